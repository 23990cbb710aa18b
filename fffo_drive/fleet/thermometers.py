"""How much of a drive's temperature its thermometer sees, by viscous friction, which goes with it.

One in the cabinet, or one that was not connected, logs a temperature too. With v_t viscous friction of run t and x_t
what was logged, v_t = level + slope x_t + r_t, where the level may change once, at the run that fits best: wear is no
fault of the thermometer. What it explains is slope^2 var x; what it does not see is what lasts in r from run to run,
as the temperature of a season does and the errors of single runs do not: the mean of r_t r_{t+1}. Its share is the
first over the sum of both; none where the slope is not beyond chance.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Floats, Integers
from ..units import MAD_TO_SD

LEAST_JUDGED = 20  # runs with a temperature: with fewer it is believed
LEAST_F = 10.0  # of a slope beyond chance: p is 0.3 % with 40 runs
LEAST_SIDE = 4  # runs on each side of a change of level
SHARES = 4  # a share is counted in as many parts
FAR_SDS = 2.0  # of the middle runs: further viscous friction counts as if there, a further temperature not at all


def seen_share(viscous: Floats, variance: Floats, steps: Floats) -> float:
    """The share of its temperature that a drive's log shows, in quarters.

    `viscous` friction (n,) of its runs in order with its `variance` (n,), and the logged temperature (n,), in any unit;
    nan where a run has none.
    """
    known = np.isfinite(viscous) & np.isfinite(steps) & np.isfinite(variance)
    known[known] = np.equal(*_pulled_in(steps[known]))  # a few at a temperature of their own would decide by themselves
    if np.count_nonzero(known) < LEAST_JUDGED:
        return 1.0
    v, x, w = _pulled_in(viscous[known])[0], steps[known], 1.0 / variance[known]
    before = np.array([0, *range(LEAST_SIDE, v.size - LEAST_SIDE + 1)])  # runs before the change; 0: none
    xx, xv, vv = (_within(one, other, w, before) for one, other in ((x, x), (x, v), (v, v)))
    explained = np.where(xx > 0.0, xv**2 / np.maximum(xx, 1e-300), 0.0)
    if explained[0] * (v.size - 2) <= LEAST_F * (vv[0] - explained[0]):
        return 0.0
    k = int(np.argmin(vv - explained))
    residual = v - xv[k] / xx[k] * x
    for side in np.split(np.arange(v.size), [before[k]]):
        if side.size:
            residual[side] -= np.average(residual[side], weights=w[side])
    pairs = np.sqrt(w[1:] * w[:-1])
    unseen = max(0.0, float(np.sum(pairs * residual[1:] * residual[:-1]) / pairs.sum()))
    share = float(explained[0] / w.sum())
    return round(SHARES * share / (share + unseen)) / SHARES


def _pulled_in(values: Floats) -> tuple[Floats, Floats]:
    """Values (n,) of which those far from the middle are put at FAR_SDS; and the values."""
    middle = float(np.median(values)) if values.size else 0.0
    reach = FAR_SDS * MAD_TO_SD * float(np.median(np.abs(values - middle))) if values.size else 0.0
    return np.clip(values, middle - reach, middle + reach), values


def _within(a: Floats, b: Floats, weight: Floats, before: Integers) -> Floats:
    """Weighted sum (k,) of products of a and b (n,) about the means of both sides of each change of level."""
    total, first, second = (np.concatenate([[0.0], np.cumsum(weight * one)]) for one in (np.ones(a.size), a, b))
    left = first[before] * second[before] / np.maximum(total[before], 1e-300)
    right = (first[-1] - first[before]) * (second[-1] - second[before]) / (total[-1] - total[before])
    return np.asarray(np.sum(weight * a * b) - left - right)


def thermometer_text(seen: float) -> str:
    """What becomes of a logged temperature that shows less than all."""
    if seen > 0.0:
        said = f"explains some {100.0 * seen:.0f} % of what moves its viscous friction, and is used that far"
    else:
        said = "explains nothing of its viscous friction, and is not used"
    return f"the logged temperature {said}: viscous friction is not watched. Log the temperature at the drive"
