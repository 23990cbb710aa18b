"""What the estimated velocity is worth on an axis: the error that friction outside the model leaves, and its noise.

Friction reverses in steps, whose spectrum falls as 1/w. With the velocity of the shaft T per torque beside the model,
the squared error of such a step is, by Parseval's theorem, the integral of |T(jw) / w|^2 / pi. With the drive's
velocity

    T = 1 / (Z + C exp(-s Td)),

with the estimate H p + U i of position and command the loop is closed at the current (control/stability):

    T = 1 / (Z + C (H / s) exp(-s Td) / (1 + C U / Kt)).

Noise of the position makes noise of the command, u = C (H / s) / (1 + C U / Kt) / (1 + loop) n / Kt, whose steps from
tick to tick are what the current loop and the ear get.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats
from ..control.stability import LinearAxis, error_response, impedance_nm_per_rps, over_loads, sweep_rad_per_s
from ..control.velocity_estimator import estimator_response
from .tuning import Gains

Complexes = npt.NDArray[np.complexfloating[Any, Any]]


class EstimateWorth(NamedTuple):
    """Gains on the estimated velocity against gains on the drive's, at the same margins."""

    integral_ratio: float  # of Ki Kt + L
    error_ratio: float  # of the squared error that friction outside the model leaves
    step_a: float  # rms of the steps of the command from tick to tick, by the counts of the position alone


def squared_error_of_a_step(axis: LinearAxis, gains: Gains) -> float:
    """Of a torque step of 1 Nm, rps^2 s, at the worst load of the axis."""
    return max(_squared_error(one, gains) for one in over_loads(axis))


def _squared_error(axis: LinearAxis, gains: Gains) -> float:
    omega = sweep_rad_per_s(axis.estimator)
    velocity = 1.0 / (impedance_nm_per_rps(axis, 1j * omega) + _feedback(axis, gains, omega))
    density = np.abs(velocity / omega) ** 2 / math.pi
    return float(np.trapezoid(density, omega))


def _controller(axis: LinearAxis, gains: Gains, s: Complexes) -> Complexes:
    proportional, integral, observer = gains.in_motion
    kt = axis.torque_constant_nm_per_a
    return np.asarray((proportional * kt + (integral * kt + observer) / s) * error_response(axis, s))


def _feedback(axis: LinearAxis, gains: Gains, omega: Floats) -> Complexes:
    """Torque against the velocity of the shaft, Nm/rps, with the delay."""
    s = 1j * omega
    controller = _controller(axis, gains, s)
    if axis.estimator is not None:
        known = estimator_response(axis.estimator, omega)
        by_command = known.of_command_rps_per_a * controller / axis.torque_constant_nm_per_a
        controller = known.of_position_per_s / s * controller / (1.0 + by_command)
    return np.asarray(controller * np.exp(-s * axis.delay_s))


def step_of_command_a(axis: LinearAxis, gains: Gains, position_noise_rev: float) -> float:
    """Root mean square of the steps that white noise of the position makes in the command from tick to tick.

    `position_noise_rev`: its standard deviation. The axis must have an estimator.
    """
    assert axis.estimator is not None
    period_s = axis.estimator.period_s
    omega = np.linspace(0.0, math.pi / period_s, 4097)[1:]
    s = 1j * omega
    feedback = _feedback(axis, gains, omega)
    loop = feedback / impedance_nm_per_rps(axis, s)
    per_rev = np.abs(feedback * s / (1.0 + loop)) / axis.torque_constant_nm_per_a
    steps = per_rev * np.abs(1.0 - np.exp(-s * period_s))
    density = position_noise_rev**2 * period_s / math.pi  # of white noise, per rad/s
    return math.sqrt(float(np.trapezoid(density * steps**2, omega)))
