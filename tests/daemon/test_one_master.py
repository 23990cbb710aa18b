"""Two masters and one bus: the second refuses with the reason and sends nothing, the first does not notice."""

from __future__ import annotations

import itertools
import threading

import pytest
from buses import BusLog
from daemon.rig import Rig
from daemon.test_faults import running

from fffo_drive.can import lease
from fffo_drive.can.frame import NMT, SDO_REQUEST, SYNC, pack_frame, unpack_frame
from fffo_drive.can.link import open_link
from fffo_drive.cli import main

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]

NODE = 1
REASON = "one bus has one master, and several axes on one bus under one SYNC are not built yet"


@pytest.fixture(params=["on this machine", "on another"])
def another_machine(request, monkeypatch):
    """Whether the second is on another machine: the lease of the bus is not seen there."""
    if request.param == "on another":
        numbers = itertools.count()
        monkeypatch.setattr(lease, "_name", lambda bus: f"test/{next(numbers)}/{bus}")
    return request.param == "on another"


class Wire:
    """All that was sent on the bus of a service, beside the number of SYNCs that it sent itself."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig

    def _ticks(self) -> int:
        return self._rig.do(lambda: self._rig.supervisor.connection.head)

    def _asked(self) -> int:
        return self._rig.do(lambda: self._rig.supervisor.connection.drive._service._requests)

    def __enter__(self) -> None:
        self._before, self._asked_before = self._ticks(), self._asked()
        self._log = BusLog(self._rig.bus)
        self._log.__enter__()

    def __exit__(self, *_: object) -> None:
        self._log.__exit__()
        ticks = self._ticks() - self._before
        heard = [unpack_frame(frame.raw).can_id for frame in self._log.frames]
        assert 0 < heard.count(SYNC) <= ticks + 1
        assert NMT not in heard
        asked = self._asked() - self._asked_before  # it reads its settings again; one may have waited for its turn
        assert heard.count(SDO_REQUEST + NODE) <= asked + 1


FOREIGN = {
    "SYNC (0x080)": pack_frame(SYNC),
    "NMT commands (0x000)": pack_frame(NMT, bytes([0x80, NODE + 1])),
    "SDO requests to node 1 (0x601)": pack_frame(SDO_REQUEST + NODE, bytes([0x40, 0, 0x10, 0, 0, 0, 0, 0])),
    "the heartbeat of node 127 (0x77F), which is ours": pack_frame(0x77F, b"\x05"),
    "commands to node 1 (RPDO 0x201)": pack_frame(0x201, bytes(4)),
}


def somebody_sends(rig: Rig, raw: bytes) -> None:
    """Once."""
    with open_link(rig.bus) as link:
        link.send(raw)


@pytest.mark.parametrize("moving", [False, True])
def test_a_second_service_refuses_and_leaves_the_first_alone(tmp_path, another_machine, moving):
    with Rig(tmp_path / "first") as first:
        client = running(first) if moving else first.client()
        first.until("running" if moving else "ready", client)
        second = Rig(tmp_path / "second", drive=False)
        second.bus = first.bus
        with Wire(first), second:
            status = second.until_status(lambda s: REASON in str(s["obstacles"]))
            words = "somebody else commands here: SYNC (0x080)" if another_machine else "on this machine commands there"
            assert words in status["obstacles"][0]
            for _ in range(3):  # it tries again and again
                rows = client.call("status")["loop"]["rows"]
                first.until_status(lambda s, rows=rows: s["loop"]["rows"] > rows + 100, client)
                assert second.client().call("status")["state"] == "offline"
        status = client.call("status")
        assert status["fault"] is None
        assert status["loop"]["exchange"]["foreign_frames"] == 0
        assert status["state"] == ("running" if moving else "ready")


def test_a_second_service_connects_by_itself_once_the_first_is_gone(tmp_path, another_machine):
    second = Rig(tmp_path / "second", drive=False)
    with Rig(tmp_path / "first") as first:
        first.until("ready")
        second.bus = first.bus
        second.__enter__()
        second.until_status(lambda s: REASON in str(s["obstacles"]))
        first.node, node = None, first.node
    assert node is not None
    try:
        second.until("ready")
    finally:
        second.__exit__()
        node.__exit__()


def test_the_commands_name_it_too(tmp_path, capsys, another_machine):
    with Rig(tmp_path) as rig:
        rig.until("ready")
        axis, out = [str(rig.path), "--bus", rig.bus], ["--out", str(tmp_path / "out")]
        with Wire(rig):
            for command in (["run", *axis, *out, "--uncommissioned"], ["commission", *axis, *out, "--yes"]):
                assert main(command) == 69
                assert REASON in capsys.readouterr().err
            main(["doctor", *axis, "--seconds", "0"])
        (line,) = [line for line in capsys.readouterr().out.splitlines() if " bus master " in line]
        if another_machine:
            assert line.startswith("failure")
            assert "somebody else commands here: SYNC (0x080)" in line
        else:
            assert line.startswith("warning")
            assert "on this machine commands on" in line


@pytest.mark.parametrize("what", FOREIGN)
def test_a_frame_of_another_at_rest_is_no_ready_axis_and_in_motion_a_fault(tmp_path, what):
    """Once is enough; without torque the service leaves the drive and comes back, with torque the fault latches."""
    with Rig(tmp_path) as rig:
        rig.until("ready")
        somebody_sends(rig, FOREIGN[what])
        rig.until_status(lambda s: s["state"] == "ready" and s["loop"]["connection"] == 2)
        assert "somebody else sends what only this program may send" in str(rig.events("state"))
        client = running(rig)
        somebody_sends(rig, FOREIGN[what])
        status = rig.until("fault", client)
        assert status["fault"]["name"] == "foreign_command"
        assert f"{what}" in status["fault"]["text"]
        assert "from somebody else" in status["fault"]["text"]
        client.call("reset_fault")
        rig.until("ready", client)


def test_feedback_of_another_is_an_event_at_the_first_and_a_fault_when_it_goes_on(tmp_path):
    stands_still = pack_frame(0x181, bytes(8))
    with Rig(tmp_path) as rig:
        client = running(rig)
        somebody_sends(rig, stands_still)
        status = rig.until_status(lambda s: s["loop"]["exchange"]["duplicate_feedback"], client)
        assert status["fault"] is None
        told = "feedback of node 1 (TPDO 0x181) twice after one SYNC"
        rig.until_status(lambda s: told in str(rig.events("drive")), client)
        stop = threading.Event()
        thread = threading.Thread(target=lambda: [somebody_sends(rig, stands_still) for _ in iter(stop.is_set, True)])
        thread.start()
        try:
            status = rig.until("fault", client)
        finally:
            stop.set()
            thread.join()
        assert status["fault"]["name"] == "foreign_command"
        assert "feedback of node 1 (TPDO 0x181) from somebody else" in status["fault"]["text"]
