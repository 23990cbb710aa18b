"""Verdicts: a measured number against a range that is ok and a wider range that is a warning."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from ..documents import finite
from .record import FAILED, NOT_DONE, OK, WARNING, CheckRecord, Verdict

# name -> what is checked; the order is that of the report
CHECKS = {
    "standstill": "the axis is at rest without torque",
    "motion": "a bounded current moves the axis",
    "torque_sign": "positive current turns towards rising position",
    "velocity_sign": "velocity has the sign of the change of position",
    "position_sign": "position has the sign of torque and velocity",
    "counts_per_rev": "counts of 0x6064 in one revolution",
    "velocity_scale": "units of 0x606C in one rev/s: integrated velocity over position",
    "velocity_update": "how often the velocity word changes",
    "velocity_age": "how much older the velocity is than the position",
    "current_scale": "current that the drive reports over current commanded",
    "torque_per_inertia": "acceleration per ampere, Kt/J, against the model",
    "delay": "from command to measured motion, against the model's delay_s",
    "static_friction": "current that just moves the axis, times Kt, against the model",
    "current_limit": "the envelope's current limit holds",
    "speed_limit": "beyond the speed limit the axis is stopped",
    "position_window": "outside the position window the axis is stopped",
    "quick_stop": "quick stop brakes harder than friction alone",
    "resonance": "response to a small sweep: whether a load swings on a spring",
    "contact": "response to a small sweep at rest: how stiffly friction holds the axis, against the model",
}


class Range(NamedTuple):
    """Ok in [lowest, highest], a warning in [least, most], else failed."""

    lowest: float
    highest: float
    least: float
    most: float

    def verdict(self, value: float) -> Verdict:
        """Verdict on a number; NaN has failed."""
        if not math.isfinite(value):
            return FAILED
        if self.lowest <= value <= self.highest:
            return OK
        return WARNING if self.least <= value <= self.most else FAILED


def within(centre: float, ok: float, warning: float) -> Range:
    """centre +- ok, centre +- warning."""
    return Range(centre - ok, centre + ok, centre - warning, centre + warning)


def factor(centre: float, ok: float, warning: float) -> Range:
    """centre times or over a factor. `ok` and `warning` are above 1."""
    return Range(centre / ok, centre * ok, centre / warning, centre * warning)


def graded(
    name: str, measured: float, expected: float, limits: Range, unit: str, text: str, remedy: str,
    numbers: Mapping[str, float] | None = None,
) -> CheckRecord:  # fmt: skip
    """A check of a number. The remedy is kept only if the check is not ok."""
    verdict = limits.verdict(measured)
    return CheckRecord(
        name=name,
        what=CHECKS[name],
        verdict=verdict,
        measured=finite(measured),
        expected=finite(expected),
        lowest=finite(limits.lowest),
        highest=finite(limits.highest),
        unit=unit,
        text=text,
        remedy="" if verdict == OK else remedy,
        numbers={key: value for key, value in (numbers or {}).items() if math.isfinite(value)},
    )


def judged(
    name: str, verdict: Verdict, text: str, remedy: str = "", numbers: Mapping[str, float] | None = None
) -> CheckRecord:
    """A check of a fact rather than of a number."""
    kept = {key: float(value) for key, value in (numbers or {}).items() if math.isfinite(value)}
    return CheckRecord(
        name=name, what=CHECKS[name], verdict=verdict, text=text, remedy="" if verdict == OK else remedy, numbers=kept
    )


def not_done(name: str, text: str) -> CheckRecord:
    """A check that an earlier one has made impossible."""
    return CheckRecord(name=name, what=CHECKS[name], verdict=NOT_DONE, text=text)
