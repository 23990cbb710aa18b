"""Rows of the fault table that concern the daemon around the loop: each lived through on a bus, in real time."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from dataclasses import replace

import pytest
from buses import BusLog
from daemon import test_hanging_files
from daemon.fault_table import ROWS
from daemon.rig import PATIENCE_S, Rig
from recording.samples import Disk

from fffo_drive.can.frame import SYNC, pack_frame, unpack_frame
from fffo_drive.can.link import open_link
from fffo_drive.daemon.client import CallError
from fffo_drive.daemon.places import CONTROL, WATCH
from fffo_drive.drive.simulated.node.faults import Fault, FaultKind
from fffo_drive.recording.reader import read_run

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]


def running(rig: Rig):
    """A client, once a profile runs."""
    client = rig.client()
    rig.until("ready", client)
    client.call("enable")
    client.act("start", profile="default")
    return client


def goes_on(rig: Rig, client) -> None:
    """The profile still runs, and the loop goes on with it."""
    sample = client.call("status")["profile"]["sample"]
    status = rig.until_status(lambda s: s["profile"] is None or s["profile"]["sample"] > sample + 100, client)
    assert status["state"] == "running"
    assert status["fault"] is None


def test_every_row_without_a_script_has_its_test():
    scripts = {*globals(), *vars(test_hanging_files)}
    assert {f"test_row_{row.name}" for row in ROWS if row.script is None} <= scripts


def test_row_sdo_timeout(tmp_path):
    deaf = Fault(FaultKind.DROP_SENT, can_id=0x581)
    with Rig(tmp_path, faults=(deaf,)) as rig:
        client = rig.client()
        status = rig.until_status(lambda s: "does not answer" in str(s["obstacles"]), client)
        assert status["state"] == "offline"
        with pytest.raises(CallError, match="offline"):
            client.call("enable")
        assert rig.node is not None
        rig.node.tell(lambda node: node.faults.clear())
        rig.until("ready", client)  # it was tried again
        assert len([event for event in rig.events("drive") if "no drive" in event["text"]]) == 1
    assert rig.node.provocations() == []


def test_row_another_master(tmp_path):
    stop = threading.Event()
    rig = Rig(tmp_path)

    def master() -> None:
        with open_link(rig.bus) as link:
            while not stop.wait(0.01):
                link.send(pack_frame(SYNC))

    thread = threading.Thread(target=master)
    thread.start()
    try:
        with rig:
            client = rig.client()
            with BusLog(rig.bus) as log:
                status = rig.until_status(lambda s: "SYNC (0x080)" in str(s["obstacles"]), client)
                assert status["state"] == "offline"
                with pytest.raises(CallError, match="offline"):
                    client.call("enable")
            assert {unpack_frame(frame.raw).can_id for frame in log.frames} <= {SYNC, 0x181, 0x281, 0x381, 0x701}
            stop.set()
            rig.until("ready", client)  # it was tried again
            assert len([event for event in rig.events("drive") if "no drive" in event["text"]]) == 1
    finally:
        stop.set()
        thread.join()


@pytest.mark.parametrize(
    ("where", "value", "words"),
    [
        ((0x1016, 1), 0, "0x1016:01 is 0 (0x00000000), but was told"),
        (
            (0x6007, 0),
            0,
            "0x6007:00 is 0 (0x0000), but was told 3 (0x0003), needed for the drive to stop when the PC is silent",
        ),
        ((0x1800, 2), 2, "0x1800:02 is 2 (0x02), but was told 1 (0x01), needed for the transmission type of TPDO1"),
    ],
)
def test_row_settings_changed(tmp_path, where, value, words):
    """In motion a fault that names object and values; at rest the service writes it again by itself."""
    with Rig(tmp_path) as rig:
        client = running(rig)
        rig.node.tell(lambda node: node.od.put(*where, value))
        status = rig.until("fault", client)
        assert status["fault"]["name"] == "settings_changed"
        assert words in status["fault"]["text"]
        client.call("reset_fault")
        rig.until("ready", client)
        connection = client.call("status")["loop"]["connection"]
        rig.node.tell(lambda node: node.od.put(*where, value))
        rig.until_status(lambda s: s["state"] == "ready" and s["loop"]["connection"] > connection, client)
        assert words in str(rig.events("state"))


@pytest.mark.parametrize(("loss", "state"), [("stop", "ready"), ("quick_stop", "ready"), ("go_on", "running")])
def test_row_holder_gone(tmp_path, loss, state):
    with Rig(tmp_path, client_loss=loss) as rig:
        watcher, holder = rig.client(), rig.client()
        rig.until("ready", watcher)
        holder.call("enable", hold=True)
        holder.act("start", profile="default")
        holder.close()
        rig.until_status(lambda s: s["state"] == state and s["held_by"] is None, watcher)
        assert ("is gone" in str(rig.events("client"))) == (loss != "go_on")


class Dies:
    """What no handler of the recorder's catches, once."""

    def __init__(self) -> None:
        self.left = 1

    def __call__(self, rows: object) -> None:
        self.left -= 1
        if self.left == 0:
            raise SystemExit


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")  # it is made to die
def test_row_recorder_dead(tmp_path):
    with Rig(tmp_path) as rig:
        rig.do(
            lambda: setattr(rig.supervisor.recorder, "hooks", replace(rig.supervisor.recorder.hooks, on_rows=Dies()))
        )
        client = running(rig)
        client.call("record", to="on")
        rig.until_status(lambda s: "thread has ended" in s["recording"]["trouble"], client)
        goes_on(rig, client)
        (event,) = [event for event in rig.events("recording") if "thread has ended" in event["text"]]
        assert event["level"] == "error"
        (file,) = client.call("record", to="off")["files"]
    assert read_run(file).complete  # what it left behind is finished


