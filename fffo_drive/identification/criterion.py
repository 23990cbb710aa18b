"""The only criterion by which an effect is kept: cross-validated gain, on rows that were not in the fit.

Rows are assigned to folds in blocks; the loss of each fold comes from a fit to the others. The gain G of an effect is
the decrease of the loss; its standard deviation comes from the blocks, because neighbouring rows are not independent.
The significance of an effect is tested on the windows' scores by Hotelling's T2 (Hotelling, 1931), without surrogates,
whose spread would grow with the effect itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy  # its modules load where they are first used

from ..arrays import Floats, Integers
from ..least_squares import HUBER, huber, huber_weights, normal_equations, spectrum
from ..units import MAD_TO_SD

FOLDS = 5
BLOCK_S = 2.0  # blocks are taken as independent; two neighbours go into one fold ...
BLOCKS = 50  # ... and a short log has at least this many
SHORTEST_BLOCK_S = 0.2
WINDOWS_A_BLOCK = 4
SDS = 2.0  # of the gain, below which it may be chance
DISTINCT = 1e-3  # share of the square of a torque or column that must remain when everything else is projected out
# of a column's squared norm: a coefficient that the other folds hardly determine stays at the value of all rows
RIDGE = 1e-4
LEVERAGE_WINDOWS = 20.0  # no window of a column and no block of a gain counts for more than one in this many
ROBUST_STEPS = 4  # of reweighted least squares
SMALLEST_P = 1e-12  # smallest p: the tail beyond it is not known
LEAST_IN_LEVEL = 200  # rows of a class with its own noise level


class Folds(NamedTuple):
    """Fold, block and window of each row, (m,) each."""

    fold: Integers
    block: Integers
    window: Integers


class Gain(NamedTuple):
    """Gain of an effect on rows that were not in the fit, in nats."""

    value: float
    sd: float
    blocks: Floats  # (blocks,) their parts of `value`

    @property
    def holds(self) -> bool:
        """Whether it is significant, and not due to a few blocks: the weight of a block is limited."""
        if not np.isfinite(self.sd):
            return False
        most = float(np.abs(self.blocks).sum()) / LEVERAGE_WINDOWS
        pulled = np.clip(self.blocks, -most, most)
        return float(pulled.sum()) > SDS * _sd_of_sum(pulled)


def folds_of(bounds: Sequence[tuple[int, int]], row_period_s: float) -> Folds:
    """Assign the rows of segments (begin, end) to folds."""
    size = bounds[-1][1] if bounds else 0
    block_s = min(BLOCK_S, max(SHORTEST_BLOCK_S, size * row_period_s / BLOCKS))
    window = max(1, round(block_s / WINDOWS_A_BLOCK / row_period_s))
    fold, block, windows = (np.zeros(size, np.int64) for _ in range(3))
    blocks = 0
    for begin, end in bounds:
        own = np.arange(end - begin) // window
        windows[begin:end] = own + blocks * WINDOWS_A_BLOCK
        block[begin:end] = own // WINDOWS_A_BLOCK + blocks
        blocks = int(block[end - 1]) + 1 if end > begin else blocks
        blocks += blocks % 2  # both blocks of a fold are from one segment
    fold[:] = block // 2 % FOLDS
    return Folds(fold, block, windows)


def levels(residual: Floats, kept: npt.NDArray[np.bool_], classes: Integers) -> Floats:
    """Weight of each row: one over the robust noise level of its class; 0 if it is not used. (m,)"""
    weight = np.zeros(residual.size)
    for number in np.unique(classes):
        inside = kept & (classes == number)
        sample = inside if inside.sum() >= LEAST_IN_LEVEL else kept
        level = MAD_TO_SD * float(np.median(np.abs(residual[sample]))) if sample.any() else 1.0
        weight[inside] = 1.0 / max(level, 1e-300)
    return weight


def clipped(white: Floats) -> Floats:
    """The score of `huber`: residuals clipped at HUBER."""
    return np.asarray(np.clip(white, -HUBER, HUBER))


def unseen_loss(target: Floats, columns: Floats, folds: Folds, ridge: Floats | float = 0.0) -> Floats:
    """Loss of each row (m,) by least squares of `target` on `columns` (m, p), both whitened, on the other folds.

    `ridge` (p,) or scalar: prior, as a share of each column's squared norm, on top of RIDGE. Outliers are clipped
    before the fit.
    """
    if not columns.shape[1]:
        return huber(target)
    scaled = _of_unit_norm(columns)
    pulled = clipped(target)
    parts = [folds.fold == k for k in range(FOLDS)]
    squares = [scaled[p].T @ scaled[p] for p in parts]
    products = [scaled[p].T @ pulled[p] for p in parts]
    prior = np.diag(np.broadcast_to(RIDGE + np.asarray(ridge), columns.shape[1:]))
    whole, right = sum(squares) + prior, sum(products)
    left = np.empty(target.size)
    for p, square, product in zip(parts, squares, products, strict=True):
        if p.any():
            left[p] = target[p] - scaled[p] @ np.linalg.solve(whole - square, right - product)
    return huber(left)


def _of_unit_norm(columns: Floats) -> Floats:
    """Columns (m, p) scaled to unit norm, so that a ridge weighs all of them alike."""
    norms = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    return np.asarray(columns / np.where(norms > 0.0, norms, 1.0))


def robust_residual(target: Floats, columns: Floats) -> Floats:
    """Residual of `target` (m,) after the fit of `columns` (m, p), both whitened, with the loss of `huber`."""
    left, scaled = target, _of_unit_norm(columns)
    for _ in range(ROBUST_STEPS):
        left = _beside(target, scaled, huber_weights(left))
    return left


def _beside(target: Floats, scaled: Floats, weight: Floats | None = None) -> Floats:
    normal = normal_equations(scaled, target, weight)
    return np.asarray(target - scaled @ np.linalg.solve(normal.matrix + RIDGE * np.eye(scaled.shape[1]), normal.moment))


def gain(without: Floats, with_it: Floats, folds: Folds, kept: npt.NDArray[np.bool_] | None = None) -> Gain:
    """G from the losses of the rows (m,) of two models, each fitted to the other folds."""
    fall = without - with_it
    used = np.ones(fall.size, bool) if kept is None else kept
    sums = np.asarray(np.bincount(folds.block[used], fall[used]), dtype=np.float64)
    sums = sums[np.bincount(folds.block[used]) > 0]
    count = sums.size
    if count < 2:
        return Gain(float(sums.sum()), float("inf"), sums)
    return Gain(float(sums.sum()), _sd_of_sum(sums), sums)


def _sd_of_sum(values: Floats) -> float:
    """Standard deviation of the sum of independent values."""
    return float(np.sqrt(values.size * values.var(ddof=1)))


def hotelling_p(scores: Floats, tried: int = 1) -> float:
    """Probability that noise alone gives windows' scores (W, k) with this mean, times the number of candidates."""
    scores = scores[np.any(scores != 0.0, axis=1)]
    count, rank = scores.shape
    if count <= rank + 2:
        return 1.0
    mean = scores.mean(axis=0)
    spread = (scores - mean).T @ (scores - mean) / (count - 1)
    statistic = count * float(mean @ spectrum(spread).solution(mean))
    tail = float(scipy.stats.f.sf(statistic * (count - rank) / (rank * (count - 1)), rank, count - rank))
    return min(1.0, max(SMALLEST_P, tail * tried))


