"""Feed-forward of effects: the torque that they take according to the model, added to the command.

E(t + Td) is computed by the model's own kernels on signals that are known when the command is computed:

    speed, acceleration, friction, travel   of the reference read ahead, with a separate 2SEP friction without lambda(e)
    torque                                   what inertia, friction and the effects before it in the list need
    motor angle                              measured, extrapolated by the delay along the reference

Each effect has its own limit, and their sum another. Everything but the angle is a bounded function of
the reference: an exogenous bounded input, under which (11) and (14) remain valid. The angle is feedback through a
bounded function with slope q = |dE/d(angle)| in Nm/rev, which acts like the integral gain: Ki Kt + L - q must
satisfy (14), and Ki Kt + L + q the margins. That is checked on the model before anything moves (config/effects); it is
the worst case, in which the axis does not have the effect. If it does, the two slopes cancel.

An effect is switched on and off with a ramp. The table and its memory are flat arrays of float64, so that they
can change between two ticks; without effects only the first number is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..jit import njit
from ..jit.by_address import call_on_vectors, vector_kernel_at
from ..model.axis import AxisConfig
from ..model.effects import slots as s
from ..model.effects.registry import law_of, law_of_kernel
from ..model.effects.table import Term, derive_signals, effect_table, kernel_address
from ..model.friction import FrictionConfig, FrictionState, friction_step
from ..packing import flat_names, pack, reader
from .feedforward import Reference

MOST_EFFECTS = 8
ALL_EFFECTS = (1 << MOST_EFFECTS) - 1
RAMP_S = 0.25  # into service and out of it

# places in the table
COUNT = 0
TOTAL_LIMIT_NM = 1
LEAD_S = 2  # from the measured position to the torque of this tick's command
FRICTION = 3  # FrictionConfig, packed
SIGNALS = FRICTION + len(flat_names(FrictionConfig))  # at rest, with the constants of the axis
FIRST_EFFECT = SIGNALS + s.N_SLOTS
ADDRESS = 0  # of an effect's part
LIMIT_NM = 1
PARAMETERS = 2
EFFECT_SIZE = PARAMETERS + s.MAX_PARAMETERS
TABLE_SIZE = FIRST_EFFECT + MOST_EFFECTS * EFFECT_SIZE

# places in the memory
RUNNING = 0  # 1 after the first step
SUM_NM = 1  # of the last step
PATH = 2  # friction on the reference: torque, travel, omega, direction
NOW = 6  # signals
GAINS = NOW + s.N_SLOTS
FIRST_MEMORY = GAINS + MOST_EFFECTS
MEMORY_SIZE = FIRST_MEMORY + MOST_EFFECTS * s.MEMORY_SLOTS


class Limits(NamedTuple):
    """Bounds of the added torque."""

    each_nm: float
    total_nm: float


def no_compensation() -> Floats:
    """A table without effects. (TABLE_SIZE,)"""
    return np.zeros(TABLE_SIZE)


def new_memory() -> Floats:
    """Memory at rest. (MEMORY_SIZE,)"""
    return np.zeros(MEMORY_SIZE)


def order_of_service(terms: Sequence[Term]) -> list[int]:
    """Positions of the terms in the order of computation: those that depend on torque come last."""
    return sorted(range(len(terms)), key=lambda k: law_of(terms[k].name).feedforward is not None)


def pack_compensation(
    terms: Sequence[Term], axis: AxisConfig, lead_s: float, limits: Limits, period_s: float
) -> Floats:
    """The table of effects, in the order given (`order_of_service`). Raises ValueError for more than MOST_EFFECTS."""
    if len(terms) > MOST_EFFECTS:
        raise ValueError(f"{len(terms)} effects: the loop compensates at most {MOST_EFFECTS}")
    packed = no_compensation()
    source = effect_table(terms, axis, period_s, feedforward=True)
    packed[COUNT], packed[TOTAL_LIMIT_NM], packed[LEAD_S] = len(terms), limits.total_nm, lead_s
    packed[FRICTION:SIGNALS] = pack(axis.friction)
    packed[SIGNALS : SIGNALS + s.N_SLOTS] = source.signals
    for k in range(len(terms)):
        part = _part(packed, k)
        part[ADDRESS], part[LIMIT_NM] = source.addresses[k], limits.each_nm
        part[PARAMETERS:] = source.parameters[k]
    return packed


def effect_names(table: Floats) -> list[str]:
    """Laws of the effects in a table, in the order of their bits."""
    return [law_of_kernel(vector_kernel_at(int(_part(table, k)[ADDRESS]))) for k in range(int(table[COUNT]))]


def table_numbers(table: Floats) -> tuple[list[str], Floats]:
    """(names, numbers): the process-independent part of a table, without addresses and unused parameters."""
    names = ["count", "total_limit_nm", "lead_s", *flat_names(FrictionConfig, "friction.")]
    names += [f"signal.{name}" for name in s.SIGNAL_NAMES]
    parts = [table[:FIRST_EFFECT]]
    for k, law in enumerate(effect_names(table)):
        own = [parameter.name for parameter in law_of(law).parameters]
        names += [f"effect_{k}.{name}" for name in ("limit_nm", *own)]
        parts.append(_part(table, k)[LIMIT_NM : PARAMETERS + len(own)])
    return names, np.concatenate(parts)


class PortableEffects(NamedTuple):
    """A table for another process, in which the kernels have other addresses."""

    numbers: Floats
    laws: tuple[str, ...]

    @staticmethod
    def of(table: Floats) -> PortableEffects:
        """Of a table of this process."""
        return PortableEffects(table_numbers(table)[1], tuple(effect_names(table)))

    def table(self) -> Floats:
        """The table for this process. Raises KeyError for a law that is not known in it."""
        return table_of(list(self.numbers), self.laws)


def table_of(numbers: Sequence[float], laws: Sequence[str]) -> Floats:
    """A table for this process: the inverse of `table_numbers`, with `effect_names`.

    Raises ValueError for numbers that are no table of these laws, KeyError for a law that is not known.
    """
    sizes = [1 + len(law_of(name).parameters) for name in laws]
    if len(numbers) != FIRST_EFFECT + sum(sizes) or numbers[COUNT] != len(laws) or len(laws) > MOST_EFFECTS:
        raise ValueError(f"{len(numbers)} numbers are no table of {len(laws)} effects")
    table = no_compensation()
    table[:FIRST_EFFECT] = numbers[:FIRST_EFFECT]
    begin = FIRST_EFFECT
    for k, (name, size) in enumerate(zip(laws, sizes, strict=True)):
        part, law = _part(table, k), law_of(name)
        part[ADDRESS] = kernel_address(law, feedforward=True)
        part[LIMIT_NM : LIMIT_NM + size] = numbers[begin : begin + size]
        begin += size
    return table


def _part(table: Floats, effect: int) -> Floats:
    return table[FIRST_EFFECT + effect * EFFECT_SIZE :][:EFFECT_SIZE]


_unpack_friction = njit(reader(FrictionConfig, "unpack_friction"))


@njit
def compensation_rest(memory: Floats) -> None:
    """Clear the memory if it is not clear: the law does not act, or the table is new."""
    if memory[RUNNING] != 0.0:
        for k in range(memory.size):
            memory[k] = 0.0


@njit
def _path_friction(table: Floats, memory: Floats, velocity_rps: float, period_s: float) -> FrictionState:
    """Friction on the reference, independent of the error."""
    config = _unpack_friction(table[FRICTION:SIGNALS])
    before = FrictionState(memory[PATH], memory[PATH + 1], memory[PATH + 2], memory[PATH + 3])
    state = friction_step(config, before, velocity_rps, 0.0, period_s)
    memory[PATH] = state.torque_nm
    memory[PATH + 1] = state.travel_rev
    memory[PATH + 2] = state.omega_nm
    memory[PATH + 3] = state.direction
    return state


@njit
def _show_motion(signals: Floats, friction: FrictionState, reference: Reference, angle_rev: float) -> None:
    needed_nm = signals[s.INERTIA_NM_S2_PER_REV] * reference.ahead_derivative + friction.torque_nm
    signals[s.TIME_S] += signals[s.STEP_S]
    signals[s.VELOCITY_RPS] = reference.ahead
    signals[s.ACCELERATION_RPS2] = reference.ahead_derivative
    signals[s.MOTOR_ANGLE_REV] = angle_rev
    signals[s.SENSOR_ANGLE_REV] = angle_rev
    signals[s.CURRENT_A] = needed_nm / signals[s.TORQUE_CONSTANT_NM_PER_A]
    signals[s.FRICTION_NM] = friction.torque_nm
    signals[s.TRAVEL_REV] = friction.travel_rev
    signals[s.DIRECTION] = friction.direction
    derive_signals(signals)


@njit
def compensation_step(
    table: Floats, memory: Floats, in_service: int, reference: Reference, position_rev: float
) -> float:
    """Torque (Nm) to add for the effects in service (bits of `in_service`) in this tick. 0 without effects."""
    count = int(table[COUNT])
    if count == 0:
        return 0.0
    signals = memory[NOW : NOW + s.N_SLOTS]
    if memory[RUNNING] == 0.0:
        memory[RUNNING] = 1.0
        for k in range(s.N_SLOTS):
            signals[k] = table[SIGNALS + k]
    period_s = signals[s.STEP_S]
    friction = _path_friction(table, memory, reference.ahead, period_s)
    angle_rev = position_rev + 0.5 * table[LEAD_S] * (reference.expected + reference.ahead)
    _show_motion(signals, friction, reference, angle_rev)
    ramp = period_s / RAMP_S
    for k in range(count):
        part = FIRST_EFFECT + k * EFFECT_SIZE
        own = FIRST_MEMORY + k * s.MEMORY_SLOTS
        before_nm = signals[s.LOAD_NM]
        call_on_vectors(
            int(table[part + ADDRESS]),
            signals,
            table[part + PARAMETERS : part + EFFECT_SIZE],
            memory[own : own + s.MEMORY_SLOTS],
        )
        limit_nm = table[part + LIMIT_NM]
        torque_nm = min(max(signals[s.LOAD_NM] - before_nm, -limit_nm), limit_nm)
        wanted = 1.0 if (in_service >> k) & 1 else 0.0
        gain = memory[GAINS + k]
        gain = min(wanted, gain + ramp) if gain < wanted else max(wanted, gain - ramp)
        memory[GAINS + k] = gain
        signals[s.LOAD_NM] = before_nm + gain * torque_nm
    limit_nm = table[TOTAL_LIMIT_NM]
    sum_nm = min(max(signals[s.LOAD_NM], -limit_nm), limit_nm)
    memory[SUM_NM] = sum_nm
    return float(sum_nm)


@njit
def effects_in_service(table: Floats, in_service: int) -> int:
    """The bits of the effects that are in the table."""
    return in_service & ((1 << int(table[COUNT])) - 1)
