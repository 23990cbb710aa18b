"""Logs into records: clean arrays at one rate, with all problems reported before anything is fitted."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats, Mask
from ..drive.cia402 import STATUS_INTERNAL_LIMIT
from ..importing.convert import Converted
from ..importing.log import read_log
from ..importing.read import RECORDINGS, short_name
from ..recording.errors import ForeignRecordingError, RecordingError
from ..recording.files import regular
from ..recording.reader import Run, read_run
from ..signals import TEMPERATURE
from .facts import DriveFacts
from .gaps import LogTiming, mended
from .impossible import fault_at_angle, impossible_lines, impossible_samples, resolution
from .timebase import Even, at_lower_rate, on_even_grid

SHORTEST_S = 1.0
LEAST_RATE_HZ = 20.0  # below it the filters leave hardly 1 Hz: an acceleration cannot be seen
LOW_RATE_HZ = 100.0  # below it break-aways, delay and single bad samples cannot be seen
CUTOFF_PERIODS = 0.1  # of the rate: the highest cut-off of a fit
SHORTEST_STRETCH_S = 0.1  # between gaps: data shorter than the filters' memory are useless
SHORTEST_STRETCH_SAMPLES = 20
SAME_RATE = 1e-3  # rates that differ by a smaller share are one rate
LARGEST_RATE_RATIO = 10.0  # a slower log would degrade the others too far
LEAST_MOTION_LSB = 50.0  # a record with less travel is useless
SCALE_TOLERANCE = 0.05  # of the velocity against the derivative of the position
KNOWN_FACTORS = {
    60.0: "rpm given as rps",
    1.0 / 60.0: "rps given as rpm",
    2.0 * np.pi: "rad/s given as rps",
    1.0 / (2.0 * np.pi): "rps given as rad/s, or the position is in rad",
    1.0 / 360.0: "the position is in degrees",
    360.0: "deg/s given as rps",
    -1.0: "one of the two has the wrong sign",
    0.001: "mm/s against m/s",
    1000.0: "mm/s given as m/s",
}


class DataError(RecordingError):
    """A log that cannot be used for a fit; the text says why and what to do."""


TAKEN = (  # columns of a log that a fit may use
    "time_s", "current_command_a", "current_a", "position_rev", "velocity_rps", "reference_rps",
    "reference_position_rev", "measured_torque_nm", "statusword",
)  # fmt: skip
TIMING = ("tick", "velocity_age", "lateness_ns")  # of a recording: from these follow the samples that were missed
DEADLINE, MODE = "deadline_ns", "mode"  # of a recording: its time, and where the loop applied torque
LOG_COLUMNS = (*TAKEN, *TIMING, DEADLINE, MODE, TEMPERATURE.name)
IN_WORDS = {
    "position_rev": "positions",
    "velocity_rps": "velocities",
    "current_command_a": "currents",
    "current_a": "currents",
}
LIMITED = "limited"  # a column in place of the statusword: 1 where the drive was at its limit
LIMIT_MARGIN_S = 0.01  # around a limit: the command acts late, and the current loop settles


@dataclass(frozen=True)
class Record:
    """One log, (n,) samples at one rate. For a linear axis revolutions stand for m, and Nm for N."""

    name: str
    path: Path
    period_s: float
    torque_constant_nm_per_a: float
    current_a: Floats  # the command: known without error; it acts Td later
    position_rev: Floats
    velocity_rps: Floats | None  # the drive's own estimate: late and filtered
    reference_rps: Floats | None  # None: open loop
    lsb_rev: float
    breaks: tuple[int, ...]  # samples that come after a gap
    digest: str  # SHA-256 of the file
    warnings: tuple[str, ...] = ()
    measured_current_a: Floats | None = None
    begin_s: float = 0.0  # stamp of the first sample, on the clock of the log
    good: Mask | None = None  # (n,) False where a sample was filled in; None: all were measured
    reference_position_rev: Floats | None = None  # of a reference encoder on the same shaft
    measured_torque_nm: Floats | None = None  # by a torque sensor between motor and load
    limited: Mask | None = None  # (n,) True where the drive was at its internal limit; None: nowhere, or not known
    fault: str = ""  # of the position, for which nothing that is found in the run is certain; empty: none is seen

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.current_a.size)

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return self.samples * self.period_s

    @property
    def closed_loop(self) -> bool:
        """Whether the command came from a velocity loop."""
        return self.reference_rps is not None

    def segments(self) -> list[slice]:
        """Stretches without a gap that are long enough for a filter."""
        least = max(SHORTEST_STRETCH_SAMPLES, round(SHORTEST_STRETCH_S / self.period_s))
        edges = [0, *self.breaks, self.samples]
        return [slice(a, b) for a, b in itertools.pairwise(edges) if b - a >= least]


class LogPart(NamedTuple):
    """Rows of a recording that stand for all of it."""

    rows: tuple[tuple[int, int], ...]  # from here on and before there, rising
    text: str  # which, and why


def load_record(path: str | Path, facts: DriveFacts, part: LogPart | None = None) -> Record:
    """Read one log by the declared facts, on a uniform grid (`timebase`); of a recording, if given, a part of it.

    Raises DataError with all reasons against a fit, RecordingError for a file that cannot be read.
    """
    path = Path(path)
    with regular(path).open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    record = record_of_log(path, log_of(path, facts, part), facts, digest)
    return record if part is None else replace(record, warnings=(part.text, *record.warnings))


def log_of(path: Path, facts: DriveFacts, part: LogPart | None = None) -> Run | Converted:
    """A recording as it is, any other log by the facts (`importing.log`). Raises RecordingError, OSError."""
    if path.name.endswith(RECORDINGS):
        with contextlib.suppress(ForeignRecordingError):
            return read_run(path, columns=LOG_COLUMNS, ranges=None if part is None else part.rows)
    return read_log(path, facts.hints())


def record_of_log(path: Path, log: Run | Converted, facts: DriveFacts, digest: str) -> Record:
    """As `load_record`, of a log that was read. `digest`: of its file. Raises DataError."""
    columns = with_limit_column({name: log.columns[name] for name in TAKEN if name in log.columns})
    warnings = list(log.remarks) if isinstance(log, Converted) else ([log.reason] if log.reason else [])
    fresh = None
    if isinstance(log, Run) and MODE in log.columns:  # of our loop, not imported
        columns, fresh, filled = _while_running(log, columns)
        warnings += [f"{path}: {filled}"] if filled else []
    return _record(path, columns, fresh, facts, warnings, digest)


def record_of_columns(
    name: str, columns: Mapping[str, Floats], facts: DriveFacts, warnings: Sequence[str] = ()
) -> Record:
    """As `load_record`, of columns (n,) by our names, `time_s` among them. Raises DataError."""
    own = with_limit_column(columns)
    digest = hashlib.sha256(b"".join(own[key].tobytes() for key in sorted(own))).hexdigest()
    return _record(Path(name), own, None, facts, list(warnings), digest)


def record_of_part(
    path: Path, columns: Mapping[str, Any], timing: LogTiming | None, facts: DriveFacts, digest: str
) -> Record:
    """As `record_of_log`, of a part of a log, (n,) each; `timing` of the ticks of our loop. Nothing is checked."""
    own, fresh = with_limit_column(columns), None
    if timing is not None:
        whole = mended(own, timing, float(np.median(np.diff(own["time_s"]))))
        own, fresh = whole.columns, whole.fresh if whole.filled else None
    return _unchecked(path, own, fresh, facts, [], digest)


def with_limit_column(columns: Mapping[str, Any]) -> dict[str, Floats]:
    """The columns as numbers; bit 11 of the statusword as a column that may be interpolated (CiA 402)."""
    own = {name: np.ascontiguousarray(values, dtype=np.float64) for name, values in columns.items()}
    statusword = own.pop("statusword", None)
    if statusword is not None:
        limited = np.nan_to_num(statusword).astype(np.int64) & STATUS_INTERNAL_LIMIT != 0
        if limited.any():
            own[LIMITED] = limited.astype(np.float64)
    return own


def where_command_acts(record: Record) -> Record:
    """The record without the samples at the drive's internal limit of current or voltage, gaps in their place.

    There the current is not the command: a fit would take the missing torque for friction and inertia. Raises DataError
    if too little is left.
    """
    if record.limited is None:
        return record
    reach = max(1, round(LIMIT_MARGIN_S / record.period_s))
    kept = np.flatnonzero(~scipy.ndimage.binary_dilation(record.limited, iterations=reach))
    share = 100.0 * (1.0 - kept.size / record.samples)
    text = f"{record.path}: the drive was at its limit of current or voltage (statusword bit 11)"
    far = np.flatnonzero(np.diff(kept) > 1) + 1
    breaks = sorted({*far.tolist(), *np.searchsorted(kept, record.breaks).tolist()} - {0, kept.size})
    given = {
        name: getattr(record, name)[kept]
        for name in (
            "current_a", "position_rev", "velocity_rps", "reference_rps", "measured_current_a", "good",
            "reference_position_rev", "measured_torque_nm",
        )
        if getattr(record, name) is not None
    }  # fmt: skip
    warning = f"{text}: {share:.3g} % of the samples are left out, as current was not as commanded: use less amplitude"
    left = replace(record, breaks=tuple(breaks), limited=None, warnings=(*record.warnings, warning), **given)
    if not left.segments():
        raise DataError(f"{text} so often that no stretch of {SHORTEST_STRETCH_S:g} s is left: reduce the amplitude")
    return left


def load_records(
    paths: Iterable[str | Path], facts: DriveFacts, parts: Mapping[Path, LogPart] = MappingProxyType({})
) -> list[Record]:
    """`load_record` for several logs, all at one rate; the problems of all logs in one DataError."""
    records, problems = [], []
    for path in paths:
        try:
            records.append(load_record(path, facts, parts.get(Path(path))))
        except RecordingError as error:
            problems.append(str(error))
    if problems:
        raise DataError("\n".join(problems))
    names = distinct_names([record.path for record in records])
    return one_rate([replace(record, name=name) for record, name in zip(records, names, strict=True)])


def one_rate(records: Sequence[Record]) -> list[Record]:
    """The records at the lowest rate among them; unchanged if they have the same rate.

    Raises DataError if a log is so slow that the others would be degraded too far.
    """
    if not records:
        return []
    slowest = max(records, key=lambda record: record.period_s)
    fastest_s = min(record.period_s for record in records)
    if slowest.period_s > LARGEST_RATE_RATIO * fastest_s:
        raise DataError(
            f"{slowest.path}: sampled at {1.0 / slowest.period_s:.4g} Hz, other logs at {1.0 / fastest_s:.4g} Hz: "
            "brought to so low a rate they would say little; leave this log out, or record it faster"
        )
    return [_slowed(record, slowest.period_s) for record in records]


def _slowed(record: Record, period_s: float) -> Record:
    """The record resampled to a longer period; unchanged if the period is its own."""
    ratio = period_s / record.period_s
    if ratio < 1.0 + SAME_RATE:
        return record
    columns = {
        "current_command_a": record.current_a, "position_rev": record.position_rev,
        "velocity_rps": record.velocity_rps, "reference_rps": record.reference_rps,
        "current_a": record.measured_current_a, "reference_position_rev": record.reference_position_rev,
        "measured_torque_nm": record.measured_torque_nm,
        LIMITED: None if record.limited is None else record.limited.astype(np.float64),
    }  # fmt: skip
    given = {name: values for name, values in columns.items() if values is not None}
    parts = [
        at_lower_rate({n: v[part] for n, v in given.items()}, None if record.good is None else record.good[part], ratio)
        for part in record.segments()
    ]
    joined = {name: np.concatenate([part[name] for part, _ in parts]) for name in given}
    good = np.concatenate([sure for _, sure in parts])
    rates = f"{1.0 / record.period_s:.6g} to {1.0 / period_s:.6g} Hz"
    return replace(
        record, period_s=period_s, current_a=joined["current_command_a"], position_rev=joined["position_rev"],
        velocity_rps=joined.get("velocity_rps"), reference_rps=joined.get("reference_rps"),
        measured_current_a=joined.get("current_a"), reference_position_rev=joined.get("reference_position_rev"),
        measured_torque_nm=joined.get("measured_torque_nm"),
        good=None if good.all() else good, limited=_limits(joined),
        breaks=tuple(itertools.accumulate(sure.size for _, sure in parts[:-1])),
        warnings=(*record.warnings, f"{record.path}: brought from {rates}, the rate of the slowest log"),
    )  # fmt: skip


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """Short names of files, no two alike: the file's own, with its directory where that is not enough, or a number."""
    names = [short_name(path) for path in paths]
    if len(set(names)) != len(names):
        names = [f"{path.resolve().parent.name}/{short_name(path)}" for path in paths]
    return [f"{name} ({names[:k].count(name) + 1})" if name in names[:k] else name for k, name in enumerate(names)]


