"""Rows of runs: the one filter, its cut-off, what is kept; a filled sample costs the rows that see it and no others."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.planted import FACTS, LSB_REV, PERIOD_S, nothing, planted, runs

from fffo_drive.diagnosis.diagnose import DiagnosisSettings, filter_for
from fffo_drive.diagnosis.rows import (
    CUTOFF_HZ,
    EDGE_S,
    HIGHEST_SHARE,
    cutoff_of,
    make_filter,
    resting,
    rows_of,
    second_difference,
    slow_rps,
    stretches_of,
)


def turning(wave_nm=0.0, order=72.0, speed_rps=1.0, duration_s=8.0):
    """A run at about one speed, one way, whose torque has a wave of the angle in it."""
    record = planted(duration_s=duration_s)
    time_s = np.arange(record.samples) * PERIOD_S
    velocity = speed_rps * (1.0 + 0.2 * np.sin(2.0 * np.pi * 0.4 * time_s))
    position = np.cumsum(velocity) * PERIOD_S
    torque = 0.03 + wave_nm * np.cos(2.0 * np.pi * order * position)
    torque += 5e-4 * np.random.default_rng(2).normal(size=time_s.size)
    return replace(record, position_rev=position, current_a=torque / record.torque_constant_nm_per_a, velocity_rps=None)


@pytest.mark.parametrize("hz", [2.0, 20.0, 45.0, 60.0, 100.0])
def test_the_gain_is_what_the_filter_leaves_of_a_sine(hz):
    filter_ = make_filter(PERIOD_S)
    wave = np.exp(2j * np.pi * hz * PERIOD_S * np.arange(6000))
    rows = filter_.rows(wave.real) + 1j * filter_.rows(wave.imag)
    thin = wave[:: filter_.step]
    inner = slice(20, -20)
    ratio = rows[inner] / thin[inner]
    assert ratio.real == pytest.approx(float(filter_.gain(np.array([hz]))[0]), abs=0.003)
    assert np.abs(ratio.imag).max() < 1e-9  # no phase
    assert filter_.gain(np.array([-hz])) == pytest.approx(filter_.gain(np.array([hz])))


def test_half_is_left_at_the_cut_off_and_nothing_at_half_the_rate_of_the_rows():
    for cutoff_hz in (45.0, 150.0):
        filter_ = make_filter(PERIOD_S, cutoff_hz)
        assert filter_.gain(np.array([0.0, cutoff_hz, 0.5 / filter_.row_period_s])) == pytest.approx(
            [1.0, 0.5, 0.0], abs=0.02
        )


def test_where_the_axis_also_moves_slowly_the_cut_off_stays():
    records = runs(nothing, nothing, duration_s=8.0)
    assert slow_rps(records) < 1.0
    assert cutoff_of(records) == CUTOFF_HZ == 45.0


def test_where_order_72_passes_at_a_turn_a_second_the_cut_off_rises_beyond_it():
    records = [turning(0.004)]
    assert slow_rps(records) == pytest.approx(0.8, abs=0.05)
    assert 72.0 < cutoff_of(records) <= HIGHEST_SHARE / PERIOD_S
    assert filter_for(records, FACTS, DiagnosisSettings()).cutoff_hz == cutoff_of(records)
    assert filter_for(records, FACTS, DiagnosisSettings(cutoff_hz=50.0)).cutoff_hz == 50.0


@pytest.mark.parametrize(
    ("record", "rotary"),
    [(turning(0.0), True), (turning(0.004, order=20.0), True), (turning(0.004), False), (turning(5e-5), True)],
    ids=["no wave", "a wave below", "a linear axis", "a wave that hardly stands out"],
)
def test_the_cut_off_rises_for_nothing_less(record, rotary):
    assert cutoff_of([record], rotary) == CUTOFF_HZ


def filled(record, *samples):
    """The record with samples that were filled in across a gap."""
    good = np.ones(record.samples, bool)
    good[list(samples)] = False
    return replace(record, good=good)


def rows_from(record, filter_):
    return rows_of(stretches_of([record], filter_), filter_)


@pytest.mark.parametrize("first", [5000, 5003])
def test_a_filled_stretch_costs_the_rows_within_the_filters_reach_and_nothing_more(first):
    record, filter_ = planted(duration_s=8.0), make_filter(PERIOD_S)
    whole, gap = rows_from(record, filter_), rows_from(filled(record, *range(first, first + 4)), filter_)
    lost = np.flatnonzero(whole.kept & ~gap.kept)
    assert gap.time_s.size == whole.time_s.size
    assert not (gap.kept & ~whole.kept).any()
    reach = filter_.taps.size // 2
    centre = np.arange(whole.time_s.size) * filter_.step
    distance = np.minimum(np.abs(centre - first), np.abs(centre - first - 3))
    thin = round(filter_.law_period_s / PERIOD_S)
    assert set(np.flatnonzero(whole.kept & (distance <= reach - 2 * thin))) <= set(lost)
    assert distance[lost].max() <= reach + thin


@pytest.mark.parametrize("sample", [5000, 5001])
def test_one_filled_sample_is_seen_wherever_it_is(sample):
    record, filter_ = planted(duration_s=8.0), make_filter(PERIOD_S)
    lost = rows_from(record, filter_).kept & ~rows_from(filled(record, sample), filter_).kept
    assert 0 < lost.sum() * filter_.step < 3 * filter_.taps.size


def test_rows_at_rest_and_at_the_ends_do_not_count():
    record, filter_ = planted(duration_s=8.0), make_filter(PERIOD_S)
    position = record.position_rev.copy()
    position[3000:4000] = position[3000]
    position[4000:] += position[3000] - position[4000]
    rows = rows_from(replace(record, position_rev=position), filter_)
    assert not rows.kept[(rows.time_s > 3.06) & (rows.time_s < 3.94)].any()
    assert not rows.kept[rows.time_s < EDGE_S - filter_.row_period_s].any()
    assert not rows.kept[rows.time_s > 8.0 - EDGE_S].any()
    assert rows.kept[(rows.time_s > 1.0) & (rows.time_s < 2.8)].mean() > 0.9


def test_rest_is_where_the_position_stays_within_counts_for_a_while():
    position = np.concatenate([np.zeros(500), np.linspace(0.0, 1.0, 500)])
    rest = resting(position, LSB_REV, PERIOD_S)
    assert rest[:440].all()
    assert not rest[560:].any()


def test_a_break_divides_a_run_and_what_is_too_short_is_left_out():
    filter_ = make_filter(PERIOD_S)
    stretches = stretches_of([replace(planted(duration_s=8.0), breaks=(3000, 3400))], filter_)
    assert [s.begin_s for s in stretches] == pytest.approx([0.0, 3.4])
    rows = rows_of(stretches, filter_)
    (begin, end), (again, last) = rows.bounds
    assert end == again
    assert last == rows.time_s.size
    assert rows.time_s[again] == pytest.approx(3.4)
    assert set(rows.folds.block[begin:end]).isdisjoint(rows.folds.block[again:last])


def test_the_acceleration_of_the_rows_is_that_of_the_motion():
    record, filter_ = planted(duration_s=8.0), make_filter(PERIOD_S)
    time_s = np.arange(record.samples) * PERIOD_S
    record = replace(record, position_rev=2.0 * np.sin(2.0 * np.pi * 1.5 * time_s))
    rows = rows_from(record, filter_)
    kept = rows.kept
    wanted = -2.0 * (3.0 * np.pi) ** 2 * np.sin(3.0 * np.pi * rows.time_s)
    assert rows.acceleration_rps2[kept] == pytest.approx(wanted[kept], abs=0.01 * np.abs(wanted).max())
    assert rows.velocity_rps[kept] == pytest.approx(
        6.0 * np.pi * np.cos(3.0 * np.pi * rows.time_s)[kept], abs=0.01 * 6.0 * np.pi
    )
    assert second_difference(np.array([0.0, 1.0, 4.0, 9.0]), 0.5) == pytest.approx([0.0, 8.0, 8.0, 0.0])
