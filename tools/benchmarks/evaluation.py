"""Table II beside ours, the targets of PI+FFFO+ and of what `tune` writes, the influence of the unprinted spectrum,
and the speed.

  .venv/bin/python tools/benchmarks/evaluation.py [--seeds N]

Writes results/evaluation.md beside this file.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from chain_files import in_this_process
from common import made_by

from fffo_drive.cli.progress import progress_bar
from fffo_drive.config.axis import read_axis
from fffo_drive.config.scenario import Scenario, cases_of, read_scenario, select_controllers
from fffo_drive.evaluation.campaign import run_campaign
from fffo_drive.evaluation.compare import SeedInterval
from fffo_drive.evaluation.metrics import PAPER_TABLE_2
from fffo_drive.evaluation.summary import Summary, summarise

HERE = Path(__file__).resolve().parent
CONFIGS = HERE.parents[1] / "configs"
SCENARIOS = CONFIGS / "scenarios"
PAPER = {name.lower(): name for name in PAPER_TABLE_2}
METRICS = ("ise", "mae", "max", "std")
BASE, PLUS = "pi+fffo", "pi+fffo+"
# figure, most that is allowed: per cent of PI+FFFO; for the lag milliseconds, at a crossing the whole interval counts
TARGETS = {
    "true.ise": 2.0,
    "true.mae": 20.0,
    "measured.ise": 20.0,
    "measured.mae": 50.0,
    "true.lag.mean_absolute_ms": 0.5,
    "true.crossing.fast_lag_ms": 0.5,
    "true.crossing.slow_error_mrps": 5.0,
    "effort.high_rms_a": 100.0,
    "effort.noise_rms_a": 100.0,
}
SLOPES = (0.0, -0.25, -0.5)
FLAT_ISE_PERCENT = 0.3  # on the flat reference, in place of the above
AXIS, MODEL = CONFIGS / "axis_simulated.yaml", CONFIGS / "models" / "table1.yaml"
MANY_SEEDS = 50


def evaluate(scenario: Scenario, seeds: int | None = None) -> tuple[Summary, float]:
    """Summary and seconds."""
    if seeds is not None:
        scenario = scenario._replace(file=scenario.file.model_copy(update={"seeds": seeds}))
    began = time.perf_counter()
    with progress_bar(scenario.file.name) as progress:
        done = None if progress is None else (lambda cases: progress(cases / scenario.file.seeds))
        found = run_campaign(cases_of(scenario), progress=done)
    return summarise(found, BASE), time.perf_counter() - began


def processor_s() -> float:
    """Processor time of this process and of all that come from it; those that have ended count with their parent.

    Workers are children of a fork server, so that resource.RUSAGE_CHILDREN of this process does not have them.
    """
    fields = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended
            fields[int(stat.parent.name)] = stat.read_text().rpartition(")")[2].split()
    family, seen = {os.getpid()}, 0
    while len(family) > seen:
        seen = len(family)
        family |= {pid for pid, values in fields.items() if int(values[1]) in family}
    ticks = sum(int(ticks) for pid in family if pid in fields for ticks in fields[pid][11:15])  # utime to cstime
    return ticks / os.sysconf("SC_CLK_TCK")


def with_slope(scenario: Scenario, slope: float) -> Scenario:
    """The same with another spectrum."""
    assert scenario.file.reference is not None
    reference = scenario.file.reference.model_copy(update={"slope": slope})
    return scenario._replace(file=scenario.file.model_copy(update={"reference": reference}))


def tuned(scenario: Scenario, place: Path) -> Scenario:
    """The scenario on the axis file that `tune MODEL --axis AXIS` writes; PI+FFFO keeps the paper's gains."""
    in_this_process("tune", MODEL, "--axis", AXIS, "--out", place)
    paper = scenario.axis.controller
    gains = {
        "proportional_a_per_rps": paper.proportional_a_per_rps,
        "integral_a_per_rev": paper.integral_a_per_rev,
        "gain_nm_per_rev": paper.observer.gain_nm_per_rev,
    }
    controllers = {
        BASE: scenario.file.controllers[BASE].model_copy(update=gains),
        PLUS: scenario.file.controllers[PLUS],
    }
    file = scenario.file.model_copy(update={"controllers": controllers})
    path = place / AXIS.name
    return scenario._replace(file=file, axis_path=path, axis=read_axis(path))


def text(interval: SeedInterval, digits: int = 1) -> str:
    """12.3 [11.0, 13.6]"""
    return f"{interval.value:.{digits}f} [{interval.low:.{digits}f}, {interval.high:.{digits}f}]"


def table_2(summary: Summary) -> list[str]:
    """Table II beside ours, and whether the intervals keep the order."""
    lines = ["| control | " + " | ".join(f"{m.upper()} % (paper)" for m in METRICS) + " |", "|---|---|---|---|---|"]
    for name in summary.controllers:
        published = PAPER_TABLE_2.get(PAPER.get(name, ""))
        cells = []
        for metric in METRICS:
            cell = text(summary.figures[f"measured.{metric}"].percent[name], 1)
            cells.append(f"{cell} ({published[metric]:.0f})" if published else cell)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    lines += ["", "Order of the paper's three, ISE, MAE and STD, intervals apart: " + order(summary) + ".", ""]
    return lines


