"""Stability of the loop with observer: condition (14) in torque units, and margins with the delay in the loop.

With lambda(e) = L e the estimate adds L / s to the controller (its worst case: the estimate's own decay helps), so the
open loop in torque units is

    G(s) = (Kp Kt + (Ki Kt + L) / s) / (J s + D + k / s) exp(-Td s)

with k = 0 in sliding. At rest the contact sticks: k is its stiffness, and what it takes away by hysteresis is left out,
which is the safe side. Above the resonance the delay turns the damping of Kp into its opposite: an axis whose margin
there is negative shakes at rest, whatever its margins in motion are. A part of the inertia may hang on a spring.
Low-pass and notches of the error multiply the controller; the position hold at rest does not pass them. A resonance is
known only so well: margins are the smallest ones over where it may be.

The load of an axis may change: then all of this holds over a range of inertia, and a margin is the smallest in it. The
motor, and the spring of an elastic load, stay as they are.

With an estimated velocity the delay is shorter by the lag of the drive's own. But the estimate also knows the command,
beside the axis: with a plant P, and the estimate H p + U i of position and command, the loop is cut at the velocity,
C (H P + U), and at the current, C H P / (1 + C U). The first is the loop with the shorter delay; the second is what an
axis of another gain meets, and it is the smaller margin. Both have to hold.

(14) reads Ki Kt + L >= 2 B. It belongs to the loop whose friction estimate takes lambda(e), and is not a margin: where
L goes to the integral the estimate is the model on a bounded reference, and there is nothing for (14) to bound.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats
from ..model.friction import FrictionConfig, steady_friction_nm
from ..model.parameters import ModelFile
from ..units import NORMAL_95, inertia_nm_s2_per_rev
from .notch import Notch, section_config
from .position_hold import held_travel_rev
from .velocity_estimator import EstimatorResponse, VelocityEstimatorConfig, estimator_response

Complexes = npt.NDArray[np.complexfloating[Any, Any]]

ELASTIC_PARAMETERS = ("share", "frequency_hz", "damping")  # of the effect elasticity
SWEEP_LOW_HZ = 1e-2
SWEEP_HIGH_HZ = 1e4
SWEEP_POINTS = 20_000
RESONANCE_SPREAD = 0.1  # of a resonance, either way, unless its interval is wider: load, wear and temperature move it
CONTACT_SPREAD = 0.2  # ... and the stiffness of a measured contact: that of its resonance, twice
CONTACT_OK = 1.5  # between contacts that are the same: their resonances differ by a fifth
LARGEST_SPREAD = 0.5  # a resonance that is known less well is not known
RESONANCES = 5  # that stand for a spread
STICK_SLIP_SPEEDS = np.geomspace(0.05, 5.0, 25)  # over the Stribeck velocity: the range in which the curve falls
SLOPE_STEP = 1e-3  # of the speed, for the slope of the Stribeck curve
ELASTIC_LOADS = 5  # in a range of inertia: the resonance moves with the load, and the worst one may lie inside


class ElasticLoad(NamedTuple):
    """Part of the inertia behind a damped spring; share 0: a rigid axis."""

    share: float = 0.0  # of the inertia
    frequency_hz: float = 0.0  # resonance of motor against load
    damping_ratio: float = 0.0  # of it


RIGID = ElasticLoad()


class MeasuredResponse(NamedTuple):
    """What a measured axis is in its band, over what inertia and elastic load make of it there; beyond the band: 1.

    Torque over velocity, both without friction and without a delay: friction, contact and delay are the axis' own, and
    a resonance sharper than the points are dense is in the elastic load, so that the ratio is smooth.
    """

    frequencies_hz: tuple[float, ...]  # (n,) rising
    ratio: tuple[complex, ...]  # (n,)


class LinearAxis(NamedTuple):
    """The axis linearised at one amplitude."""

    inertia_nm_s2_per_rev: float
    damping_nm_per_rps: float  # D of (17); the smallest one, sigma, is the worst case
    delay_s: float
    torque_constant_nm_per_a: float
    contact_nm_per_rev: float = 0.0  # stiffness of a sticking contact, a spring on the inertia; 0: sliding
    elastic: ElasticLoad = RIGID
    estimator: VelocityEstimatorConfig | None = None  # of the velocity in the error; None: the drive's own
    error_filter_s: float = 0.0  # time constant of the error's low-pass
    notches: tuple[Notch, ...] = ()  # on the error
    period_s: float = 0.0  # of the loop, in which the notches are sampled
    resonance_spread: float = 0.0  # share by which the resonance of the elastic load may differ, either way
    inertia_range_nm_s2_per_rev: tuple[float, float] | None = None  # least and largest load; None: one load
    measured: MeasuredResponse | None = None  # of inertia and elastic load, in its band
    measured_contact_nm_per_rev: tuple[float, float] | None = None  # softest and stiffest at rest; None: the model's

    def with_inertia(self, inertia_nm_s2_per_rev: float) -> LinearAxis:
        """The same axis with another load, and no range: motor, spring and the spring's damping are the same.

        k = w^2 Jm Jl / J and d = 2 zeta w Jm Jl / J stay, which gives w and zeta of another Jl; without one, with no
        more inertia than the motor's, the axis is rigid.
        """
        alone = self._replace(inertia_nm_s2_per_rev=inertia_nm_s2_per_rev, inertia_range_nm_s2_per_rev=None)
        share, frequency_hz, damping_ratio = self.elastic
        if share == 0.0:
            return alone
        other = 1.0 - (1.0 - share) * self.inertia_nm_s2_per_rev / inertia_nm_s2_per_rev  # Jm Jl / J is this times Jm
        if other <= 0.0:
            return alone._replace(elastic=RIGID)
        faster = math.sqrt(share / other)
        return alone._replace(elastic=ElasticLoad(other, faster * frequency_hz, faster * damping_ratio))


NOTHING = LinearAxis(1.0, 0.0, 0.0, 1.0)  # for what a part of an axis makes alone


class Margins(NamedTuple):
    """Margins of the open loop; infinite without a crossing."""

    phase_deg: float
    gain: float
    crossover_hz: float


def condition_14_nm_per_rev(
    integral_a_per_rev: float, torque_constant_nm_per_a: float, observer_gain_nm_per_rev: float,
    attraction_nm_per_rev: float,
) -> float:  # fmt: skip
    """Ki Kt + L - 2 B in Nm/rev: not negative if (14) holds."""
    return integral_a_per_rev * torque_constant_nm_per_a + observer_gain_nm_per_rev - 2.0 * attraction_nm_per_rev


def impedance_nm_per_rps(axis: LinearAxis, s: Complexes) -> Complexes:
    """Torque over velocity of the motor shaft, without the delay; s and the result (n,).

    Mechanics give no power, so that the phase of a measured ratio is lag on the way to the sensor. As a part of the
    mechanics one degree of it would outweigh sigma, and turn the damping of the contact's resonance into its opposite.
    """
    held = axis.damping_nm_per_rps + axis.contact_nm_per_rev / s
    return (moved_nm_per_rps(axis, s) + held) * measured_turn(axis, s)


def moved_nm_per_rps(axis: LinearAxis, s: Complexes) -> Complexes:
    """The part of inertia and elastic load in it, in size as measured where it was; s and the result (n,)."""
    return mechanics_nm_per_rps(axis.inertia_nm_s2_per_rev, axis.elastic, s) * np.abs(_measured_ratio(axis, s))


def measured_turn(axis: LinearAxis, s: Complexes) -> Complexes:
    """The phase of what was measured over the model, as a factor of size 1; s and the result (n,)."""
    ratio = _measured_ratio(axis, s)
    return np.asarray(ratio / np.abs(ratio))


def _measured_ratio(axis: LinearAxis, s: Complexes) -> Complexes:
    if axis.measured is None:
        return np.ones_like(s)
    measured_hz = np.array(axis.measured.frequencies_hz)
    return np.asarray(np.interp(np.abs(s) / (2.0 * math.pi), measured_hz, np.array(axis.measured.ratio), 1.0, 1.0))


def mechanics_nm_per_rps(inertia_nm_s2_per_rev: float, elastic: ElasticLoad, s: Complexes) -> Complexes:
    """Torque over velocity of the motor shaft by its inertia and what hangs on it, without friction; s (n,)."""
    share, frequency_hz, damping_ratio = elastic
    if share <= 0.0:
        return inertia_nm_s2_per_rev * s
    omega = 2.0 * math.pi * frequency_hz
    joint = (1.0 - share) * (omega * omega / s + 2.0 * damping_ratio * omega)  # over the inertia of the load
    return inertia_nm_s2_per_rev * ((1.0 - share) * s + share * joint * s / (s + joint))


def notch_response(notches: Sequence[Notch], s: Complexes, period_s: float) -> Complexes:
    """Frequency response of the sampled notches in a row; s = j omega and the result (n,)."""
    found = np.ones_like(s)
    z = np.exp(-s * period_s)
    for notch in notches:
        direct, middle, last, back = section_config(notch, period_s)
        found = found * (direct + z * (middle + z * last)) / (1.0 + z * (middle + z * back))
    return found


def error_response(axis: LinearAxis, s: Complexes) -> Complexes:
    """Low-pass and notches of the error; s = j omega and the result (n,)."""
    return notch_response(axis.notches, s, axis.period_s) / (1.0 + axis.error_filter_s * s)


def over_loads(axis: LinearAxis) -> tuple[LinearAxis, ...]:
    """The axis at the inertias that stand for its range, from the least to the largest; without a range the axis.

    A rigid one is judged at the ends: more inertia lowers the crossover, with less of the delay's phase and more of the
    integral's there, so that the phase margin has one maximum over it, and the gain margin rises. The model's inertia
    always belongs to the range.
    """
    if axis.inertia_range_nm_s2_per_rev is None:
        return (axis,)
    own = axis.inertia_nm_s2_per_rev
    least, most = min(*axis.inertia_range_nm_s2_per_rev, own), max(*axis.inertia_range_nm_s2_per_rev, own)
    places = np.geomspace(least, most, ELASTIC_LOADS if axis.elastic.share > 0.0 else 2).tolist()
    return tuple(axis.with_inertia(inertia) for inertia in places)


def spread_of(frequency_hz: float, sd_hz: float | None) -> float:
    """Share by which a resonance may differ, either way."""
    return max(RESONANCE_SPREAD, min(NORMAL_95 * (sd_hz or 0.0) / frequency_hz, LARGEST_SPREAD))


def over_resonances(axis: LinearAxis) -> tuple[LinearAxis, ...]:
    """The axis with the resonances that stand for the spread of its own; the axis itself where there is none."""
    spread = axis.resonance_spread
    if spread == 0.0 or axis.elastic.share == 0.0:
        return (axis,)
    alone = axis._replace(resonance_spread=0.0)
    return tuple(
        alone._replace(elastic=axis.elastic._replace(frequency_hz=factor * axis.elastic.frequency_hz))
        for factor in np.linspace(1.0 - spread, 1.0 + spread, RESONANCES).tolist()
    )


class OpenLoop:
    """The open loop of one axis but for its gains, of which a design tries hundreds."""

    def __init__(self, axis: LinearAxis, stride: int = 1, velocity_rps_per_nm: Complexes | None = None) -> None:
        """On each `stride`-th frequency. `velocity_rps_per_nm`: of the axis there, where it is known already."""
        omega = sweep_rad_per_s(axis.estimator)[::stride]
        self.axis = axis
        self._stride, self._omega = stride, omega
        self._plant = _velocity_rps_per_nm(axis, stride) if velocity_rps_per_nm is None else velocity_rps_per_nm
        filters = NOTHING._replace(
            error_filter_s=axis.error_filter_s, notches=axis.notches, period_s=axis.period_s, estimator=axis.estimator
        )
        self._of_error = _on_sweep(error_response, filters, stride)
        whole = self._of_error * self._plant
        self._magnitude, self._phase = np.abs(whole), _unwrapped(whole) - omega * axis.delay_s

    def behind(self, notches: tuple[Notch, ...]) -> OpenLoop:
        """The same with these notches."""
        return OpenLoop(self.axis._replace(notches=notches), self._stride, self._plant)

    def margins(
        self,
        proportional_a_per_rps: float,
        integral_a_per_rev: float,
        observer_gain_nm_per_rev: float,
        hold_a_per_rev_s: float = 0.0,
    ) -> Margins:
        """Phase and gain margin of PI plus observer; `hold_a_per_rev_s` as in `loop_margins`."""
        axis, omega, kt = self.axis, self._omega, self.axis.torque_constant_nm_per_a
        proportional, integral = proportional_a_per_rps * kt, integral_a_per_rev * kt + observer_gain_nm_per_rev
        if axis.estimator is None and hold_a_per_rev_s == 0.0:
            turning = integral / omega
            phase = self._phase - np.arctan2(turning, proportional)
            return _crossings(omega, self._magnitude * np.hypot(proportional, turning), phase)
        s = 1j * omega
        controller = (proportional + integral / s) * self._of_error
        hold = hold_a_per_rev_s * kt / (s * s)
        if axis.estimator is None:
            return margins_of(omega, (controller + hold) * self._plant, axis.delay_s)
        of_position_per_s, of_command_rps_per_a = (part[:: self._stride] for part in _response(axis.estimator))
        by_position = (of_position_per_s / s * controller + hold) * np.exp(-s * axis.delay_s) * self._plant
        by_command = of_command_rps_per_a * controller / kt
        at_velocity = margins_of(omega, by_position + by_command, 0.0)
        at_current = margins_of(omega, by_position / (1.0 + by_command), 0.0)
        return Margins(
            min(at_velocity.phase_deg, at_current.phase_deg),
            min(at_velocity.gain, at_current.gain),
            at_velocity.crossover_hz,
        )


@functools.lru_cache(maxsize=3)  # of an axis in motion and on both contacts, whose gains a design tries in turn
def open_loops(axis: LinearAxis, stride: int = 1) -> tuple[OpenLoop, ...]:
    """The loops over which the margins of an axis are the smallest ones."""
    return tuple(OpenLoop(one, stride) for load in over_loads(axis) for one in over_resonances(load))


def loop_margins(
    axis: LinearAxis, proportional_a_per_rps: float, integral_a_per_rev: float, observer_gain_nm_per_rev: float,
    hold_a_per_rev_s: float = 0.0,
) -> Margins:  # fmt: skip
    """Phase and gain margin of PI plus observer on the linearised axis, with its delay, its filter and its notches.

    `hold_a_per_rev_s`: the integral of the position at rest. The position is no older than the velocity.
    """
    gains = proportional_a_per_rps, integral_a_per_rev, observer_gain_nm_per_rev, hold_a_per_rev_s
    return worst_margins(loop.margins(*gains) for loop in open_loops(axis))


@functools.lru_cache(maxsize=8)  # a design evaluates the same filter some hundred times
def _response(estimator: VelocityEstimatorConfig) -> EstimatorResponse:
    return estimator_response(estimator, sweep_rad_per_s(estimator))


def _velocity_rps_per_nm(axis: LinearAxis, stride: int) -> Complexes:
    """One over the impedance, on each `stride`-th frequency of the sweep."""
    moving = NOTHING._replace(
        inertia_nm_s2_per_rev=axis.inertia_nm_s2_per_rev,
        elastic=axis.elastic,
        measured=axis.measured,
        estimator=axis.estimator,
    )
    s = 1j * sweep_rad_per_s(axis.estimator)[::stride]
    moved, turn = (_on_sweep(part, moving, stride) for part in (moved_nm_per_rps, measured_turn))
    return np.asarray(1.0 / ((moved + axis.damping_nm_per_rps + axis.contact_nm_per_rev / s) * turn))


@functools.lru_cache(maxsize=32)  # likewise; loads, resonances, dampings and contacts have most of it in common
def _on_sweep(response: Callable[[LinearAxis, Complexes], Complexes], axis: LinearAxis, stride: int) -> Complexes:
    """A response of an axis on each `stride`-th frequency of its sweep. Read only."""
    found = response(axis, 1j * sweep_rad_per_s(axis.estimator)[::stride])
    found.setflags(write=False)
    return found


def sweep_rad_per_s(estimator: VelocityEstimatorConfig | None = None) -> Floats:
    """Frequencies (SWEEP_POINTS,) in rad/s; a sampled filter has no response beyond half its rate. Read only."""
    return _sweep_rad_per_s(SWEEP_HIGH_HZ if estimator is None else 0.5 / estimator.period_s)


@functools.lru_cache(maxsize=8)  # likewise
def _sweep_rad_per_s(highest_hz: float) -> Floats:
    sweep = 2.0 * math.pi * np.geomspace(SWEEP_LOW_HZ, highest_hz, SWEEP_POINTS)
    sweep.setflags(write=False)
    return sweep


def margins_of(omega: Floats, rational: Complexes, delay_s: float) -> Margins:
    """Margins of an open loop over angular frequencies, arrays (n,), with an additional delay."""
    magnitude = np.abs(rational)
    phase = _unwrapped(rational)
    if phase[0] > 0.75 * math.pi:  # two integrators and a lag begin below -180 degrees, not below +180
        phase -= 2.0 * math.pi
    return _crossings(omega, magnitude, phase - omega * delay_s)


def _unwrapped(values: Complexes) -> Floats:
    """Phase (n,) without jumps, as of numpy.unwrap, which takes the remainder of every step, not of the jumps alone."""
    phase: Floats = np.asarray(np.angle(values), dtype=np.float64)
    steps = np.diff(phase)
    jumps = np.flatnonzero(np.abs(steps) > math.pi)
    if jumps.size:
        around = np.mod(steps[jumps] + math.pi, 2.0 * math.pi) - math.pi
        around[(around == -math.pi) & (steps[jumps] > 0.0)] = math.pi  # half a turn up stays one
        turns = np.zeros_like(steps)
        turns[jumps] = around - steps[jumps]
        phase[1:] += np.cumsum(turns)
    return phase


def _crossings(omega: Floats, magnitude: Floats, phase: Floats) -> Margins:
    """Margins of an open loop, arrays (n,); phase in radians, from where the loop begins down without a jump."""
    phase_deg = np.degrees(phase)
    below = np.flatnonzero((magnitude[:-1] >= 1.0) & (magnitude[1:] < 1.0))
    phase_margin_deg = 180.0 + float(phase_deg[below].min()) if below.size else math.inf
    # the gain margin counts downward crossings of -180 degrees, and of each turn below, where more gain encircles -1
    turns = np.ceil((phase_deg + 180.0) / 360.0)
    beyond = np.flatnonzero((turns[1:] < turns[:-1]) & (turns[1:] <= 0.0))
    gain_margin = 1.0 / float(magnitude[beyond].max()) if beyond.size else math.inf
    crossover_hz = float(omega[below[-1]] / (2.0 * math.pi)) if below.size else math.nan
    return Margins(phase_margin_deg, gain_margin, crossover_hz)


def feedback_lag_s(model: ModelFile, estimated: bool) -> float:
    """Lag of the velocity in the error behind the position, s; zero for an estimate."""
    return 0.0 if estimated else model.sensor_delay_s.value


def loop_delay_s(model: ModelFile, period_s: float, estimated: bool = False) -> float:
    """The total delay: command to torque, lag of the velocity in the error, and half a period of hold.

    A command acts one SYNC after the feedback from which it was computed, so a fit of less than a period to the
    position is an error.
    """
    to_position_s = max(period_s, model.delay_s.value - model.sensor_delay_s.value)
    return to_position_s + feedback_lag_s(model, estimated) + 0.5 * period_s


def linear_axis(
    model: ModelFile,
    period_s: float,
    estimator: VelocityEstimatorConfig | None = None,
    error_filter_s: float = 0.0,
    inertia_range_kg_m2: tuple[float, float] | None = None,
) -> LinearAxis:
    """The sliding axis of a model at its smallest damping, the viscous one, with an elastic load if the model has one.

    `estimator`: of the velocity in the error; None or unused: the drive's own velocity. `error_filter_s`: of the error.
    `inertia_range_kg_m2`: with all its loads.
    """
    if estimator is not None and not estimator.used:
        estimator = None
    config = model.axis_config()
    elastic = [effect for effect in model.effects if effect.name == "elasticity"]
    found, spread = RIGID, 0.0
    if elastic:
        share, resonance, damping = (elastic[0].parameters[name] for name in ELASTIC_PARAMETERS)
        found = ElasticLoad(share.value, resonance.value, damping.value)
        spread = spread_of(resonance.value, resonance.sd)
    axis = LinearAxis(
        config.inertia_nm_s2_per_rev,
        config.friction.viscous_nm_per_rps,
        loop_delay_s(model, period_s, estimator is not None),
        config.torque_constant_nm_per_a,
        elastic=found if found.share > 0.0 else RIGID,
        resonance_spread=spread if found.share > 0.0 else 0.0,
        estimator=estimator,
        error_filter_s=error_filter_s,
        period_s=period_s,
    )
    if inertia_range_kg_m2 is None:
        return axis
    least, most = inertia_range_kg_m2
    return axis._replace(inertia_range_nm_s2_per_rev=(inertia_nm_s2_per_rev(least), inertia_nm_s2_per_rev(most)))


def stuck_axes(sliding: LinearAxis, model: ModelFile, dead_band_rev: float) -> tuple[LinearAxis, LinearAxis]:
    """The same axis at rest, on its contact as soft and as stiff as it may be: as commissioning measured it, with
    CONTACT_SPREAD to both sides, or else as the model has it.
    """
    soft, stiff = contact_nm_per_rev(model, dead_band_rev)
    if sliding.measured_contact_nm_per_rev is not None:
        softest, stiffest = sliding.measured_contact_nm_per_rev
        soft, stiff = softest / (1.0 + CONTACT_SPREAD), stiffest * (1.0 + CONTACT_SPREAD)
    return sliding._replace(contact_nm_per_rev=soft), sliding._replace(contact_nm_per_rev=stiff)


def contact_nm_per_rev(model: ModelFile, dead_band_rev: float = 0.0) -> tuple[float, float]:
    """The contact of a model, as soft and as stiff as it may be.

    Unloaded, dF/dx of (2) and (3) at F = 0 is Fc K + B. Contacts follow other laws: one whose stiffness does not depend
    on the level, as LuGre's, and that carries Fs before it breaks away, is as stiff as Fs K + B. Over the travel that
    is held, none is stiffer than the secant of Fs; where 1/K is less than the position shows, a fit knows no more.
    """
    friction = model.friction_config()
    least_nm, most_nm = sorted((friction.coulomb_nm, friction.static_nm))
    soft = min(
        least_nm * friction.stiffness_per_rev + friction.attraction_nm_per_rev,
        friction.static_nm / held_travel_rev(friction.stiffness_per_rev, dead_band_rev),
    )
    return soft, most_nm * friction.stiffness_per_rev + friction.attraction_nm_per_rev


def is_same_contact(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two contacts, softest and stiffest, overlap within CONTACT_OK."""
    return one[0] <= CONTACT_OK * other[1] and other[0] <= CONTACT_OK * one[1]


