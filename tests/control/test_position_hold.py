"""The position hold at rest: what it brings back, its bound, its begin and its end."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fffo_drive.control.controller import (
    ControllerConfig,
    RestConfig,
    controller_at_rest,
    controller_step,
    pack_controller,
    unpack_controller,
    with_limited,
)
from fffo_drive.control.feedforward import NO_FEEDFORWARD, steady_reference
from fffo_drive.control.friction_observer import TOGGLE_FEEDBACK, TOGGLE_FEEDFORWARD, TOGGLE_OFF, ObserverConfig
from fffo_drive.control.pi import PiConfig
from fffo_drive.control.position_hold import NO_HOLD, HoldConfig
from fffo_drive.control.stability import LinearAxis
from fffo_drive.identification.tuning import design
from fffo_drive.model.friction import REST, FrictionConfig, friction_step

PERIOD_S = 5e-4
KT = 0.148
COUNT_REV = 2.0**-15
INERTIA = 9.4e-4
DELAY_TICKS = 5
TABLE1 = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, 0)
CONTACT_NM_PER_REV = TABLE1.coulomb_nm * TABLE1.stiffness_per_rev + TABLE1.attraction_nm_per_rev
SLIDING = LinearAxis(INERTIA, 0.003, (DELAY_TICKS + 0.5) * PERIOD_S, KT)
GAINS = design(SLIDING, 2.33, None, (SLIDING._replace(contact_nm_per_rev=CONTACT_NM_PER_REV),)).gains
BOUND_A = 0.5 * TABLE1.coulomb_nm / KT
HOLD = HoldConfig(GAINS.hold_a_per_rev_s, COUNT_REV, 1.0 / TABLE1.stiffness_per_rev, BOUND_A)
FADE = -math.expm1(-PERIOD_S / 0.1)
LAW = ControllerConfig(
    PiConfig(GAINS.proportional_a_per_rps, GAINS.integral_a_per_rev),
    ObserverConfig(TABLE1, GAINS.observer_nm_per_rev, 0.134, 0.1, True), NO_FEEDFORWARD, KT, 20.0, PERIOD_S, 1.0,
    RestConfig(GAINS.rest_share, FADE, FADE, HOLD),
)  # fmt: skip
WITHOUT = LAW._replace(rest=LAW.rest._replace(hold=NO_HOLD))
STILL = steady_reference(0.0)


def at_rest(config, state, position_rev, toggle=TOGGLE_FEEDFORWARD):
    """A tick at rest, of an axis that does not move."""
    return controller_step(config, state, toggle, STILL, 0.0, 0.0, 0.0, position_rev)


def settled(config=LAW, position_rev=3.25):
    """Memory after a second at rest in one place."""
    state = controller_at_rest()
    for _ in range(2000):
        terms, state = at_rest(config, state, position_rev)
    assert terms.command_a == 0.0
    return state


class Axis:
    """Inertia on the model's own contact, with the delay of a command and a shaking torque."""

    def __init__(self, load_nm=0.0):
        self.load_nm, self.friction = load_nm, REST
        self.velocity_rps = self.position_rev = 0.0
        self.commands = [0.0] * DELAY_TICKS
        self.noise = np.random.default_rng(7)

    def tick(self, command_a):
        """A period."""
        self.commands.append(command_a)
        torque_nm = KT * self.commands.pop(0) - self.load_nm + self.noise.normal(0.0, 2e-3)
        for _ in range(2):
            step_s = PERIOD_S / 2
            self.friction = friction_step(TABLE1, self.friction, self.velocity_rps, 0.0, step_s)
            self.velocity_rps += step_s * (torque_nm - self.friction.torque_nm) / INERTIA
            self.position_rev += step_s * self.velocity_rps

    def run(self, config, state, reference, seconds):
        """(terms and position of each tick, memory)."""
        kept = []
        for _ in range(round(seconds / PERIOD_S)):
            seen_rps = self.velocity_rps + self.noise.normal(0.0, 5e-3)
            seen_rev = math.floor(self.position_rev / COUNT_REV) * COUNT_REV
            terms, state = controller_step(
                config, state, TOGGLE_FEEDFORWARD, reference, seen_rps, 0.0, seen_rps, seen_rev
            )
            self.tick(terms.command_a)
            kept.append((terms.hold_a, terms.command_a, self.position_rev / COUNT_REV))
        return np.array(kept).T, state


def test_nothing_is_held_before_the_axis_has_settled_nor_within_the_dead_band():
    state = controller_at_rest()
    for k in range(900):  # 0.45 s: the friction torque still goes
        terms, state = at_rest(LAW, state, 1e-3 * k)
        assert terms.hold_a == 0.0
    state = settled()
    for away in (0.99, -0.99):
        terms, after = at_rest(LAW, state, 3.25 + away * COUNT_REV)
        assert terms.hold_a == 0.0
        assert after.hold.position_rev == 3.25


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_current_grows_against_the_distance_beyond_the_dead_band(sign):
    state = settled()
    for _ in range(10):
        terms, state = at_rest(LAW, state, 3.25 + sign * 3.0 * COUNT_REV)
    assert terms.hold_a == pytest.approx(-sign * 10 * HOLD.integral_a_per_rev_s * PERIOD_S * 2.0 * COUNT_REV)
    assert terms.requested_a == terms.proportional_a + terms.integral_a + terms.hold_a


