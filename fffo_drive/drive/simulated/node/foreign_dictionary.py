"""The object dictionary of another drive, which the node can have in place of its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ....canopen_node.dictionary import (
    REAL_TYPES,
    SIGNED_TYPES,
    STRUCT_CODES,
    DataType,
    Entry,
    ObjectDictionary,
    Value,
    type_range,
)
from .objects import ABSENT, ENTRIES, OWN_OBJECTS, PDO_OBJECTS
from .personality import Personality, named

if TYPE_CHECKING:
    from .config import NodeConfig

ABORT_CONNECTION = 0x6007
_TARGET_TYPES = {8: DataType.INTEGER8, 16: DataType.INTEGER16, 32: DataType.INTEGER32}
_OWN = {entry.multiplexer: entry for entry in ENTRIES if entry.index not in OWN_OBJECTS}
# what the device writes itself: the size is that of CiA 301 and 402
WRITTEN = (0x1001, 0x603F, 0x6041, 0x6061, 0x6064, 0x606C, 0x6074, 0x6077, 0x6078, 0x6079, 0x60FD)
# communication objects that the services count with
COUNTED = frozenset(
    {0x1001, 0x1003, 0x1005, 0x1006, 0x1007, 0x100C, 0x100D, 0x1010, 0x1011, 0x1014, 0x1015, 0x1016, 0x1017, 0x1019,
     0x1029, 0x1F80, *PDO_OBJECTS}
)  # fmt: skip
_WRITTEN = {index << 8 for index in WRITTEN}
# 0x6502 where the file lacks it: the modes whose target the drive has
_TARGETS = {1: (0x607A,), 3: (0x60FF,), 4: (0x6071,), 6: (0x6098,), 7: (0x60C1,), 10: (0x6071, 0x60C2)}


def _is_count(entry: Entry) -> bool:
    return 0 < entry.size <= 4 and entry.data_type not in SIGNED_TYPES | REAL_TYPES


@dataclass(frozen=True)
class ForeignDictionary:
    """Objects of a drive as its EDS, DCF or list of objects has them."""

    drive: str  # its name
    entries: tuple[Entry, ...]

    def problems(self) -> Iterator[tuple[Entry, str]]:
        """Entries that contradict CiA 301 or 402, with which the node could not work."""
        for entry in self.entries:
            if entry.index in COUNTED and not _is_count(entry):
                yield entry, f"is {entry.data_type.name}; CiA 301 has an unsigned number of at most 32 bits"
                continue
            own = _OWN.get(entry.multiplexer)
            if own is None or not own.size:
                continue
            if not entry.size:
                yield entry, f"is {entry.data_type.name}; CiA 301 and 402 have a number here ({own.data_type.name})"
            elif entry.multiplexer in _WRITTEN and entry.size != own.size:
                yield entry, f"is {entry.data_type.name}; CiA 301 and 402 have {own.data_type.name}"


def entries_of(config: NodeConfig) -> tuple[Entry, ...]:
    """The objects of the drive, its own or those of another one, with the deviations of its personality."""
    return tuple(_characterised(_declared(config), config.personality))


def _declared(config: NodeConfig) -> tuple[Entry, ...]:
    return ENTRIES if config.dictionary is None else config.dictionary.entries


def dictionary_of(config: NodeConfig, node_id: int, defaults: Mapping[int, Value]) -> ObjectDictionary:
    """The object dictionary of the drive. `defaults`: of objects without one."""
    entries = entries_of(config)
    if config.dictionary is None:
        return ObjectDictionary(entries, node_id, defaults)
    loss = config.personality.connection_loss_option
    ours = {ABORT_CONNECTION << 8: loss} | {key: v for key, v in defaults.items() if key >> 8 in OWN_OBJECTS}
    absent = [replace(e, default=ours.get(e.multiplexer, e.default)) for e in ABSENT]
    codes = {key: STRUCT_CODES[_OWN[key].data_type] for key in _WRITTEN}
    return ObjectDictionary(entries, node_id, defaults, absent, OWN_OBJECTS, codes)


def derived_modes(entries: Iterable[Entry], personality: Personality) -> int:
    """0x6502 of a drive whose file lacks it."""
    indices = {entry.index for entry in entries}
    modes = [mode for mode, needed in _TARGETS.items() if indices.issuperset(needed)]
    bits = sum(1 << mode - 1 for mode in modes)
    return bits | 1 << 15 - personality.vendor_mode if -16 <= personality.vendor_mode < 0 else bits


def personality_problems(config: NodeConfig) -> Iterator[tuple[str, str]]:
    """Errors in the objects that the personality names: pairs of key and text."""
    personality = config.personality
    target = personality.vendor_target
    with_target = Personality(vendor_target=target, vendor_target_bits=personality.vendor_target_bits)
    entries = {entry.multiplexer: entry for entry in _characterised(_declared(config), with_target)}
    for name in ("values", "lowest", "highest"):
        numbers: Mapping[str, int] = getattr(personality, name)
        for text, value in numbers.items():
            entry = entries.get(named(text))
            if entry is None or not entry.size:
                yield f"{name}.{text}", "the drive has no such number"
                continue
            low, high = type_range(entry.data_type)
            if not low <= value <= high:
                yield f"{name}.{text}", f"{value} is outside {low} to {high}, the range of {entry.data_type.name}"
            if name == "highest" and value < personality.lowest.get(text, low):
                yield f"{name}.{text}", f"{value} is below the lowest, {personality.lowest[text]}"
    if target and (found := entries.get(named(target))) is not None and not found.size:
        yield "vendor_target", f"{target} is {found.data_type.name}, no number"


def _characterised(entries: tuple[Entry, ...], personality: Personality) -> Iterator[Entry]:
    values = {named(text): value for text, value in personality.values.items()}
    lowest = {named(text): value for text, value in personality.lowest.items()}
    highest = {named(text): value for text, value in personality.highest.items()}
    plain = not (values or lowest or highest)
    target = named(personality.vendor_target) if personality.vendor_target else None
    for entry in entries:
        key = entry.multiplexer
        if key == target:
            target = None
        if plain or not (key in values or key in lowest or key in highest):
            yield entry
            continue
        changed = replace(entry, low=lowest.get(key, entry.low), high=highest.get(key, entry.high))
        if key in values:
            changed = replace(changed, default=values[key], relative=False, value=None)
        yield changed
    if target is not None:
        data_type = _TARGET_TYPES[personality.vendor_target_bits]
        yield Entry(target >> 8, target & 0xFF, "Target of the vendor's torque mode", data_type, "rww", mappable=True)
