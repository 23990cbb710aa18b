"""PI+FFFO+ against published friction compensators: one axis, one fit, one set of linear margins, four plants.

  .venv/bin/python tools/benchmarks/control_peers.py [--seeds N] [--axes N] [--sample] [--json]

Writes results/control_peers.md beside this file.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import commit, made_by
from scipy.stats import binomtest
from trial_axes.passivity import comes_to_rest
from trial_axes.random_axis import SPREAD, random_axis

from fffo_drive.cli.progress import progress_bar
from fffo_drive.config.scenario import Scenario, case_of, read_scenario
from fffo_drive.config.sections import VelocitySection
from fffo_drive.drive.simulated.parameters import PlantConfig
from fffo_drive.drive.simulated.surfaces import KINDS
from fffo_drive.evaluation.campaign import Case
from fffo_drive.evaluation.compare import SeedInterval, ratio_interval
from fffo_drive.evaluation.peers.campaign import FIT_SEED, friction_record
from fffo_drive.evaluation.peers.fit import fit_two_surfaces
from fffo_drive.evaluation.peers.laws import (
    FFFO,
    OWN_LAWS,
    PLUS,
    AxisNumbers,
    Models,
    PeerDesign,
    Scale,
    axis_numbers,
    design_for,
    fit_models,
    laws_of,
    scaled,
    wrong,
)
from fffo_drive.evaluation.peers.loop import PeerLaw, run_law
from fffo_drive.evaluation.peers.measures import PeerMeasures, measure_peer
from fffo_drive.evaluation.peers.plus import on_the_estimate, with_second_surface
from fffo_drive.evaluation.workers import over_cores

HERE = Path(__file__).resolve().parent
SCENARIO = HERE.parents[1] / "configs" / "scenarios" / "paper.yaml"
SLOPES = (0.0, -0.5)
SEEDS, AXES = 6, 60
AXIS_RECORD_S = 20.0  # of the reference on a random axis
AXIS_FIRST_SEED = 5000  # of the reference's phases there; the paper's scenario has small seeds
MISMATCH = 0.1  # of every friction number, as in paper_wrong_friction.yaml
LEVEL = 0.95
TITLES = dict(zip(KINDS, ("five surfaces", "2SEP", "LuGre", "GMS"), strict=True))

BANDWIDTH_HZ = VelocitySection().bandwidth_hz  # of the estimate: with it the command is as noisy as without
WIDER_HZ = 300.0
ESTIMATED = f"{PLUS} estimated"
SECOND = f"{PLUS} second surface"
BOTH = f"{PLUS} both"
BOTH_WIDER = f"{PLUS} both, {WIDER_HZ:.0f} Hz"
VARIANTS = (ESTIMATED, SECOND, BOTH, BOTH_WIDER)
LUGRE, GMS = "lugre forward+", "gms forward+"
ESTIMATED_PEERS = (f"{LUGRE} estimated", f"{GMS} estimated")

Runs = dict[str, list[PeerMeasures]]  # by law; one entry a seed or an axis


class Ground(NamedTuple):
    """A kind of plant, and what the laws know of it."""

    plant: PlantConfig
    models: Models
    left: tuple[float, ...]  # share of the friction that each model leaves


class Sizes(NamedTuple):
    """How much is run."""

    seeds: int
    axes: int
    record_s: float | None = None  # of the paper's scenario; None: as in its file


def with_reference(scenario: Scenario, slope: float, duration_s: float | None) -> Scenario:
    """The scenario with another spectrum and length."""
    assert scenario.file.reference is not None
    changes: dict[str, float] = {"slope": slope}
    if duration_s is not None:
        changes["duration_s"] = duration_s
    reference = scenario.file.reference.model_copy(update=changes)
    return scenario._replace(file=scenario.file.model_copy(update={"reference": reference}))


def ground_of(task: tuple[Scenario, str, float | None]) -> Ground:
    """The nominal plant of a kind, and all models fitted to a run on it that follows the reference."""
    scenario, kind, record_s = task
    case = case_of(with_reference(scenario, 0.0, record_s), FIT_SEED)
    plant = replace(case.plant, friction=replace(case.plant.friction, kind=kind))
    record = friction_record(case._replace(plant=plant))
    models, left = fit_models(*record)
    both = fit_two_surfaces(models.two_state, *record)
    return Ground(plant, models._replace(two_surfaces=both.model), (*left, both.left))


def run_all(case: Case, plant: PlantConfig, design: PeerDesign, models: Models) -> dict[str, PeerMeasures]:
    """All laws on one plant."""
    axis = axis_numbers(plant)
    laws = laws_of(case.candidates, design, axis, models)
    laws += variants({law.name: law for law in laws}, case, design, axis, models)
    return {law.name: measure_peer(run_law(plant, case.device, law, case.profile).trace) for law in laws}


def variants(
    laws: dict[str, PeerLaw], case: Case, design: PeerDesign, axis: AxisNumbers, models: Models
) -> list[PeerLaw]:
    """PI+FFFO+ with what it does not have by default, and the two nearest published laws with the estimate."""
    assert models.two_surfaces is not None
    limits = case.session.envelope

    def estimated(law: PeerLaw, bandwidth_hz: float = BANDWIDTH_HZ) -> PeerLaw:
        return on_the_estimate(law, design, axis, bandwidth_hz, (limits.speed_limit_rps, limits.following_error_rps))

    plus = laws[PLUS]
    second = with_second_surface(plus, axis, models.two_surfaces)
    found = [estimated(plus), second, estimated(second), estimated(second, WIDER_HZ)]
    found += [estimated(laws[name]) for name in (LUGRE, GMS)]
    return [law._replace(name=name) for law, name in zip(found, (*VARIANTS, *ESTIMATED_PEERS), strict=True)]


class SeedTask(NamedTuple):
    """One seed of the paper's scenario for all laws."""

    scenario: Scenario
    ground: Ground
    design: PeerDesign
    seed: int


