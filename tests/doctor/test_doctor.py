"""The doctor on recorded machines: a good one, an ordinary one, a guest, an empty one; and each line by itself."""

from __future__ import annotations

import contextlib
import gzip
import json
import os
import tempfile
import threading
from pathlib import Path

import numpy as np
import pytest
from doctor import machines

from fffo_drive.can.frame import pack_frame
from fffo_drive.can.lease import BusLease, bus_holder
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.cli import main
from fffo_drive.jit import cache_directory, kernel_digest
from fffo_drive.runtime.realtime import RealtimeReport
from fffo_drive.system.compiled import cache_findings
from fffo_drive.system.doctor import as_text, counts, examine
from fffo_drive.system.findings import HostFinding, Severity, Wanted
from fffo_drive.system.host import Host, cpu_list
from fffo_drive.system.lateness import Lateness, lateness_findings, measure_lateness

CAN0 = Wanted(cpu=3, bus="socketcan:can0")
CLOCK = "sys/devices/system/clocksource/clocksource0/current_clocksource"
AXIS = Path(__file__).resolve().parents[2] / "configs" / "axis_canopen.yaml"


def look(files, wanted=CAN0):
    """Findings by subject, of a recorded machine; a file whose text is None is not there."""
    with tempfile.TemporaryDirectory() as directory:
        there = {name: text for name, text in files.items() if text is not None}
        host = Host(machines.write(there, Path(directory)))
        return {finding.subject: finding for finding in examine(host, wanted)}


def limits(priority):
    return machines.LIMITS.format(memory="unlimited", priority=priority)


def levels(found: dict[str, HostFinding]) -> dict[str, str]:
    return {subject: str(finding.level) for subject, finding in found.items()}


def test_a_machine_as_it_should_be_has_nothing_to_mend():
    found = look(machines.desktop())
    assert set(levels(found).values()) == {"ok"}
    assert not any(finding.remedy for finding in found.values())
    assert "PREEMPT_RT" in found["kernel"].text
    assert "peak_pciefd on pci" in found["can can0 driver"].text


def test_an_ordinary_laptop_with_an_adapter_on_usb():
    found = look(machines.laptop())
    assert levels(found) == {
        "kernel": "warning", "machine": "ok", "rt throttling": "ok", "rt groups": "ok",
        "limit rtprio": "failure", "limit memlock": "failure", "clock source": "warning", "cpu": "ok",
        "isolation": "warning", "governor": "warning", "idle states": "warning", "interrupts": "warning",
        "can can0 driver": "failure", "can can0": "failure", "can can0 bus-off": "warning", "can can0 mode": "ok",
        "can can0 queue": "warning",
    }  # fmt: skip
    assert "isolcpus=managed_irq,domain,1,3" in found["isolation"].remedy
    assert "cpupower -c 3 frequency-set -g performance" in found["governor"].remedy
    assert "C10 takes 890 us" in found["idle states"].text
    assert "nvme0q1" in found["interrupts"].text
    assert found["interrupts"].remedy.startswith("echo 0-2 > /proc/irq/122/smp_affinity_list")
    assert "bitrate 1000000" in found["can can0"].remedy


def test_a_guest_without_a_bus():
    found = look(machines.guest(), Wanted())
    assert levels(found) == {
        "kernel": "warning", "machine": "warning", "rt throttling": "ok", "rt groups": "failure",
        "limit rtprio": "ok", "limit memlock": "ok", "clock source": "ok", "cpu": "ok", "isolation": "warning",
        "governor": "ok", "idle states": "ok", "interrupts": "warning", "can": "warning",
    }  # fmt: skip
    assert "CPU 1" in found["cpu"].text
    assert "preemption none" in found["kernel"].text


