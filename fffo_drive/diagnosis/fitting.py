"""Joint fit: base parameters with strengths and shapes of all effects, on the rows in torque.

Damped Gauss-Newton on residuals of unit variance, with Huber's loss and a wide prior on what the data do not determine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..identification.coordinates import LONGEST_DELAY_S, STRIBECK_EXPONENTS
from ..identification.criterion import Folds, clipped, levels
from ..identification.residuals import PRESLIDING_LENGTHS
from ..identification.threads import in_threads
from ..least_squares import Normal, Rule, huber, huber_weights, minimise, normal_equations, spectrum, sums_by
from ..model.effects import slots
from ..model.effects.law import PER_TURN, SHAPE
from ..model.effects.laws.lookup import VISCOUS
from ..model.effects.registry import law_of
from ..model.effects.table import Term, effects_along
from .base import (
    BASE,
    NAMES,
    RIGID,
    Along,
    BasePrior,
    along,
    balanced,
    distance,
    models_along,
    moved,
    residual_rows,
    sensitivities,
    step_of,
    wide_prior,
)
from .curves import curve_columns
from .rows import DiagnosisRows, DiagnosisStretch
from .scenes import Effect, Scene, commanded_load, load_along, load_rows, scenes_of

LOOKUP = "lookup"  # a free curve: its knots are fixed
CURVE_PRIOR = 1e-3  # prior weight, as a share of the squared norm of a curve's column
CONVERGED = 3e-4  # relative decrease of the loss that ends a fit
STEADY = 0.02  # ... and below which the sensitivities serve again
RULE = Rule(1e-4, 0.1, 1e-6, 30.0, 1e-3, 4, CONVERGED, CONVERGED, STEADY)
STEEPEST = 5.0  # largest Fs over Fc
LARGEST_LOG = 0.5  # largest step of the logarithm of a positive parameter
SPEED_CLASSES = (0.01, 0.05, 0.2, 0.6)  # bounds of the speed classes of noise, in shares of the top speed
HIDDEN = 0.1  # sd of the bias from undetectably small effects, as a share of its maximum (calibration.md)


class Data(NamedTuple):
    """The data of a fit."""

    stretches: Sequence[DiagnosisStretch]
    rows: DiagnosisRows
    weight: Floats  # (m,) inverse noise level; 0: not kept
    runs: int
    start: Floats  # start of the fits, in base parameters
    free: tuple[str, ...] = BASE  # the fitted base parameters: all, or those of a rigid base
    prior: BasePrior | None = None  # None: a wide one around the start
    most_viscous_nm_per_rps: float = math.inf  # that the torque of the logs has room for

    @property
    def used(self) -> Integers:
        """Rows that count. (q,)"""
        return np.flatnonzero(self.weight)

    @property
    def folds(self) -> Folds:
        """Of the rows that count. (q,) each"""
        return Folds(*(part[self.used] for part in self.rows.folds))

    def white(self, values: Floats) -> Floats:
        """Values (m,) or (m, k) at the rows that count, scaled to unit variance. (q,) or (q, k)"""
        used = self.used
        weight = self.weight[used]
        return np.asarray(values[used] * (weight if values.ndim == 1 else weight[:, None]))


class Fitted(NamedTuple):
    """A fitted model: base and effects."""

    physical: Floats
    effects: tuple[Effect, ...]
    loss: float  # mean loss of the white residual, nats
    residual_nm: Floats  # (m,)
    white: Floats  # (q,)

    @property
    def energy(self) -> float:
        """Sum of squares of the white residual, with outliers pulled in."""
        return float(np.sum(clipped(self.white) ** 2))


Evaluated = tuple[Fitted, list[Scene]]


class Slot(NamedTuple):
    """One fitted number of an effect."""

    effect: int
    name: str
    run: int  # -1: the same in all runs
    step: float  # of the numeric derivative
    logarithmic: bool
    periods_per_turn: bool  # the number is an order


def share_gone(before: Fitted, after: Fitted) -> float:
    """Share of the loss that is removed, at most 1: of the squared white residual, with outliers as in `huber`."""
    return 1.0 - after.loss / max(before.loss, 1e-300)


def loads_of(scenes: Sequence[Scene], effects: Sequence[Effect]) -> list[Floats]:
    """Torque of the effects (at least one) along each stretch at full rate."""
    return [np.sum([load_along(s, one.name, one.values(s.stretch.run)) for one in effects], axis=0) for s in scenes]


def evaluate(data: Data, physical: Floats, effects: Sequence[Effect]) -> Evaluated:
    """Residual of a model at the rows, and the scenes of its effects."""
    models = models_along(data.stretches, physical)
    residual = residual_rows(data.stretches, physical, data.rows, models)
    scenes = _scenes(data, physical, effects, models)
    if effects:
        residual = residual - torque_of(data, scenes, effects)
    white = data.white(residual)
    return Fitted(physical, tuple(effects), float(huber(white).mean()), residual, white), scenes


def torque_of(data: Data, scenes: Sequence[Scene], effects: Sequence[Effect]) -> Floats:
    """Torque of effects at the rows. (m,)"""
    found = np.zeros(data.rows.time_s.size)
    for effect in effects:
        found += load_rows(data.rows, scenes, effect)
    return found


def rigid_of(data: Data) -> Data:
    """The data with a rigid base: friction of one level."""
    start = data.start.copy()
    start[NAMES.index("static_nm")] = start[NAMES.index("coulomb_nm")]
    return data._replace(free=RIGID, start=start)


def with_levels(data: Data, fitted: Fitted) -> Data:
    """The data with noise levels from this model's residual, by speed class; presliding is a class of its own."""
    speed = np.abs(data.rows.velocity_rps)
    top = max(float(np.quantile(speed, 0.99)), 1e-12)
    classes = np.searchsorted(np.array([share * top for share in SPEED_CLASSES]), speed) + 1
    travel = data.rows.joined(along(stretch, fitted.physical).travel_rev for stretch in data.stretches)
    classes[travel < PRESLIDING_LENGTHS / fitted.physical[NAMES.index("stiffness_per_rev")]] = 0
    return data._replace(weight=levels(fitted.residual_nm, data.rows.kept, classes))


