"""The friction curve has a bump or a dip at low speed that the model's Stribeck curve cannot represent."""

from __future__ import annotations

import math

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, geometric, over


def _search(context: SearchContext) -> list[Shape]:
    return over("speed_rps", geometric(context.lowest_rps, 0.7 * context.highest_rps, 10))


@njit
def stribeck_shape(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = bump grip exp(-|w|/v): a second falling curve (Tustin) with a speed of its own, on the saturated contact."""
    speed_rps = abs(signals[s.VELOCITY_RPS])
    signals[s.LOAD_NM] += parameters[0] * signals[s.GRIP] * math.exp(-speed_rps / parameters[1])


LAW = Law(
    name="stribeck_shape",
    axis="velocity",
    kernel=stribeck_shape,
    parameters=(
        Parameter("bump_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "height of the second falling curve at standstill"),
        Parameter(
            "speed_rps", "rps", SHAPE, 1e-06, 10000.0, 1.0, "speed at which it has fallen to 1/e", logarithmic=True
        ),
    ),
    search=_search,
    meaning="the Stribeck curve falls at more than one characteristic speed",
    plain_name="friction that falls with speed in two steps",
    cause="two lubricated contacts with films that build up at different speeds, as in a gear with bearings",
    remedy="nothing to repair: it is part of the friction model",
    compensable=True,
    form=True,
    regime="slow sliding",
    lookalikes=("presliding_shape", "frictional_lag", "dwell_stiction"),
    experiment="constant speeds at eight or more levels, including very slow ones, held until friction has settled",
    motions=("staircase",),
    picture="velocity",
    figure="friction",
)
