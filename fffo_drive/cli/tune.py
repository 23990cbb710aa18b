"""Choose gains for a fitted model: PI, observer gain, margins with the delay, and how much friction may vary.

Writes DIR/controller.yaml, the tuned keys of the `controller:` section of an axis file, and the page DIR/report.html
with report.json; with --axis also a complete axis file, DIR/AXIS, with the model and these gains; --svg also draws
every figure of the page.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import get_args

from ..config.axis import AxisFile, default_axis, read_axis
from ..config.commissioning import NOT_COMMISSIONED, commissioned
from ..config.runaway import fewer_ticks
from ..config.sections import ControllerSection, VelocitySource
from ..documents import DocumentError
from ..identification.tuning import Wish, notch_text
from ..model.parameters import ModelFile, read_model
from ..report.page import refuse_other_report, write_report
from ..report.tune import TuneSource, estimate_text, loads_text, range_text, response_text, tune_report
from ..report.tune_figures import Tuning
from ..units import text_on
from ..workflows.load_range import ask_range, range_of, with_range
from ..workflows.tune import (
    require_positive,
    section_text,
    tune,
    tune_axis,
    write_tuned_axis,
)

FIGURES = "figures"
GAINS_NAME = "controller.yaml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("model", metavar="MODEL", help="model file (YAML)")
    parser.add_argument("--out", required=True, metavar="DIR", help="output directory")
    parser.add_argument("--axis", metavar="FILE", help="axis file to copy with the new gains and model")
    parser.add_argument(
        "--bandwidth-hz",
        type=float,
        metavar="HZ",
        help="target crossover frequency (default: where integral action is largest within the margins)",
    )
    parser.add_argument(
        "--damping-ratio",
        type=float,
        default=Wish().damping_ratio,
        metavar="RATIO",
        help="damping ratio of the closed-loop poles (%(default)s)",
    )
    parser.add_argument(
        "--phase-margin-deg", type=_margin("phase_margin_deg"), default=Wish().phase_margin_deg, metavar="DEG",
        help="smallest phase margin (%(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--gain-margin",
        type=_margin("gain_margin"),
        default=Wish().gain_margin,
        metavar="RATIO",
        help="smallest gain margin (%(default)s)",
    )
    parser.add_argument(
        "--inertia-range",
        "--mass-range",
        type=float,
        nargs=2,
        metavar=("LEAST", "LARGEST"),
        help="inertia with the least and with the largest load, at the motor shaft, motor included, in kg m2 (linear "
        "axis: kg): all margins hold over it (default: the axis file's; without one it is asked for at a terminal)",
    )
    parser.add_argument(
        "--velocity",
        choices=get_args(VelocitySource),
        help="velocity that the error takes, with --axis (default: the axis file's; in place of the drive's the "
        "estimated one where, with the noise that `commission` measured, it gains)",
    )
    parser.add_argument(
        "--rate-hz", type=float, default=2000.0, metavar="HZ", help="rate of the loop, without --axis (%(default)s)"
    )
    parser.add_argument(
        "--current-limit-a",
        type=float,
        metavar="A",
        help="current limit of the controller section (default: the axis file's, or 10)",
    )
    parser.add_argument("--svg", action="store_true", help=f"also draw each figure as DIR/{FIGURES}/NAME.svg")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _margin(key: str) -> Callable[[str], float]:
    """A number in the range that this key has in an axis file."""

    def margin(text: str) -> float:
        value = float(text)
        bounds = ControllerSection.model_fields[key].metadata
        low, high = (next(getattr(one, name) for one in bounds if hasattr(one, name)) for name in ("ge", "le"))
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} is outside {low} to {high}")
        return value

    return margin


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    if options.velocity and not options.axis:
        raise DocumentError("--velocity: only an axis file says what the loop can have: give --axis")
    require_positive(rate_hz=options.rate_hz, current_limit_a=options.current_limit_a)
    model = read_model(options.model)
    axis_file = read_axis(options.axis) if options.axis else None
    inertia_range = _inertia_range(options, model, axis_file)
    axis_file = with_range(axis_file, inertia_range) if axis_file else None
    period_s = axis_file.loop.period_s if axis_file else 1.0 / options.rate_hz
    wish = Wish(options.bandwidth_hz, options.damping_ratio, options.phase_margin_deg, options.gain_margin)
    measured = commissioned(options.axis, axis_file) if axis_file else NOT_COMMISSIONED
    if axis_file:
        tuned, more = tune_axis(axis_file, model, wish, measured, options.velocity)
    else:
        tuned, more = tune(model, default_axis(model, period_s, inertia_range), wish), None
    found = tuned.design
    limit_a = options.current_limit_a or (axis_file.controller.current_limit_a if axis_file else 10.0)
    out = Path(options.out)
    copy = [] if options.axis is None else [Path(options.axis).name]
    refuse_other_report(out, "tune", GAINS_NAME, *copy)
    for name in copy:
        if (out / name).resolve() == Path(options.axis).resolve():
            raise DocumentError(f"--out: {out / name} is the axis file to copy: give another --out")
    out.mkdir(parents=True, exist_ok=True)
    section = tuned.section(limit_a)
    text = section_text(section)
    written = [out / GAINS_NAME]
    written[0].write_text(text, encoding="utf-8")
    result = tuned.summary() | {"on_the_estimate": None if more is None else more._asdict()}
    ticks = fewer_ticks(axis_file, model) if axis_file and axis_file.controller.inertia_range_kg_m2 else None
    if options.axis:
        written.append(write_tuned_axis(Path(options.axis), out, section, Path(options.model), ticks))
    commands = _commands(written[-1] if options.axis else None, Path(options.model))
    source = TuneSource(Path(options.model), model, 0.5 * period_s, text, written, commands, more)
    tuning = Tuning(tuned.axis, found, wish, model.friction_config(), tuned.by_notches, measured.response)
    page = tune_report(source, tuning, result)
    paths = write_report(page, out)
    if options.svg:
        from ..report.static import write_figures  # loads slowly

        write_figures(page.figures, out / FIGURES)
    if options.json:
        shown = {key: result[key] for key in result if key not in ("root_locus", "step")}
        print(json.dumps(shown | {"report": str(paths.page)}, indent=2))
    else:
        _print(tuning, model)
        if more is not None:
            print(estimate_text(more))
        if ticks is not None:
            print(
                f"envelope.feedback_missing_ticks: {ticks}: without feedback for longer the axis with the least "
                "inertia could gain too much speed (`config check` has the figures); a lower current limit allows more"
            )
        for path in (*written, paths.page):
            print(path)
    return 0


def _inertia_range(
    options: argparse.Namespace, model: ModelFile, axis_file: AxisFile | None
) -> tuple[float, float] | None:
    """As given, or as the user answers; None: the axis file's, or none. Raises DocumentError."""
    if options.inertia_range is not None:
        return range_of(model, *options.inertia_range)
    known = axis_file is not None and axis_file.controller.inertia_range_kg_m2 is not None
    if known or options.json or not sys.stdin.isatty():
        return None
    asked = ask_range(model.inertia_text(model.axis_config().inertia_nm_s2_per_rev), _ask)
    return None if asked is None else range_of(model, *asked)


