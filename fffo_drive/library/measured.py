"""Axes and runs as the library has them: read, made, changed, compared and written."""

from __future__ import annotations

import contextlib
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..config.axis import AxisFile, model_of, rebased, with_keys
from ..config.axis import read_axis as read_axis_file
from ..control.reference import MODE_VELOCITY
from ..documents import DocumentError, check, did_you_mean
from ..evaluation.metrics import ErrorMetrics, Rows, run_metrics
from ..identification.dataset import Record, load_record, record_of_columns
from ..identification.facts import DriveFacts, facts_of, read_facts
from ..importing.candidates import Hints
from ..importing.log import log_of_arrays, read_log
from ..importing.read import RECORDINGS
from ..model.parameters import ModelFile
from ..model.parameters import write_model as write_model_file
from ..recording.errors import ForeignRecordingError
from ..recording.reader import read_run as read_recording
from ..signals import UNITS
from ..workflows.circle_runs import write_yaml
from ..workflows.import_logs import known_units
from ..workflows.recorded_facts import facts_for

if TYPE_CHECKING:
    import pandas


Floats = np.ndarray[Any, np.dtype[Any]]
Source = str | Path | Mapping[str, Any] | Any  # Any: a data frame
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
    doubts: tuple[str, ...] = ()  # what was assumed of columns and units, of arrays by names that are not ours

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
        from ..report.figures import TIME, VELOCITY, Figure, Series, Uniform
        from ..report.static import write_figure  # loads slowly

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
            "velocity",
            "time",
            self.name,
            "velocity over time",
            TIME,
            VELOCITY,
            series,
        )
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
    source: Source,
    *,
    facts: DriveFacts | str | Path | None = None,
    torque_constant_nm_per_a: float | None = None,
    name: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    rate_hz: float | None = None,
) -> MeasuredRun:
    """Read a run: a recording (.mcap), a log of any kind (CSV, MAT, NPZ ...), arrays (n,) by name, or a data frame.

    A file whose columns and units leave a doubt is an error that says which `fffo-drive import` line answers it. Arrays
    by our names of signals are taken as they are, those by other names are recognised as columns of a log are, with
    what is assumed in `.doubts`. `columns` (signal: column), `units` (column: unit) and `rate_hz` say it beforehand.

    `facts`: what is declared about the drive, or the file with it; recordings contain it.
    `torque_constant_nm_per_a` (Nm/A) takes precedence over both, and is sufficient by itself. An incomplete recording
    is read up to its last complete chunk, with a warning, and `.cut` says why. Errors that leave a table usable are
    warnings, too. Raises RecordingError or DocumentError.
    """
    given = None if isinstance(source, str | Path) else _arrays_of(source)
    hints = Hints(rate_hz=rate_hz, roles=columns or {}, units=known_units(dict(units or {})))
    if given is not None and not given.keys() & {"time_s", *UNITS}:
        declared = _facts(facts, torque_constant_nm_per_a)
        linear = declared is not None and declared.units == "linear"
        log = log_of_arrays(name or "run", given, replace(hints, linear=linear))
        if declared is None and log.torque_unit in ("Nm", "N"):
            declared = facts_of({}, log.torque_unit == "N")
        return MeasuredRun(name or "run", dict(log.columns), declared, doubts=log.doubts)
    if given is not None:
        arrays = {key: np.ascontiguousarray(values, dtype=np.float64) for key, values in given.items()}
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
    path = Path(str(source))
    recording = None
    if path.name.endswith(RECORDINGS):
        with contextlib.suppress(ForeignRecordingError):
            recording = read_recording(path)
    carried = _facts_carried(path, torque_constant_nm_per_a) if recording is not None and facts is None else None
    declared = _facts(facts or carried, torque_constant_nm_per_a)
    if recording is None:
        own = Hints() if declared is None else declared.hints()
        own = replace(own, rate_hz=rate_hz or own.rate_hz, roles=hints.roles, units=hints.units)
        log = read_log(path, own)
        for text in log.remarks:
            warnings.warn(text, stacklevel=2)
        return MeasuredRun(name or path.name, dict(log.columns), declared, path)
    if not recording.complete:
        warnings.warn(recording.reason, stacklevel=2)
    own_loop = "profile_sample" in recording.columns
    return MeasuredRun(
        name or path.name,
        dict(recording.columns),
        declared,
        path,
        None,
        np.asarray(recording.rows) if own_loop else None,
        recording.profile_samples if own_loop else None,
        None if recording.complete else recording.reason,
    )


def _arrays_of(source: Any) -> dict[str, Any]:
    """Arrays by name of a mapping, or of a data frame (pandas, with its index where that has a name; polars; Arrow)."""
    if isinstance(source, Mapping):
        return dict(source)
    names = getattr(source, "column_names", None) or list(getattr(source, "columns", ()))
    if not names:
        raise DocumentError(f"a file, arrays by name or a data frame is needed, not {type(source).__name__}")
    index: Any = getattr(source, "index", None)
    named = {str(index.name): index.to_numpy()} if getattr(index, "name", None) is not None else {}
    return named | {str(key): source[key].to_numpy() for key in names}


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


def as_written(axis: Axis | str | Path) -> Axis:
    """The axis of a file; one that was read must be as its file is. Raises DocumentError."""
    written = read_axis(axis.path if isinstance(axis, Axis) else axis)
    if isinstance(axis, Axis) and (axis.file, axis.model) != (written.file, written.model):
        raise DocumentError(
            f"axis: it has been changed since {axis.path} was read, and a run is recorded with its axis file: write it "
            "first with axis = fd.write_axis(axis, FILE)"
        )
    return written


def recorded(runs: Sequence[MeasuredRun | str | Path]) -> list[Path]:
    """The recordings of runs. Raises DocumentError for a run that has none."""
    paths = [(one, one.path if isinstance(one, MeasuredRun) else Path(one)) for one in runs]
    lost = next((one for one, path in paths if path is None), None)
    if lost is not None:
        raise DocumentError(f"{lost!r}: no recording: make it with run()")
    return [path for _, path in paths if path is not None]
