"""What a law says of itself is what its kernel does: on what it acts, over which period it folds, how its wave goes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fffo_drive.model.axis import AxisConfig
from fffo_drive.model.effects import slots as s
from fffo_drive.model.effects.law import SHAPE, STRENGTH, SearchContext, motor_orders
from fffo_drive.model.effects.registry import LAWS
from fffo_drive.model.effects.table import Term, effects_along
from fffo_drive.model.friction import OMEGA_CLIPPED, FrictionConfig

STEP_S = 2e-3
AXIS = AxisConfig(9.4e-4, 0.148, 0.00275, FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, OMEGA_CLIPPED))
NAMES = [name for name in LAWS if name != "lookup"]
SHAPES = {
    "position_dependent_friction": {"period_rev": 3.0, "centre_rev": 0.5, "width_rev": 1.0},
    "torque_saturation": {"knee_a": 1.0},
    "voltage_limit": {"stall_nm": 0.1, "no_load_rps": 20.0},
    "unbalance": {"ratio": 4.0},
    "periodic_disturbance": {"frequency_hz": 1.5},
}
TIME_S = np.arange(4500) * STEP_S
FALLING = math.exp(-((1.0 / AXIS.friction.stribeck_velocity_rps) ** AXIS.friction.stribeck_exponent))
LEVEL_NM = AXIS.friction.coulomb_nm + (AXIS.friction.static_nm - AXIS.friction.coulomb_nm) * FALLING  # at 1 rps
LOW_RPS, TOP_RPS, PERIOD_S = 0.2, 15.0, 1e-3


def context(**facts):
    values = {
        "duration_s": 60.0, "period_s": PERIOD_S, "lowest_rps": 0.05, "highest_rps": TOP_RPS, "low_rev": -20.0,
        "high_rev": 20.0, "highest_current_a": 2.0, "highest_torque_nm": 0.3, "coulomb_nm": 0.025, "static_nm": 0.067,
        "stiffness_per_rev": 778.0, "attraction_nm_per_rev": 2.33,
    }  # fmt: skip
    return SearchContext(**values, **facts)


def motion(current_a=0.4):
    """Steady sliding at 1 rps, on the Stribeck curve, under any current."""
    time_s = TIME_S
    rows = np.zeros((time_s.size, s.N_MOTION))
    rows[:, s.TIME_S], rows[:, s.VELOCITY_RPS], rows[:, s.DIRECTION] = time_s, 1.0, 1.0
    rows[:, s.ACCELERATION_RPS2] = np.sin(20.0 * time_s)
    rows[:, s.MOTOR_ANGLE_REV] = rows[:, s.SENSOR_ANGLE_REV] = rows[:, s.TRAVEL_REV] = time_s
    rows[:, s.FRICTION_NM] = LEVEL_NM + AXIS.friction.viscous_nm_per_rps
    rows[:, s.CURRENT_A] = current_a
    return rows


def along(name, rows):
    values = {**SHAPES.get(name, {}), **{p.name: p.typical for p in LAWS[name].strengths}}
    return effects_along([Term(name, values)], rows, AXIS, STEP_S, feedforward=True)[0]


@pytest.mark.parametrize("name", NAMES)
def test_a_law_of_the_motion_does_not_see_the_torque_and_all_others_do(name):
    one, other = (along(name, motion(size * (0.5 + np.sin(9.0 * TIME_S)))) for size in (0.3, 1.1))
    assert np.array_equal(one, other) == (LAWS[name].acts_on == "motion")


@pytest.mark.parametrize("name", [name for name in NAMES if LAWS[name].fold(LAWS[name].filled(SHAPES.get(name, {})))])
def test_a_folded_effect_comes_again_after_its_period(name):
    law = LAWS[name]
    signal, period = law.fold(law.filled(SHAPES.get(name, {})))
    rows = motion()
    if name == "position_dependent_friction":  # its wave alone
        values = {"cos_share": 0.1, "period_rev": 3.0}
        load = effects_along([Term(name, values)], rows, AXIS, STEP_S)[0]
    else:
        load = along(name, rows)
    place = rows[:, {"motor_angle": s.MOTOR_ANGLE_REV, "time": s.TIME_S}[signal]]
    shifted = np.interp(place + period, place, load)
    settled = (place > 0.5) & (place < place[-1] - period)
    assert np.ptp(load[settled]) > 0.0
    assert shifted[settled] == pytest.approx(load[settled], abs=1e-3 * np.abs(load).max())
    half = np.interp(place + 0.5 * period, place, load)
    assert np.abs(half - load)[settled].max() > 0.5 * np.ptp(load[settled])


@pytest.mark.parametrize("order", [1.0, 12.0])
@pytest.mark.parametrize("name", [name for name in NAMES if LAWS[name].wave])
def test_the_column_of_a_wave_is_a_cosine_and_a_sine_times_what_it_says(name, order):
    """That of the friction's level comes late: dF/dx = rate / level (level - F) gives 1 / (1 + i 2 pi N length)."""
    law = LAWS[name]
    shape = {p.name: 1.0 / order if p.span else order for p in law.shapes}
    rows = motion()
    f = AXIS.friction
    length_rev = (LEVEL_NM + f.viscous_nm_per_rps) / f.attraction_nm_per_rev if law.wave == "friction" else 0.0
    size = {"plain": 1.0, "torque": AXIS.torque_constant_nm_per_a * 0.4, "friction": LEVEL_NM}[law.wave]
    turns = 2j * math.pi * order
    wave = size * np.exp(turns * rows[:, s.MOTOR_ANGLE_REV]) / (1.0 + turns * length_rev)
    late = rows[:, s.MOTOR_ANGLE_REV] > 1.0
    for strength, unit in zip(law.strengths, (wave.real, wave.imag), strict=True):
        load = effects_along([Term(name, {**shape, strength.name: 0.01})], rows, AXIS, STEP_S)[0]
        assert load[late] == pytest.approx(0.01 * unit[late], abs=1e-4 * np.abs(wave).max())


