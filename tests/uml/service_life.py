"""The life of fffo-drive@vcan0.service under systemd as PID 1: installed, started, driven, ill-treated, taken away.

Runs inside `tools/uml/run --systemd`, as root, with what the product installs and nothing in its place: the unit, the
daemon, the simulated drive as a process on vcan0. Each step writes what it saw as a line of JSON to $UML_EXCHANGE/rows;
test_systemd_service.py says what it should be. A step that fails writes its error, and the next one follows.
"""

from __future__ import annotations

import contextlib
import grp
import hashlib
import json
import os
import shutil
import signal
import socket
import stat
import struct
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from fffo_drive.daemon.client import CallError, ClientError, DaemonClient
from fffo_drive.daemon.places import CONTROL, SYSTEM_DIRECTORY, WATCH

INTERFACE = "vcan0"
UNIT = f"fffo-drive@{INTERFACE}.service"
EXCHANGE = Path(os.environ["UML_EXCHANGE"])
SOURCE, HOME = Path.cwd(), Path("/opt/fffo_drive")  # the project on the host, and where services may see it
PROGRAM = HOME / ".venv/bin/fffo-drive"
AXIS = Path(f"/etc/fffo-drive/{INTERFACE}.yaml")
SOCKETS = SYSTEM_DIRECTORY / INTERFACE
CACHE = Path(f"/var/cache/private/fffo-drive/{INTERFACE}")  # DynamicUser=
UNITS = Path("/etc/systemd/system")
DROP_IN = UNITS / f"{UNIT}.d"
PATIENCE_S = 200.0
SETTLING_S = 3.0  # longer than RestartSec=: whoever wants to restart has done so
NOBODY = 65534
EMERGENCY = 0x081
FIELDS = ("ActiveState", "SubState", "Result", "ExecMainStatus", "NRestarts", "MainPID", "StatusText")

SLOW = """\
[Service]
# one slow processor, shared with others
WatchdogSec=10
TimeoutStopSec=60
TimeoutStartSec=200
ExecStartPre={python} {probe} %t/fffo-drive/%i/sandbox.json
"""
DRIVE = f"""\
[Service]
Environment=NUMBA_CACHE_DIR=/var/cache/drive PYTHONUNBUFFERED=1
ExecStart={PROGRAM} sim {EXCHANGE}/drive.yaml --bus socketcan:{INTERFACE}
"""


# what is looked at


def run(*words: str | Path) -> tuple[int, str]:
    """A command: its exit code, and what it says."""
    done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return done.returncode, done.stdout.strip()


def unit() -> dict[str, str]:
    """What systemd says about the service."""
    lines = run("systemctl", "show", UNIT, *(f"--property={name}" for name in FIELDS))[1].splitlines()
    return dict(line.split("=", 1) for line in lines)


def until(what: str, condition: Callable[[], Any], pause_s: float = 0.2) -> Any:
    """Wait until it is so; what it gave. A look at systemd costs a tenth of a second in here."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"{what}: not within {PATIENCE_S:g} s; {unit()}")
        time.sleep(pause_s)
    return found


def until_unit(**wanted: str) -> dict[str, str]:
    """Wait until the service's properties are these. Returns all of them."""

    def there() -> dict[str, str] | None:
        found = unit()
        return found if all(found[name] == value for name, value in wanted.items()) else None

    found: dict[str, str] = until(str(wanted), there, 1.0)
    return found


@contextlib.contextmanager
def client() -> Iterator[DaemonClient]:
    """A connection to the control socket."""

    def connected() -> DaemonClient | None:
        with contextlib.suppress(ClientError):
            return DaemonClient(SOCKETS / CONTROL, PATIENCE_S)
        return None

    with until("a daemon on the socket", connected) as found:
        yield found


def until_state(api: DaemonClient, state: str) -> dict[str, Any]:
    """Wait for a state of the axis. Returns its status."""

    def there() -> dict[str, Any] | None:
        status: dict[str, Any] = api.call("status")
        return status if status["state"] == state else None

    found: dict[str, Any] = until(f"state {state}", there)
    return found


