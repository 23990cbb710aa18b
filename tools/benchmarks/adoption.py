"""The benefit of adopting an effect: each compensable one on the simulated axis, found in records and fed forward."""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import ROOT, Report, finish, main, parser, passes_of, shown

sys.path.insert(0, str(ROOT / "tests" / "identification"))

from refit import EffectsFit, fit_effects
from rig import PERIOD_S, TABLE_1, record

from fffo_drive.config.axis import AxisFile, build_profile, read_axis
from fffo_drive.config.effects import compensated_terms, effect_problems
from fffo_drive.config.profile_sections import PaperProfile
from fffo_drive.config.session import session_config
from fffo_drive.control.friction_observer import TOGGLE_FEEDFORWARD
from fffo_drive.control.reference import Profile
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig, paper_plant
from fffo_drive.evaluation.metrics import profile_rows, run_metrics
from fffo_drive.identification.coordinates import MODEL_PARAMETERS, PARAMETERS
from fffo_drive.identification.dataset import Record
from fffo_drive.identification.excitation import identification_sequence, separating_recipe
from fffo_drive.identification.layout import EffectStart
from fffo_drive.identification.prediction import Problem, make_problem
from fffo_drive.model.parameters import ModelFile, Quantity, read_model
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime.runs import simulated_ring_rows
from fffo_drive.runtime.session import Session
from fffo_drive.units import inertia_kg_m2

NAME = "adoption"
AXIS = ROOT / "configs" / "axis_simulated.yaml"
PURPOSE = (
    "Each compensable effect, with 30 % of the Coulomb friction, on the simulated axis under PI+FFFO+. An "
    "identification current and the recipe are recorded and the model is refitted without and with the effect "
    "(name and orders given, everything else from the data). The paper's reference is then run with the model of "
    "the axis without the effect (`with it`), with the refit that lacks the effect (`refitted`) and with the "
    "adopted one. Excess: squared velocity error of the shaft above that of the axis without the effect."
)
LEAST_FALL = 0.70
MOST_WORSE_PERCENT = 2.0
SIGNIFICANT = 2.0  # standard errors of the excess over the seeds
LEAST_GIVEN = 0.01  # of the Coulomb friction: less torque counts as none
BANDWIDTH_HZ = 40.0
GEAR_RATIO = 160.0


class Trial(NamedTuple):
    """An effect of the plant, and where the refit of the law begins."""

    plant: tuple[str, Mapping[str, float]]
    start: EffectStart


def _trial(name: str, plant: Mapping[str, float], start: Mapping[str, float]) -> Trial:
    return Trial((name, plant), EffectStart(name, start))


