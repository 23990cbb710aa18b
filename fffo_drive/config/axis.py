"""The axis file: drive, model, law, limits, profile. `read_axis` checks it, the rest makes the kernels' records."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from .. import formats
from ..control import envelope as env
from ..control.controller import ControllerConfig
from ..control.feedforward import FeedforwardConfig
from ..control.friction_observer import TOGGLE_NAMES, ObserverConfig
from ..control.pi import PiConfig
from ..control.reference import (
    MODE_CURRENT,
    MODE_VELOCITY,
    Profile,
    paper_reference,
    piecewise_linear,
    sine,
)
from ..documents import Record, load, refuse
from ..drive.canopen.config import LISTEN_S, CanopenDriveConfig
from ..drive.canopen.sdo_writes import SdoWrite, WritePhase, reserved_reason
from ..drive.cia402 import STATUS_FOLLOWS_COMMAND, STATUS_REMOTE
from ..identification.excitation import (
    deciding_motion,
    frequency_response_chirp,
    identification_sequence,
    separating_recipe,
)
from ..model.parameters import ModelFile, content_hash, model_text, read_model
from ..recording.settings import RecorderSettings, RotationPolicy
from ..runtime.realtime import RealtimeRequest
from ..runtime.records import ModelNote
from ..runtime.session import SessionConfig
from ..runtime.tick import LoopConfig
from ..units import NS_PER_S, counts_per_rev
from .effects import compensation_table
from .sections import (
    ControllerSection,
    DaemonSection,
    DecideProfile,
    EnvelopeSection,
    FeedforwardSection,
    FrfProfile,
    IdentifyProfile,
    LoopSection,
    PaperProfile,
    ProfileSection,
    RealtimeSection,
    RecipeProfile,
    RecordingSection,
    SineProfile,
    length_problems,
)

STOP_S = 2.0  # how long a drive may take to let go of its torque
SPEED_SHARE, CHIRP_SHARE = 0.8, 0.3  # of speed limit and continuous current, for a motion that decides
RING_S = 4.0  # what the recorder may lag behind the loop on a bus
TOGGLES = {name: toggle for toggle, name in TOGGLE_NAMES.items()}
TRIP_NAMES = {
    name.removeprefix("TRIP_").lower(): value
    for name, value in vars(env).items()
    if name.startswith("TRIP_") and isinstance(value, int) and name not in ("TRIP_COUNT", "TRIP_NONE")
}
DEFAULT_RESOLVER_BITS = 15
WATCHED_STATUS_BITS = STATUS_REMOTE | STATUS_FOLLOWS_COMMAND
RATED_TORQUE_UNITS = {"mNm": 1e-3, "uNm": 1e-6}  # Nm for one of 0x6076
REACTIONS = {"coast": env.REACTION_COAST, "quick_stop": env.REACTION_QUICK_STOP}

Milliseconds = Annotated[int, Field(ge=1, le=60_000)]


class SimulatedDriveSection(Record):
    """The simulated drive, in process: faster than real time, the same run from the same seed."""

    kind: Literal["simulated"]
    file: Annotated[str, Field(description="file of the simulated drive, relative to this file")]
    enable_delay_s: ClassVar[float] = 0.0  # it has no brake, and sets every bit
    unserved_status_bits: ClassVar[tuple[int, ...]] = ()


class SdoWriteSection(Record):
    """One object that is written before a drive is enabled, or after it was left."""

    object: Annotated[int, Field(ge=0x1000, le=0xFFFF, description="index, as 0x60A9")]
    sub: Annotated[int, Field(ge=0, le=0xFF, description="sub-index")] = 0
    value: Annotated[int, Field(ge=-(1 << 63), lt=1 << 64)]
    bytes: Annotated[Literal[1, 2, 4, 8], Field(description="size of the object in the drive")]
    when: Annotated[
        WritePhase,
        Field(description="before_mapping (and before ratings are compared), before_enable, or after_disable"),
    ] = "before_mapping"
    check: Annotated[bool, Field(description="read it back and compare; false for a command such as 0x1010")] = True
    aborts: Annotated[list[int], Field(description="abort codes that are expected, and no refusal")] = Field(
        default_factory=list
    )
    why: Annotated[str, Field(min_length=3, max_length=200, description="what it is needed for; a refusal says it")]

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
        """As the bring-up takes it."""
        return SdoWrite(
            self.object, self.sub, self.value, self.bytes, self.when, self.check, tuple(self.aborts), self.why
        )


class CanopenDriveSection(Record):
    """A CiA 402 drive in cyclic synchronous torque on a CAN bus."""

    kind: Literal["canopen"]
    bus: Annotated[str, Field(pattern=r"^(socketcan|loopback):.+$", description="socketcan:can0 or loopback:PORT")]
    bitrate_hz: Annotated[int, Field(ge=10_000, le=1_000_000)] = 1_000_000
    node_id: Annotated[int, Field(ge=1, le=127)]
    master_id: Annotated[int, Field(ge=1, le=127, description="node id of our heartbeat")] = 127
    counts_per_rev: Annotated[
        int | None, Field(ge=2, lt=1 << 32, description="increments of 0x6064 in a revolution, any number")
    ] = None
    resolver_bits: Annotated[
        int | None, Field(ge=8, le=31, description="2^bits counts a revolution, in place of counts_per_rev")
    ] = None
    velocity_units_per_rps: Annotated[float, Field(gt=0, description="0x606C for one rev/s")] = 32768.0
    rated_torque_nm: Annotated[float, Field(gt=0, le=1e5, description="0x6076; compared with the drive's")]
    rated_current_a: Annotated[float | None, Field(gt=0, le=1e4, description="0x6075; compared with the drive's")] = (
        None
    )
    rated_torque_unit: Annotated[
        Literal["mNm", "uNm"], Field(description="of 0x6076 in this drive; CiA 402 has mNm")
    ] = "mNm"
    inverted: bool = False
    status_every: Annotated[int, Field(ge=1, le=240, description="SYNCs between statuswords")] = 10
    heartbeat_ms: Milliseconds = 50
    heartbeat_timeout_ms: Milliseconds = 150
    drive_heartbeat_ms: Milliseconds = 50
    command_timeout_ms: Annotated[int, Field(ge=0, le=60_000, description="RPDO deadline in the drive; 0: none")] = 20
    abort_connection_option: Annotated[int, Field(ge=1, le=3, description="0x6007: 1 fault, 2 off, 3 quick stop")] = 3
    status_event: Annotated[
        Literal[0, 254, 255], Field(description="transmission type of the statusword on change; 0: with the next SYNC")
    ] = 255
    quick_stop_option: Annotated[int | None, Field(description="0x605A; null: the drive's own")] = 2
    fault_reaction_option: Annotated[int | None, Field(description="0x605E; null: the drive's own")] = 2
    max_torque_permille: Annotated[
        int | None, Field(ge=1, le=65535, description="0x6072, torque limit in the drive; null: the drive's own")
    ] = None
    sdo: Annotated[
        list[SdoWriteSection],
        Field(default_factory=list, description="objects that this drive needs written, in order"),
    ]
    warning_codes: Annotated[
        list[Annotated[int, Field(ge=1, le=0xFFFF)]],
        Field(description="EMCY codes that only warn, as 0xFF00: told as an event, no reason to stop"),
    ] = Field(default_factory=list)
    unserved_status_bits: Annotated[
        list[Literal[9, 12]],
        Field(description="statusword bits that this drive never sets: 9 remote, 12 follows the target torque"),
    ] = Field(default_factory=list)
    enable_delay_s: Annotated[
        float, Field(ge=0, le=10, description="from Operation Enabled to the law: a holding brake opens meanwhile")
    ] = 0.0
    eds: Annotated[str | None, Field(description="EDS of the drive, relative to this file")] = None
    listen_s: Annotated[float, Field(ge=0.1, le=10, description="to the bus, before anything is sent there")] = LISTEN_S
    answer_timeout_s: Annotated[float, Field(ge=0.01, le=10, description="of one SDO answer; asked three times")] = 0.3
    attempts: Annotated[int, Field(ge=1, le=20, description="of an SDO transfer that is not answered")] = 3
    start_timeout_s: Annotated[float, Field(ge=0.01, le=60, description="boot-up, and each change of state")] = 3.0
    turnaround_us: Annotated[float, Field(ge=0, le=10_000, description="of the drive, for the sum of the bus")] = 50.0

    @model_validator(mode="after")
    def _one_resolution(self) -> CanopenDriveSection:
        if self.counts_per_rev is not None and self.resolver_bits is not None:
            raise ValueError("counts_per_rev and resolver_bits say the same: give one of them")
        return self

    @property
    def counts(self) -> int:
        """Increments of 0x6064 in one revolution."""
        return self.counts_per_rev or counts_per_rev(self.resolver_bits or DEFAULT_RESOLVER_BITS)

    def drive_config(
        self, torque_constant_nm_per_a: float, period_ns: int, bus: str | None = None
    ) -> CanopenDriveConfig:
        """What the drive's bring-up and exchange need. Raises MappingError."""
        return CanopenDriveConfig(
            bus=bus or self.bus,
            node_id=self.node_id,
            period_ns=period_ns,
            counts_per_rev=self.counts,
            velocity_units_per_rps=self.velocity_units_per_rps,
            torque_constant_nm_per_a=torque_constant_nm_per_a,
            rated_torque_nm=self.rated_torque_nm,
            rated_current_a=self.rated_current_a,
            rated_torque_unit_nm=RATED_TORQUE_UNITS[self.rated_torque_unit],
            inverted=self.inverted,
            bitrate_hz=self.bitrate_hz,
            master_id=self.master_id,
            status_every=self.status_every,
            status_event=self.status_event,
            heartbeat_ms=self.heartbeat_ms,
            heartbeat_timeout_ms=self.heartbeat_timeout_ms,
            drive_heartbeat_ms=self.drive_heartbeat_ms,
            command_timeout_ms=self.command_timeout_ms,
            abort_connection_option=self.abort_connection_option,
            quick_stop_option=self.quick_stop_option,
            fault_reaction_option=self.fault_reaction_option,
            max_torque_permille=self.max_torque_permille,
            sdo=tuple(entry.write() for entry in self.sdo),
            warning_codes=tuple(self.warning_codes),
            unserved_status_bits=tuple(self.unserved_status_bits),
            listen_s=self.listen_s,
            answer_timeout_s=self.answer_timeout_s,
            attempts=self.attempts,
            start_timeout_s=self.start_timeout_s,
            eds=self.eds,
        )


