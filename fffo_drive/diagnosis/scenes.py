"""Effects along the measured motion: torque of laws at the rows, filtered like all other signals.

A wave in angle has its column in closed form, at any order: where it passes N v times a second the filter has the gain
g(N v). Evaluated by its kernel at the laws' rate it would alias.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats
from ..model.axis import AxisConfig
from ..model.effects import slots
from ..model.effects.registry import law_of
from ..model.effects.table import Term, effects_along
from .base import Along, axis_config
from .kernels import contact_levels, wave_rows
from .rows import DiagnosisRows, DiagnosisStretch, second_difference

Factors = dict[str, Floats]  # factors of waves, by kind: the same for all orders


@dataclass(frozen=True)
class Effect:
    """A law with its numbers. Strengths with a datum per run have one value per run, all others a single value."""

    name: str
    shapes: Mapping[str, float]
    strengths: Mapping[str, Floats]  # (1,) or (runs,)
    per_run: frozenset[str] = field(default_factory=frozenset)

    def values(self, run: int) -> dict[str, float]:
        """Parameters in one run."""
        found = {name: float(v[run if v.size > 1 else 0]) for name, v in self.strengths.items()}
        return {**self.shapes, **found}

    def with_shape(self, name: str, value: float) -> Effect:
        """A copy with one shape changed."""
        return replace(self, shapes={**self.shapes, name: value})

    @property
    def waves(self) -> list[tuple[str, str]]:
        """Cosine and sine strengths of each wave with a datum per run."""
        names = [name for name in self.strengths if name in self.per_run]
        return list(zip(names[::2], names[1::2], strict=True))

    def sizes(self) -> list[float]:
        """Amplitude of each wave, the median over the runs: a run that hardly turns determines it poorly."""
        return [float(np.median(np.hypot(self.strengths[c], self.strengths[s]))) for c, s in self.waves]

    def of_sizes(self, sizes: list[float]) -> Effect:
        """A copy with these amplitudes in every run and unchanged phases."""
        strengths = dict(self.strengths)
        for (cosine, sine), size in zip(self.waves, sizes, strict=True):
            phase = np.arctan2(strengths[sine], strengths[cosine])
            strengths[cosine], strengths[sine] = size * np.cos(phase), size * np.sin(phase)
        return replace(self, strengths=strengths)


KEPT_BAND = 0.7  # share of a thinned command's bandwidth that is kept
LEAST_OF_TORQUE = 0.1  # smallest share of the torque that a ripple leaves, as in its law
SAMPLES_A_WAVE = 8.0  # of a kernel at the laws' rate, at top speed: with fewer it aliases


class Scene(NamedTuple):
    """Motion of one stretch as laws see it, with the axis parameters that it was made for.

    A torque computed from the command contains the residual: u = J a + F + E + r. With the base projected out only r
    would remain of it, and it would explain itself. Laws of the torque therefore see the modelled torque without E and
    r, u - r - E, as a feed-forward does; only laws that act on the command see the command itself, residual included.
    The measured current decides whether a lag or a limit is real. Inside a dead zone the residual explains itself, so
    little of the motion may be there.
    """

    stretch: DiagnosisStretch
    motion: Floats  # (n, slots.N_MOTION), with the modelled torque
    commanded: Floats  # commanded current at the rate of the record
    axis: AxisConfig
    moving: Floats  # (n,) 1, or 0 at rest, where friction balances all other torques

    @property
    def commanded_thinned(self) -> Floats:
        """The command at the laws' rate. (n,)"""
        return thinned(self.commanded, self.stretch.thin)


