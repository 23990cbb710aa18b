"""Sections of an axis file: control law, envelope, loop, recording, service. Each key states its range and meaning."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, Strict, model_validator

from ..control.notch import HIGHEST_NOTCH_SHARE, MOST_NOTCHES
from ..documents import StrictRecord
from ..formats import PAPER_LAW, over
from .address import Listen
from .names import FileName
from .profile_sections import ProfileSection, Rps, duration_s

Amperes = Annotated[float, Field(gt=0, le=1000)]
Pair = Annotated[tuple[float, float], Strict(False)]  # a list of two numbers, in YAML and JSON
Reaction = Literal["coast", "quick_stop"]


LEAST_PERIODS = 2  # of a profile: it has a slope


class ObserverSection(StrictRecord):
    """Friction observer."""

    toggle: Annotated[Literal["off", "ff", "fb"], Field(description="friction from reference, feedback, or off")] = "ff"
    gain_nm_per_rev: Annotated[float, Field(ge=0, le=1e4, description="L of lambda(e) = L e")] = 5.0
    learns_in: Annotated[
        Literal["friction", "integral"],
        Field(
            description="where L e is added: to the friction estimate (the paper), or to the integral, where it does "
            "not decay"
        ),
    ] = "integral"
    clamp_ratio: Annotated[float, Field(ge=1, le=10, description="bound of the estimate, in multiples of Fs")] = 2.0
    feedback_band_rps: Annotated[
        float, Field(ge=0, le=10, description="dead band: a smaller measured velocity does not reverse the model")
    ] = 0.1


class FeedforwardSection(StrictRecord):
    """Feed-forward beyond the paper: each part has its own switch and its own term in the row."""

    inertia: Annotated[bool, Field(description="inertia torque of the reference")] = True
    preview: Annotated[bool, Field(description="read the reference ahead, so that torque arrives on time")] = True
    delay_aware: Annotated[bool, Field(description="compare the feedback with a reference of the same age")] = True


class EffectsSection(StrictRecord):
    """Feed-forward of the model's effects. An effect that depends on the angle needs an absolute angle."""

    compensate: Annotated[bool, Field(description="add the torque of the model's effects to the command")] = True
    out_of_service: Annotated[list[str], Field(description="effects of the model that are not compensated")] = Field(
        default_factory=list
    )
    each_limit_share: Annotated[
        float,
        Field(
            gt=0, le=1, description="bound of the torque of each effect, as a share of the torque at current_limit_a"
        ),
    ] = 0.25
    total_limit_share: Annotated[float, Field(gt=0, le=1, description="bound of the sum of all effects, likewise")] = (
        0.4
    )
    monitor: Annotated[
        bool, Field(description="compare windows with and without the effects; remove effects that make tracking worse")
    ] = True
    monitor_window_s: Annotated[
        float, Field(ge=0.05, le=60, description="length of such a window: at least one cycle of a repetitive motion")
    ] = 1.0


class RestSection(StrictRecord):
    """Behaviour while the reference is zero."""

    gain_share: Annotated[float, Field(gt=0, le=1, description="share of Kp and Ki that acts at rest")] = 0.5
    release_friction: Annotated[
        bool, Field(description="let the friction estimate decay at rest, so that it does not push the axis")
    ] = True
    time_s: Annotated[
        float, Field(ge=0.001, le=10, description="time constant of the change of gains and of this decay")
    ] = 0.1
    hold_a_per_rev_s: Annotated[
        float,
        Field(
            ge=0,
            le=1e7,
            description="integral gain of the position hold, A per rev and second; the margins at rest count "
            "it, `tune` chooses it; 0: no hold",
        ),
    ] = 0.0
    hold_dead_band_rev: Annotated[
        float | None,
        Field(gt=0, le=0.1, description="dead band of the hold, rev; null: one count of the position"),
    ] = None
    hold_bound_share: Annotated[
        float,
        Field(
            gt=0,
            le=0.8,
            description="bound of the hold's torque: share of the model's least sliding friction at any speed up "
            "to envelope.speed_limit_rps. The hold never pushes the axis, a hand or an end stop harder than this",
        ),
    ] = 0.5


