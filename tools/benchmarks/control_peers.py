"""What `tune` writes against other laws: plain PI, published friction compensators, the drive's own velocity loop.

  .venv/bin/python tools/benchmarks/control_peers.py [--seeds N] [--axes N] [--typed-axes N] [--sample] [--json]

On each axis the functions of `tune` write an axis file for a model of that axis, and this file is run as it is. All
other laws have its margins, inertia, torque constant and delay, and the same error of their friction models. Writes
results/control_peers.md beside this file.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from chain import REFUSALS, declared_nm_per_a
from chain_files import Chain
from common import RESULTS, commit, made_by
from scipy.stats import binomtest
from trial_axes.passivity import comes_to_rest
from trial_axes.random_axis import SPREAD, RandomAxis, random_axis

from fffo_drive.cli.progress import progress_bar
from fffo_drive.config.axis import TOGGLES, controller_config, model_of, read_axis
from fffo_drive.config.effects import compensation_table
from fffo_drive.config.scenario import Scenario, case_of, read_scenario
from fffo_drive.config.sections import VelocitySection
from fffo_drive.control.controller import ControllerConfig
from fffo_drive.documents import DocumentError
from fffo_drive.drive.simulated.parameters import PlantConfig
from fffo_drive.drive.simulated.surfaces import KINDS
from fffo_drive.evaluation.campaign import Case
from fffo_drive.evaluation.compare import SeedInterval, ratio_interval
from fffo_drive.evaluation.peers.campaign import FIT_SEED, friction_record, plus_of
from fffo_drive.evaluation.peers.drive_loop import DELAYS_S, TORQUE_RATES_HZ
from fffo_drive.evaluation.peers.fit import fit_two_surfaces
from fffo_drive.evaluation.peers.laws import (
    FFFO,
    OWN_LAWS,
    PI,
    PI_AHEAD,
    PI_ALL,
    PLUS,
    Models,
    PeerDesign,
    Scale,
    axis_numbers,
    design_for,
    drive_loops,
    drives_own,
    fit_models,
    known_numbers,
    peers_of,
    scaled,
    wrong,
)
from fffo_drive.evaluation.peers.loop import PeerLaw, run_law
from fffo_drive.evaluation.peers.measures import PeerMeasures, measure_peer
from fffo_drive.evaluation.peers.plus import on_the_estimate, with_second_surface
from fffo_drive.evaluation.workers import over_cores
from fffo_drive.identification.tuning import Wish

SCENARIO = Path(__file__).resolve().parents[2] / "configs" / "scenarios" / "paper.yaml"
WISH = Wish()  # the margins of `tune`, which all laws have
SLOPES = (0.0, -0.5)
SEEDS, AXES, TYPED_AXES = 6, 200, 0
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
TYPED = "typed"  # what all commands wrote, from commission on
ALONE = tuple(drives_own(delay_s) for delay_s in DELAYS_S)
HELPED = tuple(drives_own(delay_s, rate_hz) for delay_s in DELAYS_S for rate_hz in TORQUE_RATES_HZ)
PLAIN = (PI, PI_ALL, PI_AHEAD, *ALONE)  # without a friction model
TUNED = {  # how each law gets its gains
    PLUS: "the axis file that `tune` writes for the model, byte for byte",
    f"{PI}, {FFFO}": "the same file under `law: paper`: Kp, Ki and L as they are; no filter, no preview",
    PI_ALL: "the same Kp; Ki + L/Kt; neither friction model nor preview",
    PI_AHEAD: "the same with inertia torque, preview and the reference as old as the feedback",
    "2sep, lugre and gms": "the same Kp, and Ki and L wherever the law adds it: the same linear loop",
    "dob+, eso+, luenberger+": "Kp and bandwidth of the observer with the most integral action within the margins",
    ", ".join(ALONE): "PI with the most integral action within the margins, behind the loop's own delay; no filter",
    "drive + torque": "the same, and the torque of the 2SEP model and of the inertia along the reference",
    f"{PLUS} estimated, both": "Kp by x, Ki and L by x^2: the largest x within the margins",
    TYPED: "the axis file that commission, run, identify and tune wrote, told a torque constant that is 5 % wrong",
}

Runs = dict[str, list[PeerMeasures]]  # by law; one entry a seed or an axis


class Ground(NamedTuple):
    """A kind of plant, and what the laws know of it."""

    plant: PlantConfig
    models: Models
    left: tuple[float, ...]  # share of the friction that each model leaves
    typed: PeerLaw | None  # None: a command refused


class Sizes(NamedTuple):
    """How much is run."""

    seeds: int
    axes: int
    typed_axes: int  # of them with the whole chain
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
    typed = typed_law(RandomAxis(FIT_SEED, plant, kind, ()))
    return Ground(plant, models._replace(two_surfaces=both.model), (*left, both.left), typed)


def typed_law(axis: RandomAxis) -> PeerLaw | None:
    """What the commands write for a new axis, from `commission` to `tune`; None where one of them refuses."""
    with TemporaryDirectory(prefix="chain_") as place:
        chain = Chain(Path(place))
        try:
            chain.type(axis.plant, declared_nm_per_a(axis))
        except REFUSALS:
            return None
        return written_law(TYPED, chain.tuned)


def written_law(name: str, path: Path) -> PeerLaw:
    """The law of an axis file, as `run` makes it."""
    axis = read_axis(path)
    model, toggle = model_of(path, axis), TOGGLES[axis.controller.observer.toggle]
    return PeerLaw(name, controller_config(axis, model), toggle, compensation_table(axis, model))


def tuned_case(scenario: Scenario, plant: PlantConfig, models: Models, seed: int) -> Case:
    """The scenario on the axis file that `tune` writes for a plant. Raises DocumentError where it refuses."""
    with TemporaryDirectory(prefix="tuned_") as place:
        chain = Chain(Path(place))
        chain.new_axis(plant, plant.torque_constant_nm_per_a)
        known = chain.know(axis_numbers(plant), models.two_state, scenario.axis.loop.period_s)
        chain.tune(known)
        axis = read_axis(chain.tuned)
        model = model_of(chain.tuned, axis)
        written = written_law(PLUS, chain.tuned)
        case = case_of(scenario._replace(axis_path=chain.tuned, axis=axis, model=model, plant=plant), seed)
    plus = plus_of(case)
    assert (plus.controller, plus.toggle) == (written.config, written.toggle)  # as the file has it
    return case


def run_all(
    scenario: Scenario, plant: PlantConfig, models: Models, seed: int, typed: PeerLaw | None
) -> dict[str, PeerMeasures]:
    """All laws on one plant. Raises DocumentError where `tune` refuses it."""
    case = tuned_case(scenario, plant, models, seed)
    found = {one.name: PeerLaw(one.name, one.controller, one.toggle) for one in case.candidates}
    plus = found[PLUS]
    assert isinstance(plus.config, ControllerConfig)
    laws = [found[name] for name in OWN_LAWS]
    laws += peers_of(plus.config, plus.toggle, design_for(plus.config, WISH), models)
    laws += variants({law.name: law for law in laws}, case, models)
    laws += [] if typed is None else [typed]
    return {law.name: measure_peer(run_law(plant, case.device, law, case.profile).trace) for law in laws}


def variants(laws: dict[str, PeerLaw], case: Case, models: Models) -> list[PeerLaw]:
    """PI+FFFO+ with what it does not have by default, and the two nearest published laws with the estimate."""
    assert models.two_surfaces is not None
    limits, plus = case.session.envelope, laws[PLUS].config
    assert isinstance(plus, ControllerConfig)
    axis = known_numbers(plus)

    def estimated(law: PeerLaw, bandwidth_hz: float = BANDWIDTH_HZ) -> PeerLaw:
        return on_the_estimate(law, WISH, axis, bandwidth_hz, (limits.speed_limit_rps, limits.following_error_rps))

    second = with_second_surface(laws[PLUS], axis, models.two_surfaces)
    found = [estimated(laws[PLUS]), second, estimated(second), estimated(second, WIDER_HZ)]
    found += [estimated(laws[name]) for name in (LUGRE, GMS)]
    return [law._replace(name=name) for law, name in zip(found, (*VARIANTS, *ESTIMATED_PEERS), strict=True)]


class SeedTask(NamedTuple):
    """One seed of the paper's scenario for all laws."""

    scenario: Scenario
    ground: Ground
    seed: int


