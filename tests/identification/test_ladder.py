"""The first rungs: what is there comes out with its size, and what is not there does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification.balance import BOTH_WAYS, COULOMB, INERTIA, TURN, balance_record
from identification.rig import random_plant, record
from identification.synthetic import AXIS, PERIOD_S, TRUTH, chirp_record, record_of

from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig
from fffo_drive.identification.criterion import Gain
from fffo_drive.identification.excitation import identification_sequence, separating_recipe
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.identification.fit import FitSettings, fit_records
from fffo_drive.identification.ladder import AcceptedEffect, EffectCandidate, climb, stands
from fffo_drive.identification.regression import regression_start
from fffo_drive.identification.results import ends_of_interval, model_file, reach_of

OTHER_WAYS = ((5.0, 0.23, 1.0), (2.0, 1.1, 0.0), (0.6, 3.9, 2.0))
FACTS = DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=8.3, pole_pairs=7, slots=12)


def climbed(records, facts=FACTS):
    return climb(records, regression_start(records), facts)


def names(ladder):
    return [(one.candidate.name, round(one.candidate.order, 6)) for one in ladder.accepted]


def wave(order, cosine, sine, phase=0.0):
    def load(time_s, position_rev, velocity_rps):
        angle = TURN * (order * position_rev + phase)
        return cosine * np.cos(angle) + sine * np.sin(angle)

    return load


def test_a_constant_torque_is_the_lowest_rung():
    ladder = climbed([balance_record("a", load=lambda t, p, v: 0.004 + 0.0 * t)])
    assert names(ladder) == [("torque_offset", 0.0)]
    (one,) = ladder.accepted
    assert one.coefficients == pytest.approx([0.004], rel=0.01)
    assert one.gain.holds
    assert one.p < 1e-6
    assert one.start(1).values == pytest.approx({"torque_nm": 0.004}, rel=0.01)


def test_friction_that_differs_by_direction_with_speed_is_no_constant_torque():
    ladder = climbed([balance_record(n, sines=s, load=lambda t, p, v: 6e-4 * np.abs(v)) for n, s in
                      (("a", BOTH_WAYS), ("b", OTHER_WAYS))])  # fmt: skip
    assert names(ladder) == [("asymmetric_viscous", 0.0)]
    assert ladder.accepted[0].coefficients == pytest.approx([6e-4], rel=0.02)


@pytest.mark.parametrize(("share", "possible"), [(-0.9, True), (0.9, True), (1.15, False), (-1.15, False)])
def test_friction_that_would_push_in_one_direction_is_rejected(share, possible):
    # two columns that are nearly one: chirps of axis 7522 of the chain gave -45 mNm and +115 % of Fc for a
    # constant torque of -11 mNm, and the fit that began there ended at 60 times the loss
    candidate = EffectCandidate(1, "asymmetric_coulomb", ("share",), {}, 0.0, False)
    assert (
        stands(AcceptedEffect(candidate, np.array([share]), Gain(84.0, 30.0, np.full(8, 10.5)), 0.003, 0.06))
        is possible
    )


def test_gravity_at_the_order_that_is_declared():
    facts = FACTS.model_copy(update={"gear_ratio": 4.0})
    ladder = climbed([balance_record("a", load=wave(0.25, 0.01, 0.02))], facts)
    assert names(ladder) == [("unbalance", 0.25)]
    start = ladder.accepted[0].start(1)
    assert start.values["ratio"] == 4.0
    assert [start.values[n] for n in ("cos_nm", "sin_nm")] == pytest.approx([0.01, 0.02], rel=0.02)
    assert ladder.start.inertia_nm_s2_per_rev == pytest.approx(INERTIA, rel=0.015)


@pytest.mark.parametrize("order", [7.0, 12.0, 19.0, 84.0])
def test_a_wave_of_any_order_that_the_slow_part_shows(order):
    """84 is lcm(12, 14); at 6 rps it is passed at 500 Hz, far beyond the filter, and at rest's edge slowly."""
    load = wave(order, 0.2 * COULOMB, -0.1 * COULOMB)
    ladder = climbed([balance_record("a", load=load), balance_record("b", sines=OTHER_WAYS, load=load)])
    assert names(ladder) == [("cogging", order)]
    assert not ladder.accepted[0].candidate.per_run  # one phase says it
    found = ladder.accepted[0].coefficients
    assert np.hypot(*(found - [0.2 * COULOMB, -0.1 * COULOMB])) < 0.05 * COULOMB


def test_a_phase_for_each_run_where_their_zeros_differ():
    runs = [
        balance_record("a", load=wave(12.0, 0.2 * COULOMB, 0.0)),
        balance_record("b", sines=OTHER_WAYS, load=wave(12.0, 0.2 * COULOMB, 0.0, 0.25)),
    ]
    ladder = climbed(runs)
    assert names(ladder) == [("cogging", 12.0)]
    assert ladder.accepted[0].candidate.per_run
    start = ladder.accepted[0].start(2)
    assert start.per_run["cos_nm"] == pytest.approx((0.2 * COULOMB, 0.0), abs=0.02 * COULOMB)
    assert start.per_run["sin_nm"] == pytest.approx((0.0, -0.2 * COULOMB), abs=0.02 * COULOMB)


