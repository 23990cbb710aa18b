"""Files whose disk does not answer, in a running daemon: FIFOs that nobody opens at their other end."""

from __future__ import annotations

import contextlib
import itertools
import os
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from daemon.rig import Rig, axis_file, edit

from fffo_drive.can.lease import BusLease
from fffo_drive.can.link import LinkError
from fffo_drive.cli import main
from fffo_drive.daemon import record_keeper
from fffo_drive.daemon import worker as workers
from fffo_drive.daemon.client import CallError
from fffo_drive.daemon.rpc import BAD_DOCUMENT
from fffo_drive.recording import run_files
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.settings import RecorderHooks

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]

PATIENCE_S = 0.5
KEY = "controller.proportional_a_per_rps"


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(workers, "DISK_PATIENCE_S", PATIENCE_S)


class Hanging:
    """A FIFO in the place of a file, until it is mended."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._content = path.read_bytes() if path.exists() else None
        path.unlink(missing_ok=True)
        os.mkfifo(path)

    def mend(self) -> None:
        """The file is there again; who waits in the FIFO goes on waiting."""
        self._aside = self.path.with_name("aside")
        self.path.rename(self._aside)
        if self._content is not None:
            self.path.write_bytes(self._content)

    def answer_late(self, text: bytes) -> None:
        """Who waits in the FIFO reads this."""
        with self._aside.open("wb") as file:
            file.write(text)

    def let_go(self) -> None:
        """Nobody is left behind."""
        for path in (self.path, self.path.with_name("aside")):
            with contextlib.suppress(OSError):
                for _ in range(workers.MOST_HUNG):
                    os.close(os.open(path, os.O_RDWR | os.O_NONBLOCK))


def silent(call, path: Path) -> None:
    with pytest.raises(CallError) as error:
        call()
    assert error.value.code == BAD_DOCUMENT
    assert "the disk does not answer" in str(error.value)
    assert str(path) in str(error.value)


@pytest.mark.parametrize("which", ["axis.yaml", "model.yaml"])
def test_row_file_hangs(tmp_path, which):
    """While it hangs and after it everything else goes on, and what comes late is never applied."""
    with Rig(tmp_path) as rig:
        client = rig.client()
        rig.until("ready", client)
        path = rig.path.with_name(which)
        hanging = Hanging(path)
        silent(lambda: client.call("reload"), path)
        status = client.call("status")
        assert str(path) in status["disk"]
        assert client.call("toggle", to="off") == {"toggle": "off"}
        assert client.call("set", key=KEY, value=0.9)["value"] == 0.9
        text = (Path(__file__).parents[1] / "bad_input/files/model.yaml").read_text().replace("table1", "other")
        assert client.call("model", text=text, name="m.yaml")["name"] == "other"
        assert client.call("record", to="on")["on"]
        assert client.call("enable")["state"] == "enabled"
        client.call("start", profile={"kind": "points", "points": [[0, 0], [0.2, 1], [0.4, 0]]}, wait_s=30)
        client.call("start", profile="default")
        silent(lambda: client.call("reload"), path)
        assert client.call("stop")["state"] == "enabled"
        (file,) = client.call("record", to="off")["files"]
        assert client.call("disable")["state"] == "ready"
        hanging.mend()
        edit(rig.path, lambda axis: axis["controller"].update(proportional_a_per_rps=0.8))
        assert "controller" in client.call("reload")["applied"]
        assert client.call("status")["disk"] is None
        hanging.answer_late(b"rubbish: [")  # is never applied
        assert client.call("info")["keys"][KEY] == 0.8
        events = [event["text"] for event in rig.events("files")]
        assert len([text for text in events if "the disk does not answer" in text]) == 2
        assert events[-1] == "the disk answers again"
        hanging.let_go()
    assert read_run(file).complete


def test_a_broken_model_is_refused_with_its_reasons_while_the_axis_file_hangs(tmp_path):
    """The reasons have the lines of the axis file: these are of the text that was read."""
    with Rig(tmp_path, drive=False, retry_s=600) as rig:
        client = rig.client()
        hanging = Hanging(rig.path)
        text = rig.path.with_name("model.yaml").read_text()
        model = yaml.safe_load(text)
        model["inertia_kg_m2"]["value"] *= 300.0
        with pytest.raises(CallError, match=r"axis\.yaml:\d+: "):
            client.call("model", text=yaml.safe_dump(model), name="m.yaml")
        assert client.call("toggle", to="off") == {"toggle": "off"}
        hanging.let_go()


def test_a_commissioning_record_that_hangs_keeps_the_drive_away_and_nothing_else(tmp_path):
    with Rig(tmp_path, uncommissioned=False, retry_s=0.05) as rig:
        client = rig.client()
        rig.until("connected", client)
        record = rig.path.with_name("record.yaml")
        hanging = Hanging(record)
        edit(rig.path, lambda axis: axis.update(commissioning="record.yaml"))
        rig.do(lambda: setattr(rig.supervisor, "plan", plan_with(rig, "record.yaml")))
        silent(lambda: client.call("reload"), record)
        assert client.call("toggle", to="off") == {"toggle": "off"}
        rig.node.__exit__()
        status = rig.until("offline", client)
        rig.node = rig.new_node()
        rig.node.__enter__()
        status = rig.until_status(lambda s: s["obstacles"] and str(record) in s["obstacles"][0], client)
        assert status["state"] == "offline"
        hanging.mend()  # it is not there now: an answer, too
        client.call("reload")
        rig.until("connected", client)
        hanging.let_go()


def said(client, text: str) -> bool:
    """Whether an event has this text."""
    return any(text in event["text"] for event in client.call("events", limit=1000)["events"])


def plan_with(rig: Rig, record: str):
    """The plan as if the axis file had named this record from the start."""
    plan = rig.supervisor.plan
    return plan._replace(axis=plan.axis.model_copy(update={"commissioning": record}))


def test_a_recording_whose_disk_hangs_is_answered_and_another_one_begins(tmp_path, monkeypatch):
    with Rig(tmp_path) as rig:
        client = rig.client()
        rig.until("ready", client)
        keeper = rig.supervisor.recorder
        names = itertools.count()  # two begin in the same second here, as none would after 5 s
        monkeypatch.setattr(record_keeper, "timestamp_name", lambda axis, now_ns: f"{axis}_{next(names)}")
        real, disk = keeper.hooks.opener, SimpleNamespace(fifo=tmp_path / "hangs")
        os.mkfifo(disk.fifo)
        monkeypatch.setattr(
            keeper, "hooks", RecorderHooks(opener=lambda path: (disk.fifo.open("wb").close(), real(path))[1])
        )
        silent(lambda: client.call("record", to="on"), disk.fifo)
        status = client.call("status")
        assert not status["recording"]["on"]
        assert "the disk does not answer" in status["recording"]["trouble"]
        assert client.call("record", to="off")["on"] is False
        assert client.call("enable")["state"] == "enabled"
        monkeypatch.setattr(keeper, "hooks", RecorderHooks(opener=real))
        first = client.call("record", to="on")["file"]
        client.call("start", profile={"kind": "points", "points": [[0, 0], [0.2, 1], [0.4, 0]]}, wait_s=30)
        with disk.fifo.open("rb"):  # the first one goes on, too late
            rig.until_status(lambda s: said(client, "opened too late"), client)
        assert client.call("status")["recording"]["file"].removesuffix(".part") == first.removesuffix(".part")
        (file,) = client.call("record", to="off")["files"]
    assert read_run(file).complete
    assert len(read_run(file).rows) > 100


def test_row_recording_hangs(tmp_path, monkeypatch):
    go_on, hangs = threading.Event(), threading.Event()
    real = run_files.RunFiles.keep_house

    def house(self, now_ns):
        if hangs.is_set():
            go_on.wait(60.0)
        real(self, now_ns)

    monkeypatch.setattr(run_files.RunFiles, "keep_house", house)
    with Rig(tmp_path, record_required=True) as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("record", to="on")
        client.call("enable")
        hangs.set()
        status = rig.until("connected", client)
        assert "the disk does not answer: writing" in status["obstacles"][0]
        assert "the disk does not answer: writing" in status["disk"]
        file = status["recording"]["file"]
        silent(lambda: client.call("record", to="off"), file)
        assert client.call("toggle", to="off") == {"toggle": "off"}
        hangs.clear()
        assert client.call("record", to="on")["file"] != file
        rig.until("ready", client)
        go_on.set()  # the first one is finished late
        rig.until_status(lambda s: said(client, f"recorded {file.removesuffix('.part')}"), client)
        client.call("record", to="off")


def test_a_service_whose_axis_file_does_not_come_says_so(tmp_path):
    path = axis_file(tmp_path / "axis")
    path.unlink()
    os.mkfifo(path)
    code = (
        "import sys; from fffo_drive.daemon import worker; worker.DISK_PATIENCE_S = 0.5\n"
        "from fffo_drive.cli import main; sys.exit(main(['serve', sys.argv[1]]))"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 74
    assert done.stderr == f"fffo-drive serve: the disk does not answer: reading {path} takes longer than 0.5 s\n"


def test_row_sockets_gone(tmp_path):
    with Rig(tmp_path, drive=False, retry_s=600) as rig:
        client = rig.client()
        for way in ("files", "directory", "another"):
            for path in sorted(rig.sockets.iterdir()):
                path.unlink()
            if way == "directory":
                rig.sockets.rmdir()
            elif way == "another":
                (rig.sockets / "control.sock").mkdir()  # in the way
                rig.until_status(lambda s: said(client, "cannot be made anew"), client)
                (rig.sockets / "control.sock").rmdir()
            rig.until_status(
                lambda s: all((rig.sockets / name).is_socket() for name in ("control.sock", "watch.sock")), client
            )
            assert rig.client().call("status")["state"] == "offline"
            assert rig.client(watching=True).call("status")["state"] == "offline"
            modes = {path.name: path.stat().st_mode & 0o777 for path in rig.sockets.iterdir()}
            assert modes == {"control.sock": 0o660, "watch.sock": 0o666}
            assert client.call("toggle", to="off") == {"toggle": "off"}
        texts = [event["text"] for event in rig.events("files")]
        assert len([text for text in texts if text.endswith("was gone: made anew")]) == 6
    assert not list(rig.sockets.iterdir())


def test_who_finds_no_daemon_is_told_who_commands_on_a_bus(tmp_path, monkeypatch, capsys):
    bus = "loopback:12345"
    lease = BusLease(bus)
    own = f"process {os.getpid()} ("
    word = Path(Path("/proc/self/cmdline").read_text().split("\0")[1]).name  # of this process, behind the interpreter
    try:
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
        for place in ([], ["--sockets", str(tmp_path)]):
            assert main(["ctl", *place, "status"]) == 69
            said = capsys.readouterr().err
            assert f"on {bus} commands {own}" in said
            assert f"{own}{word}" in said
        with pytest.raises(LinkError) as error:
            BusLease(bus)
        assert f"{own}{word}" in str(error.value)
    finally:
        lease.close()
