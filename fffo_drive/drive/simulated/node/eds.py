"""The electronic data sheet (CiA 306) of a simulated drive, made from its object dictionary."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from .config import NodeConfig, device_defaults
from .dictionary import STRUCT_CODES, DataType, Entry, ObjectDictionary, ObjectKind
from .objects import ENTRIES, OBJECT_NAMES, PDO_COUNT
from .pdo_parameters import DUMMIES

MANDATORY = (0x1000, 0x1001, 0x1018)
BIT_RATES = (10, 20, 50, 125, 250, 500, 800, 1000)  # kbit/s
DUMMY_TYPES = range(1, 8)
_CREATED = "01-01-2026"  # a date of the format, not of the run: the same device gives the same file


def eds_text(config: NodeConfig, file_name: str = "simulated_drive.eds") -> str:
    """The EDS of the drive that `config` describes, line by line as CiA 306 wants it; for any node-ID.

    What the drive measures (access ro) has no default.
    """
    od = ObjectDictionary(ENTRIES, config.node_id, device_defaults(config))
    indices = sorted({entry.index for entry in od.entries})
    optional = [i for i in indices if i not in MANDATORY and not 0x2000 <= i < 0x6000]
    manufacturer = [i for i in indices if 0x2000 <= i < 0x6000]
    lines = [
        *_file_info(config, file_name),
        *_device_info(config),
        *_section("DummyUsage", [(f"Dummy{t:04d}", int(t in DUMMIES)) for t in DUMMY_TYPES]),
        *_section("Comments", [("Lines", 1), ("Line1", "Generated from the simulated drive's own table.")]),
    ]
    for title, chosen in (
        ("MandatoryObjects", MANDATORY),
        ("OptionalObjects", optional),
        ("ManufacturerObjects", manufacturer),
    ):
        lines += _object_list(title, chosen)
        for index in chosen:
            lines += _object(od, index)
    return "\n".join(lines)


def _section(title: str, pairs: Iterable[tuple[str, object]]) -> Iterator[str]:
    yield f"[{title}]"
    for name, value in pairs:
        yield f"{name}={value}"
    yield ""


def _file_info(config: NodeConfig, file_name: str) -> Iterator[str]:
    pairs = [
        ("FileName", file_name),
        ("FileVersion", 1),
        ("FileRevision", 0),
        ("EDSVersion", "4.0"),
        ("Description", config.identity.device_name),
        ("CreationTime", "12:00AM"),
        ("CreationDate", _CREATED),
        ("CreatedBy", "fffo-drive"),
        ("ModificationTime", "12:00AM"),
        ("ModificationDate", _CREATED),
        ("ModifiedBy", "fffo-drive"),
    ]
    return _section("FileInfo", pairs)


def _device_info(config: NodeConfig) -> Iterator[str]:
    identity = config.identity
    pairs: list[tuple[str, object]] = [
        ("VendorName", "fffo-drive"),
        ("VendorNumber", f"0x{identity.vendor_id:08X}"),
        ("ProductName", identity.device_name),
        ("ProductNumber", f"0x{identity.product_code:08X}"),
        ("RevisionNumber", f"0x{identity.revision:08X}"),
        ("OrderCode", "simulated"),
        *((f"BaudRate_{rate}", 1) for rate in BIT_RATES),
        ("SimpleBootUpMaster", 0),
        ("SimpleBootUpSlave", 1),
        ("Granularity", 8),
        ("DynamicChannelsSupported", 0),
        ("GroupMessaging", 0),
        ("NrOfRXPDO", PDO_COUNT),
        ("NrOfTXPDO", PDO_COUNT),
        ("LSS_Supported", 1),
    ]
    return _section("DeviceInfo", pairs)


def _object_list(title: str, indices: Iterable[int]) -> Iterator[str]:
    numbered = [(str(number), f"0x{index:04X}") for number, index in enumerate(indices, 1)]
    return _section(title, [("SupportedObjects", len(numbered)), *numbered])


def _object(od: ObjectDictionary, index: int) -> Iterator[str]:
    entries = [entry for entry in od.entries if entry.index == index]
    if index not in OBJECT_NAMES:
        yield from _section(f"{index:04X}", _description(entries[0]))
        return
    kind, name = OBJECT_NAMES[index]
    head = [("ParameterName", name), ("ObjectType", f"0x{kind:X}"), ("SubNumber", len(entries))]
    yield from _section(f"{index:04X}", head)
    for entry in entries:
        yield from _section(f"{index:04X}sub{entry.sub:X}", _description(entry))


def _description(entry: Entry) -> Iterator[tuple[str, object]]:
    yield "ParameterName", entry.name
    yield "ObjectType", f"0x{ObjectKind.VARIABLE:X}"
    yield "DataType", f"0x{entry.data_type:04X}"
    yield "AccessType", entry.access
    if entry.access != "ro":
        yield "DefaultValue", _default(entry)
    if entry.data_type in STRUCT_CODES:
        for name, limit in (("LowLimit", entry.low), ("HighLimit", entry.high)):
            if limit is not None:
                yield name, _number(entry, limit)
    yield "PDOMapping", int(entry.mappable)


def _default(entry: Entry) -> str:
    if isinstance(entry.default, bytes):
        return entry.default.decode("ascii")
    number = _number(entry, entry.default)
    return f"$NODEID+{number}" if entry.relative else number


def _number(entry: Entry, value: int) -> str:
    signed = entry.data_type in (DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32)
    return str(value) if signed else f"0x{value:0{entry.size * 2}X}"
