"""Friction follows the Stribeck curve late: a part of it over another travel."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import approach, steady_contact_nm
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, geometric, over


def _search(context: SearchContext) -> list[Shape]:
    own_rev = context.static_nm / context.attraction_nm_per_rev
    return over("length_rev", [own_rev * ratio for ratio in geometric(0.1, 300.0, 8) if not 0.7 < ratio < 1.4])


@njit
def frictional_lag(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = share grip (level - S): a part of the contact follows its steady level over a travel of its own.

    memory: the level, and 1 once it has begun.
    """
    speed_rps = abs(signals[s.VELOCITY_RPS])
    steady_nm = steady_contact_nm(signals, speed_rps)
    if memory[1] == 0.0:
        memory[0] = steady_nm
        memory[1] = 1.0
    memory[0] = approach(memory[0], steady_nm, speed_rps * signals[s.STEP_S], parameters[1])
    signals[s.LOAD_NM] += parameters[0] * signals[s.GRIP] * (memory[0] - steady_nm)


LAW = Law(
    name="frictional_lag",
    axis="travel_since_reversal",
    kernel=frictional_lag,
    parameters=(
        Parameter("share", "-", STRENGTH, -10.0, 10.0, 0.3, "share of the contact that follows over the second travel"),
        Parameter("length_rev", "rev", SHAPE, 1e-06, 10000.0, 0.05, "the travel", logarithmic=True),
    ),
    search=_search,
    meaning="friction follows changes of speed over two travels",
    plain_name="friction that follows speed with a delay in travel",
    cause="a lubricant film that needs travel to build up",
    remedy="nothing to repair: it is part of the friction model",
    compensable=True,
    form=True,
    regime="sliding at changing low speed",
    lookalikes=("delay", "current_lag", "presliding_shape", "stribeck_shape"),
    experiment=(
        "a sine of speed about a bias, without a reversal: the loop of friction over speed stays, a "
        "delay shows in the accelerating part too"
    ),
    motions=("biased_sines",),
    picture="velocity",
    figure="reversal",
)
