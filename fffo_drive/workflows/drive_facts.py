"""What is known of a drive before it moves: from its objects, the profile of its family, and the user.

Each value has its source. The units that the drive reports take precedence over its profile, which has the factory
settings of the family; the user's answers take precedence over both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ..config.drive_profile import DriveProfile, profile_for, profile_path, read_profile
from ..config.drive_proposal import DriveProposal, open_units, propose
from ..config.drive_section import RATED_TORQUE_UNITS, merged
from ..drive.canopen.needs import Need, needs
from ..drive.canopen.object_map import MappingError
from ..drive.canopen.reported_units import counts_increments, reported_units
from ..drive.canopen.sdo_objects import SdoObjects
from ..drive.canopen.silence import DETECTIONS, HEARTBEAT, REACTIONS

MILLI = 1e-3
SAME = 0.01  # ratings that agree
ASSUMED = "assumed: "


class Answers(NamedTuple):
    """The user's values, which no drive reports; None: not given."""

    torque_constant_nm_per_a: float | None = None
    counts_per_rev: int | None = None
    velocity_units_per_rps: float | None = None
    rated_torque_nm: float | None = None
    rated_current_a: float | None = None
    target_units_per_a: float | None = None
    feedback_units_per_a: float | None = None
    inertia_kg_m2: float | None = None
    inertia_range_kg_m2: tuple[float, float] | None = None  # with all loads


OPTIONS = {  # field of `Answers` -> (option, what is asked)
    "counts_per_rev": ("--counts", "counts of 0x6064 per revolution (encoder: four times its lines)"),
    "velocity_units_per_rps": ("--velocity-units", "0x606C at one revolution per second"),
    "rated_torque_nm": ("--rated-torque", "rated torque of the motor in Nm"),
    "torque_constant_nm_per_a": ("--torque-constant", "torque constant of the motor in Nm/A"),
    "target_units_per_a": ("--target-units", "units per ampere of the vendor's torque command object"),
    "feedback_units_per_a": ("--feedback-units", "units per ampere of the vendor's torque feedback object"),
    "rated_current_a": ("--rated-current", "rated current of the motor in A"),
}
OWN_OBJECTS = {  # field of `Answers` -> key whose object may be the vendor's
    "target_units_per_a": "target",
    "feedback_units_per_a": "torque_feedback",
}
MOTOR = ("rated_torque_nm", "torque_constant_nm_per_a", "rated_current_a")  # one follows from the others; best first
OF_SECTION = ("counts_per_rev", "velocity_units_per_rps", "rated_torque_nm", "rated_current_a")


class Fact(NamedTuple):
    """One value and where it came from."""

    value: Any
    source: str

    @property
    def assumed(self) -> bool:
        """Neither read nor given."""
        return self.source.startswith(ASSUMED)


class SourcedFacts(NamedTuple):
    """Everything."""

    scales: dict[str, Fact]  # by the names of `Answers`
    section: dict[str, Fact]  # keys of the drive section that are not the profile's
    profile: str | None  # its name
    family: str
    profile_keys: dict[str, Any]
    profile_remarks: tuple[str, ...]  # of its author; first, what was tried
    stand_ins: tuple[str, ...]  # replacements for what the drive lacks
    remarks: tuple[str, ...]  # about units, and axes beside the one that is used
    needs: tuple[Need, ...]  # requirements that the drive does not meet
    writes: dict[str, int]  # 0x6076:00 -> number that the axis file writes
    silence: str  # how the drive notices a silent PC, and how it then stops
    torque_limit_set: bool  # the profile writes 0x6072

    @property
    def unusable(self) -> bool:
        """Whether there is one that no key of the axis file works around."""
        return any(not need.keys for need in self.needs)

    @property
    def written(self) -> tuple[str, ...]:
        """Objects that the bring-up writes; their present values do not matter."""
        return (*self.writes, *(["0x6072:00"] if self.torque_limit_set else []))

    @property
    def missing(self) -> list[str]:
        """Unknown values that are required, in the order of the questions. Of the motor two of three are enough."""
        own = _own_units(_values(self.profile_keys, self.section))
        asked = [name for name in OPTIONS if name not in OWN_OBJECTS or name in own]
        found = [name for name in asked if name not in self.scales]
        of_motor = [name for name in MOTOR if name in found]
        enough = of_motor[max(0, len(of_motor) - 1) :]  # the last of them follows from the others
        return [name for name in found if name not in enough]


