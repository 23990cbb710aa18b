"""Profiles: what they contain, and that they are bounded before anything moves."""

from __future__ import annotations

import numpy as np
import pytest
from identification import rig
from identification.synthetic import AXIS, PERIOD_S

from fffo_drive.config.axis import AxisFile, build_profile, deciding_section
from fffo_drive.config.checks import motion_problems
from fffo_drive.control.reference import MODE_CURRENT, MODE_VELOCITY
from fffo_drive.identification.excitation import (
    DWELLS_S,
    chirp,
    deciding_motion,
    frequency_response_chirp,
    identification_sequence,
    predict_motion,
    separating_recipe,
)
from fffo_drive.model.effects.registry import LAWS
from fffo_drive.model.parameters import read_model


def axis_file(profile, **envelope):
    limits = {"current_limit_a": 14, "continuous_current_a": 8, "speed_limit_rps": 60, "following_error_rps": 8}
    return AxisFile.model_validate({
        "name": "a", "drive": {"kind": "simulated", "file": "none"}, "model": "none",
        "controller": {"proportional_a_per_rps": 0.975, "integral_a_per_rev": 9.75, "current_limit_a": 12},
        "envelope": limits | envelope, "profile": profile,
    })  # fmt: skip


def test_a_chirp_has_the_frequencies_that_it_says():
    wave = chirp(10.0, 0.1, 20.0, PERIOD_S)
    crossings = np.flatnonzero(np.diff(np.signbit(wave)))
    assert 0.5 / (PERIOD_S * np.diff(crossings)[0]) == pytest.approx(10.0, rel=0.02)
    cycles = 20.0 * (10.0 - 0.1) / np.log(100.0)  # integral of an exponential sweep
    assert crossings.size == pytest.approx(2 * cycles, abs=2)


def test_the_identification_sequence_goes_down_and_up_under_its_envelope():
    profile = identification_sequence(60.0, PERIOD_S, 0.3, 1.1, 0.01, 10.0)
    assert profile.mode == MODE_CURRENT
    assert profile.duration_s == 60.0
    first, last = np.abs(profile.values[:2000]).max(), np.abs(profile.values[-2000:]).max()
    assert first == pytest.approx(0.3, rel=0.03)
    assert last == pytest.approx(1.1, rel=0.03)
    spectrum = np.abs(np.fft.rfft(profile.values))
    frequency = np.fft.rfftfreq(profile.values.size, PERIOD_S)
    assert spectrum[frequency > 20.0].max() < 0.02 * spectrum.max()


def test_the_recipe_stays_inside_its_bounds_and_holds_every_part():
    profile = separating_recipe(PERIOD_S, 14.0, 150.0)
    assert profile.mode == MODE_VELOCITY
    assert np.abs(profile.values).max() <= 14.0 + 1e-9
    assert np.abs(profile.derivatives).max() <= 150.0 * 1.01
    still = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], profile.values == 0.0, [0]]))))[::2] * PERIOD_S
    for dwell_s in DWELLS_S[2:]:
        assert np.any(np.abs(still - dwell_s) < 0.6)
    assert profile.values.min() == pytest.approx(-profile.values.max())


@pytest.mark.parametrize("effect", [*LAWS, "unknown:velocity"])
def test_every_effect_has_a_motion_that_decides(effect):
    profile = deciding_motion(effect, PERIOD_S, 10.0, 100.0, 0.4)
    assert profile.values[0] == 0.0
    if profile.mode == MODE_CURRENT:
        assert np.abs(profile.values).max() == pytest.approx(0.4, rel=1e-3)
    else:
        assert abs(profile.values[-1]) <= 100.0 * PERIOD_S  # the next sample would be at rest
        assert np.abs(profile.values).max() <= 10.0 + 1e-9
        assert np.abs(profile.derivatives).max() <= 100.0 * 1.01
        assert profile.values.min() == pytest.approx(-profile.values.max())  # both ways


def test_creep_turns_five_times_each_way_at_each_speed():
    values = deciding_motion("cogging", PERIOD_S, 14.0, 150.0, 0.4).values
    for speed_rps in (0.7, 1.4):
        for sign in (1.0, -1.0):
            constant = np.isclose(values, sign * speed_rps)
            assert constant.sum() * PERIOD_S * speed_rps == pytest.approx(5.0, rel=0.01)


def test_a_motion_that_decides_stays_inside_the_limits_of_its_axis():
    axis = axis_file({"kind": "sine", "duration_s": 1, "amplitude": 1, "frequency_hz": 1}, speed_limit_rps=5)
    model = read_model(rig.TABLE_1)
    section = deciding_section(axis, "quadratic_drag")
    profile = build_profile(section, axis.loop.period_s)
    assert np.abs(profile.values).max() == pytest.approx(4.0)
    assert motion_problems(axis.model_copy(update={"profile": section}), profile, model) == []


def test_the_forecast_is_the_steady_state_of_a_constant_current():
    from fffo_drive.control.reference import Profile

    current = np.full(20_000, 0.5)
    forecast = predict_motion(Profile("c", MODE_CURRENT, PERIOD_S, current, 0 * current), AXIS)
    steady = (0.148 * 0.5 - 0.025) / 0.003  # sigma w + Fc = Kt i, far above the Stribeck velocity
    assert forecast.speed_rps == pytest.approx(steady, rel=0.01)
    assert forecast.lowest_rev >= 0.0
    assert forecast.highest_rev > 100.0


@pytest.mark.parametrize("kind", ["identify", "frf", "recipe"])
def test_every_kind_can_be_named_in_an_axis_file(kind):
    axis = axis_file({"kind": kind})
    profile = build_profile(axis.profile, axis.loop.period_s)
    assert profile.name == kind
    assert np.isfinite(profile.values).all()
    assert profile.values.shape == profile.derivatives.shape


def test_a_current_is_bounded_by_what_it_would_do():
    model = read_model(rig.TABLE_1)
    axis = axis_file({"kind": "frf", "duration_s": 20, "amplitude_a": 1.0}, speed_limit_rps=5)
    profile = build_profile(axis.profile, axis.loop.period_s)
    assert "speed_limit_rps" in motion_problems(axis, profile, model)[0]
    window = axis_file({"kind": "frf", "duration_s": 20, "amplitude_a": 1.0}, position_window_rev=(-1, 1))
    assert "position_window_rev" in motion_problems(window, profile, model)[0]
    assert motion_problems(axis_file({"kind": "frf", "duration_s": 20}), profile, model) == []


def test_a_frequency_response_chirp_has_one_amplitude():
    values = frequency_response_chirp(30.0, PERIOD_S, 0.8, 0.1, 50.0).values
    assert np.abs(values).max() == pytest.approx(0.8, rel=1e-4)