def run_seed(task: SeedTask) -> dict[str, PeerMeasures]:
    """All laws on one seed of noise, phases and wrong signs."""
    plant = replace(task.ground.plant, seed=task.seed)
    models = wrong(task.ground.models, MISMATCH, task.seed)
    return run_all(task.scenario, plant, models, task.seed, task.ground.typed)


def scenario_runs(scenario: Scenario, ground: Ground, slope: float, sizes: Sizes) -> Runs:
    """The paper's scenario over seeds."""
    sloped = with_reference(scenario, slope, sizes.record_s)
    tasks = [SeedTask(sloped, ground, seed) for seed in range(1, sizes.seeds + 1)]
    return by_law(over_cores(run_seed, tasks))


def by_law(found: Sequence[dict[str, PeerMeasures]]) -> Runs:
    """Measures of many runs of all laws that ran in each of them."""
    return {name: [one[name] for one in found] for name in found[0] if all(name in one for one in found)}


def axis_of(ground: Ground, number: int) -> tuple[RandomAxis, Scale]:
    """Axis, delay, sensor and effects of random_axis, with the friction of the ground drawn anew."""
    drawn = np.random.default_rng([number, 0xC]).uniform(1.0 - SPREAD, 1.0 + SPREAD, len(Scale._fields))
    scale = Scale(*(float(factor) for factor in drawn))
    axis = random_axis(ground.plant, number)
    friction = ground.plant.friction.scaled(**scale._asdict())
    return axis._replace(plant=replace(axis.plant, friction=friction)), scale