def sandwich_p(
    with_it: Floats, beside: Floats, leverage: Floats, negligible: float = 0.0, numbers: int | None = None
) -> float:
    """Probability that noise alone gives an effect its windows' scores `with_it`, given those `beside` it, (W, k) each.

    `negligible`: share of its square that is too small to matter. It makes this the probability under noise plus an
    effect of that size (a minimum-effect test: Murphy and Myors, 1999): no sensor and no model is perfect, and in a
    long log anything is significant against noise alone.

    `beside` are the scores of the same columns on the residual with the effect fitted; they give the variance over the
    windows (White, 1980). `leverage` (W,): share of the columns in each window; the degrees of freedom are the
    effective number of windows, and no window counts for more than one in LEVERAGE_WINDOWS. An effect that is rare but
    far above the noise is significant, whereas the T2 of the means would take its rareness for noise. `numbers`: how
    many were fitted, where the k columns are combinations of more.
    """
    rank = numbers or with_it.shape[1]
    most = leverage.sum() / LEVERAGE_WINDOWS
    weight = np.sqrt(np.minimum(1.0, most / np.maximum(leverage, 1e-300)))
    counted = leverage * weight**2
    windows = float(counted.sum() ** 2 / max(float(np.sum(counted**2)), 1e-300))
    if windows <= rank + 2:
        return 1.0
    size, scores = weight @ with_it, weight[:, None] * beside
    statistic = float(size @ spectrum(scores.T @ scores).solution(size))
    ratio, freedom = statistic * (windows - rank) / (rank * windows), windows - rank
    if negligible > 0.0:
        tail = float(scipy.stats.ncf.sf(ratio, rank, freedom, negligible * statistic))
    else:
        tail = float(scipy.stats.f.sf(ratio, rank, freedom))
    return min(1.0, max(SMALLEST_P, tail))


def strength_variation(torque: Floats, beside: Floats, residual: Floats, folds: Folds) -> float:
    """Coefficient of variation of an effect's strength over the blocks, beyond noise.

    `torque` (m,): the effect's torque; `beside` (m, p): the sensitivities of everything else that is fitted; `residual`
    (m,): of the whole model; all whitened. Each block gets a strength of its own, relative to the fitted one, weighted
    by its share of the squared torque that is orthogonal to `beside` (a random coefficient: Swamy, 1970). A law of the
    machine has one strength everywhere; a substitute for another law does not. The noise comes from the windows of each
    block. 0 where `beside` determines the torque but for DISTINCT of its square: a full lag's strength beside a delay.
    """
    own = _beside(torque, _of_unit_norm(beside))
    if own @ own < DISTINCT * (torque @ torque):
        return 0.0
    energy = np.bincount(folds.block, own**2)
    change = np.bincount(folds.block, own * clipped(residual)) / np.maximum(energy, 1e-300)
    scores = np.bincount(folds.window, own * (residual - change[folds.block] * own))
    block_of_window = np.zeros(scores.size, np.int64)
    block_of_window[folds.window] = folds.block
    windows = np.bincount(block_of_window[np.unique(folds.window)], minlength=energy.size)
    used = (energy > 0.0) & (windows > 1)
    noise = np.bincount(block_of_window, scores**2, energy.size)[used] / energy[used] ** 2
    noise *= windows[used] / (windows[used] - 1.0)  # they lost one degree of freedom to the strength of their block
    share = energy[used] / energy[used].sum()
    return float(np.sqrt(max(0.0, share @ (change[used] - share @ change[used]) ** 2 - share @ noise)))
