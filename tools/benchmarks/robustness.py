"""200 random axes under gains that were tuned to the nominal one: how many become unstable, and with what margin.

  .venv/bin/python tools/benchmarks/robustness.py [--axes N] [--first NUMBER]

Writes results/robustness.md beside this file.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import made_by, progress_bar
from trial_axes.passivity import comes_to_rest
from trial_axes.random_axis import RandomAxis, random_axis
from trial_axes.robustness import STABLE, Probe, probe

from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.control.stability import LinearAxis, Margins, loop_margins
from fffo_drive.drive.simulated.parameters import PlantConfig
from fffo_drive.evaluation.campaign import Candidate, Case, warm_up
from fffo_drive.evaluation.workers import over_cores
from fffo_drive.units import inertia_nm_s2_per_rev

HERE = Path(__file__).resolve().parent
SCENARIO = HERE.parents[1] / "configs" / "scenarios" / "paper.yaml"
CONTROLLERS = ("pi", "pi+fffo", "pi+fffo+")
# chosen on axes 0 to 199: L frozen at rest; on 200 to 399: the filter of the error; on 400 to 599: half at rest
FRESH = 400
EXTRA_DELAYS_S = (0.0, 0.001, 0.002, 0.003, 0.004, 0.005, 0.006, 0.008, 0.01, 0.012)
GAIN_FACTORS = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0)
DAMPING_FACTORS = (0.15, 0.3, 0.6, 1.0, 2.0, 4.0, 8.0, 15.0)


class Job(NamedTuple):
    """One plant under all controllers of the case."""

    label: str
    case: Case


class Found(NamedTuple):
    """What a job gave."""

    label: str
    probes: dict[str, Probe]
    passive: bool  # False: no controller can bring the axis to rest


def run_job(job: Job) -> Found:
    """All controllers on the job's plant."""
    probes = {c.name: probe(job.case, c) for c in job.case.candidates}
    return Found(job.label, probes, comes_to_rest(job.case.plant))


def margins_of(plant: PlantConfig, candidate: Candidate) -> Margins:
    """Linear margins on the axis as it is, effects left out."""
    controller = candidate.controller
    filter_s = -controller.period_s / math.log1p(-controller.error_share) if controller.error_share < 1.0 else 0.0
    linear = LinearAxis(
        inertia_nm_s2_per_rev(plant.inertia_kg_m2),
        plant.friction.viscous_nm_per_rps,
        plant.delay_s + plant.extra_delay_s,
        # a command in A makes the torque of the real constant
        plant.torque_constant_nm_per_a,
        error_filter_s=filter_s,
    )
    gain = controller.observer.gain_nm_per_rev if candidate.toggle else 0.0
    real = gain * plant.torque_constant_nm_per_a / controller.torque_constant_nm_per_a
    gains = controller.pi.proportional_a_per_rps, controller.pi.integral_a_per_rev, real
    return loop_margins(linear, *gains)


def scaled_gains(candidate: Candidate, factor: float) -> Candidate:
    """Kp, Ki and L times a factor."""
    controller = candidate.controller
    pi = controller.pi._replace(
        proportional_a_per_rps=factor * controller.pi.proportional_a_per_rps,
        integral_a_per_rev=factor * controller.pi.integral_a_per_rev,
    )
    observer = controller.observer._replace(gain_nm_per_rev=factor * controller.observer.gain_nm_per_rev)
    return candidate._replace(controller=controller._replace(pi=pi, observer=observer))


def damped(plant: PlantConfig, factor: float) -> PlantConfig:
    """All friction times a factor: D of (17)."""
    friction = plant.friction.scaled(level=factor)
    surfaces = tuple(replace(s, viscous_nm_per_rps=factor * s.viscous_nm_per_rps) for s in friction.surfaces)
    return replace(plant, friction=replace(friction, surfaces=surfaces))


