"""Peers: the loop is the loop, laws are their equations, the design keeps its margins, measures their meaning."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fffo_drive.config.scenario import Scenario, case_of, read_scenario
from fffo_drive.control.controller import ControllerConfig
from fffo_drive.control.feedforward import FeedforwardConfig, Reference, steady_reference
from fffo_drive.control.friction_observer import TOGGLE_FEEDFORWARD
from fffo_drive.control.pi import PiConfig
from fffo_drive.control.reference import MODE_VELOCITY, Profile
from fffo_drive.control.stability import LinearAxis, loop_margins
from fffo_drive.documents import DocumentError
from fffo_drive.drive.simulated.parameters import delay_budget
from fffo_drive.evaluation.campaign import simulate
from fffo_drive.evaluation.measures import START_S
from fffo_drive.evaluation.peers import disturbance_observer as dob
from fffo_drive.evaluation.peers.campaign import plus_of, run_peers
from fffo_drive.evaluation.peers.constants import INTEGRAL_A, LIMITED, MEMORY_SLOTS, OWN, PeerConfig
from fffo_drive.evaluation.peers.design import ObserverForm, observer_gains, observer_margins
from fffo_drive.evaluation.peers.drive_loop import (
    DELAYS_S,
    PER_TICK,
    TORQUE_RATES_HZ,
    TorqueOffset,
    as_the_drive_has_it,
    finer,
    offsets_nm,
)
from fffo_drive.evaluation.peers.fit import LUGRE_START, SLIP_START, TABLE_1, fit_friction, friction_along
from fffo_drive.evaluation.peers.laws import (
    OWN_LAWS,
    PI_AHEAD,
    PI_ALL,
    PLUS,
    Models,
    PeerDesign,
    Scale,
    axis_numbers,
    design_for,
    drives_own,
    error_filter_s,
    friction_form,
    known_numbers,
    peers_of,
    scaled,
    with_friction,
    wrong,
)
from fffo_drive.evaluation.peers.loop import PeerLaw, run_law
from fffo_drive.evaluation.peers.luenberger import LuenbergerLoop
from fffo_drive.evaluation.peers.lugre import LugreConfig, lugre_step, lugre_torque, stribeck_nm
from fffo_drive.evaluation.peers.measures import NOT_FINITE, measure_peer
from fffo_drive.evaluation.trace import Trace, trace_of
from fffo_drive.identification.tuning import Wish
from fffo_drive.packing import pack
from fffo_drive.workflows.evaluate import narrowed, run_published

PAPER = Path(__file__).resolve().parents[2] / "configs" / "scenarios" / "paper.yaml"
PERIOD_S = 0.0005
AXIS = LinearAxis(9.425e-4, 0.003, 0.003, 0.148)
FILTERED = AXIS._replace(error_filter_s=0.0002)
DOB, ESO = ObserverForm((0.0,)), ObserverForm((0.0, 0.0))
BESIDE_PI = ObserverForm((0.0, 500.0), 10.0, 0.0007)
MODELS = Models(TABLE_1, LUGRE_START, SLIP_START)
PEER = PeerConfig(
    PiConfig(0.5, 0.0), FeedforwardConfig(0.0, 0.0, 0.0), AXIS.torque_constant_nm_per_a, 16.6, PERIOD_S, 1.0
)


@pytest.fixture(scope="module")
def short() -> Scenario:
    """The paper's scenario, three seconds of it."""
    scenario = read_scenario(PAPER)
    assert scenario.file.reference is not None
    reference = scenario.file.reference.model_copy(update={"duration_s": 3.0})
    return scenario._replace(file=scenario.file.model_copy(update={"reference": reference}))


@pytest.fixture(scope="module")
def design(short: Scenario) -> PeerDesign:
    return design_for(plus_of(case_of(short, 1)).controller)


