"""Response of an axis to a sweep that repeats with its sign turned round, and the elastic load that it shows.

A sweep r of T seconds, then -r, and again, has lines at the odd multiples of 1/(2T) alone. What moves the axis beside
it and repeats with T has lines at the even ones: neither leaks into the other, and neither needs a window. From current
to the drive's own velocity, with everything that lies between (hold, delay, current loop, filter of the velocity):

    H(s) = g F(s) exp(-s Td) / (M(s) + d + k / s),    g = Kt / J,    F(s) = 1 / (1 + 2 z s/w + (s/w)^2)

M = s is a single rigid inertia, else that of a motor with a load on a spring. d and k are what friction and the contact
add at these amplitudes, over the inertia. The resonance is there if three more numbers explain far more than they would
of noise.

At rest k is all that holds the axis, and g, F, Td and M are known from the axis in motion: only d and k are fitted.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy  # its modules load where they are first used

from ..arrays import Floats
from ..control.stability import RIGID, ElasticLoad, mechanics_nm_per_rps

Complexes = npt.NDArray[np.complexfloating[Any, Any]]

SMOOTHED_LINES = 25  # over which the noise is averaged: a line has the noise of two or three periods
LEAST_NOISE = 0.005  # of the response: no line counts for more
OUTLIER_SDS = 3.0  # beyond which a line counts less
# F of three more numbers from which on a resonance is there. Rigid axes with cogging, ripple, sensor error and play
# stay below it (tests/commissioning/test_sweep.py)
LEAST_F = 25.0
LEAST_SHARE = 0.02
RESONANCES, SHARES, DAMPINGS, REFINED = 40, (0.1, 0.35, 0.6), (0.02, 0.08), 6  # starts, and the best that are refined
RESONANCE_SPAN = (0.8, 1.05)  # of the band: where a resonance is looked for, beyond its lowest and highest frequency
SURE_SPAN = (1.5, 1.02)  # ... and where it is believed: at the ends friction or a filter can pass for one
LOWEST = {"share": 0.0, "damping": 0.002}
HIGHEST = {"share": 0.95, "damping": 0.25}
ENOUGH, MOST_STEPS = 1e-6, 60  # relative change at which a fit ends, and its longest
BASE = 6  # numbers of a rigid axis
FILTERS_HZ, DELAYS_S = (400.0, 2000.0), (1.5e-3, 3e-3, 6e-3)  # starts
# of the contact at rest: no line counts for more than this share of the response, since a contact is no linear spring
CONTACT_NOISE = 0.1
CONTACTS, CONTACT_DAMPINGS, CONTACT_SPAN = 40, (0.05, 0.2, 0.5), np.array([0.5, 1.5])  # starts; of the band
LEAST_DAMPING, MOST_DAMPING = 0.005, 3.0  # damping ratios of the axis on its contact, in a fit
# what of a fit is believed: median error over the response at the lines that repeat, of which so many are needed. Of
# axes 5001 to 6087 of tools/trial_axes it was 0.15 to 0.38 where one spring holds the axis at rest, from 0.49 on behind
# backlash and under cogging or friction by angle; in motion 0.2 with a load on a spring, 0.7 with one in backlash
SURE_ERROR, SURE_LINES, SURE_COHERENCE = 0.45, 15, 0.8
SURE_DAMPING, SURE_CONTACT_SD = 1.0, 0.1  # ... and at rest: this damping ratio, and relative standard deviation of k


class SweepLines(NamedTuple):
    """Response at the lines of a sweep, (n,) each."""

    frequencies_hz: Floats
    response: Complexes  # velocity over current, rps/A
    noise: Floats  # standard deviation of the response, from period to period

    @property
    def coherence(self) -> Floats:
        """Share of the answer's power that repeats."""
        power = np.abs(self.response) ** 2
        return np.asarray(power / (power + self.noise**2))


