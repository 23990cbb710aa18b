"""Requirements for a drive: one list, for a file (`drive-info`) and for the drive on the bus."""

from __future__ import annotations

from typing import Any

from ..cia402 import MODE_CYCLIC_SYNCHRONOUS_TORQUE, MODE_PROFILE_TORQUE
from . import silence
from .config import CanopenDriveConfig
from .object_map import AXIS_OBJECTS, CONTROLWORD, MODE, MODE_DISPLAY, POSITION, STATUSWORD, VELOCITY
from .service import object_name
from .silence import DriveObjects

DRIVE_PROFILE = 402  # low word of 0x1000; the type word is often 0 or the vendor's own
VENDOR_MODES = 16  # modes of 0x6502 from this bit on are vendor-specific
MODE_NAMES = {
    1: "profile position", 2: "velocity (vl)", 3: "profile velocity", MODE_PROFILE_TORQUE: "profile torque",
    6: "homing", 7: "interpolated position", 8: "cyclic synchronous position", 9: "cyclic synchronous velocity",
    MODE_CYCLIC_SYNCHRONOUS_TORQUE: "cyclic synchronous torque",
}  # fmt: skip


FIRST_AXIS_ONLY = "Only the first axis of a node (0x6000 to 0x67FF) can be driven"


class FileObjects:
    """The objects of an EDS or a DCF."""

    def __init__(self, dictionary: Any) -> None:
        self._dictionary = dictionary  # canopen's ObjectDictionary

    def has(self, index: int, sub: int = 0) -> bool:
        """Described in the file."""
        if sub == 0 and index in self._dictionary:
            return True
        return self._dictionary.get_variable(index, sub) is not None

    def value(self, index: int, sub: int = 0) -> int | None:
        """The value of a DCF before the default."""
        variable = self._dictionary.get_variable(index, sub)
        for found in (getattr(variable, "value", None), getattr(variable, "default", None)):
            if isinstance(found, int):
                return found
        return None


def mode_text(mode: int) -> str:
    """10 (cyclic synchronous torque)."""
    name = MODE_NAMES.get(mode, "the vendor's")
    return f"{mode} ({name})"


def has_mode(modes: int, mode: int) -> bool:
    """Whether 0x6502 lists a mode. For a negative, vendor-specific mode any of the upper bits counts."""
    if 1 <= mode <= VENDOR_MODES:
        return bool(modes >> (mode - 1) & 1)
    return bool(modes >> VENDOR_MODES)


def check_device_type(objects: DriveObjects, config: CanopenDriveConfig) -> list[str]:
    """0x1000 must name the device profile in its low word."""
    reported = objects.value(0x1000)
    if config.device_profile is None or (reported is not None and reported & 0xFFFF == config.device_profile):
        return []
    if reported is None:
        return ["0x1000:00 (device type) does not tell a number"]
    return [
        f"0x1000:00 says 0x{reported:08X}, which is no CiA 402 drive (0x0192 in the low word); is the node id right? "
        "For a drive that does not report its profile set drive.device_profile: null"
    ]


def check_modes(objects: DriveObjects, config: CanopenDriveConfig) -> list[str]:
    """0x6502 must list the mode in use."""
    if not config.modes_listed:
        return []
    reported = objects.value(0x6502)
    if reported is not None and has_mode(reported, config.mode):
        return []
    shown = "is missing" if reported is None else f"says 0x{reported:08X}"
    bit = f"bit {config.mode - 1}" if config.mode > 0 else f"one of bits {VENDOR_MODES} to 31"
    other = MODE_PROFILE_TORQUE
    if reported is not None and config.mode != other and has_mode(reported, other):
        remedy = f"; it has profile torque: set drive.mode: {other}"
    elif reported is None:
        remedy = "; a drive that has the mode and does not say so takes drive.modes_told: false"
    else:
        remedy = ""
    return [f"there is no mode {mode_text(config.mode)}: 0x6502:00 {shown}, {bit} is needed{remedy}"]


def other_axes(objects: DriveObjects) -> list[str]:
    """A remark where the node has further axes; none where it has one."""
    second = STATUSWORD + AXIS_OBJECTS
    if not objects.has(second):
        return []
    return [f"the node has another axis (0x{second:04X}). {FIRST_AXIS_ONLY}; nothing is written to the others"]


def needs(objects: DriveObjects, config: CanopenDriveConfig) -> list[str]:
    """Missing requirements, one sentence each, with an alternative where there is one."""
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
    pdos = [("RPDO", 0x1400, config.command), *(("TPDO", 0x1800, pdo) for pdo in config.answers)]
    named = {(index, sub) for index, sub, _ in wanted}
    wanted += [
        (item.index, item.sub, f"mapped in {kind}{pdo.number}")
        for kind, _, pdo in pdos
        for item in pdo.objects
        if (item.index, item.sub) not in named
    ]
    found = [f"object {object_name(i, sub)} is missing ({what})" for i, sub, what in wanted if not objects.has(i, sub)]
    found += silence.missing(objects, config.silence_detection, config.silence_reaction, config.command.number)
    found += [
        f"{kind}{pdo.number} is missing (0x{first + pdo.number - 1:04X}); see drive.pdo"
        for kind, first, pdo in pdos
        if not objects.has(first + pdo.number - 1, 1)
    ]
    return found