class AxisTask(NamedTuple):
    """One random axis for all laws."""

    scenario: Scenario
    ground: Ground
    number: int
    typed: bool


class OnAxis(NamedTuple):
    """What came of a random axis."""

    number: int
    left_out: str  # why; empty: it ran
    measures: dict[str, PeerMeasures]


def run_axis(task: AxisTask) -> OnAxis:
    """All laws on one random axis."""
    axis, scale = axis_of(task.ground, task.number)
    if axis.plant.errors():
        return OnAxis(task.number, "no drive can be made of it", {})
    if not comes_to_rest(axis.plant):
        return OnAxis(task.number, "not passive", {})
    seed = AXIS_FIRST_SEED + task.number
    models = wrong(scaled(task.ground.models, scale), MISMATCH, seed)
    typed = typed_law(axis) if task.typed else None
    try:
        return OnAxis(task.number, "", run_all(task.scenario, axis.plant, models, seed, typed))
    except (DocumentError, ValueError) as error:  # no gains have the margins
        return OnAxis(task.number, str(error).splitlines()[0], {})


def axis_runs(scenario: Scenario, ground: Ground, sizes: Sizes) -> tuple[list[OnAxis], list[OnAxis]]:
    """The axes that ran, as many as are asked for, and those left out among them."""
    sloped = with_reference(scenario, 0.0, AXIS_RECORD_S if sizes.record_s is None else sizes.record_s)
    ran: list[OnAxis] = []
    left: list[OnAxis] = []
    number = 0
    while len(ran) < sizes.axes:
        numbers = range(number, number + sizes.axes - len(ran))
        tasks = [AxisTask(sloped, ground, one, one < sizes.typed_axes) for one in numbers]
        for found in over_cores(run_axis, tasks):
            (left if found.left_out else ran).append(found)
        number = numbers.stop
    return ran, left


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
    no_peers = {*OWN_LAWS, *PLAIN, *HELPED, *VARIANTS, *ESTIMATED_PEERS, TYPED}
    return [law for law in runs if law not in no_peers]


def better_than_plus(runs: Runs, name: str) -> list[str]:
    """Laws of others whose interval of a measure, over that of PI+FFFO+, lies below one."""
    others = column(runs, PLUS, name)
    return [
        law for law in (*PLAIN, *HELPED, *published(runs)) if ratio_interval(column(runs, law, name), others).high < 1.0
    ]


