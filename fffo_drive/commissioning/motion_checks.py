"""Checks of the response of the axis to current: signs, scales, ages, gain, delay, friction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..control.stability import contact_nm_per_rev, is_same_contact
from ..model.parameters import ModelFile
from ..units import NORMAL_95
from .estimate import GainFit, HeldCurrent, ScaleFit
from .judge import Range, factor, graded, judged, within
from .motion import PulseMotion, PulseResponse
from .objects import NamePlate
from .record import FAILED, OK, WARNING, CheckRecord, DeclaredFacts, ResponseRecord

MOVED_REV = 0.02  # beyond gear play and the elasticity of friction at rest
STILL_REV = 0.005
OFFSET_RPS = 0.05
NOISE_SIGMAS = 5.0
SCALE_OK, SCALE_WARNING = 0.01, 0.03
ROUGH_SCALE = 1.5  # a ratio beyond this is detected in the first motion, and the pulses do not grow any more
CURRENT_OK, CURRENT_WARNING = 0.05, 0.15
GAIN_OK, GAIN_WARNING = 1.25, 1.5
FRICTION_OK = 2.5
PLATE_OK, PLATE_WARNING = 0.02, 0.1


class Beliefs(NamedTuple):
    """Expected values from the model."""

    gain_rps2_per_a: float
    delay_s: float
    sensor_delay_s: float
    static_nm: float
    torque_constant_nm_per_a: float
    assumed_kg_m2: float | None = None  # an inertia that was not declared: its check measures it, and cannot fail
    delay_assumed: bool = False
    contact_nm_per_rev: tuple[float, float] = (0.0, math.inf)  # at rest, softest and stiffest
    contact_assumed: bool = False


def beliefs_of(model: ModelFile) -> Beliefs:
    """From a model file."""
    axis = model.axis_config()
    constant = model.torque_constant_nm_per_a
    return Beliefs(
        constant / axis.inertia_nm_s2_per_rev,
        axis.delay_s,
        model.sensor_delay_s.value,
        axis.friction.static_nm,
        constant,
        model.inertia_kg_m2.value if model.inertia_kg_m2.assumed else None,
        model.delay_s.assumed,
        contact_nm_per_rev(model),
        model.friction.stiffness_per_rev.assumed,
    )


def standstill(motion: PulseMotion) -> CheckRecord:
    """Without voltage the axis must be at rest, and the feedback must show it."""
    if not motion.size:
        return judged(
            "standstill", FAILED, "no feedback after SYNC", "see the TPDO mapping and the cut-off (loop.cutoff_share)"
        )
    wandered_rev = float(np.ptp(motion.position_rev))
    offset_rps = float(np.mean(motion.velocity_rps))
    numbers = {
        "position_wander_rev": wandered_rev,
        "velocity_offset_rps": offset_rps,
        "velocity_noise_rps": float(np.std(motion.velocity_rps)),
    }
    text = f"position varies by {wandered_rev:.2g} rev, velocity {offset_rps:+.2g} rps on average"
    if wandered_rev > STILL_REV:
        remedy = "the axis moves without torque, or the sensor does not work: hold the load, check the sensor's wiring"
        return judged("standstill", FAILED, text, remedy, numbers)
    if abs(offset_rps) > OFFSET_RPS:
        remedy = "the velocity word has an offset at rest: check 0x606C and the tracking loop's tuning"
        return judged("standstill", WARNING, text, remedy, numbers)
    return judged("standstill", OK, text, numbers=numbers)


def has_moved(move: PulseResponse, noise_rps: float, period_s: float) -> bool:
    """Whether a pulse has moved the axis, by either word: neither is trusted yet, and one may be dead."""
    steps = max(1.0, move.duration_s / period_s)
    noise_rev = NOISE_SIGMAS * noise_rps * period_s * math.sqrt(steps)
    by_velocity = max(0.0, abs(move.net_by_velocity_rev) - noise_rev)
    one, other = sorted((abs(move.net_rev), by_velocity))
    return one > MOVED_REV or other > 2.0 * MOVED_REV


def signs(moves: Sequence[PulseResponse]) -> list[CheckRecord]:
    """Three signs, current, velocity and position: the one that differs from the other two is wrong."""
    by_position = float(np.median([move.net_rev for move in moves]))
    by_velocity = float(np.median([move.net_by_velocity_rev for move in moves]))
    numbers = {"travel_rev": by_position, "travel_by_velocity_rev": by_velocity}
    text = f"along the current: {by_position:+.3f} rev by the position, {by_velocity:+.3f} rev by the velocity"
    wrong = ""
    remedy = ""
    if by_position < 0.0 and by_velocity < 0.0:
        wrong = "torque_sign"
        remedy = (
            "a positive current turns the shaft backwards: the motor's phases, the resolver's or the drive's "
            "commutation are swapped, or 0x607E (polarity) turns position and velocity but not torque. drive.inverted "
            "turns all three and does not help"
        )
    elif by_velocity <= 0.0 or abs(by_velocity) < 1e-3 * abs(by_position):
        wrong = "velocity_sign"
        remedy = (
            "the velocity does not have the sign of the change of position: check 0x607E (polarity, bit 6 velocity, "
            "bit 7 position) and that 0x606C is mapped as a signed 32-bit word"
        )
    elif by_position <= 0.0 or abs(by_position) < 1e-3 * abs(by_velocity):
        wrong = "position_sign"
        remedy = (
            "the position does not have the sign of torque and velocity: check 0x607E (polarity, bit 7 position) and "
            "that 0x6064 is mapped as a signed 32-bit word of the same sensor"
        )
    return [
        judged(name, FAILED if name == wrong else OK, text, remedy if name == wrong else "", numbers)
        for name in ("torque_sign", "velocity_sign", "position_sign")
    ]


def suspects(fit: ScaleFit, gain: GainFit | None, plate: NamePlate, facts: DeclaredFacts, model: Beliefs) -> set[str]:
    """If velocity and position disagree: which of the two checks has failed.

    The encoder objects decide if the drive has them; else the word that gives an absurd Kt/J is wrong. If neither
    decides, both are suspect.
    """
    if within(1.0, SCALE_OK, SCALE_WARNING).verdict(fit.ratio) != FAILED:
        return set()
    counts_agree = plate.counts_per_rev is not None and plate.counts_per_rev == facts.counts_per_rev
    units = plate.velocity_units_per_rps
    units_agree = units is not None and units == facts.velocity_units_per_rps
    if counts_agree != units_agree:
        return {"velocity_scale"} if counts_agree else {"counts_per_rev"}
    if gain is None or fit.ratio <= 0.0:
        return {"counts_per_rev", "velocity_scale"}
    by_velocity = abs(math.log(gain.gain_rps2_per_a / model.gain_rps2_per_a))
    by_position = abs(math.log(gain.gain_rps2_per_a / fit.ratio / model.gain_rps2_per_a))
    return {"counts_per_rev"} if by_velocity < by_position else {"velocity_scale"}


def scales(fit: ScaleFit, suspected: set[str], plate: NamePlate, facts: DeclaredFacts) -> list[CheckRecord]:
    """Counts per revolution and velocity units: against each other and against the objects of the drive."""
    return [_counts(fit, suspected, plate, facts), _velocity_units(fit, suspected, plate, facts)]


CLEARED = "; acceleration per ampere or the encoder objects agree with this one"


def _counts(fit: ScaleFit, suspected: set[str], plate: NamePlate, facts: DeclaredFacts) -> CheckRecord:
    name = "counts_per_rev"
    declared, object_608f = facts.counts_per_rev, plate.counts_per_rev
    text = f"travel by position is {1.0 / fit.ratio:.4g} times the integrated velocity" if fit.ratio else "no travel"
    if declared is not None and object_608f is not None:
        text += f"; declared {declared:g} counts, {plate.counts_object} says {object_608f:g}"
        if object_608f != declared:
            remedy = (
                f"set drive.counts_per_rev to what {plate.counts_object} says; if they differ on purpose, a position "
                "factor (0x6091, 0x6092) is active: set it to 1"
            )
            return judged(name, FAILED, text, remedy, {"declared": declared, "object_608f": object_608f})
    if suspected and name not in suspected:
        return judged(name, OK, text + CLEARED)
    would = f" ({declared / fit.ratio:.6g} counts would agree with the velocity)" if declared and fit.ratio else ""
    remedy = f"correct drive.counts_per_rev{would}, or the position factors 0x608F, 0x6091, 0x6092 in the drive"
    limits = within(1.0, SCALE_OK, SCALE_WARNING)
    return graded(name, 1.0 / fit.ratio if fit.ratio else math.nan, 1.0, limits, "-", text, remedy)


def _velocity_units(fit: ScaleFit, suspected: set[str], plate: NamePlate, facts: DeclaredFacts) -> CheckRecord:
    name = "velocity_scale"
    declared, object_6090 = facts.velocity_units_per_rps, plate.velocity_units_per_rps
    text = f"integrated velocity is {fit.ratio:.4g} times the travel by position"
    if suspected and name not in suspected:
        return judged(name, OK, text + CLEARED)
    would = f" ({declared * fit.ratio:.6g} units for one rev/s would agree with the position)" if declared else ""
    remedy = f"correct drive.velocity_units_per_rps{would}; see 0x6090, 0x6094 and the unit of 0x606C in the manual"
    check = graded(name, fit.ratio, 1.0, within(1.0, SCALE_OK, SCALE_WARNING), "-", text, remedy)
    if check.verdict == OK and None not in (declared, object_6090) and declared != object_6090:
        text += f"; but {plate.velocity_object} says {object_6090:g} units for one rev/s, declared are {declared:g}"
        remedy = f"make {plate.velocity_object} and drive.velocity_units_per_rps agree"
        check = check.model_copy(update={"verdict": WARNING, "text": text, "remedy": remedy})
    return check


def velocity_update(interval_s: float, period_s: float) -> CheckRecord:
    """A word that changes less often than the loop reads it adds half its interval to the delay."""
    limits = Range(0.0, 1.5 * period_s, 0.0, 4.5 * period_s)
    text = f"changes every {interval_s * 1e3:.2f} ms, the loop reads it every {period_s * 1e3:.2f} ms"
    remedy = (
        "the drive computes 0x606C less often than SYNC comes: raise its update rate, reduce its averaging, or lower "
        "loop.rate_hz to match"
    )
    return graded("velocity_update", interval_s, period_s, limits, "s", text, remedy)


def velocity_age(fit: ScaleFit, period_s: float, believed_s: float) -> CheckRecord:
    """The velocity estimate of a drive is older than its position: by the tracking loop, a filter, a slow task."""
    limits = within(believed_s, max(period_s, 5e-4), 5e-3)
    text = f"the velocity is {fit.age_s * 1e3:.2f} ms older than the position; the model says {believed_s * 1e3:.2f} ms"
    remedy = (
        f"set sensor_delay_s: {{value: {max(fit.age_s, 0.0):.5f}, source: commissioning}} in the model, or reduce "
        "the filtering of 0x606C in the drive"
    )
    return graded("velocity_age", fit.age_s, believed_s, limits, "s", text, remedy)


def current_scale(
    slope: float, samples: int, held: HeldCurrent | None, plate: NamePlate, beliefs: Beliefs
) -> CheckRecord:
    """0x6077 (and 0x6078 with 0x6075, if present) against the commanded current, and Kt against the name plate."""
    ratio, source, count = (slope, "0x6077", 0.0) if held is None else (held.ratio, "0x6078", held.resolution)
    limits = within(1.0, CURRENT_OK + count, CURRENT_WARNING + count)
    numbers = {"by_0x6077": slope, "samples": float(samples), "resolution": count}
    text = f"{source} reports {ratio:.3f} of the commanded current"
    if count:
        text += f", in steps of {count:.3f}"
    remedy = (
        "the drive makes a different current than commanded: check rated torque and current (0x6076, 0x6075), "
        "torque_constant_nm_per_a, the torque limits 0x6072, 0x60E0, 0x60E1 and the tuning of the current loop"
    )
    if plate.torque_constant_nm_per_a is not None:
        of_plate = plate.torque_constant_nm_per_a / beliefs.torque_constant_nm_per_a
        numbers["name_plate_torque_constant_nm_per_a"] = plate.torque_constant_nm_per_a
        text += f"; rated torque over rated current is {of_plate:.3f} of the model's Kt"
        if within(1.0, PLATE_OK, PLATE_WARNING).verdict(of_plate) != OK and limits.verdict(ratio) == OK:
            remedy = "0x6076 over 0x6075 differs from the torque constant of the model: make them agree"
            return judged("current_scale", WARNING, text, remedy, numbers)
    if not samples and held is None:
        return judged("current_scale", WARNING, "the drive reported no current during the pulses", remedy, numbers)
    return graded("current_scale", ratio, 1.0, limits, "-", text, remedy, numbers)


def torque_per_inertia(gain_rps2_per_a: float, beliefs: Beliefs) -> CheckRecord:
    """Kt/J: with a wrong one every feed-forward torque and every margin is wrong by the same factor."""
    expected = beliefs.gain_rps2_per_a
    ratio = gain_rps2_per_a / expected
    text = f"{gain_rps2_per_a:.4g} rps2/A, {ratio:.2f} times the model's {expected:.4g}"
    remedy = (
        "torque_constant_nm_per_a (name plate, 0x6076 over 0x6075) or inertia_kg_m2 in the model is wrong, or "
        "drive.rated_torque_nm is; or the scales of position and velocity are wrong by one factor"
    )
    limits = factor(expected, GAIN_OK, GAIN_WARNING)
    if beliefs.assumed_kg_m2 is not None and ratio > 0.0:
        limits = limits._replace(least=0.0, most=math.inf)
        remedy = (
            f"the inertia was assumed: set inertia_kg_m2: {{value: {beliefs.assumed_kg_m2 / ratio:.3g}, "
            "source: commissioning} in the model, if torque_constant_nm_per_a is right"
        )
    return graded("torque_per_inertia", gain_rps2_per_a, expected, limits, "rps2/A", text, remedy)


def delay(measured_s: float, period_s: float, beliefs: Beliefs) -> CheckRecord:
    """The margins are computed with the model's delay: a shorter one increases them, and never fails."""
    expected_s = beliefs.delay_s
    limits = within(expected_s, max(period_s, 0.2 * expected_s), max(3.0 * period_s, 0.6 * expected_s))
    limits = limits._replace(least=0.0)
    if beliefs.delay_assumed:
        limits = limits._replace(most=math.inf)
    text = f"{measured_s * 1e3:.2f} ms, the model says {expected_s * 1e3:.2f} ms (both without the hold of a command)"
    remedy = (
        f"set delay_s: {{value: {measured_s:.5f}, source: commissioning}} in the model and check the margins again "
        "(fffo-drive config check), or find what delays: a filter on 0x606C, an RPDO that misses its SYNC"
    )
    return graded("delay", measured_s, expected_s, limits, "s", text, remedy)


