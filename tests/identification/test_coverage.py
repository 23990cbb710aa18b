"""What logs can show, against motions whose speeds, turns, reversals and dwells are known in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fffo_drive.identification.coverage import coverage_lines, coverage_of, shown, to_record
from fffo_drive.identification.dataset import Record
from fffo_drive.identification.excitation import separating_recipe

PERIOD_S = 1e-3


def record_of(velocity_rps):
    position = np.cumsum(velocity_rps) * PERIOD_S
    current = np.gradient(velocity_rps, PERIOD_S) * 1e-3 + 0.1 * np.sign(velocity_rps)
    return Record("log", Path("log"), PERIOD_S, 0.1, current, position, None, None, 1e-6, (), "0")


def sine(amplitude, frequency_hz, seconds, offset=0.0):
    time_s = np.arange(round(seconds / PERIOD_S)) * PERIOD_S
    return offset + amplitude * np.sin(2.0 * np.pi * frequency_hz * time_s)


def test_a_sine_has_its_speed_acceleration_turns_and_reversals():
    found = coverage_of([record_of(sine(4.0, 0.5, 20.0))])
    assert found.highest_rps == pytest.approx(4.0, rel=0.01)
    assert found.highest_rps2 == pytest.approx(4.0 * np.pi, rel=0.03)  # the filter rings at the ends
    assert found.travel_rev == pytest.approx(4.0 * 2.0 / np.pi, rel=0.01)  # half a period of |sin|
    assert found.reversals == 19
    assert found.backward_share == pytest.approx(0.5, abs=0.01)
    assert found.rate_hz == pytest.approx(1000.0)
    # a tenth of a sine's time is below sin(pi/20) of its amplitude
    assert found.slow_rps == pytest.approx(4.0 * np.sin(np.pi / 20.0), rel=0.05)
    assert found.highest_order == pytest.approx(found.cutoff_hz / found.slow_rps)


def test_dwells_are_counted_with_their_length_and_short_ones_are_reversals():
    step = np.concatenate([sine(2.0, 1.0, 0.5), np.zeros(round(0.7 / PERIOD_S)), -sine(2.0, 1.0, 0.5), np.zeros(20)])
    found = coverage_of([record_of(np.tile(step, 6))])
    assert found.dwells == 6
    assert found.longest_dwell_s == pytest.approx(0.7, abs=0.06)
    assert found.reversals == 11


def test_one_speed_one_way_lacks_nearly_everything_and_the_recipe_nothing():
    lacking = to_record(coverage_of([record_of(sine(0.05, 3.0, 20.0, offset=1.0))]))
    for word in ("constant torque", "viscous", "Stribeck", "presliding", "break-away"):
        assert any(word in line for line in lacking), word
    recipe = separating_recipe(PERIOD_S, 10.0, 150.0)
    whole = coverage_of([record_of(recipe.values)])
    assert to_record(whole) == []
    assert len(coverage_lines(whole)) == 1 + len(shown(whole))


def test_a_linear_axis_has_its_own_words():
    found = coverage_of([record_of(sine(0.2, 0.5, 10.0))])
    text = " ".join(coverage_lines(found, linear=True))
    assert "m/s2" in text
    assert "periods per metre" in text
    assert "rev" not in text.replace("reversals", "")