def _while_running(run: Run, columns: dict[str, Floats]) -> tuple[dict[str, Floats], Mask | None, str]:
    """The part of a recording in which the loop applied torque, with closed and open loop distinguished.

    Bus disturbances are repaired; also returns the repaired samples (None: none) and a summary in words.
    """
    mode = np.asarray(run.column(MODE))
    active = np.flatnonzero(mode)
    if not active.size:
        raise DataError(run.lacks("the loop never applied torque in this run"))
    part = slice(int(active[0]), int(active[-1]) + 1)
    kept = {name: np.ascontiguousarray(values[part]) for name, values in columns.items()}
    if not (mode[part] == 1).any():
        kept.pop("reference_rps", None)
    if part.stop - part.start < 2 or any(name not in run.columns for name in TIMING):
        return kept, None, ""
    timing = LogTiming(*(run.columns[name][part].astype(np.int64) for name in TIMING))
    whole = mended(kept, timing, float(np.median(np.diff(kept["time_s"]))))
    if not whole.filled:
        return whole.columns, None, ""
    share = 100.0 * whole.filled / whole.columns["time_s"].size
    return (
        whole.columns,
        whole.fresh,
        f"{share:.2g} % of the ticks had no SYNC, or no answer in time; what the drive did is filled in",
    )


