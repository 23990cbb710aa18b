"""The service under a real systemd, in a user-mode kernel: one boot, and what `service_life` must have seen in it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from needs import ROOT

from fffo_drive.canopen_node import emcy
from fffo_drive.commissioning.judge import CHECKS, judged
from fffo_drive.commissioning.record import BoundsRecord, CommissioningRecord, DriveRecord, overall, write_record
from fffo_drive.config.commissioning import declared_facts
from fffo_drive.daemon.journal import MESSAGE_IDS
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.workflows.plan import make_plan

pytestmark = [pytest.mark.slow, pytest.mark.uml, pytest.mark.systemd, pytest.mark.timeout(1500)]

LIMIT_S = 850.0
FIRST_DYNAMIC_UID = 61184
FIFO, OTHER = 1, 0
PRIORITY = 60

# an axis that a slow machine can serve: 100 Hz, a slow law, and limits on real time that are far away
AXIS: dict[str, Any] = {
    "format": "fffo_drive/axis/1",
    "name": "vcan0",
    "commissioning": "vcan0.commissioning.yaml",
    "drive": {
        "kind": "canopen", "bus": "socketcan:vcan0", "node_id": 1, "resolver_bits": 15,
        "velocity_units_per_rps": 32768, "rated_torque_nm": 1.2284, "rated_current_a": 8.3, "answer_timeout_s": 5,
        "start_timeout_s": 60, "heartbeat_timeout_ms": 30_000, "command_timeout_ms": 3000,
    },
    "model": "models/table1.yaml",
    "controller": {
        "proportional_a_per_rps": 0.1, "integral_a_per_rev": 0.2, "current_limit_a": 12, "observer": {"toggle": "off"},
        "at_rest": {"gain_share": 0.1},  # a period of 10 ms is a delay that the contact's spring does not bear
    },
    "envelope": {
        "current_limit_a": 14, "continuous_current_a": 8.3, "speed_limit_rps": 25, "following_error_rps": 8,
        "following_error_s": 60, "feedback_missing_ticks": 1000, "accept_runaway": True,
        "status_missing_ticks": 1000, "heartbeat_timeout_s": 30,
    },
    "loop": {"rate_hz": 100},
    "realtime": {"priority": PRIORITY, "cpu": "last", "lock_memory": True, "required": True},
    "profile": {"kind": "sine", "duration_s": 500, "amplitude": 1, "frequency_hz": 0.2},
    "daemon": {"retry_s": 1, "supervisor_timeout_s": 30, "enable_timeout_s": 60, "stop_timeout_s": 30},
}  # fmt: skip
DRIVE = {"format": "fffo_drive/simulated/1", "node_id": 1, "sync_loss_tolerance_ms": 30_000, "plant": {"seed": 1}}

# what the daemon and the drive run, compiled here where it is fast; prints where numba keeps it
COMPILE = """\
import sys
from fffo_drive.workflows.plan import make_plan, open_drive, plan_session
from fffo_drive.config.simulated import read_simulated
from fffo_drive.drive.simulated.node.process import rehearse
from fffo_drive.jit import cache_directory
from fffo_drive.runtime.session import OnPaper, Session
plan = make_plan(sys.argv[1])
Session.rehearse(OnPaper(open_drive(plan).rehearsal_port()), plan_session(plan))
rehearse(read_simulated(sys.argv[2]))
print(cache_directory())
"""


def write_files(directory: Path) -> None:
    """The axis, its commissioning record for the simulated drive, and the drive."""
    (directory / "models").mkdir()
    (directory / "models/table1.yaml").write_text((ROOT / "configs/models/table1.yaml").read_text())
    (directory / "vcan0.yaml").write_text(yaml.safe_dump(AXIS, sort_keys=False))
    (directory / "drive.yaml").write_text(yaml.safe_dump(DRIVE))
    plan = make_plan(directory / "vcan0.yaml")
    facts, identity = declared_facts(plan.axis, plan.model), NodeConfig().identity
    checks = [judged(name, "ok", "fine") for name in CHECKS]
    record = CommissioningRecord(
        axis="vcan0", date="2026-01-02T03:04:05+00:00", tool="fffo_drive", bus="socketcan:vcan0",
        drive=DriveRecord(
            vendor_id=identity.vendor_id, product_code=identity.product_code, revision=identity.revision,
            serial_number=identity.serial_number,
        ),
        facts=facts, facts_hash=facts.digest, model="table1",
        bounds=BoundsRecord(current_a=1.0, speed_rps=2.0, travel_rev=3.0, time_s=4.0),
        verdict=overall(checks), checks=checks,
    )  # fmt: skip
    write_record(directory / "vcan0.commissioning.yaml", record)


def compiled(directory: Path) -> str:
    """Directory of the compiled code, in the user's cache: in that of the tests there are types of theirs."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    command = [sys.executable, "-c", COMPILE, str(directory / "vcan0.yaml"), str(directory / "drive.yaml")]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def live(directory: Path) -> tuple[dict[str, dict[str, Any]], list[dict[str, Any]]]:
    """Boot, go through all steps. Returns what each saw, and the service's journal."""
    write_files(directory)
    script = 'tools/uml/relocate "$PWD" /opt/fffo_drive && exec "$@"'
    program = ["/opt/fffo_drive/.venv/bin/python", "tests/uml/service_life.py"]
    done = subprocess.run(
        ["tools/uml/run", "--systemd", "--timeout", str(LIMIT_S), "--exchange", directory, "--log", directory / "log",
         "--env", f"FFFO_COMPILED={compiled(directory)}", "sh", "-c", script, "sh", *program],
        cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S + 60.0,
    )  # fmt: skip
    assert (directory / "rows").exists(), done.stdout + done.stderr
    rows = [json.loads(line) for line in (directory / "rows").read_text().splitlines()]
    journal = [json.loads(line) for line in (directory / "journal").read_text().splitlines()]
    return {row["step"]: row for row in rows}, journal


