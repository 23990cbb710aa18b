"""The common part of all peers: PI on the same error, inertia and preview from the same reference, the same limit.

A law is a step that returns the command. Its memory is a flat vector, initially zero, that begins with the PI's slots.
"""

from __future__ import annotations

from typing import NamedTuple

from ...arrays import Floats
from ...control.feedforward import FeedforwardConfig, Reference
from ...control.pi import PiConfig, pi_step
from ...control.velocity_estimator import DRIVE_VELOCITY, VelocityEstimatorConfig
from ...jit import njit
from ...packing import reader

INTEGRAL_A = 0
ERROR_RPS = 1  # filtered
LIMITED = 2  # 1 when the last command was
OWN = 3  # where the memory of a law begins
MEMORY_SLOTS = 96


class PeerConfig(NamedTuple):
    """The part of a law that all have in common."""

    pi: PiConfig
    feedforward: FeedforwardConfig
    torque_constant_nm_per_a: float
    current_limit_a: float
    period_s: float
    error_share: float  # weight of a new error in the filter, per period
    velocity: VelocityEstimatorConfig = DRIVE_VELOCITY  # of the error


unpack_peer = njit(reader(PeerConfig, "unpack_peer"))


@njit
def filtered_error(config: PeerConfig, memory: Floats, reference: Reference, velocity_rps: float) -> float:
    """The error that drives the law, in rps; the reference is as old as the feedback."""
    error_rps = reference.expected - velocity_rps
    memory[ERROR_RPS] += config.error_share * (error_rps - memory[ERROR_RPS])
    return float(memory[ERROR_RPS])


@njit
def command_for(config: PeerConfig, memory: Floats, reference: Reference, error_rps: float, torque_nm: float) -> float:
    """PI, inertia torque and the law's own torque as a current (A), limited."""
    inertia_nm = config.feedforward.inertia_nm_s2_per_rev * reference.ahead_derivative
    forward_a = (torque_nm + inertia_nm) / config.torque_constant_nm_per_a
    limit_a = config.current_limit_a
    proportional_a, memory[INTEGRAL_A] = pi_step(
        config.pi, memory[INTEGRAL_A], error_rps, forward_a, limit_a, memory[LIMITED] != 0.0, config.period_s
    )
    wanted_a = proportional_a + memory[INTEGRAL_A] + forward_a
    command_a = min(max(wanted_a, -limit_a), limit_a)
    memory[LIMITED] = 1.0 if command_a != wanted_a else 0.0
    return float(command_a)


@njit
def pi_with_offset_step(
    parameters: Floats, memory: Floats, reference: Reference, velocity_rps: float, added_nm: float
) -> float:
    """The command (A) of one period of PI beside a torque that comes from elsewhere."""
    config = unpack_peer(parameters)
    return command_for(config, memory, reference, filtered_error(config, memory, reference, velocity_rps), added_nm)


@njit
def remember(memory: Floats, first: int, command_a: float) -> None:
    """Put a command before the earlier ones, which are kept from `first` to the end of the memory."""
    for place in range(MEMORY_SLOTS - 1, first, -1):
        memory[place] = memory[place - 1]
    memory[first] = command_a
