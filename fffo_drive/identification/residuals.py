"""Residuals of a fitted model: in torque and in velocity, over time, frequency, speed and regime, and whether they
still depend on the motion.

Two residuals. Torque: Kt i(t - Td) - J a - F, everything through one zero-phase filter, F the model's friction along
the measured motion. Velocity: what free simulation over short windows is off by, from the position. Autocorrelation
alone says little about a grey-box model; dependence on functions of the motion does, counted with the effective number
of samples.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats, Mask
from ..model.effects.table import Term
from .coordinates import PARAMETERS, axis_of
from .dataset import Record
from .kinematics import DEFAULT_CUTOFF_HZ, acting_torque_nm, low_pass, motion_of, trusted
from .prediction import BANDWIDTH_PERIODS, observer, table_at
from .shooting import PATH_COLUMNS, follow, shoot

OBSERVER_HZ = 40.0
WINDOW_S = 0.2
BLOCK_S = 0.005
PRESLIDING_LENGTHS = 4.0  # presliding is over after this many 1/K of travel
LONGEST_LAG = 400
SETTLING_S = 0.1


class TorqueResidual(NamedTuple):
    """Torque residual of one record with the variables it may depend on; (n,) each. `kept`: without standstill and
    ends.
    """

    time_s: Floats
    residual_nm: Floats
    torque_nm: Floats
    friction_nm: Floats
    velocity_rps: Floats
    acceleration_rps2: Floats
    travel_rev: Floats
    kept: Mask


class RunResidual(NamedTuple):
    """Residuals of a model on one record: in torque along it, and in velocity over free windows."""

    record: Record
    torque: TorqueResidual
    velocity_errors_rps: Floats  # (windows, blocks)
    begins_s: Floats  # (windows,) their starts, on the clock of the log
    presliding_rev: float  # travel after a reversal up to which it is presliding

    @property
    def free_run_share(self) -> float:
        """Error of the velocity in free windows over the velocity, rms both; 0 where there is no window."""
        return _rms(self.velocity_errors_rps) / max(_rms(self.torque.velocity_rps[self.torque.kept]), 1e-300)

    @property
    def sliding(self) -> Mask:
        """Kept samples in sliding. (n,)"""
        return np.asarray(self.torque.kept & (self.torque.travel_rev > self.presliding_rev))

    @property
    def presliding(self) -> Mask:
        """Kept samples in presliding. (n,)"""
        return np.asarray(self.torque.kept & (self.torque.travel_rev <= self.presliding_rev))


class Dependence(NamedTuple):
    """Correlation of the residual with a function of the motion."""

    function: str
    correlation: float
    p_value: float  # two-sided, with the effective number of samples


def torque_residual(
    record: Record, physical: Floats, cutoff_hz: float = DEFAULT_CUTOFF_HZ, terms: Sequence[Term] = ()
) -> TorqueResidual:
    """Torque residual along a record, with the effects `terms` subtracted."""
    parts = [_torque_part(record, part, physical, cutoff_hz, terms) for part in record.segments()]
    return TorqueResidual(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _torque_part(
    record: Record, part: slice, physical: Floats, cutoff_hz: float, terms: Sequence[Term]
) -> TorqueResidual:
    axis, nuisance = axis_of(physical, record.torque_constant_nm_per_a)
    position = np.ascontiguousarray(record.position_rev[part])
    path = np.empty((position.size, PATH_COLUMNS))
    bandwidth_hz = min(OBSERVER_HZ, BANDWIDTH_PERIODS / record.period_s)
    shooting = observer(record.period_s, bandwidth_hz, 1)
    step_s = record.period_s / shooting.substeps
    table = table_at(terms, axis, step_s, part.start * shooting.substeps)
    follow(axis, table, shooting, nuisance, np.ascontiguousarray(record.current_a[part]), position, path)
    if terms:
        seen_rev = record.position_rev.copy()
        seen_rev[part] -= path[:, 6]
        record = replace(record, position_rev=seen_rev)
    motion = motion_of(record, part, cutoff_hz)
    torque = acting_torque_nm(record, part, axis.delay_s, cutoff_hz) - nuisance.offset_nm
    friction = low_pass(path[:, 2], cutoff_hz, record.period_s)
    residual = torque - axis.inertia_nm_s2_per_rev * motion.acceleration_rps2 - friction
    if terms:
        # an effect stands for the step that led to its sample
        load = 0.5 * (path[:, 5] + np.append(path[1:, 5], path[-1, 5]))
        residual = residual - low_pass(load, cutoff_hz, record.period_s)
    kept = (np.abs(motion.velocity_rps) > motion.speed_floor_rps) & trusted(record, part, cutoff_hz)
    edge = min(kept.size // 4, round(SETTLING_S / record.period_s))
    kept[:edge] = False
    kept[kept.size - edge :] = False
    time_s = record.begin_s + np.arange(part.start, part.stop) * record.period_s
    return TorqueResidual(
        time_s, residual, torque, friction, motion.velocity_rps, motion.acceleration_rps2, path[:, 3].copy(), kept
    )


def velocity_errors(
    record: Record, physical: Floats, window_s: float = WINDOW_S, terms: Sequence[Term] = ()
) -> tuple[Floats, Floats]:
    """Velocity error of free simulation, window after window: (windows, blocks) rps, and the windows' start times.

    Windows without motion are omitted. The initial state is that of the observer.
    """
    axis, nuisance = axis_of(physical, record.torque_constant_nm_per_a)
    period_s = record.period_s
    block = max(1, round(BLOCK_S / period_s))
    samples = max(4 * block, round(window_s / period_s) // block * block)
    bandwidth_hz = min(OBSERVER_HZ, BANDWIDTH_PERIODS / period_s)
    shooting = observer(period_s, bandwidth_hz, block)._replace(samples=samples)
    errors, begins = [], []
    for part in record.segments():
        starts = np.arange(round(SETTLING_S / period_s), part.stop - part.start - samples, samples, dtype=np.int64)
        if not starts.size:
            continue
        position = np.ascontiguousarray(record.position_rev[part])
        output = np.empty((starts.size, samples // block))
        first = part.start * shooting.substeps
        table, spare = (table_at(terms, axis, period_s / shooting.substeps, first) for _ in range(2))
        shoot(
            axis, table, spare, shooting, nuisance.offset_nm,
            np.ascontiguousarray(record.current_a[part]), position, starts, 0, output,
        )  # fmt: skip
        moved = np.array([np.ptp(position[k : k + samples]) > 5.0 * record.lsb_rev for k in starts])
        errors.append(np.diff(output, axis=1)[moved] / (block * period_s))
        begins.append(record.begin_s + (part.start + starts[moved]) * period_s)
    if not errors:
        return np.zeros((0, 1)), np.zeros(0)
    return np.concatenate(errors), np.concatenate(begins)


def effective_samples(values: Floats, longest_lag: int = LONGEST_LAG) -> tuple[float, Floats]:
    """N / (1 + 2 sum of autocorrelations up to their first zero), and the autocorrelation from lag 0 on."""
    n = values.size
    centred = values - values.mean()
    lags = min(longest_lag, n - 1)
    spectrum = np.fft.rfft(centred, 2 ** math.ceil(math.log2(2 * n)))
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[: lags + 1]
    if covariance[0] <= 0.0:
        return float(n), np.ones(1)
    correlation = covariance / covariance[0]
    negative = np.flatnonzero(correlation <= 0.0)
    last = int(negative[0]) if negative.size else correlation.size
    return float(n / (1.0 + 2.0 * correlation[1:last].sum())), np.asarray(correlation)


def whiteness(values: Floats) -> dict[str, float]:
    """Ljung-Box statistic over 20 lags with its p-value, lag-1 correlation, and the effective number of samples.

    Empty where nothing can be said: values that are all the same have no correlation.
    """
    if np.ptp(values) == 0.0:
        return {}
    count, correlation = effective_samples(values)
    n, lags = values.size, min(20, correlation.size - 1)
    k = np.arange(1, lags + 1)
    statistic = float(n * (n + 2) * np.sum(correlation[1 : lags + 1] ** 2 / (n - k)))
    return {
        "samples": float(n),
        "effective_samples": count,
        "lag_1": float(correlation[1]) if correlation.size > 1 else 0.0,
        "ljung_box": statistic,
        "p_value": float(scipy.stats.chi2.sf(statistic, lags)),
    }


def dependences(found: TorqueResidual, step: int) -> list[Dependence]:
    """Is the residual still a function of the motion? Odd and even functions of velocity, acceleration and torque."""
    rows = np.flatnonzero(found.kept)[::step]
    r, v, a, u = (x[rows] for x in (found.residual_nm, found.velocity_rps, found.acceleration_rps2, found.torque_nm))
    if rows.size < 50:
        return []
    functions = {
        "1": np.ones_like(r), "sign(v)": np.sign(v), "v": v, "|v|": np.abs(v), "v|v|": v * np.abs(v), "a": a,
        "|a|": np.abs(a), "|u|": np.abs(u), "sign(v)|u|": np.sign(v) * np.abs(u), "u^3": u * u * u,
    }  # fmt: skip
    result = []
    for name, values in functions.items():
        centred_r, centred = (r, values) if name == "1" else (r - r.mean(), values - values.mean())
        scale = float(np.linalg.norm(centred_r) * np.linalg.norm(centred))
        if scale == 0.0:
            continue
        correlation = float(centred_r @ centred) / scale
        # the product, not the residual, determines the effective number of samples
        count, _ = effective_samples(centred_r * centred)
        t = correlation * math.sqrt(max(1.0, count - 2.0) / max(1e-12, 1.0 - correlation * correlation))
        result.append(Dependence(name, correlation, float(2.0 * scipy.stats.t.sf(abs(t), max(1.0, count - 2.0)))))
    return result


def run_residuals(
    records: Sequence[Record],
    physical: Floats,
    terms: Sequence[Sequence[Term]] | None = None,
    cutoff_hz: float = DEFAULT_CUTOFF_HZ,
) -> list[RunResidual]:
    """Residuals of every record at the same parameters; `terms`: the effects as they act in each, (records,).

    `cutoff_hz`: of the torque.
    """
    acting = terms if terms is not None else [()] * len(records)
    presliding_rev = PRESLIDING_LENGTHS / float(physical[PARAMETERS.index("stiffness_per_rev")])
    return [
        RunResidual(
            record,
            torque_residual(record, physical, cutoff_hz, own),
            *velocity_errors(record, physical, terms=own),
            presliding_rev,
        )
        for record, own in zip(records, acting, strict=True)
    ]


def residual_summary(runs: Sequence[RunResidual]) -> dict[str, dict[str, Any]]:
    """Everything of this page as plain numbers, by the record's name: histogram, tests, errors by axis."""
    return {run.record.name: _summary(run) for run in runs}


