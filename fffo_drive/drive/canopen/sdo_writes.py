"""Objects to write on particular drives: units, limits, motor ratings.

Objects written by the bring-up itself are not accepted: a list may configure a drive, but never command it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

from ..port import DriveRefusedError
from .checked import write_checked
from .object_map import axis_of, object_name
from .service import SdoRefusedError, Service

WritePhase = Literal["before_mapping", "before_enable", "after_disable"]

# objects that move an axis or belong to the bring-up, with the reason why they are refused
_COMMANDS = "commands the drive: nothing but the loop may"
_OWNED = "is written by the bring-up itself"
RESERVED = {
    range(0x1005, 0x1006): _OWNED, range(0x1014, 0x1015): _OWNED, range(0x1016, 0x1018): _OWNED,
    range(0x1019, 0x101A): _OWNED, range(0x1400, 0x1C00): _OWNED, range(0x6007, 0x6008): _OWNED,
    range(0x605A, 0x605B): _OWNED, range(0x605E, 0x605F): _OWNED, range(0x6060, 0x6061): _OWNED,
    range(0x60C2, 0x60C3): _OWNED, range(0x6072, 0x6073): "has a key of its own: drive.max_torque_permille",
    range(0x6040, 0x6041): _COMMANDS, range(0x6042, 0x6043): _COMMANDS, range(0x6071, 0x6072): _COMMANDS,
    range(0x607A, 0x607B): _COMMANDS, range(0x60B0, 0x60B3): _COMMANDS, range(0x60FF, 0x6100): _COMMANDS,
    range(0x1F80, 0x1F84): "changes the network's start",
}  # fmt: skip


class SdoWrite(NamedTuple):
    """One write of the list."""

    object_index: int
    sub: int
    value: int
    size: int  # bytes
    when: WritePhase
    check: bool  # read back and compared
    aborts: tuple[int, ...]  # abort codes that are expected
    why: str

    @property
    def text(self) -> str:
        """Object and value, as commissioning keeps them."""
        return f"{object_name(self.object_index, self.sub)} = {self.value} ({self.when})"


def reserved_reason(index: int) -> str:
    """Why an object is refused in the list; empty if it is allowed."""
    axis, same = axis_of(index)
    reason = next((reason for indices, reason in RESERVED.items() if same in indices), "")
    return reason if axis == 1 or reason == _COMMANDS else ""  # another axis of the node may be configured, not moved


def write_phase(service: Service, writes: Sequence[SdoWrite], when: WritePhase) -> None:
    """Write everything of one phase, in order.

    Raises DriveRefusedError naming object, value, purpose and the drive's reason; BusUnavailableError.
    """
    for one in writes:
        if one.when != when:
            continue
        try:
            if one.check:
                write_checked(service, one.object_index, one.sub, one.value, one.size, one.why)
            else:
                data = (one.value & ((1 << 8 * one.size) - 1)).to_bytes(one.size, "little")
                service.write(one.object_index, one.sub, data)
        except DriveRefusedError as error:
            refusal = error if isinstance(error, SdoRefusedError) else error.__cause__
            if isinstance(refusal, SdoRefusedError) and refusal.code in one.aborts:
                continue
            if isinstance(error, SdoRefusedError):
                name = object_name(one.object_index, one.sub)
                raise DriveRefusedError(
                    f"node {service.node_id} refuses {name} = {one.value}, needed for {one.why} (drive.sdo): {error}"
                ) from error
            raise