def until_text(start: str) -> str:
    """Wait until the line that `systemctl status` shows begins like this. Returns it."""
    return str(until(f"status text {start}", lambda: (text := unit()["StatusText"]).startswith(start) and text, 0.5))


def set_running(api: DaemonClient) -> None:
    """Enable, and start the profile of the file."""
    until_state(api, "ready")
    api.call("enable", wait_s=PATIENCE_S)
    api.act("start", profile="default")
    until("ticks of the profile", lambda: (api.call("status")["profile"] or {}).get("sample", 0) > 20)


def threads_of(pid: str) -> list[tuple[int, int]]:
    """Scheduling policy and real-time priority of every thread (fields 41 and 40 of proc(5) stat)."""
    found = []
    for path in Path(f"/proc/{pid}/task").glob("*/stat"):
        fields = path.read_text().rpartition(")")[2].split()
        found.append((int(fields[38]), int(fields[37])))
    return found


def status_of(pid: str) -> dict[str, str]:
    """/proc/PID/status."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return {name: value.strip() for name, value in (line.split(":", 1) for line in lines)}


def edit(old: str, new: str) -> None:
    """Change the axis file as somebody with an editor would."""
    text = AXIS.read_text()
    assert old in text, (old, text)
    AXIS.write_text(text.replace(old, new))


def may_connect(groups: list[int], name: str) -> bool:
    """Whether a user who is in these groups may open a socket of the daemon."""
    child = os.fork()
    if child == 0:
        os.setgroups(groups)
        os.setgid(NOBODY)
        os.setuid(NOBODY)
        try:
            DaemonClient(SOCKETS / name, PATIENCE_S).close()
        except ClientError:
            os._exit(1)
        os._exit(0)
    return os.waitpid(child, 0)[1] == 0


class EmergencyWitness:
    """Error codes of the drive's EMCY, from now on."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        own = struct.pack("=II", EMERGENCY, 0x7FF)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, own)
        self._socket.bind((INTERFACE,))
        self._socket.setblocking(False)

    def codes(self) -> list[int]:
        """Those that came."""
        found = []
        with contextlib.suppress(BlockingIOError, OSError):
            while True:
                found.append(int.from_bytes(self._socket.recv(16)[8:10], "little"))
        return found


# the steps, in their order


def install() -> dict[str, Any]:
    """As a user does; then the files of this axis, and code that was compiled before."""
    code, said = run(PROGRAM, "install", "--network", INTERFACE, "--json")
    for name in (AXIS.name, f"{INTERFACE}.commissioning.yaml"):
        shutil.copy(EXCHANGE / name, AXIS.parent / name)
    DROP_IN.mkdir()
    python, probe = HOME / ".venv/bin/python", HOME / "tests/uml/sandbox_probe.py"
    (DROP_IN / "slow.conf").write_text(SLOW.format(python=python, probe=probe))
    (UNITS / "drive.service").write_text(DRIVE)
    for place in (CACHE, Path("/var/cache/drive")):
        take_compiled(place)
    enabled = run("systemctl", "enable", UNIT)  # which reads all units again
    return {"code": code, "said": json.loads(said), "enabled": enabled[0], "active": unit()["ActiveState"]}


def take_compiled(place: Path) -> None:
    """numba names a directory of its cache after the path of the sources; these lie elsewhere in here."""
    kept = Path(os.environ["FFFO_COMPILED"])
    package = SOURCE / "fffo_drive"
    names = {named(SOURCE, path): named(HOME, path) for path in (package, *package.rglob("*/"))}
    for directory in kept.iterdir():
        shutil.copytree(directory, place / kept.name / names.get(directory.name, directory.name))


def named(root: Path, directory: Path) -> str:
    """numba.core.caching: get_suitable_cache_subpath."""
    path = root / directory.relative_to(SOURCE)
    return f"{path.name}_{hashlib.sha1(str(path).encode()).hexdigest()}"


