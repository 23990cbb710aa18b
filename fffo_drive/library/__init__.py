"""The library: what the command line does, as functions on arrays, files and records.

    import fffo_drive as fd
    run = fd.read_run({"time_s": t, "position_rev": x, "current_command_a": i}, torque_constant_nm_per_a=0.148)
    print(fd.identify(run).model.friction)

Signals have the names and units of `signals.ROW`: time_s, position_rev, velocity_rps, current_command_a, reference_rps.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import formats
from ..config.axis import TOGGLES, default_axis, with_keys
from ..config.commissioning import commissioned, permission
from ..config.scenario import read_scenario, yardstick_of
from ..control.own_law import ControlLaw as ControlLaw
from ..control.own_law import LawInput as LawInput
from ..daemon.serving import torque_on
from ..documents import DocumentError
from ..evaluation.replay_runs import ReplayReport
from ..evaluation.summary import Summary, summarise
from ..extras import needs_extra
from ..identification.dataset import Record, distinct_names, one_rate
from ..identification.facts import DriveFacts
from ..identification.facts import read_facts as read_facts
from ..identification.population import AgainstPopulation
from ..identification.tuning import Wish
from ..importing.read import RECORDINGS
from ..model.effects.registry import register_law as register_law
from ..model.parameters import ModelFile
from ..model.parameters import read_model as read_model
from ..runtime.runs import timestamp_name
from ..workflows import adopt as adoption
from ..workflows import diagnose as diagnosing
from ..workflows import evaluate as evaluating
from ..workflows import identify as identifying
from ..workflows import replay as replaying
from ..workflows import simulate as simulating
from ..workflows import tune as tuning
from ..workflows.adopt import Adopted
from ..workflows.errors import RecordingGapError
from ..workflows.evaluate_live import evaluate_recordings
from ..workflows.identify import Identified
from ..workflows.load_range import range_of, with_range
from ..workflows.plan import Plan, checked_plan, open_drive, read_profile_file
from ..workflows.record import record_run
from ..workflows.recorded_facts import facts_of_axis
from ..workflows.recordings import claim
from ..workflows.tune import Tuned
from .actions import close_the_loop as close_the_loop
from .actions import commission as commission
from .actions import export as export
from .actions import import_log as import_log
from .control_laws import margins as margins
from .control_laws import with_controller
from .measured import Axis as Axis
from .measured import Floats, as_written, recorded
from .measured import MeasuredRun as MeasuredRun
from .measured import RunMetrics as RunMetrics
from .measured import read_axis as read_axis
from .measured import read_run as read_run
from .measured import write_axis as write_axis
from .measured import write_model as write_model

if TYPE_CHECKING:
    from ..diagnosis.results import Diagnosis

PROFILE_KINDS = ("paper", "identify", "recipe", "frf")  # that need no other key
GivenProfile = str | Path | Mapping[str, Any] | Floats


def simulate(
    axis: Axis | str | Path,
    *,
    toggle: str | None = None,
    gains: Mapping[str, float] | Tuned | None = None,
    model: ModelFile | None = None,
    profile: GivenProfile | None = None,
    effects: Mapping[str, Mapping[str, float]] | None = None,
    controller: ControlLaw | None = None,
    seed: int | None = None,
) -> MeasuredRun:
    """Run an axis on its simulated drive in process, many times faster than real time, without writing a file.

    `toggle`: friction from "off", "ff" (reference) or "fb" (feedback); None: the file's. `gains`: keys of the file's
    `controller` ({"proportional_a_per_rps": 0.9, "observer.gain_nm_per_rev": 3.0}), or what `tune` found. `model`:
    another model for the law; the simulated drive stays as it is. `profile`: the reference in rps at each tick, (n,), a
    section as in a file ({"kind": "sine", ...}), a kind that needs no more ("paper", "identify", "recipe", "frf"), or a
    file. `effects`: of the simulated drive instead of those in its file, parameters by effect
    ({"cogging": {"amplitude_nm": 0.02}}; `fffo-drive config effects` lists them). `controller`: a law of your own in
    place of the file's. `seed`: of the drive's noise.

    Runs in threads use all cores: the loop holds no lock of Python. Raises DocumentError if the checks before a run
    refuse it.
    """
    chosen = axis if isinstance(axis, Axis) else read_axis(axis)
    if isinstance(gains, Tuned):
        section = gains.section(chosen.file.controller.current_limit_a)
        chosen = chosen.change({"controller": formats.over(chosen.file.controller.model_dump(), section)})
    elif gains is not None:
        chosen = chosen.change({f"controller.{key}": value for key, value in gains.items()})
    of_file = chosen is not axis and gains is None and model is None and profile is None
    chosen = chosen if model is None else replace(chosen, model=model)
    plan, friction = _plan(chosen, toggle, profile, None if of_file else "axis")
    found = simulating.simulate(with_controller(plan, controller), friction, seed, effects)
    rows = found.rows
    active = np.flatnonzero(rows["profile_sample"] >= 0)
    rows = rows[int(active[0]) : int(active[-1]) + 1] if active.size else rows
    columns = {name: rows[name] for name in rows.dtype.names or ()}
    columns["time_s"] = (rows["deadline_ns"] - rows["deadline_ns"][0]) * 1e-9
    facts = DriveFacts.model_validate(facts_of_axis(plan.axis, plan.model))
    samples = plan.profile.values.size
    return MeasuredRun(plan.axis.name, columns, facts, None, found.fault, rows, samples)


def run(
    axis: Axis | str | Path,
    out: str | Path | None = None,
    *,
    toggle: str | None = None,
    profile: GivenProfile | None = None,
    bus: str | None = None,
    uncommissioned: bool = False,
    controller: ControlLaw | None = None,
) -> MeasuredRun:
    """Run an axis file on its drive, simulated or on a bus, and record it. **A drive on a bus moves.**

    `out`: the recording (None: recording.directory of the axis file). `profile`: as for `simulate`. `bus` replaces the
    bus of the file. `uncommissioned`: enable a drive that has no commissioning record. `controller`: a law of your own
    in place of the file's; on a bus it has to be compiled, and to have the margins that the file asks for.

    An axis that was changed since it was read is refused: its recording holds its file (`write_axis`). Raises
    DriveError, DocumentError, OSError, and RecordingGapError if the recording is incomplete.
    """
    plan, chosen = _plan(as_written(axis), toggle, profile, None if profile is None else "axis")
    given = permission(plan.path, plan.axis, plan.model, uncommissioned)
    plan = with_controller(plan, controller)
    name = f"{timestamp_name(plan.axis.name, time.time_ns())}.mcap"
    path = Path(out) if out is not None else Path(plan.axis.recording.directory) / name
    claim(path)
    outcome = record_run(plan, open_drive(plan, bus), chosen, path, given)
    if outcome.gap_text is not None:
        raise RecordingGapError(f"{path}: {outcome.gap_text}")
    if len(outcome.files) > 1:
        names = ", ".join(map(str, outcome.files))
        raise DocumentError(f"{names}: `recording` of the axis file divided the run: read each with read_run")
    return replace(read_run(outcome.files[0]), fault=outcome.fault_text)


def _plan(axis: Axis, toggle: str | None, profile: GivenProfile | None, argument: str | None) -> tuple[Plan, int]:
    if toggle is not None and toggle not in TOGGLES:
        raise DocumentError(f"toggle: {toggle!r} is none of {', '.join(TOGGLES)}")
    wanted = None if toggle is None else (TOGGLES[toggle],)
    file = axis.file
    of_file = None
    if isinstance(profile, str) and profile in PROFILE_KINDS:
        profile = {"kind": profile}
    if isinstance(profile, str | Path):
        of_file = profile
        file = file.model_copy(update={"profile": read_profile_file(profile).profile})
    elif profile is not None:
        file = with_keys(file, {"profile": _section_of(profile, file.loop.period_s)}, "axis")
    plan = checked_plan(axis.path, file, axis.model, wanted, of_file, argument)
    return plan, plan.toggle if wanted is None else wanted[0]


def _section_of(profile: Mapping[str, Any] | Floats, period_s: float) -> dict[str, Any]:
    """The section of an axis file for a section, or for a reference (n,) in rps at each tick. Raises DocumentError."""
    if isinstance(profile, Mapping):
        return dict(profile)
    values = np.asarray(profile, dtype=np.float64)
    if values.ndim != 1 or values.size < 2 or not np.isfinite(values).all():
        raise DocumentError(f"profile: shape {values.shape}: finite velocities in rps, one a tick, (n,) are needed")
    points = [(tick * period_s, value) for tick, value in enumerate([*values, values[-1]])]  # it holds for its tick
    return {"kind": "points", "points": points}


def _records(runs: Sequence[MeasuredRun], facts: DriveFacts | None) -> tuple[list[Record], DriveFacts]:
    """Records at one rate under names of their own, and what is declared about their drive."""
    declared = [one for one in runs if one.facts is not None]
    chosen = facts or (declared[0].facts if declared else None)
    if chosen is None:
        raise DocumentError("nothing is declared about the drive: read_run(..., torque_constant_nm_per_a=...)")
    other = next((one for one in declared if one.facts != chosen), None)
    if facts is None and other is not None:
        raise DocumentError(
            f"{other.name}: its facts are not those of {declared[0].name}: runs of one axis belong "
            "together; where they are of one axis, give facts="
        )
    records = [one.record(chosen) for one in runs]
    names = distinct_names([record.path for record in records])
    return one_rate([replace(record, name=name) for record, name in zip(records, names, strict=True)]), chosen


def _several(runs: MeasuredRun | Sequence[MeasuredRun]) -> list[MeasuredRun]:
    return [runs] if isinstance(runs, MeasuredRun) else list(runs)


def identify(
    runs: MeasuredRun | Sequence[MeasuredRun],
    *,
    facts: DriveFacts | None = None,
    name: str = "model",
    prior: str | Path | None = None,
    prior_model: str | None = None,
) -> Identified:
    """Fit inertia, delay and 2SEP friction to runs of one axis. `.model` can be written, run and tuned.

    `prior`: a store of `fffo-drive fleet`, or a population file: what the runs do not determine then comes from other
    drives of the same type (`prior_model`; None: the type that the runs name). `.result["prior"]` has the prior, the
    fit to the runs alone, and both combined. Raises DataError if no model can be fitted to the runs, DocumentError if
    `prior` cannot be used.
    """
    several = _several(runs)
    records, chosen = _records(several, facts)
    return identifying.identify(records, chosen, name, None, _prior(prior, several, records, chosen, prior_model))


def _prior(
    prior: str | Path | None,
    runs: Sequence[MeasuredRun],
    records: Sequence[Record],
    facts: DriveFacts,
    model: str | None,
) -> AgainstPopulation | None:
    if prior is None:
        return None
    try:
        from ..fleet import measure, standing
    except ImportError as error:
        raise DocumentError(f"{error}: {needs_extra('prior', 'fleet')}") from None
    path = runs[0].path
    if path is None:  # of arrays
        who = standing.Who("", model or facts.name)
    else:
        who = standing.who_of(path, None if path.name.endswith(RECORDINGS) else facts, model)
    population = standing.population_at(str(prior), who)
    degc = [measure.temperature_of(run.columns) for run in runs]
    balances = [measure.balance_of_record(record, facts) for record in records]
    return standing.against_population(population, str(prior), balances, degc, facts)


def tune(
    model: ModelFile,
    *,
    axis: Axis | None = None,
    rate_hz: float = 2000.0,
    bandwidth_hz: float | None = None,
    phase_margin_deg: float = Wish().phase_margin_deg,
    gain_margin: float = Wish().gain_margin,
    inertia_range_kg_m2: tuple[float, float] | None = None,
) -> Tuned:
    """Choose the gains with the largest integral action within the margins (deg, factor).

    `bandwidth_hz`: target crossover frequency. `axis`: take the loop rate, the source of the velocity and what its
    commissioning record holds from this axis; None: `rate_hz` and the drive's velocity. `inertia_range_kg_m2`: least
    and largest inertia with all loads, at the motor shaft, motor included (kg of a linear axis), over which the margins
    hold; None: the axis file's, or the model's inertia alone. Raises DocumentError.
    """
    tuning.require_positive(rate_hz=rate_hz)
    given = None if inertia_range_kg_m2 is None else range_of(model, *inertia_range_kg_m2)
    wish = Wish(bandwidth_hz, Wish().damping_ratio, phase_margin_deg, gain_margin)
    if axis is None:
        return tuning.tune(model, default_axis(model, 1.0 / rate_hz, given), wish)
    return tuning.tune_axis(with_range(axis.file, given), model, wish, commissioned(axis.path, axis.file))[0]


def diagnose(
    runs: MeasuredRun | Sequence[MeasuredRun],
    held_out: MeasuredRun | Sequence[MeasuredRun] = (),
    *,
    model: ModelFile | None = None,
    facts: DriveFacts | None = None,
    out: str | Path | None = None,
    prior: str | Path | None = None,
    prior_model: str | None = None,
) -> Diagnosis:
    """Find on `runs` what the model lacks, and test it on `held_out`.

    `model`: the base model (None: identified from the runs). `prior`, `prior_model`: as for `identify`, instead of
    `model`: they supply what the runs determine poorly in the base model.

    `.headline` is the result in one sentence, `.findings` have size, interval and proof, `.model_after` is the model
    with the findings. Findings are in Nm, rps and the units that each names. `out`: a directory for report.html,
    report.json and the model.yaml that `adopt` takes. Raises DataError if no model can be fitted to the runs,
    DocumentError if a run is both fitted and held out.
    """
    chosen_runs, proof = _several(runs), _several(held_out)
    records, chosen = _records([*chosen_runs, *proof], facts)
    fit, proven = records[: len(chosen_runs)], records[len(chosen_runs) :]
    seen = {record.digest for record in fit}
    both = next((run for run, record in zip(proof, proven, strict=True) if record.digest in seen), None)
    if both is not None:
        raise DocumentError(f"{both.name}: a run cannot be fitted and held out")
    if out is not None:
        diagnosing.require_place(Path(out))
    if prior is not None and model is not None:
        raise DocumentError("prior: the base model begins from model: give one of them")
    against = _prior(prior, chosen_runs, fit, chosen, prior_model)
    found = diagnosing.diagnose(fit, proven, chosen, model, None, None, against)
    if out is not None:
        files = [run.path for run in (*chosen_runs, *proof) if run.path is not None]
        diagnosing.write_diagnosis(found, fit, chosen, files, Path(out), None)
    return found


def adopt(
    model: str | Path, axis: Axis | str | Path, *, report: str | Path | None = None, dry_run: bool = False
) -> Adopted:
    """Put a diagnosed model file in service on an axis if every gate passes; with `dry_run` only check the gates.

    `report`: the report.json of the diagnosis (None: the one beside the model). One gate requires that the axis's
    daemon has no torque on.
    """
    chosen = as_written(axis)
    serving = torque_on(chosen.file.name)
    report_path = None if report is None else Path(report)
    return adoption.adopt(chosen.path, chosen.file, Path(model), report_path, serving, dry_run)


def evaluate(
    scenario: str | Path | None = None,
    *,
    runs: Sequence[MeasuredRun | str | Path] = (),
    controllers: Sequence[str] | None = None,
    seeds: int | None = None,
    workers: int | None = None,
    laws: Sequence[ControlLaw] = (),
) -> Summary:
    """Compare controllers: `.figure("true.ise", "pi+fffo+")` in rps^2 s, and all others, with intervals over seeds.

    `scenario`: a scenario file, run on the simulated drive in process. `runs`: recordings instead. Those of one
    controller count as seeds; a scenario that is given as well sets how they are evaluated; anything that makes the
    comparison doubtful is a warning. `workers`: processes (None: one per core). `laws`: of your own, compared with the
    scenario's controllers under their names. Raises DocumentError, and ValueError
    if no seed ran to its end.
    """
    chosen = None if scenario is None else evaluating.narrowed(read_scenario(scenario), controllers, seeds)
    if runs:
        if laws:
            raise DocumentError("laws: they run on a scenario's simulated drive: leave runs= out")
        given = None if chosen is None else yardstick_of(chosen.file)
        _, evaluations, cautions = evaluate_recordings([str(path) for path in recorded(runs)], given)
        for caution in cautions:
            warnings.warn(caution, stacklevel=2)
        return summarise(evaluations, None if chosen is None else chosen.file.percent_of)
    if chosen is None:
        raise DocumentError("evaluate: a scenario file or runs=[...] is needed")
    return evaluating.evaluate(chosen, workers, laws)


def replay(
    runs: MeasuredRun | str | Path | Sequence[MeasuredRun | str | Path],
    instead: str | Path | None = None,
    *,
    controller: ControlLaw | None = None,
) -> ReplayReport:
    """Run recordings through the control law and the envelope again: `.exact` is true if every command is the same.

    The same means bit for bit. `instead`: an axis or model file whose law is run on the recorded feedback; the
    differences are in A. `controller`: the law of your own with which they were recorded; its config is the recorded
    one. Raises DocumentError.
    """
    several = [runs] if isinstance(runs, MeasuredRun | str | Path) else list(runs)
    paths = replaying.with_continuations(recorded(several))
    return replaying.replay_files(paths, None if instead is None else str(instead), controller)
