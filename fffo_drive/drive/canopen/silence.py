"""The drive's reaction to a silent PC: how it detects the silence, and how it stops.

CiA 301 has three ways to detect it (heartbeat consumer 0x1016, life guarding 0x100C and 0x100D, deadline of an RPDO,
sub-index 5 of 0x1400), CiA 402 one reaction (0x6007), and CiA 301 also the error behaviour 0x1029. Many drives lack one
or the other. A substitute is named in the configuration and never chosen silently; doing without must be accepted
explicitly.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

from ..port import DriveRefusedError
from .checked import write_checked, write_if_present
from .service import Service

if TYPE_CHECKING:
    from .config import CanopenDriveConfig

Detection = Literal["heartbeat", "life_guarding", "rpdo_timer", "vendor", "none"]
Reaction = Literal["abort_connection", "error_behaviour", "vendor", "none"]
HEARTBEAT: Literal["heartbeat"] = "heartbeat"
LIFE_GUARDING: Literal["life_guarding"] = "life_guarding"
RPDO_TIMER: Literal["rpdo_timer"] = "rpdo_timer"
PRE_OPERATIONAL_ON_ERROR = 0  # 0x1029:1; CiA 402 treats leaving OPERATIONAL as a lost connection
CONSUMER, GUARD_TIME, LIFE_FACTOR = 0x1016, 0x100C, 0x100D
MOST_CONSUMERS = 127
HIGHEST_LIFE_FACTOR = 255

Object = tuple[int, int]  # index, sub-index


class DriveObjects(Protocol):
    """The objects of a drive, from its EDS or DCF, or from its answers on the bus."""

    def has(self, index: int, sub: int = 0) -> bool:
        """True when there is such an object."""
        ...

    def value(self, index: int, sub: int = 0) -> int | None:
        """Its value; None where it has none or the file gives none."""
        ...


class MappableObjects(DriveObjects, Protocol):
    """The same, with what is known of PDOs."""

    def mappable(self, index: int, sub: int = 0) -> bool:
        """Whether a PDO may carry an object, as far as that is known before it is tried."""
        ...


class Way(NamedTuple):
    """One way: the objects that it needs, and a description."""

    objects: tuple[Object, ...]
    text: str


DETECTIONS: dict[str, Way] = {  # best first
    HEARTBEAT: Way(((CONSUMER, 1),), "the drive watches our heartbeat (0x1016)"),
    LIFE_GUARDING: Way(((GUARD_TIME, 0), (LIFE_FACTOR, 0)), "the drive watches our guarding requests (0x100C, 0x100D)"),
    RPDO_TIMER: Way(((0x1400, 5),), "the drive watches the command's RPDO (0x1400:05)"),
    "vendor": Way((), "a watchdog of the vendor's, set by drive.sdo"),
    "none": Way((), "nothing: the drive keeps its last command when the PC is silent"),
}
REACTIONS: dict[str, Way] = {
    "abort_connection": Way(((0x6007, 0),), "0x6007 says how it stops"),
    "error_behaviour": Way(((0x1029, 1),), "it leaves OPERATIONAL (0x1029)"),
    "vendor": Way((), "a setting of the vendor's, made by drive.sdo"),
    "none": Way((), "not configured: what the drive does is its own"),
}


def available(objects: DriveObjects, ways: dict[str, Way], rpdo: int = 1) -> list[str]:
    """The ways that need objects and whose objects a drive has, best first."""
    return [name for name, way in ways.items() if way.objects and not lacking(objects, way, rpdo)]


def lacking(objects: DriveObjects, way: Way, rpdo: int = 1) -> list[Object]:
    """The objects of a way that a drive does not have."""
    wanted = [(index + _slot(index, rpdo), sub) for index, sub in way.objects]
    return [(index, sub) for index, sub in wanted if not objects.has(index, sub)]


def _slot(index: int, rpdo: int) -> int:
    return rpdo - 1 if index == 0x1400 else 0


def configure(service: Service, config: CanopenDriveConfig) -> None:
    """Set both up. Raises DriveRefusedError, BusUnavailableError."""
    watch = "the drive to notice that the PC is silent"
    guarded = config.silence_detection == LIFE_GUARDING
    purpose = "no heartbeat beside life guarding" if guarded else "the drive's heartbeat"
    if guarded:
        write_if_present(service, 0x1017, 0, 0, 2, purpose)
        write_checked(service, LIFE_FACTOR, 0, 0, 1, watch)  # not before the loop sends requests: see `begin`
        write_checked(service, GUARD_TIME, 0, config.heartbeat_ms, 2, watch)
    else:
        write_checked(service, 0x1017, 0, config.drive_heartbeat_ms, 2, purpose)
    if config.silence_detection == HEARTBEAT:
        entry = consumer_entry(service, config.master_id)
        write_checked(service, CONSUMER, entry, config.master_id << 16 | config.heartbeat_timeout_ms, 4, watch)
    if config.command_timeout_ms:
        deadline = 0x1400 + config.command.number - 1
        if config.silence_detection == RPDO_TIMER:
            write_checked(service, deadline, 5, config.command_timeout_ms, 2, watch)
        else:
            purpose = "the drive to notice that commands stay away"
            write_if_present(service, deadline, 5, config.command_timeout_ms, 2, purpose)
    purpose = "the drive to stop when the PC is silent"
    if config.silence_reaction == "abort_connection":
        write_checked(service, 0x6007, 0, config.abort_connection_option, 2, purpose)
    elif config.silence_reaction == "error_behaviour":
        write_checked(service, 0x1029, 1, PRE_OPERATIONAL_ON_ERROR, 1, purpose)


def begin(service: Service, config: CanopenDriveConfig) -> None:
    """Start monitoring once the drive is operational: the loop sends the guarding requests from its first tick on.

    Raises DriveRefusedError, BusUnavailableError.
    """
    if config.silence_detection == LIFE_GUARDING:
        write_checked(service, LIFE_FACTOR, 0, life_factor(config), 1, "the drive to notice that the PC is silent")


def life_factor(config: CanopenDriveConfig) -> int:
    """Number of guarding requests that may be missed, for the time-out of the heartbeat."""
    return min(HIGHEST_LIFE_FACTOR, math.ceil(config.heartbeat_timeout_ms / config.heartbeat_ms))


def consumer_entry(service: Service, master_id: int) -> int:
    """Sub-index of 0x1016 that monitors us, or a free one. Raises DriveRefusedError when all monitor other nodes."""
    entries = min(service.read_optional_int(CONSUMER, 0) or 1, MOST_CONSUMERS)
    if entries == 1:
        return 1
    free = None
    for sub in range(1, entries + 1):
        value = service.read_optional_int(CONSUMER, sub)
        if value is None:
            break
        node, time_ms = value >> 16 & 0xFF, value & 0xFFFF
        if node == master_id:
            return sub
        if free is None and (not node or not time_ms):
            free = sub
    if free is None:
        raise DriveRefusedError(
            f"node {service.node_id}: every entry of 0x1016 watches another node; free one (write 0), "
            "or restore the drive's defaults"
        )
    return free


def release(service: Service, config: CanopenDriveConfig) -> None:
    """An orderly release is not a fault: the drive stops monitoring us. Raises DriveRefusedError,
    BusUnavailableError.
    """
    if config.silence_detection == LIFE_GUARDING:
        service.write(LIFE_FACTOR, 0, bytes(1))
    elif config.silence_detection == HEARTBEAT:
        service.write(CONSUMER, consumer_entry(service, config.master_id), bytes(4))
