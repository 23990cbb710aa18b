"""What a diagnosis says: findings with their evidence, errors before and after, and the report of part 7 as plain data.

For a linear axis revolutions stand for m, rps for m/s and Nm for N in all names; the report's `units` says so. What
people read (sentences, units, `symbols`) has the words of the axis.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from .. import __version__, formats
from ..documents import Confidence
from ..identification.population import AgainstPopulation
from ..identification.runs import RunsLook
from ..model.effects.laws.lookup import UNKNOWN, CurveModel, curve_model
from ..model.effects.registry import law_of
from ..model.parameters import ModelFile
from ..units import name_on, text_on, unit_on

Floats = npt.NDArray[np.float64]

NORMAL_95 = 1.96
VerdictWord = Literal["effects_found", "no_effect_found", "unexplained", "nothing_carries_over"]


class Interval(NamedTuple):
    """A number with its 95 % interval, from whole windows that are drawn again."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class ErrorFigures:
    """How wrong a model is on a set of runs."""

    torque_rms_nm: Interval
    torque_relative_percent: Interval  # of the torque that the axis needs, by the first rungs of the ladder
    velocity_rms_rps: Interval  # of free simulation over short windows
    seconds: float  # of motion that counted


@dataclass(frozen=True)
class Number:
    """One parameter of a finding."""

    name: str
    value: float
    sd: float | None  # None: at a bound, or not fitted
    unit: str
    per_run: str | None = None  # name of the run that it belongs to


@dataclass(frozen=True)
class FoundCurve:
    """A line or a cloud of binned means of a picture, (n,) each."""

    label: str
    x: Floats
    y: Floats
    low: Floats | None = None  # 95 % interval of y
    high: Floats | None = None
    kind: Literal["points", "line"] = "points"


class PictureMark(NamedTuple):
    """A place on the abscissa that has a name."""

    x: float
    label: str


@dataclass(frozen=True)
class Picture:
    """A plot that convinces: residual torque over the axis on which the effect lives, or what its law asks for."""

    title: str
    x_label: str
    x_unit: str
    y_label: str
    y_unit: str
    curves: tuple[FoundCurve, ...]
    note: str = ""
    marks: tuple[PictureMark, ...] = ()
    says: str = "What is left without and with it: means with 95 % intervals."


@dataclass(frozen=True)
class Rival:
    """Another effect that was refitted in the place of a finding."""

    name: str
    loss_ratio: float  # its loss over that of the finding, all parameters refitted: above 1 is worse
    collinearity: float  # with the finding's torque, base sensitivities projected out: 0 to 1
    same_family: bool  # the data do not tell it from the finding


@dataclass(frozen=True)
class Finding:
    """One effect that was found, or looked at closely and not accepted."""

    name: str  # of the library, or unknown:AXIS
    alternatives: tuple[str, ...]  # at most two: with the name a family of at most three
    axis: str
    parameters: tuple[Number, ...]
    explained_fraction: float  # of the squared residual of the fit runs that all other effects leave
    false_alarm_probability: float  # over the whole search, given all other effects
    accepted: bool
    reason: str  # why it was accepted, or not
    regime: str  # where it acts
    experiment: str  # what would tell it from its alternatives
    compensable: bool
    strength_percent: float  # rms of its torque over rms of the friction torque, fit runs
    torque_rms_nm: float = 0.0  # of its own, where the axis moves in the fit runs
    rivals: tuple[Rival, ...] = ()
    picture: Picture | None = None  # the residual over its axis
    own_picture: Picture | None = None  # of the kind that its law asks for (`Law.figure`)
    gain: tuple[float, float] | None = None  # nats on rows that the fit did not see, given the others, and its sd
    held_out_gain: tuple[float, float] | None = None  # the same on the held-out runs
    regime_before: ErrorFigures | None = None  # held-out, where the effect acts; None where it hardly does
    regime_after: ErrorFigures | None = None
    doubt: str = ""  # why it may not be what its name says; empty: nothing speaks against it

    @property
    def place(self) -> str:
        """Where on the machine, or in its motion, it is."""
        law = law_of(self.name)
        if self.curve is not None:
            return law.regime
        return law.place_of(law.filled({n.name: n.value for n in self.parameters}))

    @property
    def confidence(self) -> Confidence:
        """Certain where held-out runs show it beyond their intervals: by its gain, or by the error where it acts.

        A member of a family that the data do not separate cannot be told, nor what is in doubt.
        """
        if self.alternatives or self.doubt:
            return "cannot tell"
        shown = False
        if self.held_out_gain is not None:
            value, sd = self.held_out_gain
            shown = value - NORMAL_95 * sd > 0.0
        if self.regime_before is not None and self.regime_after is not None:
            shown = shown or self.regime_after.torque_rms_nm.high < self.regime_before.torque_rms_nm.low
        return "certain" if shown else "probable"

    @property
    def is_form(self) -> bool:
        """Whether it is the form of the friction itself, and no effect beside it."""
        return law_of(self.name).form

    @property
    def curve(self) -> CurveModel | None:
        """What is in no list, as a curve or a table; None for a law with a name."""
        if not self.name.startswith(UNKNOWN):
            return None
        return curve_model({n.name: n.value for n in self.parameters}, {n.name: n.sd for n in self.parameters})


