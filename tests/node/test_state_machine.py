"""The CiA 402 machine of the node, from outside: statusword for controlword, in every state."""

from __future__ import annotations

import pytest
from node.node_rig import Rig

SOD, RTSO, SO, OE, QSA, FRA, FAULT = 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08
MASKS = {0x00: 0x4F, SOD: 0x4F, RTSO: 0x6F, SO: 0x6F, OE: 0x6F, QSA: 0x6F, FRA: 0x4F, FAULT: 0x4F}
STABLE = (SOD, RTSO, SO, OE, QSA, FRA, FAULT)
WORDS = [low | reset for low in range(16) for reset in (0, 0x80)]
GENERIC_FAULT = 0x7303

# CiA 402, figure of the state machine: where the command leads, after all that follow at once; missing: nowhere
TARGETS = {
    SOD: {"shutdown": RTSO},
    RTSO: {"switch on": SO, "enable operation": OE, "disable voltage": SOD, "quick stop": SOD},
    SO: {"enable operation": OE, "shutdown": RTSO, "disable voltage": SOD, "quick stop": SOD},
    OE: {"switch on": SO, "shutdown": RTSO, "disable voltage": SOD, "quick stop": QSA},
    QSA: {"disable voltage": SOD, "enable operation": OE},  # with 0x605A = 6
    FRA: {},
    FAULT: {},  # an edge of bit 7 leads to SOD
}


def command(word: int) -> str:
    """CiA 402, table of the controlword; a set bit 7 is no command but those that stop."""
    if not word & 0x02:
        return "disable voltage"
    if not word & 0x04:
        return "quick stop"
    if word & 0x80:
        return "none"
    return {0x06: "shutdown", 0x0E: "shutdown", 0x07: "switch on", 0x0F: "enable operation"}[word & 0x0F]


def rig_in(state: int) -> Rig:
    """A drive that turns at 10 rev/s (so that quick stop and fault reaction last), in a state."""
    rig = Rig()
    assert rig.write(0x605A, 0, 6, 2) == 0
    assert rig.write(0x605C, 0, 0, 2) == 0  # disable operation at once
    rig.operational()
    rig.enable()
    rig.plant.velocity_rps = 10.0
    words = {SOD: 0x00, RTSO: 0x06, SO: 0x07, QSA: 0x02}
    if state in words:
        assert rig.write(0x6040, 0, words[state], 2) == 0
    if state in (FRA, FAULT):
        rig.node.drive.trip(0xFF01)
        rig.node.drive.update()
    if state == FAULT:
        rig.wait(1500)
    assert rig.write(0x6040, 0, 0x0F, 2) == 0 if state == OE else True
    assert rig.state == state
    return rig


@pytest.mark.conformance(
    "CiA 402", "each state with each of the 32 command words", "illegal commands are ignored, not refused"
)
@pytest.mark.parametrize("state", STABLE)
def test_every_word_in_every_state(state: int) -> None:
    for word in WORDS:
        rig = rig_in(state)
        assert rig.write(0x6040, 0, word, 2) == 0  # never an abort
        expected = TARGETS[state].get(command(word), state)
        if state == FAULT and word & 0x80:
            expected = SOD
        assert rig.state == expected, (hex(state), hex(word))


@pytest.mark.conformance("CiA 402", "statusword masks of the eight states")
def test_masks() -> None:
    for state in STABLE:
        word = rig_in(state).statusword
        assert [s for s, mask in MASKS.items() if word & mask == s] == [state]