def static_friction(breakaway_a: float, beliefs: Beliefs) -> CheckRecord:
    """A rough check: pulses find the level within one increment. Never more than a warning."""
    measured_nm = breakaway_a * beliefs.torque_constant_nm_per_a
    limits = factor(beliefs.static_nm, FRICTION_OK, FRICTION_OK)._replace(least=0.0, most=math.inf)
    text = f"moves from {breakaway_a:.3g} A on, {measured_nm:.3g} Nm; the model says {beliefs.static_nm:.3g} Nm"
    remedy = (
        "identify the axis again (friction changes with load, wear and temperature); check Kt if its check fails too"
    )
    return graded(
        "static_friction", measured_nm, beliefs.static_nm, limits, "Nm", text, remedy, {"current_a": breakaway_a}
    )


def resonance(found: ResponseRecord | str) -> CheckRecord:
    """What the sweep showed; text: why there was none."""
    if isinstance(found, str):
        remedy = (
            "`tune` takes the axis for a rigid one: if something elastic hangs on it, commission again with a larger "
            "--current or --speed, or where feedback was missing with a drive and a PC that keep time (realtime.*, the "
            "load of the bus), or diagnose its recordings before the gains are raised"
        )
        return judged("resonance", WARNING, f"the response was not measured: {found}", remedy)
    band = f"{found.frequency_hz[0]:.0f} to {found.frequency_hz[-1]:.0f} Hz"
    numbers = {"delay_s": found.delay_s, "gain_rps2_per_a": found.gain_rps2_per_a, "evidence": found.evidence}
    swing = found.swing
    moved = f"the axis moved back and forth at up to {swing.largest_rps:.2g} rps over {swing.travel_rev:.2g} rev"
    load = found.elastic
    if found.fit_error is not None:
        text = (
            f"from {band} the axis answers neither as one inertia nor as one with a load on a spring, by "
            f"{100.0 * found.fit_error:.0f} % of the response: no resonance is read from it; {moved}"
        )
        remedy = (
            "backlash, more than one load, or strong cogging? `tune` holds its margins on the points as measured; "
            "diagnose recordings of the axis before its gains are raised"
        )
        return judged("resonance", WARNING, text, remedy, numbers | {"fit_error": found.fit_error})
    if load is None:
        return judged("resonance", OK, f"none from {band}; {moved}", numbers=numbers)
    text = (
        f"{100.0 * load.share:.0f} +- {100.0 * NORMAL_95 * load.share_sd:.1g} % of the inertia swings on a spring at "
        f"{load.frequency_hz:.4g} +- {NORMAL_95 * load.frequency_sd_hz:.2g} Hz, damping ratio {load.damping:.2g}, "
        f"antiresonance at {load.antiresonance_hz:.4g} Hz; {moved}"
    )
    remedy = (
        "a belt, a coupling, a shaft or a gear that twists: stiffen it if the loop is to be fast. `tune` holds its "
        "margins on this response"
    )
    numbers |= {"frequency_hz": load.frequency_hz, "share": load.share, "damping": load.damping}
    return judged("resonance", WARNING, text, remedy, numbers)