class ContactFit(NamedTuple):
    """The contact of an axis at rest, over the inertia of motor and load."""

    contact_per_s2: float  # k
    contact_sd_per_s2: float
    damping_per_s: float  # d
    doubt: str  # why it is not the contact; empty: it is
    numbers: Floats  # of the fit, as `_modelled` takes them

    def response(self, frequency_hz: Floats) -> Complexes:
        """Velocity over current, rps/A. (n,)"""
        return _modelled(self.numbers, 2j * math.pi * frequency_hz)


class SweepFit(NamedTuple):
    """Axis and elastic load, with standard deviations."""

    gain_rps2_per_a: float
    delay_s: float  # command to velocity, with the hold and the lag of the drive's filter
    damping_per_s: float  # d: what friction adds, over the inertia
    contact_per_s2: float  # k: ... and the contact
    elastic: ElasticLoad  # RIGID where none was found
    elastic_sd: ElasticLoad
    evidence: float  # F of the elastic load; beyond LEAST_F it is there
    numbers: Floats  # of the fit, as `_modelled` takes them
    error: float  # of the fit with an elastic load, as `_error` has it; beyond SURE_ERROR the load is not believed

    def response(self, frequency_hz: Floats) -> Complexes:
        """Velocity over current, rps/A. (n,)"""
        return _modelled(self.numbers, 2j * math.pi * frequency_hz)


