"""Where a counter or an angle wraps: at its own turn, at a known range, or by assumption that says so; never nearby."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from importing.axis_log import truth

from fffo_drive.identification.dataset import record_of_columns
from fffo_drive.identification.facts import facts_of
from fffo_drive.identification.regression import regression_start
from fffo_drive.importing.candidates import Hints
from fffo_drive.importing.convert import converted
from fffo_drive.importing.evidence import at_stamps, stamp_wrap_of, wrap_of
from fffo_drive.importing.recognise import recognise
from fffo_drive.importing.source import source_of_arrays

RESOLUTIONS = [500, 1000, 2000, 2500, 3600, 4000, 4096, 5000, 8000, 8192, 10_000, 16_000, 65_536]
TURNS = 3.0  # of the motion of `truth`: it wraps several times


def encoder(counts, wrap=None):
    """Counts of an encoder that moves TURNS times as far as `truth`."""
    return np.mod(np.floor(TURNS * truth().position_rev * counts), counts if wrap is None else wrap)


def imported(columns, **hints):
    source = source_of_arrays(Path("log"), columns)
    found = recognise(source, Hints(**hints))
    return found, converted(source, found).columns


def log_of(position, heading="Encoder [counts]"):
    log = truth()
    return {"time_s": log.time_s, heading: position, "Demand current [A]": log.current_a}


@pytest.mark.parametrize("counts", RESOLUTIONS)
def test_an_encoder_is_unwrapped_at_its_own_counts(counts):
    found, columns = imported(log_of(encoder(counts)), counts_per_turn=float(counts))
    guess = found.of("position_rev")
    assert (guess.wrap, guess.sure) == (counts, True)
    moved = TURNS * (truth().position_rev - truth().position_rev[0])
    np.testing.assert_allclose(columns["position_rev"] - columns["position_rev"][0], moved, atol=1.01 / counts)


@pytest.mark.parametrize("counts", RESOLUTIONS)
def test_a_wrap_that_nobody_tells_is_a_power_of_two_or_an_assumption(counts):
    wrap = wrap_of(encoder(counts))
    assert wrap.at == pytest.approx(counts, abs=2.0)
    assert wrap.sure == (counts & (counts - 1) == 0)
    found, _ = imported(log_of(encoder(counts)))
    guess = found.of("position_rev")
    assert not guess.sure
    assert wrap.sure or "by assumption (--counts-per-turn N" in guess.evidence


def test_the_inertia_of_an_encoder_of_4000_counts_is_right():
    found, columns = imported(log_of(encoder(4000)), counts_per_turn=4000.0)
    record = record_of_columns("log", columns, facts_of({"torque_constant_nm_per_a": 0.025}, found.linear))
    inertia = regression_start([record]).inertia_nm_s2_per_rev
    assert inertia == pytest.approx(0.025 * 3e-3 / TURNS, rel=0.05)


def test_a_counter_of_16_bits_wraps_after_some_turns():
    """Of 4096 counts after sixteen; of 4000 after no whole number of them."""
    far = np.floor(np.linspace(0.0, 40.0, 4000) ** 1.2 * 4000.0)
    for counts in (4096.0, 4000.0):
        assert wrap_of(np.mod(far, 65_536.0), counts) == (65_536.0, pytest.approx(65_536.0, abs=2.0), True)


def test_counts_that_are_not_those_of_the_wrap_are_not_taken_for_it():
    found, _ = imported(log_of(encoder(4000)), counts_per_turn=4096.0)
    guess = found.of("position_rev")
    assert guess.wrap == pytest.approx(4000.0, abs=2.0)
    assert not guess.sure


def test_a_jump_that_is_no_wrap_stays_and_is_uncertain():
    """A position that is set to zero once."""
    counts = np.floor(20_000.0 * truth().position_rev)
    counts[600:] -= 30_000.0
    found, columns = imported(log_of(counts), counts_per_turn=4096.0)
    guess = found.of("position_rev")
    assert (guess.wrap, guess.sure) == (None, False)
    assert "neither a turn nor a known range" in guess.evidence
    np.testing.assert_allclose(columns["position_rev"] * 4096.0, counts, atol=1e-6)


def test_a_sensor_at_rest_does_not_wrap():
    toggling = np.random.default_rng(5).integers(0, 2, 1000).astype(float)
    assert wrap_of(toggling) is None
    assert wrap_of(toggling / 4096.0) is None


@pytest.mark.parametrize(("unit", "turn"), [("deg", 360.0), ("rad", 2.0 * np.pi), ("rev", 1.0), ("mrad", 2e3 * np.pi)])
def test_an_angle_wraps_at_its_turn(unit, turn):
    angle = np.mod(TURNS * truth().position_rev, 1.0) * turn
    found, columns = imported(log_of(angle, f"Position [{unit}]"))
    guess = found.of("position_rev")
    assert guess.wrap == pytest.approx(turn)
    assert guess.sure
    assert np.ptp(columns["position_rev"]) == pytest.approx(TURNS * np.ptp(truth().position_rev), rel=1e-9)


def test_a_set_point_that_steps_by_a_turn_is_not_unwrapped():
    log = truth()
    steps = np.repeat([0.25, 1.25, 0.25, 1.25], log.time_s.size // 4)
    columns = log_of(log.position_rev, "Position [rev]") | {"Position demand [rev]": steps}
    found, _ = imported(columns)
    assert found.of("setpoint_rev").wrap is None


# Time


def test_a_counter_of_time_of_16_bits_goes_on():
    log = truth()
    raw = {"time_us": np.mod(np.round(1e6 * log.time_s), 65_536.0), "pos_rev": log.position_rev, "i_a": log.current_a}
    assert stamp_wrap_of(raw["time_us"]) == 65_536.0
    _, columns = imported(raw, roles={"time_s": "time_us", "current_command_a": "i_a"}, units={"i_a": "A"})
    np.testing.assert_allclose(columns["time_s"], log.time_s, atol=1e-6)


@pytest.mark.parametrize(("unit", "factor", "rows"), [("s", 1.0, 3142), ("ms", 1e3, 512)])
def test_a_log_that_was_written_twice_does_not_wrap_its_time(unit, factor, rows):
    """After 6.283 s, or 1024 ms: an angle and a counter of few bits would wrap there."""
    log = truth()
    time = 2e-3 * np.arange(rows)
    once = {
        f"time_{unit}": time * factor, "pos_rev": np.interp(time, log.time_s, log.position_rev),
        "i_a": np.interp(time, log.time_s, log.current_a),
    }  # fmt: skip
    columns = {name: np.tile(values, 2) for name, values in once.items()}
    found, taken = imported(columns, roles={"time_s": f"time_{unit}", "current_command_a": "i_a"}, units={"i_a": "A"})
    assert found.of("time_s").wrap is None
    np.testing.assert_allclose(taken["time_s"], time, atol=1e-9)


# To the stamps of another column


def test_nothing_is_made_up_before_the_first_and_after_the_last_sample():
    own = np.linspace(2.0, 7.0, 51)
    found = at_stamps(3.0 * own + 1.0, own, np.linspace(0.0, 10.0, 101))
    inside = np.isfinite(found)
    np.testing.assert_allclose(found[inside], 3.0 * np.linspace(0.0, 10.0, 101)[inside] + 1.0)
    assert (int(np.flatnonzero(inside)[0]), int(inside.sum())) == (20, 51)
    assert np.isnan(at_stamps(np.full(4, np.nan), np.arange(4.0), np.arange(3.0))).all()


def test_an_angle_is_interpolated_through_its_wraps():
    time, slow = np.arange(0.0, 10.0, 0.01), np.arange(0.0, 10.0, 0.05)
    found = at_stamps(np.mod(100.0 * slow, 360.0), slow, time, 360.0)
    given = np.isfinite(found)
    away = np.mod(found[given] - 100.0 * time[given] + 180.0, 360.0) - 180.0
    np.testing.assert_allclose(away, 0.0, atol=1e-9)
