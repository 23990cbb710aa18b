"""The library: what the command line does, as functions on arrays, files and records.

    import fffo_drive as fd
    run = fd.read_run({"time_s": t, "position_rev": x, "current_command_a": i}, torque_constant_nm_per_a=0.148)
    print(fd.identify(run).model.friction)

Signals have the names and units of `signals.ROW`: time_s, position_rev, velocity_rps, current_command_a, reference_rps.
"""

from __future__ import annotations

import contextlib
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from . import formats
from .config.axis import TOGGLES, AxisFile, default_axis, model_of, rebased, with_keys
from .config.axis import read_axis as read_axis_file
from .config.commissioning import commissioned, permission
from .config.scenario import read_scenario, yardstick_of
from .control.reference import MODE_VELOCITY
from .daemon.serving import torque_on
from .documents import DocumentError, check, did_you_mean
from .evaluation.metrics import ErrorMetrics, Rows, run_metrics
from .evaluation.replay_runs import ReplayReport
from .evaluation.summary import Summary, summarise
from .extras import needs_extra
from .identification.dataset import Record, distinct_names, load_record, one_rate, record_of_columns
from .identification.facts import DriveFacts
from .identification.facts import read_facts as read_facts
from .identification.population import AgainstPopulation
from .identification.tuning import Wish
from .importing.log import read_log
from .importing.read import RECORDINGS
from .model.parameters import ModelFile
from .model.parameters import read_model as read_model
from .model.parameters import write_model as write_model_file
from .recording.errors import ForeignRecordingError
from .recording.reader import read_run as read_recording
from .runtime.runs import timestamp_name
from .signals import UNITS
from .workflows import adopt as adoption
from .workflows import diagnose as diagnosing
from .workflows import evaluate as evaluating
from .workflows import identify as identifying
from .workflows import replay as replaying
from .workflows import simulate as simulating
from .workflows import tune as tuning
from .workflows.adopt import Adopted
from .workflows.circle_runs import write_yaml
from .workflows.errors import RecordingGapError
from .workflows.evaluate_live import evaluate_recordings
from .workflows.identify import Identified
from .workflows.load_range import range_of, with_range
from .workflows.plan import Plan, checked_plan, open_drive, read_profile_file
from .workflows.record import record_run
from .workflows.recorded_facts import facts_for, facts_of_axis
from .workflows.recordings import claim
from .workflows.tune import Tuned

if TYPE_CHECKING:
    import pandas

    from .diagnosis.results import Diagnosis

Floats = np.ndarray[Any, np.dtype[Any]]
Source = str | Path | Mapping[str, Any]
GivenProfile = str | Path | Mapping[str, Any] | Floats
SHOWN = (("reference_rps", "ink"), ("velocity_rps", "blue"))


@dataclass(frozen=True)
class Axis:
    """An axis file with the model that it names.

    A function uses what it is given: `axis.change(...)` and `dataclasses.replace(axis, model=...)` need no file.
    """

    path: Path  # names in the file are relative to it
    file: AxisFile
    model: ModelFile

    def change(self, keys: Mapping[str, Any]) -> Axis:
        """The axis with other values, by dotted key: {"controller.proportional_a_per_rps": 0.9}.

        Raises DocumentError with every error, by key.
        """
        return replace(self, file=with_keys(self.file, keys, "axis"))

    def __repr__(self) -> str:
        return f"Axis({str(self.path)!r}: {self.file.name}, {self.file.drive.kind} drive, model {self.model.name})"


class RunMetrics(NamedTuple):
    """Errors of a run against its reference."""

    measured: ErrorMetrics  # of the velocity that the drive sends: what a real axis has, and what the commands print
    shaft: ErrorMetrics | None  # of the shaft's own velocity; None where it is not simulated