class AxisFile(Record):
    """An axis: one drive, one model, one loop."""

    format: Annotated[str, formats.AXIS.key] = formats.AXIS.word
    name: Annotated[str, Field(pattern=r"^[\w.-]+$")]
    drive: Annotated[SimulatedDriveSection | CanopenDriveSection, Field(discriminator="kind")]
    model: Annotated[str, Field(description="model file, relative to this file")]
    controller: ControllerSection
    envelope: EnvelopeSection
    loop: LoopSection = LoopSection()
    realtime: RealtimeSection = RealtimeSection()
    recording: RecordingSection = RecordingSection()
    profile: ProfileSection
    daemon: DaemonSection = DaemonSection()
    commissioning: Annotated[
        str | None,
        Field(description="record of `fffo-drive commission`, relative to this file; a drive on a bus needs one"),
    ] = None

    @model_validator(mode="after")
    def _consistent(self) -> AxisFile:
        unknown = sorted(set(self.envelope.reactions) - set(TRIP_NAMES))
        if unknown:
            raise ValueError(f"envelope.reactions: unknown trip '{unknown[0]}'; known: {', '.join(TRIP_NAMES)}")
        return self


def read_axis(path: str | Path) -> AxisFile:
    """Read and check an axis file. Raises DocumentError with every error in it."""
    axis = load(path, AxisFile)
    sections = {"profile": axis.profile, **{f"daemon.profiles.{name}": s for name, s in axis.daemon.profiles.items()}}
    found = [(key, text) for key, section in sections.items() for text in length_problems(section, axis.loop)]
    refuse(path, [(key, text.removeprefix("profile: ")) for key, text in found])
    return axis


