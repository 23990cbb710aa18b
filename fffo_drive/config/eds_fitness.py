"""What we can and cannot do with a drive, as far as its EDS says: modes, objects, PDO mappings, scales.

Nothing here asks the drive. What the file leaves open stays open; bring-up checks it on the drive itself, against the
same needs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import yaml

from ..drive.canopen.config import CanopenDriveConfig
from ..drive.canopen.eds import Eds, default_of, missing_in_pdo, supported_modes
from ..drive.canopen.needs import MODE_NAMES, VENDOR_MODES, FileObjects, check_device_type, check_modes, needs
from ..drive.canopen.object_map import EVERY_SYNC, ON_EVENT, PdoMap
from ..drive.canopen.reported_units import highest_rate_hz
from .drive_proposal import DriveProposal, config_of, propose

# objects that we use where a drive has them, and what for
WELCOME = {
    (0x1006, 0): "the drive knows the SYNC period",
    (0x1400, 5): "the drive detects missing commands",
    (0x605A, 0): "how a quick stop brakes",
    (0x605E, 0): "how the drive reacts to a fault",
    (0x6072, 0): "a torque limit in the drive",
    (0x6075, 0): "the rated current is compared",
    (0x6076, 0): "the rated torque is compared",
    (0x6080, 0): "a speed limit in the drive",
    (0x60C2, 1): "the drive knows the control period",
}
WRITABLE = ("rw", "rww", "rwr", "wo")
MOST_SLOTS = 64  # PDOs that are looked at
# keys that every axis needs, and where their values are found
TO_FILL_IN = {
    "counts_per_rev": "increments of 0x6064 per revolution (quadrature: four times the lines): see the drive's manual",
    "velocity_units_per_rps": "0x606C at one revolution per second: see the drive's manual",
    "rated_torque_nm": "0x6076, from the motor's data sheet",
}


class PdoFitness(NamedTuple):
    """One PDO that we want."""

    name: str  # RPDO1
    purpose: str
    objects: str
    problems: tuple[str, ...]


class Fitness(NamedTuple):
    """The whole answer. The drive can be used as far as the file says when `refusals` is empty."""

    modes: int | None
    mode: int  # that we would use
    refusals: tuple[str, ...]
    welcome_missing: tuple[str, ...]
    pdos: tuple[PdoFitness, ...]
    proposal: DriveProposal
    section: dict[str, Any]  # keys of an axis file's drive section: the profile's, then what the file tells
    unknown: tuple[str, ...]  # needed keys that it does not
    highest_rate_hz: int | None


def fitness_of(eds: Eds, node_id: int, base: Mapping[str, Any] | None = None) -> Fitness:
    """What the service could do with this drive under this node-ID. `base`: the drive section from its profile."""
    dictionary = eds.dictionary
    objects = FileObjects(dictionary)
    proposal = propose(objects, base)
    section = {**(base or {}), **proposal.section}
    config = config_of(section, node_id)
    usual = [(0x1400, config.command), *((0x1800, pdo) for pdo in config.answers)]
    if "pdo" not in section and any(list(_pdo_problems(dictionary, kind + p.number - 1, p)) for kind, p in usual):
        slots = _fitting_slots(dictionary, config)
        if slots is not None:
            proposal = proposal.with_key("pdo", slots, "numbers of PDOs that allow the mapping")
            section["pdo"] = slots
            config = config_of(section, node_id)
    purposes = [
        "motion with each SYNC",
        f"status and torque with every {config.status_every}th SYNC",
        "status on change",
    ]
    wanted = [("RPDO", 0x1400, config.command, "command with each SYNC")]
    wanted += [("TPDO", 0x1800, pdo, purpose) for pdo, purpose in zip(config.answers, purposes, strict=False)]
    pdos = tuple(
        PdoFitness(
            f"{kind}{pdo.number}",
            purpose,
            ", ".join(f"0x{item.index:04X}" for item in pdo.objects),
            tuple(_pdo_problems(dictionary, first + pdo.number - 1, pdo)),
        )
        for kind, first, pdo, purpose in wanted
    )
    modes = supported_modes(dictionary)
    refusals = check_device_type(objects, config) if objects.value(0x1000) is not None else []
    if not refusals and modes:
        refusals += check_modes(objects, config)
    if not refusals:  # of what is no drive, or has no torque mode, nothing more is asked
        refusals += needs(objects, config)
        refusals += [f"{pdo.name}: {problem}" for pdo in pdos for problem in pdo.problems]
    exponent = dictionary.get_variable(0x60C2, 2)
    declared_hz = None if exponent is None else highest_rate_hz(_lowest(exponent))
    return Fitness(
        modes=modes,
        mode=config.mode,
        refusals=tuple(dict.fromkeys(refusals)),
        welcome_missing=tuple(_welcome_missing(dictionary)),
        pdos=pdos,
        proposal=proposal,
        section=section,
        unknown=tuple(key for key in TO_FILL_IN if key not in section),
        highest_rate_hz=section.get("highest_rate_hz") or declared_hz,
    )


def _lowest(variable: Any) -> int | None:
    """The lowest value that a file lets us write; None where it does not say."""
    lowest: int | None = variable.default if variable.access_type not in WRITABLE else variable.min
    return lowest


def mode_names(modes: int) -> list[str]:
    """Names of the bits of 0x6502."""
    names = [MODE_NAMES.get(bit + 1, f"mode {bit + 1}") for bit in range(VENDOR_MODES) if modes >> bit & 1]
    return names + ["manufacturer's modes"] * bool(modes >> VENDOR_MODES)


def snippet(eds: Eds, node_id: int, fitness: Fitness, profile: str | None = None) -> str:
    """The drive section of an axis file, as far as the EDS fills it; keys from its profile need not stand in it."""
    lines = [
        "drive:", "  kind: canopen", "  bus: socketcan:can0", f"  node_id: {node_id}", f"  eds: {eds.path}"
    ]  # fmt: skip
    if profile is not None:
        lines.append(f"  profile: {profile}")
    lines += section_lines(fitness.proposal)
    lines += [f"  {key}:   # to fill in: {TO_FILL_IN[key]}" for key in fitness.unknown]
    return "\n".join(lines)


def _yaml_text(value: Any) -> str:
    """A value as it stands behind a key, in one line."""
    if isinstance(value, float):
        return format(value, ".10g")
    return (
        yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=math.inf).removesuffix("\n...\n").strip()
    )


def section_lines(proposal: DriveProposal) -> list[str]:
    """Keys and values as YAML, each with where it comes from."""
    return [
        f"  {key}: {_yaml_text(value)}   # {proposal.sources.get(key, 'from its profile')}"
        for key, value in proposal.section.items()
    ]


def _welcome_missing(dictionary: Any) -> Iterator[str]:
    for (index, sub), purpose in WELCOME.items():
        if dictionary.get_variable(index, sub) is None:
            yield f"0x{index:04X}:{sub:02X}: {purpose}"


def _pdo_problems(dictionary: Any, index: int, pdo: PdoMap) -> Iterator[str]:
    """What keeps a PDO from carrying what we want: objects, a mapping that is fixed, a type that it lacks."""
    problems = list(missing_in_pdo(dictionary, pdo))
    yield from problems
    if index not in dictionary:
        return
    count = dictionary.get_variable(index + 0x200, 0)
    entries = [dictionary.get_variable(index + 0x200, sub) for sub in range(1, len(pdo.objects) + 1)]
    if count is None or any(entry is None for entry in entries):
        yield f"its mapping 0x{index + 0x200:04X} has too few entries for {len(pdo.objects)} objects"
    elif count.access_type not in WRITABLE and count.default == len(pdo.objects) and _writable(entries):
        pass  # only what is mapped can be chosen, and that suffices
    elif not _writable((count, *entries)):
        fixed = [default_of(dictionary, index + 0x200, sub) for sub in range(1, (count.default or 0) + 1)]
        if fixed != [item.word for item in pdo.objects]:
            shown = ", ".join(f"0x{word:08X}" for word in fixed if word is not None) or "nothing"
            yield f"its mapping is fixed to {shown}"
    if pdo.inhibit_ns and dictionary.get_variable(index, 3) is None:
        yield f"it has no inhibit time 0x{index:04X}:03 that keeps events apart"
    yield from _type_problems(dictionary, index, pdo)


def _writable(variables: Iterable[Any]) -> bool:
    return all(variable.access_type in WRITABLE for variable in variables)


def _fitting_slots(dictionary: Any, config: CanopenDriveConfig) -> dict[str, int | None] | None:
    """Numbers of PDOs that can carry what we want, where the usual ones cannot; None where there are none."""

    def first(kind: int, pdo: PdoMap, taken: Iterable[int | None] = ()) -> int | None:
        numbers = [n for n in range(1, MOST_SLOTS + 1) if kind + n - 1 in dictionary and n not in taken]
        return next((n for n in numbers if not list(_pdo_problems(dictionary, kind + n - 1, pdo))), None)

    motion, status, *event = config.answers
    found: dict[str, int | None] = {"command": first(0x1400, config.command), "motion": first(0x1800, motion)}
    found["status"] = first(0x1800, status, (found["motion"],))
    if None in found.values():
        return None
    found["event"] = first(0x1800, event[0], found.values()) if event else None
    return found


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