def scenes_of(
    stretches: Sequence[DiagnosisStretch], physical: Floats, models: Sequence[Along],
    loads_nm: Sequence[Floats] | None = None,
) -> list[Scene]:  # fmt: skip
    """Motion of all stretches with these base parameters; `loads_nm` are the torques of accepted effects along them.

    Time is the log's clock: runs follow one another.
    """
    found = []
    for number, (stretch, model) in enumerate(zip(stretches, models, strict=True)):
        axis = axis_config(physical, stretch.torque_constant_nm_per_a)
        motion = np.empty((stretch.samples, slots.N_MOTION))
        torque_nm = axis.inertia_nm_s2_per_rev * stretch.acceleration_rps2 + model.friction_nm
        if loads_nm is not None:
            torque_nm = torque_nm + loads_nm[number]
        motion[:, slots.TIME_S] = stretch.begin_s + np.arange(stretch.samples) * stretch.law_period_s
        motion[:, slots.VELOCITY_RPS] = stretch.velocity_rps
        motion[:, slots.ACCELERATION_RPS2] = stretch.acceleration_rps2
        motion[:, slots.MOTOR_ANGLE_REV] = stretch.smooth_rev
        motion[:, slots.SENSOR_ANGLE_REV] = stretch.smooth_rev
        motion[:, slots.CURRENT_A] = torque_nm / stretch.torque_constant_nm_per_a
        motion[:, slots.FRICTION_NM] = model.friction_nm
        motion[:, slots.TRAVEL_REV] = model.travel_rev
        motion[:, slots.DIRECTION] = model.direction
        mean_rps = np.diff(stretch.path_rev, prepend=stretch.path_rev[:1]) / stretch.law_period_s  # over each step
        contact_levels(axis.friction, mean_rps, motion[:, slots.CONTACT_LEVEL_NM])
        commanded = model.torque_nm / stretch.torque_constant_nm_per_a
        found.append(Scene(stretch, motion, commanded, axis, (~stretch.rest).astype(np.float64)))
    return found


def thinned(values: Floats, thin: int) -> Floats:
    """Every `thin`-th of values (n,), low-passed without delay against aliasing."""
    if thin == 1:
        return values
    return np.asarray(scipy.ndimage.correlate1d(values, _taps(thin), mode="nearest")[::thin])


@cache
def _taps(thin: int) -> Floats:
    return np.asarray(scipy.signal.firwin(8 * thin + 1, KEPT_BAND / thin), dtype=np.float64)


def load_along(scene: Scene, name: str, values: Mapping[str, float]) -> Floats:
    """Contribution of an effect to the torque residual of a stretch, at the laws' rate: E; -J e'' for a sensor error
    e.
    """
    period_s = scene.stretch.law_period_s
    terms = [Term(name, values)]
    if law_of(name).acts_on == "command":
        load_nm, sensor_rev = commanded_load(scene, terms), np.zeros(0)
    else:
        load_nm, sensor_rev = effects_along(terms, scene.motion, scene.axis, period_s, feedforward=True)
    if sensor_rev.any():
        load_nm = load_nm - scene.axis.inertia_nm_s2_per_rev * second_difference(sensor_rev, period_s)
    if not np.isfinite(load_nm).all():
        return np.zeros(load_nm.size)  # a joint that is unstable with these numbers explains nothing
    return np.asarray(load_nm * scene.moving)


def commanded_load(scene: Scene, terms: Sequence[Term]) -> Floats:
    """Contribution of an effect on the command, at the record's rate: a limit cuts noise, a lag filters it. (n,)"""
    stretch, size = scene.stretch, scene.commanded.size
    thin = stretch.thin
    motion = np.zeros((size, slots.N_MOTION))
    places, laws = np.arange(size) / thin, np.arange(stretch.samples)
    motion[:, slots.VELOCITY_RPS] = np.interp(places, laws, stretch.velocity_rps)
    motion[:, slots.CURRENT_A] = scene.commanded
    load_nm, _ = effects_along(terms, motion, scene.axis, stretch.period_s)
    return thinned(load_nm, thin)


def load_rows(rows: DiagnosisRows, scenes: Sequence[Scene], effect: Effect) -> Floats:
    """Contribution of an effect to the torque residual at all rows. (m,)"""
    if not in_closed_form(rows, effect.name, effect.shapes):
        parts = [load_along(scene, effect.name, effect.values(scene.stretch.run)) for scene in scenes]
        return np.concatenate([rows.laws.rows(part) for part in parts])
    found = np.zeros(rows.time_s.size)
    factors: Factors = {}
    columns = wave_columns(rows, scenes, effect.name, effect.shapes, factors)
    for strength, column in zip(law_of(effect.name).strengths, columns.T, strict=True):
        values = effect.strengths.get(strength.name, np.zeros(1))
        found += column * (values[rows.run] if values.size > 1 else values[0])
    if law_of(effect.name).wave == "torque":  # the torque that compensates the ripple has the ripple too
        factor = factors["torque"]
        ripple = np.divide(found, factor, out=np.zeros_like(found), where=factor != 0.0)
        found /= np.maximum(LEAST_OF_TORQUE, 1.0 - ripple)
    return found


def in_closed_form(rows: DiagnosisRows, name: str, shapes: Mapping[str, float]) -> bool:
    """Whether a wave has a closed form here: a friction wave only where its kernel would have too few samples."""
    wave = law_of(name).wave
    if wave != "friction":
        return bool(wave)
    passed_hz = wave_order(shapes) * float(np.abs(rows.velocity_rps).max())
    return passed_hz * rows.laws.period_s * SAMPLES_A_WAVE > 1.0


