"""The simulated drive in process at a SYNC: advance the plant to now, latch the feedback, take the last command.

The CANopen node does the same with an object dictionary in between.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from ...jit import njit, when_compiling
from ...jit.by_address import address_of, emit_call, interpreted_kernel
from .braking import BrakeSettings, brake_kind, brake_step
from .cia402_device import (
    FAULT_REACTION_ACTIVE,
    NO_TRANSITION,
    OPERATION_ENABLED,
    QUICK_STOP_ACTIVE,
    SW_FOLLOWS_COMMAND,
    SW_INTERNAL_LIMIT,
    SW_REMOTE,
    SW_VOLTAGE_ENABLED,
    clears_target,
    device_step,
    follows_target,
    statusword_of,
)
from .plant import plant_advance, substeps_due
from .resolver import plant_latch
from .state import Floats, Integers, PlantParameters, PlantReport, PlantState

NO_STATUS = -1

# words of the drive
CLOCK_NS = 0  # time of the port's clock
DEVICE_STATE = 1
CONTROLWORD = 2  # of the last command
PREVIOUS_CONTROLWORD = 3  # that the device took at the previous SYNC
TARGET_PERMILLE = 4  # of the last command
FAULT_PRESENT = 5
QUICK_STOP_OPTION = 6
FAULT_REACTION_OPTION = 7
STATUS_PERIOD = 8
TURNAROUND_NS = 9
LATCHED_STATUSWORD = 10  # of this SYNC
SENT_STATUSWORD = 11  # NO_STATUS before the first
SYNC_NS = 12  # time of the last SYNC
SYNCS = 13
BRAKING = 14  # 1 when the power stage was on at the moment quick stop or fault reaction began
CYCLE_ADDRESS = 15  # of drive_cycle
N_WORDS = 16

# values of the drive
APPLIED_A = 0  # current that the drive applies
PERMILLE_PER_A = 1
RAMP_RPS = 2  # of the brake
LATCHED_RPS = 3
LATCHED_REV = 4
LATCHED_A = 5
LATCHED_TRUE_RPS = 6
LATCHED_FRICTION_NM = 7
COUNTS_PER_REV = 8
N_VALUES = 9


@njit
def _latch(values: Floats, report: PlantReport) -> None:
    values[LATCHED_RPS] = report.velocity_rps
    values[LATCHED_REV] = report.position_counts / values[COUNTS_PER_REV]
    values[LATCHED_A] = report.current_a
    values[LATCHED_TRUE_RPS] = report.true_velocity_rps
    values[LATCHED_FRICTION_NM] = report.true_friction_nm


@njit
def _brakes(
    words: Integers, values: Floats, brake: BrakeSettings, state: int, velocity_rps: float, step_s: float
) -> bool:
    """Run the brake of QUICK STOP ACTIVE or FAULT REACTION ACTIVE. True when it has ended."""
    option = words[QUICK_STOP_OPTION] if state == QUICK_STOP_ACTIVE else words[FAULT_REACTION_OPTION]
    kind = brake_kind(int(option))
    ramp_rps, current_a, done = brake_step(brake, kind, float(values[RAMP_RPS]), velocity_rps, step_s)
    values[RAMP_RPS] = ramp_rps
    values[APPLIED_A] = current_a
    return done


@njit
def _device(words: Integers, values: Floats, brake: BrakeSettings, velocity_rps: float, step_s: float) -> int:
    """The CiA 402 device takes the last command: sets the current to apply and returns the next state."""
    before = int(words[DEVICE_STATE])
    done = True
    if words[BRAKING] != 0:
        done = _brakes(words, values, brake, before, velocity_rps, step_s)
    controlword = int(words[CONTROLWORD])
    state, transition = device_step(
        before,
        controlword,
        int(words[PREVIOUS_CONTROLWORD]),
        words[FAULT_PRESENT] != 0,
        done,
        int(words[QUICK_STOP_OPTION]),
    )
    words[PREVIOUS_CONTROLWORD] = controlword
    words[DEVICE_STATE] = state
    if clears_target(transition):
        words[TARGET_PERMILLE] = 0
    if transition != NO_TRANSITION:
        powered = before in (OPERATION_ENABLED, QUICK_STOP_ACTIVE)
        words[BRAKING] = 1 if powered and state in (QUICK_STOP_ACTIVE, FAULT_REACTION_ACTIVE) else 0
        values[RAMP_RPS] = velocity_rps
    if follows_target(state):
        values[APPLIED_A] = words[TARGET_PERMILLE] / values[PERMILLE_PER_A]
    elif words[BRAKING] == 0:
        values[APPLIED_A] = 0.0
    elif transition != NO_TRANSITION:
        _brakes(words, values, brake, state, velocity_rps, 0.0)
    return state


@njit
def drive_cycle(
    parameters: PlantParameters, state: PlantState, brake: BrakeSettings, words: Integers, values: Floats
) -> None:
    """One SYNC at words[CLOCK_NS]: the plant advances with the current applied so far, then the device acts."""
    now_ns = int(words[CLOCK_NS])
    plant_advance(parameters, state, float(values[APPLIED_A]), substeps_due(state, now_ns))
    report = plant_latch(parameters, state)
    _latch(values, report)
    step_s = (now_ns - int(words[SYNC_NS])) / 1e9
    words[SYNC_NS] = now_ns
    words[SYNCS] += 1
    device_state = _device(words, values, brake, report.velocity_rps, step_s)
    bits = SW_VOLTAGE_ENABLED | SW_REMOTE
    if report.limited:
        bits |= SW_INTERNAL_LIMIT
    elif follows_target(device_state):
        bits |= SW_FOLLOWS_COMMAND
    words[LATCHED_STATUSWORD] = statusword_of(device_state, bits)


@cache
def _arguments() -> tuple[Any, ...]:
    """numba types of the arguments of `drive_cycle`."""
    from numba import types

    floats, table = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
    integers = types.Array(types.int64, 1, "C")
    return (
        types.NamedTuple((floats, integers, table, integers, table), PlantParameters),
        types.NamedTuple((floats, integers, table, floats, floats, table), PlantState),
        types.NamedUniTuple(types.float64, len(BrakeSettings._fields), BrakeSettings),
        integers,
        floats,
    )


@cache
def cycle_address() -> int:
    """Address of `drive_cycle` for `call_cycle`; compiles it when needed."""
    return address_of(drive_cycle, _arguments)


def call_cycle(
    parameters: PlantParameters, state: PlantState, brake: BrakeSettings, words: Integers, values: Floats
) -> None:
    """`drive_cycle` at words[CYCLE_ADDRESS]."""
    interpreted_kernel(int(words[CYCLE_ADDRESS]))(parameters, state, brake, words, values)


@when_compiling
def _for_kernels() -> None:
    """The same in compiled code."""
    from numba import types
    from numba.extending import intrinsic, overload

    @intrinsic  # type: ignore[untyped-decorator]
    def jump(typingctx: Any, address: Any, parameters: Any, state: Any, brake: Any, words: Any, values: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return emit_call(context, builder, _arguments(), arguments[0], arguments[1:])

        return types.void(types.int64, *_arguments()), codegen

    @overload(call_cycle)  # type: ignore[untyped-decorator]
    def call_compiled(parameters: Any, state: Any, brake: Any, words: Any, values: Any) -> Any:
        def implementation(parameters: Any, state: Any, brake: Any, words: Any, values: Any) -> None:
            jump(words[CYCLE_ADDRESS], parameters, state, brake, words, values)

        return implementation
