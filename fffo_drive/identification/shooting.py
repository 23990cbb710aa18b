"""The axis simulated along a measured position: one step ahead for the fit, over free windows to judge it.

An observer follows the measured position with two small corrections a sample, so that velocity, friction torque and
travel since the reversal are at any instant those of a motion that agrees with the record, through a standstill too.
The fit minimises the prediction error of the observer. Longer free runs are not used: where the Stribeck curve falls
the axis is unstable, and after 0.2 s any small error has grown a hundredfold. Free windows, started from the observer's
state, serve to judge a model.

Position and command are used because the drive's own velocity is filtered and late, and the measured current is noisy;
the position has no lag to first order, and the command is known exactly, in closed loop too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ..arrays import Floats, Integers
from ..jit import njit
from ..model.axis import AxisConfig, AxisState, axis_step, mean_held_command
from ..model.effects import slots
from ..model.effects.step import loaded_step
from ..model.effects.table import EffectTable
from ..model.friction import FrictionState

PATH_COLUMNS = 7  # of `follow`


class ShootingConfig(NamedTuple):
    """Parameters of the shooting. Gains of the observer are per sample."""

    period_s: float
    substeps: int
    samples: int  # of a free run
    block: int  # samples that are averaged into one residual
    position_gain: float
    velocity_gain_per_s: float


class Nuisance(NamedTuple):
    """Nuisance parameters, fitted because omitting them would bias the model."""

    offset_nm: float  # opposes the motor's torque
    sensor_lag_s2: float  # the measured position is low by this times the acceleration: second order of all lags


@njit
def _advance(
    config: AxisConfig, table: EffectTable | None, state: AxisState, offset_nm: float, current_a: Floats, sample: int,
    delay: float, period_s: float, substeps: int,
) -> AxisState:  # fmt: skip
    step_s = period_s / substeps
    for j in range(substeps):
        begin = sample + j / substeps - delay
        mean_a = mean_held_command(current_a, begin, begin + 1.0 / substeps)
        if table is not None:
            state = loaded_step(config, table, state, mean_a, offset_nm)
        else:
            state = axis_step(config, state, config.torque_constant_nm_per_a * mean_a - offset_nm, step_s)
    return state


@njit
def _copy_effects(table: EffectTable, spare: EffectTable) -> None:
    """Memory and signals of a table into another one of the same effects."""
    for k in range(table.memory.shape[0]):
        for j in range(table.memory.shape[1]):
            spare.memory[k, j] = table.memory[k, j]
    for j in range(table.signals.size):
        spare.signals[j] = table.signals[j]


@njit
def innovations(
    config: AxisConfig, table: EffectTable | None, shooting: ShootingConfig, nuisance: Nuisance, current_a: Floats,
    position_rev: Floats, first: int, output: Any,
) -> None:  # fmt: skip
    """Prediction error of the observer, measured minus predicted position (rev), from sample `first` on.

    `table`: effects at rest, with the step of a sub-step, or None (they are not compiled in). `output` (blocks,):
    means over blocks of `shooting.block` samples, all of them inside the record.
    """
    state = AxisState(0.0, position_rev[first], FrictionState(0.0, 0.0, 0.0, 0.0))
    delay = config.delay_s / shooting.period_s
    sample = first
    lag_per_rps_rev = nuisance.sensor_lag_s2 / shooting.period_s
    short_rev = 0.0
    for block in range(output.size):
        total = 0.0
        for _ in range(shooting.block):
            error_rev = position_rev[sample] - (state.position_rev - short_rev)
            if table is not None:
                error_rev -= table.signals[slots.SENSOR_REV]
            total += error_rev
            state = AxisState(
                state.velocity_rps + shooting.velocity_gain_per_s * error_rev,
                state.position_rev + shooting.position_gain * error_rev,
                state.friction,
            )
            before_rps = state.velocity_rps
            state = _advance(
                config, table, state, nuisance.offset_nm, current_a, sample, delay, shooting.period_s,
                shooting.substeps,
            )  # fmt: skip
            short_rev = lag_per_rps_rev * (state.velocity_rps - before_rps)
            sample += 1
        output[block] = total / shooting.block


@njit
def follow(
    config: AxisConfig, table: EffectTable | None, shooting: ShootingConfig, nuisance: Nuisance, current_a: Floats,
    position_rev: Floats, output: Any,
) -> None:  # fmt: skip
    """The observer along a record. `output` (n, 7): innovation rev, velocity rps, friction Nm, travel rev, direction,
    torque of the effects Nm, error of the sensor rev.

    Friction is signed against the motion and is the model's, so a residual in torque can be made from it; so are the
    effects' torque and the sensor's error, which are those of the step that led here.
    """
    state = AxisState(0.0, position_rev[0], FrictionState(0.0, 0.0, 0.0, 0.0))
    delay = config.delay_s / shooting.period_s
    lag_per_rps_rev = nuisance.sensor_lag_s2 / shooting.period_s
    short_rev = 0.0
    load_nm = 0.0
    sensor_rev = 0.0
    for sample in range(current_a.size):
        if table is not None:
            load_nm = table.signals[slots.LOAD_NM]
            sensor_rev = table.signals[slots.SENSOR_REV]
        error_rev = position_rev[sample] - (state.position_rev - short_rev) - sensor_rev
        state = AxisState(
            state.velocity_rps + shooting.velocity_gain_per_s * error_rev,
            state.position_rev + shooting.position_gain * error_rev,
            state.friction,
        )
        output[sample, 0] = error_rev
        output[sample, 1] = state.velocity_rps
        output[sample, 2] = state.friction.torque_nm
        output[sample, 3] = state.friction.travel_rev
        output[sample, 4] = state.friction.direction
        output[sample, 5] = load_nm
        output[sample, 6] = sensor_rev
        state = _advance(
            config, table, state, nuisance.offset_nm, current_a, sample, delay, shooting.period_s, shooting.substeps
        )
        short_rev = lag_per_rps_rev * (state.velocity_rps - output[sample, 1])


@njit
def _free_run(
    config: AxisConfig, table: EffectTable | None, shooting: ShootingConfig, state: AxisState, offset_nm: float,
    current_a: Floats, position_rev: Floats, start: int, output: Any,
) -> None:  # fmt: skip
    delay = config.delay_s / shooting.period_s
    sample = start
    for block in range(shooting.samples // shooting.block):
        total = 0.0
        for _ in range(shooting.block):
            total += position_rev[sample] - state.position_rev
            if table is not None:
                total -= table.signals[slots.SENSOR_REV]
            state = _advance(
                config, table, state, offset_nm, current_a, sample, delay, shooting.period_s, shooting.substeps
            )
            sample += 1
        output[block] = total / shooting.block


@njit
def shoot(
    config: AxisConfig, table: EffectTable | None, spare: EffectTable | None, shooting: ShootingConfig,
    offset_nm: float, current_a: Floats, position_rev: Floats, starts: Integers, first: int, output: Any,
) -> None:  # fmt: skip
    """Residuals (measured minus simulated position, rev) of all windows of a record, from sample `first` on.

    `table` follows the record, and `spare` (another table of the same effects) goes into the windows.
    `starts` (w,) first samples of the windows, rising; `output` (w, blocks). `offset_nm` opposes the motor's torque.
    """
    state = AxisState(0.0, position_rev[first], FrictionState(0.0, 0.0, 0.0, 0.0))
    delay = config.delay_s / shooting.period_s
    sample = first
    for window in range(starts.size):
        while True:
            error_rev = position_rev[sample] - state.position_rev
            if table is not None:
                error_rev -= table.signals[slots.SENSOR_REV]
            state = AxisState(
                state.velocity_rps + shooting.velocity_gain_per_s * error_rev,
                state.position_rev + shooting.position_gain * error_rev,
                state.friction,
            )
            if sample >= starts[window]:
                break
            state = _advance(
                config, table, state, offset_nm, current_a, sample, delay, shooting.period_s, shooting.substeps
            )
            sample += 1
        if table is not None and spare is not None:
            _copy_effects(table, spare)
        _free_run(config, spare, shooting, state, offset_nm, current_a, position_rev, starts[window], output[window])
        state = _advance(
            config, table, state, offset_nm, current_a, sample, delay, shooting.period_s, shooting.substeps
        )
        sample += 1