def test_what_a_law_says_of_its_parameters_fits_together():
    for name, law in LAWS.items():
        for p in law.parameters:
            low, high = p.plausible or (p.low, p.high)
            assert p.low <= low < high <= p.high, (name, p.name)
            assert not (p.held or p.span or p.logarithmic) or p.kind == SHAPE
            assert not (p.held or p.span or p.logarithmic) or p.low >= 0.0 or name == "lookup"
            assert not p.needs or p.needs in {shape.name for shape in law.shapes}
            assert p.held or p.step_at({**law.filled({}), "width_rev": 1.0}, 40.0) > 0.0, (name, p.name)
    rungs = {rung: {law.name for law in LAWS.values() if law.rung == rung} for rung in (0, 1, 2, 4)}
    assert rungs == {0: {"torque_offset", "asymmetric_coulomb"}, 1: {"unbalance"}, 2: {"cogging"}, 4: {"lookup"}}


@pytest.mark.parametrize("name", [name for name in NAMES if name != "backlash"])  # its flanks are hit, or not
def test_a_step_of_the_numeric_derivative_is_in_its_straight_part(name):
    """Twice the step moves the torque twice as far, to a quarter."""
    law = LAWS[name]
    values = law.filled({**SHAPES.get(name, {}), **{p.name: p.typical for p in law.strengths}})
    rows = motion(0.4 * np.sin(3.0 * TIME_S))
    base = effects_along([Term(name, values)], rows, AXIS, STEP_S)[0]
    for p in law.parameters:
        if p.held or p.is_off(values) or p.kind == STRENGTH:
            continue
        step = p.step_at(values, 4.0)
        moved = [values[p.name] * math.exp(k * step) if p.logarithmic else values[p.name] + k * step for k in (1, 2)]
        once, twice = (
            np.abs(effects_along([Term(name, {**values, p.name: value})], rows, AXIS, STEP_S)[0] - base).sum()
            for value in moved
        )
        assert twice == pytest.approx(2.0 * once, rel=0.25), p.name


def test_orders_are_tried_where_the_slow_part_of_the_data_shows_them():
    """Four samples a period: order 0.25 / (period x speed) at most, of the slow tenth and not of the top speed."""
    facts = {"pole_pairs": 6, "slots": 36, "orders": (300.0,)}
    slow = motor_orders(context(slow_rps=LOW_RPS, **facts), half=True)
    assert {1.0, 24.0, 7.5, 6.0, 36.0, 72.0, 300.0} <= set(slow)  # 72: twice the slots, and twelve times the pole pairs
    assert max(slow) <= 0.25 / (PERIOD_S * LOW_RPS)
    assert max(motor_orders(context(slow_rps=TOP_RPS, **facts))) <= 0.25 / (PERIOD_S * TOP_RPS)
    assert motor_orders(context(**facts)) == motor_orders(context(slow_rps=0.05, **facts))  # not known: the slowest


def test_a_window_that_comes_again_every_pitch_is_folded_onto_the_pitch():
    fold = LAWS["position_dependent_friction"].fold
    assert fold({"width_rev": 0.2, "pitch_rev": 1.0}) == ("motor_angle", 1.0)
    assert fold({"width_rev": 0.2, "pitch_rev": 1.0, "period_rev": 3.0}) == ("motor_angle", 3.0)
    assert fold({"width_rev": 0.2}) is None
