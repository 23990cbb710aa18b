"""What may be written to the PDO communication and mapping parameters, when, and which abort refuses the rest."""

from __future__ import annotations

import pytest
from node.node_rig import Rig

from fffo_drive.can.frame import pack_frame
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.personality import Personality

UNSUPPORTED, INVALID = 0x06010000, 0x06090030
NO_OBJECT, NO_SUB, NOT_MAPPABLE, TOO_LONG = 0x06020000, 0x06090011, 0x06040041, 0x06040042
OFF = 0x80000000
NO_RTR = 0x40000000


def unmapped(communication: int = 0x1A00 - 0x200, cob_id: int = 0x181 | NO_RTR) -> Rig:
    """A PDO that is disabled, its mapping emptied."""
    rig = Rig()
    assert rig.write(communication, 1, cob_id | OFF, 4) == 0
    assert rig.write(communication + 0x200, 0, 0, 1) == 0
    return rig


@pytest.mark.conformance("CiA 301", "a COB-ID changes only while the PDO is disabled")
@pytest.mark.parametrize(("index", "cob_id", "bits"), [(0x1400, 0x201, 0), (0x1800, 0x181, NO_RTR)])
def test_cob_id(index: int, cob_id: int, bits: int) -> None:
    rig = Rig()
    assert rig.write(index, 1, 0x190 + 1 | bits, 4) == INVALID
    assert rig.write(index, 1, cob_id | bits, 4) == 0  # the same again
    assert rig.write(index, 1, cob_id | bits | OFF, 4) == 0
    assert rig.write(index, 1, 0x192 | bits | OFF, 4) == 0
    assert rig.write(index, 1, 0x192 | bits, 4) == 0
    assert rig.read(index, 1) == 0x192 | bits


@pytest.mark.conformance("CiA 301", "restricted CAN-IDs and 29-bit identifiers are refused")
@pytest.mark.parametrize("cob_id", [0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x601, 0x701, 0x7FF, 0x20000181])
def test_restricted_and_extended_identifiers_are_refused(cob_id: int) -> None:
    rig = Rig()
    assert rig.write(0x1400, 1, 0x201 | OFF, 4) == 0
    assert rig.write(0x1400, 1, cob_id | OFF, 4) == INVALID


