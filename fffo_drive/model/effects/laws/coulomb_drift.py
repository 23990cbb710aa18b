"""Friction between the surfaces drifts with the time of the run."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import level_response, settled
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, over


def _search(context: SearchContext) -> list[Shape]:
    return over("tau_s", [context.duration_s * ratio for ratio in (0.1, 0.3, 1.0, 3.0)])


@njit
def coulomb_drift(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """Fc and Fs are 1 + share (1 - exp(-t/tau)) times as high."""
    change = parameters[0] * settled(signals[s.TIME_S], parameters[1])
    signals[s.LOAD_NM] += level_response(signals, memory, change)


LAW = Law(
    name="coulomb_drift",
    axis="time",
    kernel=coulomb_drift,
    parameters=(
        Parameter("share", "-", STRENGTH, -0.95, 10.0, 0.1, "final change, as a share of the contact's friction"),
        Parameter("tau_s", "s", SHAPE, 0.001, 10000000.0, 60.0, "time constant", logarithmic=True),
    ),
    search=_search,
    meaning="Coulomb and Stribeck friction drift with time",
    plain_name="friction that drifts with time",
    cause="warming up, or grease that spreads",
    remedy="warm the axis up before precise work, or identify it warm; controller.adaptation follows slow changes",
    place=lambda values: f"while sliding, with a time constant of {values['tau_s']:.3g} s",
    compensable=True,
    regime="sliding, late in the run",
    lookalikes=("viscous_drift", "position_dependent_friction"),
    experiment="the same motion at the beginning, in the middle and at the end, at several speeds; then after a rest",
    motions=("staircase", "dwells", "staircase", "pairs", "staircase"),
    picture="time",
    figure="level",
    level=True,
)
