"""A torque that is periodic in time: a neighbouring machine, mains."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import wave
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, over

MAINS_HZ = (16.7, 25.0, 50.0, 60.0, 100.0, 120.0)


def _search(context: SearchContext) -> list[Shape]:
    highest_hz = 0.1 / context.period_s
    return over("frequency_hz", [f for f in sorted({*context.frequencies_hz, *MAINS_HZ}) if 0.0 < f < highest_hz])


@njit
def periodic_disturbance(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = cos, sin of a frequency."""
    signals[s.LOAD_NM] += wave(parameters[0], parameters[1], parameters[2] * signals[s.TIME_S])


LAW = Law(
    name="periodic_disturbance",
    axis="frequency",
    kernel=periodic_disturbance,
    parameters=(
        Parameter("cos_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "cosine of the wave"),
        Parameter("sin_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "sine of the wave"),
        Parameter("frequency_hz", "Hz", SHAPE, 1e-06, 10000.0, 1.0, "frequency", step=2e-4),
    ),
    search=_search,
    meaning="torque that is periodic in time, whatever the axis does",
    plain_name="a disturbance with a fixed frequency",
    cause="something outside the axis: a fan, a pump, the mains, a neighbouring axis",
    remedy="switch machines nearby off one after the other until it goes",
    compensable=False,
    regime="everywhere, also at rest",
    lookalikes=("cogging", "unbalance"),
    experiment="two speeds: its frequency stays, that of an order of the angle changes; hold the axis at rest",
    motions=("staircase", "dwells"),
    picture="frequency",
    figure="order",
    per_run=("cos_nm", "sin_nm"),
    fold=lambda values: ("time", 1.0 / values["frequency_hz"]),
)