TRIALS = (
    _trial("torque_offset", {"torque_nm": 0.0075}, {}),
    _trial("asymmetric_coulomb", {"share": 0.3}, {}),
    _trial("asymmetric_viscous", {"share": 0.36}, {}),
    _trial("stribeck_shape", {"rise_share": 0.18, "velocity_share": 1.0}, {"speed_rps": 2.0}),
    _trial("presliding_shape", {"stiffness_share": -0.7}, {"length_ratio": 5.0}),
    _trial("frictional_lag", {"length_share": 3.0}, {"length_rev": 0.1}),
    _trial("dwell_stiction", {"rise_share": 0.3}, {"tau_s": 1.0, "release_rev": 0.05}),
    _trial("load_dependent_friction", {"share": 0.05}, {}),
    _trial("position_dependent_friction", {"wave_share": 0.3, "period_rev": 8.0}, {"period_rev": 8.0}),
    _trial("friction_ripple", {"share": 0.3, "order": 2.0}, {"order": 2.0}),
    _trial("coulomb_drift", {"share": 0.3, "time_constant_s": 15.0}, {"tau_s": 25.0}),
    _trial("viscous_drift", {"share": 0.36, "time_constant_s": 15.0}, {"tau_s": 25.0}),
    _trial("quadratic_drag", {"drag_nm_per_rps2": 1.5e-4}, {}),
    _trial("cogging", {"amplitude_nm": 0.0075, "order": 6.0}, {"order": 6.0}),
    _trial("torque_ripple", {"share": 0.05, "order": 6.0}, {"order": 6.0}),
    _trial("unbalance", {"amplitude_nm": 0.0075}, {"ratio": GEAR_RATIO}),
    _trial("torque_saturation", {"share": 1.0}, {"knee_a": 8.0}),
    _trial("dead_zone", {"width_a": 0.05}, {"width_a": 0.08}),
    _trial("current_lag", {"time_constant_s": 0.002}, {"tau_s": 0.003}),
)
SAMPLE = ("cogging", "quadratic_drag")
# what a refit leaves of these is no torque that could be given: not held against the law
LEFT_TO_THE_LOOP = {
    "current_lag": "what a refit leaves of `current_lag` is no torque: with the refitted Td the feed-forward is on "
    "time, but the lag remains in the feedback loop. An axis with 2 ms more of pure delay, known to the model, has "
    "0.000404 rps^2 s more than the axis without it; this lag leaves 0.000153",
}
NOT_COMPENSATED = {
    "delay": "no torque: the refit of Td includes it, and the reference is read ahead by it",
    "elasticity": "a torque on the load side, whose angle is not measured",
    "backlash": "as elasticity; also, the position of the load in the gap is unknown",
    "voltage_limit": "no torque is left: an increase of the command has no effect",
    "resolver_error": "no torque: the measured angle is wrong, and compensating it would move the shaft",
    "periodic_disturbance": "periodic in time, with a different phase in every run",
    "unknown:frequency": "not a function of what is known in advance; a curve over any other axis is compensated where "
    "it was seen",
}


class Kind(NamedTuple):
    """A plant, and the form of the friction that every model of it has beside its parameters."""

    plant: PlantConfig
    form: tuple[EffectStart, ...] = ()


KINDS = {
    "single surface": Kind(paper_plant()),
    "five surfaces": Kind(PlantConfig()),
    "five surfaces, a second one in the model": Kind(PlantConfig(), (EffectStart("second_surface", {}),)),
}


class Outcome(NamedTuple):
    """One effect on one kind of friction, ISE (seeds,) each: without it, and with it under three models."""

    name: str
    clean: np.ndarray[Any, Any]  # axis without the effect, model of that axis
    unaware: np.ndarray[Any, Any]  # axis with the effect, the same model
    before: np.ndarray[Any, Any]  # a model refitted to the axis with the effect, without a word for it
    after: np.ndarray[Any, Any]  # the adopted one
    given: float  # rms of the torque that is given for the effect, over the Coulomb friction
    problems: tuple[str, ...]

    @property
    def significant(self) -> bool:
        """The excess under the unaware model is one, by its spread over the seeds."""
        return _is_excess(self.unaware - self.clean)

    @property
    def left(self) -> bool:
        """A refit of the model's own parameters leaves something to adopt: an excess, and a torque for it."""
        return _is_excess(self.before - self.clean) and self.given > LEAST_GIVEN

    @property
    def fall(self) -> float:
        """Share of the excess under the unaware model that the adoption takes away."""
        return _fall(self.unaware - self.clean, self.after - self.clean)

    @property
    def further_fall(self) -> float:
        """Share of the excess that a refit leaves which the effect takes away."""
        return _fall(self.before - self.clean, self.after - self.clean)

    @property
    def worse_percent(self) -> float:
        """Change of the squared error by the effect, against a refit without it, mean over paired seeds."""
        return 100.0 * float(np.mean(self.after / self.before) - 1.0)


def _is_excess(excess: np.ndarray[Any, Any]) -> bool:
    spread = float(np.std(excess, ddof=1)) if excess.size > 1 else 0.0
    mean = float(np.mean(excess))
    return bool(mean > SIGNIFICANT * spread / np.sqrt(excess.size) and mean > 0.0)


def _fall(before: np.ndarray[Any, Any], after: np.ndarray[Any, Any]) -> float:
    return 1.0 - float(np.mean(after)) / float(np.mean(before))


