"""The dictionary of a drive from a file: an EDS or DCF of its vendor (CiA 306), or a list of objects in YAML.

The YAML has `drive:` and `objects:`, a mapping of 0xINDEX:SUB to type (CiA 301 number), access, and optionally pdo (may
be mapped), default, low, high, value (what a DCF sets) and name. Numbers are in C notation; $NODEID+ in front of a
default or value adds the node-ID.
"""

from __future__ import annotations

import configparser
import re
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from ....canopen_node.dictionary import REAL_TYPES, SIGNED_TYPES, TEXT_TYPES, DataType, Entry, Value, type_range
from ....documents import DocumentError, StrictRecord, load, refuse
from ...canopen.eds import read_eds
from ...canopen.eds_tidy import decode, tidy
from ...canopen.eds_tidy import number as number_of
from ...canopen.object_map import MappingError
from .foreign_dictionary import ForeignDictionary
from .objects import ENTRIES
from .personality import NAMED_OBJECT

EDS_SUFFIXES = (".eds", ".dcf")
ACCESSES = ("ro", "wo", "rw", "rwr", "rww", "const")
MOST_COMPACT = 254  # sub-indices
_NODE_ID = re.compile(r"\$?\w*node_?id", re.IGNORECASE)
_NAMES = {(entry.index, entry.sub): entry.name for entry in ENTRIES if not 0x2000 <= entry.index < 0x6000}
_SECTION = re.compile(r"([0-9A-F]{4})(?:sub([0-9A-F]{1,2}))?")


class ObjectRecord(StrictRecord):
    """One sub-index."""

    type: Any = Field(description="data type, the number of CiA 301: 0x0007 is UNSIGNED32")
    access: Any = Field(description="ro, wo, rw, rwr, rww or const")
    pdo: Any = Field(None, description="1: may be mapped into a PDO")
    default: Any = Field(None, description="at power-on; $NODEID+ in front adds the node-ID")
    low: Any = Field(None, description="lowest that may be written")
    high: Any = Field(None, description="highest that may be written")
    value: Any = Field(None, description="what a DCF sets in place of the default")
    name: Any = Field(None, description="of the object, for its EDS")


class DictionaryRecord(StrictRecord):
    """The object dictionary of one drive."""

    drive: str = Field(description="its name")
    nr_of_rx_pdo: Any = Field(None, description="RPDOs, as its EDS says")
    nr_of_tx_pdo: Any = Field(None, description="TPDOs, as its EDS says")
    bit_rates: Any = Field(None, description="kbit/s")
    lss: Any = Field(None, description="1: its node-ID can be set by LSS")
    objects: dict[str, ObjectRecord] = Field(description="by 0xINDEX:SUB, both in hexadecimal")


class WrongFieldError(ValueError):
    """A field of an object that cannot be read."""

    def __init__(self, field: str, text: str) -> None:
        super().__init__(text)
        self.field, self.text = field, text


class _Row(NamedTuple):
    """An object as a file has it: texts. `strict`: what cannot be read is refused, not left out."""

    number: int  # index
    sub: int
    name: str
    data_type: str
    access: str
    mappable: str
    default: str | None
    low: str | None
    high: str | None
    value: str | None
    strict: bool


def read_dictionary(path: str | Path) -> ForeignDictionary:
    """The drive that a file describes. Raises DocumentError: file, object, and what is wrong."""
    path = Path(path)
    foreign = _from_eds(path) if _is_eds(path) else _from_yaml(path)
    for entry, text in foreign.problems():
        raise DocumentError(f"{path}: 0x{entry.index:04X}:{entry.sub:02X} {text}")
    return foreign


def _is_eds(path: Path) -> bool:
    if path.suffix.lower() in EDS_SUFFIXES:
        return True
    if path.suffix.lower() in (".yaml", ".yml"):
        return False
    try:
        with path.open("rb") as file:
            return file.read(1000).lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"[", b";"))
    except OSError as error:
        raise DocumentError(f"{path}: cannot be read: {error.strerror}") from None


# --- YAML


def _from_yaml(path: Path) -> ForeignDictionary:
    record = load(path, DictionaryRecord)
    entries: dict[int, Entry] = {}
    problems: list[tuple[str, str]] = []
    for name, described in record.objects.items():
        key = f"objects.{name}"
        match = NAMED_OBJECT.fullmatch(name)
        if match is None:
            problems.append((key, "an object is named 0xINDEX:SUB, as 0x60C2:02"))
            continue
        try:
            entry = _entry(_row_of(int(match[1], 16), int(match[2], 16), described))
        except WrongFieldError as error:
            problems.append((f"{key}.{error.field}", error.text))
            continue
        if entry.multiplexer in entries:
            problems.append((key, "stands here twice"))
        entries[entry.multiplexer] = entry
    if not record.objects:
        problems.append(("objects", "is empty: a drive has objects"))
    elif not problems and 0x1000 << 8 not in entries:
        problems.append(("objects", "0x1000:00 (device type) is missing: every CANopen device has it"))
    refuse(path, problems)
    return ForeignDictionary(record.drive, tuple(entries[k] for k in sorted(entries)))


def _row_of(index: int, sub: int, described: ObjectRecord) -> _Row:
    texts: dict[str, str | None] = {}
    for field, value in described:
        if value is not None and not isinstance(value, str | int | float):
            raise WrongFieldError(field, "text or a number is needed")
        texts[field] = None if value is None else str(value)
    return _Row(
        index,
        sub,
        texts["name"] or _NAMES.get((index, sub), f"Object {index:04X}:{sub:02X}"),
        texts["type"] or "",
        texts["access"] or "",
        texts["pdo"] or "0",
        texts["default"],
        texts["low"],
        texts["high"],
        texts["value"],
        strict=True,
    )


