"""The diagnosis of an axis: base fit, search, selection, proof, verdict."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .. import __version__
from ..identification.dataset import DataError, Record
from ..identification.facts import DriveFacts
from ..identification.fit import sensor_delay
from ..model.effects.laws.lookup import PLAIN, RESPONSE, UNKNOWN, VISCOUS, across_word
from ..model.effects.registry import axis_of_effect, is_compensable, law_of
from ..model.parameters import EffectModel, FrictionModel, ModelFile, Provenance, Quantity, effect_model
from ..units import inertia_kg_m2, inertia_nm_s2_per_rev
from .base import BASE, NAMES
from .candidates import Effect
from .cautions import cautions
from .finishing import merged_datum, standard_deviations
from .fitting import Data, Fitted, consistent_scenes, loads_of, raw_share
from .paths import Rows, Stretch, make_filter, rows_of, stretches_of
from .pictures import ceiling, picture, run_figures
from .proof import data_of, error_figures, with_own_datum
from .results import Channel, Diagnosis, ErrorFigures, Finding, Number, Rival
from .selection import (
    Search,
    Selection,
    acting_rows,
    effect_rms,
    evidence_of,
    family,
    select,
)
from .startup import fit_base, start_physical
from .tables import with_table
from .where import where

Floats = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

LEAST_LEFT = 0.1  # of the squared residual, for what is left over to be called unexplained
KIND_UNITS = {VISCOUS: "Nm/rps", RESPONSE: "-"}  # of the values of a free curve that is no torque
LEAST_ACTING_S = 2.0  # of held-out motion in an effect's regime, for errors of its own


class DiagnosisSettings(NamedTuple):
    """What a diagnosis goes by."""

    false_alarm_rate: float = 0.01  # over the whole search
    usual_delay_s: float = 0.003  # command to torque, where nothing is declared: the paper's
    delay_tolerance_s: float = 0.0015


def prepared(
    records: Sequence[Record], facts: DriveFacts, model: ModelFile | None
) -> tuple[list[Stretch], Rows, Floats]:
    """Stretches, rows, and base parameters to start from."""
    if not records:
        raise DataError("no runs to fit: at least one is needed")
    stretches = stretches_of(records)
    if not stretches:
        raise DataError("no run has a stretch of two seconds without a gap")
    rows = rows_of(stretches, make_filter(records[0].period_s))
    start = physical_of(model) if model is not None else start_physical(records, facts, stretches, rows)
    return stretches, rows, start


def physical_of(model: ModelFile) -> Floats:
    """Base parameters of a model file, as the fits have them: the delay without the sensor's share."""
    f = model.friction
    values = {
        "inertia_nm_s2_per_rev": inertia_nm_s2_per_rev(model.inertia_kg_m2.value),
        "delay_s": max(0.0, model.delay_s.value - model.sensor_delay_s.value),
        **{name: getattr(f, name).value for name in NAMES if hasattr(f, name)},
    }
    return np.array([values.get(name, 0.0) for name in NAMES])


def base_figures(
    fit: Sequence[Record], held_out: Sequence[Record], facts: DriveFacts, model: ModelFile | None = None
) -> ErrorFigures:
    """Errors of the base model alone on held-out runs: the `before` of a diagnosis."""
    stretches, rows, start = prepared(fit, facts, model)
    _, base, _ = fit_base(stretches, rows, start, len(fit))
    data = data_of(held_out, base.physical)
    return error_figures(held_out, data, with_own_datum(data, base)[0])


def diagnose(
    fit: Sequence[Record], held_out: Sequence[Record], facts: DriveFacts, model: ModelFile | None = None,
    settings: DiagnosisSettings | None = None, progress: Progress | None = None,
) -> Diagnosis:  # fmt: skip
    """Find what the base model of an axis lacks. Effects are chosen on `fit` alone; `held_out` is for the proof.

    Raises DataError where the runs cannot carry a fit.
    """
    begin = time.monotonic()
    settings = settings or DiagnosisSettings()
    tell = progress or (lambda share, text: None)
    tell(0.0, "base model")
    stretches, rows, start = prepared(fit, facts, model)
    data, base, matrix = fit_base(stretches, rows, start, len(fit))
    tell(0.2, "search")
    search = Search(facts, settings.false_alarm_rate, lambda share, text: tell(0.2 + 0.55 * share, text))
    selected = select(data, base, matrix, search)
    selected = with_table(selected, settings.false_alarm_rate, lambda share: tell(0.75 + 0.1 * share, "pairs of axes"))
    fitted = merged_datum(selected.data, selected.sensitivities, selected.fitted)
    selected = selected._replace(fitted=fitted)
    tell(0.85, "proof")
    found = assemble(fit, held_out, facts, selected, settings)
    tell(1.0, "done")
    return replace(found, seconds=time.monotonic() - begin)