class NotchSection(StrictRecord):
    """A notch filter on the error, against a resonance. Feed-forward does not pass it; the margins count it."""

    frequency_hz: Annotated[
        float,
        Field(ge=1, le=1600, description=f"frequency of the notch; at most {HIGHEST_NOTCH_SHARE:g} of loop.rate_hz"),
    ]
    width: Annotated[
        float,
        Field(
            ge=0.05,
            le=4,
            description="width of the band over the frequency, twice the damping ratio of the poles: wider covers a "
            "resonance that is known less well, and takes more phase below it",
        ),
    ] = 1.0
    depth: Annotated[
        float, Field(ge=0, le=0.95, description="gain at the frequency; 0: nothing passes, near 1: no notch")
    ] = 0.1


VelocitySource = Literal["drive", "estimated"]


class VelocitySection(StrictRecord):
    """The velocity from which the error is computed."""

    source: Annotated[
        VelocitySource,
        Field(
            description="drive: measured by the drive; estimated: from position and torque, without the lag of the "
            "drive's tracking loop. The row and the envelope always use the drive's velocity"
        ),
    ] = "drive"
    bandwidth_hz: Annotated[
        float,
        Field(
            gt=1,
            le=400,
            description="bandwidth of the estimate: (q / (J^2 r T))^(1/6) / (2 pi), with q the disturbance's density "
            "(Nm^2/s) and r the variance of the position; higher: more noise, lower: smaller margins",
        ),
    ] = 200.0

    @property
    def estimated(self) -> bool:
        """Whether the error uses the estimate."""
        return self.source == "estimated"


class AdaptationSection(StrictRecord):
    """Adaptation to slow change of offset, Coulomb and viscous friction, from the torque that the feedback adds."""

    enabled: Annotated[
        bool,
        Field(
            description="adapt while friction is computed from the reference (toggle ff); requires "
            "observer.learns_in: integral"
        ),
    ] = False
    time_s: Annotated[float, Field(ge=5, le=3600, description="time constant, counted during motion only")] = 30.0
    bound_share: Annotated[
        float,
        Field(
            gt=0,
            le=1,
            description="bound of each: of the model's Coulomb friction (for offset and Coulomb friction) and of its "
            "viscous friction; none changes by more than its bound in time_s",
        ),
    ] = 0.5


def refuse_adaptation_beside(learns_in: str, feedforward: FeedforwardSection) -> None:
    """Raise ValueError if the P and I terms do not equal the torque that the model lacks."""
    if learns_in != "integral":
        raise ValueError(
            "adaptation.enabled: the adaptation learns from the integral, so learns_in must be 'integral': it does "
            "not see what the friction estimate learns"
        )
    off = [f"feedforward.{part}" for part in FeedforwardSection.model_fields if not getattr(feedforward, part)]
    if off:
        raise ValueError(
            f"adaptation.enabled: needs {', '.join(off)}: without them the P and I terms contain more than friction, "
            "and all of it would be learned as friction"
        )


def ordered_range(low: float, high: float) -> tuple[float, float]:
    """The ends of a range of inertia. Raises ValueError where they are none."""
    if not 0.0 < low <= high < math.inf:
        raise ValueError(f"{low:g} to {high:g}: the least inertia, above 0, and then the largest are needed")
    return low, high


