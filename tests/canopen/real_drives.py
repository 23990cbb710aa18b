"""The object dictionaries of ten real drives (shared/data/drives): as a scripted node, and as an EDS."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml
from scripted_node import READ_ONLY, ScriptedNode

DRIVES = ("e35", "elmo_gold", "epos2", "epos4", "foc_mc", "ipos", "nanotec_cl4e", "prbt", "roboteq", "schunk")
SIZES = {2: 1, 3: 2, 4: 4, 5: 1, 6: 2, 7: 4}  # bytes by data type (CiA 301)
BIT_RATES = (10, 20, 50, 125, 250, 500, 800, 1000)  # kbit/s, of CiA 301
WRITABLE = ("rw", "rww", "rwr", "wo")

Objects = dict[tuple[int, int], dict[str, str]]


def described(path: Path) -> Objects:
    """(index, sub-index) -> type, access, pdo, default, low, high, value, as the file has them."""
    objects = yaml.safe_load(path.read_text())["objects"]
    return {(int(key[2:6], 16), int(key[7:], 16)): row for key, row in objects.items()}


def number_of(text: str, node_id: int) -> int:
    """A number as an EDS has it, with $NODEID in all the ways in which vendors write it."""
    parts = [part.strip() for part in text.split("+")]
    return sum(node_id if re.fullmatch(r"\$\w*NODE\w*", part, re.IGNORECASE) else int(part, 0) for part in parts)


def bytes_of(objects: Objects, node_id: int) -> dict[tuple[int, int], bytes]:
    """What the drive holds after power-on. What a file leaves open is 0."""
    found = {}
    for place, row in objects.items():
        size = SIZES[int(row["type"], 0)]
        value = number_of(row.get("value", row.get("default", "0")) or "0", node_id)
        found[place] = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
    return found


def eds_of(path: Path) -> str:
    """The file as an EDS (CiA 306), with every number as the vendor wrote it."""
    objects, file = described(path), yaml.safe_load(path.read_text())
    lines = ["[DeviceInfo]", "VendorName=", f"ProductName={file['drive']}"]
    lines += [f"BaudRate_{rate}={int(str(rate) in file['bit_rates'])}" for rate in BIT_RATES]
    return "\n".join([*lines, *_identity(objects), *sections_of(objects)]) + "\n"


def _identity(objects: Objects) -> list[str]:
    lines = []
    for key, sub in (("VendorNumber", 1), ("ProductNumber", 2)):
        if value := objects.get((0x1018, sub), {}).get("default"):
            lines.append(f"{key}={value}")
    return lines


def sections_of(objects: Objects) -> list[str]:
    """The objects as sections of an EDS."""
    lines: list[str] = []
    for index in sorted({index for index, _ in objects}):
        subs = sorted(sub for found, sub in objects if found == index)
        if subs == [0]:
            lines += _entry(f"{index:X}", objects[index, 0])
            continue
        lines += ["", f"[{index:X}]", "ParameterName=x", "ObjectType=0x9", f"SubNumber={len(subs)}"]
        for sub in subs:
            lines += _entry(f"{index:X}sub{sub:X}", objects[index, sub])
    return lines


def _entry(section: str, row: dict[str, str]) -> list[str]:
    lines = ["", f"[{section}]", "ParameterName=x", "ObjectType=0x7", f"DataType={row['type']}"]
    lines += [f"AccessType={row['access']}", f"PDOMapping={row.get('pdo', '0')}"]
    keys = {"default": "DefaultValue", "low": "LowLimit", "high": "HighLimit", "value": "ParameterValue"}
    return lines + [f"{name}={row[key]}" for key, name in keys.items() if row.get(key)]


class RealDrive(ScriptedNode):
    """A node with the objects, access rights and limits of a real drive; guarded where it has no heartbeat."""

    def __init__(self, bus: str, node_id: int, objects: Objects, **keys: Any) -> None:
        super().__init__(bus, node_id, bytes_of(objects, node_id), **keys)
        self.rows = objects

    def keeps_count(self, index: int) -> bool:
        """Whether the number of entries of a mapping cannot be written."""
        return self.rows[index, 0]["access"] not in WRITABLE

    def check(self, index: int, sub: int, value: bytes) -> int:
        """Abort code of a write; 0 for one that is taken."""
        row = self.rows.get((index, sub))
        if row is not None and row["access"] not in WRITABLE:
            return READ_ONLY
        return 0

    def take(self, frame: Any) -> None:
        if frame.remote and frame.can_id == 0x700 + self.node_id:
            self.send(0x700 + self.node_id, b"\x05" if 0x01 in self.commands else b"\x7f")
