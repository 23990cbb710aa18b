"""A bus that fails in mid-run, and one that is not there: what the loop sends then, and that it works again."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest
from buses import SOCKETCAN, as_text
from needs import VCAN
from uml.whole_run import Participants, WholeRun, axis_file, record, wait_for_trip

from fffo_drive.can.frame import ERROR_BUS_OFF, ERROR_RESTARTED, pack_frame
from fffo_drive.can.link import open_link
from fffo_drive.control.envelope import TRIP_BUS_OFF, TRIP_NONE
from fffo_drive.drive.cia402 import CONTROL_QUICK_STOP
from fffo_drive.drive.port import BusUnavailableError
from fffo_drive.workflows.plan import make_plan, open_drive

pytestmark = [pytest.mark.slow, pytest.mark.realtime]
only_vcan = pytest.mark.parametrize("drive_bus", [pytest.param("vcan", marks=pytest.mark.vcan)], indirect=True)

RUN_S = 0.1
BUS_OFF = as_text(pack_frame(ERROR_BUS_OFF, bytes(8), error=True))
RESTARTED = as_text(pack_frame(ERROR_RESTARTED, bytes(8), error=True))
EMCY_BUS_OFF_RECOVERED = "081#4081"


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


def commands_with_torque(texts: list[str]) -> list[str]:
    return [text for text in texts if text.startswith("201#") and not text.endswith("0000")]


def assert_stopped(whole: WholeRun) -> None:
    """The loop tripped, and from that row on commanded nothing."""
    rows = whole.run.rows
    tripped = np.flatnonzero(rows["trip"] != TRIP_NONE)
    assert tripped.size
    assert np.abs(rows["current_command_a"][: tripped[0]]).max() > 0
    assert (rows["current_command_a"][tripped[0] :] == 0).all()


def assert_works_again(bus, directory) -> None:
    again = record(bus, directory, RUN_S)
    assert again.outcome.fault_text is None
    assert again.run.complete


def test_bus_off_stops_the_axis_and_is_left_again(drive_bus, tmp_path):
    def bus_off(host: Participants) -> None:
        with open_link(drive_bus) as controller:  # its reports come as frames, as from a driver
            controller.send(pack_frame(ERROR_BUS_OFF, bytes(8), error=True))
            wait_for_trip(host.session)
            controller.send(pack_frame(ERROR_RESTARTED, bytes(8), error=True))

    whole = record(drive_bus, tmp_path / "off", 2 * RUN_S, bus_off)
    assert_stopped(whole)
    assert whole.outcome.exchange.bus_losses == 1
    assert whole.outcome.exchange.error_frames == 2
    texts = whole.texts()
    off, restarted = texts.index(BUS_OFF), texts.index(RESTARTED)
    assert len(commands_with_torque(texts[off:])) <= 1  # the one that was under way
    assert any(text.startswith(EMCY_BUS_OFF_RECOVERED) for text in texts[restarted:])
    assert_works_again(drive_bus, tmp_path / "again")


@only_vcan
def test_an_interface_that_goes_down_in_mid_run_stops_the_axis(drive_bus, tmp_path):
    heard = []

    def down_and_up(host: Participants) -> None:
        ip("link", "set", VCAN, "down")
        wait_for_trip(host.session)
        heard.append(len(host.log.frames))
        ip("link", "set", VCAN, "up")

    whole = record(drive_bus, tmp_path / "down", 2 * RUN_S, down_and_up)
    assert whole.outcome.trip == TRIP_BUS_OFF
    assert_stopped(whole)
    assert whole.outcome.exchange.bus_losses == 1
    assert whole.outcome.exchange.send_errors > 0
    after = [text for text in whole.texts(heard[0]) if text.startswith(("201#", "080#"))]
    assert not commands_with_torque(after)
    # what the drive still holds from before must not act: a command without torque goes in front of SYNC
    assert after[0] == f"201#{CONTROL_QUICK_STOP.to_bytes(2, 'little').hex().upper()}0000"
    assert_works_again(drive_bus, tmp_path / "again")


@only_vcan
def test_a_bus_that_is_not_there_is_refused_with_the_command_that_helps(drive_bus, tmp_path):
    plan = make_plan(axis_file(tmp_path, RUN_S))
    with pytest.raises(BusUnavailableError, match="ip link add vcan9 type vcan"):
        open_drive(plan, "socketcan:vcan9").connect()
    ip("link", "set", VCAN, "down")
    try:
        with pytest.raises(BusUnavailableError, match=f"the interface is down or gone: ip link set {VCAN} up"):
            open_drive(plan, SOCKETCAN).connect()
    finally:
        ip("link", "set", VCAN, "up")
    assert_works_again(drive_bus, tmp_path / "again")
