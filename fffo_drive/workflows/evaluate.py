"""Comparison of the controllers of a scenario, over seeds on the simulated drive in process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from ..config.scenario import Scenario, case_of, cases_of, select_controllers
from ..documents import DocumentError
from ..evaluation.campaign import Evaluation, run_campaign
from ..evaluation.summary import Summary, summarise
from ..evaluation.workers import over_cores


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


def run_published(
    scenario: Scenario, workers: int | None = None, progress: Callable[[float], None] | None = None
) -> tuple[list[Evaluation], tuple[float, ...]]:
    """Plain and published laws and the drive's own loop on every seed, with the margins of the scenario's pi+fffo+.

    And the share of the friction that each of their models leaves: 2SEP, LuGre, GMS. Raises DocumentError.
    """
    from ..evaluation.peers.campaign import FIT_SEED, fitted_models, run_peers  # compiles the laws

    mismatch = scenario.file.mismatch
    sign = {"high": 1.0, "low": -1.0}.get(mismatch.signs)
    count = None if progress is None else lambda cases: progress(cases / scenario.file.seeds)
    try:
        fitted = fitted_models(case_of(scenario, FIT_SEED))
        one = partial(run_peers, models=fitted.models, mismatch_share=mismatch.friction_share, sign=sign)
        found = over_cores(one, cases_of(scenario), workers, count)
    except ValueError as error:
        raise DocumentError(f"{scenario.path}: {error}") from None
    return [evaluation for evaluations in found for evaluation in evaluations], fitted.left


def evaluate(scenario: Scenario, workers: int | None = None) -> Summary:
    """Figures of every controller with intervals over the seeds. Raises ValueError if no seed is complete."""
    return summarise(run_seeds(scenario, workers), scenario.file.percent_of)
