"""The drive's side of the CiA 402 state machine (IEC 61800-7-201), for the in-process port and the CANopen node.

`TRANSITIONS` is the whole machine; `device_step` makes at most one transition per call. A controlword acts by level:
repeating it continues (enable operation takes READY TO SWITCH ON through SWITCHED ON in two calls). Only fault reset
acts on an edge, of bit 7. A word that commands nothing in the present state is ignored.

A word with bit 7 set commands no transition towards torque. "Disable voltage" and "quick stop" are obeyed whatever
bit 7 is: a drive must not miss a stop because a reset bit was not cleared.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...jit import njit

# states, in the order of the standard; START is the moment of power-on
NOT_READY = 0
SWITCH_ON_DISABLED = 1
READY_TO_SWITCH_ON = 2
SWITCHED_ON = 3
OPERATION_ENABLED = 4
QUICK_STOP_ACTIVE = 5
FAULT_REACTION_ACTIVE = 6
FAULT = 7
START = 8

STATE_NAMES = (
    "not ready to switch on",
    "switch on disabled",
    "ready to switch on",
    "switched on",
    "operation enabled",
    "quick stop active",
    "fault reaction active",
    "fault",
    "start",
)

# causes of a transition: the commands of the controlword, and events in the drive
NO_CAUSE = 0
SHUTDOWN = 1
SWITCH_ON = 2  # the same bits mean "disable operation" in OPERATION_ENABLED
ENABLE_OPERATION = 3
DISABLE_VOLTAGE = 4
QUICK_STOP = 5
FAULT_RESET = 6
AUTOMATIC = 7
REACTION_DONE = 8  # quick stop or fault reaction has ended
FAULT_DETECTED = 9
N_CAUSES = 10

# controlword bits (0x6040)
CW_SWITCH_ON = 0x0001
CW_ENABLE_VOLTAGE = 0x0002
CW_QUICK_STOP = 0x0004  # active low
CW_ENABLE_OPERATION = 0x0008
CW_FAULT_RESET = 0x0080

# statusword bits (0x6041) that are not part of the state
SW_VOLTAGE_ENABLED = 0x0010
SW_WARNING = 0x0080
SW_REMOTE = 0x0200
SW_TARGET_REACHED = 0x0400
SW_INTERNAL_LIMIT = 0x0800
SW_FOLLOWS_COMMAND = 0x1000  # in the cyclic synchronous modes

# quick stop option code 0x605A: from this value on the drive stays in QUICK_STOP_ACTIVE after it has stopped
QUICK_STOP_STAYS = 5
QUICK_STOP_OPTION_DEFAULT = 2  # brake on the quick stop ramp, then SWITCH_ON_DISABLED (CiA 402 default)


class DeviceTransition(NamedTuple):
    """One arrow of the CiA 402 state diagram, with the number that the standard gives it."""

    number: int
    source: int
    target: int
    cause: int


TRANSITIONS: tuple[DeviceTransition, ...] = (
    DeviceTransition(0, START, NOT_READY, AUTOMATIC),
    DeviceTransition(1, NOT_READY, SWITCH_ON_DISABLED, AUTOMATIC),
    DeviceTransition(2, SWITCH_ON_DISABLED, READY_TO_SWITCH_ON, SHUTDOWN),
    DeviceTransition(3, READY_TO_SWITCH_ON, SWITCHED_ON, SWITCH_ON),
    DeviceTransition(3, READY_TO_SWITCH_ON, SWITCHED_ON, ENABLE_OPERATION),  # the next call makes transition 4
    DeviceTransition(4, SWITCHED_ON, OPERATION_ENABLED, ENABLE_OPERATION),
    DeviceTransition(5, OPERATION_ENABLED, SWITCHED_ON, SWITCH_ON),
    DeviceTransition(6, SWITCHED_ON, READY_TO_SWITCH_ON, SHUTDOWN),
    DeviceTransition(7, READY_TO_SWITCH_ON, SWITCH_ON_DISABLED, DISABLE_VOLTAGE),
    DeviceTransition(7, READY_TO_SWITCH_ON, SWITCH_ON_DISABLED, QUICK_STOP),
    DeviceTransition(8, OPERATION_ENABLED, READY_TO_SWITCH_ON, SHUTDOWN),
    DeviceTransition(9, OPERATION_ENABLED, SWITCH_ON_DISABLED, DISABLE_VOLTAGE),
    DeviceTransition(10, SWITCHED_ON, SWITCH_ON_DISABLED, DISABLE_VOLTAGE),
    DeviceTransition(10, SWITCHED_ON, SWITCH_ON_DISABLED, QUICK_STOP),
    DeviceTransition(11, OPERATION_ENABLED, QUICK_STOP_ACTIVE, QUICK_STOP),
    DeviceTransition(12, QUICK_STOP_ACTIVE, SWITCH_ON_DISABLED, DISABLE_VOLTAGE),
    DeviceTransition(12, QUICK_STOP_ACTIVE, SWITCH_ON_DISABLED, REACTION_DONE),
    *(
        DeviceTransition(13, state, FAULT_REACTION_ACTIVE, FAULT_DETECTED)
        for state in (
            START,
            NOT_READY,
            SWITCH_ON_DISABLED,
            READY_TO_SWITCH_ON,
            SWITCHED_ON,
            OPERATION_ENABLED,
            QUICK_STOP_ACTIVE,
        )
    ),
    DeviceTransition(14, FAULT_REACTION_ACTIVE, FAULT, REACTION_DONE),
    DeviceTransition(15, FAULT, SWITCH_ON_DISABLED, FAULT_RESET),
    DeviceTransition(16, QUICK_STOP_ACTIVE, OPERATION_ENABLED, ENABLE_OPERATION),
)

NO_TRANSITION = -1


def _lookup(pick_target: bool) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    table = np.full((len(STATE_NAMES), N_CAUSES), NO_TRANSITION, np.int64)
    for t in TRANSITIONS:
        table[t.source, t.cause] = t.target if pick_target else t.number
    return table


_TARGETS = _lookup(pick_target=True)
_NUMBERS = _lookup(pick_target=False)
_STATE_BITS = np.array([0x00, 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08, 0x00], np.int64)


@njit
def command_of(controlword: int) -> int:
    """The command in a controlword's bits 0 to 3 (one of the causes SHUTDOWN to QUICK_STOP, or NO_CAUSE)."""
    if (controlword & CW_ENABLE_VOLTAGE) == 0:
        return DISABLE_VOLTAGE
    if (controlword & CW_QUICK_STOP) == 0:
        return QUICK_STOP
    if (controlword & CW_FAULT_RESET) != 0:
        return NO_CAUSE
    if (controlword & CW_SWITCH_ON) == 0:
        return SHUTDOWN
    if (controlword & CW_ENABLE_OPERATION) == 0:
        return SWITCH_ON
    return ENABLE_OPERATION