@dataclass(frozen=True)
class MeasuredRun:
    """One run of an axis: signals (n,) at one rate, by name; `run["velocity_rps"]` is one of them."""

    name: str
    columns: Mapping[str, Floats]
    facts: DriveFacts | None
    path: Path | None = None  # the file, where there is one
    fault: str | None = None  # why it ended before its profile did
    rows: Rows | None = field(default=None, repr=False)  # signals.ROW, of this project's own loop
    profile_samples: int | None = None  # of the profile that ran, in those rows
    cut: str | None = None  # why not all of its recording could be read

    def __getitem__(self, name: str) -> Floats:
        if name not in self.columns:
            raise KeyError(f"{self.name}: no signal {name!r}: {did_you_mean(name, self.columns)}")
        return self.columns[name]

    @property
    def time_s(self) -> Floats:
        """Seconds since the first sample, (n,)."""
        return self["time_s"]

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return float(self.time_s[-1] - self.time_s[0]) if self.time_s.size else 0.0

    @property
    def metrics(self) -> RunMetrics:
        """ISE (rps^2 s), MAE, MAX, STD (rps) of the error while the profile ran: `.measured`, and `.shaft` where known.

        Raises ValueError for a run that was not made by this project's loop.
        """
        if self.rows is None:
            raise ValueError(f"{self.name}: no profile of this project's loop ran in it")
        period_s = float(np.median(np.diff(self.time_s)))
        measured = run_metrics(self.rows, period_s, self.profile_samples)
        if not np.isfinite(self.rows["true_velocity_rps"]).all():
            return RunMetrics(measured, None)
        return RunMetrics(measured, run_metrics(self.rows, period_s, self.profile_samples, "true_velocity_rps"))

    def to_pandas(self) -> pandas.DataFrame:
        """A column a signal, units in the names, indexed by time_s. Needs pandas: pip install pandas."""
        try:
            import pandas
        except ImportError:
            raise ImportError("to_pandas needs pandas: pip install pandas") from None
        return pandas.DataFrame({name: np.asarray(values) for name, values in self.columns.items()}).set_index("time_s")

    def record(self, facts: DriveFacts | None = None) -> Record:
        """As `identify` and `diagnose` take it. Raises DataError with everything that speaks against a fit."""
        chosen = facts or self.facts
        if chosen is None:
            raise DocumentError(f"{self.name}: nothing is declared about its drive: give torque_constant_nm_per_a")
        if self.path is not None:
            return load_record(self.path, chosen)
        open_loop = "mode" in self.columns and not (self["mode"] == MODE_VELOCITY).any()
        given = {name: self[name] for name in self.columns if not (open_loop and name == "reference_rps")}
        return record_of_columns(self.name, given, chosen)

    def __repr__(self) -> str:
        size = f"{self.time_s.size} samples, {self.duration_s:.4g} s, {len(self.columns)} signals"
        cut = ", cut: its recording is incomplete" if self.cut else ""
        return f"MeasuredRun({self.name!r}: {size}{cut}{f', fault: {self.fault}' if self.fault else ''})"

    def _repr_html_(self) -> str:
        rows = [
            f"<tr><td>{name}</td><td>{UNITS[name]}</td><td>{np.min(values):.4g}</td><td>{np.max(values):.4g}</td></tr>"
            for name, values in self.columns.items()
            if name in UNITS and np.issubdtype(np.asarray(values).dtype, np.floating) and np.size(values)
        ]
        table = f"<table><tr><th>signal</th><th>unit</th><th>least</th><th>most</th></tr>{''.join(rows)}</table>"
        return f"<p>{escape(repr(self))}</p>{self._picture()}<details><summary>signals</summary>{table}</details>"

    def _picture(self) -> str:
        """Velocity and reference over time, as SVG."""
        from .report.figures import TIME, VELOCITY, Figure, Series, Uniform
        from .report.static import write_figure  # loads slowly

        if self.time_s.size < 2:
            return ""
        period_s = float(np.median(np.diff(self.time_s)))
        series = tuple(
            Series(name, Uniform(0.0, period_s), np.asarray(self.columns[name], float), colour)
            for name, colour in SHOWN
            if name in self.columns
        )
        if not series:
            return ""
        figure = Figure(
            "velocity", "time", self.name, "velocity over time", TIME,
            VELOCITY, series,
        )  # fmt: skip
        with tempfile.TemporaryDirectory() as directory:
            path = Path(directory) / "velocity.svg"
            write_figure(figure, path)
            text = path.read_text(encoding="utf-8")
        return text[text.index("<svg") :]


