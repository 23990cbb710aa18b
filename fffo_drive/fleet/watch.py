"""Changes in each drive's own history, beside those with temperature, at a rate of false alarms that the user sets.

`channels` takes temperature, load and speed out of the records, `detector` holds the bound on false alarms. Alarms get
a law, a size with an interval, a first run, and runs to look at.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..documents import counted
from ..identification.threads import in_threads
from ..units import NORMAL_95
from .change import ChangeFit, fit_change
from .channels import COLUMNS, MEAN_DEGC, STEP_K, WITHOUT_TEMPERATURE, Channels, FleetPrior, Stack, channels_of, stacked
from .detector import BURN_IN, YEAR_S, ChannelPrior, Detections, detect
from .history import RunHistory, model_records
from .learning import evenly, learned
from .matrices import medians_of_known
from .store import FleetStore
from .thermometers import thermometer_text
from .words import day_of

DEFAULT_ALARMS_PER_DRIVE_YEAR = 0.01
FIRST_WITHIN = 8  # runs before and after the detector's guess, among which the first run is looked for
SAME_FIT = 3.84  # rise of the squared misfit, in variances, that leaves a first run possible: 95 % of chi-squared
RAMP_RUNS = (4, 6, 8, 12, 16, 24)
RAMP_GAIN = 6.0  # fall of the squared misfit, in variances, that makes a step a ramp
AS_GOOD = 0.85  # of the largest statistic: a law that may be meant as well
LOOK_AT = 2  # runs to open on either side of a change
RECENT = 8  # runs
DRIVES_A_PIECE = 1_000  # of about 50 runs: about 300 MB
OUTSIDE_SDS = 3.0  # standard deviations of friction with temperature
OUTSIDE_K = 3.0  # beyond the temperatures that were seen
VISCOUS = "viscous_nm_per_rps"


class Alarm(NamedTuple):
    """A change of one law of one drive."""

    drive: str
    law: str
    others: tuple[str, ...]  # laws that explain it nearly as well
    change: float  # share of `scale`; of a ripple and the residual: of its own earlier size
    interval: tuple[float, float]  # 95 %, of `change`
    scale: str  # what `change` is a share of
    size: float | None  # change in the unit of `column`; None for a ripple and the residual
    column: str | None
    ramp_runs: int  # over which it grew; 0: at once
    first_run: str  # content hash
    first_time_s: float
    first_within: tuple[str, str]  # earliest and latest run that may be the first
    raised_run: str
    raised_time_s: float
    look_at: tuple[str, ...]  # the runs before and after that show it best


class Undecided(NamedTuple):
    """What the records of a drive cannot decide, and what would."""

    drive: str
    text: str


class Watched(NamedTuple):
    """What `watch` found."""

    alarms: tuple[Alarm, ...]
    doubts: tuple[Undecided, ...]
    drives: int
    runs: int
    drive_years: float
    alarms_per_drive_year: float  # false ones, at most
    laws: tuple[str, ...]  # that were watched
    thermometers: int = 0  # drives that log a temperature, whatever it shows

    def as_plain(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            **self._asdict(),
            "alarms": [alarm._asdict() | {"text": alarm_text(alarm)} for alarm in self.alarms],
            "doubts": [doubt._asdict() for doubt in self.doubts],
        }


class DriveTrace(NamedTuple):
    """What a page draws of one drive: n runs, c laws."""

    time_s: Floats  # (n,)
    laws: tuple[str, ...]
    estimate: Floats  # (n, c) of each law, temperature taken out; over its scale, or a logarithm
    sd: Floats  # (n, c)
    evidence: Floats  # (n,) 1 raises an alarm


class FleetWatch(NamedTuple):
    """The watch over a fleet, with what it was made from."""

    found: Watched
    stack: Stack
    channels: Channels
    prior: ChannelPrior
    detections: Detections

    def trace(self, drive: str) -> DriveTrace:
        """A drive's channels and evidence. Raises KeyError for a drive that is not in the fleet."""
        if drive not in self.stack.drives:
            raise KeyError(f"drive {drive} is not among those that were watched")
        runs = self.stack.of(self.stack.drives.index(drive))
        slopes = self.channels.covariates[runs] @ self.prior.mean[:, 1:].T
        sd = np.sqrt(self.channels.variance[runs] * self.prior.variance)
        return DriveTrace(
            self.stack.time_s[runs], self.channels.laws, self.channels.y[runs] - slopes, sd,
            self.detections.evidence[runs],
        )  # fmt: skip