@pytest.mark.parametrize("bus", [None, "socketcan:can0", "loopback:29500"])
def test_a_machine_that_tells_nothing_is_no_reason_to_give_up(bus):
    found = look({}, Wanted(bus=bus))
    assert counts(found.values())[Severity.FAILURE] == 0
    for finding in found.values():
        assert finding.level == Severity.OK or finding.remedy


@pytest.mark.parametrize("name", sorted(machines.desktop()))
def test_each_file_may_be_missing_or_rubbish(tmp_path, name):
    place = machines.write(machines.desktop(), tmp_path) / name
    for content in (b"", b"\x00rubbish \xff 99999999999999999999\n", b"-1", b"[{}, 3]", None):
        place.unlink()
        if content is not None:
            place.write_bytes(content)
        for finding in examine(Host(tmp_path), CAN0):
            assert finding.text


def test_every_finding_that_is_not_ok_says_what_to_type():
    for files in (machines.laptop(), machines.guest(), {}):
        for finding in look(files).values():
            assert bool(finding.remedy) == (finding.level != Severity.OK), finding


@pytest.mark.parametrize(
    ("rate_hz", "level"), [(2000, "failure"), (1000, "failure"), (501, "failure"), (500, "warning"), (100, "warning")]
)
def test_usb_adapters_are_refused_from_the_rate_that_they_cannot_keep(rate_hz, level):
    found = look(machines.laptop(), CAN0._replace(rate_hz=rate_hz))["can can0 driver"]
    assert found.level == level
    assert "gs_usb on USB" in found.text
    assert "1 ms" in found.text  # the reason


def test_a_serial_adapter_is_refused_like_one_on_usb():
    link = machines.can0(ifname="slcan0")
    found = look(machines.desktop() | {machines.IP: machines.links(link)}, Wanted(cpu=3, bus="socketcan:slcan0"))
    assert found["can slcan0 driver"].level == "failure"


@pytest.mark.parametrize(
    ("changes", "subject", "level", "text"),
    [
        ({"flags": ["NOARP"]}, "can can0", "failure", "down"),
        ({"bittiming": {"bitrate": 500000, "sample_point": "0.875"}}, "can can0", "failure", "500000"),
        ({"bittiming": {}}, "can can0", "failure", "no bit rate"),
        ({"restart_ms": 0}, "can can0 bus-off", "warning", "restart-ms 0"),
        ({"state": "BUS-OFF"}, "can can0 bus-off", "failure", "off the bus"),
        ({"state": "ERROR-PASSIVE", "berr_counter": {"tx": 128, "rx": 3}}, "can can0 bus-off", "warning", "tx 128"),
        ({"state": "ERROR-WARNING"}, "can can0 bus-off", "warning", "ERROR-WARNING"),
        ({"ctrlmode": ["LISTEN-ONLY"]}, "can can0 mode", "failure", "listens only"),
        ({"ctrlmode": ["LOOPBACK"]}, "can can0 mode", "failure", "looped back"),
        ({"ctrlmode": ["BERR-REPORTING"]}, "can can0 mode", "warning", "every single bus error"),
        ({"ctrlmode": ["TRIPLE-SAMPLING"]}, "can can0 mode", "ok", "triple-sampling"),
        ({"txqlen": 3}, "can can0 queue", "warning", "less than a period"),
        ({"txqlen": 4}, "can can0 queue", "ok", "4 frames"),
        ({"txqlen": 32}, "can can0 queue", "ok", "32 frames"),
        ({"txqlen": 33}, "can can0 queue", "warning", "old commands"),
    ],
)
def test_each_fact_of_the_interface(changes, subject, level, text):
    found = look(machines.desktop() | {machines.IP: machines.links(machines.can0(**changes))})
    assert (found[subject].level, text in found[subject].text) == (level, True), found[subject]