@pytest.mark.parametrize("away_rev", [0.3, -0.3, 2e-4])
def test_against_a_hand_or_a_stop_it_stays_at_its_bound_and_lets_go_of_what_has_slid(away_rev):
    state = settled()
    for _ in range(20_000):  # ten seconds
        terms, state = at_rest(LAW, state, 3.25 + away_rev)
        assert abs(terms.hold_a) <= BOUND_A
        assert abs(terms.command_a) <= BOUND_A
    assert terms.hold_a == -math.copysign(BOUND_A, away_rev)
    left_rev = 3.25 + away_rev - state.hold.position_rev
    assert left_rev == pytest.approx(math.copysign(min(abs(away_rev), HOLD.travel_rev), away_rev), abs=1e-12)
    for _ in range(200):  # the hand lets go and the axis is back: a tenth of a second, not the ten that it was held for
        terms, state = at_rest(LAW, state, state.hold.position_rev - left_rev)
    assert -terms.hold_a * away_rev < 0.0 or abs(terms.hold_a) < BOUND_A


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_beyond_its_bound_it_takes_off_the_integral_at_the_same_rate_and_stops_at_nothing(sign):
    left_a = 3.0 * BOUND_A
    state = settled()._replace(integral_a=sign * left_a)
    a_tick_a = HOLD.integral_a_per_rev_s * PERIOD_S * 2.0 * COUNT_REV
    commands = [sign * left_a]
    for _ in range(math.ceil((left_a + BOUND_A) / a_tick_a) + 10):
        terms, state = at_rest(LAW, state, 3.25 + sign * 3.0 * COUNT_REV)
        commands.append(terms.command_a)
    steps = sign * np.diff(commands)
    assert steps[:-11] == pytest.approx(-a_tick_a, rel=1e-6)  # no kink at the bound: one gain, one margin
    assert steps[-9:] == pytest.approx(0.0, abs=1e-15)
    assert state.integral_a == 0.0
    assert terms.command_a == terms.hold_a == -sign * BOUND_A


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_the_integral_holds_against_a_load_is_not_raised_nor_given_back(sign):
    state = settled()._replace(integral_a=sign * 2.0 * BOUND_A)
    for _ in range(20_000):  # the load pulls away from the integral's side: the hold helps, up to its bound
        terms, state = at_rest(LAW, state, 3.25 - sign * 6.0 * COUNT_REV)
    assert terms.hold_a == sign * BOUND_A
    assert state.integral_a == sign * 2.0 * BOUND_A


@pytest.mark.parametrize("toggles", [(TOGGLE_FEEDBACK, TOGGLE_FEEDFORWARD), (TOGGLE_OFF, TOGGLE_FEEDFORWARD)])
def test_toggling_the_observer_leaves_a_charged_hold_as_it_is(toggles):
    state = settled()
    away_rev = 6.0 * COUNT_REV
    for _ in range(40):
        before, state = at_rest(LAW, state, 3.25 + away_rev)
    assert abs(before.hold_a) > 0.01
    a_tick_a = HOLD.integral_a_per_rev_s * PERIOD_S * (away_rev - COUNT_REV)
    for toggle in toggles:
        terms, state = at_rest(LAW, state, 3.25 + away_rev, toggle)
        assert before.hold_a - terms.hold_a == pytest.approx(a_tick_a)
        assert abs(terms.command_a - before.command_a) == pytest.approx(a_tick_a)
        before = terms


def test_an_envelope_below_its_bound_stops_it_from_winding_up():
    limit_a = 0.5 * BOUND_A
    state = settled()
    away_rev = 6.0 * COUNT_REV
    a_tick_a = HOLD.integral_a_per_rev_s * PERIOD_S * (away_rev - COUNT_REV)
    for _ in range(20_000):
        terms, state = at_rest(LAW, state, 3.25 + away_rev)
        state = with_limited(state, abs(terms.command_a) > limit_a)
    assert limit_a < -terms.hold_a <= limit_a + 1.01 * a_tick_a


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_next_motion_begins_without_a_jump_and_holds_nothing(direction):
    state = settled()
    for _ in range(40):
        before, state = at_rest(LAW, state, 3.25 + 6.0 * COUNT_REV)
    assert abs(before.hold_a) > 0.01
    start = steady_reference(direction * 1e-9)
    terms, state = controller_step(LAW, state, TOGGLE_FEEDFORWARD, start, 0.0, 0.0, 0.0, 3.25)
    assert terms.hold_a == 0.0
    assert terms.command_a == pytest.approx(before.command_a, abs=1e-6)
    assert not state.hold.latched


