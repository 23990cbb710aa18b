"""The sweeps of commissioning: of an axis that moves back and forth, and of the same axis at rest.

At rest the contact carries the axis like a spring of its own, and each reversal dampens it: a small sweep measures
that. For what the axis itself is, it slides at a slow speed: a kick turns it round, a bias holds its speed against
friction until the next kick, and the sweep moves it by less. Each sweep is followed by its negative
(identification.sweep_response). Signs, scales, gain and delay have passed by then, and a velocity loop of SLOW_HZ, far
below any resonance that is looked for, keeps the axis where it is; kick and bias are corrected second by second until
that loop has little left to do.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..control.envelope import TRIP_OVERSPEED, TRIP_POSITION_WINDOW
from ..control.reference import MODE_VELOCITY, Profile
from ..control.stability import RIGID, Complexes
from ..identification.excitation import chirp
from ..identification.sweep_response import (
    SURE_ERROR,
    ContactFit,
    SweepFit,
    SweepLines,
    fit_contact,
    fit_sweep,
    sweep_lines,
)
from .bounds import Bounds, SlowLoop
from .estimate import GainFit
from .motion import PulseMotion, extreme
from .motion_checks import MOVED_REV
from .pulses import LEAD_S, current_profile
from .record import ContactRecord, ElasticRecord, ResponseRecord, RestRecord, SwingRecord

SWEEP_S = 1.0  # of one sweep; its lines lie 1 Hz apart
BAND_HZ = (10.0, 400.0)
HIGHEST_SHARE = 0.4  # of the loop's rate
# of sweep and negative, a run has two: the first brings the axis into its swing, the second is measured
PAIRS, RUNS = 2, 3
SPEED_SHARE = 0.06  # of the speed bound: amplitude of the sweep ...
CURRENT_SHARE = 0.25  # ... and no more of the current bound, where the inertia would ask for it
FIRST_SHARE = 0.6  # of the current that just moves the axis, and of the kick by its inertia: they begin small
WANTED_SHARE = 0.35  # of the speed bound: with which the axis slides
LARGEST_SHARE = 0.65  # of it: the highest speed, with the sweep
SLIDING_LEAST, SLIDING_MOST = 0.4, 1.6  # of the wanted speed, after a kick and before the next
LARGEST_CHANGE = 1.4  # of a kick at a time. Speed rises faster than in proportion: friction takes its part
SWING_HZ = 3  # a whole number: it repeats with the sweep
KICK_SHARE = 0.25  # of half a period
SLOW_HZ, FILTER_HZ, CORNER_HZ = 2.0, 8.0, 0.5  # crossover of the slow loop, its filter, its integral
MOST_TRIALS = 16
MOST_TRIPS = 5
# A run is torn, and made again, where feedback is missing for longer: a gap of 2 ms in each run moved no margin of the
# example by more than 5 degrees, one of 4 ms puts single lines far off
LONGEST_GAP_S = 1e-3
MOST_TORN = 6
EASED = 0.8  # speed and sweep, after a trip
POINTS = 150  # of the response in a record
REST_SHARES = (0.06, 0.15, 0.4)  # of the current that just moves the axis: amplitudes at rest, far below it
REST_PAIRS = 3  # of sweep and negative at rest
TOO_FAR = (TRIP_OVERSPEED, TRIP_POSITION_WINDOW)  # a swing that was too large


class Swing(NamedTuple):
    """Currents that make the axis move back and forth, and the sweep on top."""

    speed_rps: float
    kick_a: float  # beyond the bias
    forward_a: float  # bias, positive where it pushes forwards
    backward_a: float
    sweep_rps: float  # amplitude where inertia alone is moved ...
    most_sweep_a: float  # ... with no more current than this

    @property
    def most_a(self) -> float:
        """The largest current that is planned."""
        return max(abs(self.forward_a), abs(self.backward_a)) + self.kick_a + self.most_sweep_a


class Sweeps:
    """Sweeps of one axis, from what its pulses have told."""

    def __init__(self, bounds: Bounds, breakaway_a: float, gain: GainFit, period_s: float) -> None:
        self.bounds, self.period_s = bounds, period_s
        self._gain, self.delay_s = gain.gain_rps2_per_a, gain.delay_s
        self.band_hz = (BAND_HZ[0], min(BAND_HZ[1], HIGHEST_SHARE / period_s))
        speed_rps, bias_a = WANTED_SHARE * bounds.speed_rps, FIRST_SHARE * breakaway_a
        kick_a = FIRST_SHARE * 2.0 * speed_rps / (self._gain * KICK_SHARE * 0.5 / SWING_HZ)
        most_sweep_a = CURRENT_SHARE * bounds.current_a
        self.swing = Swing(speed_rps, kick_a, bias_a, -bias_a, SPEED_SHARE * bounds.speed_rps, most_sweep_a)
        self._trips = self._trials = self._torn = 0
        self._slides = False
        self._way = 1.0  # in which the next motion begins: they take turns, or the axis would wander
        self.measured: list[PulseMotion] = []
        self.fitted: SweepFit | None = None  # to them

    @property
    def loop(self) -> SlowLoop:
        """The slow loop."""
        proportional = 2.0 * math.pi * SLOW_HZ / self._gain
        return SlowLoop(
            proportional,
            2.0 * math.pi * CORNER_HZ * proportional,
            -math.expm1(-2.0 * math.pi * FILTER_HZ * self.period_s),
            self.delay_s / self.period_s + 0.5,
        )

    @property
    def _half_kick(self) -> int:
        """Samples of the kick from rest."""
        return round(KICK_SHARE * 0.25 / SWING_HZ / self.period_s)

    @property
    def done(self) -> bool:
        """Whether the response is measured."""
        return len(self.measured) == RUNS

    @property
    def refusal(self) -> str | None:
        """Why no more is tried."""
        if self._torn > MOST_TORN:
            return f"feedback was missing for more than {LONGEST_GAP_S * 1e3:g} ms in {self._torn} runs of it"
        if self._trials >= MOST_TRIALS or self._trips > MOST_TRIPS or self.swing.most_a > self.bounds.current_a:
            return "no current within the bounds makes the axis move back and forth at a steady speed"
        return None

    def next(self) -> Profile:
        """The next motion: trials of a second until the axis slides as it should, then runs."""
        if self._slides:
            return self._profile(2 * PAIRS)
        self._trials += 1
        return self._profile(1)

    def made(self, motion: PulseMotion) -> None:
        """Take a motion that went to its end, and correct the swing."""
        fast = abs(extreme(motion.velocity_rps)) > LARGEST_SHARE * self.bounds.speed_rps
        slid = self._corrected(motion)
        if fast and max(slid) < SLIDING_MOST:  # not because it slides too fast: it swings on a spring
            self.ease()
            return
        pair = self._samples(2 * PAIRS)[-2 * round(SWEEP_S / self.period_s) :]
        if self._slides and self.is_torn(motion, pair):
            self._torn += 1
        elif self._slides and not fast:
            self.measured.append(motion)
        self._slides = not fast and min(slid) > SLIDING_LEAST and max(slid) < SLIDING_MOST
        self._way = -self._way

    def ease(self) -> None:
        """A smaller swing, after one that went too fast."""
        self._trips += 1
        self._slides = False
        swing = self.swing
        self.swing = swing._replace(
            speed_rps=EASED * swing.speed_rps,
            kick_a=EASED * swing.kick_a,
            sweep_rps=EASED * swing.sweep_rps,
            most_sweep_a=EASED * swing.most_sweep_a,
        )

    def _profile(self, sweeps: int) -> Profile:
        """So many sweeps, every other one negative; it begins and ends at rest, with half a kick."""
        swing, period_s = self.swing, self.period_s
        samples = round(SWEEP_S / period_s)
        frequency_hz = self.band_hz[0] * (self.band_hz[1] / self.band_hz[0]) ** (np.arange(samples) / samples)
        amplitude_a = np.minimum(swing.sweep_rps * 2.0 * math.pi * frequency_hz / self._gain, swing.most_sweep_a)
        once = amplitude_a * chirp(*self.band_hz, SWEEP_S, period_s)
        sign = np.repeat(np.where(np.arange(sweeps) % 2 == 0, 1.0, -1.0), samples)
        side, since = self._half_periods(np.arange(float(sweeps * samples)) * period_s)
        kicked = since < KICK_SHARE
        speed_rps = swing.speed_rps * side * np.where(kicked, 2.0 * since / KICK_SHARE - 1.0, 1.0)
        slide_a = np.where(side > 0.0, swing.forward_a, swing.backward_a) + kicked * side * swing.kick_a
        half = self._half_kick
        rest, rise = np.zeros(round(LEAD_S / period_s)), np.arange(half) / half
        bias_a = swing.forward_a if self._way > 0.0 else swing.backward_a
        start_a, stop_a = bias_a + self._way * swing.kick_a, bias_a - self._way * swing.kick_a
        first_rps = self._way * swing.speed_rps
        velocity_rps = [rest, first_rps * rise, speed_rps, first_rps * (1.0 - rise), rest]
        current_a = [rest, np.full(half, start_a), sign * np.tile(once, sweeps) + slide_a, np.full(half, stop_a), rest]
        return Profile("sweep", MODE_VELOCITY, period_s, np.concatenate(velocity_rps), np.concatenate(current_a))

    def _swept(self, motion: PulseMotion, sweeps: int) -> tuple[Floats, Floats, Floats]:
        """Command, velocity and position at each tick of the sweeps."""
        return _ticks(motion, self._samples(sweeps))

    def _samples(self, sweeps: int) -> Integers:
        """Those of a profile in which it has so many sweeps."""
        first = round(LEAD_S / self.period_s) + self._half_kick
        return first + np.arange(sweeps * round(SWEEP_S / self.period_s))

    def is_torn(self, motion: PulseMotion, measured: Integers) -> bool:
        """Whether feedback was missing for too long in what of a profile is measured."""
        seen = np.intersect1d(measured, motion.sample)
        gap_s = float(np.diff(seen, prepend=measured[0] - 1, append=measured[-1] + 1).max() - 1) * self.period_s
        return gap_s > max(LONGEST_GAP_S, 1.5 * self.period_s)

    def _half_periods(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Side of the half period, and the share of it that has passed. It begins after a kick."""
        halves = 2.0 * SWING_HZ * time_s + KICK_SHARE
        number = np.floor(halves)
        return self._way * np.where(number % 2 == 0, 1.0, -1.0), halves - number

    def _corrected(self, motion: PulseMotion) -> tuple[float, float]:
        """Correct the swing after a motion. Its speed after a kick and before the next, over what it should be."""
        command_a, velocity_rps, _ = self._swept(motion, 2 * PAIRS if self._slides else 1)
        side, since = self._half_periods(np.arange(float(command_a.size)) * self.period_s - self.delay_s)
        third = (1.0 - KICK_SHARE) / 3.0
        along_rps, swing = side * velocity_rps, self.swing
        after_rps = float(np.mean(along_rps[(since >= KICK_SHARE) & (since < KICK_SHARE + third)]))
        before_rps = float(np.mean(along_rps[since >= 1.0 - third]))
        held = since >= KICK_SHARE
        # what did not hold the speed made it rise or fall
        rising_a = (before_rps - after_rps) / (2.0 * third * 0.5 / SWING_HZ) / self._gain
        forward_a, backward_a = (
            float(np.mean(command_a[held & (side == way)])) - way * rising_a for way in (1.0, -1.0)
        )
        missing = 2.0 * swing.speed_rps / max(after_rps + before_rps, 2.0 * swing.speed_rps / LARGEST_CHANGE**2)
        kick_a = swing.kick_a * min(max(math.sqrt(missing), 1.0 / LARGEST_CHANGE), LARGEST_CHANGE)
        self.swing = swing._replace(
            kick_a=kick_a,
            forward_a=0.5 * (swing.forward_a + forward_a),
            backward_a=0.5 * (swing.backward_a + backward_a),
        )
        return after_rps / swing.speed_rps, before_rps / swing.speed_rps

    def lines(self) -> SweepLines:
        """The response, from the last pair of every run."""
        samples = 2 * round(SWEEP_S / self.period_s)
        pairs = [[values[-samples:] for values in self._swept(motion, 2 * PAIRS)] for motion in self.measured]
        current_a, velocity_rps, _ = (np.array(values) for values in zip(*pairs, strict=True))
        return sweep_lines(current_a, velocity_rps, self.period_s, SWEEP_S, self.band_hz)

    def repeated(self) -> tuple[Floats, Floats]:
        """Position and velocity without the sweep, which a pair adds up to nothing; (runs, pairs, samples) each.

        In all pairs of a run the axis makes the same motion.
        """
        made = np.array([self._swept(motion, 2 * PAIRS)[1:] for motion in self.measured])
        velocity_rps, position_rev = made.reshape(RUNS, 2, PAIRS, 2, -1).sum(axis=3).swapaxes(0, 1) / math.sqrt(2.0)
        return position_rev, velocity_rps


