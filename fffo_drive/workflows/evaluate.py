"""Comparison of the controllers of a scenario, over seeds on the simulated drive in process."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..config.scenario import Scenario, cases_of, select_controllers
from ..documents import DocumentError
from ..evaluation.campaign import Evaluation, run_campaign
from ..evaluation.summary import Summary, summarise


def narrowed(scenario: Scenario, controllers: Sequence[str] | None = None, seeds: int | None = None) -> Scenario:
    """The scenario with some of its controllers and another number of seeds. Raises DocumentError."""
    if seeds is not None:
        if seeds < 1:
            raise DocumentError(f"{scenario.path}: seeds: {seeds}: at least 1 is needed")
        scenario = scenario._replace(file=scenario.file.model_copy(update={"seeds": seeds}))
    return select_controllers(scenario, list(controllers)) if controllers else scenario


def run_seeds(
    scenario: Scenario, workers: int | None = None, progress: Callable[[float], None] | None = None
) -> list[Evaluation]:
    """Every controller on every seed; `progress` gets the share done."""
    count = None if progress is None else lambda cases: progress(cases / scenario.file.seeds)
    return run_campaign(cases_of(scenario), workers, count)


def evaluate(scenario: Scenario, workers: int | None = None) -> Summary:
    """Figures of every controller with intervals over the seeds. Raises ValueError if no seed is complete."""
    return summarise(run_seeds(scenario, workers), scenario.file.percent_of)
