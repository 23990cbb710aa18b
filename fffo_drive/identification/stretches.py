"""Of a recording that is longer than a fit takes, the stretches that determine most.

It is read block by block and divided into stretches of STRETCH_S. Of each it is counted what `coverage` counts in a
log: the time in classes of speed both ways and of position, the time of slow motion, of speeding up and of braking,
reversals, rests. The stretches are then taken one by one, each time the one that adds most to the sum of
ln(1 + x / x_even) over all counts x, where x_even is what an even choice of the same length would hold: what is rare in
the recording comes first, and what is held already adds little. That sum is submodular, for which such a choice reaches
at least 63 % of the best one (Nemhauser, Wolsey and Fisher, 1978).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..importing.read import RECORDINGS
from ..recording.errors import RecordingError
from ..recording.reader import RowBlocks, describe, groups
from ..units import NS_PER_S
from .coverage import DWELL_S, FAST_SHARE, REST_COUNTS_PER_S, REST_SHARE, SLOW_SHARE, lengths_of
from .dataset import MODE, SHORTEST_S, TAKEN, LogPart, Record, load_records, record_of_part
from .facts import DriveFacts
from .kinematics import DEFAULT_CUTOFF_HZ, motion_of
from .rows import samples_a_row

MOST_SAMPLES = 2_000_000  # of all logs of a fit together: 1000 s at 2 kHz, for which `identify` takes 0.53 GB
MOST_DIAGNOSED = 800_000  # ... and of a diagnosis, which keeps what each of many effects would explain: 1.1 GB
STRETCH_S = 20.0  # far above the memory of the filters, which begin anew in each
SPEED_CLASSES = 8  # each way
PLACES = 16  # classes of the position: of the turn, or of the travel where it is less than one
TIMES = 8  # classes of the time, in which an axis warms up


Progress = Callable[[float, str], None]


class RowRange(NamedTuple):
    """Rows of a recording, from here on and before there."""

    first: int
    end: int


class StretchMotion(NamedTuple):
    """The motion in a stretch of a recording, arrays (m,)."""

    rows: RowRange
    begin_s: float  # since the first row of the recording
    end_s: float
    velocity_rps: Floats
    acceleration_rps2: Floats
    position_rev: Floats
    period_s: float
    lsb_rev: float


def load_logs(
    paths: Sequence[str | Path], facts: DriveFacts, progress: Progress | None = None, most: int = MOST_SAMPLES
) -> list[Record]:
    """`load_records`; of recordings that have more than `most` samples together, the stretches that determine most.

    `progress` gets the share of what is read for the choice. Raises DataError.
    """
    found = {Path(path): _described(Path(path)) for path in paths}
    sizes = {path: int(one["rows"]) if one else 0 for path, one in found.items()}
    each = samples_each(list(sizes.values()), most)
    long = {path: one for path, one in found.items() if one and sizes[path] > each}
    parts: dict[Path, LogPart] = {}
    done, whole = 0, sum(sizes[path] for path in long)
    for path, one in long.items():
        motions = []
        for motion in motions_in(path, facts, float(one["period_s"])):
            motions.append(motion)
            if progress is not None:
                progress((done + motion.rows.end) / whole, f"stretches of {path.name}")
        if motions:  # of one that never moves `load_records` says so
            parts[path] = choose(path, motions, each)
        done += sizes[path]
    return load_records(paths, facts, parts)


def _described(path: Path) -> dict[str, Any] | None:
    """A recording by its index; None for another log, and for what `load_records` will refuse with its reason."""
    if path.name.endswith(RECORDINGS):
        with contextlib.suppress(RecordingError, OSError):
            return describe(path)
    return None


def motions_in(path: Path, facts: DriveFacts, period_s: float) -> Iterator[StretchMotion]:
    """The motion in each stretch of a recording in which the loop applied torque. Raises DataError."""
    begin_ns, number = 0, 0
    for block in groups(RowBlocks(path), round(STRETCH_S / period_s)):
        stamps_ns, rows = block.stamps_ns, RowRange(number, number + len(block.rows))
        begin_ns, number = begin_ns if number else int(stamps_ns[0]), rows.end
        times_s = (stamps_ns - begin_ns) / NS_PER_S
        names = block.rows.dtype.names or ()
        active = block.rows[MODE] != 0 if MODE in names else np.ones(len(block.rows), np.bool_)
        if np.count_nonzero(active) * period_s < SHORTEST_S:
            continue
        columns = {name: block.rows[name][active] for name in TAKEN if name in names}
        record = record_of_part(path, {**columns, "time_s": times_s[active]}, None, facts, "")
        if record.segments():
            yield motion_in(record, rows, float(times_s[0]), float(times_s[-1]))


def samples_each(samples: Sequence[int], most: int) -> int:
    """How many samples each of several logs may have at most, so that all of them together have at most `most`."""
    left = most
    for number, size in enumerate(sorted(samples)):
        level = left // (len(samples) - number)
        if size > level:
            return level
        left -= size
    return most


def motion_in(record: Record, rows: RowRange, begin_s: float, end_s: float) -> StretchMotion:
    """What the choice needs of a stretch: four rows a period of the filter's cut-off."""
    cutoff_hz = min(DEFAULT_CUTOFF_HZ, 0.1 / record.period_s)
    step = samples_a_row(record.period_s, cutoff_hz)
    motions = [motion_of(record, part, cutoff_hz) for part in record.segments()]

    def joined(parts: Iterable[Floats]) -> Floats:
        return np.concatenate([part[::step].astype(np.float32) for part in parts] or [np.zeros(0, np.float32)])

    return StretchMotion(
        rows,
        begin_s,
        end_s,
        joined(one.velocity_rps for one in motions),
        joined(one.acceleration_rps2 for one in motions),
        joined(one.position_rev for one in motions),
        step * record.period_s,
        record.lsb_rev,
    )


