"""Put a diagnosed model in service on an axis: the gates, and the change of the axis file when all of them pass."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from ..config.adoption import (
    Adoption,
    Gate,
    gates,
    put_in_service,
    read_report,
    refused_effects,
    require_model,
    require_other_model,
)
from ..config.axis import AxisFile, model_of
from ..model.parameters import read_model


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
