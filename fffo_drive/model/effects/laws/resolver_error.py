"""The measured angle is wrong by waves of the motor turn: eccentricity and unequal windings."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import wave
from ..law import STRENGTH, Law, Parameter, no_shape

PLAUSIBLE_REV = (-0.05, 0.05)  # 18 degrees: a magnet that is far off its axis


@njit
def resolver_error(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """SENSOR_REV = first and second order of the angle at which the sensor looks."""
    angle_rev = signals[s.SENSOR_ANGLE_REV]
    error_rev = wave(parameters[0], parameters[1], angle_rev) + wave(parameters[2], parameters[3], 2.0 * angle_rev)
    signals[s.SENSOR_REV] += error_rev


LAW = Law(
    name="resolver_error",
    axis="motor_angle",
    kernel=resolver_error,
    parameters=(
        Parameter("cos1_rev", "rev", STRENGTH, -0.1, 0.1, 1e-3, "cosine once a turn", plausible=PLAUSIBLE_REV),
        Parameter("sin1_rev", "rev", STRENGTH, -0.1, 0.1, 1e-3, "sine once a turn", plausible=PLAUSIBLE_REV),
        Parameter("cos2_rev", "rev", STRENGTH, -0.1, 0.1, 1e-3, "cosine twice a turn", plausible=PLAUSIBLE_REV),
        Parameter("sin2_rev", "rev", STRENGTH, -0.1, 0.1, 1e-3, "sine twice a turn", plausible=PLAUSIBLE_REV),
    ),
    search=no_shape,
    meaning="the measured angle has errors of one and two periods per turn",
    plain_name="a measured angle that is wrong within the turn",
    cause="resolver or encoder mounted off centre, or unequal amplitudes of its signals",
    remedy="align the sensor, or run the drive's own correction of its sine and cosine signals",
    compensable=False,
    regime="everywhere; in torque with the square of the speed",
    lookalikes=("cogging", "torque_ripple"),
    experiment="two speeds: in torque it grows with the square of the speed, cogging stays; coasting down shows it too",
    motions=("creep", "coast_downs"),
    picture="motor_angle",
    figure="order",
    per_run=("cos1_rev", "sin1_rev", "cos2_rev", "sin2_rev"),
    rotary=True,
)
