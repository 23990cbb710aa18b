"""CiA 402 (IEC 61800-7-201) state machine of the master: decoding of the statusword, choice of the controlword.

Pure functions without memory: the loop calls them with each statusword. One table of masks decodes the state.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import njit

# states of the power drive system
STATE_UNKNOWN = -1
STATE_NOT_READY = 0
STATE_SWITCH_ON_DISABLED = 1
STATE_READY_TO_SWITCH_ON = 2
STATE_SWITCHED_ON = 3
STATE_OPERATION_ENABLED = 4
STATE_QUICK_STOP_ACTIVE = 5
STATE_FAULT_REACTION_ACTIVE = 6
STATE_FAULT = 7


class StateMask(NamedTuple):
    """A state is present when (statusword & mask) == value."""

    state: int
    name: str
    mask: int
    value: int


# IEC 61800-7-201 table "state coding": bits 0 to 3, 5 and 6 of 0x6041
STATE_TABLE: tuple[StateMask, ...] = (
    StateMask(STATE_NOT_READY, "not ready to switch on", 0x4F, 0x00),
    StateMask(STATE_SWITCH_ON_DISABLED, "switch on disabled", 0x4F, 0x40),
    StateMask(STATE_READY_TO_SWITCH_ON, "ready to switch on", 0x6F, 0x21),
    StateMask(STATE_SWITCHED_ON, "switched on", 0x6F, 0x23),
    StateMask(STATE_OPERATION_ENABLED, "operation enabled", 0x6F, 0x27),
    StateMask(STATE_QUICK_STOP_ACTIVE, "quick stop active", 0x6F, 0x07),
    StateMask(STATE_FAULT_REACTION_ACTIVE, "fault reaction active", 0x4F, 0x0F),
    StateMask(STATE_FAULT, "fault", 0x4F, 0x08),
)
_ROWS = np.array([(row.state, row.mask, row.value) for row in STATE_TABLE], np.int64)

NOT_READY_MASK = STATE_TABLE[0].mask  # all of these are 0 in a drive that is still starting

# statusword bits
STATUS_FAULT = 1 << 3  # fault, and its reaction
STATUS_VOLTAGE_ENABLED = 1 << 4
STATUS_WARNING = 1 << 7
STATUS_REMOTE = 1 << 9
STATUS_INTERNAL_LIMIT = 1 << 11
STATUS_FOLLOWS_COMMAND = 1 << 12  # in cyclic synchronous modes

# controlword commands
CONTROL_DISABLE_VOLTAGE = 0x0000
CONTROL_QUICK_STOP = 0x0002
CONTROL_SHUTDOWN = 0x0006
CONTROL_SWITCH_ON = 0x0007
CONTROL_ENABLE_OPERATION = 0x000F
CONTROL_FAULT_RESET = 0x0080

# goals of the supervisor for the drive
GOAL_DISABLED = 0
GOAL_QUICK_STOP = 1
GOAL_READY = 2  # switched on, no torque
GOAL_ENABLED = 3

MODE_PROFILE_TORQUE = 4
MODE_CYCLIC_SYNCHRONOUS_TORQUE = 10


@njit
def state_of(statusword: int) -> int:
    """State coded in a statusword (STATE_*); STATE_UNKNOWN for a pattern that is not in the standard."""
    for i in range(_ROWS.shape[0]):
        if statusword & _ROWS[i, 1] == _ROWS[i, 2]:
            return int(_ROWS[i, 0])
    return STATE_UNKNOWN


@njit
def is_operation_enabled(statusword: int) -> bool:
    """True when the drive turns the target into torque."""
    return state_of(statusword) == STATE_OPERATION_ENABLED


@njit
def has_torque(statusword: int) -> bool:
    """True if the power stage may be on: enabled, stopping, reacting to a fault, or in no known state."""
    state = state_of(statusword)
    return state in (
        STATE_UNKNOWN, STATE_OPERATION_ENABLED, STATE_QUICK_STOP_ACTIVE, STATE_FAULT_REACTION_ACTIVE
    )  # fmt: skip


@njit
def controlword_towards(statusword: int, goal: int, fault_reset: bool, last_controlword: int = 0) -> int:
    """The controlword that takes the drive one state closer to `goal` (GOAL_*).

    In the fault state the result is 0x0000, whatever the goal. With `fault_reset` it becomes 0x0080, but
    only after a 0x0000 (`last_controlword`), because the drive resets on the rising edge of bit 7; it is held
    until the state changes or the flag falls. Lower the flag before another attempt.

    A pattern that is not a state disables the voltage (or keeps up the quick stop). From quick stop active
    the way back leads through switch on disabled: transition 16 is optional, and a stop is not left in
    one step.
    """
    state = state_of(statusword)
    if state == STATE_FAULT:
        edge = last_controlword in (CONTROL_DISABLE_VOLTAGE, CONTROL_FAULT_RESET)
        return CONTROL_FAULT_RESET if fault_reset and edge else CONTROL_DISABLE_VOLTAGE
    if goal == GOAL_QUICK_STOP:
        return CONTROL_QUICK_STOP
    if goal in (GOAL_READY, GOAL_ENABLED):
        if state == STATE_SWITCH_ON_DISABLED:
            return CONTROL_SHUTDOWN
        if state == STATE_READY_TO_SWITCH_ON:
            return CONTROL_SWITCH_ON
        if state in (STATE_SWITCHED_ON, STATE_OPERATION_ENABLED):
            return CONTROL_ENABLE_OPERATION if goal == GOAL_ENABLED else CONTROL_SWITCH_ON
    return CONTROL_DISABLE_VOLTAGE


def state_name(statusword: int) -> str:
    """Name of the state in the standard, for messages; 'unknown' if there is none."""
    for row in STATE_TABLE:
        if statusword & row.mask == row.value:
            return row.name
    return "unknown"
