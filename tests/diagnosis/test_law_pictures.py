"""The picture that each law asks for shows what was put into the rows, and every law has one that the page knows."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from diagnosis.test_pictures import PERIOD_S, model, seen
from identification.synthetic import chirp_record

from fffo_drive.diagnosis.law_pictures import _KINDS, law_picture
from fffo_drive.diagnosis.scenes import Effect
from fffo_drive.identification.dataset import Record
from fffo_drive.model.effects.law import FigureKind
from fffo_drive.model.effects.registry import LAWS, law_of

FRICTIONAL = ("asymmetric_coulomb", "asymmetric_viscous", "torque_offset", "quadratic_drag")
SECONDS = 24.0


@pytest.fixture(scope="module")
def data():
    """Sines that turn far and reverse often."""
    time_s = np.arange(round(SECONDS / PERIOD_S)) * PERIOD_S
    velocity = 3.0 * np.sin(2 * np.pi * 0.25 * time_s) + np.sin(2 * np.pi * 0.85 * time_s)
    content = {**vars(chirp_record(2.0)), "reference_rps": velocity, "position_rev": np.cumsum(velocity) * PERIOD_S}
    content |= {"current_a": 0.3 * velocity, "velocity_rps": None, "name": "sines"}
    return seen(Record(**content))


def effect_of(name, size=0.01, **shapes):
    law = law_of(name)
    return Effect(name, shapes, {strength.name: np.array([size]) for strength in law.strengths})


def drawn(data, *effects, residual=0.0):
    return law_picture(data, model(np.full(data.rows.time_s.size, residual), list(effects)), 0)


def curves(picture):
    return {curve.label: curve for curve in picture.curves}


def test_a_wave_stands_at_its_order_with_its_amplitude_and_is_gone_with_the_effect(data):
    wave = Effect("cogging", {"order": 6.0}, {"cos_nm": np.array([0.01]), "sin_nm": np.array([0.0])})
    second = Effect("cogging", {"order": 2.0}, {"cos_nm": np.array([0.004]), "sin_nm": np.array([0.0])})
    picture = drawn(data, wave, second)
    before, after = curves(picture)["without the effect"], curves(picture)["with it"]
    assert before.x[np.argmax(before.y)] == pytest.approx(6.0, abs=0.05)
    assert before.y.max() == pytest.approx(0.01, rel=0.15)  # as the filter of the rows leaves it
    assert after.y.max() < 1e-9
    assert [mark.x for mark in picture.marks] == [6.0, 2.0]  # every order that was found is named
    assert picture.marks[0].label == "cogging, 6"


@pytest.mark.parametrize("name", ["torque_ripple", "friction_ripple"])
def test_a_wave_of_a_torque_is_seen_at_its_order_too(data, name):
    law = law_of(name)
    effect = Effect(name, {"order": 5.0}, {law.strengths[0].name: np.array([0.05])})
    before = curves(drawn(data, effect))["without the effect"]
    assert before.x[np.argmax(before.y)] == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize("name", FRICTIONAL)
def test_friction_over_velocity_is_measured_where_the_model_has_it_with_the_effect(data, name):
    found = curves(drawn(data, effect_of(name)))
    np.testing.assert_allclose(found["measured"].y, found["model with the effect"].y, atol=1e-12)
    assert np.abs(found["measured"].y - found["model without it"].y).max() > 1e-4
    assert found["measured"].low is not None


@pytest.mark.parametrize("name", ["coulomb_drift", "viscous_drift", "torque_constant_drift"])
def test_a_drift_is_a_level_that_changes_with_time(data, name):
    found = curves(drawn(data, effect_of(name)))
    flat = found["model without it"].y
    assert np.ptp(flat) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(found["measured"].y, found["model with the effect"].y, atol=1e-12)
    assert np.ptp(found["measured"].y) > 1e-6


@pytest.mark.parametrize("name", ["backlash", "current_lag", "delay", "frictional_lag"])
def test_around_reversals_the_residual_is_over_the_time_since(data, name):
    picture = drawn(data, effect_of(name))
    assert picture is not None
    found = curves(picture)
    np.testing.assert_allclose(found["without the effect"].y, found["torque of the effect"].y, atol=1e-12)
    assert -0.1 <= found["with it"].x.min() < 0.0 < found["with it"].x.max() < 0.4


@pytest.mark.parametrize("name", ["dead_zone", "torque_saturation", "voltage_limit"])
def test_what_arrives_is_less_than_what_was_commanded(data, name):
    picture = drawn(data, effect_of(name, 0.02))
    found = curves(picture)
    np.testing.assert_allclose(found["measured"].y, found["model with the effect"].y, atol=1e-12)
    assert "commanded" in found


def test_every_kind_that_a_law_may_ask_for_is_drawn_and_used():
    kinds = set(get_args(FigureKind)) - {"axis"}
    assert kinds == set(_KINDS)
    assert kinds <= {law.figure for law in LAWS.values()}