def fill_the_disk(rig: Rig, disk: Disk) -> None:
    keeper = rig.supervisor.recorder
    rig.do(lambda: setattr(keeper, "hooks", replace(keeper.hooks, opener=disk)))


def test_row_disk_full(tmp_path):
    disk = Disk(200_000)
    with Rig(tmp_path) as rig:
        fill_the_disk(rig, disk)
        client = running(rig)
        client.call("record", to="on")
        disk.room = 0
        rig.until_status(lambda s: s["recording"]["trouble"], client)
        goes_on(rig, client)
        disk.room = None
        client.call("record", to="off")
        client.call("record", to="on")  # a new one works again
        goes_on(rig, client)
        (file,) = client.call("record", to="off")["files"]
        assert "missing" in str(rig.events("recording"))
    assert len(read_run(file).rows) > 0


def test_row_record_required(tmp_path):
    disk = Disk(200_000)
    with Rig(tmp_path, record="on", record_required=True) as rig:
        fill_the_disk(rig, disk)
        client = running(rig)
        client.call("record", to="on")
        disk.room = 0
        status = rig.until_status(lambda status: status["state"] in ("ready", "connected"), client)  # it is an obstacle
        assert status["fault"] is None
        assert "record_required" in str(rig.events("recording"))


def test_row_api_flooded(tmp_path):
    line = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "status"}).encode() + b"\n"
    with Rig(tmp_path) as rig:
        client = running(rig)
        stop = threading.Event()

        def flood(number: int) -> None:
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock, contextlib.suppress(OSError):
                sock.connect(str(rig.sockets / (WATCH if number % 2 else CONTROL)))
                sock.settimeout(0.2)
                while not stop.is_set():
                    with contextlib.suppress(TimeoutError):
                        sock.sendall(line * 20 if number % 5 else b'{"rubbish": [\n' * 20)
                    with contextlib.suppress(TimeoutError):
                        sock.recv(1 << 16)

        threads = [threading.Thread(target=flood, args=(number,), daemon=True) for number in range(20)]
        for thread in threads:
            thread.start()
        try:
            for _ in range(3):
                goes_on(rig, client)
        finally:
            stop.set()
            for thread in threads:
                thread.join(PATIENCE_S)
        assert client.call("disable")["state"] == "ready"


def test_row_config_rubbish(tmp_path):
    with Rig(tmp_path) as rig:
        client = running(rig)
        for rubbish in ("{", "name: x", "", "\0\1"):
            rig.path.write_text(rubbish)
            with pytest.raises(CallError, match=r"axis\.yaml"):
                client.call("reload")
            goes_on(rig, client)
        rig.path.unlink()
        with pytest.raises(CallError, match=r"axis\.yaml"):
            client.call("reload")
        client.call("record", to="on")  # what a recording carries was read before
        goes_on(rig, client)
        (file,) = client.call("record", to="off")["files"]
    assert "sine" in read_run(file).attachments["axis.yaml"].data.decode()