class ControllerSection(StrictRecord):
    """PI with friction observer."""

    proportional_a_per_rps: Annotated[float, Field(gt=0, le=1e4, description="Kp")]
    integral_a_per_rev: Annotated[float, Field(ge=0, le=1e6, description="Ki = Kp / Ti")]
    current_limit_a: Annotated[Amperes, Field(description="bound of the controller's command, A")]
    error_filter_s: Annotated[
        float, Field(ge=0, le=0.1, description="time constant of a low-pass on the error; the margins include it")
    ] = 0.0002
    observer: Annotated[ObserverSection, Field(description="the friction observer")] = ObserverSection()
    at_rest: Annotated[RestSection, Field(description="gains and friction term at standstill")] = RestSection()
    feedforward: Annotated[FeedforwardSection, Field(description="feed-forward parts")] = FeedforwardSection()
    effects: Annotated[EffectsSection, Field(description="compensation of the model's effects")] = EffectsSection()
    phase_margin_deg: Annotated[
        float, Field(ge=0, le=90, description="smallest accepted, with the delay in the loop")
    ] = 35.0
    gain_margin: Annotated[float, Field(ge=1, le=100, description="smallest accepted")] = 2.0
    accept_unproven: Annotated[
        bool, Field(description="run although (14) or a margin is violated; row and file record this")
    ] = False
    notches: Annotated[
        list[NotchSection],
        Field(
            max_length=MOST_NOTCHES, description="notch filters on the error; `tune` chooses them for an elastic axis"
        ),
    ] = Field(default_factory=list)
    inertia_range_kg_m2: Annotated[
        Pair | None,
        AfterValidator(lambda pair: None if pair is None else ordered_range(*pair)),
        Field(
            description="[least, largest] inertia of the axis with all its loads, at the motor shaft, motor included "
            "(linear axis: mass / 2 pi); every margin holds over it. Feed-forward has the model's inertia. null: the "
            "load never changes"
        ),
    ] = None
    velocity: Annotated[VelocitySection, Field(description="velocity feedback of the error")] = VelocitySection()
    adaptation: Annotated[AdaptationSection, Field(description="adaptation to slow change")] = AdaptationSection()

    @model_validator(mode="after")
    def _one_learns(self) -> ControllerSection:
        if self.adaptation.enabled:
            refuse_adaptation_beside(self.observer.learns_in, self.feedforward)
        return self

    def changed(self, changes: Mapping[str, Any]) -> ControllerSection:
        """The section with other keys; of a section in it those that are given. Raises pydantic's ValidationError."""
        return ControllerSection.model_validate(over(self.model_dump(), changes))

    @property
    def papers(self) -> ControllerSection:
        """The law of the paper with the gains of this section: PI with friction observer, and nothing beyond it."""
        beyond = {"velocity": {"source": "drive"}, "adaptation": {"enabled": False}, "notches": []}
        return self.changed(PAPER_LAW | beyond | {"at_rest": PAPER_LAW["at_rest"] | {"hold_a_per_rev_s": 0.0}})


def best_law() -> dict[str, Any]:
    """What the law has over the paper's, as it is where a file says nothing; keys as in `PAPER_LAW`."""
    whole = ControllerSection(proportional_a_per_rps=1.0, integral_a_per_rev=0.0, current_limit_a=1.0).model_dump()
    return _part_of(whole, PAPER_LAW)


def _part_of(whole: Mapping[str, Any], keys: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: _part_of(whole[key], inner) if isinstance(inner, Mapping) else whole[key] for key, inner in keys.items()
    }


class EnvelopeSection(StrictRecord):
    """Limits applied last before the bus."""

    current_limit_a: Annotated[Amperes, Field(description="largest command, A")]
    slew_a_per_s: Annotated[float, Field(gt=0, le=1e7, description="largest slew rate of the command, A/s")] = 20_000.0
    speed_limit_rps: Annotated[Rps, Field(description="trips above this speed, rev/s")]
    continuous_current_a: Annotated[Amperes, Field(description="largest permanent current (I2t), A")]
    i2t_time_s: Annotated[
        float, Field(gt=0, le=600, description="how long current_limit_a is allowed from cold, s")
    ] = 2.0
    i2t_action: Annotated[
        Literal["trip", "limit"],
        Field(description="when the I2t budget is used up: trip, or limit to continuous_current_a"),
    ] = "trip"
    position_window_rev: Annotated[Pair | None, Field(description="[low, high]; null: unlimited rotation")] = None
    following_error_rps: Annotated[
        Rps,
        Field(
            description="trips when the velocity error exceeds this for longer than following_error_s, rev/s; also "
            "when it alternates at 10 Hz or faster"
        ),
    ]
    following_error_s: Annotated[
        float,
        Field(
            gt=0,
            le=60,
            description="time allowed beyond following_error_rps, and for a command that reverses at its limit at "
            "10 Hz or faster (trip oscillation), s",
        ),
    ] = 0.2
    feedback_missing_ticks: Annotated[
        int | None,
        Field(
            ge=1,
            le=10_000,
            description="trips after this many ticks without velocity feedback; null: as many as last 2 ms. What the "
            "axis can gain in them, at current_limit_a, must stay below a fifth of speed_limit_rps",
        ),
    ] = None
    accept_runaway: Annotated[
        bool,
        Field(
            description="run although the axis can gain more speed than that without feedback: for a simulated drive "
            "on a machine that does not keep time; reported each time"
        ),
    ] = False
    status_missing_ticks: Annotated[
        int, Field(ge=1, le=100_000, description="trips after this many ticks without a statusword")
    ] = 100
    heartbeat_timeout_s: Annotated[
        float, Field(ge=0, le=60, description="trips if the drive's heartbeat is absent for this long; 0: never")
    ] = 0.5
    reactions: Annotated[
        dict[str, Reaction], Field(description="reaction by the name of the trip, instead of the default")
    ] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _ordered(self) -> EnvelopeSection:
        if self.continuous_current_a > self.current_limit_a:
            raise ValueError("continuous_current_a must not exceed current_limit_a")
        if self.position_window_rev is not None and self.position_window_rev[0] >= self.position_window_rev[1]:
            raise ValueError("position_window_rev must be [low, high] with low < high")
        return self


