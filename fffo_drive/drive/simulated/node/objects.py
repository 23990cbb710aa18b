"""Every object of the simulated drive, as one table: CiA 301 communication, manufacturer, CiA 402 profile.

The store, the SDO server's checks, the PDO mapping rules and the EDS are all made from `ENTRIES`, or from the entries
of another drive (`foreign_dictionary.py`). Objects that depend on the configured drive (ratings, counts, identity) have
their defaults in `config.py`.
"""

from __future__ import annotations

from dataclasses import replace

from ....canopen_node.cob_id import INVALID, NO_RTR
from ....canopen_node.dictionary import WAITS_FOR_MASTER, DataType, Entry, ObjectKind

I8, I16, I32 = DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32
U8, U16, U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
TEXT = DataType.VISIBLE_STRING

PDO_COUNT = 4  # RPDOs, and as many TPDOs
MAPPED_OBJECTS = 8  # entries of one mapping
HISTORY_LENGTH = 8
MONITORED_NODES = 4
STORAGE_GROUPS = 4

OWN_OBJECTS = range(0x2000, 0x2200)  # of this program alone

# CiA 402: 0x6502 and 0x6060
MODE_NONE = 0
MODE_TORQUE_PROFILE = 4
MODE_CYCLIC_TORQUE = 10
SUPPORTED_MODES = 1 << (MODE_TORQUE_PROFILE - 1) | 1 << (MODE_CYCLIC_TORQUE - 1)
DEVICE_TYPE = 0x00020192  # servo drive, device profile 402
INCREMENTS = 0x00B50000  # notation of CiA 303-2
INCREMENTS_PER_S = 0x00B50300
COMMANDS = frozenset({0x2100, 0x6040, 0x6060, 0x6071, 0x60B2})  # writable, but no parameters
EVENT_OBJECTS = frozenset({0x6041, 0x6061, 0x603F, 0x1001})  # a change sends a TPDO that has one of them
# error codes
OVERCURRENT = 0x2310
DC_LINK_OVERVOLTAGE = 0x3210
DC_LINK_UNDERVOLTAGE = 0x3220
OVERTEMPERATURE = 0x4310
RESOLVER = 0x7303
OVERSPEED = 0x7310


def _numbered(index: int, count: int, name: str, data_type: DataType, access: str, default: int) -> list[Entry]:
    """Sub 0 and `count` like entries of an array."""
    head = Entry(index, 0, "Highest sub-index supported", U8, "const", count)
    return [
        head,
        *(Entry(index, sub, f"{name} {sub}", data_type, access, default) for sub in range(1, count + 1)),
    ]


_RPDO_DEFAULTS = (  # COB-ID offset, transmission type, mapping
    (0x200, 255, (0x60400010,)),
    (0x300, 255, (0x60400010, 0x60710010)),
    (0x400 | INVALID, 1, ()),
    (0x500 | INVALID, 1, ()),
)
_TPDO_DEFAULTS = (
    (0x180 | NO_RTR, 255, (0x60410010,)),
    (0x280 | NO_RTR, 1, (0x60640020, 0x606C0020)),
    (0x380 | NO_RTR | INVALID, 1, ()),
    (0x480 | NO_RTR | INVALID, 1, ()),
)


def _mapping(index: int, mapped: tuple[int, ...]) -> list[Entry]:
    rows = [Entry(index, 0, "Number of mapped objects", U8, "rw", len(mapped))]
    padded = mapped + (0,) * (MAPPED_OBJECTS - len(mapped))
    rows += [Entry(index, sub, f"Mapped object {sub}", U32, "rw", value) for sub, value in enumerate(padded, 1)]
    return rows


def _rpdo(number: int) -> list[Entry]:
    cob_id, transmission_type, mapped = _RPDO_DEFAULTS[number]
    index = 0x1400 + number
    return [
        Entry(index, 0, "Highest sub-index supported", U8, "const", 5),
        Entry(index, 1, "COB-ID used by RPDO", U32, "rw", cob_id, relative=True),
        Entry(index, 2, "Transmission type", U8, "rw", transmission_type),
        Entry(index, 5, "Event timer", U16, "rw", 0),
        *_mapping(0x1600 + number, mapped),
    ]


