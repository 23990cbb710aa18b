"""What the estimated velocity is worth: closed forms, the filter itself, and which axes get a proposal."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import fffo_drive as fd
from fffo_drive.commissioning.record import NoiseRecord
from fffo_drive.config.axis import loop_axis
from fffo_drive.config.commissioning import NOT_COMMISSIONED, Commissioned
from fffo_drive.config.sections import VelocitySource
from fffo_drive.control.stability import ElasticLoad, LinearAxis, loop_margins
from fffo_drive.control.velocity_estimator import (
    COMMANDS,
    Measured,
    estimator_at_rest,
    estimator_config,
    velocity_estimator_step,
)
from fffo_drive.identification.estimate_gain import (
    WORTH_ERROR_RATIO,
    Noise,
    noise_in_loop,
    squared_error_of_a_step,
    white_position,
)
from fffo_drive.identification.tuning import Gains, Wish
from fffo_drive.model.parameters import Quantity
from fffo_drive.workflows.tune import tune_axis

AXIS = Path(__file__).resolve().parents[2] / "configs" / "axis_simulated.yaml"
KT, PERIOD_S = 0.148, 5e-4


@pytest.mark.parametrize(("inertia", "proportional"), [(1e-3, 0.5), (3e-3, 2.0)])
def test_the_squared_error_of_a_step_without_delay_is_its_closed_form(inertia, proportional):
    """J s^2 + b s + k has the impulse response h with the integral of h^2 1 / (2 b k)."""
    gains = Gains(proportional, 20.0 * proportional, 4.0)
    b = 0.003 + proportional * KT
    k = gains.integral_action_nm_per_rev(KT)
    found = squared_error_of_a_step(LinearAxis(inertia, 0.003, 0.0, KT), gains)
    assert found == pytest.approx(1.0 / (2.0 * b * k), rel=3e-3)  # the sweep begins at 0.01 Hz


def test_an_estimate_of_the_right_model_without_lag_costs_nothing_but_its_filter():
    """A faster filter comes nearer to the loop without the lag that the drive's velocity has."""
    gains, delay_s, lag_s = Gains(0.975, 9.75, 5.0), 0.00225, 0.0007
    lag, none = (LinearAxis(9.4e-4, 0.003, delay_s + one, KT) for one in (lag_s, 0.0))
    errors = [
        squared_error_of_a_step(
            none._replace(estimator=estimator_config(hz, 9.4e-4, KT, 0.002, PERIOD_S, 25.0, 8.0)), gains
        )
        for hz in (100.0, 200.0, 390.0)
    ]
    best, worst = (squared_error_of_a_step(axis, gains) for axis in (none, lag))
    assert errors[0] > errors[1] > errors[2] > 0.99 * best
    assert best < errors[2] < worst


def test_a_range_of_loads_counts_with_its_worst():
    gains = Gains(0.4, 2.0, 1.0)
    axis = LinearAxis(1e-3, 0.003, 0.003, KT, inertia_range_nm_s2_per_rev=(4e-4, 3e-3))
    alone = [squared_error_of_a_step(axis.with_inertia(inertia), gains) for inertia in (4e-4, 3e-3)]
    assert squared_error_of_a_step(axis, gains) == max(alone)


def test_the_steps_of_the_command_are_those_of_the_filter_on_white_noise():
    """A standing axis, gains so low that its loop does nothing: Kp times the steps of the estimate."""
    noise_rev, ticks = 1e-5, 6000
    config = estimator_config(200.0, 9.4e-4, KT, 0.002, PERIOD_S, 25.0, 8.0)
    commands_a, state = np.zeros(COMMANDS), estimator_at_rest()
    position_rev = noise_rev * np.random.default_rng(3).standard_normal(ticks)
    estimate_rps = np.empty(ticks)
    for tick in range(ticks):
        measured = Measured(tick, tick * 500_000, True, float(position_rev[tick]), 0.0)
        terms, state = velocity_estimator_step(config, state, commands_a, measured)
        estimate_rps[tick] = terms.estimated_rps
    proportional = 1e-4
    axis = LinearAxis(9.4e-4, 0.003, 0.00225, KT, estimator=config)
    found = noise_in_loop(axis, Gains(proportional, 0.0, 0.0), white_position(noise_rev, PERIOD_S), PERIOD_S)
    steps = proportional * np.diff(estimate_rps[200:])
    assert found.step_a == pytest.approx(float(np.sqrt(np.mean(steps**2))), rel=0.05)