def watch(
    histories: Mapping[str, RunHistory], alarms_per_drive_year: float = DEFAULT_ALARMS_PER_DRIVE_YEAR,
    orders: Sequence[float] | None = None, known: tuple[FleetPrior, ChannelPrior] | None = None,
) -> FleetWatch:  # fmt: skip
    """Watch drives of one model. `orders`: of ripple, to be watched; None: those that stand out in the fleet.

    `known`: what their fleet is like; None: what these drives show. Raises ValueError for a rate that is not above 0,
    and for drives whose records have other columns.
    """
    if known is None:
        stack = stacked(histories, orders)
        fleet, prior = learned(stack)
    else:
        fleet, prior = known
        stack = stacked(histories, fleet.orders, fleet.columns)
    channels = channels_of(stack, fleet)
    detections = detect(
        stack.bounds, stack.time_s, channels.y, channels.variance, channels.covariates, prior, alarms_per_drive_year
    )
    alarms = [_alarm(stack, channels, prior, detections, k) for k in range(detections.drive.size)]
    watched = tuple(law for law, y in zip(channels.laws, channels.y.T, strict=True) if np.isfinite(y).any())
    lengths = np.diff(stack.bounds)
    begin, end = stack.bounds[:-1][lengths > 0], stack.bounds[1:][lengths > 0] - 1
    years = float(np.sum(stack.time_s[end] - stack.time_s[begin])) / YEAR_S
    found = Watched(
        tuple(alarms), tuple(_doubts(stack, fleet)), len(stack.drives), stack.time_s.size, years,
        alarms_per_drive_year, tuple(dict.fromkeys(watched)), int(np.isfinite(stack.seen).sum()),
    )  # fmt: skip
    return FleetWatch(found, stack, channels, prior, detections)


def watch_model(store: FleetStore, model: str, alarms_per_drive_year: float) -> Watched:
    """`watch` over all drives of a model: a large fleet in parts, with priors learned from a sample of it."""
    records = model_records(store, model)
    drives = np.arange(records.bounds.size - 1)
    if drives.size <= DRIVES_A_PIECE:
        return watch(records.histories(drives), alarms_per_drive_year).found
    known = learned(stacked(records.histories(evenly(drives.size))))
    pieces = np.split(drives, range(DRIVES_A_PIECE, drives.size, DRIVES_A_PIECE))

    def watched(piece: Integers) -> Watched:
        return watch(records.histories(piece), alarms_per_drive_year, known=known).found

    found = list(in_threads(watched, pieces))
    return Watched(
        tuple(alarm for one in found for alarm in one.alarms), tuple(doubt for one in found for doubt in one.doubts),
        sum(one.drives for one in found), sum(one.runs for one in found), sum(one.drive_years for one in found),
        alarms_per_drive_year, tuple(dict.fromkeys(law for one in found for law in one.laws)),
        sum(one.thermometers for one in found),
    )  # fmt: skip


def _fit_change(
    channels: Channels, prior: ChannelPrior, c: int, runs: slice, shape: Floats
) -> ChangeFit | None:  # fmt: skip
    """A change of one channel of the form `shape` (n,); None where the runs say nothing of it."""
    known = np.flatnonzero(np.isfinite(channels.y[runs, c]))
    if known.size < BURN_IN or np.ptp(shape[known]) == 0.0:
        return None
    found = fit_change(channels, prior, c, runs.start + known, shape[known])
    # neighbours that are alike say less than so many runs
    alike = math.sqrt((1.0 + prior.memory[c]) / (1.0 - prior.memory[c]))
    spread = max(1.0, math.sqrt(found.misfit / max(known.size - 4, 1)))
    return found._replace(sd=found.sd * alike * spread)