def _tpdo(number: int) -> list[Entry]:
    cob_id, transmission_type, mapped = _TPDO_DEFAULTS[number]
    index = 0x1800 + number
    return [
        Entry(index, 0, "Highest sub-index supported", U8, "const", 6),
        Entry(index, 1, "COB-ID used by TPDO", U32, "rw", cob_id, relative=True),
        Entry(index, 2, "Transmission type", U8, "rw", transmission_type),
        Entry(index, 3, "Inhibit time", U16, "rw", 0),
        Entry(index, 5, "Event timer", U16, "rw", 0),
        Entry(index, 6, "SYNC start value", U8, "rw", 0, 0, 240),
        *_mapping(0x1A00 + number, mapped),
    ]


_COMMUNICATION = [
    Entry(0x1000, 0, "Device type", U32, "const", DEVICE_TYPE),
    Entry(0x1001, 0, "Error register", U8, "ro", mappable=True),
    Entry(0x1003, 0, "Number of errors", U8, "rw"),
    *(Entry(0x1003, sub, f"Standard error field {sub}", U32, "ro") for sub in range(1, HISTORY_LENGTH + 1)),
    Entry(0x1005, 0, "COB-ID SYNC message", U32, "rw", 0x80),
    Entry(0x1006, 0, "Communication cycle period", U32, "rw"),
    Entry(0x1007, 0, "Synchronous window length", U32, "rw"),
    Entry(0x1008, 0, "Manufacturer device name", TEXT, "const", None),
    Entry(0x1009, 0, "Manufacturer hardware version", TEXT, "const", None),
    Entry(0x100A, 0, "Manufacturer software version", TEXT, "const", None),
    Entry(0x100C, 0, "Guard time", U16, "rw"),
    Entry(0x100D, 0, "Life time factor", U8, "rw"),
    *_numbered(0x1010, STORAGE_GROUPS, "Store parameters of group", U32, "rw", 1),
    *_numbered(0x1011, STORAGE_GROUPS, "Restore defaults of group", U32, "rw", 1),
    Entry(0x1014, 0, "COB-ID EMCY", U32, "rw", 0x80, relative=True),
    Entry(0x1015, 0, "Inhibit time EMCY", U16, "rw"),
    *_numbered(0x1016, MONITORED_NODES, "Consumer heartbeat time", U32, "rw", 0),
    Entry(0x1017, 0, "Producer heartbeat time", U16, "rw"),
    Entry(0x1018, 0, "Highest sub-index supported", U8, "const", 4),
    Entry(0x1018, 1, "Vendor-ID", U32, "const", None),
    Entry(0x1018, 2, "Product code", U32, "const", None),
    Entry(0x1018, 3, "Revision number", U32, "const", None),
    Entry(0x1018, 4, "Serial number", U32, "const", None),
    Entry(0x1019, 0, "Synchronous counter overflow value", U8, "rw", 0, 0, 240),
    Entry(0x1029, 0, "Highest sub-index supported", U8, "const", 1),
    Entry(0x1029, 1, "Communication error", U8, "rw", 0, 0, 2),
    Entry(0x1200, 0, "Highest sub-index supported", U8, "const", 2),
    Entry(0x1200, 1, "COB-ID client to server", U32, "const", 0x600, relative=True),
    Entry(0x1200, 2, "COB-ID server to client", U32, "const", 0x580, relative=True),
    *(row for number in range(PDO_COUNT) for row in _rpdo(number)),
    *(row for number in range(PDO_COUNT) for row in _tpdo(number)),
    Entry(0x1F80, 0, "NMT startup", U32, "rw", WAITS_FOR_MASTER),
]

_MANUFACTURER = [
    Entry(0x2000, 0, "User text", TEXT, "rw", b"", high=64),
    Entry(0x2010, 0, "Tolerated loss of SYNC", U16, "rw", None),
    Entry(0x2020, 0, "Highest sub-index supported", U8, "const", 6),
    Entry(0x2020, 1, "SYNC messages received", U32, "ro"),
    Entry(0x2020, 2, "SYNC messages missed", U32, "ro"),
    Entry(0x2020, 3, "RPDOs applied", U32, "ro"),
    Entry(0x2020, 4, "RPDOs outside the synchronous window", U32, "ro"),
    Entry(0x2020, 5, "Frames dropped by the receive queue", U32, "ro"),
    Entry(0x2020, 6, "Malformed frames", U32, "ro"),
    Entry(0x2100, 0, "Highest sub-index supported", U8, "const", 8),
    Entry(0x2100, 1, "Injected fault", U8, "rw"),
    Entry(0x2100, 2, "CAN-ID concerned", U32, "rw", 0, 0, 0x7FF),
    Entry(0x2100, 3, "Probability", U16, "rw", 1000, 0, 1000),
    Entry(0x2100, 4, "Value", I32, "rw"),
    Entry(0x2100, 5, "Duration", U32, "rw"),
    Entry(0x2100, 6, "Trigger", U8, "wo", 0, 0, 2),
    Entry(0x2100, 7, "Faults in effect", U8, "ro"),
    Entry(0x2100, 8, "Jitter", U32, "rw"),
]

