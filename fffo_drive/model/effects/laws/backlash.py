"""A gap between motor and load: part of inertia and friction is decoupled after a reversal."""

from __future__ import annotations

import math

from ....arrays import Floats
from ....jit import njit
from ....units import TWO_PI
from .. import slots as s
from ..kinds import before_step
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, geometric

FINEST = 0.25  # of a radian of the contact's resonance in a sub-step
FLANK_DAMPING = 2.0  # twice the damping ratio: critical
# The load's motion is not measured. Behind a stiff, lightly damped flank it bounces along the measured motion at other
# instants than in the machine, and each bounce counts twice. A critically damped flank near the filter's cut-off stays
# in step, whatever the machine's own: it explains 46 to 58 % of the residual of six drives of 166 to 344 Hz (7092 to
# 7352); 150 Hz with a quarter of that damping 19 to 70 %.
CONTACT_HZ = 60.0


def _search(context: SearchContext) -> list[Shape]:
    return [
        {"gap_rev": gap_rev, "friction_share": friction_share, "contact_hz": min(CONTACT_HZ, 0.1 / context.period_s)}
        for gap_rev in geometric(2.0 / context.stiffness_per_rev, 100.0 / context.stiffness_per_rev, 14)
        for friction_share in (0.0, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
    ]


@njit
def _load_rps2(signals: Floats, parameters: Floats, memory: Floats) -> float:
    """Acceleration that the flanks give the load: of instants at the end of the step, else the mean over it.

    memory: speed of the load, lead of the motor, speed of the motor before.
    """
    share, gap_rev, friction_share, contact_hz = parameters[0], parameters[1], parameters[2], parameters[3]
    omega = TWO_PI * contact_hz
    count = math.ceil(omega * signals[s.STEP_S] / FINEST)
    step_s = signals[s.STEP_S] / count
    inertia = signals[s.INERTIA_NM_S2_PER_REV]
    stiff, damp = omega * omega * (1.0 - share), FLANK_DAMPING * omega * (1.0 - share)
    drag_rps2 = friction_share * signals[s.COULOMB_NM] / inertia
    total = 0.0
    load_rps2 = 0.0
    now_rps = signals[s.VELOCITY_RPS]
    before_rps = before_step(signals, memory, 2, now_rps)
    for k in range(count):
        slip_rps = before_rps + (k + 0.5) / count * (now_rps - before_rps) - memory[0]
        memory[1] += slip_rps * step_s
        load_rps2 = 0.0
        if memory[1] > 0.5 * gap_rev:
            load_rps2 = max(0.0, stiff * (memory[1] - 0.5 * gap_rev) + damp * slip_rps)
        elif memory[1] < -0.5 * gap_rev:
            load_rps2 = min(0.0, stiff * (memory[1] + 0.5 * gap_rev) + damp * slip_rps)
        drag = drag_rps2 * min(1.0, max(-1.0, memory[0] / signals[s.REST_SPEED_RPS]))
        memory[0] += load_rps2 * step_s
        # drag stops the load, it does not turn it round
        if abs(memory[0]) > abs(drag) * step_s:
            memory[0] -= drag * step_s
        else:
            memory[0] = 0.0
        total += load_rps2
    return load_rps2 if signals[s.AT_INSTANTS] != 0.0 else total / count


@njit
def _behind_nm(signals: Floats, parameters: Floats) -> float:
    """Friction behind the gap: it is part of F, and is given back, as the motor feels the joint instead."""
    return float(parameters[0] * parameters[2] * signals[s.CONTACT_NM])


@njit
def backlash(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """Two masses as in elasticity, with a joint that bears nothing inside the gap and only pushes at its flanks.

    Behind the gap are a share of the inertia and a share of the friction.
    """
    joint_rps2 = _load_rps2(signals, parameters, memory)
    driving_nm = signals[s.MOTOR_TORQUE_NM] - signals[s.FRICTION_NM]
    joint_nm = parameters[0] * (signals[s.INERTIA_NM_S2_PER_REV] * joint_rps2 - driving_nm)
    signals[s.LOAD_NM] += (joint_nm - _behind_nm(signals, parameters)) / (1.0 - parameters[0])


@njit
def _along_motion(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """The same of a motion that is known, with u - F = J dw/dt + E."""
    slower_rps2 = _load_rps2(signals, parameters, memory) - signals[s.ACCELERATION_RPS2]
    joint_nm = parameters[0] * signals[s.INERTIA_NM_S2_PER_REV] * slower_rps2
    signals[s.LOAD_NM] += joint_nm - _behind_nm(signals, parameters)


LAW = Law(
    name="backlash",
    axis="travel_since_reversal",
    kernel=backlash,
    parameters=(
        Parameter("share", "-", STRENGTH, 0.0, 0.9, 0.2, "share of the inertia behind the gap", plausible=(0.15, 0.9)),
        Parameter("gap_rev", "rev", SHAPE, 0.0, 1000.0, 0.01, "width of the gap at the motor shaft", logarithmic=True),
        Parameter(
            "friction_share",
            "-",
            SHAPE,
            0.0,
            10.0,
            0.0,
            "share of the friction behind the gap, over that of the inertia",
            logarithmic=True,
        ),
        Parameter(
            "contact_hz",
            "Hz",
            SHAPE,
            1.0,
            10000.0,
            CONTACT_HZ,
            "resonance of the closed joint",
            logarithmic=True,
            held=True,
        ),
    ),
    search=_search,
    meaning="a gap decouples part of the inertia after reversals",
    plain_name="backlash",
    cause="play in gear, key or coupling",
    remedy="remove the play: preload the gear, tighten the coupling; feed-forward cannot compensate it",
    place=lambda values: f"after each reversal, within {values['gap_rev']:.3g} rev",
    compensable=False,
    regime="after reversals, within the gap",
    lookalikes=("presliding_shape", "elasticity", "dead_zone"),
    experiment="reversals at several accelerations: the gap is fixed in angle; the resonance falls at small amplitude",
    motions=("triangles", "pairs"),
    picture="travel_since_reversal",
    figure="reversal",
    feedforward=_along_motion,
    joint=True,
)
