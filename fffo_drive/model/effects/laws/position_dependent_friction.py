"""Friction between the surfaces varies along the travel: a wave, or a worn or tight place."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ....arrays import Floats
from ....jit import njit
from ....units import TWO_PI
from .. import slots as s
from ..kinds import level_response, over_step, wave
from ..law import SHAPE, STRENGTH, Folded, Law, Parameter, SearchContext, Shape, slow_periods_rev

WIDTH_SHARES = (0.06, 0.15)  # of the travel


def _search(context: SearchContext) -> list[Shape]:
    shapes: list[Shape] = [{"period_rev": period_rev} for period_rev in slow_periods_rev(context)]
    for share in WIDTH_SHARES if context.turns > 0.0 else ():
        width_rev = share * context.turns
        shapes += [
            {"centre_rev": context.low_rev + 0.5 * width_rev * (k + 1), "width_rev": width_rev}
            for k in range(int(2.0 * (1.0 - share) / share) + 1)
        ]
    if context.turns > 3.0:
        shapes += [{"centre_rev": k / 8.0, "width_rev": 0.25, "pitch_rev": 1.0} for k in range(8)]
    return shapes


def _place(values: Mapping[str, float]) -> str:
    places = []
    if values.get("width_rev", 0.0) > 0.0:
        text = f"at {values['centre_rev']:.4g} rev, ± {0.5 * values['width_rev']:.3g} rev"
        pitch, share = values.get("pitch_rev", 0.0), values.get("window_share", 0.0)
        text += f", again every {pitch:.4g} rev" if pitch > 0.0 else ""
        places.append(f"{text}, where friction is {100.0 * abs(share):.2g} % {'higher' if share > 0.0 else 'lower'}")
    if values.get("period_rev", 0.0) > 0.0:
        places.append(f"a wave every {values['period_rev']:.4g} rev of the travel")
    return " and ".join(places) or "along the travel"


def _fold(values: Mapping[str, float]) -> Folded | None:
    period_rev = values.get("period_rev", 0.0) or values.get("pitch_rev", 0.0)
    return ("motor_angle", period_rev) if period_rev > 0.0 else None


@njit
def position_dependent_friction(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """Fc and Fs are 1 + (wave over a period + share inside a window) times as high; a length of zero switches off.

    The window has the shape of a raised cosine towards its edges (a fifth of the width each); it repeats every pitch,
    or stands once along the travel.
    """
    angle_rev = over_step(signals, memory, signals[s.MOTOR_ANGLE_REV])
    scale = 0.0
    if parameters[3] > 0.0:
        scale += wave(parameters[0], parameters[1], angle_rev / parameters[3])
    if parameters[5] > 0.0:
        away_rev = angle_rev - parameters[4]
        if parameters[6] > 0.0:
            away_rev -= parameters[6] * math.floor(away_rev / parameters[6] + 0.5)
        inside = (0.5 * parameters[5] - abs(away_rev)) / (0.2 * parameters[5])
        if inside >= 1.0:
            scale += parameters[2]
        elif inside > 0.0:
            scale += parameters[2] * 0.5 * (1.0 - math.cos(0.5 * TWO_PI * inside))
    signals[s.LOAD_NM] += level_response(signals, memory, scale)


LAW = Law(
    name="position_dependent_friction",
    axis="output_angle",
    kernel=position_dependent_friction,
    parameters=(
        Parameter(
            "cos_share",
            "-",
            STRENGTH,
            -10.0,
            10.0,
            0.1,
            "cosine of the wave, as a share of the contact's friction",
            "period_rev",
        ),
        Parameter("sin_share", "-", STRENGTH, -10.0, 10.0, 0.1, "sine of the wave", "period_rev"),
        Parameter("window_share", "-", STRENGTH, -10.0, 10.0, 0.1, "change inside the window", "width_rev"),
        Parameter(
            "period_rev",
            "rev",
            SHAPE,
            0.0,
            1000000.0,
            0.0,
            "period of the wave along the travel; 0: no wave",
            logarithmic=True,
            span=True,
        ),
        Parameter("centre_rev", "rev", SHAPE, -1000000000.0, 1000000000.0, 0.0, "centre of the window", "width_rev"),
        Parameter(
            "width_rev", "rev", SHAPE, 0.0, 1000000.0, 0.0, "width of the window; 0: no window", logarithmic=True
        ),
        Parameter(
            "pitch_rev",
            "rev",
            SHAPE,
            0.0,
            1000000.0,
            0.0,
            "travel after which the window repeats; 0: never",
            logarithmic=True,
            held=True,
            span=True,
        ),
    ),
    search=_search,
    meaning="friction varies along the travel, in waves or in a window",
    plain_name="a tight or loose spot along the travel",
    cause="a bent or worn screw, a guide out of line, dirt or dry grease at one place",
    remedy="clean, grease and align the guide or screw there; the controller compensates what is left",
    place=_place,
    compensable=True,
    regime="sliding",
    lookalikes=("friction_ripple", "unbalance", "coulomb_drift"),
    experiment="slow constant speed over the whole travel, both ways: friction changes its sign, a weight does not",
    motions=("creep",),
    picture="output_angle",
    per_run=("cos_share", "sin_share"),
    level=True,
    fold=_fold,
)