@pytest.mark.parametrize("cogging", [0.0, 0.2])
def test_an_error_of_the_sensor_is_no_wave_of_the_torque(cogging):
    """It grows with the square of the speed, and a wave of the torque of the same order beside it does not."""
    angle = [2e-4, -1e-4, 5e-4, 3e-4]

    def sensor_rev(position_rev):
        first, second = np.exp(2j * np.pi * position_rev), np.exp(4j * np.pi * position_rev)
        return angle[0] * first.real + angle[1] * first.imag + angle[2] * second.real + angle[3] * second.imag

    load = wave(2.0, cogging * COULOMB, 0.0)
    ladder = climbed(
        [balance_record(n, sines=s, sensor_rev=sensor_rev, load=load) for n, s in (("a", BOTH_WAYS), ("b", OTHER_WAYS))]
    )
    expected = [("cogging", 2.0)] * bool(cogging) + [("resolver_error", 1.0)]
    assert sorted(names(ladder)) == expected
    found = next(one for one in ladder.accepted if one.candidate.name == "resolver_error")
    assert found.candidate.strengths == ("cos1_rev", "sin1_rev", "cos2_rev", "sin2_rev")
    for run in found.coefficients.reshape(-1, 4):
        assert run == pytest.approx(angle, abs=2.0 * 2.0**-15)  # two counts of the sensor
    assert ladder.start.inertia_nm_s2_per_rev == pytest.approx(INERTIA, rel=0.01)


def test_one_way_a_constant_torque_is_not_claimed():
    ladder = climbed(
        [balance_record("a", 4.0, ((2.0, 0.31, 0.0), (0.8, 2.3, 1.0)), load=lambda t, p, v: 0.004 + 0 * t)]
    )
    assert ladder.accepted == ()


def test_no_rung_holds_where_nothing_is():
    found = [
        name
        for seed in range(10)
        for name in names(
            climbed([balance_record("a", seed=seed), balance_record("b", sines=OTHER_WAYS, seed=50 + seed)])
        )
    ]
    assert found == []


@pytest.mark.slow
def test_no_rung_holds_on_the_plant_without_effects():
    """Resolver, current loop and 2SEP friction with other parameters each time: ten axes."""
    found = []
    for seed in range(10):
        plant = random_plant(seed)
        runs = [
            record(plant, identification_sequence(30.0, PERIOD_S, 0.3, 1.1, 0.05, 10.0), "identify"),
            record(plant, separating_recipe(PERIOD_S, 14.0, 150.0, 1), "recipe"),
        ]
        found += names(climbed(runs))
    assert found == []


@pytest.mark.slow
def test_a_constant_torque_does_not_bend_the_inertia():
    """15 % of Fc: J's interval holds the truth, and does not where the constant torque is left out."""
    offset_nm = 0.15 * AXIS.friction.coulomb_nm
    base = chirp_record(40.0)
    moved = record_of(base.current_a - offset_nm / 0.148, lsb_rev=2.0**-15, noise_rev=1e-5)
    seen = replace(moved, current_a=base.current_a)
    fit = fit_records([seen], FitSettings(compare_literal=False), FACTS)
    assert [effect.name for effect in fit.effects] == ["torque_offset"]
    low, high = ends_of_interval("inertia_nm_s2_per_rev", fit.physical[0], reach_of(fit) * fit.uncertainty.sd[0])
    assert low < TRUTH[0] < high
    effect = fit.effects[0]
    assert abs(effect.values["torque_nm"] - offset_nm) < 3.0 * effect.sd["torque_nm"]
    assert effect.sd["torque_nm"] < 0.1 * offset_nm
    (written,) = model_file(fit, [seen], "axis").effects
    assert written.name == "torque_offset"
    assert written.parameters["torque_nm"].sd == effect.sd["torque_nm"]
    bent = fit_records([seen], FitSettings(compare_literal=False, effects=()), FACTS)
    assert abs(bent.physical[0] - TRUTH[0]) > abs(fit.physical[0] - TRUTH[0])


PLANT = PlantConfig()
SHORT_STROKES = identification_sequence(60.0, 5e-4, 0.3, 0.7, 0.01, 10.0)  # the paper's, with little current
SWINGING = EffectConfig("elasticity", {"load_share": 0.35, "frequency_hz": 110.0, "damping": 0.03})
COGGING = EffectConfig("cogging", {"amplitude_nm": 0.006})


@pytest.mark.parametrize("effects", [(), (SWINGING,)], ids=["rigid", "elastic"])
def test_a_contact_that_yields_in_short_strokes_is_no_cogging(effects):
    """Order 51 was found in both, with 7.5 mNm: a stroke of less than a period is a spring to either."""
    assert "cogging" not in {
        name for name, _ in names(climbed([record(replace(PLANT, effects=effects), SHORT_STROKES)]))
    }


@pytest.mark.parametrize("effects", [(COGGING,), (COGGING, SWINGING)], ids=["rigid", "elastic"])
def test_cogging_of_a_drive_is_found_in_the_strokes_in_which_it_comes_back(effects):
    ladder = climbed([record(replace(PLANT, effects=effects), SHORT_STROKES)])
    assert ("cogging", 12.0) in names(ladder)
    (one,) = [one for one in ladder.accepted if one.candidate.name == "cogging"]
    assert float(np.hypot(*one.coefficients)) == pytest.approx(0.006, rel=0.15)
