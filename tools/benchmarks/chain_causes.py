"""Why the tuned loop of an axis of the chain is not stable or creeps: what tune says, what the axis can do, what
diagnose finds, and the same chain by the present code.

  .venv/bin/python tools/benchmarks/chain_causes.py --rows FILE

Reads the rows that tools/benchmarks/chain.py wrote, and takes each dissipative axis whose tuned loop is not stable or
creeps. The present code was mended with these axes in view: its column is no test. Writes results/chain_causes.md
beside this file.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from chain import (
    MOST_CREEP_COUNTS,
    SCENARIO,
    at_rest_counts,
    declared_nm_per_a,
    read_rows,
    tuned_candidate,
)
from chain_files import Chain, records_of
from common import RESULTS, made_by, progress_bar
from trial_axes.random_axis import wide_axis
from trial_axes.robustness import PLATEAU_S, RAMP_S, SPEEDS_RPS, STABLE, probe, probe_profiles

from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.control.envelope import LIMIT_CONTROLLER, LIMIT_CURRENT
from fffo_drive.diagnosis.diagnose import diagnose
from fffo_drive.documents import DocumentError
from fffo_drive.drive.simulated.parameters import noiseless
from fffo_drive.evaluation.campaign import Candidate, Case, simulate, warm_up
from fffo_drive.evaluation.workers import over_cores
from fffo_drive.identification.dataset import DataError
from fffo_drive.workflows.tune import Tuned

STICK_SLIP = "stick-slip"  # a word of the warning of tune
SETTLED_S = 1.0  # the last of a plateau
REACHED = 0.9  # of a level: below it, and at the limit of the current, the axis cannot go faster
LIMITED_SHARE = 0.9  # of these ticks


class Cause(NamedTuple):
    """Findings on an axis."""

    number: int
    law: str
    effects: tuple[str, ...]
    verdict: str
    creep_counts: float  # in five seconds at rest
    verdict_now: str  # by the present code
    creep_counts_now: float
    stick_slip: str  # speeds in rps that tune warns of; empty: of none
    fastest_rps: float  # at the current limit, where it does not reach a level; nan: nowhere seen
    found: tuple[str, ...]  # effects that diagnose accepts on the runs that identify had
    verdict_diagnosed: str  # of the loop that tune designs for the diagnosed model


def stick_slip_speeds(tuned: Tuned) -> str:
    """The range that tune warns of, as in its message."""
    said = [text for text in tuned.design.warnings if STICK_SLIP in text]
    return said[0].partition(" expect")[0].removeprefix("from ") if said else ""


def fastest_rps(case: Case, candidate: Candidate) -> float:
    """How fast the axis turns at the limit of its current, where it stays below a level of the staircase; else nan."""
    plain, _ = probe_profiles(case.session.loop.period_ns * 1e-9)
    rows, _ = simulate(case._replace(plant=noiseless(case.plant), profile=plain), candidate)
    limited = rows["limits"] & (LIMIT_CONTROLLER | LIMIT_CURRENT) != 0
    time_s = rows["profile_sample"] * plain.period_s
    for number, level_rps in enumerate(SPEEDS_RPS):
        end_s = 0.2 + RAMP_S + (number + 1) * PLATEAU_S - RAMP_S
        inside = (time_s > end_s - SETTLED_S) & (time_s < end_s)
        if not inside.any():
            return math.nan
        mean_rps = float(np.mean(rows["true_velocity_rps"][inside]))
        if mean_rps * np.sign(level_rps) < REACHED * abs(level_rps) and np.mean(limited[inside]) > LIMITED_SHARE:
            return abs(mean_rps)
    return math.nan


def cause_of(job: tuple[int, str, float, Case]) -> Cause:
    """Everything about one axis."""
    number, verdict, creep_counts, case = job
    axis = wide_axis(case.plant, number)
    case = case._replace(plant=axis.plant)
    with TemporaryDirectory(prefix="chain_") as place:
        chain = Chain(Path(place))
        tuned = chain.type(axis.plant, declared_nm_per_a(axis))
        candidate = tuned_candidate(chain)
        accepted: tuple[str, ...] = ()
        try:
            facts, runs = records_of(chain.logs)
            found = diagnose(runs, [], facts)
            accepted = tuple(finding.name for finding in found.findings if finding.accepted)
            after = "nothing found"
            if found.model_after is not None:
                chain.take_diagnosed(found.model_after)
                chain.tune()
                after = probe(case, tuned_candidate(chain)).verdict
        except (DataError, DocumentError) as error:
            after = f"refused: {str(error).splitlines()[0]}"
    return Cause(
        number, axis.law, axis.effects, verdict, creep_counts, probe(case, candidate).verdict,
        at_rest_counts(case, candidate)[0], stick_slip_speeds(tuned), fastest_rps(case, candidate), accepted, after,
    )  # fmt: skip


def table(found: Sequence[Cause], axes: int) -> list[str]:
    """One line for each axis."""
    lines = [
        "# chain_causes",
        "",
        f"The {len(found)} of {axes} random axes on which the tuned loop of the chain (results/chain.md) is not "
        f"stable, or creeps over {MOST_CREEP_COUNTS:g} counts in five seconds. *Now* is the same chain by the present "
        "code, which was mended with these axes in view. Further: the speeds at which tune warns of stick-slip; the "
        "fastest that the axis turns at its current limit, "
        "where the staircase asks for more; the effects that diagnose accepts on the runs that identify had; and the "
        "loop that tune designs for the diagnosed model.",
        "",
        "| axis | friction | effects of the plant | verdict | now | creep, counts | now "
        "| stick-slip warned, rps | fastest, rps "
        "| found by diagnose | loop for the diagnosed model |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for one in found:
        fastest = "–" if math.isnan(one.fastest_rps) else f"{one.fastest_rps:.2g}"
        lines.append(
            f"| {one.number} | {one.law} | {', '.join(one.effects)} | {one.verdict} | {one.verdict_now} "
            f"| {one.creep_counts:.2g} | {one.creep_counts_now:.2g} | {one.stick_slip or 'none'} "
            f"| {fastest} | {', '.join(one.found) or 'none'} | {one.verdict_diagnosed} |"
        )
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Look at every axis that failed, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=Path, required=True, help="of chain.py (JSON lines)")
    options = parser.parse_args(arguments)
    rows = sorted(read_rows(options.rows), key=lambda one: one.number)
    case = case_of(read_scenario(SCENARIO), 1)
    warm_up(case)
    moved = [one for one in rows if one.passive and not one.refused]
    failed = [one for one in moved if one.verdict != STABLE or one.creep_counts > MOST_CREEP_COUNTS]
    jobs = [(one.number, one.verdict, one.creep_counts, case) for one in failed]
    with progress_bar("axes") as progress:
        share = None if progress is None else (lambda done: progress(done / len(jobs)))
        found = over_cores(cause_of, jobs, progress=share)
    lines = table(found, len(rows))
    lines += ["", made_by("chain_causes.py")]
    (RESULTS / "chain_causes.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
