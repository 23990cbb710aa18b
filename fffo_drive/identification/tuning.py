"""Gains from a fitted plant (Fig. 6): PI, observer gain with the delay in the loop, and how much friction may vary.

The plant is 1/(J p + D) with the end-to-end delay. Friction changes D by orders of magnitude with amplitude, so a
design is judged over a range of D: the closed loop's poles, its margins, the overshoot of a step with zero and delay.
Gains act on current: proportional A/rps, integral A/rev, observer Nm/rev.

The margins are the constraint, and within them integral action is maximised. (14) is not a constraint: it is sufficient
for an estimate without delay, while a loop without phase margin oscillates. The correction goes to the integral, where
(14) does not apply; a design that violates it says so. At rest the contact sticks and the axis is a different plant: Kp
and Ki are scaled until the margin on that spring holds too.

A resonance near the frequency where the delay has turned the phase by 180 degrees leaves a loop that is several times
slower. There a notch is chosen, or two, by trial on the frequency response: where it allows more integral action by a
worthwhile factor, over all places in which the resonance may be.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..control.notch import HIGHEST_NOTCH_SHARE, MOST_NOTCHES, Notch
from ..control.stability import (
    RIGID,
    LinearAxis,
    Margins,
    OpenLoop,
    condition_14_nm_per_rev,
    impedance_nm_per_rps,
    loop_margins,
    open_loops,
    over_loads,
    sweep_rad_per_s,
    worst_margins,
)

DAMPING_RATIO = 2.0  # of the desired closed loop: real poles with margin for friction; the paper's loop has 1.96
REST_MARGIN_DEG = 20.0  # at rest, on the contact's spring; hysteresis adds to it (results/chain.md)
# of Kp and Ki at rest, the largest first: half costs nothing in motion and covers an axis that differs by 30 %
# (results/robustness.md)
REST_SHARES = np.geomspace(0.5, 0.02, 33)
FRICTION_SPAN = 100.0  # required range of friction damping
PHASE_MARGIN_DEG = 45.0
GAIN_MARGIN = 2.5
SHORTEST_DELAY_S = 1e-4
BANDWIDTHS = 41
SLOWEST_SHARE = 0.01  # of the fastest crossover: a slower loop is useless
RETREAT, MOST_RETREATS = 0.99, 20  # of the integral action, where the digits of a file would cost a margin
HALVINGS = 14  # of the range of a gain: to a ten-thousandth of the most
STEP_POINTS = 4000

NOTCH_GAIN = 1.2  # times the integral action that a notch has to allow: each costs phase, and one more thing to know
PEAK = 1.1  # of the response over that of the whole inertia, from which on it is a resonance
NOTCH_PLACES = (0.85, 1.0, 1.15)  # of the resonance
NOTCH_WIDTHS = (0.3, 0.6, 1.0, 1.6, 2.5)
NOTCH_DEPTHS = (0.03, 0.1, 0.2, 0.35, 0.5)
NOTCH_STEPS = (1.04, 1.2, 1.3)  # of place, width and depth, when the best of these is made better
# of a trial: a coarser sweep, still five points within the half width of a resonance with a damping ratio of 0.01
TRIAL_STRIDE, TRIAL_BANDWIDTHS, TRIAL_HALVINGS = 4, 13, 7


class Wish(NamedTuple):
    """Requirements of the loop."""

    bandwidth_hz: float | None = None  # None: where integral action is largest
    damping_ratio: float = DAMPING_RATIO
    phase_margin_deg: float = PHASE_MARGIN_DEG
    gain_margin: float = GAIN_MARGIN

    def is_met(self, margins: Margins) -> bool:
        """Whether both margins are met."""
        return margins.phase_deg >= self.phase_margin_deg and margins.gain >= self.gain_margin


class Gains(NamedTuple):
    """Gains for the controller section of an axis file."""

    proportional_a_per_rps: float
    integral_a_per_rev: float
    observer_nm_per_rev: float
    rest_share: float = 1.0  # of Kp and Ki while the reference stands at zero
    hold_a_per_rev_s: float = 0.0  # integral of the position while it does

    @property
    def in_motion(self) -> tuple[float, float, float]:
        """Kp, Ki and L, as `loop_margins` takes them."""
        return self.proportional_a_per_rps, self.integral_a_per_rev, self.observer_nm_per_rev

    def integral_action_nm_per_rev(self, torque_constant_nm_per_a: float) -> float:
        """Ki Kt + L: the integral of the error is the change of the disturbance over it."""
        return self.integral_a_per_rev * torque_constant_nm_per_a + self.observer_nm_per_rev


class LocusPoint(NamedTuple):
    """Closed-loop poles (1/s) at one proportional gain, the integral time kept."""

    proportional_a_per_rps: float
    poles: tuple[complex, complex]


class DampingRange(NamedTuple):
    """Range of friction damping over which a property holds, in Nm/rps."""

    lowest: float
    highest: float

    @property
    def ratio(self) -> float:
        """Highest over lowest."""
        return self.highest / self.lowest if self.lowest > 0.0 else math.inf


class Design(NamedTuple):
    """Gains with all results by which they are judged."""

    gains: Gains
    margins_pi: Margins
    margins_observer: Margins
    margins_rest: Margins  # on the contact's spring, with the gains at rest
    condition_14_nm_per_rev: float  # not negative where it holds
    real_poles_from_a_per_rps: float
    overshoot_percent: float  # of a step of the reference, PI alone, with zero and delay
    settled_s: float  # within 2 %
    without_overshoot: DampingRange  # real poles: the paper's dashed line
    within_margins: DampingRange  # phase and gain margin kept, observer on
    warnings: tuple[str, ...]


def real_pole_bound(axis: LinearAxis, integral_time_s: float) -> float:
    """Smallest Kp (A/rps) from which on both closed-loop poles of (16) are real for good.

    J s^2 + (D + G) s + G / Ti with G = Kp Kt has real poles where (D + G)^2 >= 4 J G / Ti.
    """
    damping = axis.damping_nm_per_rps
    middle = 2.0 * axis.inertia_nm_s2_per_rev / integral_time_s - damping
    if middle <= damping:
        return 0.0  # J / D <= Ti: real for every gain
    return (middle + math.sqrt(middle * middle - damping * damping)) / axis.torque_constant_nm_per_a


def root_locus(axis: LinearAxis, integral_time_s: float, gains: Floats) -> list[LocusPoint]:
    """Poles of PI and first-order plant without delay, over proportional gains (A/rps)."""
    points = []
    for gain in gains:
        stiffness = float(gain) * axis.torque_constant_nm_per_a
        roots = np.roots([axis.inertia_nm_s2_per_rev, axis.damping_nm_per_rps + stiffness, stiffness / integral_time_s])
        points.append(LocusPoint(float(gain), (complex(roots[0]), complex(roots[1]))))
    return points


def gains_in_motion(axis: LinearAxis, wish: Wish) -> tuple[float, float, float]:
    """Kp, Ki, L with the required margins: over the crossovers, the largest integral action Ki Kt + L.

    Integral action rejects slow disturbances: the integral of the error is the change of the disturbance over Ki Kt +
    L. Maximising it within the margins is the standard design for disturbance rejection (Astrom, Panagopoulos and
    Hagglund, "Design of PI controllers based on non-convex optimization", Automatica 34, 1998). The crossover of PI
    alone is Kp Kt / (2 pi J), and Ki follows from the damping ratio of its two poles; L is the rest. If no crossover
    has the margins, Ki is lowered until one has them, with L = 0: where viscous friction is far beyond what inertia
    takes, the damping ratio alone would allow any Ki. If that does not help either, the slowest crossover.
    """
    loops = open_loops(axis)
    found = [
        _gains_at(axis, crossover_hz, wish.damping_ratio) for crossover_hz in _crossovers_hz(axis, wish, BANDWIDTHS)
    ]
    held = [
        (proportional, integral, observer_gain(loops, proportional, integral, wish))
        for proportional, integral in found
        if _holds(loops, proportional, integral, 0.0, wish)
    ]
    if not held:
        lowered = [(gains[0], _integral_that_holds(loops, *gains, wish), 0.0) for gains in found]
        held = [gains for gains in lowered if gains[1] > 0.0]
    kt = axis.torque_constant_nm_per_a
    return max(held, key=lambda gains: gains[1] * kt + gains[2], default=(*found[-1], 0.0))


def _crossovers_hz(axis: LinearAxis, wish: Wish, count: int) -> list[float]:
    """Crossovers to try, the fastest first."""
    if wish.bandwidth_hz is not None:
        return [wish.bandwidth_hz]
    fastest_hz = 90.0 / 360.0 / max(axis.delay_s, SHORTEST_DELAY_S)  # the delay alone takes 90 deg there
    return [float(crossover_hz) for crossover_hz in fastest_hz * np.geomspace(1.0, SLOWEST_SHARE, count)]


def notches_for(axis: LinearAxis, wish: Wish) -> tuple[Notch, ...]:
    """Notches with which the required margins allow more integral action, each NOTCH_GAIN times as much at least.

    Only the frequency response of the axis is used. For each of its resonances a grid of places, widths and depths is
    tried, and the best of it is made better step by step. None on an axis without a resonance.
    """
    notches: tuple[Notch, ...] = ()
    peaks_hz = resonances_hz(axis)
    if not peaks_hz:
        return notches
    loops = open_loops(axis, TRIAL_STRIDE)
    before = _action(axis, loops, wish)
    while len(notches) < MOST_NOTCHES:
        action, notch = _best_notch(axis, loops, wish, peaks_hz, NOTCH_GAIN * before)
        if notch is None:
            break
        before, notches = action, (*notches, notch)
        loops = tuple(loop.behind(notches) for loop in loops)
    return tuple(_written(notch) for notch in notches)


def resonances_hz(axis: LinearAxis) -> list[float]:
    """Where the axis answers more than its whole inertia would, at a maximum; within reach of a notch."""
    omega = sweep_rad_per_s(axis.estimator)
    s = 1j * omega
    over = np.abs(axis.inertia_nm_s2_per_rev * s / impedance_nm_per_rps(axis, s))
    peaks = 1 + np.flatnonzero((over[1:-1] >= over[:-2]) & (over[1:-1] > over[2:]) & (over[1:-1] > PEAK))
    hz = omega[peaks] / (2.0 * math.pi)
    return [float(peak_hz) for peak_hz in hz[NOTCH_PLACES[0] * hz <= _highest_notch_hz(axis)]]


def resonance_text(axis: LinearAxis) -> str:
    """Where the elastic load of an axis resonates, as its margins count it."""
    share, frequency_hz, _ = axis.elastic
    low_hz, high_hz = ((1.0 + sign * axis.resonance_spread) * frequency_hz for sign in (-1.0, 1.0))
    return f"the resonance of the load ({100.0 * share:.2g} % of the inertia) from {low_hz:.3g} to {high_hz:.3g} Hz"


def notch_text(axis: LinearAxis, by_notches: float | None) -> str | None:
    """What the notches of a design give, `by_notches` times the integral action; None for a rigid axis."""
    if axis.elastic == RIGID:
        return None
    held = f"the margins hold with {resonance_text(axis)}"
    if by_notches is None:
        return f"{held}; no notch would allow {NOTCH_GAIN:g} times the integral action"
    several = len(axis.notches) > 1
    notches = " and ".join(
        f"at {one.frequency_hz:g} Hz (width {one.width:g}, depth {one.depth:g})" for one in axis.notches
    )
    allow = f"{'notches' if several else 'a notch'} {notches} allow{'' if several else 's'}"
    if math.isinf(by_notches):
        return f"{allow} gains within the margins, which no gains have without; {held}"
    return f"{allow} {by_notches:.3g} times the integral action within the margins; {held}"


def _highest_notch_hz(axis: LinearAxis) -> float:
    return HIGHEST_NOTCH_SHARE / axis.period_s if axis.period_s > 0.0 else math.inf


def _best_notch(
    axis: LinearAxis, loops: Sequence[OpenLoop], wish: Wish, peaks_hz: Sequence[float], before: float
) -> tuple[float, Notch | None]:
    """The largest integral action with one more notch, and that notch; `before` and None where none allows more."""
    highest_hz = _highest_notch_hz(axis)
    best, best_action = None, before

    def is_better(notch: Notch) -> bool:
        nonlocal best, best_action
        wide = NOTCH_WIDTHS[0] <= notch.width <= NOTCH_WIDTHS[-1]
        if not (wide and notch.frequency_hz <= highest_hz and NOTCH_DEPTHS[0] <= notch.depth <= NOTCH_DEPTHS[-1]):
            return False
        behind = [loop.behind((*loop.axis.notches, notch)) for loop in loops]
        action = _action(axis, behind, wish, best_action)
        if action <= best_action:
            return False
        best, best_action = notch, action
        return True

    places_hz = [place * peak_hz for peak_hz in peaks_hz for place in NOTCH_PLACES]
    # of those that allow the same, the narrowest and then the least deep
    for width, depth, place_hz in itertools.product(NOTCH_WIDTHS, reversed(NOTCH_DEPTHS), places_hz):
        is_better(Notch(place_hz, width, depth))
    improved = best is not None
    while improved and best is not None:
        improved = False
        for field, step in zip(Notch._fields, NOTCH_STEPS, strict=True):
            for factor in (step, 1.0 / step):
                improved |= is_better(best._replace(**{field: factor * getattr(best, field)}))
    return best_action, best


def _action(axis: LinearAxis, loops: Sequence[OpenLoop], wish: Wish, least: float = 0.0) -> float:
    """The largest Ki Kt + L (Nm/rev) with the required margins, roughly: on few crossovers; else `least`."""
    most = least
    for crossover_hz in _crossovers_hz(axis, wish, TRIAL_BANDWIDTHS):
        proportional, integral = _gains_at(axis, crossover_hz, wish.damping_ratio)
        nm_per_rev = integral * axis.torque_constant_nm_per_a
        beyond = max(0.0, most - nm_per_rev)  # what is had already
        if _holds(loops, proportional, integral, beyond, wish):
            most = max(most, nm_per_rev + observer_gain(loops, proportional, integral, wish, TRIAL_HALVINGS))
    return most


def _written(notch: Notch) -> Notch:
    """As an axis file has it."""
    return Notch(*(float(f"{value:.3g}") for value in notch))


def as_written(value: float) -> float:
    """A gain as a file has it: four digits, rounded down."""
    exponent = math.floor(math.log10(value)) - 3 if value > 0.0 else 0
    return float(f"{math.floor(value / 10.0**exponent * (1.0 + 1e-12)) * 10.0**exponent:.4g}")


def _held_as_written(axis: LinearAxis, gains: tuple[float, float, float], wish: Wish) -> tuple[float, float, float]:
    """Gains whose margins hold with the digits of a file as well; those that hold in no case as they are.

    Margins fall with each gain, but for a phase that dips to -180 degrees where the loop's gain is above 1: there a
    digit of Kp less makes the margin that of the dip.
    """
    loops, trial = open_loops(axis), gains
    for _ in range(MOST_RETREATS):
        proportional, integral, observer = (as_written(one) for one in trial)
        if _holds(loops, proportional, integral, observer, wish):
            return trial
        trial = trial[0], RETREAT * trial[1], RETREAT * trial[2]
    return gains


def _holds(loops: Sequence[OpenLoop], proportional: float, integral: float, observer: float, wish: Wish) -> bool:
    return all(wish.is_met(loop.margins(proportional, integral, observer)) for loop in loops)


def _gains_at(axis: LinearAxis, bandwidth_hz: float, damping_ratio: float) -> tuple[float, float]:
    kt, inertia = axis.torque_constant_nm_per_a, axis.inertia_nm_s2_per_rev
    omega = 2.0 * math.pi * bandwidth_hz
    proportional = max(omega * inertia - axis.damping_nm_per_rps, 0.05 * omega * inertia) / kt
    natural = (axis.damping_nm_per_rps + proportional * kt) / (2.0 * damping_ratio * inertia)
    return proportional, natural * natural * inertia / kt


def _integral_that_holds(loops: Sequence[OpenLoop], proportional: float, most: float, wish: Wish) -> float:
    """The largest Ki up to `most` with the required margins; 0 if there is none."""
    return largest_that(most, lambda integral: _holds(loops, proportional, integral, 0.0, wish))


def observer_gain(
    loops: Sequence[OpenLoop], proportional: float, integral: float, wish: Wish, halvings: int = HALVINGS
) -> float:
    """The largest L (Nm/rev) with the required margins, which hold without it; 0 if there is none."""
    axis = loops[0].axis
    most = proportional * axis.torque_constant_nm_per_a / max(axis.delay_s, SHORTEST_DELAY_S)  # as fast as the delay
    return largest_that(most, lambda gain: _holds(loops, proportional, integral, gain, wish), halvings)


def largest_that(most: float, holds: Callable[[float], bool], halvings: int = HALVINGS) -> float:
    """The largest value up to `most` that holds, where smaller ones do; 0 where none does."""
    least = 0.0
    for _ in range(halvings):
        middle = 0.5 * (least + most)
        if holds(middle):
            least = middle
        else:
            most = middle
    return least


def rest_margins(stuck: Sequence[LinearAxis], gains: Gains) -> Margins:
    """The smallest margins with the gains at rest, over the stiffnesses of the contact."""
    proportional, integral = (
        gains.rest_share * gains.proportional_a_per_rps,
        gains.rest_share * gains.integral_a_per_rev,
    )
    return worst_margins(loop_margins(one, proportional, integral, 0.0, gains.hold_a_per_rev_s) for one in stuck)


def hold_gain(stuck: Sequence[LinearAxis], gains: Gains) -> float:
    """Integral gain of the hold (A/rev/s): the largest with `REST_MARGIN_DEG` on the stuck axis, times the share of Kp
    and Ki.

    On the contact's spring k alone the hold is an integrator of bandwidth gain Kt / k, which a softer contact makes
    faster. It can be no faster than the spring's resonance. A contact that is loaded towards its Coulomb friction is
    softer, and where the share is small, the hold must be slow as well: at four times this gain axes hunt
    (results/position_hold.md).
    """

    def holds(gain: float) -> bool:
        margins = rest_margins(stuck, gains._replace(hold_a_per_rev_s=gain))
        return margins.phase_deg >= REST_MARGIN_DEG and margins.gain >= 1.0

    softest = over_loads(min(stuck, key=lambda one: one.contact_nm_per_rev))[-1]  # with the most inertia
    contact, constant = softest.contact_nm_per_rev, softest.torque_constant_nm_per_a
    most = math.sqrt(contact / softest.inertia_nm_s2_per_rev) * contact / constant
    return gains.rest_share * largest_that(most, holds)


def rest_share(stuck: Sequence[LinearAxis], proportional: float, integral: float) -> float:
    """The largest share of Kp and Ki with `REST_MARGIN_DEG` on the sticking axis; the smallest if none has it."""
    for share in REST_SHARES:
        margins = rest_margins(stuck, Gains(proportional, integral, 0.0, float(share)))
        if margins.phase_deg >= REST_MARGIN_DEG and margins.gain >= 1.0:
            return float(share)
    return float(REST_SHARES[-1])


def step_response(
    axis: LinearAxis, proportional: float, integral: float, duration_s: float, points: int = STEP_POINTS
) -> Floats:
    """Velocity (rps) after a unit step of the reference: PI with its zero, plant, delay; exact steps of the plant."""
    step_s = duration_s / points
    wait = round(axis.delay_s / step_s)
    kt, damping, inertia = axis.torque_constant_nm_per_a, axis.damping_nm_per_rps, axis.inertia_nm_s2_per_rev
    decay = math.exp(-damping * step_s / inertia)
    gain = -math.expm1(-damping * step_s / inertia) / damping if damping > 0.0 else step_s / inertia
    torque = np.zeros(points)
    velocity = np.zeros(points)
    integral_a, speed = 0.0, 0.0
    for k in range(points):
        velocity[k] = speed
        error = 1.0 - speed
        torque[k] = kt * (proportional * error + integral_a)
        integral_a += integral * error * step_s
        speed = decay * speed + gain * (torque[k - wait] if k >= wait else 0.0)
    return velocity


def design(
    axis: LinearAxis, attraction_nm_per_rev: float, wish: Wish | None = None, stuck: Sequence[LinearAxis] = ()
) -> Design:
    """Choose gains for an axis, and for the same axis at rest (`stuck`, on each stiffness; empty: not considered).

    `axis.damping_nm_per_rps` is the smallest one, sigma: the worst case of the margins.
    """
    wish = wish or Wish()
    proportional, integral, observer = _held_as_written(axis, gains_in_motion(axis, wish), wish)
    gains = Gains(proportional, integral, observer)
    if stuck:
        gains = gains._replace(rest_share=rest_share(stuck, proportional, integral))
        gains = gains._replace(hold_a_per_rev_s=hold_gain(stuck, gains))
    return judge(axis, attraction_nm_per_rev, gains, wish, stuck)


def judge(
    axis: LinearAxis, attraction_nm_per_rev: float, gains: Gains, wish: Wish | None = None,
    stuck: Sequence[LinearAxis] = (),
) -> Design:  # fmt: skip
    """Evaluate given gains on an axis."""
    wish = wish or Wish()
    proportional, integral, observer = gains.in_motion
    integral_time_s = proportional / integral if integral > 0.0 else math.inf
    duration_s = max(8.0 * integral_time_s, 0.5) if math.isfinite(integral_time_s) else 1.0
    response = step_response(axis, proportional, integral, duration_s)
    outside = np.flatnonzero(np.abs(response - 1.0) > 0.02)
    bound = real_pole_bound(axis, integral_time_s) if math.isfinite(integral_time_s) else 0.0
    margins_observer = loop_margins(axis, proportional, integral, observer)
    excess = condition_14_nm_per_rev(integral, axis.torque_constant_nm_per_a, observer, attraction_nm_per_rev)
    result = Design(
        gains,
        loop_margins(axis, proportional, integral, 0.0),
        margins_observer,
        rest_margins(stuck or (axis,), gains),
        excess,
        bound,
        100.0 * max(0.0, float(response.max()) - 1.0),
        float((outside[-1] + 1) * duration_s / response.size) if outside.size else 0.0,
        real_pole_range(axis, proportional, integral),
        margin_range(axis, gains, wish),
        (),
    )
    return result._replace(warnings=tuple(_warnings(result, wish)))


def real_pole_range(axis: LinearAxis, proportional: float, integral: float) -> DampingRange:
    """Damping from zero up (upwards without end, or in an open interval) over which both poles are real.

    (D + Kp Kt)^2 >= 4 J Ki Kt holds from one damping on upwards; below it the pair is complex. The other end of the
    paper's range, where the integral pole gets slow, is where the loop is ten times slower than 1/Ti.
    """
    kt = axis.torque_constant_nm_per_a
    lowest = max(0.0, 2.0 * math.sqrt(axis.inertia_nm_s2_per_rev * integral * kt) - proportional * kt)
    # the slow pole is about Ki Kt / (D + Kp Kt); a tenth of Ki / Kp is where tracking is lost
    return DampingRange(max(lowest, 0.01 * axis.damping_nm_per_rps), max(9.0 * proportional * kt, lowest))


def dampings_around(axis: LinearAxis, gains: Gains, count: int) -> Floats:
    """Friction damping from 0.01 to 1e4 times the axis' own, or times a thousandth of Kp Kt, below which D changes
    nothing. (count,)
    """
    own = max(axis.damping_nm_per_rps, 1e-3 * gains.proportional_a_per_rps * axis.torque_constant_nm_per_a)
    return np.asarray(own * np.geomspace(0.01, 1e4, count))


def margin_range(axis: LinearAxis, gains: Gains, wish: Wish) -> DampingRange:
    """Damping, within `dampings_around`, over which the margins hold without interruption."""
    dampings = dampings_around(axis, gains, 61)

    def held(place: int) -> bool:
        margins = loop_margins(axis._replace(damping_nm_per_rps=float(dampings[place])), *gains.in_motion)
        return margins.phase_deg >= wish.phase_margin_deg - 1e-9 and margins.gain >= wish.gain_margin - 1e-9

    low = high = 20  # the axis' own
    if not held(low):
        return DampingRange(axis.damping_nm_per_rps, axis.damping_nm_per_rps)
    while low > 0 and held(low - 1):
        low -= 1
    while high < dampings.size - 1 and held(high + 1):
        high += 1
    return DampingRange(float(dampings[low]), float(dampings[high]))


def _warnings(found: Design, wish: Wish) -> list[str]:
    texts = []
    if found.condition_14_nm_per_rev < -1e-9:
        texts.append(
            f"L is {-found.condition_14_nm_per_rev:.3g} Nm/rev below what condition (14) asks for, because the margins "
            "come first: it goes to the integral (learns_in: integral), where (14) does not apply"
        )
    for name, margins in (("PI alone", found.margins_pi), ("with observer", found.margins_observer)):
        if margins.phase_deg < wish.phase_margin_deg:
            texts.append(f"{name}: phase margin {margins.phase_deg:.1f} deg is below {wish.phase_margin_deg:g}")
        if margins.gain < wish.gain_margin:
            texts.append(f"{name}: gain margin {margins.gain:.2f} is below {wish.gain_margin:g}")
    if found.margins_rest.phase_deg < REST_MARGIN_DEG:
        texts.append(
            f"at rest: phase margin {found.margins_rest.phase_deg:.1f} deg on the contact's spring is below "
            f"{REST_MARGIN_DEG:g} even with the smallest gains that are tried: only less delay helps"
        )
    if found.without_overshoot.ratio < FRICTION_SPAN:
        texts.append(
            f"friction damping may vary only {found.without_overshoot.ratio:.3g}:1 with real poles, "
            f"{FRICTION_SPAN:g}:1 is the paper's figure: lower the bandwidth's damping ratio or raise the bandwidth"
        )
    return texts
