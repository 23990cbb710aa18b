"""Cyclic error of the position sensor, by order, from a reference encoder on the same shaft; torque is not needed.

    position - reference = offset of the run + lag * velocity + sum over k of a_k cos(2 pi k x) + b_k sin(2 pi k x)

with x the sensor's own angle: a resolver errs once and twice a turn (eccentricity, unequal windings), and at its poles.
Each sample is the error at its own angle, so that no order aliases. Standard deviations are by the sandwich over
windows (White, 1980), because errors of neighbouring samples are correlated.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Mask
from ..least_squares import least_squares, sums_by
from ..units import NORMAL_95, TWO_PI
from .coverage import LEAST_TURNS
from .criterion import folds_of
from .dataset import DataError, Record

HIGHEST_ORDER = 64  # periods a turn
WINDOWS_AN_ORDER = 4  # of data: each order has two numbers
MOST_ROWS = 50_000
ANGLE_CLASSES = 360  # of the curve over a turn
SURE_SDS = 4.0  # of an amplitude over its standard deviation: one false order in 40 runs of 64 orders
ARCMIN = 360.0 * 60.0  # of a turn
OTHER_SHAFT = 0.02  # of the travel, by which two sensors of one shaft may differ


class Order(NamedTuple):
    """One term of the error: amplitude * cos(2 pi (order * x - phase))."""

    order: int
    amplitude_rev: float
    sd_rev: float
    phase_rev: float  # of the order's own period, 0 to 1

    @property
    def is_sure(self) -> bool:
        """Whether it is significant."""
        return self.amplitude_rev > SURE_SDS * self.sd_rev


class CyclicError(NamedTuple):
    """Cyclic error of a position sensor."""

    orders: tuple[Order, ...]  # every order that was fitted, 1 first
    lag_s: float  # of the sensor behind the reference
    lag_sd_s: float
    peak_to_peak_rev: float  # of the significant orders together
    left_rms_rev: float
    samples: int
    angle_rev: Floats  # (n,) classes over a turn ...
    mean_rev: Floats  # (n,) ... and the mean error in each; NaN without data

    @property
    def sure(self) -> tuple[Order, ...]:
        """Significant orders, the largest first."""
        return tuple(sorted((one for one in self.orders if one.is_sure), key=lambda one: -one.amplitude_rev))

    def error_rev(self, angle_rev: Floats) -> Floats:
        """Error of the significant orders at angles (n,) of the sensor, to be subtracted from its position."""
        found = np.zeros_like(angle_rev)
        for one in self.sure:
            found += one.amplitude_rev * np.cos(TWO_PI * (one.order * angle_rev - one.phase_rev))
        return found

    def as_plain(self) -> dict[str, object]:
        """For a report."""
        return {
            "orders": [one._asdict() | {"sure": one.is_sure} for one in self.orders], "lag_s": self.lag_s,
            "lag_sd_s": self.lag_sd_s, "peak_to_peak_rev": self.peak_to_peak_rev, "left_rms_rev": self.left_rms_rev,
            "samples": self.samples,
        }  # fmt: skip


def cyclic_error(records: Sequence[Record]) -> CyclicError | None:
    """Of the records with a reference encoder; None where none has one.

    Raises DataError if the two sensors are not on one shaft, or the travel is less than a turn.
    """
    able = [record for record in records if record.reference_position_rev is not None]
    if not able:
        return None
    parts = [_errors(record, part) for record in able for part in record.segments()]
    error, angle, velocity = (np.concatenate([part[k] for part in parts]) for k in range(3))
    good = np.concatenate([part[3] for part in parts])
    ends = np.cumsum([part[0].size for part in parts])
    stretch = np.repeat(np.arange(ends.size), np.diff(ends, prepend=0))
    travel_rev = float(np.ptp(angle))
    if travel_rev < LEAST_TURNS:
        raise DataError(
            f"{able[0].path}: {travel_rev:.3g} rev are travelled: the cyclic error of a sensor needs a whole turn"
        )
    rows = np.flatnonzero(good)
    rows = rows[:: max(1, math.ceil(rows.size / MOST_ROWS))]
    window = folds_of(list(itertools.pairwise([0, *ends.tolist()])), able[0].period_s).window[rows]
    error, angle, velocity, stretch = error[rows], angle[rows], velocity[rows], stretch[rows]
    highest = max(1, min(HIGHEST_ORDER, np.unique(window).size // WINDOWS_AN_ORDER))
    phase = TWO_PI * np.outer(angle, np.arange(1, highest + 1))
    offsets = (stretch[:, None] == np.unique(stretch)).astype(np.float64)
    matrix = np.concatenate([np.cos(phase), np.sin(phase), velocity[:, None], offsets], axis=1)
    fit = least_squares(matrix, error)
    values, half = fit.values, fit.spectrum.basis()
    turned = sums_by(window, fit.residual[:, None] * matrix) @ half  # scores of each window, in orthonormal columns
    freedom = turned.shape[0] / max(1, turned.shape[0] - values.size)  # the fitted residual is smaller than the noise
    covariance = freedom * half @ (turned.T @ turned) @ half.T
    orders = tuple(_order(k, highest, values, covariance) for k in range(1, highest + 1))
    classes = np.minimum((np.mod(angle, 1.0) * ANGLE_CLASSES).astype(np.int64), ANGLE_CLASSES - 1)
    count = np.bincount(classes, minlength=ANGLE_CLASSES)
    rest = np.bincount(classes, error - matrix[:, 2 * highest :] @ values[2 * highest :], ANGLE_CLASSES)
    with np.errstate(invalid="ignore"):
        mean = np.where(count > 0, rest / count, np.nan)
    lag = 2 * highest
    found = CyclicError(
        orders, float(values[lag]), float(np.sqrt(covariance[lag, lag])), 0.0, float(np.sqrt(np.mean(fit.residual**2))),
        error.size, (np.arange(ANGLE_CLASSES) + 0.5) / ANGLE_CLASSES, mean,
    )  # fmt: skip
    return found._replace(peak_to_peak_rev=float(np.ptp(found.error_rev(np.linspace(0.0, 1.0, 20 * HIGHEST_ORDER)))))


def cyclic_lines(found: CyclicError) -> list[str]:
    """The error in words, for a terminal."""
    lines = [
        f"the position sensor against the reference encoder: {ARCMIN * found.peak_to_peak_rev:.3g} arcmin peak to peak "
        f"by order, {ARCMIN * found.left_rms_rev:.3g} arcmin rms of other error; {1e3 * found.lag_s:.3g} +- "
        f"{1.96e3 * found.lag_sd_s:.2g} ms behind"
    ]
    lines += [
        f"  {one.order:3d} a turn: {ARCMIN * one.amplitude_rev:.3g} +- {NORMAL_95 * ARCMIN * one.sd_rev:.2g} arcmin"
        for one in found.sure
    ]
    return lines if found.sure else [*lines, "  no order is beyond noise"]


def _errors(record: Record, part: slice) -> tuple[Floats, Floats, Floats, Mask]:
    """Error, angle and velocity of a stretch, and where they were measured, (n,) each."""
    assert record.reference_position_rev is not None
    position, reference = record.position_rev[part], record.reference_position_rev[part]
    error = position - reference
    if np.ptp(error) > OTHER_SHAFT * max(float(np.ptp(position)), LEAST_TURNS):
        raise DataError(
            f"{record.path}: reference_position_rev is not that of the same shaft: it differs from the position by "
            f"{np.ptp(error):.3g} rev over {np.ptp(position):.3g} rev: a wrong unit, gear or sign"
        )
    good = np.ones(error.size, bool) if record.good is None else record.good[part]
    return error - error.mean(), position, np.gradient(reference, record.period_s), good


def _order(order: int, highest: int, values: Floats, covariance: Floats) -> Order:
    place = [order - 1, highest + order - 1]
    cos, sin = values[place]
    size = math.hypot(cos, sin)
    own = covariance[np.ix_(place, place)]
    along = np.array([cos, sin]) / max(size, 1e-300)
    sd = math.sqrt(max(float(along @ own @ along), 0.5 * float(np.trace(own))))
    return Order(order, size, sd, math.atan2(sin, cos) / TWO_PI % 1.0)
