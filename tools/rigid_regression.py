"""The rigid model by linear regression on force: inertia, viscous and Coulomb friction, symmetric or by direction.

    u = M a + Fv v + Fc sgn(v) + c          u = M a + Fv+ v+ + Fv- v- + Fc+ [v > 0] - Fc- [v < 0]

The method of the published EMPS benchmark (Janot, Gautier and Brunot, 2019): the position is low-passed with zero phase
(a Butterworth filter of order 4 in all, order 2 each way), differentiated by central differences, the first samples are
dropped, and force and regressors are decimated alike (Chebyshev, zero phase). Figure of merit: 100 |u - uhat| / |u|.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import signal

from fffo_drive.identification.dataset import Record
from fffo_drive.identification.kinematics import central_difference, low_pass

Floats = npt.NDArray[np.float64]

SYMMETRIC = ("inertia", "viscous", "coulomb", "offset")
DIRECTIONAL = ("inertia", "viscous_forward", "viscous_backward", "coulomb_forward", "coulomb_backward")


class RigidSettings(NamedTuple):
    """Filters of force and regressors."""

    cutoff_hz: float = 100.0
    dropped: int = 49
    decimation: int = 10
    directional: bool = False
    hold: bool = False  # the command as it acts, held: on average half a sample late


class RigidFit(NamedTuple):
    """Parameters by name, and their relative force error in per cent on the data of the fit."""

    parameters: dict[str, float]
    error_percent: float


def rigid_regressors(record: Record, settings: RigidSettings) -> tuple[Floats, Floats]:
    """Force (n,) and regressors (n, p) of a record, filtered and decimated alike."""
    position = low_pass(record.position_rev, settings.cutoff_hz, record.period_s, 4)
    velocity = central_difference(position, record.period_s)
    acceleration = central_difference(velocity, record.period_s)
    force: Floats = record.torque_constant_nm_per_a * record.current_a
    if settings.hold:
        force = 0.5 * (force + np.concatenate([force[:1], force[:-1]]))
    forward = (velocity > 0.0).astype(np.float64)
    backward = (velocity < 0.0).astype(np.float64)
    if settings.directional:
        columns = [acceleration, velocity * forward, velocity * backward, forward, -backward]
    else:
        columns = [acceleration, velocity, np.sign(velocity), np.ones_like(velocity)]
    kept = [_decimated(np.asarray(c[settings.dropped :]), settings.decimation) for c in (force, *columns)]
    return kept[0], np.column_stack(kept[1:])


def _decimated(values: Floats, factor: int) -> Floats:
    return values if factor == 1 else np.asarray(signal.decimate(values, factor, ftype="iir", zero_phase=True))


def fit_rigid(record: Record, settings: RigidSettings | None = None) -> RigidFit:
    """Least squares of force on the rigid model's regressors."""
    settings = settings or RigidSettings()
    force, matrix = rigid_regressors(record, settings)
    solution, *_ = np.linalg.lstsq(matrix, force, rcond=None)
    names = DIRECTIONAL if settings.directional else SYMMETRIC
    parameters = {name: float(value) for name, value in zip(names, solution, strict=True)}
    return RigidFit(parameters, relative_error_percent(force, matrix @ solution))


def rigid_error_percent(record: Record, parameters: dict[str, float], settings: RigidSettings | None = None) -> float:
    """Relative force error of given parameters on a record, in per cent."""
    settings = settings or RigidSettings()
    force, matrix = rigid_regressors(record, settings)
    names = DIRECTIONAL if settings.directional else SYMMETRIC
    return relative_error_percent(force, matrix @ np.array([parameters[name] for name in names]))


def relative_error_percent(measured: Floats, predicted: Floats) -> float:
    """100 |y - yhat| / |y|."""
    return float(100.0 * np.linalg.norm(measured - predicted) / np.linalg.norm(measured))
