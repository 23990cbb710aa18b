"""The proof on held-out runs: torque error relative to the needed torque, and velocity error over windows.

The needed torque comes from the first rungs of the ladder and is the same for all models, so that no model gains by
needing less. Velocity errors use the inertia of that model too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..arrays import Floats, Mask
from ..identification.criterion import Folds, Gain, gain
from ..identification.dataset import Record
from ..least_squares import huber
from .base import NAMES
from .fitting import Data, Fitted, at_rest, consistent_scenes, evaluate, fit, torque_of, with_levels
from .gates import needed_rows
from .results import ErrorFigures, Interval
from .rows import DiagnosisRows, Filter, rows_of, stretches_of
from .scenes import Effect

DRAWS = 400
SDS = 2.0  # of the paired difference, beyond which a model counts as worse
WINDOWS_S = (0.25, 0.5)  # windows over which velocity errors are counted
HISTORY_SHARE = 0.01  # of a stretch's travel, during which the friction's state is unknown
DATUM_SHARE = 0.3  # share of a run, and of a periodic effect in it, that its datum is fitted on ...
DATUM_MOST = 0.7  # ... and at most this share of the run; the rest is scored


def data_of(records: Sequence[Record], filter_: Filter, physical: Floats) -> Data:
    """Rows of other records, with the base model's noise levels on them; rows whose history is unknown do not count."""
    stretches = stretches_of(records, filter_)
    rows = rows_of(stretches, filter_)
    rows = rows._replace(kept=rows.kept & with_known_history(rows))
    data = Data(stretches, rows, rows.kept.astype(np.float64), len(records), physical)
    data = at_rest(data, physical, ())
    return with_levels(data, evaluate(data, physical, ())[0])


def with_known_history(rows: DiagnosisRows) -> Mask:
    """Rows after the first HISTORY_SHARE of each stretch's travel. (m,)

    Until then friction depends on the motion before the log. Where a log begins slowly, up to a fifth of its rows lie
    there; on five surfaces they held up to nine tenths of the squared error.
    """
    known = np.zeros(rows.kept.size, dtype=bool)
    for begin, end in rows.bounds:
        travel = np.cumsum(np.abs(rows.velocity_rps[begin:end]))
        known[begin:end] = travel >= HISTORY_SHARE * travel[-1]
    return known


