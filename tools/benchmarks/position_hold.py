"""The position hold at rest, over its two constants: creep, starts, a load step, hunting, error in motion.

The chain (tools/benchmarks/chain.py) gives each random axis its model and gains. Then all variants of the hold run on
it: motion, seven seconds of rest, a start in the same direction, five seconds of rest, a start in the other direction,
five seconds of rest with a load step, and a start under that load. Errors are of the true velocity.

With --rows each axis is saved when it is done, and the same command resumes after an interruption.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from chain import (
    COUNTS_PER_REV,
    MOST_CREEP_COUNTS,
    REFUSALS,
    SCENARIO,
    crept_counts,
    declared_nm_per_a,
    tuned_candidate,
)
from chain_files import Chain
from common import Report, finish, main, paired_ratio, parser, shown
from trial_axes.passivity import comes_to_rest
from trial_axes.random_axis import RandomAxis, wide_axis
from trial_axes.robustness import HUNTING, STABLE, probe

from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.control.controller import ControllerConfig
from fffo_drive.control.envelope import TRIP_NONE
from fffo_drive.control.position_hold import HELD_DEAD_BANDS, NO_HOLD
from fffo_drive.control.reference import MODE_VELOCITY, Profile, piecewise_linear
from fffo_drive.drive.simulated.effects import slots
from fffo_drive.drive.simulated.effects.declaration import PlantEffect, PlantParameter
from fffo_drive.drive.simulated.effects.registry import EFFECTS
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig
from fffo_drive.evaluation.campaign import Candidate, Case, simulate, warm_up
from fffo_drive.evaluation.workers import over_cores
from fffo_drive.jit import njit

NAME = "position_hold"
FIRST = 6200  # no choice was made on axes from here to 6999; the gain was chosen on 6100 to 6159
AXES = 60
FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)  # times the gain in use
TRAVELS = (1.0, 128.0)  # in dead bands, beside the one in use
NOT_HELD = "not held"
IN_USE = "gain 1"

STOPS_S = (1.6, 9.3, 15.0, 20.7)  # where each motion has ended; rest follows
STARTS_S = (8.6, 14.3, 20.0)  # same direction, other direction, under the load
STARTS = ("same direction", "other direction", "under the load")
START_RPS = (0.5, -0.5, 0.5)
RAMP_S = 0.1
STARTED_S = 0.4  # over which a start is judged
LOAD_AT_S = 16.5
LOAD_SHARE = 0.45  # of the true Coulomb friction
SETTLED_S = (17.5, 19.5)  # between these, after the load step, the axis has been brought back
MEAN_S = 0.5


class Job(NamedTuple):
    """An axis and the scenario's case."""

    axis: RandomAxis
    case: Case
    rows: Path | None  # where its outcome is added


class Figures(NamedTuple):
    """One variant on one axis."""

    verdict: str
    creep_counts: float
    load_counts: float  # left of a load step, after three seconds
    motion_ise: float  # (rps)^2 s while the reference moves, the starts too
    start_ise: tuple[float, ...]
    start_delay_s: tuple[float, ...]  # of the shaft at half the speed; inf: not reached
    overshoot: tuple[float, ...]  # share of the speed


class Outcome(NamedTuple):
    """All variants on an axis."""

    number: int
    law: str
    refused: str
    variants: dict[str, Figures]


@njit
def load_step(signals: slots.Vector, parameters: slots.Vector, memory: slots.Vector) -> None:
    """A torque that is there from a time on."""
    if signals[slots.TIME_S] >= parameters[1]:
        signals[slots.ADDED_TORQUE_NM] -= parameters[0]


LOAD_STEP = PlantEffect(
    "load_step", slots.LOAD, load_step,
    (
        PlantParameter("torque_nm", "Nm", 0.01, 0.0, 1.0, "torque", True),
        PlantParameter("at_s", "s", 0.0, 0.0, 100.0, "since power-on"),
    ),
    "a load that comes at a time",
)  # fmt: skip


@contextmanager
def with_load_step() -> Iterator[None]:
    """The effect is in the registry for a run only: random axes are drawn from all that are in it."""
    EFFECTS[LOAD_STEP.name] = LOAD_STEP
    try:
        yield
    finally:
        del EFFECTS[LOAD_STEP.name]


def scene(period_s: float) -> Profile:
    """The reference."""
    times_s = [0.0, 0.2, 0.3, 1.5, STOPS_S[0]]
    values_rps = [0.0, 0.0, 1.0, 1.0, 0.0]
    for start_s, stop_s, speed_rps in zip(STARTS_S, STOPS_S[1:], START_RPS, strict=True):
        times_s += [start_s, start_s + RAMP_S, stop_s - RAMP_S, stop_s]
        values_rps += [0.0, speed_rps, speed_rps, 0.0]
    times_s.append(STOPS_S[-1] + 0.3)
    values_rps.append(0.0)
    return piecewise_linear("starts", MODE_VELOCITY, period_s, np.array(times_s), np.array(values_rps))