@pytest.mark.parametrize("name", [*OWN_LAWS, "pi+fbfo"])
def test_a_law_of_this_project_runs_in_the_loop_of_peers_as_in_its_own(short, name):
    case = case_of(short, 3)
    candidate = next(one for one in case.candidates if one.name == name)
    rows, trip = simulate(case, candidate)
    own = trace_of(rows, case.profile.period_s, case.profile.values.size)
    found = run_law(case.plant, case.device, PeerLaw(name, candidate.controller, candidate.toggle), case.profile).trace
    assert trip == 0
    for column in ("reference_rps", "measured_rps", "true_rps", "command_a"):
        assert np.array_equal(getattr(own, column), getattr(found, column)), column


@pytest.mark.parametrize("velocity_rps", [0.3, -2.0])
def test_the_lugre_observer_is_its_differential_equation(velocity_rps):
    """dz/dt = w - s0 |w| z / g + (L/s0) e over a period: the bristles exactly, the torque with their mean bending."""
    model, observation_nm_per_s, start_nm = LUGRE_START, 0.7, 0.01
    level_nm = stribeck_nm(*model[:4], abs(velocity_rps))

    def slope(_, z):
        bent = model.stiffness_nm_per_rev * abs(velocity_rps) / level_nm * z
        return velocity_rps - bent + observation_nm_per_s / model.stiffness_nm_per_rev

    z_rev = start_nm / model.stiffness_nm_per_rev
    solved = solve_ivp(slope, (0.0, PERIOD_S), [z_rev], rtol=1e-11, atol=1e-15)
    torque_nm, bristles_nm = lugre_torque(model, start_nm, velocity_rps, observation_nm_per_s, PERIOD_S)
    after_rev = float(solved.y[0, -1])
    assert bristles_nm == pytest.approx(model.stiffness_nm_per_rev * after_rev, rel=1e-9)
    bending_rps = (after_rev - z_rev) / PERIOD_S
    expected_nm = bristles_nm + model.damping_nm_per_rps * bending_rps + model.viscous_nm_per_rps * velocity_rps
    assert torque_nm == pytest.approx(expected_nm, rel=1e-7)


@pytest.mark.parametrize("model", MODELS[:3], ids=["2sep", "lugre", "slip"])
@pytest.mark.parametrize("velocity_rps", [0.2, -3.0])
def test_every_model_ends_on_the_same_stribeck_curve(model, velocity_rps):
    torque_nm = friction_along(model, np.full(8000, velocity_rps), PERIOD_S)
    expected_nm = stribeck_nm(0.025, 0.067, 0.733, 1.07, abs(velocity_rps)) + 0.003 * abs(velocity_rps)
    assert torque_nm[-1] == pytest.approx(math.copysign(expected_nm, velocity_rps), rel=1e-6)


def test_the_elements_of_maxwell_slip_are_springs_at_first():
    """Nearly at rest all four stick: the sum of a geometric row of stiffnesses."""
    start = SLIP_START._replace(viscous_nm_per_rps=0.0)
    torque_nm = friction_along(start, np.full(4, 1e-3), PERIOD_S)
    stiffness = 12.0 * (1.0 + 0.4 + 0.4**2 + 0.4**3)
    assert torque_nm == pytest.approx(stiffness * 1e-3 * PERIOD_S * np.arange(1, 5), rel=1e-9)


def test_a_lugre_observer_learns_nothing_while_the_command_is_limited():
    parameters = pack(LugreConfig(PEER, LUGRE_START, 5.0))
    reference = Reference(1.0, 0.0, 1.0, 0.0, 1.0)
    free, limited = np.zeros(MEMORY_SLOTS), np.zeros(MEMORY_SLOTS)
    limited[LIMITED] = 1.0
    lugre_step(parameters, free, reference, 0.5)
    lugre_step(parameters, limited, reference, 0.5)
    _, without_nm = lugre_torque(LUGRE_START, 0.0, 1.0, 0.0, PERIOD_S)
    assert limited[OWN] == without_nm
    assert free[OWN] - without_nm == pytest.approx(5.0 * 0.5 * PERIOD_S, rel=0.2)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("load_nm", [0.05, -0.2])
