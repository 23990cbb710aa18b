"""The chain from commissioning to a tuned run on random axes: commission, excite, identify, tune, run; at rest too.

Where `commission` warns that the axis is no single rigid inertia, `diagnose` comes before `tune`, as both advise.

  .venv/bin/python tools/benchmarks/chain.py [--axes N] [--first NUMBER] [--rows FILE]

Each axis has every number, its delay and its noise spread by half, one of five friction laws, one to three effects, a
resolver or an encoder (tools/trial_axes/random_axis.wide_axis). Axes that no controller can bring to rest are
counted apart (tools/trial_axes/passivity). The chain gets only the torque constant, 5 % wrong:
`commission` begins with an assumed inertia and delay; `tune` designs for the longer of its delay and the fitted one.
Every file is written by the function that the command writes it with (chain_files.py), and the axis file that `tune`
writes is run as it is.

A thousand axes take over an hour. With `--rows` the results are saved after every batch, and the same command resumes
after an interruption. The table names the commits that the rows were measured at.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from chain_files import Chain
from common import RESULTS, ROOT, commit, made_by, progress_bar
from trial_axes.passivity import comes_to_rest
from trial_axes.random_axis import RandomAxis, wide_axis
from trial_axes.robustness import CYCLE, HUNTING, STABLE, TRIPPED, UNSTABLE, probe

from fffo_drive.arrays import Floats
from fffo_drive.config.axis import TOGGLES, controller_config, model_of, read_axis
from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.control.envelope import TRIP_NONE
from fffo_drive.control.position_hold import NO_HOLD
from fffo_drive.control.reference import MODE_VELOCITY, piecewise_linear
from fffo_drive.documents import DocumentError
from fffo_drive.evaluation.campaign import Candidate, Case, simulate, warm_up
from fffo_drive.evaluation.workers import over_cores

SCENARIO = ROOT / "configs" / "scenarios" / "paper.yaml"
FRESH = 3000  # no choice was made on axes from here on
TORQUE_CONSTANT_SHARE = 0.05  # by which the data sheet is wrong, with a random sign
REST_S = 6.8
CREEP_FROM_S, CREEP_TO_S = 0.7, 5.7  # after the stop: five seconds, when the contact has unloaded
# over which a position is averaged, with the weights of a Hann window: a periodic disturbance is no creep. One of
# 7.3 Hz shook axis 7003 by 37 counts to each side, and the plain mean over 0.2 s, 1.46 periods, left 6 of them
CREEP_MEAN_S = 1.0
MOST_CREEP_COUNTS = 5.0  # of a 15-bit resolver
MOST_SWING_COUNTS = 20.0  # shaken by its own effects, an axis at rest swings by some counts
SWING_S = 2.0  # the last of the rest: a contact that rings is no creep, and a mean over its periods hides it
COUNTS_PER_REV = 2.0**15
CRASHED = "crashed"
BATCH_AXES = 10  # between two writes of the rows


class Outcome(NamedTuple):
    """Result for an axis."""

    number: int
    law: str
    effects: tuple[str, ...]
    passive: bool
    refused: str  # why the chain gave no gains; empty when it did
    verdict: str  # of trial_axes.robustness, with the tuned gains
    nominal: str  # ... with those of the scenario
    creep_counts: float  # nan where it was not run
    nominal_creep_counts: float
    unheld: str  # verdict with the tuned gains, the position not held at rest
    unheld_creep_counts: float
    phase_deg: float  # margin of the design
    rest_share: float
    seconds: float
    commissioned_delay_s: float  # less what is true; nan where the chain ended before
    fitted_delay_s: float  # ... of identify
    commit: str  # that it was measured at
    swing_counts: float = math.nan  # peak to peak at rest; nan in rows of earlier code as well


class Job(NamedTuple):
    """An axis and the scenario's case."""

    axis: RandomAxis
    case: Case


def declared_nm_per_a(axis: RandomAxis) -> float:
    """The torque constant of the data sheet."""
    wrong = float(np.random.default_rng([axis.number, 0xC]).choice((-1.0, 1.0))) * TORQUE_CONSTANT_SHARE
    return axis.plant.torque_constant_nm_per_a * (1.0 + wrong)


def tuned_candidate(chain: Chain) -> Candidate:
    """What `run` makes of the axis file that `tune` wrote."""
    axis = read_axis(chain.tuned)
    return Candidate(
        "tuned", TOGGLES[axis.controller.observer.toggle], controller_config(axis, model_of(chain.tuned, axis))
    )