Check = Callable[[dict[str, Any]], None]
CHECKED: dict[str, Check] = {}


def step(check: Check) -> Check:
    """What the step of this name must have seen."""
    CHECKED[check.__name__] = check
    return check


@step
def install(row):
    assert row["code"] == row["enabled"] == 0
    assert [command["problem"] for command in row["said"]["commands"]] == ["", "", ""]
    assert "etc/systemd/system/fffo-drive@.service" in row["said"]["installed"]
    assert row["active"] == "inactive"  # nothing is started by it


@step
def start_with_the_interface(row):
    assert (row["ActiveState"], row["SubState"], row["NRestarts"]) == ("active", "running", "0")
    assert row["queue"] == 16  # by the installed rule
    assert row["text"].startswith("offline")  # there is no drive yet


@step
def look_at_the_sandbox(row):
    assert row["inside"] == {
        "write to /etc": "EROFS",
        "write beside the program": "EROFS",
        "write to the state directory": "ok",
        "write to the cache directory": "ok",
        "read /home": "EACCES",
        "read /root": "EACCES",
        "see a process of others": "ENOENT",
        "open /dev/mem": "ENOENT",
        "change a kernel setting": "ENOENT",
        "mount": "EPERM",
        "new user namespace": "EPERM",
        "set the clock": "EPERM",
        "become root": "EPERM",
        "CAN socket": "ok",
        "packet socket": "EAFNOSUPPORT",
        "netlink socket": "EAFNOSUPPORT",
        "FIFO priority 98": "ok",
        "FIFO priority 99": "EPERM",
        "lock memory": "ok",
        "compiled code": "ok",
    }
    assert row["uid"] >= FIRST_DYNAMIC_UID
    assert row["group"] == "fffo-drive"
    assert row["CapEff"] == row["CapPrm"] == row["CapBnd"] == 0
    assert row["NoNewPrivs"] == 1
    assert row["Seccomp"] == 2


@step
def look_at_the_sockets(row):
    everyone, members = {"member": True, "stranger": True}, {"member": True, "stranger": False}
    assert row["watch.sock"] == {"mode": 0o666, "group": "fffo-drive", **everyone}
    assert row["control.sock"] == {"mode": 0o660, "group": "fffo-drive", **members}


@step
def find_the_drive(row):
    assert row["realtime"] == {"fifo": True, "cpu": -1, "locked": True, "refusals": []}  # one CPU: nothing to pin to
    assert row["drive"]["product_code"] == NodeConfig().identity.product_code
    assert row["threads"].count([FIFO, PRIORITY]) == 1
    assert row["threads"].count([OTHER, 0]) == len(row["threads"]) - 1
    assert row["limit"] == 98
    assert row["locked_kib"] > 10_000
    assert row["text"].startswith("ready")