def run_seed(task: SeedTask) -> dict[str, PeerMeasures]:
    """All laws on one seed of noise, phases and wrong signs."""
    plant = replace(task.ground.plant, seed=task.seed)
    models = wrong(task.ground.models, MISMATCH, task.seed)
    return run_all(case_of(task.scenario, task.seed), plant, task.design, models)


def scenario_runs(scenario: Scenario, ground: Ground, design: PeerDesign, slope: float, sizes: Sizes) -> Runs:
    """The paper's scenario over seeds."""
    sloped = with_reference(scenario, slope, sizes.record_s)
    tasks = [SeedTask(sloped, ground, design, seed) for seed in range(1, sizes.seeds + 1)]
    return by_law(over_cores(run_seed, tasks))


def by_law(found: Sequence[dict[str, PeerMeasures]]) -> Runs:
    """Measures of many runs of all laws."""
    return {name: [one[name] for one in found] for name in found[0]}


def axis_of(ground: Ground, number: int) -> tuple[PlantConfig, Scale]:
    """Axis, delay, sensor and effects of random_axis, with the friction of the ground drawn anew."""
    drawn = np.random.default_rng([number, 0xC]).uniform(1.0 - SPREAD, 1.0 + SPREAD, len(Scale._fields))
    scale = Scale(*(float(factor) for factor in drawn))
    plant = random_axis(ground.plant, number).plant
    return replace(plant, friction=ground.plant.friction.scaled(**scale._asdict())), scale


class AxisTask(NamedTuple):
    """One random axis for all laws."""

    scenario: Scenario
    ground: Ground
    design: PeerDesign
    number: int
    record_s: float


def run_axis(task: AxisTask) -> dict[str, PeerMeasures]:
    """All laws on one random axis."""
    plant, scale = axis_of(task.ground, task.number)
    seed = AXIS_FIRST_SEED + task.number
    case = case_of(with_reference(task.scenario, 0.0, task.record_s), seed)
    return run_all(case, plant, task.design, wrong(scaled(task.ground.models, scale), MISMATCH, seed))


