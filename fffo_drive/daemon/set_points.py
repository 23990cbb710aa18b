"""Requested live set points: checked against the limits, with the bounds of the axis file."""

from __future__ import annotations

import math
from typing import NamedTuple

from ..config.axis import feedforward_config
from ..control.set_point import SetPoint
from ..documents import DocumentError
from ..workflows.plan import Plan

JOG, VELOCITY, STEP, STOP = "jog", "velocity", "step", "stop"

WINDOW_SHARE = 0.1  # of the position window: its margin at most


class AskedSetPoint(NamedTuple):
    """A set point with the kind of its request."""

    kind: str  # JOG, VELOCITY, STEP; STOP brakes
    set_point: SetPoint
    leased: bool = False  # it lives on a lease: it has to be renewed

    @property
    def runs_on_rps(self) -> float:
        """What it leads to in the end, if nobody asks for anything else."""
        return self.set_point.after_rps if self.set_point.hold_ticks else self.set_point.target_rps


def jog(plan: Plan, to_rps: float) -> AskedSetPoint:
    """A velocity that is valid as long as it is renewed in time. Raises DocumentError beyond the limit."""
    return _leased(plan, JOG, to_rps)


def velocity(plan: Plan, to_rps: float, for_s: float | None, run_on: bool) -> AskedSetPoint:
    """A velocity as long as it is renewed, for a time, or until the next set point. Raises DocumentError."""
    if for_s is None and not run_on:
        return _leased(plan, VELOCITY, to_rps)
    return _set_point(plan, VELOCITY, to_rps, for_s or 0.0, 0.0)


def step(
    plan: Plan, before: AskedSetPoint | None, from_rps: float, by_rps: float, for_s: float | None, run_on: bool
) -> AskedSetPoint:
    """A change of the present set point, as `velocity`. After its time the one before runs on, if it may do so by
    itself. Raises DocumentError.
    """
    to_rps = from_rps + by_rps
    if for_s is None and not run_on:
        return _leased(plan, STEP, to_rps)
    return _set_point(plan, STEP, to_rps, for_s or 0.0, 0.0 if before is None else before.runs_on_rps)


def _leased(plan: Plan, kind: str, to_rps: float) -> AskedSetPoint:
    """Not renewed in time, it is braked as by a stop. Standstill needs no renewal."""
    found = _set_point(plan, kind, to_rps, plan.axis.daemon.set_points.jog_timeout_s if to_rps else 0.0, 0.0)
    stopping = found.set_point._replace(after_acceleration_rps2=plan.axis.daemon.stop_rps2)
    return found._replace(set_point=stopping, leased=to_rps != 0.0)


def standstill(plan: Plan) -> AskedSetPoint:
    """A controlled stop."""
    deceleration_rps2, jerk_rps3 = plan.axis.daemon.stop_rps2, plan.axis.daemon.set_points.jerk_rps3
    return AskedSetPoint(STOP, SetPoint(0.0, deceleration_rps2, jerk_rps3, 0, 0.0, deceleration_rps2, *_window(plan)))


def latency_s(plan: Plan) -> float:
    """Latency of a set point because the reference is known ahead, for the preview of feed-forward."""
    period_s = plan.axis.loop.period_s
    feedforward = feedforward_config(plan.axis.controller.feedforward, plan.model, period_s)
    return feedforward.preview_ticks * period_s


def _window(plan: Plan) -> tuple[float, float, float]:
    """Position limits of the motion, and the age of the measured position relative to the newest sample."""
    period_s, sensor_s = plan.axis.loop.period_s, plan.model.sensor_delay_s.value
    lag_s = max(plan.model.delay_s.value + 0.5 * period_s, sensor_s + latency_s(plan))
    window = plan.axis.envelope.position_window_rev
    if window is None:
        return -math.inf, math.inf, lag_s
    margin_rev = min(plan.axis.daemon.set_points.window_margin_rev, WINDOW_SHARE * (window[1] - window[0]))
    return window[0] + margin_rev, window[1] - margin_rev, lag_s


def longest_stop_s(plan: Plan, from_rps: float) -> float:
    """Upper bound of the duration of a controlled stop from a speed, from any acceleration."""
    deceleration_rps2 = plan.axis.daemon.stop_rps2
    section = plan.axis.daemon.set_points
    jerk_s = (max(deceleration_rps2, section.acceleration_rps2) + deceleration_rps2) / section.jerk_rps3
    return from_rps / deceleration_rps2 + jerk_s + latency_s(plan)


def _set_point(plan: Plan, kind: str, to_rps: float, hold_s: float, after_rps: float) -> AskedSetPoint:
    section, limits = plan.axis.daemon.set_points, plan.axis.envelope
    largest_rps = section.largest_rps or limits.speed_limit_rps
    if abs(to_rps) > largest_rps:
        key = "daemon.set_points.largest_rps" if section.largest_rps else "envelope.speed_limit_rps"
        raise DocumentError(f"{kind}: {to_rps:g} rps is beyond {key} {largest_rps:g}")
    # 0.0 takes the sign from a zero
    bounds = section.acceleration_rps2, section.jerk_rps3
    found = SetPoint(to_rps + 0.0, *bounds, 0, 0.0, section.acceleration_rps2, *_window(plan))
    if hold_s > 0:
        ticks = max(1, round(hold_s * plan.axis.loop.rate_hz))
        found = found._replace(hold_ticks=ticks, after_rps=after_rps)
    return AskedSetPoint(kind, found)
