"""Refit of everything together: base parameters, strengths and shapes of all effects, on the rows in torque.

Gauss-Newton with damping on the white residual. The sensitivities of the base change little between rivals and are
shared; those of the effects are made anew at every step, and the model's torque that laws see follows the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..identification.coordinates import LONGEST_DELAY_S, STRIBECK_EXPONENTS
from ..identification.prediction import THREADS
from ..model.effects import slots
from ..model.effects.law import PER_TURN, SHAPE
from ..model.effects.registry import law_of
from ..model.effects.table import Term, effects_along
from .base import BASE, NAMES, Along, balanced, models_along, moved, residual_rows, sensitivities, step_of
from .candidates import Effect, Scene, commanded_load, load_along, scenes_of
from .curves import curve_columns
from .evidence import Whitening, whiten
from .paths import Rows, Stretch

Floats = npt.NDArray[np.float64]

LOOKUP = "lookup"  # a free curve: its knots stay
HUBER = 4.0
CONVERGED = 3e-4  # relative fall of the loss at which a fit is done
STARTED = 2  # rounds of a fit from the start, its sensitivities made anew in each
STEADY = 0.02  # ... and at which the effects' sensitivities serve again
STEEPEST = 5.0  # Fs over Fc at most
PENALTY = 2.0  # on the logarithm of the number of rows, a free number
LARGEST_LOG = 0.5  # of a positive parameter in one step


class Data(NamedTuple):
    """What a fit is made on."""

    stretches: Sequence[Stretch]
    rows: Rows
    whitening: Whitening
    runs: int
    start: Floats  # base parameters where the first fit began


class Fitted(NamedTuple):
    """A fitted model: base and effects."""

    physical: Floats
    effects: tuple[Effect, ...]
    loss: float  # mean Huber loss of the white residual
    residual_nm: Floats  # (m,)
    white: Floats  # (q,)


class Slot(NamedTuple):
    """One number of an effect that is fitted."""

    effect: int
    name: str
    run: int  # -1: no datum per run
    step: float  # of the numeric derivative
    logarithmic: bool
    periods_per_turn: bool  # an order


def huber_loss(white: Floats) -> float:
    """Mean Huber loss at unit variance."""
    return float(np.mean(huber_terms(white)))


def huber_terms(white: Floats) -> Floats:
    """Huber loss of each row at unit variance. Shapes (q,)."""
    magnitude = np.abs(white)
    inner = np.minimum(magnitude, HUBER)
    return np.asarray(inner * (2.0 * magnitude - inner))


def loads_of(scenes: Sequence[Scene], effects: Sequence[Effect]) -> list[Floats]:
    """Torque of effects along each stretch at full rate."""
    found = []
    for scene in scenes:
        total = np.zeros(scene.stretch.samples)
        for effect in effects:
            total += load_along(scene, effect.name, effect.values(scene.stretch.run))
        found.append(total)
    return found


def evaluate(data: Data, physical: Floats, effects: Sequence[Effect]) -> tuple[Fitted, list[Scene]]:
    """Residual of a model on the rows, and the scenes that its effects see."""
    models = models_along(data.stretches, physical)
    residual = residual_rows(data.stretches, physical, data.rows, models)
    scenes = _scenes(data, physical, effects, models)
    if effects:
        residual = residual - load_rows(data, scenes, effects)
    white = whiten(data.rows, data.whitening, residual)
    return Fitted(physical, tuple(effects), huber_loss(white), residual, white), scenes


def load_rows(data: Data, scenes: Sequence[Scene], effects: Sequence[Effect]) -> Floats:
    """Torque of effects at the rows. (m,)"""
    return np.concatenate([data.rows.laws.rows(load) for load in loads_of(scenes, effects)])


def consistent_scenes(data: Data, physical: Floats, effects: Sequence[Effect]) -> list[Scene]:
    """Scenes whose torque has the effects in it, apart from those that answer to torque themselves."""
    return _scenes(data, physical, effects, models_along(data.stretches, physical))


def _scenes(data: Data, physical: Floats, effects: Sequence[Effect], models: Sequence[Along]) -> list[Scene]:
    scenes = scenes_of(data.stretches, physical, models)
    carried = [e for e in effects if not law_of(e.name).joint and law_of(e.name).feedforward is None]
    if not carried or not any(law_of(e.name).feedforward is not None for e in effects):
        return scenes
    return scenes_of(data.stretches, physical, models, loads_of(scenes, carried))


def at_rest(data: Data, physical: Floats, effects: Sequence[Effect]) -> Data:
    """The data with the torque that friction balances at rest: motor torque less inertia and effects."""
    data = data._replace(stretches=balanced(data.stretches, physical))
    acting = [effect for effect in effects if not (law_of(effect.name).level or law_of(effect.name).joint)]
    if not acting:
        return data
    found = []
    for scene in scenes_of(data.stretches, physical, models_along(data.stretches, physical)):
        stretch = scene.stretch
        motion = scene.motion.copy()
        motion[:, slots.CURRENT_A] = scene.commanded_thinned
        terms = [Term(effect.name, effect.values(stretch.run)) for effect in acting]
        load_nm, _ = effects_along(
            [term for term in terms if not on_command(term)], motion, scene.axis, stretch.law_period_s
        )
        commanded = [term for term in terms if on_command(term)]
        if commanded:
            load_nm = load_nm + commanded_load(scene, commanded)
        found.append(stretch._replace(balance_nm=stretch.balance_nm - np.nan_to_num(load_nm)))
    return data._replace(stretches=found)


def on_command(effect: Effect | Term) -> bool:
    """Whether it acts on the command itself."""
    return law_of(effect.name).acts_on == "command"


def slots_of(effects: Sequence[Effect], shapes: bool, turns: float) -> list[Slot]:
    """Every number of the effects that is fitted."""
    found = []
    for number, effect in enumerate(effects):
        law = law_of(effect.name)
        for p in law.parameters:
            if p.name in effect.strengths:
                values = effect.strengths[p.name]
                runs = range(values.size) if p.name in effect.per_run else [-1]
            elif p.kind == SHAPE and shapes and not (p.held or p.is_off(effect.shapes)):
                runs = [-1]
            else:
                continue
            step = p.step_at(effect.shapes, turns)
            found += [Slot(number, p.name, run, step, p.logarithmic, p.unit == PER_TURN) for run in runs]
    return found


def changed(effects: Sequence[Effect], slot: Slot, step: float) -> list[Effect]:
    """Effects with one number moved."""
    found = list(effects)
    effect = found[slot.effect]
    if slot.name in effect.strengths:
        values = effect.strengths[slot.name].copy()
        p = next(p for p in law_of(effect.name).strengths if p.name == slot.name)
        values[max(slot.run, 0)] = min(max(values[max(slot.run, 0)] + step, p.low), p.high)
        found[slot.effect] = replace(effect, strengths={**effect.strengths, slot.name: values})
    else:
        value = effect.shapes[slot.name]
        value = value * float(np.exp(step)) if slot.logarithmic else value + step
        p = next(p for p in law_of(effect.name).shapes if p.name == slot.name)
        found[slot.effect] = effect.with_shape(slot.name, min(max(value, p.low), p.high))
    return found


def effect_jacobian(data: Data, effects: Sequence[Effect], numbers: Sequence[Slot], scenes: Sequence[Scene]) -> Floats:
    """d(torque of the effects)/d(each number) at the rows. (m, slots)"""
    matrix = np.zeros((data.rows.time_s.size, len(numbers)))
    filter_ = data.rows.laws
    base: dict[tuple[int, int], Floats] = {}
    curves = {k for k, effect in enumerate(effects) if law_of(effect.name).name == LOOKUP}
    for k in curves:
        own = [column for column, slot in enumerate(numbers) if slot.effect == k]
        parts = [curve_columns(scene, effects[k].name, effects[k].shapes, filter_) for scene in scenes]
        matrix[:, own] = np.concatenate(parts)
    for column, slot in enumerate(numbers):
        if slot.effect in curves:
            continue
        moved_effect = changed(effects, slot, slot.step)[slot.effect]
        for (begin, end), (number, scene) in zip(data.rows.bounds, enumerate(scenes), strict=True):
            run = scene.stretch.run
            if slot.run >= 0 and slot.run != run:
                continue
            key = (slot.effect, number)
            if key not in base:
                effect = effects[slot.effect]
                base[key] = load_along(scene, effect.name, effect.values(run))
            difference = load_along(scene, moved_effect.name, moved_effect.values(run)) - base[key]
            matrix[begin:end, column] = filter_.rows(difference / slot.step)
    return matrix


def refit(
    data: Data, sensitivities: Floats, start: Floats, effects: Sequence[Effect], iterations: int = 4,
    shapes: bool = True, free_base: bool = True,
) -> Fitted:  # fmt: skip
    """Fit base and effects from a start. `sensitivities` (m, len(BASE)) may be those of a near model."""
    best, scenes = evaluate(data, start, effects)
    turns = float(np.ptp(data.rows.position_rev))
    numbers = slots_of(effects, shapes, turns)
    base_white = whiten(data.rows, data.whitening, sensitivities) if free_base else np.zeros((best.white.size, 0))
    damping, fall = 1e-4, np.inf
    matrix = base_white
    for _ in range(iterations):
        if fall > STEADY:
            columns = whiten(data.rows, data.whitening, effect_jacobian(data, best.effects, numbers, scenes))
            matrix = np.concatenate([base_white, columns], axis=1)
        weight = np.minimum(1.0, HUBER / np.maximum(np.abs(best.white), 1e-12))
        gradient = matrix.T @ (weight * best.white)
        hessian = matrix.T @ (weight[:, None] * matrix)
        accepted = None
        for _ in range(4):
            step = _solve(hessian, gradient, damping)
            physical = stepped(best.physical, step[: base_white.shape[1]]) if free_base else best.physical
            moved_effects: Sequence[Effect] = best.effects
            for slot, size in zip(numbers, step[base_white.shape[1] :], strict=True):
                limit = LARGEST_LOG if slot.logarithmic else np.inf
                if slot.periods_per_turn:
                    limit = 0.25 / max(turns, 1.0)
                moved_effects = changed(moved_effects, slot, float(np.clip(size, -limit, limit)))
            trial, trial_scenes = evaluate(data, physical, moved_effects)
            if np.isfinite(trial.loss) and trial.loss < best.loss:
                accepted = trial
                break
            damping = max(1e-3, 30.0 * damping)
        if accepted is None:
            break
        fall = (best.loss - accepted.loss) / best.loss
        best, scenes = accepted, trial_scenes
        damping = max(1e-6, 0.1 * damping)
        if fall < CONVERGED:
            break
    return best


def from_start(data: Data, effects: Sequence[Effect]) -> Fitted:
    """Base and effects fitted from where the first fit began.

    A base that was fitted without an effect bends to take it in, and may not find back from where that led.
    """
    found = evaluate(data, data.start, effects)[0]
    for _ in range(STARTED):
        matrix = loaded_sensitivities(data, found.physical, found.effects)
        found = refit(data, matrix, found.physical, found.effects)
    return found


def loaded_sensitivities(data: Data, physical: Floats, effects: Sequence[Effect]) -> Floats:
    """Sensitivities of the base with effects on it. (m, len(BASE))

    A change of level grows with the level, and what acts on the command comes as late as the torque does.
    """
    matrix = sensitivities(data.stretches, physical, data.rows)
    delay = BASE.index("delay_s")
    others = [k for k, name in enumerate(BASE) if name not in ("delay_s", "sensor_lag_s2")]
    for columns, carried in (
        ([delay], [e for e in effects if on_command(e)]),
        (others, [e for e in effects if law_of(e.name).follows_model]),
    ):
        if carried:
            matrix[:, columns] += _load_slopes(data, physical, effects, carried, columns)
    return matrix


def _load_slopes(
    data: Data, physical: Floats, effects: Sequence[Effect], carried: Sequence[Effect], columns: Sequence[int]
) -> Floats:
    """d(torque of the `carried` effects)/d(each of these coordinates of BASE). (m, columns)"""
    before = load_rows(data, consistent_scenes(data, physical, effects), carried)

    def slope(k: int) -> Floats:
        step = step_of(BASE[k], data.rows.filter.period_s)
        scenes = consistent_scenes(data, moved(physical, BASE[k], step), effects)
        return (load_rows(data, scenes, carried) - before) / step

    with ThreadPoolExecutor(THREADS) as pool:
        return np.stack(list(pool.map(slope, columns)), axis=1)


def polished(data: Data, fitted: Fitted, rounds: int = 4, settled: float = 0.01) -> Fitted:
    """A fit carried on with sensitivities of its own: a base that was bent by a missing effect is far from home."""
    for _ in range(rounds):
        matrix = loaded_sensitivities(data, fitted.physical, fitted.effects)
        again = refit(data, matrix, fitted.physical, fitted.effects)
        done = 1.0 - again.loss / fitted.loss < settled
        fitted = again
        if done:
            break
    return fitted


def _solve(hessian: Floats, gradient: Floats, damping: float) -> Floats:
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    use = np.diag(hessian) > 1e-12 * float(np.diag(hessian).max(initial=1e-300))
    found = np.zeros(gradient.size)
    part = hessian[np.ix_(use, use)] / np.outer(scale[use], scale[use])
    values, vectors = np.linalg.eigh(part)
    inverse = 1.0 / (np.maximum(values, 0.0) + damping + 1e-9)
    found[use] = (vectors @ (inverse * (vectors.T @ (gradient[use] / scale[use])))) / scale[use]
    return found


def stepped(physical: Floats, step: Floats) -> Floats:
    """Base parameters after a step in their coordinates, within bounds."""
    found = physical
    for name, size in zip(BASE, step, strict=True):
        found = moved(found, name, float(np.clip(size, -LARGEST_LOG, LARGEST_LOG)))
    found = found.copy()
    for name, (low, high) in (("delay_s", (0.0, LONGEST_DELAY_S)), ("stribeck_exponent", STRIBECK_EXPONENTS)):
        k = NAMES.index(name)
        found[k] = min(max(found[k], low), high)
    coulomb, static = NAMES.index("coulomb_nm"), NAMES.index("static_nm")
    found[static] = max(found[static], found[coulomb])
    found[coulomb] = max(
        found[coulomb], found[static] / STEEPEST
    )  # by its logarithm it would never come back from zero
    return found


def cost(fitted: Fitted, data: Data) -> float:
    """Loss, raised by what the free numbers cost: exp of the penalised deviance over the rows. Smaller is better."""
    q = fitted.white.size
    free = len(slots_of(fitted.effects, True, float(np.ptp(data.rows.position_rev))))
    return float(max(fitted.loss, 1e-12) * np.exp(PENALTY * free * np.log(q) / q))


def best_gain(before: Fitted, after: Fitted) -> float:
    """Fall of the white loss times the number of rows."""
    return (before.loss - after.loss) * before.white.size


def raw_share(data: Data, before: Fitted, after: Fitted) -> float:
    """Share of the squared torque residual that is gone."""
    kept = data.rows.kept
    return 1.0 - float(np.sum(after.residual_nm[kept] ** 2)) / max(float(np.sum(before.residual_nm[kept] ** 2)), 1e-300)