@step
def run_a_profile(row):
    assert row["code"] == 0
    assert row["said"].startswith("running, for ")
    assert "operation enabled" in row["said"]
    assert row["text"] == "running sine, friction off"
    assert row["uninstall"][0] == 78
    assert "systemctl disable --now fffo-drive@vcan0.service" in row["uninstall"][1]


@step
def reload(row):
    assert row["code"] == 0
    assert row["warning"] == "reloaded by SIGHUP: controller; needs a restart: loop"
    assert "all goes on as it was" in row["refused"]
    assert "vcan0.yaml:1" in row["refused"]
    assert (row["gain"], row["rate_hz"]) == (0.12, 100)
    assert row["state"] == row["still"] == "running"


@step
def take_the_interface_down(row):
    assert row["before"] == "running"
    assert row["fault"]["name"] == "bus_off"
    assert row["text"] == f"fault: {row['fault']['text']}"
    assert (row["during"]["ActiveState"], row["during"]["NRestarts"]) == ("active", "0")
    assert "enable is not possible in state fault" in row["refused"]
    assert row["drive"] == "switch on disabled"  # a reset is no enable
    assert row["connections"] == 2


@step
def hang(row):
    assert emcy.RPDO_TIMEOUT in row["codes"]
    assert row["drive_first"]  # it had stopped by itself when the watchdog came
    assert not row["same_pid"]
    assert "Watchdog timeout" in row["said"]
    assert "Failed with result 'watchdog'" in row["said"]
    assert row["state"] == "ready"
    assert row["drive"] == "switch on disabled"  # a new daemon enables nothing


@step
def remove_the_interface(row):
    assert (row["ActiveState"], row["Result"], row["ExecMainStatus"]) == ("inactive", "success", "0")
    assert row["sockets"] == []


@step
def come_back_with_rubbish(row):
    assert (row["Result"], row["ExecMainStatus"], row["NRestarts"]) == ("exit-code", "78", "0")
    assert row["later"] == {name: row[name] for name in row["later"]}  # it is not tried again


@step
def start_without_rights(row):
    assert row["code"] != 0
    assert (row["ActiveState"], row["ExecMainStatus"], row["NRestarts"]) == ("failed", "77", "0")
    assert row["later"] == {name: row[name] for name in row["later"]}


@step
def uninstall(row):
    assert row["code"] == 0
    assert row["said"]["kept"] == ["etc/fffo-drive/vcan0.yaml"]  # edited
    assert "etc/systemd/system/fffo-drive@.service" in row["said"]["removed"]
    assert not row["group"]


def fields_of_the_journal(journal: list[dict[str, Any]]) -> None:
    """What `journalctl FFFO_STATE=...` and MESSAGE_ID= find."""
    ours = [entry for entry in journal if "FFFO_KIND" in entry]
    assert {"started", "drive", "state", "command", "reload", "fault", "stopping"} <= {e["FFFO_KIND"] for e in ours}
    for entry in ours:
        assert entry["MESSAGE_ID"] == MESSAGE_IDS[entry["FFFO_KIND"]]
        assert entry["FFFO_AXIS"] == "vcan0"
        assert entry["FFFO_STATE"]
        assert entry["SYSLOG_IDENTIFIER"] == "fffo-drive"
        assert entry["_SYSTEMD_UNIT"] == "fffo-drive@vcan0.service"
        assert int(entry["_UID"]) >= FIRST_DYNAMIC_UID
    fault = next(entry for entry in ours if entry["FFFO_KIND"] == "fault")
    assert (fault["FFFO_STATE"], fault["FFFO_FAULT"], fault["PRIORITY"]) == ("fault", "bus_off", "3")
    commands = [entry for entry in ours if entry["FFFO_KIND"] == "command"]
    assert all(int(entry["FFFO_CLIENT_PID"]) > 1 and entry["FFFO_CLIENT_UID"] == "0" for entry in commands)
    said = [str(entry["MESSAGE"]) for entry in journal]
    assert any("vcan0.yaml:1" in text for text in said)  # why 78
    assert any("CPU 7 for the loop" in text for text in said)  # why 77


def test_the_service_lives_as_its_unit_says(tmp_path, subtests):
    rows, journal = live(tmp_path)
    for name, check in CHECKED.items():
        with subtests.test(name):
            assert "error" not in rows[name], rows[name]["error"]
            check(rows[name])
    with subtests.test("journal"):
        fields_of_the_journal(journal)
