"""Comparison of the controllers of a scenario, over seeds on the simulated drive in process."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from ..config.axis import controller_config
from ..config.scenario import Scenario, case_of, cases_of, select_controllers
from ..control.friction_observer import TOGGLE_OFF
from ..control.own_law import ControlLaw, require_law
from ..documents import DocumentError
from ..evaluation.campaign import Candidate, Evaluation, run_campaign, run_case, warm_up
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


def run_own_laws(scenario: Scenario, laws: Sequence[ControlLaw]) -> list[Evaluation]:
    """Laws of a user's own on every seed, in threads of this process, which knows them. Raises DocumentError."""
    for law in laws:
        require_law("laws", law)
    names = [*scenario.file.controllers, *(law.name for law in laws)]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise DocumentError(f"laws: two controllers are called {twice!r}: give each a name of its own")
    if not laws:
        return []
    axis = controller_config(scenario.axis, scenario.model)
    candidates = tuple(Candidate(law.name, TOGGLE_OFF, axis, law) for law in laws)
    warm_up(case_of(scenario, scenario.file.first_seed))
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as cores:
        cases = (case_of(scenario, seed)._replace(candidates=candidates) for seed in scenario.seeds)
        return [evaluation for found in cores.map(run_case, cases) for evaluation in found]


def evaluate(scenario: Scenario, workers: int | None = None, laws: Sequence[ControlLaw] = ()) -> Summary:
    """Figures of every controller, and of laws of a user's own, with intervals over the seeds.

    Raises ValueError if no seed is complete.
    """
    found = run_own_laws(scenario, laws)  # first: an error in one is seen at once
    return summarise([*run_seeds(scenario, workers), *found], scenario.file.percent_of)
