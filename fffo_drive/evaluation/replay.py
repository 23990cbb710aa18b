"""Replay of recorded rows through law and envelope: the same blocks give the same commands, bit for bit.

A row holds all inputs of law and envelope, and names the parameters and effects in use, whose records have all values:
a recording proves what was computed. A changed law is run open loop on the same data, which shows what it would have
commanded. Reproduced are every term of the law, the command after the envelope, its limits, the I2t heat, the latched
fault and the controlword. Taken from the row are references, feedback and requests.

The memory of law and envelope is known from the start of a loop on, or from the record of it with which a file begins
(runtime/records). If rows were lost within a file, it is known again after the first row in which no torque was
requested; rows until then are counted as not replayed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..control.adaptation import NOTHING_ADAPTED, AdaptationState, adaptation_at_start
from ..control.compensation import (
    SUM_NM,
    TABLE_SIZE,
    compensation_rest,
    compensation_step,
    new_memory,
)
from ..control.controller import (
    CONTROLLER_BLOCK_SIZE,
    ControllerState,
    adapts_another_model,
    controller_at_rest,
    controller_step,
    unpack_controller,
    with_limited,
    with_new_gains,
    with_torque_lost,
)
from ..control.envelope import (
    LIMIT_CONTROLLER,
    TRIP_NONE,
    EnvelopeConfig,
    EnvelopeInputs,
    EnvelopeState,
    envelope_after_reset,
    envelope_at_rest,
    envelope_step,
    envelope_with_heat,
)
from ..control.feedforward import Reference
from ..control.own_law import USED, no_own_law, own_law_rest, own_law_step
from ..control.reference import MODE_CURRENT, MODE_VELOCITY
from ..control.velocity_estimator import (
    COMMANDS as COMMANDS_KEPT,
)
from ..control.velocity_estimator import (
    Measured,
    VelocityEstimatorState,
    estimator_at_rest,
    keep_command,
    velocity_estimator_step,
)
from ..drive.cia402 import GOAL_ENABLED, controlword_towards, is_operation_enabled
from ..jit import njit
from ..runtime.records import MemoryBefore
from ..runtime.tick import (
    FLAG_BUS_OFF,
    FLAG_EMERGENCY,
    FLAG_FOREIGN_COMMAND,
    FLAG_IGNORES_TARGET,
    FLAG_LOCAL_CONTROL,
    FLAG_LOOP_BEGAN,
    FLAG_NOT_OPERATIONAL,
    FLAG_REBOOT,
    FLAG_SETTINGS_CHANGED,
    LawOutput,
    give_adapted,
    goal_in_force,
    learn,
    terms_of_current,
)

Rows = np.ndarray[Any, np.dtype[np.void]]

# what is reproduced, by the names of the row
TERMS = (
    "error_rps", "filtered_error_rps", "proportional_a", "integral_a", "friction_nm", "inertia_nm", "effects_nm",
    "observation_nm_per_s", "requested_a", "estimated_rps", "disturbance_nm", "adapted_nm", "adapted_offset_nm",
    "adapted_coulomb_nm", "adapted_viscous_nm_per_rps", "hold_a",
)  # fmt: skip
COMMANDS = ("limited_a", "i2t_a2s")
WORDS = ("limits", "trip", "controlword")
REQUESTED = TERMS.index("requested_a")

_int64: Any = np.int64  # rows hold narrower integers; the law has been compiled for these


class InForce(NamedTuple):
    """Laws that rows refer to by their place."""

    parameters: Floats  # (m, CONTROLLER_BLOCK_SIZE), packed
    effects: Floats  # (t, TABLE_SIZE)
    envelope: EnvelopeConfig


class Memory(NamedTuple):
    """State of the replay: memory of the loop between two ticks, and data of the previous row."""

    known: bool  # False: the rest is invalid
    controller: ControllerState
    envelope: EnvelopeState
    parameters: int  # places in `InForce`
    effects: int
    trip: int
    controlword: int
    resetting: int
    row_number: int
    tick: int
    estimator: VelocityEstimatorState
    learned: AdaptationState
    adapted_nm: float  # in the row before


class Replayed(NamedTuple):
    """What was computed for rows (n,)."""

    terms: Floats  # (n, len(TERMS)); NaN if the law did not act
    commands: Floats  # (n, len(COMMANDS))
    words: Integers  # (n, len(WORDS))
    known: Integers  # (n,): 1 where the memory was known


def memory_at_start() -> Memory:
    """Before the first row."""
    return Memory(
        False, controller_at_rest(), envelope_at_rest(), 0, 0, 0, 0, 0, -1, -1, estimator_at_rest(),
        adaptation_at_start(), 0.0,
    )  # fmt: skip


def room_for(rows: int) -> Replayed:
    """Nothing computed yet."""
    return Replayed(
        np.full((rows, len(TERMS)), np.nan),
        np.full((rows, len(COMMANDS)), np.nan),
        np.zeros((rows, len(WORDS)), np.int64),
        np.zeros(rows, np.int64),
    )


@njit
def _reference_of(row: Any) -> Reference:
    return Reference(
        row["reference_rps"], row["reference_rps2"], row["reference_ahead_rps"], row["reference_ahead_rps2"],
        row["expected_rps"],
    )  # fmt: skip


@njit
def _measured_in(row: Any) -> Measured:
    """Inputs of the velocity estimator in the tick of this row."""
    return Measured(
        _int64(row["tick"]), row["deadline_ns"] + row["lateness_ns"], row["velocity_age"] == 0, row["position_rev"],
        row["velocity_rps"],
    )  # fmt: skip


@njit
def _seen_in(row: Any, requested_a: float, limited: bool, wanted: bool, skipped_ticks: int) -> EnvelopeInputs:
    """Inputs of the envelope in the tick of this row."""
    flags = _int64(row["flags"])
    statusword = _int64(row["statusword"])
    closed_loop = row["mode"] == MODE_VELOCITY
    return EnvelopeInputs(
        requested_a,
        row["velocity_rps"],
        row["position_rev"],
        row["expected_rps"] - row["velocity_rps"] if closed_loop else 0.0,
        _int64(row["velocity_age"]),
        _int64(row["status_age"]),
        statusword,
        1 if flags & FLAG_EMERGENCY else 0,
        1 if flags & FLAG_REBOOT else 0,
        flags & FLAG_NOT_OPERATIONAL != 0,
        flags & FLAG_BUS_OFF != 0,
        1 if flags & FLAG_FOREIGN_COMMAND else 0,
        _int64(row["heartbeat_age_ns"]),
        1 if flags & FLAG_SETTINGS_CHANGED else 0,
        wanted,
        is_operation_enabled(statusword),
        closed_loop,
        flags & FLAG_LOCAL_CONTROL != 0,
        flags & FLAG_IGNORES_TARGET != 0,
        skipped_ticks,
        limited,
    )


@njit
def replay_into(
    in_force: InForce, effects_memory: Floats, commands_a: Floats, own_law: Floats, memory: Memory, rows: Any,
    parameters_at: Integers, effects_at: Integers, out: Replayed,
) -> Memory:  # fmt: skip
    """Run law and envelope over rows (n,) of signals.ROW into `out`. Returns the memory behind the last one.

    `parameters_at`, `effects_at` (n,): index of the law named by each row; -1: unknown.
    """
    config = unpack_controller(in_force.parameters[memory.parameters])
    known, controller, envelope = memory.known, memory.controller, memory.envelope
    parameters, effects, estimator = memory.parameters, memory.effects, memory.estimator
    trip, controlword, resetting_before = memory.trip, memory.controlword, memory.resetting
    row_number, tick = memory.row_number, memory.tick
    learned, adapted_nm = memory.learned, memory.adapted_nm
    for k in range(rows.size):
        row = rows[k]
        resetting = _int64(row["resetting"])
        wanted = row["goal"] == GOAL_ENABLED and resetting == 0
        named = parameters_at[k] >= 0 and effects_at[k] >= 0
        follows = _int64(row["row_number"]) == (row_number + 1) & 0xFFFFFFFF
        if _int64(row["flags"]) & FLAG_LOOP_BEGAN:
            known, controller, envelope = True, controller_at_rest(), envelope_at_rest()
            estimator = estimator_at_rest()
            learned, adapted_nm = adaptation_at_start(), 0.0
            compensation_rest(effects_memory)
            own_law_rest(own_law)
            trip, controlword, resetting_before, tick = TRIP_NONE, 0, 0, -1
        known = known and named and (follows or tick < 0)
        if known:
            if parameters_at[k] != parameters:
                before, config = config, unpack_controller(in_force.parameters[parameters_at[k]])
                controller = with_new_gains(before, config, controller)
                if adapts_another_model(before, config):
                    controller = with_torque_lost(config, controller, adapted_nm)
                    learned, adapted_nm = adaptation_at_start(), 0.0
            if effects_at[k] != effects:
                controller = with_torque_lost(config, controller, effects_memory[SUM_NM])
                compensation_rest(effects_memory)
            if resetting > 0 and resetting >= resetting_before:  # it counts down, so a larger value is a new request
                trip = TRIP_NONE
                envelope = envelope_after_reset(envelope)
            requested_a = 0.0
            limited = False
            reference = _reference_of(row)
            moves = row["mode"] == MODE_VELOCITY
            adapted, terms = NOTHING_ADAPTED, terms_of_current(0.0)
            if moves:
                effects_nm = compensation_step(
                    in_force.effects[effects_at[k]], effects_memory, _int64(row["effects"]), reference,
                    row["position_rev"],
                )  # fmt: skip
                estimate, estimator = velocity_estimator_step(config.velocity, estimator, commands_a, _measured_in(row))
                toggle = _int64(row["toggle"])
                adapted, controller = give_adapted(
                    config, learned, controller, MODE_VELOCITY, reference, toggle, True, adapted_nm
                )
                if own_law[USED] != 0.0:
                    terms, controller = own_law_step(
                        own_law,
                        config,
                        controller,
                        reference,
                        effects_nm + adapted.torque_nm,
                        estimate.followed_rps,
                        row["position_rev"],
                    )
                else:
                    terms, controller = controller_step(
                        config,
                        controller,
                        toggle,
                        reference,
                        row["velocity_rps"],
                        effects_nm + adapted.torque_nm,
                        estimate.followed_rps,
                        row["position_rev"],
                    )
                requested_a, limited = terms.command_a, terms.limited
                out.terms[k, 0] = terms.error_rps
                out.terms[k, 1] = terms.filtered_error_rps
                out.terms[k, 2] = terms.proportional_a
                out.terms[k, 3] = terms.integral_a
                out.terms[k, 4] = terms.friction_nm
                out.terms[k, 5] = terms.inertia_nm
                out.terms[k, 6] = effects_nm
                out.terms[k, 7] = terms.observation_nm_per_s
                out.terms[k, 8] = terms.requested_a
                out.terms[k, 9] = estimate.estimated_rps
                out.terms[k, 10] = estimate.disturbance_nm
                out.terms[k, 11] = adapted.torque_nm
                out.terms[k, 12] = learned.offset_nm
                out.terms[k, 13] = learned.coulomb_nm
                out.terms[k, 14] = learned.viscous_nm_per_rps
                out.terms[k, 15] = terms.hold_a
            else:
                controller, estimator = controller_at_rest(), estimator_at_rest()
                compensation_rest(effects_memory)
                own_law_rest(own_law)
                if row["mode"] == MODE_CURRENT:
                    requested_a = row["requested_a"]
            skipped_ticks = _int64(row["tick"]) - tick - 1
            seen = _seen_in(row, requested_a, limited, wanted and trip == TRIP_NONE, skipped_ticks)
            command_a, limits, found, envelope = envelope_step(in_force.envelope, envelope, seen)
            if limits != 0:
                controller = with_limited(controller, True)
            adapted_nm = adapted.torque_nm
            if moves:
                law = LawOutput(MODE_VELOCITY, reference, terms, effects_nm, estimate)
                _, learned = learn(config, learned, adapted, law, controller)
            if limited:
                limits |= LIMIT_CONTROLLER
            if found != TRIP_NONE and trip == TRIP_NONE and resetting == 0:
                trip = found
            goal = goal_in_force(in_force.envelope, trip, _int64(row["goal"]), seen)
            controlword = controlword_towards(seen.statusword, goal, resetting > 0, controlword)
            out.commands[k, 0] = command_a if trip == TRIP_NONE else 0.0
            out.commands[k, 1] = envelope.i2t_a2s
            out.words[k, 0] = limits
            out.words[k, 1] = trip
            out.words[k, 2] = controlword
            out.known[k] = 1
        elif named and not wanted:
            # nothing acts and nothing is requested: law and envelope are at rest, with the I2t heat of the row; the
            # adaptation is not reset, and is known from the start of a loop only
            known = not unpack_controller(in_force.parameters[parameters_at[k]]).adaptation.used
            controller, estimator = controller_at_rest(), estimator_at_rest()
            compensation_rest(effects_memory)
            own_law_rest(own_law)
            envelope = envelope_with_heat(row["i2t_a2s"])
        keep_command(commands_a, _int64(row["tick"]), row["current_command_a"])
        # another law may have tripped where the axis continued: from here on the recorded course is used
        trip, controlword, resetting_before = _int64(row["trip"]), _int64(row["controlword"]), resetting
        row_number, tick = _int64(row["row_number"]), _int64(row["tick"])
        if named:
            if parameters_at[k] != parameters:
                config = unpack_controller(in_force.parameters[parameters_at[k]])
            parameters, effects = parameters_at[k], effects_at[k]
    return Memory(
        known, controller, envelope, parameters, effects, trip, controlword, resetting_before, row_number, tick,
        estimator, learned, adapted_nm,
    )  # fmt: skip


def law_in_force(parameters: list[Floats], effects: list[Floats], envelope: EnvelopeConfig) -> InForce:
    """Blocks and tables side by side."""
    return InForce(
        np.array(parameters).reshape(-1, CONTROLLER_BLOCK_SIZE), np.array(effects).reshape(-1, TABLE_SIZE), envelope
    )


class Replay:
    """The rows of one session, file by file."""

    def __init__(self, own_law: Floats | None = None) -> None:
        """`own_law`: the block of a user's law (control.own_law) in place of the loop's own."""
        self._own_law = no_own_law() if own_law is None else own_law
        self._memory = memory_at_start()
        self._effects_memory = new_memory()
        self._commands_a = np.zeros(COMMANDS_KEPT)

    def continues_with(self, row: Any) -> bool:
        """Whether the memory before this row is known."""
        return self._memory.known and int(row["row_number"]) == (self._memory.row_number + 1) & 0xFFFFFFFF

    def begin_from(self, before: MemoryBefore, parameters_at: int, effects_at: int) -> None:
        """Take a recorded memory. The places are those of the parameters and effects that were in use with it.

        It has none of a user's own law, which is known from its next start on.
        """
        law = before.packed.memory.law
        self._memory = Memory(
            self._own_law[USED] == 0.0,
            law.controller,
            before.packed.memory.envelope,
            parameters_at,
            effects_at,
            before.trip,
            before.controlword,
            before.resetting,
            before.row_number - 1,
            before.tick,
            law.estimator,
            law.learned,
            law.adapted.torque_nm,
        )
        self._effects_memory[:] = before.packed.effects
        self._commands_a[:] = before.packed.commands_a

    def run(self, in_force: InForce, rows: Rows, parameters_at: Integers, effects_at: Integers) -> Replayed:
        """The next rows; places in `in_force` stay what they are from call to call."""
        out = room_for(rows.size)
        if rows.size:
            self._memory = replay_into(
                in_force,
                self._effects_memory,
                self._commands_a,
                self._own_law,
                self._memory,
                rows,
                parameters_at,
                effects_at,
                out,
            )
        return out
