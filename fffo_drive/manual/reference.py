"""The reference of the manual, made from the code: commands, files, signals, effects, states, faults, control API."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..cli import COMMANDS, parser_of
from ..cli.config import SCHEMAS, schema_record
from ..cli.exits import MEANINGS
from ..control.envelope import DEFAULT_REACTIONS, REACTION_COAST, TRIP_NAMES, TRIP_TEXTS
from ..daemon.parameters import METHODS
from ..daemon.states import markdown as states_markdown
from ..drive.simulated.effects.registry import EFFECTS, PARAMETER_COLUMNS, parameter_cells
from ..drive.simulated.effects.slots import STAGE_NAMES
from ..model.effects.law import Law
from ..model.effects.registry import LAWS
from ..signals import SIGNALS
from ..units import SUFFIXES

FILES = {  # kind -> (title, what the file is)
    "axis": ("Axis file", "One axis: drive, model, law, limits, profile. Input of `run`, `serve` and `commission`."),
    "drive_profile": (
        "Drive profile",
        (
            "What all drives of a family have in common. `drive.profile` in an axis file selects it; the axis "
            "file can override each key."
        ),
    ),
    "simulated": ("Simulated drive", "The drive that `sim` simulates, or that an axis file names under `drive.file`."),
    "model": (
        "Model",
        "Parameters of an axis with their uncertainties, and effects. `identify` and `diagnose` write it.",
    ),
    "scenario": ("Scenario", "What `evaluate` compares: an axis, a reference, model errors, controllers, seeds."),
    "facts": (
        "Facts",
        "What has to be declared about a drive if its logs do not contain it: `identify LOG --drive FACTS`.",
    ),
}


def pages() -> dict[str, str]:
    """Name of each generated page below `reference/`, and its Markdown."""
    found = {
        "commands": commands(), "signals": signals(), "effects": effects(), "states": states_markdown(),
        "trips": trips(), "api": api(),
    }  # fmt: skip
    return found | {f"file_{kind}": file_page(kind) for kind in SCHEMAS}


def cell(text: object) -> str:
    """Text inside a cell of a Markdown table."""
    return re.sub(r"\s+", " ", str(text)).strip().replace("|", "\\|").replace("<", "&lt;")


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """A Markdown table; no lines where there are no rows."""
    body = ["| " + " | ".join(str(value) for value in row) + " |" for row in rows]
    return ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head), *body, ""] if body else []


# commands


def commands() -> str:
    """Every subcommand with its usage and options, from the parsers."""
    lines = [
        "# Commands",
        "",
        "Generated from the program's parsers. `fffo-drive COMMAND --help` prints the same text.",
        "",
    ]
    lines += table(
        ("command", "what it does"), ((f"[`{name}`](#{name})", cell(text)) for name, (_, text) in COMMANDS.items())
    )
    lines += ["## Exit codes", "", *table(("code", "meaning"), MEANINGS.items())]
    for name in COMMANDS:
        lines += _command(parser_of(name), f"fffo-drive {name}", 2, name)
    return "\n".join(lines)


def _command(parser: argparse.ArgumentParser, title: str, level: int, anchor: str) -> list[str]:
    lines = [f"({anchor})=", f"{'#' * level} {title}", ""]
    if parser.description:
        lines += ["```text", parser.description.strip(), "```", ""]
    usage = parser.format_usage().removeprefix("usage: ").strip()
    lines += ["```text", re.sub(r"\s*\n\s*", "\n    ", usage), "```", ""]
    rows = []
    nested: list[str] = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, sub in action.choices.items():
                nested += _command(sub, f"{title} {name}", level + 1, f"{anchor}-{name}")
        elif not isinstance(action, argparse._HelpAction):
            rows.append((_name_of(action), cell(_help_of(action))))
    return [*lines, *table(("argument", "meaning"), rows), *nested]


def _name_of(action: argparse.Action) -> str:
    metavar = action.metavar if isinstance(action.metavar, str) else None
    choices = "{" + ",".join(str(c) for c in action.choices) + "}" if action.choices else None
    value = metavar or choices or action.dest.upper()
    if not action.option_strings:
        return f"`{value}`"
    return f"`{', '.join(action.option_strings)}{'' if action.nargs == 0 else ' ' + value}`"


def _help_of(action: argparse.Action) -> str:
    return action.help % {"default": action.default, "prog": "fffo-drive"} if action.help else ""


# files


def file_page(kind: str) -> str:
    """One kind of file: each section with its keys, from the pydantic records."""
    title, text = FILES[kind]
    schema = schema_record(kind).model_json_schema()
    sections = schema.get("$defs", {})
    lines = [
        f"(file-{kind})=",
        f"# {title}",
        "",
        text,
        "",
        f"`fffo-drive config schema {kind}` prints the JSON schema for an editor. Unknown keys are errors. "
        "A key with a default may be left out.",
        "",
        *_keys(schema, kind, sections),
    ]
    for name, section in sections.items():
        lines += [f"({_anchor(kind, name)})=", f"## {_heading(name)}", ""]
        if section.get("description"):
            lines += [_prose(section["description"]), ""]
        if "enum" in section:
            lines += ["One of " + ", ".join(f"`{v}`" for v in section["enum"]) + ".", ""]
        lines += _keys(section, kind, sections)
    return "\n".join(lines)


def _prose(text: str) -> str:
    return "\n\n".join(re.sub(r"\s+", " ", part) for part in text.replace("<", "&lt;").split("\n\n"))


def _heading(name: str) -> str:
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", re.sub(r"(Section|Record)$", "", name))
    return words[:1] + words[1:].lower()


def _anchor(kind: str, name: str) -> str:
    return f"{kind}-{name.lower()}"


def _keys(schema: Mapping[str, Any], kind: str, sections: Mapping[str, Any]) -> list[str]:
    needed = set(schema.get("required", ()))
    rows = []
    for name, entry in schema.get("properties", {}).items():
        default = "required" if name in needed else _value(entry.get("default", None), "default" in entry)
        if name == "object" and name not in needed:  # an index of the object dictionary
            default = f"`0x{entry['default']:04X}`"
        rows.append((f"`{name}`", unit_of(name), _allowed(entry, kind), default, cell(_meaning(entry, sections))))
    return table(("key", "unit", "allowed", "default", "meaning"), rows)


def _meaning(entry: Mapping[str, Any], sections: Mapping[str, Any]) -> str:
    """The key's own description; of a key that holds a section, the section's first sentence."""
    if "description" in entry:
        return str(entry["description"])
    if "$ref" not in entry:
        return ""
    text = str(sections.get(entry["$ref"].rpartition("/")[2], {}).get("description", ""))
    return text.partition("\n")[0].removesuffix(".")


def _allowed(entry: Mapping[str, Any], kind: str) -> str:
    """Type and range of a key in one cell."""
    limits = _range(entry)
    return f"{_type(entry, kind)}{', ' if limits else ''}{limits}"


def unit_of(key: str) -> str:
    """The unit that the ending of a key names; empty for none."""
    fitting = [suffix for suffix in SUFFIXES if f"_{key}".endswith(f"_{suffix}")]
    return SUFFIXES[max(fitting, key=len)] if fitting else ""


def _type(entry: Mapping[str, Any], kind: str) -> str:
    """The type in words, with a link to the section where it is one."""
    if "$ref" in entry:
        name = entry["$ref"].rpartition("/")[2]
        return f"[{_heading(name)}](#{_anchor(kind, name)})"
    for key in ("anyOf", "oneOf", "allOf"):
        if key in entry:
            words = [_type(part, kind) for part in entry[key] if part.get("type") != "null"]
            return " or ".join(dict.fromkeys(words))
    if "const" in entry:
        return f"`{entry['const']}`"
    if "enum" in entry:
        return " or ".join(f"`{value}`" for value in entry["enum"])
    if entry.get("type") == "array":
        inside = _type(entry["items"], kind) if isinstance(entry.get("items"), dict) and entry["items"] else "value"
        return f"list of {inside}"
    if entry.get("type") == "object":
        held: Any = entry.get("additionalProperties")
        return f"mapping to {_type(held, kind)}" if isinstance(held, dict) and held else "mapping"
    return {"string": "text", "integer": "integer", "number": "number", "boolean": "true or false"}.get(
        str(entry.get("type")), "value"
    )


def _range(entry: Mapping[str, Any]) -> str:
    """The allowed range of a number, or the pattern of a text."""
    parts = [part for part in entry.get("anyOf", [entry]) if part.get("type") != "null"]
    texts = []
    for part in parts:
        low, above = part.get("minimum"), part.get("exclusiveMinimum")
        high, below = part.get("maximum"), part.get("exclusiveMaximum")
        words = [
            f"{sign} {_number(v)}" for sign, v in ((">", above), ("≥", low), ("<", below), ("≤", high)) if v is not None
        ]
        if "minItems" in part or "maxItems" in part:
            words.append(f"{part.get('minItems', 0)} to {part.get('maxItems', 'any')} entries")
        texts.append(", ".join(words))
    return cell(" or ".join(dict.fromkeys(text for text in texts if text)))


def _number(value: float) -> str:
    return f"{value:.10g}"


def _value(value: object, given: bool) -> str:
    if not given:
        return "empty"
    if value is None:
        return "none"
    if isinstance(value, dict):
        return "see section" if value else "empty"
    if isinstance(value, list):
        return f"`{cell(value)}`" if value else "empty"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{_number(value) if isinstance(value, float) else value}`"


# signals, effects, states, faults


def signals() -> str:
    """The columns of a recorded row."""
    lines = [
        "# Signals",
        "",
        (
            "One row is recorded for each tick. These are its columns, in the order of the row. Each name "
            "ends in its unit."
        ),
        "The ring, the MCAP schema, the columns of the reader and this table come from one list, `signals.py`.",
        "",
    ]
    return "\n".join(
        lines + table(("signal", "unit", "meaning"), ((f"`{s.name}`", s.unit, cell(s.meaning)) for s in SIGNALS))
    )


def effects() -> str:
    """The laws that a model may hold, and the effects of the simulated drive."""
    laws = [law for law in LAWS.values() if law.name != "lookup"]
    lines = [
        "# Effects",
        "",
        (
            "An *effect* is a behaviour that can be added to the model of an axis; a *law* is the formula of one "
            "effect. The first list is"
        ),
        (
            "what `diagnose` can identify and a controller can compensate. The second is what the simulated "
            "drive can produce: it"
        ),
        "has its own physics and shares no code with the model.",
        "",
        "## Laws of the model",
        "",
    ]
    lines += table(
        ("law", "meaning", "depends on", "compensated by the controller"),
        (
            (
                f"[`{w.name}`](#law-{_slug(w.name)})",
                cell(w.meaning),
                w.axis.replace("_", " "),
                "yes" if w.compensable else "no",
            )
            for w in laws
        ),
    )
    lines += ["Anything outside this list is reported as `unknown:AXIS`, a free curve over the variable AXIS.", ""]
    for law in laws:
        lines += _law(law)
    return "\n".join([*lines, "## Effects of the simulated drive", "", *_plant_effects()])


def _plant_effects() -> list[str]:
    """Every effect of the simulated drive, with a row for each parameter."""
    rows = []
    for effect in EFFECTS.values():
        head = (f"`{effect.name}`", STAGE_NAMES[effect.stage], cell(effect.description))
        for parameter in effect.parameters:
            name, *cells = parameter_cells(parameter)
            rows.append((*head, f"`{name}`", *map(cell, cells)))
            head = ("", "", "")
    return table(("effect", "acts on", "what it is", *PARAMETER_COLUMNS), rows)


def _slug(name: str) -> str:
    return name.replace("_", "-")


def _law(law: Law) -> list[str]:
    others = ", ".join(f"[`{name}`](#law-{_slug(name)})" for name in law.lookalikes if name in LAWS) or "none known"
    lines = [
        f"(law-{_slug(law.name)})=",
        f"### `{law.name}`",
        "",
        f"{law.meaning[:1].upper()}{cell(law.meaning)[1:]}.",
        "",
    ]
    lines += [
        f"Regime: {cell(law.regime)}. Similar effects: {others}. How to tell them apart: {cell(law.experiment)}.",
        "",
    ]
    rows = [
        (f"`{p.name}`", p.unit, p.kind, f"{_number(p.low)} to {_number(p.high)}", cell(p.meaning))
        for p in law.parameters
    ]
    return lines + table(("parameter", "unit", "kind", "range", "meaning"), rows)


def trips() -> str:
    """Every trip of the envelope with its default reaction."""
    rows = []
    for trip, (reaction, why) in DEFAULT_REACTIONS.items():
        word = "coast" if reaction == REACTION_COAST else "quick stop"
        rows.append((trip, f"`{TRIP_NAMES[trip]}`", cell(TRIP_TEXTS[trip]), word, cell(why)))
    lines = [
        "# Trips",
        "",
        (
            "A trip is a latched fault of the envelope, the last stage before the bus. From the tick of the "
            "trip on, no torque is"
        ),
        (
            "commanded. The reaction is what the loop requests from the drive; `envelope.reactions` in the axis "
            "file overrides it under"
        ),
        "the name of the trip. The signal `trip` of a recording contains the number.",
        "",
    ]
    return "\n".join(lines + table(("number", "name", "meaning", "default reaction", "reason"), rows))


# control API


def api() -> str:
    """The methods of the daemon's control API with their parameters."""
    from ..daemon import methods as module

    answers = (module.__doc__ or "").partition("\n\n")[2]
    lines = [
        "# Control API",
        "",
        (
            "Newline-delimited JSON-RPC 2.0 over two Unix sockets in the directory of the daemon: "
            "`control.sock` for everything,"
        ),
        (
            "`watch.sock` for the methods that only read. `fffo-drive ctl` is generated from the same table, and "
            "`fffo-drive ctl schema`"
        ),
        "prints the JSON schemas of a running daemon.",
        "",
        "## Answers and errors",
        "",
        *_answers(answers),
        "## Methods",
        "",
    ]
    for name, method in METHODS.items():
        socket = "`watch.sock` and `control.sock`" if method.watching else "`control.sock`"
        lines += [
            f"### `{name}`",
            "",
            f"{cell(method.summary)[:1].upper()}{cell(method.summary)[1:]}. Socket: {socket}.",
            "",
        ]
        lines += _parameters(method.parameters.model_json_schema())
    return "\n".join(lines)


