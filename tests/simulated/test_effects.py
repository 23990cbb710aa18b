"""Each effect leaves the signature that it should in the residual of the axis without it, and nothing at zero."""

from __future__ import annotations

import numpy as np
import pytest
from simulated.plant_rig import (
    NO_FRICTION,
    exchange,
    fitted,
    friction_along,
    lively_current,
    quiet,
    record,
    residual,
    with_effects,
)

from fffo_drive.drive.simulated import state as at
from fffo_drive.drive.simulated.effects import slots
from fffo_drive.drive.simulated.effects.registry import EFFECTS
from fffo_drive.drive.simulated.pack import new_state, plant_parameters
from fffo_drive.drive.simulated.parameters import PlantConfig
from fffo_drive.drive.simulated.plant import plant_advance
from fffo_drive.drive.simulated.state import STEP_S
from fffo_drive.units import TWO_PI, inertia_nm_s2_per_rev

KT = 0.148
RATED_A = 8.3
INERTIA = inertia_nm_s2_per_rev(1.5e-4)
COMMANDS = lively_current(4.0)


def sine(order, angle, phase=0.0):
    return np.sin(TWO_PI * (order * angle + phase))


def turn_part(angle):
    return angle - np.floor(angle)


# torque that the effect adds (positive drives), as a function of the record: shape whose factor is expected to be 1
ADDED = {
    "torque_offset": ({"torque_nm": 0.01}, lambda r: np.full(r.time_s.size, 0.01)),
    "cogging": (
        {"amplitude_nm": 0.01, "order": 12.0, "phase_rev": 0.2},
        lambda r: 0.01 * sine(12.0, r.angle_rev, 0.2),
    ),
    "torque_ripple": (
        {"share": 0.1, "order": 6.0, "phase_rev": 0.25},
        lambda r: -0.1 * KT * r.current_a * sine(6.0, r.angle_rev),
    ),
    "unbalance": (
        {"amplitude_nm": 0.02, "phase_rev": 0.1},
        lambda r: 0.02 * sine(1.0, r.angle_rev / 160.0, 0.1),
    ),
    "periodic_disturbance": (
        {"amplitude_nm": 0.01, "frequency_hz": 7.3},
        lambda r: 0.01 * sine(7.3, r.time_s),
    ),
    "torque_saturation": (
        {"share": 1.0},
        lambda r: KT * r.current_a * (1.0 / (1.0 + (r.current_a / RATED_A) ** 2) - 1.0),
    ),
    "quadratic_drag": (
        {"drag_nm_per_rps2": 2e-4},
        lambda r: -2e-4 * r.velocity_rps * np.abs(r.velocity_rps),
    ),
    "odd_speed_band": (
        {"amplitude_nm": 0.01, "centre_rps": 4.0, "width_rps": 1.0},
        lambda r: -0.01 * np.sign(r.velocity_rps) * np.exp(-((np.abs(r.velocity_rps) - 4.0) ** 2)),
    ),
    "odd_direction_angle": (
        {"amplitude_nm": 0.01, "phase_rev": 0.0},
        lambda r: -0.01 * np.sign(r.velocity_rps) * np.cos(TWO_PI * r.angle_rev / 160.0),
    ),
    "odd_stick_patch": (
        {"amplitude_nm": 0.02, "centre_rev": 0.3, "width_rev": 0.2, "fades_rps": 2.0},
        lambda r: (
            -0.02
            * np.clip(r.velocity_rps / 0.02, -1, 1)
            / (1 + np.abs(r.velocity_rps) / 2.0)
            * (np.abs(turn_part(r.angle_rev - 0.3 + 0.5) - 0.5) < 0.1)
        ),
    ),
    "odd_eddy_brake": (
        {"brake_nm_per_rps": 0.05},
        lambda r: -0.05 * r.velocity_rps * (r.current_a / RATED_A) ** 2,
    ),
}

