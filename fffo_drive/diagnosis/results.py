"""Results of a diagnosis: findings with their evidence, errors before and after, and the report of part 7 as plain
data.

For a linear axis read m for rev, m/s for rps and N for Nm in all names; the report's `units` says so. The texts
(sentences, units, `symbols`) use the words of the axis.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

from .. import __version__, formats
from ..arrays import Floats
from ..documents import Confidence
from ..identification.population import AgainstPopulation
from ..identification.runs import RunsLook
from ..model.effects.laws.lookup import UNKNOWN, CurveModel, curve_model
from ..model.effects.registry import law_of
from ..model.parameters import ModelFile
from ..units import NORMAL_95, name_on, text_on, unit_on

VerdictWord = Literal["effects_found", "no_effect_found", "unexplained", "nothing_carries_over"]


class Interval(NamedTuple):
    """A number with its 95 % interval from resampled windows."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class ErrorFigures:
    """Errors of a model on a set of runs."""

    torque_rms_nm: Interval
    torque_relative_percent: Interval  # of the needed torque, taken from the first rungs of the ladder
    velocity_rms_rps: Interval  # of free simulation over short windows
    seconds: float  # of motion that was scored


@dataclass(frozen=True)
class Number:
    """One parameter of a finding."""

    name: str
    value: float
    sd: float | None  # None: at a bound, or not fitted
    unit: str
    per_run: str | None = None  # the run that it belongs to


@dataclass(frozen=True)
class FoundCurve:
    """A line or a cloud of bin means in a figure, (n,) each."""

    label: str
    x: Floats
    y: Floats
    low: Floats | None = None  # 95 % interval of y
    high: Floats | None = None
    kind: Literal["points", "line"] = "points"


class PictureMark(NamedTuple):
    """A labelled place on the abscissa."""

    x: float
    label: str


@dataclass(frozen=True)
class Picture:
    """A figure of one effect: residual torque over the effect's axis, or the figure that its law declares."""

    title: str
    x_label: str
    x_unit: str
    y_label: str
    y_unit: str
    curves: tuple[FoundCurve, ...]
    note: str = ""
    marks: tuple[PictureMark, ...] = ()
    says: str = "Residual without and with the effect: means with 95 % intervals."


@dataclass(frozen=True)
class Rival:
    """Another effect, refitted in place of a finding."""

    name: str
    loss_ratio: float  # its loss relative to the finding's, all parameters refitted: above 1 is worse
    collinearity: float  # with the finding's torque, after base sensitivities are projected out: 0 to 1
    same_family: bool  # the data cannot distinguish it from the finding


@dataclass(frozen=True)
class Finding:
    """One effect that was found, or examined and rejected."""

    name: str  # a law of the library, or unknown:AXIS
    alternatives: tuple[str, ...]  # at most two: a family has at most three members
    axis: str
    parameters: tuple[Number, ...]
    explained_fraction: float  # of the squared residual that all other effects leave on the fit runs
    false_alarm_probability: float  # over the whole search, given all other effects
    accepted: bool
    reason: str  # why it was accepted or rejected
    regime: str  # where it acts
    experiment: str  # experiment that would distinguish it from its alternatives
    compensable: bool
    strength_percent: float  # rms of its torque over rms of the friction torque, fit runs
    torque_rms_nm: float = 0.0  # of the effect, where the axis moves in the fit runs
    rivals: tuple[Rival, ...] = ()
    picture: Picture | None = None  # the residual over its axis
    law_picture: Picture | None = None  # the figure that its law declares (`Law.figure`)
    gain: tuple[float, float] | None = None  # nats on rows outside the fit, given the others, and its sd
    held_out_gain: tuple[float, float] | None = None  # the same on the held-out runs
    strength_variation: float = 0.0  # coefficient of variation of its strength over the blocks of the fit runs
    # held-out, where the effect acts, without and with it; None where there is too little of that
    regime_before: ErrorFigures | None = None
    regime_after: ErrorFigures | None = None
    doubt: str = ""  # why it may not be what its name says; empty: nothing contradicts it

    @property
    def place(self) -> str:
        """Its place on the machine or in the motion."""
        law = law_of(self.name)
        if self.curve is not None:
            return law.regime
        return law.place_of(law.filled({n.name: n.value for n in self.parameters}))

    @property
    def confidence(self) -> Confidence:
        """Certain where held-out runs confirm it.

        A member of a family that the data do not separate, and a finding in doubt, gives `cannot tell`.
        """
        if self.alternatives or self.doubt:
            return "cannot tell"
        return "certain" if self.is_confirmed else "probable"

    def is_confirmed_by(self, sds: float) -> bool:
        """Whether its gain on held-out runs is positive by more than so many standard deviations."""
        return self.held_out_gain is not None and self.held_out_gain[0] > sds * self.held_out_gain[1]

    @property
    def is_confirmed(self) -> bool:
        """Whether held-out runs confirm it beyond the 95 % intervals, by its gain or by the error where it acts."""
        if self.is_confirmed_by(NORMAL_95):
            return True
        before, after = self.regime_before, self.regime_after
        return before is not None and after is not None and after.torque_rms_nm.high < before.torque_rms_nm.low

    @property
    def is_form(self) -> bool:
        """Whether it is the form of the friction itself rather than an additional effect."""
        return law_of(self.name).form

    @property
    def curve(self) -> CurveModel | None:
        """An effect outside the library, as a curve or a table; None for a named law."""
        if not self.name.startswith(UNKNOWN):
            return None
        return curve_model({n.name: n.value for n in self.parameters}, {n.name: n.sd for n in self.parameters})