class LoopSection(StrictRecord):
    """The tick: its rate, its cut-off, and what counts as late."""

    rate_hz: Annotated[int, Field(ge=50, le=4000, description="500, 1000 and 2000 are tested")] = 2000
    cutoff_share: Annotated[
        float, Field(gt=0.05, le=0.9, description="time from SYNC to the cut-off, as a share of the period")
    ] = 0.6
    late_share: Annotated[
        float, Field(gt=0, le=1, description="lateness from which a tick is late, as a share of the period")
    ] = 0.2
    minimum_gap_share: Annotated[
        float, Field(ge=0.5, le=1, description="smallest distance of two SYNCs, as a share of the period")
    ] = 0.8
    tail_s: Annotated[float, Field(ge=0, le=60, description="standstill under control after a profile")] = 0.25
    longest_profile_s: Annotated[float, Field(gt=0, le=86_400, description="a longer profile is refused, s")] = 600.0

    @property
    def period_s(self) -> float:
        """Length of a tick."""
        return 1.0 / self.rate_hz


def notch_problem(controller: ControllerSection, loop: LoopSection) -> str | None:
    """A notch that the loop is too slow for, with its key first; None if there is none."""
    highest_hz = HIGHEST_NOTCH_SHARE * loop.rate_hz
    for place, notch in enumerate(controller.notches):
        if notch.frequency_hz > highest_hz:
            return (
                f"controller.notches.{place}.frequency_hz: {notch.frequency_hz:g} Hz; at most {highest_hz:g} Hz is "
                f"possible, {HIGHEST_NOTCH_SHARE:g} of loop.rate_hz"
            )
    return None


class RealtimeSection(StrictRecord):
    """Properties of the loop's thread."""

    priority: Annotated[int, Field(ge=0, le=98, description="SCHED_FIFO; 0: ordinary scheduling")] = 60
    cpu: Annotated[int | Literal["last", "any"], Field(description="CPU of the loop")] = "last"
    lock_memory: Annotated[
        bool,
        Field(
            description="lock the memory of the whole process in RAM (mlockall), so that the loop has no page faults"
        ),
    ] = True
    required: Annotated[
        bool, Field(description="false: continue without rights that the system refuses, with a warning")
    ] = True


Bytes = Annotated[int, Field(ge=1_000_000, le=1 << 50)]


class RecordingSection(StrictRecord):
    """Where runs are recorded, the size of the files, and how much is kept."""

    directory: Annotated[FileName, Field(description="where recordings are written")] = "runs"
    compression: Annotated[Literal["zstd", "none"], Field(description="compression of the chunks")] = "zstd"
    flush_interval_s: Annotated[float, Field(ge=0.05, le=60, description="largest loss if the process is killed")] = 1.0
    fsync_interval_s: Annotated[
        float | None,
        Field(ge=0.1, le=3600, description="largest loss at a power failure; null: when the kernel writes"),
    ] = None
    rotate_bytes: Annotated[
        Bytes | None, Field(description="size at which a new file begins, bytes; null: no limit")
    ] = 1_000_000_000
    rotate_s: Annotated[
        float | None, Field(ge=1, le=86_400, description="time after which a new file begins, s; null: no limit")
    ] = 3600.0
    quota_bytes: Annotated[
        Bytes | None,
        Field(
            description="limit of the service's recordings of this axis in the directory, bytes: its oldest finished "
            "files are deleted, with an event; recordings of `run` are neither counted nor deleted; null: no limit"
        ),
    ] = 20_000_000_000

    @model_validator(mode="after")
    def _roomy(self) -> RecordingSection:
        if self.quota_bytes is not None and self.rotate_bytes is not None and self.quota_bytes < 2 * self.rotate_bytes:
            raise ValueError(
                f"quota_bytes must hold two files of rotate_bytes, {self.rotate_bytes}: one is written, one is kept"
            )
        if self.quota_bytes is not None and self.rotate_bytes is None and self.rotate_s is None:
            raise ValueError(
                "quota_bytes deletes finished files only, and without rotate_bytes and rotate_s the only one is never "
                "finished: set one of them, or quota_bytes: null"
            )
        if self.fsync_interval_s is not None and self.fsync_interval_s < self.flush_interval_s:
            raise ValueError("fsync_interval_s must be at least flush_interval_s: rows are flushed, then synced")
        return self