def start_with_the_interface() -> dict[str, Any]:
    """Nobody starts the service: its interface appears, made by networkd from the installed files."""
    run("systemctl", "start", "systemd-networkd")
    found = until_unit(ActiveState="active")
    queue = Path(f"/sys/class/net/{INTERFACE}/tx_queue_len").read_text()
    return {**found, "queue": int(queue), "text": until_text("offline")}


def look_at_the_sandbox() -> dict[str, Any]:
    """From inside, and at the process."""
    status = status_of(unit()["MainPID"])
    names = ("CapEff", "CapPrm", "CapBnd", "NoNewPrivs", "Seccomp")
    return {
        "inside": json.loads((SOCKETS / "sandbox.json").read_text()),
        "uid": int(status["Uid"].split()[0]),
        "group": grp.getgrgid(int(status["Gid"].split()[0])).gr_name,
        **{name: int(status[name], 16) for name in names},
    }


def look_at_the_sockets() -> dict[str, Any]:
    """Modes, and who gets in."""
    members = [grp.getgrnam("fffo-drive").gr_gid]
    return {
        name: {
            "mode": stat.S_IMODE((SOCKETS / name).stat().st_mode),
            "group": grp.getgrgid((SOCKETS / name).stat().st_gid).gr_name,
            "member": may_connect(members, name),
            "stranger": may_connect([], name),
        }
        for name in (CONTROL, WATCH)
    }


def find_the_drive() -> dict[str, Any]:
    """The drive is switched on; the service finds it by itself. Of its threads the loop's alone is real-time."""
    run("systemctl", "start", "drive.service")
    with client() as api:
        until_state(api, "ready")
        info = api.call("info")
    pid = unit()["MainPID"]
    limits = Path(f"/proc/{pid}/limits").read_text().splitlines()
    (priority,) = [line.split()[-2] for line in limits if "realtime priority" in line]
    return {
        "realtime": info["realtime"],
        "drive": info["drive"],
        "threads": threads_of(pid),
        "limit": int(priority),
        "locked_kib": int(status_of(pid)["VmLck"].split()[0]),
        "text": until_text("ready"),
    }


def run_a_profile() -> dict[str, Any]:
    """Enabled and moving, and controlled by the command that people use. Nobody takes the unit from under it."""
    with client() as api:
        set_running(api)
    code, said = run(PROGRAM, "ctl", "--axis", INTERFACE, "status")
    kept = run(PROGRAM, "install", "--uninstall")
    return {"code": code, "said": said, "text": until_text("running"), "uninstall": kept, **unit()}


def reload() -> dict[str, Any]:
    """In mid-run: a key that applies, one that needs a restart, and then rubbish."""
    edit("proportional_a_per_rps: 0.1", "proportional_a_per_rps: 0.12")
    edit("rate_hz: 100", "rate_hz: 200")
    with client() as api:
        last = api.call("status")["last_event"]

        def reloads(level: str) -> list[str]:
            events = api.call("events", since=last)["events"]
            return [event["text"] for event in events if event["kind"] == "reload" and event["level"] == level]

        code, _ = run("systemctl", "reload", UNIT)
        (warning,) = until("a reload", lambda: reloads("warning"))
        info, state = api.call("info"), api.call("status")["state"]
        whole = AXIS.read_text()
        AXIS.write_text("rubbish: [")
        run("systemctl", "reload", UNIT)
        (refused,) = until("a refusal", lambda: reloads("error"))
        AXIS.write_text(whole)
        edit("rate_hz: 200", "rate_hz: 100")
        return {
            "code": code, "warning": warning, "refused": refused, "rate_hz": info["rate_hz"], "state": state,
            "gain": info["keys"]["controller.proportional_a_per_rps"], "still": api.call("status")["state"],
            "pid": unit()["MainPID"],
        }  # fmt: skip


