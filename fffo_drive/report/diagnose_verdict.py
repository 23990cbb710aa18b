"""The opening of a diagnosis page: what the axis has, where, how big, how sure, and what to do about it."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence

from ..diagnosis.results import Diagnosis, Finding, Rest
from ..directories import as_typed
from ..model.effects.registry import law_of
from .cause_words import in_words, sized
from .diagnose_figures import DiagnosisWords, words_of
from .document import Confidence, Line, Verdict, significant

SHOWN_NAMES = 3  # of further effects in the headline
SHOWN_CAUSES = 3  # with a sentence each


def diagnosis_verdict(diagnosis: Diagnosis, model_path: str) -> Verdict:
    """The opening of the page. `model_path`: of the updated model file; empty where none was written."""
    accepted = [finding for finding in diagnosis.findings if finding.accepted]
    effects = [finding for finding in accepted if not (finding.is_form or finding.doubt)]
    words = words_of(diagnosis)
    cautions = [*doubts(diagnosis), *diagnosis.cautions]
    if diagnosis.before is None:
        cautions.append("No run was held out: the errors are those of the fitted runs.")
    reasons = [_reason(finding, words) for finding in accepted]
    rate = 100.0 * diagnosis.false_alarm_rate
    reasons.append(f"In a drive without effects, a search like this finds something in {rate:g} % of all cases.")
    reasons += _repeated(diagnosis) if accepted else []
    if not model_path and diagnosis.model_after is None:
        reasons.append("No model was written: the model in service is unchanged.")
    if diagnosis.verdict == "nothing_carries_over" or _not_finite(diagnosis):
        opening = _nothing_carries_over(diagnosis)
    elif diagnosis.verdict == "effects_found" and effects:
        opening = _effects_found(diagnosis, effects, model_path, words)
    else:
        opening = _no_effect(diagnosis, words)
    return opening.model_copy(update={"reasons": reasons, "cautions": cautions})


def _nothing_carries_over(diagnosis: Diagnosis) -> Verdict:
    return Verdict(
        headline=diagnosis.headline,
        finding="nothing confirmed",
        confidence="cannot tell",
        next_step="keep the model in service",
        alarm=True,
        lines=[
            Line(
                label="How sure",
                text="What was found on the fitted runs does not lower the error of the held-out runs.",
            ),
            Line(
                label="Next",
                text="Keep the model in service. Record runs that are alike in load, temperature and drive settings, "
                "and diagnose them again.",
            ),
        ],
    )


def _effects_found(diagnosis: Diagnosis, effects: Sequence[Finding], model_path: str, words: DiagnosisWords) -> Verdict:
    """How much is explained, then each effect that the held-out runs show in a sentence, what is left, what to do."""
    effects = lead_first(effects)
    shown = [finding for finding in effects if not unproven(finding)] or effects
    lead = shown[0]
    others = [name for name in dict.fromkeys(plain_name(one) for one in shown[1:]) if name != plain_name(lead)]
    more = f", and {names_of(others[:SHOWN_NAMES])}" if others else ""
    more += f" and {len(others) - SHOWN_NAMES} more" if len(others) > SHOWN_NAMES else ""
    law = law_of(lead.name)
    # only a law with a name has a usual cause
    cause = "" if law.name == "lookup" or lead.alternatives else f" Usually: {law.cause}."
    step, next_line = _next(lead, model_path, held_out=diagnosis.before is not None)
    return Verdict(
        headline=words.text(f"The model lacks: {plain_name(lead)}{more}.{cause}"),
        finding=f"{len(shown)} effects" if len(shown) > 1 else words.text(plain_name(lead)),
        confidence=_confidence(diagnosis, lead),
        next_step=step,
        lines=[
            Line(label="Explained", text=_explained(diagnosis, words)),
            *(
                Line(label=f"Cause {number}" if shown[1:] else "Cause", text=_told(diagnosis, finding, words))
                for number, finding in enumerate(shown[:SHOWN_CAUSES], 1)
            ),
            *_unexplained(diagnosis, words),
            next_line.model_copy(update={"text": words.text(next_line.text)}),
        ],
    )


def _told(diagnosis: Diagnosis, finding: Finding, words: DiagnosisWords) -> str:
    """One cause: what it does and how much, and how sure that is."""
    said = in_words(finding, diagnosis.model_after or diagnosis.model_before, words)
    return f"{_capital(said)}. {_surety(diagnosis, finding, words)}"


def _confidence(diagnosis: Diagnosis, lead: Finding) -> Confidence:
    """Of the first finding; never certain where a held-out error rose with what was found."""
    rose = any(after > before for _, before, after in _held_out_errors(diagnosis))
    return "probable" if rose and lead.confidence == "certain" else lead.confidence


def plain_name(finding: Finding) -> str:
    """The plain name; of a family that the data do not separate, all members."""
    names = [law_of(name).plain_name for name in (finding.name, *finding.alternatives)]
    own = [f"{name} (over the {finding.axis.replace('_', ' ')})" if k == 0 and finding.curve is not None else name
           for k, name in enumerate(names)]  # fmt: skip
    return " or ".join(dict.fromkeys(own))


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _explained(diagnosis: Diagnosis, words: DiagnosisWords) -> str:
    """By how much all that was found lowers the error."""
    pair = [one for one in (diagnosis.before, diagnosis.after) if one is not None]
    where = "held-out" if len(pair) == 2 else "fitted"
    if where == "fitted":
        pair = [diagnosis.fit_before, diagnosis.fit_after]
    before, after = (one.torque_relative_percent.value for one in pair)
    old, new = significant(before, 2), significant(after, 2)
    change = f"is {old} %" if old == new else f"{'rises' if after > before else 'falls'} from {old} to {new} %"
    return f"The model's error on the {where} runs {change} of the {words.torque} that the axis needs."


def _unexplained(diagnosis: Diagnosis, words: DiagnosisWords) -> list[Line]:
    """What is left, where a better model could reduce it; the cautions have the full sentence."""
    rest = diagnosis.unexplained_rest
    if rest is None:
        return []
    left, floor = (sized(value, words.torque_unit) for value in (rest.rms_nm, rest.floor_nm))
    over = f"; it depends on {names_of([words.axis(axis) for axis in rest.axes])}" if rest.axes else ""
    return [Line(label="Unexplained", text=f"{left} rms, which a better model could reduce to {floor}{over}.")]


def _surety(diagnosis: Diagnosis, finding: Finding, words: DiagnosisWords) -> str:
    chance = f"p = {significant(finding.false_alarm_probability, 2)}"
    if finding.alternatives:
        family = (finding.name, *finding.alternatives)
        members = " and ".join(dict.fromkeys(words.text(law_of(name).plain_name) for name in family))
        return f"There is an effect ({chance}), but these runs do not separate {members}."
    if finding.held_out_gain is None:
        return f"Probable ({chance}): no run was held out to confirm it."
    if _confidence(diagnosis, finding) == "certain":
        return f"Certain ({chance}): held-out runs confirm it."
    return f"Probable ({chance}): the held-out runs do not confirm it clearly."


def _next(lead: Finding, model_path: str, held_out: bool) -> tuple[str, Line]:
    law = law_of(lead.name)
    if lead.alternatives:
        return "decide between them", Line(
            label="Next", text=f"A run that decides: {lead.experiment}.",
            command=f"fffo-drive run AXIS.yaml --decide {lead.name}",
        )  # fmt: skip
    remedy = f"{_capital(law.remedy)}."
    if lead.compensable and not held_out:  # `adopt` would refuse the model
        return "hold a run out", Line(
            label="Next", text=f"{remedy} To adopt the model, diagnose again with a run held out (--held-out)."
        )
    if lead.compensable and model_path:
        return "adopt it", Line(
            label="Next", text=remedy, command=f"fffo-drive adopt {shlex.quote(as_typed(model_path))} --axis AXIS.yaml"
        )
    return "fix it on the machine" if not lead.compensable else "look at it", Line(label="Next", text=remedy)


def _no_effect(diagnosis: Diagnosis, words: DiagnosisWords) -> Verdict:
    """No named effect: a form of the friction, nothing at all, or an unexplained residual."""
    size = Line(label="Explained", text=_explained(diagnosis, words))
    if diagnosis.verdict == "unexplained":
        return Verdict(
            headline=diagnosis.headline,
            finding="not explained",
            confidence="cannot tell",
            next_step="record more",
            lines=[
                size,
                *_unexplained(diagnosis, words),
                Line(label="How sure", text="There is a residual that none of the searched effects explains."),
                Line(
                    label="Next",
                    text="See below what the residual depends on; a recording with slow, fast and reversing motion "
                    "separates more.",
                ),
            ],
        )
    confidence: Confidence = "probable" if diagnosis.before is None else "certain"
    step = "nothing to do" if diagnosis.before is not None else "hold a run out"
    text = "Nothing to do." if diagnosis.before is not None else "Diagnose again with a run held out (--held-out)."
    sure = "Effects that are smaller than these runs can show are not excluded."
    return Verdict(
        headline=diagnosis.headline,
        finding="nothing missing",
        confidence=confidence,
        next_step=step,
        lines=[size, Line(label="How sure", text=sure), Line(label="Next", text=text)],
    )


def _repeated(diagnosis: Diagnosis) -> list[str]:
    """What repetitions of a reference show, a sentence each."""
    found, ceiling = [], diagnosis.ceiling
    if ceiling.explained_of_explainable is not None:
        share = 100.0 * ceiling.explained_of_explainable
        found.append(f"The model explains {share:.0f} % of what any model could explain ({ceiling.note}).")
    if ceiling.left_repeatable_fraction is not None:
        share = 100.0 * ceiling.left_repeatable_fraction
        found.append(f"{share:.0f} % of the remaining squared residual repeats with the reference.")
    return found


def doubts(diagnosis: Diagnosis) -> list[str]:
    """Cautions about a diagnosis, a sentence each: held-out errors that rose, unexplained residual."""
    found = []
    words = words_of(diagnosis)
    for what, before, after in _held_out_errors(diagnosis):
        if not math.isfinite(after):
            found.append(f"The held-out error in {what} is not finite: the model cannot be used for it.")
        elif after > before:
            found.append(f"The held-out error in {what} rose from {before:.3g} to {after:.3g} {words.unit_of(what)}.")
    if diagnosis.unexplained_rest is not None:
        found.append(_rest(diagnosis.unexplained_rest, words))
    return found


def _held_out_errors(diagnosis: Diagnosis) -> list[tuple[str, float, float]]:
    """(quantity, before, after) of the held-out runs, in the units of the page."""
    before, after = diagnosis.before, diagnosis.after
    if before is None or after is None:
        return []
    words = words_of(diagnosis)
    quantities = (
        (words.torque, words.torque_scale, before.torque_rms_nm, after.torque_rms_nm),
        ("velocity", words.speed_scale, before.velocity_rms_rps, after.velocity_rms_rps),
    )
    return [(what, scale * old.value, scale * new.value) for what, scale, old, new in quantities]


def _not_finite(diagnosis: Diagnosis) -> bool:
    return not all(math.isfinite(after) for _, _, after in _held_out_errors(diagnosis))


def _rest(rest: Rest, words: DiagnosisWords) -> str:
    left, floor = (f"{words.torque_scale * value:.3g}" for value in (rest.rms_nm, rest.floor_nm))
    text = (
        f"Not explained: {left} {words.small_torque} rms remain on the fitted runs; a black-box model of the same rows "
        f"would leave {floor}, or that much does not repeat or does not follow from its own past"
    )
    if rest.repeats_share is not None:
        text += f"; {100.0 * rest.repeats_share:.0f} % of the squared residual repeats"
    if rest.axes:
        text += f"; it depends on {names_of([words.axis(axis) for axis in rest.axes])}"
    return text + "."


def _reason(finding: Finding, words: DiagnosisWords) -> str:
    family = f", or {names_of(finding.alternatives)}: the data do not decide" if finding.alternatives else ""
    share = 100.0 * finding.explained_fraction
    chance = significant(finding.false_alarm_probability, 2)
    law = law_of(finding.name)
    meaning = "" if law.name == "lookup" else words.text(f" It is: {law.meaning}.")
    return (
        f"{finding.name}{family}.{meaning} It explains {share:.0f} % of the squared residual that the other "
        "effects leave; "
        f"noise and an effect too small to matter would do so with p = {chance}. "
        f"Acts in: {finding.regime}."
        + (" It does not lower the error on the held-out runs." if unproven(finding) else "")
        + (f" Its name is in doubt: {words.text(finding.doubt)}." if finding.doubt else "")
    )


def unproven(finding: Finding) -> bool:
    """The held-out runs excite it and do not show it."""
    return finding.held_out_gain is not None and not finding.held_out_gain[0] > 0.0


def lead_first(findings: Sequence[Finding]) -> list[Finding]:
    """Findings in the order of the headline: effects before those in doubt and forms of friction, proven ones first."""
    return sorted(findings, key=lambda finding: (finding.is_form or bool(finding.doubt), unproven(finding)))


def names_of(names: Sequence[str]) -> str:
    """A list in words: a, b and c."""
    return ", ".join(names[:-1]) + f" and {names[-1]}" if len(names) > 1 else "".join(names)