@pytest.mark.parametrize("proportional", [0.5, 2.0])
def test_white_noise_of_the_velocity_moves_an_inertia_as_a_low_pass_does(proportional):
    """P on J s without delay: bandwidth a = Kp Kt / J; one-sided density S gives the shaft S a / 4."""
    inertia, density = 9.4e-4, 1e-9
    axis = LinearAxis(inertia, 0.0, 0.0, KT)
    noise = Noise(np.array([1.0]), np.array([density]))
    found = noise_in_loop(axis, Gains(proportional, 0.0, 0.0), noise, 1e-4)
    assert found.shaft_rps2 == pytest.approx(density * proportional * KT / inertia / 4.0, rel=0.02)


def noise_record(position_counts: float = 0.5, velocity_rps: float = 0.01) -> NoiseRecord:
    """White noise of both words; standard deviations, of a position in counts of 15 bits."""
    per_hz = 2.0 * PERIOD_S
    return NoiseRecord(
        frequency_hz=[40.0, 1000.0],
        position_rev2_per_hz=[per_hz * (position_counts * 2.0**-15) ** 2] * 2,
        velocity_rps2_per_hz=[per_hz * velocity_rps**2] * 2,
    )


def worth(tracking_hz: float, commissioned: Commissioned = NOT_COMMISSIONED, source: VelocitySource | None = None):
    """For the simulated axis with a tracking loop of this speed, 2.75 ms from end to end with each."""
    axis = fd.read_axis(AXIS)
    lag = Quantity(value=0.9 / (math.pi * tracking_hz))
    model = axis.model.model_copy(update={"sensor_delay_s": lag, "content_hash": None})
    return tune_axis(axis.file, model, Wish(), commissioned, source)


def test_behind_a_slow_sensor_the_estimate_would_gain_and_without_a_record_nobody_takes_it():
    (kept, slow), (_, usual), (_, fast) = worth(200.0), worth(400.0), worth(1000.0)
    assert slow.error_ratio < usual.error_ratio < WORTH_ERROR_RATIO < fast.error_ratio
    assert slow.integral_ratio > usual.integral_ratio > 1.0
    assert 0.001 < usual.step_a < 0.1
    assert slow.drive_step_a is None
    assert kept.velocity.source == "drive"


@pytest.mark.parametrize(
    ("tracking_hz", "noise", "source"),
    [
        (400.0, noise_record(), "estimated"),
        (400.0, noise_record(position_counts=20.0), "drive"),  # the estimate would shake with the position
        (1000.0, noise_record(velocity_rps=0.0), "drive"),  # by friction alone a fast sensor is as good
        (1000.0, noise_record(velocity_rps=0.1), "estimated"),  # ... and one that is noisier than its position is not
    ],
)
def test_the_measured_noise_decides(tracking_hz, noise, source):
    tuned, found = worth(tracking_hz, Commissioned(noise=noise))
    assert tuned.velocity.source == source
    assert found.gains is (source == "estimated")
    section = tuned.section(5.0)
    assert section["velocity"] == {"source": source, "bandwidth_hz": 200.0}


def test_what_the_user_says_decides_before():
    noisy = Commissioned(noise=noise_record(position_counts=20.0))
    tuned, found = worth(400.0, noisy, "estimated")
    assert tuned.velocity.source == "estimated"
    assert found is None
    tuned, found = worth(400.0, Commissioned(noise=noise_record()), "drive")
    assert tuned.velocity.source == "drive"
    assert found is None


def test_it_is_not_proposed_where_the_axis_is_known_to_be_unlike_its_model():
    """The estimate believes a rigid inertia."""
    assert worth(200.0, Commissioned(unexplained_share=0.1, noise=noise_record()))[1] is None


def test_the_margins_of_the_estimate_are_those_on_an_elastic_axis():
    """Gains for a rigid axis on the estimate, on one of which 35 % hang on a spring of 110 Hz."""
    axis = fd.read_axis(AXIS)
    velocity = axis.file.controller.velocity.model_copy(update={"source": "estimated"})
    controller = axis.file.controller.model_copy(update={"velocity": velocity})
    rigid = loop_axis(axis.file.model_copy(update={"controller": controller}), axis.model)
    gains = fd.tune(
        axis.model, axis=fd.library.Axis(axis.path, axis.file.model_copy(update={"controller": controller}), axis.model)
    )
    elastic = rigid._replace(elastic=ElasticLoad(0.35, 110.0, 0.03))
    assert loop_margins(rigid, *gains.design.gains.in_motion).gain > 2.0
    assert loop_margins(elastic, *gains.design.gains.in_motion).gain < 1.0
