"""The report of an identification: the parameters and how well they are known, what is not determined, the residual."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..identification.coverage import Coverage
from ..identification.cyclic import CyclicError
from ..identification.dataset import Record
from ..identification.facts import DriveFacts
from ..identification.fit import Fit
from ..identification.population import AgainstPopulation
from ..identification.residuals import RunResidual
from ..identification.results import CONFIDENCE, INERTIA
from ..units import NORMAL_95, inertia_kg_m2, name_on, unit_in
from . import identify_figures as draw
from . import response_figures
from .coverage import coverage_section
from .cyclic import cyclic_section, cyclic_table
from .document import (
    Cell,
    Heading,
    Line,
    Listing,
    Report,
    ReportProvenance,
    Row,
    Section,
    SourceFile,
    Table,
    Verdict,
    count,
    number,
    provenance,
    significant,
    source_file,
)
from .figures import Figure
from .identify_figures import IdentifyWords
from .population import population_table

LARGE_RESIDUAL_PERCENT = 10.0  # of the torque: the model misses something that matters
USELESS_RESIDUAL_PERCENT = 50.0
NOT_TUNE = "do not tune with this model: record the motion that determines the rest, and identify again"
LEAST_SHARE = 0.02  # of the residual's power that a function of the motion explains, to be reported
SURE = 1e-3
ROTARY = IdentifyWords()
LINEAR = IdentifyWords("force", "N", "m", "m/s", "N s/m", "command", "A", linear=True)


class IdentifySource(NamedTuple):
    """What was fitted, and what was written."""

    name: str
    facts: DriveFacts
    facts_file: Path | None  # None: the recordings carry them
    model_file: Path


def words_of(facts: DriveFacts) -> IdentifyWords:
    """Names of quantities on this axis; the command's unit is the one declared for its column."""
    words = LINEAR if facts.units == "linear" else ROTARY
    column = (facts.columns or {}).get("current_command_a")
    unit = None if column is None or isinstance(column, str) else column.unit
    return words if unit is None else words._replace(command_unit=unit)


def identify_report(
    source: IdentifySource, fit: Fit, records: Sequence[Record], runs: Sequence[RunResidual], results: dict[str, Any],
    coverage: Coverage, cyclic: CyclicError | None = None, prior: AgainstPopulation | None = None,
) -> Report:  # fmt: skip
    """The report of a fit. `runs` of residuals.run_residuals, `results` of results.report."""
    words = words_of(source.facts)
    shown = coverage_section(records, coverage, source.facts.units == "linear")
    tables = [_parameters(results)]
    tables += [] if prior is None else [population_table(prior)]
    tables += [_effects(results, words)] if results["effects"] else []
    tables += [_doubts(results)] if results["doubts"] else []
    tables += [_runs(results, words), _dependence(results, words)]
    tables += [] if cyclic is None else [cyclic_table(cyclic)]
    sections = (shown, *_sections(fit, records, runs, results, words))
    seconds = sum(record.duration_s for record in records)
    return Report(
        kind="identify",
        title=f"Identification of {source.facts.name or source.name}",
        subtitle=f"{len(records)} {'logs' if len(records) > 1 else 'log'}, {seconds:.4g} s at "
        f"{1.0 / records[0].period_s:.5g} Hz, fitted together: {', '.join(record.name for record in records)}.",
        verdict=_verdict(source, results, words),
        tables=tuple(tables),
        sections=sections if cyclic is None else (*sections, cyclic_section(cyclic)),
        provenance=_provenance(source, records, results),
        results=results,
        opening="friction",
        listings=(_next_steps(source),),
    )