@dataclass(frozen=True)
class RunFigure:
    """The residual of one run for a plot: envelope over time before and after, decimated. (n,) each."""

    name: str
    role: Literal["fit", "held_out"]
    time_s: Floats
    before_low_nm: Floats
    before_high_nm: Floats
    after_low_nm: Floats
    after_high_nm: Floats


@dataclass(frozen=True)
class ResidualChannel:
    """Part of the residual that a free curve over one axis explains, before and after."""

    name: str  # the name of an axis, or of an event such as break_away
    explained_before: float  # share of the squared residual
    explained_after: float
    significant_before: bool  # against surrogates of the same search
    significant_after: bool
    samples: int


@dataclass(frozen=True)
class Ceiling:
    """The most that any model could explain, from repeats of a profile. All None where nothing was repeated."""

    repeatable_fraction: float | None  # of the base model's squared residual
    left_repeatable_fraction: float | None  # of the squared residual of the model with its effects
    noise_rms_nm: float | None  # the part that does not repeat
    explained_of_explainable: float | None
    note: str


class Rest(NamedTuple):
    """The part of the residual that could still be explained."""

    rms_nm: float
    floor_nm: float  # residual of a black box on the same rows, or the part that does not repeat
    repeats_share: float | None  # repeatable share of the squared residual; None: nothing was repeated
    axes: tuple[str, ...]
    sentence: str

    @property
    def share(self) -> float:
        """Share of the squared residual that could still be explained."""
        return share_above(self.floor_nm, self.rms_nm)


def share_above(floor_nm: float, rms_nm: float) -> float:
    """Share of a squared rms that is above its floor."""
    return 1.0 - (floor_nm / rms_nm) ** 2


