"""The index of a finished recording: the same answers as a look at every row, without reading them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from recording.samples import PERIOD_NS, WALL_NS, random_rows, same_bits

from fffo_drive.cli import main
from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.events import Event, Level
from fffo_drive.recording.reader import RowBlocks, TimeWindow, describe, read_run
from fffo_drive.recording.writer import RunWriter

ROWS = random_rows(400, seed=5)
FIRST_NS = WALL_NS + int(ROWS["deadline_ns"][0])
TRIP_S = 0.11


@pytest.fixture(scope="module", params=["zstd", "none"])
def sample(request, tmp_path_factory) -> Path:
    """Many chunks of rows, an event in one of the middle and one at the end."""
    path = tmp_path_factory.mktemp("index") / f"{request.param}.mcap"
    writer = RunWriter(
        path, {"axis": "bench"}, [("a", "text/plain", b"A" * 300)], WALL_NS, chunk_size=6000, compression=request.param
    )
    for begin in range(0, len(ROWS), 20):
        writer.write_rows(ROWS[begin : begin + 20])
        if begin == 220:
            writer.write_event(Event(FIRST_NS + round(TRIP_S * 1e9), Level.ERROR, "loop", "trip: following error"))
    writer.write_event(Event(FIRST_NS + 10**9, Level.INFO, "loop", "end"))
    return writer.close()


def chunks(path):
    with path.open("rb") as file:
        return SeekingReader(file).get_summary().chunk_indexes


def spoilt(path, out, place, change=0xFF):
    """A copy with one byte changed."""
    data = bytearray(path.read_bytes())
    data[place] ^= change
    out.write_bytes(bytes(data))
    return out


def test_it_says_what_all_rows_say(sample):
    by_index, by_rows = describe(sample), describe(sample, check=True)
    assert by_index == by_rows
    assert (by_index["rows"], by_index["duration_s"]) == (400, pytest.approx(399 * PERIOD_NS * 1e-9))
    assert by_index["period_s"] == pytest.approx(PERIOD_NS * 1e-9)
    assert [event["text"] for event in by_index["events"]] == ["trip: following error", "end"]


def test_rows_are_not_read_unless_they_are_to_be_checked(sample, tmp_path, capsys):
    place = chunks(sample)[3].chunk_start_offset + 200
    path = spoilt(sample, tmp_path / "a.mcap", place)
    assert describe(path)["complete"]
    whole = describe(path, check=True)
    assert not whole["complete"]
    assert whole["rows"] < 400
    assert main(["log", "info", "--check", str(path)]) == 0
    assert "TORN: " in capsys.readouterr().out


def test_an_index_that_names_what_is_not_there_is_told(sample, tmp_path):
    place = chunks(sample)[0].chunk_start_offset
    path = spoilt(sample, tmp_path / "a.mcap", place, Opcode.CHUNK ^ Opcode.METADATA)
    with pytest.raises(RecordingError, match=rf"a\.mcap: its index names a record at byte {place} that is not there"):
        describe(path)


def test_a_damaged_index_is_not_believed(sample, tmp_path):
    path = spoilt(sample, tmp_path / "a.mcap", sample.stat().st_size - 60)
    assert describe(path)["rows"] == 400


@pytest.mark.parametrize("share", [0.3, 0.9, 1.0])
def test_of_a_torn_file_every_whole_chunk_counts(sample, tmp_path, share):
    path = tmp_path / "a.mcap.part"
    path.write_bytes(sample.read_bytes()[: round(share * sample.stat().st_size) - 1])
    said, run = describe(path), read_run(path)
    assert (said["complete"], said["rows"], said["reason"]) == (False, len(run.rows), run.reason)
    assert said["duration_s"] == pytest.approx(float(run.time_s[-1]))


@settings(max_examples=60, deadline=None)
@given(st.floats(-0.05, 0.25), st.floats(-0.05, 0.25), st.sampled_from([1.0, 0.6]))
def test_a_window_is_those_rows_and_no_others(sample, begin_s, end_s, share):
    path = sample.with_suffix(".part")
    path.write_bytes(sample.read_bytes()[: round(share * sample.stat().st_size)])
    run, blocks = read_run(path), RowBlocks(path, window=TimeWindow(begin_s, end_s))
    seconds = (run.log_time_ns - run.log_time_ns[0]) / 1e9
    wanted = run.rows[(seconds >= begin_s) & (seconds < end_s)]
    found = [block.rows for block in blocks]
    assert same_bits(np.concatenate(found) if found else wanted[:0], wanted)
    assert blocks.rest.events == run.events
    assert blocks.count == len(run.rows)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_a_changed_byte_is_an_error_that_names_the_file_or_nothing(sample, data):
    place = data.draw(st.integers(0, sample.stat().st_size - 1))
    path = spoilt(sample, sample.with_suffix(".changed"), place, data.draw(st.integers(1, 255)))
    try:
        said = describe(path)
    except RecordingError as error:
        assert str(path) in str(error)  # noqa: PT017
    else:
        assert said["rows"] <= 400
