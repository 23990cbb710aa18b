"""PI+FFFO+ beyond its defaults: the peers' loop is the loop, the margins stay, two surfaces are found again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.control.compensation import PortableEffects
from fffo_drive.control.controller import ControllerConfig
from fffo_drive.control.stability import LinearAxis, loop_margins
from fffo_drive.evaluation.campaign import Candidate, Case, simulate
from fffo_drive.evaluation.peers.campaign import plus_of
from fffo_drive.evaluation.peers.fit import (
    LUGRE_START,
    SLIP_START,
    TABLE_1,
    TwoSurfaces,
    fit_two_surfaces,
    friction_along,
)
from fffo_drive.evaluation.peers.laws import (
    PLUS,
    Models,
    PeerDesign,
    Scale,
    axis_numbers,
    design_for,
    peers_of,
    scaled,
    with_friction,
)
from fffo_drive.evaluation.peers.laws import wrong as made_wrong
from fffo_drive.evaluation.peers.loop import PeerLaw, run_law
from fffo_drive.evaluation.peers.lugre import LugreConfig
from fffo_drive.evaluation.peers.maxwell_slip import SlipConfig
from fffo_drive.evaluation.peers.plus import on_the_estimate, with_second_surface
from fffo_drive.evaluation.trace import trace_of
from fffo_drive.model.friction import FrictionConfig

PAPER = Path(__file__).resolve().parents[2] / "configs" / "scenarios" / "paper.yaml"
PERIOD_S = 0.0005
BANDWIDTH_HZ = 200.0
LIMITS_RPS = (30.0, 10.0)
SURFACES = TwoSurfaces(*TABLE_1, 0.006, 0.004, 0.05, 0.4, 0.1)
MODELS = Models(TABLE_1, LUGRE_START, SLIP_START, SURFACES)


@pytest.fixture(scope="module")
def case() -> Case:
    """The paper's scenario, three seconds of it."""
    scenario = read_scenario(PAPER)
    assert scenario.file.reference is not None
    reference = scenario.file.reference.model_copy(update={"duration_s": 3.0})
    return case_of(scenario._replace(file=scenario.file.model_copy(update={"reference": reference})), 3)


@pytest.fixture(scope="module")
def design(case: Case) -> PeerDesign:
    return design_for(plus_of(case).controller)


@pytest.fixture(scope="module")
def laws(case: Case, design: PeerDesign) -> dict[str, PeerLaw]:
    plus = plus_of(case)
    config = with_friction(plus.controller, MODELS.two_state)
    laws = [PeerLaw(PLUS, config, plus.toggle), *peers_of(config, plus.toggle, design, MODELS)]
    return {law.name: law for law in laws}


@pytest.mark.parametrize("second", [False, True])
def test_it_runs_in_the_loop_of_peers_as_in_its_own(case, design, laws, second):
    axis = axis_numbers(case.plant)
    law = with_second_surface(laws[PLUS], axis, SURFACES) if second else laws[PLUS]
    law = on_the_estimate(law, design.wish, axis, BANDWIDTH_HZ, LIMITS_RPS)
    assert isinstance(law.config, ControllerConfig)
    own_case = case if law.effects is None else case._replace(effects=PortableEffects.of(law.effects))
    rows, trip = simulate(own_case, Candidate(PLUS, law.toggle, law.config))
    own = trace_of(rows, case.profile.period_s, case.profile.values.size)
    found = run_law(case.plant, case.device, law, case.profile).trace
    assert trip == 0
    assert np.any(rows["estimated_rps"] != 0.0)
    assert np.any(rows["effects_nm"] != 0.0) == second
    for column in ("reference_rps", "measured_rps", "true_rps", "command_a"):
        assert np.array_equal(getattr(own, column), getattr(found, column)), column


@pytest.mark.parametrize("name", [PLUS, "lugre forward+", "gms forward+"])
def test_the_margins_on_the_estimate_are_those_of_the_design_and_the_loop_is_faster(case, design, laws, name):
    axis = axis_numbers(case.plant)
    before, law = laws[name], on_the_estimate(laws[name], design.wish, axis, BANDWIDTH_HZ, LIMITS_RPS)
    gain = 0.0
    if isinstance(law.config, ControllerConfig):
        common, gain = law.config, law.config.observer.gain_nm_per_rev
    else:
        assert isinstance(law.config, LugreConfig | SlipConfig)
        common = law.config.peer
    was = before.config.pi if isinstance(before.config, ControllerConfig) else before.config.peer.pi
    delay_s = axis.delay_s - axis.sensor_delay_s
    linear = LinearAxis(
        axis.inertia_nm_s2_per_rev, 0.0, delay_s, axis.torque_constant_nm_per_a, estimator=common.velocity
    )
    margins = loop_margins(linear, *common.pi, gain)
    assert margins.phase_deg >= design.wish.phase_margin_deg
    assert margins.gain >= design.wish.gain_margin
    tight = min(margins.phase_deg / design.wish.phase_margin_deg, margins.gain / design.wish.gain_margin)
    assert tight == pytest.approx(1.0, abs=1e-3)
    faster = common.pi.proportional_a_per_rps / was.proportional_a_per_rps
    assert faster > 1.0
    assert common.pi.integral_a_per_rev == pytest.approx(faster**2 * was.integral_a_per_rev)
    assert law.common.feedforward.behind_ticks == 0.0


def test_a_law_with_an_observer_in_its_loop_is_refused(case, design, laws):
    with pytest.raises(TypeError, match="dob\\+"):
        on_the_estimate(laws["dob+"], design.wish, axis_numbers(case.plant), BANDWIDTH_HZ, LIMITS_RPS)


# as fitted to GMS friction: a single surface that stands for several
BENT = FrictionConfig(4.58e-4, 0.288, 0.0134, 0.182, 0.00465, 14.2, 7.94, TABLE_1.omega_form)


@pytest.mark.parametrize("start", [TABLE_1, BENT], ids=["table 1", "a bent surface"])
def test_two_surfaces_are_found_along_a_motion_through_them(start):
    time_s = np.arange(0.0, 20.0, PERIOD_S)
    velocity_rps = 2.0 * np.sin(2.0 * np.pi * 0.4 * time_s) + 0.7 * np.sin(2.0 * np.pi * 1.3 * time_s)
    true_nm = friction_along(SURFACES, velocity_rps, PERIOD_S)
    single_nm = friction_along(TABLE_1, velocity_rps, PERIOD_S)
    found = fit_two_surfaces(start, velocity_rps, true_nm, PERIOD_S)
    alone = np.sqrt(np.mean((single_nm - true_nm) ** 2) / np.mean(true_nm**2))
    assert found.left < 0.01 < 0.1 * alone
    assert found.model.level_nm == pytest.approx(SURFACES.level_nm, rel=0.2)


def test_scaled_and_wrong_surfaces_follow_the_single_one():
    scale = Scale(1.2, 0.8, 1.1, 0.9, 1.3)
    models = made_wrong(scaled(MODELS, scale), 0.1, 7)
    single, both = models.two_state, models.two_surfaces
    assert both is not None
    assert both.first == single
    right = scaled(MODELS, scale).two_surfaces
    assert right is not None
    assert right.level_nm == pytest.approx(1.2 * SURFACES.level_nm)
    assert right.rise_nm == pytest.approx(1.2 * 0.8 * SURFACES.rise_nm)
    for name in ("level_nm", "rise_nm", "travel_rev", "speed_rps", "memory_rev"):
        assert getattr(both, name) / getattr(right, name) == pytest.approx(1.0, abs=0.1 + 1e-9)
        assert getattr(both, name) != getattr(right, name)