def _alarm(stack: Stack, channels: Channels, prior: ChannelPrior, detections: Detections, k: int) -> Alarm:
    drive, raised, first = (int(a[k]) for a in (detections.drive, detections.run, detections.first))
    own = np.flatnonzero(detections.drive == drive)
    place = int(np.flatnonzero(own == k)[0])
    begin = int(detections.first[own[place - 1]]) if place else int(stack.bounds[drive])
    end = int(detections.first[own[place + 1]]) if place + 1 < own.size else int(stack.bounds[drive + 1])
    runs = slice(begin, max(end, raised + 1))
    count = runs.stop - begin
    steps = np.arange(count)
    guess = (steps >= first - begin).astype(np.float64)
    fits = [_fit_change(channels, prior, c, runs, guess) for c in range(len(channels.laws))]
    power = np.array([0.0 if one is None else abs(one.size) / one.sd for one in fits])
    c = int(np.argmax(power))
    c = c if power[c] > 0.0 else int(detections.channel[k])
    others = {channels.laws[j] for j in np.flatnonzero(power > AS_GOOD * power[c])} - {channels.laws[c]}
    around = range(max(1, first - begin - FIRST_WITHIN), min(count, first - begin + FIRST_WITHIN + 1))
    found = {j: _fit_change(channels, prior, c, runs, (steps >= j).astype(np.float64)) for j in around}
    kept = {j: one for j, one in found.items() if one is not None}
    best = min(kept, key=lambda j: kept[j].misfit) if kept else first - begin
    change = kept.get(best) or ChangeFit(math.nan, math.nan, math.inf)
    possible = [j for j, one in kept.items() if one.misfit <= change.misfit + SAME_FIT] or [best]
    ramp = 0
    ramps = {
        (j, length): _fit_change(channels, prior, c, runs, np.clip((steps - j + 1) / length, 0.0, 1.0))
        for j in around for length in RAMP_RUNS if j + length <= count
    }  # fmt: skip
    grown = {key: one for key, one in ramps.items() if one is not None}
    if grown:
        key = min(grown, key=lambda one: grown[one].misfit)
        if grown[key].misfit < change.misfit - RAMP_GAIN:
            (best, ramp), change = key, grown[key]
            possible = [j for (j, _), one in grown.items() if one.misfit <= change.misfit + SAME_FIT]
    return _described(stack, channels, drive, c, begin, best, possible, ramp, change, raised, tuple(sorted(others)))


def _described(
    stack: Stack, channels: Channels, drive: int, c: int, begin: int, best: int, possible: Sequence[int], ramp: int,
    change: ChangeFit, raised: int, others: tuple[str, ...],
) -> Alarm:  # fmt: skip
    column = stack.columns[c] if c < len(stack.columns) else None
    reach = NORMAL_95 * change.sd
    if column is None:
        share, interval = math.expm1(change.size), (math.expm1(change.size - reach), math.expm1(change.size + reach))
        scale, size = "its size before", None
    else:
        share, interval = change.size, (change.size - reach, change.size + reach)
        scale = COLUMNS[COLUMNS[column][1]][0]
        size = share * float(stack.scales[drive, c])
    first = begin + best
    return Alarm(
        stack.drives[drive], channels.laws[c], others, share, interval, scale, size, column, ramp,
        str(stack.run[first]), float(stack.time_s[first]),
        (str(stack.run[begin + min(possible)]), str(stack.run[begin + max(possible)])),
        str(stack.run[raised]), float(stack.time_s[raised]),
        _to_look_at(stack, channels, drive, c, first, first + max(ramp, 1)),
    )  # fmt: skip


def _to_look_at(stack: Stack, channels: Channels, drive: int, c: int, first: int, whole: int) -> tuple[str, ...]:
    """Runs near the change: the surest of the last before it and of the first after it."""
    begin, end = int(stack.bounds[drive]), int(stack.bounds[drive + 1])
    chosen: list[int] = []
    for low, high in ((max(begin, first - RECENT), first), (min(whole, end - 1), min(end, whole + RECENT))):
        runs = [n for n in range(low, high) if np.isfinite(channels.y[n, c])]
        sure = sorted(runs, key=lambda n: float(channels.variance[n, c]))[:LOOK_AT]
        chosen += sorted(sure)
    return tuple(str(stack.run[n]) for n in chosen)


def _doubts(stack: Stack, prior: FleetPrior) -> list[Undecided]:
    """Drives of which the records cannot say whether it is wear or temperature, and those with too few runs."""
    counts = np.diff(stack.bounds)
    found = {
        int(number): f"{counts[number]} runs: a change is looked for from run {BURN_IN + 1} on"
        for number in np.flatnonzero(counts <= BURN_IN)
    }
    enough = counts > BURN_IN
    found |= {int(number): thermometer_text(float(stack.seen[number])) for number in np.flatnonzero(stack.seen < 1.0)}
    found |= _unseen_temperatures(stack, np.flatnonzero(enough & stack.logged))
    if VISCOUS in stack.columns:
        place = stack.columns.index(VISCOUS)
        sd = math.sqrt(prior.ambient_covariance[place, place])
        found |= _unusual_viscous(stack, np.flatnonzero(enough & ~stack.logged & (counts >= 2 * RECENT)), place, sd)
    return [Undecided(stack.drives[number], found[number]) for number in sorted(found)]