def stick_slip_rps(
    axis: LinearAxis, friction: FrictionConfig, gains: tuple[float, float, float]
) -> tuple[float, float] | None:
    """The slowest and the fastest speed at which the axis would stick and slip under Kp, Ki and L; None: at none.

    Where the Stribeck curve falls, friction has negative damping. By (3) it follows its level over the travel S/B, so
    that linearised dF = S'(w) dw / (1 + s S/(B w)). An estimator of the velocity counts as its delay alone.
    """
    speeds_rps = friction.stribeck_velocity_rps * STICK_SLIP_SPEEDS
    slides = [_slides(one, friction, gains, speeds_rps.tolist()) for one in over_loads(axis)]
    found = speeds_rps[~np.all(slides, axis=0)].tolist()
    return (found[0], found[-1]) if found else None


def _slides(
    axis: LinearAxis, friction: FrictionConfig, gains: tuple[float, float, float], speeds_rps: Sequence[float]
) -> list[bool]:
    """Whether the loop is stable at each speed: Mikhailov's criterion, by the phase of the characteristic function
    beside that of the same loop without delay on friction that rises, which is passive.
    """
    proportional_a_per_rps, integral_a_per_rev, observer_nm_per_rev = gains
    omega = sweep_rad_per_s()
    s, kt = 1j * omega, axis.torque_constant_nm_per_a
    plant = s * impedance_nm_per_rps(axis, s)
    controller = s * proportional_a_per_rps * kt + integral_a_per_rev * kt + observer_nm_per_rev
    controller = controller * error_response(axis, s)
    with_delay, without = plant + controller * np.exp(-s * axis.delay_s), plant + controller
    found = []
    for speed_rps in speeds_rps:
        before_nm, level_nm, after_nm = (
            steady_friction_nm(friction, share * speed_rps) for share in (1.0 - SLOPE_STEP, 1.0, 1.0 + SLOPE_STEP)
        )
        slope = (after_nm - before_nm) / (2.0 * SLOPE_STEP * speed_rps) - friction.viscous_nm_per_rps
        follows = 1.0 + s * level_nm / (friction.attraction_nm_per_rev * speed_rps)
        loop, passive = follows * with_delay + s * slope, follows * without + s * abs(slope)
        turned, most = (float(np.subtract(*_unwrapped(values)[[-1, 0]])) for values in (loop, passive))
        found.append(turned > most - 0.5 * math.pi)  # each unstable pole takes half a turn
    return found


def worst_margins(found: Iterable[Margins]) -> Margins:
    """The smallest phase margin, with its crossover, and the smallest gain margin."""
    known = list(found)
    least = min(known, key=lambda one: one.phase_deg)
    return least._replace(gain=min(one.gain for one in known))
