"""Checks of the stops: limits set so tight that a small pulse reaches them, and the drive's quick stop."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..control.envelope import LIMIT_CURRENT, TRIP_TEXTS
from .estimate import fall_rate_rps2
from .judge import Range, graded, judged, not_done
from .motion import PulseMotion, pulse_windows, responses
from .motion_checks import MOVED_REV, NOISE_SIGMAS
from .record import FAILED, OK, WARNING, CheckRecord

QUIET_SHARE = 0.05  # of the highest speed: below, the axis counts as stopped
QUIET_RPS = 0.05
STAND_S = 0.1  # at the end: an axis without travel in it is at rest, however noisy its velocity is
LEAVE_S = 0.1  # for the drive to leave Operation Enabled after a trip
HIGH, LOW = 0.85, 0.35  # of the speed at which braking begins: between them decelerations are compared
BRAKES_OK, BRAKES_WARNING = 1.3, 1.1
SHORTEST_FALL_S = 0.01  # if friction stops the axis this fast, the braking of the drive cannot be seen
ENVELOPE_REMEDY = (
    "do not enable this axis: this is a fault of the program or of the drive's state machine; report it with the record"
)


def current_limit(motion: PulseMotion, limit_a: float, asked_a: float, resolution_a: float) -> CheckRecord:
    """A pulse beyond the limit is clamped to the limit, which does not move the axis."""
    highest_a = float(np.abs(motion.command_a).max())
    reported_limited = bool((motion.limits & LIMIT_CURRENT).any())
    moved_rev = max((abs(r.net_rev) for r in responses(motion)), default=math.nan)
    numbers = {"asked_a": asked_a, "limit_a": limit_a, "highest_command_a": highest_a, "travel_rev": moved_rev}
    text = (
        f"{asked_a:.3g} A requested with a limit of {limit_a:.3g} A: {highest_a:.3g} A sent, {moved_rev:.2g} rev moved"
    )
    if highest_a > limit_a + resolution_a or not reported_limited or not motion.enabled.any():
        return judged("current_limit", FAILED, text, ENVELOPE_REMEDY, numbers)
    if moved_rev > MOVED_REV:
        remedy = (
            "the axis moved at a current that had not moved it: friction is uneven, or the drive makes more current "
            "than requested"
        )
        return judged("current_limit", WARNING, text, remedy, numbers)
    return judged("current_limit", OK, text, numbers=numbers)


def trip_row(motion: PulseMotion) -> int:
    """First row with a latched trip; -1 when there is none."""
    tripped = np.flatnonzero(motion.trip)
    return int(tripped[0]) if tripped.size else -1


def stop_after_trip(
    name: str, motion: PulseMotion, expected_trip: int, reached: float, limit: float, unit: str
) -> CheckRecord:
    """A limit was reached on purpose: the right trip, no current from then on, the drive without torque, the axis at
    rest.

    `reached`: how far the axis got, in the unit of the limit.
    """
    row = trip_row(motion)
    peak_rps = float(np.abs(motion.velocity_rps).max())
    if row < 0:
        text = f"no trip at a limit of {limit:.3g} {unit}; the axis reached {reached:.3g} {unit}"
        if reached <= limit:
            return not_done(name, f"{text}, less than with the same pulse before: repeat")
        return judged(name, FAILED, text, ENVELOPE_REMEDY, {"limit": limit, "peak_rps": peak_rps})
    after = motion.part(np.arange(motion.size) >= row)
    left = np.flatnonzero(~after.enabled)
    left_s = float(after.time_s[left[0]] - after.time_s[0]) if left.size else math.nan
    quiet_rps = max(QUIET_RPS, QUIET_SHARE * peak_rps)
    end = after.part(after.time_s >= after.time_s[-1] - STAND_S)
    stands = bool(np.ptp(end.position_rev) <= quiet_rps * STAND_S)
    noise_rps = float(np.std(end.velocity_rps))
    moving = np.flatnonzero(np.abs(after.velocity_rps) > max(quiet_rps, NOISE_SIGMAS * noise_rps))
    stop_s = float(after.time_s[moving[-1]] - after.time_s[0]) if moving.size else 0.0
    way_rev = float(np.abs(after.position_rev - after.position_rev[0]).max())
    numbers = {
        "limit": limit,
        "peak_rps": peak_rps,
        "left_operation_enabled_s": left_s,
        "stopped_after_s": stop_s,
        "stopping_travel_rev": way_rev,
    }
    text = f"tripped at {limit:.3g} {unit}, at rest {stop_s * 1e3:.0f} ms and {way_rev:.3g} rev later"
    trip = int(motion.trip[row])
    if trip != expected_trip:
        return judged(name, FAILED, f"another trip came first: {TRIP_TEXTS[trip]}", ENVELOPE_REMEDY, numbers)
    if (after.command_a != 0.0).any():
        return judged(name, FAILED, "current was commanded after the trip", ENVELOPE_REMEDY, numbers)
    if not left_s <= LEAVE_S:
        remedy = "the drive stays in Operation Enabled after a trip: check its reaction to the controlword (0x6040)"
        return judged(name, FAILED, f"{text}; the drive did not let go", remedy, numbers)
    if not stands:
        remedy = "the axis coasts on: let the drive brake (0x605A, 0x6085), add a brake, or leave it more room"
        return judged(
            name,
            FAILED,
            f"the axis still moved {after.time_s[-1] - after.time_s[0]:.1f} s after the trip",
            remedy,
            numbers,
        )
    return judged(name, OK, text, numbers=numbers)


def quick_stop(stops: Sequence[PulseMotion], coasting: Sequence[PulseMotion]) -> CheckRecord:
    """After a trip the drive brakes by itself: its deceleration against that of an axis left to its friction."""
    braked, free, falls_s, seen = [], [], [], False
    for motion in stops:
        after = motion.part(np.arange(motion.size) >= max(0, trip_row(motion)))
        speed_rps = float(np.abs(after.velocity_rps).max())
        rate = fall_rate_rps2(after, HIGH * speed_rps, LOW * speed_rps)
        coast = _coast_rate_rps2(coasting, speed_rps)
        seen = seen or bool(after.braking.any())
        if math.isfinite(rate) and coast > 0.0:
            braked.append(rate)
            free.append(coast)
            falls_s.append((HIGH - LOW) * speed_rps / coast)
    if not braked:
        remedy = "repeat with a larger --speed; until then do not rely on the quick stop"
        return judged("quick_stop", FAILED, "the axis was too slow, or did not stop: nothing to compare", remedy)
    ratio = float(np.mean(np.divide(braked, free)))
    numbers = {
        "deceleration_rps2": float(np.mean(braked)),
        "coasting_rps2": float(np.mean(free)),
        "quick_stop_active_seen": float(seen),
    }
    text = (
        f"{numbers['deceleration_rps2']:.3g} rps2 after a trip, {numbers['coasting_rps2']:.3g} rps2 by friction alone; "
        f"the statusword {'showed' if seen else 'never showed'} Quick Stop Active"
    )
    if ratio < BRAKES_OK and max(falls_s) < SHORTEST_FALL_S:
        remedy = "friction alone stops the axis as fast; repeat with a larger --speed to see the drive brake"
        return judged("quick_stop", WARNING, text, remedy, numbers)
    remedy = (
        "the drive does not brake: set 0x605A (quick stop option) to 2 or 6 and a steep 0x6085 (quick stop "
        "deceleration); without it every trip coasts"
    )
    limits = Range(BRAKES_OK, math.inf, BRAKES_WARNING, math.inf)
    return graded("quick_stop", ratio, BRAKES_OK, limits, "-", text, remedy, numbers)


def _coast_rate_rps2(coasting: Sequence[PulseMotion], speed_rps: float) -> float:
    """Mean over pulses of the free deceleration through the same speeds."""
    rates = [
        fall_rate_rps2(motion.part(_rows(motion, window)), HIGH * speed_rps, LOW * speed_rps)
        for motion in coasting
        for window in pulse_windows(motion)
    ]
    known = [rate for rate in rates if math.isfinite(rate)]
    return float(np.mean(known)) if known else math.nan


def _rows(motion: PulseMotion, window: slice) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    mask = np.zeros(motion.size, bool)
    mask[window] = True
    return mask