def beside(path: str | Path, name: str) -> Path:
    """A file named in another one: relative names are relative to that file."""
    return Path(path).parent / name


def controller_config(axis: AxisFile, model: ModelFile) -> ControllerConfig:
    """The law's constants from the file and the model."""
    section, friction = axis.controller, model.friction_config()
    observer = ObserverConfig(
        friction,
        section.observer.gain_nm_per_rev,
        section.observer.clamp_ratio * friction.static_nm,
        section.observer.feedback_band_rps,
    )
    return ControllerConfig(
        PiConfig(section.proportional_a_per_rps, section.integral_a_per_rev),
        observer,
        feedforward_config(section.feedforward, model, axis.loop.period_s),
        model.torque_constant_nm_per_a,
        section.current_limit_a,
        axis.loop.period_s,
        error_share(section.error_filter_s, axis.loop.period_s),
    )


def error_share(time_constant_s: float, period_s: float) -> float:
    """Share of a new error that a first-order low-pass takes in a period."""
    return -math.expm1(-period_s / time_constant_s) if time_constant_s > 0.0 else 1.0


def feedforward_config(section: FeedforwardSection, model: ModelFile, period_s: float) -> FeedforwardConfig:
    """Shifts of the reference. A command is held for a period: on average it acts half of one later than its delay.

    Read ahead, the shaft follows on time and the feedback shows it a sensor's delay later; not read ahead, torque and
    feedback are the whole delay behind.
    """
    axis = model.axis_config()
    whole_s, sensor_s = axis.delay_s + 0.5 * period_s, model.sensor_delay_s.value
    behind_s = sensor_s if section.preview else whole_s
    return FeedforwardConfig(
        axis.inertia_nm_s2_per_rev if section.inertia else 0.0,
        (whole_s - sensor_s) / period_s if section.preview else 0.0,
        behind_s / period_s if section.delay_aware else 0.0,
    )