def test_a_virtual_bus_has_no_bit_rate():
    wanted = Wanted(cpu=3, bus="socketcan:vcan0")
    files = {machines.IP: machines.links(machines.VCAN0)}
    found = look(machines.desktop() | files)
    assert found["can can0"].level == "failure"  # can0 is not there, and what is there is named
    assert "vcan0" in found["can can0"].text
    found = look(machines.desktop() | files, wanted)
    assert {found["can vcan0 driver"].level, found["can vcan0 queue"].level} == {"ok"}


def test_a_missing_virtual_bus_can_be_made():
    found = look(machines.desktop(), Wanted(cpu=3, bus="socketcan:vcan0"))
    assert "ip link add vcan0 type vcan" in found["can vcan0"].remedy


@pytest.mark.parametrize(
    ("files", "subject", "level", "text"),
    [
        ({"sys/kernel/realtime": None, "proc/sys/kernel/version": "#1 SMP PREEMPT_RT"}, "kernel", "ok", "PREEMPT_RT"),
        ({"proc/sys/kernel/sched_rt_runtime_us": "-1"}, "rt throttling", "ok", "off"),
        ({"proc/sys/kernel/sched_rt_runtime_us": "0"}, "rt throttling", "failure", "0 %"),
        ({"proc/sys/kernel/sched_rt_runtime_us": "499999"}, "rt throttling", "warning", "49"),
        ({"proc/sys/kernel/sched_rt_runtime_us": "500000"}, "rt throttling", "ok", "50 %"),
        ({"proc/cpuinfo": "flags : hypervisor"}, "machine", "warning", "virtual machine"),
        ({"proc/self/limits": limits(59)}, "limit rtprio", "failure", "59"),
        ({"proc/self/limits": limits(60)}, "limit rtprio", "ok", "60"),
        ({"sys/devices/system/cpu/online": "0-2"}, "cpu", "failure", "not there"),
        ({"sys/devices/system/cpu/isolated": "2"}, "cpu", "warning", "CPU 2 is isolated"),
        ({"sys/devices/system/cpu/isolated": ""}, "isolation", "warning", "not isolated"),
        ({"sys/devices/system/cpu/nohz_full": ""}, "isolation", "ok", "timer tick"),
        ({"sys/devices/system/cpu/cpu3/topology/thread_siblings_list": "2-3"}, "isolation", "warning", "hyper-thread"),
        ({"sys/devices/system/cpu/cpu3/cpuidle/state2/disable": "0"}, "idle states", "warning", "890"),
        ({CLOCK: "hpet"}, "clock source", "warning", "hpet"),
        ({"proc/irq/122/effective_affinity_list": "3"}, "interrupts", "ok", "none"),  # none has come there
        ({"proc/interrupts": machines.INTERRUPTS.format(disk=9)}, "interrupts", "ok", "none"),  # led elsewhere by now
    ],
)  # fmt: skip
def test_each_fact_of_the_machine(files, subject, level, text):
    found = look(machines.desktop() | files)
    assert (found[subject].level, text in found[subject].text) == (level, True), found[subject]


@pytest.mark.parametrize(
    ("options", "command_line", "runtime_us", "level"),
    [
        ("CONFIG_RT_GROUP_SCHED=y", "", "950000", "failure"),
        ("CONFIG_RT_GROUP_SCHED=y", "rt_group_sched=0", "950000", "ok"),
        ("CONFIG_RT_GROUP_SCHED=y\nCONFIG_RT_GROUP_SCHED_DEFAULT_DISABLED=y", "", "950000", "ok"),
        ("CONFIG_RT_GROUP_SCHED=y\nCONFIG_RT_GROUP_SCHED_DEFAULT_DISABLED=y", "rt_group_sched=1", "950000", "failure"),
        ("CONFIG_RT_GROUP_SCHED=y", "", "-1", "ok"),
        ("# CONFIG_RT_GROUP_SCHED is not set\nCONFIG_SMP=y", "", "950000", "ok"),
    ],
)
def test_group_scheduling_as_it_is_built_and_as_it_was_booted(options, command_line, runtime_us, level):
    files = {
        "boot/config-6.12.43+deb13-rt-amd64": options,
        "proc/cmdline": command_line,
        "proc/sys/kernel/sched_rt_runtime_us": runtime_us,
    }
    assert look(machines.desktop() | files)["rt groups"].level == level