def _verdict(source: IdentifySource, results: dict[str, Any], words: IdentifyWords) -> Verdict:
    doubted = [doubt["symbol"] for doubt in results["doubts"]]
    fitted = [row["symbol"] for row in results["parameters"] if row["of_the_model"] and row["fitted"]]
    determined = [symbol for symbol in fitted if symbol not in doubted]
    percent = {name: run["torque_relative_percent"] for name, run in results["residuals"].items()}
    worst = max(percent.values())
    if worst > LARGE_RESIDUAL_PERCENT:
        left = significant(worst, 2)
        headline = f"The residual is up to {left} % of the {words.torque}: an important effect is missing."
    elif doubted:
        headline = f"The data determine {', '.join(determined)}. They do not determine {', '.join(doubted)}."
    else:
        left = _span(percent.values())
        headline = f"The data determine all {len(fitted)} parameters; the residual is {left} % of the {words.torque}."
    doubts = [f"{d['symbol']}: {d['reason']}; what would determine it: {d['excitation']}." for d in results["doubts"]]
    useless = worst > USELESS_RESIDUAL_PERCENT or INERTIA in [doubt["name"] for doubt in results["doubts"]]
    doubtful = bool(doubted) or worst > LARGE_RESIDUAL_PERCENT
    quality = _quality(results, words)
    good = quality[0].removeprefix("Quality: ")
    lines = [Line(label="What", text=_known(results, doubted)), Line(label="How good", text=good)]
    lines += [Line(label="How sure", text=doubt) for doubt in doubts[:1]]
    if useless:
        lines.append(Line(label="Next", text=f"{NOT_TUNE[0].upper()}{NOT_TUNE[1:]}."))
    else:
        lines.append(Line(label="Next", text="Choose gains for this model:", command=tune_command(source)))
    return Verdict(
        headline=headline,
        finding="a model with a large residual" if worst > LARGE_RESIDUAL_PERCENT else "a model of the axis",
        confidence="cannot tell" if useless else "probable" if doubtful else "certain",
        next_step="record more" if useless else "tune",
        alarm=useless,
        lines=lines,
        reasons=quality[1:],
        cautions=[*results["warnings"], *_remaining(results), *doubts],
    )


def _known(results: dict[str, Any], doubted: Sequence[str]) -> str:
    """Inertia, Coulomb friction, delay and the rest of the model that the data determine, in one line."""
    known = []
    for p in results["parameters"]:
        if not (p["of_the_model"] and p["fitted"]) or p["symbol"] in doubted or p["name"] == "offset_nm":
            continue
        value, unit = p["value"], "" if p["unit"] == "-" else f" {p['unit'].replace('^2', '²')}"
        if p["name"] == INERTIA and results["units"] == "rotary":
            value, unit = inertia_kg_m2(value), " kg m²"
        known.append(f"{p['symbol']} {significant(value)}{unit}")
    return ", ".join(known) + "."


def tune_command(source: IdentifySource) -> str:
    """What to type next."""
    return shlex.join(["fffo-drive", "tune", str(source.model_file), "--out", str(source.model_file.parent / "tune")])