def assemble(
    fit: Sequence[Record], held_out: Sequence[Record], facts: DriveFacts, selected: Selection,
    settings: DiagnosisSettings,
) -> Diagnosis:  # fmt: skip
    """Everything that is said about a selection."""
    data, base, fitted = selected.data, selected.base, selected.fitted
    base_sd, effect_sd = standard_deviations(data, selected.sensitivities, fitted)
    proof = _Proof(held_out, base, fitted)
    probabilities = [*selected.probabilities, *[1.0] * len(fitted.effects)]
    findings = [
        _finding(facts, selected, number, probabilities[number], effect_sd, proof, settings)
        for number in range(len(fitted.effects))
    ]
    findings = delay_finding(fitted, facts, settings) + findings
    findings.sort(key=lambda f: (not f.accepted, -f.explained_fraction))
    left = evidence_of(data, selected.sensitivities, fitted)[0]
    evidence, scenes = evidence_of(data, selected.sensitivities, base)
    lives = where((evidence, left), scenes, settings.false_alarm_rate)
    verdict, headline = _verdict(findings, selected, lives.beyond, settings)
    accepted = [f for f in findings if f.accepted]
    energies = tuple(float(s.trials[0].explained) if s.trials else 0.0 for s in selected.screenings)
    return Diagnosis(
        verdict=verdict,
        headline=headline,
        findings=tuple(findings),
        before=proof.before,
        after=proof.after,
        fit_before=error_figures(fit, data, base, velocity=False),
        fit_after=error_figures(fit, data, fitted, velocity=False),
        ceiling=ceiling(data, base, fitted),
        channels=(*lives.axes, *lives.beyond),
        runs=(
            *run_figures(data, base, fitted, "fit"),
            *(run_figures(proof.data, proof.base, proof.fitted, "held_out") if proof.data is not None else ()),
        ),
        model_before=model_file(fit, facts, base, (), base_sd, {}, ()),
        model_after=model_file(fit, facts, fitted, fitted.effects, base_sd, effect_sd, accepted),
        false_alarm_rate=settings.false_alarm_rate,
        units=facts.units,
        cautions=tuple(cautions(selected, facts, (proof.before, proof.after))),
        tried=tuple(_tried(selected)),
        settings={**settings._asdict(), "first_search_best": list(energies)},
        fit_names=tuple(r.name for r in fit),
        held_out_names=tuple(r.name for r in held_out),
    )  # fmt: skip


class _Proof:
    """Held-out errors, before and after; None where nothing was held out."""

    def __init__(self, records: Sequence[Record], base: Fitted, fitted: Fitted) -> None:
        self.records = records
        self.data: Data | None = None
        self.before: ErrorFigures | None = None
        self.after: ErrorFigures | None = None
        if not records:
            return
        self.data = data_of(records, fitted.physical)
        self.base, _ = with_own_datum(data_of(records, base.physical), base)
        self.fitted, self.scored = with_own_datum(self.data, fitted)
        self.before = error_figures(records, self.data, self.base, self.scored)
        self.after = error_figures(records, self.data, self.fitted, self.scored) if fitted.effects else self.before

    def regime(self, number: int) -> tuple[ErrorFigures | None, ErrorFigures | None]:
        """Errors before and after where one effect acts."""
        if self.data is None:
            return None, None
        scenes = consistent_scenes(self.data, self.fitted.physical, self.fitted.effects)
        loads = loads_of(scenes, [self.fitted.effects[number]])
        load = np.concatenate([self.data.rows.laws.rows(x) for x in loads])
        acting = acting_rows(load, self.data.rows.kept) & self.scored
        if acting.sum() * self.data.rows.filter.row_period_s < LEAST_ACTING_S:
            return None, None
        return (
            error_figures(self.records, self.data, self.base, acting, velocity=False),
            error_figures(self.records, self.data, self.fitted, acting, velocity=False),
        )


