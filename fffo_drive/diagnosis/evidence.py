"""What rows are worth: coloured noise made white, rows of a restless regime given less weight, the base projected out.

A residual of surfaces is coloured, and presliding is noisier than sliding. An autoregression fitted to the residual
makes rows nearly independent, the same filter runs over every regressor, and the local level of noise weighs them
(generalised least squares). The sensitivities of the base parameters are then projected out of regressor and residual
(Frisch and Waugh), so that what is left is what no refit of the base could explain.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .paths import Rows

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

ORDER = 1  # of the autoregression
MEMORY = 0.75  # largest coefficient: an effect that is still in the residual is slow, and must not pass for noise
SPEED_CLASSES = (0.01, 0.05, 0.2, 0.6)  # limits, in shares of the top speed
LEAST_IN_CLASS = 200
CLIP = 6.0  # robust standard deviations beyond which a row is pulled in


class Whitening(NamedTuple):
    """A filter and weights that make a residual white with unit variance."""

    coefficients: Floats  # (ORDER,) of the rows before
    weight: Floats  # (m,) one over the standard deviation of the innovation; 0: not kept
    kept: Integers  # rows that count


def estimate_whitening(rows: Rows, residual_nm: Floats, classes: Integers) -> Whitening:
    """Noise model of a residual (m,). `classes` (m,) are regimes with a level of noise of their own."""
    kept = rows.kept
    scale = np.ones(residual_nm.size)
    coefficients = np.zeros(ORDER)
    for _ in range(2):
        scaled = np.where(kept, residual_nm / scale, 0.0)
        level = max(float(np.sqrt(np.mean(scaled[kept] ** 2))), 1e-300)
        scaled = np.clip(scaled, -CLIP * level, CLIP * level)
        coefficients = _autoregression(rows, scaled)
        innovation = _filtered(rows, coefficients, residual_nm)
        for number in range(int(classes.max()) + 1):
            inside = kept & (classes == number)
            if inside.sum() < LEAST_IN_CLASS:
                inside = kept
            scale[classes == number] = max(1.4826 * float(np.median(np.abs(innovation[inside]))), 1e-12)
    weight = np.where(kept, 1.0 / scale, 0.0)
    return Whitening(coefficients, weight, np.flatnonzero(kept))


def _autoregression(rows: Rows, scaled: Floats) -> Floats:
    """Correlation of neighbours over pairs of kept rows of one stretch, within limits."""
    covariance = np.zeros(ORDER + 1)
    for lag in range(ORDER + 1):
        total, count = 0.0, 0
        for begin, end in rows.bounds:
            part, kept = scaled[begin:end], rows.kept[begin:end]
            if part.size > lag:
                both = kept[lag:] & kept[: kept.size - lag]
                total += float((part[lag:] * part[: part.size - lag])[both].sum())
                count += int(both.sum())
        covariance[lag] = total / max(1, count)
    if covariance[0] <= 0.0:
        return np.zeros(ORDER)
    return np.asarray(np.clip(covariance[1:] / covariance[0], 0.0, MEMORY), dtype=np.float64)


def _filtered(rows: Rows, coefficients: Floats, values: Floats) -> Floats:
    """Values minus what the rows before foretell; (m,) or (m, k)."""
    found = values.copy()
    for begin, end in rows.bounds:
        for lag, coefficient in enumerate(coefficients, 1):
            found[begin + lag : end] -= coefficient * values[begin : end - lag]
    return found


def whiten(rows: Rows, whitening: Whitening, values: Floats) -> Floats:
    """Values (m,) or (m, k) at the kept rows, white and weighted. (q,) or (q, k)"""
    filtered = _filtered(rows, whitening.coefficients, values)[whitening.kept]
    weight = whitening.weight[whitening.kept]
    return np.asarray(filtered * (weight if values.ndim == 1 else weight[:, None]))


def noise_classes(rows: Rows, travel_rev: Floats, presliding_rev: float) -> Integers:
    """Regimes by speed, and presliding apart. `travel_rev` (m,) since the reversal."""
    speed = np.abs(rows.velocity_rps)
    top = max(float(np.quantile(speed, 0.99)), 1e-12)
    limits = [share * top for share in SPEED_CLASSES]
    found = np.searchsorted(np.array(limits), speed) + 1
    found[travel_rev < presliding_rev] = 0
    return np.asarray(found, dtype=np.int64)


class Evidence(NamedTuple):
    """Residual and base sensitivities, white; what a candidate is scored against."""

    rows: Rows
    whitening: Whitening
    residual: Floats  # (q,) white, base projected out
    basis: Floats  # (q, b) orthonormal: what the base (and accepted effects) can explain
    window: Integers  # (q,)
    windows: int

    @property
    def energy(self) -> float:
        """Sum of squares that is left to explain."""
        return float(self.residual @ self.residual)


def make_evidence(rows: Rows, whitening: Whitening, residual_nm: Floats, known: Floats) -> Evidence:
    """`known` (m, b): sensitivities of everything that is refitted anyway."""
    basis = orthonormal(whiten(rows, whitening, known))
    white = whiten(rows, whitening, residual_nm)
    white = white - basis @ (basis.T @ white)
    scale = 1.4826 * float(np.median(np.abs(white)))
    white = np.clip(white, -CLIP * scale, CLIP * scale)
    white = white - basis @ (basis.T @ white)
    return Evidence(rows, whitening, white, basis, rows.window[whitening.kept], rows.windows)


def orthonormal(columns: Floats, tolerance: float = 1e-9) -> Floats:
    """Orthonormal basis of the columns (q, k), without those that are (nearly) combinations of others. (q, <=k)"""
    norms = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    use = norms > 0.0
    if not use.any():
        return np.zeros((columns.shape[0], 0))
    scaled = columns[:, use] / norms[use]
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    good = values > tolerance * values[-1]
    return np.asarray(scaled @ (vectors[:, good] / np.sqrt(values[good])))


class Score(NamedTuple):
    """What a candidate explains."""

    explained: float  # fall of the sum of squares
    strengths: Floats  # (k,) least-squares strengths
    window_scores: Floats  # (windows, r) contributions of the windows, orthonormal coordinates
    rank: int


def score(evidence: Evidence, columns: Floats) -> Score:
    """Score a candidate's torque columns (m, k), in Nm per unit of strength."""
    white = whiten(evidence.rows, evidence.whitening, columns)
    size = np.sqrt(np.einsum("ij,ij->j", white, white))
    white = white - evidence.basis @ (evidence.basis.T @ white)
    norms = np.sqrt(np.einsum("ij,ij->j", white, white))
    use = norms > np.maximum(1e-6 * size, 1e-12)
    strengths = np.zeros(columns.shape[1])
    if not use.any():
        return Score(0.0, strengths, np.zeros((evidence.windows, 1)), 0)
    scaled = white[:, use] / norms[use]
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    good = values > 1e-8 * values[-1]
    turn = vectors[:, good] / np.sqrt(values[good])
    axes = scaled @ turn
    products = axes * evidence.residual[:, None]
    counts = [np.bincount(evidence.window, products[:, k], evidence.windows) for k in range(products.shape[1])]
    scores = np.stack(counts, axis=1).astype(np.float64)
    total = scores.sum(axis=0)
    strengths[use] = (turn @ total) / norms[use]
    return Score(float(total @ total), strengths, scores, int(good.sum()))
