"""Feed-forward of generalised Maxwell slip friction (Al-Bender, Lampaert and Swevers, IEEE TAC 50, 2005) with PI.

Elements in parallel: one that sticks is a spring, dF/dt = k w; one that slips follows its share of the Stribeck level,
dF/dt = C (1 - F / S(w)); it sticks again when the motion reverses. All are driven by the reference read ahead; the
integral supplies what the model lacks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ...arrays import Floats
from ...control.feedforward import Reference
from ...jit import njit
from ...packing import reader
from .constants import OWN, PeerConfig, command_for, filtered_error
from .lugre import stribeck_nm

ELEMENTS = 4  # as in the publication's own experiments


class SlipModel(NamedTuple):
    """Constants of the friction model. The elements slip at equal shares of the level, one after the other."""

    coulomb_nm: float
    static_nm: float
    stribeck_velocity_rps: float
    stribeck_exponent: float
    viscous_nm_per_rps: float
    stiffness_nm_per_rev: float  # of the stiffest element; the next one has `stiffness_ratio` of it
    stiffness_ratio: float
    attraction_nm_per_s: float  # C


class SlipConfig(NamedTuple):
    """The law."""

    peer: PeerConfig
    model: SlipModel


@njit
def slip_torque(model: SlipModel, memory: Floats, velocity_rps: float, period_s: float) -> float:
    """Friction torque (Nm) after a period at a constant velocity; memory[OWN:]: torque and slip of each element."""
    direction = 1.0 if velocity_rps > 0.0 else -1.0
    speed_rps = abs(velocity_rps)
    level_nm = stribeck_nm(
        model.coulomb_nm, model.static_nm, model.stribeck_velocity_rps, model.stribeck_exponent, speed_rps
    )
    share_nm = level_nm / ELEMENTS
    stiffness = model.stiffness_nm_per_rev
    total_nm = model.viscous_nm_per_rps * velocity_rps
    for k in range(ELEMENTS):
        place = OWN + 2 * k
        if speed_rps > 0.0:
            load_nm = direction * memory[place]
            slips = direction * memory[place + 1] > 0.0
            if slips:
                decay = math.exp(-model.attraction_nm_per_s * period_s / level_nm)
                load_nm = share_nm + (load_nm - share_nm) * decay
            else:
                load_nm += stiffness * speed_rps * period_s
                if load_nm >= share_nm:
                    load_nm, slips = share_nm, True
            memory[place] = direction * load_nm
            memory[place + 1] = direction if slips else 0.0
        total_nm += memory[place]
        stiffness *= model.stiffness_ratio
    return total_nm


unpack_slip = njit(reader(SlipConfig, "unpack_slip"))


@njit
def slip_step(parameters: Floats, memory: Floats, reference: Reference, velocity_rps: float) -> float:
    """The command (A) of one period."""
    config = unpack_slip(parameters)
    error_rps = filtered_error(config.peer, memory, reference, velocity_rps)
    torque_nm = slip_torque(config.model, memory, reference.ahead, config.peer.period_s)
    return command_for(config.peer, memory, reference, error_rps, torque_nm)