def envelope_config(axis: AxisFile) -> env.EnvelopeConfig:
    """The envelope's constants."""
    section = axis.envelope
    reactions = env.default_reactions()
    for name, reaction in section.reactions.items():
        reactions[TRIP_NAMES[name]] = REACTIONS[reaction]
    low_rev, high_rev = section.position_window_rev or (-np.inf, np.inf)
    return env.EnvelopeConfig(
        section.current_limit_a,
        section.slew_a_per_s,
        section.speed_limit_rps,
        section.continuous_current_a,
        section.i2t_time_s,
        section.i2t_action == "trip",
        float(low_rev),
        float(high_rev),
        section.following_error_rps,
        section.following_error_s,
        section.feedback_missing_ticks,
        section.status_missing_ticks,
        round(section.heartbeat_timeout_s * NS_PER_S),
        axis.loop.period_s,
        reactions,
    )


def loop_config(axis: AxisFile) -> LoopConfig:
    """Times of the loop."""
    loop = axis.loop
    period_ns = NS_PER_S // loop.rate_hz
    return LoopConfig(
        period_ns,
        round(loop.cutoff_share * period_ns),
        round(loop.late_share * period_ns),
        round(loop.minimum_gap_share * period_ns),
        round(STOP_S * loop.rate_hz),
        round(loop.tail_s * loop.rate_hz),
        0,
        enable_delay_ticks=round(axis.drive.enable_delay_s * loop.rate_hz),
        served_status_bits=WATCHED_STATUS_BITS & ~sum(1 << bit for bit in set(axis.drive.unserved_status_bits)),
    )


