"""Joint refit of all parameters: those of the model and those of its effects, shared or per run.

Adding an effect changes the other parameters: without it, Coulomb friction absorbs the mean of a drift, J the slope of
an elasticity. So nothing is held that the data determine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..model.effects.table import Term
from ..model.parameters import EffectModel, effect_model
from .coordinates import MODEL_PARAMETERS, NUISANCES, PARAMETERS, Coordinates, coordinates, to_coordinates, to_physical
from .layout import SHARED, EffectLayout, EffectScales, EffectStart, layout_of
from .prediction import Problem, jacobian
from .solver import Solution, solve
from .uncertainty import Uncertainty, uncertainty_of

Floats = npt.NDArray[np.float64]

BASE = len(PARAMETERS)
ITERATIONS = 12
COULOMB, STATIC, VISCOUS = (PARAMETERS.index(name) for name in ("coulomb_nm", "static_nm", "viscous_nm_per_rps"))
# a fit without the effect may have driven a friction parameter to zero, and a logarithm returns slowly from there
LEAST_SHARE = 0.1  # of the larger of Fc and Fs; of what viscous friction has of it at the highest speed


class FittedEffect(NamedTuple):
    """A fitted effect; standard deviations under the same names, without held parameters."""

    name: str
    values: Mapping[str, float]
    sd: Mapping[str, float]
    per_run: Mapping[str, tuple[float, ...]]
    per_run_sd: Mapping[str, tuple[float, ...]]

    def term(self, run: int = 0) -> Term:
        """The effect in one run."""
        return Term(self.name, {**self.values, **{key: values[run] for key, values in self.per_run.items()}})

    def start(self) -> EffectStart:
        """As the start of another fit."""
        return EffectStart(self.name, self.values, self.per_run)

    def model(self, alternatives: Sequence[str] = (), provenance: str = "") -> EffectModel:
        """For a model file; of a parameter with a value for each run the first one stands there."""
        sd = {**self.sd, **{key: spread[0] for key, spread in self.per_run_sd.items()}}
        return effect_model(
            self.name, self.term().values, {key: spread or None for key, spread in sd.items()},
            datum="run" if self.per_run else "absolute", alternatives=alternatives, provenance=provenance,
        )  # fmt: skip


class EffectsFit(NamedTuple):
    """Result of the refit."""

    physical: Floats  # (parameters,): of coordinates.PARAMETERS, then of the layout
    effects: tuple[FittedEffect, ...]
    errors: Floats  # (rows,) prediction errors, counts of the sensor
    jacobian: Floats  # (rows, free), by coordinates; empty if not requested
    free: npt.NDArray[np.int64]  # positions of the columns in the vector
    problem: Problem  # with the layout
    space: Coordinates
    solution: Solution
    uncertainty: Uncertainty | None

    @property
    def base(self) -> Floats:
        """The model's own parameters and nuisances, as coordinates.PARAMETERS."""
        return self.physical[:BASE]

    def terms(self, run: int = 0) -> list[Term]:
        """All effects as they act in a run."""
        return [effect.term(run) for effect in self.effects]


def scales_of(problem: Problem, physical: Floats) -> EffectScales:
    """Sizes of the data of a problem."""
    period_s = problem.shooting.period_s
    span = max(1, round(0.01 / period_s))
    speed = max(float(np.abs(s.position_rev[span:] - s.position_rev[:-span]).max()) for s in problem.stretches)
    return EffectScales(
        max(float(physical[COULOMB]), float(physical[STATIC])),
        speed / (span * period_s),
        max(float(np.ptp(s.position_rev)) for s in problem.stretches),
        max(s.position_rev.size for s in problem.stretches) * period_s,
        period_s,
        problem.lsb_rev,
    )


def with_effects(problem: Problem, physical: Floats, effects: Sequence[EffectStart]) -> tuple[Problem, Floats]:
    """The problem with a layout, and the vector (parameters,) at the start of a refit."""
    layout = layout_of(effects, scales_of(problem, physical))
    return problem._replace(layout=layout), np.concatenate([physical[:BASE], [p.value for p in layout.parameters]])