_DRIVE = [
    Entry(0x6007, 0, "Abort connection option code", I16, "rw", 1, 0, 3),
    Entry(0x603F, 0, "Error code", U16, "ro", mappable=True),
    Entry(0x6040, 0, "Controlword", U16, "rww", mappable=True),
    Entry(0x6041, 0, "Statusword", U16, "ro", mappable=True),
    Entry(0x605A, 0, "Quick stop option code", I16, "rw", None, 0, 7),
    Entry(0x605B, 0, "Shutdown option code", I16, "rw", 0, 0, 1),
    Entry(0x605C, 0, "Disable operation option code", I16, "rw", 1, 0, 1),
    Entry(0x605D, 0, "Halt option code", I16, "rw", 1, 1, 3),
    Entry(0x605E, 0, "Fault reaction option code", I16, "rw", None, 0, 3),
    Entry(0x6060, 0, "Modes of operation", I8, "rww", mappable=True),
    Entry(0x6061, 0, "Modes of operation display", I8, "ro", mappable=True),
    Entry(0x6064, 0, "Position actual value", I32, "ro", mappable=True),
    Entry(0x606C, 0, "Velocity actual value", I32, "ro", mappable=True),
    Entry(0x6071, 0, "Target torque", I16, "rww", mappable=True),
    Entry(0x6072, 0, "Max torque", U16, "rww", None, mappable=True),
    Entry(0x6073, 0, "Max current", U16, "rw", None),
    Entry(0x6074, 0, "Torque demand", I16, "ro", mappable=True),
    Entry(0x6075, 0, "Motor rated current", U32, "rw", None),
    Entry(0x6076, 0, "Motor rated torque", U32, "rw", None),
    Entry(0x6077, 0, "Torque actual value", I16, "ro", mappable=True),
    Entry(0x6078, 0, "Current actual value", I16, "ro", mappable=True),
    Entry(0x6079, 0, "DC link circuit voltage", U32, "ro", mappable=True),
    Entry(0x607E, 0, "Polarity", U8, "rw"),
    Entry(0x6080, 0, "Max motor speed", U32, "rww", None, mappable=True),
    Entry(0x6084, 0, "Profile deceleration", U32, "rww", None, low=1, mappable=True),
    Entry(0x6085, 0, "Quick stop deceleration", U32, "rww", None, low=1, mappable=True),
    Entry(0x6087, 0, "Torque slope", U32, "rww", 1_000_000, low=1, mappable=True),
    Entry(0x608F, 0, "Highest sub-index supported", U8, "const", 2),
    Entry(0x608F, 1, "Encoder increments", U32, "rw", None, low=1),
    Entry(0x608F, 2, "Motor revolutions", U32, "rw", 1, low=1),
    Entry(0x6090, 0, "Highest sub-index supported", U8, "const", 2),
    Entry(0x6090, 1, "Encoder increments per second", U32, "const", None),
    Entry(0x6090, 2, "Motor revolutions per second", U32, "const", 1),
    Entry(0x6091, 0, "Highest sub-index supported", U8, "const", 2),
    Entry(0x6091, 1, "Motor revolutions", U32, "rw", 1, low=1),
    Entry(0x6091, 2, "Shaft revolutions", U32, "rw", 1, low=1),
    Entry(0x6092, 0, "Highest sub-index supported", U8, "const", 2),
    Entry(0x6092, 1, "Feed", U32, "rw", None, low=1),
    Entry(0x6092, 2, "Shaft revolutions", U32, "rw", 1, low=1),
    Entry(0x60A8, 0, "SI unit position", U32, "rw", INCREMENTS),
    Entry(0x60A9, 0, "SI unit velocity", U32, "rw", INCREMENTS_PER_S),
    Entry(0x60B2, 0, "Torque offset", I16, "rww", mappable=True),
    Entry(0x60C2, 0, "Highest sub-index supported", U8, "const", 2),
    Entry(0x60C2, 1, "Interpolation time period value", U8, "rw", 1, low=1),
    Entry(0x60C2, 2, "Interpolation time index", I8, "rw", -3, -6, 0),
    Entry(0x60E0, 0, "Positive torque limit value", U16, "rww", None, mappable=True),
    Entry(0x60E1, 0, "Negative torque limit value", U16, "rww", None, mappable=True),
    Entry(0x60FD, 0, "Digital inputs", U32, "ro", mappable=True),
    Entry(0x60FE, 0, "Highest sub-index supported", U8, "const", 2),
    Entry(0x60FE, 1, "Physical outputs", U32, "rww", mappable=True),
    Entry(0x60FE, 2, "Bit mask", U32, "rw"),
    Entry(0x6402, 0, "Motor type", U16, "const", 10),
    Entry(0x6502, 0, "Supported drive modes", U32, "const", SUPPORTED_MODES),
    Entry(0x67FF, 0, "Single device type", U32, "const", DEVICE_TYPE),
]