def test_a_disturbance_observer_carries_a_constant_load_at_no_error(order, load_nm):
    """P alone would leave an error of load / (Kp Kt). The axis takes the command as late as the law thinks."""
    ticks = 6
    parameters = pack(dob.ObserverLoop(PEER, AXIS.inertia_nm_s2_per_rev, 100.0, order, float(ticks)))
    memory = np.zeros(MEMORY_SLOTS)
    late = deque([0.0] * ticks, maxlen=ticks)
    velocity_rps, command_a = 0.0, 0.0
    for _ in range(4000):
        command_a = dob.observer_loop_step(parameters, memory, steady_reference(0.0), velocity_rps)
        torque_nm = AXIS.torque_constant_nm_per_a * late[0] - load_nm
        late.append(command_a)
        velocity_rps += torque_nm / AXIS.inertia_nm_s2_per_rev * PERIOD_S
    assert command_a * AXIS.torque_constant_nm_per_a == pytest.approx(load_nm, rel=1e-6)
    assert abs(velocity_rps) < 1e-6
    assert memory[INTEGRAL_A] == 0.0


@pytest.mark.parametrize("order", [1, 2])
def test_a_disturbance_observer_takes_neither_inertia_nor_delay_for_a_disturbance(order):
    """On an axis without friction that is as late as the law thinks, the estimate is zero whatever the motion."""
    ticks = 6
    # a command is held for a period: on average it is half of one later than the whole ticks
    parameters = pack(dob.ObserverLoop(PEER, AXIS.inertia_nm_s2_per_rev, 158.0, order, ticks + 0.5))
    memory = np.zeros(MEMORY_SLOTS)
    late = deque([0.0] * ticks, maxlen=ticks)
    velocity_rps, largest_nm = 0.0, 0.0
    for tick in range(4000):
        reference = steady_reference(3.0 * math.sin(0.02 * tick))
        command_a = dob.observer_loop_step(parameters, memory, reference, velocity_rps)
        largest_nm = max(largest_nm, abs(memory[dob.FIRST_NM]), abs(memory[dob.SECOND_NM]))
        velocity_rps += AXIS.torque_constant_nm_per_a * late[0] / AXIS.inertia_nm_s2_per_rev * PERIOD_S
        late.append(command_a)
    assert largest_nm < 1e-12


def test_margins_of_a_disturbance_observer_are_those_of_the_pi_that_it_is_without_delay():
    """Q of first order, no delay: C = Kp Kt + wo J + Kp Kt wo / s, a PI."""
    axis = AXIS._replace(delay_s=1e-9)
    kt, bandwidth, proportional = axis.torque_constant_nm_per_a, 120.0, 0.6
    as_pi = loop_margins(
        axis, proportional + bandwidth * axis.inertia_nm_s2_per_rev / kt, proportional * bandwidth, 0.0
    )
    found = observer_margins(axis, proportional, bandwidth, DOB)
    assert found.crossover_hz == pytest.approx(as_pi.crossover_hz, rel=1e-3)
    assert found.phase_deg == pytest.approx(as_pi.phase_deg, abs=0.05)


def test_margins_without_an_observer_are_those_of_p_with_its_filter():
    as_p = loop_margins(FILTERED, 0.6, 0.0, 0.0)
    found = observer_margins(FILTERED, 0.6, 1e-7, DOB)
    assert found.phase_deg == pytest.approx(as_p.phase_deg, abs=0.05)
    assert found.gain == pytest.approx(as_p.gain, rel=1e-3)
    assert observer_margins(AXIS, 0.6, 1e-7, DOB).phase_deg > found.phase_deg + 1.0


def test_margins_without_an_observer_are_those_of_pi_where_there_is_one_beside_it():
    as_pi = loop_margins(FILTERED, 0.6, 6.0, 0.0)
    found = observer_margins(FILTERED, 0.6, 1e-7, BESIDE_PI)
    assert found.phase_deg == pytest.approx(as_pi.phase_deg, abs=0.05)
    assert found.gain == pytest.approx(as_pi.gain, rel=1e-3)


