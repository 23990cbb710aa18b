"""The service's files as systemd reads them: unit, sandbox, rules and network files."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from fffo_drive import manual
from fffo_drive.daemon.places import SYSTEM_RECORDS
from fffo_drive.runtime.realtime import RealtimeRequest
from fffo_drive.system import service_files as sf

SYSTEMD = Path(__file__).resolve().parents[2] / "systemd"
UNIT_TEXT = (SYSTEMD / sf.UNIT).read_text(encoding="utf-8")
RECORDS_TEXT = (SYSTEMD / sf.RECORDS_UNIT).read_text(encoding="utf-8")
MOST_EXPOSED = 20  # tenths; `systemd-analyze security` calls up to 2.0 "OK" in its best sense
DOCUMENTED = {  # systemd.link(5), systemd.network(5), systemd.netdev(5)
    "Match": {"Name", "OriginalName"},
    "Link": {"TransmitQueueLength", "RequiredForOnline"},
    "Network": {"LinkLocalAddressing"},
    "CAN": {"BitRate", "RestartSec"},
    "NetDev": {"Name", "Kind", "MTUBytes"},
}


def settings(name: str, text: str = UNIT_TEXT) -> list[str]:
    """All values of a setting in a unit, in order."""
    return re.findall(rf"^{name}=(.*)$", text, re.MULTILINE)


def test_what_the_units_may_take_is_what_the_page_says():
    page = (Path(manual.__file__).parent / "pages/howto/service.md").read_text(encoding="utf-8")
    table = re.findall(r"^\| ([A-Z]\w+) \| (\S+) \| (\S+) \|$", page, re.MULTILINE)
    assert {"MemoryMax", "OOMScoreAdjust", "OOMPolicy", "TasksMax", "LimitNOFILE"} <= {name for name, *_ in table}
    for name, daemon, records in table:
        assert settings(name) == [daemon], name
        assert settings(name, RECORDS_TEXT) == [records], name


def test_the_unit_of_the_records_has_the_daemons_user_directories_and_sandbox():
    same = {"User", "Group", "StateDirectory", "CacheDirectory", "ProtectSystem", "NoNewPrivileges", "DynamicUser"}
    same |= {name for name in re.findall(r"^((?:Protect|Private|Restrict(?!Address))\w+)=", UNIT_TEXT, re.MULTILINE)}
    for name in same:
        assert settings(name, RECORDS_TEXT) == settings(name), name
    socket_text = (SYSTEMD / sf.RECORDS_SOCKET).read_text(encoding="utf-8")
    assert settings("ListenStream", socket_text) == ["%t/fffo-drive-records/%i.sock"]
    assert str(SYSTEM_RECORDS) == "/run/fffo-drive-records"  # %t of a system unit
    assert sf.RECORDS_SOCKET.replace("@", "@%i") in settings("Wants")[0].split()


@pytest.fixture
def placed(tmp_path):
    """The units as installed, their program being one that is there."""
    for name in (sf.UNIT, sf.RECORDS_UNIT, sf.RECORDS_SOCKET):
        text = (SYSTEMD / name).read_text(encoding="utf-8")
        (tmp_path / name).write_text(text.replace(sf.PROGRAM, shutil.which("true") or "/bin/true"), encoding="utf-8")
    return tmp_path / sf.UNIT


@pytest.mark.systemd
@pytest.mark.parametrize("name", [sf.UNIT, sf.RECORDS_UNIT, sf.RECORDS_SOCKET])
@pytest.mark.parametrize("instance", ["", "can0", "vcan0", "can_axis1"])
def test_systemd_has_nothing_to_say_about_the_unit(placed, name, instance):
    unit = placed.with_name(name.replace("@", f"@{instance}"))
    done = subprocess.run(["systemd-analyze", "verify", "--man=no", str(unit)], capture_output=True, text=True)
    # it ends well even with unknown keys: what counts is that it says nothing
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.systemd
def test_a_misspelt_setting_would_be_noticed(placed):
    placed.write_text(placed.read_text().replace("WatchdogSec", "WatchdogSecs"))
    done = subprocess.run(["systemd-analyze", "verify", "--man=no", str(placed)], capture_output=True, text=True)
    assert "WatchdogSecs" in done.stderr


@pytest.mark.systemd
def test_the_sandbox_is_tight(placed):
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", f"--threshold={MOST_EXPOSED}", str(placed)],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    level = re.search(r"exposure level for \S+: ([\d.]+)", done.stdout)
    assert level is not None
    assert float(level.group(1)) <= MOST_EXPOSED / 10


def allowed_calls() -> set[str]:
    """System calls that the unit's filters leave, groups resolved by systemd itself."""
    calls: set[str] = set()
    for line in settings("SystemCallFilter"):
        group = resolved(line.removeprefix("~").split())
        calls = calls - group if line.startswith("~") else calls | group
    return calls


def resolved(groups: list[str]) -> set[str]:
    """Calls of groups, with the groups inside them."""
    printed = subprocess.run(["systemd-analyze", "syscall-filter", *groups], capture_output=True, text=True, check=True)
    words = {line.strip() for line in printed.stdout.splitlines() if line.startswith("    ") and "#" not in line}
    inner = sorted(word for word in words if word.startswith("@"))
    return {word for word in words if not word.startswith("@")} | (resolved(inner) if inner else set())


