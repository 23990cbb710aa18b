"""Measures against closed forms: lags of shifted sines, effort of known tones, bands and histograms that add up."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fffo_drive.evaluation.campaign import cut, evaluation_of
from fffo_drive.evaluation.effort import control_effort
from fffo_drive.evaluation.measures import Yardstick, measure
from fffo_drive.evaluation.metrics import TickSums
from fffo_drive.evaluation.reversal import Reversals, crossing_error, find_reversals, near_reversals, reversal_lag
from fffo_drive.evaluation.summary import figures_of
from fffo_drive.evaluation.trace import Trace, trace_of, traces
from fffo_drive.signals import ROW

PERIOD_S = 5e-4
TIME_S = np.arange(20_000) * PERIOD_S
YARDSTICK = Yardstick((0.0, 0.5, 2.0, 1000.0), np.linspace(-0.4, 0.4, 81))


def sine(lag_s: float = 0.0, amplitude_rps: float = 3.0, frequency_hz: float = 1.3) -> np.ndarray:
    return amplitude_rps * np.sin(2.0 * math.pi * frequency_hz * (TIME_S - lag_s) + 0.3)


@given(lag_ms=st.floats(-8.0, 8.0))
@settings(max_examples=40)
def test_the_lag_of_a_shifted_sine_is_its_shift(lag_ms):
    reference, axis = (find_reversals(sine(lag), PERIOD_S) for lag in (0.0, 1e-3 * lag_ms))
    lag = reversal_lag(reference, axis)
    assert lag.reversals in (25, 26)
    assert lag.missed <= 1  # the record's ends
    assert lag.mean_ms == pytest.approx(lag_ms, abs=0.01)
    assert lag.mean_absolute_ms == pytest.approx(abs(lag_ms), abs=0.01)


def test_noise_within_the_threshold_makes_no_reversals():
    noise = np.random.default_rng(1).normal(0.0, 0.008, TIME_S.size)
    assert find_reversals(sine() + noise, PERIOD_S).time_s.size == find_reversals(sine(), PERIOD_S).time_s.size
    assert find_reversals(noise, PERIOD_S).time_s.size == 0


def test_an_axis_that_sticks_reverses_when_it_leaves_zero():
    reference = np.where(TIME_S < 1.0, -1.0, 1.0) * np.minimum(1.0, 5.0 * np.abs(TIME_S - 1.0))
    stuck = np.where((TIME_S > 0.98) & (TIME_S < 1.03), 0.0, reference)
    lag = reversal_lag(find_reversals(reference, PERIOD_S), find_reversals(stuck, PERIOD_S))
    assert lag.missed == 0
    assert lag.mean_ms == pytest.approx(30.0, abs=0.6)


def test_an_axis_that_stands_still_misses_every_reversal():
    lag = reversal_lag(find_reversals(sine(), PERIOD_S), find_reversals(np.zeros(TIME_S.size), PERIOD_S))
    assert lag.missed == lag.reversals > 20
    assert math.isnan(lag.mean_ms)


def test_a_reference_without_reversals_has_no_lag():
    nothing = find_reversals(np.ones(100), PERIOD_S)
    assert reversal_lag(nothing, nothing).reversals == 0


def test_the_neighbourhood_of_reversals_has_the_expected_length():
    reversals = find_reversals(sine(), PERIOD_S)
    near = near_reversals(reversals, TIME_S.size, PERIOD_S, 0.01)
    inner = np.count_nonzero((reversals.time_s > 0.01) & (reversals.time_s < TIME_S[-1] - 0.01))
    assert near.sum() * PERIOD_S == pytest.approx(0.02 * inner, rel=0.1)


def test_a_reversal_at_a_sample_has_the_same_neighbourhood_whatever_its_last_digit_is():
    moments_s = np.array([100.0, 300.5, 700.0]) * PERIOD_S
    masks = [
        near_reversals(Reversals(moments_s + rounding_s, np.ones(3)), 1000, PERIOD_S, 20 * PERIOD_S)
        for rounding_s in (-1e-15, 0.0, 1e-15)
    ]
    assert np.flatnonzero(masks[1])[0] == 80
    assert (masks[0] == masks[1]).all()
    assert (masks[2] == masks[1]).all()


@pytest.mark.parametrize(("frequency_hz", "high", "noise"), [(20.0, 0.0, 0.0), (150.0, 1.0, 0.05), (600.0, 1.0, 1.0)])
def test_effort_tells_motion_from_noise(frequency_hz, high, noise):
    tone = math.sqrt(2.0) * np.sin(2.0 * math.pi * frequency_hz * TIME_S)
    effort = control_effort(tone, PERIOD_S)
    assert effort.rms_a == pytest.approx(1.0, abs=0.01)
    assert effort.high_rms_a == pytest.approx(high, abs=0.05)
    assert effort.noise_rms_a == pytest.approx(noise, abs=0.3 if frequency_hz == 150.0 else 0.05)


def test_effort_of_a_slow_loop_has_no_high_band():
    effort = control_effort(np.ones(100), 1e-2)
    assert math.isnan(effort.high_rms_a)
    assert effort.rms_a == 1.0


def test_bands_and_histogram_hold_every_sample_once():
    reference = sine()
    measured = sine(0.002) + np.random.default_rng(2).normal(0.0, 0.05, TIME_S.size)
    found = measure([Trace(PERIOD_S, reference, measured, None, np.zeros(TIME_S.size))], YARDSTICK)
    assert found.true is None
    assert sum(band.ise for band in found.measured.bands) == pytest.approx(found.measured.error.ise)
    assert found.measured.histogram.sum() == TIME_S.size
    assert found.measured.error.ise == pytest.approx(float(np.sum((reference - measured) ** 2)) * PERIOD_S)


def test_a_trace_is_the_profile_and_nothing_else():
    rows = np.zeros(10, ROW)
    rows["profile_sample"] = [-1, -1, 0, 1, 2, 3, 4, -1, -1, -1]
    rows["reference_rps"] = np.arange(10)
    rows["true_velocity_rps"] = np.nan
    trace = trace_of(rows, PERIOD_S, samples=4)
    np.testing.assert_array_equal(trace.reference_rps, [2.0, 3.0, 4.0, 5.0])
    assert trace.true_rps is None
    with pytest.raises(ValueError, match="did not run"):
        trace_of(rows[:2], PERIOD_S)


def test_ticks_that_came_too_late_leave_the_others_at_their_time():
    """A sine of which every 7th sample, and 40 in a piece, have no row: cut-outs and lags stay where they were."""
    kept = [n for n in range(TIME_S.size) if n % 7 != 3 and not 1000 <= n < 1040]
    rows = np.zeros(len(kept), ROW)
    rows["profile_sample"] = kept
    rows["reference_rps"] = sine()[kept]
    rows["velocity_rps"] = sine(0.002)[kept]
    rows["current_command_a"] = TIME_S[kept]
    trace = trace_of(rows, PERIOD_S)
    assert trace.reference_rps.size == TIME_S.size
    assert trace.skipped == TIME_S.size - len(kept)
    assert trace.command_a[1039] == TIME_S[999]  # held
    whole = Trace(PERIOD_S, sine(), sine(0.002), None, TIME_S)
    found, wanted = measure([trace], YARDSTICK).measured, measure([whole], YARDSTICK).measured
    assert found.error.ise == pytest.approx(wanted.error.ise, rel=2e-3)
    assert found.lag.mean_absolute_ms == pytest.approx(wanted.lag.mean_absolute_ms, abs=0.05)


def test_a_run_that_stopped_early_has_no_cutout_of_what_it_did_not_reach():
    trace = Trace(PERIOD_S, sine()[:1000], sine(0.002)[:1000], None, np.zeros(1000))
    pieces = cut([trace], ((0.1, 0.2), (0.45, 0.55), (0.5, 0.6), (0.9, 1.0)), False)
    assert [(piece.start_s, piece.velocity_rps.size) for piece in pieces] == [(0.1, 200), (0.45, 100)]


@pytest.mark.parametrize(("amplitude_rps", "fast"), [(5.0, True), (0.5, False)])
def test_the_error_at_a_crossing_is_the_lag_times_the_slope(amplitude_rps, fast):
    period_s, hz, late_s = 5e-4, 1.0, 1e-3
    time_s = np.arange(8000) * period_s
    reference_rps = amplitude_rps * np.sin(2.0 * np.pi * hz * time_s)
    error_rps = reference_rps - amplitude_rps * np.sin(2.0 * np.pi * hz * (time_s - late_s))
    found = crossing_error(reference_rps, error_rps, period_s)
    slope_rps2 = 2.0 * np.pi * hz * amplitude_rps
    if fast:  # 31 rps2
        assert found.fast > 5
        assert found.slow == 0
        assert found.fast_lag_ms == pytest.approx(1e3 * late_s, rel=2e-3)
    else:  # 3 rps2
        assert found.slow > 5
        assert found.fast == 0
        assert found.slow_error_mrps == pytest.approx(1e3 * slope_rps2 * late_s, rel=2e-3)
        assert np.isnan(found.fast_lag_ms)


def rows_of_a_run(seed: int) -> np.ndarray:
    """Reversals fast and slow, a stretch that creeps inside the threshold, skipped ticks, and noise."""
    rng = np.random.default_rng(seed)
    rows = np.zeros(9000, ROW)
    rows["profile_sample"] = np.arange(rows.size)
    time_s = PERIOD_S * np.arange(rows.size)
    reference = 3.0 * np.sin(2.0 * math.pi * 1.7 * time_s) + 0.4 * np.sin(2.0 * math.pi * 9.0 * time_s)
    reference[4000:5800] = np.linspace(0.04, -0.04, 1800)  # crosses zero far from both thresholds
    rows["reference_rps"] = reference
    rows["velocity_rps"] = np.roll(reference, 4) + rng.normal(0.0, 0.02, rows.size)
    rows["true_velocity_rps"] = np.roll(reference, 3)
    rows["current_command_a"] = rng.normal(0.0, 1.0, rows.size)
    return rows[np.sort(rng.choice(rows.size, 8700, replace=False))]


@given(seed=st.integers(0, 9), edges=st.lists(st.integers(0, 8700), max_size=30))
@settings(max_examples=25, deadline=None)
def test_a_run_in_parts_measures_as_it_does_as_a_whole(seed, edges):
    """Counts, lags, crossings and the largest error to the last bit; sums but for the order of their terms."""
    rows = rows_of_a_run(seed)
    windows = ((0.3, 0.5), (2.9, 3.1), (4.4, 4.6))
    whole, parts = (
        evaluation_of("pi", 1, list(traces(blocks, PERIOD_S)), YARDSTICK, windows)
        for blocks in ([rows], np.split(rows, sorted(edges)))
    )
    assert parts.skipped_share == whole.skipped_share > 0.02
    assert figures_of(parts.measures) == pytest.approx(figures_of(whole.measures), rel=1e-12)
    for own, wanted in ((parts.measures.measured, whole.measures.measured), (parts.measures.true, whole.measures.true)):
        assert (own.lag, own.crossing, own.error.max) == (wanted.lag, wanted.crossing, wanted.error.max)
        np.testing.assert_array_equal(own.histogram, wanted.histogram)
    assert len(whole.cutouts) == len(parts.cutouts) == 3
    for own, wanted in zip(parts.cutouts, whole.cutouts, strict=True):
        np.testing.assert_array_equal(own.velocity_rps, wanted.velocity_rps)
        np.testing.assert_array_equal(own.reference_rps, wanted.reference_rps)


def test_a_reversal_counts_for_the_samples_before_it_that_are_in_another_part():
    rows = rows_of_a_run(1)
    reference = find_reversals(trace_of(rows, PERIOD_S).reference_rps, PERIOD_S)
    whole = near_reversals(reference, 9000, PERIOD_S, 0.025)
    parts = [near_reversals(reference, 100, PERIOD_S, 0.025, begin) for begin in range(0, 9000, 100)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert 0.05 < whole.mean() < 0.6


def test_a_profile_that_ran_twice_in_one_recording_is_not_taken_for_one_run():
    rows = np.concatenate([rows_of_a_run(1), rows_of_a_run(1)])
    with pytest.raises(ValueError, match="ran more than once: cut out one run with fffo-drive log export"):
        list(traces([rows], PERIOD_S))
    with pytest.raises(ValueError, match="ran more than once"):
        list(traces(np.split(rows, 2), PERIOD_S))


@given(parts=st.lists(st.lists(st.integers(-400, 400), max_size=40), min_size=1, max_size=6))
@settings(max_examples=60, deadline=None)
def test_statistics_of_ticks_block_by_block_are_those_of_all_of_them(parts):
    sums, blocks = TickSums(), []
    for turnaround_ns in parts:
        block = np.zeros(len(turnaround_ns), ROW)
        block["turnaround_ns"], block["lateness_ns"] = turnaround_ns, np.abs(turnaround_ns)
        block["tick"] = 1000 + 2 * np.arange(block.size) + 2 * sum(len(one) for one in blocks)
        blocks.append(block)
        sums.take(block)
    rows = np.concatenate(blocks)
    if not rows.size:
        with pytest.raises(ValueError, match="the loop did not run"):
            sums.statistics()
        return
    found = sums.statistics()
    assert (found.ticks, found.skipped) == (rows.size, rows.size - 1)
    late_us = rows["lateness_ns"] / 1e3
    wanted = [*np.percentile(late_us, [50, 99]), late_us.max()]
    assert [found.lateness_us_p50, found.lateness_us_p99, found.lateness_us_max] == pytest.approx(wanted, rel=1e-12)
    answered = rows["turnaround_ns"][rows["turnaround_ns"] >= 0]
    assert found.missing_feedback == rows.size - answered.size
    assert found.turnaround_us_p50 == pytest.approx(
        np.median(answered) / 1e3 if answered.size else math.nan, nan_ok=True
    )
