"""Fit a model to logs of one axis: parameters with uncertainties, residuals, frequency response.

LOG is a recording (MCAP), or any log that `fffo-drive import` reads; one that leaves a doubt about a column or a unit
is refused with the `import` line that answers it. Several logs are fitted together. --drive is a YAML file of declared
facts (torque constant, resolver, poles and slots, columns of other programs' logs; `fffo-drive config schema facts`);
recordings of this program and of `fffo-drive import` contain them. If the logs show a constant
torque, friction that differs by direction, gravity or ripple over the angle, it is fitted as well. Writes
DIR/model.yaml for the controller, and the page DIR/report.html with DIR/report.json; --svg also draws every figure of
the page. With --prior, a few seconds of motion are enough: other drives of the same type supply what the logs do not
determine. If the drive differs from them, the program says so and uses its logs alone.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from ..identification.coverage import coverage_lines
from ..identification.cyclic import cyclic_lines
from ..identification.dataset import where_command_acts
from ..identification.results import INERTIA
from ..identification.stretches import load_logs
from ..model.parameters import write_model
from ..report.identify import NOT_TUNE, IdentifySource, identify_report, tune_command
from ..report.page import refuse_other_report, write_report
from ..units import inertia_kg_m2, text_on
from ..workflows.identify import identify
from ..workflows.recorded_facts import facts_for
from .exits import printable
from .prior import add_prior_arguments, prior_lines, prior_of
from .progress import progress_bar

FIGURES = "figures"
MODEL_NAME = "model.yaml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("logs", metavar="LOG", nargs="+", help="recordings or tables of one axis")
    parser.add_argument(
        "--drive", metavar="FILE", help="declared facts about the drive (YAML); recordings contain them"
    )
    parser.add_argument(
        "--out", required=True, metavar="DIR", help="directory for model.yaml, report.html and report.json"
    )
    parser.add_argument("--name", help="name of the model (default: the directory's)")
    parser.add_argument("--svg", action="store_true", help=f"also draw each figure as DIR/{FIGURES}/NAME.svg")
    parser.add_argument("--json", action="store_true", help="print the parameters as JSON")
    add_prior_arguments(parser)


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    facts = facts_for(options.drive, options.logs)
    out = Path(options.out)
    refuse_other_report(out, "identify", MODEL_NAME)
    with progress_bar("read", options.json) as bar:
        records = [where_command_acts(record) for record in load_logs(options.logs, facts, bar)]
    for record in records:
        for warning in record.warnings:
            print(f"warning: {printable(warning)}", file=sys.stderr)
    prior = prior_of(options, options.logs, facts)
    with progress_bar("identify", options.json) as bar:
        name = options.name or out.resolve().name
        found = identify(records, facts, name, None if bar is None else bar, prior)
        out.mkdir(parents=True, exist_ok=True)
        write_model(out / MODEL_NAME, found.model)
        source = IdentifySource(name, facts, Path(options.drive) if options.drive else None, out / MODEL_NAME)
        page = identify_report(
            source, found.fit, records, found.residuals, found.result, found.coverage, found.cyclic, prior
        )
        paths = write_report(page, out)
    if options.svg:
        from ..report.static import write_figures  # loads slowly

        write_figures(page.figures, out / FIGURES)
    if options.json:
        keys = ("parameters", "effects", "remarks", "doubts", "warnings", "sensor_delay_s", "sensor_delay_sd_s")
        printed = {key: found.result[key] for key in (*keys, "prior") if key in found.result}
        print(json.dumps(printed | {"report": str(paths.page)}, indent=2))
    else:
        print("\n".join(coverage_lines(found.coverage, facts.units == "linear")))
        _print(found.result)
        if prior is not None:
            print("\n".join(prior_lines(prior)))
        if found.cyclic is not None:
            print("\n".join(cyclic_lines(found.cyclic)))
        print(out / MODEL_NAME)
        print(paths.page)
        print("next: " + (tune_command(source) if page.verdict.next_step == "tune" else NOT_TUNE))
    return 0


def _print(result: dict[str, Any]) -> None:
    for row in result["parameters"]:
        if not row["fitted"]:
            continue
        scale, unit = 1.0, row["unit"]
        if row["name"] == INERTIA and result["units"] == "rotary":  # as the model file and the page have it
            scale, unit = inertia_kg_m2(1.0), "kg m2"
        sd = row["source"] if row["sd"] is None else f"{scale * row['sd']:.2g}"
        print(f"{row['symbol']:>10} {scale * row['value']:>12.5g} +- {sd:<10} {unit}")
    for effect in result["effects"]:
        print(effect_line(effect))
    if result["sensor_delay_s"] is not None:
        sd_s = result["sensor_delay_sd_s"]
        spread = "" if sd_s is None else f" +- {1e3 * sd_s:.2g}"
        print(
            f"velocity is {1e3 * result['sensor_delay_s']:.4g}{spread} ms behind the position; Td above is without it"
        )
    torque, torque_unit, speed_unit = (text_on(word, result["units"] == "linear") for word in ("torque", "Nm", "rps"))
    for name, run in result["residuals"].items():
        print(
            f"{name}: {torque} residual {run['torque_rms_nm']:.3g} {torque_unit} "
            f"({run['torque_relative_percent']:.2f} %), velocity {run['velocity_rms_rps']:.3g} {speed_unit} over "
            f"{run['velocity_window_s']:g} s"
        )
    for doubt in result["doubts"]:
        print(f"not determined: {doubt['symbol']}: {doubt['reason']}; what would determine it: {doubt['excitation']}")
    for warning in result["warnings"]:
        print(f"warning: {printable(warning)}", file=sys.stderr)


def effect_line(effect: dict[str, Any]) -> str:
    """An effect with its numbers, and what it takes of the residual that all others leave."""
    numbers = []
    for row in effect["parameters"]:
        spread = "" if row["sd"] is None else f" +- {row['sd']:.2g}"
        place = "" if row["run"] is None else f" in {row['run']}"
        numbers.append(f"{row['symbol']} {row['value']:.4g}{spread} {row['unit']}{place}".rstrip(" -"))
    share = effect.get("share_of_the_others_residual")
    share_text = "" if share is None else f" ({100.0 * share:.0f} % of what the others leave)"
    return f"{effect['name']}{share_text}: {', '.join(numbers)}"