def choose(path: Path, motions: Sequence[StretchMotion], samples: int) -> LogPart:
    """The stretches of a recording with at most so many rows together, at least one."""
    amounts = dict(_amounts(motions))
    table = np.concatenate(list(amounts.values()), axis=1)
    sizes = np.array([one.rows.end - one.rows.first for one in motions])
    taken = _greedy(table, sizes, samples)
    chosen = np.isin(np.arange(len(motions)), taken)
    joined = list(_joined(one for one, own in zip(motions, chosen, strict=True) if own))
    held = [
        f"{100.0 * float(own[chosen].sum() / own.sum()):.0f} % of {name}" for name, own in amounts.items() if own.sum()
    ]
    classes = table.sum(axis=0) > 0.0
    reached = int(np.count_nonzero(table[chosen].sum(axis=0)[classes]))
    length_s, taken_s = (
        sum(one.end_s - one.begin_s for one, own in zip(motions, which, strict=True) if own)
        for which in (np.ones(len(motions), np.bool_), chosen)
    )
    places = ", ".join(f"{one.begin_s:.0f}-{one.end_s:.0f}" for one in joined)
    text = (
        f"{path}: {length_s / 60.0:.3g} min are more than a fit takes; of them {taken_s / 60.0:.3g} min are taken "
        f"({100.0 * taken_s / length_s:.2g} %), the stretches that determine most. They hold {', '.join(held)}, and "
        f"{reached} of {int(classes.sum())} classes of speed, position, time and acceleration. From-to in s: {places}. "
        f"To take others: fffo-drive log export {path} --from S --to S --out part.mcap"
    )
    return LogPart(tuple(one.rows for one in joined), text)


def _greedy(table: Floats, sizes: Integers, samples: int) -> list[int]:
    """Stretches, the most useful first. `table`: (stretches, counts)."""
    counts = table[:, table.sum(axis=0) > 0.0]
    even = counts.sum(axis=0) * min(1.0, samples / sizes.sum())
    taken: list[int] = []
    held, left, open_ = np.zeros(counts.shape[1]), samples, np.ones(len(sizes), np.bool_)
    while (open_ & ((sizes <= left) | (not taken))).any():
        gains = np.log1p((held + counts) / even).sum(axis=1)
        best = int(np.argmax(np.where(open_ & ((sizes <= left) | (not taken)), gains, -np.inf)))
        taken.append(best)
        held += counts[best]
        left -= int(sizes[best])
        open_[best] = False
    return taken


def _joined(motions: Iterable[StretchMotion]) -> Iterator[StretchMotion]:
    """Stretches (their rows and times) that follow each other, as one."""
    last: StretchMotion | None = None
    for one in motions:
        if last is not None and last.rows.end == one.rows.first:
            last = last._replace(rows=RowRange(last.rows.first, one.rows.end), end_s=one.end_s)
            continue
        if last is not None:
            yield last
        last = one
    if last is not None:
        yield last


def _amounts(motions: Sequence[StretchMotion]) -> Iterator[tuple[str, Floats]]:
    """What each stretch holds of each kind: (stretches, classes), s or numbers. The limits are those of all."""
    speeds = np.abs(np.concatenate([one.velocity_rps for one in motions]))
    top = float(np.quantile(speeds, 0.999)) if speeds.size else 0.0
    accelerations = np.abs(np.concatenate([one.acceleration_rps2 for one in motions]))
    fastest = float(np.quantile(accelerations, 0.999)) if speeds.size else 0.0
    ends = np.array([(one.position_rev.min(), one.position_rev.max()) for one in motions if one.position_rev.size])
    low, span = (float(ends[:, 0].min()), float(ends[:, 1].max() - ends[:, 0].min())) if ends.size else (0.0, 0.0)
    turn = min(1.0, span) or 1.0
    edges = top * np.linspace(-1.0, 1.0, 2 * SPEED_CLASSES + 1)[1:-1]
    found: dict[str, list[Floats]] = {}
    for number, one in enumerate(motions):
        rest_rps = max(REST_SHARE * top, REST_COUNTS_PER_S * one.lsb_rev)
        moving = np.abs(one.velocity_rps) >= rest_rps
        velocity, acceleration = one.velocity_rps[moving], one.acceleration_rps2[moving]
        ways = velocity > 0.0
        speeding = np.abs(acceleration) > FAST_SHARE * fastest
        slow = np.abs(velocity) < SLOW_SHARE * top
        times = np.zeros(TIMES)
        times[number * TIMES // len(motions)] = velocity.size
        place = ((one.position_rev[moving] - low) / turn % 1.0 * PLACES).astype(np.int64).clip(0, PLACES - 1)
        rests = lengths_of(~moving) * one.period_s
        own = {
            "the motion": np.bincount(np.searchsorted(edges, velocity), minlength=2 * SPEED_CLASSES),
            "it by place": np.bincount(place, minlength=PLACES),
            "it by time": times,
            "the slow motion": np.bincount(ways[slow], minlength=2),
            "the speeding up and braking": np.bincount(
                2 * ways[speeding] + (acceleration[speeding] > 0.0), minlength=4
            ),
            "the reversals": np.array([np.count_nonzero(np.diff(np.sign(velocity)))]),
            "the rests": np.array([np.count_nonzero(rests > DWELL_S)]),
        }
        for name, values in own.items():
            found.setdefault(name, []).append(values.astype(np.float64))
    yield from ((name, np.array(values)) for name, values in found.items())