def axis_file(seed: int, duration_s: float) -> AxisFile:
    """The example on the simulated drive, on another reference."""
    profile = PaperProfile(kind="paper", duration_s=duration_s, seed=seed)
    return read_axis(AXIS).model_copy(update={"profile": profile})


class Driven(NamedTuple):
    """One run over the reference of a seed."""

    ise: float  # of the shaft's velocity
    given: float  # rms of the torque that was given for effects, over the Coulomb friction
    problems: list[str]  # what speaks against the compensation


def driven(plant: PlantConfig, model: ModelFile, seed: int, duration_s: float) -> Driven:
    """Run the reference of a seed."""
    axis = axis_file(seed, duration_s)
    profile: Profile = build_profile(axis.profile, axis.loop.period_s)
    drive = SimulatedDrive(replace(plant, seed=seed))
    drive.connect()
    rows = simulated_ring_rows(profile, axis.loop.tail_s)
    with Session(drive, session_config(axis, model, profile.values.size, rows)) as session:
        session.run_profile(profile, TOGGLE_FEEDFORWARD)
        measured = RingReader(session.ring).read().rows
    metrics = run_metrics(measured, axis.loop.period_s, profile.values.size, "true_velocity_rps")
    given = float(np.sqrt(np.mean(profile_rows(measured, profile.values.size)["effects_nm"] ** 2)))
    share = given / model.friction.coulomb_nm.value
    return Driven(float(metrics.ise), share, effect_problems(axis, model, profile, True))


def records_of(plant: PlantConfig) -> list[Record]:
    """What is recorded for the fit."""
    current = identification_sequence(30.0, PERIOD_S, 0.3, 1.1, 0.05, 10.0)
    recipe = separating_recipe(PERIOD_S, 14.0, 150.0, 1)
    return [record(plant, current, "identify"), record(plant, recipe, "recipe")]


def model_of(fit: EffectsFit, declared: ModelFile) -> ModelFile:
    """The fitted model as the controller runs it; the sensor's delay stays declared."""
    value = dict(zip(PARAMETERS, (float(x) for x in fit.base), strict=True))
    friction = {name: Quantity(value=value[name]) for name in MODEL_PARAMETERS[2:]}
    return declared.model_copy(update={
        "inertia_kg_m2": Quantity(value=inertia_kg_m2(value["inertia_nm_s2_per_rev"])),
        "delay_s": Quantity(value=value["delay_s"] + declared.sensor_delay_s.value),
        "friction": declared.friction.model_copy(update=friction),
        "effects": [effect.model() for effect in fit.effects],
    })  # fmt: skip