def test_a_hold_that_is_switched_off_leaves_its_current_to_the_integral():
    state = settled()
    for _ in range(40):
        before, state = at_rest(LAW, state, 3.25 + 6.0 * COUNT_REV)
    terms, state = at_rest(WITHOUT, state, 3.25)
    assert terms.hold_a == 0.0
    assert terms.command_a == before.command_a


def test_a_position_that_is_no_number_stands_or_jumps_does_no_harm():
    state = settled()
    for _ in range(40):
        before, state = at_rest(LAW, state, 3.25 + 6.0 * COUNT_REV)
    terms, after = at_rest(LAW, state, math.nan)
    assert terms.hold_a == before.hold_a
    assert after.hold == state.hold
    assert controller_at_rest().hold == at_rest(LAW, controller_at_rest(), math.nan)[1].hold
    assert at_rest(LAW, settled(position_rev=0.0), 0.0)[0].hold_a == 0.0  # a drive that reports no position
    for position_rev in (1e6, -1e6, math.inf):  # a counter that is set anew
        terms, after = at_rest(LAW, state, position_rev)
        assert abs(terms.hold_a - before.hold_a) <= HOLD.integral_a_per_rev_s * PERIOD_S * HOLD.travel_rev
        assert math.isfinite(after.hold.position_rev)


def test_without_a_hold_the_position_changes_nothing():
    draw = np.random.default_rng(3)
    one = other = controller_at_rest()
    for k in range(4000):
        reference = steady_reference(0.0 if k % 2000 > 400 else 1.0)
        velocity_rps, position_rev = draw.normal(0.0, 0.1), draw.normal()
        toggle = TOGGLE_OFF if k > 3000 else TOGGLE_FEEDFORWARD
        first, one = controller_step(WITHOUT, one, toggle, reference, velocity_rps, 0.0, velocity_rps, position_rev)
        second, other = controller_step(WITHOUT, other, toggle, reference, velocity_rps, 0.0, velocity_rps, 0.0)
        assert first == second


def test_the_block_carries_it():
    assert unpack_controller(pack_controller(LAW)) == LAW


@pytest.mark.parametrize("load_share", [0.45, -0.45])
def test_a_load_step_at_rest_is_brought_back_and_does_not_creep_on(load_share):
    """A load of half the Coulomb friction on a contact that noise shakes: the axis creeps under it, or is held."""
    left, scatter, ticks = {}, {}, np.arange(2000)
    for name, config in (("with", LAW), ("without", WITHOUT)):
        axis = Axis()
        _, state = axis.run(config, controller_at_rest(), STILL, 1.0)
        begin = axis.position_rev / COUNT_REV
        axis.load_nm = load_share * TABLE1.coulomb_nm
        (hold_a, _, counts), state = axis.run(config, state, STILL, 4.0)
        assert np.abs(hold_a).max() <= BOUND_A
        left[name] = abs(counts[-400:].mean() - begin)
        creep = abs(counts[-400:].mean() - counts[2000:2400].mean())
        assert name == "without" or creep < 3.0  # within the dead band, both sides of it and a count
        scatter[name] = np.std(counts[-2000:] - np.polyval(np.polyfit(ticks, counts[-2000:], 1), ticks))
    assert scatter["with"] < 1.2 * scatter["without"]  # about its trend: noise alone, no hunting
    assert left["with"] < 3.0
    assert left["without"] > 2.0 * left["with"]


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_model_of_too_little_friction_does_not_let_the_axis_creep_on_after_a_stop(direction):
    """A tenth of the friction: the integral makes up for the rest, and pushes when the axis has stopped."""
    tenth = TABLE1._replace(coulomb_nm=0.1 * TABLE1.coulomb_nm, static_nm=0.1 * TABLE1.static_nm)
    hold = HOLD._replace(bound_a=0.5 * tenth.coulomb_nm / KT)
    poor = LAW._replace(observer=LAW.observer._replace(friction=tenth), rest=LAW.rest._replace(hold=hold))
    crept, left_a = {}, {}
    for name, config in (("with", poor), ("without", poor._replace(rest=poor.rest._replace(hold=NO_HOLD)))):
        axis = Axis()
        _, state = axis.run(config, controller_at_rest(), steady_reference(direction), 1.0)
        _, state = axis.run(config, state, STILL, 0.7)
        stopped_a = state.integral_a
        (hold_a, _, counts), state = axis.run(config, state, STILL, 4.0)
        assert np.abs(hold_a).max() <= hold.bound_a
        assert direction * stopped_a > 3.0 * hold.bound_a
        crept[name] = abs(counts[-400:].mean() - counts[:400].mean())
        left_a[name] = state.integral_a / stopped_a
    assert crept["with"] < 3.0
    assert crept["without"] > 3.0 * crept["with"]
    assert 0.0 <= left_a["with"] < left_a["without"]