@dataclass(frozen=True)
class Diagnosis:
    """Everything that the page and the report contain."""

    verdict: VerdictWord
    headline: str
    findings: tuple[Finding, ...]  # accepted ones first, by explained share
    before: ErrorFigures | None  # held-out; None without held-out runs
    after: ErrorFigures | None
    fit_before: ErrorFigures
    fit_after: ErrorFigures
    ceiling: Ceiling
    channels: tuple[ResidualChannel, ...]
    runs: tuple[RunFigure, ...]
    model_before: ModelFile
    model_after: ModelFile | None  # None: no finding carries over
    false_alarm_rate: float  # of the whole search; the thresholds are set for it
    units: Literal["rotary", "linear"]
    unexplained_rest: Rest | None = None
    runs_look: RunsLook | None = None
    first_p: float = 1.0  # smallest p-value of the first free round
    cautions: tuple[str, ...] = ()
    tried: tuple[dict[str, Any], ...] = ()  # every law with its best shape and score in the first search
    settings: dict[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    fit_names: tuple[str, ...] = ()
    held_out_names: tuple[str, ...] = ()
    prior: AgainstPopulation | None = None  # what the base model began from beside the runs


def in_words_of_axis(diagnosis: Diagnosis) -> Diagnosis:
    """Its sentences in the words of the axis: for a linear axis forces, a mass and metres."""
    if diagnosis.units == "rotary":
        return diagnosis

    def said(text: str) -> str:
        return text_on(text, linear=True)

    look, rest = diagnosis.runs_look, diagnosis.unexplained_rest
    return replace(
        diagnosis,
        headline=said(diagnosis.headline),
        cautions=tuple(map(said, diagnosis.cautions)),
        unexplained_rest=None if rest is None else rest._replace(sentence=said(rest.sentence)),
        runs_look=None if look is None else look._replace(
            remarks=tuple(remark._replace(text=said(remark.text)) for remark in look.remarks)
        ),
        findings=tuple(
            replace(
                one, reason=said(_named_on_linear(one.name, one.reason)), regime=said(one.regime),
                experiment=said(one.experiment), doubt=said(one.doubt),
            )
            for one in diagnosis.findings
        ),
    )  # fmt: skip


def _named_on_linear(effect: str, reason: str) -> str:
    """A reason that names parameters of its law, with their names on a linear axis."""
    for p in law_of(effect).parameters:
        reason = re.sub(rf"\b{p.name}\b", name_on(p.name, p.unit, linear=True), reason)
    return reason


def figures_json(figures: ErrorFigures | None) -> dict[str, Any] | None:
    """The numbers of part 7 and their intervals."""
    if figures is None:
        return None
    keys = ("torque_rms_nm", "torque_relative_percent", "velocity_rms_rps")
    return {
        **{key: getattr(figures, key).value for key in keys},
        "interval_95": {key: list(getattr(figures, key)[1:]) for key in keys},
        "seconds": figures.seconds,
    }


def report(diagnosis: Diagnosis) -> dict[str, Any]:
    """The report: stable keys first, then the evidence."""
    linear = diagnosis.units == "linear"
    return {
        "format": formats.DIAGNOSIS.word,
        "tool": f"fffo-drive {__version__}",
        "verdict": diagnosis.verdict,
        "headline": diagnosis.headline,
        "effects": [_effect(f, linear) for f in diagnosis.findings if not (f.accepted and f.is_form)],
        "friction_form": [_effect(f, linear) for f in diagnosis.findings if f.accepted and f.is_form],
        "before": {"held_out": figures_json(diagnosis.before), "fit": figures_json(diagnosis.fit_before)},
        "after": {"held_out": figures_json(diagnosis.after), "fit": figures_json(diagnosis.fit_after)},
        "unexplained_rest": None if diagnosis.unexplained_rest is None else diagnosis.unexplained_rest._asdict(),
        "runs_look": _runs(diagnosis.runs_look),
        "first_p": diagnosis.first_p,
        "ceiling": vars(diagnosis.ceiling),
        "units": diagnosis.units,
        "false_alarm_rate": diagnosis.false_alarm_rate,
        "runs": {"fit": list(diagnosis.fit_names), "held_out": list(diagnosis.held_out_names)},
        "channels": [vars(channel) for channel in diagnosis.channels],
        "tried": list(diagnosis.tried),
        "cautions": list(diagnosis.cautions),
        "settings": diagnosis.settings,
        "prior": None if diagnosis.prior is None else diagnosis.prior.as_plain(),
        "seconds": diagnosis.seconds,
    }


def _runs(look: RunsLook | None) -> dict[str, Any] | None:
    if look is None:
        return None
    return {
        "remarks": [remark._asdict() for remark in look.remarks],
        "runs": [
            {"name": run.name, "turns_one_way": run.turns_one_way,
             "estimates": {name: one._asdict() for name, one in run.estimates.items()}}
            for run in look.runs
        ],
    }  # fmt: skip


def _effect(finding: Finding, linear: bool) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for number in finding.parameters:
        if number.per_run is None:
            values[number.name] = number.value
        else:
            values.setdefault(number.name, {})[number.per_run] = number.value
    curve = finding.curve
    if curve is not None:
        curve = curve.model_copy(update={"unit": unit_on(curve.unit, linear)})
    return {
        "name": finding.name,
        "alternatives": list(finding.alternatives),
        "axis": finding.axis,
        "parameters": values if curve is None else {},
        **({} if curve is None else {"curve": curve.model_dump(mode="json")}),
        "explained_fraction": finding.explained_fraction,
        "false_alarm_probability": finding.false_alarm_probability,
        "accepted": finding.accepted,
        "reason": finding.reason,
        "regime": finding.regime,
        "experiment": finding.experiment,
        "compensable": finding.compensable,
        "strength_percent": finding.strength_percent,
        "torque_rms_nm": finding.torque_rms_nm,
        "plain_name": text_on(law_of(finding.name).plain_name, linear),
        "cause": text_on(law_of(finding.name).cause, linear),
        "remedy": text_on(law_of(finding.name).remedy, linear),
        "place": text_on(finding.place, linear),
        "confidence": finding.confidence,
        "doubt": finding.doubt,
        "sd": {n.name: n.sd for n in finding.parameters if n.per_run is None and curve is None},
        "units": {n.name: unit_on(n.unit, linear) for n in finding.parameters if curve is None},
        "symbols": {n.name: name_on(n.name, n.unit, linear) for n in finding.parameters if curve is None},
        "gain": finding.gain,
        "held_out_gain": finding.held_out_gain,
        "strength_variation": finding.strength_variation,
        "rivals": [vars(rival) for rival in finding.rivals],
        "before": {"held_out_regime": figures_json(finding.regime_before)},
        "after": {"held_out_regime": figures_json(finding.regime_after)},
    }
