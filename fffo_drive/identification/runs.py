"""Checks of each run by itself, before anything is fitted to all runs together.

Each run gets its own rigid regression, Kt i(t - Td) = J a + sigma w + Fc sgn(w) + constant, on the rows of `rows`,
with standard deviations from whole blocks. Parameters that a run does not determine by itself (a one-way run cannot
separate Coulomb friction from a constant torque) are reported and not compared. The falling part of the Stribeck curve
is estimated on all runs together and subtracted first, because otherwise runs at different speeds would contradict each
other.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from ..arrays import Floats
from ..least_squares import least_squares, sums_by
from ..units import unit_in
from .criterion import BLOCK_S, SHORTEST_BLOCK_S
from .dataset import CUTOFF_PERIODS, DataError, Record
from .kinematics import DEFAULT_CUTOFF_HZ
from .regression import STRIBECK_SHARE, TorqueStart, regression_start
from .rows import (
    ACCELERATION,
    CONSTANT,
    DIRECTION,
    VELOCITY,
    RegressionRows,
    rigid_columns,
    rows_at,
    stretches_of,
    turns_one_way,
)

Kind = Literal["contradiction", "drift", "confounded", "repeated_reference"]

PARAMETERS = ("inertia_nm_s2_per_rev", "viscous_nm_per_rps", "coulomb_nm", "offset_nm")
WORDS = {
    "inertia_nm_s2_per_rev": "inertia",
    "viscous_nm_per_rps": "viscous friction",
    "coulomb_nm": "Coulomb friction",
    "offset_nm": "the constant torque",
}
LARGEST_INFLATION = 20.0  # variance inflation by the other columns: speed varies by a quarter of its mean
LARGEST_SHARE_SD = 0.25  # of the run's torque: a less certain contribution is not determined
NOISE_RATIO = 4.0  # acceleration over its noise from the sensor's resolution: below it, inertia is biased low
LARGEST_LEFT = 0.5  # of the torque: if the axis differs this much from a rigid one, the four numbers mean little
BLOCKS_A_RUN = 20  # a short run has shorter blocks ...
LEAST_BLOCKS = 8  # ... and no standard deviation with fewer blocks in sliding
LEAST_ROWS = 40  # of sure sliding in a run
CONTRADICTION_SHARE = 0.03  # spread between runs, of their mean ...
CONTRADICTION_SDS = 5.0  # ... and of its standard deviation, from which the runs contradict each other
DRIFT_RUNS = 3  # smallest number of runs for a monotone change
SAME_REFERENCE = 1e-6  # of its range
SAME_TRAVEL = 0.995  # correlation of position and time in every run above which they cannot be separated


class Estimate(NamedTuple):
    """Estimate of one parameter from one run; if it is not determined, value and sd are meaningless alone."""

    value: float
    sd: float
    determined: bool
    inflation: float  # variance inflation by the other columns


class RunLook(NamedTuple):
    """One run by itself."""

    name: str
    begin_s: float  # on the clock of the log
    estimates: Mapping[str, Estimate]  # by PARAMETERS; empty if the run hardly slides
    turns_one_way: bool
    rows: int
    condition: float  # of the scaled normal matrix


class Remark(NamedTuple):
    """A problem of the runs that is reported before any fit."""

    kind: Kind
    parameters: tuple[str, ...]
    runs: tuple[str, ...]
    text: str  # the problem and its remedy


class RunsLook(NamedTuple):
    """All runs, and contradictions between them."""

    runs: tuple[RunLook, ...]
    remarks: tuple[Remark, ...]
    delay_s: float
    turn_one_way: bool = False  # all in the same direction


def look_at_runs(records: Sequence[Record], cutoff_hz: float = DEFAULT_CUTOFF_HZ) -> RunsLook:
    """Regress every run (all of one rate) by itself and compare. Raises DataError if there is hardly any sliding."""
    start = regression_start(records, cutoff_hz)
    cutoff_hz = min(cutoff_hz, CUTOFF_PERIODS / records[0].period_s)
    rows = rows_at(stretches_of(records, cutoff_hz)[0], cutoff_hz, start.delay_s)
    rows = _without_stribeck(rows, start)
    looks = tuple(_look(record, number, rows) for number, record in enumerate(records))
    usable = [look for look in looks if look.estimates]
    if not usable:
        raise DataError("no run slides long enough to be looked at by itself: raise the current of the excitation")
    remarks = (*_confounded(records, rows, looks), *_compared(usable), *_repeated(records))
    return RunsLook(looks, remarks, start.delay_s, turns_one_way(rows.direction[rows.sliding]))


def _without_stribeck(rows: RegressionRows, start: TorqueStart) -> RegressionRows:
    """The rows without the falling part of the friction, if it explains something in addition to each run's rigid fit.

    One coefficient for all runs, the runs' own columns projected out: what differs between runs does not go into it.
    """
    ratio = np.abs(rows.velocity_rps) / start.stribeck_velocity_rps
    fall = np.exp(-(ratio**start.stribeck_exponent)) * rows.direction
    columns = rigid_columns(rows)
    products, squares, energy = 0.0, 0.0, 0.0
    for number in np.unique(rows.run):
        own = rows.sliding & (rows.run == number)
        if np.count_nonzero(own) < LEAST_ROWS:
            continue
        left, torque = least_squares(columns[own], np.column_stack([fall, rows.torque_nm])[own]).residual.T
        products += float(left @ torque)
        squares += float(left @ left)
        energy += float(torque @ torque)
    if squares == 0.0 or products * products <= STRIBECK_SHARE * squares * energy:
        return rows
    return rows._replace(torque_nm=rows.torque_nm - products / squares * fall)


def _look(record: Record, number: int, rows: RegressionRows) -> RunLook:
    own = rows.sliding & (rows.run == number)
    one_way = turns_one_way(rows.direction[own])
    count = int(np.count_nonzero(own))
    if count < LEAST_ROWS:
        return RunLook(record.name, record.begin_s, {}, one_way, count, np.inf)
    columns, torque_nm = rigid_columns(rows)[own], rows.torque_nm[own]
    fit = least_squares(columns, torque_nm)
    norm, curvature, inverse = fit.spectrum.lengths, fit.spectrum.curvature, fit.spectrum.inverse()
    block_s = min(BLOCK_S, max(SHORTEST_BLOCK_S, record.duration_s / BLOCKS_A_RUN))
    blocks = np.flatnonzero(own) // max(1, round(block_s / rows.period_s))
    sums = sums_by(blocks, fit.residual[:, None] * columns / norm)
    few = sums.shape[0] / max(1.0, sums.shape[0] - len(PARAMETERS))
    sd = np.sqrt(np.maximum(np.diag(inverse @ (sums.T @ sums) @ inverse), 0.0) * few)
    inflation = np.diag(inverse)
    level_nm = float(np.sqrt(torque_nm @ torque_nm))
    left = float(np.linalg.norm(fit.residual)) / max(level_nm, 1e-300)
    known = left <= LARGEST_LEFT and sums.shape[0] >= LEAST_BLOCKS
    determined = known & (inflation <= LARGEST_INFLATION) & (sd <= LARGEST_SHARE_SD * level_nm)
    if one_way:
        determined[[DIRECTION, CONSTANT]] = False
    noise_rps2 = _acceleration_noise_rps2(record, rows.cutoff_hz)
    determined[ACCELERATION] &= norm[ACCELERATION] > NOISE_RATIO * noise_rps2 * np.sqrt(count)
    estimates = {
        name: Estimate(float(fit.values[k]), float(sd[k] / norm[k]), bool(determined[k]), float(inflation[k]))
        for k, name in enumerate(PARAMETERS)
    }
    condition = float(curvature[-1] / max(curvature[0], 1e-12))
    return RunLook(record.name, record.begin_s, estimates, one_way, count, condition)


def _acceleration_noise_rps2(record: Record, cutoff_hz: float) -> float:
    """Noise of the acceleration from rounding to whole counts, below a cut-off: white noise, differentiated twice."""
    density = record.lsb_rev**2 / 12.0 * 2.0 * record.period_s
    return float(np.sqrt(density * (2.0 * np.pi) ** 4 * cutoff_hz**5 / 5.0))


def _compared(looks: Sequence[RunLook]) -> list[Remark]:
    """Contradictions and drifts of parameters that several runs determine."""
    torque_nm = max((abs(e.value) for look in looks for n, e in look.estimates.items() if n == "coulomb_nm"), default=0)
    found = []
    for name in PARAMETERS:
        known = [(look, look.estimates[name]) for look in looks if look.estimates[name].determined]
        if len(known) < 2:
            continue
        values = np.array([e.value for _, e in known])
        sds = np.array([max(e.sd, 1e-300) for _, e in known])
        mean = float(np.sum(values / sds**2) / np.sum(1.0 / sds**2))
        scale = max(abs(mean), torque_nm) if name == "offset_nm" else abs(mean)
        first, last = int(np.argmin(values)), int(np.argmax(values))
        spread = float(values[last] - values[first])
        z = spread / float(np.hypot(sds[first], sds[last]))
        if spread <= CONTRADICTION_SHARE * scale or z <= CONTRADICTION_SDS:
            continue
        found.append(_drift(name, known, scale) or _contradiction(name, known, first, last, z))
    return found


def _contradiction(name: str, known: Sequence[tuple[RunLook, Estimate]], first: int, last: int, z: float) -> Remark:
    (low, least), (high, most) = known[first], known[last]
    text = (
        f"{low.name} and {high.name} contradict each other: {WORDS[name]} {least.value:.3g} and {most.value:.3g} "
        f"{unit_in(name)} ({z:.0f} standard deviations). One model cannot hold for both: a payload, a temperature or a "
        "setting changed between them, or they moved in unlike ways that the model does not describe. Fit them apart, "
        "or repeat both with the same motion"
    )
    return Remark("contradiction", (name,), (low.name, high.name), text)


def _drift(name: str, known: Sequence[tuple[RunLook, Estimate]], scale: float) -> Remark | None:
    """A monotone change from run to run over the clock of the log, each step larger than its noise."""
    ordered = sorted(known, key=lambda pair: pair[0].begin_s)
    begins = [look.begin_s for look, _ in ordered]
    if len(ordered) < DRIFT_RUNS or any(b <= a for a, b in itertools.pairwise(begins)):
        return None
    values = np.array([e.value for _, e in ordered])
    sds = np.array([e.sd for _, e in ordered])
    steps = np.diff(values)
    if not (np.all(steps > np.hypot(sds[1:], sds[:-1])) or np.all(-steps > np.hypot(sds[1:], sds[:-1]))):
        return None
    text = (
        f"{WORDS[name]} drifts from run to run, from {values[0]:.3g} to {values[-1]:.3g} {unit_in(name)} "
        f"({100.0 * (values[-1] - values[0]) / scale:+.0f} %) in {begins[-1] - begins[0]:.4g} s. Let the axis warm up "
        "and repeat the first run at the end: what recovers depends on the motion, what does not depends on time"
    )
    return Remark("drift", (name,), tuple(look.name for look, _ in ordered), text)


def _confounded(records: Sequence[Record], rows: RegressionRows, looks: Sequence[RunLook]) -> list[Remark]:
    """Effects that all runs together cannot separate."""
    found = []
    names = tuple(record.name for record in records)
    direction = rows.direction[rows.sliding]
    if turns_one_way(direction):
        text = (
            "all runs go the same way: Coulomb friction and a constant torque are one thing, and so are position and "
            "time. Add the same motion the other way"
        )
        found.append(Remark("confounded", ("coulomb_nm", "offset_nm"), names, text))
    elif len(looks) > 1 and all(look.turns_one_way for look in looks if look.rows >= LEAST_ROWS):
        text = (
            "every run goes one way only: direction, run and travel are one thing, so that a constant torque, "
            "friction that differs by direction and a change between the runs cannot be distinguished. Add a run that "
            "goes both ways"
        )
        found.append(Remark("confounded", ("coulomb_nm", "offset_nm"), names, text))
    else:
        found += _place_is_time(records, rows, names)
    found += _one_speed(rigid_columns(rows)[rows.sliding], looks, names)
    return found


def _place_is_time(records: Sequence[Record], rows: RegressionRows, names: tuple[str, ...]) -> list[Remark]:
    """Runs that pass each position once: dependence on position cannot be separated from drift in time."""
    straight = []
    for number in range(len(records)):
        own = np.flatnonzero(rows.run == number)
        position = rows.position_rev[own]
        if own.size < LEAST_ROWS or np.ptp(position) == 0.0:
            return []
        straight.append(abs(float(np.corrcoef(position, own)[0, 1])))
    if not straight or min(straight) < SAME_TRAVEL:
        return []
    text = "every run passes each place once: position and time are one thing. Add a run that goes back over its way"
    return [Remark("confounded", (), names, text)]


def _one_speed(columns: Floats, looks: Sequence[RunLook], names: tuple[str, ...]) -> list[Remark]:
    speed = np.abs(columns[:, VELOCITY])
    mean, spread = float(speed.mean()), float(speed.std())
    if mean == 0.0 or 1.0 + (mean / max(spread, 1e-300)) ** 2 <= LARGEST_INFLATION:
        return []
    parameters: tuple[str, ...] = ("viscous_nm_per_rps", "coulomb_nm")
    text = "all runs move at one speed: viscous and Coulomb friction are one thing. Add a staircase of constant speeds"
    if not any(look.estimates[PARAMETERS[ACCELERATION]].determined for look in looks if look.estimates):
        parameters = (*parameters, PARAMETERS[ACCELERATION])
        text += ", and accelerate/brake pairs for the inertia"
    return [Remark("confounded", parameters, names, text)]


def _repeated(records: Sequence[Record]) -> list[Remark]:
    """Runs with the same reference, except a steady one."""
    groups: list[list[Record]] = []
    for record in records:
        for group in groups:
            if _same(_asked(group[0]), _asked(record)):
                group.append(record)
                break
        else:
            groups.append([record])
    found = []
    for group in groups:
        if len(group) > 1:
            names = tuple(record.name for record in group)
            text = (
                f"{', '.join(names)} have the same reference: they are repeats of one run. What repeats in them is the "
                "axis, what does not is the floor; held out, one of them proves nothing new. Add a run with another "
                "reference"
            )
            found.append(Remark("repeated_reference", (), names, text))
    return found


def _asked(record: Record) -> Floats:
    """Reference of the run; in open loop its command."""
    return record.current_a if record.reference_rps is None else record.reference_rps


def _same(first: Floats, second: Floats) -> bool:
    size = min(first.size, second.size)
    span = float(np.ptp(first))
    if span == 0.0 or size < 0.9 * max(first.size, second.size):
        return False
    return float(np.abs(first[:size] - second[:size]).max()) <= SAME_REFERENCE * span
