"""Viscous friction drifts with the time of the run, for example as a lubricant warms up."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import settled, surface_response
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, over


def _search(context: SearchContext) -> list[Shape]:
    return over("tau_s", [context.duration_s * ratio for ratio in (0.1, 0.3, 1.0, 3.0)])


@njit
def viscous_drift(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """The viscous coefficient is larger by change (1 - exp(-t/tau))."""
    viscous = parameters[0] * settled(signals[s.TIME_S], parameters[1])
    signals[s.LOAD_NM] += surface_response(signals, memory, 0.0, viscous)


LAW = Law(
    name="viscous_drift",
    axis="time",
    kernel=viscous_drift,
    parameters=(
        Parameter("change_nm_per_rps", "Nm/rps", STRENGTH, -1e6, 1e6, 1e-3, "final change of the viscous coefficient"),
        Parameter("tau_s", "s", SHAPE, 0.001, 10000000.0, 60.0, "time constant", logarithmic=True),
    ),
    search=_search,
    meaning="viscous friction drifts with time",
    plain_name="speed-dependent friction that drifts with time",
    cause="lubricant that warms up and thins",
    remedy="warm the axis up before precise work, or identify it warm; controller.adaptation follows slow changes",
    place=lambda values: f"at speed, with a time constant of {values['tau_s']:.3g} s",
    compensable=True,
    regime="fast sliding, late in the run",
    lookalikes=("coulomb_drift", "quadratic_drag"),
    experiment=(
        "the same motion at the beginning, in the middle and at the end, at several speeds: the change grows with speed"
    ),
    motions=("staircase", "dwells", "staircase", "pairs", "staircase"),
    picture="time",
    figure="level",
    level=True,
)