# scale of the friction level that the effect makes; the residual is then -(scale - 1) times the base contact torque
LEVELS = {
    "asymmetric_coulomb": ({"share": 0.3}, lambda r: 1 + 0.3 * np.sign(r.velocity_rps)),
    "coulomb_drift": (
        {"share": 0.6, "time_constant_s": 1.5},
        lambda r: 1 + 0.6 * (1 - np.exp(-r.time_s / 1.5)),
    ),
    "friction_ripple": (
        {"share": 0.3, "order": 2.0, "phase_rev": 0.25},
        lambda r: 1 - 0.3 * sine(2.0, r.angle_rev),
    ),
    "position_dependent_friction": (
        {"wave_share": 0.3, "window_share": 0.5, "period_rev": 3.0, "centre_rev": 1.0, "width_rev": 0.8},
        lambda r: (
            1
            + 0.3 * np.cos(TWO_PI * r.angle_rev / 3.0)
            + 0.5 * (np.abs(turn_part((r.angle_rev - 1.0) / 3.0 + 0.5) - 0.5) < 0.4 / 3.0)
        ),
    ),
    "odd_alternate_turns": (
        {"share": 0.5, "turns": 3.0},
        lambda r: 1 + 0.5 * (turn_part(r.angle_rev / 3.0) * 3.0 < 1.0),
    ),
    "odd_two_levels": ({"share": 0.5, "lifts_rps": 5.0, "lies_rps": 1.0}, None),
    "odd_fatigue": ({"share": 0.6, "travel_rev": 4.0, "recovery_s": 2.0}, None),
    "odd_current_heating": ({"share": 100.0, "time_constant_s": 1.0}, None),
}


def memory_scale(name, run):
    """Scales of effects with a memory, from their definition by a plain recursion."""
    scale = np.ones(run.time_s.size)
    m = 0.0
    for k, (w, i) in enumerate(zip(run.velocity_rps, run.current_a, strict=True)):
        if name == "odd_two_levels":
            m = 1.0 if abs(w) > 5.0 else 0.0 if abs(w) < 1.0 else m
            scale[k] = 1.0 if m else 1.5
        elif name == "odd_fatigue":
            m += (abs(w) / 4.0 * (1 - m) - m / 2.0) * STEP_S
            scale[k] = 1 - 0.6 * m
        else:
            m += ((i / RATED_A) ** 2 - m) * STEP_S
            scale[k] = 1 + 100.0 * m
    return scale


@pytest.mark.parametrize("name", ADDED)
def test_a_torque_effect_adds_the_torque_of_its_formula(name):
    values, formula = ADDED[name]
    config = quiet()
    run = record(with_effects(config, (name, values)), COMMANDS)
    assert np.abs(run.velocity_rps).max() > 4.0
    left = residual(config, run)
    factor, correlation = fitted(formula(run), -left)
    assert factor == pytest.approx(1.0, abs=1e-3)
    assert correlation == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("name", LEVELS)
def test_a_level_effect_scales_the_contact_torque(name):
    values, formula = LEVELS[name]
    config = quiet()
    run = record(with_effects(config, (name, values)), COMMANDS)
    contact_nm = friction_along(config.friction, run.velocity_rps)
    contact_nm -= config.friction.viscous_nm_per_rps * run.velocity_rps
    scale = memory_scale(name, run) if formula is None else formula(run)
    # while the contacts are being stretched after a reversal they know nothing of a level
    sliding = np.abs(run.velocity_rps) > 0.8
    factor, correlation = fitted(((scale - 1.0) * contact_nm)[sliding], residual(config, run)[sliding])
    assert factor == pytest.approx(1.0, abs=0.12)
    assert correlation > 0.93


def test_asymmetric_viscous_friction_is_even_in_speed():
    config = quiet()
    run = record(with_effects(config, ("asymmetric_viscous", {"share": 0.4})), COMMANDS)
    factor, correlation = fitted(np.abs(run.velocity_rps), residual(config, run))
    assert factor == pytest.approx(0.4 * config.friction.viscous_nm_per_rps, rel=1e-3)
    assert correlation > 0.999


def test_viscous_drift_grows_with_time():
    config = quiet()
    run = record(with_effects(config, ("viscous_drift", {"share": 1.0, "time_constant_s": 2.0})), COMMANDS)
    shape = run.velocity_rps * (1 - np.exp(-run.time_s / 2.0))
    factor, correlation = fitted(shape, residual(config, run))
    assert factor == pytest.approx(config.friction.viscous_nm_per_rps, rel=1e-3)
    assert correlation > 0.999


def test_thermal_drift_follows_the_work_of_friction():
    config = quiet()
    values = {"per_k": -0.02, "k_per_w": 40.0, "time_constant_s": 2.0}
    run = record(with_effects(config, ("thermal_drift", values)), np.full(16_000, 0.6))
    power_w = TWO_PI * run.friction_nm[-1] * run.velocity_rps[-1]
    expected = np.exp(-0.02 * 40.0 * power_w) - 1.0
    left = residual(config, run)[-1] / (config.friction.viscous_nm_per_rps * run.velocity_rps[-1])
    assert left == pytest.approx(expected, rel=0.05)