class RestSweeps:
    """Sweeps of an axis at rest, so small that friction holds it: a spring on the inertia.

    They grow while it holds. No loop is closed.
    """

    def __init__(self, sweeps: Sweeps, breakaway_a: float) -> None:
        """`sweeps`: of the same axis in motion, with their fit."""
        assert sweeps.fitted is not None
        self._sweeps, self._breakaway_a, self._moving = sweeps, breakaway_a, sweeps.fitted
        self._shares = list(REST_SHARES)
        self._last: tuple[SweepLines, ContactFit] | None = None
        self._torn = 0
        self.contacts: list[ContactRecord] = []

    @property
    def most_a(self) -> float:
        """The largest amplitude."""
        return REST_SHARES[-1] * self._breakaway_a

    def next(self) -> Profile | None:
        """The next sweeps; None: no more are needed, or made."""
        if not self._shares or self._torn == MOST_TORN:
            return None
        period_s = self._sweeps.period_s
        once = self._shares[0] * self._breakaway_a * chirp(*self._sweeps.band_hz, SWEEP_S, period_s)
        rest = np.zeros(round(LEAD_S / period_s))
        return current_profile(
            "rest", period_s, np.concatenate([rest, np.tile(np.append(once, -once), REST_PAIRS), rest])
        )

    def made(self, motion: PulseMotion) -> str | None:
        """Take sweeps that went to their end. Text: why they do not tell the contact."""
        period_s = self._sweeps.period_s
        pair = 2 * round(SWEEP_S / period_s)
        samples = round(LEAD_S / period_s) + pair + np.arange((REST_PAIRS - 1) * pair)  # the first settles the contact
        if self._sweeps.is_torn(motion, samples):
            self._torn += 1
            return f"feedback was missing for more than {LONGEST_GAP_S * 1e3:g} ms in {self._torn} runs of it"
        share = self._shares.pop(0)
        current_a, velocity_rps = (values.reshape(-1, pair) for values in _ticks(motion, samples)[:2])
        travel_rev = float(np.ptp(motion.position_rev))
        if travel_rev > MOVED_REV:
            self._shares.clear()
            return f"a sweep of {share * self._breakaway_a:.2g} A moves the axis by {travel_rev:.2g} rev"
        lines = sweep_lines(current_a, velocity_rps, period_s, SWEEP_S, self._sweeps.band_hz)
        fit = fit_contact(lines, self._moving)
        if fit.doubt:
            return fit.doubt
        self._last = lines, fit
        self.contacts.append(
            ContactRecord(
                current_a=_digits(share * self._breakaway_a),
                travel_rev=_digits(travel_rev),
                contact_per_s2=_digits(fit.contact_per_s2),
                contact_sd_per_s2=_digits(fit.contact_sd_per_s2),
                damping_per_s=_digits(fit.damping_per_s),
            )
        )
        return None

    def record(self) -> RestRecord | None:
        """The response to the largest of them; None where fewer than two amplitudes show a contact."""
        if self._last is None or len(self.contacts) < 2:
            return None
        return RestRecord(**_points(*self._last), contacts=self.contacts)


