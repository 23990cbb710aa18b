"""Laws of effects: closed forms, linearity in their strengths, the registry, the model file, bit-for-bit kernels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from interpreted import hex_results
from model.loaded_axis import simulate_with_effects

from fffo_drive.documents import DocumentError
from fffo_drive.model.axis import AxisConfig, AxisState, simulate
from fffo_drive.model.effects import slots as s
from fffo_drive.model.effects.law import SearchContext
from fffo_drive.model.effects.registry import LAWS, NAMES, is_compensable, name_error, parameter_errors
from fffo_drive.model.effects.table import Term, effect_table, effects_along
from fffo_drive.model.friction import OMEGA_CLIPPED, REST, FrictionConfig, friction_step
from fffo_drive.model.parameters import EffectModel, Quantity, content_hash, read_model, write_model

STEP_S = 5e-4
TURN = 2.0 * math.pi
FRICTION = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, OMEGA_CLIPPED)
AXIS = AxisConfig(9.4e-4, 0.148, 0.00275, FRICTION)
CONTEXT = SearchContext(100.0, STEP_S, 0.02, 15.0, -20.0, 20.0, 2.0, 0.3, 0.025, 0.067, 778.0, 2.33, 160.0, 4, 12)
# a shape in which every strength of a law acts
SHAPES = {
    "position_dependent_friction": {"period_rev": 3.0, "centre_rev": 0.5, "width_rev": 1.0},
    "torque_saturation": {"knee_a": 1.0},
    "voltage_limit": {"stall_nm": 0.1, "no_load_rps": 20.0},
    "lookup": {"count": 3.0, "axis": 1.0, "kind": 1.0, "x00": -4.0, "x01": 0.5, "x02": 4.0},
}


def motion(n=4000, friction=FRICTION, amplitude_rps=5.0, step_s=STEP_S, shake_hz=3.1):
    """A motion with reversals, its own friction, and a current that is not just that of the motion."""
    time_s = np.arange(n) * step_s
    velocity = amplitude_rps * np.sin(TURN * 0.5 * time_s) + np.sin(TURN * shake_hz * time_s)
    rows = np.zeros((n, s.N_MOTION))
    state = REST
    for k in range(n):
        state = friction_step(friction, state, float(velocity[k]), 0.0, step_s)
        rows[k, s.FRICTION_NM], rows[k, s.TRAVEL_REV], rows[k, s.DIRECTION] = state[0], state[1], state[3]
    rows[:, s.TIME_S], rows[:, s.VELOCITY_RPS] = time_s, velocity
    rows[:, s.ACCELERATION_RPS2] = np.gradient(velocity, step_s)
    rows[:, s.MOTOR_ANGLE_REV] = rows[:, s.SENSOR_ANGLE_REV] = np.cumsum(velocity) * step_s
    rows[:, s.CURRENT_A] = 1.2 * np.cos(TURN * 0.5 * time_s) + 0.3 * np.sin(TURN * 7.0 * time_s)
    return rows


MOTION = motion()
COARSE_S = 4.0 * STEP_S  # the step of a diagnosis: a fast reversal crosses presliding in one or two of them
SHAKEN = motion(step_s=COARSE_S, shake_hz=21.3)


NOT_LINEAR = {"delay", "elasticity", "backlash", "dwell_stiction", "asymmetric_viscous", "viscous_drift"}


def along(name, values, rows=MOTION, step_s=STEP_S):
    return effects_along([Term(name, values)], rows, AXIS, step_s)


def each_strength(name, rows):
    """Strengths of a law, and of each, alone and typical: (n, k) torque and (n, k) rev of the sensor, per unit."""
    shape, strengths = SHAPES.get(name, {}), LAWS[name].strengths
    found = [effects_along([Term(name, {**shape, p.name: p.typical})], rows, AXIS, STEP_S) for p in strengths]
    load, sensor = (np.column_stack(columns) / [p.typical for p in strengths] for columns in zip(*found, strict=True))
    return [p.name for p in strengths], load, sensor


def kernel_results():
    rows = MOTION[:600]
    found = []
    for name in NAMES:
        names, load, sensor = each_strength(name, rows)
        found += [*load[::50, 0], *sensor[::50, -1]]
        kernel = effect_table([Term(name, {names[0]: 0.1, **SHAPES.get(name, {})})], AXIS, STEP_S, feedforward=True)
        found.append(float(kernel.parameters.sum()))
    terms = [Term("cogging", {"cos_nm": 0.004, "order": 6.0}), Term("elasticity", {"share": 0.2}),
             Term("resolver_error", {"cos1_rev": 1e-3})]  # fmt: skip
    output, end = simulate_with_effects(AXIS, terms, AxisState(0.0, 0.0, REST), rows[:, s.CURRENT_A], STEP_S, 2)
    return [float(x).hex() for x in (*found, *output[-1], end.velocity_rps)]


def test_compiled_and_interpreted_laws_agree_bit_for_bit():
    assert kernel_results() == hex_results("model.test_effects", "kernel_results")


CLOSED = {
    "torque_offset": ({"torque_nm": 0.01}, lambda m: np.full(len(m), 0.01)),
    "quadratic_drag": ({"drag_nm_per_rps2": 1e-4}, lambda m: 1e-4 * m[:, 1] * np.abs(m[:, 1])),
    "cogging": (
        {"cos_nm": 0.004, "sin_nm": 0.003, "order": 6.0},
        lambda m: 0.004 * np.cos(TURN * 6.0 * m[:, 3]) + 0.003 * np.sin(TURN * 6.0 * m[:, 3]),
    ),
    "unbalance": ({"sin_nm": 0.01, "ratio": 160.0}, lambda m: 0.01 * np.sin(TURN * m[:, 3] / 160.0)),
    "torque_ripple": (
        {"cos_share": 0.1, "order": 2.0}, lambda m: 0.148 * m[:, 5] * 0.1 * np.cos(TURN * 2.0 * m[:, 3]),
    ),
    "periodic_disturbance": ({"sin_nm": 0.01, "frequency_hz": 7.3}, lambda m: 0.01 * np.sin(TURN * 7.3 * m[:, 0])),
    "dead_zone": (
        {"lost_nm": 0.0148, "width_a": 0.1}, lambda m: 0.0148 * np.clip(m[:, 5] / 0.1, -1.0, 1.0),
    ),
    "torque_saturation": (
        {"share": 0.5, "knee_a": 1.0}, lambda m: 0.5 * 0.148 * m[:, 5] * m[:, 5] ** 2 / (1.0 + m[:, 5] ** 2),
    ),
    "torque_constant_drift": (
        {"share": 0.3, "begin_s": 0.4, "tau_s": 0.5},
        lambda m: -0.3 * 0.148 * m[:, 5] * np.expm1(-np.maximum(m[:, 0] - 0.4, 0.0) / 0.5),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CLOSED)
def test_closed_forms(name):
    values, expected = CLOSED[name]
    load, sensor = along(name, values)
    assert np.allclose(load, expected(MOTION), rtol=1e-9, atol=1e-12)
    assert not sensor.any()


def test_a_delay_gives_back_the_torque_of_before():
    load, _ = along("delay", {"delay_s": 3.0 * STEP_S})
    torque = 0.148 * MOTION[:, s.CURRENT_A]
    assert np.allclose(load[3:], torque[3:] - torque[:-3], atol=1e-12)
    half, _ = along("delay", {"delay_s": 2.5 * STEP_S})
    assert np.allclose(half[3:], torque[3:] - 0.5 * (torque[1:-2] + torque[:-3]), atol=1e-12)


def test_a_lag_answers_a_step_with_an_exponential():
    rows = np.zeros((400, s.N_MOTION))
    rows[:, s.CURRENT_A] = 1.0
    load, _ = effects_along([Term("current_lag", {"share": 1.0, "tau_s": 0.01})], rows, AXIS, STEP_S)
    ramp = 0.148 * 0.01 / STEP_S * -math.expm1(-STEP_S / 0.01)  # the step is a ramp between two instants
    assert np.allclose(load, ramp * np.exp(-np.arange(400) * STEP_S / 0.01), rtol=1e-9)


def test_the_resolver_is_wrong_and_the_torque_is_not():
    load, sensor = along("resolver_error", {"cos1_rev": 1e-3, "sin2_rev": 5e-4})
    angle = MOTION[:, s.SENSOR_ANGLE_REV]
    assert not load.any()
    assert np.allclose(sensor, 1e-3 * np.cos(TURN * angle) + 5e-4 * np.sin(2.0 * TURN * angle))


LEVELS = {
    "asymmetric_coulomb": ({"share": 0.3}, lambda row: 0.3 * row[s.DIRECTION]),
    "coulomb_drift": ({"share": -0.4, "tau_s": 0.7}, lambda row: -0.4 * (1.0 - math.exp(-row[s.TIME_S] / 0.7))),
    "friction_ripple": (
        {"cos_share": 0.5, "order": 3.0}, lambda row: 0.5 * math.cos(TURN * 3.0 * row[s.MOTOR_ANGLE_REV]),
    ),
    "position_dependent_friction": (
        {"sin_share": 0.6, "period_rev": 0.8}, lambda row: 0.6 * math.sin(TURN * row[s.MOTOR_ANGLE_REV] / 0.8),
    ),
    "load_dependent_friction": ({"share": 0.1}, lambda row: 0.1 * abs(0.148 * row[s.CURRENT_A]) / 0.025),
}  # fmt: skip


@pytest.mark.parametrize(("rows", "step_s"), [(MOTION, STEP_S), (SHAKEN, COARSE_S)], ids=["slow", "shaken"])
@pytest.mark.parametrize("name", LEVELS)
def test_a_change_of_level_is_what_the_friction_of_another_level_is_more(name, rows, step_s):
    """Fc and Fs of a 2SEP surface moved step by step, on the same motion: by what acts in the middle of each step."""
    values, change = LEVELS[name]
    load, _ = along(name, values, rows, step_s)
    state, expected = REST, np.zeros(len(rows))
    middle = rows.copy()
    for slot in (s.MOTOR_ANGLE_REV, s.CURRENT_A):
        middle[1:, slot] = 0.5 * (rows[1:, slot] + rows[:-1, slot])
    for k, row in enumerate(rows):
        scale = 1.0 + change(middle[k])
        config = FRICTION._replace(coulomb_nm=0.025 * scale, static_nm=0.067 * scale)
        state = friction_step(config, state, float(row[s.VELOCITY_RPS]), 0.0, step_s)
        expected[k] = state.torque_nm - row[s.FRICTION_NM]
    assert np.abs(expected).max() > 0.004
    assert np.abs(load - expected).max() < 1e-12


@pytest.mark.parametrize("name", sorted(set(NAMES) - NOT_LINEAR - set(LEVELS)))
def test_effects_are_linear_in_their_strengths(name):
    names, load, sensor = each_strength(name, MOTION)
    generator = np.random.default_rng(4)
    strengths = generator.uniform(0.2, 0.8, len(names)) * [p.typical for p in LAWS[name].strengths]
    values = {**SHAPES.get(name, {}), **dict(zip(names, strengths, strict=True))}
    found_nm, found_rev = along(name, values)
    scale = np.abs(load).max() * np.abs(strengths).max() + 1e-300
    assert np.allclose(found_nm, load @ strengths, rtol=1e-9, atol=1e-9 * scale)
    assert np.allclose(found_rev, sensor @ strengths, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_without_strength_there_is_no_effect(name):
    load, sensor = along(name, SHAPES.get(name, {}))
    assert not load.any()
    assert not sensor.any()


@pytest.mark.parametrize("name", ["asymmetric_coulomb", "coulomb_drift", "load_dependent_friction", "friction_ripple",
                                  "dwell_stiction", "position_dependent_friction"])  # fmt: skip
def test_friction_effects_do_nothing_to_an_axis_that_never_moved(name):
    rows = np.zeros((500, s.N_MOTION))
    rows[:, s.CURRENT_A] = 0.1
    rows[:, s.TIME_S] = np.arange(500) * STEP_S
    values = {p.name: p.typical for p in LAWS[name].parameters} | SHAPES.get(name, {})
    load, _ = effects_along([Term(name, values)], rows, AXIS, STEP_S)
    assert not load.any()


def test_break_away_grows_with_the_time_at_rest_and_goes_with_travel():
    def peak(rest_s):
        rest = round(rest_s / STEP_S)
        velocity = np.concatenate([np.full(1000, 0.5), np.zeros(rest), np.full(2000, 0.5)])
        rows = np.zeros((velocity.size, s.N_MOTION))
        rows[:, s.VELOCITY_RPS] = velocity
        state = REST
        for k in range(velocity.size):
            state = friction_step(FRICTION, state, float(velocity[k]), 0.0, STEP_S)
            rows[k, s.FRICTION_NM], rows[k, s.TRAVEL_REV], rows[k, s.DIRECTION] = state[0], state[1], state[3]
        values = {"peak_nm": 0.02, "tau_s": 1.0, "release_rev": 0.05}
        load, _ = effects_along([Term("dwell_stiction", values)], rows, AXIS, STEP_S)
        assert np.ptp(load[1000 : 1000 + rest]) == 0.0  # nothing moves an axis at rest
        return load[1000 + rest :].max(), load[-1]

    short, long = peak(0.2), peak(3.0)
    assert 0.0 < short[0] < 0.4 * long[0]
    assert 0.007 < long[0] < 0.02  # it is released while friction still follows, over Fs/B of 0.03 rev
    assert long[1] < 0.2 * long[0]


def test_a_presliding_part_is_gone_in_sliding():
    load, _ = along("presliding_shape", {"torque_nm": 0.01, "length_ratio": 5.0})
    sliding = MOTION[:, s.TRAVEL_REV] > 0.1
    assert np.abs(load[~sliding]).max() > 0.004
    assert np.abs(load[sliding]).max() < 1e-5


def test_a_second_surface_builds_up_over_its_travel_and_follows_the_speed_over_its_memory():
    values = {"level_nm": 0.002, "rise_nm": 0.02, "travel_rev": 0.06, "speed_rps": 0.4, "memory_rev": 0.1}
    slow, fast = 0.2, 1.0
    speed = np.concatenate([np.full(2000, slow), np.full(2000, fast), np.full(2000, -fast)])
    rows = np.zeros((speed.size, s.N_MOTION))
    rows[:, s.VELOCITY_RPS] = speed
    load, _ = along("second_surface", values, rows)
    travel = np.cumsum(np.abs(speed)) * STEP_S
    built = 1.0 - np.exp(-travel / 0.06)
    m_slow, m_fast = (math.exp(-w / 0.4) for w in (slow, fast))
    assert np.allclose(load[:2000], built[:2000] * (0.002 + 0.02 * m_slow), rtol=1e-9)
    m = m_fast + (m_slow - m_fast) * np.exp(-(travel[2000:] - travel[1999]) / 0.1)
    assert np.allclose(load[2000:4000], built[2000:4000] * (0.002 + 0.02 * m[:2000]), rtol=1e-9)
    assert load[-1] == pytest.approx(-(0.002 + 0.02 * m_fast), rel=1e-3)


def test_two_masses_share_their_motion_at_low_frequency_and_part_at_resonance():
    values = {"share": 0.3, "frequency_hz": 40.0, "damping": 0.05}

    def response(frequency_hz):
        rows = np.zeros((8000, s.N_MOTION))
        time_s = np.arange(8000) * STEP_S
        rows[:, s.VELOCITY_RPS] = np.sin(TURN * frequency_hz * time_s)
        acceleration = TURN * frequency_hz * np.cos(TURN * frequency_hz * time_s)
        rows[:, s.CURRENT_A] = AXIS.inertia_nm_s2_per_rev * acceleration / 0.148
        load, _ = effects_along([Term("elasticity", values)], rows, AXIS, STEP_S)
        return np.abs(load[4000:]).max() / (AXIS.inertia_nm_s2_per_rev * np.abs(acceleration).max())

    assert response(1.0) < 0.01  # one body: nothing is taken away
    assert response(33.0) > 0.5  # where the load swings against the motor held in motion: sqrt(1 - share) of 40 Hz


def test_a_table_of_knots_is_drawn_with_straight_lines():
    values = {"count": 3.0, "x00": -2.0, "x01": 0.0, "x02": 2.0, "y00": -0.01, "y01": 0.0, "y02": 0.03}
    load, _ = along("unknown:velocity", values)
    expected = np.interp(MOTION[:, s.VELOCITY_RPS], [-2.0, 0.0, 2.0], [-0.01, 0.0, 0.03])
    assert np.allclose(load, expected, atol=1e-12)
    turned, _ = along("unknown:motor_angle", {**values, "x00": 0.0, "x01": 0.5, "x02": 1.0, "scale": 1.0})
    angle = MOTION[:, s.MOTOR_ANGLE_REV] % 1.0
    assert np.allclose(turned, np.interp(angle, [0.0, 0.5, 1.0], [-0.01, 0.0, 0.03]), atol=1e-9)


def test_a_table_can_be_friction_or_a_viscous_coefficient():
    values = {"count": 2.0, "x00": -9.0, "x01": 9.0, "y00": 0.02, "y01": 0.02}  # the same everywhere
    viscous, _ = along("unknown:current", {**values, "kind": 2.0})
    assert np.allclose(viscous, 0.02 * MOTION[:, s.VELOCITY_RPS], atol=1e-12)
    friction, _ = along("unknown:current", {**values, "kind": 1.0})
    sliding = np.abs(MOTION[:, s.FRICTION_NM]) > 0.9 * AXIS.friction.coulomb_nm
    assert np.abs(friction).max() <= 0.02 + 1e-12
    assert np.sign(friction[sliding]) == pytest.approx(np.sign(MOTION[sliding, s.FRICTION_NM]))


def test_a_memory_of_the_squared_current_warms_up_as_a_winding_does():
    rows = motion(2000)
    rows[:, s.CURRENT_A] = -3.0
    values = {"count": 2.0, "x00": 0.0, "x01": 100.0, "y00": 0.0, "y01": 100.0, "scale": 0.5, "of_current": 1.0}
    load, _ = effects_along([Term("unknown:memory", values)], rows, AXIS, STEP_S)
    time_s = np.arange(1, 2001) * STEP_S
    assert np.allclose(load, 9.0 * -np.expm1(-time_s / 0.5), rtol=1e-6)


def test_without_effects_the_loaded_axis_is_the_axis():
    command = np.ascontiguousarray(MOTION[:, s.CURRENT_A])
    plain, _ = simulate(AXIS, AxisState(0.0, 0.0, REST), command, STEP_S, 2)
    loaded, _ = simulate_with_effects(AXIS, [], AxisState(0.0, 0.0, REST), command, STEP_S, 2)
    assert np.allclose(loaded[:, :3], plain, rtol=1e-9, atol=1e-12)


def test_every_law_says_what_a_reader_and_a_search_need():
    for name, law in LAWS.items():
        assert law.name == name
        assert law.strengths
        assert set(law.per_run) <= {p.name for p in law.strengths}
        assert set(law.lookalikes) <= set(NAMES)
        assert all((law.meaning, law.experiment, law.regime))
        for shape in law.search(CONTEXT):
            assert not parameter_errors(name, {**{p.name: p.typical for p in law.shapes}, **shape})


def test_what_is_wrong_with_a_request_is_said():
    assert "did you mean 'cogging'" in (name_error("coging") or "")
    assert "did you mean 'velocity'" in (name_error("unknown:velocty") or "")
    assert name_error("unknown:dwell") is None
    wrong = dict(parameter_errors("cogging", {"cos_mn": 1.0, "order": -1.0}))
    assert "did you mean 'cos_nm'" in wrong["cos_mn"]
    assert "outside" in wrong["order"]
    assert "missing" in dict(parameter_errors("dwell_stiction", {"peak_nm": 0.01}))["tau_s"]
    assert is_compensable("cogging", {})
    assert not is_compensable("elasticity", {})
    assert not is_compensable("unknown:frequency", {})


def with_cogging(model, order=6.0):
    values = {"cos_nm": 0.004, "sin_nm": 0.0, "order": order}
    parameters = {key: Quantity(value=value, sd=1e-4, source="fitted") for key, value in values.items()}
    return model.model_copy(update={"effects": [EffectModel(name="cogging", parameters=parameters)]})


def test_a_model_file_carries_its_effects_and_they_are_in_its_hash(tmp_path, table_1):
    plain = read_model(table_1)
    loaded = with_cogging(plain)
    write_model(tmp_path / "model.yaml", loaded)
    again = read_model(tmp_path / "model.yaml")
    assert [effect.term() for effect in again.effects] == [
        Term("cogging", {"cos_nm": 0.004, "sin_nm": 0.0, "order": 6.0})
    ]
    assert effect_table([effect.term() for effect in again.effects], again.axis_config(), STEP_S).addresses.shape == (
        1,
    )
    assert len({content_hash(plain), content_hash(loaded), content_hash(with_cogging(plain, 7.0))}) == 3
    write_model(tmp_path / "plain.yaml", plain)
    assert "effects" not in (tmp_path / "plain.yaml").read_text()
    text = (tmp_path / "model.yaml").read_text().replace("name: cogging", "name: coging")
    (tmp_path / "wrong.yaml").write_text(text)
    with pytest.raises(DocumentError, match=r"effects\[0\].name: no effect is called 'coging'"):
        read_model(tmp_path / "wrong.yaml")


@pytest.fixture
def table_1(request):
    return request.config.rootpath / "configs" / "models" / "table1.yaml"
