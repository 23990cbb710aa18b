"""The proof on held-out runs: one yardstick, a datum found on the first part, and what does worse is reported."""

from functools import cache

import numpy as np
import pytest
from diagnosis.planted import PERIOD_S, based, effect, left, nothing, planted, runs

from fffo_drive.diagnosis.fitting import Fitted, fit
from fffo_drive.diagnosis.proof import (
    DATUM_MOST,
    DATUM_SHARE,
    HISTORY_SHARE,
    Proof,
    data_of,
    error_figures,
    velocity_squares,
    with_own_datum,
)
from fffo_drive.diagnosis.rows import make_filter, rows_of, stretches_of
from fffo_drive.diagnosis.scenes import Effect

OFFSET_NM = 0.006
WAVE_NM = 0.005
ORDER = 3.0


def constant(motion):
    return np.full(motion.time_s.size, OFFSET_NM)


def wave(phase_rev):
    return lambda motion: WAVE_NM * np.cos(2.0 * np.pi * (ORDER * motion.position_rev - phase_rev))


@cache
def fitted(load=constant, name="torque_offset"):
    """(data, base, fit with the offset) of the fit runs."""
    data, base = based(runs(load, load, duration_s=8.0))
    return data, base, fit(data, base.physical, [effect(name, {"torque_nm": 0.0})])


@cache
def held_out(load=constant):
    return tuple(runs(load, load, seed=11, duration_s=8.0))


def proof_of(model, base=None, ladder=None, records=None):
    _, own, _ = fitted()
    base = own if base is None else base
    return Proof(list(records or held_out()), make_filter(PERIOD_S), base, ladder or base, model)


def with_offset(torque_nm):
    _, base, _ = fitted()
    return base._replace(effects=(effect("torque_offset", {"torque_nm": torque_nm}),))


def test_the_truth_does_better_and_is_not_worse():
    proof = proof_of(fitted()[2])
    assert proof.worse() == ""
    assert proof.after.torque_rms_nm.value < 0.6 * proof.before.torque_rms_nm.value
    assert proof.after.velocity_rms_rps.value < 1.02 * proof.before.velocity_rms_rps.value
    own = proof.gain_over(proof.without(0))
    assert own.holds
    assert own.value > 100.0


@pytest.mark.parametrize("torque_nm", [-OFFSET_NM, 3.0 * OFFSET_NM, np.nan])
def test_a_model_whose_error_in_torque_is_no_smaller_does_worse(torque_nm):
    assert "torque" in proof_of(with_offset(torque_nm)).worse()


def test_a_model_that_is_better_in_torque_and_worse_in_velocity_does_worse():
    """What it leaves is less, and keeps its sign for an eighth of a second at a time: it drives the axis away."""
    proof = proof_of(fitted()[2])
    rows = proof.data.rows
    sign = np.where(np.floor(rows.time_s / 0.125) % 2.0, 1.0, -1.0)
    size = 0.7 * np.sqrt(np.mean(proof.base.residual_nm[rows.kept] ** 2))
    proof.fitted = left(proof.data, proof.fitted, size * sign - proof.fitted.residual_nm)
    proof.ladder = left(proof.data, proof.ladder, np.random.default_rng(4).normal(0.0, size, sign.size))
    proof.after = proof.figures(proof.fitted, proof.scored)
    assert proof.after.torque_rms_nm.value < proof.before.torque_rms_nm.value
    assert "velocity" in proof.worse()


def test_a_run_of_gaps_has_no_window_and_its_velocity_decides_nothing():
    proof = proof_of(fitted()[2])
    proof.scored &= np.arange(proof.scored.size) % 2 == 0  # no two rows in succession
    assert velocity_squares(proof.data, proof.fitted, proof.inertia, proof.scored).size == 0
    assert proof.worse() == ""


def test_without_an_effect_nothing_is_worse_and_nothing_changes():
    _, base, _ = fitted()
    proof = proof_of(base)
    assert proof.worse() == ""
    assert proof.after is proof.before


def test_the_torque_that_is_needed_is_the_same_for_all_models():
    """No model gains by needing less: the percentage is the rms over the ladder's."""
    _, base, true = fitted()
    small = Fitted(*base)._replace(physical=base.physical * 0.5)
    small = small._replace(effects=(effect("torque_offset", {"torque_nm": OFFSET_NM}),))
    ratios = []
    for model in (true, small):
        proof = proof_of(model, ladder=true)
        ratios += [f.torque_relative_percent.value / f.torque_rms_nm.value for f in (proof.before, proof.after)]
    assert ratios == pytest.approx([ratios[0]] * 4, rel=1e-9)
    proof = proof_of(true, ladder=true)
    needed = np.sqrt(np.mean(proof.needed_nm[proof.data.rows.kept] ** 2))
    assert 100.0 / ratios[0] == pytest.approx(needed, rel=1e-9)


