"""What each part of PI+FFFO+ contributes: on the paper's scenario with friction 10 % wrong, a hard and a smooth one.

  .venv/bin/python tools/benchmarks/ablation.py [--seeds N]

Writes results/ablation.md beside this file and tools/pictures/ablation.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from common import made_by

from fffo_drive.cli.progress import progress_bar
from fffo_drive.config.scenario import ControllerVariant, Scenario, cases_of, read_scenario
from fffo_drive.evaluation.campaign import run_campaign
from fffo_drive.evaluation.compare import SeedInterval
from fffo_drive.evaluation.summary import Summary, summarise
from fffo_drive.formats import PAPER_LAW
from fffo_drive.report.figures import Figure, Group, LevelLine, PlotAxis, grouped_bars
from fffo_drive.report.static import write_overview

HERE = Path(__file__).resolve().parent
SCENARIOS = HERE.parents[1] / "configs" / "scenarios"
PICTURE = HERE.parent / "pictures" / "ablation.png"
NAMES = {"paper_wrong_friction": "paper", "hard": "hard", "smooth": "smooth"}
BASE = "PI+FFFO"
FILTER_S = 0.0002  # of the error, as in the scenarios
SHOWN = ("PI", "PI+FBFO", "FFFO+inertia", "FFFO+inertia+preview", "FFFO+ (all)", "all, no friction")
COLUMNS = {
    "true.ise": "true ISE",
    "true.mae": "true MAE",
    "measured.ise": "measured ISE",
    "measured.mae": "measured MAE",
    "true.lag.mean_absolute_ms": "lag",
    "effort.high_rms_a": "effort > 100 Hz",
    "effort.noise_rms_a": "effort > 200 Hz",
}


def variants() -> dict[str, ControllerVariant]:
    """Everything that is compared."""

    def variant(
        toggle: str,
        gain: float | None = None,
        filter_s: float | None = None,
        learns_in: str = "friction",
        **parts: bool,
    ) -> ControllerVariant:
        changes: dict[str, object] = {"gain_nm_per_rev": gain, "error_filter_s": filter_s, "learns_in": learns_in}
        if learns_in == "integral":
            changes["at_rest"] = {"gain_share": 1.0, "release_friction": True}
        changes["feedforward"] = PAPER_LAW["feedforward"] | parts
        return ControllerVariant.model_validate({"law": "paper", "toggle": toggle, **changes})

    every = {"inertia": True, "preview": True, "delay_aware": True}
    return {
        "PI": variant("off"),
        "PI+FBFO": variant("fb"),
        BASE: variant("ff"),
        "PI+FFFO, L = 0": variant("ff", 0.0),
        "PI+FFFO, L = 10": variant("ff", 10.0),
        "FFFO+preview": variant("ff", preview=True),
        "FFFO+delay-aware": variant("ff", delay_aware=True),
        "FFFO+inertia": variant("ff", inertia=True),
        "FFFO+inertia+delay-aware": variant("ff", inertia=True, delay_aware=True),
        "FFFO+inertia+preview": variant("ff", inertia=True, preview=True),
        "FFFO+filter": variant("ff", None, FILTER_S),
        "FFFO+inertia+preview+delay-aware": variant("ff", **every),
        "FFFO+ (all)": ControllerVariant(toggle="ff"),  # the law of the axis file
        "all, L in the estimate": variant("ff", None, FILTER_S, **every),
        "all, L = 0": variant("ff", 0.0, FILTER_S, "integral", **every),
        "all, L = 10": variant("ff", 10.0, FILTER_S, "integral", **every),
        "all, friction on feedback": variant("fb", None, FILTER_S, **every),
        "all, no friction": variant("off", None, FILTER_S, **every),
    }


def evaluate(scenario: Scenario, seeds: int | None) -> Summary:
    """All variants on one scenario."""
    changes: dict[str, object] = {"controllers": variants(), "percent_of": BASE}
    if seeds is not None:
        changes["seeds"] = seeds
    scenario = scenario._replace(file=scenario.file.model_copy(update=changes))
    with progress_bar(scenario.file.name) as progress:
        done = None if progress is None else (lambda cases: progress(cases / scenario.file.seeds))
        return summarise(run_campaign(cases_of(scenario), progress=done), BASE)


def table(name: str, summary: Summary) -> list[str]:
    """Markdown of one scenario."""
    lines = [
        f"## {name}",
        "",
        f"Per cent of {BASE} (lag in ms), {len(summary.seeds)} seeds, 95 % intervals over resampled seeds.",
        "",
        "| controller | " + " | ".join(COLUMNS.values()) + " |",
        "|---|" + "---|" * len(COLUMNS),
    ]
    for controller in summary.controllers:
        cells = []
        for key in COLUMNS:
            if key not in summary.figures:
                cells.append("–")
                continue
            comparison = summary.figures[key]
            if key.endswith("_ms"):
                cells.append(text(comparison.absolute[controller], 2))
            else:
                cells.append(text(comparison.percent[controller], 1))
        lines.append(f"| {controller} | " + " | ".join(cells) + " |")
    return [*lines, "", *(f"- {failure}" for failure in summary.failures), ""]


def text(interval: SeedInterval, digits: int) -> str:
    """12.3 [11.0, 13.6]"""
    return f"{interval.value:.{digits}f} [{interval.low:.{digits}f}, {interval.high:.{digits}f}]"


def picture(summaries: dict[str, Summary]) -> list[list[Figure]]:
    """MAE against true and measured velocity, of the controllers that show most."""
    colours = ("orange", "green", "grey", "purple", "blue", "ink")
    rows = []
    for kind, said in (("true", "the shaft's velocity"), ("measured", "the measured velocity")):
        groups = {}
        for controller, colour in zip(SHOWN, colours, strict=True):
            found = [summary.figures[f"{kind}.mae"].percent[controller] for summary in summaries.values()]
            groups[controller] = Group(
                [i.value for i in found], colour, [i.low for i in found], [i.high for i in found]
            )
        rows.append(
            [
                Figure(
                    name=f"ablation-{kind}",
                    kind="bars",
                    title=f"Mean absolute error against {said}",
                    caption="Ten seeds; whiskers: 95 % intervals.",
                    x=PlotAxis("scenario", "-", categories=tuple(summaries)),
                    y=PlotAxis(f"share of {BASE}", "%"),
                    series=tuple(grouped_bars(groups, {}, "")),
                    levels=(LevelLine(100.0, BASE),),
                    height_px=240,
                )
            ]
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything and write table and picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, help="of each scenario (default: as in its file)")
    options = parser.parse_args(arguments)
    summaries = {
        name: evaluate(read_scenario(SCENARIOS / f"{file}.yaml"), options.seeds) for file, name in NAMES.items()
    }
    lines = [
        "# What each part contributes",
        "",
        "paper: five surfaces, 0.01 to 10 Hz, friction parameters 10 % wrong",
        "with random signs. hard: 0.1 to 1.5 rps, cogging, dwell, asymmetry, friction 30 % and inertia 20 % wrong,",
        "delay 20 % too short. smooth: one sine of 15 rps and 1 Hz, a single surface that the model describes exactly.",
        "",
    ]
    for name, summary in summaries.items():
        lines += table(name, summary)
    lines.append(made_by("ablation.py"))
    (HERE / "results" / "ablation.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    write_overview(picture(summaries), [PICTURE])
    print("\n".join(lines))


if __name__ == "__main__":
    main()
