"""Whether a diagnosed model may be put in service on an axis: gates, each with its reason.

Each gate checks one thing that can go wrong: the effects do not exist (held-out error, intervals), a parameter is out
of range, no effect can be compensated, the loop loses its stability condition or margins, the model is of another axis,
or the drive has torque while its model is changed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ..config.axis import AxisFile, build_profile
from ..config.checks import law_problems
from ..config.effects import effect_limits, effect_problems, services, slope_margin
from ..model.effects.law import STRENGTH
from ..model.effects.registry import law_of
from ..model.parameters import EffectModel, ModelFile, effect_errors
from ..units import NORMAL_95, TWO_PI, name_on, text_on, unit_in

DISABLED = "drive disabled"
SAME_AXIS = "same axis"
HELD_OUT = "held-out error"
STABILITY = "stability"
NOTHING_CARRIES_OVER = "nothing_carries_over"  # verdict of a diagnosis
# factor by which a refit may move a parameter of the model in service; beyond it the runs are of another axis
OTHER_AXIS = {"inertia_kg_m2": 2.0, "friction.coulomb_nm": 4.0}


class Gate(NamedTuple):
    """One condition of an adoption."""

    name: str
    passed: bool
    text: str  # what was found


def held_out_gate(report: Mapping[str, Any] | None) -> Gate:
    """The error on the held-out runs has fallen, clearly: by one of the two intervals, or where an effect acts."""
    if report is None:
        return Gate(HELD_OUT, False, "there is no report.json of `fffo-drive diagnose` next to the model")
    if report.get("verdict") == NOTHING_CARRIES_OVER:
        return Gate(HELD_OUT, False, str(report.get("headline") or "the held-out runs confirm none of the effects"))
    before, after = (report.get(key, {}).get("held_out") for key in ("before", "after"))
    if not before or not after:
        return Gate(HELD_OUT, False, "the report has no held-out runs: diagnose again with --held-out")
    old, new = (_torque_rms_nm(figures) for figures in (before, after))
    if not (math.isfinite(old) and math.isfinite(new)):
        return Gate(HELD_OUT, False, "the error on the held-out runs is not finite")
    highest = _finite(after.get("interval_95", {}).get("torque_rms_nm", [new, new])[1], math.inf)
    lowest = _finite(before.get("interval_95", {}).get("torque_rms_nm", [old, old])[0], -math.inf)
    text = f"{old:.3g} -> {new:.3g} Nm rms ({100.0 * (new / old - 1.0):+.1f} %), at most {highest:.3g} (95 %)"
    regime = any(
        _torque_rms_nm((effect.get("after") or {}).get("held_out_regime"))
        < _torque_rms_nm((effect.get("before") or {}).get("held_out_regime"))
        for effect in [*report.get("effects", []), *report.get("friction_form", [])]
        if effect.get("accepted")
    )
    if new < old and (highest < old or new < lowest):
        return Gate(HELD_OUT, True, text)
    if new <= old and regime:
        return Gate(HELD_OUT, True, text + "; clear in the regime where the effect acts")
    return Gate(HELD_OUT, False, text)


def _torque_rms_nm(figures: Mapping[str, Any] | None) -> float:
    """NaN where a report has no number: every comparison with it is false."""
    return _finite((figures or {}).get("torque_rms_nm"), math.nan)


def _finite(value: Any, otherwise: float) -> float:
    """A number of a report, whose JSON has null for one that is not finite."""
    return otherwise if value is None else float(value)


def rest_gate(report: Mapping[str, Any] | None) -> Gate | None:
    """What the diagnosis could not explain: shown only, it refuses nothing. None: nothing is left."""
    rest = (report or {}).get("unexplained_rest")
    return None if not rest else Gate("unexplained rest", True, str(rest["sentence"]))


def interval_gate(effect: EffectModel, linear: bool = False) -> Gate:
    """The strengths together differ from zero: the root of the sum of (value / sd)² exceeds 1.96 sqrt(number)."""
    law = law_of(effect.name)
    strengths = []
    quantities = effect.quantities()
    for p in law.parameters:
        quantity = quantities.get(p.name)
        if p.kind == STRENGTH and quantity is not None and quantity.value != 0.0:
            strengths.append((name_on(p.name, p.unit, linear), quantity.value, quantity.sd))
    name = f"{effect.name}: interval"
    if not strengths:
        return Gate(name, False, "no strength")
    unknown = [key for key, _, sd in strengths if sd is None]
    if len(unknown) == len(strengths):
        return Gate(name, False, "no standard deviation: the strengths were not fitted, or are at a bound")
    known = [(key, value, sd) for key, value, sd in strengths if sd is not None]
    distance = math.sqrt(sum((value / sd) ** 2 for _, value, sd in known if sd > 0.0))
    needed = NORMAL_95 * math.sqrt(len(known))
    first, value, sd = known[0]
    together = f"all {len(known)} strengths together: " if len(known) > 1 else ""
    text = f"{first} = {value:.3g} +- {sd:.2g}; {together}{distance:.1f} standard deviations from zero"
    return Gate(name, distance > needed, f"{text}, {needed:.1f} needed")


def bounds_gate(effect: EffectModel) -> Gate:
    """Every parameter lies within its law's range."""
    errors = effect_errors([effect])
    text = "; ".join(f"{key.removeprefix('effects[0].').removeprefix('parameters.')}: {why}" for key, why in errors)
    return Gate(f"{effect.name}: range", not errors, text or "inside the law's range")