def said_of(runs: Runs) -> str:
    """In words: which laws are better than PI+FFFO+, with and without the start."""
    better = {name: better_than_plus(runs, name) for name in ("true_ise", "after_ise")}
    if not any(better.values()):
        return "No other law is significantly better than PI+FFFO+ (whole interval)."
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
    """On how many axes each form of PI+FFFO+ is better than all published laws, and than all plain ones; and how much
    its command is noise.
    """
    lines = ["| less true ISE than all published laws; than all plain ones | "]
    lines[0] += " | ".join(TITLES[kind] for kind in found) + " |"
    lines.append("|---|" + "---|" * len(found))
    for own in (PLUS, *VARIANTS, TYPED):
        if not all(own in runs for runs in found.values()):
            continue
        cells = []
        for runs in found.values():
            ise = column(runs, own, "true_ise")
            shares = [
                share_of(ise < np.min([column(runs, law, "true_ise") for law in laws], axis=0))
                for laws in (published(runs), PLAIN)
            ]
            steps = column(runs, own, "step_rms_a") / column(runs, PLUS, "step_rms_a")
            cells.append(f"{'; '.join(shares)}; {np.median(steps):.2f} x")
        lines.append(f"| {own} | " + " | ".join(cells) + " |")
    plain = ", ".join(f"`{law}`" for law in PLAIN)
    said = f"Plain: {plain}. x: median over axes of the step of the command, over that of {PLUS}."
    return [*lines, "", said, ""]


def design_table(plus: ControllerConfig, design: PeerDesign) -> list[str]:
    """Gains and margins on the nominal axis, for the model that knows it."""
    lines = [
        "| loop | Kp A/rps | Ki A/rev | L Nm/rev | bandwidth of the observer (slowest pole) rad/s | margins |",
        "|---|---|---|---|---|---|",
        f"| {PLUS}, and all with a friction model on the reference | {plus.pi.proportional_a_per_rps:.3f} "
        f"| {plus.pi.integral_a_per_rev:.3g} | {plus.observer.gain_nm_per_rev:.3g} | – | as asked for |",
    ]
    observers = {"dob+": design.disturbance, "eso+": design.extended_state, "luenberger+": design.friction_state}
    for name, gains in observers.items():
        lines.append(
            f"| {name} | {gains.proportional_a_per_rps:.3f} | – | – | {gains.bandwidth_rad_per_s:.0f} "
            f"| {gains.margins.phase_deg:.1f}°, {gains.margins.gain:.2f} |"
        )
    for law in drive_loops(plus, WISH, plus.observer.friction):
        if law.name in ALONE:
            pi = law.common.pi
            lines.append(
                f"| {law.name} | {pi.proportional_a_per_rps:.3f} | {pi.integral_a_per_rev:.3g} | – | – | as asked for |"
            )
    lines += ["", f"Asked for: {WISH.phase_margin_deg:g}° and {WISH.gain_margin:g}.", ""]
    lines += ["| law | how it is tuned |", "|---|---|", *(f"| {law} | {how} |" for law, how in TUNED.items())]
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
    found = over_cores(ground_of, [(scenario, kind, sizes.record_s) for kind in KINDS])
    grounds = dict(zip(KINDS, found, strict=True))
    nominal = tuned_case(scenario, found[0].plant, found[0].models, FIT_SEED)
    plus = plus_of(nominal).controller
    design = design_for(plus, WISH)
    lines = ["## Gains on the nominal axis", "", *design_table(plus, design), "## Models", "", *fit_table(grounds)]
    facts: dict[str, object] = {
        "margins": {
            name: list(getattr(design, name).margins[:2])
            for name in ("disturbance", "extended_state", "friction_state")
        },
        "asked": [WISH.phase_margin_deg, WISH.gain_margin],
        "left": {kind: list(ground.left) for kind, ground in grounds.items()},
    }
    on_axes: dict[str, list[OnAxis]] = {}
    counted = []
    with progress_bar("peers", quiet=not shown) as progress:
        for place, (kind, ground) in enumerate(grounds.items()):
            for slope in SLOPES:
                runs = scenario_runs(scenario, ground, slope, sizes)
                lines += [f"## The paper's scenario on {TITLES[kind]}, slope {slope:g}, {sizes.seeds} seeds", ""]
                lines += [*scenario_table(runs), said_of(runs), ""]
                ises = {law: float(column(runs, law, "true_ise").mean()) for law in runs}
                facts[f"{kind}, slope {slope:g}"] = ises
            on_axes[kind], left = axis_runs(scenario, ground, sizes)
            named = ", ".join(f"{one.number} ({one.left_out})" for one in left) or "none"
            counted.append(f"- {TITLES[kind]}: axes up to number {on_axes[kind][-1].number}; left out: {named}.")
            if progress is not None:
                progress((place + 1) / len(grounds))
    runs_of = {kind: by_law([one.measures for one in ran]) for kind, ran in on_axes.items()}
    lines += [f"## Random passive axes: {sizes.axes} on each plant", ""]
    lines += [*best_table(runs_of), *axes_table(runs_of, PLUS), *axes_table(runs_of, BOTH), *counted, ""]
    typed = {
        kind: by_law([one.measures for one in ran if TYPED in one.measures])
        for kind, ran in on_axes.items()
        if any(TYPED in one.measures for one in ran)
    }
    if typed and sizes.typed_axes < sizes.axes:
        lines += [f"## The first {sizes.typed_axes} of them, by all commands where none refuses", ""]
        lines += [*best_table(typed), *axes_table(typed, TYPED)]
    facts["axes"] = {kind: {law: len(runs[law]) for law in runs} for kind, runs in runs_of.items()}
    return lines, facts


