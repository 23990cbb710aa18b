"""A refit of all parameters from a given start: those of the model and those of its effects, shared or per run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fffo_drive.identification.coordinates import (
    MODEL_PARAMETERS,
    NUISANCES,
    PARAMETERS,
    Coordinates,
    coordinates,
    to_coordinates,
    to_physical,
)
from fffo_drive.identification.effects_fit import (
    BASE,
    COULOMB,
    STATIC,
    FittedEffect,
    effects_of,
    joint_coordinates,
    scales_of,
)
from fffo_drive.identification.layout import EffectScales, EffectStart, layout_of
from fffo_drive.identification.prediction import Problem, jacobian
from fffo_drive.identification.solver import Solution, point_at, solve
from fffo_drive.identification.uncertainty import Uncertainty, uncertainty_of
from fffo_drive.model.effects.table import Term

Floats = npt.NDArray[np.float64]

ITERATIONS = 12
VISCOUS = PARAMETERS.index("viscous_nm_per_rps")
# a fit without the effect may have driven a friction parameter to zero, and a logarithm returns slowly from there
LEAST_SHARE = 0.1  # of the larger of Fc and Fs; of what viscous friction has of it at the highest speed


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


def with_effects(problem: Problem, physical: Floats, effects: Sequence[EffectStart]) -> tuple[Problem, Floats]:
    """The problem with a layout, and the vector (parameters,) at the start of a refit."""
    layout = layout_of(effects, scales_of(problem, physical))
    return problem._replace(layout=layout), np.concatenate([physical[:BASE], [p.value for p in layout.parameters]])


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
    errors = point_at(joint, space, solution.values).errors
    columns = movable if with_jacobian else movable[:0]
    matrix = jacobian(joint, space, solution.values, errors, columns, central=False)
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
