"""Break-away friction grows with the time at rest."""

from __future__ import annotations

import math

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import LEVEL_MEMORY, level_response, settled
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape


def _search(context: SearchContext) -> list[Shape]:
    shortest_rev = 3.0 / context.stiffness_per_rev
    return [
        {"tau_s": tau_s, "release_rev": ratio * shortest_rev}
        for tau_s in (0.1, 0.5, 2.0, 8.0)
        for ratio in (1.0, 4.0, 16.0, 64.0)
    ]


@njit
def dwell_stiction(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """Contacts strengthen with age (Dieterich's ageing law), and are renewed by travel:

    d(age)/dt = 1 - age |w| / release,    Fc and Fs are 1 + (peak/Fs) (1 - exp(-age/tau)) times as high

    memory[LEVEL_MEMORY]: age.
    """
    step_s = signals[s.STEP_S]
    distance_rev = abs(signals[s.VELOCITY_RPS]) * step_s
    renewed = distance_rev / parameters[2]
    mean = 1.0 if renewed < 1e-12 else -math.expm1(-renewed) / renewed
    memory[LEVEL_MEMORY] = memory[LEVEL_MEMORY] * math.exp(-renewed) + step_s * mean
    change = parameters[0] / signals[s.STATIC_NM] * settled(memory[LEVEL_MEMORY], parameters[1])
    signals[s.LOAD_NM] += level_response(signals, memory, change)


LAW = Law(
    name="dwell_stiction",
    axis="dwell",
    kernel=dwell_stiction,
    parameters=(
        Parameter("peak_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "rise of the break-away torque after a long rest"),
        Parameter(
            "tau_s",
            "s",
            SHAPE,
            0.0001,
            1000000.0,
            1.0,
            "time at rest after which 63 % of it is reached",
            logarithmic=True,
            plausible=(0.1, 1000.0),  # a rest that is shorter is not distinguished from motion
        ),
        Parameter(
            "release_rev",
            "rev",
            SHAPE,
            1e-06,
            10000.0,
            0.03,
            "travel over which contacts are renewed",
            logarithmic=True,
        ),
    ),
    search=_search,
    meaning="break-away torque grows with the time at rest",
    plain_name="sticking after a rest",
    cause="grease or seals that settle while the axis stands still",
    remedy="move the axis a little before a precise start, or change grease or seals; the controller compensates it",
    place=lambda values: f"breaking away after a rest of about {values['tau_s']:.3g} s and longer",
    compensable=True,
    regime="break-away after a rest",
    lookalikes=("stribeck_shape", "presliding_shape"),
    experiment=(
        "four or more dwells of 0.1 to 30 s, each ended by the same torque ramp; then other ramps after equal dwells"
    ),
    motions=("dwells",),
    picture="dwell",
    figure="reversal",
    level=True,
)