def test_the_packed_kernel_configuration_is_read(tmp_path):
    root = machines.write(machines.desktop(), tmp_path)
    (root / "proc/config.gz").write_bytes(gzip.compress(b"CONFIG_RT_GROUP_SCHED=y\n"))
    found = {finding.subject: finding.level for finding in examine(Host(root), CAN0)}
    assert found["rt groups"] == "failure"


@pytest.mark.parametrize(
    ("cpu", "text"), [(-1, "CPU 2, although CPU 3 is isolated"), (-2, "not pinned"), (3, "CPU 3 for")]
)
def test_the_cpu_is_chosen_as_the_loop_chooses_it(cpu, text):
    assert text in look(machines.desktop(), Wanted(cpu=cpu))["cpu"].text


def test_cpu_lists():
    assert cpu_list("0-2,5") == {0, 1, 2, 5}
    assert cpu_list("\n") == cpu_list(None) == cpu_list("nonsense") == set()


def test_a_record_of_this_machine_says_what_this_machine_says(tmp_path):
    here = Host()
    found = examine(here, Wanted())
    here.write_record(tmp_path)
    there = examine(Host(tmp_path), Wanted())
    assert [(f.subject, f.level) for f in there] == [(f.subject, f.level) for f in found]


def realtime(fifo=True, refusals=()):
    return RealtimeReport(fifo, 1, True, refusals)


@pytest.mark.parametrize(("late", "level"), [(0, "ok"), (1, "warning"), (10, "warning"), (11, "failure")])
def test_lateness_is_judged_by_the_share_of_late_ticks(late, level):
    lateness_ns = np.full(1000, 99_999, np.int64)
    lateness_ns[:late] = 100_001  # 0.2 of 500 us and 1 ns
    (found,) = lateness_findings(Lateness(lateness_ns, realtime()), Wanted())
    assert found.level == level


def test_what_the_system_refused_is_said_beside_the_figures():
    measured = Lateness(np.zeros(10, np.int64), realtime(False, ("SCHED_FIFO 60: Operation not permitted",)))
    refusal, figures = lateness_findings(measured, Wanted())
    assert "SCHED_FIFO" in refusal.text
    assert "ordinary scheduling" in figures.text


@pytest.mark.slow
@pytest.mark.realtime
def test_lateness_is_measured_for_every_period():
    measured = measure_lateness(Wanted(rate_hz=4000, priority=0, lock_memory=False, cpu=-2), 0.02)
    assert measured.lateness_ns.shape == (80,)
    assert (measured.lateness_ns >= 0).all()  # never before its deadline


def test_a_cache_is_warm_once_the_loop_is_compiled(tmp_path):
    services = tmp_path / "services"
    (services / "can0" / "0123").mkdir(parents=True)
    own, can0 = cache_findings(tmp_path / "own", "0123", services)
    assert (own.level, can0.level) == ("warning", "warning")
    assert "fffo-drive@can0" in can0.remedy
    (services / "can0" / "0123" / "runtime_ab").mkdir()
    (services / "can0" / "0123" / "runtime_ab" / "loop.run_loop-1.py311.nbi").touch()
    assert cache_findings(tmp_path / "own", "0123", services)[1].level == "ok"
    assert cache_directory().name == kernel_digest()


def doctor(capsys, *words: str) -> tuple[int, str]:
    code = main(["doctor", *words])
    return code, capsys.readouterr().out