def read_axis(path: str | Path) -> Axis:
    """Read an axis file and its model. Raises DocumentError with every error, by file, line and key."""
    path = Path(path)
    file = read_axis_file(path)
    return Axis(path, file, model_of(path, file))


def read_run(
    source: Source, *, facts: DriveFacts | str | Path | None = None, torque_constant_nm_per_a: float | None = None,
    name: str | None = None,
) -> MeasuredRun:  # fmt: skip
    """Read a run: a recording (.mcap), a log of any kind (CSV, MAT, NPZ ...), or arrays (n,) by signal name.

    A log whose columns and units leave a doubt is an error that says which `fffo-drive import` line answers it.

    `facts`: what is declared about the drive, or the file with it; recordings contain it.
    `torque_constant_nm_per_a` (Nm/A) takes precedence over both, and is sufficient by itself. An incomplete recording
    is read up to its last complete chunk, with a warning, and `.cut` says why. Errors that leave a table usable are
    warnings, too. Raises RecordingError or DocumentError.
    """
    if isinstance(source, Mapping):
        arrays = {key: np.ascontiguousarray(values, dtype=np.float64) for key, values in source.items()}
        if "time_s" not in arrays:
            raise DocumentError(f"{name or 'run'}: time_s: a mapping of arrays needs the time of each sample, in s")
        shape = arrays["time_s"].shape
        other = next((key for key, values in arrays.items() if values.shape != shape), "time_s")
        if len(shape) != 1 or shape[0] < 2 or other != "time_s":
            raise DocumentError(
                f"{name or 'run'}: {other}: shape {arrays[other].shape}, time_s has {shape}: arrays (n,) of one length "
                "are needed, at least 2 samples"
            )
        return MeasuredRun(name or "run", arrays, _facts(facts, torque_constant_nm_per_a))
    path = Path(source)
    recording = None
    if path.name.endswith(RECORDINGS):
        with contextlib.suppress(ForeignRecordingError):
            recording = read_recording(path)
    own = _facts_carried(path, torque_constant_nm_per_a) if recording is not None and facts is None else None
    declared = _facts(facts or own, torque_constant_nm_per_a)
    if recording is None:
        log = read_log(path, None if declared is None else declared.hints())
        for text in log.remarks:
            warnings.warn(text, stacklevel=2)
        return MeasuredRun(name or path.name, dict(log.columns), declared, path)
    if not recording.complete:
        warnings.warn(recording.reason, stacklevel=2)
    own_loop = "profile_sample" in recording.columns
    return MeasuredRun(
        name or path.name, dict(recording.columns), declared, path, None,
        np.asarray(recording.rows) if own_loop else None, recording.profile_samples if own_loop else None,
        None if recording.complete else recording.reason,
    )  # fmt: skip


def _facts(facts: DriveFacts | str | Path | None, torque_constant_nm_per_a: float | None) -> DriveFacts | None:
    if isinstance(facts, str | Path):
        facts = read_facts(facts)
    if torque_constant_nm_per_a is None:
        return facts
    given = {} if facts is None else facts.model_dump(exclude_none=True)
    return check(given | {"torque_constant_nm_per_a": float(torque_constant_nm_per_a)}, DriveFacts, "facts", {})


def _facts_carried(path: Path, torque_constant_nm_per_a: float | None) -> DriveFacts | None:
    """The facts in a recording; None where it has none, and the constant is enough. Raises DocumentError."""
    try:
        return facts_for(None, [path])
    except DocumentError:
        if torque_constant_nm_per_a is None:
            raise
        return None


def write_axis(axis: Axis, path: str | Path) -> Axis:
    """Write an axis to a file, and its model beside it where it is not that of the file that it names.

    Names of other files are written as they are from there. Returns the axis as it is read again. Raises DocumentError,
    OSError.
    """
    path = Path(path)
    data = rebased(axis.file.model_dump(mode="json", exclude_none=True), axis.path, path.parent)
    if axis.model != model_of(axis.path, axis.file):
        beside_it = path.with_name(f"{path.stem}_model.yaml")
        write_model(axis.model, beside_it)
        data["model"] = beside_it.name
    write_yaml(path, data)
    return read_axis(path)