def axes_table(drawn: list[RandomAxis], every: list[Found], case: Case) -> list[str]:
    """How many of those that lose energy, and which."""
    active = [axis for axis, one in zip(drawn, every, strict=True) if not one.passive]
    axes = [axis for axis, one in zip(drawn, every, strict=True) if one.passive]
    found = [one for one in every if one.passive]
    lines = [
        f"{len(active)} of them supply energy, so that no controller can bring them to rest "
        "(tools/trial_axes/passivity.py), and are omitted: "
        + (", ".join(f"{axis.number} ({', '.join(axis.effects)})" for axis in active) or "none")
        + ".",
        "",
        "| controller | stable | " + " | ".join(_verdicts(found)) + " | overshoot, median | back after stop, worst |",
    ]
    lines.append("|---|" + "---|" * (3 + len(_verdicts(found))))
    for name in CONTROLLERS:
        probes = [one.probes[name] for one in found]
        counts = Counter(p.verdict for p in probes)
        stable = [p for p in probes if p.verdict == STABLE]
        cells = [str(counts[STABLE]), *(str(counts[v]) for v in _verdicts(found))]
        cells.append(f"{100 * np.median([p.overshoot for p in stable]):.0f} %")
        cells.append(f"{max(p.beyond_rest_rps for p in stable):.2f} rps")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    lines += ["", "Linear margins of the real axis, effects left out:", ""]
    lines += [
        "| controller | of the stable: least phase | least gain | of the others: phase | gain |",
        "|---|---|---|---|---|",
    ]
    for candidate in case.candidates:
        parts: dict[bool, list[Margins]] = {True: [], False: []}
        for axis, one in zip(axes, found, strict=True):
            parts[one.probes[candidate.name].verdict == STABLE].append(margins_of(axis.plant, candidate))
        good, bad = parts[True], parts[False]
        others = "– | –"
        if bad:
            others = (
                f"{min(m.phase_deg for m in bad):.0f} to {max(m.phase_deg for m in bad):.0f} deg | "
                f"{min(m.gain for m in bad):.2f} to {max(m.gain for m in bad):.2f}"
            )
        least_phase_deg, least_gain = min(m.phase_deg for m in good), min(m.gain for m in good)
        lines.append(f"| {candidate.name} | {least_phase_deg:.0f} deg | {least_gain:.2f} | {others} |")
    lines += ["", "Axes on which a controller was not stable:", ""]
    lines += [
        "| axis | friction | delay | J | Kt | effects | " + " | ".join(CONTROLLERS) + " | phase margin, PI and FFFO |"
    ]
    lines.append("|---|" + "---|" * (6 + len(CONTROLLERS)))
    nominal = case.plant
    for axis, one in zip(axes, found, strict=True):
        if all(p.verdict == STABLE for p in one.probes.values()):
            continue
        plant = axis.plant
        both = [margins_of(plant, c).phase_deg for c in case.candidates if c.name in ("pi", "pi+fffo")]
        strengths = ", ".join(
            f"{e.name} ({', '.join(f'{k} {v:.3g}' for k, v in e.parameters.items() if 'phase' not in k)})"
            for e in plant.effects
        )
        lines.append(
            f"| {axis.number} | {axis.law} | {1e3 * plant.delay_s:.1f} ms "
            f"| {plant.inertia_kg_m2 / nominal.inertia_kg_m2:.2f} "
            f"| {plant.torque_constant_nm_per_a / nominal.torque_constant_nm_per_a:.2f} | {strengths} | "
            + " | ".join(one.probes[name].verdict for name in CONTROLLERS)
            + f" | {both[0]:.0f}, {both[1]:.0f} deg |"
        )
    worse = [
        axis.number
        for axis, one in zip(axes, found, strict=True)
        if one.probes["pi+fffo"].verdict == STABLE and one.probes["pi+fffo+"].verdict != STABLE
    ]
    said = "never" if not worse else f"on axis {', '.join(map(str, worse))}"
    return [*lines, "", f"PI+FFFO+ is unstable or cycles where PI+FFFO does not: **{said}**.", ""]


def _verdicts(found: list[Found]) -> list[str]:
    return sorted({p.verdict for one in found for p in one.probes.values()} - {STABLE})


def sweep_table(title: str, unit: str, found: list[Found]) -> list[str]:
    """Verdicts along a sweep."""
    lines = [f"## {title}", "", f"| {unit} | " + " | ".join(CONTROLLERS) + " |", "|---|" + "---|" * len(CONTROLLERS)]
    for one in found:
        cells = []
        for name in CONTROLLERS:
            p = one.probes[name]
            cells.append(
                f"{p.verdict}; overshoot {100 * p.overshoot:.0f} %, back {p.beyond_rest_rps:.3f} rps, "
                f"rest {1e3 * p.hunting_rps:.1f} mrps"
                if p.trip == 0
                else p.verdict
            )
        lines.append(f"| {one.label} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", type=int, default=200)
    parser.add_argument("--first", type=int, default=FRESH, help="number of the first random axis")
    options = parser.parse_args(arguments)
    scenario = read_scenario(SCENARIO)
    whole = case_of(scenario, 1)
    case = whole._replace(candidates=tuple(c for c in whole.candidates if c.name in CONTROLLERS))
    warm_up(case)
    axes = [random_axis(case.plant, number) for number in range(options.first, options.first + options.axes)]
    jobs = [Job(str(axis.number), case._replace(plant=axis.plant)) for axis in axes]
    delays = [Job(f"{1e3 * d:g}", case._replace(plant=replace(case.plant, extra_delay_s=d))) for d in EXTRA_DELAYS_S]
    gains = [
        Job(f"{f:g}", case._replace(candidates=tuple(scaled_gains(c, f) for c in case.candidates)))
        for f in GAIN_FACTORS
    ]
    dampings = [Job(f"{f:g}", case._replace(plant=damped(case.plant, f))) for f in DAMPING_FACTORS]
    every = [*jobs, *delays, *gains, *dampings]
    with progress_bar("axes") as progress:
        done = None if progress is None else (lambda count: progress(count / len(every)))
        results = over_cores(run_job, every, progress=done)
    parts = [len(jobs), len(delays), len(gains), len(dampings)]
    ends = np.cumsum(parts)
    found, by_delay, by_gain, by_damping = (
        results[end - size : end] for end, size in zip(ends.tolist(), parts, strict=True)
    )
    nominal = [margins_of(case.plant, c) for c in case.candidates]
    lines = [
        "# Robustness",
        "",
        "Gains of configs/scenarios/paper.yaml, tuned to the nominal axis and not retuned.",
        "tools/trial_axes/robustness.py defines unstable and limit cycle.",
        "",
        "Linear margins on the nominal axis: "
        + ", ".join(
            f"{c.name} {m.phase_deg:.0f} deg and {m.gain:.2f}" for c, m in zip(case.candidates, nominal, strict=True)
        )
        + ".",
        "",
        f"## {len(axes)} random axes (numbers {options.first} to {options.first + options.axes - 1})",
        "",
        "30 % spread on every number, delay 1 to 5 ms, five friction laws, one to three effects of up to 1.5 times",
        "their default strength.",
        "",
        *axes_table(axes, found, case),
        *sweep_table("More delay on the nominal axis", "beyond 3 ms, ms", by_delay),
        *sweep_table("More gain on the nominal axis (Kp, Ki and L together)", "factor", by_gain),
        *sweep_table("Friction damping over 100:1", "all friction times", by_damping),
        made_by("robustness.py"),
    ]
    (HERE / "results" / "robustness.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
