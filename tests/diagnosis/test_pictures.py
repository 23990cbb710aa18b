"""Pictures of a diagnosis: intervals that hold, pieces of a reference that come again, channels before and after."""

from __future__ import annotations

import numpy as np
import pytest
from identification.synthetic import TRUTH, chirp_record

from fffo_drive.diagnosis.base import NAMES
from fffo_drive.diagnosis.fitting import Data, Fitted
from fffo_drive.diagnosis.pictures import bin_edges, ceiling, interval, picture, run_figures
from fffo_drive.diagnosis.rows import make_filter, rows_of, stretches_of
from fffo_drive.diagnosis.scenes import Effect
from fffo_drive.identification.dataset import Record

PERIOD_S = 0.0005


def moved_record(repeats=2):
    """A run whose reference is one piece of 4 s, again and again."""
    time_s = np.arange(round(4.0 / PERIOD_S)) * PERIOD_S
    piece = 3.0 * np.sin(2 * np.pi * 0.5 * time_s) + np.sin(2 * np.pi * 1.25 * time_s)
    reference = np.tile(piece, repeats)
    position = np.cumsum(reference) * PERIOD_S
    base = chirp_record(2.0)
    content = {**vars(base), "reference_rps": reference, "position_rev": position, "current_a": 0.1 * reference}
    return Record(**{**content, "velocity_rps": None, "name": "track"})


def seen(record):
    filter_ = make_filter(record.period_s)
    stretches = stretches_of([record], filter_)
    rows = rows_of(stretches, filter_)
    return Data(stretches, rows, rows.kept.astype(float), 1, np.zeros(len(NAMES)))


def model(residual, effects=()):
    return Fitted(TRUTH.copy(), tuple(effects), 1.0, residual, residual)


def test_what_repeats_is_distinguished_from_what_does_not():
    data = seen(moved_record(3))
    draw = np.random.default_rng(1)
    phase = 2 * np.pi * data.rows.time_s / 4.0
    repeated = 0.01 * np.sin(3 * phase)
    noise = 0.003 * draw.normal(size=phase.size)
    found = ceiling(data, model(repeated + noise), model(0.3 * repeated + noise))
    assert found.noise_rms_nm == pytest.approx(0.003, rel=0.15)
    assert found.repeatable_fraction == pytest.approx(0.5e-4 / (0.5e-4 + 9e-6), rel=0.1)
    assert found.explained_of_explainable == pytest.approx(1.0 - 0.09, abs=0.05)


def test_without_a_repeat_there_is_no_ceiling():
    data = seen(moved_record(1))
    found = ceiling(data, model(np.ones(data.rows.time_s.size)), model(np.ones(data.rows.time_s.size)))
    assert found.repeatable_fraction is None
    assert "repeated" in found.note


def test_intervals_of_a_mean_hold_also_where_windows_hang_together():
    draw = np.random.default_rng(2)
    inside = 0
    for _ in range(200):
        window = np.repeat(np.arange(60), 20)
        values = np.repeat(draw.normal(size=60), 20) + draw.normal(size=1200)  # a window has an error of its own
        mean, reach = interval(values, np.zeros(1200, np.int64), window, 1)
        inside += abs(mean[0]) < reach[0]
    assert 180 <= inside <= 199


def test_bins_cover_the_range_and_none_is_empty_of_meaning():
    values = np.concatenate([np.zeros(1000), np.linspace(0.0, 10.0, 1000)])
    edges = bin_edges(values)
    assert edges[0] == 0.0
    assert edges[-1] == 10.0
    assert (np.diff(edges) > 0.0).all()
    assert bin_edges(np.ones(5)).size == 2


def test_the_picture_of_a_wave_is_folded_onto_its_period_and_shows_what_the_effect_says():
    data = seen(moved_record(3))
    effect = Effect("cogging", {"order": 2.0}, {"cos_nm": np.array([0.01]), "sin_nm": np.array([0.0])})
    shown = picture(data, model(np.zeros(data.rows.time_s.size), [effect]), 0)
    without, after, says = shown.curves
    assert "periods of 0.5 rev" in shown.x_label
    assert 0.0 <= says.x.min() < says.x.max() <= 1.0
    assert without.y == pytest.approx(says.y, abs=1e-12)  # nothing else is left: the effect's torque put back
    assert after.y == pytest.approx(np.zeros(after.y.size))
    assert np.corrcoef(says.y, np.cos(2 * np.pi * says.x))[0, 1] > 0.95


def test_friction_that_varies_over_the_angle_is_shown_against_the_motion_and_not_as_its_mean_of_both_directions():
    data = seen(moved_record(3))
    effect = Effect("friction_ripple", {"order": 2.0}, {"cos_share": np.array([0.3]), "sin_share": np.array([0.0])})
    without, _, says = picture(data, model(np.zeros(data.rows.time_s.size), [effect]), 0).curves
    assert without.y == pytest.approx(says.y, abs=1e-12)
    assert np.corrcoef(says.y, np.cos(2 * np.pi * says.x))[0, 1] > 0.9
    level_nm = TRUTH[NAMES.index("coulomb_nm")]
    assert 0.3 * level_nm < np.ptp(says.y) < 1.2 * level_nm  # at most twice 0.3 of Fs


def test_the_residual_over_time_keeps_its_extremes():
    data = seen(moved_record(3))
    residual = np.zeros(data.rows.time_s.size)
    place = int(np.flatnonzero(data.rows.kept)[50])
    residual[place] = 0.5
    (figure,) = run_figures(data, model(residual), model(0.1 * residual), "held_out")
    assert figure.before_high_nm.max() == 0.5
    assert figure.after_high_nm.max() == pytest.approx(0.05)
    assert figure.role == "held_out"