def preface(made_from: str, seconds: float) -> list[str]:
    """What was done, when and where."""
    return [
        "# control_peers",
        "",
        "What `tune` writes against other laws on four kinds of plants; the manual's page on peers describes them.",
        f"`{PLUS}` is the axis file that `tune` writes for a model of the axis, byte for byte. Every friction model is",
        "fitted to one record of the same plant; then each of its parameters is changed by",
        f"{100 * MISMATCH:.0f} %, signs drawn anew for each seed. All laws know inertia, torque constant and delay,",
        "and have the margins of `tune`. Laws marked + have the same inertia torque, preview and error filter.",
        "Plant, noise and reference are the same for all; how much a law makes of the noise is the last column.",
        "`2sep observer+` is the 2SEP model with L in the friction estimate, `luenberger+` PI with a law after",
        "Ruderman (arXiv 2504.21316): from there are the",
        "reduced-order observer of velocity and friction on the position, its real eigenvalues and an assigned slowest",
        "pole; its tangent stiffness (of the fitted 2SEP model) and the choice of its poles are this project's.",
        "`drive` is the drive's own velocity loop, PI at 8 kHz with 1 or 2 ms from the shaft's velocity to torque and",
        "back; `+ torque` adds 2SEP friction and inertia torque from the PC (0x60B2), held for 1 or 4 ms.",
        f"`{ESTIMATED}` is PI+FFFO+ on the velocity estimated from position and torque ({BANDWIDTH_HZ:g} Hz, the "
        "default);",
        f"`{SECOND}` has the effect second_surface beside the 2SEP model; `both` has both. `{ESTIMATED_PEERS[0]}`",
        f"and `{ESTIMATED_PEERS[1]}` have this estimate too.",
        f"`{TYPED}` is not told the axis: its model is what `identify` found.",
        "Intervals are 95 %: over resampled seeds, and Wilson's for shares of axes.",
        "",
        "A random axis has inertia, torque constant, delay, sensor and effects of trial_axes/random_axis, and friction",
        f"parameters within {100 * SPREAD:.0f} % of the plant's. The laws do not know the effects. x: median over axes",
        "of the other law's true ISE over that of this one. The peers' loop has the law's current limit, but no",
        "envelope.",
        "",
        f"{made_by('control_peers.py', made_from)} {seconds:.0f} s.",
        "",
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"of the paper's scenario (default {SEEDS})")
    parser.add_argument("--axes", type=int, default=AXES, help=f"random axes on each plant (default {AXES})")
    parser.add_argument(
        "--typed-axes",
        type=int,
        default=TYPED_AXES,
        help=f"of them on which all commands are run, from commission on (default {TYPED_AXES})",
    )
    parser.add_argument("--sample", action="store_true", help="a short run: logic and rough figures, no result file")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout in place of the tables")
    options = parser.parse_args(arguments)
    sizes = Sizes(2, 1, 0, 6.0) if options.sample else Sizes(options.seeds, options.axes, options.typed_axes)
    began, made_from = time.perf_counter(), commit()  # of the code that runs, whatever changes meanwhile
    lines, facts = compare(sizes, shown=not options.json)
    lines = [*preface(made_from, time.perf_counter() - began), *lines]
    if not options.sample:
        (RESULTS / "control_peers.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    print(json.dumps(facts) if options.json else "\n".join(lines))


if __name__ == "__main__":
    main()