def _answers(text: str) -> list[str]:
    """Paragraphs of a docstring; one whose lines are names, and indented answers to them, as a table."""
    lines = []
    for part in text.strip().split("\n\n"):
        if "\n    " not in part:
            lines += [cell(part), ""]
            continue
        rows: list[tuple[str, str]] = []
        for line in part.split("\n"):
            names, _, answer = line.partition("  ")  # no names: a line that continues an answer
            if names:
                rows.append((", ".join(f"`{name}`" for name in names.split(", ")), answer.strip()))
            else:
                rows[-1] = (rows[-1][0], f"{rows[-1][1]} {line.strip()}")
        lines += table(("method", "answer"), ((names, cell(answer).replace("*", "\\*")) for names, answer in rows))
    return lines


def _parameters(schema: Mapping[str, Any]) -> list[str]:
    needed = set(schema.get("required", ()))
    rows = []
    for name, entry in schema.get("properties", {}).items():
        kind = _type(entry, "api") if "$ref" not in str(entry) else "text or mapping"
        default = "required" if name in needed else _value(entry.get("default", None), "default" in entry)
        limits = _range(entry)
        allowed = f"{kind}{', ' if limits else ''}{limits}"
        rows.append((f"`{name}`", unit_of(name), allowed, default, cell(entry.get("description", ""))))
    return table(("parameter", "unit", "allowed", "default", "meaning"), rows) or ["No parameters.", ""]