@pytest.mark.parametrize("form", [DOB, ESO, BESIDE_PI], ids=["dob", "eso", "beside pi"])
def test_gains_of_an_observer_have_the_margins_that_were_asked_for_and_no_more(form):
    wish = Wish(phase_margin_deg=46.0, gain_margin=3.0)
    gains = observer_gains(FILTERED, form, wish)
    found = observer_margins(FILTERED, gains.proportional_a_per_rps, gains.bandwidth_rad_per_s, form)
    assert found.phase_deg >= 46.0
    assert found.gain >= 3.0
    assert min(found.phase_deg - 46.0, 100.0 * (found.gain - 3.0)) < 1.0  # one of the two binds
    faster = observer_margins(FILTERED, gains.proportional_a_per_rps, 1.05 * gains.bandwidth_rad_per_s, form)
    assert faster.phase_deg < 46.0 or faster.gain < 3.0


@pytest.mark.parametrize("place", range(3), ids=Models._fields[:3])
def test_a_fit_finds_the_numbers_that_made_its_record(place):
    rng = np.random.default_rng(place)
    truth = MODELS[place]
    numbers = [name for name in truth._fields if name != "omega_form"]
    truth = truth._replace(**{n: getattr(truth, n) * float(rng.uniform(0.8, 1.25)) for n in numbers})
    time_s = np.arange(20_000) * PERIOD_S
    velocity_rps = sum(a * np.sin(2.0 * np.pi * f * time_s) for a, f in ((0.4, 3.1), (1.5, 0.9), (6.0, 0.13)))
    found = fit_friction(MODELS[place], velocity_rps, friction_along(truth, velocity_rps, PERIOD_S), PERIOD_S)
    assert found.left < 1e-3
    for name in numbers:
        if name != "damping_nm_per_rps":  # a thousandth of the torque along this motion
            assert getattr(found.model, name) == pytest.approx(getattr(truth, name), rel=0.03), name


def laws_on(config: ControllerConfig, wish: Wish | None = None) -> dict[str, PeerLaw]:
    """All laws beside PI+FFFO+ on the axis that it knows."""
    return {law.name: law for law in peers_of(config, TOGGLE_FEEDFORWARD, design_for(config, wish), MODELS)}


def test_laws_have_the_margins_that_are_asked_for_and_else_those_of_pi_fffo_plus(short, design):
    plus = plus_of(case_of(short, 1)).controller
    numbers = known_numbers(plus)
    axis = LinearAxis(
        numbers.inertia_nm_s2_per_rev,
        0.003,
        numbers.delay_s,
        numbers.torque_constant_nm_per_a,
        error_filter_s=error_filter_s(plus),
    )
    own = loop_margins(axis, *plus.pi, plus.observer.gain_nm_per_rev)
    assert design.wish.phase_margin_deg == pytest.approx(own.phase_deg)
    assert design.wish.gain_margin == pytest.approx(own.gain)
    asked = Wish(phase_margin_deg=50.0, gain_margin=3.5)
    loop, position = (laws_on(plus, asked)[name].config for name in ("dob+", "luenberger+"))
    assert isinstance(loop, dob.ObserverLoop)
    assert isinstance(position, LuenbergerLoop)
    of_position = friction_form(plus, numbers, position.model)
    for found in (
        observer_margins(axis, loop.peer.pi.proportional_a_per_rps, loop.bandwidth_rad_per_s, DOB),
        observer_margins(axis, position.peer.pi.proportional_a_per_rps, position.slow_rad_per_s, of_position),
    ):
        assert found.phase_deg >= 50.0
        assert found.gain >= 3.5
        assert min(found.phase_deg - 50.0, 10.0 * (found.gain - 3.5)) < 1.0  # one of the two binds
    assert loop.delay_ticks == pytest.approx(6.0)
    assert position.delay_ticks == pytest.approx(6.0 - 1.4)  # the position is not behind as the velocity is


