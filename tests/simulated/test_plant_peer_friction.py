"""LuGre and Maxwell slip friction of the plant: steady curve, stiffness at rest, memory of reversals, dissipation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from simulated.plant_rig import friction_along
from simulated.test_plant_friction import rough_motion

from fffo_drive.drive.simulated.parameters import PlantConfig, PlantConfigError
from fffo_drive.drive.simulated.state import STEP_S
from fffo_drive.drive.simulated.surfaces import Lugre, MaxwellSlip, PlantFriction, SlipElement

LUGRE = PlantFriction(kind="lugre")
SLIP = PlantFriction(kind="maxwell_slip")
TWO_ELEMENTS = MaxwellSlip(
    0.02, 0.02, 0.0, attraction_nm_per_s=50.0, elements=(SlipElement(0.5, 8.0), SlipElement(0.5, 2.0))
)


def stribeck_nm(friction: Lugre | MaxwellSlip, speed_rps: float) -> float:
    """Steady friction."""
    fading = math.exp(-((speed_rps / friction.stribeck_rps) ** friction.stribeck_exponent))
    level_nm = friction.coulomb_nm + (friction.stiction_nm - friction.coulomb_nm) * fading
    return level_nm + friction.viscous_nm_per_rps * speed_rps


@pytest.mark.parametrize("config", [LUGRE, SLIP], ids=["lugre", "maxwell slip"])
@pytest.mark.parametrize("velocity_rps", [0.05, 0.7, -0.7, 6.0])
def test_a_long_motion_ends_on_the_stribeck_curve(config, velocity_rps):
    torque_nm = friction_along(config, np.full(40_000, velocity_rps))
    expected_nm = math.copysign(stribeck_nm(config.lugre, abs(velocity_rps)), velocity_rps)
    assert torque_nm[-1] == pytest.approx(expected_nm, rel=1e-4)


@pytest.mark.parametrize(
    ("config", "stiffness"),
    [
        (LUGRE, LUGRE.lugre.stiffness_nm_per_rev),
        (SLIP, sum(e.stiffness_nm_per_rev for e in SLIP.maxwell_slip.elements)),
    ],
    ids=["lugre", "maxwell slip"],
)
def test_the_first_travel_meets_the_stiffness_of_the_contact(config, stiffness):
    bare = replace(config, lugre=replace(config.lugre, damping_nm_per_rps=0.0, viscous_nm_per_rps=0.0),
                   maxwell_slip=replace(config.maxwell_slip, viscous_nm_per_rps=0.0))  # fmt: skip
    torque_nm = friction_along(bare, np.full(20, 0.001))
    assert torque_nm[-1] / (20 * 0.001 * STEP_S) == pytest.approx(stiffness, rel=1e-3)


@pytest.mark.parametrize("config", [LUGRE, SLIP], ids=["lugre", "maxwell slip"])
def test_a_closed_path_takes_energy(config):
    time_s = np.arange(200_000) * STEP_S
    for amplitude_rps in (0.002, 0.05, 2.0):
        velocity_rps = amplitude_rps * np.sin(2.0 * np.pi * time_s / (100_000 * STEP_S))
        torque_nm = friction_along(config, velocity_rps)
        assert np.sum((torque_nm * velocity_rps)[100_000:]) > 0.0  # the second turn of a settled loop


def test_lugre_is_the_solution_of_its_equation():
    friction = replace(Lugre(), stribeck_rps=1e3, stiction_nm=0.025)  # level and damping do not depend on speed

    def slope(_time_s, z):
        return velocity_rps - friction.stiffness_nm_per_rev * abs(velocity_rps) / friction.coulomb_nm * z

    z = 0.0
    torque_nm = []
    for velocity_rps in (0.4, -0.1):
        solved = solve_ivp(slope, (0.0, 400 * STEP_S), [z], rtol=1e-10, atol=1e-14)
        z = float(solved.y[0, -1])
        bristles = friction.damping_nm_per_rps * slope(0.0, z) + friction.viscous_nm_per_rps * velocity_rps
        torque_nm.append(friction.stiffness_nm_per_rev * z + bristles)
    path_rps = np.repeat([0.4, -0.1], 400)
    found_nm = friction_along(PlantFriction(kind="lugre", lugre=friction), path_rps)
    assert found_nm[[399, 799]] == pytest.approx(torque_nm, rel=2e-3)


def test_a_loop_inside_a_loop_closes_as_masing_says():
    """Springs that slip remember each reversal: back where an inner loop began, the outer one goes on as before."""
    config = PlantFriction(kind="maxwell_slip", maxwell_slip=TWO_ELEMENTS)
    step_rev = 2e-5
    moves = [400, -60, 60, 40]  # steps of the virgin curve, an inner loop back to where it began, and further
    path_rps = np.concatenate([np.full(abs(n), np.sign(n) * step_rev / STEP_S) for n in moves])
    torque_nm = friction_along(config, path_rps)
    straight_nm = friction_along(config, np.full(440, step_rev / STEP_S))
    assert torque_nm[519] == pytest.approx(straight_nm[399], abs=1e-12)
    assert torque_nm[-1] == pytest.approx(straight_nm[-1], abs=1e-12)
    # Masing: a branch after a reversal is the virgin curve at twice its scale
    branch_nm = straight_nm[399] - torque_nm[400:460]
    virgin_nm = friction_along(config, np.full(30, step_rev / STEP_S))
    assert branch_nm[1::2] == pytest.approx(2.0 * virgin_nm, abs=1e-12)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("config", [LUGRE, SLIP], ids=["lugre", "maxwell slip"])
def test_no_more_energy_comes_back_than_the_springs_hold(config, seed):
    """Along any motion, from any moment on; at the level of rest, the highest one."""
    w = rough_motion(seed)
    work_j = np.cumsum(friction_along(config, w) * w) * STEP_S
    if config is LUGRE:
        stored_j = config.stiction_nm**2 / (2.0 * config.lugre.stiffness_nm_per_rev)
    else:
        elements = config.maxwell_slip.elements
        stored_j = sum((e.share * config.stiction_nm) ** 2 / (2.0 * e.stiffness_nm_per_rev) for e in elements)
    assert np.max(np.maximum.accumulate(work_j) - work_j) <= stored_j
    assert work_j[-1] > 10.0 * stored_j


def test_the_damping_of_lugre_bristles_is_within_what_keeps_the_model_passive():
    """s1 |v| <= 4 g(v): v F is then the rate of the spring energy and a square, never negative (Olsson, 1996)."""
    one = LUGRE.lugre
    for speed_rps in np.geomspace(1e-3, 100.0, 200):
        level_nm = stribeck_nm(one, speed_rps) - one.viscous_nm_per_rps * speed_rps
        fading = math.exp(-((speed_rps / one.stribeck_rps) ** 2))
        assert one.damping_nm_per_rps * fading * speed_rps <= 4.0 * level_nm


def test_stiction_below_the_coulomb_level_is_refused_by_key():
    for kind in ("lugre", "maxwell_slip"):
        low = replace(getattr(PlantFriction(), kind), stiction_nm=0.01)
        with pytest.raises(PlantConfigError, match=rf"friction.{kind}.stiction_nm: 0.01 is below coulomb_nm 0.025"):
            replace(PlantConfig(), friction=replace(PlantFriction(), **{kind: low})).validate()


def test_shares_that_are_not_the_whole_are_refused_by_key():
    lame = replace(SLIP, maxwell_slip=replace(SLIP.maxwell_slip, elements=(SlipElement(0.5, 1.0),)))
    with pytest.raises(PlantConfigError, match=r"friction.maxwell_slip.elements: their shares add up to 0.5"):
        replace(PlantConfig(), friction=lame).validate()
