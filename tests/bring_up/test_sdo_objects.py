"""Objects of a drive by SDO: read once, absent, refused, timed out."""

from __future__ import annotations

import pytest
from paper_drive import SILENT, Paper, u32

from fffo_drive.drive.canopen.sdo_objects import CHANGING, MOST_TIMEOUTS, WANTED, SdoObjects
from fffo_drive.drive.port import BusUnavailableError

DENIED, WRITE_ONLY, EMPTY = 0x08000020, 0x06010001, 0x08000024


def test_an_object_is_read_once():
    paper = Paper({(0x6041, 0): b"\x50\x02"})
    objects = SdoObjects(paper.read)
    assert [objects.value(0x6041), objects.value(0x6041), objects.has(0x6041)] == [0x0250, 0x0250, True]
    assert paper.asked == [(0x6041, 0)]


def test_absent_refused_and_empty_are_three_things():
    objects = SdoObjects(Paper({(0x2000, 0): DENIED, (0x2001, 0): WRITE_ONLY, (0x1003, 1): EMPTY}).read)
    assert (objects.has(0x6076), objects.value(0x6076)) == (False, None)
    assert (objects.has(0x2000), objects.value(0x2000)) == (True, None)
    assert (objects.has(0x2001), objects.value(0x1003, 1)) == (True, None)
    assert objects.unreadable == {"0x2000:00": "abort 0x08000020", "0x2001:00": "abort 0x06010001"}


def test_one_timeout_is_reported_and_several_in_a_row_mean_that_the_drive_is_gone():
    objects = SdoObjects(Paper({(0x2000, 0): SILENT, (0x2001, 0): u32(1), (0x2002, 0): SILENT}).read)
    assert [objects.value(index) for index in (0x2000, 0x2001, 0x2002)] == [None, 1, None]
    assert objects.unreadable == {"0x2000:00": "no answer", "0x2002:00": "no answer"}
    gone = SdoObjects(Paper(dict.fromkeys(WANTED, SILENT)).read)
    with pytest.raises(BusUnavailableError):
        gone.read_all()
    assert len(gone.unreadable) == MOST_TIMEOUTS - 1


def test_what_changes_is_read_again_and_an_old_value_stays_where_there_is_no_new_one():
    objects = SdoObjects(Paper({(0x6041, 0): b"\x40\0", (0x6079, 0): u32(1), (0x1000, 0): u32(402)}).read)
    shares = []
    objects.read_all(shares.append)
    assert shares[-1] == 1.0
    later = Paper({(0x6041, 0): b"\x50\x02", (0x6079, 0): u32(48_000)})
    objects.read_again(later.read)
    assert (objects.value(0x6041), objects.value(0x6079), objects.value(0x1000)) == (0x0250, 48_000, 402)
    assert {index for index, _ in later.asked} <= set(CHANGING)
    silent = SdoObjects(Paper({(0x6041, 0): b"\x40\0"}).read)
    silent.read_all()
    silent.read_again(Paper(dict.fromkeys(WANTED, SILENT)).read)
    assert silent.value(0x6041) == 0x40


def test_nothing_is_read_from_a_drive_after_its_connection_was_closed():
    paper = Paper({(0x6041, 0): b"\x40\0", (0x6087, 0): u32(5)})
    objects = SdoObjects(paper.read)
    objects.read_all()
    objects.stop_reading()
    before = len(paper.asked)
    assert (objects.value(0x6041), objects.has(0x6087)) == (0x40, False)
    assert len(paper.asked) == before
    assert objects.values == {"0x6041:00": 0x40}
