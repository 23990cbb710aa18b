"""Stability of a loop on one axis, found by experiment: does it come to rest, and does it forget a kick?

Two runs differ in short kicks of the reference, up and down, that move the axis nowhere. Whatever else disturbs the
axis is in both: their difference shows the loop alone. It dies out in a stable loop; in an unstable one or in a limit
cycle it does not, neither in motion nor at rest. The sensor is made ideal: shaking under noise is not hunting.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fffo_drive.arrays import Floats
from fffo_drive.control.envelope import LIMIT_CONTROLLER, LIMIT_CURRENT, TRIP_NONE
from fffo_drive.control.reference import MODE_VELOCITY, Profile, piecewise_linear
from fffo_drive.drive.simulated.parameters import noiseless
from fffo_drive.evaluation.campaign import Candidate, Case, simulate
from fffo_drive.evaluation.metrics import Rows, rms

RAMP_S = 0.02
PLATEAU_S = 4.0
SPEEDS_RPS = (0.3, 1.0, 5.0, 8.0, -5.0, -1.0, -0.3)
REST_S = 6.0  # standstill at the end
HUNTING_S = 1.0  # the last of it: nothing should move any more
KICK_RPS = 0.5
KICK_S = 0.02  # half of it up, half of it down
KICK_AFTER_S = 0.55  # the plateau has settled
KICK_AT_REST_S = 2.2  # after the last step, so that what is left of it falls into HUNTING_S
FORGOTTEN_S = (3.0, 3.12)  # after the kick: what is left of it; a slow integral forgets in a second

HUNTING_RPS = 0.02  # rms of the shaft's velocity at standstill, and of what is left there of a kick
REMAINING_SHARE = 0.3  # of the kick's own difference in motion
REMAINING_RPS = 0.03  # and at least this much
LIMITED_SHARE = 0.2  # of the ticks at the current limit

STABLE = "stable"
TRIPPED = "tripped"
UNSTABLE = "at the current limit"
CYCLE = "limit cycle in motion"
HUNTING = "hunting at standstill"


class Probe(NamedTuple):
    """Result for one axis under one controller."""

    verdict: str
    trip: int
    hunting_rps: float  # rms at standstill
    remaining: float  # largest share of a kick that is left after `FORGOTTEN_S`
    overshoot: float  # largest excursion beyond a level after its step, as a share of the step
    beyond_rest_rps: float  # how fast the axis turns back after its stop at the end
    limited_share: float


def probe_profiles(period_s: float) -> tuple[Profile, Profile]:
    """The staircase without kicks and with them."""
    levels: list[tuple[float, float]] = [(0.0, 0.0), (0.2, 0.0)]
    time_s = 0.2
    for speed_rps in SPEEDS_RPS:
        levels += [(time_s + RAMP_S, speed_rps), (time_s + PLATEAU_S, speed_rps)]
        time_s += PLATEAU_S
    levels += [(time_s + RAMP_S, 0.0), (time_s + REST_S, 0.0)]
    times_s, values_rps = np.array(levels).T
    plain = piecewise_linear("staircase", MODE_VELOCITY, period_s, times_s, values_rps)
    kicked = plain.values.copy()
    half = round(0.5 * KICK_S / period_s)
    for first in kick_samples(period_s):
        kicked[first : first + half] += KICK_RPS
        kicked[first + half : first + 2 * half] -= KICK_RPS
    # the kick's derivative is left out: feed-forward of a step's inertia torque would be a kick of another size
    return plain, Profile("staircase with kicks", MODE_VELOCITY, period_s, kicked, plain.derivatives)


def kick_samples(period_s: float) -> list[int]:
    """First sample of each kick; the last one is at rest."""
    starts_s = [0.2 + number * PLATEAU_S + KICK_AFTER_S for number in range(len(SPEEDS_RPS))]
    starts_s.append(0.2 + len(SPEEDS_RPS) * PLATEAU_S + KICK_AT_REST_S)
    return [round(start_s / period_s) for start_s in starts_s]


def probe(case: Case, candidate: Candidate) -> Probe:
    """Both runs of one controller on the axis of the case; the profile of the case is not used."""
    plain, kicked = probe_profiles(case.session.loop.period_ns * 1e-9)
    case = case._replace(plant=noiseless(case.plant))
    rows, trip = simulate(case._replace(profile=plain), candidate)
    others, trip_kicked = simulate(case._replace(profile=kicked), candidate)
    trip = trip or trip_kicked
    if trip != TRIP_NONE:
        return Probe(TRIPPED, trip, *5 * (float("nan"),))
    first, second = _velocities(rows, plain), _velocities(others, kicked)
    limited_share = float(np.mean(_inside(rows, plain)["limits"] & (LIMIT_CONTROLLER | LIMIT_CURRENT) != 0))
    at_rest = slice(-round(HUNTING_S / plain.period_s), None)
    hunting_rps = rms(first[at_rest])
    *in_motion, left_at_rest_rps = _left_of_kicks(second - first, plain.period_s)
    remaining = max(share for share, _ in in_motion)
    verdict = STABLE
    if limited_share > LIMITED_SHARE:
        verdict = UNSTABLE
    elif remaining > REMAINING_SHARE:
        verdict = CYCLE
    elif hunting_rps > HUNTING_RPS and left_at_rest_rps[1] > 0.5 * HUNTING_RPS:
        verdict = HUNTING
    overshoot = max(excursions(first, plain)[:-1])
    return Probe(verdict, trip, hunting_rps, remaining, overshoot, beyond_rest_rps(first, plain), limited_share)


def _inside(rows: Rows, profile: Profile) -> Rows:
    sample = rows["profile_sample"]
    return rows[(sample >= 0) & (sample < profile.values.size)]


def _velocities(rows: Rows, profile: Profile) -> Floats:
    return np.ascontiguousarray(_inside(rows, profile)["true_velocity_rps"])


def _left_of_kicks(difference_rps: Floats, period_s: float) -> list[tuple[float, float]]:
    """What is left of each kick after `FORGOTTEN_S`: as a share of it (0 below REMAINING_RPS), and in rps."""
    found = []
    for start in kick_samples(period_s):
        made_rps = rms(difference_rps[start : start + round(0.06 / period_s)])
        window = slice(start + round(FORGOTTEN_S[0] / period_s), start + round(FORGOTTEN_S[1] / period_s))
        left_rps = rms(difference_rps[window])
        found.append((left_rps / made_rps if left_rps > REMAINING_RPS and made_rps > 0.0 else 0.0, left_rps))
    return found


def excursions(velocity_rps: Floats, profile: Profile) -> list[float]:
    """Largest excursion beyond each level within its first 0.4 s, as a share of its step; the last is the stop."""
    found, before_rps = [], 0.0
    for number, level_rps in enumerate((*SPEEDS_RPS, 0.0)):
        start = round((0.2 + number * PLATEAU_S + RAMP_S) / profile.period_s)
        step_rps = level_rps - before_rps
        after_rps = velocity_rps[start : start + round(0.4 / profile.period_s)]
        found.append(float(np.max((after_rps - level_rps) * np.sign(step_rps))) / abs(step_rps))
        before_rps = level_rps
    return found


def beyond_rest_rps(velocity_rps: Floats, profile: Profile) -> float:
    """How fast the axis turns back after the stop at the end: over-compensated friction would push it."""
    return excursions(velocity_rps, profile)[-1] * abs(SPEEDS_RPS[-1])
