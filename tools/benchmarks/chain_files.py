"""The chain on one simulated axis as a user types it: by the commands themselves, or in one process, where every file
is written by the function that the command writes it with (commission, run, identify, diagnose, tune). The tuned axis
file is what is run.

What a user of a new axis has: the drive, its torque constant, and a first axis file as `bring-up` drafts it. Nothing
here chooses a key of the law.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml
from common import ROOT

from fffo_drive.cli import main as cli
from fffo_drive.commissioning.record import FAILED, NOT_DONE, WARNING, CommissioningRecord, read_record
from fffo_drive.config.axis import read_axis
from fffo_drive.config.axis_text import replace_file, with_line
from fffo_drive.config.commissioning import commissioned, permission
from fffo_drive.documents import DocumentError, parse, read_text
from fffo_drive.drive.simulated.parameters import PlantConfig
from fffo_drive.evaluation.peers.laws import AxisNumbers
from fffo_drive.identification.dataset import DataError, Record, load_records, where_command_acts
from fffo_drive.identification.fit import FitSettings
from fffo_drive.identification.tuning import Wish
from fffo_drive.model.friction import FrictionConfig
from fffo_drive.model.parameters import ModelFile, Quantity, read_model, write_model
from fffo_drive.symbols import FRICTION
from fffo_drive.units import inertia_kg_m2
from fffo_drive.workflows.axis_draft import first_law
from fffo_drive.workflows.commission import bounds_of, commission_axis, commissioning_plan, record_path
from fffo_drive.workflows.identify import fitted_model
from fffo_drive.workflows.plan import make_plan, open_drive
from fffo_drive.workflows.record import record_run
from fffo_drive.workflows.recorded_facts import facts_for
from fffo_drive.workflows.tune import needs_diagnosis, tune_axis, write_tuned_axis

CONFIGS = ROOT / "configs"
EXAMPLE = CONFIGS / "axis_simulated.yaml"
ASSUMED_MODEL = CONFIGS / "models" / "table1.yaml"
AXIS, DRIVE, MODEL, KNOWN = "axis.yaml", "simulated_drive.yaml", "assumed.yaml", "known.yaml"
IDENTIFIED, DIAGNOSED, TUNED, RANGED = "model", "diagnosed", "tuned", "ranged"  # directories
FIRST = "first"  # directory of gains for the assumed model, where those of the first axis file are refused ...
TUNE_FIRST = "--axis AXIS --out DIR` choose"  # ... with this advice
PROFILES = {  # what is recorded, with the torque constant of the nominal axis
    "chirp": {"kind": "identify", "duration_s": 40, "low_a": 0.3, "high_a": 1.1, "lowest_hz": 0.01, "highest_hz": 10},
    "sweep": {"kind": "frf", "duration_s": 30, "amplitude_a": 0.8, "lowest_hz": 0.1, "highest_hz": 50},
}
TRACEBACK = "Traceback (most recent call last)"
LOWER, MOST_STEPS = 0.8, 12  # of the amplitudes, while they are refused
AMPLITUDES = ("low_a", "high_a", "amplitude_a")
NOMINAL_NM_PER_A = 0.148
MORE_CURRENT = 2.0  # times as much where `identify` asks for it: axes 8369 and 8764 moved in 4 and 2 % of the chirp


class Chain:
    """The files of one axis in a directory."""

    def __init__(self, place: Path) -> None:
        self.place = place
        self.axis = place / AXIS
        self.excited = self.axis  # the axis file with which the runs for the model are made
        self.logs: list[Path] = []  # that the model is from
        self.warnings: list[str] = []  # what the user was told before anything ran with the tuned gains

    @property
    def tuned(self) -> Path:
        """The axis file that `tune` writes."""
        return self.place / TUNED / AXIS

    def new_axis(self, plant: PlantConfig, torque_constant_nm_per_a: float) -> None:
        """A first axis file, with the torque constant of the data sheet; inertia and delay are assumed."""
        self.connect(plant)
        model, _ = parse(read_text(ASSUMED_MODEL), ASSUMED_MODEL.name)
        for key in ("inertia_kg_m2", "delay_s"):
            model[key]["source"] = "assumed"
        model = {**model, "name": "assumed", "torque_constant_nm_per_a": torque_constant_nm_per_a}
        _write(self.place / MODEL, model)
        axis, _ = parse(read_text(EXAMPLE), EXAMPLE.name)
        inertia_kg_m2 = read_model(self.place / MODEL).inertia_kg_m2.value
        axis["controller"] = {
            **first_law(inertia_kg_m2, torque_constant_nm_per_a),
            "current_limit_a": axis["controller"]["current_limit_a"],
        }
        axis["envelope"]["accept_runaway"] = True  # as a draft of bring-up has it for a simulated drive
        axis |= {"name": "axis", "model": MODEL, "commissioning": "axis.commissioning.yaml"}
        _write(self.axis, axis)

    def connect(self, plant: PlantConfig) -> None:
        """The plant is what the axis has from now on."""
        drive, _ = parse(read_text(CONFIGS / DRIVE), DRIVE)
        _write(self.place / DRIVE, {**drive, "plant": _plain(asdict(plant))})

    def commission(self) -> None:
        """As `commission AXIS --yes`. Raises ValueError where it does not pass."""
        plan = commissioning_plan(self.axis)
        self.judge(commission_axis(plan, bounds_of(plan), record_path(plan)))

    def judge(self, record: CommissioningRecord) -> None:
        """Keep the warnings of a record. Raises ValueError for one that has not passed."""
        failed = [check for check in record.checks if check.verdict in (FAILED, NOT_DONE)]
        if failed:
            raise ValueError(f"commission: {failed[0].name}: {failed[0].text}")
        self.warnings += [f"{check.name}: {check.text}" for check in record.checks if check.verdict == WARNING]

    def record(self, name: str, factor: float = 1.0) -> Path:
        """A run with amplitudes for this motor, lowered, as the user would, as long as the command refuses them by the
        model, or the axis leaves its limits. Raises ValueError, DocumentError where it does so with all.
        """
        scale = factor * NOMINAL_NM_PER_A / read_model(self.place / MODEL).torque_constant_nm_per_a
        refusal: Exception | None = None
        for step in range(MOST_STEPS):
            sized = {key: LOWER**step * scale * v if key in AMPLITUDES else v for key, v in PROFILES[name].items()}
            _write(self.place / f"{name}.yaml", {"profile": sized})
            try:
                return self.run_as_advised(name)
            except (DocumentError, ValueError) as error:
                refusal = error
        assert refusal is not None
        raise refusal

    def run_as_advised(self, name: str) -> Path:
        """`run`, and where it refuses the gains of the first axis file `tune` for the assumed model before it."""
        try:
            return self.run(name)
        except (DocumentError, ValueError) as error:
            if TUNE_FIRST not in str(error) or self.excited != self.axis:
                raise
        self.tune(self.place / MODEL, FIRST)
        self.excited = self.place / FIRST / AXIS
        return self.run(name)

    def run(self, name: str, axis: Path | None = None) -> Path:
        """As `run AXIS --profile FILE --out RUN`, or `run AXIS --out RUN` on another axis file. Raises DocumentError;
        ValueError for a run that ends with a fault.
        """
        plan = make_plan(axis or self.excited, profile_file=None if axis else self.place / f"{name}.yaml")
        out = self.place / f"{name}.mcap"
        out.unlink(missing_ok=True)  # of a run with larger amplitudes
        given = permission(plan.path, plan.axis, plan.model)
        outcome = record_run(plan, open_drive(plan), plan.toggle, out, given)
        if outcome.fault_text is not None:
            raise ValueError(f"run: {outcome.fault_text}")
        return out

    def identify(self, logs: list[Path]) -> bool:
        """As `identify LOG... --out model`, its model alone; whether it asks for more current."""
        self.logs = logs
        facts, records = records_of(logs)
        fit, model = fitted_model(records, facts, IDENTIFIED, FitSettings(compare_literal=False))
        write_model(_made(self.place / IDENTIFIED) / "model.yaml", model)
        return any(doubt.name == "coulomb_nm" for doubt in fit.uncertainty.doubts)

    def model(self) -> Path:
        """The model to tune for: that of `diagnose`, where one was advised and written."""
        found = self.place / DIAGNOSED / "model.yaml"
        return found if found.exists() else self.place / IDENTIFIED / "model.yaml"

    def diagnose_where_advised(self) -> None:
        """As `diagnose --fit LOG... --out diagnosed`, its model alone, where `tune` advises it."""
        from fffo_drive.diagnosis.diagnose import diagnose  # compiles the library

        if not needs_diagnosis(read_model(self.model()), commissioned(self.axis, read_axis(self.axis))):
            return
        facts, records = records_of(self.logs)
        with contextlib.suppress(DataError):
            found = diagnose(records, [], facts)
            if found.model_after is not None:
                self.take_diagnosed(found.model_after)

    def take_diagnosed(self, model: ModelFile) -> None:
        """The model that `diagnose` writes."""
        named = model.model_copy(update={"name": DIAGNOSED})
        write_model(_made(self.place / DIAGNOSED) / "model.yaml", named)

    def know(self, numbers: AxisNumbers, friction: FrictionConfig, period_s: float) -> Path:
        """A model file with these numbers, in place of what the commands would find."""
        declared = read_model(ASSUMED_MODEL)

        def known(value: float) -> Quantity:
            return Quantity(value=value, source="known")

        of_friction = {name: known(getattr(friction, name)) for name in FRICTION}
        model = declared.model_copy(
            update={
                "name": "known",
                "torque_constant_nm_per_a": numbers.torque_constant_nm_per_a,
                "inertia_kg_m2": known(inertia_kg_m2(numbers.inertia_nm_s2_per_rev)),
                "delay_s": known(numbers.delay_s - 0.5 * period_s),  # the hold is the loop's
                "sensor_delay_s": known(numbers.sensor_delay_s),
                "friction": declared.friction.model_copy(update=of_friction),
            }
        )
        write_model(self.place / KNOWN, model)
        return self.place / KNOWN

    def tune(self, model_path: Path | None = None, out: str = TUNED) -> dict[str, Any]:
        """As `tune MODEL --axis AXIS --out tuned`, its axis file alone, and its summary. Raises DocumentError."""
        model_path = model_path or self.model()
        axis, model = read_axis(self.axis), read_model(model_path)
        found, _ = tune_axis(axis, model, Wish(), commissioned(self.axis, axis))
        section = found.section(axis.controller.current_limit_a)
        write_tuned_axis(self.axis, _made(self.place / out), section, model_path)
        self.warnings += found.design.warnings if out == TUNED else ()
        return found.summary()

    def tune_range(self, low_kg_m2: float, high_kg_m2: float) -> None:
        """`tune MODEL --axis AXIS --out ranged --inertia-range LOW HIGH`. Raises RefusedError."""
        ends = (f"{low_kg_m2:.6g}", f"{high_kg_m2:.6g}")
        words = ("--axis", self.axis, "--out", self.place / RANGED, "--inertia-range", *ends, "--json")
        self.warnings += self.typed("tune", self.model(), *words)["warnings"]

    def typed(self, command: str, *words: str | Path) -> dict[str, Any]:
        """Run a command; its JSON object, or an empty one. Raises RefusedError as it ends."""
        return in_this_process(command, *words)

    def delays_s(self) -> tuple[float, float]:
        """Of `commission` and of `identify`, command to measured velocity; nan where there is none that can be read."""
        measured_s, fitted_s = math.nan, math.nan
        if record_path(commissioning_plan(self.axis)).exists():
            measured_s = commissioned(self.axis, read_axis(self.axis)).delay_s or math.nan
        fitted = self.place / IDENTIFIED / "model.yaml"
        if fitted.exists():
            with contextlib.suppress(DocumentError):
                fitted_s = read_model(fitted).delay_s.value
        return measured_s, fitted_s

    def type(self, plant: PlantConfig, torque_constant_nm_per_a: float) -> dict[str, Any]:
        """All of it, from power-on to the tuned file. Raises ValueError, DocumentError where a step refuses."""
        self.new_axis(plant, torque_constant_nm_per_a)
        self.commission()
        if self.identify([self.record(name) for name in PROFILES]):
            replace_file(self.axis, with_line(self.axis, "model", f"{IDENTIFIED}/model.yaml"))
            self.identify([self.record(name, MORE_CURRENT) for name in PROFILES])
        self.diagnose_where_advised()
        return self.tune()


class TypedChain(Chain):
    """The same by the commands themselves, each a process of its own. Raises ValueError where one of them refuses."""

    def commission(self) -> None:
        """`commission AXIS --yes`"""
        record = record_path(commissioning_plan(self.axis))
        try:
            self.typed("commission", self.axis, "--yes")
        except RefusedError:
            if not record.exists():
                raise
        self.judge(read_record(record))  # of a failed check it says more

    def run(self, name: str, axis: Path | None = None) -> Path:
        """`run AXIS --profile FILE --out RUN`, or `run AXIS --out RUN` on another axis file"""
        out = self.place / f"{name}.mcap"
        out.unlink(missing_ok=True)
        profile = [] if axis else ["--profile", self.place / f"{name}.yaml"]
        self.typed("run", axis or self.excited, *profile, "--out", out)
        return out

    def identify(self, logs: list[Path]) -> bool:
        """`identify LOG... --out model`"""
        self.logs = logs
        said = self.typed("identify", *logs, "--out", self.place / IDENTIFIED, "--json")
        return any(doubt["name"] == "coulomb_nm" for doubt in said["doubts"])

    def diagnose_where_advised(self) -> None:
        """`diagnose --fit LOG... --out diagnosed`, where `tune` advises it"""
        if needs_diagnosis(read_model(self.model()), commissioned(self.axis, read_axis(self.axis))):
            with contextlib.suppress(RefusedError):
                self.typed("diagnose", "--fit", *self.logs, "--out", self.place / DIAGNOSED)

    def tune(self, model_path: Path | None = None, out: str = TUNED) -> dict[str, Any]:
        """`tune MODEL --axis AXIS --out tuned`"""
        model = model_path or self.model()
        found = self.typed("tune", model, "--axis", self.axis, "--out", self.place / out, "--json")
        self.warnings += found["warnings"] if out == TUNED else ()
        return found

    def typed(self, command: str, *words: str | Path) -> dict[str, Any]:
        """Run a command in a process of its own."""
        words = (Path(sys.executable).parent / "fffo-drive", command, *words)
        done = subprocess.run(words, capture_output=True, text=True, cwd=self.place)
        return _answer(command, done.returncode, done.stdout, done.stderr, "--json" in words)


class RefusedError(ValueError):
    """A command ended with another exit code than 0."""


def in_this_process(command: str, *words: str | Path) -> dict[str, Any]:
    """Run a command in this process; its JSON object, or an empty one. Raises RefusedError as it ends."""
    said, complained = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
        try:
            code = cli([command, *map(str, words)])
        except SystemExit as error:  # of words that are none of the command's
            code = error.code if isinstance(error.code, int) else 1
    return _answer(command, code, said.getvalue(), complained.getvalue(), "--json" in words)


def tuned_file(axis: Path, model: Path) -> Path:
    """`tune MODEL --axis AXIS --out tuned`: the axis file that it writes, beside the other. Raises RefusedError."""
    out = axis.parent / TUNED
    in_this_process("tune", model, "--axis", axis, "--out", out)
    return out / axis.name


def _answer(command: str, code: int, said: str, complained: str, is_json: bool) -> dict[str, Any]:
    """What a command printed. Raises RefusedError with its last line; RuntimeError for a fault of the program."""
    if code != 0:
        lines = (complained.strip() or said.strip()).splitlines() or [""]
        raise (RuntimeError if TRACEBACK in complained else RefusedError)(f"{command}: {lines[-1]}")
    found: dict[str, Any] = json.loads(said) if is_json else {}
    return found


def records_of(logs: Sequence[Path]) -> tuple[Any, list[Record]]:
    """Facts and records of recordings, as `identify` and `diagnose` take them."""
    facts = facts_for(None, logs)
    return facts, [where_command_acts(record) for record in load_records(logs, facts)]


def _made(directory: Path) -> Path:
    directory.mkdir(parents=True, exist_ok=True)
    return directory


def _plain(value: Any) -> Any:
    """Numbers, lists and mappings, as YAML has them."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value.item() if hasattr(value, "item") else value


def _write(path: Path, data: Any) -> Path:
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path