def test_laws_without_an_observer_of_their_own_have_the_integral_action_of_pi_fffo_plus(short):
    """Wherever L is added, Ki Kt + L is the same."""
    plus = plus_of(case_of(short, 1)).controller
    constant, gain = plus.torque_constant_nm_per_a, plus.observer.gain_nm_per_rev
    most = plus.pi.integral_a_per_rev * constant + gain
    laws = laws_on(plus)
    for name in (PI_ALL, PI_AHEAD, "lugre forward+", "gms forward+"):
        assert laws[name].common.pi.integral_a_per_rev * constant == pytest.approx(most), name
        assert laws[name].common.pi.proportional_a_per_rps == plus.pi.proportional_a_per_rps, name
    observer = laws["lugre observer+"].config
    assert isinstance(observer, LugreConfig)
    assert observer.peer.pi == plus.pi
    assert observer.gain_nm_per_rev == gain


def test_plain_laws_add_no_friction_and_the_plainer_one_nothing_from_the_reference(short):
    """On the same plant: what a plain PI leaves, inertia and preview reduce, and the friction model reduces further."""
    case = case_of(short, 1)
    candidate = plus_of(case)
    laws = {**laws_on(candidate.controller), PLUS: PeerLaw(PLUS, candidate.controller, candidate.toggle)}
    assert laws[PI_ALL].common.feedforward == FeedforwardConfig(0.0, 0.0, 0.0)
    assert laws[PI_AHEAD].common.feedforward == candidate.controller.feedforward
    ises = {
        name: measure_peer(run_law(case.plant, case.device, laws[name], case.profile).trace).true_ise
        for name in (PI_ALL, PI_AHEAD, PLUS, drives_own(0.002), drives_own(0.002, 1000.0))
    }
    assert ises[PLUS] < 0.3 * ises[PI_AHEAD] < 0.1 * ises[PI_ALL]
    # a loop in the drive is faster than the same over the bus; with torque from the PC it needs to do little
    assert ises[drives_own(0.002, 1000.0)] < 0.1 * ises[drives_own(0.002)] < 0.1 * ises[PI_ALL]


@pytest.mark.parametrize("delay_s", DELAYS_S)
def test_the_loop_in_the_drive_has_the_margins_behind_its_own_delay(short, delay_s):
    plus = plus_of(case_of(short, 1)).controller
    wish = Wish()
    pi = laws_on(plus, wish)[drives_own(delay_s)].common.pi
    numbers = known_numbers(plus)
    axis = LinearAxis(numbers.inertia_nm_s2_per_rev, 0.0, delay_s, numbers.torque_constant_nm_per_a)
    found = loop_margins(axis, *pi, 0.0)
    assert found.phase_deg >= wish.phase_margin_deg - 0.05
    assert found.gain >= wish.gain_margin
    assert found.phase_deg == pytest.approx(wish.phase_margin_deg, abs=0.5)


@pytest.mark.parametrize("delay_s", DELAYS_S)
def test_the_plant_behind_the_loop_in_the_drive_has_its_delay_and_is_else_the_same_axis(short, delay_s):
    plant = case_of(short, 1).plant
    own = as_the_drive_has_it(plant, delay_s, PERIOD_S / PER_TICK)
    budget = delay_budget(own)
    assert sum(astuple(budget)) == pytest.approx(delay_s)
    assert budget.transport_s >= 0.0
    assert budget.hold_s == pytest.approx(0.5 * PERIOD_S / PER_TICK)
    resolver = replace(own.resolver, tracking_hz=plant.resolver.tracking_hz)
    assert replace(own, delay_s=plant.delay_s, sync_period_s=plant.sync_period_s, resolver=resolver) == plant
    if delay_s == 0.002:
        assert own.resolver == plant.resolver  # only a loop that its converter would make too slow has a faster one