def _ticks(motion: PulseMotion, samples: Integers) -> tuple[Floats, Floats, Floats]:
    """Command, velocity and position at these samples of a profile.

    Rows without fresh feedback are missing: a command is held over them, velocity and position lie between.
    """
    running = motion.part(motion.sample >= 0)
    held = np.searchsorted(running.sample, samples, side="right") - 1
    velocity_rps, position_rev = (
        np.interp(samples, running.sample, values) for values in (running.velocity_rps, running.position_rev)
    )
    return running.command_a[held], velocity_rps, position_rev


def response_record(sweeps: Sweeps) -> ResponseRecord:
    """The response to all sweeps, the fit to it, and how the axis moved."""
    lines = sweeps.lines()
    fit = sweeps.fitted = fit_sweep(lines, sweeps.delay_s)
    elastic, sd = fit.elastic, fit.elastic_sd
    found = None
    if elastic != RIGID:
        found = ElasticRecord(
            share=_digits(elastic.share),
            share_sd=_digits(sd.share),
            frequency_hz=_digits(elastic.frequency_hz),
            frequency_sd_hz=_digits(sd.frequency_hz),
            damping=_digits(elastic.damping_ratio),
            damping_sd=_digits(sd.damping_ratio),
        )
    hold_s = 0.5 * sweeps.period_s
    position_rev = np.concatenate([motion.position_rev for motion in sweeps.measured])
    return ResponseRecord(
        swing=SwingRecord(
            speed_rps=_digits(sweeps.swing.speed_rps),
            swing_hz=float(SWING_HZ),
            sweep_rps=_digits(sweeps.swing.sweep_rps),
            most_sweep_a=_digits(sweeps.swing.most_sweep_a),
            largest_a=_digits(max(abs(extreme(motion.command_a)) for motion in sweeps.measured)),
            largest_rps=_digits(max(abs(extreme(motion.velocity_rps)) for motion in sweeps.measured)),
            travel_rev=_digits(float(np.ptp(position_rev))),
        ),
        **_points(lines, fit),
        gain_rps2_per_a=_digits(fit.gain_rps2_per_a),
        delay_s=_digits(fit.delay_s - hold_s),
        hold_s=hold_s,
        damping_per_s=_digits(fit.damping_per_s),
        contact_per_s2=_digits(fit.contact_per_s2),
        evidence=_digits(fit.evidence),
        elastic=found,
        fit_error=_digits(fit.error) if fit.error > SURE_ERROR else None,
    )