def compensation_gate(axis: AxisFile, model: ModelFile) -> Gate:
    """At least one effect can be compensated; which, and why the others cannot."""
    found = services(axis, model)
    limits = effect_limits(axis, model)
    said = [f"{s.effect.name}: {s.reason or f'compensated, within +-{limits.each_nm:.3g} Nm'}" for s in found]
    if not found:
        return Gate("compensation", True, "the model has no effects: only its parameters change")
    return Gate("compensation", any(s.reason is None for s in found), "; ".join(said))


def stability_gate(axis: AxisFile, model: ModelFile) -> Gate:
    """Condition (14), the margins, and both with the slope of the feed-forward over the motor angle."""
    profile = build_profile(axis.profile, axis.loop.period_s)
    observer_on = axis.controller.observer.toggle != "off"
    problems = law_problems(axis, model, observer_on) + effect_problems(axis, model, profile, observer_on)
    margin = slope_margin(axis, model, profile, observer_on)
    text = (
        f"slope over the angle {margin.slope_nm_per_rev:.3g} Nm/rev; with it "
        f"{margin.condition_14_nm_per_rev:.3g} Nm/rev "
        f"of margin in (14), {margin.phase_deg:.1f} deg, gain margin {margin.gain:.2f}"
    )
    return Gate(STABILITY, not problems, "; ".join([text, *problems]))


def same_axis_gate(in_service: ModelFile, model: ModelFile) -> Gate:
    """The model is of this axis: the same torque constant, and about the same inertia and Coulomb friction."""
    ours, theirs = in_service.torque_constant_nm_per_a, model.torque_constant_nm_per_a
    same = math.isclose(ours, theirs, rel_tol=1e-3)
    said = [f"torque constant {theirs:g} Nm/A, in service {ours:g}"]
    for key, factor in OTHER_AXIS.items():
        before, after = (_value(m, key) for m in (in_service, model))
        same = same and 1.0 / factor <= after / before <= factor
        name = key.rpartition(".")[2]
        if model.units == "linear":
            scale = TWO_PI if name == "inertia_kg_m2" else 1.0
            name = "mass_kg" if name == "inertia_kg_m2" else name_on(name, unit_in(name), linear=True)
            before, after = scale * before, scale * after
        said.append(f"{name} {after:.3g}, in service {before:.3g} (factor {factor:g} allowed)")
    return Gate(SAME_AXIS, same, "; ".join(said))


def _value(model: ModelFile, key: str) -> float:
    found: Any = model
    for part in key.split("."):
        found = getattr(found, part)
    return float(found.value)


def gates(
    axis: AxisFile, in_service: ModelFile, model: ModelFile, report: Mapping[str, Any] | None, torque_on: bool | None
) -> list[Gate]:
    """All of them. `torque_on`: what the axis' daemon says; None where none answers."""
    found = [
        Gate(
            DISABLED,
            not torque_on,
            {True: "the daemon has torque on: `fffo-drive ctl disable` first", False: "the daemon has no torque on",
             None: "no daemon serves this axis"}[torque_on],
        ),
        same_axis_gate(in_service, model),
        held_out_gate(report) if model.effects else Gate(HELD_OUT, True, "no effects"),
    ]  # fmt: skip
    linear = model.units == "linear"
    rest = rest_gate(report)
    found += [rest] if rest is not None else []
    for service in services(axis, model):
        if service.reason is None:
            found += [interval_gate(service.effect, linear), bounds_gate(service.effect)]
    found += [compensation_gate(axis, model), stability_gate(axis, model)]
    return [gate if gate.name == DISABLED else gate._replace(text=text_on(gate.text, linear)) for gate in found]


def refused_effects(model: ModelFile, found: Sequence[Gate]) -> list[str]:
    """Names of effects whose own gates refuse them. Without these, the other effects can be adopted."""
    names = {gate.name.rpartition(": ")[0] for gate in found if not gate.passed}
    return [name for name in dict.fromkeys(effect.name for effect in model.effects) if name in names]
