"""Gains for a fitted model, as a section of an axis file, with their margins."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from .. import formats
from ..config.axis import AxisFile, hold_dead_band_rev, loop_axis, read_axis, rebased
from ..config.checks import fallback_problems, velocity_problems
from ..config.commissioning import NOT_COMMISSIONED, Commissioned
from ..config.sections import ControllerSection, VelocitySection, VelocitySource, best_law
from ..control.stability import (
    RIGID,
    LinearAxis,
    contact_nm_per_rev,
    is_same_contact,
    linear_axis,
    loop_margins,
    stick_slip_rps,
    stuck_axes,
)
from ..documents import DocumentError, parse, read_text, up_to_date
from ..identification.estimate_gain import (
    EstimateWorth,
    Noise,
    noise_in_loop,
    squared_error_of_a_step,
    white_position,
)
from ..identification.tuning import (
    Design,
    Gains,
    Wish,
    as_written,
    design,
    gains_in_motion,
    notches_for,
    resonance_text,
    root_locus,
    step_response,
)
from ..identification.uncertainty import ADVICE, UNKNOWN_SD
from ..model.parameters import ModelFile
from ..units import NORMAL_95, inertia_kg_m2

LOCUS_POINTS = 61
STEP_S = 0.4
ROUNDING = 1e-6  # of margins
SAME_RESONANCE, SAME_SHARE = 0.1, 0.1  # of the frequency, and of the inertia: by which two measurements may differ
FRICTION_ERROR_SHARE = 0.1  # of Coulomb friction: by which a model is wrong, as in all tables
REVERSALS_PER_S = 2.0  # at each of which that friction steps, against the noise that is always there
NARROWER = (0.75, 0.5, 0.25, 0.0)  # of a range without gains, on a logarithmic scale: tried for a refusal


class Tuned(NamedTuple):
    """Gains, and the linear axis that they are for, with its notches."""

    axis: LinearAxis
    design: Design
    by_notches: float | None = None  # times the integral action that the same margins allow without; None: no notch
    velocity: VelocitySection = VelocitySection()  # that the error takes

    def __repr__(self) -> str:
        gains, margins = self.design.gains, self.design.margins_observer
        return (
            f"Tuned(Kp {gains.proportional_a_per_rps:.4g} A/rps, Ki {gains.integral_a_per_rev:.4g} A/rev, "
            f"L {gains.observer_nm_per_rev:.4g} Nm/rev: phase margin {margins.phase_deg:.1f} deg, gain margin "
            f"{margins.gain:.2f}, crossover {margins.crossover_hz:.1f} Hz)"
        )

    def section(self, current_limit_a: float) -> dict[str, Any]:
        """The `controller:` section of an axis file: the gains, and the best law that is known, whole."""
        return controller_section(self.design, self.axis, current_limit_a, self.velocity)

    def summary(self) -> dict[str, Any]:
        """Gains, margins, root locus and step, JSON-ready."""
        return summarise(self.design, self.axis) | {"integral_action_by_notches": self.by_notches}


def tune(
    model: ModelFile, axis: LinearAxis, wish: Wish, commissioned: Commissioned = NOT_COMMISSIONED,
    dead_band_rev: float = hold_dead_band_rev(None),
) -> Tuned:  # fmt: skip
    """Choose gains for the linear axis of a model. Raises DocumentError if none has the required margins.

    Also where a bandwidth or damping ratio is not above 0. `commissioned`: what commissioning measured. Backlash and
    elasticity make the delay of a rigid model too short; the longer of the two is designed for. Where commissioning
    took an elastic axis for a rigid one, because its record has no response, the model's own delay counts. Notches are
    chosen where they gain. An axis that moved unlike a single rigid inertia, which neither the response nor an effect
    of the model explains, is a warning. With a range of inertia the margins hold over it.
    `dead_band_rev`: of the position hold, in general its resolution.
    """
    require_positive(bandwidth_hz=wish.bandwidth_hz, damping_ratio=wish.damping_ratio)
    if commissioned.response is not None and axis.measured is not None:  # it has the longer delay already
        delay_s, added_s = commissioned.response.delay_s, 0.0
    else:
        delay_s = (commissioned.delay_s or 0.0) if axis.elastic == RIGID else 0.0
        added_s = max(0.0, delay_s - model.delay_s.value)
    longer_s = max(0.0, delay_s - model.delay_s.value)
    axis = axis._replace(delay_s=axis.delay_s + added_s)
    axis = axis._replace(notches=())
    axis = axis._replace(notches=notches_for(axis, wish))
    found = design(axis, model.friction.attraction_nm_per_rev.value, wish, stuck_axes(axis, model, dead_band_rev))
    refuse_unstable(found, axis, wish, model)
    found = found._replace(
        warnings=(
            *found.warnings,
            *undetermined(model),
            *outside_range(axis, model),
            *other_load(model, axis),
            *other_contact(model, axis),
        )
    )
    if longer_s > NORMAL_95 * (model.delay_s.sd or 0.0):  # beyond the model's own interval
        text = (
            f"designed for the delay that commissioning measured, {1e3 * longer_s:.2f} ms longer than the model's "
            f"{1e3 * model.delay_s.value:.2f} ms"
        )
        found = found._replace(warnings=(*found.warnings, text))
    if needs_diagnosis(model, commissioned):
        text = (
            f"commissioning found that a single rigid inertia leaves {100.0 * commissioned.unexplained_share:.0f} % of "
            "the velocity variance unexplained, and the model has no effect such as elasticity: the margins may not "
            "hold on this axis. Diagnose the same recordings and tune for the model that `diagnose` writes"
        )
        found = found._replace(warnings=(*found.warnings, text))
    slow_rps = stick_slip_rps(axis, model.friction_config(), found.gains.in_motion)
    if slow_rps is not None:
        refuse_range(axis, wish, model)
        text = (
            f"from {slow_rps[0]:.2g} to {slow_rps[1]:.2g} rps expect stick-slip: the model's friction falls "
            "faster with speed than Kp can hold behind this delay. Move faster, shorten the delay, or change the "
            "lubricant"
        )
        found = found._replace(warnings=(*found.warnings, text))
    return Tuned(axis, found, _by_notches(axis, found, wish) if axis.notches else None)


def _by_notches(axis: LinearAxis, found: Design, wish: Wish) -> float:
    """How many times the integral action that the margins allow without notches; infinite if they allow none."""
    without = axis._replace(notches=())
    gains = Gains(*gains_in_motion(without, wish))
    if not wish.is_met(loop_margins(without, *gains.in_motion)):
        return math.inf
    kt = axis.torque_constant_nm_per_a
    return found.gains.integral_action_nm_per_rev(kt) / gains.integral_action_nm_per_rev(kt)


def other_load(model: ModelFile, axis: LinearAxis) -> list[str]:
    """A sentence where the elastic load of the model is not the one that the measured response has."""
    known = linear_axis(model, axis.period_s).elastic
    if known == RIGID or axis.measured is None:
        return []
    apart = abs(known.frequency_hz - axis.elastic.frequency_hz) > SAME_RESONANCE * known.frequency_hz
    if not apart and abs(known.share - axis.elastic.share) <= SAME_SHARE:
        return []
    measured = "none"
    if axis.elastic != RIGID:
        measured = f"{100.0 * axis.elastic.share:.2g} % at {axis.elastic.frequency_hz:.3g} Hz"
    return [
        f"the elasticity of the model has {100.0 * known.share:.2g} % of the inertia at {known.frequency_hz:.3g} Hz, "
        f"the response that commissioning measured {measured}: the response counts. Diagnose new recordings, or "
        "commission again if load or coupling have changed"
    ]


def other_contact(model: ModelFile, axis: LinearAxis) -> list[str]:
    """A sentence where the contact of the model is not the one that was measured at rest."""
    measured, known = axis.measured_contact_nm_per_rev, contact_nm_per_rev(model)
    if measured is None or is_same_contact(measured, known):
        return []
    return [
        f"at rest the model's friction holds the axis with {known[0]:.3g} to {known[1]:.3g} Nm/rev, commissioning "
        f"measured {measured[0]:.3g} to {measured[1]:.3g}: the measured one counts. Identify again with slow reversals"
    ]


def outside_range(axis: LinearAxis, model: ModelFile) -> list[str]:
    """A sentence where the model's inertia is outside the declared range: it was identified with no load of it."""
    ends = axis.inertia_range_nm_s2_per_rev
    if ends is None or ends[0] <= axis.inertia_nm_s2_per_rev <= ends[1]:
        return []
    own = model.inertia_text(axis.inertia_nm_s2_per_rev)
    return [
        f"the model's inertia, {own}, is outside the range {model.inertia_text(*ends)}: the feed-forward of inertia "
        "is wrong for each of its loads. Identify again with one of them"
    ]