def write_model(model: ModelFile, path: str | Path) -> None:
    """Write a model to a file, with its hash. Raises OSError."""
    write_model_file(path, model)


def simulate(
    axis: Axis | str | Path,
    *,
    toggle: str | None = None,
    gains: Mapping[str, float] | Tuned | None = None,
    model: ModelFile | None = None,
    profile: GivenProfile | None = None,
    seed: int | None = None,
) -> MeasuredRun:
    """Run an axis on its simulated drive in process, many times faster than real time, without writing a file.

    `toggle`: friction from "off", "ff" (reference) or "fb" (feedback); None: the file's. `gains`: keys of the file's
    `controller` ({"proportional_a_per_rps": 0.9, "observer.gain_nm_per_rev": 3.0}), or what `tune` found. `model`:
    another model for the law; the simulated drive stays as it is. `profile`: the reference in rps at each tick, (n,), a
    section as in a file ({"kind": "sine", ...}), or a file with one. `seed`: of the drive's noise. Raises DocumentError
    if the checks before a run refuse it.
    """
    chosen = axis if isinstance(axis, Axis) else read_axis(axis)
    if isinstance(gains, Tuned):
        section = gains.section(chosen.file.controller.current_limit_a)
        chosen = chosen.change({"controller": formats.over(chosen.file.controller.model_dump(), section)})
    elif gains is not None:
        chosen = chosen.change({f"controller.{key}": value for key, value in gains.items()})
    plan, friction = _plan(chosen if model is None else replace(chosen, model=model), toggle, profile)
    found = simulating.simulate(plan, friction, seed)
    rows = found.rows
    active = np.flatnonzero(rows["profile_sample"] >= 0)
    rows = rows[int(active[0]) : int(active[-1]) + 1] if active.size else rows
    columns = {name: np.ascontiguousarray(rows[name]) for name in rows.dtype.names or ()}
    columns["time_s"] = (rows["deadline_ns"] - rows["deadline_ns"][0]) * 1e-9
    facts = DriveFacts.model_validate(facts_of_axis(plan.axis, plan.model))
    samples = plan.profile.values.size
    return MeasuredRun(plan.axis.name, columns, facts, None, found.fault, rows, samples)


def run(
    axis: Axis | str | Path, out: str | Path | None = None, *, toggle: str | None = None,
    profile: GivenProfile | None = None, bus: str | None = None, uncommissioned: bool = False,
) -> MeasuredRun:  # fmt: skip
    """Run an axis file on its drive, simulated or on a bus, and record it. **A drive on a bus moves.**

    `out`: the recording (None: recording.directory of the axis file). `profile`: as for `simulate`. `bus` replaces the
    bus of the file. `uncommissioned`: enable a drive that has no commissioning record. An axis that was changed since
    it was read is refused: its recording holds its file (`write_axis`). Raises DriveError, DocumentError, OSError, and
    RecordingGapError if the recording is incomplete.
    """
    plan, chosen = _plan(_as_written(axis), toggle, profile)
    given = permission(plan.path, plan.axis, plan.model, uncommissioned)
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


def _as_written(axis: Axis | str | Path) -> Axis:
    """The axis of a file; one that was read must be as its file is. Raises DocumentError."""
    written = read_axis(axis.path if isinstance(axis, Axis) else axis)
    if isinstance(axis, Axis) and (axis.file, axis.model) != (written.file, written.model):
        raise DocumentError(
            f"axis: it has been changed since {axis.path} was read, and a run is recorded with its axis file: write it "
            "first with axis = fd.write_axis(axis, FILE)"
        )
    return written