def test_the_drive_interpolates_the_set_point_and_keeps_each_of_the_pcs_samples(short):
    profile = case_of(short, 1).profile
    found = finer(profile, PER_TICK)
    assert np.array_equal(found.values[::PER_TICK], profile.values)
    assert found.period_s * PER_TICK == profile.period_s
    middle = found.values[PER_TICK // 2 : -PER_TICK : PER_TICK]
    assert middle == pytest.approx(0.5 * (profile.values[:-1] + profile.values[1:]))


@pytest.mark.parametrize("rate_hz", TORQUE_RATES_HZ)
def test_the_torque_of_the_pc_is_that_of_the_reference_ahead_held_for_its_period(rate_hz):
    """A constant acceleration without friction: J times it; with viscous friction a ramp, right in the middle."""
    period_s, ahead_s = PERIOD_S / PER_TICK, 0.0015
    time_s = np.arange(8000) * period_s
    profile = Profile("ramp", MODE_VELOCITY, period_s, 10.0 * time_s, np.full(time_s.size, 10.0))
    inertia = AXIS.inertia_nm_s2_per_rev
    still = TABLE_1._replace(coulomb_nm=1e-12, static_nm=1e-12, viscous_nm_per_rps=0.0)
    found_nm = offsets_nm(TorqueOffset(still, inertia, rate_hz), profile, ahead_s)
    assert found_nm == pytest.approx(np.full(found_nm.size, 10.0 * inertia), abs=1e-9)
    viscous = still._replace(viscous_nm_per_rps=0.003, attraction_nm_per_rev=1e4)  # follows its level at once
    found_nm = offsets_nm(TorqueOffset(viscous, 0.0, rate_hz), profile, ahead_s)[: -round(0.1 / period_s)]
    held = round(1.0 / (rate_hz * period_s))
    blocks = found_nm[: found_nm.size // held * held].reshape(-1, held)
    assert np.all(blocks == blocks[:, :1])
    middle_s = (np.arange(blocks.shape[0]) * held + 0.5 * (held - 1)) * period_s
    assert blocks[:, 0] == pytest.approx(0.003 * 10.0 * (middle_s + ahead_s), rel=1e-3, abs=1e-6)


def test_wrong_models_are_wrong_in_every_number_and_alike_by_name():
    changed = wrong(MODELS, 0.1, 7)
    for before, after in zip(MODELS[:3], changed[:3], strict=True):
        for name in before._fields:
            ratio = getattr(after, name) / getattr(before, name) if name != "omega_form" else 1.1
            assert abs(abs(ratio - 1.0) - 0.1) < 1e-12
    ratios = [after.coulomb_nm / before.coulomb_nm for before, after in zip(MODELS[:3], changed[:3], strict=True)]
    assert ratios[0] == pytest.approx(ratios[1])
    assert ratios[0] == pytest.approx(ratios[2])


def test_a_scaled_model_is_the_model_of_the_scaled_plant(short):
    """The plant's own `scaled` and the model's: one curve, one stiffness."""
    scale = Scale(1.2, 0.8, 1.1, 1.3, 0.7)
    plant = replace(case_of(short, 1).plant.friction, kind="single_2sep").scaled(**scale._asdict()).single
    model = scaled(MODELS, scale).two_state
    assert (model.coulomb_nm, model.static_nm) == pytest.approx((plant.coulomb_nm, plant.stiction_nm))
    assert model.stribeck_velocity_rps == pytest.approx(plant.stribeck_rps)
    assert model.stiffness_per_rev == pytest.approx(plant.stiffness_per_rev)
    assert model.attraction_nm_per_rev == pytest.approx(plant.attraction_nm_per_rev)


def test_an_axis_is_known_by_its_inertia_constant_and_whole_delay(short):
    numbers = axis_numbers(case_of(short, 1).plant)
    assert numbers.delay_s == pytest.approx(0.003)
    assert numbers.inertia_nm_s2_per_rev == pytest.approx(2.0 * math.pi * 1.5e-4)
    assert numbers.sensor_delay_s == pytest.approx(0.0007, abs=2e-5)


def test_pi_fffo_plus_knows_its_axis_as_it_is(short):
    case = case_of(short, 1)
    known, true = known_numbers(plus_of(case).controller), axis_numbers(case.plant)
    assert tuple(known[:3]) == pytest.approx(tuple(true[:3]), rel=5e-3)
    assert known.sensor_delay_s == pytest.approx(true.sensor_delay_s, abs=2e-5)


def test_errors_of_the_models_have_the_sign_that_is_given_and_else_the_seeds():
    high = wrong(MODELS, 0.1, 3, 1.0)
    assert all(
        getattr(after, name) == pytest.approx(1.1 * getattr(before, name))
        for before, after in zip(MODELS[:3], high[:3], strict=True)
        for name in before._fields
        if name != "omega_form"
    )
    assert wrong(MODELS, 0.1, 3) != wrong(MODELS, 0.1, 4)
    assert wrong(MODELS, 0.0, 3) == MODELS


def test_published_laws_are_run_beside_those_of_a_scenario_and_as_the_benchmark_runs_them(short):
    """The same axis, noise and reference: with the same model, `2sep observer+` errs as much as in the benchmark."""
    case = case_of(short, 2)
    found = {one.candidate: one for one in run_peers(case, MODELS, 0.0, None)}
    drives = [drives_own(delay_s, rate_hz) for delay_s in DELAYS_S for rate_hz in (None, *TORQUE_RATES_HZ)]
    assert list(found) == [
        PI_ALL, PI_AHEAD,
        "2sep observer+", "lugre observer+", "lugre forward+", "gms forward+", "dob+", "eso+", "luenberger+", *drives,
    ]  # fmt: skip
    assert all(one.seed == 2 and one.fault_text is None for one in found.values())
    law = laws_on(with_friction(plus_of(case).controller, MODELS.two_state))["2sep observer+"]
    trace = run_law(case.plant, case.device, law, case.profile).trace
    measures = found["2sep observer+"].measures
    assert measures is not None
    assert measures.true is not None
    assert measures.true.error.ise == pytest.approx(measure_peer(trace).true_ise, rel=1e-9)


def test_a_scenario_without_pi_fffo_plus_has_no_published_laws_beside_it(short):
    alone = narrowed(short, ["pi", "pi+fffo"], 1)
    with pytest.raises(DocumentError, match=r"paper.yaml: controllers: no pi\+fffo\+ with inertia, preview"):
        run_published(alone, 1)


def sine_trace(late_s: float) -> Trace:
    """A sine of 2 rps and 1 Hz, and an axis that is late."""
    time_s = np.arange(round(6.0 / PERIOD_S)) * PERIOD_S
    reference_rps = 2.0 * np.sin(2.0 * np.pi * time_s + 0.5)
    true_rps = 2.0 * np.sin(2.0 * np.pi * (time_s - late_s) + 0.5)
    command_a = np.where(np.arange(time_s.size) % 2, 0.1, -0.1)
    return Trace(PERIOD_S, reference_rps, true_rps + 0.01, true_rps, command_a)


def test_measures_of_a_late_axis_are_in_closed_form():
    found = measure_peer(sine_trace(0.004))
    slope_rps2 = 2.0 * 2.0 * np.pi
    assert found.lag_ms == pytest.approx(4.0, rel=1e-3)
    assert found.crossing_rps == pytest.approx(slope_rps2 * 0.004, rel=2e-3)
    chord = 2.0 * math.sin(math.pi * 0.004)  # of the sine against its delayed self, amplitude of the difference
    assert found.true_ise == pytest.approx(0.5 * (2.0 * chord) ** 2 * 6.0, rel=1e-3)
    assert found.measured_ise == pytest.approx(found.true_ise + 0.01**2 * 6.0, rel=1e-3)
    assert found.start_ise == pytest.approx(found.true_ise * START_S / 6.0, rel=1e-3)
    assert found.start_ise + found.after_ise == pytest.approx(found.true_ise, rel=1e-12)
    assert found.step_rms_a == pytest.approx(0.2)


def test_a_run_that_is_not_finite_is_infinitely_bad():
    trace = sine_trace(0.0)
    assert trace.true_rps is not None
    trace.true_rps[-1] = np.nan
    assert measure_peer(trace) == NOT_FINITE


def test_a_trace_without_the_true_velocity_is_refused():
    with pytest.raises(ValueError, match="compared on a simulated drive"):
        measure_peer(sine_trace(0.0)._replace(true_rps=None))
