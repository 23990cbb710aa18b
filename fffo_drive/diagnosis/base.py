"""The base model in torque: its residual at the rows, and the sensitivity of that to each base parameter.

r = Kt u(t - Td) - J a - F(2SEP along the measured path) - sensor lag

Friction is evaluated along the measured path and not along an observer's path. An observer without the missing effect
compensates for it with a wrong velocity, and near the Stribeck speed a wrong velocity gives a wrong friction.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Container, Sequence
from threading import Lock
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..identification.coordinates import LOGARITHMIC, MODEL_PARAMETERS, PARAMETERS, axis_of
from ..identification.kinematics import low_pass
from ..identification.population import FROM_POPULATION, AgainstPopulation
from ..identification.threads import in_threads
from ..model.axis import AxisConfig
from ..model.friction import FrictionConfig
from .kernels import friction_along
from .rows import DiagnosisRows, DiagnosisStretch, second_difference

BASE = (*MODEL_PARAMETERS, "sensor_lag_s2")  # refitted with every effect; a torque offset is an effect
RIGID = ("inertia_nm_s2_per_rev", "delay_s", "viscous_nm_per_rps", "coulomb_nm")  # parameters of a rigid base
NAMES = PARAMETERS
# Prior standard deviation of each parameter about its start value: of the logarithm for positive parameters,
# in s and s2 for the others.
PRIOR_SD = {"delay_s": 0.003, "stribeck_exponent": 1.0, "sensor_lag_s2": 1e-4}
PRIOR_LOG_SD = 2.0
RELATIVE_STEP = 0.005  # step of the numeric derivatives, in the logarithm of a positive parameter
EXPONENT_STEP = 0.005
BALANCE_HZ = 30.0


class BasePrior(NamedTuple):
    """What is known of the base model beside the runs: a normal distribution in the coordinates of BASE."""

    centre: Floats  # (len(NAMES),) physical
    precision: Floats  # (len(BASE), len(BASE)), for rows that are independent
    effective_rows: float = 0.0  # independent rows of the runs; 0: as many as there are

    def weighed(self, rows: int) -> Floats:
        """The precision beside so many rows: where these repeat each other, it counts as if it did likewise."""
        return self.precision if self.effective_rows == 0.0 else self.precision * max(1.0, rows / self.effective_rows)


class Along(NamedTuple):
    """The base model along one stretch."""

    torque_nm: Floats  # (n,) Kt times the delayed command, at the record's rate
    friction_nm: Floats  # (l,) at the laws' rate
    travel_rev: Floats  # (l,)
    direction: Floats  # (l,)


def delayed(values: Floats, delay_samples: float) -> Floats:
    """A held, sampled command as it acts `delay_samples` late, averaged over the period around each sample. (n,)

    The mean from -1/2 to +1/2 sample around k - d: parts of three held values.
    """
    begin = -0.5 - delay_samples
    first = int(np.floor(begin))
    share = 1.0 - (begin - first)  # weight of the first held value
    padded = np.concatenate([np.zeros(max(0, -first) + 1), values, np.full(2, values[-1])])
    offset = max(0, -first) + 1 + first
    n = values.size
    return np.asarray(share * padded[offset : offset + n] + (1.0 - share) * padded[offset + 1 : offset + 1 + n])


def along(stretch: DiagnosisStretch, physical: Floats) -> Along:
    """The base model along a stretch."""
    axis, _ = axis_of(physical, stretch.torque_constant_nm_per_a)
    return Along(_torque(stretch, physical), *_friction_path(stretch, axis))


def models_along(stretches: Sequence[DiagnosisStretch], physical: Floats) -> list[Along]:
    """The base model along every stretch."""
    return [along(stretch, physical) for stretch in stretches]


def residual_rows(
    stretches: Sequence[DiagnosisStretch], physical: Floats, rows: DiagnosisRows, models: Sequence[Along] | None = None
) -> Floats:
    """Torque residual of the base model at all rows. (m,)"""
    models = models if models is not None else models_along(stretches, physical)
    joined = np.concatenate([rows.filter.rows(m.torque_nm) - rows.laws.rows(m.friction_nm) for m in models])
    lag = _value(physical, "sensor_lag_s2")
    inertia = _value(physical, "inertia_nm_s2_per_rev")
    return np.asarray(joined - inertia * (rows.acceleration_rps2 + lag * snap_rows(rows)))


def wide_prior(start: Floats) -> BasePrior:
    """Nothing is known: a wide prior around the start, for what the data do not determine."""
    return BasePrior(start, np.diag([PRIOR_SD.get(name, PRIOR_LOG_SD) ** -2.0 for name in BASE]))


def population_prior(against: AgainstPopulation | None, start: Floats) -> BasePrior:
    """What the population says of inertia, viscous and Coulomb friction, the rest wide; all wide for no population, and
    for a drive that is not of it."""
    wide = wide_prior(start)
    if against is None or against.other_population:
        return wide
    known = [(k, row) for k, row in enumerate(against.rows) if row.name in FROM_POPULATION and row.prior > 0.0]
    if not known:
        return wide
    centre, precision = start.copy(), wide.precision.copy()
    mean = np.array([row.prior for _, row in known])
    for value, (_, row) in zip(mean, known, strict=True):
        centre[NAMES.index(row.name)] = value
    kept = [k for k, _ in known]
    places = [BASE.index(row.name) for _, row in known]
    # of logarithms, for deviations that are small beside the values
    precision[np.ix_(places, places)] = np.linalg.inv(against.covariance[np.ix_(kept, kept)] / np.outer(mean, mean))
    return BasePrior(centre, precision, against.effective_rows)


def distance(physical: Floats, start: Floats) -> Floats:
    """Distance between two sets of parameters, in the coordinates of BASE. (len(BASE),)"""
    pairs = [(name, _value(physical, name), _value(start, name)) for name in BASE]
    return np.array([np.log(new / old) if name in LOGARITHMIC else new - old for name, new, old in pairs])


def snap_rows(rows: DiagnosisRows) -> Floats:
    """Second derivative of the acceleration at the rows, stretch by stretch. (m,)"""
    found = np.zeros(rows.time_s.size)
    for begin, end in rows.bounds:
        found[begin:end] = second_difference(rows.acceleration_rps2[begin:end], rows.filter.row_period_s)
    return found


def _value(physical: Floats, name: str) -> float:
    return float(physical[NAMES.index(name)])


def moved(physical: Floats, name: str, step: float) -> Floats:
    """Parameters with one coordinate moved: a positive one by its logarithm, any other by its value."""
    changed = physical.copy()
    k = NAMES.index(name)
    changed[k] = physical[k] * np.exp(step) if name in LOGARITHMIC else physical[k] + step
    return changed


def step_of(name: str, period_s: float) -> float:
    """Size of a numeric step, in the coordinate that `moved` uses."""
    sizes = {"delay_s": 0.1 * period_s, "stribeck_exponent": EXPONENT_STEP, "sensor_lag_s2": period_s * period_s}
    return sizes.get(name, RELATIVE_STEP)


def sensitivities(
    stretches: Sequence[DiagnosisStretch], physical: Floats, rows: DiagnosisRows, names: Container[str] = BASE
) -> Floats:
    """Derivative of the modelled torque (minus the residual's) by each coordinate of BASE at the rows; zero for those
    that are not in `names`. (m, len(BASE))
    """
    period_s = rows.filter.period_s
    friction = [_friction(stretch, physical) for stretch in stretches]
    matrix = np.zeros((rows.time_s.size, len(BASE)))

    def column(k: int) -> None:
        name = BASE[k]
        if name == "inertia_nm_s2_per_rev":
            matrix[:, k] = _value(physical, name) * rows.acceleration_rps2
        elif name == "sensor_lag_s2":
            matrix[:, k] = _value(physical, "inertia_nm_s2_per_rev") * snap_rows(rows)
        else:
            step = step_of(name, period_s)
            high = moved(physical, name, step)
            if name == "delay_s":
                # the modelled torque is subtracted in the residual, hence the sign
                parts = [rows.filter.rows(_torque(s, physical) - _torque(s, high)) for s in stretches]
            else:
                pairs = zip(stretches, friction, strict=True)
                parts = [rows.laws.rows(_friction(s, high) - before) for s, before in pairs]
            matrix[:, k] = np.concatenate(parts) / step

    list(in_threads(column, [k for k, name in enumerate(BASE) if name in names]))
    return matrix


def _torque(stretch: DiagnosisStretch, physical: Floats) -> Floats:
    delay_s = _value(physical, "delay_s")
    return np.asarray(stretch.torque_constant_nm_per_a * delayed(stretch.current_a, delay_s / stretch.period_s))


def _friction(stretch: DiagnosisStretch, physical: Floats) -> Floats:
    return np.asarray(_friction_path(stretch, axis_config(physical, stretch.torque_constant_nm_per_a))[0])


_PATHS: OrderedDict[tuple[int, FrictionConfig], tuple[DiagnosisStretch, Floats]] = OrderedDict()
# memory for recently computed friction paths: a fit often starts where another ended. Twice as much: 1 % less time
PATHS_KEPT_BYTES = 50_000_000
_KEEPING = Lock()


def _friction_path(stretch: DiagnosisStretch, axis: AxisConfig) -> Floats:
    """Torque in Nm, travel since reversal in rev, and direction along a stretch. (3, n), read-only."""
    key = (id(stretch), axis.friction)
    known = _PATHS.get(key)
    if known is not None and known[0] is stretch:
        return known[1]
    path = np.empty((stretch.samples, 3))
    friction_along(axis.friction, stretch.path_rev, stretch.rest, stretch.balance_nm, stretch.law_period_s, path)
    found = np.ascontiguousarray(path.T)
    with _KEEPING:
        _PATHS[key] = (stretch, found)
        for _ in range(len(_PATHS) - max(1, PATHS_KEPT_BYTES // found.nbytes)):
            _PATHS.popitem(last=False)
    return found


def balanced(stretches: Sequence[DiagnosisStretch], physical: Floats) -> list[DiagnosisStretch]:
    """The stretches with the torque that friction balances at rest, computed with these parameters."""
    found = []
    for stretch in stretches:
        axis, _ = axis_of(physical, stretch.torque_constant_nm_per_a)
        torque = _torque(stretch, physical)
        inertia = axis.inertia_nm_s2_per_rev * stretch.acceleration_rps2
        cutoff_hz = min(BALANCE_HZ, 0.2 / stretch.period_s)
        smooth = low_pass(torque, cutoff_hz, stretch.period_s)[:: stretch.thin]
        balance = smooth - low_pass(inertia, cutoff_hz, stretch.law_period_s)
        found.append(stretch._replace(balance_nm=np.ascontiguousarray(balance)))
    return found


def axis_config(physical: Floats, torque_constant_nm_per_a: float) -> AxisConfig:
    """Axis constants without the nuisance parameters."""
    return axis_of(physical, torque_constant_nm_per_a)[0]