def _record(
    path: Path, columns: dict[str, Any], fresh: Mask | None, facts: DriveFacts, warnings: list[str], digest: str
) -> Record:
    record = _unchecked(path, columns, fresh, facts, warnings, digest)
    problems, found = check_record(record)
    if problems:
        raise DataError("\n".join(problems))
    return replace(record, warnings=(*record.warnings, *found))


def _unchecked(
    path: Path, columns: dict[str, Any], fresh: Mask | None, facts: DriveFacts, warnings: list[str], digest: str
) -> Record:  # fmt: skip
    time_s = columns.pop("time_s")
    # its steps are the sensor's as long as nothing is interpolated
    counts = {name: resolution(columns[name]) for name in IN_WORDS if name in columns}
    even = on_even_grid(time_s, columns, fresh)
    columns, period_s = dict(even.columns), even.period_s
    if even.jitter_s:
        warnings.append(
            f"{path}: time stamps scatter by {1e3 * even.jitter_s:.2g} ms rms, {1e3 * even.largest_jitter_s:.2g} ms at "
            f"most, around a grid of {1e3 * period_s:.6g} ms; the samples are interpolated to the grid"
        )
    if fresh is None and even.good is not None:
        share = 100.0 * float(np.mean(~even.good))
        warnings.append(f"{path}: {share:.2g} % of the samples are missing in short gaps, which are bridged")
    stands_in = "current_command_a" not in columns
    if stands_in:
        if "current_a" not in columns:
            raise DataError(f"{path}: no column gives current_command_a: map the command in `columns` of the facts")
        warnings.append(f"{path}: no current command; the measured current stands in for it, with its noise and lag")
        columns["current_command_a"] = columns["current_a"]
    if facts.sample_rate_hz is not None and abs(period_s * facts.sample_rate_hz - 1.0) > 0.01:
        raise DataError(
            f"{path}: sampled at {1.0 / period_s:.6g} Hz, the facts declare {facts.sample_rate_hz:g} Hz: "
            "a wrong unit of time, or the wrong file"
        )
    if facts.lsb_rev:
        counts["position_rev"] = facts.lsb_rev
    counts.setdefault("current_command_a", counts.get("current_a", 0.0))
    fault = _fault(columns, even, counts) if facts.units == "rotary" else ""
    warnings += [f"{path}: {fault}"] if fault else []
    good, breaks = _without_impossible(path, columns, even, counts, warnings)
    if stands_in:
        now_a = columns["current_command_a"]  # measured at an instant, where a command is held from it to the next one
        columns["current_command_a"] = 0.5 * (now_a + np.append(now_a[1:], now_a[-1]))
    position_rev = columns.get("position_rev")
    velocity_rps = columns.get("velocity_rps")
    if position_rev is None:
        if velocity_rps is None:
            raise DataError(f"{path}: neither position_rev nor velocity_rps is given: one of them is needed")
        warnings.append(f"{path}: no position: the velocity is integrated, and its lag counts as delay")
        position_rev = np.concatenate([[0.0], np.cumsum(0.5 * (velocity_rps[1:] + velocity_rps[:-1]) * period_s)])
        counts.setdefault("position_rev", resolution(position_rev))
        velocity_rps = None  # the same once more would say that it is not late
    return Record(
        name=short_name(path),
        path=path,
        period_s=period_s,
        torque_constant_nm_per_a=facts.torque_constant_nm_per_a,
        current_a=columns["current_command_a"],
        position_rev=position_rev,
        velocity_rps=velocity_rps,
        reference_rps=columns.get("reference_rps"),
        lsb_rev=counts["position_rev"],
        breaks=breaks,
        digest=digest,
        measured_current_a=columns.get("current_a"),
        begin_s=float(time_s[0]),
        good=good,
        reference_position_rev=columns.get("reference_position_rev"),
        measured_torque_nm=columns.get("measured_torque_nm"),
        limited=_limits(columns),
        fault=fault,
        warnings=tuple(warnings),
    )


