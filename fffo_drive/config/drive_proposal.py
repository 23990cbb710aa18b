"""The drive section of an axis file that a drive's own objects, or its file, propose.

What the drive does not meet is replaced by what it has, best first, until no requirement is left that a key could
mend (drive.canopen.needs). A profile of the drive's family stands before what is proposed here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from pydantic import ValidationError

from ..documents import accepts
from ..drive.canopen.config import CanopenDriveConfig
from ..drive.canopen.needs import Need, other_axes, yaml_text
from ..drive.canopen.object_map import MappingError, interpolation_period
from ..drive.canopen.reported_units import reported_units, unit_remarks
from ..drive.canopen.silence import DriveObjects
from ..drive.cia402 import MODE_PROFILE_TORQUE
from ..units import NS_PER_S
from .drive_section import RATED_CURRENT_UNITS, RATED_TORQUE_UNITS, CanopenDriveSection, merged

FULL_TORQUE_IN_A_MILLISECOND = 1_000_000  # 0x6087, per mille a second: profile torque that acts like a cyclic one
USUAL_RATES_HZ = (2000, 1000, 500, 250, 200, 125, 100)  # of the loop; the first is the default
MOST_ROUNDS = 10  # of keys: one may ask for another
SNIPPET_BUS = "socketcan:can0"
# where only objects are asked for
PLACEHOLDER_NM_PER_A = 1.0
PLACEHOLDERS = {"kind": "canopen", "bus": SNIPPET_BUS, "node_id": 1, "rated_torque_nm": 1.0}
PLACEHOLDER_UNITS_PER_A = 1.0
SCALED = ("target", "torque_feedback")  # objects of torque, which may be the vendor's with units of their own


class DriveProposal(NamedTuple):
    """What a drive section should say."""

    section: dict[str, Any]  # keys that differ from the defaults and the profile, as an axis file has them
    sources: dict[str, str]  # key -> where it comes from, or why it stands there
    mended: tuple[Need, ...]  # requirements that the drive does not meet without these keys
    needs: tuple[Need, ...]  # what no key mends, or what a person must decide
    remarks: tuple[str, ...]  # about units, and axes beside the one that is used

    @property
    def stand_ins(self) -> tuple[str, ...]:
        """What takes the place of something that the drive lacks, one sentence each."""
        return tuple(str(need) for need in self.mended)


def propose(
    objects: DriveObjects,
    node_id: int,
    needs_of: Callable[[CanopenDriveConfig], list[Need]],
    base: Mapping[str, Any] | None = None,
) -> DriveProposal:
    """`needs_of`: unmet requirements of a configuration. `base`: keys that its profile, or a person, sets.

    A value of `base` that no section takes is left to the check of the axis file. Raises MappingError.
    """
    given = dict(base or {})
    section: dict[str, Any] = {}
    sources: dict[str, str] = {}
    mended: list[Need] = []

    def put(key: str, value: Any, source: str) -> None:
        if key not in given:
            section[key], sources[key] = value, source

    unit_nm = RATED_TORQUE_UNITS[given.get("rated_torque_unit", "mNm")]
    unit_a = RATED_CURRENT_UNITS[given.get("rated_current_unit", "mA")]
    found: list[Need] = []
    for _ in range(MOST_ROUNDS):
        try:
            config = config_of(merged(given, section), node_id)
        except ValidationError:
            break
        timer = 0x1400 + config.command.number - 1
        if not objects.has(timer, 5) and config.command_timeout_ms:
            put("command_timeout_ms", 0, f"the drive has no RPDO deadline (0x{timer:04X}:05)")
        if "mode" in section and config.mode == MODE_PROFILE_TORQUE and objects.has(0x6087):
            put("torque_slope", FULL_TORQUE_IN_A_MILLISECOND, "0x6087: the whole torque within a millisecond")
        found = needs_of(config)
        new = [need for need in found if need.keys and not need.choice and not _holds(section, need.keys)]
        if not new:
            break
        taken: dict[str, Any] = {}
        for need in new:
            if any(key in taken and taken[key] != value for key, value in need.keys.items()):
                continue  # another need has this key in this round
            taken |= need.keys
            mended.append(need)
            for key, value in need.keys.items():
                section[key] = {**section.get(key, {}), **value} if isinstance(value, Mapping) else value
                sources[key] = need.text
    for key, value in reported_units(objects, unit_nm, unit_a).items():
        if accepts(CanopenDriveSection, {**PLACEHOLDERS, key: value}):  # what is not set is often 0xFFFFFFFF
            put(key, value, "reported by the drive")
    remarks = (*unit_remarks(objects), *other_axes(objects))
    return DriveProposal(section, sources, tuple(mended), tuple(found), remarks)


def _holds(section: Mapping[str, Any], keys: Mapping[str, Any]) -> bool:
    """Whether a section has these keys, of a mapping each of them."""
    return all(
        key in section and (_holds(section[key], value) if isinstance(value, Mapping) else section[key] == value)
        for key, value in keys.items()
    )


def open_units(section: Mapping[str, Any]) -> dict[str, int]:
    """Objects of the vendor's without units: key of the drive section -> index."""
    standard = {key: CanopenDriveSection.model_fields[key].default.object for key in SCALED}
    return {
        key: one["object"]
        for key in SCALED
        if (one := section.get(key))
        and one.get("object", standard[key]) != standard[key]
        and one.get("units_per_a") is None
    }


def config_of(section: Mapping[str, Any], node_id: int, rate_hz: int | None = None) -> CanopenDriveConfig:
    """A configuration to check objects against: what a section leaves open is a placeholder.

    `rate_hz` of the loop; None: the highest usual one that the section allows. Raises MappingError, and pydantic's
    ValidationError for keys that no section takes.
    """
    placed: dict[str, Any] = {"node_id": node_id, "master_id": 127 if node_id != 127 else 126}
    units = {key: {**section[key], "units_per_a": PLACEHOLDER_UNITS_PER_A} for key in open_units(section)}
    found = CanopenDriveSection.model_validate({**PLACEHOLDERS, **placed, **section, **units})
    rate_hz = usual_rate_hz(found.highest_rate_hz) if rate_hz is None else rate_hz
    return found.drive_config(PLACEHOLDER_NM_PER_A, NS_PER_S // rate_hz)


def usual_rate_hz(highest_hz: int | None) -> int:
    """The rate of a loop that may be no faster: that very rate, or the next usual one."""
    if highest_hz is None or highest_hz >= USUAL_RATES_HZ[0]:
        return USUAL_RATES_HZ[0]
    try:
        interpolation_period(NS_PER_S // highest_hz)
    except MappingError:
        return next((rate for rate in USUAL_RATES_HZ if rate <= highest_hz), USUAL_RATES_HZ[-1])
    return highest_hz


def section_lines(proposal: DriveProposal) -> list[str]:
    """Keys and values as YAML, each with where it comes from."""
    return [
        f"  {key}: {yaml_text(value)}   # {proposal.sources.get(key, 'from its profile')}"
        for key, value in proposal.section.items()
    ]