def test_the_error_in_velocity_is_what_the_torque_that_is_left_makes_of_a_window():
    data, base, _ = fitted()
    rows = data.rows
    kept = np.ones(rows.kept.size, bool)
    inertia = base.physical[0]
    steps = round(0.25 / rows.filter.row_period_s)
    constant_left = base._replace(residual_nm=np.full(rows.kept.size, 0.01))
    whole = data._replace(rows=rows._replace(kept=kept))
    assert velocity_squares(whole, constant_left, inertia, kept) == pytest.approx(
        0.0, abs=1e-12
    )  # it says nothing of a form
    ramp = base._replace(residual_nm=np.where(np.arange(kept.size) % steps < steps // 2, 0.01, -0.01))
    found = velocity_squares(whole, ramp, inertia, kept)
    peak = 0.01 / inertia * 0.125
    assert np.sqrt(found[:5]) == pytest.approx(peak / np.sqrt(3.0), rel=0.1)  # a triangle
    halved = kept.copy()
    halved[: kept.size // 2] = False
    assert 0 < velocity_squares(whole, ramp, inertia, halved).size < found.size


def test_the_first_hundredth_of_a_stretchs_travel_is_not_scored():
    _, base, _ = fitted(nothing)
    records, filter_ = held_out(), make_filter(PERIOD_S)
    before, after = rows_of(stretches_of(records, filter_), filter_), data_of(records, filter_, base.physical).rows
    for begin, end in after.bounds:
        travel = np.cumsum(np.abs(after.velocity_rps[begin:end]))
        known = travel >= HISTORY_SHARE * travel[-1]
        assert 0.0 < np.mean(~known) < 0.2
        assert not after.kept[begin:end][~known].any()
        assert (after.kept == before.kept)[begin:end][known].all()


def test_a_datum_is_found_on_the_first_part_of_a_run_and_the_rest_is_scored():
    """The phase differs from run to run, how large the wave is was learnt from the fit runs."""
    _, base, _ = fitted(nothing)
    model = base._replace(effects=(wave_effect(0.0, 0.25),))
    records = [
        planted(wave(phase), seed=seed, duration_s=8.0, name=str(seed), begin_s=10.0 * k)
        for k, (phase, seed) in enumerate(((0.4, 11), (0.85, 12)))
    ]
    data = data_of(records, make_filter(PERIOD_S), base.physical)
    found, scored = with_own_datum(data, model)
    strengths = found.effects[0].strengths
    phases = np.arctan2(strengths["sin_nm"], strengths["cos_nm"]) / (2.0 * np.pi)
    assert np.mod(phases, 1.0) == pytest.approx([0.4, 0.85], abs=0.03)
    assert np.hypot(strengths["cos_nm"], strengths["sin_nm"]) == pytest.approx([WAVE_NM] * 2, rel=1e-6)
    for begin, end in data.rows.bounds:
        part = scored[begin:end]
        first = int(np.argmax(part))
        assert not part[:first].any()
        assert part[first:].all()
        assert DATUM_SHARE <= (first + 1) / part.size <= DATUM_MOST + 0.01
    # the held-out runs have no offset, and do not take it out of the model
    offset = Effect("torque_offset", {}, {"torque_nm": np.array([WAVE_NM])})
    beside, _ = with_own_datum(data, model._replace(effects=(*model.effects, offset)))
    assert beside.effects[1].strengths["torque_nm"][0] == WAVE_NM
    assert beside.physical is base.physical
    # what lies behind the first part does not move the datum
    late = [np.where(scored, 0.0, data.weight)]
    again, _ = with_own_datum(data._replace(weight=late[0]), model)
    assert again.effects[0].strengths["cos_nm"] == pytest.approx(strengths["cos_nm"])


def wave_effect(*phases, size_nm=WAVE_NM):
    angle = 2.0 * np.pi * np.array(phases)
    strengths = {"cos_nm": size_nm * np.cos(angle), "sin_nm": size_nm * np.sin(angle)}
    return Effect("cogging", {"order": ORDER}, strengths, frozenset(strengths))


def test_without_a_datum_per_run_every_row_is_scored():
    _, scored = with_own_datum(data_of(held_out(), make_filter(PERIOD_S), fitted()[1].physical), fitted()[2])
    assert scored.all()


def test_intervals_are_of_whole_blocks():
    data, base, _ = fitted()
    draw = np.random.default_rng(2)
    count = data.rows.folds.block.max() + 1
    common = left(data, base, -base.residual_nm + draw.normal(size=count)[data.rows.folds.block])
    found = error_figures(data, common, np.ones(data.rows.kept.size), 1.0).torque_rms_nm
    assert found.low < found.value < found.high
    own = left(data, base, -base.residual_nm + draw.normal(size=data.rows.kept.size))
    other = error_figures(data, own, np.ones(data.rows.kept.size), 1.0).torque_rms_nm
    assert (found.high - found.low) > 3.0 * (other.high - other.low)
    assert found.value == pytest.approx(np.sqrt(np.mean(common.residual_nm[data.rows.kept] ** 2)))
