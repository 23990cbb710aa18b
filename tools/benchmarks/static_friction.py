"""How far Fs may lie above the friction that acted in the logs: what bounds it in `identify`.

  .venv/bin/python tools/benchmarks/static_friction.py [--axes N] [--first NUMBER]

On random axes, excited as in the chain (chain.py): true Fs over the largest friction torque in the logs, and the Fs of
a fit over the true one, with the bound and without. The chain's table shows what the bound does to the loop.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from chain import REFUSALS, SCENARIO, declared_nm_per_a
from chain_files import PROFILES, Chain, records_of
from common import RESULTS, made_by, progress_bar
from trial_axes.random_axis import wide_axis

from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.evaluation.campaign import Case, warm_up
from fffo_drive.evaluation.workers import over_cores
from fffo_drive.identification import fit as fitting

FIRST = 7300
SHARES = (0.05, 0.5, 0.9, 0.95, 0.99, 1.0)


class Job(NamedTuple):
    """An axis, and the scenario's case."""

    number: int
    case: Case


class StaticFriction(NamedTuple):
    """Ratios on one axis; nan where there is no fit."""

    true_over_seen: float
    fitted_over_true: float
    unbounded_over_true: float


def run_job(job: Job) -> StaticFriction:
    """One axis."""
    axis = wide_axis(job.case.plant, job.number)
    true_nm = axis.plant.friction.stiction_nm
    fitted = []
    with TemporaryDirectory(prefix="chain_") as place:
        chain = Chain(Path(place))
        chain.new_axis(axis.plant, declared_nm_per_a(axis))
        try:
            chain.commission()
            facts, records = records_of([chain.record(name) for name in PROFILES])
            for most in (fitting.MOST_STATIC, math.inf):
                with patch.object(fitting, "MOST_STATIC", most):
                    fitted.append(fitting.fit_records(records, fitting.FitSettings(compare_literal=False), facts))
        except REFUSALS:
            return StaticFriction(math.nan, math.nan, math.nan)
    bounded, free = (fit.value("static_nm") / true_nm for fit in fitted)
    return StaticFriction(true_nm / fitted[0].start.most_friction_nm, bounded, free)


def table(found: Sequence[StaticFriction]) -> list[str]:
    """Quantiles of the ratios."""
    lines = ["| ratio | " + " | ".join(f"{share:.0%}" for share in SHARES) + " |", "|---|" + "---|" * len(SHARES)]
    values = np.array(found)
    values = values[np.isfinite(values).all(axis=1)]
    names = (
        "true Fs over the largest friction torque in the logs",
        f"fitted Fs over the true one, at most {fitting.MOST_STATIC:g} times that torque",
        "fitted Fs over the true one, not bounded",
    )
    for name, column in zip(names, values.T, strict=True):
        lines.append(f"| {name} | " + " | ".join(f"{q:.3g}" for q in np.quantile(column, SHARES)) + " |")
    beyond = int(np.sum(values[:, 0] > fitting.MOST_STATIC))
    stands = int(np.sum(values[:, 1] < 0.999 * values[:, 2]))
    said = f"On {beyond} the true Fs is beyond the bound; on {stands} the bound lowers the fit."
    return [*lines, "", f"{len(found)} axes, {len(values)} fitted. {said}"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", type=int, default=200)
    parser.add_argument("--first", type=int, default=FIRST, help="number of the first random axis")
    parser.add_argument("--out", type=Path, default=RESULTS / "static_friction.md")
    options = parser.parse_args(arguments)
    case = case_of(read_scenario(SCENARIO), 1)
    warm_up(case)
    jobs = [Job(number, case) for number in range(options.first, options.first + options.axes)]
    with progress_bar("axes") as progress:
        done = (lambda count: progress(count / len(jobs))) if progress is not None else None
        found = over_cores(run_job, jobs, progress=done)
    lines = ["# static_friction", "", *table(found), ""]
    lines.append(made_by("static_friction.py"))
    options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