def realtime_request(axis: AxisFile) -> RealtimeRequest:
    """What the loop's thread asks the system for."""
    section = axis.realtime
    cpu = {"last": -1, "any": -2}.get(str(section.cpu))
    return RealtimeRequest(section.priority, int(section.cpu) if cpu is None else cpu, section.lock_memory)


def session_config(
    axis: AxisFile, model: ModelFile, longest_profile: int, ring_rows: int | None = None
) -> SessionConfig:
    """Everything that a session is made from. `ring_rows`: None for what a recorder beside the loop needs."""
    return SessionConfig(
        loop_config(axis),
        controller_config(axis, model),
        envelope_config(axis),
        realtime_request(axis),
        axis.realtime.required,
        longest_profile,
        ring_rows or round(RING_S * axis.loop.rate_hz),
        compensation_table(axis, model),
        model_note(model),
    )


def model_note(model: ModelFile) -> ModelNote:
    """The model as a record of a run holds it."""
    return ModelNote(model.name, content_hash(model), model_text(model))


def recorder_settings(axis: AxisFile) -> RecorderSettings:
    """How the recorder works, from the file."""
    section = axis.recording
    return RecorderSettings(
        flush_interval_s=section.flush_interval_s,
        fsync_interval_s=section.fsync_interval_s,
        compression=section.compression,
        rotation=RotationPolicy(section.rotate_bytes, section.rotate_s, section.quota_bytes),
    )


def build_profile(section: ProfileSection, period_s: float) -> Profile:
    """Sample the profile of a file. `length_problems` is asked first: a day at 2 kHz takes gigabytes."""
    if isinstance(section, PaperProfile):
        return paper_reference(
            section.duration_s, period_s, section.low_rps, section.high_rps, section.lowest_hz, section.highest_hz,
            section.lines, section.slope, section.seed,
        )  # fmt: skip
    if isinstance(section, IdentifyProfile):
        return identification_sequence(
            section.duration_s, period_s, section.low_a, section.high_a, section.lowest_hz, section.highest_hz
        )
    if isinstance(section, FrfProfile):
        return frequency_response_chirp(
            section.duration_s, period_s, section.amplitude_a, section.lowest_hz, section.highest_hz
        )
    if isinstance(section, RecipeProfile):
        return separating_recipe(period_s, section.high_rps, section.acceleration_rps2, section.repeats)
    if isinstance(section, DecideProfile):
        return deciding_motion(
            section.effect, period_s, section.high_rps, section.acceleration_rps2, section.amplitude_a
        )
    mode = MODE_CURRENT if section.mode == "current" else MODE_VELOCITY
    if isinstance(section, SineProfile):
        return sine("sine", mode, section.duration_s, period_s, section.amplitude, section.frequency_hz)
    times, levels = np.array(section.points, dtype=np.float64).T
    return piecewise_linear("points", mode, period_s, times, levels)


def deciding_section(axis: AxisFile, effect: str) -> DecideProfile:
    """The motion that decides about an effect, inside the limits of an axis; as fast as its own profile goes.

    The effect's name must be known.
    """
    limits, own = axis.envelope, axis.profile
    high_rps = own.high_rps if isinstance(own, PaperProfile | RecipeProfile) else math.inf
    return DecideProfile(
        kind="decide",
        effect=effect,
        high_rps=min(high_rps, DecideProfile.model_fields["high_rps"].default, SPEED_SHARE * limits.speed_limit_rps),
        amplitude_a=CHIRP_SHARE * limits.continuous_current_a,
    )


def model_of(path: str | Path, axis: AxisFile) -> ModelFile:
    """The model file that an axis file names. Raises DocumentError."""
    return read_model(beside(path, axis.model))
