"""The LSS master against the simulated drive's LSS slave, frame by frame, without a bus or a clock."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from node.node_rig import Rig

from fffo_drive.drive.canopen.lss import LssAddress, LssMaster
from fffo_drive.drive.port import DriveRefusedError
from fffo_drive.drive.simulated.node.config import Identity, NodeConfig

U32 = st.integers(0, 0xFFFF_FFFF)


class LssBus:
    """Drives without an id, and what an LSS master hears of them. `deaf`: requests (from 0) whose answers are lost."""

    def __init__(self, *addresses, deaf=()):
        self.rigs = [Rig(NodeConfig(identity=Identity(*address))) for address in addresses]
        self.deaf, self.asked, self.heard = set(deaf), [], []
        for rig in self.rigs:
            for request in ("0401", "11FF", "17", "0400"):  # to the configuration state, no id, store, back
                rig.send("7E5#" + request.ljust(16, "0"))
            rig.send("000#8101")
            assert rig.send("601#4000100000000000") == []  # off the bus but for LSS

    def ask(self, request, patience_s):
        self.asked.append((request, patience_s))
        answers = []
        for rig in self.rigs:
            for text in rig.send("7E5#" + request.hex()):
                if text.startswith("7E4#"):
                    answers.append(bytes.fromhex(text[4:]))
                else:
                    self.heard.append(text)
        return [] if len(self.asked) - 1 in self.deaf or patience_s == 0.0 else answers


def test_nobody_without_an_id_takes_one_question():
    bus = LssBus()
    assert LssMaster(bus.ask).nodes_without_id() == []
    assert [request.hex() for request, _ in bus.asked] == ["5100000000800000", "0400000000000000"]


@settings(max_examples=25)
@given(st.tuples(U32, U32, U32, U32))
def test_any_address_is_found_and_the_drive_goes_on_waiting(address):
    bus = LssBus(address)
    shares = []
    assert LssMaster(bus.ask, shares.append).nodes_without_id() == [LssAddress(*address)]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert bus.ask(bytes.fromhex("5E00000000000000"), 0.1) == []  # not in the configuration state


def test_all_drives_without_an_id_are_found_one_after_the_other():
    addresses = [(0x11, 1, 2, 3), (0x11, 1, 2, 4), (0xFB, 0xFFFFFFFF, 0, 0x80000001)]
    found = LssMaster(LssBus(*addresses).ask).nodes_without_id()
    assert sorted(found) == sorted(LssAddress(*address) for address in addresses)


def test_an_answer_that_is_lost_makes_a_second_scan_with_more_patience():
    bus = LssBus((0x11, 1, 2, 3), deaf={5})  # a 1 is taken where the address has a 0: the part is not confirmed
    assert LssMaster(bus.ask).nodes_without_id() == [LssAddress(0x11, 1, 2, 3)]
    assert max(patience for request, patience in bus.asked if request[0] == 0x51) == 0.2


def test_a_drive_that_answers_and_confirms_no_address_is_reported():
    def ask(request, patience_s):
        command, _, bit, _, _ = struct.unpack("<BIBBB", request)
        return [bytes([0x4F]).ljust(8, b"\0")] if command == 0x51 and bit == 0x80 else []

    with pytest.raises(DriveRefusedError, match="lacks a part of 0x1018, or two nodes"):
        LssMaster(ask).nodes_without_id()


def test_an_id_is_given_to_one_drive_alone_and_kept():
    mine, other = (0x11, 1, 2, 3), (0x11, 1, 2, 4)
    bus = LssBus(other, mine)
    assert LssMaster(bus.ask).assign(LssAddress(*mine), 42)
    assert bus.heard == ["72A#00"]  # its boot-up
    assert bus.rigs[1].send("62A#4018100400000000") == ["5AA#4318100403000000"]  # the serial number of mine
    assert bus.rigs[0].send("62A#4018100400000000") == []
    assert bus.rigs[1].send("000#812A") == ["72A#00"]  # it was stored


def test_what_does_not_take_an_id_is_reported_and_left_waiting():
    bus = LssBus((0x11, 1, 2, 3))
    master = LssMaster(bus.ask)
    with pytest.raises(DriveRefusedError, match="does not answer LSS any more"):
        master.assign(LssAddress(0x11, 1, 2, 99), 42)
    with pytest.raises(DriveRefusedError, match="1 to 127"):
        master.assign(LssAddress(0x11, 1, 2, 3), 128)
    assert bus.ask(bytes.fromhex("5E00000000000000"), 0.1) == []
    assert bus.heard == []


def test_a_drive_that_refuses_or_cannot_store():
    answers = {0x43: 0x44, 0x11: 0x11, 0x17: 0x17}

    def slave(error_of):
        def ask(request, patience_s):
            if request[0] not in answers:
                return []
            return [bytes([answers[request[0]], error_of.get(request[0], 0)]).ljust(8, b"\0")]

        return LssMaster(ask)

    address = LssAddress(1, 2, 3, 4)
    assert slave({}).assign(address, 5) is True
    assert slave({0x17: 1}).assign(address, 5) is False
    with pytest.raises(DriveRefusedError, match="refuses \\(error 1\\) when given the node id 5"):
        slave({0x11: 1}).assign(address, 5)