def _finding(
    facts: DriveFacts, selected: Selection, number: int, probability: float,
    effect_sd: dict[tuple[int, str, int], float], proof: _Proof, settings: DiagnosisSettings,
) -> Finding:  # fmt: skip
    effect = selected.fitted.effects[number]
    contest = selected.contests[number]
    law = law_of(effect.name)
    whole = max(sum(c.gains[c.chosen] for c in selected.contests), 1e-300)
    gone = max(0.0, raw_share(selected.data, selected.base, selected.fitted))
    explained = gone * contest.gains[contest.chosen] / whole
    strength, _ = effect_rms(selected.data, selected.fitted, number)
    accepted = probability <= settings.false_alarm_rate
    others = family(contest)
    best = contest.gains[contest.chosen]
    rivals = tuple(
        Rival(
            name,
            float(best / max(gain, 1e-9)) if gain > 0.0 else float("inf"),
            min(1.0, max(0.0, gain / best)),
            name in others,
        )
        for name, gain in sorted(contest.gains.items(), key=lambda item: -item[1])
        if name != contest.chosen
    )
    before, after = proof.regime(number)
    reason = (
        f"takes away {100.0 * explained:.1f} % of the squared residual of the fit runs with every parameter refitted; "
        f"noise alone would do as well in a search like this with probability {probability:.2g}"
    )
    across = across_word(effect.shapes)
    if across:
        reason += f"; a table over {axis_of_effect(effect.name)} and {across}"
    if accepted and proof.data is not None and before is None:
        reason += "; the held-out runs hardly excite it: it rests on the fit runs"
    return Finding(
        name=effect.name,
        alternatives=tuple(others),
        axis=axis_of_effect(effect.name),
        parameters=tuple(_numbers(effect, number, effect_sd, selected.data)),
        explained_fraction=explained,
        false_alarm_probability=probability,
        accepted=accepted,
        reason=reason,
        regime=law.regime,
        experiment=law.experiment,
        compensable=is_compensable(effect.name, effect.values(0)) and not effect.per_run,
        strength_percent=strength,
        rivals=rivals,
        picture=picture(selected.data, selected.base, selected.fitted, number, None),
        regime_before=before,
        regime_after=after,
    )


def _numbers(effect: Effect, number: int, sd: dict[tuple[int, str, int], float], data: Data) -> list[Number]:
    law = law_of(effect.name)
    names = {s.stretch_run: s.name for s in _runs(data)}
    found = []
    for p in law.parameters:
        if p.name in effect.strengths:
            values = effect.strengths[p.name]
            for run, value in enumerate(values):
                key = run if p.name in effect.per_run else -1
                own = names.get(run) if p.name in effect.per_run else None
                unit = KIND_UNITS.get(effect.shapes.get("kind", PLAIN), p.unit)
                found.append(Number(p.name, float(value), sd.get((number, p.name, key)), unit, own))
        elif p.name in effect.shapes:
            found.append(Number(p.name, float(effect.shapes[p.name]), sd.get((number, p.name, -1)), p.unit))
    return found


class _Run(NamedTuple):
    stretch_run: int
    name: str


def _runs(data: Data) -> list[_Run]:
    return [_Run(s.run, s.name) for s in data.stretches]


def delay_finding(fitted: Fitted, facts: DriveFacts, settings: DiagnosisSettings) -> list[Finding]:
    """A delay beyond what is expected: no residual shows it, as Td is fitted; the fitted Td does."""
    delay_s = float(fitted.physical[NAMES.index("delay_s")])
    declared = facts.nominal_delay_s is not None
    nominal_s = settings.usual_delay_s if facts.nominal_delay_s is None else facts.nominal_delay_s
    excess_s = delay_s - nominal_s
    taken = {e.name for e in fitted.effects}
    if facts.units != "rotary" or excess_s < settings.delay_tolerance_s or taken & {"delay", "current_lag"}:
        return []
    law = law_of("delay")
    return [
        Finding(
            name="delay", alternatives=("current_lag",), axis=law.axis,
            parameters=(Number("delay_s", excess_s, None, "s"),), explained_fraction=0.0,
            false_alarm_probability=0.0, accepted=True,
            reason=f"the fitted delay is {1e3 * delay_s:.2f} ms, {1e3 * nominal_s:.2f} ms are "
            + ("declared" if declared else "usual (nominal_delay_s of the drive file declares another)")
            + "; the base model has it already, so that no residual is left of it",
            regime=law.regime, experiment=law.experiment, compensable=False, strength_percent=0.0,
        )
    ]  # fmt: skip


