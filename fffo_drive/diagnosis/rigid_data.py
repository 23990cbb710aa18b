"""Force balance of a rigid axis: rows of force, base regressors and effect regressors, all filtered alike.

    u = M a + Fv v + Fc sgn(v) + c + E

The rows are those of the published EMPS benchmark (identification/rigid.py): low-passed position, central differences,
the first samples dropped, force and regressors decimated by one filter without phase. Effects come from the kernels of
model/effects, run along the filtered motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import signal

from ..identification.dataset import Record
from ..identification.kinematics import central_difference, low_pass
from ..identification.ranking import first_best
from ..identification.rigid import RigidSettings, rigid_regressors
from ..model.axis import AxisConfig
from ..model.effects import slots as s
from ..model.effects.table import regressors
from ..model.friction import OMEGA_CLIPPED, FrictionConfig

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

SETTINGS = RigidSettings(hold=True)
BASE = ("inertia", "viscous", "coulomb", "offset")
REST_OF_TOP_SPEED = 0.002  # below this share of the highest speed the axis counts as resting
PRESLIDING_SHARE = 2e-4  # of the travel: where nothing is known of presliding, a contact that is stiff
WINDOW_S = 0.25
REPEATS = 0.9  # correlation from which a motion counts as repeated


@dataclass(frozen=True)
class RigidRun:
    """One record as rows, (m,) each, at the decimated rate, with the full-rate motion behind them."""

    record: Record
    force: Floats
    base: Floats  # (m, 4) in the order of BASE
    motion: Floats  # (n, slots.N_MOTION)
    axis: AxisConfig  # what the effects' kernels are told of the axis
    time_s: Floats
    position: Floats
    velocity: Floats
    acceleration: Floats
    travel: Floats
    window: Integers  # which piece of the motion a row belongs to; a repeated piece has one number

    @property
    def row_period_s(self) -> float:
        """Seconds between rows."""
        return self.record.period_s * SETTINGS.decimation


def rigid_run(record: Record, axis: AxisConfig | None = None) -> RigidRun:
    """Rows of a record. `axis` from another record: its effects then mean the same here."""
    force, base = rigid_regressors(record, SETTINGS)
    period_s = record.period_s
    position = low_pass(record.position_rev, SETTINGS.cutoff_hz, period_s, 4)
    velocity = central_difference(position, period_s)
    acceleration = central_difference(velocity, period_s)
    if axis is None:
        values = np.asarray(np.linalg.lstsq(base, force, rcond=None)[0], dtype=np.float64)
        axis = _axis(values, record, float(np.ptp(position)))
    motion = np.zeros((record.samples, s.N_MOTION))
    direction = np.sign(velocity)
    travel = _travel(position, direction)
    motion[:, s.TIME_S] = np.arange(record.samples) * period_s
    motion[:, s.VELOCITY_RPS] = velocity
    motion[:, s.ACCELERATION_RPS2] = acceleration
    motion[:, s.MOTOR_ANGLE_REV] = motion[:, s.SENSOR_ANGLE_REV] = position
    friction = axis.friction
    motion[:, s.FRICTION_NM] = friction.coulomb_nm * direction + friction.viscous_nm_per_rps * velocity
    # the force of the base and not the measured one: that has the residual in it, which would then explain itself
    driving = axis.inertia_nm_s2_per_rev * acceleration + motion[:, s.FRICTION_NM]
    motion[:, s.CURRENT_A] = driving / axis.torque_constant_nm_per_a
    motion[:, s.TRAVEL_REV] = travel
    motion[:, s.DIRECTION] = direction
    picked = slice(SETTINGS.dropped, None, SETTINGS.decimation)
    return RigidRun(
        record=record,
        force=force,
        base=base,
        motion=motion,
        axis=axis,
        time_s=motion[picked, s.TIME_S].copy(),
        position=position[picked],
        velocity=velocity[picked],
        acceleration=acceleration[picked],
        travel=travel[picked],
        window=_windows(velocity[picked], period_s * SETTINGS.decimation),
    )


def _axis(base: Floats, record: Record, reach: float) -> AxisConfig:
    """The rigid base as the kernels know an axis: a stiff contact, no rise at low speed."""
    inertia, viscous, coulomb = (float(x) for x in base[:3])
    stiffness = 1.0 / (PRESLIDING_SHARE * reach)
    friction = FrictionConfig(coulomb, coulomb, reach, 1.0, viscous, stiffness, coulomb * stiffness, OMEGA_CLIPPED)
    return AxisConfig(inertia, record.torque_constant_nm_per_a, 0.0, friction)


def _travel(position: Floats, direction: Floats) -> Floats:
    turned = np.flatnonzero(np.diff(direction) != 0.0) + 1
    starts = np.concatenate([[0], turned])
    index = np.searchsorted(starts, np.arange(position.size), side="right") - 1
    return np.asarray(np.abs(position - position[starts[index]]))


def decimated(columns: Floats) -> Floats:
    """Rows of full-rate columns (n, k), through the filter of the force. (m, k)"""
    kept = columns[SETTINGS.dropped :]
    return np.asarray(signal.decimate(kept, SETTINGS.decimation, ftype="iir", zero_phase=True, axis=0))


def effect_columns(run: RigidRun, name: str, shape: Mapping[str, float]) -> tuple[tuple[str, ...], Floats]:
    """Force of an effect per unit of each of its strengths: (names (k,), columns (m, k))."""
    facts = s.AxisFacts(REST_OF_TOP_SPEED * float(np.abs(run.velocity).max()))
    period_s = run.record.period_s
    names, load, sensor = regressors(name, shape, run.motion, run.axis, period_s, facts)
    if np.any(sensor):  # what the sensor says too much, is seen as motion
        rate = np.gradient(sensor, period_s, axis=0)
        load = load - run.axis.friction.viscous_nm_per_rps * rate
        load = load - run.axis.inertia_nm_s2_per_rev * np.gradient(rate, period_s, axis=0)
    return names, decimated(load)


def longest_rest_s(run: RigidRun) -> float:
    """The longest time without motion."""
    moving = np.flatnonzero(np.abs(run.velocity) > REST_OF_TOP_SPEED * np.abs(run.velocity).max())
    if not moving.size:
        return run.velocity.size * run.row_period_s
    edges = np.concatenate([[-1], moving, [run.velocity.size]])
    return float((np.diff(edges).max() - 1) * run.row_period_s)


def cycle_rows(velocity: Floats) -> int | None:
    """Length of a motion that repeats, in rows; None where it does not."""
    centred = velocity - velocity.mean()
    size = 1 << (2 * centred.size - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    correlation = np.fft.irfft(spectrum)[: centred.size // 2]
    overlap = np.arange(centred.size, centred.size - correlation.size, -1) / centred.size
    correlation = correlation / (correlation[0] * overlap)
    below = np.flatnonzero(correlation < 0.0)
    if not below.size:
        return None
    # a motion that repeats is like itself after two cycles as well: the first of equal peaks is the cycle
    peaks = int(below[0]) + signal.argrelmax(correlation[below[0] :])[0]
    if not peaks.size:
        return None
    later = first_best(peaks.tolist(), key=lambda lag: -correlation[lag])
    return later if correlation[later] > REPEATS else None


def _windows(velocity: Floats, period_s: float) -> Integers:
    """Pieces of about a quarter of a second. Repeats of a piece share a number: their errors are not independent."""
    rows = np.arange(velocity.size)
    cycle = cycle_rows(velocity)
    piece = max(1, round(WINDOW_S / period_s))
    if cycle is None:
        return np.asarray(rows // piece)
    return np.asarray((rows % cycle) * max(1, round(cycle / piece)) // cycle)
