"""One recorded run: a profile on a session, in simulated or wall-clock time, in a self-contained file."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from .. import __version__
from ..control.envelope import TRIP_NONE, TRIP_TEXTS
from ..control.friction_observer import TOGGLE_NAMES
from ..control.reference import Profile
from ..drive.cia402 import GOAL_DISABLED, GOAL_ENABLED, has_torque
from ..drive.port import DriveIdentity, ExchangeCounts, exchange_counts, port_now_ns
from ..jit import kernel_digest
from ..recording.events import Level
from ..recording.ring_reader import RingReader
from ..recording.settings import RecorderHooks, RecorderSettings, RecorderStatistics, RunHeader
from ..units import NS_PER_S
from . import blocks as b
from .adaptation_watch import BoundWatch
from .effect_monitor import EffectMonitor
from .session import Session

if TYPE_CHECKING:
    from ..recording.recorder import Recorder

POLL_S = 0.05
NOT_ENABLED = "the drive did not reach Operation Enabled in time"
STOP_TIMEOUT_S = 2.0  # from disabling to no torque, including the braking of a quick stop
ENABLE_TIMEOUT_S = 5.0  # from the request to the first sample of the profile
DISK_TIMEOUT_S = 30.0  # for the last rows; a disk that takes longer costs the end of the recording, not the command


class RunOutcome(NamedTuple):
    """The result of a run."""

    files: tuple[Path, ...]
    trip: int  # envelope.TRIP_*; TRIP_NONE for a run that ended as planned
    started: bool  # False: the drive never reached Operation Enabled
    exchange: ExchangeCounts  # counters of the port during the run
    recorder: RecorderStatistics
    recorder_ended: bool = True  # False: still waiting for the disk
    drive_words: str = ""  # the drive's own description of a fault
    warnings: tuple[str, ...] = ()  # warnings of the drive

    @property
    def fault_text(self) -> str | None:
        """Why the run is unusable; None if it is usable."""
        return fault_text(self.trip, self.started, self.drive_words)

    @property
    def gap_text(self) -> str | None:
        """Why the recording is incomplete; None if it is complete."""
        recorder = self.recorder
        missing = recorder.rows_dropped + recorder.rows_lost + recorder.rows_pending
        if not self.recorder_ended:
            return (
                f"the disk did not take the last rows within {DISK_TIMEOUT_S:g} s; {recorder.rows_written} are written"
            )
        if not missing and not recorder.write_errors:
            return None
        reason = recorder.last_error or "the disk was too slow for the ring"
        return f"{missing} of {missing + recorder.rows_written} rows are missing from the recording: {reason}"


def fault_text(trip: int, enabled: bool, drive_words: str) -> str | None:
    """Why a run did not end as planned, with the drive's description (`Drive.fault_words`); None if it did."""
    if trip != TRIP_NONE:
        return with_words(TRIP_TEXTS[trip], drive_words)
    return None if enabled else with_words(NOT_ENABLED, drive_words)


def with_words(text: str, drive_words: str) -> str:
    """A reason, followed by the drive's description."""
    return f"{text} ({drive_words})" if drive_words else text


def run_metadata(
    name: str, identity: DriveIdentity, toggle: int, period_s: float, extra: Mapping[str, str]
) -> dict[str, str]:
    """Contents of the metadata record of a run."""
    return {
        "axis": name,
        "controller": TOGGLE_NAMES[toggle],
        "period_s": repr(period_s),
        "fffo_drive": __version__,
        "kernels": kernel_digest(),
        "python": platform.python_version(),
        "system": " ".join(os.uname()),
        "drive": f"{identity.device_name} {identity.software_version}".strip(),
        "drive_software": identity.software_version,
        "drive_vendor": f"0x{identity.vendor_id:08X}",
        "drive_product": f"0x{identity.product_code:08X}",
        "drive_revision": f"0x{identity.revision:08X}",
        "drive_serial": f"0x{identity.serial_number:08X}",
        **extra,
    }


def record_simulated(
    session: Session, profile: Profile, toggle: int, path: Path, header: RunHeader,
    settings: RecorderSettings | None = None, hooks: RecorderHooks | None = None,
) -> RunOutcome:  # fmt: skip
    """Run in simulated time, then write all rows. The session's ring must hold the whole run."""
    from ..recording.recorder import Recorder

    hooks = hooks or RecorderHooks(clock_ns=lambda: int(port_now_ns(session.drive.port)))
    # opened before anything moves: a path that cannot be written is an error now
    recorder = Recorder(
        session.ring, path, _with_offset(header, time.time_ns()), settings, hooks, records=session.records
    )
    counted = exchange_counts(session.drive.feedback)
    before = session.status(b.PROFILE_DONE)
    warnings: list[str] = []
    session.run_profile(profile, toggle)
    started = session.status(b.PROFILE_DONE) != before
    _warn_of_bounds(session, recorder, BoundWatch(), warnings)
    words = _hear_out(session, recorder, started)
    recorder.close(_closing_facts(session, counted))
    return _outcome(session, recorder, started, counted, words)._replace(warnings=tuple(warnings))


