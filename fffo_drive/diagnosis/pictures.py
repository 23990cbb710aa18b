"""Figures of a diagnosis: effects over their axis, residuals over time, residual channels, what repeats."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats, Integers
from ..identification.criterion import clipped
from ..model.effects.laws.lookup import PLAIN, WOUND, across_axis, across_word
from ..model.effects.registry import axis_of_effect, law_of
from ..units import NORMAL_95
from .curves import ANGLES, CurveAxis, abscissa
from .fitting import Data, Fitted, consistent_scenes
from .results import Ceiling, FoundCurve, Picture, RunFigure
from .rows import DiagnosisRows, DiagnosisStretch
from .scenes import Effect, Scene, load_rows

BINS = 32
LEAST_ROWS = 8  # fewest rows in a bin that is shown
LEAST_WINDOWS = 2
ENVELOPE = 400
REPEAT_S = 2.0
REPEAT_STEP_S = 0.05
LEAST_REPEATED_ROWS = 50
LEAST_REPEATABLE = 0.05  # of the squared residual; below it the repeatable part counts as explained
MEMORY_S = 3.0
SMALLEST_TRAVEL_REV = 1e-4
UNITS = {
    "time": ("time", "s"), "velocity": ("velocity", "rps"), "direction": ("direction", "-"),
    "acceleration": ("acceleration", "rps2"), "motor_angle": ("motor angle", "rev"),
    "output_angle": ("position at the motor", "rev"), "current": ("current", "A"), "torque": ("motor torque", "Nm"),
    "dwell": ("length of the last rest", "s"),
    "travel_since_reversal": ("travel since the reversal, log10", "rev"),
    "frequency": ("change of the motor torque", "Nm/s"), "memory": ("mean speed of the last seconds", "rps"),
}  # fmt: skip
LOGARITHMIC = ("travel_since_reversal", "dwell")


class _Place(NamedTuple):
    """Coordinates of the rows on the axis of a figure."""

    values: Floats  # (m,)
    label: str
    unit: str


def picture(data: Data, fitted: Fitted, number: int) -> Picture:
    """Residual over the axis of an effect, without the effect (its torque added back) and with it, and the effect's
    torque.
    """
    effect = fitted.effects[number]
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    load = load_rows(data.rows, scenes, effect)
    place = _place(data, scenes, effect.name, dict(effect.shapes))
    kept = np.flatnonzero(data.rows.kept & np.isfinite(place.values))
    law = law_of(effect.name)
    # a friction that varies over place or time has the sign of the motion: over both directions its mean is zero
    turned = law.level and law.picture in (*ANGLES, "time")
    sense = np.sign(data.rows.velocity_rps) if turned else np.ones(load.size)
    load, left = load * sense, fitted.residual_nm * sense
    before = left + load
    edges = bin_edges(place.values[kept])
    curves: list[FoundCurve] = []
    for where, rows in _shares(scenes, effect, load, kept, data.rows.laws.step):
        bins = np.clip(np.searchsorted(edges, place.values[rows], side="right") - 1, 0, edges.size - 2)
        window = data.rows.folds.window[rows]
        shown = shown_bins(bins, window, edges.size - 1)
        x = binned(place.values[rows], bins, edges.size - 1)[shown]
        clouds = [("without the effect", before), ("with it", left)][: 1 if where else 2]
        for label, values in clouds:
            mean, reach = interval(values[rows], bins, window, edges.size - 1)
            curves.append(
                FoundCurve(label + where, x, mean[shown], (mean - reach)[shown], (mean + reach)[shown], "points")
            )
        says = binned(load[rows], bins, edges.size - 1)[shown]
        curves.append(FoundCurve("torque of the effect" + where, x, says, kind="line"))
    return Picture(
        title=f"{law.plain_name}, over {place.label}".capitalize(),
        x_label=place.label,
        x_unit=place.unit,
        y_label="residual friction" if turned else "residual torque",
        y_unit="Nm",
        curves=tuple(curves),
        note="Fit runs together; intervals from the means of half-second windows."
        + (" Positive against the motion." if turned else ""),
    )


def _shares(
    scenes: Sequence[Scene], effect: Effect, load_nm: Floats, kept: Integers, step: int
) -> list[tuple[str, Integers]]:
    """Rows shown together: all for a curve; for a table those near its two most different levels."""
    word = across_word(effect.shapes)
    if not word:
        return [("", kept)]
    across = CurveAxis(across_axis(effect.shapes), PLAIN, effect.shapes["across_scale"])
    at = np.concatenate([part[::step] for part in abscissa(scenes, across)])[kept]
    levels = np.array([effect.shapes[f"z{k:02d}"] for k in range(int(effect.shapes["levels"]))])
    nearest = np.argmin(np.abs(at[:, None] - levels), axis=1)
    rows = [kept[nearest == k] for k in range(levels.size)]
    looks = [
        np.array([load_nm[own].mean(), load_nm[own].std()]) if own.size >= LEAST_ROWS else np.zeros(2) for own in rows
    ]
    pairs = itertools.combinations(range(levels.size), 2)
    chosen = max(pairs, key=lambda pair: float(np.abs(looks[pair[0]] - looks[pair[1]]).sum()))
    unit = UNITS["velocity" if word == "speed" else word][1]
    return [(f", {word.replace('_', ' ')} near {levels[k]:.3g} {unit}", rows[k]) for k in chosen]


def _place(data: Data, scenes: Sequence[Scene], name: str, shapes: dict[str, float]) -> _Place:
    """Coordinates of the rows on the axis of this effect; a wave is folded onto its period."""
    rows = data.rows
    law = law_of(name)
    folded = law.fold(law.filled(shapes))
    if folded is not None:
        signal, period = folded
        if law.wave == "plain" and law.picture == "output_angle":  # in one piece, where a joint makes no whole turn
            turns = rows.position_rev / period
            whole = float(np.ptp(turns)) > 1.0
            return _Place(np.mod(turns, 1.0) if whole else turns, "angle of the output", "turns")
        along, words, unit = {
            "motor_angle": (rows.position_rev, "motor angle", "rev"), "time": (rows.time_s, "time", "s"),
        }[signal]  # fmt: skip
        return _Place(np.mod(along / period, 1.0), f"{words}, periods of {period:.4g} {unit}", "")
    word = law.picture if law.name != "lookup" else axis_of_effect(name)
    if shapes.get("kind") == WOUND:  # a memory of the travel, not of the speed
        word = "travel_since_reversal"
    return _Place(_along(data, scenes, word, shapes.get("scale", 0.0)), *UNITS[word])


def _along(data: Data, scenes: Sequence[Scene], word: str, scale: float) -> Floats:
    """Rows on a named axis. (m,)"""
    rows = data.rows
    plain = {"velocity": rows.velocity_rps, "acceleration": rows.acceleration_rps2, "time": rows.time_s}
    if word in plain:
        return plain[word]
    if word == "direction":
        return np.sign(rows.velocity_rps)
    if word in ANGLES:
        period_rev = scale or (1.0 if word == "motor_angle" else 0.0)
        return np.asarray(np.mod(rows.position_rev, period_rev)) if period_rev > 0.0 else rows.position_rev
    step = rows.laws.step
    if word == "frequency":
        torque = [
            np.gradient(s.commanded_thinned, s.stretch.law_period_s) * s.axis.torque_constant_nm_per_a for s in scenes
        ]
        return np.concatenate([rows.laws.rows(part) for part in torque])
    own = CurveAxis(word, 0.0, MEMORY_S if word == "memory" and scale <= 0.0 else scale)
    found = np.concatenate([part[::step] for part in abscissa(scenes, own)])
    if word in LOGARITHMIC:
        return np.asarray(np.log10(np.maximum(found, SMALLEST_TRAVEL_REV)))
    return found


def bin_edges(values: Floats) -> Floats:
    """Bin edges: a compromise between equal steps of the range and equal numbers of rows."""
    if not values.size:
        return np.array([0.0, 1.0])
    shares = np.linspace(0.0, 1.0, BINS + 1)
    low, high = float(values.min()), float(values.max())
    edges = np.unique(0.5 * (np.quantile(values, shares) + low + (high - low) * shares))
    return edges if edges.size > 1 else np.array([low - 0.5, high + 0.5])


def binned(values: Floats, bins: Integers, count: int) -> Floats:
    return np.asarray(np.bincount(bins, values, count) / np.maximum(np.bincount(bins, minlength=count), 1))


def _pieces(bins: Integers, window: Integers) -> tuple[Integers, Integers]:
    """Groups of rows that share bin and window, and the bin of each group."""
    keys, index = np.unique(bins.astype(np.int64) * (int(window.max()) + 1) + window, return_inverse=True)
    return index, keys // (int(window.max()) + 1)


def shown_bins(bins: Integers, window: Integers, count: int) -> npt.NDArray[np.bool_]:
    """Bins with enough rows and windows."""
    if not bins.size:
        return np.zeros(count, dtype=bool)
    _, owner = _pieces(bins, window)
    rows = np.bincount(bins, minlength=count)
    return np.asarray((rows >= LEAST_ROWS) & (np.bincount(owner, minlength=count) >= LEAST_WINDOWS))


def interval(values: Floats, bins: Integers, window: Integers, count: int) -> tuple[Floats, Floats]:
    """Mean of each bin, and half the width of its 95 % interval; the rows of one window count as one sample."""
    mean = binned(values, bins, count)
    if not bins.size:
        return mean, np.zeros(count)
    index, owner = _pieces(bins, window)
    sums = np.bincount(index, values - mean[bins])
    rows = np.maximum(np.bincount(bins, minlength=count), 1)
    pieces = np.bincount(owner, minlength=count)
    inflation = pieces / np.maximum(pieces - 1, 1)
    return mean, NORMAL_95 * np.sqrt(inflation * np.bincount(owner, sums * sums, count)) / rows


def run_figures(data: Data, base: Fitted, fitted: Fitted, role: Literal["fit", "held_out"]) -> tuple[RunFigure, ...]:
    """Envelope (minimum, maximum) of each stretch's residual over time, before and after; zero at rest."""
    rows = data.rows
    found = []
    for stretch, (begin, end) in zip(data.stretches, rows.bounds, strict=True):
        step = max(1, (end - begin) // ENVELOPE)
        end = begin + (end - begin) // step * step
        if end - begin < 2 * step:
            continue
        kept = rows.kept[begin:end]
        first, last = (np.where(kept, m.residual_nm[begin:end], 0.0).reshape(-1, step) for m in (base, fitted))
        found.append(
            RunFigure(
                stretch.name, role, rows.time_s[begin:end:step], first.min(axis=1), first.max(axis=1),
                last.min(axis=1), last.max(axis=1),
            )
        )  # fmt: skip
    return tuple(found)


def ceiling(data: Data, base: Fitted, fitted: Fitted) -> Ceiling:
    """Repeatable share of the residual, from parts of the reference that occur more than once in a run."""
    pairs = [
        pair
        for stretch, bounds in zip(data.stretches, data.rows.bounds, strict=True)
        for pair in _repeats(stretch, bounds, data.rows)
    ]
    if not pairs:
        return Ceiling(None, None, None, None, "no part of the reference was repeated")
    first, second = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    both = data.rows.kept[first] & data.rows.kept[second]
    first, second = first[both], second[both]
    if first.size < LEAST_REPEATED_ROWS:
        return Ceiling(None, None, None, None, "the repeated parts contain too little motion")
    r, s = base.residual_nm, fitted.residual_nm
    noise = 0.5 * float(np.mean((r[first] - r[second]) ** 2))
    whole = 0.5 * float(np.mean(r[first] ** 2) + np.mean(r[second] ** 2))
    left = 0.5 * float(np.mean(s[first] ** 2) + np.mean(s[second] ** 2))
    repeatable = max(0.0, whole - noise)
    share = min(1.0, max(0.0, (whole - left) / repeatable)) if repeatable > LEAST_REPEATABLE * whole else None
    seconds = first.size * data.rows.filter.row_period_s
    note = f"{seconds:.0f} s of motion with a repeated reference in the same run"
    # in units of the noise level, or the rows just after each reversal would dominate
    u, v = (clipped((s * data.weight)[part]) for part in (first, second))
    whole_white = float(np.mean(u**2) + np.mean(v**2))
    repeats = max(0.0, whole_white - float(np.mean((u - v) ** 2))) / max(whole_white, 1e-300)
    return Ceiling(repeatable / max(whole, 1e-300), repeats, noise**0.5, share, note)


def _repeats(
    stretch: DiagnosisStretch, bounds: tuple[int, int], rows: DiagnosisRows
) -> list[tuple[Integers, Integers]]:
    """Pairs of equally long row ranges of one stretch with identical references."""
    if stretch.reference_rps is None:
        return []
    step = max(1, round(REPEAT_STEP_S / stretch.period_s))
    coarse = np.round(stretch.reference_rps[::step], 3)
    length = round(REPEAT_S / REPEAT_STEP_S)
    rows_of_piece = int(length * step * stretch.period_s / rows.filter.row_period_s)
    earlier: dict[bytes, int] = {}
    found = []
    for begin in range(0, coarse.size - length, length // 4):
        piece = coarse[begin : begin + length]
        if np.ptp(piece) < 0.05:
            continue
        former = earlier.setdefault(piece.tobytes(), begin)
        if begin - former < length:
            continue
        starts = [bounds[0] + round(at * step * stretch.period_s / rows.filter.row_period_s) for at in (former, begin)]
        if max(starts) + rows_of_piece <= bounds[1]:
            found.append((starts[0] + np.arange(rows_of_piece), starts[1] + np.arange(rows_of_piece)))
    return found
