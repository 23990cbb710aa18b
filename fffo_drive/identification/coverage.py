"""What a set of logs can determine, reported before any fit: speeds, accelerations, reversals, dwells, angle, orders;
and what to record next.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..units import text_on, unit_on
from .dataset import Record
from .kinematics import DEFAULT_CUTOFF_HZ, motion_of
from .ladder import SLOW_QUANTILE
from .rows import LEAST_OTHER_WAY

REST_SHARE = 0.005  # of the highest speed: slower is rest ...
REST_COUNTS_PER_S = 50.0  # ... and so is one count of the sensor in a twentieth of a second
DWELL_S = 0.1  # shorter rests are reversals
LEAST_REVERSALS = 8
LEAST_DWELLS = 3
LEAST_LEVELS = 3  # range of speed needed to separate viscous and Coulomb friction
SLOW_SHARE = 0.05  # of the highest speed: the Stribeck curve is below
LEAST_SLOW_S = 1.0
LEAST_TURNS = 1.0
FAST_SHARE = 0.1  # of the highest acceleration: above it the axis accelerates or brakes ...
LEAST_FAST_S = 1.0  # ... and for so long


class Coverage(NamedTuple):
    """Coverage of all logs together. For a linear axis, revolutions stand for m."""

    runs: int
    duration_s: float
    moving_s: float
    rate_hz: float
    cutoff_hz: float  # of what a fit sees
    highest_rps: float
    slow_rps: float  # 10 % quantile of the speed in motion
    slow_s: float  # time below SLOW_SHARE of the highest speed
    highest_rps2: float
    speeding_s: float  # time at or above FAST_SHARE of the highest acceleration
    backward_share: float
    reversals: int
    dwells: int
    longest_dwell_s: float
    travel_rev: float  # between the ends
    levels: int  # of eight equal classes of speed, those with a twentieth of the motion
    highest_order: float  # highest order (periods per revolution) that the slow part resolves


def coverage_of(records: Sequence[Record], cutoff_hz: float = DEFAULT_CUTOFF_HZ) -> Coverage:
    """Evaluate all segments of the records. Raises DataError if there is none."""
    cutoff_hz = min(cutoff_hz, 0.1 / records[0].period_s)
    speeds, accelerations, travels = [], [], []
    reversals, dwells, longest_s = 0, 0, 0.0
    for record in records:
        parts = [motion_of(record, part, cutoff_hz) for part in record.segments()]
        top = max(float(np.abs(part.velocity_rps).max()) for part in parts)
        rest_rps = max(REST_SHARE * top, REST_COUNTS_PER_S * record.lsb_rev)
        for part in parts:
            sign = np.sign(np.where(np.abs(part.velocity_rps) < rest_rps, 0.0, part.velocity_rps))
            moving = sign[sign != 0.0]
            reversals += int(np.count_nonzero(np.diff(moving)))
            rests = lengths_of(sign == 0.0) * record.period_s
            dwells += int(np.count_nonzero(rests > DWELL_S))
            longest_s = max(longest_s, float(rests.max(initial=0.0)))
            speeds.append(part.velocity_rps[sign != 0.0])
            accelerations.append(np.abs(part.acceleration_rps2[sign != 0.0]))
            travels.append(part.position_rev[[part.position_rev.argmin(), part.position_rev.argmax()]])
    velocity, acceleration = np.concatenate(speeds), np.concatenate(accelerations)
    period_s = records[0].period_s
    speed = np.abs(velocity)
    top = float(np.quantile(speed, 0.999)) if speed.size else 0.0
    slow = float(np.quantile(speed, SLOW_QUANTILE)) if speed.size else 0.0
    fastest = float(np.quantile(acceleration, 0.999)) if speed.size else 0.0
    classes = np.histogram(speed, bins=8, range=(0.0, top or 1.0))[0] / max(1, speed.size)
    ends = np.concatenate(travels)
    return Coverage(
        runs=len(records),
        duration_s=sum(record.duration_s for record in records),
        moving_s=speed.size * period_s,
        rate_hz=1.0 / period_s,
        cutoff_hz=cutoff_hz,
        highest_rps=top,
        slow_rps=slow,
        slow_s=float(np.count_nonzero(speed < SLOW_SHARE * top)) * period_s,
        highest_rps2=fastest,
        speeding_s=float(np.count_nonzero(acceleration > FAST_SHARE * fastest)) * period_s,
        backward_share=float(min(np.mean(velocity > 0.0), np.mean(velocity < 0.0))) if speed.size else 0.0,
        reversals=reversals,
        dwells=dwells,
        longest_dwell_s=longest_s,
        travel_rev=float(np.ptp(ends)),
        levels=int(np.count_nonzero(classes > 0.05)),
        highest_order=cutoff_hz / slow if slow > 0.0 else math.inf,
    )


def lengths_of(flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Lengths of the runs of true in flags (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return np.asarray(edges[1::2] - edges[::2], dtype=np.int64)


def shown(coverage: Coverage, linear: bool = False) -> list[str]:
    """What the data can determine, one sentence each."""
    turn, speed, acceleration = (unit_on(unit, linear) for unit in ("rev", "rps", "rps2"))
    ways = "one way only" if coverage.backward_share < LEAST_OTHER_WAY else "both ways"
    waves = f"{coverage.highest_order:.3g} periods per {'metre' if linear else 'revolution'}"
    return [
        f"{coverage.moving_s:.4g} s of motion in {coverage.duration_s:.4g} s at {coverage.rate_hz:.5g} Hz, {ways}",
        f"speeds up to {coverage.highest_rps:.4g} {speed}, a tenth of the motion below {coverage.slow_rps:.3g} {speed}",
        f"accelerations up to {coverage.highest_rps2:.4g} {acceleration} (below {coverage.cutoff_hz:.3g} Hz)",
        f"{coverage.reversals} reversals, {coverage.dwells} dwells (the longest {coverage.longest_dwell_s:.3g} s)",
        f"travel {coverage.travel_rev:.4g} {turn}; ripple over the position visible up to about {waves}",
    ]


def coverage_lines(coverage: Coverage, linear: bool = False) -> list[str]:
    """`shown` and `to_record` for a terminal."""
    lines = ["what these data can show:", *(f"  {line}" for line in shown(coverage, linear))]
    wanted = to_record(coverage, linear)
    return lines + (
        ["what they do not determine, and what to record for it:", *(f"  {line}" for line in wanted)] if wanted else []
    )


def to_record(coverage: Coverage, linear: bool = False) -> list[str]:
    """What the data do not determine, and the part of the `recipe` profile that would; the most important first."""
    found = []
    if coverage.backward_share < LEAST_OTHER_WAY:
        found.append(
            "a constant torque beside Coulomb friction: all motion goes one way: record the same motion the other way"
        )
    if coverage.speeding_s < LEAST_FAST_S:
        found.append("inertia: too little of the motion speeds up or brakes: accelerate/brake pairs (`pairs`)")
    if coverage.levels < LEAST_LEVELS:
        found.append("viscous friction: too narrow a range of speeds: a staircase of constant speeds (`staircase`)")
    if coverage.slow_s < LEAST_SLOW_S:
        found.append("Stribeck curve: hardly any slow motion: a staircase with slow levels (`staircase`)")
    if coverage.reversals < LEAST_REVERSALS:
        found.append("presliding and frictional lag: too few reversals: slow triangles (`triangles`)")
    if coverage.dwells < LEAST_DWELLS:
        found.append("break-away after rest: too few dwells: standstills of six lengths (`dwells`)")
    if not linear and coverage.travel_rev < LEAST_TURNS:
        found.append(
            "ripple over the angle: less than one revolution travelled: slow creep over five revolutions (`creep`)"
        )
    return [text_on(text, linear) for text in found]
