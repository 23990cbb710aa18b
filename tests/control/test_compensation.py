"""Feed-forward of effects: what it gives, its bounds, in and out of service without a bump, and its inverses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from interpreted import hex_results

from fffo_drive.control.compensation import (
    ALL_EFFECTS,
    RAMP_S,
    SUM_NM,
    Limits,
    compensation_rest,
    compensation_step,
    effects_in_service,
    new_memory,
    no_compensation,
    order_of_service,
    pack_compensation,
)
from fffo_drive.control.feedforward import Reference, steady_reference
from fffo_drive.model.axis import AxisConfig
from fffo_drive.model.effects.table import Term
from fffo_drive.model.friction import OMEGA_CLIPPED, FrictionConfig

PERIOD_S = 5e-4
LEAD_S = 0.0023
AXIS = AxisConfig(9.4e-4, 0.148, 0.00275, FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, OMEGA_CLIPPED))
WIDE = Limits(1.0, 1.0)
COGGING = Term("cogging", {"cos_nm": 0.004, "sin_nm": 0.003, "order": 6.0})
OFFSET = Term("torque_offset", {"torque_nm": 0.01})


def drive(table, memory, ticks, in_service=ALL_EFFECTS, speed_rps=2.0, begin_rev=0.0, acceleration_rps2=0.0):
    """The steps along a steady reference that the axis follows. Torques (ticks,)."""
    found = np.empty(ticks)
    for k in range(ticks):
        velocity = speed_rps + acceleration_rps2 * k * PERIOD_S
        reference = Reference(velocity, acceleration_rps2, velocity, acceleration_rps2, velocity)
        position = begin_rev + speed_rps * k * PERIOD_S
        found[k] = compensation_step(table, memory, in_service, reference, position)
    return found


def kernel_results():
    terms = [COGGING, Term("dead_zone", {"lost_nm": 0.0148, "width_a": 0.1}), Term("dwell_stiction", {"peak_nm": 0.01}),
             Term("torque_saturation", {"share": 0.5, "knee_a": 1.0})]  # fmt: skip
    terms = [terms[k] for k in order_of_service(terms)]
    table, memory = pack_compensation(terms, AXIS, LEAD_S, WIDE, PERIOD_S), new_memory()
    found = [*drive(table, memory, 300, acceleration_rps2=20.0), *drive(table, memory, 300, 0b0101, -1.0)]
    return [float(x).hex() for x in found[::10]]


def test_compiled_and_interpreted_steps_agree_bit_for_bit():
    assert kernel_results() == hex_results("control.test_compensation", "kernel_results")


def test_without_effects_nothing_is_added_and_nothing_remembered():
    memory = new_memory()
    assert not drive(no_compensation(), memory, 100).any()
    assert not memory.any()
    assert effects_in_service(no_compensation(), ALL_EFFECTS) == 0


def test_the_torque_is_that_of_the_angle_where_it_arrives():
    memory = new_memory()
    table = pack_compensation([COGGING], AXIS, LEAD_S, WIDE, PERIOD_S)
    found = drive(table, memory, 2000)[1000:]
    angle = 2.0 * math.pi * 6.0 * (2.0 * np.arange(1000, 2000) * PERIOD_S + 2.0 * LEAD_S)
    assert np.allclose(found, 0.004 * np.cos(angle) + 0.003 * np.sin(angle), atol=1e-9)


def test_each_effect_and_their_sum_are_bounded():
    several = [OFFSET._replace(values={"torque_nm": 0.01 * sign}) for sign in (1.0, 1.0, -1.0)]
    for limits, expected in ((Limits(1.0, 1.0), 0.01), (Limits(0.004, 1.0), 0.004), (Limits(1.0, 0.003), 0.003)):
        table = pack_compensation(several, AXIS, LEAD_S, limits, PERIOD_S)
        assert drive(table, new_memory(), 1000)[-1] == pytest.approx(expected)


def test_into_service_and_out_of_it_on_a_ramp():
    table = pack_compensation([OFFSET, COGGING], AXIS, LEAD_S, WIDE, PERIOD_S)
    memory = new_memory()
    largest = 0.01 * PERIOD_S / RAMP_S + 0.005 * (PERIOD_S / RAMP_S + 2.0 * math.pi * 6.0 * 2.0 * PERIOD_S)
    first = drive(table, memory, 1000)
    out = drive(table, memory, 1000, 0b10, begin_rev=1.0)
    again = drive(table, memory, 1000, 0b11, begin_rev=2.0)
    assert np.abs(np.diff(np.concatenate([[0.0], first, out, again]))).max() <= largest * (1.0 + 1e-9)
    assert np.abs(out[600:]).max() <= 0.005 * (1.0 + 1e-9)  # of the cogging alone
    assert again[600:].max() > 0.0149
    assert memory[SUM_NM] == again[-1]
    compensation_rest(memory)
    assert not memory.any()


@pytest.mark.parametrize(
    ("name", "values", "lost"),
    [
        (
            "torque_saturation",
            {"share": 0.5, "knee_a": 2.0},
            lambda t: 0.5 * t * (t / 0.296) ** 2 / (1 + (t / 0.296) ** 2),
        ),
        ("dead_zone", {"lost_nm": 0.01, "width_a": 0.1}, lambda t: 0.01 * np.clip(t / 0.0148, -1.0, 1.0)),
        ("load_dependent_friction", {"share": 0.2}, lambda t: 0.2 * abs(t)),
        ("torque_ripple", {"cos_share": 0.2, "order": 1.0}, lambda t: 0.2 * t),
    ],
)
def test_what_depends_on_torque_gives_the_whole_of_it(name, values, lost):
    """T + E on the motor leaves T behind the effect; at a standing angle of zero, sliding forwards."""
    table = pack_compensation([Term(name, values)], AXIS, 0.0, WIDE, PERIOD_S)
    memory = new_memory()
    for acceleration in (20.0, 150.0):
        for _ in range(2000):
            reference = Reference(5.0, acceleration, 5.0, acceleration, 5.0)
            added = compensation_step(table, memory, ALL_EFFECTS, reference, 0.0)
        friction_nm = 0.025 + 0.042 * math.exp(-((5.0 / 0.733) ** 1.07)) + 0.015
        wanted = 9.4e-4 * acceleration + friction_nm
        motor = wanted + added
        assert motor - lost(motor) == pytest.approx(wanted, rel=2e-3)


def test_what_depends_on_torque_is_computed_last():
    terms = [Term("dead_zone", {}), COGGING, Term("torque_saturation", {}), OFFSET]
    assert order_of_service(terms) == [1, 3, 0, 2]


def test_more_effects_than_the_loop_has_room_for_are_refused():
    with pytest.raises(ValueError, match="at most 8"):
        pack_compensation([OFFSET] * 9, AXIS, LEAD_S, WIDE, PERIOD_S)


def test_at_rest_before_any_motion_friction_effects_give_nothing():
    table = pack_compensation([Term("friction_ripple", {"cos_share": 0.3, "order": 1.0})], AXIS, LEAD_S, WIDE, PERIOD_S)
    memory = new_memory()
    for _ in range(1000):
        assert compensation_step(table, memory, ALL_EFFECTS, steady_reference(0.0), 0.3) == 0.0
