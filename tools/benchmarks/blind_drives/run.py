"""Hand blind drives to the diagnosis, which sees a folder of logs and nothing else, and keep what it says.

Each report is a file, so that an interrupted run resumes. Beside it is the
floor: the held-out torque error of the base model on the twin of the drive, simulated without the effects under the
same noise. An oracle that knows the true effects leaves no less than that.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from engine import diagnosed, write_answer
from pydantic import TypeAdapter

from fffo_drive.drive.simulated.parameters import PlantConfig
from fffo_drive.identification.dataset import Record, load_records
from fffo_drive.identification.facts import DriveFacts, read_facts

from .draw import chirp_current_a, gains_of
from .generate import DECIMALS, BlindDrive
from .profiles import HELD_OUT, PERIOD_S, profiles
from .simulate import Run

FITTED = ("identify", "track", "recipe")


def diagnose_folder(folder: Path, answer: Path, without: Iterable[str] = (), ablate: Iterable[str] = ()) -> None:
    """Diagnose one drive by its logs and declared facts; the report goes to `answer`. An answer that exists is kept."""
    if answer.exists():
        return
    fit, held_out, facts = records_of(folder)
    write_answer(answer, diagnosed(fit, held_out, facts, without, ablate))


def records_of(folder: Path) -> tuple[list[Record], list[Record], DriveFacts]:
    """The runs that are fitted, the held-out ones, and the declared facts of a drive."""
    facts = read_facts(folder / "drive.yaml")
    fit = load_records([folder / f"{name}.csv.gz" for name in FITTED], facts)
    return fit, load_records([folder / f"{HELD_OUT}.csv.gz"], facts), facts


def floor_of(truth_path: Path, answer: Path) -> None:
    """Held-out torque error (rms, Nm) of the base model on the twin without effects, to `answer`."""
    if answer.exists():
        return
    truth = json.loads(truth_path.read_text())
    drive = drive_from_truth(truth)
    facts = DriveFacts.model_validate(drive.facts())
    records = {run.profile.name: record_of(run, facts) for run in drive.runs(with_effects=False)}
    write_answer(answer, {"torque_rms_nm": base_rms_nm([records[name] for name in FITTED], [records[HELD_OUT]], facts)})


def base_rms_nm(fit: list[Record], held_out: list[Record], facts: DriveFacts) -> float:
    """Torque error of the base model alone on held-out runs: the `before` of a diagnosis without effects."""
    from fffo_drive.diagnosis.diagnose import DiagnosisSettings, filter_for, prepared
    from fffo_drive.diagnosis.proof import data_of, with_own_datum
    from fffo_drive.diagnosis.scored import base_of, settled

    filter_ = filter_for(fit, facts, DiagnosisSettings())
    base = settled(data := prepared(fit, facts, filter_)[0], base_of(data))[1].fitted
    data = data_of(held_out, filter_, base.physical)
    left_nm = with_own_datum(data, base)[0].residual_nm[data.rows.kept]
    return float(np.sqrt(np.mean(left_nm**2)))


def drive_from_truth(truth: dict[str, Any]) -> BlindDrive:
    """The drive again from its file of truth, without finding strengths anew."""
    effects = [{"name": effect["name"], "parameters": effect["parameters"]} for effect in truth["effects"]]
    plant = TypeAdapter(PlantConfig).validate_python(truth["plant"] | {"effects": effects})
    seed = int(truth["seed"])
    return BlindDrive(seed, plant, gains_of(plant), profiles(seed, chirp_current_a(plant)), ())


def record_of(run: Run, facts: DriveFacts) -> Record:
    """A run as the logs would give it, in memory."""
    columns = {name: np.round(values, DECIMALS[name]) for name, values in run.columns.items()}
    return Record(
        name=run.profile.name,
        path=Path(run.profile.name),
        period_s=PERIOD_S,
        torque_constant_nm_per_a=facts.torque_constant_nm_per_a,
        current_a=np.ascontiguousarray(columns["current_command_a"]),
        position_rev=columns["position_rev"],
        velocity_rps=columns["velocity_rps"],
        reference_rps=columns.get("reference_rps"),
        lsb_rev=facts.lsb_rev or 2.0**-15,
        breaks=(),
        digest="",
        measured_current_a=columns["current_a"],
        begin_s=run.profile.begin_s,
    )