def variants_of(law: ControllerConfig, contact_travel_rev: float) -> dict[str, ControllerConfig]:
    """The law with every hold."""
    hold = law.rest.hold
    holds = {NOT_HELD: NO_HOLD}
    for factor in FACTORS:
        holds[f"gain {factor:g}"] = hold._replace(integral_a_per_rev_s=factor * hold.integral_a_per_rev_s)
    for bands in TRAVELS:
        travel_rev = max(contact_travel_rev, bands * hold.dead_band_rev)
        holds[f"travel {bands:g}"] = hold._replace(travel_rev=travel_rev)
    return {name: law._replace(rest=law.rest._replace(hold=one)) for name, one in holds.items()}


def loaded(plant: PlantConfig) -> PlantConfig:
    """The plant with the load step; its time is since power-on, a little before the profile begins."""
    torque_nm = LOAD_SHARE * plant.friction.coulomb_nm
    step = EffectConfig(LOAD_STEP.name, {"torque_nm": torque_nm, "at_s": LOAD_AT_S})
    return replace(plant, effects=(*plant.effects, step))


def figures_of(case: Case, candidate: Candidate) -> Figures | None:
    """Run the scene; None where the envelope tripped."""
    verdict = probe(case, candidate).verdict
    period_s = case.session.loop.period_ns * 1e-9
    profile = scene(period_s)
    with with_load_step():
        rows, trip = simulate(case._replace(profile=profile, plant=loaded(case.plant)), candidate)
    if trip != TRIP_NONE:
        return None
    rows = rows[(rows["profile_sample"] >= 0) & (rows["profile_sample"] < profile.values.size)]
    true_rps, wanted_rps = rows["true_velocity_rps"], rows["reference_rps"]
    error_rps = wanted_rps - true_rps

    def at(time_s: float) -> int:
        return round(time_s / period_s)

    ises, delays_s, overshoots = [], [], []
    for start_s, speed_rps in zip(STARTS_S, START_RPS, strict=True):
        span = slice(at(start_s), at(start_s + STARTED_S))
        ises.append(float(np.sum(error_rps[span] ** 2)) * period_s)
        share = true_rps[span] / speed_rps
        reached = np.flatnonzero(share >= 0.5)
        delays_s.append(float(reached[0]) * period_s - 0.5 * RAMP_S if reached.size else math.inf)
        overshoots.append(float(share.max()) - 1.0)
    places = np.cumsum(true_rps) * period_s * COUNTS_PER_REV
    before, after = (float(places[at(t) : at(t + MEAN_S)].mean()) for t in (LOAD_AT_S - 2.0 * MEAN_S, SETTLED_S[1]))
    return Figures(
        verdict, crept_counts(true_rps, at(STOPS_S[0]), period_s), abs(after - before),
        float(np.sum(error_rps[wanted_rps != 0.0] ** 2)) * period_s, tuple(ises), tuple(delays_s), tuple(overshoots),
    )  # fmt: skip


def run_job(job: Job) -> Outcome:
    """The outcome of an axis, saved."""
    found = outcome_of(job)
    if job.rows is not None:
        variants = {name: one._asdict() for name, one in found.variants.items()}
        with job.rows.open("a", encoding="utf-8") as file:
            file.write(json.dumps(found._asdict() | {"variants": variants}) + "\n")
    return found


def read_rows(path: Path) -> list[Outcome]:
    """What `run_job` saved."""
    found = []
    for line in path.read_text(encoding="utf-8").splitlines():
        row = json.loads(line)
        variants = {name: Figures(**one) for name, one in row["variants"].items()}
        found.append(Outcome(**row | {"variants": variants}))
    return found


def outcome_of(job: Job) -> Outcome:
    """The chain on an axis, then every variant."""
    axis = job.axis
    case = job.case._replace(plant=axis.plant)
    if not comes_to_rest(axis.plant):
        return Outcome(axis.number, axis.law, "gives energy", {})
    with TemporaryDirectory(prefix="chain_") as place:
        chain = Chain(Path(place))
        try:
            chain.type(axis.plant, declared_nm_per_a(axis))
            candidate = tuned_candidate(chain)
        except REFUSALS as error:
            return Outcome(axis.number, axis.law, str(error).splitlines()[0], {})
    laws = variants_of(candidate.controller, 1.0 / candidate.controller.observer.friction.stiffness_per_rev)
    found = {name: figures_of(case, candidate._replace(controller=law)) for name, law in laws.items()}
    tripped = [name for name, figures in found.items() if figures is None]
    if tripped:
        return Outcome(axis.number, axis.law, f"tripped: {', '.join(tripped)}", {})
    return Outcome(axis.number, axis.law, "", {name: one for name, one in found.items() if one is not None})


def label(name: str) -> str:
    """A variant as the table calls it."""
    kind, _, value = name.partition(" ")
    if name == NOT_HELD:
        return name
    if kind == "gain":
        return f"{value} times the gain, {HELD_DEAD_BANDS:g} dead bands"
    return f"the gain, {value} dead bands"


