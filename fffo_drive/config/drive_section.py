"""The drive section of an axis file: a drive on a bus, or the simulated one in process."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from ..documents import StrictRecord, accepts
from ..drive.canopen.config import LISTEN_S, CanopenDriveConfig, ModeDisplay
from ..drive.canopen.needs import FIRST_AXIS_ONLY
from ..drive.canopen.object_map import (
    CURRENT,
    STANDARD_SLOTS,
    TARGET_TORQUE,
    TORQUE,
    TORQUE_OFFSET,
    VENDOR_OBJECTS,
    MappedObject,
    PdoSlots,
    axis_of,
)
from ..drive.canopen.sdo_writes import SdoWrite, WritePhase, reserved_reason
from ..drive.canopen.silence import HEARTBEAT, Detection, Reaction
from ..drive.cia402 import (
    MODE_CYCLIC_SYNCHRONOUS_TORQUE,
    MODE_PROFILE_TORQUE,
    STATUS_FOLLOWS_COMMAND,
    STATUS_REMOTE,
)
from ..units import counts_per_rev
from .names import FileName

DEFAULT_RESOLVER_BITS = 15
RATED_TORQUE_UNITS = {"mNm": 1e-3, "uNm": 1e-6}  # Nm for one of 0x6076
RATED_CURRENT_UNITS = {"mA": 1e-3, "mA_rms": 1e-3 * math.sqrt(2.0)}  # A of the torque constant for one of 0x6075

Milliseconds = Annotated[int, Field(ge=1, le=60_000)]
OptionCode = Annotated[int, Field(ge=-(1 << 15), le=(1 << 15) - 1)]  # INTEGER16
BUS_WORD = r"^(socketcan|loopback):.+$"
DRIVE_KIND = Field(description="canopen: a drive on a CAN bus; simulated: the simulated drive, in process")


def _named_bus(bus: str) -> str:
    if not re.match(BUS_WORD, bus):
        raise ValueError("write socketcan:INTERFACE (socketcan:can0) or loopback:PORT (loopback:20000)")
    return bus


class SimulatedDriveSection(StrictRecord):
    """The simulated drive, in process: faster than real time, and the same run for the same seed."""

    kind: Annotated[Literal["simulated"], DRIVE_KIND]
    file: Annotated[FileName, Field(description="file of the simulated drive, relative to this file")]
    enable_delay_s: ClassVar[float] = 0.0  # it has no brake, and sets every bit
    served_status_bits: ClassVar[int] = STATUS_REMOTE | STATUS_FOLLOWS_COMMAND


class SdoWriteSection(StrictRecord):
    """An object to write before the drive is enabled, or after it is released."""

    object: Annotated[int, Field(ge=0x1000, le=0xFFFF, description="index, such as 0x60A9")]
    sub: Annotated[int, Field(ge=0, le=0xFF, description="sub-index")] = 0
    value: Annotated[int, Field(ge=-(1 << 63), lt=1 << 64, description="value to write")]
    bytes: Annotated[Literal[1, 2, 4, 8], Field(description="size of the object in the drive")]
    when: Annotated[
        WritePhase,
        Field(description="before_mapping (and before ratings are compared), before_enable, or after_disable"),
    ] = "before_mapping"
    check: Annotated[bool, Field(description="read it back and compare; false for a command such as 0x1010")] = True
    aborts: Annotated[list[int], Field(description="abort codes that do not count as a refusal")] = Field(
        default_factory=list
    )
    why: Annotated[
        str, Field(min_length=3, max_length=200, description="what it is needed for; shown if the drive refuses")
    ]

    @model_validator(mode="after")
    def _allowed(self) -> SdoWriteSection:
        low = -(1 << 8 * self.bytes - 1)
        if not low <= self.value < 1 << 8 * self.bytes:
            raise ValueError(f"value {self.value} does not fit into {self.bytes} bytes")
        reason = reserved_reason(self.object)
        if reason:
            raise ValueError(f"object 0x{self.object:04X} {reason}")
        return self

    def write(self) -> SdoWrite:
        """The write for the bring-up."""
        return SdoWrite(
            self.object, self.sub, self.value, self.bytes, self.when, self.check, tuple(self.aborts), self.why
        )


class TargetSection(StrictRecord):
    """The object that carries the command with each SYNC."""

    standard: ClassVar[tuple[int, ...]] = (TARGET_TORQUE, TORQUE_OFFSET)  # what holds it in CiA 402
    object: Annotated[int, Field(ge=0x2000, le=0xFFFF, description="index, such as 0x6071")] = TARGET_TORQUE
    sub: Annotated[int, Field(ge=0, le=0xFF, description="sub-index")] = 0
    bits: Annotated[Literal[16, 32], Field(description="size of the object, signed")] = 16
    units_per_a: Annotated[
        float | None,
        Field(gt=0, description="units per ampere of torque-forming current; null: per mille of the rated torque"),
    ] = None

    @field_validator("object")
    @classmethod
    def _holds_torque(cls, index: int) -> int:
        if index not in VENDOR_OBJECTS and index not in cls.standard:
            axis, same = axis_of(index)
            if axis > 1 and same in cls.standard:
                raise ValueError(
                    f"0x{index:04X} is 0x{same:04X} of axis {axis} of a node. {FIRST_AXIS_ONLY}: connect this motor to "
                    f"the first axis and use 0x{same:04X}"
                )
            known = " or ".join(f"0x{known:04X}" for known in cls.standard)
            vendors = "a vendor's object of torque or current, 0x2000 to 0x5FFF"
            raise ValueError(f"0x{index:04X} is neither the drive's torque here ({known}) nor {vendors}")
        return index


class TorqueFeedbackSection(TargetSection):
    """The object that reports the actual torque or current."""

    standard: ClassVar[tuple[int, ...]] = (TORQUE, CURRENT)
    object: Annotated[int, Field(ge=0x2000, le=0xFFFF, description="index, such as 0x6077")] = TORQUE


class PdoSection(StrictRecord):
    """Numbers of the PDOs that are used; the others are switched off."""

    command: Annotated[int, Field(ge=1, le=512, description="RPDO")] = STANDARD_SLOTS.command
    motion: Annotated[int, Field(ge=1, le=512, description="TPDO sent with each SYNC")] = STANDARD_SLOTS.motion
    status: Annotated[int, Field(ge=1, le=512, description="TPDO sent with every status_every-th SYNC")] = (
        STANDARD_SLOTS.status
    )
    event: Annotated[int | None, Field(ge=1, le=512, description="TPDO on a change of the statusword; null: none")] = (
        STANDARD_SLOTS.event
    )

    @model_validator(mode="after")
    def _different(self) -> PdoSection:
        used = [number for number in (self.motion, self.status, self.event) if number is not None]
        if len(set(used)) < len(used):
            raise ValueError("motion, status and event are three TPDOs")
        return self


class CanopenDriveSection(StrictRecord):
    """A CiA 402 drive with a torque mode on a CAN bus."""

    kind: Annotated[Literal["canopen"], DRIVE_KIND]
    bus: Annotated[
        str,
        AfterValidator(_named_bus),
        Field(description="socketcan:can0 or loopback:PORT", json_schema_extra={"pattern": BUS_WORD}),
    ]
    bitrate_hz: Annotated[int, Field(ge=10_000, le=1_000_000, description="bit rate of the bus, bit/s")] = 1_000_000
    node_id: Annotated[int, Field(ge=1, le=127, description="node id of the drive")]
    master_id: Annotated[int, Field(ge=1, le=127, description="node id of the master's heartbeat")] = 127
    counts_per_rev: Annotated[
        int | None, Field(ge=2, lt=1 << 32, description="increments of 0x6064 per revolution, any number")
    ] = None
    resolver_bits: Annotated[
        int | None, Field(ge=8, le=31, description="2^bits counts per revolution, instead of counts_per_rev")
    ] = None
    velocity_units_per_rps: Annotated[float, Field(gt=0, description="value of 0x606C at one rev/s")] = 32768.0
    rated_torque_nm: Annotated[float, Field(gt=0, le=1e5, description="0x6076; compared with the drive's")]
    rated_current_a: Annotated[float | None, Field(gt=0, le=1e4, description="0x6075; compared with the drive's")] = (
        None
    )
    rated_torque_unit: Annotated[
        Literal["mNm", "uNm"], Field(description="unit of 0x6076 in this drive; mNm in CiA 402")
    ] = "mNm"
    rated_current_unit: Annotated[
        Literal["mA", "mA_rms"],
        Field(
            description="unit of 0x6075 in this drive; with mA_rms the torque constant still refers to the amplitude"
        ),
    ] = "mA"
    inverted: Annotated[bool, Field(description="reverses the sign of velocity, position and torque together")] = False
    status_every: Annotated[int, Field(ge=1, le=240, description="SYNCs between statuswords")] = 10
    heartbeat_ms: Annotated[Milliseconds, Field(description="period of the master's heartbeat, ms")] = 50
    heartbeat_timeout_ms: Annotated[
        Milliseconds,
        Field(description="the drive reacts if the master's heartbeat is absent for this long (0x1016), ms"),
    ] = 150
    drive_heartbeat_ms: Annotated[Milliseconds, Field(description="period of the drive's heartbeat (0x1017), ms")] = 50
    command_timeout_ms: Annotated[int, Field(ge=0, le=60_000, description="RPDO deadline in the drive; 0: none")] = 20
    abort_connection_option: Annotated[int, Field(ge=1, le=3, description="0x6007: 1 fault, 2 off, 3 quick stop")] = 3
    status_event: Annotated[
        Literal[0, 254, 255], Field(description="transmission type of the statusword on change; 0: with the next SYNC")
    ] = 255
    quick_stop_option: Annotated[OptionCode | None, Field(description="0x605A; null: the drive's own")] = 2
    fault_reaction_option: Annotated[OptionCode | None, Field(description="0x605E; null: the drive's own")] = 2
    max_torque_permille: Annotated[
        int | None, Field(ge=1, le=65535, description="0x6072, torque limit in the drive; null: the drive's own")
    ] = None
    current_limit_a: Annotated[
        float | None,
        Field(
            gt=0,
            le=1e4,
            description="current to which the drive limits itself, A: the law's limit is never above it; null: the "
            "least of 0x6072, 0x6073, 0x60E0 and 0x60E1 as the drive has them",
        ),
    ] = None
    sdo: Annotated[
        list[SdoWriteSection],
        Field(default_factory=list, description="objects to write to this drive, in order"),
    ]
    warning_codes: Annotated[
        list[Annotated[int, Field(ge=1, le=0xFFFF)]],
        Field(description="EMCY codes that are only warnings, such as 0xFF00: reported as events, without a stop"),
    ] = Field(default_factory=list)
    unserved_status_bits: Annotated[
        list[Literal[9, 12]],
        Field(description="statusword bits that this drive never sets: 9 remote, 12 follows the target torque"),
    ] = Field(default_factory=list)
    enable_delay_s: Annotated[
        float,
        Field(ge=0, le=10, description="from Operation Enabled to the start of the law, for a holding brake to open"),
    ] = 0.0
    profile: Annotated[
        FileName | None,
        Field(
            description="profile of the drive's family: a name listed by "
            "`fffo-drive config drives`, or a file relative "
            "to this one; its values are the defaults of the keys here"
        ),
    ] = None
    mode: Annotated[
        int,
        Field(
            ge=-128,
            le=127,
            description="0x6060: 10 cyclic synchronous torque, 4 profile torque, -1 to -128 vendor-specific",
        ),
    ] = MODE_CYCLIC_SYNCHRONOUS_TORQUE
    modes_told: Annotated[
        bool, Field(description="0x6502 lists the mode; false: the drive has it without listing it")
    ] = True
    mode_display: Annotated[
        ModeDisplay, Field(description="when 0x6061 shows the mode: at_once, with_sync, or not_checked")
    ] = "at_once"
    device_profile: Annotated[int | None, Field(ge=0, le=0xFFFF, description="low word of 0x1000; null: any")] = 402
    target: Annotated[TargetSection, Field(description="object and scale of the torque command")] = TargetSection()
    torque_feedback: Annotated[TorqueFeedbackSection, Field(description="object and scale of the actual torque")] = (
        TorqueFeedbackSection()
    )
    torque_slope: Annotated[
        int | None, Field(ge=1, lt=1 << 32, description="0x6087 in per mille per second; null: the drive's own")
    ] = None
    pdo: Annotated[PdoSection, Field(description="numbers of the PDOs used")] = PdoSection()
    silence_detection: Annotated[
        Detection,
        Field(
            description="how the drive detects that the PC is silent: heartbeat (0x1016), life_guarding (0x100C and "
            "0x100D), rpdo_timer (0x1400:05), vendor (set by sdo), none (accepts a drive that does not detect it)"
        ),
    ] = HEARTBEAT
    silence_reaction: Annotated[
        Reaction,
        Field(
            description="what determines how it then stops: abort_connection "
            "(0x6007), error_behaviour (0x1029), vendor "
            "(set by sdo), none (accepts a drive without a reaction)"
        ),
    ] = "abort_connection"
    highest_rate_hz: Annotated[
        int | None, Field(ge=1, description="highest rate at which the drive accepts commands; null: not known")
    ] = None
    eds: Annotated[FileName | None, Field(description="EDS of the drive, relative to this file")] = None
    listen_s: Annotated[
        float, Field(ge=0.1, le=10, description="time of listening on the bus before anything is sent")
    ] = LISTEN_S
    answer_timeout_s: Annotated[float, Field(ge=0.01, le=10, description="timeout of one SDO answer; see attempts")] = (
        0.3
    )
    attempts: Annotated[int, Field(ge=1, le=20, description="attempts of an SDO transfer that is not answered")] = 3
    start_timeout_s: Annotated[
        float, Field(ge=0.01, le=60, description="timeout of boot-up and of each change of state")
    ] = 3.0
    turnaround_us: Annotated[
        float, Field(ge=0, le=10_000, description="turnaround of the drive, for the timing budget")
    ] = 50.0

    @model_validator(mode="after")
    def _one_resolution(self) -> CanopenDriveSection:
        if self.counts_per_rev is not None and self.resolver_bits is not None:
            raise ValueError("counts_per_rev and resolver_bits define the same: give one of them")
        if "vendor" in (self.silence_detection, self.silence_reaction) and not self.sdo:
            raise ValueError("silence_detection or silence_reaction is vendor: the objects that set it belong in sdo")
        standard = (MODE_CYCLIC_SYNCHRONOUS_TORQUE, MODE_PROFILE_TORQUE)
        for key, one, standard_object in (
            ("target", self.target, TARGET_TORQUE), ("torque_feedback", self.torque_feedback, TORQUE)
        ):  # fmt: skip
            if one.object != standard_object and one.units_per_a is None:
                raise ValueError(f"{key}.units_per_a: 0x{one.object:04X} has its own units, give them")
        if self.mode not in standard and self.mode >= 0:
            raise ValueError(f"mode {self.mode}: 10, 4, or a negative one of the vendor's; others command no torque")
        return self

    @property
    def served_status_bits(self) -> int:
        """Mask of the monitored bits of the statusword: bit 12 has this meaning in the cyclic synchronous mode only."""
        cyclic = self.mode == MODE_CYCLIC_SYNCHRONOUS_TORQUE
        watched = STATUS_REMOTE | (STATUS_FOLLOWS_COMMAND if cyclic else 0)
        return watched & ~sum(1 << bit for bit in set(self.unserved_status_bits))

    @property
    def counts(self) -> int:
        """Increments of 0x6064 in one revolution."""
        return self.counts_per_rev or counts_per_rev(self.resolver_bits or DEFAULT_RESOLVER_BITS)

    def drive_config(
        self, torque_constant_nm_per_a: float, period_ns: int, bus: str | None = None
    ) -> CanopenDriveConfig:
        """Configuration of the drive's bring-up and exchange. Raises MappingError."""
        names = {field.name for field in dataclasses.fields(CanopenDriveConfig)}
        values: dict[str, Any] = {name: value for name, value in self if name in names}
        values |= {
            "bus": bus or self.bus,
            "period_ns": period_ns,
            "counts_per_rev": self.counts,
            "torque_constant_nm_per_a": torque_constant_nm_per_a,
            "rated_torque_unit_nm": RATED_TORQUE_UNITS[self.rated_torque_unit],
            "rated_current_unit_a": RATED_CURRENT_UNITS[self.rated_current_unit],
            "sdo": tuple(entry.write() for entry in self.sdo),
            "warning_codes": tuple(self.warning_codes),
            "unserved_status_bits": tuple(self.unserved_status_bits),
            "modes_listed": self.modes_told,
            "target": MappedObject(self.target.object, self.target.sub, self.target.bits),
            "target_units_per_a": self.target.units_per_a,
            "torque": MappedObject(self.torque_feedback.object, self.torque_feedback.sub, self.torque_feedback.bits),
            "torque_units_per_a": self.torque_feedback.units_per_a,
            "slots": PdoSlots(**self.pdo.model_dump()),
        }
        return CanopenDriveConfig(**values)


