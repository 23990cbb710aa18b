"""The amplifier gives nothing, or less, at small current."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, geometric, over

STEEPEST = 10.0


def _search(context: SearchContext) -> list[Shape]:
    widest_a = 0.3 * context.highest_current_a
    if context.driving_a > 0.0:
        widest_a = min(widest_a, context.driving_a)
    return over("width_a", geometric(0.004 * context.highest_current_a, widest_a, 8))


@njit
def dead_zone(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = lost i/width, within +-lost; lost = Kt width: nothing comes out below the width."""
    ratio = signals[s.CURRENT_A] / parameters[1]
    signals[s.LOAD_NM] += parameters[0] * min(1.0, max(-1.0, ratio))


@njit
def _inverse(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """The E that the wanted torque needs: steep where little torque is wanted, at most `STEEPEST` times it."""
    reach_nm = signals[s.TORQUE_CONSTANT_NM_PER_A] * parameters[1]
    left_nm = max(reach_nm - parameters[0], abs(parameters[0]) / STEEPEST)
    wanted_nm = signals[s.MOTOR_TORQUE_NM] + signals[s.LOAD_NM]
    signals[s.LOAD_NM] += parameters[0] * min(1.0, max(-1.0, wanted_nm / left_nm))


LAW = Law(
    name="dead_zone",
    axis="current",
    kernel=dead_zone,
    parameters=(
        Parameter("lost_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "torque that is lost beyond the zone"),
        Parameter("width_a", "A", SHAPE, 1e-09, 1000000.0, 0.1, "half width of the zone", logarithmic=True),
    ),
    search=_search,
    meaning="the amplifier gives less at small current",
    plain_name="torque that is lost at small current",
    cause="dead time of the amplifier's bridge, or its current measurement",
    remedy="switch on the dead-time compensation of the drive; the controller compensates what is left",
    place=lambda values: f"at small current, below {values['width_a']:.3g} A",
    compensable=True,
    regime="small current, at any speed",
    lookalikes=("dwell_stiction", "presliding_shape", "torque_saturation"),
    experiment="let the torque cross zero while the axis moves, as in coasting down: stiction acts at rest only",
    motions=("coast_downs",),
    picture="current",
    figure="transfer",
    feedforward=_inverse,
    acts_on="command",
    shown_by_current=True,
)
