"""The remaining residual, and whether it could be explained: compared with a black box on the same rows, and with
repeats.

Gradient-boosted trees name no cause. Where they predict rows that they were not fitted on, and the model does not, the
model is still missing something. They predict Nm, not noise levels: the level of a class of speeds contains whatever
the model lacks there. Rows are left out by blocks, not by runs: where each run has speeds of its own, trees of the
other runs would have to extrapolate. Both hid a friction of 13 % of the torque in a band of speeds (left-out drive
5097).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy  # its modules load where they are first used

from ..arrays import Floats
from ..identification.criterion import gain
from ..least_squares import huber
from ..model.effects import slots
from ..model.effects.registry import axis_of_effect
from .fitting import Data, Fitted, consistent_scenes
from .gates import rigid_rows
from .results import Ceiling, Rest, share_above
from .scenes import Scene
from .spectra import own_line, time_spectrum

REPORTED_RATIO = 1.2  # rms relative to the floor, above which a rest is reported
# a rest that nothing predicts: correlated from here to there (0.7 and 0.95 on tx40 joint 1 and lorenz, 0.0 to 0.3 where
# waves and friction are explained) ...
SMOOTH_S = 0.05
LARGE_SHARE = 0.05  # ... and at least this share of the needed torque, both rms
TREES = 80
LEAVES = 15
LEAST_LEAF = 40  # rows in a leaf
MOST_ROWS = 16_000
COMB_HZ = (0.2, 20.0)
REFINED = 81  # periods tried around it ...
FOLDED = 24  # ... with this many bins each
CLIPPED = 6.0  # rms or noise levels at which outliers are clipped: a push on the axis is an outlier
COMB_LINES = 6  # harmonics of a disturbance with a period in time
MEMORY_S = 3.0
WORDS = {
    "angle": "motor_angle", "position": "output_angle", "velocity": "velocity", "acceleration": "acceleration",
    "torque": "torque", "direction": "direction", "travel": "travel_since_reversal", "time": "time",
    "heat": "memory", "clock": "a clock of its own", "cycle": "the cycle of the motion",
}  # fmt: skip


def rest_of(data: Data, fitted: Fitted, ceiling: Ceiling, needed_nm: float) -> Rest | None:
    """The part of the residual that could still be explained; None where there is none.

    `needed_nm`: rms torque that the axis needs. A residual that is a large part of it and smooth has a cause, whether
    or not anything predicts it.
    """
    rms = float(np.sqrt(np.mean(fitted.residual_nm[data.used] ** 2)))
    floor, axes, depends = _black_box(data, fitted, rms)
    repeats = ceiling.left_repeatable_fraction
    if ceiling.noise_rms_nm is not None and repeats is not None and repeats > 0.0:
        floor = min(floor, rms * float(np.sqrt(max(0.0, 1.0 - repeats))))
    predicted = rms > REPORTED_RATIO * floor
    share = rms / max(needed_nm, 1e-300)
    past = correlation(data, fitted) if share >= LARGE_SHARE else 0.0
    own_floor = rms * float(np.sqrt(1.0 - np.clip(past, 0.0, 1.0) ** 2))
    smooth = rms > REPORTED_RATIO * own_floor
    if not (predicted or smooth):
        return None
    floor = min(floor, own_floor)
    if smooth:
        sentence = (
            f"{100.0 * share:.0f} % of the torque is smooth and unexplained: {rms:.3g} Nm rms remain, with a "
            f"correlation of {past:.2f} over {1e3 * SMOOTH_S:.0f} ms"
        )
    else:
        sentence = (
            f"{100.0 * share_above(floor, rms):.0f} % of the remaining squared residual has an unknown cause: "
            f"{rms:.3g} Nm rms remain, {floor:.3g} if it were modelled"
        )
    if not predicted:
        return Rest(rms, floor, repeats, (), sentence)
    return Rest(rms, floor, repeats, axes, f"{sentence}; it depends on {depends}")


def _black_box(data: Data, fitted: Fitted, rms: float) -> tuple[float, tuple[str, ...], str]:
    """Rms that trees leave on rows that they were not fitted on, what they depend on, and that in words."""
    used = data.used
    features, names, period_s = _features(data, fitted)
    scaled = np.clip(fitted.residual_nm[used] / max(rms, 1e-300), -CLIPPED, CLIPPED)
    predicted, strongest = _trees(features[used], scaled, data.folds.fold, names)
    floor = rms
    if gain(huber(scaled), huber(scaled - predicted), data.folds).holds:
        floor *= float(np.sqrt(np.sum((scaled - predicted) ** 2) / np.sum(scaled**2)))
    axes = tuple(WORDS[name] for name in strongest)
    clock = f" (a period of {period_s:.3g} s)" if {"clock", "cycle"} & set(strongest) else ""
    return floor, axes, (" and ".join(axes).replace("_", " ") or "the command, by its repeats") + clock


def correlation(data: Data, fitted: Fitted) -> float:
    """Correlation of the residual with itself SMOOTH_S later, within stretches, over the rows that count."""
    rows = data.rows
    lag = max(1, round(SMOOTH_S / rows.filter.row_period_s))
    counts = data.weight > 0.0
    products = squares = 0.0
    for begin, end in rows.bounds:
        here, later = slice(begin, max(begin, end - lag)), slice(min(begin + lag, end), end)
        both = counts[here] & counts[later]
        first, second = fitted.residual_nm[here][both], fitted.residual_nm[later][both]
        products += float(first @ second)
        squares += 0.5 * float(first @ first + second @ second)
    return products / max(squares, 1e-300)


def refused_rest(data: Data, in_force: Fitted, refused: Fitted) -> Rest | None:
    """What only effects explain that do not carry over to held-out runs; None where it is small."""
    used = data.used
    rms, floor = (float(np.sqrt(np.mean(one.residual_nm[used] ** 2))) for one in (in_force, refused))
    if rms <= REPORTED_RATIO * floor:
        return None
    names = Counter(effect.name for effect in refused.effects) - Counter(effect.name for effect in in_force.effects)
    axes = tuple(dict.fromkeys(axis_of_effect(name) for name in names))[:2]
    sentence = (
        f"{100.0 * share_above(floor, rms):.0f} % of the squared residual is explained only by effects of "
        f"the fitted runs alone: {rms:.3g} Nm rms remain, {floor:.3g} with them; "
        f"it depends on {' and '.join(axes).replace('_', ' ')}"
    )
    return Rest(rms, floor, None, axes, sentence)


def _trees(
    features: Floats, target: Floats, group: npt.NDArray[np.int64], names: Sequence[str]
) -> tuple[Floats, tuple[str, ...]]:
    """The target (q,) as trees of the other groups predict it, and the two most important features."""
    from sklearn.ensemble import HistGradientBoostingRegressor  # slow to import

    found = np.zeros(target.size)
    fall = np.zeros(len(names))
    draw = np.random.default_rng(3)
    for number in np.unique(group):
        inside = group == number
        others = np.flatnonzero(~inside)
        if others.size > MOST_ROWS:
            others = np.sort(draw.choice(others, MOST_ROWS, replace=False))
        model = HistGradientBoostingRegressor(
            max_iter=TREES, max_leaf_nodes=LEAVES, min_samples_leaf=LEAST_LEAF, early_stopping=False, random_state=3
        ).fit(features[others], target[others])
        rows = np.flatnonzero(inside)
        found[rows] = model.predict(features[rows])
        if rows.size > MOST_ROWS // 4:
            rows = np.sort(draw.choice(rows, MOST_ROWS // 4, replace=False))
        error = float(np.mean((target[rows] - found[rows]) ** 2))
        for k in range(len(names)):
            mixed = features[rows].copy()
            mixed[:, k] = draw.permutation(mixed[:, k])
            fall[k] += float(np.mean((target[rows] - model.predict(mixed)) ** 2)) - error
    order = np.argsort(-fall)
    return found, tuple(names[k] for k in order[:2] if fall[k] > 0.25 * fall[order[0]] > 0.0)


def _features(data: Data, fitted: Fitted) -> tuple[Floats, tuple[str, ...], float]:
    """Possible causes of a residual, at all rows (m, f), with their names; the period of the strongest disturbance
    in time, s.
    """
    rows = data.rows
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)

    def signal(slot: int) -> Floats:
        return rows.joined(scene.motion[:, slot] for scene in scenes)

    period_s = _clock(data, fitted)
    columns = {
        "angle": np.mod(rows.position_rev, 1.0), "position": rows.position_rev, "velocity": rows.velocity_rps,
        "acceleration": rows.acceleration_rps2,
        "torque": signal(slots.CURRENT_A), "direction": signal(slots.DIRECTION),
        "travel": np.log10(np.maximum(signal(slots.TRAVEL_REV), 1e-5)),
        "time": rows.time_s, "heat": rows.joined(_heat(scene) for scene in scenes),
    }  # fmt: skip
    if period_s > 0.0:
        columns["cycle" if _is_cycle(data, fitted, period_s) else "clock"] = np.mod(rows.time_s, period_s)
    return np.stack(list(columns.values()), axis=1), tuple(columns), period_s


def _heat(scene: Scene) -> Floats:
    speed = np.abs(scene.stretch.velocity_rps)
    width = max(1, round(MEMORY_S / scene.stretch.law_period_s))
    return np.asarray(scipy.ndimage.uniform_filter1d(speed, width, origin=(width - 1) // 2, mode="nearest"))


def _clock(data: Data, fitted: Fitted) -> float:
    """Period of the comb of lines with most of the residual's power over time, s; 0 where there is none."""
    frequency, power = time_spectrum(data.rows, np.clip(fitted.residual_nm * data.weight, -CLIPPED, CLIPPED))
    low, high = np.searchsorted(frequency, COMB_HZ)
    base = np.arange(max(1, low), min(high, (power.size - 1) // COMB_LINES))
    if not base.size:
        return 0.0
    level = np.maximum(scipy.ndimage.median_filter(power, 257, mode="nearest"), 1e-300)
    comb = sum(np.minimum(power / level, 100.0)[base * k] for k in range(1, COMB_LINES + 1))
    return _refined(data, fitted, float(1.0 / frequency[base[int(np.argmax(comb))]]), float(frequency[1]))


def _is_cycle(data: Data, fitted: Fitted, period_s: float) -> bool:
    """Whether most of what has this period in the residual is at lines of the motion, which then has the period too."""
    rows, motion_nm = data.rows, rigid_rows(data, fitted)
    frequency, power = time_spectrum(rows, fitted.residual_nm)
    lines = np.arange(1, COMB_LINES + 1) / period_s
    own = np.array([own_line(rows, motion_nm, fitted.residual_nm, float(line)) is not None for line in lines])
    there = np.interp(lines, frequency, power)
    return float(there[own].sum()) > float(there[~own].sum())


def _refined(data: Data, fitted: Fitted, period_s: float, step_hz: float) -> float:
    """The period near this one at which the folded residual varies most from bin to bin."""
    time_s, white = data.rows.time_s[data.used], np.clip(fitted.white, -CLIPPED, CLIPPED)
    near = 1.0 / (1.0 / period_s + step_hz * np.linspace(-1.0, 1.0, REFINED))

    def spread(period_s: float) -> float:
        place = (np.mod(time_s / period_s, 1.0) * FOLDED).astype(np.int64)
        count = np.maximum(np.bincount(place, minlength=FOLDED), 1)
        return -float(np.sum(np.bincount(place, white, FOLDED) ** 2 / count))

    return float(min(near, key=spread))