def _ask(question: str, proposal: str) -> str | None:
    try:
        return input(f"{question} [{proposal}] ").strip() or proposal
    except EOFError:
        return None


def _commands(axis: Path | None, model: Path) -> list[str]:
    """What to type next."""
    if axis is None:
        return [
            f"# into an axis file: `model: {model}` and the section above; then",
            "fffo-drive config check AXIS.yaml",
            "fffo-drive run AXIS.yaml",
        ]
    place = shlex.quote(str(axis))
    return [
        f"fffo-drive config check {place}   # all errors at once, margins, bus load",
        f"fffo-drive run {place} --toggle ff   # one profile, recorded",
        f"fffo-drive run {place} --toggle off  # the same under PI alone",
    ]


def _print(tuning: Tuning, model: ModelFile) -> None:
    linear = model.units == "linear"
    for line in (*_lines(tuning), loads_text(tuning.axis, model)):
        print(text_on(line, linear))
    for warning in tuning.design.warnings:
        print(f"warning: {text_on(warning, linear)}", file=sys.stderr)


def _lines(tuning: Tuning) -> list[str]:
    found = tuning.design
    g = found.gains
    at_rest = f"at rest, {100.0 * g.rest_share:.3g} % of Kp and Ki, hold {g.hold_a_per_rev_s:.4g} A/rev/s"
    margins = [
        f"{name}: phase margin {one.phase_deg:.1f} deg, gain margin {one.gain:.2f}, crossover {one.crossover_hz:.1f} Hz"
        for name, one in (
            ("PI", found.margins_pi),
            ("with observer", found.margins_observer),
            (at_rest, found.margins_rest),
        )
    ]
    return [
        f"Kp {g.proportional_a_per_rps:.4g} A/rps, Ki {g.integral_a_per_rev:.4g} A/rev, "
        f"L {g.observer_nm_per_rev:.4g} Nm/rev",
        *margins,
        *filter(None, [notch_text(tuning.axis, tuning.by_notches)]),
        f"(14): Ki Kt + L - 2 B = {found.condition_14_nm_per_rev:.3g} Nm/rev; "
        f"real poles from Kp {found.real_poles_from_a_per_rps:.3g} A/rps",
        f"step: overshoot {found.overshoot_percent:.1f} %, at worst {tuning.worst_overshoot_percent:.1f} % with the "
        f"observer, settled in {1e3 * found.settled_s:.0f} ms",
        f"friction damping may vary {range_text(found.without_overshoot)} with real poles, "
        f"{range_text(found.within_margins)} within the margins",
        response_text(tuning.axis),
    ]