def jacobian(data: Data, fitted: Fitted) -> Floats:
    """White sensitivities of everything that is fitted: the base, then the numbers of the effects. (q, p)"""
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    return _jacobian(data, fitted, scenes, slots_of(fitted.effects, data.rows.turns), len(BASE))


def _jacobian(data: Data, fitted: Fitted, scenes: Sequence[Scene], numbers: Sequence[Slot], count: int) -> Floats:
    matrix = effect_jacobian(data, fitted.effects, numbers, scenes)
    if count:
        base = _free(data, loaded_sensitivities(data, fitted.physical, fitted.effects))
        matrix = np.concatenate([base, matrix], axis=1)
    return data.white(matrix)


def _free(data: Data, matrix: Floats) -> Floats:
    """Sensitivities (m, len(BASE)), zero for parameters that are not fitted. In a rigid base Fs moves with Fc."""
    found = matrix * np.array([name in data.free for name in BASE])
    if "static_nm" not in data.free:
        found[:, BASE.index("coulomb_nm")] += matrix[:, BASE.index("static_nm")]
    return np.asarray(found)


def consistent_scenes(data: Data, physical: Floats, effects: Sequence[Effect]) -> list[Scene]:
    """Scenes whose torque includes the effects, except those that respond to torque themselves."""
    return _scenes(data, physical, effects, models_along(data.stretches, physical))


def _scenes(data: Data, physical: Floats, effects: Sequence[Effect], models: Sequence[Along]) -> list[Scene]:
    scenes = scenes_of(data.stretches, physical, models)
    carried = [e for e in effects if not law_of(e.name).joint and law_of(e.name).feedforward is None]
    if not carried or not any(law_of(e.name).feedforward is not None for e in effects):
        return scenes
    return scenes_of(data.stretches, physical, models, loads_of(scenes, carried))


def load_of(data: Data, fitted: Fitted, number: int) -> Floats:
    """White torque of one effect. (q,)"""
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    return data.white(load_rows(data.rows, scenes, fitted.effects[number]))