def with_own_datum(data: Data, fitted: Fitted) -> tuple[Fitted, Mask]:
    """The model with each periodic effect's datum fitted on the first part of each run; rows that may be scored.
    (m,)

    The datum is a phase; the amplitude and all other numbers come from the fit runs.
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
    part = data._replace(weight=np.where(early, data.weight, 0.0))
    found = fit(part, fitted.physical, effects, datum_alone=True)
    effects = [effect.of_sizes(size) for effect, size in zip(found.effects, sizes, strict=True)]
    data = at_rest(data, fitted.physical, effects)
    return evaluate(data, fitted.physical, effects)[0], ~early


def _early(data: Data, physical: Floats, effects: Sequence[Effect]) -> Mask:
    """The part of each run from which the datum is fitted: in slow motion a wave may hardly show. (m,)"""
    load = np.square(torque_of(data, consistent_scenes(data, physical, effects), effects))
    early = np.zeros(load.size, dtype=bool)
    for begin, end in data.rows.bounds:
        done = np.cumsum(load[begin:end])
        shown = int(np.searchsorted(done, DATUM_SHARE * done[-1])) if done[-1] > 0.0 else 0
        least, most = round(DATUM_SHARE * (end - begin)), round(DATUM_MOST * (end - begin))
        early[begin : begin + min(max(shown, least), most)] = True
    return early


class Proof:
    """Errors on held-out runs before and after, on one scale."""

    def __init__(
        self, records: Sequence[Record], filter_: Filter, base: Fitted, ladder: Fitted, fitted: Fitted
    ) -> None:  # fmt: skip
        self.data = data_of(records, filter_, base.physical)
        self.base = with_own_datum(self.data, base)[0]
        self.fitted, self.scored = with_own_datum(self.data, fitted)
        self.ladder = with_own_datum(self.data, ladder)[0]
        self.needed_nm = needed_rows(self.data, self.ladder)
        self.inertia = inertia_of(ladder)
        self.before = self.figures(self.base, self.scored)
        self.after = self.figures(self.fitted, self.scored) if fitted.effects else self.before

    def figures(self, model: Fitted, scored: Mask) -> ErrorFigures:
        """Errors of a model over the scored rows."""
        return error_figures(self.data, model, self.needed_nm, self.inertia, scored)

    def without(self, number: int) -> Fitted:
        """The model without one effect, nothing refitted."""
        others = tuple(e for k, e in enumerate(self.fitted.effects) if k != number)
        return evaluate(self.data, self.fitted.physical, others)[0]

    def gain_over(self, without: Fitted) -> Gain:
        """Gain of the model on the held-out rows over one without some effect."""
        scored = self.scored[self.data.used]
        folds = Folds(*(part[scored] for part in self.data.folds))
        return gain(huber(without.white[scored]), huber(self.fitted.white[scored]), folds)

    def worse(self) -> str:
        """Where the model is worse on held-out runs than the base; empty where it is not."""
        if not self.fitted.effects:
            return ""
        if not self.after.torque_rms_nm.value < self.before.torque_rms_nm.value:
            return "the torque error is not smaller"
        speeds = [velocity_squares(self.data, model, self.inertia, self.scored) for model in (self.ladder, self.fitted)]
        change = speeds[1] - speeds[0]  # of whole windows: a run with many gaps may have none, and decides nothing
        if change.size > 1 and change.sum() > SDS * np.sqrt(change.size * change.var(ddof=1)):
            return "the velocity error is larger"
        return ""


def error_figures(
    data: Data, fitted: Fitted, needed_nm: Floats, inertia: float, scored: Mask | None = None
) -> ErrorFigures:
    """Errors over the rows that count (of the kept ones those `scored`); intervals by resampling whole blocks.

    `needed_nm` (m,): torque that the axis needs; `inertia` in Nm s2/rev converts the residual to an acceleration.
    """
    rows = data.rows
    use = rows.kept if scored is None else rows.kept & scored
    block = rows.folds.block
    count = int(block[-1]) + 1
    squares = np.bincount(block[use], fitted.residual_nm[use] ** 2, count)
    powers = np.bincount(block[use], needed_nm[use] ** 2, count)
    sizes = np.bincount(block[use], minlength=count).astype(np.float64)
    rng = np.random.default_rng(7)
    filled = np.flatnonzero(sizes)
    drawn = filled[rng.integers(0, filled.size, (DRAWS, filled.size))] if filled.size else np.zeros((1, 1), np.int64)
    rms = np.sqrt(squares[drawn].sum(axis=1) / np.maximum(sizes[drawn].sum(axis=1), 1.0))
    relative = 100.0 * np.sqrt(squares[drawn].sum(axis=1) / np.maximum(powers[drawn].sum(axis=1), 1e-300))
    speeds = velocity_squares(data, fitted, inertia, use)
    velocity = Interval(0.0, 0.0, 0.0)
    if speeds.size:
        again = speeds[np.random.default_rng(8).integers(0, speeds.size, (DRAWS, speeds.size))]
        velocity = _interval(float(np.sqrt(speeds.mean())), np.sqrt(again.mean(axis=1)))
    return ErrorFigures(
        _interval(float(np.sqrt(squares.sum() / max(float(sizes.sum()), 1.0))), rms),
        _interval(100.0 * float(np.sqrt(squares.sum() / max(float(powers.sum()), 1e-300))), relative),
        velocity,
        float(use.sum()) * rows.filter.row_period_s,
    )


def inertia_of(fitted: Fitted) -> float:
    """Inertia of a model, Nm s2/rev."""
    return float(fitted.physical[NAMES.index("inertia_nm_s2_per_rev")])


def velocity_squares(data: Data, fitted: Fitted, inertia: float, scored: Mask) -> Floats:
    """Mean squared velocity error of each window whose rows are scored, rps2. (w,)

    The residual torque is integrated from the start of a window, with one inertia for all models and with friction and
    effects along the measured motion. The window's mean torque is removed: a constant carries no form.
    """
    rows = data.rows
    change_rps = fitted.residual_nm * rows.filter.row_period_s / inertia
    use = rows.kept & scored
    found = []
    for window_s in WINDOWS_S:
        length = max(2, round(window_s / rows.filter.row_period_s))
        for begin, end in rows.bounds:
            count = (end - begin) // length
            part = slice(begin, begin + count * length)
            steps = change_rps[part].reshape(count, length)[use[part].reshape(count, length).all(axis=1)]
            found.append(np.mean(np.cumsum(steps - steps.mean(axis=1, keepdims=True), axis=1) ** 2, axis=1))
    return np.concatenate(found)


def _interval(value: float, drawn: Floats) -> Interval:
    low, high = (float(x) for x in np.quantile(drawn, (0.025, 0.975)))
    return Interval(value, min(low, value), max(high, value))