def grid_rows(found: list[Outcome]) -> list[list[str]]:
    """Every variant over the axes."""
    rows = []
    for name in found[0].variants:
        every = [one.variants[name] for one in found]
        creeps = np.array([one.creep_counts for one in every])
        left = np.array([one.load_counts for one in every])
        verdicts = Counter(one.verdict for one in every)
        row = [
            label(name),
            f"{int(np.sum(creeps > MOST_CREEP_COUNTS))}",
            f"{np.median(creeps):.2f}, {creeps.max():.1f}",
            f"{np.median(left):.1f}, {np.quantile(left, 0.9):.0f}",
            f"{verdicts[HUNTING]}, {len(every) - verdicts[STABLE] - verdicts[HUNTING]}",
        ]
        for which in range(len(STARTS)):
            delays_ms = 1e3 * np.array([one.start_delay_s[which] for one in every])
            row.append(f"{np.median(delays_ms):.1f}, {delays_ms.max():.1f}")
        row.append(
            ", ".join(f"{100.0 * np.median([one.overshoot[k] for one in every]):.0f}" for k in range(len(STARTS)))
        )
        rows.append(row)
    return rows


def costs(report: Report, found: list[Outcome]) -> None:
    """The hold in use against none, axis by axis."""
    held = [one.variants[IN_USE] for one in found]
    free = [one.variants[NOT_HELD] for one in found]

    def compared(what: str, values: list[float], base: list[float]) -> None:
        ratio = paired_ratio(values, base)
        report.ratio(what, ratio)
        report.lines[-1] = report.lines[-1]._replace(target="interval reaches 1", met=ratio.low <= 1.0)

    compared("ISE in motion, held / not held", [one.motion_ise for one in held], [one.motion_ise for one in free])
    for k, name in enumerate(STARTS):
        compared(f"ISE of a start, {name}", [one.start_ise[k] for one in held], [one.start_ise[k] for one in free])
    for k, name in enumerate(STARTS):
        later_ms = 1e3 * np.array([a.start_delay_s[k] - b.start_delay_s[k] for a, b in zip(held, free, strict=True)])
        text = f"median {np.median(later_ms):+.2f} ms, {later_ms.min():+.1f} to {later_ms.max():+.1f}"
        report.bounded(f"delay of a start, {name}, held less not held", text)
        report.facts[f"later, {name}"] = float(np.median(later_ms))


def run() -> int:
    """The command."""
    options = parser(NAME, __doc__ or "", AXES, 1)
    options.add_argument("--first", type=int, default=FIRST, help="number of the first random axis")
    options.add_argument("--rows", type=Path, help="save results here (JSON lines), and resume from it")
    chosen = options.parse_args()
    count = chosen.passes or (1 if chosen.sample else AXES)
    case = case_of(read_scenario(SCENARIO), 1)
    warm_up(case)
    numbers = range(chosen.first, chosen.first + count)
    done = read_rows(chosen.rows) if chosen.rows is not None and chosen.rows.is_file() else []
    done = [one for one in done if one.number in numbers]
    known = {one.number for one in done}
    jobs = [Job(wide_axis(case.plant, number), case, chosen.rows) for number in numbers if number not in known]
    with shown("axes") as progress:
        done += over_cores(run_job, jobs, progress=None if progress is None else lambda n: progress(n / len(jobs)))
    done.sort(key=lambda one: one.number)
    found = [one for one in done if one.variants]
    report = Report(NAME, f"{(__doc__ or '').strip()}\n\nAxes {chosen.first} to {chosen.first + count - 1}.")
    report.facts["axes"] = len(found)
    report.facts["left out"] = {str(one.number): one.refused for one in done if one.refused}
    if found:
        costs(report, found)
        held = [one.variants[IN_USE].creep_counts for one in found]
        report.figure("axes that creep over 5 counts, held", sum(one > MOST_CREEP_COUNTS for one in held), "", 0)
        report.facts["variants"] = {
            name: {
                "creep_counts": [one.variants[name].creep_counts for one in found],
                "load_counts": [one.variants[name].load_counts for one in found],
            }
            for name in found[0].variants
        }
        header = ["hold", "axes over 5 counts", "creep in 5 s, counts: median, most",
                  "left of a load step, counts: median, 90 %", "hunting, otherwise not stable"]  # fmt: skip
        header += [f"start, {name}, ms: median, latest" for name in STARTS]
        report.table([*header, "overshoot of the three starts, median, %"], grid_rows(found))
    for one in done:
        if one.refused:
            report.notes.append(f"{one.number} ({one.law}) is omitted: {one.refused}")
    report.notes.append(
        "In use: the gain of tune (the largest with its margin at rest, times the share of Kp and Ki), "
        f"{HELD_DEAD_BANDS:g} dead bands (`HELD_DEAD_BANDS`) or 1/K if that is more. Load: {LOAD_SHARE:g} of the "
        "true Coulomb friction. Delay: of the shaft at half the speed, behind the reference; ISE of a start: its first "
        f"{STARTED_S:g} s."
    )
    return finish(report, chosen)


if __name__ == "__main__":
    main(run)
