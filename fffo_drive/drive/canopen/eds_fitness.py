"""What we can and cannot do with a drive, as far as its EDS says: modes, objects, PDO mappings, scales.

Nothing here asks the drive. What the file leaves open stays open; bring-up checks it on the drive itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from ..cia402 import SUPPORTS_CYCLIC_SYNCHRONOUS_TORQUE
from .eds import Eds, default_of, missing_in_pdo, missing_objects, supported_modes
from .object_map import EVERY_SYNC, ON_EVENT, PdoMap, command_pdo, feedback_pdos

MODE_NAMES = {
    1: "profile position", 2: "velocity (vl)", 3: "profile velocity", 4: "profile torque", 6: "homing",
    7: "interpolated position", 8: "cyclic synchronous position", 9: "cyclic synchronous velocity",
    10: "cyclic synchronous torque",
}  # fmt: skip
# objects that we use where a drive has them, and what for
WELCOME = {
    (0x1006, 0): "the drive knows the SYNC period",
    (0x1400, 5): "the drive notices that commands stay away",
    (0x605A, 0): "how a quick stop brakes",
    (0x605E, 0): "how the drive reacts to a fault",
    (0x6072, 0): "a torque limit in the drive",
    (0x6075, 0): "the rated current is compared",
    (0x6076, 0): "the rated torque is compared",
    (0x6080, 0): "a speed limit in the drive",
    (0x60C2, 1): "the drive knows the control period",
}
WRITABLE = ("rw", "rww", "rwr", "wo")
DRIVE_PROFILE = 402  # low word of 0x1000; the type word is often 0 or the vendor's own
REVOLUTIONS, INCREMENTS, PER_SECOND, PER_MINUTE = 0xB4, 0xB5, 0x03, 0x47  # notations of CiA 303-2
_STATUS_EVERY = 10


class PdoFitness(NamedTuple):
    """One PDO that we want."""

    name: str  # RPDO1
    purpose: str
    objects: str
    problems: tuple[str, ...]


class Fitness(NamedTuple):
    """The whole answer. The drive can be used as far as the file says when `refusals` is empty."""

    modes: int | None
    refusals: tuple[str, ...]
    welcome_missing: tuple[str, ...]
    pdos: tuple[PdoFitness, ...]
    facts: dict[str, float | int]  # keys of an axis file's drive section that the file tells
    unknown: tuple[str, ...]  # keys that it does not


def fitness_of(eds: Eds, node_id: int) -> Fitness:
    """What the service could do with this drive under this node-ID."""
    dictionary = eds.dictionary
    motion, status, event = feedback_pdos(node_id, _STATUS_EVERY)
    wanted = [
        ("RPDO", 0x1400, command_pdo(node_id), "command with each SYNC"),
        ("TPDO", 0x1800, motion, "motion with each SYNC"),
        ("TPDO", 0x1800, status, f"status and torque with every {_STATUS_EVERY}th SYNC"),
        ("TPDO", 0x1800, event, "status on change"),
    ]
    pdos = tuple(
        PdoFitness(
            f"{kind}{pdo.number}",
            purpose,
            ", ".join(f"0x{item.index:04X}" for item in pdo.objects),
            tuple(_pdo_problems(dictionary, first + pdo.number - 1, pdo)),
        )
        for kind, first, pdo, purpose in wanted
    )
    device_type = default_of(dictionary, 0x1000)
    refusals = []
    if device_type is not None and device_type & 0xFFFF != DRIVE_PROFILE:
        refusals.append(f"0x1000 is 0x{device_type:08X}: no CiA 402 drive (0x0192 in the low word)")
    refusals += missing_objects(dictionary)
    refusals += [f"{pdo.name}: {problem}" for pdo in pdos for problem in pdo.problems]
    facts = _facts(dictionary)
    return Fitness(
        modes=supported_modes(dictionary),
        refusals=tuple(refusals),
        welcome_missing=tuple(_welcome_missing(dictionary)),
        pdos=pdos,
        facts=facts,
        unknown=tuple(k for k in ("counts_per_rev", "velocity_units_per_rps", "rated_torque_nm") if k not in facts),
    )


def mode_names(modes: int) -> list[str]:
    """Names of the bits of 0x6502."""
    names = [MODE_NAMES.get(bit + 1, f"mode {bit + 1}") for bit in range(16) if modes >> bit & 1]
    return names + ["manufacturer's modes"] * bool(modes >> 16)


def has_cyclic_torque(fitness: Fitness) -> bool | None:
    """True, False, or None where the file leaves it open."""
    return None if fitness.modes is None else bool(fitness.modes & SUPPORTS_CYCLIC_SYNCHRONOUS_TORQUE)


def snippet(eds: Eds, node_id: int, fitness: Fitness) -> str:
    """The drive section of an axis file, as far as the EDS fills it."""
    known = fitness.facts
    comments = {
        "counts_per_rev": "increments of 0x6064 in a revolution (quadrature: four times the lines): see the manual",
        "velocity_units_per_rps": "0x606C at one revolution a second: see the manual",
        "rated_torque_nm": "0x6076, from the motor's data sheet",
    }
    lines = [
        "drive:", "  kind: canopen", "  bus: socketcan:can0", f"  node_id: {node_id}", f"  eds: {eds.path}"
    ]  # fmt: skip
    for key in ("counts_per_rev", "velocity_units_per_rps", "rated_torque_nm", "rated_current_a"):
        if key in known:
            lines.append(f"  {key}: {known[key]:g}")
        elif key in comments:
            lines.append(f"  {key}:   # to fill in: {comments[key]}")
    if default_of(eds.dictionary, 0x1400, 5) is None:
        lines.append("  command_timeout_ms: 0   # the drive has no RPDO deadline (0x1400:05)")
    return "\n".join(lines)


def _welcome_missing(dictionary: Any) -> Iterator[str]:
    for (index, sub), purpose in WELCOME.items():
        if dictionary.get_variable(index, sub) is None:
            yield f"0x{index:04X}:{sub:02X}: {purpose}"


def _pdo_problems(dictionary: Any, index: int, pdo: PdoMap) -> Iterator[str]:
    """What keeps a PDO from carrying what we want: objects, a mapping that is fixed, a type that it lacks."""
    problems = list(missing_in_pdo(dictionary, index, pdo))
    yield from problems
    if index not in dictionary:
        return
    count = dictionary.get_variable(index + 0x200, 0)
    entries = [dictionary.get_variable(index + 0x200, sub) for sub in range(1, len(pdo.objects) + 1)]
    if count is None or any(entry is None for entry in entries):
        yield f"its mapping 0x{index + 0x200:04X} has too few entries for {len(pdo.objects)} objects"
    elif any(entry.access_type not in WRITABLE for entry in (count, *entries)):
        fixed = [default_of(dictionary, index + 0x200, sub) for sub in range(1, (count.default or 0) + 1)]
        if fixed != [item.word for item in pdo.objects]:
            shown = ", ".join(f"0x{word:08X}" for word in fixed if word is not None) or "nothing"
            yield f"its mapping is fixed to {shown}"
    if pdo.inhibit_ns and dictionary.get_variable(index, 3) is None:
        yield f"it has no inhibit time 0x{index:04X}:03 that keeps events apart"
    yield from _type_problems(dictionary, index, pdo)


def _type_problems(dictionary: Any, index: int, pdo: PdoMap) -> Iterator[str]:
    kind = dictionary.get_variable(index, 2)
    if kind is None:
        yield f"it has no transmission type 0x{index:04X}:02"
        return
    fixed = kind.access_type not in WRITABLE
    within = (kind.min is None or kind.min <= pdo.transmission) and (kind.max is None or pdo.transmission <= kind.max)
    if (fixed and kind.default != pdo.transmission) or not within:
        allowed = kind.default if fixed else f"{kind.min} to {kind.max}"
        name = {EVERY_SYNC: "each SYNC", ON_EVENT: "events"}.get(pdo.transmission, "SYNC")
        yield f"its transmission type is {allowed}, {pdo.transmission} ({name}) is needed"


def _facts(dictionary: Any) -> dict[str, float | int]:
    """What stands in defaults; a default of 0 says that the file leaves it to the drive."""
    found: dict[str, float | int] = {}
    if torque := default_of(dictionary, 0x6076):
        found["rated_torque_nm"] = torque / 1000.0
    if current := default_of(dictionary, 0x6075):
        found["rated_current_a"] = current / 1000.0
    for index, key in ((0x608F, "counts_per_rev"), (0x6090, "velocity_units_per_rps")):
        increments, revolutions = default_of(dictionary, index, 1), default_of(dictionary, index, 2)
        if increments and revolutions and increments % revolutions == 0 and increments > revolutions:
            found[key] = increments // revolutions  # 1 to 1 is a placeholder: no encoder has one count
    unit = default_of(dictionary, 0x60A9)
    if unit and (units := velocity_units_per_rps(unit, found.get("counts_per_rev"))):
        found["velocity_units_per_rps"] = units
    return found


def velocity_units_per_rps(unit: int, counts_per_rev: float | None) -> float | None:
    """0x606C for one rev/s, by an SI unit of velocity (0x60A9; CiA 303-2): rev or increments, a second or a minute.

    None for another unit, or for increments where nobody says how many make a revolution.
    """
    prefix, numerator, denominator = unit >> 24 & 0xFF, unit >> 16 & 0xFF, unit >> 8 & 0xFF
    exponent = prefix - 256 if prefix > 127 else prefix
    seconds = {PER_SECOND: 1.0, PER_MINUTE: 60.0}.get(denominator)
    turns = {REVOLUTIONS: 1.0, INCREMENTS: counts_per_rev}.get(numerator)
    if seconds is None or turns is None:
        return None
    return turns * seconds / 10.0**exponent
