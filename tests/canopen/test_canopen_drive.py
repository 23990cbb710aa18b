"""The drive beside a running loop: service traffic goes through the loop's slot, and comes back."""

import dataclasses
import os
import socket
import threading
from itertools import pairwise

import pytest
from scripted_node import ScriptedNode

from fffo_drive.can.frame import pack_frame, unpack_frame
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.drive.canopen.config import CanopenDriveConfig
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.canopen.service import SdoRefusedError
from fffo_drive.drive.port import (
    BusUnavailableError,
    Drive,
    DriveError,
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sync,
)

NODE = 5
CUTOFF_NS = 200_000


@pytest.fixture
def config():
    return CanopenDriveConfig(
        bus=f"loopback:{free_loopback_port()}",
        node_id=NODE,
        listen_s=0.02,
        period_ns=50_000_000,  # the loop counts as running for twenty of these after its last sign
        command_timeout_ms=100,
        counts_per_rev=32768,
        velocity_units_per_rps=1000.0,
        torque_constant_nm_per_a=0.1,
        rated_torque_nm=1.0,
        answer_timeout_s=2.0,
    )


class Ticking:
    """The loop's calls in a thread, as fast as they go, until the block ends."""

    def __init__(self, port):
        self.port, self.ticks = port, 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self):
        while not self._stop.is_set():
            port_sync(self.port, self.ticks)
            port_receive(self.port, self.ticks, port_now_ns(self.port) + CUTOFF_NS)
            port_command(self.port, self.ticks, 0x0006, 0.0)
            port_housekeeping(self.port, self.ticks, False)
            self.ticks += 1

    def __enter__(self):
        port_sync(self.port, 0)  # compiled, and seen, before the thread begins
        port_receive(self.port, 0, 0)
        port_command(self.port, 0, 0, 0.0)
        port_housekeeping(self.port, 0, False)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join(5.0)


def frames(link):
    heard = []
    while (raw := link.receive(0.0)) is not None:
        heard.append(unpack_frame(raw))
    return heard


def test_it_is_a_drive(config):
    drive: Drive = CanopenDrive(config)
    assert drive.realtime
    for use in (lambda: drive.port, lambda: drive.feedback, lambda: drive.read_object(0x6041, 0)):
        with pytest.raises(DriveError, match="not connected"):
            use()


def test_connect_comes_once(config):
    with ScriptedNode(config.bus, NODE), CanopenDrive(config) as drive, pytest.raises(DriveError, match="twice"):
        drive.connect()


def test_objects_before_during_and_after_the_loop(config):
    with ScriptedNode(config.bus, NODE), CanopenDrive(config) as drive:
        assert drive.read_object(0x1008, 0) == b"a drive with a long name"
        with Ticking(drive.port) as loop, open_link(config.bus) as witness:
            assert drive.read_object(0x1008, 0) == b"a drive with a long name"
            with pytest.raises(SdoRefusedError, match=r"0x2000:00.*0x06020000"):
                drive.read_object(0x2000, 0)
            heard = frames(witness)
        assert loop.ticks > 0
        # a service frame stands only between a command and the next SYNC
        ours = [frame.can_id for frame in heard if frame.can_id != 0x585]
        assert all(before == 0x205 for before, can_id in pairwise(ours) if can_id == 0x605)
        assert [frame.can_id for frame in heard].count(0x605) >= 6


def test_threads_share_the_one_client(config):
    failures = []

    def read(drive, index, sub, expected):
        failures.extend(index for _ in range(20) if drive.read_object(index, sub) != expected)

    with ScriptedNode(config.bus, NODE), CanopenDrive(config) as drive:
        wanted = [(0x1018, 1, b"\x11\0\0\0"), (0x1018, 4, b"\x44\0\0\0"), (0x1008, 0, b"a drive with a long name")]
        threads = [threading.Thread(target=read, args=(drive, *item)) for item in wanted]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert not failures


def test_emergencies_are_kept_with_their_vendor_bytes(config):
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config) as drive:
        node.send(0x085, b"\x30\x81\x11vendr", extended=True)  # of somebody else
        node.send(0x085, b"\x10")  # too short
        node.send(0x085, b"\x30\x81\x11vendr")
        drive.read_object(0x1000, 0)  # arrives behind them
        (emergency,) = drive.emergencies
        assert emergency[1:] == (0x8130, 0x11, b"vendr")


def test_a_silent_drive_is_unavailable_and_recovers(config):
    config = dataclasses.replace(config, answer_timeout_s=0.05)
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config) as drive:
        node.mute = True
        with pytest.raises(BusUnavailableError, match=r"asked to read 0x6041:00 \(3 times"):
            drive.read_object(0x6041, 0)
        node.mute = False
        assert drive.read_object(0x6041, 0) == b"\x40\0"


def test_lost_frames_show_in_the_feedback(config):
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config) as drive:
        assert drive.feedback["dropped_frames"][0] == 0
        with socket.socket(fileno=os.dup(drive.port.rx_fd)) as handle:
            handle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for _ in range(100):
            node.link.send(pack_frame(0x185, bytes(8)))
        port_sync(drive.port, 0)
        late = int(drive.feedback["late_feedback"][0])
        assert 0 < late < 100
        # the answers of the bring-up and of the NMT start passed through the same queue and were not lost
        assert drive.feedback["dropped_frames"][0] == 100 - late