def merged(keys: Mapping[str, Any], section: Mapping[str, Any]) -> dict[str, Any]:
    """A drive section over the keys of a profile."""
    found = {**keys, **section}
    for key, value in keys.items():  # of a mapping in it the file may give single keys
        if isinstance(value, Mapping) and isinstance(section.get(key), Mapping):
            found[key] = {**value, **section[key]}
    for given, other in (("resolver_bits", "counts_per_rev"), ("counts_per_rev", "resolver_bits")):
        if given in section and other not in section:  # two ways to say the same
            found.pop(other, None)
    own = section.get("sdo")
    if "sdo" in keys and isinstance(own, list) and all(accepts(SdoWriteSection, write) for write in own):
        found["sdo"] = _joined(keys["sdo"], own)  # else its own mistakes are named
    return found


def _joined(shared: list[Any], own: list[Any]) -> list[Any]:
    """Writes of a profile and of a file, each list in its order: one may unlock what the next one sets."""
    places = [_place(write) for write in own]
    found, rest = [], own
    for write in shared:
        place = _place(write)
        if place not in places:
            found.append(write)
            continue
        end = next((k for k, mine in enumerate(rest, 1) if _place(mine) == place), 0)
        found, rest = found + rest[:end], rest[end:]
    return found + rest


def _place(write: Mapping[str, Any]) -> tuple[Any, Any, Any]:
    return write.get("object"), write.get("sub", 0), write.get("when", "before_mapping")