def test_the_command_says_how_it_is_by_its_exit_code(tmp_path, capsys):
    good = machines.write(machines.desktop(), tmp_path / "good")
    bad = machines.write(machines.laptop(), tmp_path / "bad")
    code, text = doctor(capsys, str(AXIS), "--bus", "socketcan:can0", "--root", str(good))
    assert code == 0
    assert text.endswith("0 failures, 2 warnings, 15 ok\n")  # 'last' takes no isolated CPU
    code, text = doctor(capsys, "--root", str(bad), "--json")
    assert code == 1
    said = json.loads(text)
    assert said["counts"]["failure"] == sum(finding["level"] == "failure" for finding in said["findings"])
    assert main(["doctor", "--root", str(tmp_path / "none")]) == 74
    assert "no such directory" in capsys.readouterr().err
    assert set(said["findings"][0]) == {"subject", "level", "text", "remedy"}


def test_an_axis_file_decides_what_is_asked_for(tmp_path, capsys):
    root = machines.write(machines.desktop(), tmp_path)
    axis = tmp_path / "axis.yaml"
    text = (
        AXIS.read_text()
        .replace("loopback:29500", "socketcan:can0")
        .replace("node_id: 1", "node_id: 1\n  bitrate_hz: 500000")
    )
    axis.write_text(text + "realtime: {cpu: 3, priority: 98}\nloop: {rate_hz: 1000}\n")
    code, said = doctor(capsys, str(axis), "--root", str(root))
    assert code == 1
    assert "98; the loop asks for 98" in said
    assert "bit rate 1000000, the axis file says 500000" in said
    assert "CPU 3 for the loop" in said


def bus_master(capsys, path, bus):
    said = json.loads(doctor(capsys, str(path), "--bus", bus, "--seconds", "0", "--json")[1])
    (finding,) = [finding for finding in said["findings"] if finding["subject"] == "bus master"]
    return finding["level"], finding["text"]


@contextlib.contextmanager
def saying(bus, *frames):
    """Somebody says this again and again."""
    stop = threading.Event()

    def say():
        with open_link(bus) as link:
            while not stop.wait(0.01):
                for frame in frames:
                    link.send(frame)

    thread = threading.Thread(target=say)
    thread.start()
    yield
    stop.set()
    thread.join()


def test_who_else_commands_on_the_bus_of_an_axis_is_heard_and_named(tmp_path, capsys):
    bus = f"loopback:{free_loopback_port()}"
    axis = tmp_path / "axis.yaml"
    axis.write_text(AXIS.read_text().replace("node_id: 1", "node_id: 1\n  listen_s: 0.2"))
    heartbeat = pack_frame(0x702, b"\x05")
    nobody = f"{bus}: nobody else was heard to command in 0.2 s; heartbeats of nodes:"
    assert bus_master(capsys, axis, bus) == ("ok", f"{nobody} none")
    with saying(bus, heartbeat):
        assert bus_master(capsys, axis, bus) == ("ok", f"{nobody} 2")
    with saying(bus, heartbeat, pack_frame(0x080)):
        assert bus_master(capsys, axis, bus) == ("failure", f"{bus}: somebody else commands here: SYNC (0x080)")
    with contextlib.closing(BusLease(bus)):
        holder = bus_holder(bus)
        assert holder is not None
        assert holder.startswith(f"process {os.getpid()} (")  # and a command line, another one in a worker
        told = f"{holder} on this machine commands on {bus}; heartbeats of nodes: none"
        assert bus_master(capsys, axis, bus) == ("warning", told)
    level, text = bus_master(capsys, axis, "socketcan:no-such-can0")
    assert level == "failure"
    assert "socketcan:no-such-can0" in text


def test_text_is_one_line_a_finding_and_one_a_remedy():
    text = as_text(
        [HostFinding("a", Severity.OK, "fine"), HostFinding("long one", Severity.FAILURE, "broken", "mend it")]
    )
    assert text.splitlines() == [
        "ok       a         fine",
        "failure  long one  broken",
        "                     -> mend it",
        "1 failure, 0 warnings, 1 ok",
    ]
