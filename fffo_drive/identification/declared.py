"""Comparison of the declared load with the data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from ..units import NORMAL_95
from .facts import DriveFacts
from .ladder import GRAVITY_PERIODS

Fitted = tuple[str, float, float | None]  # name of a number, value, standard deviation
WEIGHT = "unbalance"  # the law of it ...
WEIGHT_PARTS = ("cos_nm", "sin_nm")  # ... and its numbers
DECLARED_TOLERANCE = 0.1  # of a declared weight: masses and lever arms are rarely known better


def wave_size(cos: float, sin: float, cos_sd: float | None, sin_sd: float | None) -> tuple[float, float]:
    """Amplitude of a wave and its standard deviation; NaN where none is known."""
    size = math.hypot(cos, sin)
    if cos_sd is None or sin_sd is None or size == 0.0:
        return size, math.nan
    return size, math.hypot(cos * cos_sd, sin * sin_sd) / size


def weight_remarks(facts: DriveFacts, found: Iterable[tuple[str, Sequence[Fitted]]], travel_rev: float) -> list[str]:
    """`gravity_remark` of the effects that were found, each with its numbers; of each run its own, the first counts."""
    size = None
    for effect, numbers in found:
        if effect == WEIGHT:
            (cos, cos_sd), (sin, sin_sd) = (
                next((value, sd) for name, value, sd in numbers if name == part) for part in WEIGHT_PARTS
            )
            size = wave_size(cos, sin, cos_sd, sin_sd)
    remark = gravity_remark(facts, size, travel_rev)
    return [remark] if remark else []


def gravity_remark(facts: DriveFacts, found_nm: tuple[float, float] | None, travel_rev: float) -> str:
    """One sentence if the declared weight of the load contradicts the data; else empty.

    `found_nm`: amplitude of the fitted weight at the motor shaft and its standard deviation; None where none was found.
    """
    declared_nm = facts.load_gravity_nm
    if declared_nm is None:
        return ""
    said = f"load_gravity_nm declares {declared_nm:.4g} Nm"
    turns = travel_rev / (facts.gear_ratio or 1.0)
    if found_nm is None:
        if turns < GRAVITY_PERIODS:
            return (
                f"{said}; the logs travel {turns:.2g} turns of the output, which do not show a weight: record "
                f"{GRAVITY_PERIODS:g} turns and more"
            )
        return f"{said}, and the data show no weight: another load, another gear_ratio, or a balanced axis"
    amplitude_nm, sd_nm = found_nm
    reach_nm = NORMAL_95 * sd_nm if math.isfinite(sd_nm) else 0.0
    if abs(amplitude_nm - declared_nm) <= reach_nm + DECLARED_TOLERANCE * declared_nm:
        return ""
    return (
        f"{said}; the data show {amplitude_nm:.4g} +- {reach_nm:.2g} Nm: another load, or a torque constant "
        f"that is {amplitude_nm / declared_nm:.3g} times the true one"
    )
