"""The figures of a tuning: root locus over the gain (Fig. 6), step, open loop with its margins, friction's damping."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..commissioning.record import ResponsePoints, ResponseRecord
from ..control.stability import (
    RIGID,
    Complexes,
    ElasticLoad,
    LinearAxis,
    Margins,
    error_response,
    impedance_nm_per_rps,
    loop_margins,
    mechanics_nm_per_rps,
    notch_response,
)
from ..control.velocity_estimator import estimator_response
from ..identification.sweep_response import SURE_COHERENCE
from ..identification.tuning import Design, Gains, Wish, dampings_around, root_locus, step_response
from ..model.friction import FrictionConfig
from .document import significant
from .figures import FREQUENCY, TIME, VELOCITY, Dash, Figure, LevelLine, PlotAxis, Series, Span, Uniform
from .response_figures import harmonic_damping

LOCUS_GAINS = 401
HIGHEST_GAIN = 2.5  # of the chosen one, in the s-plane
POINTS = 400
LOWEST_HZ, HIGHEST_HZ = 0.1, 500.0
LAST_TURN = 0.5  # turns of phase that the delay takes at the end of the figure
BEYOND_RESONANCE = 1.5  # of a resonance, the figure ends
DAMPINGS = 81
SHORTEST_STEP_S = 0.15


class Tuning(NamedTuple):
    """A design on its axis, and the required margins."""

    axis: LinearAxis
    design: Design
    wish: Wish
    friction: FrictionConfig
    by_notches: float | None = None  # times the integral action that is allowed without; None: no notch
    response: ResponseRecord | None = None  # as commissioning measured it

    @property
    def gains(self) -> Gains:
        """The chosen gains."""
        return self.design.gains

    @property
    def integral_time_s(self) -> float:
        """Kp / Ki."""
        return self.gains.proportional_a_per_rps / self.gains.integral_a_per_rev

    @property
    def integral_with_observer_a_per_rev(self) -> float:
        """In the worst case the observer is additional integral action with gain L."""
        return self.gains.integral_a_per_rev + self.gains.observer_nm_per_rev / self.axis.torque_constant_nm_per_a

    @property
    def worst_overshoot_percent(self) -> float:
        """Of a step of the reference with that integral action, zero and delay."""
        duration_s = max(SHORTEST_STEP_S, 1.5 * self.design.settled_s)
        integral = self.integral_with_observer_a_per_rev
        response = step_response(self.axis, self.gains.proportional_a_per_rps, integral, duration_s)
        return 100.0 * max(0.0, float(response.max()) - 1.0)


def locus_figures(tuning: Tuning) -> list[Figure]:
    """Fig. 6: both closed-loop poles as the proportional gain rises, the integral time kept; and near the bound."""
    chosen = tuning.gains.proportional_a_per_rps
    bound = tuning.design.real_poles_from_a_per_rps
    range_a = chosen * np.geomspace(0.005, HIGHEST_GAIN, LOCUS_GAINS)
    upper, lower = _branches(tuning, np.union1d(range_a, bound * np.linspace(0.9, 1.1, LOCUS_GAINS)[1::2]))
    series = [
        Series("one pole", upper.real, upper.imag, "blue", weight=2.0),
        Series("the other", lower.real, lower.imag, "purple", dash="dashed", weight=2.0),
    ]
    here = np.array(_branches(tuning, np.array([chosen]))).ravel()
    series.append(Series(f"chosen, Kp {significant(chosen)}", here.real, here.imag, "orange", "points"))
    if bound > 0.0:
        meet = np.array(_branches(tuning, np.array([bound * (1.0 + 1e-9)])))[:1].ravel()
        series.append(Series(f"real from Kp {significant(bound)}", meet.real, meet.imag, "green", "points"))
    zero = -1.0 / tuning.integral_time_s
    series.append(Series("zero of the PI", np.array([zero]), np.array([0.0]), "grey", "points"))
    caption = (
        f"PI and first-order plant at its smallest damping, without delay, Kp from {significant(range_a[0])} to "
        f"{significant(range_a[-1])} A/rps at Ti = {significant(tuning.integral_time_s)} s."
    )
    x, y = PlotAxis("real part", "1/s"), PlotAxis("imaginary part", "1/s")
    figures = [
        Figure(
            "root-locus", "xy", "Root locus", f"As in the paper's Fig. 6: {caption}", x, y, tuple(series), height_px=240
        )
    ]
    if bound > 0.0:
        near = x._replace(limits=(4.0 * zero, 0.4 * abs(zero)))
        title = "Root locus near the bound"
        figures.append(
            Figure("root-locus-near", "xy", title, "The same, near the zero.", near, y, tuple(series), "half")
        )
    return figures


def _branches(tuning: Tuning, gains: Floats) -> tuple[Floats, Floats]:
    """Upper or faster pole, and lower or slower pole, at each gain: complex (n,)."""
    points = root_locus(tuning.axis, tuning.integral_time_s, gains)
    poles = np.array([sorted(point.poles, key=lambda z: (z.imag, -z.real)) for point in points])
    return poles[:, 1], poles[:, 0]


def poles_figure(tuning: Tuning) -> Figure:
    """The same poles over the gain, with the bound above which they are real."""
    chosen, bound = tuning.gains.proportional_a_per_rps, tuning.design.real_poles_from_a_per_rps
    gains = np.geomspace(min(0.02 * chosen, 0.5 * bound if bound > 0.0 else chosen), 10.0 * chosen, LOCUS_GAINS)
    first, second = _branches(tuning, gains)
    turning = np.abs(first.imag)
    levels = [LevelLine(chosen, "chosen", upright=True)]
    if bound > 0.0:
        levels.append(LevelLine(bound, "real", upright=True))
    return Figure(
        name="poles", kind="xy", title="Poles over the gain",
        caption="Distance of the poles from the imaginary axis, and the frequency of a complex pair. Both stay real "
                f"from {significant(bound)} A/rps on; {significant(chosen)} is chosen.",
        x=PlotAxis("Kp", "A/rps", log=True), y=PlotAxis("pole", "1/s", log=True), width="half",
        series=(
            Series("−Re", gains, -first.real, "blue", weight=2.0),
            Series("−Re, other", gains, -second.real, "purple", dash="dashed", weight=2.0),
            Series("|Im|", gains, np.where(turning > 0.0, turning, np.nan), "orange", dash="dotted"),
        ),
        levels=tuple(levels),
    )  # fmt: skip


def step_figure(tuning: Tuning) -> Figure:
    """A step of the reference with the PI's zero and the delay, and without each of them."""
    design, axis, gains = tuning.design, tuning.axis, tuning.gains
    duration_s = max(SHORTEST_STEP_S, 1.5 * design.settled_s)
    prompt = axis._replace(delay_s=0.0)
    cases: tuple[tuple[str, LinearAxis, float, str, Dash, float], ...] = (
        ("PI, zero and delay", axis, gains.integral_a_per_rev, "blue", "solid", 2.0),
        ("without the delay", prompt, gains.integral_a_per_rev, "grey", "dashed", 1.3),
        ("with L, at worst", axis, tuning.integral_with_observer_a_per_rev, "orange", "dashdot", 1.5),
    )
    series = []
    for name, plant, integral, colour, dash, weight in cases:
        response = step_response(plant, gains.proportional_a_per_rps, integral, duration_s)
        thin = max(1, response.size // POINTS)
        grid = Uniform(0.0, duration_s / response.size * thin)
        series.append(Series(name, grid, response[::thin], colour, dash=dash, weight=weight))
    return Figure(
        name="step", kind="time", title="Step of the reference",
        caption="Unit step at the smallest damping, current not limited: "
                f"{significant(design.overshoot_percent, 2)} % overshoot, within 2 % after "
                f"{significant(1e3 * design.settled_s, 2)} ms. In the worst case the observer is an additional "
                "integral action L; this figure does not include friction that is compensated.",
        x=TIME, y=VELOCITY, series=tuple(series), levels=(LevelLine(1.0, ""),),
    )  # fmt: skip


def bode_figures(tuning: Tuning) -> list[Figure]:
    """Open loop with the delay, without and with the observer's L: gain and phase, zooming together."""
    highest_hz = max(LAST_TURN / max(tuning.axis.delay_s, 1e-4), BEYOND_RESONANCE * tuning.axis.elastic.frequency_hz)
    hz = np.geomspace(LOWEST_HZ, min(HIGHEST_HZ, highest_hz), POINTS)
    design, gains = tuning.design, tuning.gains
    observer, with_observer = gains.observer_nm_per_rev, design.margins_observer
    looks: list[tuple[str, LinearAxis, float, Margins, str, Dash]] = [
        ("PI", tuning.axis, 0.0, design.margins_pi, "blue", "solid"),
        ("PI and L", tuning.axis, observer, with_observer, "orange", "dashdot"),
    ]
    if tuning.axis.notches:
        plain = tuning.axis._replace(notches=())
        looks.append(("PI and L, no notch", plain, observer, with_observer, "grey", "dotted"))
    gain, phase, levels = [], [], []
    for name, axis, observer, margins, colour, dash in looks:
        loop = open_loop(axis, gains, observer, hz)
        gain.append(Series(name, hz, np.abs(loop), colour, dash=dash, weight=1.8))
        turned = np.degrees(np.unwrap(np.angle(loop)))
        phase.append(Series(name, hz, turned, colour, dash=dash, weight=1.8))
        if axis is tuning.axis and observer > 0.0 and np.isfinite(margins.crossover_hz):
            levels.append(LevelLine(margins.crossover_hz, "", upright=True))
    wanted = tuning.wish.phase_margin_deg
    elastic = (
        f" Drawn at the resonance of {significant(tuning.axis.elastic.frequency_hz)} Hz; margins are the smallest "
    )
    elastic += "ones over its interval."
    estimated = " Margins with the estimated velocity are the smaller ones of this loop and the one cut at the current."
    return [
        Figure(
            name="bode-gain", kind="xy", title="Open loop: gain", group="bode", width="half",
            caption=f"From velocity error to velocity. Crossover {significant(design.margins_pi.crossover_hz)} Hz "
                    f"with PI, {significant(design.margins_observer.crossover_hz)} Hz with L; gain margins "
                    f"{significant(design.margins_pi.gain)} and {significant(design.margins_observer.gain)}.",
            x=FREQUENCY, y=PlotAxis("gain", "-", log=True), series=tuple(gain), levels=(LevelLine(1.0, ""), *levels),
        ),
        Figure(
            name="bode-phase", kind="xy", title="Open loop: phase", group="bode", width="half",
            caption=f"Phase margins {significant(design.margins_pi.phase_deg)}° with PI, "
                    f"{significant(design.margins_observer.phase_deg)}° with L; {wanted:g}° are required."
                    + elastic * (tuning.axis.elastic != RIGID) + estimated * (tuning.axis.estimator is not None),
            x=FREQUENCY, y=PlotAxis("phase", "deg"), series=tuple(phase),
            levels=(LevelLine(-180.0, "−180°"), LevelLine(wanted - 180.0, f"{wanted:g}° margin"), *levels),
        ),
    ]  # fmt: skip


def open_loop(axis: LinearAxis, gains: Gains, observer_nm_per_rev: float, hz: Floats) -> Floats:
    """Complex open loop (n,) of `loop_margins`, cut at the velocity: L is additional integral action."""
    omega = 2.0 * np.pi * hz
    s, kt = 1j * omega, axis.torque_constant_nm_per_a
    controller = gains.proportional_a_per_rps * kt + (gains.integral_a_per_rev * kt + observer_nm_per_rev) / s
    controller = controller * error_response(axis, s)
    plant = np.exp(-s * axis.delay_s) / impedance_nm_per_rps(axis, s)
    if axis.estimator is not None:
        known = estimator_response(axis.estimator, omega)
        plant = known.of_position_per_s / s * plant + known.of_command_rps_per_a / kt
    return np.asarray(controller * plant)


def measured_figures(tuning: Tuning) -> list[Figure]:
    """The response that commissioning measured, in motion and at rest, with its fits and what the notches make of it:
    gain and phase, zooming together. None where it was not measured.
    """
    response = tuning.response
    if response is None:
        return []
    hz = np.geomspace(response.frequency_hz[0], response.frequency_hz[-1], POINTS)
    fitted = _fitted(response, response.damping_per_s, response.contact_per_s2, hz)
    curves: list[tuple[str, Floats, Complexes, str, Dash]] = [("fit", hz, fitted, "blue", "solid")]
    if tuning.axis.notches:
        behind = fitted * notch_response(tuning.axis.notches, 2j * np.pi * hz, tuning.axis.period_s)
        curves.append(("behind the notches", hz, behind, "purple", "dashdot"))
    measured: list[tuple[str, ResponsePoints, str]] = [("in motion", response, "orange")]
    at_rest = response.at_rest
    if at_rest is not None:
        held = at_rest.contacts[-1]
        stuck = _fitted(response, held.damping_per_s, held.contact_per_s2, hz)
        curves.append(("fit at rest", hz, stuck, "grey", "dashed"))
        measured.append(("at rest", at_rest, "green"))
    gain, phase = [], []
    for name, points, colour in measured:
        used = np.array(points.coherence) > SURE_COHERENCE
        places = np.array(points.frequency_hz)[used]
        gain.append(Series(name, places, np.array(points.gain_rps_per_a)[used], colour, "points"))
        phase.append(Series(name, places, _turned(np.array(points.phase_deg)[used]), colour, "points"))
    for name, places, values, colour, dash in curves:
        gain.append(Series(name, places, np.abs(values), colour, dash=dash, weight=1.8))
        phase.append(Series(name, places, _turned(np.degrees(np.angle(values))), colour, dash=dash, weight=1.8))
    levels = [LevelLine(notch.frequency_hz, "notch", upright=True) for notch in tuning.axis.notches]
    load = response.elastic
    found = "no elastic load was found"
    if load is not None:
        levels.append(LevelLine(load.frequency_hz, "resonance", upright=True))
        found = (
            f"fit: {significant(100.0 * load.share, 2)} % of the inertia on a spring at "
            f"{significant(load.frequency_hz)} Hz, damping ratio {significant(load.damping, 2)}, antiresonance at "
            f"{significant(load.antiresonance_hz)} Hz"
        )
    elif response.fit_error is not None:
        found = "neither one inertia nor a load on a spring fits it"
    of_rest = "At rest it was not measured, or shows no contact."
    if at_rest is not None and (contact := response.contact_nm_per_rev(tuning.axis.torque_constant_nm_per_a)):
        of_rest = (
            f"At rest, under {significant(at_rest.contacts[-1].current_a, 2)} A, friction holds the axis as a spring: "
            f"{significant(contact[0])} to {significant(contact[1])} Nm/rev."
        )
    margins = tuning.design.margins_observer
    return [
        Figure(
            name="response-gain", kind="xy", title="Measured response: gain", group="response", width="half",
            caption=f"Points that repeat (coherence above {SURE_COHERENCE:g}); {found}. {of_rest}",
            x=FREQUENCY, y=PlotAxis("gain", "rps/A", log=True), series=tuple(gain), levels=tuple(levels),
        ),
        Figure(
            name="response-phase", kind="xy", title="Measured response: phase", group="response", width="half",
            caption="With every delay between command and velocity. The open loop below is the controller times this "
                    f"response: phase margin {significant(margins.phase_deg)}°, gain margin "
                    f"{significant(margins.gain)} with L, crossover {significant(margins.crossover_hz)} Hz.",
            x=FREQUENCY, y=PlotAxis("phase", "deg"), series=tuple(phase), levels=tuple(levels),
        ),
    ]  # fmt: skip


def _fitted(response: ResponseRecord, damping_per_s: float, contact_per_s2: float, hz: Floats) -> Complexes:
    """Velocity over current by the fit, rps/A. (n,)"""
    s, load = 2j * np.pi * hz, response.elastic
    elastic = RIGID if load is None else ElasticLoad(load.share, load.frequency_hz, load.damping)
    late = np.exp(-s * (response.delay_s + response.hold_s))
    moved = mechanics_nm_per_rps(1.0, elastic, s) + damping_per_s + contact_per_s2 / s
    return np.asarray(response.gain_rps2_per_a * late / moved)


def _turned(phase_deg: Floats) -> Floats:
    """Without jumps, from between -180 and 180 degrees down. (n,)"""
    turned = np.unwrap(phase_deg, period=360.0)
    return np.asarray(turned - 360.0 * np.round(turned[:1] / 360.0)) if turned.size else turned


def damping_figures(tuning: Tuning) -> list[Figure]:
    """Phase margin over friction damping with the allowed range, and the amplitudes with that damping."""
    own = tuning.axis.damping_nm_per_rps
    damping = dampings_around(tuning.axis, tuning.gains, DAMPINGS)
    phase: dict[str, list[float]] = {"PI": [], "PI and L": []}
    for value in damping:
        varied = tuning.axis._replace(damping_nm_per_rps=float(value))
        for name, observer in (("PI", 0.0), ("PI and L", tuning.gains.observer_nm_per_rev)):
            margins = loop_margins(
                varied, tuning.gains.proportional_a_per_rps, tuning.gains.integral_a_per_rev, observer
            )
            phase[name].append(margins.phase_deg if np.isfinite(margins.phase_deg) else np.nan)
    held, real = tuning.design.within_margins, tuning.design.without_overshoot
    x = PlotAxis("friction damping D", "Nm/rps", log=True)
    amplitude = np.geomspace(1e-3, 50.0, DAMPINGS)
    friction = np.array([harmonic_damping(tuning.friction, float(a)) for a in amplitude])
    return [
        Figure(
            name="margin-over-damping", kind="xy", title="Phase margin over friction damping", width="half",
            caption=f"Margins hold from {significant(held.lowest)} to {significant(held.highest)} Nm/rps; poles are "
                    f"real and not ten times slower from {significant(real.lowest)} to {significant(real.highest)}. "
                    "A line ends where the gain does not cross 1.",
            x=x, y=PlotAxis("phase margin", "deg"),
            series=(
                Series("PI", damping, np.array(phase["PI"]), "blue", weight=1.8),
                Series("PI and L", damping, np.array(phase["PI and L"]), "orange", dash="dashdot", weight=1.8),
            ),
            spans=(Span(held.lowest, held.highest, "margins hold"),),
            levels=(LevelLine(tuning.wish.phase_margin_deg, "required"), LevelLine(own, "smallest", upright=True)),
        ),
        Figure(
            name="damping-over-amplitude", kind="xy", title="Friction damping over amplitude", width="half",
            caption="Steady friction of the model by harmonic balance (17). Between the lines both poles are real and "
                    "neither is ten times slower than 1/Ti; above, the loop follows only with friction compensated.",
            x=PlotAxis("amplitude of the velocity", "rps", log=True), y=PlotAxis("damping", "Nm/rps", log=True),
            series=(Series("model", amplitude, friction, "blue", weight=2.0),),
            levels=(LevelLine(real.lowest, "least"), LevelLine(real.highest, "most")),
        ),
    ]  # fmt: skip