def at_rest_counts(case: Case, candidate: Candidate) -> tuple[float, float]:
    """How far the shaft goes in five seconds at rest, and how far it swings in the last `SWING_S`; counts of 15 bits,
    nan where the envelope tripped.
    """
    period_s = case.session.loop.period_ns * 1e-9
    times_s = np.array([0.0, 0.2, 0.3, 1.5, 1.6, 1.6 + REST_S])
    profile = piecewise_linear("stop", MODE_VELOCITY, period_s, times_s, np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0]))
    rows, trip = simulate(case._replace(profile=profile), candidate)
    if trip != TRIP_NONE:
        return math.nan, math.nan
    rows = rows[(rows["profile_sample"] >= 0) & (rows["profile_sample"] < profile.values.size)]
    velocity_rps = rows["true_velocity_rps"]
    swing_rev = np.ptp(np.cumsum(velocity_rps[-round(SWING_S / period_s) :]) * period_s)
    return crept_counts(velocity_rps, round(1.6 / period_s), period_s), float(swing_rev) * COUNTS_PER_REV


def crept_counts(velocity_rps: Floats, stop: int, period_s: float) -> float:
    """How far the shaft goes between two places, five seconds apart, after the stop at a sample; counts of 15 bits."""
    travel_rev = np.cumsum(velocity_rps) * period_s
    weights = np.hanning(round(CREEP_MEAN_S / period_s) + 2)[1:-1]
    ends = []
    for after_s in (CREEP_FROM_S, CREEP_TO_S):
        first = stop + round(after_s / period_s)
        ends.append(float(np.average(travel_rev[first : first + weights.size], weights=weights)))
    return abs(ends[1] - ends[0]) * COUNTS_PER_REV


def run_job(job: Job) -> Outcome:
    """The chain on one axis."""
    began = time.perf_counter()
    axis = job.axis
    case = job.case._replace(plant=axis.plant)
    nominal = next(c for c in job.case.candidates if c.name == "pi+fffo+")
    passive = comes_to_rest(axis.plant)
    true_s = axis.plant.delay_s - 0.5 * case.session.loop.period_ns * 1e-9  # without the hold
    as_today = probe(case, nominal).verdict, at_rest_counts(case, nominal)[0]
    candidate, phase_deg, share, refused = None, math.nan, math.nan, ""
    measured_s, fitted_s = math.nan, math.nan
    with TemporaryDirectory(prefix="chain_") as place:
        chain = Chain(Path(place))
        try:
            found = chain.type(axis.plant, declared_nm_per_a(axis))
            phase_deg, share = found.design.margins_observer.phase_deg, found.design.gains.rest_share
            candidate = tuned_candidate(chain)
        except (ValueError, DocumentError) as error:
            refused = str(error).splitlines()[0]
        except Exception as error:  # a fault of the program: counted, so that an hour's work is not lost with it
            refused = f"{CRASHED}: {type(error).__name__}: {error}"
        measured_s, fitted_s = chain.delays_s()
    verdict, creep, swing = (CRASHED if refused.startswith(CRASHED) else "refused", math.nan, math.nan)
    unheld = verdict, math.nan
    if candidate is not None:
        verdict, (creep, swing) = probe(case, candidate).verdict, at_rest_counts(case, candidate)
        law = candidate.controller
        without = candidate._replace(controller=law._replace(rest=law.rest._replace(hold=NO_HOLD)))
        unheld = probe(case, without).verdict, at_rest_counts(case, without)[0]
    return Outcome(
        axis.number, axis.law, axis.effects, passive, refused, verdict, as_today[0], creep, as_today[1],
        *unheld, phase_deg, share, time.perf_counter() - began,
        measured_s - true_s, fitted_s - true_s, commit(),
        swing,
    )  # fmt: skip


def table(found: list[Outcome]) -> list[str]:
    """Verdicts, creep, and every axis that is not stable."""
    passive = [one for one in found if one.passive]
    lines = [
        f"{len(found)} axes, numbers {found[0].number} to {found[-1].number}; {len(found) - len(passive)} that no "
        "controller can bring to rest are omitted below.",
        "",
        "| gains | "
        + " | ".join(("stable", "hunting", "limit cycle", "unstable", "tripped", "refused", CRASHED))
        + " | creep "
        f"over {MOST_CREEP_COUNTS:g} counts in 5 s | median, 95 % quantile of it |",
        "|---|" + "---|" * 9,
    ]
    verdicts = (STABLE, HUNTING, CYCLE, UNSTABLE, TRIPPED, "refused", CRASHED)
    for name, which, creep in (
        ("as in the scenario", "nominal", "nominal_creep_counts"),
        ("identified and tuned, position not held at rest", "unheld", "unheld_creep_counts"),
        ("identified and tuned", "verdict", "creep_counts"),
    ):
        counted = Counter(getattr(one, which) for one in passive)
        creeps = np.array([getattr(one, creep) for one in passive])
        known = creeps[np.isfinite(creeps)]
        cells = [str(counted[verdict]) for verdict in verdicts]
        beyond = f"{int(np.sum(known > MOST_CREEP_COUNTS))} of {known.size}"
        median, late = np.quantile(known, [0.5, 0.95])
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {beyond} | {median:.1f}, {late:.1f} |")
    lines += ["", "Passive axes on which the tuned loop is not stable, or was refused:", ""]
    lines += ["| axis | friction | effects | verdict | margin | share at rest |", "|---|---|---|---|---|---|"]
    for one in passive:
        if one.verdict != STABLE:
            said = one.refused or one.verdict
            lines.append(
                f"| {one.number} | {one.law} | {', '.join(one.effects)} | {said} | {one.phase_deg:.0f} deg "
                f"| {one.rest_share:.2f} |"
            )
    creeping = [one for one in passive if one.verdict == STABLE and one.creep_counts > MOST_CREEP_COUNTS]
    lines += ["", "Stable ones that creep, by friction law: " + _by_law(creeping) + ".", ""]
    lines += _creeping(creeping)
    lines += _swinging(passive)
    lines += ["Measured delay less the true one, ms (5 %, median, 95 % quantile): " + _delays(passive) + ".", ""]
    return lines


