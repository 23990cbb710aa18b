"""The proof: errors of a model on runs, in torque and in velocity, with intervals from whole windows drawn again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..identification.dataset import Record
from ..identification.residuals import velocity_errors
from ..model.effects.table import Term
from .base import NAMES, balanced, delayed
from .candidates import Effect
from .evidence import Whitening
from .fitting import Data, Fitted, at_rest, consistent_scenes, evaluate, load_rows, refit
from .paths import make_filter, rows_of, stretches_of
from .results import ErrorFigures, Interval
from .startup import noise_model

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

DRAWS = 400
BLOCK_WINDOWS = 4  # windows of rows that are drawn together
DATUM_SHARE = 0.3  # of a run and of what a periodic effect does in it: there its datum is found; the rest is scored ...
DATUM_MOST = 0.7  # ... and so much of the run at most
MIDDLE_S = 0.1  # of a free window
WORST = 0.99  # a few windows at the edge of stick and slip run away in any model: pulled in to this quantile


def data_of(records: Sequence[Record], physical: Floats) -> Data:
    """Rows of other records, ready for a model whose base parameters are near these."""
    stretches = balanced(stretches_of(records), physical)
    rows = rows_of(stretches, make_filter(records[0].period_s))
    blank = Whitening(np.zeros(1), rows.kept.astype(np.float64), np.flatnonzero(rows.kept))
    data = Data(stretches, rows, blank, len(records), physical)
    return noise_model(data, physical, evaluate(data, physical, ())[0].residual_nm)


def with_own_datum(data: Data, fitted: Fitted) -> tuple[Fitted, Mask]:
    """The model with each periodic effect's datum found on the first part of each run; rows that may be scored. (m,)

    The datum is a phase: how large the wave is was learnt from the fit runs.
    """
    scored = np.ones(data.rows.time_s.size, dtype=bool)
    data = at_rest(data, fitted.physical, fitted.effects)
    if not any(effect.per_run for effect in fitted.effects):
        return evaluate(data, fitted.physical, fitted.effects)[0], scored
    effects = [
        replace(
            effect,
            strengths={
                name: np.full(data.runs, np.sqrt(0.5 * np.mean(v * v))) if name in effect.per_run else v
                for name, v in effect.strengths.items()
            },
        )
        for effect in fitted.effects
    ]
    sizes = [effect.sizes() for effect in fitted.effects]
    early = _early(data, fitted.physical, [effect for effect in effects if effect.per_run])
    part = data._replace(whitening=data.whitening._replace(kept=np.flatnonzero(data.rows.kept & early)))
    matrix = np.zeros((scored.size, 0))
    found = refit(part, matrix, fitted.physical, effects, shapes=False, free_base=False)
    effects = [effect.of_sizes(size) for effect, size in zip(found.effects, sizes, strict=True)]
    data = at_rest(data, fitted.physical, effects)
    return evaluate(data, fitted.physical, effects)[0], ~early


def _early(data: Data, physical: Floats, effects: Sequence[Effect]) -> Mask:
    """The part of each run from which a datum is learnt: what is slow may hardly show it. (m,)"""
    load = np.square(load_rows(data, consistent_scenes(data, physical, effects), effects))
    early = np.zeros(load.size, dtype=bool)
    for begin, end in data.rows.bounds:
        done = np.cumsum(load[begin:end])
        shown = int(np.searchsorted(done, DATUM_SHARE * done[-1])) if done[-1] > 0.0 else 0
        early[
            begin : begin + min(max(shown, round(DATUM_SHARE * (end - begin))), round(DATUM_MOST * (end - begin)))
        ] = True
    return early


def error_figures(
    records: Sequence[Record], data: Data, fitted: Fitted, scored: Mask | None = None, velocity: bool = True
) -> ErrorFigures:
    """Errors over the rows that count (`scored` of the kept ones), intervals by windows."""
    rows = data.rows
    use = rows.kept if scored is None else rows.kept & scored
    delay_s = float(fitted.physical[NAMES.index("delay_s")])
    torque = np.concatenate([
        rows.filter.rows(s.torque_constant_nm_per_a * delayed(s.current_a, delay_s / s.period_s))
        for s in data.stretches
    ])  # fmt: skip
    window = rows.window // BLOCK_WINDOWS
    count = int(window[-1]) + 1
    squares = np.bincount(window[use], fitted.residual_nm[use] ** 2, count)
    powers = np.bincount(window[use], torque[use] ** 2, count)
    sizes = np.bincount(window[use], minlength=count).astype(np.float64)
    rng = np.random.default_rng(7)
    filled = np.flatnonzero(sizes)
    drawn = filled[rng.integers(0, filled.size, (DRAWS, filled.size))] if filled.size else np.zeros((1, 1), np.int64)
    rms = np.sqrt(squares[drawn].sum(axis=1) / np.maximum(sizes[drawn].sum(axis=1), 1.0))
    relative = 100.0 * np.sqrt(squares[drawn].sum(axis=1) / np.maximum(powers[drawn].sum(axis=1), 1e-300))
    return ErrorFigures(
        _interval(float(np.sqrt(squares.sum() / max(float(sizes.sum()), 1.0))), rms),
        _interval(100.0 * float(np.sqrt(squares.sum() / max(float(powers.sum()), 1e-300))), relative),
        velocity_figure(records, data, fitted, use) if velocity else Interval(0.0, 0.0, 0.0),
        float(use.sum()) * rows.filter.row_period_s,
    )


def velocity_figure(records: Sequence[Record], data: Data, fitted: Fitted, use: Mask) -> Interval:
    """Rms of the velocity error of free simulation over short windows whose middle is scored."""
    squares: list[Floats] = []
    for number, record in enumerate(records):
        inside = data.rows.run == number
        if not inside.any():
            continue
        terms = [Term(effect.name, effect.values(number)) for effect in fitted.effects]
        errors, begins = velocity_errors(record, fitted.physical, terms=terms)
        at = np.searchsorted(data.rows.time_s[inside], begins + MIDDLE_S)
        good = use[inside][np.minimum(at, int(inside.sum()) - 1)]
        if good.any():
            squares.append(np.mean(errors[good] ** 2, axis=1))
    if not squares:
        return Interval(0.0, 0.0, 0.0)
    joined = np.concatenate(squares)
    joined = np.minimum(joined, np.quantile(joined, WORST))
    rng = np.random.default_rng(8)
    drawn = joined[rng.integers(0, joined.size, (DRAWS, joined.size))]
    return _interval(float(np.sqrt(joined.mean())), np.sqrt(drawn.mean(axis=1)))


def _interval(value: float, drawn: Floats) -> Interval:
    low, high = (float(x) for x in np.quantile(drawn, (0.025, 0.975)))
    return Interval(value, min(low, value), max(high, value))
