"""The plant's own friction: levels, passivity, presliding, memory, and the 2SEP surface against an ODE solver."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from simulated.plant_rig import friction_along

from fffo_drive.drive.simulated import friction
from fffo_drive.drive.simulated.pack import new_state, plant_parameters
from fffo_drive.drive.simulated.parameters import PlantConfig
from fffo_drive.drive.simulated.state import STEP_S
from fffo_drive.drive.simulated.surfaces import PlantFriction, SingleSurface

FIVE = PlantFriction()
SINGLE = PlantFriction(kind="single_2sep")
KINDS = pytest.mark.parametrize("config", [FIVE, SINGLE], ids=["five", "single"])
CONTACTS = friction.CONTACT_NM


def table_one(speed_rps: float) -> float:
    return 0.025 + 0.042 * math.exp(-((speed_rps / 0.733) ** 1.07)) + 0.003 * speed_rps


def rough_motion(seed: int, n: int = 40_000, peak_rps: float = 8.0) -> np.ndarray:
    """A velocity with reversals on every scale."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * STEP_S
    w = sum(rng.normal() / (1 + k) * np.sin(2 * np.pi * 0.7 * 1.9**k * t + rng.uniform(0, 6.28)) for k in range(9))
    return peak_rps * w / np.abs(w).max()


def test_the_five_surfaces_add_up_to_the_levels_of_table_one():
    assert pytest.approx(0.025, rel=0.15) == FIVE.coulomb_nm
    assert pytest.approx(0.067, rel=0.05) == FIVE.stiction_nm
    assert pytest.approx(0.003, rel=0.15) == FIVE.viscous_nm_per_rps


@KINDS
@pytest.mark.parametrize("speed_rps", [0.02, 0.2, 0.733, 2.0, 5.0, 15.0])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_steady_sliding_ends_on_the_stribeck_curve(config, speed_rps, direction):
    n = max(2000, round(0.6 / (speed_rps * STEP_S)))
    torque_nm = friction_along(config, np.full(n, direction * speed_rps))
    assert direction * torque_nm[-1] == pytest.approx(table_one(speed_rps), rel=0.09)
    if config is SINGLE:
        assert direction * torque_nm[-1] == pytest.approx(table_one(speed_rps), rel=1e-6)


@KINDS
@pytest.mark.parametrize("seed", range(5))
def test_friction_never_gives_back_more_than_its_contacts_can_store(config, seed):
    w = rough_motion(seed)
    work_j = np.cumsum(friction_along(config, w) * w) * STEP_S
    table = plant_parameters(PlantConfig(friction=config)).friction
    if config is FIVE:
        levels = table[:, friction.COULOMB_NM] + table[:, friction.RISE_NM]
        stored_j = float(np.sum(levels * levels / (2 * table[:, friction.STIFFNESS])))
    else:
        stored_j = 0.067**2 / (2 * 0.025 * 778)
    # from any moment on, the work that comes back is at most what was stored at that moment
    assert np.max(np.maximum.accumulate(work_j) - work_j) <= stored_j
    assert work_j[-1] > 10 * stored_j


def test_a_single_contact_passes_its_energy_on_exactly():
    """Elastic, sliding, unloading: work done on a contact is its elastic energy plus what sliding dissipates (>= 0)."""
    one = replace(FIVE, surfaces=(replace(FIVE.surfaces[0], viscous_nm_per_rps=0.0),))
    table = plant_parameters(PlantConfig(friction=one)).friction
    w = rough_motion(11, peak_rps=0.4)
    state = new_state(PlantConfig(friction=one)).friction
    contact_nm = friction_along(one, w, STEP_S, state)
    before_nm = np.concatenate(([0.0], contact_nm[:-1]))
    energy_j = (contact_nm**2 - before_nm**2) / (2 * table[0, friction.STIFFNESS])
    dissipated_j = 0.5 * (contact_nm + before_nm) * w * STEP_S - energy_j
    assert dissipated_j.min() > -1e-12