def test_load_dependent_friction_follows_the_motor_torque():
    config = quiet()
    run = record(with_effects(config, ("load_dependent_friction", {"share": 0.3})), COMMANDS)
    sliding = np.abs(run.velocity_rps) > 1.0
    shape = np.sign(run.velocity_rps) * np.abs(run.torque_nm)
    factor, correlation = fitted(shape[sliding], residual(config, run)[sliding])
    assert factor == pytest.approx(0.3, rel=0.2)
    assert correlation > 0.95


def test_dwell_raises_the_break_away_torque_with_the_time_at_rest():
    """Break away after rests of 0.2, 2 and 20 s, by the same ramp: peaks rise as 1 - exp(-t/tau)."""
    config = with_effects(quiet(), ("dwell_stiction", {"rise_share": 0.8, "time_constant_s": 3.0}))
    ramp = np.linspace(0.0, 1.2, 2400)
    peaks = []
    for rest_s in (0.2, 2.0, 20.0):
        run = record(config, np.concatenate([np.zeros(round(rest_s * 2000)), ramp]))
        moving = np.argmax(run.velocity_rps > 1.0)
        peaks.append(run.friction_nm[: moving + 1].max())
    plain = record(quiet(), ramp)
    free = plain.friction_nm[: np.argmax(plain.velocity_rps > 1.0) + 1].max()
    rise = np.array(peaks) / free - 1.0
    assert np.all(np.diff(rise) > 0.1)
    # the ramp itself takes some tenths of a second, and the first travel eats some of the adhesion
    assert 0.5 < rise[2] / 0.8 < 1.05
    assert rise[0] < 0.35


def test_dead_zone_takes_its_width_from_the_current():
    config = with_effects(quiet(), ("dead_zone", {"width_a": 0.2}))
    run = record(config, np.repeat([0.15, -0.15, 1.0, -1.0], 200))
    ends = run.current_a[2199::2200]
    assert ends == pytest.approx([0.0, 0.0, 0.8, -0.8], abs=1e-3)


def test_current_lag_is_a_first_order_lag():
    step = np.full(200, 1.0)
    plain = record(quiet(friction=NO_FRICTION), step).current_a
    lagged = record(with_effects(quiet(friction=NO_FRICTION), ("current_lag", {"time_constant_s": 0.01})), step)
    assert (plain - lagged.current_a).sum() * STEP_S == pytest.approx(0.01, rel=1e-3)


def test_extra_delay_shifts_the_whole_answer():
    commands = lively_current(0.5)
    plain = record(quiet(friction=NO_FRICTION), commands)
    late = record(with_effects(quiet(friction=NO_FRICTION), ("delay", {"delay_s": 0.004})), commands)
    # 4 ms are 88 sub-steps, and the controller's update falls on even ones
    assert late.velocity_rps[88:] == pytest.approx(plain.velocity_rps[:-88], abs=1e-9)


def test_a_weak_supply_lowers_the_top_speed_in_proportion():
    weak = with_effects(quiet(friction=NO_FRICTION), ("voltage_limit", {"drop_share": 0.5}))
    speeds = [record(c, np.full(6000, 8.0)).velocity_rps[-1] for c in (quiet(friction=NO_FRICTION), weak)]
    assert speeds[1] / speeds[0] == pytest.approx(0.5, rel=1e-3)


def test_stribeck_shape_changes_low_speeds_only():
    config = quiet()
    changed = with_effects(config, ("stribeck_shape", {"rise_share": 0.5, "velocity_share": 0.0})).prepared()
    for speed, more in ((0.02, 0.5), (15.0, 0.0)):
        w = np.full(round(0.4 / (speed * STEP_S)), speed)
        a, b = (friction_along(c.friction, w)[-1] for c in (config, changed))
        rise = config.friction.stiction_nm - config.friction.coulomb_nm
        assert (b - a) / rise == pytest.approx(more, abs=0.03)


def test_presliding_shape_changes_the_first_travel_only():
    config = quiet()
    soft = with_effects(config, ("presliding_shape", {"stiffness_share": -0.5})).prepared()
    w = np.full(400_000, 0.05)
    a, b = (friction_along(c.friction, w) - config.friction.viscous_nm_per_rps * w for c in (config, soft))
    assert b[1] / a[1] == pytest.approx(0.5, rel=0.01)
    assert b[-1] == pytest.approx(a[-1], rel=1e-3)


