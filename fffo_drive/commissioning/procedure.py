"""The procedure of commissioning: listen, probe until the axis moves a little, measure, then provoke each limit.

Pulses do not grow after the first unexpected result: a trip, a wrong sign, a velocity that is not the derivative of the
position. The remaining checks are marked as not done, and the axis has not passed. Before each motion somebody may be
asked whether it may be made (`NextMotion`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ..control.envelope import (
    TRIP_FEEDBACK_MISSING,
    TRIP_HEARTBEAT,
    TRIP_OVERSPEED,
    TRIP_POSITION_WINDOW,
    TRIP_STATUS_MISSING,
    EnvelopeConfig,
)
from ..control.reference import Profile
from ..drive.port import Drive, DriveError, DriveIdentity
from ..model.parameters import ModelFile
from ..runtime.session import Session, SessionConfig
from ..units import NORMAL_95, PERMILLE
from . import limit_checks, motion_checks, pulses
from .bounds import Bounds, bounded_envelope
from .estimate import (
    RIGID_UNEXPLAINED,
    GainFit,
    HeldCurrent,
    ScaleFit,
    coasting_s,
    current_slope,
    fit_gain,
    fit_scale,
    travel_ratio,
    update_interval_s,
)
from .judge import CHECKS, judged, not_done
from .motion import PulseMotion, PulseResponse, responses
from .motion_checks import ROUGH_SCALE, Beliefs, beliefs_of, has_moved
from .noise import noise_record
from .objects import NamePlate, ObjectSource, read_name_plate, read_number
from .record import FAILED, OK, UNEXPLAINED_SHARE, WARNING, CheckRecord, DeclaredFacts, NoiseRecord, ResponseRecord
from .rig import PulseRun, Rig, Runner, TimeBoundError, position_at_rest
from .sweep import RestSweeps, Sweeps, response_record

LISTEN_S = 0.5
REST_TAIL_S = 0.05
FIRST_SHARE = 0.01  # of the current bound: the first pulse
GROWTH = 1.25
SURE_RESONANCE = 0.05  # of its frequency: interval of a resonance that explains what pulses do not
WANTED_SHARE = 0.4  # of the speed bound: fast enough to measure
LARGEST_SPEED_SHARE = 0.6  # of the bound: a pulse expected to exceed it is not tried
LARGEST_TRAVEL_SHARE = 0.4
LONGEST_MEASURING_S = 7.0
MEASURING_PAIRS = 5
REST_FACTOR = 1.3  # of the time that the axis coasted
HOLD_SHARE = 0.6  # of the current that just moves the axis
HOLD_S = 1.0
FEWEST_PERMILLE = 20.0  # of the rated current: below, the resolution of 0x6078 dominates
FEWEST_READINGS = 5
CLAMP_SHARE, CLAMP_ASK = 0.5, 1.5  # of the current that just moves the axis
TRIP_SHARE = 0.6  # of what the same pulse reached without the limit
WATCH_S = 0.3
DEFAULT_RESOLUTION_A = 0.01
SILENCE = (TRIP_FEEDBACK_MISSING, TRIP_STATUS_MISSING, TRIP_HEARTBEAT)


Seen = Callable[[CheckRecord, PulseMotion | None], None]  # a check, and the last motion before it


class NextMotion(NamedTuple):
    """A motion that is about to be made, for the question whether it may be."""

    checks: tuple[str, ...]  # names of the checks that it serves
    text: str  # what is done, how fast and how far the axis moves by it


MayMove = Callable[[NextMotion], bool]


class NotAgreedError(Exception):
    """Somebody was asked whether the axis may make a motion, and did not agree."""

    def __init__(self, motion: NextMotion, has_moved: bool) -> None:
        """`has_moved`: motions before it were made."""
        before = "it is at rest, without torque" if has_moved else "nothing was moved"
        super().__init__(f"not agreed to: {', '.join(motion.checks)}; {before}, and no record was written")


class CommissioningOutcome(NamedTuple):
    """Result of commissioning, with the drive."""

    identity: DriveIdentity
    checks: list[CheckRecord]
    response: ResponseRecord | None  # to the sweep; None: it was not measured
    noise: NoiseRecord | None  # in the same motion


class _SurpriseError(Exception):
    """Abort: nothing more is tried."""


class _Probe(NamedTuple):
    """The pulse that moves the axis well."""

    amplitude_a: float
    length_s: float
    breakaway_a: float  # between the last current that did not move it and the first that did
    stood_a: float  # the largest that did not
    motions: list[PulseMotion]  # forwards, backwards
    moves: list[PulseResponse]


def _like(probe: _Probe) -> str:
    """The pulse that has moved the axis, with how fast and how far it did."""
    speed_rps = max(abs(move.speed_rps) for move in probe.moves)
    travel_rev = max(abs(move.travel_rev) for move in probe.moves)
    return f"of {probe.amplitude_a:.3g} A, about {speed_rps:.2g} rps and {travel_rev:.2g} rev"


def _rough_gain(probe: _Probe, beliefs: Beliefs) -> GainFit:
    """Good enough to begin a sweep with: what a pulse gives beyond half the current that just moves the axis."""
    driving_a = probe.amplitude_a - 0.5 * probe.breakaway_a
    speed_rps = float(np.median([abs(move.speed_rps) for move in probe.moves]))
    return GainFit(speed_rps / (driving_a * probe.length_s), beliefs.delay_s, 1.0)


def _unexplained_text(share: float) -> str:
    return f"a single rigid inertia leaves {100.0 * share:.0f} % of the velocity variance unexplained"


def commission(
    drive: Drive, session: SessionConfig, model: ModelFile, facts: DeclaredFacts, bounds: Bounds,
    tell: Callable[[str], None] = lambda text: None, seen: Seen = lambda check, motion: None,
    may_move: MayMove = lambda motion: True, prepare: Callable[[Session], None] = lambda session: None,
) -> CommissioningOutcome:  # fmt: skip
    """Check a drive that is not connected yet; it is left without torque. `session`: of the axis file.

    `tell` gets a line for each step, `seen` each check as it comes, `may_move` each motion before it is made, with the
    axis without torque. `prepare` gets the first session on a bus, before anything is asked of the drive.

    Raises DriveError if the drive cannot be brought up, BoundsError if there is no room, NotAgreedError,
    RealtimeRefusedError.
    """
    rig = Rig(drive, session, bounds.time_s, tell, prepare)
    procedure = _Procedure(rig, beliefs_of(model), facts, bounds, tell, seen, may_move)
    reason, declined = "", None
    try:
        procedure.listen(session.envelope)
        envelope = bounded_envelope(session.envelope, bounds, procedure.rest_rev)
        probe = procedure.move(envelope)
        procedure.limits(envelope, probe)
        procedure.sweep(envelope, probe)
    except _SurpriseError as surprise:
        reason = str(surprise)
    except TimeBoundError:
        reason = f"the axis has moved for {bounds.time_s:g} s, which is the limit"
    except NotAgreedError as error:
        reason, declined = "its motion was not agreed to", error
    identity = procedure.rig.identity
    if identity is None:
        raise DriveError("the drive was not connected")
    found = procedure.found
    checks = [found.get(name) or not_done(name, f"not done: {reason}") for name in CHECKS]
    for check in checks:
        if check.name not in found:
            seen(check, None)
    if declined is not None:
        raise declined
    return CommissioningOutcome(identity, checks, procedure.response, procedure.noise)


class _Procedure:
    """State of one commissioning."""

    def __init__(
        self, rig: Rig, beliefs: Beliefs, facts: DeclaredFacts, bounds: Bounds, tell: Callable[[str], None], seen: Seen,
        may_move: MayMove,
    ) -> None:  # fmt: skip
        self.rig, self.beliefs, self.facts, self.bounds, self.tell = rig, beliefs, facts, bounds, tell
        self._may_move = may_move
        self._has_moved = False
        self.found: dict[str, CheckRecord] = {}
        self.seen = seen
        self.plate = NamePlate()
        self.rest_rev = 0.0
        self.noise_rps = 0.0
        self.gain: GainFit | None = None
        self._unexplained: CheckRecord | None = None  # the check `motion`, unless the sweep tells why
        self.response: ResponseRecord | None = None
        self.noise: NoiseRecord | None = None

    def add(self, *checks: CheckRecord) -> None:
        """Keep results, and stop at one that failed."""
        for check in checks:
            if self.found.get(check.name) != check:
                self.seen(check, self.rig.motion)
            self.found[check.name] = check

    def stop_if_failed(self, *names: str) -> None:
        """Raise when one of these checks has failed."""
        for name in names:
            check = self.found.get(name)
            if check is not None and check.verdict == FAILED:
                raise _SurpriseError(f"{name} failed")

    def ask(self, text: str, *checks: str) -> None:
        """Raises NotAgreedError where nobody agrees to the motion of these checks."""
        motion = NextMotion(checks, text)
        if not self._may_move(motion):
            raise NotAgreedError(motion, self._has_moved)
        self._has_moved = True

    # -- without torque --------------------------------------------------------------------------------------------

    def listen(self, envelope: EnvelopeConfig) -> None:
        """Standstill, and the name plate."""
        self.tell("listening, no voltage")
        with self.rig.under(envelope) as runner:
            units = self.facts.rated_current_unit_a, self.facts.rated_torque_unit_nm
            self.plate = read_name_plate(self.rig.drive, *units)
            motion = runner.listen(LISTEN_S)
        self.add(motion_checks.standstill(motion))
        self.stop_if_failed("standstill")
        self.rest_rev = position_at_rest(motion)
        self.noise_rps = float(np.std(motion.velocity_rps))

    # -- small pulses ----------------------------------------------------------------------------------------------

    def move(self, envelope: EnvelopeConfig) -> _Probe:
        """Grow pulses until the axis moves well, then measure with them."""
        bounds = self.bounds
        self.ask(
            f"pulses both ways that grow until the axis turns, at most {bounds.current_a:.3g} A, "
            f"{bounds.speed_rps:.3g} rps and {bounds.travel_rev:.3g} rev from here",
            "motion", "torque_sign", "velocity_sign", "position_sign",
        )  # fmt: skip
        with self.rig.under(envelope) as runner:
            probe = self._grow(runner)
            self.ask(
                f"up to {2 * MEASURING_PAIRS} pulses {_like(probe)}, then {HOLD_SHARE * probe.stood_a:.3g} A, under "
                "which it stays where it is",
                "counts_per_rev", "velocity_scale", "velocity_update", "velocity_age", "current_scale",
                "torque_per_inertia", "delay", "static_friction",
            )  # fmt: skip
            self.tell(f"measuring with {probe.amplitude_a:.3g} A")
            rest_s = max(pulses.SHORTEST_REST_S, REST_FACTOR * max(coasting_s(motion) for motion in probe.motions))
            pairs = int(LONGEST_MEASURING_S / (2.0 * (probe.length_s + rest_s)))
            if pairs < 1:
                text = f"the axis coasts for {rest_s / REST_FACTOR:.1f} s after a pulse"
                self.add(judged("motion", FAILED, text, "repeat with a smaller --speed"))
                raise _SurpriseError(text)
            profile = pulses.measuring_pairs(
                probe.amplitude_a, probe.length_s, rest_s, self.rig.period_s, min(MEASURING_PAIRS, pairs)
            )
            motion = self._run(runner, profile).motion
            held = self._hold(runner, HOLD_SHARE * probe.stood_a)
        self._measure(motion, held, probe)
        self.stop_if_failed("counts_per_rev", "velocity_scale")
        return probe

    def _run(self, runner: Runner, profile: Profile, meanwhile: Callable[[], None] | None = None) -> PulseRun:
        """Run a profile that must reach its end."""
        run = runner.run(profile, meanwhile=meanwhile)
        self._note_rest(run.motion)
        if run.fault_text is not None:
            self._explain(run, float(np.abs(profile.values).max()))
            raise _SurpriseError(run.fault_text)
        return run

    def _explain(self, run: PulseRun, current_a: float) -> None:
        """Why a pulse did not end as planned: a scale that is far off trips although the axis has hardly moved."""
        ratio = travel_ratio([run.motion])
        limit_met = run.trip in (TRIP_OVERSPEED, TRIP_POSITION_WINDOW)
        if limit_met and math.isfinite(ratio) and not 1.0 / ROUGH_SCALE < abs(ratio) < ROUGH_SCALE:
            suspect = "velocity_scale" if run.trip == TRIP_OVERSPEED else "counts_per_rev"
            self.add(*motion_checks.scales(ScaleFit(ratio, 0.0), {suspect}, self.plate, self.facts))
            return
        remedy = "see the drive's error history (0x1003, 0x603F), its supply, and what else is on the bus"
        if limit_met:
            remedy = (
                "is the axis lighter than expected, does it coast far, or are counts and velocity units wrong by one "
                "factor? Repeat with a smaller --current or --speed"
            )
        elif run.trip in SILENCE:
            remedy = (
                "the drive or this PC does not keep time: see realtime.*, the load of the bus (fffo-drive config "
                "check) and its wiring, then repeat"
            )
        self.add(judged("motion", FAILED, f"{run.fault_text}, with pulses of {current_a:.3g} A", remedy))

    def _note_rest(self, motion: PulseMotion) -> None:
        if motion.size:
            self.rest_rev = position_at_rest(motion.part(motion.time_s >= motion.time_s[-1] - REST_TAIL_S))

    def _grow(self, runner: Runner) -> _Probe:
        """Pairs of pulses that grow until the axis moves both ways, and then until it is fast enough to measure."""
        stood_a = 0.0
        moved_a = math.nan
        best: _Probe | None = None
        for amplitude_a, length_s in self._amplitudes():
            if best is not None and not self._may_grow(best, amplitude_a):
                break
            self.tell(f"pulses of {amplitude_a:.3g} A, {length_s * 1e3:.0f} ms")
            motions = [
                self._run(runner, pulses.single_pulse(signed_a, length_s, self.rig.period_s)).motion
                for signed_a in (amplitude_a, -amplitude_a)
            ]
            moves = [move for motion in motions for move in responses(motion)]
            moved = [move for move in moves if has_moved(move, self.noise_rps, self.rig.period_s)]
            if not moved:
                stood_a = amplitude_a
                continue
            if math.isnan(moved_a):
                moved_a = amplitude_a
            self._check_signs(moved)
            if len(moved) < len(moves):
                continue
            best = _Probe(amplitude_a, length_s, 0.5 * (stood_a + moved_a), stood_a, motions, moves)
            if not 1.0 / ROUGH_SCALE < travel_ratio(motions) < ROUGH_SCALE:
                break  # unexpected: measure with the pulse that moved it, and do not grow further
            if min(move.speed_rps for move in moves) > WANTED_SHARE * self.bounds.speed_rps:
                break
        if best is None:
            self._did_not_move(stood_a, moved_a)
            raise _SurpriseError("the axis does not move both ways")
        speeds = [move.speed_rps for move in best.moves]
        pulse = f"{best.amplitude_a:.3g} A for {best.length_s * 1e3:.0f} ms"
        text = f"{pulse}: {speeds[0]:.3g} rps forwards, {speeds[-1]:.3g} backwards"
        self.add(judged("motion", OK, text, numbers={"current_a": best.amplitude_a, "speed_rps": min(speeds)}))
        return best

    def _amplitudes(self) -> Iterator[tuple[float, float]]:
        """Rising currents up to the bound, then longer pulses of it."""
        highest_a = self.bounds.current_a
        amplitude_a = FIRST_SHARE * highest_a
        while amplitude_a < highest_a:
            yield amplitude_a, pulses.PULSE_S
            amplitude_a *= GROWTH
        length_s = pulses.PULSE_S
        while length_s <= pulses.LONGEST_PULSE_S:
            yield highest_a, length_s
            length_s *= 2.0

    def _may_grow(self, last: _Probe, amplitude_a: float) -> bool:
        """Whether a larger pulse is expected to stay inside the bounds: speed rises with current above friction."""
        threshold_a = 0.5 * last.breakaway_a
        growth = (amplitude_a - threshold_a) / (last.amplitude_a - threshold_a)
        speed_rps = growth * max(abs(move.speed_rps) for move in last.moves)
        travel_rev = growth * growth * max(abs(move.travel_rev) for move in last.moves)
        return (
            speed_rps < LARGEST_SPEED_SHARE * self.bounds.speed_rps
            and travel_rev < LARGEST_TRAVEL_SHARE * self.bounds.travel_rev
        )

    def _check_signs(self, moves: list[PulseResponse]) -> None:
        self.add(*motion_checks.signs(moves))
        self.stop_if_failed("torque_sign", "velocity_sign", "position_sign")

    def _did_not_move(self, stood_a: float, moved_a: float) -> None:
        if math.isnan(moved_a):
            text = f"the axis does not move with {stood_a:.3g} A for {pulses.LONGEST_PULSE_S * 1e3:.0f} ms either way"
            remedy = (
                "is the brake released, the axis free, the motor connected, 0x6072 (torque limit) large enough? If the "
                "axis needs more, give a larger --current"
            )
        else:
            text = f"the axis moves one way with {moved_a:.3g} A, not the other way with {self.bounds.current_a:.3g} A"
            remedy = "a load pulls it, or it is at an end stop: balance or move it, or give a larger --current"
        self.add(judged("motion", FAILED, text, remedy, {"current_a": self.bounds.current_a}))

    def _hold(self, runner: Runner, current_a: float) -> HeldCurrent | None:
        """0x6078 over the commanded current, with the axis at rest under it. None if it cannot be determined."""
        source = self.rig.drive
        rated_a = self.plate.rated_current_a
        if not isinstance(source, ObjectSource) or rated_a is None or current_a * PERMILLE < FEWEST_PERMILLE * rated_a:
            return None
        reported: list[float] = []

        def read() -> None:
            raw = read_number(source, 0x6078, 0, signed=True)
            if raw is not None:
                reported.append(raw / PERMILLE * rated_a)

        held = self._run(runner, pulses.holding_current(current_a, HOLD_S, self.rig.period_s), meanwhile=read).motion
        sent_a = float(np.max(held.command_a)) if held.size else 0.0  # whole per mille of what was asked for
        if len(reported) < FEWEST_READINGS or sent_a <= 0.0:
            return None
        return HeldCurrent(float(np.median(reported)) / sent_a, rated_a / PERMILLE / sent_a)

    def _measure(self, motion: PulseMotion, held: HeldCurrent | None, probe: _Probe) -> None:
        period_s, beliefs = self.rig.period_s, self.beliefs
        scale = fit_scale(motion)
        slid = fit_gain(motion)
        gain = slid if slid is not None and slid.rigid else None
        suspected = motion_checks.suspects(scale, gain, self.plate, self.facts, beliefs)
        self.add(*motion_checks.scales(scale, suspected, self.plate, self.facts))
        self.add(motion_checks.velocity_update(update_interval_s(motion, period_s), period_s))
        self.add(motion_checks.velocity_age(scale, period_s, beliefs.sensor_delay_s))
        slope, samples = current_slope(motion)
        self.add(motion_checks.current_scale(slope, samples, held, self.plate, beliefs))
        if gain is None:
            self._is_unexplained(probe, slid, bool(suspected))
            self.gain = _rough_gain(probe, beliefs)
            self.add(motion_checks.static_friction(probe.breakaway_a, beliefs))
            return
        if gain.unexplained > RIGID_UNEXPLAINED:
            self._is_not_rigid(gain.unexplained)
        self.add(motion_checks.delay(gain.delay_s, period_s, beliefs))
        self.gain = gain._replace(gain_rps2_per_a=self._trusted_gain(gain.gain_rps2_per_a, scale))
        self.add(motion_checks.torque_per_inertia(self.gain.gain_rps2_per_a, beliefs))
        self.add(motion_checks.static_friction(probe.breakaway_a, beliefs))

    def _is_unexplained(self, probe: _Probe, slid: GainFit | None, scale_suspected: bool) -> None:
        """Neither gain nor delay can be measured by pulses. Unless a wrong scale explains it, the sweep may tell why;
        an axis that does not slide cannot be swept.
        """
        text = f"pulses of {probe.amplitude_a:.3g} A move the axis, but "
        if slid is None:
            text += "it does not slide under them"
        else:
            text += _unexplained_text(slid.unexplained)
        if not scale_suspected:
            remedy = (
                "is the brake released and the axis free, or does a load swing on an elastic coupling? If it needs "
                "more, give a larger --current or --speed"
            )
            self._unexplained = judged("motion", FAILED, text, remedy, {"current_a": probe.amplitude_a})
            if slid is not None:
                return
            self.add(self._unexplained)
        raise _SurpriseError(text)

    def _is_not_rigid(self, unexplained: float) -> None:
        """It slides, but not as a single inertia: a warning, and the remaining checks continue."""
        moved = self.found["motion"]
        text = f"{moved.text}; {_unexplained_text(unexplained)}"
        remedy = (
            "backlash, an elastic coupling or strong cogging? The torque per inertia and the delay below are rough; "
            "identify and diagnose the axis before its gains are raised"
        )
        self.add(judged("motion", WARNING, text, remedy, moved.numbers | {UNEXPLAINED_SHARE: unexplained}))

    def _trusted_gain(self, by_velocity: float, scale: ScaleFit) -> float:
        """Acceleration per ampere, by the word with the right scale."""
        wrong = self.found["velocity_scale"].verdict == FAILED
        return by_velocity / scale.ratio if wrong and scale.ratio else by_velocity

    # -- limits ----------------------------------------------------------------------------------------------------

    def limits(self, envelope: EnvelopeConfig, probe: _Probe) -> None:
        """Provoke each limit with a session of its own, then judge how the drive braked."""
        period_s = self.rig.period_s
        limit_a, asked_a = CLAMP_SHARE * probe.breakaway_a, CLAMP_ASK * probe.breakaway_a
        self.ask(
            f"a pulse of {asked_a:.3g} A, cut to {limit_a:.3g} A, under which the axis stays where it is; if the cut "
            f"fails, at most {self.bounds.speed_rps:.3g} rps and {self.bounds.travel_rev:.3g} rev",
            "current_limit",
        )
        self.tell(f"current limit of {limit_a:.3g} A")
        clamped = envelope._replace(
            current_limit_a=limit_a, continuous_current_a=min(envelope.continuous_current_a, limit_a)
        )
        with self.rig.under(clamped) as runner:
            motion = self._run(runner, pulses.single_pulse(asked_a, probe.length_s, period_s)).motion
        self.add(limit_checks.current_limit(motion, limit_a, asked_a, self._resolution_a()))
        self.stop_if_failed("current_limit")

        speed_rps = TRIP_SHARE * min(move.speed_rps for move in probe.moves)
        self.ask(f"a pulse {_like(probe)}, braked beyond {speed_rps:.3g} rps", "speed_limit")
        self.tell(f"speed limit of {speed_rps:.3g} rps")
        pulse = pulses.single_pulse(probe.amplitude_a, probe.length_s, period_s)
        with self.rig.under(envelope._replace(speed_limit_rps=speed_rps)) as runner:
            over_speed = runner.run(pulse, WATCH_S).motion
        self._note_rest(over_speed)
        reached_rps = float(np.abs(over_speed.velocity_rps).max())
        self.add(limit_checks.stop_after_trip("speed_limit", over_speed, TRIP_OVERSPEED, reached_rps, speed_rps, "rps"))
        self.stop_if_failed("speed_limit")

        room_rev = TRIP_SHARE * TRIP_SHARE * min(move.travel_rev for move in probe.moves)
        self.ask(f"a pulse {_like(probe)}, braked beyond {room_rev:.3g} rev from here", "position_window", "quick_stop")
        self.tell(f"position window of +-{room_rev:.3g} rev")
        rest_rev = self.rest_rev
        window = envelope._replace(position_low_rev=rest_rev - room_rev, position_high_rev=rest_rev + room_rev)
        pulse = pulses.single_pulse(-probe.amplitude_a, probe.length_s, period_s)
        with self.rig.under(window) as runner:
            outside = runner.run(pulse, WATCH_S).motion
        reached_rev = float(np.abs(outside.position_rev - rest_rev).max())
        self.add(
            limit_checks.stop_after_trip(
                "position_window", outside, TRIP_POSITION_WINDOW, reached_rev, room_rev, "rev"
            ),
            limit_checks.quick_stop([over_speed, outside], probe.motions),
        )

    # -- the sweep -------------------------------------------------------------------------------------------------

    def sweep(self, envelope: EnvelopeConfig, probe: _Probe) -> None:
        """Move the axis back and forth with a small sweep on top, and fit what it answers."""
        bounds = self.bounds
        assert self.gain is not None  # measured before any limit was provoked
        sweeps = Sweeps(bounds, probe.breakaway_a, self.gain, self.rig.period_s)
        low_hz, high_hz = sweeps.band_hz
        self.ask(
            f"a sweep from {low_hz:g} to {high_hz:g} Hz while the axis moves back and forth at about "
            f"{sweeps.swing.speed_rps:.2g} rps, for some seconds; at most {bounds.current_a:.3g} A, "
            f"{bounds.speed_rps:.3g} rps and {bounds.travel_rev:.3g} rev from where it began",
            "resonance",
        )
        self.tell(f"sweep from {low_hz:g} to {high_hz:g} Hz")
        try:
            refusal = self._swing(envelope, sweeps)
        except TimeBoundError:
            refusal = f"the axis has moved for {bounds.time_s:g} s, which is the limit"
        if refusal is None:
            self.response, self.noise = response_record(sweeps), noise_record(sweeps)
        self.add(motion_checks.resonance(self.response or str(refusal)))
        if self._unexplained is not None:
            self._is_explained(self._unexplained)
        if self.response is not None and self.response.elastic is not None:
            # a pulse takes a motor with a load on a spring for another rigid inertia, with another delay
            self.add(motion_checks.delay(self.response.delay_s, self.rig.period_s, self.beliefs))
            self.add(motion_checks.torque_per_inertia(self.response.gain_rps2_per_a, self.beliefs))
        if self.response is not None:
            self._at_rest(envelope, RestSweeps(sweeps, probe.breakaway_a))
        else:
            text = "the response in motion was not measured, and what moves is not known without it"
            self.add(motion_checks.contact(text, self.beliefs))

    def _is_explained(self, unexplained: CheckRecord) -> None:
        """Pulses did not show how the axis moves: it has failed unless the sweep surely found a load that swings."""
        load = None if self.response is None else self.response.elastic
        if load is None or NORMAL_95 * load.frequency_sd_hz > SURE_RESONANCE * load.frequency_hz:
            self.add(unexplained)
            raise _SurpriseError(unexplained.text)
        text = f"{self.found['motion'].text}; {unexplained.text.partition(', but ')[2]}: a load swings, see resonance"
        self.add(judged("motion", WARNING, text, "see the check resonance", self.found["motion"].numbers))

    def _at_rest(self, envelope: EnvelopeConfig, sweeps: RestSweeps) -> None:
        """Sweep the axis at rest, and keep what holds it there."""
        assert self.response is not None
        self.ask(
            f"the same sweep at rest, of {sweeps.most_a:.2g} A at most, under which the axis stays where it is; if it "
            f"does not, at most {self.bounds.speed_rps:.3g} rps and {self.bounds.travel_rev:.3g} rev",
            "contact",
        )
        self.tell(f"sweep at rest, up to {sweeps.most_a:.2g} A")
        refusal = ""
        try:
            with self.rig.under(envelope) as runner:
                while (profile := sweeps.next()) is not None:
                    run = runner.run(profile)
                    self._note_rest(run.motion)
                    if run.fault_text is not None:
                        refusal = run.fault_text
                        break
                    refusal = sweeps.made(run.motion) or refusal
        except TimeBoundError:
            refusal = f"the axis has moved for {self.bounds.time_s:g} s, which is the limit"
        at_rest = sweeps.record()
        self.response = self.response.model_copy(update={"at_rest": at_rest})
        self.add(motion_checks.contact(refusal if at_rest is None else self.response, self.beliefs))

    def _swing(self, envelope: EnvelopeConfig, sweeps: Sweeps) -> str | None:
        """Let the axis slide under the sweep until its response is measured; text: why it is not."""
        while not sweeps.done:
            with self.rig.under(envelope, sweeps.loop) as runner:  # a new session after each trip
                run: PulseRun | None = None
                while not sweeps.done and (run is None or run.fault_text is None):
                    if (refusal := sweeps.refusal) is not None:
                        return refusal
                    run = runner.run(sweeps.next())
                    self._note_rest(run.motion)
                    if run.fault_text is None:
                        sweeps.made(run.motion)
            if run is not None and run.fault_text is not None:
                if run.trip != TRIP_OVERSPEED:
                    return run.fault_text
                sweeps.ease()
        return None

    def _resolution_a(self) -> float:
        """One thousandth of the rated torque, as current."""
        rated_nm = self.facts.rated_torque_nm
        if rated_nm is None:
            return DEFAULT_RESOLUTION_A
        return rated_nm / self.facts.torque_constant_nm_per_a / PERMILLE