@KINDS
def test_presliding_saturates_within_several_degrees_of_the_motor(config):
    slow = 0.02
    settled = friction_along(config, np.full(30 * 22_000, slow))[-1]
    state = new_state(PlantConfig(friction=config)).friction
    friction_along(config, np.full(30 * 22_000, slow), STEP_S, state)
    back = friction_along(config, np.full(10 * 22_000, -slow), STEP_S, state)
    travel_deg = np.arange(1, back.size + 1) * STEP_S * slow * 360.0
    share = (settled - back) / (2 * settled)
    assert share[np.searchsorted(travel_deg, 0.05)] < 0.2
    assert share[np.searchsorted(travel_deg, 15.0)] > 0.75
    assert share[np.searchsorted(travel_deg, 45.0)] > 0.93


@KINDS
def test_a_periodic_motion_in_presliding_settles_to_a_closed_loop_without_drift(config):
    """0.3 degrees to and fro round a preload: the mean torque stays, and no torque builds up."""
    period = 2200
    w = 2 * np.pi * 10 * (0.3 / 360) * np.cos(2 * np.pi * np.arange(60 * period) / period)
    torque_nm = friction_along(config, w)
    assert np.abs(torque_nm[-period:] - torque_nm[-2 * period : -period]).max() < 1e-4
    assert np.abs(torque_nm).max() < 0.068


@KINDS
def test_friction_is_held_at_standstill(config):
    state = new_state(PlantConfig(friction=config)).friction
    last = friction_along(config, np.full(200, 0.3), STEP_S, state)[-1]
    held = friction_along(config, np.zeros(1000), STEP_S, state)
    viscous = 0.0 if config is SINGLE else config.viscous_nm_per_rps * 0.3
    assert held == pytest.approx(last - viscous, abs=1e-15)


@KINDS
def test_friction_lags_behind_speed_while_sliding(config):
    """A speed that varies about a bias without reversal draws a loop: friction is higher while the axis speeds up."""
    t = np.arange(5 * 22_000) * STEP_S
    for frequency_hz, least in ((0.05, 0.0), (4.0, 1e-3)):
        w = 0.6 + 0.5 * np.sin(2 * np.pi * frequency_hz * t)
        torque_nm = friction_along(config, w)[-round(22_000 / min(frequency_hz, 1.0) * 0.2) :]
        speed = w[-torque_nm.size :]
        rising = np.gradient(speed) > 0
        near = np.abs(speed - 0.6) < 0.1
        if frequency_hz > 1:
            assert torque_nm[near & rising].mean() - torque_nm[near & ~rising].mean() > least


@KINDS
def test_the_break_away_peak_depends_on_how_fast_the_torque_rises(config):
    """The level builds up with travel: a fast start leaves the low speeds before the stiction is there."""
    peaks = []
    state = new_state(PlantConfig(friction=config)).friction
    friction_along(config, np.full(22_000, -8.0), STEP_S, state)  # run: the rise is gone
    for acceleration in (0.3, 300.0):
        w = np.arange(22_000) * STEP_S * acceleration
        torque_nm = friction_along(config, w[w < 12.0], STEP_S, state.copy())
        peaks.append(np.max(torque_nm - 0.003 * w[w < 12.0]))
    assert peaks[0] > peaks[1] + 0.005


@KINDS
def test_the_result_hardly_depends_on_the_step(config):
    coarse = rough_motion(3, 8000)
    fine = np.repeat(coarse, 8)
    a = friction_along(config, coarse, STEP_S)
    b = friction_along(config, fine, STEP_S / 8)[7::8]
    assert np.sqrt(np.mean((a - b) ** 2)) < 0.02 * np.sqrt(np.mean(b**2))


