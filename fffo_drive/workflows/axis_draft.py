"""The first axis file of a drive, from what the drive reports and people know: each value with its source.

Its law is cautious: PI without friction observer, with a crossover far below what a servo axis can do, on an assumed
inertia, or on the range of it that was given. It lets `fffo-drive commission` check signs, scales and delay; `identify`
and `tune` then make the real law.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from .. import formats
from ..config.axis import AxisFile, default_blind_ticks
from ..config.drive_profile import with_profile
from ..config.runaway import most_current_a, most_ticks
from ..documents import check, parse
from ..drive.canopen.current_limit import MAX_TORQUE, least_limit
from ..drive.canopen.sdo_objects import SdoObjects
from ..model.parameters import ModelFile
from ..units import TWO_PI, inertia_nm_s2_per_rev, rps_from_rpm
from .drive_facts import ASSUMED, Fact, SourcedFacts

# assumptions about an axis before any measurement
ACCELERATION_RPS2 = 1000.0  # by the rated torque
COULOMB_SHARE, STATIC_SHARE = 0.02, 0.05  # of the rated torque
VISCOUS_SHARE_PER_RPS = 0.002
STRIBECK_RPS, STRIBECK_EXPONENT, STIFFNESS_PER_REV, ATTRACTION_PER_STATIC = 0.7, -1.0, 800.0, 35.0
DRIVE_DELAY_S, SENSOR_DELAY_S = 1.5e-3, 0.5e-3
CROSSOVER_HZ, RESET_TIME_S = 5.0, 0.2  # of the first law
HIGHEST_SPEED_RPS = 25.0
SPEED_SHARE, FOLLOWING_SHARE, PROFILE_SHARE = 0.8, 0.3, 0.2  # of the drive's limit; of ours
ROUNDED_SHARE = 0.99  # of a computed limit: the files have four digits
PEAK_FACTOR = 1.5  # of the rated current, where the drive allows it
HIGHEST_MASTER_ID = 127


class Draft(NamedTuple):
    """An axis file and its model, as text and as parsed records."""

    axis_text: str
    model_text: str
    axis: AxisFile
    model: ModelFile


class Place(NamedTuple):
    """The bus and node of a draft, and what was measured there."""

    name: str
    model_name: str  # file of the model, beside the axis file
    bus: str
    bitrate_hz: Fact
    node_id: int
    drive: str  # the drive's own name
    other_nodes: tuple[int, ...] = ()
    rate_hz: Fact = Fact(2000, "assumed: not measured yet")
    turnaround_us: Fact | None = None
    realtime_refused: bool = False
    patience_ticks: int = 0  # longest gap of feedback seen on a loopback bus, with a margin


def make_draft(place: Place, facts: SourcedFacts, objects: SdoObjects) -> Draft:
    """The files for facts in which nothing is missing. Raises DocumentError if they make no axis."""
    model_text = _model_text(place, facts)
    axis_text = _axis_text(place, facts, objects)
    axis_data, axis_lines = parse(axis_text, f"{place.name}.yaml")
    model_data, model_lines = parse(model_text, place.model_name)
    axis_data = with_profile(axis_data, Path(f"{place.name}.yaml"))
    axis = check(axis_data, AxisFile, f"{place.name}.yaml", axis_lines)
    return Draft(axis_text, model_text, axis, check(model_data, ModelFile, place.model_name, model_lines))


def drive_section(place: Place, facts: SourcedFacts) -> list[tuple[str, Fact]]:
    """Keys of the drive section, in order, without those of its profile."""
    lines: list[tuple[str, Fact]] = [
        ("kind", Fact("canopen", "")),
        ("bus", Fact(place.bus, "given")),
        ("bitrate_hz", place.bitrate_hz),
        ("node_id", Fact(place.node_id, f"found: {place.drive}")),
    ]
    if HIGHEST_MASTER_ID in (*place.other_nodes, place.node_id):
        taken = {*place.other_nodes, place.node_id}
        free = next(node for node in range(HIGHEST_MASTER_ID, 0, -1) if node not in taken)
        lines.append(("master_id", Fact(free, "id of our heartbeat: the highest that no node has")))
    if facts.profile is not None:
        lines.append(("profile", Fact(facts.profile, f"by vendor and product (0x1018): {facts.family}")))
    lines += list(facts.section.items())
    named = {**facts.profile_keys, **facts.section}
    if place.patience_ticks:
        lines.append(("heartbeat_timeout_ms", Fact(1000, "loopback bus on a shared machine")))
        if "command_timeout_ms" not in named:
            lines.append(("command_timeout_ms", Fact(200, "as above; a drive on a real bus takes 20")))
    if place.turnaround_us is not None:
        lines.append(("turnaround_us", place.turnaround_us))
    if facts.writes:
        lines.append(("sdo", Fact("", "not configured in the drive yet; written before it is enabled")))
        for name, number in facts.writes.items():
            why = "rated torque of the motor" if name.startswith("0x6076") else "rated current of the motor"
            lines.append(("  -", Fact(f"{{object: {name[:6]}, value: {number}, bytes: 4, why: {why}}}", "given")))
    return lines


def _axis_text(place: Place, facts: SourcedFacts, objects: SdoObjects) -> str:
    rated_a = float(facts.scales["rated_current_a"].value)
    constant = float(facts.scales["torque_constant_nm_per_a"].value)
    peak, peak_source = PEAK_FACTOR, "assumed: 1.5 of the rated current"
    written = {MAX_TORQUE: facts.profile_keys.get("max_torque_permille")}
    own = least_limit(
        lambda index: written.get(index) or objects.value(index),
        constant,
        float(facts.scales["rated_torque_nm"].value),
        rated_a,
    )
    if own.current_a < PEAK_FACTOR * rated_a:
        peak, peak_source = own.current_a / rated_a, f"read: the drive's own limit: {own.source}"
    speed_rps, speed_source = HIGHEST_SPEED_RPS, "assumed; raise it once the axis is known"
    if (rpm := objects.value(0x6080)) and SPEED_SHARE * rps_from_rpm(rpm) < HIGHEST_SPEED_RPS:
        speed_rps, speed_source = SPEED_SHARE * rps_from_rpm(rpm), f"read: 0.8 of 0x6080, {rpm} rpm"
    least, largest = inertia_ends_kg_m2(facts)
    law = first_law(least, constant, largest / least)
    limit_a = peak * rated_a
    rate_hz = float(place.rate_hz.value)
    rps2_per_a = constant / inertia_nm_s2_per_rev(least)
    most_a = ROUNDED_SHARE * most_current_a(speed_rps, rps2_per_a, rate_hz)
    if most_a < limit_a and not place.patience_ticks:
        limit_a, peak_source = most_a, "computed: with more the axis could run away in one tick without feedback"
    continuous_a = min(rated_a, limit_a)
    lines = _lines(
        "",
        [
            ("format", Fact(formats.AXIS.word, "")),
            ("name", Fact(place.name, "")),
        ],
    )
    lines += ["drive:", *_lines("  ", drive_section(place, facts))]
    record = f"{place.name}.commissioning.yaml"
    lines += _lines("", [("commissioning", Fact(record, "written by the next step; without it the axis does not run"))])
    lines += _lines("", [("model", Fact(place.model_name, "written with this file; its friction is assumed"))])
    lines += [
        "controller:",
        *_lines(
            "  ",
            [
                (
                    "proportional_a_per_rps",
                    Fact(
                        _rounded(law["proportional_a_per_rps"]), f"assumed: {CROSSOVER_HZ:g} Hz on the model's inertia"
                    ),
                ),
                (
                    "integral_a_per_rev",
                    Fact(_rounded(law["integral_a_per_rev"]), f"assumed: Ti {law_reset_s(largest / least):.3g} s"),
                ),
                *([("inertia_range_kg_m2", loads)] if (loads := facts.scales.get("inertia_range_kg_m2")) else []),
                ("current_limit_a", Fact(_rounded(continuous_a), "the rated current, or the envelope's limit")),
                ("observer", Fact("{toggle: off}", "until the friction is identified")),
                ("feedforward", Fact("{inertia: false}", "until the inertia is; `tune` switches on the whole law")),
            ],
        ),
    ]
    envelope = [
        ("current_limit_a", Fact(_rounded(limit_a), peak_source)),
        ("continuous_current_a", Fact(_rounded(continuous_a), "the rated current, or the limit")),
        ("speed_limit_rps", Fact(_rounded(speed_rps), speed_source)),
        ("following_error_rps", Fact(_rounded(FOLLOWING_SHARE * speed_rps), "assumed: 0.3 of the speed limit")),
        ("position_window_rev", Fact("null", "TO FILL IN where the axis has ends: [low, high]")),
    ]
    if place.patience_ticks:
        source = "loopback bus: delete these four keys on a real bus"
        envelope.append(("feedback_missing_ticks", Fact(place.patience_ticks, source)))
        envelope.append(("accept_runaway", Fact("true", "as above: a simulated drive")))
        envelope.append(("status_missing_ticks", Fact(max(100, 2 * place.patience_ticks), "as above")))
        envelope.append(("heartbeat_timeout_s", Fact(2, "as above")))
    elif (most := most_ticks(ROUNDED_SHARE * speed_rps, rps2_per_a * limit_a, rate_hz)) < default_blind_ticks(rate_hz):
        source = "computed: with more the axis could run away"
        envelope.append(("feedback_missing_ticks", Fact(max(1, most), source)))
    lines += ["envelope:", *_lines("  ", envelope)]
    lines += ["loop:", *_lines("  ", [("rate_hz", place.rate_hz)])]
    if place.realtime_refused:
        lines += _lines(
            "",
            [
                (
                    "realtime",
                    Fact("{required: false}", "measured: this machine refuses SCHED_FIFO; see `fffo-drive doctor`"),
                )
            ],
        )
    amplitude = _rounded(PROFILE_SHARE * speed_rps)
    lines += _lines("", [
        ("profile", Fact(f"{{kind: sine, duration_s: 10, amplitude: {amplitude}, frequency_hz: 0.5}}", "gentle"))
    ])  # fmt: skip
    head = [
        f"# {place.drive}: written by `fffo-drive bring-up`.",
        "# read: from the drive; given: by you; measured: here; assumed: unknown, check it.",
        f"# next: fffo-drive commission {place.name}.yaml (it moves the axis a little, and asks before)",
    ]
    return "\n".join([*head, *lines]) + "\n"


def law_reset_s(ratio: float) -> float:
    """Ti of the first law: the crossover falls by the ratio of the largest to the least inertia, and Ti follows it."""
    return RESET_TIME_S * max(1.0, ratio)


def first_law(inertia_kg_m2: float, torque_constant_nm_per_a: float, ratio: float = 1.0) -> dict[str, Any]:
    """Keys of the law before anything is identified: a slow PI, and no torque of an assumed friction or inertia.

    `inertia_kg_m2`: the least; `ratio`: of the largest to it.
    """
    gain = TWO_PI * CROSSOVER_HZ * TWO_PI * inertia_kg_m2 / torque_constant_nm_per_a
    return {
        "proportional_a_per_rps": gain,
        "integral_a_per_rev": gain / law_reset_s(ratio),
        "observer": {"toggle": "off"},
        "feedforward": {"inertia": False},
    }


def inertia_kg_m2(facts: SourcedFacts) -> Fact:
    """As given, or assumed."""
    if "inertia_kg_m2" in facts.scales:
        return facts.scales["inertia_kg_m2"]
    value = facts.scales["rated_torque_nm"].value / (TWO_PI * ACCELERATION_RPS2)
    source = f"{ASSUMED}the rated torque gives {ACCELERATION_RPS2:g} rps2; commission measures Kt/J"
    return Fact(float(f"{value:.3g}"), source)


def inertia_ends_kg_m2(facts: SourcedFacts) -> tuple[float, float]:
    """With the least and the largest load; the same twice where no range was given."""
    own = inertia_kg_m2(facts).value
    given = facts.scales.get("inertia_range_kg_m2")
    ends = (own,) if given is None else (own, *given.value)
    return min(ends), max(ends)


def _model_text(place: Place, facts: SourcedFacts) -> str:
    rated_nm = float(facts.scales["rated_torque_nm"].value)
    period_s = 1.0 / float(place.rate_hz.value)
    constant, inertia = facts.scales["torque_constant_nm_per_a"], inertia_kg_m2(facts)
    static_nm = STATIC_SHARE * rated_nm
    of_torque = "assumed: a share of the rated torque"
    quantities = [
        ("viscous_nm_per_rps", VISCOUS_SHARE_PER_RPS * rated_nm, of_torque),
        ("coulomb_nm", COULOMB_SHARE * rated_nm, of_torque),
        ("static_nm", static_nm, of_torque),
        ("stribeck_velocity_rps", STRIBECK_RPS, "assumed: typical"),
        ("stribeck_exponent", STRIBECK_EXPONENT, "assumed: typical"),
        ("stiffness_per_rev", STIFFNESS_PER_REV, "assumed: typical"),
        ("attraction_nm_per_rev", ATTRACTION_PER_STATIC * static_nm, "assumed: typical"),
    ]
    lines = [
        "# A first model, before any measurement. `fffo-drive commission` measures delay and Kt/J,",
        "# `fffo-drive identify` inertia and friction; then this file is replaced.",
        f"format: {formats.MODEL.word}",
        f"name: {place.name}",
        f"torque_constant_nm_per_a: {_rounded(constant.value, 6)}   # {constant.source}",
        f'inertia_kg_m2: {{value: {_rounded(inertia.value, 6)}, source: "{inertia.source}"}}',
        f'delay_s: {{value: {_rounded(period_s + DRIVE_DELAY_S)}, source: "assumed: one period and 1.5 ms of drive"}}',
        f"sensor_delay_s: {{value: {_rounded(SENSOR_DELAY_S)}, source: assumed}}",
        "friction:",
        *(f'  {name}: {{value: {_rounded(value)}, source: "{source}"}}' for name, value, source in quantities),
    ]
    return "\n".join(lines) + "\n"


def _rounded(value: float, digits: int = 4) -> str:
    """A number rounded to so many digits, as YAML."""
    text = f"{value:.{digits}g}"
    return text if math.isfinite(value) and "e" not in text else f"{value:.10f}".rstrip("0").rstrip(".")


def _lines(indent: str, pairs: Iterable[tuple[str, Fact]]) -> list[str]:
    """`key: value   # source`, the comments one below the other."""
    texts = [
        (f"{indent}{key} {fact.value}" if key.endswith("-") else f"{indent}{key}: {_shown(fact.value)}".rstrip(), fact)
        for key, fact in pairs
    ]  # fmt: skip
    width = min(44, max((len(text) for text, _ in texts), default=0))
    return [f"{text:<{width}}   # {fact.source}" if fact.source else text for text, fact in texts]


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.10g}"
    return json.dumps(value) if isinstance(value, dict | list) else str(value)


def model_file_of(axis_file: Path) -> Path:
    """Beside the axis file."""
    return axis_file.with_name(f"{axis_file.stem}.model.yaml")
