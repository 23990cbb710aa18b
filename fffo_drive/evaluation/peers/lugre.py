"""LuGre friction observer (Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE TAC 40, 1995, section V).

    dz/dt = w - s0 |w| z / g(w) + (L / s0) e,    F = s0 z + s1 dz/dt + s2 w,    g(w) = Fc + (Fs - Fc) exp(-(|w|/Vs)^d)

w is the reference read ahead, e the error. The inputs are those of this project's friction observer, so both have the
same integral action L at the same margins.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ...arrays import Floats
from ...control.feedforward import Reference
from ...jit import njit
from ...packing import reader
from .constants import LIMITED, OWN, PeerConfig, command_for, filtered_error


class LugreModel(NamedTuple):
    """Constants of the friction model."""

    coulomb_nm: float
    static_nm: float
    stribeck_velocity_rps: float
    stribeck_exponent: float
    viscous_nm_per_rps: float
    stiffness_nm_per_rev: float  # s0
    damping_nm_per_rps: float  # s1


class LugreConfig(NamedTuple):
    """The law."""

    peer: PeerConfig
    model: LugreModel
    gain_nm_per_rev: float  # L


@njit
def stribeck_nm(
    coulomb_nm: float, static_nm: float, stribeck_velocity_rps: float, exponent: float, speed_rps: float
) -> float:
    """g(w): the level without viscous friction."""
    if speed_rps == 0.0:
        return static_nm
    return coulomb_nm + (static_nm - coulomb_nm) * math.exp(-math.pow(speed_rps / stribeck_velocity_rps, exponent))


@njit
def lugre_torque(
    model: LugreModel, bristles_nm: float, velocity_rps: float, observation_nm_per_s: float, period_s: float
) -> tuple[float, float]:
    """Friction torque and the new s0 z (Nm), exact for constant velocity and observation over a period."""
    speed_rps = abs(velocity_rps)
    level_nm = stribeck_nm(
        model.coulomb_nm, model.static_nm, model.stribeck_velocity_rps, model.stribeck_exponent, speed_rps
    )
    rate_per_s = model.stiffness_nm_per_rev * speed_rps / level_nm
    drive_nm_per_s = model.stiffness_nm_per_rev * velocity_rps + observation_nm_per_s
    exponent = rate_per_s * period_s
    mean = 1.0 if exponent < 1e-12 else -math.expm1(-exponent) / exponent  # of exp(-rate t) over the period
    after_nm = bristles_nm * math.exp(-exponent) + drive_nm_per_s * period_s * mean
    bending_rps = (after_nm - bristles_nm) / (model.stiffness_nm_per_rev * period_s)
    torque_nm = after_nm + model.damping_nm_per_rps * bending_rps + model.viscous_nm_per_rps * velocity_rps
    return torque_nm, after_nm


unpack_lugre = njit(reader(LugreConfig, "unpack_lugre"))


@njit
def lugre_step(parameters: Floats, memory: Floats, reference: Reference, velocity_rps: float) -> float:
    """The command (A) of one period."""
    config = unpack_lugre(parameters)
    error_rps = filtered_error(config.peer, memory, reference, velocity_rps)
    # frozen at rest and while the last command was limited, as in controller_step
    frozen = reference.ahead == 0.0 or memory[LIMITED] != 0.0
    observation = 0.0 if frozen else config.gain_nm_per_rev * error_rps
    torque_nm, memory[OWN] = lugre_torque(config.model, memory[OWN], reference.ahead, observation, config.peer.period_s)
    return command_for(config.peer, memory, reference, error_rps, torque_nm)
