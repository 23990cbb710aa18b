"""The electronic data sheet (CiA 306) of a simulated drive, made from its object dictionary."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator

from ....canopen_node.dictionary import (
    REAL_TYPES,
    SIGNED_TYPES,
    TEXT_TYPES,
    DataType,
    Entry,
    ObjectDictionary,
    ObjectKind,
    Value,
)
from ....canopen_node.node import pdo_numbers
from ....canopen_node.pdo_parameters import DUMMIES
from .config import NodeConfig, device_defaults
from .foreign_dictionary import dictionary_of
from .objects import OBJECT_NAMES

MANDATORY = (0x1000, 0x1001, 0x1018)
BIT_RATES = (10, 20, 50, 125, 250, 500, 800, 1000)  # kbit/s
DUMMY_TYPES = range(1, 8)
_CREATED = "01-01-2026"  # fixed, so that the same device gives the same file


def eds_text(config: NodeConfig, file_name: str = "simulated_drive.eds") -> str:
    """The EDS of the drive that `config` describes, line by line as in CiA 306; for any node-ID.

    Measured values have no default. With the dictionary of another drive it has the contents of that drive's file,
    values of a DCF included.
    """
    od = dictionary_of(config, config.node_id, device_defaults(config))
    indices = sorted({entry.index for entry in od.entries})
    mandatory = [index for index in MANDATORY if index in od]
    optional = [i for i in indices if i not in MANDATORY and not 0x2000 <= i < 0x6000]
    manufacturer = [i for i in indices if 0x2000 <= i < 0x6000]
    lines = [
        *_file_info(config, file_name),
        *_device_info(config, od),
        *_section("DummyUsage", [(f"Dummy{t:04d}", int(t in DUMMIES)) for t in DUMMY_TYPES]),
        *_section("Comments", [("Lines", 1), ("Line1", _origin(config))]),
    ]
    for title, chosen in (
        ("MandatoryObjects", mandatory),
        ("OptionalObjects", optional),
        ("ManufacturerObjects", manufacturer),
    ):
        lines += _object_list(title, chosen)
        for index in chosen:
            lines += _object(od, index)
    return "\n".join(lines)


def _origin(config: NodeConfig) -> str:
    if config.dictionary is None:
        return "Generated from the simulated drive's own table."
    return f"Objects of {_name(config)}, as the simulated drive has them."


def _name(config: NodeConfig) -> str:
    name = config.identity.device_name if config.dictionary is None else config.dictionary.drive
    return name.encode("ascii", "replace").decode()


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
        ("Description", _name(config)),
        ("CreationTime", "12:00AM"),
        ("CreationDate", _CREATED),
        ("CreatedBy", "fffo-drive"),
        ("ModificationTime", "12:00AM"),
        ("ModificationDate", _CREATED),
        ("ModifiedBy", "fffo-drive"),
    ]
    return _section("FileInfo", pairs)


def _device_info(config: NodeConfig, od: ObjectDictionary) -> Iterator[str]:
    vendor, product, revision = (od.number(0x1018, sub) for sub in (1, 2, 3))
    pairs: list[tuple[str, object]] = [
        ("VendorName", "fffo-drive" if config.dictionary is None else ""),
        ("VendorNumber", f"0x{vendor:08X}"),
        ("ProductName", _name(config)),
        ("ProductNumber", f"0x{product:08X}"),
        ("RevisionNumber", f"0x{revision:08X}"),
        ("OrderCode", "simulated"),
        *((f"BaudRate_{rate}", 1) for rate in BIT_RATES),
        ("SimpleBootUpMaster", 0),
        ("SimpleBootUpSlave", 1),
        ("Granularity", 8),
        ("DynamicChannelsSupported", 0),
        ("GroupMessaging", 0),
        ("NrOfRXPDO", len(pdo_numbers(od, 0x1400))),
        ("NrOfTXPDO", len(pdo_numbers(od, 0x1800))),
        ("LSS_Supported", 1),
    ]
    return _section("DeviceInfo", pairs)


def _object_list(title: str, indices: Iterable[int]) -> Iterator[str]:
    numbered = [(str(number), f"0x{index:04X}") for number, index in enumerate(indices, 1)]
    return _section(title, [("SupportedObjects", len(numbered)), *numbered])


def _object(od: ObjectDictionary, index: int) -> Iterator[str]:
    entries = [entry for entry in od.entries if entry.index == index]
    if all(entry.sub == 0 for entry in entries):
        yield from _section(f"{index:04X}", _description(od, entries[0]))
        return
    kind, name = OBJECT_NAMES.get(index, (ObjectKind.RECORD, f"Object {index:04X}"))
    head = [("ParameterName", name), ("ObjectType", f"0x{kind:X}"), ("SubNumber", len(entries))]
    yield from _section(f"{index:04X}", head)
    for entry in entries:
        yield from _section(f"{index:04X}sub{entry.sub:X}", _description(od, entry))


def _description(od: ObjectDictionary, entry: Entry) -> Iterator[tuple[str, object]]:
    yield "ParameterName", entry.name
    yield "ObjectType", f"0x{ObjectKind.VARIABLE:X}"
    yield "DataType", f"0x{entry.data_type:04X}"
    yield "AccessType", entry.access
    default = entry.default
    if default is None and entry.access != "ro" and not od.foreign:
        default = od.power_on_value(entry)  # of the device itself; another drive's file may lack it
    if default is not None:
        yield "DefaultValue", _value(entry, default, entry.relative)
    if entry.value is not None:
        yield "ParameterValue", _value(entry, entry.value, entry.value_relative)
    if entry.size:
        for name, limit in (("LowLimit", entry.low), ("HighLimit", entry.high)):
            if limit is not None:
                yield name, _number(entry, limit)
    yield "PDOMapping", int(entry.mappable)


def _value(entry: Entry, value: Value, relative: bool) -> str:
    if isinstance(value, bytes):
        text = entry.data_type in TEXT_TYPES
        return value.decode("ascii", "replace").replace("\ufffd", "?") if text else value.hex()
    if entry.data_type in REAL_TYPES:
        layout = "<f" if entry.data_type is DataType.REAL32 else "<d"
        return repr(struct.unpack(layout, value.to_bytes(entry.size, "little"))[0])
    number = _number(entry, value)
    return f"$NODEID+{number}" if relative else number


def _number(entry: Entry, value: int) -> str:
    return str(value) if entry.data_type in SIGNED_TYPES else f"0x{value:0{entry.size * 2}X}"