@pytest.mark.conformance("CiA 402", "transitions 0 to 16")
def test_each_transition_has_its_number() -> None:
    rig = Rig()
    seen: list[int] = []
    drive = rig.node.drive
    drive.on_transition.append(seen.append)
    rig.send("000#8101")  # reset node: power-on
    assert seen == [0, 1]
    seen.clear()
    rig.write(0x605A, 0, 6, 2)
    rig.write(0x605C, 0, 0, 2)
    for word in (0x06, 0x07, 0x06, 0x00, 0x06, 0x07, 0x00, 0x06, 0x07, 0x0F, 0x07, 0x0F, 0x06, 0x0F, 0x00):
        assert rig.write(0x6040, 0, word, 2) == 0
    assert seen == [2, 3, 6, 7, 2, 3, 10, 2, 3, 4, 5, 4, 8, 3, 4, 9]
    seen.clear()
    for word in (0x06, 0x0F, 0x02, 0x0F, 0x02, 0x00):
        assert rig.write(0x6040, 0, word, 2) == 0
    assert seen == [2, 3, 4, 11, 16, 11, 12]
    seen.clear()
    drive.trip(0xFF01)
    assert seen == [13, 14]
    for word in (0x00, 0x80):
        assert rig.write(0x6040, 0, word, 2) == 0
    assert seen == [13, 14, 15]


def test_a_fault_comes_from_any_state() -> None:
    for state in (SOD, RTSO, SO, OE, QSA):
        rig = rig_in(state)
        rig.node.drive.trip(0xFF01)
        rig.wait(1500)
        assert rig.state == FAULT


@pytest.mark.conformance("CiA 402", "fault reset is an edge of bit 7, and needs the condition gone")
def test_fault_reset() -> None:
    rig = Rig()
    rig.write(0x6040, 0, 0x80, 2)
    rig.node.drive.trip(0xFF01)
    rig.wait(20)
    assert rig.state == FAULT
    for word in (0x80, 0x81, 0x8F):  # bit 7 was set before: no edge
        rig.write(0x6040, 0, word, 2)
        assert rig.state == FAULT
    rig.write(0x6040, 0, 0x00, 2)
    rig.node.drive.injected.add(GENERIC_FAULT)
    rig.write(0x6040, 0, 0x80, 2)
    assert rig.state == FAULT  # the condition is there
    rig.node.drive.injected.clear()
    assert rig.state == FAULT  # and its end alone does nothing
    rig.write(0x6040, 0, 0x00, 2)
    rig.write(0x6040, 0, 0x80, 2)
    assert rig.state == SOD


@pytest.mark.parametrize("condition", ["hot", "overvoltage"])
def test_a_measured_condition_holds_the_fault(condition: str) -> None:
    rig = Rig()
    rig.operational()
    rig.enable()
    rig.plant.temperature_k, rig.plant.dc_link_v = (100.0, 48.0) if condition == "hot" else (0.0, 70.0)
    rig.wait(20)
    assert rig.state == FAULT
    rig.write(0x6040, 0, 0x80, 2)
    assert rig.state == FAULT
    rig.plant.temperature_k, rig.plant.dc_link_v = 0.0, 48.0
    rig.write(0x6040, 0, 0x00, 2)
    rig.write(0x6040, 0, 0x80, 2)
    assert rig.state == SOD


def test_a_fault_that_is_present_at_power_on_is_reported() -> None:
    rig = Rig()
    rig.node.drive.injected.add(GENERIC_FAULT)
    rig.wait(20)
    rig.send("000#8101")
    assert rig.state == FAULT
    assert rig.read(0x603F) == GENERIC_FAULT
    assert rig.read(0x1001) == 0x21
    assert rig.read(0x1003, 1) & 0xFFFF == GENERIC_FAULT


@pytest.mark.conformance("CiA 402", "bit 9 remote", "bit 4 voltage enabled", "bit 7 warning")
def test_bits_of_any_state() -> None:
    for state in STABLE:
        assert rig_in(state).statusword & 0x210 == 0x210
    rig = Rig()
    rig.plant.lose_dc_link(True)
    rig.wait(20)
    assert rig.statusword & 0x10 == 0
    rig.plant.lose_dc_link(False)
    rig.node.emergency.raise_error(0xFF01)
    rig.wait(20)
    assert rig.statusword & 0x90 == 0x90
    rig.node.emergency.clear(0xFF01)
    rig.wait(20)
    assert rig.statusword & 0x80 == 0