def test_frictional_lag_stretches_the_way_to_the_stribeck_curve():
    config = quiet()
    slow = with_effects(config, ("frictional_lag", {"length_share": 3.0})).prepared()
    ways = []
    for c in (config, slow):
        state = new_state(c).friction
        friction_along(c.friction, np.full(22_000, 8.0), STEP_S, state)
        torque = friction_along(c.friction, np.full(150_000, 0.3), STEP_S, state)
        ways.append(np.argmax(torque > torque[0] + 0.6 * (torque[-1] - torque[0])))
    assert ways[1] > 1.5 * ways[0]


@pytest.mark.parametrize(("share", "frequency_hz"), [(0.4, 45.0), (0.2, 120.0)])
def test_elasticity_rings_at_its_resonance_and_keeps_the_momentum(share, frequency_hz):
    values = {"load_share": share, "frequency_hz": frequency_hz, "damping": 0.01}
    config = with_effects(quiet(friction=NO_FRICTION), ("elasticity", values))
    kick = np.concatenate([np.full(4, 4.0), np.zeros(4000)])
    run = record(config, kick)
    impulse = np.sum(run.torque_nm) * STEP_S
    ringing = run.velocity_rps[3000:] - impulse / INERTIA
    spectrum = np.abs(np.fft.rfft(ringing * np.hanning(ringing.size)))
    peak_hz = np.argmax(spectrum[10:]) + 10
    assert peak_hz / (ringing.size * STEP_S) == pytest.approx(frequency_hz, rel=0.03)
    # in the end both masses turn together: the whole inertia has taken the whole impulse
    assert run.velocity_rps[-4000:].mean() == pytest.approx(impulse / INERTIA, rel=1e-2)


def test_backlash_frees_the_motor_of_its_load_inside_the_gap():
    values = {"gap_rev": 0.05, "load_share": 0.4, "friction_share": 0.0, "contact_hz": 250.0}
    config = with_effects(quiet(friction=NO_FRICTION), ("backlash", values))
    run = record(config, np.full(1000, 0.5))
    acceleration = (run.next_rps - run.velocity_rps) / STEP_S
    free = (run.angle_rev < 0.024) & (run.current_a > 0.4999)
    assert acceleration[free] == pytest.approx(np.full(free.sum(), KT * 0.5 / (0.6 * INERTIA)), rel=2e-3)
    assert acceleration[-2000:].mean() == pytest.approx(KT * 0.5 / INERTIA, rel=1e-3)


def test_backlash_keeps_the_load_within_the_gap_and_lets_go_of_it_there():
    values = {"gap_rev": 0.1, "load_share": 0.2, "friction_share": 0.4}
    config = with_effects(quiet(), ("backlash", values))
    parameters, state = plant_parameters(config), new_state(config)
    leads, misses = [], []
    for command_a in np.tile(np.repeat([0.55, -0.55], 600), 3):
        plant_advance(parameters, state, command_a, 10)
        before_rps, lead_rev = state.values[at.VELOCITY_RPS], state.effect_memory[0, 1]
        plant_advance(parameters, state, command_a, 1)
        acceleration = (state.values[at.VELOCITY_RPS] - before_rps) / STEP_S
        # torque that the motor's own share of the inertia and of the friction does not account for: the load's
        torque_nm = state.values[at.TORQUE_NM] - state.values[at.FRICTION_NM] - 0.8 * INERTIA * acceleration
        leads.append(lead_rev)
        misses.append(torque_nm)
    leads, misses = np.array(leads), np.array(misses)
    free = np.abs(leads) < 0.0499
    assert 100 < free.sum() < 2400
    assert np.abs(misses[free]).max() < 1e-9
    assert np.abs(misses[~free]).mean() > 0.005
    assert leads.max() == pytest.approx(0.05, rel=0.1)
    assert leads.min() == pytest.approx(-0.05, rel=0.1)


def test_a_resolver_error_is_seen_in_the_position_and_not_felt_by_the_shaft():
    values = {"first_rev": 0.002, "first_phase_rev": 0.1, "second_rev": 0.001, "second_phase_rev": 0.0}
    commands = np.full(4000, 0.6)
    plain, wrong = record(quiet(), commands), record(with_effects(quiet(), ("resolver_error", values)), commands)
    assert np.array_equal(plain.velocity_rps, wrong.velocity_rps)
    slow = (plain.velocity_rps > 0.5) & (plain.velocity_rps < 8.0)
    angle = plain.next_rev
    expected = 0.002 * np.cos(TWO_PI * (angle + 0.1)) + 0.001 * np.cos(TWO_PI * 2 * angle)
    seen = wrong.tracked_rev - plain.tracked_rev
    assert seen[slow] == pytest.approx(expected[slow], abs=2e-4)


