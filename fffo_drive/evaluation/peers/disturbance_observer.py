"""P with a disturbance observer (Ohnishi, Shibata and Murakami, IEEE/ASME T. Mechatronics 1, 1996), or the linear
extended state observer of Gao ("Scaling and bandwidth-parameterization based controller tuning", ACC 2003).

    d = Q(s) (Kt i(t - Td) - J s w),    Q = wo / (s + wo), or its square for the extended state observer

The command is delayed as in the axis, so that the observer does not mistake the delay for a disturbance. There is no
friction model: d is any missing torque, and is added to the command.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ...arrays import Floats
from ...control.feedforward import Reference, read_samples
from ...jit import njit
from ...packing import reader
from .constants import OWN, PeerConfig, command_for, filtered_error, remember

FIRST_NM = OWN  # estimate through the first low-pass
VELOCITY_RPS = OWN + 1  # of the last period
SECOND_NM = OWN + 2  # estimate through the second low-pass
HISTORY = OWN + 3  # commands, the last one first


class ObserverLoop(NamedTuple):
    """The law."""

    peer: PeerConfig
    inertia_nm_s2_per_rev: float  # of the observer
    bandwidth_rad_per_s: float
    order: int  # 1: disturbance observer, 2: extended state observer
    delay_ticks: float  # of the axis, hold included


unpack_observer = njit(reader(ObserverLoop, "unpack_observer"))


@njit
def observer_loop_step(parameters: Floats, memory: Floats, reference: Reference, velocity_rps: float) -> float:
    """The command (A) of one period."""
    config = unpack_observer(parameters)
    peer = config.peer
    error_rps = filtered_error(peer, memory, reference, velocity_rps)
    kept = math.exp(-config.bandwidth_rad_per_s * peer.period_s)
    history = memory[HISTORY:]
    # a difference of velocities is the acceleration half a period ago: the command that made it is as much older
    given_nm = peer.torque_constant_nm_per_a * read_samples(history, history.size, config.delay_ticks - 0.5)
    inertia_nm = config.inertia_nm_s2_per_rev * (velocity_rps - memory[VELOCITY_RPS]) / peer.period_s
    memory[VELOCITY_RPS] = velocity_rps
    unexplained_nm = given_nm - inertia_nm
    memory[FIRST_NM] = unexplained_nm + (memory[FIRST_NM] - unexplained_nm) * kept
    memory[SECOND_NM] = memory[FIRST_NM] + (memory[SECOND_NM] - memory[FIRST_NM]) * kept
    missing_nm = memory[SECOND_NM] if config.order == 2 else memory[FIRST_NM]
    command_a = command_for(peer, memory, reference, error_rps, missing_nm)
    remember(memory, HISTORY, command_a)
    return command_a