def needs_diagnosis(model: ModelFile, commissioned: Commissioned) -> bool:
    """Whether the axis moved unlike a single rigid inertia, and neither the sweep nor the model says what it is."""
    swings = commissioned.response is not None and commissioned.response.elastic is not None
    return commissioned.unexplained_share > 0.0 and not model.effects and not swings


def tune_axis(
    axis_file: AxisFile, model: ModelFile, wish: Wish, commissioned: Commissioned, source: VelocitySource | None = None
) -> tuple[Tuned, EstimateWorth | None]:
    """Gains for an axis file, and what the estimated velocity is worth to it.

    `source`: of the velocity in the error, as `controller.velocity.source`. None: the file's own; but in place of
    the drive's the estimate, where with the noise that commissioning measured it gains. Its worth is None where it is
    asked for or in use already; where the loop cannot have it; and where a part of the inertia swings or the axis is
    known to be unlike the model: the estimate believes in one rigid inertia. Raises DocumentError if no gains have the
    required margins.
    """
    if source is not None:
        axis_file = with_velocity(axis_file, source)
    own = tune(model, loop_axis(axis_file, model), wish, commissioned, hold_dead_band_rev(axis_file))
    own = own._replace(velocity=axis_file.controller.velocity)
    chosen = source is not None or own.velocity.estimated
    if chosen or own.axis.elastic != RIGID or needs_diagnosis(model, commissioned):
        return own, None
    other = _on_the_estimate(axis_file, model, wish, commissioned)
    if other is None:
        return own, None
    worth = _worth(axis_file, model, commissioned, own, other)
    return (other if worth.gains and worth.drive_step_a is not None else own), worth