@dataclass(frozen=True)
class RunFigure:
    """The residual of one run for a plot: envelope over time before and after, thinned. (n,) each."""

    name: str
    role: Literal["fit", "held_out"]
    time_s: Floats
    before_low_nm: Floats
    before_high_nm: Floats
    after_low_nm: Floats
    after_high_nm: Floats


@dataclass(frozen=True)
class ResidualChannel:
    """Where the residual lives: what a free curve over one axis explains of it, before and after."""

    name: str  # an axis word, or an event such as break_away
    explained_before: float  # share of the squared residual
    explained_after: float
    significant_before: bool  # against surrogates of the same search
    significant_after: bool
    samples: int


@dataclass(frozen=True)
class Ceiling:
    """What any model could explain: from repeats of a profile. All None where nothing was repeated."""

    repeatable_fraction: float | None  # of the squared residual of the base model that repeats
    left_repeatable_fraction: float | None  # of the squared residual of the model with its effects
    noise_rms_nm: float | None  # what does not repeat
    explained_of_explainable: float | None
    note: str


class Rest(NamedTuple):
    """What is left and could be explained."""

    rms_nm: float
    floor_nm: float  # what a black box leaves on the same rows, or what does not repeat
    repeats_share: float | None  # of the squared residual that repeats; None: nothing was repeated
    axes: tuple[str, ...]
    sentence: str

    @property
    def share(self) -> float:
        """Share of the squared residual that could be explained."""
        return share_above(self.floor_nm, self.rms_nm)


def share_above(floor_nm: float, rms_nm: float) -> float:
    """Share of a squared rms that is above its floor."""
    return 1.0 - (floor_nm / rms_nm) ** 2


@dataclass(frozen=True)
class Diagnosis:
    """Everything that the page and the report are made of."""

    verdict: VerdictWord
    headline: str
    findings: tuple[Finding, ...]  # accepted ones first, in the order of what they explain
    before: ErrorFigures | None  # held-out; None where no held-out run was given
    after: ErrorFigures | None
    fit_before: ErrorFigures
    fit_after: ErrorFigures
    ceiling: Ceiling
    channels: tuple[ResidualChannel, ...]
    runs: tuple[RunFigure, ...]
    model_before: ModelFile
    model_after: ModelFile | None  # None: nothing was found that carries over
    false_alarm_rate: float  # that the thresholds are made for, over the whole search
    units: Literal["rotary", "linear"]
    unexplained_rest: Rest | None = None
    runs_look: RunsLook | None = None
    first_p: float = 1.0  # smallest chance in the first round over everything
    cautions: tuple[str, ...] = ()
    tried: tuple[dict[str, Any], ...] = ()  # every law with its best shape and score in the first search
    settings: dict[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    fit_names: tuple[str, ...] = ()
    held_out_names: tuple[str, ...] = ()
    prior: AgainstPopulation | None = None  # what the base model began from beside the runs


def in_words_of_axis(diagnosis: Diagnosis) -> Diagnosis:
    """Its sentences in the words of its axis: of a linear one forces, a mass and metres."""
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
    """A reason that names parameters of its law, by what they are called on a linear axis."""
    for p in law_of(effect).parameters:
        reason = re.sub(rf"\b{p.name}\b", name_on(p.name, p.unit, linear=True), reason)
    return reason


def figures_json(figures: ErrorFigures | None) -> dict[str, Any] | None:
    """The numbers of part 7, and their intervals beside them."""
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
        "rivals": [vars(rival) for rival in finding.rivals],
        "before": {"held_out_regime": figures_json(finding.regime_before)},
        "after": {"held_out_regime": figures_json(finding.regime_after)},
    }
