"""The report of a tuning: the gains, their margins and conditions, and the files that a controller runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ..control.stability import LinearAxis, Margins, loop_margins, over_loads
from ..documents import sentence
from ..identification.estimate_gain import EstimateWorth
from ..identification.tuning import DampingRange, Design, notch_text
from ..model.parameters import ModelFile, Quantity
from ..symbols import FRICTION
from ..units import NORMAL_95, TWO_PI, inertia_nm_s2_per_rev
from . import tune_figures as draw
from .document import (
    Cell,
    Heading,
    Line,
    Listing,
    Report,
    Row,
    Section,
    Table,
    Verdict,
    number,
    of_linear_axis,
    provenance,
    significant,
    source_file,
)
from .tune_figures import Tuning

LARGEST_RATIO = 1e4  # of damping; from it on only "... or more" is printed


class TuneSource(NamedTuple):
    """The model that the gains are for, and what was written."""

    model_path: Path
    model: ModelFile
    hold_s: float  # of a sampled command: half a period
    section: str  # the controller section, as YAML
    written: Sequence[Path]  # files, the axis file last where there is one
    commands: Sequence[str]
    on_the_estimate: EstimateWorth | None = None  # None: not possible, or decided already


def tune_report(source: TuneSource, tuning: Tuning, results: dict[str, Any]) -> Report:
    """The report of a design."""
    files = [source_file(path.name, path.read_bytes(), text=True) for path in (source.model_path, *source.written)]
    fitted = source.model.provenance
    facts = {"model": source.model.name, "model fitted": f"{fitted.date} {fitted.tool}".strip()}
    if fitted.runs:
        facts["on the logs (SHA-256)"] = ", ".join(fitted.runs)
    report = Report(
        kind="tune",
        title=f"Gains for {source.model.name}",
        subtitle="PI and observer for the fitted axis with its full delay, at the smallest friction damping.",
        verdict=_verdict(source, tuning),
        tables=(_gains(tuning), _margins(source, tuning), _checks(tuning, source.model), _axis(source, tuning)),
        sections=(
            Section("Poles", "Poles of the closed loop as the gain rises.",
                    (*draw.locus_figures(tuning), draw.poles_figure(tuning))),
            Section("Step", "Response to a step of the reference.", (draw.step_figure(tuning),)),
            *_measured(tuning),
            Section("Open loop", "With the delay, without and with the observer's L.",
                    tuple(draw.bode_figures(tuning))),
            Section("Friction damping", "Range of friction damping that the loop tolerates.",
                    tuple(draw.damping_figures(tuning))),
        ),
        provenance=provenance(files, {name: text for name, text in facts.items() if text}),
        results=results,
        opening="step",
        listings=_listings(source),
    )  # fmt: skip
    return of_linear_axis(report) if source.model.units == "linear" else report


def _measured(tuning: Tuning) -> tuple[Section, ...]:
    figures = tuple(draw.measured_figures(tuning))
    return (Section("Measured response", "From current to velocity, by commissioning.", figures),) if figures else ()


def _verdict(source: TuneSource, tuning: Tuning) -> Verdict:
    design, gains = tuning.design, tuning.gains
    margins = design.margins_observer
    headline = (
        f"Kp {significant(gains.proportional_a_per_rps, 4)} A/rps, "
        f"Ki {significant(gains.integral_a_per_rev, 4)} A/rev, L {significant(gains.observer_nm_per_rev, 4)} Nm/rev."
    )
    unstable = margins.phase_deg <= 0.0 or margins.gain <= 1.0
    bound = design.real_poles_from_a_per_rps
    share = f", {significant(gains.proportional_a_per_rps / bound, 2)} times the bound" if bound > 0.0 else ""
    reasons = [
        "Do not run the loop with these gains."
        if unstable
        else f"Poles are real from Kp {significant(bound)} A/rps{share}. {_condition_14(design)}",
        f"The friction damping may vary {range_text(design.without_overshoot)} with real poles, "
        f"{range_text(design.within_margins)} within the margins.",
        sentence(response_text(tuning.axis)),
    ]
    notches = notch_text(tuning.axis, tuning.by_notches)
    if notches is not None:
        reasons.append(sentence(notches))
    if source.on_the_estimate is not None and not unstable:
        reasons.append(sentence(estimate_text(source.on_the_estimate)))
    cautions = [sentence(text) for text in design.warnings]
    lines = [
        Line(label="Margins", text=f"Phase {significant(margins.phase_deg, 2)}°, gain {significant(margins.gain, 2)} "
                                   f"with delay and observer; required: {tuning.wish.phase_margin_deg:g}° and "
                                   f"{tuning.wish.gain_margin:g}."),
        Line(label="Step", text=f"Overshoots by {significant(design.overshoot_percent, 2)} %, at worst "
                                f"{significant(tuning.worst_overshoot_percent, 2)} % with the observer, and is within "
                                f"2 % after {significant(1e3 * design.settled_s, 2)} ms."),
        Line(label="At rest", text=f"{significant(100.0 * gains.rest_share, 3)} % of Kp and Ki give a phase margin of "
                                   f"{significant(design.margins_rest.phase_deg, 2)}° at standstill, where the "
                                   "friction contact acts as a spring."),
    ]  # fmt: skip
    if unstable:
        lines.append(Line(label="Next", text="Do not run these gains; let `fffo-drive tune` choose others."))
    else:
        text = "Try them on the simulated drive before you use them on an axis."
        lines.append(Line(label="Next", text=text, command=_first_command(source)))
    return Verdict(
        headline=headline,
        finding="an unstable loop" if unstable else "gains" if cautions else "gains that keep the margins",
        confidence="probable" if cautions and not unstable else "certain",
        next_step="do not run it" if unstable else "try them in simulation",
        alarm=unstable,
        lines=lines,
        reasons=reasons,
        cautions=cautions,
    )


def estimate_text(worth: EstimateWorth) -> str:
    """What the estimated velocity gains, or would gain, for the page and the terminal."""
    more, left = significant(worth.integral_ratio, 2), significant(100.0 * worth.error_ratio, 2)
    step = significant(worth.step_a, 2)
    allowed = f"the same margins allow {more} times the integral action Ki Kt + L"
    if worth.drive_step_a is None:
        if not worth.gains:
            return f"a velocity estimated from position and torque would gain little: {allowed}"
        return (
            f"with the velocity estimated from position and torque {allowed}, and {left} % of the squared error by "
            "friction outside the model would remain. Whether its noise is worth that is not known: no record of this "
            f"axis has it (the counts of the position alone make steps of {step} A rms in the command). Run "
            "`fffo-drive commission`, and `tune` decides; or tune with --velocity estimated"
        )
    error = "the squared error by friction outside the model and by the measured noise"
    steps = (
        f"Noise makes steps of {step} A rms in the command, with the drive's velocity "
        f"{significant(worth.drive_step_a, 2)} A"
    )
    if not worth.gains:
        return (
            f"the error takes the drive's velocity: with the estimated one {left} % of {error} would remain. {steps}. "
            "To take the estimate all the same, tune with --velocity estimated"
        )
    return (
        f"the error takes the velocity estimated from position and torque: {allowed}, and {left} % of {error} remains. "
        f"{steps}. To keep the drive's velocity, tune with --velocity drive"
    )


def loads_text(axis: LinearAxis, model: ModelFile) -> str:
    """For which inertia the gains are, for the page and the terminal."""
    own = model.inertia_text(axis.inertia_nm_s2_per_rev)
    if axis.inertia_range_nm_s2_per_rev is None:
        return (
            f"assumed: the load never changes, the inertia is always the model's {own}. If it changes, tune with "
            f"{'--mass-range' if model.units == 'linear' else '--inertia-range'} LEAST LARGEST"
        )
    ends = model.inertia_text(*axis.inertia_range_nm_s2_per_rev)
    return f"all margins hold with an inertia of {ends}; feed-forward has the model's {own}"


def response_text(axis: LinearAxis) -> str:
    """What the margins stand on, for the page and the terminal."""
    if axis.measured is None:
        return "margins from the model alone: no response was measured (run `fffo-drive commission`, then give --axis)"
    low_hz, high_hz = (axis.measured.frequencies_hz[k] for k in (0, -1))
    at_rest = "at rest from the contact of the model"
    if axis.measured_contact_nm_per_rev is not None:
        soft, stiff = axis.measured_contact_nm_per_rev
        at_rest = f"at rest from the contact that it measured, {significant(soft)} to {significant(stiff)} Nm/rev"
    return f"margins from the response that commissioning measured, {low_hz:.0f} to {high_hz:.0f} Hz; {at_rest}"


def _first_command(source: TuneSource) -> str:
    commands = [command.split("#")[0].strip() for command in source.commands]
    return next(filter(None, commands))


def _condition_14(design: Design) -> str:
    excess = design.condition_14_nm_per_rev
    if excess >= -1e-9:
        return f"Condition (14) holds with an excess of {significant(excess)} Nm/rev."
    return (
        f"L is {significant(-excess)} Nm/rev below what condition (14) requires, because the margins have priority. L "
        "acts in the integral, where (14) does not apply."
    )


def range_text(damping: DampingRange) -> str:
    """By how much the friction damping may vary, for the page and the terminal."""
    if damping.ratio > 0.999 * LARGEST_RATIO:  # the end of the range that is searched
        return f"{LARGEST_RATIO:g} : 1 or more"
    return f"{significant(damping.ratio, 2)} : 1"


def _gains(tuning: Tuning) -> Table:
    g = tuning.gains
    rows = [
        Row(label="Kp", unit="A/rps", cells=[number(g.proportional_a_per_rps, 4), _text("proportional gain")]),
        Row(label="Ki", unit="A/rev", cells=[number(g.integral_a_per_rev, 4), _text("integral gain")]),
        Row(label="Ti", unit="s", cells=[number(tuning.integral_time_s, 4), _text("integral time, Kp / Ki")]),
        Row(label="L", unit="Nm/rev", cells=[number(g.observer_nm_per_rev, 4), _text("gain of the friction observer")]),
        Row(label="at rest", unit="-", cells=[number(g.rest_share, 3), _text("share of Kp and Ki at standstill")]),
        Row(
            label="hold",
            unit="A/rev/s",
            cells=[number(g.hold_a_per_rev_s, 4), _text("integral gain of the position hold at standstill")],
        ),
    ]
    for notch in tuning.axis.notches:
        text = _text(f"notch on the error, width {notch.width:g}, depth {notch.depth:g}")
        rows.append(Row(label="notch", unit="Hz", cells=[number(notch.frequency_hz), text]))
    return Table(
        name="gains", title="Gains", corner="gain", rows=rows,
        columns=[Heading(label="value"), Heading(label="what it is", words=True)],
        note="As in the controller section, which has four digits.",
    )  # fmt: skip


def _text(text: str) -> Cell:
    return Cell(text=text)


TWO_CUTS = (
    " The velocity is estimated: each margin is the smaller one of the loop cut at the velocity (as in the figures) "
    "and cut at the current."
)


def _margins(source: TuneSource, tuning: Tuning) -> Table:
    axis, gains, wish = tuning.axis, tuning.gains, tuning.wish
    design = tuning.design
    rows = [
        _margin_row("PI", design.margins_pi),
        _margin_row("PI and observer", design.margins_observer),
        _margin_row("at rest, friction contact as a spring", design.margins_rest),
    ]
    if axis.notches:
        without = loop_margins(axis._replace(notches=()), *gains.in_motion)
        rows.insert(2, _margin_row("the same gains without notches", without))
    if axis.inertia_range_nm_s2_per_rev is not None:
        loads = over_loads(axis)
        for word, one in (("least", loads[0]), ("largest", loads[-1])):
            label = f"the same, at the {word} inertia, {source.model.inertia_text(one.inertia_nm_s2_per_rev)}"
            rows.append(_margin_row(label, loop_margins(one, *gains.in_motion)))
    corners = _corners(source, axis)
    if corners:
        found = [loop_margins(corner, *gains.in_motion) for corner in corners]
        worst = Margins(
            min(m.phase_deg for m in found), min(m.gain for m in found), min(found, key=lambda m: m.gain).crossover_hz
        )
        rows.append(_margin_row(f"the same, {_letter(source.model)} and Td at the ends of their intervals", worst))
    return Table(
        name="margins", title="Margins", corner="loop", rows=rows,
        columns=[Heading(label="phase", unit="deg"), Heading(label="gain"), Heading(label="crossover", unit="Hz")],
        note=f"With {significant(1e3 * axis.delay_s)} ms of delay, at the smallest damping. Required: at least "
             f"{wish.phase_margin_deg:g}° and {wish.gain_margin:g}.{'' if axis.estimator is None else TWO_CUTS}",
    )  # fmt: skip


def _margin_row(label: str, margins: Margins) -> Row:
    cells = [
        _bounded(margins.phase_deg, "no crossover"),
        _bounded(margins.gain, "no limit"),
        _bounded(margins.crossover_hz, "–"),
    ]
    return Row(label=label, cells=cells)


def _bounded(value: float, otherwise: str) -> Cell:
    return number(value) if math.isfinite(value) else Cell(text=otherwise)


def _corners(source: TuneSource, axis: LinearAxis) -> list[LinearAxis]:
    """The axis at the ends of the 95 % intervals of J and Td; none where the model has no standard deviations."""
    j_sd, delay_sd_s = source.model.inertia_kg_m2.sd, source.model.delay_s.sd
    if j_sd is None or delay_sd_s is None:
        return []
    reach = NORMAL_95 * inertia_nm_s2_per_rev(j_sd)
    return [
        axis._replace(
            inertia_range_nm_s2_per_rev=None,
            inertia_nm_s2_per_rev=max(0.1 * axis.inertia_nm_s2_per_rev, axis.inertia_nm_s2_per_rev + sign * reach),
            delay_s=max(0.0, axis.delay_s + other * NORMAL_95 * delay_sd_s),
        )
        for sign in (-1.0, 1.0)
        for other in (-1.0, 1.0)
    ]


def _checks(tuning: Tuning, model: ModelFile) -> Table:
    design, gains, axis = tuning.design, tuning.gains, tuning.axis
    stiffness = gains.integral_a_per_rev * axis.torque_constant_nm_per_a
    attraction = model.friction.attraction_nm_per_rev.value
    rows = [
        Row(label="Ki Kt + L", unit="Nm/rev",
            cells=[number(stiffness + gains.observer_nm_per_rev), _text("left side of condition (14)")]),
        Row(label="2 B", unit="Nm/rev", cells=[number(2.0 * attraction), _text("right side of condition (14)")]),
        Row(label="excess", unit="Nm/rev",
            cells=[number(design.condition_14_nm_per_rev), _text("not negative where (14) holds")]),
        Row(label="real poles from Kp", unit="A/rps",
            cells=[number(design.real_poles_from_a_per_rps), _text("at the smallest damping, and for every "
                                                                   "larger Kp")]),
        Row(label="overshoot", unit="%",
            cells=[number(design.overshoot_percent), _text("of a step, with the PI's zero and the delay")]),
        Row(label="settled", unit="s", cells=[number(design.settled_s), _text("within 2 % of a step")]),
        *_range_rows("real poles", design.without_overshoot, "and the slow one within ten times 1/Ti"),
        *_range_rows("margins hold", design.within_margins, "with delay and observer"),
    ]  # fmt: skip
    return Table(
        name="checks", title="Conditions", corner="what", rows=rows,
        columns=[Heading(label="value"), Heading(label="meaning", words=True)],
        note="Condition (14) in torque units, Ki Kt + L ≥ 2 B, belongs to the loop with observer and is not a margin.",
    )  # fmt: skip


def _range_rows(label: str, damping: DampingRange, meaning: str) -> list[Row]:
    interval = f"{significant(damping.lowest)} to {significant(damping.highest)}"
    wide = range_text(damping)
    ratio = damping.ratio if math.isfinite(damping.ratio) else None
    return [
        Row(
            label=f"damping, {label}",
            cells=[Cell(text=wide, value=ratio), _text(f"{interval} Nm/rps, {meaning}")],
        )
    ]  # fmt: skip


def _axis(source: TuneSource, tuning: Tuning) -> Table:
    model, axis = source.model, tuning.axis
    friction = model.friction
    sigma, attraction = FRICTION["viscous_nm_per_rps"], FRICTION["attraction_nm_per_rev"]
    rows = [
        _inertia(model),
        Row(label="loads", cells=[Cell(text="–"), Cell(text="–"), _text(loads_text(axis, model))]),
        _quantity(f"{sigma.greek}, smallest damping", sigma.unit, friction.viscous_nm_per_rps),
        _quantity(attraction.label, attraction.unit, friction.attraction_nm_per_rev),
        _quantity("Td, command to measured velocity", "s", model.delay_s),
        Row(label="hold of the command", unit="s",
            cells=[number(source.hold_s), Cell(text="–"), _text("half a period")]),
        *_lag_given_back(model, axis),
        *_resonance(axis),
        Row(label="total delay", unit="s", cells=[number(axis.delay_s, 4), Cell(text="–"), _text("their sum")]),
        Row(label="Kt", unit="Nm/A",
            cells=[number(model.torque_constant_nm_per_a, 4), Cell(text="–"), _text("declared")]),
    ]  # fmt: skip
    return Table(
        name="axis", title="The axis", corner="parameter", rows=rows,
        columns=[Heading(label="value"), Heading(label="sd"), Heading(label="source", words=True)],
        note="From the model file; below each value its 95 % interval where it was fitted.",
    )  # fmt: skip


def _lag_given_back(model: ModelFile, axis: LinearAxis) -> list[Row]:
    """The lag that an estimated velocity removes from the loop."""
    if axis.estimator is None:
        return []
    lag = _text("its lag is not in the loop: the velocity is estimated")
    return [Row(label="drive's velocity", unit="s", cells=[number(-model.sensor_delay_s.value), Cell(text="–"), lag])]


def _resonance(axis: LinearAxis) -> list[Row]:
    """That of an elastic load, with the interval over which the margins hold."""
    share, frequency_hz, damping = axis.elastic
    if share == 0.0:
        return []
    low_hz, high_hz = ((1.0 + sign * axis.resonance_spread) * frequency_hz for sign in (-1.0, 1.0))
    meaning = f"{significant(100.0 * share, 2)} % of the inertia behind it, damping ratio {significant(damping, 2)}"
    found = number(frequency_hz, low=low_hz, high=high_hz)
    return [Row(label="resonance", unit="Hz", cells=[found, Cell(text="–"), _text(meaning)])]


def _letter(model: ModelFile) -> str:
    return "M" if model.units == "linear" else "J"


def _inertia(model: ModelFile) -> Row:
    inertia = model.inertia_kg_m2
    if model.units == "rotary":
        return _quantity(_letter(model), "kg m²", inertia)
    sd = None if inertia.sd is None else TWO_PI * inertia.sd
    return _quantity(_letter(model), "kg", inertia.model_copy(update={"value": TWO_PI * inertia.value, "sd": sd}))


def _quantity(label: str, unit: str, quantity: Quantity) -> Row:
    sd = quantity.sd
    low, high = (None, None) if sd is None else (quantity.value - NORMAL_95 * sd, quantity.value + NORMAL_95 * sd)
    cells = [
        number(quantity.value, 4, low=low, high=high),
        Cell(text="–") if sd is None else number(sd, 2),
        _text(quantity.source),
    ]
    return Row(label=label, unit=unit, cells=cells)


def _listings(source: TuneSource) -> tuple[Listing, ...]:
    note = f"Written to {source.written[0]}."
    if source.model.units == "linear":
        note += " Its keys are those of a rotary axis: rev stands for m, rps for m/s, nm for N."
    return (
        Listing(name="controller", title="Controller section", note=note, text=source.section),
        Listing(
            name="commands", title="What to do with it",
            note="Try gains on the simulated drive before you use them on an axis.", text="\n".join(source.commands),
        ),
    )  # fmt: skip
