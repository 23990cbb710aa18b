"""The table of what has no name, against interpolation by scipy: inside, at the edges, beyond, and as a plain curve."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from fffo_drive.model.effects import slots as s
from fffo_drive.model.effects.laws.lookup import (
    AXIS_CODES,
    BRAKE,
    FRICTION,
    PLAIN,
    RESPONSE,
    VISCOUS,
    WOUND,
    CurveModel,
    across_word,
    curve_errors,
    packed_curve,
    values_of,
)
from fffo_drive.model.effects.registry import law_of, parameter_errors, vector_of
from fffo_drive.model.parameters import EffectModel, Quantity, effect_errors, effect_model, read_model, write_model

NAME = "unknown:velocity"
X = np.array([-4.0, -0.5, 0.2, 3.0])
Z = np.array([-10.0, 0.0, 40.0])
Y = np.random.default_rng(1).normal(size=(Z.size, X.size))
SHAPES = {
    "count": 4.0, "across": float(AXIS_CODES["acceleration"]), "levels": 3.0,
    **{f"x{k:02d}": x for k, x in enumerate(X)}, **{f"z{k:02d}": z for k, z in enumerate(Z)},
}  # fmt: skip
VALUES = {f"y{k:02d}": y for k, y in enumerate(Y.ravel())}


def torque(velocity_rps, acceleration_rps2=0.0, kind=PLAIN, grip=0.0, **values):
    signals, memory = np.zeros(s.N_SLOTS), np.zeros(s.MEMORY_SLOTS)
    signals[s.STEP_S] = 5e-4
    signals[s.REST_SPEED_RPS] = s.REST_SPEED_DEFAULT_RPS
    signals[s.VELOCITY_RPS], signals[s.ACCELERATION_RPS2], signals[s.GRIP] = velocity_rps, acceleration_rps2, grip
    parameters = np.zeros(s.MAX_PARAMETERS)
    given = vector_of(NAME, {**SHAPES, **VALUES, "kind": kind, **values})
    parameters[: len(given)] = given
    law_of(NAME).kernel(signals, parameters, memory)
    return signals[s.LOAD_NM]


@given(velocity_rps=st.floats(-6.0, 6.0), acceleration_rps2=st.floats(-20.0, 60.0))
def test_a_table_is_straight_between_its_knots_and_constant_beyond(velocity_rps, acceleration_rps2):
    wanted = RegularGridInterpolator((Z, X), Y)
    inside = (np.clip(acceleration_rps2, Z[0], Z[-1]), np.clip(velocity_rps, X[0], X[-1]))
    assert torque(velocity_rps, acceleration_rps2) == pytest.approx(float(wanted(inside)), abs=1e-12)


KINDS = (PLAIN, FRICTION, VISCOUS, BRAKE)


@given(velocity_rps=st.floats(-6.0, 6.0), kind=st.sampled_from(KINDS), grip=st.floats(-1.0, 1.0))
def test_a_curve_is_a_table_without_a_second_axis(velocity_rps, kind, grip):
    sign = np.clip(velocity_rps / s.REST_SPEED_DEFAULT_RPS, -1.0, 1.0)
    times = {PLAIN: 1.0, FRICTION: grip, VISCOUS: velocity_rps, BRAKE: sign}[kind]
    wanted = np.interp(velocity_rps, X, Y[0]) * times
    assert torque(velocity_rps, 25.0, kind, grip, across=-1.0) == pytest.approx(wanted, abs=1e-12)
    level = Z[0] - 1.0
    assert torque(velocity_rps, level, kind, grip) == pytest.approx(wanted, abs=1e-12)


@given(velocity_rps=st.floats(-6.0, 6.0))
def test_a_memory_without_a_length_is_the_speed(velocity_rps):
    own = torque(velocity_rps, across=float(AXIS_CODES["memory"]), across_scale=0.0)
    wanted = RegularGridInterpolator((Z, X), Y)((min(abs(velocity_rps), Z[-1]), np.clip(velocity_rps, X[0], X[-1])))
    assert own == pytest.approx(float(wanted), abs=1e-9)


def test_a_table_says_how_many_values_it_has_and_over_what():
    assert values_of(SHAPES) == 12
    assert values_of({"count": 4.0}) == 4
    assert across_word(SHAPES) == "acceleration"
    assert across_word({"count": 4.0}) == ""
    assert across_word({**SHAPES, "across": 11.0, "across_scale": 0.0}) == "speed"
    assert across_word({**SHAPES, "across": 11.0, "across_scale": 3.0}) == "memory"


def test_a_table_that_does_not_fit_is_refused():
    assert parameter_errors(NAME, {**SHAPES, **VALUES}) == []
    assert [key for key, _ in parameter_errors(NAME, {**SHAPES, "levels": 5.0})] == ["levels"]
    assert [key for key, _ in parameter_errors(NAME, {**SHAPES, "count": 25.0})] == ["count"]


CURVE = {"kind": "torque", "unit": "Nm", "knots": [0.0, 1.0, 2.0], "values": [0.1, 0.2, 0.3]}
TABLE = {**CURVE, "across": "speed", "levels": [0.5, 4.0], "values": [[0.1, 0.2, 0.3]] * 2}


def test_a_model_file_has_a_curve_as_lists_with_names(tmp_path, pytestconfig):
    """Places and values that people read, in lines; what was not fitted has no standard deviation."""
    sd = {f"y{k:02d}": 0.01 for k in range(11)}
    found = effect_model(NAME, {**SHAPES, **VALUES, "kind": VISCOUS}, sd)
    model = read_model(pytestconfig.rootpath / "configs" / "models" / "table1.yaml").model_copy(
        update={"effects": [found]}
    )
    write_model(tmp_path / "model.yaml", model)
    text = (tmp_path / "model.yaml").read_text()
    for line in ("kind: viscous", "unit: Nm/rps", "knots: [-4.0, -0.5, 0.2, 3.0]", "across: acceleration",
                 "levels: [-10.0, 0.0, 40.0]", "- [0.01, 0.01, 0.01, null]"):  # fmt: skip
        assert f"    {line}\n" in text
    assert "y00" not in text
    again = read_model(tmp_path / "model.yaml").effects[0]
    assert again == found
    quantities = again.quantities()
    assert {key: quantity.value for key, quantity in quantities.items() if key[0] == "y"} == VALUES
    assert (quantities["y10"].sd, quantities["y11"].sd) == (0.01, None)


@pytest.mark.parametrize(
    ("wrong", "key"),
    [
        ({**CURVE, "knots": [0.0, 2.0, 1.0]}, "knots"),
        ({**CURVE, "knots": [], "values": []}, "knots"),
        ({**CURVE, "knots": [float(k) for k in range(25)], "values": [0.0] * 25}, "knots"),
        ({**CURVE, "values": [0.1, 0.2]}, "values"),
        ({**CURVE, "values": [[0.1, 0.2, 0.3]]}, "values"),
        ({**CURVE, "sd": [0.1]}, "sd"),
        ({**CURVE, "unit": "rev"}, "unit"),
        ({**CURVE, "levels": [0.0]}, "levels"),
        ({**TABLE, "values": [[0.1, 0.2, 0.3], [0.1, 0.2]]}, "values"),
        ({**TABLE, "levels": [], "values": []}, "levels"),
        ({**TABLE, "kind": "wound"}, "across"),
        ({**CURVE, "kind": "response", "unit": "-"}, "values"),
    ],
)
def test_a_curve_that_does_not_fit_together_is_refused_with_its_key(wrong, key):
    curve = CurveModel.model_validate(wrong)
    assert key in dict(curve_errors(curve))
    assert f"effects[0].curve.{key}" in dict(effect_errors([EffectModel(name=NAME, curve=curve)]))


def test_a_curve_belongs_to_an_effect_without_a_name_of_its_own():
    curve = CurveModel.model_validate(CURVE)
    packed = {key: Quantity(value=value) for key, value in packed_curve(curve).items()}
    assert effect_errors([EffectModel(name=NAME, curve=curve)]) == []
    assert effect_errors([EffectModel(name=NAME, curve=CurveModel.model_validate(TABLE))]) == []
    for wrong, key in (
        (EffectModel(name="cogging", curve=curve), "curve"),
        (EffectModel(name=NAME, curve=curve, parameters=packed), "parameters"),
        (EffectModel(name=NAME), "curve"),
    ):
        assert [found for found, _ in effect_errors([wrong])] == [f"effects[0].{key}"]


@pytest.mark.parametrize("band_hz", [2.0, 8.0])
def test_a_response_gives_what_is_in_phase_and_what_is_a_quarter_of_a_period_late(band_hz):
    """At its own frequency a band passes all of the motor torque."""
    step_s, samples = 5e-4, 20_000
    time_s = np.arange(samples) * step_s
    torque_nm = np.sin(2.0 * np.pi * band_hz * time_s)
    for in_phase, late in ((0.3, 0.0), (0.0, -0.2)):
        values = {"kind": RESPONSE, "count": 2.0, "x00": 2.0, "x01": 8.0}
        values["y00" if band_hz == 2.0 else "y01"], values["y02" if band_hz == 2.0 else "y03"] = in_phase, late
        parameters, signals = np.zeros(s.MAX_PARAMETERS), np.zeros(s.N_SLOTS)
        given = vector_of("unknown:frequency", values)
        parameters[: len(given)] = given
        signals[s.STEP_S] = step_s
        memory, load_nm = np.zeros(s.MEMORY_SLOTS), np.zeros(samples)
        for k in range(samples):
            signals[s.MOTOR_TORQUE_NM], signals[s.LOAD_NM] = torque_nm[k], 0.0
            law_of("unknown:frequency").kernel(signals, parameters, memory)
            load_nm[k] = signals[s.LOAD_NM]
        settled = time_s > 5.0
        wanted = in_phase * torque_nm - late * np.cos(2.0 * np.pi * band_hz * time_s)
        assert load_nm[settled] == pytest.approx(wanted[settled], abs=0.01)
    assert values_of(values) == 4


def test_a_spring_that_slips_pulls_by_its_value_at_the_reach_and_lets_go_over_twice_the_reach():
    """Wound up from rest over 2 rev, then back over 2 rev: 0, up to the reach, level, down by 2 reaches, level."""
    step_s, speed_rps, reach_rev, pull_nm = 1e-3, 0.5, 0.3, 0.012
    values = {"kind": WOUND, "count": 2.0, "x00": reach_rev, "x01": 5.0, "y00": pull_nm}
    parameters, signals = np.zeros(s.MAX_PARAMETERS), np.zeros(s.N_SLOTS)
    given = vector_of("unknown:memory", values)
    parameters[: len(given)] = given
    signals[s.STEP_S] = step_s
    memory, pulls_nm, travel_rev = np.zeros(s.MEMORY_SLOTS), [], []
    place_rev = 0.0
    for k in range(8000):
        signals[s.VELOCITY_RPS], signals[s.LOAD_NM] = speed_rps if k < 4000 else -speed_rps, 0.0
        place_rev += signals[s.VELOCITY_RPS] * step_s
        law_of("unknown:memory").kernel(signals, parameters, memory)
        pulls_nm.append(signals[s.LOAD_NM])
        travel_rev.append(place_rev)
    forth = pull_nm * np.minimum(np.array(travel_rev[:4000]) / reach_rev, 1.0)
    back = pull_nm * np.maximum(1.0 - (2.0 - np.array(travel_rev[4000:])) / reach_rev, -1.0)
    assert pulls_nm == pytest.approx(np.concatenate([forth, back]), abs=1e-12)
    assert values_of(values) == 2