def contact(found: ResponseRecord | str, beliefs: Beliefs) -> CheckRecord:
    """How stiffly friction holds the axis at rest; text: why it cannot be told."""
    remedy = "the margins at rest stand on the model's contact alone: watch the axis when it first stands under control"
    if isinstance(found, str):
        return judged("contact", WARNING, f"cannot tell: {found}", remedy)
    contact_nm, at_rest = found.contact_nm_per_rev(beliefs.torque_constant_nm_per_a), found.at_rest
    assert contact_nm is not None
    assert at_rest is not None
    last, hz = at_rest.contacts[-1], [math.sqrt(value) / (2.0 * math.pi) for value in at_rest.contact_per_s2]
    text = (
        f"friction holds the axis at rest with {contact_nm[0]:.3g} to {contact_nm[1]:.3g} Nm/rev, on which its inertia "
        f"resonates at {hz[0]:.3g} to {hz[1]:.3g} Hz; under {last.current_a:.2g} A it moved by {last.travel_rev:.2g} "
        "rev. `tune` holds its margins at rest on it"
    )
    numbers = {"softest_nm_per_rev": contact_nm[0], "stiffest_nm_per_rev": contact_nm[1]}
    soft, stiff = beliefs.contact_nm_per_rev
    if beliefs.contact_assumed:
        return judged("contact", OK, text, numbers=numbers)
    text += f"; the model's contact has {soft:.3g} to {stiff:.3g} Nm/rev"
    same = is_same_contact(contact_nm, beliefs.contact_nm_per_rev)
    remedy = "identify the axis again, with slow reversals: its friction torque at rest and after a reversal is wrong"
    return judged("contact", OK if same else WARNING, text, remedy, numbers)
