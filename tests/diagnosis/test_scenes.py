"""Effects along a motion: a wave's column is its kernel's at low order, and the truth where a kernel would alias."""

from functools import cache

import numpy as np
import pytest
from diagnosis.planted import PERIOD_S, TRUTH, effect, nothing, runs

from fffo_drive.diagnosis.base import balanced, models_along
from fffo_drive.diagnosis.fitting import Data, at_rest, consistent_scenes
from fffo_drive.diagnosis.rows import make_filter, rows_of, stretches_of
from fffo_drive.diagnosis.scenes import (
    Effect,
    commanded_load,
    effect_of,
    in_closed_form,
    load_along,
    load_rows,
    scenes_of,
    strength_columns,
    thinned,
    wave_columns,
    with_datum,
)
from fffo_drive.model.effects import slots
from fffo_drive.model.effects.table import Term

OFFSET_NM = 0.004


@cache
def seen():
    """(stretches, rows, scenes) of two runs under their true model."""
    filter_ = make_filter(PERIOD_S)
    stretches = balanced(stretches_of(runs(nothing, nothing, duration_s=8.0), filter_), TRUTH)
    rows = rows_of(stretches, filter_)
    return stretches, rows, scenes_of(stretches, TRUTH, models_along(stretches, TRUTH))


def by_kernel(rows, scenes, name, shapes, strength):
    """The column of one strength, from the law's kernel at the laws' rate."""
    parts = [load_along(scene, name, {**shapes, strength: 1e-3}) / 1e-3 for scene in scenes]
    return np.concatenate([rows.laws.rows(part) for part in parts])


@pytest.mark.parametrize(
    ("name", "shapes", "strengths", "tolerance"),
    [
        ("cogging", {"order": 0.5}, ("cos_nm", "sin_nm"), 0.04),
        ("unbalance", {"ratio": 4.0}, ("cos_nm", "sin_nm"), 0.04),
        ("torque_ripple", {"order": 0.5}, ("cos_share", "sin_share"), 0.04),
        ("friction_ripple", {"order": 0.5}, ("cos_share", "sin_share"), 0.06),
        ("friction_ripple", {"order": 2.0}, ("cos_share", "sin_share"), 0.08),
        ("friction_ripple", {"order": 8.0}, ("cos_share", "sin_share"), 0.2),
    ],
)
def test_at_low_order_the_closed_form_of_a_wave_is_its_kernel(name, shapes, strengths, tolerance):
    _, rows, scenes = seen()
    columns = wave_columns(rows, scenes, name, shapes)
    # near a reversal the friction is on its way, and follows no wave; a kernel's step is late where the axis is fast
    sliding = rows.kept & (np.abs(rows.velocity_rps) > 1.0) & (np.abs(rows.velocity_rps) < 4.0)
    for strength, column in zip(strengths, columns.T, strict=True):
        kernel = by_kernel(rows, scenes, name, shapes, strength)
        error = np.sqrt(np.mean((column - kernel)[sliding] ** 2) / np.mean(kernel[sliding] ** 2))
        assert error < tolerance


def test_friction_that_follows_its_level_late_makes_a_wave_smaller_and_later():
    """After a travel of level over attraction: of order 20 that is more than a radian."""
    _, rows, scenes = seen()
    slow = rows.kept & (np.abs(rows.velocity_rps) > 0.7) & (np.abs(rows.velocity_rps) < 1.2)
    late = wave_columns(rows, scenes, "friction_ripple", {"order": 20.0})[slow]
    gain = rows.filter.gain(20.0 * rows.velocity_rps[slow])
    assert np.hypot(*late.T) / gain == pytest.approx(0.027 / np.hypot(1.0, 1.35), rel=0.25)


def test_at_order_72_the_column_is_what_the_filter_leaves_and_nothing_folds_down():
    stretches, rows, scenes = seen()
    columns = wave_columns(rows, scenes, "cogging", {"order": 72.0})
    fine = 16
    truth, folded = [], []
    for stretch, scene in zip(stretches, scenes, strict=True):
        time_s = np.arange(stretch.samples) * stretch.law_period_s
        at_s = np.arange(stretch.samples * fine) * stretch.law_period_s / fine
        position = np.interp(at_s, time_s, stretch.smooth_rev)
        filter_ = make_filter(stretch.law_period_s / fine)
        step = rows.laws.step * fine
        wave = np.cos(2.0 * np.pi * 72.0 * position)
        half = filter_.taps.size // 2
        padded = np.convolve(np.pad(wave, half, mode="edge"), filter_.taps, mode="valid")
        truth.append(padded[::step])
        folded.append(rows.laws.rows(load_along(scene, "cogging", {"order": 72.0, "cos_nm": 1.0})))
    wanted = np.concatenate(truth)[: rows.time_s.size]
    kept = rows.kept
    size = np.sqrt(np.mean(wanted[kept] ** 2))
    assert np.sqrt(np.mean((columns[:, 0] - wanted)[kept] ** 2)) < 0.5 * size  # it speeds up within the filter's reach
    fast = kept & (np.abs(rows.velocity_rps) > 2.0)
    assert np.abs(columns[fast]).max() < 0.01
    assert np.sqrt(np.mean(np.concatenate(folded)[fast] ** 2)) > 0.1  # the trap: a kernel at the laws' rate


def test_friction_uses_its_kernel_where_that_has_samples_enough():
    _, rows, _ = seen()
    assert in_closed_form(rows, "cogging", {"order": 0.1})
    assert not in_closed_form(rows, "friction_ripple", {"order": 0.1})
    assert in_closed_form(rows, "friction_ripple", {"order": 30.0})
    assert not in_closed_form(rows, "torque_offset", {})


