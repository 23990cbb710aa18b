"""The axis file: drive, model, law, limits, profile. `read_axis` checks it, the rest makes the kernels' records."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from .. import formats
from ..control import envelope as env
from ..control.adaptation import NO_ADAPTATION, AdaptationConfig
from ..control.controller import ControllerConfig, RestConfig
from ..control.feedforward import FeedforwardConfig
from ..control.friction_observer import TOGGLE_NAMES, ObserverConfig
from ..control.notch import Notch, notch_config
from ..control.pi import PiConfig
from ..control.position_hold import NO_HOLD, HoldConfig, held_travel_rev
from ..control.reference import (
    MODE_CURRENT,
    MODE_VELOCITY,
    Profile,
    paper_reference,
    piecewise_linear,
    sine,
)
from ..control.stability import LinearAxis, feedback_lag_s, linear_axis, loop_delay_s
from ..control.velocity_estimator import DRIVE_VELOCITY, VelocityEstimatorConfig, estimator_config
from ..documents import (
    DocumentError,
    StrictRecord,
    check,
    did_you_mean,
    location_of,
    parse,
    read_text,
    refuse,
    require_named,
)
from ..identification.excitation import (
    deciding_motion,
    frequency_response_chirp,
    identification_sequence,
    separating_recipe,
)
from ..model.friction import FrictionConfig, least_sliding_nm
from ..model.parameters import ModelFile, content_hash, model_text, read_model
from ..recording.settings import RecorderSettings, RotationPolicy
from ..runtime.realtime import RealtimeRequest
from ..runtime.records import ModelNote
from ..runtime.tick import LoopConfig
from ..units import NS_PER_S
from .drive_profile import profile_path, shipped_profiles, with_profile
from .drive_section import DEFAULT_RESOLVER_BITS, CanopenDriveSection, SimulatedDriveSection
from .measured_axis import response_in, with_response
from .names import LONGEST_NAME, FileName
from .profile_sections import (
    DecideProfile,
    FrfProfile,
    IdentifyProfile,
    PaperProfile,
    ProfileSection,
    RecipeProfile,
    SineProfile,
)
from .sections import (
    AdaptationSection,
    ControllerSection,
    DaemonSection,
    EnvelopeSection,
    FeedforwardSection,
    LoopSection,
    RealtimeSection,
    RecordingSection,
    VelocitySection,
    length_problems,
    notch_problem,
)

if TYPE_CHECKING:
    from ..commissioning.record import ResponseRecord

BLIND_S = 2e-3  # tolerated without velocity feedback where the file does not say: 4 ticks at 2 kHz
STOP_S = 2.0  # how long a drive may take to let go of its torque
SPEED_SHARE, CHIRP_SHARE = 0.8, 0.3  # of speed limit and continuous current, for a motion that decides
TOGGLES = {name: toggle for toggle, name in TOGGLE_NAMES.items()}
TRIPS = {name: trip for trip, name in env.TRIP_NAMES.items()}
REACTIONS = {"coast": env.REACTION_COAST, "quick_stop": env.REACTION_QUICK_STOP}


class AxisFile(StrictRecord):
    """An axis: one drive, one model, one loop."""

    format: Annotated[str, formats.AXIS.key] = formats.AXIS.word
    name: Annotated[
        str,
        Field(
            pattern=r"^[\w.-]+$",
            max_length=LONGEST_NAME,
            description="names recordings and, outside systemd, the sockets of `serve`; letters, digits, _ . -",
        ),
    ]
    drive: Annotated[
        SimulatedDriveSection | CanopenDriveSection,
        Field(discriminator="kind", description="the drive: on a CAN bus, or simulated in process"),
    ]
    model: Annotated[FileName, Field(description="model file, relative to this file")]
    controller: ControllerSection
    envelope: EnvelopeSection
    loop: LoopSection = LoopSection()
    realtime: RealtimeSection = RealtimeSection()
    recording: RecordingSection = RecordingSection()
    profile: Annotated[ProfileSection, Field(description="default motion of `run`, `ctl start` and `evaluate`")]
    daemon: DaemonSection = DaemonSection()
    commissioning: Annotated[
        FileName | None,
        Field(description="record of `fffo-drive commission`, relative to this file; a drive on a bus needs one"),
    ] = None

    # what commissioning measured, or why its record cannot be read, as it was when the file was
    _response: ResponseRecord | DocumentError | None = PrivateAttr(default=None)

    def response(self) -> ResponseRecord | None:
        """What commissioning measured; None where the file names no record, or a record without it.

        An axis file of `bring-up` names its record before there is one. Raises DocumentError for one that was edited.
        """
        if isinstance(self._response, DocumentError):
            raise self._response
        return self._response

    @model_validator(mode="after")
    def _consistent(self) -> AxisFile:
        unknown = sorted(set(self.envelope.reactions) - set(TRIPS))
        if unknown:
            raise ValueError(
                f"envelope.reactions.{unknown[0]}: no trip has this name: {did_you_mean(unknown[0], TRIPS)}"
            )
        largest_rps = self.daemon.set_points.largest_rps
        if largest_rps is not None and largest_rps > self.envelope.speed_limit_rps:
            raise ValueError("daemon.set_points.largest_rps: it must not exceed envelope.speed_limit_rps")
        problem = notch_problem(self.controller, self.loop)
        if problem is not None:
            raise ValueError(problem)
        return self


def blind_ticks(axis: AxisFile) -> int:
    """Ticks without velocity feedback after which the envelope trips."""
    return axis.envelope.feedback_missing_ticks or default_blind_ticks(axis.loop.rate_hz)


def default_blind_ticks(rate_hz: float) -> int:
    """Where the file does not say."""
    return max(1, int(BLIND_S * rate_hz))


def read_axis(path: str | Path) -> AxisFile:
    """Read and check an axis file. Raises DocumentError with every error in it."""
    path = Path(path)
    data, lines = parse(read_text(path), str(path))
    axis = check(with_profile(data, path), AxisFile, str(path), lines)
    sections = {"profile": axis.profile, **{f"daemon.profiles.{name}": s for name, s in axis.daemon.profiles.items()}}
    found = [(key, text) for key, section in sections.items() for text in length_problems(section, axis.loop)]
    refuse(path, [(key, text.removeprefix("profile: ")) for key, text in found])
    if axis.commissioning is not None:
        try:
            axis._response = response_in(beside(path, axis.commissioning))
        except DocumentError as error:  # to commission it again, the file must be readable
            axis._response = error
    return axis


def with_keys(axis: AxisFile, keys: Mapping[str, Any], name: str) -> AxisFile:
    """An axis file with other values by dotted key (controller.observer.toggle); `name` begins each error.

    Raises DocumentError with every error.
    """
    content = axis.model_dump()
    for key, value in keys.items():
        *sections, last = location_of(key)
        inner: Any = content
        for section in sections:
            there = inner if isinstance(inner, dict) else dict(enumerate(inner or ()))
            if section not in there:
                known = did_you_mean(str(section), map(str, there))
                raise DocumentError(f"{name}: {key}: no section {section!r}: {known}")
            inner = there[section]
        inner[last] = value
    changed = check(content, AxisFile, name)
    changed._response = axis._response
    return changed


def rebased(data: Mapping[str, Any], source: Path, out: Path) -> dict[str, Any]:
    """A parsed axis file with the names of other files as they are from the directory `out`."""
    moved = {**data, "drive": dict(data["drive"])}
    drive = moved["drive"]
    for place, key in ((moved, "model"), (moved, "commissioning"), (drive, "file"), (drive, "eds")):
        if place.get(key):
            place[key] = os.path.relpath(beside(source, place[key]).resolve(), out.resolve())
    family = profile_path(source, drive["profile"]) if drive.get("profile") else None
    if family is not None and family not in shipped_profiles().values():
        drive["profile"] = os.path.relpath(family.resolve(), out.resolve())
    return moved


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
        section.observer.learns_in == "integral",
    )
    return ControllerConfig(
        PiConfig(section.proportional_a_per_rps, section.integral_a_per_rev),
        observer,
        feedforward_config(section.feedforward, model, axis.loop.period_s, section.velocity),
        model.torque_constant_nm_per_a,
        section.current_limit_a,
        axis.loop.period_s,
        error_share(section.error_filter_s, axis.loop.period_s),
        rest_config(axis, model),
        velocity_config(axis, model),
        adaptation_config(section.adaptation, friction, axis.loop.period_s),
        notch_config(notches_of(section), axis.loop.period_s),
    )


def notches_of(section: ControllerSection) -> tuple[Notch, ...]:
    """The notches on the error."""
    return tuple(Notch(one.frequency_hz, one.width, one.depth) for one in section.notches)


def adaptation_config(section: AdaptationSection, friction: FrictionConfig, period_s: float) -> AdaptationConfig:
    """What is learned in service, and within which bounds."""
    if not section.enabled:
        return NO_ADAPTATION
    return AdaptationConfig(
        True,
        period_s / section.time_s,
        section.bound_share * friction.coulomb_nm,
        section.bound_share * friction.viscous_nm_per_rps,
    )


def velocity_config(axis: AxisFile, model: ModelFile) -> VelocityEstimatorConfig:
    """The velocity that the error takes. What the axis at its limits cannot do is no motion: jump, disagreement."""
    section, limits = axis.controller.velocity, axis.envelope
    if not section.estimated:
        return DRIVE_VELOCITY
    config = model.axis_config()
    return estimator_config(
        section.bandwidth_hz,
        config.inertia_nm_s2_per_rev,
        config.torque_constant_nm_per_a,
        config.delay_s - model.sensor_delay_s.value,
        axis.loop.period_s,
        limits.speed_limit_rps,
        limits.following_error_rps,
    )


def loop_axis(axis: AxisFile, model: ModelFile) -> LinearAxis:
    """The sliding axis as the loop of this file meets it, and as commissioning measured it: delay, filter and notches
    of the error, and its loads. Raises DocumentError for a record that was edited.
    """
    section = axis.controller
    known = linear_axis(
        model, axis.loop.period_s, velocity_config(axis, model), section.error_filter_s, section.inertia_range_kg_m2
    )
    known = known._replace(notches=notches_of(section))
    response = axis.response()
    return known if response is None else with_response(known, model, response)


def default_axis(
    model: ModelFile, period_s: float, inertia_range_kg_m2: tuple[float, float] | None = None
) -> LinearAxis:
    """The same for a file whose law is the default."""
    filter_s = ControllerSection.model_fields["error_filter_s"].default
    return linear_axis(model, period_s, None, filter_s, inertia_range_kg_m2)


def rest_config(axis: AxisFile, model: ModelFile) -> RestConfig:
    """What changes at rest."""
    section = axis.controller.at_rest
    fade_share = error_share(section.time_s, axis.loop.period_s)
    release_share = fade_share if section.release_friction else 0.0
    return RestConfig(section.gain_share, fade_share, release_share, hold_config(axis, model))


def hold_config(axis: AxisFile, model: ModelFile) -> HoldConfig:
    """The position hold: no finer than its resolution, and over no more than the contact's travel, 1/K."""
    section, friction = axis.controller.at_rest, model.friction_config()
    if section.hold_a_per_rev_s == 0.0:
        return NO_HOLD
    dead_band_rev = hold_dead_band_rev(axis)
    least_nm = least_sliding_nm(friction, axis.envelope.speed_limit_rps)
    return HoldConfig(
        section.hold_a_per_rev_s,
        dead_band_rev,
        held_travel_rev(friction.stiffness_per_rev, dead_band_rev),
        section.hold_bound_share * least_nm / model.torque_constant_nm_per_a,
    )