def _fault(columns: Mapping[str, Floats], even: Even, counts: Mapping[str, float]) -> str:
    """What is wrong with the position itself, in words; empty: nothing is seen."""
    position_rev = columns.get("position_rev")
    if position_rev is None:
        return ""
    bounds = itertools.pairwise((0, *even.breaks, position_rev.size))
    found = (fault_at_angle(position_rev[a:b], even.period_s, counts["position_rev"]) for a, b in bounds)
    return next((one.sentence for one in found if one is not None), "")


def _without_impossible(
    path: Path, columns: dict[str, Floats], even: Even, counts: Mapping[str, float], warnings: list[str]
) -> tuple[Mask | None, tuple[int, ...]]:
    """The samples that were measured, and those that come after a gap or a slip. `counts`: resolutions.

    What no motion makes is bridged in `columns`, and told in `warnings`.
    """
    size = columns["current_command_a"].size
    good = np.ones(size, dtype=np.bool_) if even.good is None else even.good.copy()
    breaks = set(even.breaks)
    # a command is known, whatever it is; a measured current that stands in for it is not
    drive = ["current_command_a"] if columns["current_command_a"] is columns.get("current_a") else []
    for name in [*(name for name in ("position_rev", "velocity_rps") if name in columns), *drive]:
        found = []
        for begin, end in itertools.pairwise((0, *even.breaks, size)):
            one = impossible_samples(columns[name][begin:end], even.period_s, counts[name], name == "position_rev")
            if one is None:
                continue
            columns[name] = columns[name].copy()
            columns[name][begin:end] = one.mended(columns[name][begin:end])
            found.append(one)
            breaks.update(begin + slip for slip in one.slips)
            if name != "velocity_rps" or "position_rev" not in columns:
                good[begin:end] &= ~one.bad
        warnings += [f"{path}: {text}" for text in impossible_lines(IN_WORDS[name], found, size)]
    return None if good.all() else good, tuple(sorted(breaks))