def test_a_wave_with_a_datum_of_its_own_in_each_run_is_the_sum_of_its_columns():
    _, rows, scenes = seen()
    shapes = {"order": 3.0}
    columns = with_datum(strength_columns(rows, scenes, "cogging", shapes), "cogging", rows)
    assert columns.names == ("cos_nm", "cos_nm", "sin_nm", "sin_nm")
    assert columns.runs == (0, 1, 0, 1)
    for run, column in zip(columns.runs, columns.values.T, strict=True):
        assert not column[rows.run != run].any()
        assert column[rows.run == run].any()
    strengths = np.array([1e-3, 2e-3, -3e-3, 5e-4])
    found = effect_of("cogging", shapes, columns, strengths, 2)
    assert found.per_run == {"cos_nm", "sin_nm"}
    assert found.values(1)["cos_nm"] == 2e-3
    assert load_rows(rows, scenes, found) == pytest.approx(columns.values @ strengths, abs=1e-15)


def test_a_datum_is_given_to_what_has_one_and_to_nothing_else():
    _, rows, scenes = seen()
    columns = with_datum(strength_columns(rows, scenes, "torque_offset", {}), "torque_offset", rows)
    assert columns.runs == (-1,)


def test_a_wave_keeps_its_phases_and_takes_one_size():
    phases, sizes = np.array([0.0, 1.0, 2.0]), np.array([3.0, 0.5, 2.0])
    strengths = {"cos_nm": sizes * np.cos(phases), "sin_nm": sizes * np.sin(phases)}
    wave = Effect("cogging", {"order": 4.0}, strengths, frozenset(strengths))
    assert wave.sizes() == pytest.approx([2.0])
    equal = wave.of_sizes(wave.sizes())
    assert equal.strengths["cos_nm"] == pytest.approx(2.0 * np.cos(phases))
    assert equal.strengths["sin_nm"] == pytest.approx(2.0 * np.sin(phases))
    assert effect("torque_offset", {"torque_nm": 1.0}).waves == []


def test_at_rest_nothing_acts_that_friction_does_not_balance():
    _, _, scenes = seen()
    still = scenes[0]._replace(moving=np.zeros(scenes[0].moving.size))
    assert not load_along(still, "torque_offset", {"torque_nm": 1.0}).any()
    assert load_along(scenes[0], "torque_offset", {"torque_nm": 1.0}).any()


def test_a_torque_at_rest_is_taken_from_what_friction_balances():
    stretches, rows, _ = seen()
    data = Data(stretches, rows, rows.kept.astype(float), 2, TRUTH)
    plain = at_rest(data, TRUTH, ())
    loaded = at_rest(data, TRUTH, [effect("torque_offset", {"torque_nm": OFFSET_NM})])
    for before, after in zip(plain.stretches, loaded.stretches, strict=True):
        assert np.allclose(before.balance_nm - after.balance_nm, OFFSET_NM)
    level = at_rest(data, TRUTH, [effect("asymmetric_coulomb", {"share": 0.1})])  # a level holds, it does not act
    assert level.stretches[0].balance_nm == pytest.approx(plain.stretches[0].balance_nm)


def test_laws_of_the_torque_see_what_the_model_wants_and_never_the_residual():
    """What is left of the command after the base is the residual: a column that carries it explains itself."""
    stretches, rows, scenes = seen()
    noisy = [s._replace(current_a=s.current_a + 0.1) for s in stretches]
    again = scenes_of(noisy, TRUTH, models_along(noisy, TRUTH))
    ripple = effect("torque_ripple", {"cos_share": 0.1}, order=2.0)
    assert load_rows(rows, again, ripple) == pytest.approx(load_rows(rows, scenes, ripple), abs=1e-12)
    assert again[0].commanded.mean() == pytest.approx(scenes[0].commanded.mean() + 0.1, abs=1e-3)
    data = Data(stretches, rows, rows.kept.astype(float), 2, TRUTH)
    # ... with the effects that are accepted in it, apart from those that answer to it
    offset = effect("torque_offset", {"torque_nm": OFFSET_NM})
    loaded = consistent_scenes(data, TRUTH, [offset, effect("load_dependent_friction", {"share": 0.1})])
    change = loaded[0].motion[:, slots.CURRENT_A] - scenes[0].motion[:, slots.CURRENT_A]
    moving = scenes[0].moving > 0.0
    assert change[moving] == pytest.approx(OFFSET_NM / stretches[0].torque_constant_nm_per_a)
    assert consistent_scenes(data, TRUTH, [offset])[0].motion == pytest.approx(scenes[0].motion)


def test_what_acts_on_the_command_is_made_at_the_rate_of_the_record():
    _, _, scenes = seen()
    scene = scenes[0]
    ripple = np.zeros(scene.commanded.size)
    ripple[::2] = 0.2  # noise at half the record's rate: half of it is cut by a limit, on average
    at_rate = commanded_load(
        scene._replace(commanded=1.0 + ripple), [Term("dead_zone", {"lost_nm": 0.01, "width_a": 1.1})]
    )
    assert at_rate.size == scene.stretch.samples
    assert thinned(np.ones(100), 4) == pytest.approx(np.ones(25))
    fast = np.cos(np.pi * np.arange(4000))
    assert np.abs(thinned(fast, 4)[10:-10]).max() < 0.01  # ... and does not fold down
