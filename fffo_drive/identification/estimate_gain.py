"""What the estimated velocity is worth on an axis: the error that friction outside the model leaves, and its noise.

Friction reverses in steps, whose spectrum falls as 1/w. With the velocity of the shaft T per torque beside the model,
the squared error of such a step is, by Parseval's theorem, the integral of |T(jw) / w|^2 / pi. With the drive's
velocity

    T = 1 / (Z + C exp(-s Td)),

with the estimate H p + U i of position and command the loop is closed at the current (control/stability):

    T = 1 / (Z + C (H / s) exp(-s Td) / (1 + C U / Kt)).

Noise n of the velocity that the loop sees moves the shaft by -loop / (1 + loop) n, and makes the command
u = C / (1 + loop) n / Kt, whose steps from tick to tick are what the current loop and the ear get. With the estimate
the position's noise counts, with n its derivative and C (H / s) / (1 + C U / Kt) for C.
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

WORTH_ERROR_RATIO = 0.8  # of squared errors (results/velocity.md, by sensor and noise)
NOISE_POINTS = 4096  # from 0 to half the rate

Complexes = npt.NDArray[np.complexfloating[Any, Any]]


class EstimateWorth(NamedTuple):
    """Gains on the estimated velocity against gains on the drive's, at the same margins."""

    integral_ratio: float  # of Ki Kt + L
    error_ratio: float  # of the squared error that friction outside the model, and noise where it is known, make
    step_a: float  # rms of the steps of the command from tick to tick by noise; by the counts alone where not known ...
    drive_step_a: float | None  # ... and with the drive's velocity; None: commissioning has measured no noise

    @property
    def gains(self) -> bool:
        """Whether clearly less error is left."""
        return self.error_ratio <= WORTH_ERROR_RATIO


class Noise(NamedTuple):
    """One-sided power spectral density of the noise of what the loop sees: of a velocity, or of a position."""

    frequency_hz: Floats  # (n,) rising; constant beyond
    density_per_hz: Floats  # (n,) rps^2/Hz or rev^2/Hz
    of_position: bool = False

    def of_velocity(self, frequency_hz: Floats) -> Floats:
        """Of a position's derivative, or of the velocity itself, rps^2/Hz; (k,) each."""
        density = np.interp(frequency_hz, self.frequency_hz, self.density_per_hz)
        return density * (2.0 * math.pi * frequency_hz) ** 2 if self.of_position else density


class LoopNoise(NamedTuple):
    """What the sensor's noise does in a closed loop."""

    shaft_rps2: float  # variance of the shaft's velocity
    step_a: float  # rms of the steps of the command from tick to tick


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


def white_position(noise_rev: float, period_s: float) -> Noise:
    """White noise of a sampled position with this standard deviation."""
    return Noise(np.array([0.0]), np.array([2.0 * noise_rev**2 * period_s]), of_position=True)


def noise_in_loop(axis: LinearAxis, gains: Gains, noise: Noise, period_s: float) -> LoopNoise:
    """What noise of the velocity that the loop sees does, at the worst load of the axis."""
    found = [_noise_in_loop(one, gains, noise, period_s) for one in over_loads(axis)]
    return LoopNoise(max(one.shaft_rps2 for one in found), max(one.step_a for one in found))


def _noise_in_loop(axis: LinearAxis, gains: Gains, noise: Noise, period_s: float) -> LoopNoise:
    width_hz = 0.5 / period_s / NOISE_POINTS
    frequency_hz = np.linspace(0.5 * width_hz, 0.5 / period_s - 0.5 * width_hz, NOISE_POINTS)
    density = noise.of_velocity(frequency_hz)
    omega = 2.0 * math.pi * frequency_hz
    s = 1j * omega
    feedback = _feedback(axis, gains, omega)
    loop = feedback / impedance_nm_per_rps(axis, s)
    shaft = np.abs(loop / (1.0 + loop)) ** 2
    per_rps = np.abs(feedback / (1.0 + loop)) / axis.torque_constant_nm_per_a
    steps = per_rps * np.abs(1.0 - np.exp(-s * period_s))
    return LoopNoise(
        width_hz * float(np.sum(density * shaft)),
        math.sqrt(width_hz * float(np.sum(density * steps**2))),
    )