def _verdict(
    findings: Sequence[Finding], selected: Selection, places: Sequence[Channel], settings: DiagnosisSettings
) -> tuple[Any, str]:
    accepted = [f for f in findings if f.accepted]
    left = selected.left
    if accepted:
        names = ", ".join(f.name + (f" (or {' or '.join(f.alternatives)})" if f.alternatives else "") for f in accepted)
        return "effects_found", f"The model lacks: {names}"
    if left is not None and left[1] >= LEAST_LEFT and left[2] <= settings.false_alarm_rate:
        return "unexplained", "Something is left that these data cannot explain"
    rare = [c for c in places if c.significant_after and c.explained_after >= LEAST_LEFT]
    if rare:
        most = max(rare, key=lambda c: c.explained_after)
        return "unexplained", f"Something is left that no law and no curve over one axis explains: look at {most.name}"
    return "no_effect_found", "Nothing significant and material is left over: no effect found"


def _tried(selected: Selection) -> list[dict[str, Any]]:
    if not selected.screenings:
        return []
    energy = selected.base.loss * selected.base.white.size
    first = [*selected.screenings[0].trials, *selected.curves]
    return [
        {"name": t.name, "shape": {k: v for k, v in t.shapes.items() if not t.name.startswith(UNKNOWN)},
         "explained_fraction": t.explained / max(energy, 1e-300), "rank": t.rank}
        for t in first
    ]  # fmt: skip


def model_file(
    records: Sequence[Record], facts: DriveFacts, fitted: Fitted, effects: Sequence[Effect], base_sd: Floats,
    effect_sd: dict[tuple[int, str, int], float], accepted: Sequence[Finding],
) -> ModelFile:  # fmt: skip
    """A model as the controller runs it, with the accepted effects."""
    value = {name: float(fitted.physical[k]) for k, name in enumerate(NAMES)}
    sd = {name: float(base_sd[k]) for k, name in enumerate(BASE)}
    logs = {name: value[name] for name in BASE}

    def quantity(name: str, factor: float = 1.0) -> Quantity:
        spread = sd[name] * (1.0 if name in ("delay_s", "stribeck_exponent", "sensor_lag_s2") else logs[name])
        return Quantity(value=value[name] * factor, sd=spread * factor, source="fitted")

    sensor_s, sensor_sd_s = sensor_delay(records)
    sensor_s = max(0.0, sensor_s or 0.0)
    friction = FrictionModel(
        stribeck="classical", omega="clipped",
        **{name: quantity(name) for name in BASE if name not in ("inertia_nm_s2_per_rev", "delay_s", "sensor_lag_s2")},
    )  # fmt: skip
    names = {f.name: f for f in accepted}
    return ModelFile(
        name="diagnosed",
        torque_constant_nm_per_a=facts.torque_constant_nm_per_a,
        inertia_kg_m2=quantity("inertia_nm_s2_per_rev", inertia_kg_m2(1.0)),
        delay_s=Quantity(value=value["delay_s"] + sensor_s, sd=sd["delay_s"], source="fitted, and the sensor's"),
        sensor_delay_s=Quantity(value=sensor_s, sd=sensor_sd_s, source="lag of the drive's velocity"),
        friction=friction,
        effects=[
            _effect_model(effect, number, effect_sd, names[effect.name])
            for number, effect in enumerate(effects)
            if effect.name in names
        ],
        provenance=Provenance(
            date=time.strftime("%Y-%m-%d"), tool=f"fffo-drive {__version__} diagnose", runs=[r.digest for r in records]
        ),
    )


def _effect_model(effect: Effect, number: int, sd: dict[tuple[int, str, int], float], finding: Finding) -> EffectModel:
    values = effect.values(0)
    spread = {key: sd.get((number, key, 0 if key in effect.per_run else -1)) for key in values}
    return effect_model(
        effect.name, values, spread, datum="run" if effect.per_run else "absolute",
        alternatives=finding.alternatives, provenance=finding.reason,
    )  # fmt: skip