def _plan(axis: Axis, toggle: str | None, profile: GivenProfile | None) -> tuple[Plan, int]:
    if toggle is not None and toggle not in TOGGLES:
        raise DocumentError(f"toggle: {toggle!r} is none of {', '.join(TOGGLES)}")
    wanted = None if toggle is None else (TOGGLES[toggle],)
    file = axis.file
    of_file = None
    if isinstance(profile, str | Path):
        of_file = profile
        file = file.model_copy(update={"profile": read_profile_file(profile).profile})
    elif profile is not None:
        file = with_keys(file, {"profile": _section_of(profile, file.loop.period_s)}, "axis")
    plan = checked_plan(axis.path, file, axis.model, wanted, of_file)
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
    runs: MeasuredRun | Sequence[MeasuredRun], *, facts: DriveFacts | None = None, name: str = "model",
    prior: str | Path | None = None, prior_model: str | None = None,
) -> Identified:  # fmt: skip
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
    prior: str | Path | None, runs: Sequence[MeasuredRun], records: Sequence[Record], facts: DriveFacts,
    model: str | None,
) -> AgainstPopulation | None:  # fmt: skip
    if prior is None:
        return None
    try:
        from .fleet import measure, standing
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
    model: ModelFile, *, axis: Axis | None = None, rate_hz: float = 2000.0, bandwidth_hz: float | None = None,
    phase_margin_deg: float = Wish().phase_margin_deg, gain_margin: float = Wish().gain_margin,
    inertia_range_kg_m2: tuple[float, float] | None = None,
) -> Tuned:  # fmt: skip
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
    runs: MeasuredRun | Sequence[MeasuredRun], held_out: MeasuredRun | Sequence[MeasuredRun] = (), *,
    model: ModelFile | None = None, facts: DriveFacts | None = None, out: str | Path | None = None,
    prior: str | Path | None = None, prior_model: str | None = None,
) -> Diagnosis:  # fmt: skip
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
    chosen = _as_written(axis)
    serving = torque_on(chosen.file.name)
    report_path = None if report is None else Path(report)
    return adoption.adopt(chosen.path, chosen.file, Path(model), report_path, serving, dry_run)


def evaluate(
    scenario: str | Path | None = None, *, runs: Sequence[MeasuredRun | str | Path] = (),
    controllers: Sequence[str] | None = None, seeds: int | None = None, workers: int | None = None,
) -> Summary:  # fmt: skip
    """Compare controllers: `.figure("true.ise", "pi+fffo+")` in rps^2 s, and all others, with intervals over seeds.

    `scenario`: a scenario file, run on the simulated drive in process. `runs`: recordings instead. Those of one
    controller count as seeds; a scenario that is given as well sets how they are evaluated; anything that makes the
    comparison doubtful is a warning. `workers`: processes (None: one per core). Raises DocumentError, and ValueError
    if no seed ran to its end.
    """
    chosen = None if scenario is None else evaluating.narrowed(read_scenario(scenario), controllers, seeds)
    if runs:
        given = None if chosen is None else yardstick_of(chosen.file)
        _, evaluations, cautions = evaluate_recordings([str(path) for path in _recorded(runs)], given)
        for caution in cautions:
            warnings.warn(caution, stacklevel=2)
        return summarise(evaluations, None if chosen is None else chosen.file.percent_of)
    if chosen is None:
        raise DocumentError("evaluate: a scenario file or runs=[...] is needed")
    return evaluating.evaluate(chosen, workers)


def replay(
    runs: MeasuredRun | str | Path | Sequence[MeasuredRun | str | Path], instead: str | Path | None = None
) -> ReplayReport:
    """Run recordings through the control law and the envelope again: `.exact` is true if every command is the same.

    The same means bit for bit. `instead`: an axis or model file whose law is run on the recorded feedback; the
    differences are in A. Raises DocumentError.
    """
    several = [runs] if isinstance(runs, MeasuredRun | str | Path) else list(runs)
    paths = replaying.with_continuations(_recorded(several))
    return replaying.replay_files(paths, None if instead is None else str(instead))


def _recorded(runs: Sequence[MeasuredRun | str | Path]) -> list[Path]:
    """The recordings of runs."""
    paths = [(one, one.path if isinstance(one, MeasuredRun) else Path(one)) for one in runs]
    lost = next((one for one, path in paths if path is None), None)
    if lost is not None:
        raise DocumentError(f"{lost!r}: no recording: make it with run()")
    return [path for _, path in paths if path is not None]
