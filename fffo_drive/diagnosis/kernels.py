"""Kernels of the diagnosis: the shared filter, the path that friction sees, and friction along it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import Floats
from ..jit import njit
from ..model.friction import FrictionConfig, FrictionState, friction_step, steady_friction_nm

HELD_SHARE = 3.0  # largest torque that friction holds at rest, in its own level: a missing effect may have raised it


@njit
def filter_rows(values: Floats, taps: Floats, step: int, output: Any) -> None:
    """A symmetric (zero-phase) filter, evaluated at every `step`-th sample: row j is centred on sample j*step.

    `values` (n,), `taps` (2h+1,), `output` (rows,). Beyond the ends the end values are repeated.
    """
    last = values.size - 1
    half = taps.size // 2
    for row in range(output.size):
        centre = row * step
        total = taps[half] * values[centre]
        if centre >= half and centre + half <= last:
            for k in range(1, half + 1):
                total += taps[half + k] * (values[centre - k] + values[centre + k])
        else:
            for k in range(1, half + 1):
                total += taps[half + k] * (values[max(0, centre - k)] + values[min(last, centre + k)])
        output[row] = total


@njit
def wave_rows(
    position_rev: Floats, velocity_rps: Floats, factor: Floats, order: float, lag_rev: float, response: Floats,
    points_per_hz: float, output: Any,
) -> None:  # fmt: skip
    """Cosine and sine of a wave of an order, times `factor`, after the filter. `output` (m, 2).

    `response` of the filter at frequencies `1 / points_per_hz` apart, linear between them. A friction that follows its
    level over a travel of `lag_rev` times |factor| gives a smaller, later wave.
    """
    last = response.size - 1
    for k in range(position_rev.size):
        place = abs(order * velocity_rps[k]) * points_per_hz
        first = min(int(place), last - 1)
        share = min(1.0, place - first)
        late = 2.0 * np.pi * order * lag_rev * abs(factor[k])
        height = (response[first] + share * (response[first + 1] - response[first])) * factor[k]
        angle = 2.0 * np.pi * order * position_rev[k]
        if late > 0.0:
            height /= np.sqrt(1.0 + late * late)
            angle -= np.arctan(late) * np.sign(velocity_rps[k])
        output[k, 0] = height * np.cos(angle)
        output[k, 1] = height * np.sin(angle)


@njit
def play_path(position_rev: Floats, half_width_rev: float, output: Any) -> None:
    """Position behind a play of +-`half_width_rev`: noise at rest is not motion. Shapes (n,)."""
    held = position_rev[0]
    for k in range(position_rev.size):
        if position_rev[k] > held + half_width_rev:
            held = position_rev[k] - half_width_rev
        elif position_rev[k] < held - half_width_rev:
            held = position_rev[k] + half_width_rev
        output[k] = held


@njit
def friction_along(
    config: FrictionConfig, path_rev: Floats, rest: Any, balance_nm: Floats, period_s: float, output: Any
) -> None:
    """2SEP friction along a path. `path_rev` (n,); `output` (n, 3): torque Nm, travel since reversal rev, direction.

    Where `rest` (n,) is true, friction balances the other torques, `balance_nm` (n,), since it creeps there by motions
    too small for the sensor. The next motion starts from that value as after a reversal.
    """
    state = FrictionState(0.0, 0.0, 0.0, 0.0)
    limit_nm = HELD_SHARE * max(config.static_nm, config.coulomb_nm)
    output[0, 0] = 0.0
    output[0, 1] = 0.0
    output[0, 2] = 0.0
    for k in range(1, path_rev.size):
        if rest[k]:
            torque_nm = min(limit_nm, max(-limit_nm, balance_nm[k]))
            state = FrictionState(torque_nm, 0.0, 0.0, 0.0)
        else:
            velocity_rps = (path_rev[k] - path_rev[k - 1]) / period_s
            if velocity_rps != 0.0:
                state = friction_step(config, state, velocity_rps, 0.0, period_s)
        output[k, 0] = state.torque_nm
        output[k, 1] = state.travel_rev
        output[k, 2] = state.direction


@njit
def contact_levels(config: FrictionConfig, velocity_rps: Floats, output: Any) -> None:
    """|S(w)| without its viscous part, along a motion. `velocity_rps`, `output` (n,)."""
    for k in range(velocity_rps.size):
        viscous_nm = config.viscous_nm_per_rps * abs(velocity_rps[k])
        output[k] = steady_friction_nm(config, velocity_rps[k]) - viscous_nm
