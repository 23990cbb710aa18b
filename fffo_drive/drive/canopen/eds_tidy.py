"""Repair of vendors' EDS files for a strict parser, with a remark for each repair.

CiA 306 is an INI file in ASCII with numbers in C notation. Real files are in cp1252 or have a byte order mark, have
empty or differently written numbers, count comment lines under another key, repeat entries, or spell keys in other
cases. An entry with only one possible meaning is repaired, any other is left out. An empty default or limit is legal
and gives no remark. Unused sections ([1003Name], [Tools], vendors' own) are skipped.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

VARIABLE, ARRAY, RECORD = 7, 8, 9
DOMAIN, HIGHEST_TYPE = 0x0F, 0x1B
SIGNED_BITS = {0x02: 8, 0x03: 16, 0x04: 32, 0x10: 24, 0x12: 40, 0x13: 48, 0x14: 56, 0x15: 64}
UNSIGNED_BITS = {0x01: 1, 0x05: 8, 0x06: 16, 0x07: 32, 0x16: 24, 0x18: 40, 0x19: 48, 0x1A: 56, 0x1B: 64}
ACCESSES = {"ro", "wo", "rw", "rwr", "rww", "const"}
ACCESS_WORDS = {"read only": "ro", "readonly": "ro", "write only": "wo", "writeonly": "wo", "r": "ro", "w": "wo",
                "read/write": "rw", "readwrite": "rw", "wr": "rw", "r/w": "rw", "constant": "const"}  # fmt: skip
TRUTH = {"yes": 1, "true": 1, "on": 1, "no": 0, "false": 0, "off": 0}

_KEYS = {
    key.lower(): key
    for key in (
        "ParameterName", "ObjectType", "DataType", "AccessType", "DefaultValue", "LowLimit", "HighLimit", "PDOMapping",
        "SubNumber", "CompactSubObj", "ParameterValue", "VendorName", "VendorNumber", "ProductName",
        "ProductNumber", "RevisionNumber", "OrderCode", "SimpleBootUpMaster", "SimpleBootUpSlave", "Granularity",
        "DynamicChannelsSupported", "GroupMessaging", "NrOfRXPDO", "NrOfTXPDO", "LSS_Supported", "SupportedObjects",
        *(f"BaudRate_{rate}" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)),
    )
}  # fmt: skip
_OBJECT_KEYS = {
    "ParameterName", "ObjectType", "DataType", "AccessType", "DefaultValue", "LowLimit", "HighLimit", "PDOMapping",
    "SubNumber", "CompactSubObj", "ParameterValue",
}  # fmt: skip
_DEVICE_TEXTS = {"VendorName", "ProductName", "OrderCode"}
_DEVICE_NUMBERS = {
    key for key in _KEYS.values() if key.startswith(("VendorNum", "ProductNum", "Revision", "BaudRate", "Simple"))
} | {"Granularity", "DynamicChannelsSupported", "GroupMessaging", "NrOfRXPDO", "NrOfTXPDO", "LSS_Supported"}
_PLAIN_SECTIONS = {
    name.lower(): name
    for name in (
        "FileInfo", "DeviceInfo", "DummyUsage", "Comments", "MandatoryObjects", "OptionalObjects",
        "ManufacturerObjects",
    )
}  # fmt: skip
_OBJECT = re.compile(r"^([0-9a-f]{4})$", re.IGNORECASE)
_SUB = re.compile(r"^([0-9a-f]{4})\s*sub\s*([0-9a-f]{1,2})$", re.IGNORECASE)
_NODE_ID = re.compile(r"\$?(?:my_)?node_?id", re.IGNORECASE)  # Roboteq writes $MY_NODE_ID


class EdsRemark(NamedTuple):
    """A deviation in the file. Line 0: the file as a whole."""

    line: int
    text: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.text}" if self.line else self.text


@dataclass
class EdsSection:
    """One section: where it began, and its keys with value and line."""

    name: str
    line: int
    values: dict[str, tuple[str, int]] = field(default_factory=dict)

    def text(self, key: str) -> str:
        """A value, empty where there is none."""
        return self.values[key][0] if key in self.values else ""

    def line_of(self, key: str) -> int:
        """The line of a key; the line of the section where the key is missing."""
        return self.values[key][1] if key in self.values else self.line


def decode(raw: bytes) -> tuple[str, list[EdsRemark]]:
    """The text of a file in whatever encoding it is."""
    for mark, name in ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16")):
        if raw.startswith(mark):
            return raw.decode(name, errors="replace"), [EdsRemark(0, "is UTF-16, not ASCII")]
    try:
        return raw.decode("utf-8-sig"), []
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        return raw.decode("cp1252", errors="replace"), [
            EdsRemark(line, f"byte 0x{raw[error.start]:02X} is not UTF-8; the file is read as cp1252")
        ]


def tidy(text: str) -> tuple[str, list[EdsRemark]]:
    """The file in CiA 306 form, and its repairs and omissions, by line."""
    remarks: list[EdsRemark] = []
    sections = _read(text, remarks)
    objects = {name: section for name, section in sections.items() if name not in _PLAIN_SECTIONS.values()}
    for name in [name for name in objects if _SUB.match(name)]:
        _give_parent(objects, name[:4], name, remarks)
    kept = {name: section for name, section in objects.items() if _repair(section, remarks)}
    lines = ["[FileInfo]", *_comments(sections, remarks), *_device_info(sections, remarks)]
    if "DummyUsage" in sections:
        lines += ["[DummyUsage]", *_dummies(sections["DummyUsage"], remarks)]
    for name in sorted(kept, key=lambda name: (len(name) > 4, name)):  # an object before its sub-indices
        lines.append(f"[{name}]")
        lines += [f"{key}={value}" for key, (value, _) in kept[name].values.items() if key in _OBJECT_KEYS]
    _check_lists(sections, kept, remarks)
    return "\n".join(lines) + "\n", sorted(remarks)


def number(text: str) -> int | None:
    """A number in C notation or one of the common variants; None where it is none."""
    compact = re.sub(r"[\s_]", "", text).lower().rstrip("ul")
    if re.fullmatch(r"[+-]?0x[0-9a-f]+|[+-]?[1-9][0-9]*|[+-]?0", compact):
        return int(compact, 0)
    if re.fullmatch(r"[0-9][0-9a-f]*h", compact):
        return int(compact[:-1], 16)
    if re.fullmatch(r"0[0-7]+", compact):
        return int(compact, 8)
    if re.fullmatch(r"[+-]?[0-9]+(\.0*)?", compact):
        return int(float(compact))
    return TRUTH.get(compact)


# --- reading


def _read(text: str, remarks: list[EdsRemark]) -> dict[str, EdsSection]:
    sections: dict[str, EdsSection] = {}
    current: EdsSection | None = None
    for line, raw in enumerate(text.splitlines(), 1):
        content = raw.strip().strip("\0\ufeff\x1a")
        if not content or content[0] in ";#":
            continue
        if content[0] == "[":
            current = _open(sections, content, line, remarks)
            continue
        key, equals, value = content.partition("=")
        if not equals:
            remarks.append(EdsRemark(line, f"{content[:40]!r} is neither a section nor a key; left out"))
        elif current is None:
            remarks.append(EdsRemark(line, f"key {key.strip()!r} stands before the first section; left out"))
        else:
            _take(current, key.strip(), value.partition(";")[0].strip(), line, remarks)
    return sections


def _open(sections: dict[str, EdsSection], content: str, line: int, remarks: list[EdsRemark]) -> EdsSection:
    if "]" not in content:
        remarks.append(EdsRemark(line, f"section {content!r} lacks its closing bracket"))
    name = _canonical(content[1:].partition("]")[0].strip())
    if name in sections:
        remarks.append(EdsRemark(line, f"section [{name}] begins again (first in line {sections[name].line}): joined"))
        return sections[name]
    section = EdsSection(name, line)
    if name in _PLAIN_SECTIONS.values() or _OBJECT.match(name) or _SUB.match(name):
        sections[name] = section
    return section


def _canonical(name: str) -> str:
    if name.lower() in _PLAIN_SECTIONS:
        return _PLAIN_SECTIONS[name.lower()]
    if match := _SUB.match(name):
        return f"{match[1].upper()}sub{int(match[2], 16):X}"
    return name.upper() if _OBJECT.match(name) else name


def _take(section: EdsSection, key: str, value: str, line: int, remarks: list[EdsRemark]) -> None:
    name = _KEYS.get(key.lower(), key)
    if name in section.values:
        if section.values[name][0] != value:
            first = section.values[name][1]
            remarks.append(EdsRemark(line, f"{name} of [{section.name}] is given twice; line {first} counts"))
        return
    section.values[name] = (value, line)


# --- sections other than objects


def _comments(sections: dict[str, EdsSection], remarks: list[EdsRemark]) -> Iterator[str]:
    section = sections.get("Comments")
    if section is None:
        return
    numbered = [(k, value) for k, (value, _) in section.values.items() if re.fullmatch(r"(?i)lines?\d+", k)]
    odd = next((k for k, _ in numbered if k.lower().startswith("lines")), None)
    if odd is not None:
        remarks.append(EdsRemark(section.line_of(odd), f"[Comments] has {odd}=, where Line{odd[5:]}= is meant"))
    counted = number(section.text("Lines"))
    if counted != len(numbered):
        lines = section.text("Lines") or "nothing"
        remarks.append(EdsRemark(section.line_of("Lines"), f"[Comments] says Lines={lines}, there are {len(numbered)}"))
    yield "[Comments]"
    yield f"Lines={len(numbered)}"
    yield from (f"Line{place}={value}" for place, (_, value) in enumerate(numbered, 1))


def _device_info(sections: dict[str, EdsSection], remarks: list[EdsRemark]) -> Iterator[str]:
    section = sections.get("DeviceInfo")
    if section is None:
        return
    yield "[DeviceInfo]"
    for key, (text, line) in section.values.items():
        if key in _DEVICE_TEXTS:
            yield f"{key}={text}"
        if key not in _DEVICE_NUMBERS:
            continue
        value = number(text)
        if value is None:
            remarks.append(EdsRemark(line, f"{key} of [DeviceInfo] {_no_number(text)}; left out"))
            continue
        if not _plain(text):
            remarks.append(EdsRemark(line, f"{key}={text} of [DeviceInfo] is read as {value}"))
        yield f"{key}={value}"


def _dummies(section: EdsSection, remarks: list[EdsRemark]) -> Iterator[str]:
    for data_type in range(1, 8):
        key = next((k for k in section.values if k.lower() == f"dummy{data_type:04d}"), "")
        value = number(section.text(key)) if key else 0
        if value is None:
            remarks.append(EdsRemark(section.line_of(key), f"{key} {_no_number(section.text(key))}"))
        yield f"Dummy{data_type:04d}={value or 0}"


def _check_lists(sections: dict[str, EdsSection], kept: dict[str, EdsSection], remarks: list[EdsRemark]) -> None:
    for title in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        section = sections.get(title)
        for key, (text, line) in section.values.items() if section else ():
            index = number(text)
            if key.isdecimal() and index and f"{index:04X}" not in kept:
                remarks.append(EdsRemark(line, f"[{title}] lists 0x{index:04X}, which is not described"))


# --- objects


def _give_parent(objects: dict[str, EdsSection], parent: str, child: str, remarks: list[EdsRemark]) -> None:
    """A sub-index needs an object with sub-indices."""
    line = objects[child].line
    if parent not in objects:
        remarks.append(EdsRemark(line, f"[{child}] has no section [{parent}] above it; taken for a record"))
        objects[parent] = EdsSection(parent, line, {"ParameterName": (f"object 0x{parent}", line)})
    section = objects[parent]
    if number(section.text("ObjectType")) not in (ARRAY, RECORD):
        if section.text("ObjectType"):
            declared = section.text("ObjectType")
            remarks.append(
                EdsRemark(section.line_of("ObjectType"), f"0x{parent} has sub-indices, but ObjectType={declared}")
            )
        section.values["ObjectType"] = (f"0x{RECORD:X}", section.line_of("ObjectType"))


def _repair(section: EdsSection, remarks: list[EdsRemark]) -> bool:
    """Make an object's section readable. False: it is left out."""
    if not section.text("ParameterName"):
        remarks.append(EdsRemark(section.line_of("ParameterName"), f"[{section.name}] has no ParameterName"))
        section.values["ParameterName"] = (f"object 0x{section.name}", section.line)
    for key in ("ObjectType", "SubNumber", "CompactSubObj", "PDOMapping", "DataType"):
        _repair_number(section, key, remarks)
    if number(section.text("CompactSubObj") or "0") == 0:
        section.values.pop("CompactSubObj", None)
    kind = number(section.text("ObjectType") or str(VARIABLE))
    if kind in (ARRAY, RECORD) and not section.text("CompactSubObj") and not _SUB.match(section.name):
        return True
    if not section.text("DataType"):
        remarks.append(EdsRemark(section.line_of("DataType"), f"[{section.name}] has no DataType; left out"))
        return False
    _repair_access(section, remarks)
    data_type = number(section.text("DataType")) or 0
    if data_type > HIGHEST_TYPE:
        remarks.append(
            EdsRemark(section.line_of("DataType"), f"[{section.name}] has the unknown DataType 0x{data_type:04X}")
        )
        section.values["DataType"] = (str(DOMAIN), section.line_of("DataType"))
    for key in ("DefaultValue", "ParameterValue", "LowLimit", "HighLimit"):
        _repair_value(section, key, data_type, remarks)
    return True