def sampling_step(period_s: float) -> int:
    """Decimation of the filtered residual without loss of information: four times its cut-off."""
    return max(1, int(0.25 / (DEFAULT_CUTOFF_HZ * period_s)))


def _summary(run: RunResidual) -> dict[str, Any]:
    found, errors = run.torque, run.velocity_errors_rps
    step = sampling_step(run.record.period_s)
    r = found.residual_nm[found.kept]
    forward = found.velocity_rps > 0.0
    shaped = r.size > 10 and np.ptp(r) > 0.0
    return {
        "torque_rms_nm": _rms(r),
        "torque_relative_percent": 100.0 * _rms(r) / max(1e-300, _rms(found.torque_nm[found.kept])),
        "friction_relative_percent": 100.0 * _rms(r) / max(1e-300, _rms(found.friction_nm[found.kept])),
        "velocity_rms_rps": _rms(errors),
        "velocity_median_rps": _median_window(errors),
        "velocity_window_s": WINDOW_S,
        "windows": int(errors.shape[0]),
        "histogram": _histogram(r),
        "skewness": float(scipy.stats.skew(r)) if shaped else 0.0,
        "excess_kurtosis": float(scipy.stats.kurtosis(r)) if shaped else 0.0,
        "whiteness": whiteness(r[::step]) if r.size > 50 * step else {},
        "dependence": [d._asdict() for d in dependences(found, step)],
        "by_regime": {
            "sliding": _rms(found.residual_nm[run.sliding]),
            "presliding": _rms(found.residual_nm[run.presliding]),
            "forward_mean_nm": _mean(found.residual_nm[run.sliding & forward]),
            "backward_mean_nm": _mean(found.residual_nm[run.sliding & ~forward]),
        },
        "by_speed": _by_speed(run),
        "by_frequency": _by_frequency(found, run.record.period_s),
    }


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values * values))) if values.size else 0.0