def drive_facts(
    objects: SdoObjects, answers: Answers, node_id: int, vendor_id: int = 0, product_code: int = 0,
    profile: str | None = None,
) -> SourcedFacts:  # fmt: skip
    """Read what is needed from the drive, and put together what is known.

    `profile`: of its family, in place of the one that vendor and product name. Raises BusUnavailableError,
    DocumentError for a profile that there is not.
    """
    known = profile_for(vendor_id, product_code) if profile is None else named_profile(profile)
    base = dict(known[1].keys) if known else {}
    section = {
        key: Fact(value, f"given ({OPTIONS[key][0]})")
        for key, value in answers._asdict().items()
        if key in OF_SECTION and value is not None
    }
    raw = objects.value(0x6076)
    unit = _torque_unit(raw, answers.rated_torque_nm, base.get("rated_torque_unit", "mNm"))
    if unit != base.get("rated_torque_unit", "mNm"):
        section["rated_torque_unit"] = Fact(unit, "0x6076 then has the value given")
    if raw:
        section.setdefault("rated_torque_nm", Fact(raw * RATED_TORQUE_UNITS[unit], f"read: 0x6076 in {unit}"))
    reported = reported_units(objects)
    for key, index in (("counts_per_rev", 0x60A8), ("velocity_units_per_rps", 0x60A9)):
        if key in reported and key in base and objects.value(index) and reported[key] != base[key]:
            section.setdefault(key, Fact(reported[key], f"read: 0x{index:04X}; the profile has {base[key]:g}"))
    proposal = _proposal(objects, _values(base, section), node_id)
    for key, value in proposal.section.items():
        section[key] = Fact(value, f"read: {_source(objects, key) or proposal.sources.get(key, '')}")
    own = _own_units(_values(base, section))
    for name in own:
        if (units := getattr(answers, name)) is not None:
            key = OWN_OBJECTS[name]
            value = {**(section[key].value if key in section else {}), "units_per_a": units}
            section[key] = Fact(value, f"given ({OPTIONS[name][0]})")
    section = {key: section[key] for key in (*OF_SECTION, *section) if key in section}
    scales = _scales(section, base, known[0] if known else "", answers, own)
    if "rated_torque_nm" in scales:
        section.setdefault("rated_torque_nm", scales["rated_torque_nm"])
    return SourcedFacts(
        scales, section, known[0] if known else None, known[1].family if known else "", base,
        tuple(known[1].notes) if known else (), proposal.stand_ins, proposal.remarks,
        proposal.needs,
        _writes(objects, section, unit), _silence(_values(base, section)), "max_torque_permille" in base,
    )  # fmt: skip


def _proposal(objects: SdoObjects, section: Mapping[str, Any], node_id: int) -> DriveProposal:
    """What the drive's objects propose beside a section, by the list of needs that `drive-info` applies to a file."""
    try:
        return propose(objects, node_id, lambda config: needs(objects, config), section)
    except MappingError as error:
        return DriveProposal({}, {}, (), (Need(str(error)),), ())


def _values(keys: Mapping[str, Any], section: Mapping[str, Fact]) -> dict[str, Any]:
    """The drive section over the keys of its profile."""
    return merged(keys, {key: fact.value for key, fact in section.items()})


def _own_units(keys: Mapping[str, Any]) -> list[str]:
    """Questions for a profile that names a vendor's object without its units."""
    return [name for name, key in OWN_OBJECTS.items() if key in open_units(keys)]


def _source(objects: SdoObjects, key: str) -> str:
    """The object in which the drive reports a scale; empty for other keys."""
    if key == "counts_per_rev":
        unit = objects.value(0x60A8)
        return "0x608F" if counts_increments(unit) else f"0x60A8 is 0x{unit:08X}"
    if key == "velocity_units_per_rps":
        return f"0x60A9 is 0x{objects.value(0x60A9):08X}" if objects.value(0x60A9) else "0x6090"
    return {"rated_torque_nm": "0x6076", "rated_current_a": "0x6075"}.get(key, "")


def named_profile(name: str) -> tuple[str, DriveProfile]:
    """A profile by its name. Raises DocumentError naming those that there are."""
    return name, read_profile(profile_path(Path("--profile"), name))


def _torque_unit(raw: int | None, given_nm: float | None, expected: str) -> str:
    """Unit of 0x6076: the one in which it agrees with the given rated torque, else that of the family."""
    if not raw or given_nm is None:
        return expected
    fitting = [name for name, one in RATED_TORQUE_UNITS.items() if abs(raw * one - given_nm) <= SAME * given_nm]
    return fitting[0] if fitting else expected


def _scales(
    section: Mapping[str, Fact], base: Mapping[str, Any], profile: str, answers: Answers, own: Iterable[str]
) -> dict[str, Fact]:
    found = {key: section[key] for key in OF_SECTION if key in section}
    for key in OF_SECTION:
        if key in base:
            found.setdefault(key, Fact(base[key], f"profile {profile}"))
    for key in ("torque_constant_nm_per_a", *own):
        if (value := getattr(answers, key)) is not None:
            found[key] = Fact(value, f"given ({OPTIONS[key][0]})")
    if answers.inertia_kg_m2 is not None:
        found["inertia_kg_m2"] = Fact(answers.inertia_kg_m2, "given (--inertia)")
    if answers.inertia_range_kg_m2 is not None:
        found["inertia_range_kg_m2"] = Fact(list(answers.inertia_range_kg_m2), "given (--inertia-range)")
    torque, current, constant = (
        found[name].value if name in found else None
        for name in ("rated_torque_nm", "rated_current_a", "torque_constant_nm_per_a")
    )
    if torque and current:
        source = f"{ASSUMED}rated torque over rated current; see the data sheet"
        found.setdefault("torque_constant_nm_per_a", Fact(_six_digits(torque / current), source))
    elif torque and constant:
        found["rated_current_a"] = Fact(_six_digits(torque / constant), f"{ASSUMED}rated torque over torque constant")
    elif current and constant:
        source = f"{ASSUMED}torque constant times rated current"
        found["rated_torque_nm"] = Fact(_six_digits(current * constant), source)
    return found


def _six_digits(value: float) -> float:
    return float(f"{value:.6g}")


def _silence(section: Mapping[str, Any]) -> str:
    detection = DETECTIONS[section.get("silence_detection", HEARTBEAT)]
    reaction = REACTIONS[section.get("silence_reaction", "abort_connection")]
    return f"{detection.text}; {reaction.text}"


def _writes(objects: SdoObjects, section: Mapping[str, Fact], unit: str) -> dict[str, int]:
    """Ratings that are not configured in the drive and that the user gave."""
    found = {}
    for index, key, one in ((0x6076, "rated_torque_nm", RATED_TORQUE_UNITS[unit]), (0x6075, "rated_current_a", MILLI)):
        if objects.value(index) == 0 and key in section:
            found[f"0x{index:04X}:00"] = round(section[key].value / one)
    return found