@pytest.mark.systemd
def test_the_filter_leaves_what_the_loop_needs_and_nothing_that_takes_privileges():
    calls = allowed_calls()
    loop = {"sched_setscheduler", "sched_setaffinity", "mlockall", "munlockall", "prctl", "clock_nanosleep", "ppoll"}
    bus = {"socket", "bind", "setsockopt", "sendto", "recvfrom", "recvmsg", "ioctl"}
    compiled = {"mmap", "mprotect", "clone", "clone3", "futex"}
    assert loop | bus | compiled <= calls
    assert not calls & {
        "setuid",
        "setresuid",
        "mount",
        "init_module",
        "clock_settime",
        "reboot",
        "keyctl",
        "ptrace",
        "bpf",
    }


def test_real_time_comes_from_limits_and_not_from_capabilities():
    assert settings("CapabilityBoundingSet") == [""]
    assert int(settings("LimitRTPRIO")[0]) >= RealtimeRequest(60, -1, True).priority
    assert settings("LimitMEMLOCK") == ["infinity"]
    # the whole process would become real-time, recorder and API included
    assert settings("CPUSchedulingPolicy") == []
    for name in ("RestrictRealtime", "MemoryDenyWriteExecute"):  # no SCHED_FIFO; no compiled kernels
        assert settings(name) == []


def test_the_highest_priority_of_an_axis_file_is_within_the_units_limit():
    from fffo_drive.config.sections import RealtimeSection

    highest = RealtimeSection.model_json_schema()["properties"]["priority"]["maximum"]
    assert int(settings("LimitRTPRIO")[0]) >= highest


def test_what_one_axis_may_take_of_the_machine_is_bounded():
    from fffo_drive.config.sections import DaemonSection

    most_clients = DaemonSection.model_json_schema()["properties"]["clients"]["maximum"]
    own_descriptors, own_threads, own_bytes = 28, 9, 365_000_000  # measured; the bytes while it compiles
    assert int(settings("LimitNOFILE")[0]) > 2 * (own_descriptors + 2 * most_clients)  # of two sockets, and viewers
    assert int(settings("TasksMax")[0]) > 2 * own_threads
    (memory,) = settings("MemoryMax")
    assert memory == "1G"
    assert 2 * own_bytes < 1 << 30
    # a standstill, then the drive's release: what SIGTERM asks for
    assert int(settings("TimeoutStopSec")[0]) >= 5


def test_a_bad_configuration_is_not_tried_again_and_a_crash_is():
    from fffo_drive.cli.exits import EXIT_BAD_INPUT, EXIT_NOT_PERMITTED, EXIT_UNAVAILABLE

    never = {int(code) for code in settings("RestartPreventExitStatus")[0].split()}
    assert {EXIT_BAD_INPUT, EXIT_NOT_PERMITTED} <= never
    assert EXIT_UNAVAILABLE not in never
    assert settings("Restart") == ["on-failure"]


def test_compiled_kernels_have_a_directory_that_the_services_user_may_write():
    # each axis has its own user: a shared directory would change hands at every start
    assert settings("CacheDirectory") == ["fffo-drive/%i"]
    assert "NUMBA_CACHE_DIR=%C/fffo-drive/%i" in settings("Environment")[0].split()


def test_the_unit_follows_its_interface():
    device = "sys-subsystem-net-devices-%i.device"
    assert settings("BindsTo") == [device]
    assert device in settings("After")[0].split()
    assert settings("WantedBy") == [device]


@pytest.mark.parametrize("path", sorted((SYSTEMD / "network").iterdir()), ids=lambda path: path.name)
def test_network_files_have_documented_keys_only(path):
    parser = configparser.ConfigParser(interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(path.read_text(encoding="utf-8"))
    for section in parser.sections():
        assert set(parser[section]) <= DOCUMENTED[section]
    name = parser["NetDev"]["Name"] if "NetDev" in parser else next(iter(parser["Match"].values()))
    assert name == sf.interface_of(path.name)


def test_the_transmit_queue_is_one_the_doctor_accepts():
    from fffo_drive.system.bus import LONGEST_QUEUE, SHORTEST_QUEUE

    link = (SYSTEMD / "network" / "80-fffo-can0.link").read_text()
    rules = (SYSTEMD / "90-fffo-drive.rules").read_text()
    lengths = re.findall(r"TransmitQueueLength=(\d+)", link) + re.findall(r'ATTR\{tx_queue_len\}="(\d+)"', rules)
    assert len(lengths) == 2
    assert all(SHORTEST_QUEUE <= int(length) <= LONGEST_QUEUE for length in lengths)


RULE = re.compile(r'^(ACTION|SUBSYSTEM|KERNEL|TAG|NAME|ENV\{\w+\}|ATTR\{\w+\})(==|!=|=|\+=)"[^"]*"$')


def test_every_rule_is_written_as_udev_wants_it():
    lines = (SYSTEMD / "90-fffo-drive.rules").read_text().splitlines()
    rules = [line.removeprefix("# ") for line in lines if line.removeprefix("# ").startswith("ACTION")]
    assert len(rules) == 2
    for rule in rules:
        for part in rule.split(", "):
            assert RULE.match(part), part
