"""Which effects of a model the controller gives torque for, within which bounds, and whether the loop stays proven."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..control.compensation import (
    MOST_EFFECTS,
    Limits,
    no_compensation,
    order_of_service,
    pack_compensation,
)
from ..control.reference import MODE_VELOCITY, Profile, profile_bounds
from ..control.stability import condition_14_nm_per_rev, loop_margins
from ..model.axis import AxisConfig
from ..model.effects import slots as s
from ..model.effects.registry import LAWS, is_compensable, law_of
from ..model.effects.table import Term, along_into, effect_table
from ..model.parameters import EffectModel, ModelFile
from .axis import AxisFile, loop_axis

SLOPE_POINTS = 8192  # of one span of the angle
# step, speed, travel since the reversal: what has a memory stands still, or has come to its end within each step
STANDING = (1e-12, 0.0, 0.0)
SETTLED = (1e6, 1e-5, 1e3)


class EffectService(NamedTuple):
    """An effect of a model, and why it is not compensated (None: it is)."""

    effect: EffectModel
    reason: str | None


def services(axis: AxisFile, model: ModelFile) -> list[EffectService]:
    """Every effect of the model, in its order, with the reason that keeps it out of the feed-forward."""
    section = axis.controller.effects
    found: list[EffectService] = []
    taken = 0
    for effect in model.effects:
        reason = reason_against(effect)
        if reason is None and not section.compensate:
            reason = "controller.effects.compensate is false"
        elif reason is None and effect.name in section.out_of_service:
            reason = "controller.effects.out_of_service names it"
        elif reason is None and taken == MOST_EFFECTS:
            reason = f"the loop compensates {MOST_EFFECTS} effects"
        taken += reason is None
        found.append(EffectService(effect, reason))
    return found


def reason_against(effect: EffectModel) -> str | None:
    """Why no feed-forward gives the torque of this effect; None where one does: it is decided, and known ahead.

    Forms of friction that the data do not separate are the same friction: one of them is as good as another.
    """
    term = effect.term()
    family = [effect.name, *effect.alternatives]
    if effect.alternatives and not all(name in LAWS and LAWS[name].form for name in family):
        members = " or ".join(family)
        return f"the data do not decide: {members}; record what does: `fffo-drive run AXIS --decide {effect.name}`"
    if not is_compensable(effect.name, term.values):
        return "its torque is not known in advance"
    if effect.datum == "run" and any(term.values.get(name, 0.0) != 0.0 for name in law_of(effect.name).per_run):
        return "its phase differs from run to run: declare absolute_angle where the drive's angle is absolute"
    return None


def compensated_terms(axis: AxisFile, model: ModelFile) -> list[Term]:
    """The effects that are compensated, in the order of the bits in the row."""
    terms = [service.effect.term() for service in services(axis, model) if service.reason is None]
    return [terms[k] for k in order_of_service(terms)]


def service_bits(axis: AxisFile, model: ModelFile) -> list[tuple[EffectService, int | None]]:
    """Every effect of the model with its bit in the row; None for one that is not compensated."""
    found = services(axis, model)
    taken = [k for k, service in enumerate(found) if service.reason is None]
    order = order_of_service([found[k].effect.term() for k in taken])
    bits = {taken[place]: bit for bit, place in enumerate(order)}
    return [(service, bits.get(k)) for k, service in enumerate(found)]


def compensated_names(axis: AxisFile, model: ModelFile) -> list[str]:
    """Names of the compensated effects in the order of their bits; one of a name that stands twice has a number."""
    names = [term.name for term in compensated_terms(axis, model)]
    return [f"{name} ({names[: k + 1].count(name)})" if names.count(name) > 1 else name for k, name in enumerate(names)]


def effect_limits(axis: AxisFile, model: ModelFile) -> Limits:
    """Bounds of the torque that is added."""
    section = axis.controller.effects
    whole_nm = model.torque_constant_nm_per_a * axis.controller.current_limit_a
    return Limits(section.each_limit_share * whole_nm, section.total_limit_share * whole_nm)


def compensation_table(axis: AxisFile, model: ModelFile) -> Floats:
    """What the loop compensates. The measured position is as old as the drive's answer, the command acts Td later."""
    terms = compensated_terms(axis, model)
    if not terms:
        return no_compensation()
    period_s = axis.loop.period_s
    lead_s = model.delay_s.value - model.sensor_delay_s.value + 0.5 * period_s
    return pack_compensation(terms, model.axis_config(), lead_s, effect_limits(axis, model), period_s)


def angle_slope_nm_per_rev(term: Term, axis: AxisConfig, torque_nm: float) -> float:
    """Largest |dE/d(motor angle)| of an effect, friction at its highest level and `torque_nm` needed, either way.

    A change of the friction's level is felt over some travel: its slope is that of what it comes to.
    """
    return _angle_slope_nm_per_rev(term.name, tuple(term.values.items()), axis, torque_nm)


