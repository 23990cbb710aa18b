"""A run to its record: identity, the balance that adds up, what the run covered, and what the balance leaves."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import __version__
from ..arrays import Floats
from ..evaluation.metrics import rms
from ..identification.dataset import DataError, Record, log_of, record_of_log
from ..identification.facts import DriveFacts
from ..identification.kinematics import DEFAULT_CUTOFF_HZ
from ..identification.ladder import SLOW_QUANTILE, WAVE_PERIODS, Waves, waves_in
from ..identification.rows import RegressionRows, RegressionStretch, delay_between, rows_at, stretches_of
from ..recording.events import Level
from ..recording.reader import Run
from ..recording.table import LogTable
from ..signals import TEMPERATURE
from ..workflows.recorded_facts import facts_in
from .backlash import GAP_REV, GAP_UPPER, GapSums, gap_of, gap_sums
from .regress import PARAMETERS, RUNGS, Balance, Estimates, balance_columns, balance_of, explained_by, packed, solve
from .schema import ANGLE_BINS, BAND_EDGES_HZ, HIGHEST_ORDER, LOAD_QUANTILES, SCHEMA_VERSION, SPEED_EDGES_RPS

LEAST_ROWS = 40  # of sure sliding
TOOL = f"fffo-drive {__version__}"


def measured(path: Path, digest: str, facts: DriveFacts | None) -> dict[str, Any]:
    """The record of a run's file, without what the index says of it. `facts`: None where the recording carries them.

    Raises RecordingError (DataError too), DocumentError for a file that makes no record, OSError.
    """
    if facts is None:
        log: Run | LogTable = log_of(path, DriveFacts(torque_constant_nm_per_a=1.0))
        if not isinstance(log, Run):
            raise DataError(f"{path}: a table carries no facts about its drive: add it with --drive FILE")
        facts = facts_in(log)
    else:
        log = log_of(path, facts)
    record = record_of_log(path, log, facts, digest)
    stretches, rows, delay_s = _rows_of(record)
    columns = balance_columns(rows, facts)
    balance = balance_of(columns, rows)
    estimates = solve(balance)
    residual_nm = np.where(rows.sliding, rows.torque_nm - columns @ estimates.theta, 0.0)
    return {
        "run": digest, "schema_version": SCHEMA_VERSION, "tool": TOOL,
        "duration_s": record.duration_s, "rate_hz": 1.0 / record.period_s, "units": facts.units,
        **_balance(balance, estimates), "delay_s": delay_s,
        **_gap(gap_sums(record, facts, estimates, delay_s), facts.units),
        **_left(rows, residual_nm, balance, facts),
        **_covered(stretches),
        **_temperature(log), **_ticks(log),
    }  # fmt: skip


def _rows_of(record: Record) -> tuple[list[RegressionStretch], RegressionRows, float]:
    """What the balance of a run stands on, and the delay (s) of its torque. Raises DataError."""
    cutoff_hz = min(DEFAULT_CUTOFF_HZ, 0.1 / record.period_s)
    stretches, _ = stretches_of([record], cutoff_hz)
    sliding = sum(int(np.count_nonzero(stretch.sliding[stretch.rows])) for stretch in stretches)
    if sliding < LEAST_ROWS:
        raise DataError(
            f"{record.path}: {sliding} rows of sure sliding motion, {LEAST_ROWS} are needed: hardly anything moves"
        )
    delay_s = delay_between(stretches, cutoff_hz)
    return stretches, rows_at(stretches, cutoff_hz, delay_s), delay_s


def balance_of_record(record: Record, facts: DriveFacts) -> Balance:
    """The balance that the record of a run holds. Raises DataError for one that hardly moves."""
    _, rows, _ = _rows_of(record)
    return balance_of(balance_columns(rows, facts), rows)


def temperature_of(columns: Mapping[str, Any]) -> float | None:
    """Mean temperature (degC) of a run by its columns; None where it was not logged."""
    values = _temperatures_degc(columns)
    return float(values.mean()) if values.size else None


def _temperatures_degc(columns: Mapping[str, Any]) -> Floats:
    """Those that were logged. (n,)"""
    values = np.asarray(columns.get(TEMPERATURE.name, []), dtype=np.float64)
    return values[np.isfinite(values)]


def _balance(balance: Balance, estimates: Estimates) -> dict[str, Any]:
    known = np.isfinite(estimates.sd)
    pairs = list(zip(PARAMETERS, estimates.theta.tolist(), estimates.sd.tolist(), known.tolist(), strict=True))
    return {
        "normal": packed(balance.normal), "moment": balance.moment, "energy_nm2": balance.energy_nm2,
        "rows": balance.rows, "effective_rows": balance.effective_rows,
        **{name: value if sure else None for name, value, _, sure in pairs},
        **{f"{name}_sd": sd if sure else None for name, _, sd, sure in pairs},
        "torque_rms_nm": float(np.sqrt(balance.energy_nm2 / balance.rows)), "rms_nm": float(estimates.rms_nm),
    }  # fmt: skip


def _gap(sums: GapSums | None, units: str) -> dict[str, Any]:
    """Sums of the gap; those of a run that says nothing of it are 0."""
    sums = sums or GapSums(np.zeros((GAP_REV.size, GAP_REV.size)), np.zeros(GAP_REV.size), 0.0, 0.0, 0.0)
    found = gap_of(sums, units)
    views = {"gap_rev": found.gap_rev, "gap_log_sd": found.log_sd, "gap_share": found.share}
    return {
        "gap_normal": sums.normal[GAP_UPPER], "gap_moment": sums.moment, "gap_energy_nm2": sums.energy_nm2,
        "gap_rows": sums.rows, "gap_effective_rows": sums.effective_rows,
        **{name: float(value) if np.isfinite(value) else None for name, value in views.items()},
    }  # fmt: skip


def _left(rows: RegressionRows, residual_nm: Floats, balance: Balance, facts: DriveFacts) -> dict[str, Any]:
    """Rungs of the ladder, orders of the angle and bands of frequency in the residual (m,), 0 where nothing counts."""
    energy = float(residual_nm @ residual_nm)
    waves = waves_in(rows, residual_nm, rows.sliding.astype(np.float64), HIGHEST_ORDER)
    resolved = _resolved(rows) if facts.units == "rotary" else np.zeros(HIGHEST_ORDER, dtype=np.bool_)
    share = np.where(resolved, waves.explained[0] / energy, 0.0) if energy > 0.0 else np.zeros(HIGHEST_ORDER)
    return {
        **{f"{rung}_share": explained_by(balance, columns) for rung, columns in RUNGS.items()},
        "wave_share": float(share.max()),
        "wave_order": int(np.argmax(share)) + 1 if resolved.any() else None,
        "order_amplitude_nm": _amplitudes(waves, resolved),
        "band_rms_nm": _bands(rows, residual_nm),
    }


def _amplitudes(waves: Waves, resolved: npt.NDArray[np.bool_]) -> Floats:
    return np.asarray(np.where(resolved, np.abs(waves.amplitude[0]), np.nan))


def _resolved(rows: RegressionRows) -> npt.NDArray[np.bool_]:
    """Orders that the motion passes often enough, and slowly enough for the filter. (HIGHEST_ORDER,)"""
    order = np.arange(1, HIGHEST_ORDER + 1)
    slow_rps = float(np.quantile(np.abs(rows.velocity_rps[rows.sliding]), SLOW_QUANTILE))
    travel_rev = float(np.ptp(rows.position_rev[rows.sliding]))
    return np.asarray((order * slow_rps < rows.cutoff_hz) & (order * travel_rev >= WAVE_PERIODS))


def _bands(rows: RegressionRows, residual_nm: Floats) -> Floats:
    """rms of the residual in each band, of the rows that count; 0 above the filter."""
    power = np.zeros(BAND_EDGES_HZ.size - 1)
    for begin, end in rows.bounds:
        part = residual_nm[begin:end]
        density = np.abs(np.fft.rfft(part)) ** 2
        density[1 : -1 if part.size % 2 == 0 else None] *= 2.0
        frequency_hz = np.fft.rfftfreq(part.size, rows.period_s)
        power += np.histogram(frequency_hz, BAND_EDGES_HZ, weights=density / part.size)[0]
    return np.asarray(np.sqrt(power / np.count_nonzero(rows.sliding)))


def _covered(stretches: list[RegressionStretch]) -> dict[str, Any]:
    velocity_rps = np.concatenate([one.motion.velocity_rps for one in stretches])
    position_rev = np.concatenate([one.motion.position_rev for one in stretches])
    acceleration_rps2 = np.concatenate([one.motion.acceleration_rps2 for one in stretches])
    load_nm = np.abs(np.concatenate([one.torque_nm for one in stretches]))
    count = velocity_rps.size
    angle = np.mod(position_rev, 1.0)
    return {
        "speed_share": np.histogram(np.abs(velocity_rps), SPEED_EDGES_RPS)[0] / count,
        "speed_rms_rps": rms(velocity_rps),
        "acceleration_rms_rps2": rms(acceleration_rps2),
        "load_quantile_nm": np.quantile(load_nm, LOAD_QUANTILES),
        "angle_share": np.histogram(angle, ANGLE_BINS, (0.0, 1.0))[0] / count,
        "travel_rev": float(np.ptp(position_rev)),
    }


def _temperature(log: Run | LogTable) -> dict[str, Any]:
    values = _temperatures_degc(log.columns)
    if not values.size:
        return {}
    mean, low, high = float(values.mean()), float(values.min()), float(values.max())
    return {"temperature_degc": mean, "temperature_low_degc": low, "temperature_high_degc": high}


def _ticks(log: Run | LogTable) -> dict[str, Any]:
    """What the loop did, of a recording of our own."""
    if not isinstance(log, Run):
        return {}
    levels = np.array([event.level for event in log.events], dtype=np.int64)
    found: dict[str, Any] = {
        "complete": log.complete,
        "warnings": int(np.count_nonzero((levels >= Level.WARNING) & (levels < Level.ERROR))),
        "errors": int(np.count_nonzero(levels >= Level.ERROR)),
    }
    if not {"tick", "late", "velocity_age", "trip", "mode", "error_rps"} <= set(log.columns):
        return found
    tick, on = log.column("tick").astype(np.int64), log.column("mode") != 0
    return found | {
        "ticks": int(tick.size),
        "late": int(np.count_nonzero(log.column("late"))),
        "skipped": int(np.sum(np.diff(tick) - 1)) if tick.size else 0,
        "without_feedback": int(np.count_nonzero(log.column("velocity_age"))),
        "trip": int(log.column("trip")[-1]) if tick.size else 0,
        "speed_error_rms_rps": rms(log.column("error_rps")[on].astype(np.float64)) if on.any() else None,
    }
