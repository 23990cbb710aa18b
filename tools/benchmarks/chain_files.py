"""The chain on one simulated axis as a user types it, in one process: every file is written by the function that the
command writes it with (commission, run, identify, diagnose, tune), and the tuned axis file is what is run.

What a user of a new axis has: the drive, its torque constant, and a first axis file as `bring-up` drafts it. Nothing
here chooses a key of the law.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml
from common import ROOT

from fffo_drive.config.axis import hold_dead_band_rev, loop_axis, read_axis
from fffo_drive.config.axis_text import replace_file, with_line
from fffo_drive.config.commissioning import commissioned, permission
from fffo_drive.documents import DocumentError, parse, read_text
from fffo_drive.drive.simulated.parameters import PlantConfig
from fffo_drive.identification.dataset import DataError, Record, load_records, where_command_acts
from fffo_drive.identification.fit import FitSettings
from fffo_drive.identification.tuning import Wish
from fffo_drive.model.parameters import ModelFile, read_model, write_model
from fffo_drive.workflows.axis_draft import first_law
from fffo_drive.workflows.commission import bounds_of, commission_axis, commissioning_plan, record_path
from fffo_drive.workflows.identify import fitted_model
from fffo_drive.workflows.plan import make_plan, open_drive
from fffo_drive.workflows.record import record_run
from fffo_drive.workflows.recorded_facts import facts_for
from fffo_drive.workflows.tune import Tuned, needs_diagnosis, tune, write_tuned_axis

CONFIGS = ROOT / "configs"
EXAMPLE = CONFIGS / "axis_simulated.yaml"
ASSUMED_MODEL = CONFIGS / "models" / "table1.yaml"
AXIS, DRIVE, MODEL = "axis.yaml", "simulated_drive.yaml", "assumed.yaml"
IDENTIFIED, DIAGNOSED, TUNED = "model", "diagnosed", "tuned"  # directories
PROFILES = {  # what is recorded, with the torque constant of the nominal axis
    "chirp": {"kind": "identify", "duration_s": 40, "low_a": 0.3, "high_a": 1.1, "lowest_hz": 0.01, "highest_hz": 10},
    "sweep": {"kind": "frf", "duration_s": 30, "amplitude_a": 0.8, "lowest_hz": 0.1, "highest_hz": 50},
}
LOWER, MOST_STEPS = 0.8, 12  # of the amplitudes, while they are refused
AMPLITUDES = ("low_a", "high_a", "amplitude_a")
NOMINAL_NM_PER_A = 0.148
MORE_CURRENT = 2.0  # times as much where `identify` asks for it: axes 8369 and 8764 moved in 4 and 2 % of the chirp


class Chain:
    """The files of one axis in a directory."""

    def __init__(self, place: Path) -> None:
        self.place = place
        self.axis = place / AXIS
        self.logs: list[Path] = []  # that the model is from

    @property
    def tuned(self) -> Path:
        """The axis file that `tune` writes."""
        return self.place / TUNED / AXIS

    def new_axis(self, plant: PlantConfig, torque_constant_nm_per_a: float) -> None:
        """A first axis file, with the torque constant of the data sheet; inertia and delay are assumed."""
        drive, _ = parse(read_text(CONFIGS / DRIVE), DRIVE)
        _write(self.place / DRIVE, {**drive, "plant": _plain(asdict(plant))})
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

    def commission(self) -> None:
        """As `commission AXIS --yes`. Raises ValueError where it does not pass."""
        plan = commissioning_plan(self.axis)
        record = commission_axis(plan, bounds_of(plan), record_path(plan))
        failed = [check for check in record.checks if check.verdict == "failed"]
        if failed:
            raise ValueError(f"commission: {failed[0].name}: {failed[0].text}")

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
                return self.run(name)
            except (DocumentError, ValueError) as error:
                refusal = error
        assert refusal is not None
        raise refusal

    def run(self, name: str) -> Path:
        """As `run AXIS --profile FILE --out RUN`. Raises DocumentError; ValueError for a run that ends with a fault."""
        plan = make_plan(self.axis, profile_file=self.place / f"{name}.yaml")
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

    def tune(self) -> Tuned:
        """As `tune MODEL --axis AXIS --out tuned`, its axis file alone. Raises DocumentError."""
        axis, model = read_axis(self.axis), read_model(self.model())
        measured = commissioned(self.axis, axis)
        found = tune(model, loop_axis(axis, model), Wish(), measured, hold_dead_band_rev(axis))
        section = found.section(axis.controller.current_limit_a)
        write_tuned_axis(self.axis, _made(self.place / TUNED), section, self.model())
        return found

    def delays_s(self) -> tuple[float, float]:
        """Of `commission` and of `identify`, command to measured velocity; nan where the chain ended before."""
        measured_s, fitted_s = math.nan, math.nan
        if record_path(commissioning_plan(self.axis)).exists():
            measured_s = commissioned(self.axis, read_axis(self.axis)).delay_s or math.nan
        fitted = self.place / IDENTIFIED / "model.yaml"
        if fitted.exists():
            fitted_s = read_model(fitted).delay_s.value
        return measured_s, fitted_s

    def type(self, plant: PlantConfig, torque_constant_nm_per_a: float) -> Tuned:
        """All of it, from power-on to the tuned file. Raises ValueError, DocumentError where a step refuses."""
        self.new_axis(plant, torque_constant_nm_per_a)
        self.commission()
        if self.identify([self.record(name) for name in PROFILES]):
            replace_file(self.axis, with_line(self.axis, "model", f"{IDENTIFIED}/model.yaml"))
            self.identify([self.record(name, MORE_CURRENT) for name in PROFILES])
        self.diagnose_where_advised()
        return self.tune()


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