def length_problems(section: ProfileSection, loop: LoopSection) -> list[str]:
    """Problems with the length of a profile; to be checked before its samples are computed."""
    length_s = duration_s(section)
    if length_s > loop.longest_profile_s:
        return [f"profile: lasts {length_s:g} s, loop.longest_profile_s is {loop.longest_profile_s:g}"]
    if length_s < LEAST_PERIODS * loop.period_s:
        least = f"{LEAST_PERIODS} periods of the loop, {LEAST_PERIODS / loop.rate_hz:g} s"
        return [f"profile: lasts {length_s:g} s; at least {least}, are needed"]
    return []


class SetPointSection(StrictRecord):
    """Live set points (`ctl jog`, `velocity`, `step`) and how the reference approaches them."""

    largest_rps: Annotated[
        Rps | None, Field(description="a larger set point is refused; null: envelope.speed_limit_rps")
    ] = None
    acceleration_rps2: Annotated[float, Field(gt=0, le=1e5, description="bound of the reference's acceleration")] = 50.0
    jerk_rps3: Annotated[
        float, Field(gt=0, le=1e8, description="bound of its jerk, rps/s^2; also for stops and a lapsed lease")
    ] = 1000.0
    jog_timeout_s: Annotated[
        float, Field(ge=0.05, le=10, description="a jog or set point not renewed within this time ends at standstill")
    ] = 0.5
    window_margin_rev: Annotated[
        float,
        Field(
            gt=0,
            le=1000,
            description="distance from the edge of envelope.position_window_rev at which the axis stops; at most a "
            "tenth of the window",
        ),
    ] = 0.05


class DaemonSection(StrictRecord):
    """`fffo-drive serve`: clients and their rights, stops, recording."""

    control_group: Annotated[str | None, Field(description="group of the control socket; null: the process's own")] = (
        None
    )
    clients: Annotated[int, Field(ge=1, le=256, description="largest number of clients at a time, per socket")] = 32
    in_charge: Annotated[
        Literal["anyone", "connection"],
        Field(description="connection: only a client that stays connected (ctl enable --hold) may enable"),
    ] = "anyone"
    client_loss: Annotated[
        Literal["stop", "quick_stop", "go_on"],
        Field(description="reaction when the connection of the client in charge ends"),
    ] = "stop"
    client_silence_s: Annotated[
        float,
        Field(ge=0.2, le=60, description="a client in charge that sends nothing for this long is taken for lost"),
    ] = 1.0
    stop_rps2: Annotated[float, Field(gt=0, le=1e5, description="deceleration of a controlled stop")] = 100.0
    set_points: Annotated[SetPointSection, Field(description="limits of live set points and jogs")] = SetPointSection()
    enable_timeout_s: Annotated[float, Field(gt=0, le=60, description="from the request to Operation Enabled")] = 5.0
    stop_timeout_s: Annotated[
        float,
        Field(gt=0, le=60, description="a controlled stop that takes longer becomes a quick stop, then a fault"),
    ] = 3.0
    retry_s: Annotated[float, Field(ge=0.05, le=600, description="time between attempts to reach the drive")] = 2.0
    supervisor_timeout_s: Annotated[
        float,
        Field(ge=0.1, le=60, description="if the supervisor is silent this long, the loop makes a quick stop and ends"),
    ] = 1.0
    scope: Annotated[
        Listen | None, Field(description="[HOST:]PORT of the scope page; HOST is 127.0.0.1; null: none (extra `live`)")
    ] = None
    foxglove: Annotated[
        Listen | None, Field(description="[HOST:]PORT of the WebSocket for Foxglove and PlotJuggler; null: none")
    ] = None
    record: Annotated[Literal["on", "off"], Field(description="on: record from the start of the daemon")] = "off"
    fleet: Annotated[
        str | None,
        Field(
            description="store (directory, s3://...) that gets a record of each finished recording; null: none "
            "(extra `fleet`)"
        ),
    ] = None
    record_required: Annotated[
        bool, Field(description="true: while its recording fails, the axis is stopped and not enabled")
    ] = False
    profiles: Annotated[
        dict[str, ProfileSection], Field(description="by name, for `ctl start`; `default` is the file's own profile")
    ] = Field(default_factory=dict)