@pytest.mark.conformance("CiA 301", "remapping: disable, sub 0 = 0, entries, sub 0 = n, enable")
def test_remapping_takes_effect() -> None:
    rig = Rig()
    rig.map_cyclic()
    rig.operational()
    answers = rig.send("080#")
    assert [frame.partition("#")[0] for frame in answers] == ["181", "281"]
    assert [len(frame.partition("#")[2]) // 2 for frame in answers] == [8, 4]
    assert rig.read(0x1A01, 0) == 2
    assert rig.read(0x1A01, 2) == 0x60770010


@pytest.mark.conformance("CiA 301", "mapping of an enabled PDO, or with sub 0 not 0, is refused (06010000)")
@pytest.mark.parametrize(
    ("communication", "cob_id", "entry"), [(0x1401, 0x301, 0x60710010), (0x1800, 0x40000181, 0x60640020)]
)
def test_the_order_of_remapping_is_kept(communication: int, cob_id: int, entry: int) -> None:
    rig = Rig()
    mapping = communication + 0x200
    assert rig.write(mapping, 0, 0, 1) == UNSUPPORTED  # enabled
    assert rig.write(mapping, 1, entry, 4) == UNSUPPORTED
    assert rig.write(communication, 1, cob_id | OFF, 4) == 0
    assert rig.write(mapping, 1, entry, 4) == UNSUPPORTED  # sub 0 is not 0
    assert rig.write(mapping, 0, 0, 1) == 0
    assert rig.write(mapping, 1, entry, 4) == 0
    assert rig.write(mapping, 0, 1, 1) == 0
    assert rig.write(communication, 1, cob_id, 4) == 0


@pytest.mark.conformance("CiA 301", "a mapping of more than 8 entries or 64 bit is refused (06040042)")
def test_too_much() -> None:
    rig = unmapped()
    assert rig.write(0x1A00, 0, 9, 1) == TOO_LONG
    for sub, entry in enumerate((0x60640020, 0x606C0020, 0x60410010), 1):
        assert rig.write(0x1A00, sub, entry, 4) == 0
    assert rig.write(0x1A00, 0, 3, 1) == TOO_LONG  # 80 bits
    assert rig.write(0x1A00, 0, 2, 1) == 0


@pytest.mark.conformance("CiA 301", "an object that cannot be mapped, or not in this direction, is refused (06040041)")
def test_not_mappable() -> None:
    rig = unmapped()
    assert rig.write(0x1A00, 1, 0x10180120, 4) == NOT_MAPPABLE  # no PDO flag
    assert rig.write(0x1A00, 1, 0x60400010, 4) == NOT_MAPPABLE  # rww: received, not sent
    assert rig.write(0x1A00, 1, 0x60640010, 4) == NOT_MAPPABLE  # 32 bits, not 16
    assert rig.write(0x1A00, 1, 0x00050008, 4) == NO_OBJECT  # dummies are for RPDOs
    rig = unmapped(0x1400, 0x201)
    assert rig.write(0x1600, 1, 0x60410010, 4) == NOT_MAPPABLE  # ro: sent, not received


@pytest.mark.conformance("CiA 301", "an unknown object in a mapping is refused (06020000, 06090011)")
def test_unknown_objects() -> None:
    rig = unmapped()
    assert rig.write(0x1A00, 1, 0x60FF0020, 4) == NO_OBJECT
    assert rig.write(0x1A00, 1, 0x60640120, 4) == NO_SUB
    assert rig.write(0x1A00, 0, 1, 1) == 0  # what stands there from before
    assert rig.write(0x1A00, 0, 0, 1) == 0
    assert rig.write(0x1A00, 1, 0, 4) == 0  # an empty entry
    assert rig.write(0x1A00, 0, 1, 1) == NO_OBJECT  # but none that is in use


@pytest.mark.conformance("CiA 301", "reserved transmission types 241 to 253 are refused")
def test_reserved_transmission_types() -> None:
    rig = Rig()
    for index in (0x1400, 0x1800):
        for transmission in range(241, 254):
            assert rig.write(index, 2, transmission, 1) == INVALID
        for transmission in (0, 1, 240, 254, 255):
            assert rig.write(index, 2, transmission, 1) == 0


@pytest.mark.conformance("CiA 301", "bit 30 of a TPDO's COB-ID (no remote frames): free, or demanded where configured")
def test_the_remote_frame_bit_of_a_tpdo() -> None:
    free = Rig()
    assert free.write(0x1800, 1, 0x181 | OFF, 4) == 0
    assert free.write(0x1800, 1, 0x181, 4) == 0
    assert free.read(0x1800, 1) == 0x181
    strict = Rig(NodeConfig(personality=Personality(rtr_bit="required")))
    assert strict.write(0x1800, 1, 0x181 | OFF, 4) == INVALID
    assert strict.write(0x1800, 1, 0x181 | NO_RTR | OFF, 4) == 0
    for rig in (free, strict):  # no remote frame is answered by either
        rig.operational()
        assert rig.node.handle(pack_frame(0x181, remote=True), rig.now_ns) == []


@pytest.mark.conformance("CiA 301", "bit 30 of an RPDO's COB-ID is reserved: refused")
def test_bit_30_of_an_rpdo_is_reserved() -> None:
    rig = Rig()
    assert rig.write(0x1400, 1, 0x40000201, 4) == INVALID
    assert rig.write(0x1400, 1, 0xC0000201, 4) == INVALID
    assert rig.read(0x1400, 1) == 0x201


@pytest.mark.conformance("CiA 301", "inhibit time and SYNC start value change only while the PDO is disabled")
def test_inhibit_time_and_start_value_change_only_while_disabled() -> None:
    rig = Rig()
    assert rig.write(0x1800, 3, 10, 2) == UNSUPPORTED
    assert rig.write(0x1800, 6, 10, 1) == UNSUPPORTED
    assert rig.write(0x1800, 1, 0x181 | NO_RTR | OFF, 4) == 0
    assert rig.write(0x1800, 3, 10, 2) == 0
    assert rig.write(0x1800, 6, 10, 1) == 0
    assert rig.write(0x1800, 6, 241, 1) == 0x06090031


@pytest.mark.conformance("CiA 301", "dummy entries fill gaps in an RPDO")
def test_dummies() -> None:
    rig = unmapped(0x1401, 0x301)
    for sub, entry in enumerate((0x00050008, 0x00060010, 0x60710010), 1):
        assert rig.write(0x1601, sub, entry, 4) == 0
    assert rig.write(0x1601, 0, 3, 1) == 0
    assert rig.write(0x1401, 1, 0x301, 4) == 0
    rig.operational()
    rig.send("301#AAAAAA3412")
    assert rig.read(0x6071) == 0x1234