# --- EDS and DCF


def _from_eds(path: Path) -> ForeignDictionary:
    try:
        eds = read_eds(str(path), 1)
    except MappingError as error:
        raise DocumentError(str(error)) from None
    text, _ = decode(path.read_bytes())
    parser = configparser.RawConfigParser(strict=False)
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read_string(tidy(text)[0])
    entries: dict[int, Entry] = {}
    for section in parser.sections():
        match = _SECTION.fullmatch(section)
        if match is None:
            continue
        for row in _rows(int(match[1], 16), match[2], parser[section]):
            try:
                entry = _entry(row)
            except WrongFieldError as error:
                raise DocumentError(f"EDS file {path}: [{section}] {error.field}: {error.text}") from None
            entries[entry.multiplexer] = entry
    return ForeignDictionary(eds.drive_name, tuple(entries[k] for k in sorted(entries)))


def _rows(index: int, sub: str | None, section: Mapping[str, str]) -> Iterator[_Row]:
    """The objects that a section describes: one; none, for the head of an array; or all of a compact array."""
    count = number_of(section.get("CompactSubObj", "0")) or 0
    if sub is None and not count and (number_of(section.get("ObjectType", "7")) or 7) in (8, 9):
        return
    name = section.get("ParameterName", "").encode("ascii", "replace").decode()
    row = _Row(
        index,
        int(sub or "0", 16),
        name,
        section.get("DataType", ""),
        section.get("AccessType", ""),
        section.get("PDOMapping", "0"),
        section.get("DefaultValue"),
        section.get("LowLimit"),
        section.get("HighLimit"),
        section.get("ParameterValue"),
        strict=False,
    )
    if not count:
        yield row
        return
    yield _Row(index, 0, "Highest sub-index supported", "0x0005", "const", "0", str(count), None, None, None, False)
    for k in range(1, min(count, MOST_COMPACT) + 1):
        yield row._replace(sub=k, name=f"{name} {k}")


# --- both


def _entry(row: _Row) -> Entry:
    data_type = _type(row.data_type)
    access = row.access.lower()
    if access not in ACCESSES:
        raise WrongFieldError("access", f"{row.access!r} is none of {', '.join(ACCESSES)}")
    mappable = number_of(row.mappable)
    if mappable not in (0, 1) and row.strict:
        raise WrongFieldError("pdo", f"{row.mappable!r} is neither 0 nor 1")
    default, relative = _value_of(row, "default", data_type)
    value, value_relative = _value_of(row, "value", data_type)
    low, high = _limit(row, "low", data_type), _limit(row, "high", data_type)
    if low is not None and high is not None and low > high:
        if row.strict:
            raise WrongFieldError("low", f"{low} is above high, {high}")
        low = high = None
    return Entry(
        row.number, row.sub, row.name, data_type, access, default, low, high, bool(mappable), relative, value,
        value_relative,
    )  # fmt: skip


def _type(text: str) -> DataType:
    found = number_of(text)
    if found is None or found not in set(DataType):
        raise WrongFieldError("type", f"{text!r} is no data type of CiA 301 (0x0007 is UNSIGNED32)")
    return DataType(found)


def _value_of(row: _Row, field: str, data_type: DataType) -> tuple[Value | None, bool]:
    """A default or value, and whether the node-ID is added to it."""
    text: str | None = getattr(row, field)
    if text is None or not text.strip():
        return None, False
    try:
        if data_type in REAL_TYPES:
            return _real(text, data_type), False
        size = Entry(0, 0, "", data_type, "ro").size
        if not size:
            return _bytes(text, data_type), False
        relative = bool(_NODE_ID.search(text))
        rest = _NODE_ID.sub("", text).replace(" ", "").strip("+") if relative else text
        return _fitting(number_of(rest) if rest else 0, text, data_type), relative
    except (ValueError, OverflowError) as error:
        if row.strict:
            raise WrongFieldError(field, str(error)) from None
        return None, False


def _limit(row: _Row, field: str, data_type: DataType) -> int | None:
    text: str | None = getattr(row, field)
    if text is None or not text.strip() or data_type in REAL_TYPES or not Entry(0, 0, "", data_type, "ro").size:
        return None
    try:
        return _fitting(number_of(text), text, data_type)
    except ValueError as error:
        if row.strict:
            raise WrongFieldError(field, str(error)) from None
        return None


def _fitting(value: int | None, text: str, data_type: DataType) -> int:
    """The number as its type has it: 0xFD is -3 in eight bits. ValueError."""
    if value is None:
        raise ValueError(f"{text!r} is no number")
    low, high = type_range(data_type)
    span = high - low + 1
    if data_type in SIGNED_TYPES and high < value < span:
        value -= span
    elif data_type not in SIGNED_TYPES and -(span >> 1) <= value < 0:
        value += span
    if not low <= value <= high:
        raise ValueError(f"{text} does not fit {data_type.name} ({low} to {high})")
    return value


def _real(text: str, data_type: DataType) -> int:
    layout = "<f" if data_type is DataType.REAL32 else "<d"
    return int.from_bytes(struct.pack(layout, float(text)), "little")


def _bytes(text: str, data_type: DataType) -> bytes:
    if data_type in TEXT_TYPES:
        return text.encode("latin-1", "replace")
    try:
        return bytes.fromhex(text.removeprefix("0x"))
    except ValueError:
        return text.encode("latin-1", "replace")
