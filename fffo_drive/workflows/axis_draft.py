"""What a drive tells, and what only people know, as the first axis file of a drive: each value with where it came from.

The law of a first file is cautious: PI without friction observer, a crossover far below what a servo axis can do, on an
inertia that is assumed. It is there so that `fffo-drive commission` can check signs, scales and delay; `identify` and `tune` make
the real one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from ..config.axis import AxisFile
from ..documents import check, parse
from ..drive.canopen.eds_fitness import velocity_units_per_rps
from ..model.parameters import ModelFile
from ..units import TWO_PI, rps_from_rpm
from .told import ToldObjects

MILLI, MICRO = 1e-3, 1e-6
SAME = 0.01  # ratings that agree
# what is assumed of an axis that nobody has measured yet
ACCELERATION_RPS2 = 1000.0  # by the rated torque
COULOMB_SHARE, STATIC_SHARE = 0.02, 0.05  # of the rated torque
VISCOUS_SHARE_PER_RPS = 0.002
STRIBECK_RPS, STRIBECK_EXPONENT, STIFFNESS_PER_REV, ATTRACTION_PER_STATIC = 0.7, -1.0, 800.0, 35.0
DRIVE_DELAY_S, SENSOR_DELAY_S = 1.5e-3, 0.5e-3
CROSSOVER_HZ, RESET_TIME_S = 5.0, 0.2  # of the first law
HIGHEST_SPEED_RPS = 25.0
SPEED_SHARE, FOLLOWING_SHARE, PROFILE_SHARE = 0.8, 0.3, 0.2  # of the drive's limit; of ours
PEAK_FACTOR = 1.5  # of the rated current, where the drive allows it
PERMILLE = 1000.0
HIGHEST_MASTER_ID = 127


class Answers(NamedTuple):
    """What people know and no drive tells; None: not said."""

    torque_constant_nm_per_a: float | None = None
    counts_per_rev: int | None = None
    velocity_units_per_rps: float | None = None
    rated_torque_nm: float | None = None
    rated_current_a: float | None = None
    inertia_kg_m2: float | None = None


OPTIONS = {  # field of `Answers` -> (option, what is asked)
    "counts_per_rev": ("--counts", "counts of 0x6064 in a revolution (encoder: four times its lines)"),
    "velocity_units_per_rps": ("--velocity-units", "0x606C at one revolution a second"),
    "rated_torque_nm": ("--rated-torque", "rated torque of the motor in Nm"),
    "torque_constant_nm_per_a": ("--torque-constant", "torque constant of the motor in Nm/A"),
    "rated_current_a": ("--rated-current", "rated current of the motor in A"),
}


class Fact(NamedTuple):
    """One value and where it came from."""

    value: Any
    source: str


Facts = dict[str, Fact]


def drive_facts(objects: ToldObjects, answers: Answers) -> Facts:
    """Scales and ratings, by the names of `Answers` and keys of the drive section; what nobody tells is not there."""
    found: Facts = {}
    for name, value in answers._asdict().items():
        if value is not None:
            found[name] = Fact(value, f"given ({OPTIONS[name][0]})" if name in OPTIONS else "given")
    increments = _ratio(objects, 0x608F)
    if increments and increments == round(increments):
        found.setdefault("counts_per_rev", Fact(round(increments), "read: 0x608F"))
    counts = found.get("counts_per_rev")
    unit = objects.value(0x60A9)
    units = velocity_units_per_rps(unit, None if counts is None else float(counts.value)) if unit else None
    if units:
        found.setdefault("velocity_units_per_rps", Fact(units, f"read: 0x60A9 is 0x{unit:08X}"))
    elif not unit and (per_second := _ratio(objects, 0x6090)):
        found.setdefault("velocity_units_per_rps", Fact(per_second, "read: 0x6090"))
    _ratings(objects, found)
    torque, current = found.get("rated_torque_nm"), found.get("rated_current_a")
    if torque is not None and current is not None:
        constant = float(f"{torque.value / current.value:.6g}")
        found.setdefault(
            "torque_constant_nm_per_a", Fact(constant, "assumed: rated torque over rated current; see the data sheet")
        )
    constant_told = found.get("torque_constant_nm_per_a")
    if current is None and torque is not None and constant_told is not None:
        value = float(f"{torque.value / constant_told.value:.6g}")
        found["rated_current_a"] = Fact(value, "assumed: rated torque over torque constant")
    return found


def _ratings(objects: ToldObjects, found: Facts) -> None:
    raw = objects.value(0x6076)
    given = found.get("rated_torque_nm")
    if raw and given is not None and abs(raw * MICRO - given.value) <= SAME * given.value:
        found["rated_torque_unit"] = Fact("uNm", "0x6076 counts uNm: it then says what was given")
    elif raw:
        found.setdefault("rated_torque_nm", Fact(raw * MILLI, "read: 0x6076"))
    if milliamperes := objects.value(0x6075):
        found.setdefault("rated_current_a", Fact(milliamperes * MILLI, "read: 0x6075"))


def missing_facts(facts: Facts) -> list[str]:
    """What must be known, and is not, in the order in which it is asked. One of torque constant and current will do."""
    found = [name for name in OPTIONS if name not in facts]
    return found[:-1] if "torque_constant_nm_per_a" in found and "rated_current_a" in found else found


class Draft(NamedTuple):
    """An axis file and its model, as text and as they are read."""

    axis_text: str
    model_text: str
    axis: AxisFile
    model: ModelFile


class Place(NamedTuple):
    """Where a draft is for, and what was measured there."""

    name: str
    model_name: str  # file of the model, beside the axis file
    bus: str
    bitrate_hz: Fact
    node_id: int
    drive: str  # what the drive calls itself
    other_nodes: tuple[int, ...] = ()
    rate_hz: Fact = Fact(2000, "assumed: not measured yet")
    turnaround_us: Fact | None = None
    realtime_refused: bool = False
    patience_ticks: int = 0  # longest time without feedback that was seen on a loopback bus, with a margin


def make_draft(place: Place, facts: Facts, objects: ToldObjects) -> Draft:
    """The files for facts in which nothing is missing. Raises DocumentError if they make no axis."""
    model_text = _model_text(place, facts)
    axis_text = _axis_text(place, facts, objects)
    axis_data, axis_lines = parse(axis_text, f"{place.name}.yaml")
    model_data, model_lines = parse(model_text, place.model_name)
    axis = check(axis_data, AxisFile, f"{place.name}.yaml", axis_lines)
    return Draft(axis_text, model_text, axis, check(model_data, ModelFile, place.model_name, model_lines))


def written_objects(facts: Facts, objects: ToldObjects) -> list[str]:
    """Objects that the axis file writes: ratings that the drive has not been told, where people have."""
    return [name for name, *_ in _rating_writes(facts, objects)]


def _rating_writes(facts: Facts, objects: ToldObjects) -> list[tuple[str, int, int, str]]:
    found = []
    for index, key, what in ((0x6076, "rated_torque_nm", "torque"), (0x6075, "rated_current_a", "current")):
        if objects.value(index) == 0 and key in facts:
            number = round(facts[key].value / MILLI)
            found.append((f"0x{index:04X}:00", index, number, f"rated {what} of the motor"))
    return found


def _ratio(objects: ToldObjects, index: int) -> float | None:
    """Increments for each revolution; None for a placeholder: no encoder has one count."""
    above, below = objects.value(index, 1), objects.value(index, 2)
    return above / below if above and below and above > below else None


def drive_section(place: Place, facts: Facts, objects: ToldObjects) -> list[tuple[str, Fact]]:
    """Keys of the drive section, in order."""
    lines: list[tuple[str, Fact]] = [
        ("kind", Fact("canopen", "")),
        ("bus", Fact(place.bus, "given")),
        ("bitrate_hz", place.bitrate_hz),
        ("node_id", Fact(place.node_id, f"found: {place.drive}")),
    ]
    if HIGHEST_MASTER_ID in place.other_nodes or place.node_id == HIGHEST_MASTER_ID:
        taken = {*place.other_nodes, place.node_id}
        free = next(node for node in range(HIGHEST_MASTER_ID, 0, -1) if node not in taken)
        lines.append(("master_id", Fact(free, "of our heartbeat: the highest id that no node has")))
    for key in (
        "counts_per_rev", "velocity_units_per_rps", "rated_torque_nm", "rated_torque_unit", "rated_current_a",
    ):  # fmt: skip
        if key in facts:
            lines.append((key, facts[key]))
    if not objects.has(0x1400, 5):
        lines.append(("command_timeout_ms", Fact(0, "read: the drive has no RPDO deadline (0x1400:05)")))
    elif place.patience_ticks:
        lines.append(("heartbeat_timeout_ms", Fact(1000, "loopback bus: a rehearsal on a shared machine")))
        lines.append(("command_timeout_ms", Fact(200, "as above; a drive on a real bus takes 20")))
    if place.turnaround_us is not None:
        lines.append(("turnaround_us", place.turnaround_us))
    writes = _rating_writes(facts, objects)
    if writes:
        lines.append(("sdo", Fact("", "what the drive has not been told yet, written before it is enabled")))
        for _, index, number, why in writes:
            entry = f"{{object: 0x{index:04X}, value: {number}, bytes: 4, why: {why}}}"
            lines.append(("  -", Fact(entry, "given")))
    return lines


def _axis_text(place: Place, facts: Facts, objects: ToldObjects) -> str:
    rated_a = float(facts["rated_current_a"].value)
    constant = float(facts["torque_constant_nm_per_a"].value)
    peak, peak_source = PEAK_FACTOR, "assumed: 1.5 of the rated current"
    if allowed := objects.value(0x6073):
        peak = min(PEAK_FACTOR, allowed / PERMILLE)
        peak_source = f"read: 0x6073 allows {allowed / PERMILLE:g} of the rated current; at most 1.5 here"
    speed_rps, speed_source = HIGHEST_SPEED_RPS, "assumed; raise it once the axis is known"
    if (rpm := objects.value(0x6080)) and SPEED_SHARE * rps_from_rpm(rpm) < HIGHEST_SPEED_RPS:
        speed_rps, speed_source = SPEED_SHARE * rps_from_rpm(rpm), f"read: 0.8 of 0x6080, {rpm} rpm"
    gain = TWO_PI * CROSSOVER_HZ * TWO_PI * inertia_kg_m2(facts).value / constant
    limit_a = max(peak * rated_a, rated_a)
    lines = _lines(
        "",
        [
            ("format", Fact("fffo_drive/axis/1", "")),
            ("name", Fact(place.name, "")),
        ],
    )
    lines += ["drive:", *_lines("  ", drive_section(place, facts, objects))]
    lines += _lines("", [("model", Fact(place.model_name, "written with this file; its friction is assumed"))])
    lines += [
        "controller:",
        *_lines(
            "  ",
            [
                (
                    "proportional_a_per_rps",
                    Fact(_rounded(gain), f"assumed: {CROSSOVER_HZ:g} Hz on the model's inertia"),
                ),
                ("integral_a_per_rev", Fact(_rounded(gain / RESET_TIME_S), f"assumed: Ti {RESET_TIME_S:g} s")),
                ("current_limit_a", Fact(_rounded(rated_a), "the rated current")),
                ("observer", Fact("{toggle: off}", "until the friction is identified")),
            ],
        ),
    ]
    envelope = [
        ("current_limit_a", Fact(_rounded(limit_a), peak_source)),
        ("continuous_current_a", Fact(_rounded(rated_a), "the rated current")),
        ("speed_limit_rps", Fact(_rounded(speed_rps), speed_source)),
        ("following_error_rps", Fact(_rounded(FOLLOWING_SHARE * speed_rps), "assumed: 0.3 of the speed limit")),
        ("position_window_rev", Fact("null", "TO FILL IN where the axis has ends: [low, high]")),
    ]
    if place.patience_ticks:
        source = "measured on this loopback bus; a real one takes the default"
        envelope.append(("feedback_missing_ticks", Fact(place.patience_ticks, source)))
        envelope.append(("status_missing_ticks", Fact(max(100, 2 * place.patience_ticks), "as above")))
        envelope.append(("heartbeat_timeout_s", Fact(2, "as above")))
    lines += ["envelope:", *_lines("  ", envelope)]
    lines += ["loop:", *_lines("  ", [("rate_hz", place.rate_hz)])]
    if place.realtime_refused:
        lines += _lines(
            "", [("realtime", Fact("{required: false}", "measured: this machine refuses SCHED_FIFO; see `doctor`"))]
        )
    amplitude = _rounded(PROFILE_SHARE * speed_rps)
    lines += _lines("", [
        ("profile", Fact(f"{{kind: sine, duration_s: 10, amplitude: {amplitude}, frequency_hz: 0.5}}", "gentle"))
    ])  # fmt: skip
    head = [
        f"# {place.drive}: written by `fffo-drive bring-up`.",
        "# read: from the drive; given: by you; measured: here; assumed: by nobody in the know - check it.",
        f"# next: fffo-drive commission {place.name}.yaml (it moves the axis a little, and asks before)",
    ]
    return "\n".join([*head, *lines]) + "\n"


def inertia_kg_m2(facts: Facts) -> Fact:
    """As given, or assumed."""
    if "inertia_kg_m2" in facts:
        return Fact(facts["inertia_kg_m2"].value, "given (--inertia)")
    value = facts["rated_torque_nm"].value / (TWO_PI * ACCELERATION_RPS2)
    source = f"assumed: the rated torque gives {ACCELERATION_RPS2:g} rps2; commission measures Kt/J"
    return Fact(float(f"{value:.3g}"), source)


def _model_text(place: Place, facts: Facts) -> str:
    rated_nm = float(facts["rated_torque_nm"].value)
    period_s = 1.0 / float(place.rate_hz.value)
    constant, inertia = facts["torque_constant_nm_per_a"], inertia_kg_m2(facts)
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
        "# The first model of an axis that nobody has measured yet. `fffo-drive commission` measures delay and Kt/J,",
        "# `fffo-drive identify` inertia and friction; then this file is replaced.",
        "format: fffo_drive/model/1",
        f"name: {place.name}",
        f"torque_constant_nm_per_a: {_rounded(constant.value)}   # {constant.source}",
        f'inertia_kg_m2: {{value: {_rounded(inertia.value)}, source: "{inertia.source}"}}',
        f'delay_s: {{value: {_rounded(period_s + DRIVE_DELAY_S)}, source: "assumed: one period and 1.5 ms of drive"}}',
        f"sensor_delay_s: {{value: {_rounded(SENSOR_DELAY_S)}, source: assumed}}",
        "friction:",
        *(f'  {name}: {{value: {_rounded(value)}, source: "{source}"}}' for name, value, source in quantities),
    ]
    return "\n".join(lines) + "\n"


def _rounded(value: float) -> str:
    """Four digits, as YAML reads them as a number."""
    text = f"{value:.4g}"
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
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def model_file_of(axis_file: Path) -> Path:
    """Beside the axis file."""
    return axis_file.with_name(f"{axis_file.stem}.model.yaml")
