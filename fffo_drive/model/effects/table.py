"""Effects for the kernels: packed tables, one step, and a whole followed record at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ...arrays import Floats, Integers
from ...documents import DocumentError
from ...jit import njit
from ...jit.by_address import call_on_vectors, vectors_address
from ..axis import AxisConfig
from . import slots as s
from .law import Law
from .registry import LAWS, law_of, vector_of
from .slots import AxisFacts, new_signals


class EffectTable(NamedTuple):
    """Effects of one axis with their memory. Without effects the arrays have no rows, and no effect code runs."""

    addresses: Integers  # (effects,)
    parameters: Floats  # (effects, slots.MAX_PARAMETERS)
    memory: Floats  # (effects, slots.MEMORY_SLOTS)
    signals: Floats  # (slots.N_SLOTS,)


class Term(NamedTuple):
    """An effect by name with its parameters; missing ones are zero (strengths) or typical (shapes)."""

    name: str
    values: Mapping[str, float]


def kernel_address(law: Law, feedforward: bool) -> int:
    """Address of a law's kernel, in a controller where `feedforward`. Raises DocumentError if it does not compile."""
    kernel = law.feedforward if feedforward and law.feedforward is not None else law.kernel
    try:
        return vectors_address(kernel)
    except Exception as error:
        if LAWS.brought_by(law.name) is None:
            raise
        text = " ".join(str(error).split())
        raise DocumentError(
            f"effect {law.name!r}: its kernel does not compile: it may use numbers, math, the three vectors and other "
            f"kernels, and allocate nothing: {text}"
        ) from error


def effect_table(
    terms: Sequence[Term], axis: AxisConfig, step_s: float, facts: AxisFacts | None = None, feedforward: bool = False
) -> EffectTable:
    """Pack effects for an axis, memory at rest. With `feedforward`, the kernels of a controller."""
    count = len(terms)
    addresses = np.zeros(count, np.int64)
    parameters = np.zeros((count, s.MAX_PARAMETERS))
    for k, term in enumerate(terms):
        addresses[k] = kernel_address(law_of(term.name), feedforward)
        vector = vector_of(term.name, term.values)
        parameters[k, : len(vector)] = vector
    return EffectTable(addresses, parameters, np.zeros((count, s.MEMORY_SLOTS)), new_signals(axis, step_s, facts))


@njit
def derive_signals(signals: Floats) -> None:
    """Compute the signals derived from the motion: torque, contact, grip, rest; set the outputs to zero."""
    velocity_rps = signals[s.VELOCITY_RPS]
    speed_rps = abs(velocity_rps)
    step_s = signals[s.STEP_S]
    signals[s.MOTOR_TORQUE_NM] = signals[s.TORQUE_CONSTANT_NM_PER_A] * signals[s.CURRENT_A]
    contact_nm = signals[s.FRICTION_NM] - signals[s.VISCOUS_NM_PER_RPS] * velocity_rps
    signals[s.CONTACT_NM] = contact_nm
    signals[s.GRIP] = min(1.0, max(-1.0, contact_nm / signals[s.COULOMB_NM]))
    if speed_rps < signals[s.REST_SPEED_RPS]:
        if signals[s.RESTING] == 0.0:
            signals[s.RESTING] = 1.0
            signals[s.REST_S] = 0.0
            signals[s.SLIDE_REV] = 0.0
        signals[s.REST_S] += step_s
    else:
        signals[s.RESTING] = 0.0
        signals[s.SLIDE_REV] += speed_rps * step_s
    signals[s.LOAD_NM] = 0.0
    signals[s.SENSOR_REV] = 0.0


@njit
def effects_step(table: EffectTable) -> None:
    """Run all effects on the motion in the signals; LOAD_NM and SENSOR_REV are their sums."""
    derive_signals(table.signals)
    for k in range(table.addresses.size):
        call_on_vectors(table.addresses[k], table.signals, table.parameters[k], table.memory[k])


@njit
def along_into(table: EffectTable, motion: Floats, load_nm: Floats, sensor_rev: Floats) -> None:
    """Run the effects over rows of motion (n, slots.N_MOTION); `load_nm`, `sensor_rev` (n,)."""
    signals = table.signals
    for k in range(motion.shape[0]):
        for slot in range(s.N_MOTION):
            signals[slot] = motion[k, slot]
        effects_step(table)
        load_nm[k] = signals[s.LOAD_NM]
        sensor_rev[k] = signals[s.SENSOR_REV]


def effects_along(
    terms: Sequence[Term], motion: Floats, axis: AxisConfig, period_s: float, feedforward: bool = False
) -> tuple[Floats, Floats]:
    """(torque of the effects (n,) Nm, error of the sensor (n,) rev) along a followed record.

    `motion` (n, slots.N_MOTION), columns as numbered in `slots`. The same kernels as in a simulation, from rest; with
    `feedforward` the current of the motion is that without the effects.
    """
    table = effect_table(terms, axis, period_s, feedforward=feedforward)
    table.signals[s.AT_INSTANTS] = 1.0
    load_nm, sensor_rev = np.empty(motion.shape[0]), np.empty(motion.shape[0])
    along_into(table, np.ascontiguousarray(motion, dtype=np.float64), load_nm, sensor_rev)
    return load_nm, sensor_rev
