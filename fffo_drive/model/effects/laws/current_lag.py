"""The current follows its command with a first-order lag."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import approach, before_step
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, over


def _search(context: SearchContext) -> list[Shape]:
    return over("tau_s", [context.period_s * ratio for ratio in (2.0, 4.0, 8.0, 16.0, 32.0, 64.0)])


@njit
def current_lag(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = share (torque - lagged torque), exact for a torque that is held over a step, or of straight lines between
    instants. memory: the lagged torque, the torque before.
    """
    torque_nm = signals[s.MOTOR_TORQUE_NM]
    before_nm = before_step(signals, memory, 1, torque_nm)
    behind_nm = (torque_nm - before_nm) * parameters[1] / signals[s.STEP_S]  # of a ramp that has lasted
    memory[0] = approach(memory[0] - before_nm, -behind_nm, signals[s.STEP_S], parameters[1]) + before_nm
    memory[0] += torque_nm - before_nm
    signals[s.LOAD_NM] += parameters[0] * (torque_nm - memory[0])


LAW = Law(
    name="current_lag",
    axis="memory",
    kernel=current_lag,
    parameters=(
        Parameter(
            "share", "-", STRENGTH, -2.0, 2.0, 0.5, "share of the torque that lags; 1: all of it", plausible=(0.0, 1.1)
        ),
        Parameter("tau_s", "s", SHAPE, 1e-06, 1.0, 0.002, "time constant", logarithmic=True, plausible=(1e-6, 0.005)),
    ),
    search=_search,
    meaning="the current follows its command with a lag",
    plain_name="a current loop that lags",
    cause="a current loop in the drive that is tuned too slow",
    remedy="raise the bandwidth of the drive's current loop; the controller compensates what is left",
    place=lambda values: f"at fast changes of torque, with a time constant of {1e3 * values['tau_s']:.3g} ms",
    compensable=True,
    regime="fast changes of torque",
    lookalikes=("delay", "frictional_lag", "elasticity"),
    experiment=(
        "a chirp of current to 100 Hz or more: a lag reduces the amplitude too; compare commanded and measured current"
    ),
    motions=("chirp",),
    picture="frequency",
    figure="reversal",
    acts_on="command",
    shown_by_current=True,
)
