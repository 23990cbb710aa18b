"""A second frictional surface, as of a gear's output bearing: it gives way and renews itself over longer travels."""

from __future__ import annotations

import math

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import approach, sign_of
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, geometric

TRAVEL_RATIO, MEMORY_RATIO = 64.0, 3.0  # over 1/K and Fs/B of the model's surface: where a fit begins
RANGE = (1e-6, 1e4)


def _search(context: SearchContext) -> list[Shape]:
    memory_rev = MEMORY_RATIO * context.static_nm / context.attraction_nm_per_rev
    return [
        {"travel_rev": TRAVEL_RATIO / context.stiffness_per_rev, "speed_rps": speed_rps, "memory_rev": memory_rev}
        for speed_rps in geometric(2.0 * context.lowest_rps, 0.5 * context.highest_rps, 4)
    ]


@njit
def second_surface(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = z (level + rise m): dz/dx = (sgn w - z)/travel in presliding; m follows exp(-|w|/v) over another travel.

    memory: z, m, and 1 once m has begun. The surfaces of a train of bearings and gears add up (paper, Fig. 2b).
    """
    speed_rps = abs(signals[s.VELOCITY_RPS])
    distance_rev = speed_rps * signals[s.STEP_S]
    falling = math.exp(-speed_rps / parameters[3])
    if memory[2] == 0.0:
        memory[1] = falling
        memory[2] = 1.0
    if distance_rev > 0.0:
        memory[0] = approach(memory[0], sign_of(signals[s.VELOCITY_RPS]), distance_rev, parameters[2])
        memory[1] = approach(memory[1], falling, distance_rev, parameters[4])
    signals[s.LOAD_NM] += memory[0] * (parameters[0] + parameters[1] * memory[1])


SECOND_SURFACE = "second_surface"

LAW = Law(
    name=SECOND_SURFACE,
    axis="travel_since_reversal",
    kernel=second_surface,
    parameters=(
        Parameter("level_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "level of the second surface at high speed"),
        Parameter("rise_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "by how much its level is higher at the lowest speed"),
        *(
            Parameter(name, unit, SHAPE, *RANGE, typical, meaning, logarithmic=True, plausible=RANGE)
            for name, unit, typical, meaning in (
                ("travel_rev", "rev", 0.05, "travel over which it builds up"),
                ("speed_rps", "rps", 1.0, "speed at which the rise is 1/e"),
                ("memory_rev", "rev", 0.1, "travel over which the rise renews"),
            )
        ),
    ),
    search=_search,
    meaning="the friction is that of two surfaces",
    plain_name="a second friction contact",
    cause="two contacts that slide one after the other, such as seal and bearing, or motor and gear",
    remedy="nothing to repair: it is part of the friction model",
    compensable=True,
    form=True,
    regime="presliding and slow sliding",
    lookalikes=("presliding_shape", "stribeck_shape", "frictional_lag"),
    experiment="reversals at two or more accelerations, and constant speeds at eight levels, including very slow ones",
    motions=("triangles", "staircase"),
    picture="travel_since_reversal",
    figure="reversal",
)