def wave_order(shapes: Mapping[str, float]) -> float:
    """Periods of a wave in a motor turn."""
    return shapes["order"] if "order" in shapes else 1.0 / shapes["ratio"]


def wave_columns(
    rows: DiagnosisRows, scenes: Sequence[Scene], name: str, shapes: Mapping[str, float], factors: Factors | None = None
) -> Floats:
    """Filtered cosine and sine of a wave at the rows, per unit of strength. (m, 2)

    Friction follows its level over the travel level/B (5), so that a wave of the level arrives smaller and later.
    """
    wave, order = law_of(name).wave, wave_order(shapes)
    factors = {} if factors is None else factors
    if wave not in factors:
        factors[wave] = wave_factor(rows, scenes, wave)
    lag_rev = 1.0 / scenes[0].axis.friction.attraction_nm_per_rev if wave == "friction" else 0.0
    found = np.empty((rows.time_s.size, 2))
    wave_rows(
        rows.position_rev, rows.velocity_rps, factors[wave], order, lag_rev, rows.filter.response,
        rows.filter.points_per_hz, found,
    )  # fmt: skip
    return found


def wave_factor(rows: DiagnosisRows, scenes: Sequence[Scene], wave: str) -> Floats:
    """Factor of a wave: one, the modelled torque, or the friction without its viscous part. (m,)"""
    if wave == "torque":
        return np.concatenate([rows.laws.rows(_torque_nm(scene)) for scene in scenes])
    if wave == "friction":
        return np.concatenate([rows.laws.rows(_contact_nm(scene)) for scene in scenes])
    return rows.joined(scene.moving for scene in scenes)


def _torque_nm(scene: Scene) -> Floats:
    return np.asarray(scene.motion[:, slots.CURRENT_A] * scene.axis.torque_constant_nm_per_a * scene.moving)


def _contact_nm(scene: Scene) -> Floats:
    viscous_nm = scene.axis.friction.viscous_nm_per_rps * scene.motion[:, slots.VELOCITY_RPS]
    return np.asarray((scene.motion[:, slots.FRICTION_NM] - viscous_nm) * scene.moving)


class Columns(NamedTuple):
    """Torque per unit of strength, with the name and the run (-1: all) of each strength. (m, k)"""

    names: tuple[str, ...]
    runs: tuple[int, ...]
    values: Floats


def strength_columns(
    rows: DiagnosisRows, scenes: Sequence[Scene], name: str, shapes: Mapping[str, float], factors: Factors | None = None
) -> Columns:
    """Regressors of a law at a shape, one per strength, with one datum for all runs."""
    law = law_of(name)
    if in_closed_form(rows, name, shapes):
        names = tuple(p.name for p in law.strengths)
        return Columns(names, (-1,) * len(names), wave_columns(rows, scenes, name, shapes, factors))
    found: dict[str, Floats] = {}
    for strength in law.strengths:
        if strength.needs and shapes.get(strength.needs, 0.0) <= 0.0:
            continue
        probe = Effect(name, dict(shapes), {strength.name: np.array([strength.typical])})
        column = load_rows(rows, scenes, probe) / strength.typical
        if column.any():
            found[strength.name] = column
    values = np.stack(list(found.values()), axis=1) if found else np.zeros((rows.time_s.size, 0))
    return Columns(tuple(found), (-1,) * len(found), values)


def with_datum(columns: Columns, name: str, rows: DiagnosisRows) -> Columns:
    """The same columns with a datum of its own in each run."""
    names, runs, values = [], [], []
    for label, column in zip(columns.names, columns.values.T, strict=True):
        for run in np.unique(rows.run) if label in law_of(name).per_run else (-1,):
            names.append(label)
            runs.append(int(run))
            values.append(column if run < 0 else np.where(rows.run == run, column, 0.0))
    return Columns(tuple(names), tuple(runs), np.stack(values, axis=1))


def effect_of(name: str, shapes: Mapping[str, float], columns: Columns, strengths: Floats, runs: int) -> Effect:
    """An effect from least-squares strengths in the order of its columns."""
    found: dict[str, Floats] = {}
    per_run = set()
    for label, run, value in zip(columns.names, columns.runs, strengths, strict=True):
        if run < 0:
            found[label] = np.array([value])
        else:
            per_run.add(label)
            found.setdefault(label, np.zeros(runs))[run] = value
    return Effect(name, dict(shapes), found, frozenset(per_run))