def at_rest(data: Data, physical: Floats, effects: Sequence[Effect]) -> Data:
    """The data with the torque that friction balances at rest: motor torque minus inertia and effects."""
    data = data._replace(stretches=balanced(data.stretches, physical))
    acting = [effect for effect in effects if not law_of(effect.name).level and not law_of(effect.name).joint]
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
    """Whether a law acts on the command itself."""
    return law_of(effect.name).acts_on == "command"


def slots_of(effects: Sequence[Effect], turns: float) -> list[Slot]:
    """Every fitted number of the effects."""
    found = []
    for number, effect in enumerate(effects):
        law = law_of(effect.name)
        for p in law.parameters:
            if p.name in effect.strengths:
                values = effect.strengths[p.name]
                runs = range(values.size) if p.name in effect.per_run else [-1]
            elif p.kind == SHAPE and not (p.held or p.is_off(effect.shapes)):
                runs = [-1]
            else:
                continue
            step = p.step_at(effect.shapes, turns)
            found += [Slot(number, p.name, run, step, p.logarithmic, p.unit == PER_TURN) for run in runs]
    return found


def numbers_of(fitted: Fitted) -> int:
    """Free numbers of all effects."""
    return len(slots_of(fitted.effects, 1.0))


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
    """Derivative of the effects' torque by each number, at the rows. (m, slots)"""
    rows = data.rows
    matrix = np.zeros((rows.time_s.size, len(numbers)))
    base: dict[int, Floats] = {}
    for k, effect in enumerate(effects):
        if law_of(effect.name).name == LOOKUP:
            own = [column for column, slot in enumerate(numbers) if slot.effect == k]
            if own:
                parts = [curve_columns(scene, effect.name, effect.shapes, rows.laws) for scene in scenes]
                matrix[:, own] = np.concatenate(parts)
        else:
            base[k] = load_rows(rows, scenes, effect)

    def column(place: int) -> None:
        slot = numbers[place]
        if slot.effect in base:
            moved_effect = changed(effects, slot, slot.step)[slot.effect]
            matrix[:, place] = (load_rows(rows, scenes, moved_effect) - base[slot.effect]) / slot.step

    list(in_threads(column, range(len(numbers))))
    return matrix


def fit(data: Data, start: Floats, effects: Sequence[Effect], iterations: int = 4, datum_alone: bool = False) -> Fitted:
    """Fit base and effects from a start; `datum_alone`: only the strengths with a datum per run."""
    turns = data.rows.turns
    numbers = slots_of(effects, turns)
    count = len(BASE)
    if datum_alone:
        numbers = [slot for slot in numbers if slot.name in effects[slot.effect].per_run]
        count = 0
    prior = data.prior or wide_prior(data.start)
    precision = prior.weighed(data.used.size)[:count, :count]
    matrix = np.zeros((0, 0))

    def loss(fitted: Fitted) -> float:
        away = distance(fitted.physical, prior.centre)[:count]
        return fitted.loss * fitted.white.size + 0.5 * float(away @ precision @ away)

    def about(point: Evaluated, anew: bool) -> tuple[float, Normal]:
        nonlocal matrix
        fitted, scenes = point
        if anew:
            matrix = _jacobian(data, fitted, scenes, numbers, count)
        normal = normal_equations(matrix, fitted.white, huber_weights(fitted.white))
        normal.moment[:count] -= precision @ distance(fitted.physical, prior.centre)[:count]
        normal.matrix[:count, :count] += precision
        _curve_prior(normal, fitted, numbers, count)
        return loss(fitted), normal

    def after(point: Evaluated, step: Floats) -> tuple[Evaluated, float]:
        fitted = point[0]
        physical = fitted.physical
        if count:
            physical = stepped(physical, step[:count], data.free, data.most_viscous_nm_per_rps)
        moved_effects: Sequence[Effect] = fitted.effects
        for slot, size in zip(numbers, step[count:], strict=True):
            limit = LARGEST_LOG if slot.logarithmic else np.inf
            if slot.periods_per_turn:
                limit = 0.25 / max(turns, 1.0)
            moved_effects = changed(moved_effects, slot, float(np.clip(size, -limit, limit)))
        trial = evaluate(data, physical, moved_effects)
        return trial, loss(trial[0])

    return minimise(evaluate(data, start, effects), about, after, RULE, iterations)[0][0]