def start_of(declared: ModelFile) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The declared model as the start of the fits."""
    axis = declared.axis_config()
    f = axis.friction
    return np.array([
        axis.inertia_nm_s2_per_rev, axis.delay_s - declared.sensor_delay_s.value, f.viscous_nm_per_rps, f.coulomb_nm,
        f.static_nm, f.stribeck_velocity_rps, f.stribeck_exponent, f.stiffness_per_rev, f.attraction_nm_per_rev,
        0.0, 0.0,
    ])  # fmt: skip


def fitted(kind: Kind, declared: ModelFile, start: EffectStart | None) -> tuple[ModelFile, ModelFile]:
    """Models from records of a plant: without the effect, and with it."""
    problem: Problem = make_problem(records_of(kind.plant), BANDWIDTH_HZ)
    base = fit_effects(problem, start_of(declared), [], with_jacobian=False)

    def model(starts: Sequence[EffectStart]) -> ModelFile:
        found = fit_effects(problem, base.base, starts, iterations=20, with_jacobian=False) if starts else base
        return model_of(found, declared)

    without = model(kind.form)
    return without, without if start is None else model((start, *kind.form))


def with_effect(plant: PlantConfig, trial: Trial) -> PlantConfig:
    """The plant with the effect of a trial. Raises PlantConfigError."""
    name, values = trial.plant
    return replace(plant, effects=(EffectConfig(name, dict(values)),)).validate()


def try_effect(trial: Trial, kind: Kind, clean: Clean, seeds: Sequence[int], duration_s: float) -> Outcome:
    """One effect: record, fit, adopt, run."""
    loaded = with_effect(kind.plant, trial)
    refitted, adopted = fitted(kind._replace(plant=loaded), read_model(TABLE_1), trial.start)
    runs = [[driven(loaded, model, seed, duration_s) for seed in seeds] for model in (clean.model, refitted, adopted)]
    problems = {text for run in runs[2] for text in run.problems}
    if not compensated_terms(axis_file(1, duration_s), adopted):
        problems.add("not compensated")
    errors = [np.array([run.ise for run in row]) for row in runs]
    return Outcome(
        trial.plant[0], clean.ise, *errors, float(np.mean([run.given for run in runs[2]])), tuple(sorted(problems))
    )


class Clean(NamedTuple):
    """The axis without an effect."""

    model: ModelFile  # fitted to it
    ise: np.ndarray[Any, Any]  # with that model, (seeds,)


def clean_axis(kind: Kind, seeds: Sequence[int], duration_s: float) -> Clean:
    """Fit a model to the axis without an effect, and run it."""
    model, _ = fitted(kind, read_model(TABLE_1), None)
    return Clean(model, np.array([driven(kind.plant, model, seed, duration_s).ise for seed in seeds]))


class Kept:
    """Rows that were measured already, in a file: a run that is interrupted goes on where it was."""

    def __init__(self, path: Path | None, section: str, again: Sequence[str]) -> None:
        self._path, self._section, self._again = path, section, again
        self._all: dict[str, dict[str, Any]] = json.loads(path.read_text()) if path and path.exists() else {}
        self._rows = self._all.setdefault(section, {})

    def __contains__(self, name: str) -> bool:
        return name in self._rows

    def clean(self, measure: Callable[[], Clean]) -> Clean:
        """The axis without an effect."""
        if "clean" not in self._rows:
            found = measure()
            self._keep("clean", {"model": found.model.model_dump(mode="json"), "ise": found.ise.tolist()})
        row = self._rows["clean"]
        return Clean(ModelFile.model_validate(row["model"]), np.array(row["ise"]))

    def outcome(self, name: str, measure: Callable[[], Outcome]) -> Outcome:
        """The row of an effect."""
        if name not in self._rows or name in self._again:
            o = measure()
            errors = {key: getattr(o, key).tolist() for key in ("clean", "unaware", "before", "after")}
            self._keep(name, {**errors, "given": o.given, "problems": list(o.problems)})
        row = self._rows[name]
        arrays = (np.array(row[key]) for key in ("clean", "unaware", "before", "after"))
        return Outcome(name, *arrays, row["given"], tuple(row["problems"]))

    def _keep(self, name: str, value: Any) -> None:
        self._rows[name] = value
        if self._path is not None:
            self._path.write_text(json.dumps(self._all, indent=1))


def table_of(report: Report, kind: str, outcomes: Sequence[Outcome]) -> None:
    """The table of one kind of friction."""
    rows = []
    for o in outcomes:
        fall = f"{100.0 * o.fall:.1f} %" if o.significant else "no excess"
        further = f"{100.0 * o.further_fall:.1f} %" if o.left else "nothing left"
        further += " (below)" if o.left and o.name in LEFT_TO_THE_LOOP else ""
        cells = (f"{np.mean(x):.6f}" for x in (o.clean, o.unaware, o.before, o.after))
        change, given = f"{o.worse_percent:+.1f} %", f"{100.0 * o.given:.1f} %"
        rows.append((f"`{o.name}`", *cells, given, fall, further, change, "; ".join(o.problems) or "-"))
    header = (
        "ISE without it", "with it", "refitted", "adopted", "compensating torque, of Fc", "excess falls by",
        "of what a refit leaves", "adopted/refitted", "gates",
    )  # fmt: skip
    report.table((f"{kind}: effect", *header), rows)
    for what, falls in (
        ("fall of a significant excess", [o.fall for o in outcomes if o.significant]),
        (
            "fall of what a refit leaves of it",
            [o.further_fall for o in outcomes if o.left and o.name not in LEFT_TO_THE_LOOP],
        ),
    ):
        if falls:
            report.figure(f"{kind}: smallest {what}, missing to 1", 1.0 - min(falls), "", 1.0 - LEAST_FALL)
    report.figure(
        f"{kind}: largest rise of the squared error by an adoption", max(o.worse_percent for o in outcomes), "%",
        MOST_WORSE_PERCENT,
    )  # fmt: skip


def run() -> int:
    """The command."""
    options = parser(NAME, PURPOSE, 6, 2)
    options.add_argument("--only", action="append", help="an effect (may be given more than once)")
    options.add_argument("--duration-s", type=float, default=60.0, help="of the reference")
    options.add_argument(
        "--rows", type=Path, metavar="FILE", help="finished rows are kept there, and not measured again (JSON)"
    )
    options.add_argument(
        "--kept", action="store_true", help="measure nothing: a table of the rows that are kept, the others are named"
    )
    options.add_argument("--again", action="append", default=[], metavar="EFFECT", help="but this one is")
    chosen = options.parse_args()
    names = chosen.only or (SAMPLE if chosen.sample else [trial.plant[0] for trial in TRIALS])
    seeds = range(1, passes_of(chosen) + 1)
    duration_s = min(chosen.duration_s, 20.0) if chosen.sample else chosen.duration_s
    kinds = {"single surface": KINDS["single surface"]} if chosen.sample else KINDS
    report = Report(NAME, PURPOSE)
    trials = [trial for trial in TRIALS if trial.plant[0] in names]
    for trial in TRIALS:
        with_effect(PlantConfig(), trial)  # refused now, and not after an hour
    with shown(NAME) as progress:
        for number, (kind, axis) in enumerate(kinds.items()):
            kept = Kept(chosen.rows, f"{kind}, {len(seeds)} seeds, {duration_s:g} s", chosen.again)
            missing = [trial.plant[0] for trial in trials if trial.plant[0] not in kept] if chosen.kept else []
            if missing:
                report.notes.append(f"{kind}: not measured with this state: {', '.join(missing)}.")
            present = [trial for trial in trials if trial.plant[0] not in missing]
            if not present:
                continue
            clean = kept.clean(functools.partial(clean_axis, axis, seeds, duration_s))
            outcomes = []
            for k, trial in enumerate(present):
                measure = functools.partial(try_effect, trial, axis, clean, seeds, duration_s)
                outcomes.append(kept.outcome(trial.plant[0], measure))
                o = outcomes[-1]
                facts = {
                    "significant": o.significant, "left": o.left, "fall": o.fall, "further_fall": o.further_fall,
                    "worse_percent": o.worse_percent, "given": o.given,
                }  # fmt: skip
                report.facts[f"{kind}: {o.name}"] = facts
                if progress is not None:
                    progress((number * len(trials) + k + 1) / (len(kinds) * len(trials)))
                else:
                    print(f"{kind}: {o.name}: {facts}", file=sys.stderr)
            table_of(report, kind, outcomes)
    report.table(("not compensated", "why"), [(f"`{name}`", why) for name, why in NOT_COMPENSATED.items()])
    report.notes += [f"{text[0].upper()}{text[1:]}." for text in LEFT_TO_THE_LOOP.values()]
    report.notes += [
        f"{len(seeds)} seeds of reference and noise, {duration_s:g} s each; the first is that of the records.",
        f"An excess counts if it exceeds {SIGNIFICANT:g} standard errors of its mean over the seeds.",
        "Nothing left: after a refit of the model's own parameters there is no significant excess, or the refit "
        f"includes the effect and its compensation is below {100.0 * LEAST_GIVEN:g} % of Fc. The remaining excess is "
        "then a property of the axis under a correct model.",
    ]
    return finish(report, chosen)


if __name__ == "__main__":
    main(run)
