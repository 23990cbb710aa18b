"""The loop rate that drive, bus and machine allow, measured with SYNC and feedback, without voltage.

The loop is the one that will run later, with its session, port and cut-off. No torque is requested: the drive is
brought up as for a run but stays without voltage.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..can import frame as can
from ..can.bpf import CanFilter
from ..can.frame import longest_bits, pack_frame, unpack_frame
from ..can.link import LinkError, open_link
from ..config.axis import AxisFile
from ..config.checks import bus_problems
from ..config.drive_section import CanopenDriveSection
from ..config.sections import LoopSection
from ..config.session import session_config
from ..drive.canopen.config import CanopenDriveConfig, load_of
from ..drive.canopen.drive import CanopenDrive
from ..drive.canopen.object_map import MappingError
from ..drive.canopen.service import READ_DEVICE_TYPE
from ..drive.canopen.silence import RPDO_TIMER
from ..drive.port import BusUnavailableError, DriveError
from ..model.parameters import ModelFile
from ..recording.ring_reader import RingReader
from ..runtime.session import OnPaper, Session
from ..system.bus import bus_findings
from ..system.findings import Severity, Wanted
from ..system.host import Host
from ..system.lateness import MOST_LATE
from ..units import NS_PER_S

RATES_HZ = (500, 1000, 2000)
LISTEN_S = 0.1  # before each rate; the bus was listened to before
PATIENCE_MS = 1000  # for which the drive tolerates a silent PC during the measurement
SETTLE_S = 0.3  # the first ticks of a loop are not typical
MOST_MISSING = 0.001  # share of SYNCs without an answer in time
TURNAROUND_SHARE = 0.8  # of the cut-off: 99 % of the answers come within it
ROUND_TRIPS = 100
ROUND_TRIP_TIMEOUT_S = 0.3
SDO_BYTES = 8
NO_SCALE = 1.0  # only identifiers and lengths matter here
PERCENTILES = (50.0, 99.0, 100.0)

Rows = np.ndarray[Any, np.dtype[np.void]]


class Spread(NamedTuple):
    """Distribution of times, microseconds."""

    median: float
    most: float  # 99 % are within it
    highest: float

    @property
    def text(self) -> str:
        """median/99 %/highest."""
        return f"{self.median:.0f}/{self.most:.0f}/{self.highest:.0f}"


class RoundTrip(NamedTuple):
    """Of SDO requests, one at a time."""

    adapter_us: Spread  # until the request itself is reported as sent: kernel, adapter, and its time on the wire
    answer_us: Spread  # until the drive's SDO answer is here


class RateTrial(NamedTuple):
    """Trial of one rate. Times in microseconds."""

    rate_hz: int
    refused: str = ""  # why it could not be tried; the rest is then empty
    ticks: int = 0
    missing: int = 0  # no answer before the cut-off
    late: int = 0  # woke later than loop.late_share of the period
    skipped: int = 0  # deadlines that passed while the loop could not run
    longest_gap: int = 0  # periods in a row without feedback
    turnaround_us: Spread = Spread(0.0, 0.0, 0.0)  # SYNC sent to feedback received
    jitter_us: float = 0.0  # standard deviation of the turnaround
    lateness_us: Spread = Spread(0.0, 0.0, 0.0)
    sync_jitter_us: float = 0.0  # standard deviation of the distance between two SYNCs
    busy_us: Spread = Spread(0.0, 0.0, 0.0)  # from waking to the command sent
    bus_load: float = 0.0  # worst case, 0 to 1
    refusals: tuple[str, ...] = ()  # real-time properties that the system refused


def trial_of(rows: Rows, rate_hz: int, bus_load: float, refusals: tuple[str, ...] = ()) -> RateTrial:
    """Result of a trial from the rows of its loop. Rows without a tick that ran are refused."""
    if rows.size == 0:
        return RateTrial(rate_hz, "the loop did not run")
    period_ns = NS_PER_S // rate_hz
    answered = rows["turnaround_ns"] >= 0
    turnaround_us = rows["turnaround_ns"][answered] / 1e3
    woke_ns = rows["deadline_ns"] + rows["lateness_ns"]
    apart = np.diff(rows["tick"].astype(np.int64))
    return RateTrial(
        rate_hz,
        "" if turnaround_us.size else "no feedback after SYNC: see the PDO mapping and loop.cutoff_share",
        int(rows.size),
        int(np.count_nonzero(~answered)),
        int(rows["late"].sum()),
        int(rows["tick"][-1] - rows["tick"][0] + 1 - rows.size),
        _longest_gap(rows["tick"].astype(np.int64), answered),
        _spread(turnaround_us),
        float(turnaround_us.std()) if turnaround_us.size else 0.0,
        _spread(rows["lateness_ns"] / 1e3),
        float(np.std(np.diff(woke_ns)[apart == 1] - period_ns) / 1e3) if np.any(apart == 1) else 0.0,
        _spread(rows["busy_ns"] / 1e3),
        bus_load,
        refusals,
    )


def _longest_gap(ticks: Any, answered: Any) -> int:
    """Periods without an answer between two answers."""
    fresh = ticks[answered]
    return int(np.diff(fresh).max() - 1) if fresh.size > 1 else int(ticks[-1] - ticks[0] + 1)


def _spread(values: Any) -> Spread:
    return Spread(*(float(one) for one in np.percentile(values, PERCENTILES))) if values.size else Spread(0, 0, 0)


def objections(trial: RateTrial, loop: LoopSection) -> list[str]:
    """Why a loop should not run at the rate of a trial; empty if it fits. `loop`: its margins."""
    if trial.refused:
        return [trial.refused]
    period_us = 1e6 / trial.rate_hz
    allowed_us = TURNAROUND_SHARE * loop.cutoff_share * period_us
    found = []
    if trial.missing > MOST_MISSING * trial.ticks:
        found.append(
            f"{trial.missing} of {trial.ticks} SYNCs had no feedback before the cut-off at "
            f"{loop.cutoff_share * period_us:.0f} us"
        )
    elif trial.turnaround_us.most > allowed_us:
        found.append(
            f"the feedback takes {trial.turnaround_us.most:.0f} us (99 %), more than {allowed_us:.0f} us: "
            f"{TURNAROUND_SHARE:g} of the cut-off"
        )
    late = trial.late + trial.skipped
    if late > MOST_LATE * trial.ticks:
        found.append(
            f"this machine woke the loop late {late} times in {trial.ticks} periods (99 %: "
            f"{trial.lateness_us.most:.0f} us late); see `fffo-drive doctor`"
        )
    elif trial.busy_us.most > period_us:
        found.append(f"a tick takes {trial.busy_us.most:.0f} us (99 %) of a period of {period_us:.0f} us")
    return found


class Choice(NamedTuple):
    """The rate to write, and why the next one does not fit."""

    rate_hz: int | None  # None: none fits
    reason: str


def choose_rate(
    trials: list[RateTrial], loop: LoopSection, problems: Callable[[int], list[str]] = lambda rate_hz: []
) -> Choice:
    """The highest rate that fits, and why the next one does not. `problems`: of the timing budget of the bus."""
    ordered = sorted(trials, key=lambda one: one.rate_hz)
    against = [objections(trial, loop) or problems(trial.rate_hz) for trial in ordered]
    best = max((k for k, reasons in enumerate(against) if not reasons), default=-1)
    rate_hz = ordered[best].rate_hz if best >= 0 else None
    if best + 1 == len(ordered):
        return Choice(rate_hz, "It is the highest rate that the program tries.")
    return Choice(rate_hz, f"{ordered[best + 1].rate_hz} Hz does not fit: {'; '.join(against[best + 1])}")


def problems_at(axis: AxisFile, model: ModelFile, rate_hz: int, turnaround_us: float | None = None) -> list[str]:
    """Problems of a rate by the timing budget of the bus, with a measured turnaround (None: that of the file)."""
    section = axis.drive
    if turnaround_us is not None:
        section = section.model_copy(update={"turnaround_us": turnaround_us})
    loop = axis.loop.model_copy(update={"rate_hz": rate_hz})
    found = bus_problems(axis.model_copy(update={"loop": loop, "drive": section}), model)
    return [text.partition(": ")[2].removeprefix(f"{rate_hz} Hz; ") for text in found]


def try_rate(
    axis: AxisFile, model: ModelFile, rate_hz: int, seconds: float,
    meanwhile: Callable[[CanopenDrive], None] = lambda drive: None, host: Host | None = None,
    prepare: Callable[[Session], None] = lambda session: None,
) -> RateTrial:  # fmt: skip
    """Bring the drive up at a rate, run SYNC, measure, and leave it without voltage.

    `prepare` gets the session before the measurement, `meanwhile` the drive after it, in NMT OPERATIONAL.

    Raises BusUnavailableError when nobody answers.
    """
    section = axis.drive
    assert isinstance(section, CanopenDriveSection)
    axis = axis.model_copy(update={"loop": axis.loop.model_copy(update={"rate_hz": rate_hz})})
    if problems := problems_at(axis, model, rate_hz):
        return RateTrial(rate_hz, problems[0])
    if too_slow := adapter_problem(section.bus, rate_hz, section.bitrate_hz, host):
        return RateTrial(rate_hz, too_slow)
    config = section.drive_config(model.torque_constant_nm_per_a, NS_PER_S // rate_hz)
    config = _patient(config)
    ticks = round((SETTLE_S + seconds) * rate_hz)
    session_settings = session_config(axis, model, 2, 2 * ticks)._replace(realtime_required=False)
    try:
        drive = CanopenDrive(config)
        Session.rehearse(OnPaper(drive.rehearsal_port()), session_settings)
        drive.connect()
    except MappingError as error:
        return RateTrial(rate_hz, str(error))
    except BusUnavailableError:
        raise
    except DriveError as error:
        return RateTrial(rate_hz, str(error))
    with Session(drive, session_settings) as session:
        report = session.start()
        prepare(session)
        reader = RingReader(session.ring)
        time.sleep(SETTLE_S)
        reader.read()
        time.sleep(seconds)
        rows = reader.read().rows
        meanwhile(drive)
    return trial_of(rows, rate_hz, load_of(config).worst, report.refusals)


def _patient(config: CanopenDriveConfig) -> CanopenDriveConfig:
    """Long time-outs for a drive that is not enabled, so that short silences leave no errors in its history."""
    return dataclasses.replace(
        config,
        listen_s=LISTEN_S,
        heartbeat_timeout_ms=max(config.heartbeat_timeout_ms, PATIENCE_MS),
        command_timeout_ms=PATIENCE_MS if config.silence_detection == RPDO_TIMER else 0,
    )


def adapter_problem(bus: str, rate_hz: int, bitrate_hz: int, host: Host | None = None) -> str:
    """Why the CAN interface cannot take a rate; empty if no reason is known."""
    wanted = Wanted(rate_hz=rate_hz, bus=bus, bitrate_hz=bitrate_hz)
    failures = [one for one in bus_findings(host or Host(), wanted) if one.level is Severity.FAILURE]
    return f"{failures[0].subject}: {failures[0].text}; {failures[0].remedy}" if failures else ""


def round_trip(bus: str, node_id: int, count: int = ROUND_TRIPS) -> RoundTrip | None:
    """Times of `count` SDO requests; None if not all were answered. Raises BusUnavailableError."""
    request = pack_frame(can.SDO_REQUEST + node_id, READ_DEVICE_TYPE)
    filters = [CanFilter(can.SDO_REQUEST + node_id), CanFilter(can.SDO_RESPONSE + node_id)]
    sent_us, answered_us = [], []
    try:
        with open_link(bus, filters=filters, receive_own=True) as link:
            for _ in range(count):
                began_ns = time.monotonic_ns()
                link.send(request)
                seen: dict[int, float] = {}
                while len(seen) < len(filters):
                    raw = link.receive(ROUND_TRIP_TIMEOUT_S)
                    if raw is None:
                        return None
                    seen.setdefault(unpack_frame(raw).can_id, (time.monotonic_ns() - began_ns) / 1e3)
                sent_us.append(seen[can.SDO_REQUEST + node_id])
                answered_us.append(seen[can.SDO_RESPONSE + node_id])
    except LinkError as error:
        raise BusUnavailableError(str(error)) from error
    return RoundTrip(_spread(np.array(sent_us)), _spread(np.array(answered_us)))


def turnaround_of_drive_us(trials: list[RateTrial], trip: RoundTrip | None, axis: AxisFile) -> float | None:
    """The drive's own part of the time from SYNC to feedback, without adapter, kernel and wire.

    None if unknown: on a loopback bus all times are those of the machine.
    """
    section = axis.drive
    measured = [trial.turnaround_us.median for trial in trials if not trial.refused]
    if not measured or trip is None or not isinstance(section, CanopenDriveSection) or _is_loopback(section.bus):
        return None
    config = section.drive_config(NO_SCALE, NS_PER_S // axis.loop.rate_hz)
    bit_us = 1e6 / section.bitrate_hz
    wire_us = bit_us * (longest_bits(0) + longest_bits(config.answers[0].data_bytes))
    adapter_us = max(0.0, trip.adapter_us.median - bit_us * longest_bits(SDO_BYTES))
    return max(0.0, statistics.median(measured) - wire_us - adapter_us)


def _is_loopback(bus: str) -> bool:
    return bus.startswith("loopback:")
