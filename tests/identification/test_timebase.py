"""Uneven stamps, short gaps, several rates: what a filter is given is uniform, and what was filled in is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification.synthetic import PERIOD_S, chirp_record

from fffo_drive.identification.dataset import DataError, load_record, one_rate
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.identification.kinematics import trusted
from fffo_drive.identification.timebase import LONGEST_BRIDGE_S, at_lower_rate, held_mean, on_even_grid
from fffo_drive.recording.errors import RecordingError

FACTS = DriveFacts(torque_constant_nm_per_a=0.148, resolver_bits=15)
STEP_S = 0.001


def sine(time_s):
    """A position of 3 Hz and 0.4 rev."""
    return 0.4 * np.sin(2.0 * np.pi * 3.0 * time_s)


def test_an_even_log_stays_as_it_is():
    time_s = 7.0 + np.arange(4000) / 3000.0
    for stamps in (time_s, np.round(time_s, 5)):  # rounding to 10 us: the median step is 0.1 % short
        even = on_even_grid(stamps, {"position_rev": sine(time_s)})
        assert even.period_s == pytest.approx(1.0 / 3000.0, rel=2e-6)
        assert np.array_equal(even.columns["position_rev"], sine(time_s))
        assert (even.good, even.breaks, even.jitter_s) == (None, (), 0.0)


def test_jitter_is_taken_out_and_its_size_reported():
    """190 to 280 Hz, as a servo on a serial line gives it."""
    steps = 1.0 / np.random.default_rng(1).uniform(190.0, 280.0, 3000)
    time_s = np.cumsum(steps)
    even = on_even_grid(time_s, {"position_rev": sine(time_s), "velocity_rps": np.gradient(sine(time_s), time_s)})
    grid_s = time_s[0] + even.period_s * np.arange(even.columns["position_rev"].size)
    assert even.period_s == pytest.approx(np.mean(steps), rel=1e-3)
    assert np.array_equal(even.breaks, ())
    assert even.good is None
    offset_s = np.linspace(-0.1, 1.0, 221) * even.period_s  # the grid lies where the stamps are, not at the first one
    errors = [np.abs(even.columns["position_rev"] - sine(grid_s + shift))[2:-2].max() for shift in offset_s]
    assert min(errors) < 0.06 * even.period_s * 0.4 * 2.0 * np.pi * 3.0  # ON_GRID of a period at top speed
    assert 0.2 * even.period_s < even.jitter_s < 0.4 * even.period_s


def test_a_short_gap_is_bridged_and_marked_and_a_long_one_stays():
    time_s = np.arange(5000) * STEP_S
    keep = np.ones(5000, bool)
    keep[[100, 700, 701, 702]] = False
    keep[3000:3040] = False
    even = on_even_grid(time_s[keep], {"position_rev": sine(time_s[keep]), "current_command_a": np.ones(keep.sum())})
    assert even.breaks == (3000,)
    assert np.flatnonzero(~even.good).tolist() == [100, 700, 701, 702]
    assert np.abs(even.columns["position_rev"][:3000] - sine(time_s[:3000])).max() < 1e-4
    assert np.array_equal(even.columns["position_rev"][3000:], sine(time_s[3040:]))
    assert np.array_equal(even.columns["current_command_a"], np.ones(4960))
    limit = round(LONGEST_BRIDGE_S / STEP_S)
    for missing, breaks in ((limit - 1, 0), (limit, 1)):
        keep = np.ones(5000, bool)
        keep[2000 : 2000 + missing] = False
        assert len(on_even_grid(time_s[keep], {"position_rev": sine(time_s[keep])}).breaks) == breaks


def test_the_command_is_held_from_stamp_to_stamp():
    stamps, values = np.array([0.0, 1.0, 2.5, 4.0]), np.array([2.0, 4.0, 8.0, 1.0])
    assert held_mean(stamps, values, np.array([0.0, 0.5, 2.0, 4.0]), 1.0).tolist() == [2.0, 3.0, 6.0, 1.0]


def test_rows_on_filled_samples_do_not_count():
    record = chirp_record(4.0)
    good = np.ones(record.samples, bool)
    good[1000] = False  # one sample weighs little behind the filter
    good[4000:4030] = False
    rows = trusted(replace(record, good=good), slice(0, record.samples))
    assert rows[900:1100].all()
    assert not rows[4000:4030].any()
    assert 30 < np.count_nonzero(~rows) < 120
    assert trusted(record, slice(0, record.samples)).all()


def test_a_faster_log_is_brought_to_the_rate_of_the_slower():
    slow = chirp_record(4.0)
    time_s = np.arange(slow.samples) * PERIOD_S
    slow = replace(slow, position_rev=sine(time_s), current_a=np.sin(40.0 * time_s), period_s=PERIOD_S)
    fast_s = np.arange(3 * slow.samples) * PERIOD_S / 2.5
    hum_rev = 0.01 * np.sin(2.0 * np.pi * 1900.0 * fast_s)  # would alias to 100 Hz
    fast = replace(slow, position_rev=sine(fast_s) + hum_rev, current_a=np.sin(40.0 * fast_s), period_s=PERIOD_S / 2.5)
    first, second = one_rate([slow, fast])
    assert first is slow
    assert second.period_s == slow.period_s
    assert "brought from 5000 to 2000 Hz" in second.warnings[-1]
    there_s = np.arange(second.samples) * PERIOD_S
    assert np.abs(second.position_rev - sine(there_s))[50:-50].max() < 2e-5
    middle = np.sin(40.0 * (there_s + 0.5 * PERIOD_S)) * np.sinc(40.0 * PERIOD_S / (2.0 * np.pi))
    assert np.abs(second.current_a - middle).max() < 0.01  # the mean over the new period, of a held command
    assert one_rate([slow, replace(slow, period_s=PERIOD_S * 1.0005)])[1].samples == slow.samples
    with pytest.raises(DataError, match="leave this log out"):
        one_rate([slow, replace(slow, period_s=20.0 * PERIOD_S)])


def test_a_gap_survives_the_lower_rate():
    good = np.ones(100, bool)
    good[50] = False
    found, sure = at_lower_rate({"position_rev": np.arange(100.0), "current_command_a": np.ones(100)}, good, 4.0)
    assert sure.size == found["position_rev"].size == 25
    assert 1 <= np.count_nonzero(~sure) <= 2
    assert np.allclose(found["position_rev"][3:-3], 4.0 * np.arange(25)[3:-3], atol=0.05)


def test_a_log_as_published_is_read(tmp_path):
    """Blanks behind the commas, stamps that come twice, and an end in the middle of a line."""
    record = chirp_record(4.0, lsb_rev=2.0**-15)
    rows = [
        f"{k * PERIOD_S:.4f},  {position:.9f}, {current:.6f}"
        for k, (position, current) in enumerate(zip(record.position_rev, record.current_a, strict=True))
    ]
    rows.insert(2001, rows[2000])
    path = tmp_path / "speed_0.065.txt"
    path.write_text("Time,   Position, Iq\n" + "\n".join(rows) + "\n4.00")
    columns = {"time_s": "Time", "position_rev": "Position", "current_command_a": "Iq"}
    found = load_record(path, FACTS.model_copy(update={"columns": columns}))
    assert found.name == "speed_0.065"
    assert found.samples == record.samples
    assert any("ends in the middle" in text for text in found.warnings)
    assert any("1 rows whose stamp is not later" in text for text in found.warnings)
    path.write_text("Time, Position, Iq\n" + "\n".join(rows[:2000] * 2) + "\n")  # written twice
    found = load_record(path, FACTS.model_copy(update={"columns": columns}))
    assert found.samples == 2000
    assert any("run 2 is the same and is left out" in text for text in found.warnings)
    other = [f"{k * PERIOD_S:.4f}, 0.0, 0.{k % 10}" for k in range(2000)]
    path.write_text("Time, Position, Iq\n" + "\n".join(rows[:2000] + other) + "\n")
    with pytest.raises(RecordingError, match="holds 2 runs, and a log of one is needed"):
        load_record(path, FACTS.model_copy(update={"columns": columns}))