ENTRIES: tuple[Entry, ...] = tuple(
    replace(entry, default=None) if entry.access == "ro" else entry  # measured
    for entry in (*_COMMUNICATION, *_MANUFACTURER, *_DRIVE)
)

# Behaviour of a drive without the object, where it differs from our default
_WITHOUT = {
    (0x1014, 0): INVALID,  # no emergency messages
    (0x6007, 0): 0,  # no action when the connection is lost
    (0x6075, 0): 0,
    (0x6076, 0): 0,
    (0x6087, 0): 0xFFFFFFFF,  # as fast as it can
    (0x608F, 1): 0,
    (0x608F, 2): 0,
    (0x6090, 1): 0,
    (0x6090, 2): 0,
    (0x6092, 1): 0,
    (0x6092, 2): 0,
    (0x60A8, 0): 0,
    (0x60A9, 0): 0,
}
PDO_OBJECTS = range(0x1400, 0x1C00)
ABSENT: tuple[Entry, ...] = tuple(
    replace(entry, default=_WITHOUT.get((entry.index, entry.sub), entry.default))
    for entry in ENTRIES
    if entry.index not in PDO_OBJECTS and entry.index not in (0x1003, 0x1010, 0x1011, 0x1016)
)

# Objects with more than one sub-index; every other is a variable.
OBJECT_NAMES: dict[int, tuple[ObjectKind, str]] = {
    0x1003: (ObjectKind.ARRAY, "Pre-defined error field"),
    0x1010: (ObjectKind.ARRAY, "Store parameters"),
    0x1011: (ObjectKind.ARRAY, "Restore default parameters"),
    0x1016: (ObjectKind.ARRAY, "Consumer heartbeat time"),
    0x1018: (ObjectKind.RECORD, "Identity object"),
    0x1029: (ObjectKind.ARRAY, "Error behaviour"),
    0x1200: (ObjectKind.RECORD, "SDO server parameter"),
    **{0x1400 + n: (ObjectKind.RECORD, f"RPDO communication parameter {n + 1}") for n in range(PDO_COUNT)},
    **{0x1600 + n: (ObjectKind.RECORD, f"RPDO mapping parameter {n + 1}") for n in range(PDO_COUNT)},
    **{0x1800 + n: (ObjectKind.RECORD, f"TPDO communication parameter {n + 1}") for n in range(PDO_COUNT)},
    **{0x1A00 + n: (ObjectKind.RECORD, f"TPDO mapping parameter {n + 1}") for n in range(PDO_COUNT)},
    0x2020: (ObjectKind.RECORD, "Statistics"),
    0x2100: (ObjectKind.RECORD, "Fault injection"),
    0x608F: (ObjectKind.RECORD, "Position encoder resolution"),
    0x6090: (ObjectKind.RECORD, "Velocity encoder resolution"),
    0x6091: (ObjectKind.RECORD, "Gear ratio"),
    0x6092: (ObjectKind.RECORD, "Feed constant"),
    0x60FE: (ObjectKind.RECORD, "Digital outputs"),
    0x60C2: (ObjectKind.RECORD, "Interpolation time period"),
}
