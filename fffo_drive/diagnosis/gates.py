"""Physical plausibility: reject an axis that shrinks, a shape at a bound, a lag that the measured current does not
show.

A law that acts on the command, or a spring, can absorb half of the command; inertia and friction then shrink with it
and the residual falls on any run. The axis from the ladder's first rungs is therefore the reference.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..model.effects.law import SHAPE, Parameter
from ..model.effects.registry import law_of
from .base import BASE, NAMES, delayed, models_along
from .fitting import Data, Fitted, consistent_scenes, standard_deviations, torque_of
from .propose import WAVE_RUNG
from .scenes import Effect, load_along, load_rows
from .spectra import own_line

NEGLIGIBLE = 0.0025  # rms share of the needed torque; a sensor leaves as much (ablation_diagnosis.md)
INERTIA_FACTOR = 1.5  # largest factor by which an effect may change the inertia of the first rungs ...
NEEDED_SHARE = 0.6  # ... and the smallest share of their needed torque that must remain needed
DETERMINED_SD = 0.3  # sd of the logarithm of the inertia above which the data do not determine it
AT_BOUND = 0.01  # share of the plausible range: a number this near a bound is implausible
SHOWN_SHARE = 0.5  # share of the current's shortfall against its command that an effect must account for
LONGEST_SAMPLES = 20  # longest delay between command and measured current
FINENESS = 2  # delays tried per sample


class ReferenceAxis(NamedTuple):
    """The axis as fitted by the first rungs of the ladder."""

    inertia_nm_s2_per_rev: float
    inertia_sd: float  # of its logarithm
    needed_nm: float  # rms torque: J a, friction, and the effects of these rungs

    @property
    def inertia_is_determined(self) -> bool:
        """Whether the data determine the inertia."""
        return self.inertia_sd < DETERMINED_SD

    @property
    def negligible_nm(self) -> float:
        """Rms torque below which an effect is negligible, and which any parameter may hide."""
        return NEGLIGIBLE * self.needed_nm

    def beside(self, inertia_nm_s2_per_rev: float) -> ReferenceAxis:
        """The axis, where a force balance gives this inertia: where the two differ, the data do not determine it."""
        change = abs(float(np.log(self.inertia_nm_s2_per_rev / max(inertia_nm_s2_per_rev, 1e-300))))
        return self._replace(inertia_sd=max(self.inertia_sd, change))

    @classmethod
    def of(cls, data: Data, fitted: Fitted, matrix: Floats) -> ReferenceAxis:
        """The axis of a fit of the first rungs."""
        sd = standard_deviations(data, fitted, matrix)[BASE.index("inertia_nm_s2_per_rev")]
        inertia = float(fitted.physical[NAMES.index("inertia_nm_s2_per_rev")])
        return cls(inertia, float(sd), needed_rms_nm(data, fitted))


def needed_rows(data: Data, fitted: Fitted) -> Floats:
    """Torque that the axis needs according to a model: J a, friction, and effects that do not act on the command.
    (m,)

    An effect on the command that the measured current confirms counts as needed: there the axis does not shrink.
    """
    shown = _is_measured(data)
    laws = {effect.name: law_of(effect.name) for effect in fitted.effects}
    load = [
        effect for effect in fitted.effects
        if laws[effect.name].acts_on != "command" or (laws[effect.name].shown_by_current and shown)
    ]  # fmt: skip
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    return rigid_rows(data, fitted) + torque_of(data, scenes, load)


def rigid_rows(data: Data, fitted: Fitted) -> Floats:
    """Torque that the axis needs without its effects: J a and friction. (m,)"""
    models = models_along(data.stretches, fitted.physical)
    inertia = float(fitted.physical[NAMES.index("inertia_nm_s2_per_rev")])
    friction = np.concatenate([data.rows.laws.rows(model.friction_nm) for model in models])
    return np.asarray(inertia * data.rows.acceleration_rps2 + friction)


def _is_measured(data: Data) -> bool:
    return all(stretch.measured_a is not None for stretch in data.stretches)


def needed_rms_nm(data: Data, fitted: Fitted) -> float:
    """Rms of `needed_rows` over the rows that count."""
    return float(np.sqrt(np.mean(needed_rows(data, fitted)[data.used] ** 2)))


def objection(data: Data, fitted: Fitted, reference: ReferenceAxis | None, ablate: frozenset[str]) -> str:
    """Why the last effect of a model is rejected; empty where nothing contradicts it."""
    effect = fitted.effects[-1]
    reason = implausibility(data, fitted, reference, ablate)
    if reason:
        return reason
    if law_of(effect.name).shown_by_current and "current" not in ablate:
        shown = shown_share(data, fitted, effect)
        if shown is None and law_of(effect.name).needs_current:
            return "it acts on the command, which contains the residual: a log with the measured current would decide"
        if shown is not None and shown < SHOWN_SHARE:
            return f"the measured current does not confirm it ({100.0 * max(shown, 0.0):.0f} % of its shortfall)"
    return ""


def implausibility(data: Data, fitted: Fitted, reference: ReferenceAxis | None, ablate: frozenset[str]) -> str:
    """Why a model is physically implausible (an implausible shape, or a shrunken axis); empty where it is not."""
    for effect in () if "shapes" in ablate else fitted.effects:
        reason = _shape_objection(data, effect) or _line_objection(data, fitted, effect)
        if not reason and law_of(effect.name).joint and reference is not None and not reference.inertia_is_determined:
            reason = f"{effect.name} uses part of an inertia that the data do not determine"
        if reason:
            return reason
    if "shrink" in ablate or all(law_of(effect.name).rung <= WAVE_RUNG for effect in fitted.effects):
        return ""  # a constant, a weight or a wave cannot absorb the command
    return shrinking(data, fitted, reference)


def shrinking(data: Data, fitted: Fitted, reference: ReferenceAxis | None) -> str:
    """How a model lowers its error by changing the axis of the first rungs; empty where it does not.

    A rigid axis fitted to a motor and a share of the inertia behind a joint has an inertia between that of the motor,
    above the resonance, and that of both.
    """
    if reference is None:
        return ""
    ratio = float(fitted.physical[NAMES.index("inertia_nm_s2_per_rev")]) / reference.inertia_nm_s2_per_rev
    behind = max([0.0, *(one.values(0)["share"] for one in fitted.effects if law_of(one.name).joint)])
    within = 1.0 / INERTIA_FACTOR < ratio < INERTIA_FACTOR / (1.0 - behind)
    if reference.inertia_is_determined and not within:
        return f"it lowers the error by changing the axis: the inertia would be {ratio:.2g} times as large"
    needed = needed_rms_nm(data, fitted) / reference.needed_nm
    if needed < NEEDED_SHARE:
        return f"it lowers the error by shrinking the axis: only {100.0 * needed:.0f} % of the torque would be needed"
    return ""


def _shape_objection(data: Data, effect: Effect) -> str:
    values = effect.values(0)
    period_rev = values.get("period_rev", 0.0) or 1.0 / values.get("order", np.inf)
    if period_rev > data.rows.turns:
        return f"the data show less than one period ({period_rev:.3g} rev) of this {effect.name}"
    measured = _is_measured(data)
    for parameter in law_of(effect.name).parameters:
        if parameter.held or parameter.is_off(effect.shapes):
            continue
        if law_of(effect.name).shown_by_current and measured and parameter.kind == SHAPE:
            continue  # the measured current decides
        numbers = effect.strengths.get(parameter.name, effect.shapes.get(parameter.name))
        outside = next(
            (value for value in np.ravel([] if numbers is None else numbers) if _at_bound(parameter, value)), None
        )
        if outside is not None:
            low, high = parameter.plausible or (parameter.low, parameter.high)
            words = f"{effect.name} with {parameter.name} {outside:.3g} {parameter.unit}"
            return f"implausible for a machine: {words} is not within {low:g} to {high:g}"
    return ""


def _at_bound(parameter: Parameter, value: float) -> bool:
    """Whether a number is beyond the range of its parameter, or at a bound of it, where a fit that wants more stops."""
    if parameter.plausible is None:
        return not parameter.low < value < parameter.high
    bounds = np.array([*parameter.plausible, value])
    low, high, place = np.log(bounds) if parameter.logarithmic else bounds
    return not low + AT_BOUND * (high - low) < place < high - AT_BOUND * (high - low)


def _line_objection(data: Data, fitted: Fitted, effect: Effect) -> str:
    """An effect at one frequency, where the motion itself has a line there that the effect cannot have made.

    What no model has right of the torque of that line looks like an effect at its frequency. A disturbance moves the
    axis with its own torque, times what the loop amplifies; near a resonance the torque of a spring is that of its
    inertia, and more.
    """
    values = effect.values(0)
    frequency_hz = next((values[p.name] for p in law_of(effect.name).shapes if p.unit == "Hz"), 0.0)
    if frequency_hz <= 0.0:
        return ""
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    width_hz = values.get("damping", 0.0) * frequency_hz
    load_nm = load_rows(data.rows, scenes, effect)
    line = own_line(data.rows, rigid_rows(data, fitted), load_nm, frequency_hz, width_hz)
    if line is None:
        return ""
    return (
        f"the motion itself has a line at {line.place:.4g} Hz, with {line.strength:.2g} times its torque: runs without "
        "that frequency would decide"
    )


def shown_share(data: Data, fitted: Fitted, effect: Effect) -> float | None:
    """Share of the current's shortfall against its command that an effect explains; None: current not measured.

    1 for laws that act on the command, 0 or less for others. The delay of the measurement is free on both sides,
    because a delay alone can explain much of a lag.
    """
    if not _is_measured(data):
        return None
    acts_s = float(fitted.physical[NAMES.index("delay_s")])
    kept = data.rows.kept
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    loads = [
        (np.arange(scene.stretch.samples) * scene.stretch.law_period_s, load_along(scene, effect.name, values))
        for scene in scenes
        for values in [effect.values(scene.stretch.run)]
    ]
    errors, without = [], []
    for samples in np.arange(0, LONGEST_SAMPLES * FINENESS) / FINENESS:
        short, moved = [], []
        for stretch, (time_s, load) in zip(data.stretches, loads, strict=True):
            assert stretch.measured_a is not None
            short_a = delayed(stretch.current_a, float(samples)) - stretch.measured_a
            short.append(data.rows.filter.rows(stretch.torque_constant_nm_per_a * short_a))
            # the effect acts with the torque; the current has a sampling time of its own
            at_s = time_s - samples * data.rows.filter.period_s + acts_s
            moved.append(data.rows.laws.rows(np.interp(at_s, time_s, load)))
        short_nm, moved_nm = np.concatenate(short)[kept], np.concatenate(moved)[kept]
        without.append(float(np.sum(short_nm**2)))
        errors.append(float(np.sum((short_nm - moved_nm) ** 2)))
    return 1.0 - min(errors) / max(min(without), 1e-300)
