"""The drive section of an axis file that a drive's own objects, or its file, propose.

What a drive lacks is replaced by what it has, best first: the mode, how it notices a silent PC, how it stops then, the
statusword on change. A profile of the drive's family stands before what is proposed here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from ..documents import accepts
from ..drive.canopen.config import CanopenDriveConfig
from ..drive.canopen.needs import has_mode, mode_text, other_axes
from ..drive.canopen.object_map import STANDARD_SLOTS
from ..drive.canopen.reported_units import reported_units, unit_remarks
from ..drive.canopen.silence import DETECTIONS, HEARTBEAT, REACTIONS, DriveObjects, available
from ..drive.cia402 import MODE_CYCLIC_SYNCHRONOUS_TORQUE, MODE_PROFILE_TORQUE
from .drive_section import RATED_CURRENT_UNITS, RATED_TORQUE_UNITS, CanopenDriveSection

FULL_TORQUE_IN_A_MILLISECOND = 1_000_000  # 0x6087, per mille a second: profile torque that acts like a cyclic one
PLACEHOLDER_PERIOD_NS, PLACEHOLDER_NM_PER_A = 1_000_000, 1.0  # where only objects are asked for
PLACEHOLDERS = {"kind": "canopen", "bus": "loopback:0", "node_id": 1, "rated_torque_nm": 1.0}


class DriveProposal(NamedTuple):
    """What a drive section should say."""

    section: dict[str, Any]  # keys that differ from the defaults, as an axis file has them
    sources: dict[str, str]  # key -> where it comes from, or why it stands there
    stand_ins: tuple[str, ...]  # what takes the place of something that the drive lacks, one sentence each
    remarks: tuple[str, ...]  # about units, and axes beside the one that is used

    def with_key(self, key: str, value: Any, source: str) -> DriveProposal:
        """With one key more."""
        return self._replace(section={**self.section, key: value}, sources={**self.sources, key: source})


def propose(objects: DriveObjects, base: Mapping[str, Any] | None = None) -> DriveProposal:
    """`base`: keys of the drive section that its profile sets; they are taken as they are."""
    given = dict(base or {})
    section: dict[str, Any] = {}
    sources: dict[str, str] = {}
    stand_ins: list[str] = []

    def put(key: str, value: Any, source: str) -> None:
        if key not in given:
            section[key], sources[key] = value, source

    modes = objects.value(0x6502)
    cyclic, profile = MODE_CYCLIC_SYNCHRONOUS_TORQUE, MODE_PROFILE_TORQUE
    if modes and not has_mode(modes, cyclic) and has_mode(modes, profile) and "mode" not in given:
        put("mode", profile, "0x6502 has no cyclic synchronous torque")
        stand_ins.append(f"mode {mode_text(profile)} in place of {mode_text(cyclic)}")
        if objects.has(0x6087):
            put("torque_slope", FULL_TORQUE_IN_A_MILLISECOND, "0x6087: the whole torque within a millisecond")
    slots = given.get("pdo") or {}
    rpdo = slots.get("command", STANDARD_SLOTS.command)
    for key, default, ways in (
        ("silence_detection", HEARTBEAT, DETECTIONS), ("silence_reaction", "abort_connection", REACTIONS)
    ):  # fmt: skip
        found = available(objects, ways, rpdo)
        if key in given or default in found:
            continue
        if found:
            put(key, found[0], ways[found[0]].text)
            stand_ins.append(f"{key}: {found[0]}, {ways[found[0]].text}")
        elif key == "silence_reaction":
            put(
                key,
                "none",
                "the drive has no object that defines how it stops: test this by disconnecting the bus, or change it",
            )
            stand_ins.append(f"{key}: none. {REACTIONS['none'].text.capitalize()}: test it before you rely on it")
    timer = 0x1400 + rpdo - 1
    if not objects.has(timer, 5):
        put("command_timeout_ms", 0, f"the drive has no RPDO deadline (0x{timer:04X}:05)")
    event = slots.get("event", STANDARD_SLOTS.event)
    if event is not None and not objects.has(0x1800 + event - 1, 1):
        put("pdo", {**slots, "event": None}, f"the drive has no TPDO{event}")
    elif event is not None and not objects.has(0x1800 + event - 1, 3):
        put("status_event", 0, f"TPDO{event} has no inhibit time: the statusword with the SYNC after a change")
    unit_nm = RATED_TORQUE_UNITS[given.get("rated_torque_unit", "mNm")]
    unit_a = RATED_CURRENT_UNITS[given.get("rated_current_unit", "mA")]
    for key, value in reported_units(objects, unit_nm, unit_a).items():
        if accepts(CanopenDriveSection, {**PLACEHOLDERS, key: value}):  # what is not set is often 0xFFFFFFFF
            put(key, value, "reported by the drive")
    return DriveProposal(section, sources, tuple(stand_ins), (*unit_remarks(objects), *other_axes(objects)))


def config_of(section: Mapping[str, Any], node_id: int) -> CanopenDriveConfig:
    """A configuration to check objects against: what a section leaves open is a placeholder.

    Raises MappingError, and pydantic's ValidationError for keys that no section takes.
    """
    placed = {"node_id": node_id, "master_id": 127 if node_id != 127 else 126}
    found = CanopenDriveSection.model_validate({**PLACEHOLDERS, **placed, **section})
    return found.drive_config(PLACEHOLDER_NM_PER_A, PLACEHOLDER_PERIOD_NS)