def joint_coordinates(base: Coordinates, layout: EffectLayout) -> Coordinates:
    """The space of the model's own parameters with that of the effects behind it."""
    parameters = layout.parameters
    scale = np.array([p.scale for p in parameters])
    values = np.array([p.value for p in parameters]) / scale
    low = np.array([p.low for p in parameters]) / scale
    high = np.array([p.high for p in parameters]) / scale
    held = ~np.array([p.free for p in parameters], dtype=bool)
    low[held] = high[held] = values[held]
    return Coordinates(
        (*base.names, *layout.labels), np.concatenate([base.scale, scale]), np.concatenate([base.low, low]),
        np.concatenate([base.high, high]), base.rising,
    )  # fmt: skip


def fit_effects(
    problem: Problem, physical: Floats, effects: Sequence[EffectStart], *,
    free: Sequence[str] = (*MODEL_PARAMETERS, NUISANCES[0]), iterations: int = ITERATIONS,
    check: Problem | None = None, with_jacobian: bool = True, progress: Callable[[int], None] | None = None,
) -> EffectsFit:  # fmt: skip
    """Refit the parameters `free` of the model and all free ones of the effects, from `physical` (PARAMETERS, ...).

    With `check`, a problem of the same records at a second bandwidth (prediction.make_problem), standard deviations
    are computed and include the shift between the two. Without effects it refits the model alone.
    """
    joint, start = with_effects(problem, physical, effects)
    assert joint.layout is not None
    if effects:
        start = _revived(start, scales_of(problem, physical))
    else:
        joint = joint._replace(layout=None)
    base = coordinates(start[:BASE], problem.shooting.period_s, tuple(free))
    space = joint_coordinates(base, joint.layout) if joint.layout else base
    solution = solve(joint, space, to_coordinates(start, space.scale), iterations, progress)
    uncertainty = None
    if check is not None:
        other = solve(check._replace(layout=joint.layout), space, solution.values, max(4, iterations // 2))
        uncertainty = uncertainty_of(joint, space, solution, other.values - solution.values)
    movable = np.flatnonzero(space.high > space.low)
    if with_jacobian:
        errors, matrix = jacobian(joint, space, solution.values, movable, central=False)
    else:
        errors, matrix = jacobian(joint, space, solution.values, movable[:0], central=False)
    found = to_physical(solution.values, space.scale)
    fitted = effects_of(joint.layout, found, None if uncertainty is None else uncertainty.sd)
    return EffectsFit(found, fitted, errors, matrix, movable, joint, space, solution, uncertainty)


def _revived(start: Floats, scales: EffectScales) -> Floats:
    """The start, with the friction restored that a fit without the effects had driven to zero."""
    revived = start.copy()
    least_nm = LEAST_SHARE * scales.torque_nm
    revived[COULOMB] = max(start[COULOMB], least_nm)
    revived[STATIC] = max(start[STATIC], least_nm)
    revived[VISCOUS] = max(start[VISCOUS], LEAST_SHARE * least_nm / max(scales.highest_rps, 1e-9))
    return revived


def effects_of(layout: EffectLayout | None, physical: Floats, sd: Floats | None) -> tuple[FittedEffect, ...]:
    """The effects of a layout with the values of a fit, (parameters,), and their standard deviations where given."""
    found = []
    for k, name in enumerate(layout.names if layout else ()):
        assert layout is not None
        values: dict[str, float] = {}
        spread: dict[str, float] = {}
        runs: dict[str, tuple[float, ...]] = {}
        runs_spread: dict[str, tuple[float, ...]] = {}
        for j, p in enumerate(layout.parameters):
            if p.effect != k:
                continue
            value, own = float(physical[BASE + j]), float(sd[BASE + j]) if sd is not None and p.free else 0.0
            if p.run == SHARED:
                values[p.name] = value
                if own > 0.0:
                    spread[p.name] = own
            else:
                runs[p.name] = (*runs.get(p.name, ()), value)
                runs_spread[p.name] = (*runs_spread.get(p.name, ()), own)
        found.append(FittedEffect(name, values, spread, runs, runs_spread))
    return tuple(found)
