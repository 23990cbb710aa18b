"""Requirements that a drive does not meet: one list, for a file (`drive-info`, `config check`) and for the bus.

All are reported at once, each with the keys of the drive section that work around it, if any do.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import yaml

from ..cia402 import MODE_CYCLIC_SYNCHRONOUS_TORQUE, MODE_PROFILE_TORQUE
from . import silence
from .config import CanopenDriveConfig
from .object_map import (
    AXIS_OBJECTS,
    CONTROLWORD,
    CURRENT,
    MODE,
    MODE_DISPLAY,
    POSITION,
    STATUSWORD,
    TORQUE,
    VELOCITY,
    PdoMap,
    object_name,
)
from .silence import DriveObjects, MappableObjects

DRIVE_PROFILE = 402  # low word of 0x1000; the type word is often 0 or the vendor's own
VENDOR_MODES = 16  # modes of 0x6502 from this bit on are vendor-specific
MODE_NAMES = {
    1: "profile position", 2: "velocity (vl)", 3: "profile velocity", MODE_PROFILE_TORQUE: "profile torque",
    6: "homing", 7: "interpolated position", 8: "cyclic synchronous position", 9: "cyclic synchronous velocity",
    MODE_CYCLIC_SYNCHRONOUS_TORQUE: "cyclic synchronous torque",
}  # fmt: skip


PERMILLE = 1e3
UNNOTICED = (  # to be decided by a person
    "vendor, with the objects of the drive's own watchdog in drive.sdo (see its manual: communication timeout, "
    "watchdog), or none, which accepts that it keeps its last command when the PC is silent"
)
FIRST_AXIS_ONLY = "Only the first axis of a node (0x6000 to 0x67FF) can be driven"


class Need(NamedTuple):
    """A requirement that a drive does not meet, and the keys of an axis file that work around it."""

    text: str
    keys: Mapping[str, Any] = MappingProxyType({})  # of the drive section, that mend it; empty: none does
    choice: str = ""  # where `keys` is one of several answers that only a person can give: what to fill in

    def __str__(self) -> str:
        if not self.keys:
            return self.text
        if self.choice:
            return f"{self.text}; {' and '.join(f'drive.{key}' for key in self.keys)}: {self.choice}"
        return f"{self.text}; set {keys_text(self.keys, 'drive.', ' and ')}"


def keys_text(keys: Mapping[str, Any], before: str = "", between: str = ", ") -> str:
    """Keys with their values, in one line."""
    return between.join(f"{before}{key}: {yaml_text(value)}" for key, value in keys.items())


def yaml_text(value: Any) -> str:
    """A value as it stands behind a key of a YAML file, in one line; of an object the index in hexadecimal."""
    if isinstance(value, float):
        return format(value, ".10g")
    if isinstance(value, Mapping):
        shown = {key: f"0x{one:04X}" if key == "object" else yaml_text(one) for key, one in value.items()}
        return f"{{{', '.join(f'{key}: {text}' for key, text in shown.items())}}}"
    text: str = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=math.inf)
    return text.removesuffix("\n...\n").strip()


def mode_text(mode: int) -> str:
    """10 (cyclic synchronous torque)."""
    name = MODE_NAMES.get(mode, "the vendor's")
    return f"{mode} ({name})"


def has_mode(modes: int, mode: int) -> bool:
    """Whether 0x6502 lists a mode. For a negative, vendor-specific mode any of the upper bits counts."""
    if 1 <= mode <= VENDOR_MODES:
        return bool(modes >> (mode - 1) & 1)
    return bool(modes >> VENDOR_MODES)


def needs(objects: MappableObjects, config: CanopenDriveConfig) -> list[Need]:
    """Requirements of this configuration that the drive on the bus does not meet."""
    return [
        *check_device_type(objects, config),
        *check_modes(objects, config),
        *check_objects(objects, config),
        *check_silence(objects, config),
        *missing_pdos(objects, config),
    ]


def check_device_type(objects: DriveObjects, config: CanopenDriveConfig) -> list[Need]:
    """0x1000 must name the device profile in its low word."""
    reported = objects.value(0x1000)
    if config.device_profile is None or (reported is not None and reported & 0xFFFF == config.device_profile):
        return []
    if reported is None:
        return [Need("0x1000:00 (device type) does not tell a number", {"device_profile": None})]
    text = f"0x1000:00 says 0x{reported:08X}, which is no CiA 402 drive (0x0192 in the low word): another device, or it"
    return [Need(f"{text} does not report its profile", {"device_profile": None})]


def check_modes(objects: DriveObjects, config: CanopenDriveConfig) -> list[Need]:
    """0x6502 must list the mode in use."""
    if not config.modes_listed:
        return []
    reported = objects.value(0x6502)
    if reported is not None and has_mode(reported, config.mode):
        return []
    shown = "is missing" if reported is None else f"says 0x{reported:08X}"
    bit = f"bit {config.mode - 1}" if config.mode > 0 else f"one of bits {VENDOR_MODES} to 31"
    text = f"there is no mode {mode_text(config.mode)}: 0x6502:00 {shown}, {bit} is needed"
    if reported is None:  # whether the drive took the mode is seen at 0x6061
        return [Need(text, {"modes_told": False})]
    return [Need(text, other_mode(config, reported))]


def other_mode(config: CanopenDriveConfig, modes: int) -> dict[str, Any]:
    """The key for profile torque in place of the cyclic mode; empty where 0x6502 does not list it."""
    other = MODE_PROFILE_TORQUE
    return {"mode": other} if config.mode == MODE_CYCLIC_SYNCHRONOUS_TORQUE and has_mode(modes, other) else {}


def other_axes(objects: DriveObjects) -> list[str]:
    """A remark where the node has further axes; none where it has one."""
    second = STATUSWORD + AXIS_OBJECTS
    if not objects.has(second):
        return []
    return [f"the node has another axis (0x{second:04X}). {FIRST_AXIS_ONLY}; nothing is written to the others"]


def check_objects(objects: MappableObjects, config: CanopenDriveConfig) -> list[Need]:
    """Objects that are read, written or mapped and that the drive does not have."""
    wanted = [
        (CONTROLWORD, 0, "commands of state"),
        (STATUSWORD, 0, "its state"),
        (MODE, 0, "choosing the mode"),
        (VELOCITY, 0, "the velocity that is controlled"),
        (POSITION, 0, "the position"),
        (config.target.index, config.target.sub, "the torque that is commanded"),
        (config.torque.index, config.torque.sub, "the torque that comes back"),
    ]
    if config.mode_display != "not_checked":
        wanted.append((MODE_DISPLAY, 0, "the mode that is in force"))
    if config.silence_detection != silence.LIFE_GUARDING:
        wanted.append((0x1017, 0, "the PC notices that the drive is silent"))
    named = {(index, sub) for index, sub, _ in wanted}
    wanted += [
        (item.index, item.sub, f"mapped in {kind}{pdo.number}")
        for kind, _, pdo in pdos_of(config)
        for item in pdo.objects
        if (item.index, item.sub) not in named
    ]
    return [
        Need(f"object {object_name(index, sub)} is missing ({what})", _without(objects, config, index, sub))
        for index, sub, what in wanted
        if not objects.has(index, sub)
    ]


def _without(objects: MappableObjects, config: CanopenDriveConfig, index: int, sub: int) -> dict[str, Any]:
    """The key that makes an object unnecessary; empty if there is none."""
    if (index, sub) == (MODE_DISPLAY, 0):
        return {"mode_display": "not_checked"}
    if (index, sub) == (0x1017, 0) and silence.LIFE_GUARDING in silence.available(objects, silence.DETECTIONS):
        return {"silence_detection": silence.LIFE_GUARDING}
    if (index, sub) == (TORQUE, 0):
        return current_feedback(objects, config)
    return {}


def current_feedback(objects: MappableObjects, config: CanopenDriveConfig) -> dict[str, Any]:
    """The key for 0x6078 (actual current, per mille of 0x6075) in place of the torque; empty without it."""
    if config.torque.index == CURRENT or not objects.mappable(CURRENT):
        return {}
    rated_a = (objects.value(0x6075) or 0) * config.rated_current_unit_a
    scale = {"units_per_a": PERMILLE / rated_a} if rated_a else {}
    return {"torque_feedback": {"object": CURRENT, **scale}}


def check_silence(objects: DriveObjects, config: CanopenDriveConfig) -> list[Need]:
    """Objects of the chosen ways to notice that the PC is silent, and to stop then."""
    found = []
    for key, chosen, ways, purpose in (
        ("silence_detection", config.silence_detection, silence.DETECTIONS, "the drive notices that the PC is silent"),
        ("silence_reaction", config.silence_reaction, silence.REACTIONS, "what the drive does when the PC is silent"),
    ):
        lacking = silence.lacking(objects, ways[chosen], config.command.number)
        if not lacking:
            continue
        names = ", ".join(object_name(index, sub) for index, sub in lacking)
        text = f"{'object' if len(lacking) == 1 else 'objects'} {names} {'is' if len(lacking) == 1 else 'are'} missing"
        others = silence.available(objects, ways, config.command.number)
        if others:
            keys: dict[str, Any] = {key: others[0]}
            if others[0] == silence.RPDO_TIMER and not config.command_timeout_ms:
                keys["command_timeout_ms"] = CanopenDriveConfig.command_timeout_ms
            found.append(Need(f"{text} ({purpose}); instead: {ways[others[0]].text}", keys))
        elif key == "silence_reaction":
            test = "nothing else determines it: test it by disconnecting the bus before you rely on it"
            found.append(Need(f"{text} ({purpose}); {test}", {key: "none"}))
        else:
            found.append(Need(f"{text} ({purpose})", {key: "none"}, UNNOTICED))
    return found


def pdos_of(config: CanopenDriveConfig) -> Iterable[tuple[str, int, PdoMap]]:
    """(RPDO or TPDO, index of its communication parameter, mapping) of every PDO in use; the command first."""
    for kind, first, pdo in (("RPDO", 0x1400, config.command), *(("TPDO", 0x1800, pdo) for pdo in config.answers)):
        yield kind, first + pdo.number - 1, pdo


def missing_pdos(objects: DriveObjects, config: CanopenDriveConfig) -> list[Need]:
    """PDOs in use that the drive does not have. It can do without the one on change, or without its inhibit time."""
    found = []
    for kind, index, pdo in pdos_of(config):
        if not objects.has(index, 1):
            text = f"{kind}{pdo.number} is missing (0x{index:04X})"
            found.append(Need(text, without_event(config) if is_event(config, kind, pdo) else {}))
        elif pdo.inhibit_ns and not objects.has(index, 3):
            found.append(Need(no_inhibit_text(f"{kind}{pdo.number}", index), {"status_event": 0}))
    return found


def no_inhibit_text(name: str, index: int) -> str:
    """Of a TPDO on change, and the index of its communication parameter."""
    return f"{name} has no inhibit time (0x{index:04X}:03), which keeps events apart"


def is_event(config: CanopenDriveConfig, kind: str, pdo: PdoMap) -> bool:
    """The statusword on change: the only PDO that can be done without."""
    return kind == "TPDO" and pdo.number == config.slots.event


def without_event(config: CanopenDriveConfig) -> dict[str, Any]:
    """The key that makes the statusword on change unnecessary."""
    return {"pdo": {**config.slots._asdict(), "event": None}}
