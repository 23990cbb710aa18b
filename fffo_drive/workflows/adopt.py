"""Put a diagnosed model in service on an axis if all gates pass: the axis file, its history, and the roll-back."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from .. import formats
from ..config.adoption import Adoption, History, history_path, read_history, write_history
from ..config.axis import AxisFile, beside, model_of, read_axis
from ..config.axis_text import replace_file, with_line
from ..documents import DocumentError, load_json, up_to_date
from ..formats import kind_of
from ..model.parameters import content_hash, read_model
from .adoption_gates import NOTHING_CARRIES_OVER, Gate, gates, refused_effects


class Adopted(NamedTuple):
    """Result of an adoption."""

    gates: tuple[Gate, ...]
    entry: Adoption | None  # of the axis' history; None where the model was not put in service
    refused_effects: tuple[str, ...]  # that would have to be left out of service

    def __repr__(self) -> str:
        against = ", ".join(gate.name for gate in self.gates if not gate.passed)
        state = f"refused by {against}" if against else "in service" if self.entry is not None else "not yet in service"
        return f"Adopted({state}; {len(self.gates)} gates)"

    @property
    def passed(self) -> bool:
        """True if no gate refuses the model."""
        return all(gate.passed for gate in self.gates)


def adopt(
    axis_path: Path, axis: AxisFile, model_path: Path, report_path: Path | None = None, torque_on: bool | None = None,
    dry_run: bool = False,
) -> Adopted:  # fmt: skip
    """Put a model in service when all gates pass; with `dry_run` only look.

    `report_path`: the diagnosis' report.json (None: beside the model). `torque_on`: reported by the axis' daemon; None
    if none answers. Raises DocumentError for files that are missing, damaged or of another axis.
    """
    require_model(model_path)
    model = read_model(model_path)
    require_other_model(axis_path, axis, model_path)
    found = gates(axis, model_of(axis_path, axis), model, read_report(model_path, report_path), torque_on)
    entry = None
    if all(gate.passed for gate in found) and not dry_run:
        entry = put_in_service(axis_path, model_path, found)
    return Adopted(tuple(found), entry, tuple(refused_effects(model, found)))


def read_report(model_path: Path, given: Path | None) -> dict[str, Any] | None:
    """The report of the diagnosis that wrote the model: given, or beside it. Raises DocumentError if it is damaged."""
    path = given or model_path.parent / "report.json"
    if not path.exists():
        if given is not None:
            raise DocumentError(f"{given}: cannot be read: no such file")
        return None
    found = load_json(path)
    if given is None and kind_of(found) != formats.DIAGNOSIS.kind:
        return None
    return dict(up_to_date(found, formats.DIAGNOSIS.kind, str(path)))


def require_model(model_path: Path) -> None:
    """Raise DocumentError with the diagnosis' own reason where it wrote no model."""
    report = None if model_path.exists() else read_report(model_path, None)
    if report is not None and report.get("verdict") == NOTHING_CARRIES_OVER:
        raise DocumentError(f"{model_path}: the diagnosis wrote no model: {report['headline']}")


def require_other_model(axis_path: Path, axis: AxisFile, model_path: Path) -> None:
    """Raise DocumentError for the model that the axis file names already: there would be no way back."""
    if beside(axis_path, axis.model).resolve() == model_path.resolve():
        raise DocumentError(f"{model_path}: is already in service: {axis_path} names it")


def put_in_service(axis_path: Path, model_path: Path, passed: list[Gate]) -> Adoption:
    """Name the model in the axis file, and keep the former one in the history. Raises DocumentError, OSError."""
    axis = read_axis(axis_path)
    require_other_model(axis_path, axis, model_path)
    name = os.path.relpath(model_path.resolve(), axis_path.resolve().parent)
    entry = Adoption(
        date=datetime.now(UTC).isoformat(timespec="seconds"), model=name,
        model_hash=content_hash(read_model(model_path)), former=axis.model,
        gates=[f"{gate.name}: {gate.text}" for gate in passed],
    )  # fmt: skip
    history = read_history(axis_path)
    text = with_line(axis_path, "model", name)  # refused before anything is written
    write_history(axis_path, History(adoptions=[*history.adoptions, entry]))
    replace_file(axis_path, text)
    return entry


def roll_back(axis_path: Path) -> Adoption:
    """Name the former model again. Raises DocumentError where nothing was adopted, or the file was edited since."""
    history = read_history(axis_path)
    if not history.adoptions:
        raise DocumentError(f"{axis_path}: nothing was adopted on this axis: {history_path(axis_path)} has no entry")
    last = history.adoptions[-1]
    axis = read_axis(axis_path)
    if axis.model != last.model:
        raise DocumentError(
            f"{axis_path}: model: names {axis.model}, not the adopted {last.model}: the file was edited since"
        )
    read_model(beside(axis_path, last.former))
    replace_file(axis_path, with_line(axis_path, "model", last.former))
    write_history(axis_path, History(adoptions=history.adoptions[:-1]))
    return last
