"""Results of a comparison as figures by name, each with an interval over seeds for every controller."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from ..documents import finite
from .campaign import Evaluation
from .compare import MetricComparison, compare_metric
from .measures import Measures, VelocityMeasures


class Summary(NamedTuple):
    """Result of a comparison."""

    controllers: tuple[str, ...]
    seeds: tuple[int, ...]  # on which every controller ran to the end
    figures: dict[str, MetricComparison]  # by the names of `figures_of`
    histograms: dict[str, dict[str, np.ndarray[Any, np.dtype[np.int64]]]]  # measured or true -> controller -> counts
    failures: tuple[str, ...]  # CONTROLLER, seed N: reason; such seeds are excluded for all controllers

    def figure(self, name: str, controller: str) -> float:
        """The mean of a figure."""
        return self.figures[name].absolute[controller].value


def figures_of(measures: Measures) -> dict[str, float]:
    """All numbers of a run by dotted name: measured.ise, true.band2.mae, true.lag.mean_absolute_ms, effort.rms_a."""
    found = dict(_of_velocity("measured", measures.measured))
    if measures.true is not None:
        found.update(_of_velocity("true", measures.true))
    found.update({f"effort.{key}": value for key, value in measures.effort._asdict().items()})
    return found


def _of_velocity(kind: str, measures: VelocityMeasures) -> Iterator[tuple[str, float]]:
    parts: dict[str, Any] = {
        kind: measures.error,
        **{f"{kind}.band{number}": band for number, band in enumerate(measures.bands)},
        **{f"{kind}.{name}": getattr(measures, name) for name in ("reversals", "settled", "lag", "crossing")},
    }
    for name, part in parts.items():
        for key, value in part._asdict().items():
            yield f"{name}.{key}", float(value)


def summarise(evaluations: Iterable[Evaluation], percent_of: str | None = None) -> Summary:
    """Summary of runs with the same seeds for each controller. Raises ValueError if no seed is complete.

    `percent_of`: the controller that is 100 % (None: the smallest of each figure).
    """
    runs = list(evaluations)
    failures = tuple(f"{run.candidate}, seed {run.seed}: {run.fault_text}" for run in runs if run.fault_text)
    by_controller: dict[str, dict[int, Measures]] = {}
    for run in runs:
        kept = by_controller.setdefault(run.candidate, {})
        if run.measures is not None and run.fault_text is None:
            kept[run.seed] = run.measures
    whole = sorted(set.intersection(*(set(kept) for kept in by_controller.values()))) if by_controller else []
    if not whole:
        raise ValueError("no seed on which every controller ran to its end" + "".join(f"\n  {f}" for f in failures))
    numbers = {name: [figures_of(kept[seed]) for seed in whole] for name, kept in by_controller.items()}
    names = [
        name for name in next(iter(numbers.values()))[0] if all(name in run for own in numbers.values() for run in own)
    ]
    figures = {}
    for name in names:
        values = {controller: np.array([run[name] for run in own]) for controller, own in numbers.items()}
        if all(np.isfinite(own).all() for own in values.values()):
            figures[name] = compare_metric(values, percent_of)
    return Summary(tuple(by_controller), tuple(whole), figures, _histograms(by_controller, whole), failures)


def _histograms(
    by_controller: dict[str, dict[int, Measures]], seeds: list[int]
) -> dict[str, dict[str, np.ndarray[Any, np.dtype[np.int64]]]]:
    found: dict[str, dict[str, np.ndarray[Any, np.dtype[np.int64]]]] = {}
    for kind in ("measured", "true"):
        for controller, kept in by_controller.items():
            counts = [getattr(kept[seed], kind) for seed in seeds]
            if all(one is not None for one in counts):
                found.setdefault(kind, {})[controller] = np.sum([one.histogram for one in counts], axis=0)
    return found


def as_object(summary: Summary) -> dict[str, Any]:
    """For programs: every figure with value, interval and per cent; numbers that are not known are null."""
    return {
        "controllers": list(summary.controllers),
        "seeds": list(summary.seeds),
        "failures": list(summary.failures),
        "figures": {
            name: {
                "percent_of": comparison.base,
                **{
                    controller: {
                        "value": finite(comparison.absolute[controller].value),
                        "interval": [finite(end) for end in comparison.absolute[controller][1:]],
                        "percent": finite(comparison.percent[controller].value),
                        "percent_interval": [finite(end) for end in comparison.percent[controller][1:]],
                    }
                    for controller in summary.controllers
                },
            }
            for name, comparison in summary.figures.items()
        },
    }