def _repair_number(section: EdsSection, key: str, remarks: list[EdsRemark]) -> None:
    if key not in section.values:
        return
    text, line = section.values[key]
    value = number(text)
    if value is None:
        section.values[key] = ("", line)
        if key != "DataType":
            del section.values[key]
        if text or key == "PDOMapping":
            remarks.append(EdsRemark(line, f"{key} of [{section.name}] {_no_number(text)}"))
    elif not _plain(text):
        section.values[key] = (str(value), line)
        remarks.append(EdsRemark(line, f"{key}={text} of [{section.name}] is read as {value}"))


def _repair_access(section: EdsSection, remarks: list[EdsRemark]) -> None:
    text, line = section.text("AccessType"), section.line_of("AccessType")
    access = text.lower()
    if access not in ACCESSES:
        access = ACCESS_WORDS.get(access, "rw")
        remarks.append(
            EdsRemark(line, f"AccessType of [{section.name}] is {repr(text) if text else 'empty'}; read as {access}")
        )
    section.values["AccessType"] = (access, line)


def _repair_value(section: EdsSection, key: str, data_type: int, remarks: list[EdsRemark]) -> None:
    """A default or limit: left out where it does not fit its type; empty where there is none."""
    if key not in section.values:
        return
    text, line = section.values[key]
    bits = SIGNED_BITS.get(data_type) or UNSIGNED_BITS.get(data_type)
    if not text:
        del section.values[key]
        return
    if bits is None:
        return
    relative = bool(_NODE_ID.search(text))
    rest = _NODE_ID.sub("", text).replace(" ", "").strip("+") if relative else text
    value = number(rest) if rest else 0
    if value is not None and data_type in SIGNED_BITS and 1 << bits - 1 <= value < 1 << bits:
        value -= 1 << bits  # in hexadecimal
    elif value is not None and data_type in UNSIGNED_BITS and -(1 << bits - 1) <= value < 0:
        value += 1 << bits
        remarks.append(
            EdsRemark(line, f"{key}={text} of [{section.name}] is negative in an unsigned type; read as {value}")
        )
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if data_type in SIGNED_BITS else (0, (1 << bits) - 1)
    if value is None or not low <= value <= high:
        del section.values[key]
        why = "is no number" if value is None else f"does not fit {bits} bits"
        remarks.append(EdsRemark(line, f"{key}={text} of [{section.name}] {why}; left out"))
        return
    if relative and "$" not in text:
        remarks.append(EdsRemark(line, f"{key}={text} of [{section.name}] is read as $NODEID+{value}"))
    elif not relative and not _plain(text):
        remarks.append(EdsRemark(line, f"{key}={text} of [{section.name}] is read as {value}"))
    section.values[key] = (f"$NODEID+{value}" if relative else str(value), line)


def _plain(text: str) -> bool:
    """A number in the notation of CiA 306; with leading zeros (octal there, decimal to most authors) it is not."""
    return bool(re.fullmatch(r"[+-]?(0[xX][0-9a-fA-F]+|0|[1-9][0-9]*)", text))


def _no_number(text: str) -> str:
    return f"is {text!r}, which is no number" if text else "is empty"