def sweep_lines(
    current_a: Floats, velocity_rps: Floats, period_s: float, sweep_s: float, band_hz: tuple[float, float]
) -> SweepLines:
    """Lines of whole periods of the sweep and its negative, (periods, 2 T / period_s) each; at least two of them."""
    samples = current_a.shape[1]
    frequency_hz = np.arange(samples // 2 + 1) / (2.0 * sweep_s)
    inside = (frequency_hz >= band_hz[0]) & (frequency_hz <= band_hz[1]) & (np.arange(samples // 2 + 1) % 2 == 1)
    into, out = (np.fft.rfft(values, axis=1)[:, inside] for values in (current_a, velocity_rps))
    mean = into.mean(axis=0)
    each = out / mean
    spread = np.var(each, axis=0, ddof=1) / each.shape[0]
    response = out.mean(axis=0) / mean
    relative = spread / np.abs(response) ** 2
    near = np.minimum(SMOOTHED_LINES, relative.size)
    padded = np.pad(relative, (near // 2, near - 1 - near // 2), mode="edge")
    smoothed = np.median(np.lib.stride_tricks.sliding_window_view(padded, near), axis=1)
    noise = np.abs(response) * np.sqrt(np.maximum(smoothed, LEAST_NOISE**2))
    return SweepLines(frequency_hz[inside], response, noise)


def fit_sweep(lines: SweepLines, delay_s: float) -> SweepFit:
    """The axis, with the elastic load where there is one. `delay_s`: about its delay; a fit begins there as well."""
    s = 2j * math.pi * lines.frequencies_hz
    gain = float(np.median(np.abs(lines.response * s)[: max(3, lines.frequencies_hz.size // 6)]))
    rigid = min(
        (
            _fit(lines, np.array([math.log(gain), start_s, math.log(filter_hz), 1.0, 1.0, 0.0]))
            for start_s in (*DELAYS_S, delay_s)
            for filter_hz in FILTERS_HZ
        ),
        key=lambda found: float(found.cost),
    )
    low_hz, high_hz = _resonances_hz(lines)
    starts = [
        np.concatenate([base, [share, math.log(frequency_hz), math.log(damping)]])
        for frequency_hz in np.geomspace(low_hz, high_hz, RESONANCES)
        for share in SHARES
        for damping in DAMPINGS
        for base in (rigid.x, _of_the_motor(rigid.x, share))
    ]
    starts.sort(key=lambda x: _robust_cost(_errors(lines, x)))
    elastic = min((_fit(lines, start) for start in starts[:REFINED]), key=lambda found: float(found.cost))
    freedom = 2 * lines.frequencies_hz.size - elastic.x.size
    evidence = (rigid.cost - elastic.cost) / 3.0 / max(elastic.cost / freedom, 1e-300)
    share, log_hz, log_damping = elastic.x[BASE:]
    error = _error(lines, elastic.x)
    there = (
        evidence > LEAST_F
        and error <= SURE_ERROR
        and share > LEAST_SHARE
        and SURE_SPAN[0] * lines.frequencies_hz[0] < math.exp(log_hz) < SURE_SPAN[1] * lines.frequencies_hz[-1]
        and math.exp(log_damping) < 0.99 * HIGHEST["damping"]
    )
    found = elastic if there else rigid
    load = ElasticLoad(float(share), math.exp(log_hz), math.exp(log_damping)) if there else RIGID
    log_gain, fitted_s, log_filter_hz, filter_damping, damping, contact = (float(v) for v in found.x[:BASE])
    lag_s = filter_damping / (math.pi * math.exp(log_filter_hz))
    return SweepFit(
        math.exp(log_gain),
        fitted_s + lag_s,
        damping,
        contact,
        load,
        _elastic_sd(found, load, freedom) if there else RIGID,
        float(evidence),
        found.x,
        error,
    )


def fit_contact(lines: SweepLines, moving: SweepFit) -> ContactFit:
    """Stiffness and damping of the contact that holds the axis at rest, with all else as in motion."""
    s = 2j * math.pi * lines.frequencies_hz
    noise = np.maximum(lines.noise, CONTACT_NOISE * np.abs(lines.response))

    def errors(x: Floats) -> Floats:
        errors = (_modelled(_on_contact(moving, x), s) - lines.response) / noise
        return np.concatenate([errors.real, errors.imag])

    low_hz, high_hz = (
        CONTACT_SPAN[0] * float(lines.frequencies_hz[0]),
        CONTACT_SPAN[1] * float(lines.frequencies_hz[-1]),
    )
    starts = [
        np.log([frequency_hz, damping])
        for frequency_hz in np.geomspace(1.01 * low_hz, 0.99 * high_hz, CONTACTS)
        for damping in CONTACT_DAMPINGS
    ]
    starts.sort(key=lambda x: _robust_cost(errors(x)))
    bounds = np.log([[low_hz, LEAST_DAMPING], [high_hz, MOST_DAMPING]])
    found = min(
        (_least_squares(errors, start, bounds, [0.1, 0.3]) for start in starts[:REFINED]),
        key=lambda one: float(one.cost),
    )
    frequency_hz, damping = np.exp(found.x).tolist()
    sd = 2.0 * math.sqrt(float(_covariance(found, 2 * s.size - 2)[0, 0]))  # of log k, twice that of log f
    numbers = _on_contact(moving, found.x)
    damping_per_s, contact_per_s2 = numbers[4:BASE].tolist()
    doubt = ""
    if np.sum(lines.coherence > SURE_COHERENCE) < SURE_LINES:
        doubt = "the sensor hardly shows how the axis moves under currents that do not move it away"
    elif not lines.frequencies_hz[0] < frequency_hz < lines.frequencies_hz[-1]:
        doubt = f"no resonance on friction from {lines.frequencies_hz[0]:.0f} to {lines.frequencies_hz[-1]:.0f} Hz"
    elif damping > SURE_DAMPING or sd > SURE_CONTACT_SD or _error(lines, numbers) > SURE_ERROR:
        doubt = "the axis at rest does not answer as one that friction holds on a spring"
    return ContactFit(contact_per_s2, sd * contact_per_s2, damping_per_s, doubt, numbers)


def _on_contact(moving: SweepFit, x: Floats) -> Floats:
    """The numbers of an axis in motion, with resonance and damping ratio on a contact, in logarithms, instead."""
    omega, damping = 2.0 * math.pi * math.exp(x[0]), math.exp(x[1])
    numbers = moving.numbers.copy()
    numbers[4:BASE] = 2.0 * damping * omega, omega * omega
    return numbers


def _of_the_motor(x: Floats, share: float) -> Floats:
    """A rigid axis as the motor of an elastic one: above the resonance only the motor is moved."""
    return np.array([x[0] + math.log(1.0 - share), *x[1:4], 1.0, 0.0])


def _resonances_hz(lines: SweepLines) -> tuple[float, float]:
    return RESONANCE_SPAN[0] * float(lines.frequencies_hz[0]), RESONANCE_SPAN[1] * float(lines.frequencies_hz[-1])


def _smooth(x: Floats, s: Complexes) -> Complexes:
    """Filter of the velocity and delay."""
    normal = s / (2.0 * math.pi * math.exp(x[2]))
    return np.asarray(np.exp(-s * x[1]) / (1.0 + 2.0 * x[3] * normal + normal**2))


def _modelled(x: Floats, s: Complexes) -> Complexes:
    elastic = RIGID if x.size == BASE else ElasticLoad(float(x[6]), math.exp(x[7]), math.exp(x[8]))
    return np.asarray(math.exp(x[0]) * _smooth(x, s) / (mechanics_nm_per_rps(1.0, elastic, s) + x[4] + x[5] / s))


def _errors(lines: SweepLines, x: Floats) -> Floats:
    """Over the noise, real and imaginary parts. (2 n,)"""
    errors = (_modelled(x, 2j * math.pi * lines.frequencies_hz) - lines.response) / lines.noise
    return np.concatenate([errors.real, errors.imag])


def _error(lines: SweepLines, x: Floats) -> float:
    """Median of the error over the response, at the lines that repeat; 0 where they are too few to tell."""
    seen = lines.coherence > SURE_COHERENCE
    if seen.sum() < SURE_LINES:
        return 0.0
    fitted = _modelled(x, 2j * math.pi * lines.frequencies_hz[seen])
    return float(np.median(np.abs(fitted / lines.response[seen] - 1.0)))


def _robust_cost(errors: Floats) -> float:
    return float(np.sum(np.sqrt(1.0 + (errors / OUTLIER_SDS) ** 2) - 1.0))


def _fit(lines: SweepLines, start: Floats) -> Any:
    """Least squares whose outliers count less, from a start that may be outside of what is possible."""
    low_hz, high_hz = _resonances_hz(lines)
    low = [-np.inf, 0.0, math.log(150.0), 0.5, -8.0, -5e2]
    high = [np.inf, 0.05, math.log(5000.0), 2.0, 500.0, 1e5]
    scale = [0.1, 1e-4, 0.3, 0.2, 1.0, 100.0]
    if start.size > BASE:
        low += [LOWEST["share"], math.log(low_hz), math.log(LOWEST["damping"])]
        high += [HIGHEST["share"], math.log(high_hz), math.log(HIGHEST["damping"])]
        scale += [0.1, 0.1, 0.3]

    def errors(x: Floats) -> Floats:
        return _errors(lines, x)

    return _least_squares(errors, start, np.array([low, high]), scale)


def _least_squares(errors: Callable[[Floats], Floats], start: Floats, bounds: Floats, scale: list[float]) -> Any:
    """Least squares whose outliers count less, between two rows of bounds."""
    inside = np.clip(start, bounds[0] + 1e-9, bounds[1] - 1e-9)
    return scipy.optimize.least_squares(
        errors,
        inside,
        bounds=(bounds[0], bounds[1]),
        x_scale=scale,
        loss="soft_l1",
        f_scale=OUTLIER_SDS,
        ftol=ENOUGH,
        xtol=ENOUGH,
        max_nfev=MOST_STEPS,
    )


def _elastic_sd(found: Any, load: ElasticLoad, freedom: int) -> ElasticLoad:
    """By the curvature of the fit, with the errors that it leaves."""
    share, log_hz, log_damping = np.sqrt(np.maximum(np.diag(_covariance(found, freedom))[BASE:], 0.0))
    return ElasticLoad(float(share), float(load.frequency_hz * log_hz), float(load.damping_ratio * log_damping))


def _covariance(found: Any, freedom: int) -> Floats:
    return np.asarray(np.linalg.pinv(found.jac.T @ found.jac) * 2.0 * float(found.cost) / max(freedom, 1))
