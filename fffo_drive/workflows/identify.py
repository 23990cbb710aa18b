"""Logs of one axis to a model: the fit with its uncertainties, its residuals, and what the logs cover."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..identification.coverage import Coverage, coverage_of
from ..identification.cyclic import CyclicError, cyclic_error
from ..identification.dataset import Record, where_command_acts
from ..identification.facts import DriveFacts
from ..identification.fit import Fit, FitSettings, Progress, fit_records
from ..identification.population import AgainstPopulation, with_population
from ..identification.residuals import RunResidual
from ..identification.results import model_file, report
from ..model.parameters import ModelFile
from .progress import Share

FIT_SHARE = 0.85  # of the total time


@dataclass(frozen=True)
class Identified:
    """Result of `identify`."""

    model: ModelFile
    fit: Fit
    residuals: list[RunResidual]
    coverage: Coverage
    cyclic: CyclicError | None  # of the sensor, where the logs show one
    result: dict[str, Any]  # JSON-ready: parameters with intervals, effects, doubts, warnings

    def __repr__(self) -> str:
        fitted = self._fitted()
        said = ", ".join(f"{row['symbol']} {row['value']:.4g} {row['unit']}" for row in fitted[:3])
        doubts = ", ".join(doubt["symbol"] for doubt in self.result["doubts"])
        unknown = f"; not determined: {doubts}" if doubts else ""
        return f"Identified({self.model.name!r}: {said} and {len(fitted) - 3} more{unknown})"

    def _repr_html_(self) -> str:
        cells = [
            (row["symbol"], f"{row['value']:.5g}", "" if row["sd"] is None else f"{row['sd']:.2g}", row["unit"])
            for row in self._fitted()
        ]
        rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in cells)
        return f"<table><tr><th>parameter</th><th>value</th><th>sd</th><th>unit</th></tr>{rows}</table>"

    def _fitted(self) -> list[dict[str, Any]]:
        return [row for row in self.result["parameters"] if row["fitted"]]


def fitted_model(
    records: Sequence[Record],
    facts: DriveFacts,
    name: str,
    settings: FitSettings | None = None,
    progress: Progress | None = None,
) -> tuple[Fit, ModelFile]:
    """The fit of records, from `where_command_acts`, and the model as `identify` writes it. Raises DataError."""
    fit = fit_records(records, settings or FitSettings(), facts, progress)
    return fit, model_file(fit, records, name, facts.units)


def identify(
    records: Sequence[Record], facts: DriveFacts, name: str, progress: Share | None = None,
    prior: AgainstPopulation | None = None,
) -> Identified:  # fmt: skip
    """Fit a model to records of one axis. Raises DataError for logs that allow no fit.

    `prior`: these records against the population of the drive's model, which supplies what they determine poorly;
    `result["parameters"]` is the fit of the records alone.
    """
    part = None if progress is None else lambda share, step: progress(FIT_SHARE * share, step)
    records = [where_command_acts(record) for record in records]
    fit, model = fitted_model(records, facts, name, progress=part)
    coverage = coverage_of(records)
    cyclic = cyclic_error(records)
    result = report(fit, records, facts) | {"coverage": coverage._asdict()}
    if cyclic is not None:
        result["cyclic_error"] = cyclic.as_plain()
    if prior is not None:
        result["prior"] = prior.as_plain()
        model = with_population(model, fit, prior)
        if prior.other_population:
            result["warnings"].append(prior.sentence())
    return Identified(model, fit, list(fit.runs), coverage, cyclic, result)
