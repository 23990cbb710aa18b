"""The fit of base and effects together: right slopes, the truth of a known axis, and a prior where data say nothing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnosis.planted import TRUTH, based, effect, left, nothing, runs

from fffo_drive.diagnosis.base import BASE, NAMES, moved
from fffo_drive.diagnosis.fitting import (
    HIDDEN,
    STEEPEST,
    changed,
    evaluate,
    fit,
    jacobian,
    slots_of,
    standard_deviations,
    stepped,
    with_levels,
)
from fffo_drive.identification.criterion import unseen_loss
from fffo_drive.least_squares import huber

OFFSET_NM = 0.006
TOLERANCES = {
    "inertia_nm_s2_per_rev": 0.01, "viscous_nm_per_rps": 0.05, "coulomb_nm": 0.05, "static_nm": 0.1,
    "stribeck_velocity_rps": 0.3, "stiffness_per_rev": 0.15, "attraction_nm_per_rev": 0.2,
}  # fmt: skip


@cache
def axis():
    """(data, base) of two runs without an effect."""
    return based(runs(nothing, nothing))


@cache
def offset_axis():
    """(data, base) of two runs with a constant torque."""

    def constant(motion):
        return np.full(motion.time_s.size, OFFSET_NM)

    return based(runs(constant, constant, duration_s=8.0))


def test_the_base_of_a_known_axis_is_recovered():
    _, base = axis()
    for name, tolerance in TOLERANCES.items():
        k = NAMES.index(name)
        assert base.physical[k] == pytest.approx(TRUTH[k], rel=tolerance), name
    assert base.physical[NAMES.index("delay_s")] == pytest.approx(0.002, abs=1e-4)


def test_a_constant_torque_is_fitted_beside_the_base():
    data, base = offset_axis()
    found = fit(data, base.physical, [effect("torque_offset", {"torque_nm": 0.0})])
    assert found.effects[0].strengths["torque_nm"][0] == pytest.approx(OFFSET_NM, rel=0.05)
    assert found.loss < 0.5 * base.loss
    again, _ = evaluate(data, found.physical, found.effects)
    assert np.array_equal(again.residual_nm, found.residual_nm)
    assert again.loss == found.loss


EFFECTS = (
    effect("torque_offset", {"torque_nm": 0.003}),
    effect("asymmetric_coulomb", {"share": 0.1}),
    effect("cogging", {"cos_nm": 0.004, "sin_nm": -0.002}, order=3.0),
    effect("coulomb_drift", {"share": -0.2}, tau_s=9.0),
    effect("current_lag", {"share": 0.5}, tau_s=0.003),
)


@pytest.mark.parametrize("one", EFFECTS, ids=lambda one: one.name)
def test_the_jacobian_is_the_slope_of_the_residual(one):
    """Of every number of the effect, and of the base where the effect is made from it."""
    data, _ = axis()
    fitted, _ = evaluate(data, TRUTH, [one])
    matrix = jacobian(data, fitted)
    numbers = slots_of([one], data.rows.turns)
    assert matrix.shape == (data.used.size, len(BASE) + len(numbers))
    for k, slot in enumerate(numbers):
        step = 0.2 * slot.step
        ahead, back = (evaluate(data, TRUTH, changed([one], slot, s * step))[0].white for s in (1.0, -1.0))
        close(matrix[:, len(BASE) + k], (back - ahead) / (2.0 * step), slot.name)
    for name, step in (("inertia_nm_s2_per_rev", 0.01), ("coulomb_nm", 0.01), ("delay_s", 2e-4)):
        ahead, back = (evaluate(data, moved(TRUTH, name, s * step), [one])[0].white for s in (1.0, -1.0))
        close(matrix[:, BASE.index(name)], (back - ahead) / (2.0 * step), name)


def close(column, slope, name):
    error = np.sqrt(np.mean((column - slope) ** 2))
    assert error < 0.05 * np.sqrt(np.mean(slope**2)), name


def test_the_prior_holds_what_the_data_do_not_determine():
    """Rows that say next to nothing leave every parameter where the fits begin; rows that say much do not."""
    data, _ = axis()
    start = TRUTH
    for name in ("viscous_nm_per_rps", "stiffness_per_rev", "stribeck_velocity_rps"):
        start = moved(start, name, 0.4)
    fitted = fit(data._replace(start=start), TRUTH, (), iterations=8).physical
    silent = fit(data._replace(start=start, weight=1e-5 * data.weight), TRUTH, (), iterations=8).physical
    for name in ("viscous_nm_per_rps", "stiffness_per_rev", "stribeck_velocity_rps"):
        k = NAMES.index(name)
        assert silent[k] == pytest.approx(start[k], rel=0.02), name
        assert abs(np.log(fitted[k] / TRUTH[k])) < 0.2, name


def test_a_step_stays_within_what_an_axis_can_be():
    far = stepped(TRUTH, np.full(len(BASE), 100.0))
    assert far[NAMES.index("inertia_nm_s2_per_rev")] == pytest.approx(TRUTH[0] * np.exp(0.5))
    assert far[NAMES.index("delay_s")] <= 0.1
    steep = np.zeros(len(BASE))
    steep[BASE.index("coulomb_nm")] = -0.5
    found = stepped(moved(TRUTH, "static_nm", 1.0), steep)
    static, coulomb = found[NAMES.index("static_nm")], found[NAMES.index("coulomb_nm")]
    assert coulomb >= static / STEEPEST
    assert stepped(TRUTH, -steep * 2.0)[NAMES.index("static_nm")] >= stepped(TRUTH, -steep * 2.0)[3]
    fast = np.zeros(len(BASE))
    fast[BASE.index("viscous_nm_per_rps")] = 0.5
    viscous = TRUTH[NAMES.index("viscous_nm_per_rps")]
    for most, wanted in (
        (np.inf, np.exp(0.5)),
        (1.2 * viscous, 1.2),
        (0.5 * viscous, 1.0),
    ):  # what the torque has room for
        reached = stepped(TRUTH, fast, BASE, most)[NAMES.index("viscous_nm_per_rps")]
        assert reached == pytest.approx(wanted * viscous)


def test_the_loss_of_unseen_rows_is_a_little_above_that_of_the_fit():
    data, base = axis()
    loss = unseen_loss(base.white, jacobian(data, base), data.folds)
    assert loss.size == data.used.size
    assert huber(base.white).mean() < loss.mean() < 1.1 * huber(base.white).mean()


def test_noise_has_a_level_of_its_own_in_each_class_of_speed_and_in_presliding():
    data, base = axis()
    speed = np.abs(data.rows.velocity_rps)
    travel = data.rows.joined(np.asarray(s.rest, float) for s in data.stretches)
    assert travel.size == speed.size
    fast = speed > 0.6 * np.quantile(speed, 0.99)
    draw = np.random.default_rng(3)
    noise = left(data, base, np.where(fast, 0.02, 0.0) * draw.normal(size=speed.size))
    weight = with_levels(data, noise).weight
    plain = data.weight
    kept = data.rows.kept
    assert 1.0 / np.median(weight[kept & fast]) == pytest.approx(0.02, rel=0.2)
    slow = kept & (speed < 0.1 * speed.max()) & (speed > 1.0)
    assert np.median(weight[slow] / plain[slow]) == pytest.approx(1.0, abs=0.05)
    near = kept & (speed < 0.3)
    assert np.unique(np.round(weight[near], 6)).size > 1  # presliding apart


def test_only_the_datum_is_fitted_where_that_is_asked():
    data, base = offset_axis()
    strengths = {"cos_nm": np.full(data.runs, 1e-3), "sin_nm": np.zeros(data.runs)}
    wave = replace(effect("cogging", {}, order=3.03), strengths=strengths, per_run=frozenset(strengths))
    offset = effect("torque_offset", {"torque_nm": 0.0})  # the truth has one
    found = fit(data, base.physical, [wave, offset], datum_alone=True)
    assert found.physical is base.physical
    assert found.effects[0].shapes == wave.shapes
    assert found.effects[1].strengths["torque_nm"][0] == 0.0
    assert (found.effects[0].strengths["cos_nm"] != 1e-3).all()


def test_strengths_stay_in_their_bounds():
    share = effect("elasticity", {"share": 0.85}, frequency_hz=40.0, damping=0.03)
    slot = next(s for s in slots_of([share], 1.0) if s.name == "share")
    assert changed([share], slot, 5.0)[0].strengths["share"][0] == 0.9


def test_the_deviation_of_a_parameter_is_that_of_fits_of_other_noise():
    data, base = offset_axis()
    one = effect("torque_offset", {"torque_nm": OFFSET_NM})
    fitted = fit(data, base.physical, [one])
    sd = standard_deviations(data, fitted)[-1]
    found = []
    draw = np.random.default_rng(5)
    block = data.rows.folds.block
    matrix = jacobian(data, fitted)
    for _ in range(60):  # what whole blocks have in common moves the estimate; linear, about the fit
        signs = draw.choice([-1.0, 1.0], block.max() + 1)[block[data.used]]
        found.append(np.linalg.lstsq(matrix, fitted.white * signs, rcond=1e-8)[0][-1])
    assert sd == pytest.approx(np.std(found), rel=0.4)


def test_what_is_too_small_to_be_determined_doubts_a_parameter_by_the_torque_that_it_shows_itself_with():
    """A constant torque, known by nothing else, may be wrong by a hidden constant torque."""
    data, base = offset_axis()
    fitted = fit(data, base.physical, [effect("torque_offset", {"torque_nm": OFFSET_NM})])
    even = data._replace(weight=np.where(data.weight > 0.0, 100.0, 0.0))
    alone = even.white(np.ones((data.rows.time_s.size, 1)))
    noise = standard_deviations(even, fitted, alone)
    for hidden_nm in (1e-6, 1e-3, 1.0):
        sd = standard_deviations(even, fitted, alone, hidden_nm)
        assert sd[0] == pytest.approx(np.hypot(noise[0], HIDDEN * hidden_nm))