@functools.lru_cache(maxsize=64)  # an axis's plan, its gates and its page ask for the same slope
def _angle_slope_nm_per_rev(
    name: str, values_of_term: tuple[tuple[str, float], ...], axis: AxisConfig, torque_nm: float
) -> float:
    term = Term(name, dict(values_of_term))
    law = law_of(term.name)
    step_s, speed_rps, travel_rev = SETTLED if law.level else STANDING
    values = law.filled(term.values)
    span_rev = max([1.0] + [abs(values[p.name]) for p in law.parameters if p.span])
    folded = law.fold(values)
    if folded is not None and folded[0] == "motor_angle":
        span_rev = max(span_rev, folded[1])
    if term.values.get("width_rev", 0.0) > 0.0:
        span_rev = max(span_rev, 2.0 * (abs(term.values.get("centre_rev", 0.0)) + term.values["width_rev"]))
    angles = np.linspace(-0.5, 0.5, SLOPE_POINTS) * span_rev
    largest = 0.0
    for contact_nm in (axis.friction.static_nm, -axis.friction.static_nm):
        for needed_nm in (torque_nm, -torque_nm):
            motion = np.zeros((angles.size, s.N_MOTION))
            motion[:, s.MOTOR_ANGLE_REV] = motion[:, s.SENSOR_ANGLE_REV] = angles
            motion[:, s.FRICTION_NM] = contact_nm
            motion[:, s.CURRENT_A] = needed_nm / axis.torque_constant_nm_per_a
            motion[:, s.DIRECTION] = np.sign(contact_nm)
            motion[:, s.VELOCITY_RPS] = np.sign(contact_nm) * speed_rps
            motion[:, s.TRAVEL_REV] = travel_rev + step_s * speed_rps * np.arange(angles.size)
            along = _loads(term, axis, motion, step_s)
            motion[:, s.MOTOR_ANGLE_REV] = motion[:, s.SENSOR_ANGLE_REV] = 0.0
            along -= _loads(term, axis, motion, step_s)  # what changes although the angle does not
            largest = max(largest, float(np.abs(np.diff(along)).max()) * (angles.size - 1) / span_rev)
    return largest


def _loads(term: Term, axis: AxisConfig, motion: Floats, step_s: float) -> Floats:
    load_nm, sensor_rev = np.empty(motion.shape[0]), np.empty(motion.shape[0])
    along_into(effect_table([term], axis, step_s, feedforward=True), motion, load_nm, sensor_rev)
    return load_nm


class SlopeMargin(NamedTuple):
    """What the feedback through the angle leaves of the loop's proof, in the worst case."""

    slope_nm_per_rev: float  # sum over the effects
    condition_14_nm_per_rev: float  # with the slope taken from the integral part
    phase_deg: float  # with the slope added to it
    gain: float


def slope_margin(axis: AxisFile, model: ModelFile, profile: Profile, observer_on: bool) -> SlopeMargin:
    """The proof with all compensated effects. Without the observer the integral part itself must stay positive."""
    config = model.axis_config()
    needed_nm = config.friction.static_nm
    if profile.mode == MODE_VELOCITY:
        bounds = profile_bounds(profile)
        needed_nm += config.inertia_nm_s2_per_rev * bounds.derivative
        needed_nm += config.friction.viscous_nm_per_rps * bounds.value
    slope = sum(angle_slope_nm_per_rev(term, config, needed_nm) for term in compensated_terms(axis, model))
    section = axis.controller
    gain = section.observer.gain_nm_per_rev if observer_on else 0.0
    learning = observer_on and section.observer.learns_in == "friction"
    attraction = config.friction.attraction_nm_per_rev if learning else 0.0
    left = condition_14_nm_per_rev(
        section.integral_a_per_rev, config.torque_constant_nm_per_a, gain - slope, attraction
    )
    margins = loop_margins(
        loop_axis(axis, model),
        section.proportional_a_per_rps,
        section.integral_a_per_rev,
        gain + slope,
    )
    return SlopeMargin(slope, left, margins.phase_deg, margins.gain)


def effect_problems(axis: AxisFile, model: ModelFile, profile: Profile, observer_on: bool) -> list[str]:
    """What speaks against compensating the effects of this model on this axis."""
    if not compensated_terms(axis, model):
        return []
    section = axis.controller
    found = slope_margin(axis, model, profile, observer_on)
    problems = []
    # what is broken without the slope is said of the law itself
    if found.condition_14_nm_per_rev < 0.0 <= found.condition_14_nm_per_rev + found.slope_nm_per_rev:
        problems.append(
            f"controller.effects: the feed-forward's slope over the motor angle, {found.slope_nm_per_rev:.3g} Nm/rev, "
            "reduces the integral action more than condition (14) allows: list the steepest effect in out_of_service, "
            "or raise observer.gain_nm_per_rev"
        )
    if found.phase_deg < section.phase_margin_deg or found.gain < section.gain_margin:
        problems.append(
            f"controller.effects: with the feed-forward's slope over the motor angle, {found.slope_nm_per_rev:.3g} "
            f"Nm/rev, the margins are {found.phase_deg:.1f} deg and {found.gain:.2f}: below phase_margin_deg "
            f"{section.phase_margin_deg:g} or gain_margin {section.gain_margin:g}"
        )
    return problems