def read_rows(path: Path) -> list[Outcome]:
    """What `add_rows` wrote."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [Outcome(**row | {"effects": tuple(row["effects"])}) for row in rows]


def add_rows(path: Path, found: Sequence[Outcome]) -> None:
    """Append one JSON line per axis (NaN as Python's json writes it)."""
    with path.open("a", encoding="utf-8") as file:
        file.writelines(json.dumps(one._asdict()) + "\n" for one in found)


def _delays(found: list[Outcome]) -> str:
    """Without the axes whose effect is a delay: their truth is another one."""
    texts = []
    for name, which in (("commission", "commissioned_delay_s"), ("identify", "fitted_delay_s")):
        errors_s = np.array([getattr(one, which) for one in found if "delay" not in one.effects])
        low, median, high = 1e3 * np.nanquantile(errors_s, [0.05, 0.5, 0.95])
        texts.append(f"{name} {low:.2f}, {median:.2f}, {high:.2f}")
    return "; ".join(texts)


def _creeping(found: list[Outcome]) -> list[str]:
    if not found:
        return []
    lines = ["| axis | friction | effects | creep in counts, position not held | held |", "|---|---|---|---|---|"]
    lines += [
        f"| {one.number} | {one.law} | {', '.join(one.effects)} | {one.unheld_creep_counts:.1f} "
        f"| {one.creep_counts:.1f} |"
        for one in found
    ]
    return [*lines, ""]


def _swinging(found: list[Outcome]) -> list[str]:
    """The stable axes that ring at rest, of those whose swing is known."""
    known = [one for one in found if math.isfinite(one.swing_counts)]
    if not known:
        return []
    ringing = [one for one in known if one.verdict == STABLE and one.swing_counts > MOST_SWING_COUNTS]
    listed = ", ".join(f"{one.number} ({one.law}, {one.swing_counts:.0f})" for one in ringing) or "none"
    return [
        f"Stable ones that swing by more than {MOST_SWING_COUNTS:g} counts peak to peak in the last {SWING_S:g} s at "
        f"rest, of {len(known)} where it was measured: {listed}.",
        "",
    ]


def _by_law(found: list[Outcome]) -> str:
    counted = Counter(one.law for one in found)
    return ", ".join(f"{law} {count}" for law, count in counted.most_common()) or "none"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", type=int, default=1000)
    parser.add_argument("--first", type=int, default=FRESH, help="number of the first random axis")
    parser.add_argument("--out", type=Path, default=RESULTS / "chain.md")
    parser.add_argument("--rows", type=Path, help="save results here (JSON lines), and resume from it")
    options = parser.parse_args(arguments)
    case = case_of(read_scenario(SCENARIO), 1)
    warm_up(case)
    found = read_rows(options.rows) if options.rows is not None and options.rows.is_file() else []
    known = {one.number for one in found}
    numbers = [n for n in range(options.first, options.first + options.axes) if n not in known]
    with progress_bar("axes") as progress:
        for part in (numbers[k : k + BATCH_AXES] for k in range(0, len(numbers), BATCH_AXES)):
            new = over_cores(run_job, (Job(wide_axis(case.plant, number), case) for number in part))
            found += new
            if options.rows is not None:
                add_rows(options.rows, new)
            if progress is not None:
                progress((len(found) - len(known)) / len(numbers))
    found.sort(key=lambda one: one.number)
    commits = ", ".join(sorted({one.commit for one in found}))
    lines = [
        "# chain",
        "",
        "The chain on random axes: commission, excite (70 s of the paper's chirps of current), identify, tune, run.",
        "Where commissioning finds no single rigid inertia, diagnose comes before tune, as tune advises.",
        "Only the torque constant is given, 5 % wrong.",
        "",
        *table(found),
        f"{made_by('chain.py', commits)} {np.median([one.seconds for one in found]):.1f} s an axis.",
    ]
    options.out.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
