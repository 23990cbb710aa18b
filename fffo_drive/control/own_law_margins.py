"""Margins of a user's own control law: its step linearised in steady motion, in the loop with the model's axis.

    x' = A x + B_v dv + B_p dp,    di = C x + D_v dv + D_p dp,    H(z) = C (z - A)^-1 B + D,    z = exp(j w T)

The open loop is -(H_v + H_p / s) Kt P(s) exp(-Td s). Of a law that is not linear these are the margins at this speed.
An estimator of the velocity counts as its delay alone.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..arrays import Floats
from ..documents import DocumentError
from ..packing import pack, reader
from .own_law import ControlLaw, LawInput
from .stability import LinearAxis, Margins, impedance_nm_per_rps, margins_of, over_loads, over_resonances, worst_margins

SETTLING_S = 2.0  # of a motion at constant speed, before the law is linearised
STEP = 1e-6  # of the numeric derivative: of each number, or of one unit where it is smaller
LOW_HZ = 1e-2
POINTS = 4000


def own_law_margins(law: ControlLaw, axis: LinearAxis, seen: LawInput) -> Margins:
    """Phase and gain margin of a law in steady motion, the smallest ones over the loads and resonances of the axis.

    `seen`: what the law sees there, without an error. Raises DocumentError for a state that is not made of numbers.
    """
    omega = 2.0 * math.pi * np.geomspace(LOW_HZ, 0.5 / seen.period_s, POINTS)
    s = 1j * omega
    of_velocity, of_position = _responses(law, seen, omega)
    current_a_per_rps = -(of_velocity + of_position / s)
    found = []
    for load in over_loads(axis):
        for one in over_resonances(load):
            loop = current_a_per_rps * one.torque_constant_nm_per_a / impedance_nm_per_rps(one, s)
            found.append(margins_of(omega, loop, one.delay_s))
    return worst_margins(found)


def _responses(law: ControlLaw, seen: LawInput, omega: Floats) -> tuple[Any, Any]:
    """Current over velocity (A/rps) and over position (A/rev), each (n,)."""
    step = getattr(law.step, "py_func", law.step)
    try:
        numbers = pack(law.at_rest)
        state_of = reader(type(law.at_rest), "state_of")
    except (TypeError, AttributeError, KeyError) as error:
        raise DocumentError(
            f"controller {law.name!r}: margins need a state that is a NamedTuple of numbers: {error}"
        ) from None

    def after(memory: Floats, faster_rps: float = 0.0, further_rev: float = 0.0) -> Floats:
        """State and command behind one step."""
        moved = seen._replace(
            velocity_rps=seen.velocity_rps + faster_rps,
            error_rps=seen.expected_rps - seen.velocity_rps - faster_rps,
            position_rev=seen.position_rev + further_rev,
        )
        current_a, state = step(law.config, state_of(memory.tolist()), moved)
        return np.array([*pack(state), current_a])

    for _ in range(round(SETTLING_S / seen.period_s)):
        numbers = after(numbers)[:-1]

    def slope(direction: Floats, faster: float, further: float, length: float) -> Floats:
        forward = after(numbers + length * direction, length * faster, length * further)
        backward = after(numbers - length * direction, -length * faster, -length * further)
        return (forward - backward) / (2.0 * length)

    count = numbers.size
    unit, nowhere = np.eye(count), np.zeros(count)
    lengths = STEP * np.maximum(1.0, np.abs(numbers))
    columns = [slope(unit[k], 0.0, 0.0, float(lengths[k])) for k in range(count)]
    transition = np.array([column[:-1] for column in columns]).T.reshape(count, count)
    output = np.array([column[-1] for column in columns])
    inputs = slope(nowhere, 1.0, 0.0, STEP), slope(nowhere, 0.0, 1.0, STEP)
    z = np.exp(1j * omega * seen.period_s)
    resolvent = z[:, None, None] * np.eye(count) - transition
    entering = np.array([part[:-1] for part in inputs]).T.reshape(count, 2).astype(complex)
    inner = np.linalg.solve(resolvent, np.broadcast_to(entering, (omega.size, count, 2))) if count else None
    through = np.zeros((omega.size, 2)) if inner is None else np.einsum("k,nkj->nj", output, inner)
    return through[:, 0] + inputs[0][-1], through[:, 1] + inputs[1][-1]