def _span(values: Any) -> str:
    low, high = (significant(value, 2) for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _quality(results: dict[str, Any], words: IdentifyWords) -> list[str]:
    """The quality line: torque residual, and error of the velocity simulated freely."""
    runs = results["residuals"].values()
    median = _span([run["velocity_median_rps"] for run in runs])
    window_s = next(iter(runs))["velocity_window_s"]
    share = _span([run["torque_relative_percent"] for run in runs])
    friction = _span([run["friction_relative_percent"] for run in runs])
    lines = [
        f"Quality: {words.torque} residual {share} % of the motor torque ({friction} % of the friction); "
        f"free simulation over {window_s:g} s is off by {median} {words.velocity_unit} in the median window."
    ]
    loss = results["fit"]["literal_stribeck_loss_ratio"]
    if loss is not None and loss > 1.005:
        lines.append(
            f"The falling Stribeck curve fits: the rising (literal) one has {significant(loss)} times its loss."
        )
    return lines


def _remaining(results: dict[str, Any]) -> list[str]:
    """Functions of the motion on which the residual still depends."""
    found = []
    for name, run in results["residuals"].items():
        strong = [
            f"{d['function']} (r = {d['correlation']:+.2f})".replace("-", "\u2212")
            for d in run["dependence"]
            if d["p_value"] < SURE and d["correlation"] ** 2 > LEAST_SHARE
        ]
        if strong:
            found.append(f"{name}: the residual still depends on {', '.join(strong)}: an effect that the model lacks.")
    return found


def _digits(value: float, sd: float | None) -> int:
    """Number of digits that shows two digits of the standard deviation."""
    if sd is None or sd <= 0.0 or value == 0.0:
        return 4
    return min(9, max(3, math.floor(math.log10(abs(value))) - math.floor(math.log10(sd)) + 2))


def _parameters(results: dict[str, Any]) -> Table:
    doubted = {doubt["name"]: doubt for doubt in results["doubts"]}
    rows = []
    for p in results["parameters"]:
        if not p["fitted"]:
            continue
        source = p["source"] + (", not determined" if p["source"] == "fitted" and p["name"] in doubted else "")
        if p["name"] == "offset_nm":
            continue  # the table of effects has it
        source = source if p["of_the_model"] else "beside the model"
        rows.append(_parameter_row(p["symbol"], p["unit"], p, source))
        if p["name"] == "inertia_nm_s2_per_rev" and results["units"] == "rotary":
            rows.append(_parameter_row("J", "kg m²", _scaled(p, inertia_kg_m2(1.0)), source))
    lag = results["sensor_delay_s"]
    if lag is not None:
        sd = results["sensor_delay_sd_s"]
        ends = None if sd is None else [lag - NORMAL_95 * sd, lag + NORMAL_95 * sd]
        row = {"value": lag, "sd": sd, "interval_95": ends, "statistical_sd": sd or math.nan}
        row |= {"specification_sd": math.nan, "windows_that_tell": math.nan}
        rows.append(_parameter_row("velocity lag", "s", row, "regression"))
    constant = results["torque_constant_nm_per_a"]
    dash = Cell(text="–")
    unit = "N per command" if results["units"] == "linear" else "Nm/A"
    rows.append(Row(label="Kt", unit=unit, cells=[number(constant, 6), *[dash] * 5, Cell(text="declared")]))
    note = (
        f"Below each value: its {100 * CONFIDENCE:g} % interval. Standard deviation: noise (each window counts once, "
        "because neighbouring rows may be correlated), and specification (disagreement beyond the noise between fits "
        "with observers of three bandwidths, whose mean is the value, and the bias from sensor noise). Windows: "
        "effective number of quarter-second windows that determine it. Velocity lag: of the drive's velocity behind "
        "its position."
    )
    columns = [
        Heading(label="value"), Heading(label="sd"), Heading(label="sd", unit="%"),
        Heading(label="noise", group="parts of sd"), Heading(label="specification", group="parts of sd"),
        Heading(label="windows"), Heading(label="source", words=True),
    ]  # fmt: skip
    return Table(name="parameters", title="Parameters", note=note, corner="parameter", columns=columns, rows=rows)


def _scaled(parameter: dict[str, Any], factor: float) -> dict[str, Any]:
    scaled = dict(parameter)
    for key in ("value", "sd", "statistical_sd", "specification_sd"):
        scaled[key] = None if parameter[key] is None else factor * parameter[key]
    ends = parameter["interval_95"]
    scaled["interval_95"] = None if ends is None else [factor * end for end in ends]
    return scaled


def _parameter_row(label: str, unit: str, p: dict[str, Any], source: str) -> Row:
    value, sd = p["value"], p["sd"]
    low, high = p["interval_95"] or (None, None)
    nothing = math.nan
    cells = [
        number(value, _digits(value, sd), low=low, high=high),
        number(nothing if sd is None else sd, 2),
        number(nothing if sd is None or abs(value) < 2.0 * sd else 100.0 * sd / abs(value), 2),
        number(p["statistical_sd"] if sd is not None else nothing, 2),
        number(p["specification_sd"] if sd is not None else nothing, 2),
        number(p["windows_that_tell"] if sd is not None else nothing, 3),
        Cell(text=source),
    ]
    return Row(label=label, unit="" if unit == "-" else unit.replace("^2", "²"), cells=cells)


def _effects(results: dict[str, Any], words: IdentifyWords) -> Table:
    rows = []
    for effect in results["effects"]:
        for k, p in enumerate(effect["parameters"]):
            low, high = p["interval_95"] or (None, None)
            label = f"{effect['name']}: {p['symbol']}" + (f", {p['run']}" if p["run"] else "")
            rows.append(
                Row(
                    label=label,
                    unit="" if p["unit"] == "-" else p["unit"],
                    cells=[
                        number(p["value"], _digits(p["value"], p["sd"]), low=low, high=high),
                        number(math.nan if p["sd"] is None else p["sd"], 2),
                        number(100.0 * effect.get("share_of_the_others_residual", math.nan) if k == 0 else math.nan, 2),
                        _p(effect["p"]) if k == 0 and "p" in effect else Cell(text=""),
                        Cell(text=effect["meaning"] if k == 0 else ""),
                    ],
                )
            )
    return Table(
        name="effects", title="Beside friction", corner="effect", rows=rows,
        note="Searched for first, and part of the model file: "
             + words.text("constant torque, friction by direction, gravity, ripple over the angle.")
             + " Share: of the squared residual that the others leave. p: probability of a chance finding, over "
               "everything that was tried.",
        columns=[
            Heading(label="value"), Heading(label="sd"), Heading(label="share", unit="%"), Heading(label="p"),
            Heading(label="what it is", words=True),
        ],
    )  # fmt: skip


def _doubts(results: dict[str, Any]) -> Table:
    symbols = {p["name"]: p["symbol"] for p in results["parameters"]}
    rows = [
        Row(
            label=doubt["symbol"],
            cells=[
                Cell(text=doubt["reason"]),
                Cell(text=", ".join(symbols.get(name, name) for name in doubt["confused_with"]) or "–"),
                Cell(text=doubt["excitation"]),
            ],
        )
        for doubt in results["doubts"]
    ]
    return Table(
        name="doubts", title="What the data do not determine", corner="parameter",
        note="The model file contains values for these; do not rely on them.",
        columns=[
            Heading(label="why", words=True), Heading(label="goes with", words=True),
            Heading(label="excitation that would determine it", words=True),
        ],
        rows=rows,
    )  # fmt: skip


def _runs(results: dict[str, Any], words: IdentifyWords) -> Table:
    columns = [
        Heading(label="length", unit="s"), Heading(label="loop"), Heading(label="gaps"),
        Heading(label="rms", unit=words.torque_unit, group=f"{words.torque} residual"),
        Heading(label="of all", unit="%", group=f"{words.torque} residual"),
        Heading(label="sliding", unit=words.torque_unit, group=f"{words.torque} residual"),
        Heading(label="presliding", unit=words.torque_unit, group=f"{words.torque} residual"),
        Heading(label="mean forward", unit=words.torque_unit, group=f"{words.torque} residual"),
        Heading(label="mean backward", unit=words.torque_unit, group=f"{words.torque} residual"),
        Heading(label="rms", unit=words.velocity_unit, group="velocity, free for 0.2 s"),
        Heading(label="median", unit=words.velocity_unit, group="velocity, free for 0.2 s"),
    ]  # fmt: skip
    rows = []
    for run in results["runs"]:
        r = results["residuals"][run["name"]]
        regime = r["by_regime"]
        rows.append(
            Row(
                label=run["name"],
                cells=[
                    number(run["duration_s"], 4), Cell(text="closed" if run["closed_loop"] else "open"),
                    count(run["gaps"]), number(r["torque_rms_nm"]), number(r["torque_relative_percent"]),
                    *(number(regime[key]) for key in ("sliding", "presliding")),
                    *(number(regime[key], 2) for key in ("forward_mean_nm", "backward_mean_nm")),
                    number(r["velocity_rms_rps"]), number(r["velocity_median_rps"]),
                ],
            )
        )  # fmt: skip
    return Table(
        name="runs", title="Residuals", corner="log", columns=columns, rows=rows,
        note="Where the Stribeck curve falls, a free simulation is unstable and a few windows diverge; the median "
             "window is typical. Means: while sliding, by direction.",
    )  # fmt: skip


def _dependence(results: dict[str, Any], words: IdentifyWords) -> Table:
    runs = results["residuals"]
    columns: list[Heading] = []
    for name in runs:
        columns += [Heading(label="r", group=name), Heading(label="p", group=name)]
    functions = list(dict.fromkeys(d["function"] for run in runs.values() for d in run["dependence"]))
    rows = []
    for function in functions:
        cells: list[Cell] = []
        for run in runs.values():
            entry = next((d for d in run["dependence"] if d["function"] == function), None)
            cells += [Cell(text="–")] * 2 if entry is None else [_signed(entry["correlation"]), _p(entry["p_value"])]
        rows.append(Row(label={"1": "constant"}.get(function, function), cells=cells))
    for label, key in (("neighbours (lag 1)", "lag_1"), ("skewness", ""), ("Ljung-Box, 20 lags", "ljung_box")):
        cells = []
        for run in runs.values():
            white = run["whiteness"]
            value = run["skewness"] if not key else white.get(key, math.nan)
            cells += [
                number(value) if key == "ljung_box" else _signed(value),
                Cell(text="") if key != "ljung_box" else _p(white["p_value"]) if white else Cell(text="cannot tell"),
            ]
        rows.append(Row(label=label, cells=cells))
    for label, key in (("samples", "samples"), ("in effect", "effective_samples")):
        cells = []
        for run in runs.values():
            value = run["whiteness"].get(key, math.nan)
            cells += [count(round(value)) if math.isfinite(value) else Cell(text="–"), Cell(text="")]
        rows.append(Row(label=label, cells=cells))
    return Table(
        name="dependence", title="Is anything left in the residual?", corner="function of the motion",
        note=f"Correlation of the {words.torque} residual with functions of velocity v, acceleration a and the motor's "
             f"{words.torque} u, with the p-value of no correlation (two-sided, from the effective number of samples). "
             "The residual is filtered at 40 Hz, so it is never white; correlation with the motion is the sign of a "
             "missing effect.",
        columns=columns, rows=rows,
    )  # fmt: skip


def _signed(value: float) -> Cell:
    if not math.isfinite(value):
        return Cell(text="–")
    return Cell(text=f"{value:+.3f}".replace("-", "\u2212"), value=value)


def _p(value: float) -> Cell:
    text = "< 1e−4" if value < 1e-4 else f"{value:.1g}" if value < 0.01 else f"{value:.2f}"
    return Cell(text=text.replace("-", "\u2212"), value=value)


def _sections(
    fit: Fit, records: Sequence[Record], runs: Sequence[RunResidual], results: dict[str, Any], words: IdentifyWords
) -> tuple[Section, ...]:
    summaries = results["residuals"]
    measured: list[Figure] = [figure for run in runs for figure in draw.cutout_figures(run, words)]
    spread: list[Figure] = []
    for run in runs:
        spread += [draw.histogram_figure(run, words), draw.over_speed_figure(run, words)]
    whole = [draw.autocorrelation_figure(runs, words), draw.by_frequency_figure(summaries, words)]
    whole.append(draw.by_speed_figure(summaries, words))
    chirps = response_figures.responses(records, results["frequency_response"], fit.physical)
    inertia = fit.value("inertia_nm_s2_per_rev")
    damping = results["damping"]
    answers = [f for chirp in chirps for f in response_figures.response_figures(chirp, damping, inertia, words)]
    answers += [response_figures.damping_figure(damping, fit.physical, words)] if damping else []
    sections = [
        Section("Measured and simulated", "Simulated and measured motion, as in the paper's Fig. 3.", tuple(measured)),
        Section("Friction", "Fitted values and their uncertainty.",
                (draw.friction_figure(fit, runs, words),)),
        Section("Residual", "Measured torque minus that of the model, as in the paper's Fig. 4.", tuple(spread)),
        Section("Where the residual is", "By correlation time, frequency, amplitude and regime.", tuple(whole)),
        Section("Frequency response", "From open-loop chirps, as in the paper's Fig. 5.", tuple(answers)),
        Section("Whole logs", "The figures of one log zoom together.",
                tuple(figure for run in runs for figure in draw.course_figures(run, words))),
    ]  # fmt: skip
    return tuple(section for section in sections if section.figures)


def _next_steps(source: IdentifySource) -> Listing:
    model = source.model_file
    return Listing(
        name="next", title="What to do with it", note="A controller uses the model file.",
        text=f"{tune_command(source)}   # gains and margins for this model\n"
             f"fffo-drive config check AXIS.yaml   # after `model: {model.name}` in the axis file",
    )  # fmt: skip


def _provenance(source: IdentifySource, records: Sequence[Record], results: dict[str, Any]) -> ReportProvenance:
    files = [
        SourceFile(name=record.path.name, bytes=record.path.stat().st_size, sha256=record.digest) for record in records
    ]
    given = [path for path in (source.facts_file, source.model_file) if path is not None]
    files += [source_file(path.name, path.read_bytes(), text=True) for path in given]
    fit, linear = results["fit"], results["units"] == "linear"
    facts = {
        "fit": f"{fit['residual']}: {fit['residuals']} residuals, rms {significant(fit['residual_rms_lsb'])} counts, "
               f"{fit['windows']} windows, {fit['iterations']} iterations",
        "starting point": ", ".join(
            f"{name_on(key, unit_in(key), linear)} {significant(value, 4)}"
            for key, value in results["start"].items() if np.isfinite(value)
        ),
    }  # fmt: skip
    return provenance(files, facts)
