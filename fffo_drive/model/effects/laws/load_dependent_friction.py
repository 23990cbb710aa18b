"""Friction grows with the transmitted torque, which presses the surfaces together."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import LEVEL_MEMORY, level_response, over_step
from ..law import STRENGTH, Law, Parameter, no_shape


@njit
def load_dependent_friction(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """Fc grows by share |motor torque|, and Fs in proportion."""
    pressing_nm = abs(over_step(signals, memory, signals[s.MOTOR_TORQUE_NM]))
    signals[s.LOAD_NM] += level_response(signals, memory, parameters[0] * pressing_nm / signals[s.COULOMB_NM])


@njit
def _inverse(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """The E that the wanted torque needs: what is added presses too. memory[LEVEL_MEMORY]: E of the tick before."""
    wanted_nm = over_step(signals, memory, signals[s.MOTOR_TORQUE_NM] + signals[s.LOAD_NM]) + memory[LEVEL_MEMORY]
    memory[LEVEL_MEMORY] = level_response(signals, memory, parameters[0] * abs(wanted_nm) / signals[s.COULOMB_NM])
    signals[s.LOAD_NM] += memory[LEVEL_MEMORY]


LAW = Law(
    name="load_dependent_friction",
    axis="torque",
    kernel=load_dependent_friction,
    parameters=(Parameter("share", "-", STRENGTH, -1.0, 1.0, 0.1, "friction per transmitted torque"),),
    search=no_shape,
    meaning="friction grows with the transmitted torque",
    plain_name="friction that grows with the load",
    cause="a gear or screw that is pressed harder by the torque it transmits",
    remedy="check alignment and lubrication of the gear or screw; the controller compensates it",
    compensable=True,
    regime="high torque: acceleration, braking, load",
    lookalikes=("torque_saturation", "asymmetric_viscous", "quadratic_drag"),
    experiment="accelerate and brake with the same torque: this opposes the motion, saturation opposes the torque",
    motions=("pairs",),
    picture="torque",
    feedforward=_inverse,
    level=True,
    acts_on="torque",
)