def _limits(columns: Mapping[str, Floats]) -> Mask | None:
    """Samples that depend on a limited one; None: no sample does."""
    return columns[LIMITED] > 0.0 if LIMITED in columns else None


def check_record(record: Record) -> tuple[list[str], list[str]]:
    """Reasons against a fit to this record, and anomalies: (problems, warnings), one sentence each."""
    problems: list[str] = []
    warnings: list[str] = []
    place = record.path
    if record.duration_s < SHORTEST_S:
        problems.append(f"{place}: {record.duration_s:.3g} s long; at least {SHORTEST_S:g} s are needed")
    elif 1.0 / record.period_s < (1.0 - SAME_RATE) * LEAST_RATE_HZ:
        problems.append(
            f"{place}: sampled at {1.0 / record.period_s:.4g} Hz; at least {LEAST_RATE_HZ:g} Hz are needed to see "
            "accelerations: record it faster"
        )
    elif not record.segments():
        problems.append(f"{place}: no stretch without a gap is {SHORTEST_STRETCH_S:g} s long: record it without losses")
    for name, values in (("current command", record.current_a), ("position", record.position_rev)):
        if not np.isfinite(values).all():
            problems.append(
                f"{place}: the {name} is not a finite number at sample {int(np.argmin(np.isfinite(values)))}"
            )
    if problems:
        return problems, warnings
    travel_rev = float(np.ptp(record.position_rev))
    if np.ptp(record.current_a) == 0.0:
        problems.append(f"{place}: the current command is constant ({record.current_a[0]:g}): nothing is excited")
    if travel_rev < LEAST_MOTION_LSB * record.lsb_rev or travel_rev == 0.0:
        problems.append(
            f"{place}: too little motion: {travel_rev:.3g} rev in all, less than {LEAST_MOTION_LSB:g} counts of the "
            "sensor; raise the current of the excitation"
        )
    rate_hz = 1.0 / record.period_s
    if rate_hz < LOW_RATE_HZ:
        warnings.append(
            f"{place}: sampled at {rate_hz:.4g} Hz: motion faster than {CUTOFF_PERIODS * rate_hz:.2g} Hz, a delay "
            f"below {500.0 / rate_hz:.2g} ms, presliding at reversals and single wrong samples cannot be seen: record "
            f"them at {LOW_RATE_HZ:g} Hz or more"
        )
    if record.breaks:
        warnings.append(f"{place}: {len(record.breaks)} gap(s) in time; nothing is simulated across them")
    if not problems and record.velocity_rps is not None:
        problem = _velocity_scale_problem(record)
        if problem is not None:
            problems.append(problem)
    return problems, warnings