def record_live(
    session: Session, profile: Profile, toggle: int, path: Path, header: RunHeader,
    settings: RecorderSettings | None = None, hooks: RecorderHooks | None = None,
    progress: Callable[[float], None] | None = None, monitor: EffectMonitor | None = None,
) -> RunOutcome:  # fmt: skip
    """Run in wall-clock time on a started session: enable, profile, disable. `progress` receives the share done.

    With a `monitor` the effects of the model are tested, and taken out of service if they make tracking worse.

    An exception (Ctrl-C, say) disables the drive before it goes on.
    """
    from ..recording.recorder import Recorder
    from ..recording.writer import wall_clock_offset_ns

    header = _with_offset(header, wall_clock_offset_ns())
    recorder = Recorder(
        session.ring, path, header, settings, hooks, from_now=True, records=session.records, memory=session
    )
    counted = exchange_counts(session.drive.feedback)
    recorder.start()
    warnings: list[str] = []
    try:
        session.request(b.TOGGLE, toggle)
        number = session.start_profile(profile)
        session.request(b.GOAL, GOAL_ENABLED)
        watch = _watch(session, recorder, monitor, warnings)
        started = _follow(session, profile, number, progress, watch)
        words = _hear_out(session, recorder, started)
    finally:
        session.request(b.GOAL, GOAL_DISABLED)
        _let_go(session)
        ended = recorder.stop(_closing_facts(session, counted), DISK_TIMEOUT_S)
    return _outcome(session, recorder, started, counted, words)._replace(recorder_ended=ended, warnings=tuple(warnings))


def _hear_out(session: Session, recorder: Recorder, started: bool) -> str:
    """The drive's description if a run did not end as planned, also recorded. The drive is disabled first."""
    statusword = session.stop_statusword  # before anything is changed
    session.request(b.GOAL, GOAL_DISABLED)
    trip = session.status(b.TRIP)
    if started and trip == TRIP_NONE:
        return ""
    words = session.drive.fault_words(statusword)
    recorder.event(Level.ERROR, "drive", fault_text(trip, started, words) or "")
    return words


def _warn_of_bounds(session: Session, recorder: Recorder, bounds: BoundWatch, warnings: list[str]) -> None:
    text = bounds.news(session.status(b.ADAPTED_TO_BOUND))
    if text is not None:
        warnings.append(text)
        recorder.event(Level.WARNING, "adaptation", text)


def _watch(
    session: Session, recorder: Recorder, monitor: EffectMonitor | None, warnings: list[str]
) -> Callable[[], None]:
    """Periodic checks during the run: warnings, and whether the model's effects help."""
    bounds = BoundWatch()

    def listen() -> None:
        for text in session.warnings():
            warnings.append(text)
            recorder.event(Level.WARNING, "drive", text)
        _warn_of_bounds(session, recorder, bounds, warnings)

    if monitor is None:
        return listen
    reader = RingReader(session.ring, newest=0)
    session.request(b.EFFECTS, monitor.effects)

    def look() -> None:
        listen()
        for decision in monitor.observe(reader.read().rows):
            session.request(b.EFFECTS, decision.effects)
            verdict = decision.verdict
            if verdict is not None:
                level = Level.WARNING if verdict.worse else Level.INFO
                recorder.event(level, "effects", monitor.sentence(verdict))

    return look


def _follow(
    session: Session, profile: Profile, number: int, progress: Callable[[float], None] | None,
    watch: Callable[[], None],
) -> bool:  # fmt: skip
    """Wait until the profile is done or the loop has tripped. False if the drive was never enabled."""
    deadline = time.monotonic() + ENABLE_TIMEOUT_S + session.config.loop.enable_delay_s
    started = False
    while session.running and session.status(b.TRIP) == TRIP_NONE and session.status(b.PROFILE_DONE) != number:
        sample = session.status(b.PROFILE_SAMPLE)
        started = started or sample >= 0
        if not started and time.monotonic() > deadline:
            return False
        if progress is not None and sample >= 0:
            progress(min(1.0, sample / profile.values.size))
        watch()
        time.sleep(POLL_S)
    return started or session.status(b.PROFILE_DONE) == number


def _let_go(session: Session) -> None:
    """Wait, with a timeout, until the drive has no torque, so that the recording contains the stop."""
    deadline = time.monotonic() + STOP_TIMEOUT_S
    while session.running and has_torque(session.status(b.STATUSWORD)) and time.monotonic() < deadline:
        time.sleep(POLL_S)


def _with_offset(header: RunHeader, offset_ns: int) -> RunHeader:
    return RunHeader(header.metadata, header.attachments, offset_ns)


def _closing_facts(session: Session, before: ExchangeCounts) -> dict[str, str]:
    """Summary of the run for the file."""
    exchange = exchange_counts(session.drive.feedback).since(before)
    counts = {name: str(count) for name, count in exchange._asdict().items()}
    return {"trip": TRIP_TEXTS[session.status(b.TRIP)], **counts}


def _outcome(session: Session, recorder: Recorder, started: bool, before: ExchangeCounts, words: str) -> RunOutcome:
    trip = session.status(b.TRIP)
    exchange = exchange_counts(session.drive.feedback).since(before)
    statistics = recorder.statistics
    fault = trip != TRIP_NONE
    return RunOutcome(statistics.files, trip, started or fault, exchange, statistics, drive_words=words)


def simulated_ring_rows(profile: Profile, tail_s: float, stop_s: float = 3.0) -> int:
    """Largest number of rows of a run in simulated time: profile, tail, enabling and stopping."""
    return profile.values.size + round((tail_s + stop_s) / profile.period_s)


def timestamp_name(prefix: str, now_ns: int) -> str:
    """NAME_YYYYMMDD_HHMMSS for a file, in local time."""
    return f"{prefix}_{time.strftime('%Y%m%d_%H%M%S', time.localtime(now_ns / NS_PER_S))}"
