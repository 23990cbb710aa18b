"""What the drive was told is read again while the loop runs: a change is counted and named, a refusal is told."""

import dataclasses
import struct

import pytest
from scripted_node import NO_OBJECT, ScriptedNode
from test_canopen_drive import NODE, Ticking, config  # noqa: F401  a fixture

from fffo_drive.drive.canopen import settings_watch
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.canopen.service import Kept


@pytest.fixture
def at_once(monkeypatch):
    """Without pauses between two objects."""
    monkeypatch.setattr(settings_watch, "REREAD_S", 0.0)


def until(drive, condition):
    """Wait for what an answer of the drive brings about."""
    assert drive._service.wait_until(condition, 20.0)


def read_twice(drive):
    """Wait until each object has been read, and once more."""
    responses = drive._service._responses
    until(drive, lambda: drive._service._responses > responses + 2 * len(drive._service.kept))


def test_the_list_is_what_bring_up_has_written(config):  # noqa: F811
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config) as drive:
        kept = drive._service.kept
        assert {index for index, _ in kept} >= {0x1016, 0x1017, 0x1400, 0x1600, 0x1800, 0x1A00, 0x6007, 0x6061, 0x605A}
        assert {(index, sub) for index, sub, _ in node.written} - set(kept) == {(0x6060, 0), (0x6071, 0)}
        assert all(one.is_still(node.number(*where)) for where, one in kept.items())
        assert (0x6071, 0) not in kept  # it changes with every tick


def test_nothing_is_read_while_no_loop_runs_and_nothing_is_amiss_while_one_does(config, at_once):  # noqa: F811
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config) as drive:
        asked = len(node.heard)
        drive._service.wait_until(lambda: False, 0.1)
        assert len(node.heard) == asked
        with Ticking(drive.port):
            read_twice(drive)
        assert drive.feedback["settings_changed"][0] == drive.feedback["foreign_frames"][0] == 0
        assert drive.warnings() == []
        assert drive.fault_words(ask=False) == ""


@pytest.mark.parametrize(
    ("where", "value", "words"),
    [
        (
            (0x1016, 1),
            bytes(4),
            "0x1016:01 is 0 (0x00000000), but was told 8323222 (0x007F0096), needed for the drive "
            "to notice that the PC is silent",
        ),
        ((0x6061, 0), b"\x08", "0x6061:00 is 8 (0x08), but was told 10 (0x0A), needed for mode 10"),
        ((0x1600, 2), struct.pack("<I", 0x60FF0020), "0x1600:02 is 1627324448 (0x60FF0020)"),
        ((0x1800, 1), struct.pack("<I", 0x80000185), "0x1800:01 is 2147484037 (0x80000185)"),
        ((0x1400, 2), b"\xff", "0x1400:02 is 255 (0xFF), but was told 1 (0x01), needed for the transmission type of"),
    ],
)
def test_a_change_is_counted_once_and_says_object_and_both_values(config, at_once, where, value, words):  # noqa: F811
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config) as drive, Ticking(drive.port):
        node.objects[where] = value
        until(drive, lambda: drive.feedback["settings_changed"][0] > 0)
        read_twice(drive)
        assert drive.feedback["settings_changed"][0] == 1
        assert words in drive.fault_words(ask=False)


def test_bits_that_do_not_count_may_change(config, at_once):  # noqa: F811
    """Bit 30 of a COB-ID is the drive's own."""
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config) as drive, Ticking(drive.port):
        node.objects[0x1800, 1] = struct.pack("<I", 0x185)
        read_twice(drive)
        assert drive.feedback["settings_changed"][0] == 0


def test_an_object_that_can_no_longer_be_read_is_told_once_and_is_no_fault(config, at_once):  # noqa: F811
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config) as drive, Ticking(drive.port):
        del node.objects[0x6007, 0]
        read_twice(drive)
        (told,) = drive.warnings()
        assert told.startswith("0x6007:00 cannot be watched: node 5: cannot read 0x6007:00")
        assert f"{NO_OBJECT:08X}" in told
        read_twice(drive)
        assert drive.warnings() == []
        assert drive.feedback["settings_changed"][0] == 0


def test_a_drive_without_a_mode_display_is_watched_by_what_was_written(config):  # noqa: F811
    shy = dataclasses.replace(config, mode_display="not_checked")
    with ScriptedNode(config.bus, NODE), CanopenDrive(shy) as drive:
        assert drive._service.kept[0x6060, 0].is_still(10)
        assert isinstance(drive._service.kept[0x6060, 0], Kept)
        assert (0x6061, 0) not in drive._service.kept
