"""The additive part of a record: a run's force balance as normal equations, and what these give.

Torque is regressed on what the motion needs, on the rows on which `identify` stands (`identification.rows`):

    torque = J a + sigma w + Fc d + Fst d exp(-|w| / V0) + offset + excess |w| + C cos(angle) + S sin(angle)

a acceleration, w velocity, d its direction; V0 is one number for all, so that the records of an axis add up to the fit
on all of its rows. The last two columns are there where the angle has the same zero in every run.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..identification.criterion import BLOCK_S, SHORTEST_BLOCK_S
from ..identification.facts import DriveFacts
from ..identification.ladder import GRAVITY_PERIODS, wave_columns
from ..identification.rows import RegressionRows, turns_one_way

Floats = npt.NDArray[np.float64]

PARAMETERS = (
    "inertia_nm_s2_per_rev", "viscous_nm_per_rps", "coulomb_nm", "stribeck_nm", "offset_nm",
    "viscous_excess_nm_per_rps", "gravity_cos_nm", "gravity_sin_nm",
)  # fmt: skip
INERTIA, VISCOUS, COULOMB, STRIBECK, OFFSET, EXCESS, GRAVITY_COS, GRAVITY_SIN = range(len(PARAMETERS))
RUNGS = {  # of the ladder, those that are columns here
    "constant": (OFFSET,), "direction": (EXCESS,), "gravity": (GRAVITY_COS, GRAVITY_SIN),
}  # fmt: skip
STRIBECK_RPS = 1.0  # V0: between those of small servo motors; one for all, or records would not add up
STRIBECK_M_PER_S = 0.02  # V0 of a linear axis
SINGULAR = 1e-9  # of the scaled normal matrix: what columns have in common beyond it is not known
BLOCKS_A_RUN = 60  # of a short run, which are independent pieces: several times as many as columns
LARGEST_INFLATION = 1e3  # of a variance by the other columns: an estimate beyond it says nothing by itself
UPPER = np.triu_indices(len(PARAMETERS))


class Balance(NamedTuple):
    """Normal equations of m rows with p columns: those of two sets of rows are added field by field."""

    normal: Floats  # (p, p) X^T X
    moment: Floats  # (p,) X^T y
    energy_nm2: float  # y^T y
    rows: float
    effective_rows: float  # independent ones among them: rows that follow each other say nearly the same

    def with_rows_of(self, other: Balance) -> Balance:
        """Both sets of rows together."""
        return Balance(
            self.normal + other.normal, self.moment + other.moment, self.energy_nm2 + other.energy_nm2,
            self.rows + other.rows, self.effective_rows + other.effective_rows,
        )  # fmt: skip


class Estimates(NamedTuple):
    """What a balance gives."""

    theta: Floats  # (p,) of PARAMETERS, finite; what is not determined is the smallest that fits
    information: Floats  # (p, p) inverse covariance; 0 along what is not determined
    sd: Floats  # (p,) nan where a parameter is not determined
    rms_nm: float  # of the residual


def balance_columns(rows: RegressionRows, facts: DriveFacts) -> Floats:
    """Columns of the balance at all rows, in the order of PARAMETERS; 0 where the motion has none. (m, p)"""
    speed = np.abs(rows.velocity_rps)
    v0_rps = STRIBECK_M_PER_S if facts.units == "linear" else STRIBECK_RPS
    columns = np.zeros((speed.size, len(PARAMETERS)))
    columns[:, INERTIA] = rows.acceleration_rps2
    columns[:, VISCOUS] = rows.velocity_rps
    columns[:, COULOMB] = rows.direction
    columns[:, STRIBECK] = rows.direction * np.exp(-speed / v0_rps)
    if not turns_one_way(rows.direction[rows.sliding]):  # else they are Coulomb and viscous friction
        columns[:, OFFSET] = 1.0
        columns[:, EXCESS] = speed
    order = 1.0 / (facts.gear_ratio or 1.0)
    travel = float(np.ptp(rows.position_rev[rows.sliding])) if rows.sliding.any() else 0.0
    if facts.units == "rotary" and facts.absolute_angle and order * travel >= GRAVITY_PERIODS:
        columns[:, GRAVITY_COS:] = wave_columns(rows, order)
    return columns


def balance_of(columns: Floats, rows: RegressionRows) -> Balance:
    """Normal equations of the rows that slide for sure; `columns` (m, p) of all rows."""
    kept = np.flatnonzero(rows.sliding)
    own, torque_nm = columns[kept], rows.torque_nm[kept]
    duration_s = rows.run.size * rows.period_s
    block_s = min(BLOCK_S, max(SHORTEST_BLOCK_S, duration_s / BLOCKS_A_RUN))
    block = kept // max(1, round(block_s / rows.period_s))
    begins = np.flatnonzero(np.diff(block, prepend=-1))
    whole = Balance(own.T @ own, own.T @ torque_nm, float(torque_nm @ torque_nm), float(kept.size), float(kept.size))
    solution = solve(whole)
    scores = own * (torque_nm - own @ solution.theta)[:, None]
    sums = np.add.reduceat(scores, begins, axis=0) if kept.size else scores
    return whole._replace(effective_rows=_effective_rows(whole, sums, solution.rms_nm))


def _effective_rows(balance: Balance, sums: Floats, rms_nm: float) -> float:
    """Rows over how much larger variances are than those of independent rows, by blocks' scores (b, p)."""
    scaled = _Scaled(balance.normal)
    if rms_nm == 0.0 or scaled.rank == 0 or sums.shape[0] <= scaled.rank:
        return balance.rows
    half = sums / scaled.scale @ scaled.directions / np.sqrt(scaled.curvature)
    few = sums.shape[0] / (sums.shape[0] - scaled.rank)
    ratio = few * float(np.sum(half**2)) / (scaled.rank * rms_nm**2)
    return float(balance.rows / max(1.0, ratio))


