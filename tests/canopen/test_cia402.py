"""The master's side of CiA 402 against the standard's tables, for every statusword there is."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.drive import cia402 as c

# IEC 61800-7-201, "state coding" of the statusword, as printed: bit 15 first, x for any
PRINTED = {
    "xxxx xxxx x0xx 0000": c.STATE_NOT_READY,
    "xxxx xxxx x1xx 0000": c.STATE_SWITCH_ON_DISABLED,
    "xxxx xxxx x01x 0001": c.STATE_READY_TO_SWITCH_ON,
    "xxxx xxxx x01x 0011": c.STATE_SWITCHED_ON,
    "xxxx xxxx x01x 0111": c.STATE_OPERATION_ENABLED,
    "xxxx xxxx x00x 0111": c.STATE_QUICK_STOP_ACTIVE,
    "xxxx xxxx x0xx 1111": c.STATE_FAULT_REACTION_ACTIVE,
    "xxxx xxxx x0xx 1000": c.STATE_FAULT,
}
# the commands of the controlword: bits 7, 3, 2, 1, 0 that matter, for each transition of the state machine
TRANSITIONS = {
    "shutdown": (0x87, 0x06),
    "switch on": (0x8F, 0x07),
    "enable operation": (0x8F, 0x0F),
    "disable voltage": (0x82, 0x00),
    "quick stop": (0x86, 0x02),
}


assert all(pattern.startswith("xxxx xxxx x") for pattern in PRINTED)


def printed_state(word):
    bits = f"{word:016b}"
    states = [
        state
        for pattern, state in PRINTED.items()
        if all(p in ("x", b) for p, b in zip(pattern.replace(" ", ""), bits, strict=True))
    ]
    assert len(states) <= 1, "the standard's patterns exclude each other"
    return states[0] if states else c.STATE_UNKNOWN


PRINTED_STATES = [printed_state(word) for word in range(0x80)] * 512  # bits 7 to 15 are all x


def command_of(controlword):
    return [name for name, (mask, value) in TRANSITIONS.items() if controlword & mask == value]


def test_every_statusword_is_decoded_as_printed():
    for word in range(0x10000):
        state = PRINTED_STATES[word]
        assert c.state_of(word) == state
        assert c.is_operation_enabled(word) == (state == c.STATE_OPERATION_ENABLED)
        torque = {c.STATE_OPERATION_ENABLED, c.STATE_QUICK_STOP_ACTIVE, c.STATE_FAULT_REACTION_ACTIVE}
        assert c.has_torque(word) == (state in torque or state == c.STATE_UNKNOWN)


def test_names_follow_the_same_table():
    assert c.state_name(0x0640) == "switch on disabled"
    assert c.state_name(0x0027) == "operation enabled"
    assert c.state_name(0x0002) == "unknown"


@pytest.mark.parametrize("goal", [c.GOAL_DISABLED, c.GOAL_QUICK_STOP, c.GOAL_READY, c.GOAL_ENABLED])
def test_every_statusword_gets_one_legal_command(goal):
    wanted = {
        c.GOAL_DISABLED: {},
        c.GOAL_QUICK_STOP: {},
        c.GOAL_READY: {
            c.STATE_SWITCH_ON_DISABLED: "shutdown",
            c.STATE_READY_TO_SWITCH_ON: "switch on",
            c.STATE_SWITCHED_ON: "switch on",
            c.STATE_OPERATION_ENABLED: "switch on",  # transition 5, disable operation
        },
        c.GOAL_ENABLED: {
            c.STATE_SWITCH_ON_DISABLED: "shutdown",
            c.STATE_READY_TO_SWITCH_ON: "switch on",
            c.STATE_SWITCHED_ON: "enable operation",
            c.STATE_OPERATION_ENABLED: "enable operation",
        },
    }[goal]
    for word in range(0x10000):
        state = PRINTED_STATES[word]
        default = "quick stop" if goal == c.GOAL_QUICK_STOP else "disable voltage"
        if state == c.STATE_FAULT:
            default = "disable voltage"
        assert command_of(c.controlword_towards(word, goal, False, 0)) == [wanted.get(state, default)]


def test_operation_is_enabled_only_from_switched_on():
    for word in range(0x10000):
        for goal in range(4):
            if c.controlword_towards(word, goal, False, 0) & 0x0F == 0x0F:
                assert goal == c.GOAL_ENABLED
                assert PRINTED_STATES[word] in (c.STATE_SWITCHED_ON, c.STATE_OPERATION_ENABLED)


class Drive:
    """The state machine of the standard, one transition a command, fault reset on a rising edge."""

    def __init__(self, state):
        self.state, self.last = state, 0

    @property
    def statusword(self):
        return {0: 0x00, 1: 0x40, 2: 0x21, 3: 0x23, 4: 0x27, 5: 0x07, 6: 0x0F, 7: 0x08}[self.state]

    def command(self, word):
        rising = word & 0x80 and not self.last & 0x80
        self.last = word
        names = command_of(word)
        moves = {
            ("shutdown", 1): 2, ("shutdown", 3): 2, ("shutdown", 4): 2,
            ("switch on", 2): 3, ("switch on", 4): 3, ("enable operation", 3): 4,
            ("disable voltage", 2): 1, ("disable voltage", 3): 1, ("disable voltage", 4): 1,
            ("disable voltage", 5): 1, ("quick stop", 2): 1, ("quick stop", 3): 1, ("quick stop", 4): 5,
        }  # fmt: skip
        if self.state == 7:
            self.state = 1 if rising else 7
        elif self.state == 6:
            self.state = 7
        elif self.state == 0:
            self.state = 1
        else:
            for name in names:
                self.state = moves.get((name, self.state), self.state)


@given(
    st.integers(0, 7),
    st.sampled_from([c.GOAL_DISABLED, c.GOAL_READY, c.GOAL_ENABLED]),
    st.integers(0, 0xFFFF),
)
def test_a_drive_reaches_the_goal_from_every_state(state, goal, last):
    drive, controlword = Drive(state), last
    for _ in range(8):
        controlword = c.controlword_towards(drive.statusword, goal, True, controlword)
        drive.command(controlword)
    ends = {c.GOAL_DISABLED: c.STATE_SWITCH_ON_DISABLED, c.GOAL_READY: 3, c.GOAL_ENABLED: 4}
    assert drive.state == ends[goal]


def test_quick_stop_from_operation():
    drive = Drive(c.STATE_OPERATION_ENABLED)
    drive.command(c.controlword_towards(drive.statusword, c.GOAL_QUICK_STOP, False, 0x0F))
    assert drive.state == c.STATE_QUICK_STOP_ACTIVE
    drive.command(c.controlword_towards(drive.statusword, c.GOAL_QUICK_STOP, False, 0x02))
    assert drive.state == c.STATE_QUICK_STOP_ACTIVE


def test_a_fault_stays_without_the_flag_and_goes_on_the_edge():
    fault = 0x08
    assert c.controlword_towards(fault, c.GOAL_ENABLED, False, 0x0F) == 0x00
    assert c.controlword_towards(fault, c.GOAL_ENABLED, True, 0x0F) == 0x00  # first low, ...
    assert c.controlword_towards(fault, c.GOAL_ENABLED, True, 0x00) == 0x80  # ... then the edge
    assert c.controlword_towards(fault, c.GOAL_ENABLED, True, 0x80) == 0x80