def test_a_contact_converges_to_the_solution_of_its_differential_equation():
    """Loading from rest at 0.05 rps: dz/dt = k w (1 - alpha(z/g) z/g), g constant; the error halves with the step."""
    level_nm, share, stiffness = 0.01, 0.2, 15.0
    surface = replace(
        FIVE.surfaces[0], coulomb_nm=level_nm, stiction_nm=level_nm, viscous_nm_per_rps=0.0,
        stiffness_nm_per_rev=stiffness, elastic_share=share,
    )  # fmt: skip
    one = replace(FIVE, surfaces=(surface,))

    def slope(_, z_nm):
        y = min(1.0, max(0.0, (z_nm[0] / level_nm - share) / (1.0 - share)))
        return [stiffness * 0.05 * (1.0 - y * y * (3.0 - 2.0 * y) * z_nm[0] / level_nm)]

    step_s = 1e-3
    times_s = np.arange(1, 41) * step_s
    solved_nm = solve_ivp(slope, (0.0, times_s[-1]), [0.0], t_eval=times_s, rtol=1e-10, atol=1e-14).y[0]
    errors_nm = []
    for parts in (1, 2, 4):
        along_nm = friction_along(one, np.full(40 * parts, 0.05), step_s / parts)[parts - 1 :: parts]
        errors_nm.append(np.abs(along_nm - solved_nm).max())
    assert errors_nm[0] < 0.02 * level_nm
    assert errors_nm[1] / errors_nm[0] == pytest.approx(0.5, abs=0.1)
    assert errors_nm[2] / errors_nm[1] == pytest.approx(0.5, abs=0.1)


def test_no_stiffness_is_too_stiff():
    """A thousand times stiffer, at 50 rps: bounded by the level, no oscillation."""
    stiff = FIVE.scaled(stiffness=1000.0)
    w = np.where(np.arange(8000) // 1000 % 2 == 0, 50.0, -50.0)
    contact_nm = friction_along(stiff, w) - stiff.viscous_nm_per_rps * w
    assert np.abs(contact_nm).max() <= stiff.stiction_nm * (1 + 1e-12)
    assert np.abs(np.diff(contact_nm[500:999])).max() < 1e-6


def test_the_single_surface_solves_the_differential_equation_of_the_notes():
    """dF/dt = dz1/dt + B w - (B|w|/|S|) F with dz1/dt = Omega K |w| exp(-K x), after a reversal at F(t_r)."""
    one = SingleSurface()
    k, b = one.stiffness_per_rev, one.attraction_nm_per_rev
    for direction, start_nm, speed in ((1.0, 0.0, 0.3), (1.0, -0.06, 0.05), (-1.0, 0.06, 6.0)):
        omega = direction * max(0.0, one.coulomb_nm - direction * start_nm)
        level = table_one(speed)
        n = 400

        def rhs(t, f, omega=omega, speed=speed, level=level, direction=direction):
            return omega * k * speed * math.exp(-k * speed * t) + b * direction * speed - b * speed / level * f

        truth = solve_ivp(rhs, (0, n * STEP_S), [start_nm], rtol=1e-10, atol=1e-13, dense_output=True)
        state = new_state(PlantConfig(friction=SINGLE)).friction
        state[0, friction.FRICTION_NM] = start_nm
        state[0, friction.DIRECTION] = -direction
        torque_nm = friction_along(SINGLE, np.full(n, direction * speed), STEP_S, state)
        assert torque_nm == pytest.approx(truth.sol(np.arange(1, n + 1) * STEP_S)[0], abs=2e-9)


def test_the_single_surface_does_not_ratchet_when_it_dithers():
    """The clipped Omega: from Fs, reversals of a thousandth of a degree neither raise nor drop the torque."""
    state = new_state(PlantConfig(friction=SINGLE)).friction
    start = friction_along(SINGLE, np.full(200_000, 0.01), STEP_S, state)[-1]
    dither = np.tile([0.06, -0.06], 20_000)
    torque_nm = friction_along(SINGLE, dither, STEP_S, state)
    assert start > 0.06
    assert np.abs(torque_nm).max() <= start + 1e-9


def test_equal_rates_of_both_states_are_no_division_by_zero():
    """b = K exactly: B/|S| equal to K."""
    one = SingleSurface(stiction_nm=0.025, coulomb_nm=0.025, viscous_nm_per_rps=0.0, stiffness_per_rev=2.33 / 0.025)
    torque_nm = friction_along(PlantFriction("single_2sep", single=one), np.full(4000, 0.5))
    x = np.arange(1, 4001) * STEP_S * 0.5 * 2.33 / 0.025
    assert torque_nm == pytest.approx(0.025 * (1 - np.exp(-x) + x * np.exp(-x)), abs=1e-12)