def _unseen_temperatures(stack: Stack, drives: Integers) -> dict[int, str]:
    """Of these drives, which have more than RECENT runs, those whose last runs are at a temperature of their own."""
    begins, ends = stack.bounds[drives], stack.bounds[drives + 1]
    degc = MEAN_DEGC + STEP_K * stack.temperature
    recent = ends[:, None] - 1 - np.arange(RECENT)
    now = medians_of_known(degc[recent], 1)
    before = np.append(degc, np.nan)
    before[recent] = np.nan
    spans = np.column_stack([begins, ends]).ravel()
    low, high = (one.reduceat(before, spans)[::2] if drives.size else now for one in (np.fmin, np.fmax))
    outside = (now < low - OUTSIDE_K) | (now > high + OUTSIDE_K)
    return {
        int(drives[k]): f"the last runs are at {now[k]:.0f} degC, those before at {low[k]:.0f} to {high[k]:.0f} degC: "
        "what this temperature does to the drive is not known from its own runs, so a change of friction cannot be "
        "distinguished from it yet"
        for k in np.flatnonzero(outside)
    }


def _unusual_viscous(stack: Stack, drives: Integers, place: int, sd: float) -> dict[int, str]:
    """Of drives that log no temperature, those whose viscous friction is further off than temperature moves it."""
    viscous = np.where(stack.information[:, place, place] > 0.0, stack.theta[:, place], np.nan)
    found = {}
    for drive in drives:
        runs = viscous[stack.of(drive)]
        usual, now = (float(medians_of_known(part, 0)) for part in (runs[:-RECENT], runs[-RECENT:]))
        if abs(now - usual) > OUTSIDE_SDS * sd:
            found[int(drive)] = (
                f"viscous friction is {100.0 * (now / usual - 1.0):+.0f} % from its usual value, further than "
                f"temperature moves it in this fleet ({100.0 * sd:.0f} %, standard deviation). No temperature that "
                "shows it is logged, so wear cannot be distinguished from temperature: log that of the drive, or "
                "compare runs at the same one"
            )
    return found


def alarm_text(alarm: Alarm) -> str:
    """One alarm in plain language."""
    low, high = sorted(alarm.interval)
    grew = f", grown over {alarm.ramp_runs} runs" if alarm.ramp_runs else ""
    of = "" if alarm.scale in (alarm.law, "its size before") else f" of {alarm.scale}"
    text = (
        f"{alarm.drive}: {alarm.law} {100.0 * alarm.change:+.1f} %{of} ({100.0 * low:+.1f} to {100.0 * high:+.1f} %) "
        f"since {day_of(alarm.first_time_s)}{grew}, alarm raised on {day_of(alarm.raised_time_s)}"
    )
    if alarm.others:
        text += f"; it may also be {' or '.join(alarm.others)}"
    return f"{text}. Look at runs {', '.join(run[:12] for run in alarm.look_at)}"


def unwatched_text(found: Watched) -> str:
    """What the watch cannot see for want of a temperature; empty where there is one."""
    unseen = [law for law in WITHOUT_TEMPERATURE if law not in found.laws]
    if not unseen or not found.laws:
        return ""
    late = "a change of Coulomb friction is found late or not at all"
    why = "no logged temperature shows that of its drive" if found.thermometers else "no temperature is logged"
    return f"{why}: {unseen[0]} is not watched, {late}"


def watch_lines(found: Watched) -> list[str]:
    """What `fleet watch` prints."""
    lines = [alarm_text(alarm) for alarm in found.alarms]
    lines += [f"{doubt.drive}: {doubt.text}" for doubt in found.doubts]
    expected = found.alarms_per_drive_year * found.drive_years
    lines.append(
        f"{counted(len(found.alarms), 'alarm')} in {counted(found.drives, 'drive')}, {counted(found.runs, 'run')}, "
        f"{found.drive_years:.1f} drive-years; "
        f"at {found.alarms_per_drive_year:g} false alarms a drive and year, {expected:.2g} of them are expected to be "
        "false at most"
    )
    lines.append(f"watched: {', '.join(found.laws)}")
    unwatched = unwatched_text(found)
    return [*lines, unwatched] if unwatched else lines