class _Scaled:
    """A normal matrix with columns of length one: the directions in which it determines something."""

    def __init__(self, normal: Floats) -> None:
        length = np.sqrt(np.diag(normal))
        self.scale: Floats = np.where(length > 0.0, length, 1.0)
        curvature, directions = np.linalg.eigh(normal / np.outer(self.scale, self.scale))
        known = curvature > SINGULAR
        self.curvature: Floats = curvature[known]
        self.directions: Floats = directions[:, known]  # (p, rank)
        self.rank = int(known.sum())

    @cached_property
    def inverse(self) -> Floats:
        """Pseudo-inverse, still scaled."""
        return np.asarray((self.directions / self.curvature) @ self.directions.T)


def solve(balance: Balance) -> Estimates:
    """Least squares, with the covariance that the effective rows give."""
    scaled = _Scaled(balance.normal)
    theta = scaled.inverse @ (balance.moment / scaled.scale) / scaled.scale
    left = max(balance.energy_nm2 - float(balance.moment @ theta), 0.0)
    variance_nm2 = left / max(balance.rows - scaled.rank, 1.0)
    information = np.zeros_like(balance.normal)
    sd = np.full(theta.size, np.nan)
    if variance_nm2 > 0.0:
        share = balance.effective_rows / balance.rows
        kept = (scaled.directions * scaled.curvature) @ scaled.directions.T * np.outer(scaled.scale, scaled.scale)
        information = kept * (share / variance_nm2)
        inflation = np.diag(scaled.inverse)
        # a direction that is not determined and has a part in a parameter: nor is that
        within = np.abs(np.sum(scaled.directions**2, axis=1) - 1.0) < SINGULAR**0.5
        known = within & (inflation < LARGEST_INFLATION) & (np.diag(balance.normal) > 0.0)
        sd[known] = np.sqrt(inflation[known] * variance_nm2 / share) / scaled.scale[known]
    return Estimates(theta, information, sd, float(np.sqrt(left / balance.rows)) if balance.rows else 0.0)


def explained_by(balance: Balance, without: tuple[int, ...]) -> float:
    """Share of the squared residual that these columns explain beside all others: of a rung of the ladder."""
    keep = np.setdiff1d(np.arange(len(PARAMETERS)), without)
    rest = solve(balance._replace(normal=balance.normal[np.ix_(keep, keep)], moment=balance.moment[keep]))
    left, whole = rest.rms_nm**2, solve(balance).rms_nm ** 2
    return max(0.0, 1.0 - whole / left) if left > 0.0 else 0.0


def packed(normal: Floats) -> Floats:
    """Upper triangle of (p, p), row by row."""
    return np.asarray(normal[UPPER])


def unpacked(upper: Floats) -> Floats:
    """(..., p, p) of upper triangles (..., p (p + 1) / 2)."""
    size = len(PARAMETERS)
    full = np.zeros((*upper.shape[:-1], size, size))
    full[..., UPPER[0], UPPER[1]] = upper
    full[..., UPPER[1], UPPER[0]] = upper
    return full