@njit
def _cause(
    state: int,
    controlword: int,
    previous_controlword: int,
    fault: bool,
    reaction_done: bool,
    quick_stop_option: int,
) -> int:
    if state == FAULT_REACTION_ACTIVE:
        return REACTION_DONE if reaction_done else NO_CAUSE
    if state == FAULT:
        edge = (controlword & ~previous_controlword & CW_FAULT_RESET) != 0
        return FAULT_RESET if edge and not fault else NO_CAUSE
    if fault:
        return FAULT_DETECTED
    if state in (START, NOT_READY):
        return AUTOMATIC
    command = command_of(controlword)
    if state != QUICK_STOP_ACTIVE or command == DISABLE_VOLTAGE:
        return command
    if quick_stop_option >= QUICK_STOP_STAYS:
        return command
    return REACTION_DONE if reaction_done else NO_CAUSE


@njit
def device_step(
    state: int,
    controlword: int,
    previous_controlword: int,
    fault: bool,
    reaction_done: bool,
    quick_stop_option: int,
) -> tuple[int, int]:
    """Next state, and the CiA 402 number of the transition made (-1 for none). At most one transition a call.

    `fault`: a fault condition is present now (a reset is refused while it lasts).
    `reaction_done`: the quick stop or the fault reaction has ended (stopped, or nothing to wait for).
    `quick_stop_option`: object 0x605A; below 5 the end of the quick stop leads to SWITCH_ON_DISABLED (12),
    from 5 on the drive stays and enable operation leads back (16).
    """
    cause = _cause(state, controlword, previous_controlword, fault, reaction_done, quick_stop_option)
    number = int(_NUMBERS[state, cause])
    if number == NO_TRANSITION:
        return state, NO_TRANSITION
    return int(_TARGETS[state, cause]), number


@njit
def statusword_of(state: int, bits: int) -> int:
    """Statusword 0x6041: the state's own bits (0 to 3, 5, 6), joined with `bits` (SW_* of the caller)."""
    return int(_STATE_BITS[state]) | bits


@njit
def follows_target(state: int) -> bool:
    """Whether the target torque acts: in OPERATION_ENABLED only."""
    return state == OPERATION_ENABLED


@njit
def clears_target(transition: int) -> bool:
    """True for a transition that enters or leaves OPERATION_ENABLED: the target torque is then zeroed."""
    return transition in (4, 5, 8, 9, 11, 13, 16)