def _digits(value: float) -> float:
    return float(f"{value:.5g}")


def _points(lines: SweepLines, fit: SweepFit | ContactFit) -> dict[str, Any]:
    """The fields of ResponsePoints."""
    frequency_hz, response, coherence = _thinned(lines, fit)
    return {
        "frequency_hz": [_digits(value) for value in frequency_hz],
        "gain_rps_per_a": [_digits(value) for value in np.abs(response)],
        "phase_deg": [_digits(value) for value in np.degrees(np.unwrap(np.angle(response)))],
        "coherence": [_digits(value) for value in coherence],
    }


def _thinned(lines: SweepLines, fit: SweepFit | ContactFit) -> tuple[Floats, Complexes, Floats]:
    """About POINTS frequencies, evenly spaced in log frequency: the mean of what the lines are over the fit, times the
    fit there. A resonance sharper than the points are dense is in the fit.
    """
    edges = np.geomspace(lines.frequencies_hz[0] * 0.999, lines.frequencies_hz[-1] * 1.001, POINTS + 1)
    number = np.digitize(lines.frequencies_hz, edges)
    groups = [np.flatnonzero(number == k) for k in np.unique(number)]
    frequency_hz = np.array([float(np.exp(np.log(lines.frequencies_hz[i]).mean())) for i in groups])
    over = lines.response / fit.response(lines.frequencies_hz)
    mean = np.array([over[i].mean() for i in groups])
    coherence = np.array([lines.coherence[i].mean() for i in groups])
    return frequency_hz, mean * fit.response(frequency_hz), coherence
