"""Long recordings: what is rare in them is taken, the rest as far as there is room, and both are told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.identification.dataset import load_records
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.identification.gaps import LogTiming, mended
from fffo_drive.identification.stretches import RowRange, StretchMotion, choose, load_logs, samples_each
from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.writer import RunWriter
from fffo_drive.signals import ROW

FACTS = DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=8.3)
PERIOD_S = 0.002
ROWS = 10_000  # of a stretch


@given(samples=st.lists(st.integers(0, 5000), min_size=1, max_size=8), most=st.integers(8, 20_000))
def test_logs_together_have_at_most_so_many_samples_and_nothing_is_cut_without_need(samples, most):
    each = samples_each(samples, most)
    kept = [min(size, each) for size in samples]
    assert sum(kept) <= most
    if sum(samples) <= most:
        assert kept == samples
    else:
        assert sum(kept) > most - len(samples)


def stretch(number, velocity_rps, acceleration_rps2=0.0):
    """20 s at 100 rows a second."""
    velocity = np.broadcast_to(np.asarray(velocity_rps, float), 2000)
    position = np.cumsum(velocity) * 0.01 + 3.0 * number
    acceleration = np.broadcast_to(np.asarray(acceleration_rps2, float), 2000)
    rows = RowRange(ROWS * number, ROWS * (number + 1))
    return StretchMotion(rows, 20.0 * number, 20.0 * number + 20.0, velocity, acceleration, position, 0.01, 1e-5)


def test_the_stretches_that_hold_what_is_rare_are_taken():
    turns = np.repeat([1.0, -1.0], 1000)
    rests = np.where(np.arange(2000) % 500 < 100, 0.0, 5.0)
    rare = {13: stretch(13, turns), 29: stretch(29, rests), 41: stretch(41, 5.0, 300.0), 55: stretch(55, 0.1)}
    motions = [rare.get(number, stretch(number, 5.0)) for number in range(60)]
    chosen = choose(Path("day.mcap"), motions, 8 * ROWS)
    taken = {number for first, end in chosen.rows for number in range(first // ROWS, end // ROWS)}
    assert set(rare) <= taken
    assert len(taken) == 8
    assert len({number * 8 // 60 for number in taken}) >= 6  # the others over the whole time: an axis warms up
    assert "100 % of the rests" in chosen.text
    assert "100 % of the reversals" in chosen.text
    assert "log export day.mcap --from S --to S --out part.mcap" in chosen.text


def test_stretches_that_follow_each_other_are_one_without_a_gap():
    chosen = choose(Path("a.mcap"), [stretch(number, 5.0 - number) for number in range(3)], 3 * ROWS)
    assert chosen.rows == (RowRange(0, 3 * ROWS),)


def test_a_stretch_longer_than_there_is_room_for_is_taken_alone():
    assert choose(Path("a.mcap"), [stretch(0, 5.0), stretch(1, 5.0)], ROWS // 2).rows == (RowRange(0, ROWS),)


def recording(path, seconds, turns_at_s):
    """A shaft that turns at constant speed, but for ten seconds in which it goes back and forth."""
    rows = np.zeros(round(seconds / PERIOD_S), ROW)
    rows["tick"] = np.arange(rows.size)
    rows["deadline_ns"] = np.round(rows["tick"] * PERIOD_S * 1e9)
    time_s = rows["tick"] * PERIOD_S
    phase = 2.0 * np.pi * 1.3 * (time_s - turns_at_s)
    rows["velocity_rps"] = np.where((time_s > turns_at_s) & (time_s < turns_at_s + 10.0), 2.0 * np.cos(phase), 2.0)
    rows["position_rev"] = np.round(np.cumsum(rows["velocity_rps"]) * PERIOD_S * 2**15) / 2**15
    rows["current_command_a"] = 1.0 + 0.1 * np.sin(time_s) + np.sign(rows["velocity_rps"])
    rows["mode"] = 1
    writer = RunWriter(path, {}, [], 0)
    for begin in range(0, rows.size, 500):
        writer.write_rows(rows[begin : begin + 500])
    return writer.close()


def test_of_a_long_recording_stretches_are_read_and_told(tmp_path):
    path = recording(tmp_path / "long.mcap", 200.0, 105.0)
    said = []
    (record,) = load_logs([path], FACTS, lambda share, step: said.append(share), most=30_000)
    assert record.samples <= 30_000
    assert record.velocity_rps.min() < -1.9  # the ten seconds are in it
    assert len(record.breaks) >= 1
    assert record.warnings[0].startswith(f"{path}: 3.33 min are more than a fit takes")
    assert said == sorted(said)
    assert said[-1] == 1.0
    (whole,) = load_records([path], FACTS)
    same = np.isin(np.round(record.position_rev * 2**15), np.round(whole.position_rev * 2**15))
    assert same.all()


def test_what_is_short_enough_is_read_as_it_is(tmp_path):
    path = recording(tmp_path / "short.mcap", 20.0, 5.0)
    (record,), (whole,) = load_logs([path], FACTS), load_records([path], FACTS)
    np.testing.assert_array_equal(record.position_rev, whole.position_rev)
    assert record.warnings == whole.warnings


def test_what_cannot_be_read_is_said_by_the_reading(tmp_path):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no recording")
    with pytest.raises(RecordingError, match=r"broken\.mcap"):
        load_logs([broken], FACTS)
    with pytest.raises(FileNotFoundError):
        load_logs([tmp_path / "gone.mcap"], FACTS)


def test_a_gap_of_a_year_takes_no_memory():
    tick = np.concatenate([np.arange(1000), 10**11 + np.arange(1000)])
    lateness = np.full(2000, 1000)
    columns = {name: np.sin(tick % 1000) for name in ("position_rev", "velocity_rps", "current_command_a")}
    found = mended({"time_s": tick * 5e-4, **columns}, LogTiming(tick, np.zeros(2000, np.int64), lateness), 5e-4)
    assert found.columns["time_s"].size == 2000
    assert found.dropped == 10**11 - 1000