def _median_window(errors: Floats) -> float:
    """Typical error of a window (median): where the Stribeck curve falls, a free run is unstable and a few windows
    diverge.
    """
    return float(np.median(np.sqrt(np.mean(errors * errors, axis=1)))) if errors.size else 0.0


def _mean(values: Floats) -> float:
    return float(values.mean()) if values.size else 0.0


def _histogram(values: Floats) -> dict[str, list[float]]:
    limit = float(np.quantile(np.abs(values), 0.999)) if values.size else 1.0
    counts, edges = np.histogram(values, bins=61, range=(-max(limit, 1e-12), max(limit, 1e-12)))
    return {"edges": edges.tolist(), "counts": counts.tolist()}


def _by_speed(run: RunResidual) -> list[dict[str, float]]:
    found = run.torque
    speed = np.abs(found.velocity_rps)
    moving = speed[found.kept]
    if moving.size < 100:
        return []
    edges = np.geomspace(max(float(moving.min()), 1e-4 * float(moving.max())), float(moving.max()) * 1.0001, 9)
    rows = []
    for low, high in itertools.pairwise(edges):
        inside = found.kept & (speed >= low) & (speed < high)
        rows.append({"low_rps": float(low), "high_rps": float(high), "rms_nm": _rms(found.residual_nm[inside]),
                     "sliding_rms_nm": _rms(found.residual_nm[inside & run.sliding]),
                     "presliding_rms_nm": _rms(found.residual_nm[inside & run.presliding]),
                     "share": float(inside.sum() / max(1, found.kept.sum()))})  # fmt: skip
    return rows


def _by_frequency(found: TorqueResidual, period_s: float) -> list[dict[str, float]]:
    length = min(found.residual_nm.size, 2 ** round(math.log2(8.0 / period_s)))
    residual = np.where(found.kept, found.residual_nm, 0.0)
    frequency, density = scipy.signal.welch(residual, 1.0 / period_s, nperseg=length)
    _, torque = scipy.signal.welch(found.torque_nm, 1.0 / period_s, nperseg=length)
    rows = []
    for low in 0.125 * 2.0 ** np.arange(9):
        inside = (frequency >= low) & (frequency < 2.0 * low)
        if inside.any():
            width = float(frequency[1] - frequency[0])
            rows.append({"low_hz": float(low), "high_hz": float(2.0 * low),
                         "rms_nm": math.sqrt(float(density[inside].sum()) * width),
                         "torque_rms_nm": math.sqrt(float(torque[inside].sum()) * width)})  # fmt: skip
    return rows