def with_velocity(axis_file: AxisFile, source: VelocitySource) -> AxisFile:
    """The axis file with another source of the velocity in the error."""
    velocity = axis_file.controller.velocity.model_copy(update={"source": source})
    controller = axis_file.controller.model_copy(update={"velocity": velocity})
    return axis_file.model_copy(update={"controller": controller})


def _on_the_estimate(axis_file: AxisFile, model: ModelFile, wish: Wish, commissioned: Commissioned) -> Tuned | None:
    """The tuning on the estimated velocity; None where the axis cannot have it."""
    other = with_velocity(axis_file, "estimated")
    if velocity_problems(other, model):
        return None
    try:
        tuned = tune(model, loop_axis(other, model), wish, commissioned, hold_dead_band_rev(axis_file))
    except DocumentError:
        return None
    controller = other.controller
    tuned = tuned._replace(velocity=controller.velocity)
    written = formats.over(controller.model_dump(), tuned.section(controller.current_limit_a))
    other = other.model_copy(update={"controller": ControllerSection.model_validate(written)})
    if velocity_problems(other, model) or fallback_problems(other, model, observer_on=True):
        return None
    return tuned


def _worth(
    axis_file: AxisFile, model: ModelFile, commissioned: Commissioned, own: Tuned, other: Tuned
) -> EstimateWorth:
    """What the estimate gains: of what friction outside the model leaves, and of the sensor's noise where known."""
    kt, period_s = model.torque_constant_nm_per_a, axis_file.loop.period_s
    laws = [(one.axis, one.design.gains) for one in (own, other)]
    actions = [gains.integral_action_nm_per_rev(kt) for _, gains in laws]
    squared = [squared_error_of_a_step(*law) for law in laws]
    noise = commissioned.noise
    if noise is None:
        counts = white_position(hold_dead_band_rev(axis_file) / math.sqrt(12.0), period_s)
        step_a = noise_in_loop(*laws[1], counts, period_s).step_a
        return EstimateWorth(actions[1] / actions[0], squared[1] / squared[0], step_a, None)
    frequency_hz = np.array(noise.frequency_hz)
    drive = noise_in_loop(*laws[0], Noise(frequency_hz, np.array(noise.velocity_rps2_per_hz)), period_s)
    position = Noise(frequency_hz, np.array(noise.position_rev2_per_hz), of_position=True)
    estimate = noise_in_loop(*laws[1], position, period_s)
    per_s = REVERSALS_PER_S * (2.0 * FRICTION_ERROR_SHARE * model.friction.coulomb_nm.value) ** 2
    error_ratio = (per_s * squared[1] + estimate.shaft_rps2) / (per_s * squared[0] + drive.shaft_rps2)
    return EstimateWorth(actions[1] / actions[0], error_ratio, estimate.step_a, drive.step_a)