def take_the_interface_down() -> dict[str, Any]:
    """In mid-run, and up again."""
    with client() as api:
        before = api.call("status")
        run("ip", "link", "set", INTERFACE, "down")
        status = until_state(api, "fault")
        text, during = until_text("fault"), unit()
        try:
            refused = str(api.call("enable"))
        except CallError as error:
            refused = str(error)
        run("ip", "link", "set", INTERFACE, "up")
        api.call("reset_fault", wait_s=PATIENCE_S)
        after = until_state(api, "ready")
        return {
            "before": before["state"], "fault": status["fault"], "text": text, "during": during, "refused": refused,
            "drive": after["drive"]["state"], "connections": after["loop"]["connection"],
        }  # fmt: skip


def hang() -> dict[str, Any]:
    """The daemon is stopped in mid-run: the drive ends the motion by itself, the watchdog the daemon."""
    witness = EmergencyWitness()
    with client() as api:
        set_running(api)
    before = unit()
    os.kill(int(before["MainPID"]), signal.SIGSTOP)
    codes: list[int] = []
    until("an emergency message", lambda: codes.extend(witness.codes()) or any(codes))
    alive = unit()["MainPID"] == before["MainPID"]
    after = until_unit(NRestarts="1", ActiveState="active")
    with client() as api:
        status = until_state(api, "ready")
        _, said = run("journalctl", "--no-pager", "-o", "cat", "-u", UNIT, "_PID=1")
        return {
            "codes": codes, "drive_first": alive, "same_pid": before["MainPID"] == after["MainPID"], **after,
            "state": status["state"], "drive": status["drive"]["state"], "said": said,
        }  # fmt: skip


def remove_the_interface() -> dict[str, Any]:
    """In mid-run. The unit is bound to it."""
    with client() as api:
        set_running(api)
    run("ip", "link", "delete", INTERFACE)
    found = until_unit(ActiveState="inactive")
    return {**found, "sockets": sorted(path.name for path in SOCKETS.glob("*.sock"))}


def come_back_with_rubbish() -> dict[str, Any]:
    """The interface comes again, and with it the service; its file is not one."""
    AXIS.write_text("rubbish: [")
    run("ip", "link", "add", INTERFACE, "type", "vcan")
    found = until_unit(ActiveState="failed")
    time.sleep(SETTLING_S)
    return {**found, "later": unit()}


def start_without_rights() -> dict[str, Any]:
    """What the file requires of the system is refused: this machine has one processor."""
    shutil.copy(EXCHANGE / AXIS.name, AXIS)
    edit("cpu: last", "cpu: 7")
    code, _ = run("systemctl", "start", UNIT)
    found = unit()
    time.sleep(SETTLING_S)
    return {"code": code, **found, "later": unit()}


def uninstall() -> dict[str, Any]:
    """Everything away but what was edited."""
    code, said = run(PROGRAM, "install", "--uninstall", "--json")
    groups = [group.gr_name for group in grp.getgrall()]
    return {"code": code, "said": json.loads(said), "group": "fffo-drive" in groups}


STEPS = (
    install, start_with_the_interface, look_at_the_sandbox, look_at_the_sockets, find_the_drive, run_a_profile, reload,
    take_the_interface_down, hang, remove_the_interface, come_back_with_rubbish, start_without_rights, uninstall,
)  # fmt: skip


def main() -> int:
    """All steps."""
    failed = 0
    with (EXCHANGE / "rows").open("w", encoding="utf-8") as rows:
        for step in STEPS:
            begin_s = time.monotonic()
            try:
                found = step()
            except Exception:
                failed += 1
                found = {"error": traceback.format_exc()}
            line = {"step": step.__name__, "seconds": round(time.monotonic() - begin_s, 1), **found}
            print(json.dumps(line), file=rows, flush=True)
            print(f"{line['seconds']:6.1f} s  {step.__name__}{'  FAILED' if 'error' in found else ''}", flush=True)
    with (EXCHANGE / "journal").open("w", encoding="utf-8") as journal:
        subprocess.run(["journalctl", "--no-pager", "-o", "json", "-u", UNIT], stdout=journal, check=False)
    with (EXCHANGE / "journal.txt").open("w", encoding="utf-8") as journal:
        subprocess.run(["journalctl", "--no-pager"], stdout=journal, check=False)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
