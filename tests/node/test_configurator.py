"""What others configure the drive with: the concise DCF that lely's dcfgen makes for ros2_canopen, write by write."""

from __future__ import annotations

from node.node_rig import Rig

from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.personality import Personality

# index, sub-index, value, bytes; from a bus.yml of RPDO 1 {0x6040, 0x6060}, RPDO 2 {0x6071}, TPDO 1 {0x6041, 0x6061},
# TPDO 2 {0x6064, 0x606C}, all with SYNC; heartbeat 1 s, 0x60C2 10 ms, 0x6060 = 10. None has bit 30 in a COB-ID.
CONCISE_DCF = (
    (0x1017, 0, 0x03E8, 2), (0x1400, 1, 0x80000201, 4), (0x1400, 2, 0x01, 1), (0x1600, 0, 0x00, 1),
    (0x1600, 1, 0x60400010, 4), (0x1600, 2, 0x60600008, 4), (0x1600, 0, 0x02, 1), (0x1400, 1, 0x00000201, 4),
    (0x1401, 1, 0x80000301, 4), (0x1401, 2, 0x01, 1), (0x1601, 0, 0x00, 1), (0x1601, 1, 0x60710010, 4),
    (0x1601, 0, 0x01, 1), (0x1401, 1, 0x00000301, 4), (0x1800, 1, 0x80000181, 4), (0x1800, 2, 0x01, 1),
    (0x1A00, 0, 0x00, 1), (0x1A00, 1, 0x60410010, 4), (0x1A00, 2, 0x60610008, 4), (0x1A00, 0, 0x02, 1),
    (0x1800, 1, 0x00000181, 4), (0x1801, 1, 0x80000281, 4), (0x1A01, 0, 0x00, 1), (0x1A01, 1, 0x60640020, 4),
    (0x1A01, 2, 0x606C0020, 4), (0x1A01, 0, 0x02, 1), (0x1801, 1, 0x00000281, 4), (0x60C2, 1, 0x0A, 1),
    (0x60C2, 2, 0xFD, 1), (0x6060, 0, 0x0A, 1),
)  # fmt: skip
INVALID = 0x06090030


def test_every_write_of_the_configurator_is_taken() -> None:
    rig = Rig()
    for index, sub, value, size in CONCISE_DCF:
        assert rig.write(index, sub, value, size) == 0, f"{index:04X}:{sub:02X} = {value:X}"
        assert rig.read(index, sub) == value
    rig.operational()
    rig.send("201#0F000A")
    rig.send("301#6400")
    assert [frame[:4] for frame in rig.send("080#")] == ["181#", "281#"]
    assert (rig.read(0x6040), rig.read(0x6061)) == (0x0F, 10)


def test_a_drive_that_demands_bit_30_refuses_the_same_writes() -> None:
    rig = Rig(NodeConfig(personality=Personality(rtr_bit="required")))
    answers = [rig.write(*row) for row in CONCISE_DCF]
    assert INVALID in answers
    assert answers[[row[:2] for row in CONCISE_DCF].index((0x1800, 1))] == INVALID
