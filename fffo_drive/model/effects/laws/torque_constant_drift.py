"""The torque per ampere falls with the time of the run: magnets that warm up, or a commutation that slips."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import settled
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape

STARTS = 24  # places along the log at which a change is looked for
MOST = 0.9  # share of the torque that may be lost


def _search(context: SearchContext) -> list[Shape]:
    """A slow change from the start on, and one at each of STARTS places that is over by the next."""
    between_s = context.duration_s / STARTS
    slow = [{"begin_s": 0.0, "tau_s": context.duration_s * ratio} for ratio in (0.1, 0.3, 1.0, 3.0)]
    return slow + [{"begin_s": context.first_s + k * between_s, "tau_s": 0.5 * between_s} for k in range(1, STARTS)]


@njit
def _lost(signals: Floats, parameters: Floats) -> float:
    """Share of the motor's torque that is lost by now."""
    since_s = signals[s.TIME_S] - parameters[1]
    return min(MOST, parameters[0] * settled(since_s, parameters[2])) if since_s > 0.0 else 0.0


@njit
def torque_constant_drift(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = lost torque, lost = share (1 - exp(-(t - begin)/tau)) past `begin`."""
    signals[s.LOAD_NM] += _lost(signals, parameters) * signals[s.MOTOR_TORQUE_NM]


@njit
def _inverse(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """The E that the wanted torque needs: what is added is lost in part too."""
    lost = _lost(signals, parameters)
    signals[s.LOAD_NM] += lost / (1.0 - lost) * (signals[s.MOTOR_TORQUE_NM] + signals[s.LOAD_NM])


LAW = Law(
    name="torque_constant_drift",
    axis="time",
    kernel=torque_constant_drift,
    parameters=(
        Parameter("share", "-", STRENGTH, -10.0, 10.0, 0.1, "share of the torque per ampere that is lost at last"),
        Parameter("begin_s", "s", SHAPE, 0.0, 10000000.0, 0.0, "when it begins; 0: from the start", step=0.05),
        Parameter("tau_s", "s", SHAPE, 1e-06, 10000000.0, 60.0, "time constant", logarithmic=True),
    ),
    search=_search,
    meaning="the torque per ampere changes with time",
    plain_name="a torque per ampere that changes with time",
    cause="magnets or sensors of the current that warm up; a commutation that slipped, where it changes at once",
    remedy="check the angle of the commutation and the current's calibration; let the motor cool, or load it less",
    place=lambda values: (
        f"all torque from {values['begin_s']:.4g} s on"
        if values["begin_s"] > 0.0
        else f"all torque, with a time constant of {values['tau_s']:.3g} s"
    ),
    compensable=False,
    regime="everywhere, late in the run",
    lookalikes=("coulomb_drift", "viscous_drift", "torque_saturation"),
    experiment=(
        "the same motion with strong accelerations at the beginning and at the end: a torque constant scales the "
        "torque of the inertia too, friction does not"
    ),
    motions=("pairs", "staircase", "dwells", "pairs", "staircase"),
    picture="time",
    figure="level",
    feedforward=_inverse,
    acts_on="torque",
)