def axis_runs(
    scenario: Scenario, ground: Ground, design: PeerDesign, sizes: Sizes
) -> tuple[list[int], list[int], Runs]:
    """Numbers of the axes that ran, of those left out because they give energy, and the runs."""
    ran: list[int] = []
    active: list[int] = []
    duration_s = AXIS_RECORD_S if sizes.record_s is None else sizes.record_s

    def tasks() -> Iterator[AxisTask]:
        number = -1
        while len(ran) < sizes.axes:
            number += 1
            plant, _ = axis_of(ground, number)
            if plant.errors():
                continue
            if not comes_to_rest(plant):
                active.append(number)
                continue
            ran.append(number)
            yield AxisTask(scenario, ground, design, number, duration_s)

    runs = by_law(over_cores(run_axis, tasks()))
    return ran, active, runs


def column(runs: Runs, law: str, name: str) -> np.ndarray:
    """One measure of a law over its runs, (n,)."""
    return np.array([getattr(one, name) for one in runs[law]])


def text(interval: SeedInterval, factor: float = 1.0) -> str:
    """12.3 [11.0, 13.6], three digits"""
    value, low, high = (f"{factor * one:.3g}" for one in interval)
    return f"{value} [{low}, {high}]"


def scenario_table(runs: Runs) -> list[str]:
    """A line a law."""
    lines = [
        "| law | true ISE, % of PI+FFFO+ | % of PI+FFFO | after 2 s | first 2 s, 1e-3 rps² s | measured ISE % "
        "| MAE mrps | MAX mrps | at the crossing, mrps | lag ms | step of the command, mA rms |",
        "|---|" + "---|" * 10,
    ]
    for law in runs:
        percent = [
            text(ratio_interval(column(runs, law, name), column(runs, base, name)), 100.0)
            for name, base in (("true_ise", PLUS), ("true_ise", FFFO), ("after_ise", PLUS))
        ]
        measured = ratio_interval(column(runs, law, "measured_ise"), column(runs, PLUS, "measured_ise"))
        means = {name: float(np.mean(column(runs, law, name))) for name in PeerMeasures._fields}
        cells = [
            *percent,
            f"{1e3 * means['start_ise']:.3g}",
            text(measured, 100.0),
            f"{1e3 * means['true_mae']:.3g}",
            f"{1e3 * means['true_max']:.3g}",
            f"{1e3 * means['crossing_rps']:.3g}",
            f"{means['lag_ms']:.2f}",
            f"{1e3 * means['step_rms_a']:.3g}",
        ]
        lines.append(f"| {law} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def published(runs: Runs) -> list[str]:
    """The laws that are no form of this project's, as published."""
    return [law for law in runs if law not in (*OWN_LAWS, *VARIANTS, *ESTIMATED_PEERS)]


def better_than_plus(runs: Runs, name: str) -> list[str]:
    """Published laws whose interval of a measure, over that of PI+FFFO+, lies below one."""
    others = column(runs, PLUS, name)
    return [law for law in published(runs) if ratio_interval(column(runs, law, name), others).high < 1.0]


def said_of(runs: Runs) -> str:
    """In words: which laws are better than PI+FFFO+, with and without the start."""
    better = {name: better_than_plus(runs, name) for name in ("true_ise", "after_ise")}
    if not any(better.values()):
        return "No published law is significantly better than PI+FFFO+ (whole interval)."
    return (
        f"Better than PI+FFFO+ by the whole interval: {', '.join(better['true_ise']) or 'none'} over the whole record; "
        f"{', '.join(better['after_ise']) or 'none'} after its first 2 s."
    )


def share_of(won: np.ndarray) -> str:
    """Share of axes in per cent, with Wilson's interval."""
    found = binomtest(int(won.sum()), won.size).proportion_ci(LEVEL, method="wilson")
    return f"{100 * won.mean():.0f} % [{100 * found.low:.0f}, {100 * found.high:.0f}]"


def axes_table(found: dict[str, Runs], own: str) -> list[str]:
    """On how many axes a law of this project is better than each published law and its own simpler ones."""
    lines = [f"| {own} has less true ISE than | " + " | ".join(TITLES[kind] for kind in found) + " |"]
    lines.append("|---|" + "---|" * len(found))
    for law in next(iter(found.values())):
        if law == own or law in VARIANTS:
            continue
        cells = []
        for runs in found.values():
            this, other = column(runs, own, "true_ise"), column(runs, law, "true_ise")
            cells.append(f"{share_of(this < other)}; {np.median(other / this):.2g} x")
        lines.append(f"| {law} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def best_table(found: dict[str, Runs]) -> list[str]:
    """On how many axes each form of PI+FFFO+ is better than all published laws, and how much its command is noise."""
    lines = ["| less true ISE than all published laws | " + " | ".join(TITLES[kind] for kind in found) + " |"]
    lines.append("|---|" + "---|" * len(found))
    for own in (PLUS, *VARIANTS):
        cells = []
        for runs in found.values():
            peers = [column(runs, law, "true_ise") for law in published(runs)]
            steps = column(runs, own, "step_rms_a") / column(runs, PLUS, "step_rms_a")
            share = share_of(column(runs, own, "true_ise") < np.min(peers, axis=0))
            cells.append(f"{share}; {np.median(steps):.2f} x")
        lines.append(f"| {own} | " + " | ".join(cells) + " |")
    return [*lines, "", f"x: median over axes of the step of the command, over that of {PLUS}.", ""]


def design_table(design: PeerDesign) -> list[str]:
    """Gains and margins on the nominal axis."""
    lines = [
        "| loop | Kp A/rps | bandwidth of the observer (slowest pole) rad/s | phase margin | gain margin |",
        "|---|---|---|---|---|",
    ]
    plus = design.margins
    known = "PI and all with a friction model on the reference"
    lines.append(f"| {known} | as configured | – | {plus.phase_deg:.1f}° | {plus.gain:.2f} |")
    observers = {"dob+": design.disturbance, "eso+": design.extended_state, "luenberger+": design.friction_state}
    for name, gains in observers.items():
        lines.append(
            f"| {name} | {gains.proportional_a_per_rps:.3f} | {gains.bandwidth_rad_per_s:.0f} "
            f"| {gains.margins.phase_deg:.1f}° | {gains.margins.gain:.2f} |"
        )
    return [*lines, ""]


def fit_table(grounds: dict[str, Ground]) -> list[str]:
    """Share of each plant's friction that each model leaves unexplained."""
    lines = ["| plant | 2SEP leaves | LuGre | GMS | 2SEP with a second surface |", "|---|---|---|---|---|"]
    lines += [
        f"| {TITLES[kind]} | " + " | ".join(f"{100 * left:.1f} %" for left in ground.left) + " |"
        for kind, ground in grounds.items()
    ]
    return [*lines, ""]


def compare(sizes: Sizes, shown: bool) -> tuple[list[str], dict[str, object]]:
    """All of it: lines of the report, and facts."""
    scenario = read_scenario(SCENARIO)
    case = case_of(scenario, FIT_SEED)
    plus = next(one.controller for one in case.candidates if one.name == PLUS)
    design = design_for(plus, axis_numbers(case.plant), case.plant.friction.viscous_nm_per_rps)
    found = over_cores(ground_of, [(scenario, kind, sizes.record_s) for kind in KINDS])
    grounds = dict(zip(KINDS, found, strict=True))
    lines = ["## Gains", "", *design_table(design), "## Models", "", *fit_table(grounds)]
    facts: dict[str, object] = {
        "margins": {
            name: list(getattr(design, name).margins[:2])
            for name in ("disturbance", "extended_state", "friction_state")
        },
        "asked": list(design.margins[:2]),
        "left": {kind: list(ground.left) for kind, ground in grounds.items()},
    }
    on_axes: dict[str, Runs] = {}
    counted = []
    with progress_bar("peers", quiet=not shown) as progress:
        for place, (kind, ground) in enumerate(grounds.items()):
            for slope in SLOPES:
                runs = scenario_runs(scenario, ground, design, slope, sizes)
                lines += [f"## The paper's scenario on {TITLES[kind]}, slope {slope:g}, {sizes.seeds} seeds", ""]
                lines += [*scenario_table(runs), said_of(runs), ""]
                ises = {law: float(column(runs, law, "true_ise").mean()) for law in runs}
                facts[f"{kind}, slope {slope:g}"] = ises
            ran, active, on_axes[kind] = axis_runs(scenario, ground, design, sizes)
            named = ", ".join(str(number) for number in active) or "none"
            counted.append(f"- {TITLES[kind]}: axes up to number {ran[-1]}; not passive and left out: {named}.")
            if progress is not None:
                progress((place + 1) / len(grounds))
    lines += [f"## Random passive axes: {sizes.axes} on each plant", ""]
    lines += [*best_table(on_axes), *axes_table(on_axes, PLUS), *axes_table(on_axes, BOTH), *counted, ""]
    facts["axes"] = {kind: {law: len(runs[law]) for law in runs} for kind, runs in on_axes.items()}
    return lines, facts


def preface(made_from: str, seconds: float) -> list[str]:
    """What was done, when and where."""
    return [
        "# control_peers",
        "",
        "PI+FFFO+ against published laws on four kinds of plants; the manual's page on peers describes them.",
        "Every friction model is fitted to one record of the same plant; then each of its parameters is changed by",
        f"{100 * MISMATCH:.0f} %, signs drawn anew for each seed. All laws marked + have the same inertia torque,",
        "preview and error filter.",
        "`pi+fffo+` is as configured: the 2SEP model on the reference, L in the integral. `2sep observer+` has L in "
        "the",
        "friction estimate. `luenberger+` is PI with a law after Ruderman (arXiv 2504.21316): from there are the",
        "reduced-order observer of velocity and friction on the position, its real eigenvalues and an assigned slowest",
        "pole; its tangent stiffness (of the fitted 2SEP model) and the choice of its poles are this project's.",
        f"`{ESTIMATED}` is PI+FFFO+ on the velocity estimated from position and torque ({BANDWIDTH_HZ:g} Hz, the "
        "default) at the",
        f"same margins; `{SECOND}` has the effect second_surface beside the 2SEP model; `both` has both. The peers",
        f"are as published; `{ESTIMATED_PEERS[0]}` and `{ESTIMATED_PEERS[1]}` have this estimate too.",
        "Intervals are 95 %: over resampled seeds, and Wilson's for shares of axes.",
        "",
        "A random axis has inertia, torque constant, delay, sensor and effects of trial_axes/random_axis, and friction",
        f"parameters within {100 * SPREAD:.0f} % of the plant's. The laws know inertia, torque constant and delay",
        "without effects, and their gains are scaled with them; they do not know the effects. x: median over axes of",
        "the other law's true ISE over that of this one. The peers' loop has the law's current limit, but no envelope.",
        "",
        f"{made_by('control_peers.py', made_from)} {seconds:.0f} s.",
        "",
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"of the paper's scenario (default {SEEDS})")
    parser.add_argument("--axes", type=int, default=AXES, help=f"random axes on each plant (default {AXES})")
    parser.add_argument("--sample", action="store_true", help="a short run: logic and rough figures, no result file")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout in place of the tables")
    options = parser.parse_args(arguments)
    sizes = Sizes(2, 1, 6.0) if options.sample else Sizes(options.seeds, options.axes)
    began, made_from = time.perf_counter(), commit()  # of the code that runs, whatever changes meanwhile
    lines, facts = compare(sizes, shown=not options.json)
    lines = [*preface(made_from, time.perf_counter() - began), *lines]
    if not options.sample:
        (HERE / "results" / "control_peers.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    print(json.dumps(facts) if options.json else "\n".join(lines))


if __name__ == "__main__":
    main()