def order(summary: Summary) -> str:
    """Whether PI+FFFO is best and PI worst with intervals that do not overlap."""
    said = []
    for metric in ("ise", "mae", "std"):
        percent = summary.figures[f"measured.{metric}"].percent
        low, middle, high = percent[BASE], percent["pi+fbfo"], percent["pi"]
        apart = low.high < middle.low and middle.high < high.low
        said.append(f"{metric.upper()} {'yes' if apart else 'no'}")
    return ", ".join(said)


def targets(summary: Summary, flat: bool = True) -> list[str]:
    """What PI+FFFO+ must reach, and what it does."""
    lines = ["| figure | PI+FFFO+ | at most | PI+FFFO | reached |", "|---|---|---|---|---|"]
    for name, most in (TARGETS | ({"true.ise": FLAT_ISE_PERCENT} if flat else {})).items():
        comparison = summary.figures.get(name)
        if comparison is None:
            lines.append(f"| {name} | – | {most:g} | – | no: some runs have none |")
            continue
        unit = name.rpartition("_")[2]
        reached = comparison.percent[PLUS].value <= most
        if unit in ("ms", "mrps"):
            own, other = comparison.absolute[PLUS], comparison.absolute[BASE]
            cells = f"{text(own, 2)} {unit} | {most:g} {unit} | {text(other, 2)} {unit}"
            reached = (own.high if "crossing" in name else own.value) <= most
        else:
            own = comparison.percent[PLUS]
            cells = f"{text(own, 2)} % | {most:g} % | {comparison.absolute[BASE].value:.4g}"
        lines.append(f"| {name} | {cells} | {'yes' if reached else 'NO'} |")
    return [*lines, ""]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, help="of each scenario (default: as in its file)")
    options = parser.parse_args(arguments)
    lines = [
        "# Evaluation",
        "",
        "Intervals are 95 %, over resampled seeds.",
        "",
    ]
    paper, _ = evaluate(read_scenario(SCENARIOS / "paper.yaml"), options.seeds)
    lines += [f"## Table II: configs/scenarios/paper.yaml, {len(paper.seeds)} seeds", "", *table_2(paper)]
    for file in ("paper_wrong_friction", "paper_single_surface"):
        summary, _ = evaluate(read_scenario(SCENARIOS / f"{file}.yaml"), options.seeds)
        lines += [f"## Targets: configs/scenarios/{file}.yaml, {len(summary.seeds)} seeds", "", *targets(summary)]
    with TemporaryDirectory(prefix="tuned_") as place:
        written = tuned(read_scenario(SCENARIOS / "paper_wrong_friction.yaml"), Path(place))
        for slope in (SLOPES[0], SLOPES[-1]):
            summary, _ = evaluate(with_slope(written, slope), options.seeds)
            lines += [f"## What `tune` writes for the same axis, slope {slope:g}, {len(summary.seeds)} seeds", ""]
            lines += targets(summary, flat=slope == 0.0)
    lines += [
        "## Influence of the spectrum, which the paper does not print",
        "",
        "The same with amplitudes f^slope: reversals a minute, Table II, and the targets with 10 % wrong friction.",
        "",
        "paper.yaml is flat (slope 0). That was chosen after the ten seeds of f^-0.5 had been run and seen, for the",
        "number of reversals; the target for the lag at reversals is met with the flat spectrum only. Effort omits",
        "0.05 s at both ends, and its band above 200 Hz was added; both were decided after the first figures too.",
        "",
    ]
    for slope in SLOPES[1:]:
        found, _ = evaluate(with_slope(read_scenario(SCENARIOS / "paper.yaml"), slope), options.seeds)
        reversals = found.figure("measured.lag.reversals", BASE)
        wrong = select_controllers(read_scenario(SCENARIOS / "paper_wrong_friction.yaml"), [BASE, PLUS])
        reached, _ = evaluate(with_slope(wrong, slope), options.seeds)
        lines += [f"### slope {slope:g}: {reversals:.0f} reversals", "", *table_2(found), *targets(reached, flat=False)]
    before_s = processor_s()
    many, seconds = evaluate(read_scenario(SCENARIOS / "paper.yaml"), MANY_SEEDS if options.seeds is None else 5)
    spent_s = processor_s() - before_s
    runs = len(many.seeds) * len(many.controllers)
    cores = len(os.sched_getaffinity(0))
    lines += [
        "## Speed",
        "",
        f"{runs} evaluations of 60 s on {cores} cores: {seconds:.0f} s without compiling, with a load average of "
        f"{os.getloadavg()[0]:.1f}; {spent_s:.0f} s of processor time, so {spent_s / cores:.0f} s on cores of its own.",
        "",
        made_by("evaluation.py"),
    ]
    (HERE / "results" / "evaluation.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