def test_a_resolver_error_makes_a_velocity_error_that_grows_with_speed():
    values = {"first_rev": 0.002, "second_rev": 0.0}
    sizes = []
    for current_a in (0.48, 0.65):
        config = with_effects(quiet(), ("resolver_error", values))
        rows = exchange(config, np.full(8000, current_a))[6000:]
        sizes.append((rows[:, 0] - rows[:, 3]).std() / rows[:, 3].mean())
    assert sizes[0] == pytest.approx(0.002 * TWO_PI / np.sqrt(2), rel=0.05)
    assert sizes[1] == pytest.approx(sizes[0], rel=0.05)


def test_a_late_kick_comes_after_its_travel_and_only_once():
    values = {"amplitude_nm": 0.02, "after_rev": 0.5, "width_rev": 0.1}
    config = quiet()
    run = record(with_effects(config, ("odd_late_kick", values)), np.concatenate([np.full(3000, 0.6)]))
    left = residual(config, run)
    hit = np.abs(run.angle_rev - 0.5) < 0.1
    expected = np.where(hit, 0.02 * (1 - ((run.angle_rev - 0.5) / 0.1) ** 2), 0.0)
    factor, correlation = fitted(expected, left)
    assert factor == pytest.approx(1.0, abs=0.02)
    assert correlation > 0.999


def test_a_cable_pulls_back_and_slips_at_its_reach():
    config = quiet()
    run = record(with_effects(config, ("odd_cable", {"torque_nm": 0.02, "reach_rev": 1.0})), np.full(3000, 0.7))
    left = residual(config, run)
    pull = 0.02 * np.clip(run.angle_rev, -1.0, 1.0)
    factor, correlation = fitted(pull, left)
    assert factor == pytest.approx(1.0, abs=1e-3)
    assert correlation > 0.9999


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_of_zero_strength_is_no_effect_to_the_last_bit(name):
    zero = {p.name: 0.0 for p in EFFECTS[name].parameters if p.strength}
    plain = plant_parameters(PlantConfig())
    without = plant_parameters(with_effects(PlantConfig(), (name, zero)))
    for a, b in zip(plain, without, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("name", [n for n, e in EFFECTS.items() if e.kernel is not None and n != "backlash"])
def test_an_effect_fades_out_with_its_strength(name):
    """A billionth of the default strength moves the shaft by next to nothing, at any stage."""
    tiny = {p.name: 1e-9 * p.default for p in EFFECTS[name].parameters if p.strength}
    commands = COMMANDS[:1000]
    plain = record(quiet(), commands)
    run = record(with_effects(quiet(), (name, tiny)), commands)
    assert run.velocity_rps == pytest.approx(plain.velocity_rps, abs=1e-4)
    assert run.tracked_rev == pytest.approx(plain.tracked_rev, abs=1e-5)


def test_effects_add_up_in_any_number_and_any_order_of_configuration():
    several = [(name, {}) for name in ("cogging", "quadratic_drag", "resolver_error", "dead_zone", "friction_ripple")]
    a = record(with_effects(quiet(), *several), COMMANDS[:2000])
    b = record(with_effects(quiet(), *reversed(several)), COMMANDS[:2000])
    assert a.velocity_rps == pytest.approx(b.velocity_rps, abs=1e-9)
    twice = with_effects(quiet(), ("cogging", {"order": 4.0}), ("cogging", {"order": 12.0}))
    run = record(twice, COMMANDS)
    shape = 0.008 * (sine(4.0, run.angle_rev) + sine(12.0, run.angle_rev))
    assert fitted(shape, -residual(quiet(), run))[0] == pytest.approx(1.0, abs=1e-3)


def test_all_effects_at_once_keep_the_plant_finite():
    config = with_effects(quiet(), *((name, {}) for name in EFFECTS if name != "backlash"))
    assert len(plant_parameters(config).effects) == sum(e.kernel is not None for e in EFFECTS.values()) - 1
    run = record(config, COMMANDS)
    assert np.isfinite(run.velocity_rps).all()
    assert np.abs(run.velocity_rps).max() < 60.0


def test_every_row_of_the_registry_is_complete():
    for effect in EFFECTS.values():
        assert effect.description
        assert effect.stage in slots.STAGE_NAMES
        assert (effect.kernel is None) == (effect.stage == slots.PREPARED)
        assert 0 < len(effect.parameters) <= slots.MAX_PARAMETERS
        assert any(p.strength for p in effect.parameters)
        for p in effect.parameters:
            assert p.low <= p.default <= p.high
            assert not p.strength or p.low <= 0.0 <= p.high