def undetermined(model: ModelFile) -> list[str]:
    """A sentence for each of inertia, viscous and Coulomb friction that the data of a fitted model hardly determine.

    If the excitation hardly moved the axis, many pairs of viscous and Coulomb friction fit its data equally well: the
    margins, which count on the viscous one, may then be wrong, and the feed-forward torque may be several times the
    friction.
    """
    return [
        f"the data of the model do not determine {what}, {quantity.value:.3g} +- {quantity.sd:.2g} {unit} "
        f"({ADVICE[key][0]}): the gains may be wrong for this axis. Record {ADVICE[key][1]}, with more current, and "
        "identify again"
        for key, what, quantity, unit in (
            ("inertia_nm_s2_per_rev", "inertia J", model.inertia_kg_m2, "kg m2"),
            ("viscous_nm_per_rps", "viscous friction sigma", model.friction.viscous_nm_per_rps, "Nm/rps"),
            ("coulomb_nm", "Coulomb friction Fc", model.friction.coulomb_nm, "Nm"),
        )
        if quantity.sd is not None and quantity.sd > UNKNOWN_SD * abs(quantity.value)
    ]


def require_positive(**given: float | None) -> None:
    """Raises DocumentError for a number that is not above 0 and finite; None is none."""
    for name, value in given.items():
        if value is not None and not 0.0 < value < math.inf:
            raise DocumentError(f"{name}: {value:g}: a number above 0 is needed")


def controller_section(
    found: Design, axis: LinearAxis, current_limit_a: float, velocity: VelocitySection
) -> dict[str, Any]:
    """The `controller:` section of an axis file: all that a file of the axis needs to have the best law.

    Every part is said, also where it is the default: what a file says, no later default changes.
    """
    gains: dict[str, Any] = {
        "proportional_a_per_rps": as_written(found.gains.proportional_a_per_rps),
        "integral_a_per_rev": as_written(found.gains.integral_a_per_rev),
        "current_limit_a": current_limit_a,
        "error_filter_s": axis.error_filter_s,
        "velocity": velocity.model_dump(),
        "notches": [notch._asdict() for notch in axis.notches],
        "observer": {"toggle": "ff", "gain_nm_per_rev": as_written(found.gains.observer_nm_per_rev)},
        "at_rest": {
            "gain_share": as_written(found.gains.rest_share),
            "hold_a_per_rev_s": as_written(found.gains.hold_a_per_rev_s),
        },
    }
    if axis.inertia_range_nm_s2_per_rev is not None:
        ends = [inertia_kg_m2(inertia) for inertia in axis.inertia_range_nm_s2_per_rev]
        gains["inertia_range_kg_m2"] = [float(f"{inertia:.10g}") for inertia in ends]
    law: dict[str, Any] = formats.over(best_law(), gains)
    return gains | law


def section_text(section: dict[str, Any]) -> str:
    """The section as a file, for an axis file that is written by hand."""
    return yaml.safe_dump({"controller": section}, sort_keys=False)


def write_tuned_axis(
    source: Path, out: Path, section: dict[str, Any], model: Path, blind_ticks: int | None = None
) -> Path:
    """Write a copy of an axis file with this section and model to the directory `out`; return its path.

    `blind_ticks`: for `envelope.feedback_missing_ticks`; None: the file's own. Keys of the section that are not tuned
    are kept; an older file is brought up to date. Raises DocumentError, OSError.
    """
    parsed, lines = parse(read_text(source), str(source))
    data = dict(up_to_date(parsed, formats.AXIS.kind, str(source), lines))
    data["controller"] = formats.over(data["controller"], section)
    if blind_ticks is not None:
        data["envelope"] = data["envelope"] | {"feedback_missing_ticks": blind_ticks}
    data = rebased(data | {"model": str(model.resolve())}, source, out)
    target = out / source.name
    target.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    read_axis(target)
    return target