def _curve_prior(normal: Normal, fitted: Fitted, numbers: Sequence[Slot], first: int) -> None:
    """Prior of free curves: values of the size of the friction, shrunk to zero where the motion hardly goes."""
    for place, slot in enumerate(numbers, first):
        effect = fitted.effects[slot.effect]
        if law_of(effect.name).name == LOOKUP:
            size = "viscous_nm_per_rps" if effect.shapes["kind"] == VISCOUS else "coulomb_nm"
            precision = CURVE_PRIOR * normal.matrix[place, place] + 1.0 / fitted.physical[NAMES.index(size)] ** 2
            normal.moment[place] -= precision * float(effect.strengths[slot.name][0])
            normal.matrix[place, place] += precision


def loaded_sensitivities(data: Data, physical: Floats, effects: Sequence[Effect]) -> Floats:
    """Sensitivities of what is fitted of the base, in the presence of effects. (m, len(BASE))

    The effect of a level changes with the level, and an effect on the command is delayed as the torque is.
    """
    names = {*data.free, "static_nm"}  # with which Fc moves in a rigid base
    matrix = sensitivities(data.stretches, physical, data.rows, names)
    delay = BASE.index("delay_s")
    others = [k for k, name in enumerate(BASE) if name in names and name not in ("delay_s", "sensor_lag_s2")]
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
    """Derivative of the `carried` effects' torque by each of these coordinates of BASE. (m, columns)"""
    before = torque_of(data, consistent_scenes(data, physical, effects), carried)

    def slope(k: int) -> Floats:
        step = step_of(BASE[k], data.rows.filter.period_s)
        scenes = consistent_scenes(data, moved(physical, BASE[k], step), effects)
        return (torque_of(data, scenes, carried) - before) / step

    return np.stack(list(in_threads(slope, columns)), axis=1)


def stepped(
    physical: Floats, step: Floats, free: Sequence[str] = BASE, most_viscous_nm_per_rps: float = math.inf
) -> Floats:
    """Base parameters after a step in their coordinates, within bounds."""
    found = physical
    for name, size in zip(BASE, step, strict=True):
        if name in free:
            found = moved(found, name, float(np.clip(size, -LARGEST_LOG, LARGEST_LOG)))
    found = found.copy()
    bounds = (
        ("delay_s", (0.0, LONGEST_DELAY_S)),
        ("stribeck_exponent", STRIBECK_EXPONENTS),
        ("viscous_nm_per_rps", (0.0, max(most_viscous_nm_per_rps, float(physical[NAMES.index("viscous_nm_per_rps")])))),
    )
    for name, (low, high) in bounds:
        k = NAMES.index(name)
        found[k] = min(max(found[k], low), high)
    coulomb, static = NAMES.index("coulomb_nm"), NAMES.index("static_nm")
    if "static_nm" not in free:
        found[static] = physical[static] * found[coulomb] / physical[coulomb]
    found[static] = max(found[static], found[coulomb])
    # in its logarithm it could never leave zero again
    found[coulomb] = max(found[coulomb], found[static] / STEEPEST)
    return found


def standard_deviations(data: Data, fitted: Fitted, matrix: Floats | None = None, negligible_nm: float = 0.0) -> Floats:
    """Standard deviations of BASE in its coordinates, then of the effects' numbers. (p,)

    Noise enters by the sandwich estimate over blocks. An undetected effect of this rms torque adds HIDDEN times the
    largest bias that it can cause in a number.
    """
    matrix = jacobian(data, fitted) if matrix is None else matrix
    half = spectrum(matrix.T @ matrix).basis()
    inverse, used = half @ half.T, data.used
    scores = sums_by(data.rows.folds.block[used], matrix * clipped(fitted.white)[:, None]) @ inverse
    pull = (matrix * data.weight[used][:, None]) @ inverse
    share = used.size * (HIDDEN * negligible_nm) ** 2
    return np.asarray(np.sqrt(np.sum(scores**2, axis=0) + share * np.einsum("ij,ij->j", pull, pull)))