def hold_dead_band_rev(axis: AxisFile | None) -> float:
    """The distance that the hold does not correct: the resolution of the position, unless the file has one."""
    counts = 2.0**DEFAULT_RESOLVER_BITS
    if axis is None:
        return 1.0 / counts
    if isinstance(axis.drive, CanopenDriveSection):
        counts = axis.drive.counts
    return axis.controller.at_rest.hold_dead_band_rev or 1.0 / counts


def error_share(time_constant_s: float, period_s: float) -> float:
    """Share of a new error that a first-order low-pass takes in a period."""
    return -math.expm1(-period_s / time_constant_s) if time_constant_s > 0.0 else 1.0


def feedforward_config(
    section: FeedforwardSection, model: ModelFile, period_s: float, velocity: VelocitySection | None = None
) -> FeedforwardConfig:
    """Shifts of the reference. A command is held for a period: on average it acts half of one later than its delay.

    Read ahead, the shaft follows on time and the feedback shows it a sensor's delay later; not read ahead, torque and
    feedback are the whole delay behind. `velocity`: what the error takes; None: the drive's own.
    """
    axis = model.axis_config()
    estimated = velocity is not None and velocity.estimated
    whole_s, sensor_s = loop_delay_s(model, period_s, estimated), feedback_lag_s(model, estimated)
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
        reactions[TRIPS[name]] = REACTIONS[reaction]
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
        blind_ticks(axis),
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
        served_status_bits=axis.drive.served_status_bits,
    )


def realtime_request(axis: AxisFile) -> RealtimeRequest:
    """What the loop's thread asks the system for."""
    section = axis.realtime
    cpu = {"last": -1, "any": -2}.get(str(section.cpu))
    return RealtimeRequest(section.priority, int(section.cpu) if cpu is None else cpu, section.lock_memory)


def model_note(model: ModelFile) -> ModelNote:
    """The model as a record of a run holds it."""
    return ModelNote(model.name, content_hash(model), model_text(model))


def recorder_settings(axis: AxisFile, of_service: bool = False) -> RecorderSettings:
    """How the recorder works, from the file. Only a service has a quota: a single run deletes nothing."""
    section = axis.recording
    quota_bytes = section.quota_bytes if of_service else None
    return RecorderSettings(
        flush_interval_s=section.flush_interval_s,
        fsync_interval_s=section.fsync_interval_s,
        compression=section.compression,
        rotation=RotationPolicy(section.rotate_bytes, section.rotate_s, quota_bytes),
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
    return read_model(require_named(path, "model", beside(path, axis.model)))
