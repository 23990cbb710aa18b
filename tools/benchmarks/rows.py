"""Rows of a torque balance straight from records, for yardsticks that know nothing of the product's own rows.

Position and command go through the same filter (Butterworth of third order, zero phase), the position is
differentiated after that, and all is thinned. Nothing is simulated, and no delay is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from fffo_drive.identification.dataset import Record

Floats = np.ndarray[Any, np.dtype[np.float64]]

CUTOFF_HZ = 45.0
ROWS_PER_CUTOFF = 4.0  # rate of the rows over the cut-off
STICK_SHARE = 0.005  # of the fastest speed (99 %): width of the smoothed sign
LEAST_BACK = 0.1  # of the rows, for both ways to have been gone
ALIKE = 0.03  # least singular value over the largest, columns of one length
EDGE_PERIODS = 2.0  # of the cut-off, left out at both ends of a stretch


class Rows(NamedTuple):
    """(n,) each."""

    torque_nm: Floats
    position_rev: Floats
    velocity_rps: Floats
    acceleration_rps2: Floats


def rows_of(records: Sequence[Record], cutoff_hz: float = CUTOFF_HZ) -> Rows:
    """Rows of all stretches between gaps; torque is commanded."""
    parts: list[tuple[Floats, ...]] = []
    for record in records:
        period_s = record.period_s
        sections = butter(3, cutoff_hz, fs=1.0 / period_s, output="sos")
        step = max(1, int(1.0 / (period_s * ROWS_PER_CUTOFF * cutoff_hz)))
        edge = int(EDGE_PERIODS / (cutoff_hz * period_s)) + 1
        for part in record.segments():
            if part.stop - part.start < 4 * edge:
                continue
            torque = sosfiltfilt(sections, record.torque_constant_nm_per_a * record.current_a[part])
            position = sosfiltfilt(sections, record.position_rev[part])
            velocity = np.gradient(position, period_s)
            columns = (torque, position, velocity, np.gradient(velocity, period_s))
            parts.append(tuple(column[edge:-edge:step] for column in columns))
    return Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def sign_width_rps(rows: Rows) -> float:
    """Width of the smoothed sign of the velocity, to be kept from the fit runs to the held-out ones."""
    return STICK_SHARE * float(np.quantile(np.abs(rows.velocity_rps), 0.99))


def axis_columns(rows: Rows, width_rps: float) -> Floats:
    """What any axis has: acceleration, velocity, sign of the velocity. (n, 3)"""
    return np.column_stack([rows.acceleration_rps2, rows.velocity_rps, np.tanh(rows.velocity_rps / width_rps)])


def least_squares(columns: Floats, torque_nm: Floats) -> Floats:
    """Strengths (k,) of columns (n, k). What `ALIKE` columns cannot be told apart by is shared between them."""
    scale = np.linalg.norm(columns, axis=0) + 1e-300
    return np.asarray(np.linalg.lstsq(columns / scale, torque_nm, rcond=ALIKE)[0] / scale)


class Textbook(NamedTuple):
    """A least-squares fit: inertia (Nm s2/rev), viscous, Coulomb; if asked a constant, sin and cos of the angle."""

    strengths: Floats
    width_rps: float
    with_constant: bool
    with_angle: bool

    @staticmethod
    def fit(rows: Rows, with_angle: bool = False, with_constant: bool = True) -> Textbook:
        """Fit on rows."""
        unfitted = Textbook(np.zeros(0), sign_width_rps(rows), with_constant, with_angle)
        strengths = least_squares(unfitted.columns(rows), rows.torque_nm)
        return unfitted._replace(strengths=strengths)

    def columns(self, rows: Rows) -> Floats:
        """(n, 3 to 6)"""
        columns = [axis_columns(rows, self.width_rps)]
        if self.with_constant:
            columns.append(np.ones((rows.torque_nm.size, 1)))
        if self.with_angle:
            angle = 2.0 * np.pi * rows.position_rev
            columns.append(np.column_stack([np.sin(angle), np.cos(angle)]))
        return np.column_stack(columns)

    def left(self, rows: Rows) -> Floats:
        """Torque that it does not explain, Nm (n,)."""
        return np.asarray(rows.torque_nm - self.columns(rows) @ self.strengths)


def needed_nm(fitted: Rows, rows: Rows, with_angle: bool) -> Floats:
    """Torque that the axis needs on `rows` by a textbook fit: inertia and friction (n,). Where it hardly moved both
    ways, Coulomb friction and a constant are the same thing, and all of it counts as friction."""
    width_rps = sign_width_rps(fitted)
    both_ways = min(float(np.mean(way * fitted.velocity_rps > width_rps)) for way in (-1.0, 1.0)) > LEAST_BACK
    book = Textbook.fit(fitted, with_angle, both_ways)
    return np.asarray(axis_columns(rows, book.width_rps) @ book.strengths[:3])


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))