def _velocity_scale_problem(record: Record) -> str | None:
    """Compare the drive's velocity with the derivative of the position: a wrong unit or sign appears as a factor."""
    assert record.velocity_rps is not None
    span = max(1, round(0.01 / record.period_s))
    parts = record.segments()
    positions = [record.position_rev[part] for part in parts]
    derived = np.concatenate([p[2 * span :] - p[: -2 * span] for p in positions]) / (2 * span * record.period_s)
    own = np.concatenate([_moving_mean(record.velocity_rps[part], span) for part in parts])
    power = float(derived @ derived)
    if power == 0.0 or float(own @ own) == 0.0:
        return f"{record.path}: the velocity is zero throughout while the position moves, or the other way round"
    correlation = float(own @ derived) / np.sqrt(power * float(own @ own))
    factor = float(own @ derived) / power
    if abs(correlation) < 0.5:
        return f"{record.path}: velocity and derivative of the position have nothing in common (r = {correlation:.2f})"
    if abs(factor - 1.0) <= SCALE_TOLERANCE:
        return None
    known = min(KNOWN_FACTORS, key=lambda k: abs(np.log(abs(factor / k))) + (10.0 if factor * k < 0 else 0.0))
    hint = f": {KNOWN_FACTORS[known]}?" if abs(factor / known - 1.0) < 0.1 else "."
    return (
        f"{record.path}: the velocity is {factor:.4g} times the derivative of the position{hint} "
        "Give the unit of each column in `columns` of the facts"
    )


def _moving_mean(values: Floats, span: int) -> Floats:
    """Mean over 2 `span` periods around each sample that has them: what positions so far apart differ by, over time."""
    path = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]))])
    return np.asarray((path[2 * span :] - path[: -2 * span]) / (2 * span))