def summarise(found: Design, axis: LinearAxis) -> dict[str, Any]:
    """The design, its root locus and its step, JSON-ready."""
    gains = found.gains
    integral_time_s = gains.proportional_a_per_rps / gains.integral_a_per_rev
    locus = root_locus(axis, integral_time_s, gains.proportional_a_per_rps * np.geomspace(0.02, 10.0, LOCUS_POINTS))
    step = step_response(axis, gains.proportional_a_per_rps, gains.integral_a_per_rev, STEP_S)
    return {
        "format": formats.TUNING.word,
        "axis": {key: value for key, value in axis._asdict().items() if key != "measured"},
        "measured_hz": None if axis.measured is None else [axis.measured.frequencies_hz[k] for k in (0, -1)],
        "gains": gains._asdict(),
        "integral_time_s": integral_time_s,
        "margins_pi": found.margins_pi._asdict(),
        "margins_observer": found.margins_observer._asdict(),
        "margins_rest": found.margins_rest._asdict(),
        "condition_14_nm_per_rev": found.condition_14_nm_per_rev,
        "real_poles_from_a_per_rps": found.real_poles_from_a_per_rps,
        "overshoot_percent": found.overshoot_percent,
        "settled_s": found.settled_s,
        "damping_with_real_poles_nm_per_rps": found.without_overshoot._asdict()
        | {"ratio": found.without_overshoot.ratio},
        "damping_within_margins_nm_per_rps": found.within_margins._asdict() | {"ratio": found.within_margins.ratio},
        "root_locus": [
            {"proportional_a_per_rps": p.proportional_a_per_rps, "poles": [[z.real, z.imag] for z in p.poles]}
            for p in locus
        ],
        "step": {"period_s": STEP_S / 400, "velocity_rps": step[:: step.size // 400].tolist()},
        "warnings": list(found.warnings),
    }


def refuse_unstable(found: Design, axis: LinearAxis, wish: Wish, model: ModelFile) -> None:
    """Refuse gains that miss the required margins. Raises DocumentError that names a crossover that has them."""
    margins = found.margins_observer
    if margins.phase_deg >= wish.phase_margin_deg - ROUNDING and margins.gain >= wish.gain_margin - ROUNDING:
        return
    text = (
        f"the loop would have a phase margin of {margins.phase_deg:.1f} deg and a gain margin of {margins.gain:.2f}; "
        f"{wish.phase_margin_deg:g} deg and {wish.gain_margin:g} are required"
        f"{'' if axis.elastic == RIGID else f', with {resonance_text(axis)}'}. "
    )
    free_wish = wish._replace(bandwidth_hz=None)
    free = design(axis, model.friction.attraction_nm_per_rev.value, free_wish)
    if free.margins_observer.phase_deg >= wish.phase_margin_deg - ROUNDING and wish.bandwidth_hz is not None:
        crossover_hz = free.margins_pi.crossover_hz
        raise DocumentError(
            f"with a crossover of {wish.bandwidth_hz:g} Hz {text}A crossover of {crossover_hz:.3g} Hz has them"
        )
    remedy = "require smaller margins"
    if axis.elastic != RIGID:
        remedy = f"no notch helps: stiffen the coupling, damp the load, or {remedy}"
    if axis.inertia_range_nm_s2_per_rev is not None:
        text = f"with an inertia of {model.inertia_text(*axis.inertia_range_nm_s2_per_rev)} {text}"
        narrower = _narrower(axis, free_wish, model)
        if narrower is not None:
            remedy = f"from {narrower} one does: give a narrower range (a file for each load), or {remedy}"
    raise DocumentError(f"{model.name}: {text}No crossover gives them: {remedy}")


def refuse_range(axis: LinearAxis, wish: Wish, model: ModelFile) -> None:
    """Refuse a range of inertia so wide that the axis would stick and slip, if it does not over a narrower one."""
    if axis.inertia_range_nm_s2_per_rev is None:
        return
    narrower = _narrower(axis, wish, model)
    if narrower is not None:
        raise DocumentError(
            f"{model.name}: gains that keep the margins with an inertia of "
            f"{model.inertia_text(*axis.inertia_range_nm_s2_per_rev)} are so low that the axis would stick and slip. "
            f"From {narrower} it would not: give a narrower range (a file for each load), or shorten the delay"
        )


def _narrower(axis: LinearAxis, wish: Wish, model: ModelFile) -> str | None:
    """A part of the range, around the model's inertia, over which there are gains without stick-slip; None: not even
    at that inertia.
    """
    assert axis.inertia_range_nm_s2_per_rev is not None
    own = axis.inertia_nm_s2_per_rev
    for share in NARROWER:
        ends = [own * (end / own) ** share for end in axis.inertia_range_nm_s2_per_rev]
        one = axis._replace(inertia_range_nm_s2_per_rev=(ends[0], ends[1]))
        gains = gains_in_motion(one, wish)
        if wish.is_met(loop_margins(one, *gains)) and stick_slip_rps(one, model.friction_config(), gains) is None:
            return model.inertia_text(*ends)
    return None
