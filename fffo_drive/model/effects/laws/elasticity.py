"""Part of the inertia is coupled by a spring: two masses."""

from __future__ import annotations

import math

from ....arrays import Floats
from ....jit import njit
from ....units import TWO_PI
from .. import slots as s
from ..kinds import before_step
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape

FINEST = 0.2  # of a radian of the resonance in a sub-step


def _search(context: SearchContext) -> list[Shape]:
    found = [f for f in context.frequencies_hz if f * context.period_s * 1000.0 >= 3.0]
    grid = [8.0, 12.0, 18.0, 26.0, 36.0, 50.0, 70.0, 100.0, 140.0]
    return [
        {"frequency_hz": frequency_hz, "damping": damping}
        for frequency_hz in sorted({*grid, *found})
        if frequency_hz * context.period_s < 0.1
        for damping in (0.02, 0.1)
    ]


@njit
def _load_rps2(signals: Floats, parameters: Floats, memory: Floats) -> float:
    """Acceleration of the load, of instants at the end of the step, else the mean over it.

    memory: speed of the load, twist of the joint, speed of the motor before.
    A damped spring whose resonance, motor against load, is given; as many sub-steps as the resonance needs.
    """
    share, frequency_hz, damping = parameters[0], parameters[1], parameters[2]
    omega = TWO_PI * frequency_hz
    count = math.ceil(omega * signals[s.STEP_S] / FINEST)
    step_s = signals[s.STEP_S] / count
    stiff, damp = omega * omega * (1.0 - share), 2.0 * damping * omega * (1.0 - share)
    total = 0.0
    load_rps2 = 0.0
    now_rps = signals[s.VELOCITY_RPS]
    before_rps = before_step(signals, memory, 2, now_rps)
    for k in range(count):
        slip_rps = before_rps + (k + 0.5) / count * (now_rps - before_rps) - memory[0]
        memory[1] += slip_rps * step_s
        load_rps2 = stiff * memory[1] + damp * slip_rps
        memory[0] += load_rps2 * step_s
        total += load_rps2
    return load_rps2 if signals[s.AT_INSTANTS] != 0.0 else total / count


@njit
def elasticity(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = (Ts - share (u - F)) / (1 - share), Ts the torque of the joint: J - share J turns with the motor."""
    joint_rps2 = _load_rps2(signals, parameters, memory)
    driving_nm = signals[s.MOTOR_TORQUE_NM] - signals[s.FRICTION_NM]
    share = parameters[0]
    signals[s.LOAD_NM] += share * (signals[s.INERTIA_NM_S2_PER_REV] * joint_rps2 - driving_nm) / (1.0 - share)


@njit
def _along_motion(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """The same of a motion that is known: with u - F = J dw/dt + E, E = share J (acceleration of load - of motor)."""
    slower_rps2 = _load_rps2(signals, parameters, memory) - signals[s.ACCELERATION_RPS2]
    signals[s.LOAD_NM] += parameters[0] * signals[s.INERTIA_NM_S2_PER_REV] * slower_rps2


LAW = Law(
    name="elasticity",
    axis="frequency",
    kernel=elasticity,
    parameters=(
        Parameter(
            "share", "-", STRENGTH, -0.9, 0.9, 0.2, "share of the inertia behind the spring", plausible=(0.02, 0.9)
        ),
        Parameter("frequency_hz", "Hz", SHAPE, 0.1, 10000.0, 40.0, "resonance of motor against load", logarithmic=True),
        Parameter(
            "damping",
            "-",
            SHAPE,
            0.0,
            2.0,
            0.03,
            "damping ratio of the resonance",
            logarithmic=True,
            plausible=(0.001, 0.2),
        ),
    ),
    search=_search,
    meaning="part of the inertia is coupled by a damped spring",
    plain_name="an elastic load",
    cause="a belt, coupling, long shaft or gear that twists between motor and load",
    remedy="stiffen the coupling or tension the belt; fffo-drive tune keeps the loop below the resonance",
    place=lambda values: f"near {values['frequency_hz']:.3g} Hz",
    compensable=False,
    regime="changes of torque near the resonance",
    lookalikes=("delay", "current_lag", "backlash", "presliding_shape"),
    experiment="a chirp of current through the resonance at two amplitudes: the frequency of a spring does not change",
    motions=("chirp",),
    picture="frequency",
    figure="reversal",
    feedforward=_along_motion,
    joint=True,
)
