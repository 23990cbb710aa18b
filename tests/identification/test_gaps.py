"""What a bus does to a record, and its mending: late ticks, missing answers, skipped ticks."""

from __future__ import annotations

import numpy as np

from fffo_drive.identification.gaps import LONGEST_FILL_S, LogTiming, mended

PERIOD_S = 0.0005
LSB_REV = 2.0**-15
TICKS = 4000


def motion(time_s):
    """5 rps at 10 Hz over a drift of 2 rps: position and velocity."""
    rate = 2.0 * np.pi * 10.0
    return 2.0 * time_s - 5.0 / rate * np.cos(rate * time_s), 2.0 + 5.0 * np.sin(rate * time_s)


def a_record(lateness_ns=None):
    """Columns of a whole run and its timing; the drive latches when the loop wakes."""
    tick = np.arange(TICKS)
    lateness_ns = np.zeros(TICKS, np.int64) if lateness_ns is None else lateness_ns
    position, velocity = motion(tick * PERIOD_S + lateness_ns * 1e-9)
    columns = {
        "time_s": tick * PERIOD_S, "position_rev": position, "velocity_rps": velocity,
        "current_command_a": np.sin(0.01 * tick), "current_a": np.cos(0.01 * tick), "reference_rps": velocity.copy(),
    }  # fmt: skip
    return columns, LogTiming(tick.astype(np.int64), np.zeros(TICKS, np.int64), lateness_ns)


def cut(columns, timing, rows):
    return {name: values[rows] for name, values in columns.items()}, LogTiming(*(values[rows] for values in timing))


def test_a_sound_record_stays_as_it_is():
    columns, timing = a_record()
    found = mended(columns, timing, PERIOD_S)
    assert found.columns is columns
    assert (found.filled, found.dropped) == (0, 0)


def test_the_position_of_a_late_tick_is_brought_back_to_its_deadline():
    generator = np.random.default_rng(1)
    columns, timing = a_record(generator.integers(0, 300_000, TICKS))
    found = mended(columns, timing, PERIOD_S)
    true_rev, _ = motion(columns["time_s"])
    assert np.abs(columns["position_rev"] - true_rev).max() > 50.0 * LSB_REV
    assert np.abs(found.columns["position_rev"] - true_rev).max() < LSB_REV
    assert np.array_equal(found.columns["current_command_a"], columns["current_command_a"])
    assert found.filled == 0


def test_short_gaps_are_filled_to_a_count_of_the_sensor():
    generator = np.random.default_rng(2)
    columns, timing = a_record()
    stale = np.flatnonzero(generator.random(TICKS) < 0.02)
    stale = stale[(stale > 0) & (stale < TICKS - 1)]
    for k in stale:  # no answer: the last feedback is held
        timing.age[k] = timing.age[k - 1] + 1
        for name in ("position_rev", "velocity_rps"):
            columns[name][k] = columns[name][k - 1]
    rows = np.ones(TICKS, bool)
    for begin in range(100, TICKS - 100, 170):  # skipped: no row at all
        rows[begin : begin + int(generator.integers(1, 0.8 * LONGEST_FILL_S / PERIOD_S))] = False
    given, timed = cut(columns, timing, rows)
    found = mended(given, timed, PERIOD_S)
    true_rev, true_rps = motion(np.arange(TICKS) * PERIOD_S)
    assert found.columns["time_s"].size == TICKS
    assert np.allclose(np.diff(found.columns["time_s"]), PERIOD_S)
    assert np.abs(found.columns["position_rev"] - true_rev).max() < LSB_REV
    assert np.abs(found.columns["velocity_rps"] - true_rps).max() < 1.0
    kept = np.flatnonzero(rows & (timing.age == 0))
    assert np.array_equal(found.columns["position_rev"][kept], true_rev[kept])
    assert found.filled == TICKS - kept.size
    assert found.dropped == 0


def test_the_command_of_a_gap_is_the_one_that_the_drive_held():
    """Command k acts at SYNC k+1. Without SYNCs 4 and 5 the drive keeps command 2, and command 3 acts at SYNC 6."""
    columns, timing = a_record()
    columns["current_command_a"] = np.arange(TICKS, dtype=float)
    rows = np.ones(TICKS, bool)
    rows[4:6] = False
    found = mended(*cut(columns, timing, rows), PERIOD_S)
    assert found.columns["current_command_a"][:9].tolist() == [0.0, 1.0, 2.0, 2.0, 2.0, 3.0, 6.0, 7.0, 8.0]


def test_a_long_gap_stays_one():
    columns, timing = a_record()
    rows = np.ones(TICKS, bool)
    rows[1000:1200] = False
    timing.age[990:1000] = np.arange(1, 11)  # the last rows before it have no answer either
    found = mended(*cut(columns, timing, rows), PERIOD_S)
    steps = np.diff(found.columns["time_s"])
    assert np.count_nonzero(steps > 1.5 * PERIOD_S) == 1
    assert round(steps.max() / PERIOD_S) == 211
    assert found.filled == 0
    assert found.dropped == 210
    true_rev, _ = motion(found.columns["time_s"])
    assert np.abs(found.columns["position_rev"] - true_rev).max() < 1e-9
