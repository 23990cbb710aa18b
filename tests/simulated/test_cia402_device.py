"""The device's state machine against the standard: every state and word, and no way to torque but the one."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.drive.simulated import cia402_device as device

NRTSO, SOD, RTSO, SO, OE, QSA, FRA, F, START = range(9)

# the command table of CiA 402 (bits 7 3 2 1 0; x is any), first match counts; written from the standard
COMMANDS = (
    ("x x x 0 x", "disable voltage"),
    ("x x 0 1 x", "quick stop"),
    ("1 x x x x", "none"),
    ("0 x 1 1 0", "shutdown"),
    ("0 0 1 1 1", "switch on"),
    ("0 1 1 1 1", "enable operation"),
)
# state, command -> next state, number of the transition; what is not here is ignored
BY_COMMAND = {
    (SOD, "shutdown"): (RTSO, 2),
    (RTSO, "switch on"): (SO, 3),
    (RTSO, "enable operation"): (SO, 3),
    (RTSO, "disable voltage"): (SOD, 7),
    (RTSO, "quick stop"): (SOD, 7),
    (SO, "enable operation"): (OE, 4),
    (SO, "shutdown"): (RTSO, 6),
    (SO, "disable voltage"): (SOD, 10),
    (SO, "quick stop"): (SOD, 10),
    (OE, "switch on"): (SO, 5),
    (OE, "shutdown"): (RTSO, 8),
    (OE, "disable voltage"): (SOD, 9),
    (OE, "quick stop"): (QSA, 11),
    (QSA, "disable voltage"): (SOD, 12),
}
STATUS_MASKS = {  # state: mask, value; IEC 61800-7-201
    NRTSO: (0x4F, 0x00),
    SOD: (0x4F, 0x40),
    RTSO: (0x6F, 0x21),
    SO: (0x6F, 0x23),
    OE: (0x6F, 0x27),
    QSA: (0x6F, 0x07),
    FRA: (0x4F, 0x0F),
    F: (0x4F, 0x08),
}


def command_named(controlword: int) -> str:
    bits = [(controlword >> bit) & 1 for bit in (7, 3, 2, 1, 0)]
    for pattern, name in COMMANDS:
        if all(p in ("x", str(b)) for p, b in zip(pattern.split(), bits, strict=True)):
            return name
    raise AssertionError(controlword)


def expected(state, controlword, previous, fault, done, option):
    if state == FRA:
        return (F, 14) if done else (FRA, -1)
    if state == F:
        edge = controlword & 0x80 and not previous & 0x80
        return (SOD, 15) if edge and not fault else (F, -1)
    if fault:
        return FRA, 13
    if state in (START, NRTSO):
        return (NRTSO, 0) if state == START else (SOD, 1)
    command = command_named(controlword)
    if state == QSA and command != "disable voltage":
        if option >= 5:
            return (OE, 16) if command == "enable operation" else (QSA, -1)
        return (SOD, 12) if done else (QSA, -1)
    return BY_COMMAND.get((state, command), (state, -1))


WORDS = [low | reset for low in range(16) for reset in (0, 0x80)]


@pytest.mark.parametrize("state", range(9), ids=device.STATE_NAMES)
def test_every_state_meets_every_word_as_the_standard_has_it(state):
    cases = itertools.product(WORDS, (0, 0x80), (False, True), (False, True), (0, 2, 5, 7))
    for word, previous, fault, done, option in cases:
        got = device.device_step(state, word, previous, fault, done, option)
        assert tuple(got) == expected(state, word, previous, fault, done, option), (word, previous, fault, done, option)


def test_bits_outside_the_command_change_nothing():
    for state, word in itertools.product(range(9), WORDS):
        plain = device.device_step(state, word, 0, False, True, 2)
        assert device.device_step(state, word | 0xFF70, 0, False, True, 2) == plain


def test_all_seventeen_transitions_are_in_the_table_and_lead_where_the_standard_says():
    arrows = {(t.number, t.source, t.target) for t in device.TRANSITIONS if t.number != 13}
    assert arrows == {
        (0, START, NRTSO), (1, NRTSO, SOD), (2, SOD, RTSO), (3, RTSO, SO), (4, SO, OE), (5, OE, SO), (6, SO, RTSO),
        (7, RTSO, SOD), (8, OE, RTSO), (9, OE, SOD), (10, SO, SOD), (11, OE, QSA), (12, QSA, SOD), (14, FRA, F),
        (15, F, SOD), (16, QSA, OE),
    }  # fmt: skip
    assert {t.source for t in device.TRANSITIONS if t.number == 13} == set(range(9)) - {FRA, F}


def test_statuswords_carry_the_state_and_the_given_bits():
    for state, (mask, value) in STATUS_MASKS.items():
        for bits in (0, device.SW_VOLTAGE_ENABLED | device.SW_REMOTE | device.SW_FOLLOWS_COMMAND):
            word = device.statusword_of(state, bits)
            assert word & mask == value
            assert word & bits == bits
            fits = [other for other, (m, v) in STATUS_MASKS.items() if word & m == v]
            assert fits == [state]


def test_a_fault_reset_needs_an_edge_and_a_gone_fault():
    assert device.device_step(F, 0x80, 0x80, False, True, 2) == (F, -1)
    assert device.device_step(F, 0x80, 0x00, True, True, 2) == (F, -1)
    assert device.device_step(F, 0x80, 0x00, False, True, 2) == (SOD, 15)
    # the bit that is left standing leads nowhere
    assert device.device_step(SOD, 0x86, 0x80, False, True, 2) == (SOD, -1)


def test_a_quick_stop_waits_until_the_shaft_has_stopped():
    state, number = device.device_step(OE, 0x0B, 0x0F, False, True, 2)
    assert (state, number) == (QSA, 11)
    for _ in range(5):
        state, number = device.device_step(state, 0x0B, 0x0B, False, False, 2)
        assert (state, number) == (QSA, -1)
    assert device.device_step(state, 0x0B, 0x0B, False, True, 2) == (SOD, 12)
    assert device.device_step(state, 0x0B, 0x0B, False, True, 6) == (QSA, -1)
    assert device.device_step(state, 0x0F, 0x0B, False, True, 6) == (OE, 16)


@given(st.lists(st.tuples(st.integers(0, 0xFFFF), st.booleans(), st.booleans(), st.sampled_from([0, 2, 5, 6]))))
def test_torque_comes_by_transition_4_or_16_only_and_a_fault_ends_it(events):
    state, previous = START, 0
    for word, fault, done, option in events:
        before = state
        state, number = device.device_step(state, word, previous, fault, done, option)
        previous = word
        assert (number == -1) == (state == before)
        if device.follows_target(state) and before != state:
            assert number in (4, 16)
            assert word & 0x8F == 0x0F
        if fault:
            assert not device.follows_target(state)
        if device.follows_target(before) != device.follows_target(state):
            assert device.clears_target(number)
