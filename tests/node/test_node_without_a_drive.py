"""A thermometer on CANopen: the node with a device that is no drive, by its own object dictionary."""

from __future__ import annotations

from node.node_rig import text

from fffo_drive.can.frame import pack_frame
from fffo_drive.canopen_node.dictionary import DataType, Entry, ObjectDictionary
from fffo_drive.canopen_node.node import CanopenNode
from fffo_drive.drive.simulated.node.objects import ENTRIES

NODE_ID, MASTER_ID = 5, 0x7F
NS_PER_MS = 1_000_000
TEMPERATURE = 0x6000
U8, U16, U32, I16 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32, DataType.INTEGER16
COMMUNICATION = [e for e in ENTRIES if e.index < 0x1400 or e.index in (0x1F80, 0x2010, 0x2020)]
TPDO1 = [
    Entry(0x1800, 0, "Highest sub-index supported", U8, "const", 2),
    Entry(0x1800, 1, "COB-ID", U32, "rw", 0x40000180, relative=True),
    Entry(0x1800, 2, "Transmission type", U8, "rw", 1),
    Entry(0x1A00, 0, "Number of mapped objects", U8, "rw", 1),
    Entry(0x1A00, 1, "Mapped object 1", U32, "rw", TEMPERATURE << 16 | 16),
    Entry(TEMPERATURE, 0, "Temperature, 0.1 degC", I16, "ro", mappable=True),
]


class Thermometer(CanopenNode):
    def __init__(self):
        super().__init__(ObjectDictionary([*COMMUNICATION, *TPDO1], NODE_ID))
        self.measured, self.lost = 215, []

    def on_sync(self):
        self.od.put(TEMPERATURE, 0, self.measured)

    def connection_lost(self, code, announce=False):
        self.lost.append(code)


def send(node, frame, now_ms=0):
    can_id, _, data = frame.partition("#")
    return [text(f) for f in node.handle(pack_frame(int(can_id, 16), bytes.fromhex(data)), now_ms * NS_PER_MS)]


def test_it_boots_answers_and_sends_what_it_measures_with_sync():
    node = Thermometer()
    assert [text(f) for f in node.start(0)] == ["705#00"]
    assert send(node, "605#4000600000000000") == ["585#4B00600000000000"]
    assert send(node, "605#2B00600001000000") == ["585#8000600002000106"]  # read only
    assert send(node, "080#") == []
    send(node, "000#0105")
    assert send(node, "080#") == ["185#D700"]
    node.measured = -5
    assert send(node, "080#") == ["185#FBFF"]


def test_a_master_that_goes_silent_takes_it_back_to_pre_operational():
    node = Thermometer()
    node.start(0)
    assert send(node, "605#23161001" + (MASTER_ID << 16 | 100).to_bytes(4, "little").hex()) == ["585#6016100100000000"]
    send(node, "000#0105")
    send(node, f"{0x700 + MASTER_ID:03X}#05", 10)
    node.lost.clear()
    assert [text(f) for f in node.poll(110 * NS_PER_MS)] == ["085#3081117F00000000"]
    assert node.lost[0] == 0x8130
    assert send(node, "080#", 111) == []
