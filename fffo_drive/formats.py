"""Every kind of file that this program writes or reads, its number, and how an older file becomes one of today.

A file says `format: fffo_drive/KIND/NUMBER`; one that says nothing is of number 1. The number rises only when an older
program would misread the file, or today's an older one. Then a migration is added here: a pure function from the parsed
document of one number to that of the next. A file with a `content_hash` is migrated together with it: the function
checks the hash as its number had it, raises ValueError where it does not fit, and leaves the key out.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from pydantic import Field

from . import __version__

Document = Mapping[str, Any]
Migration = Callable[[Document], dict[str, Any]]

_WORD = re.compile(r"fffo_drive/([a-z_]+)/([1-9][0-9]{0,5})")
_VERSION = re.compile(r"fffo[-_]drive[ /](\d[\w.+-]*)")


class FormatError(Exception):
    """A file of another kind, or of a number that this program does not read; the text says which program does."""


class Format(NamedTuple):
    """One kind of file."""

    kind: str
    what: str
    written_by: str
    read_by: str
    migrations: tuple[Migration, ...] = ()  # the first makes number 2 of number 1, and so on

    @property
    def newest(self) -> int:
        """The number that is written."""
        return 1 + len(self.migrations)

    @property
    def word(self) -> str:
        """What a file of today says."""
        return f"fffo_drive/{self.kind}/{self.newest}"

    @property
    def key(self) -> Any:
        """The pydantic field of the key `format`."""
        return Field(
            pattern=f"^{re.escape(self.word)}$",
            json_schema_extra={"const": self.word},
            description="kind of this file and number of its format; absent: number 1",
        )


# What the law of a file has over the paper's PI with friction observer, each part off: axis/1 meant this where it said
# nothing, and `law: paper` of a scenario's controller means it today.
PAPER_LAW: dict[str, Any] = {
    "error_filter_s": 0.0,
    "observer": {"learns_in": "friction"},
    "at_rest": {"gain_share": 1.0, "release_friction": False},
    "feedforward": {"inertia": False, "preview": False, "delay_aware": False},
}


def over(base: Document, given: Any) -> Any:
    """A mapping of sections with the keys of another over it; anything else is left to the check of the file."""
    if not isinstance(given, Mapping):
        return given
    found = {**base, **given}
    for key in base.keys() & given.keys():
        if isinstance(base[key], Mapping):
            found[key] = over(base[key], given[key])
    return found


def _axis_2(data: Document) -> dict[str, Any]:
    """The best law that is known became the default: what a file of 1 did not switch on stays off.

    `foreign_sync` became `foreign_command`.
    """
    law = {"controller": over(PAPER_LAW, data["controller"])} if "controller" in data else {}
    return {**data, **law, **_with_todays_trips(data.get("envelope"))}


def _with_todays_trips(envelope: Any) -> dict[str, Any]:
    reactions = envelope.get("reactions") if isinstance(envelope, Mapping) else None
    if not isinstance(reactions, Mapping) or "foreign_sync" not in reactions:
        return {}
    named = {"foreign_command" if name == "foreign_sync" else name: value for name, value in reactions.items()}
    return {"envelope": {**envelope, "reactions": named}}


def _scenario_2(data: Document) -> dict[str, Any]:
    """A controller takes what it does not say from the axis file, and a section that it gives has today's defaults."""
    controllers = data.get("controllers")
    if not isinstance(controllers, Mapping):
        return dict(data)
    return {**data, "controllers": {name: _variant_2(variant) for name, variant in controllers.items()}}


def _variant_2(variant: Any) -> Any:
    given = over({"feedforward": PAPER_LAW["feedforward"]}, variant)
    if isinstance(given, Mapping) and isinstance(given.get("at_rest"), Mapping):
        given = {**given, "at_rest": over(PAPER_LAW["at_rest"], given["at_rest"])}
    return given


HAND = "by hand"
NOBODY = "programs of others"

MODEL = Format("model", "model of an axis", f"bring-up, identify, diagnose, {HAND}", "all that runs or fits an axis")
AXIS = Format(
    "axis", "an axis: drive, model, law, limits, profile", f"bring-up, tune, close-the-loop, {HAND}",
    "all that runs an axis", (_axis_2,),
)  # fmt: skip
DRIVE_PROFILE = Format(
    "drive_profile", "what a family of drives needs", f"drive-info, {HAND}", "all that reads an axis"
)
SIMULATED = Format("simulated", "a simulated drive", f"close-the-loop, {HAND}", "sim, run, evaluate, close-the-loop")
SCENARIO = Format("scenario", "what is compared, on which axis", HAND, "evaluate", (_scenario_2,))
FACTS = Format("facts", "declared facts about a drive", f"close-the-loop, {HAND}", "identify, diagnose, close-the-loop")
COMMISSIONING = Format("commissioning", "record of a commissioning", "commission", "run, serve, close-the-loop")
ADOPTIONS = Format("adoptions", "models that an axis has had", "adopt, close-the-loop", "adopt")
DIAGNOSIS = Format("diagnosis", "report.json of a diagnosis", "diagnose", "adopt, close-the-loop")
IDENTIFICATION = Format("identification", "results in report.json of an identification", "identify", NOBODY)
TUNING = Format("tuning", "results in report.json of a design", "tune", NOBODY)
CIRCLE = Format("circle", "results in report.json of a whole circle", "close-the-loop", NOBODY)
FLEET = Format("fleet", "store.json of a fleet's store", "fleet add", "fleet")
FLEET_REPORT = Format("fleet_report", "results in report.json of a fleet", "fleet report", NOBODY)
FLEET_COMPARISON = Format("fleet_comparison", "results in report.json of two sets of runs", "fleet compare", NOBODY)
FLEET_DIAGNOSIS = Format("fleet_diagnosis", "results in report.json of drives that changed", "fleet diagnose", NOBODY)
POPULATION = Format("population", "parameters of the drives of one model", "fleet.prior", "identify, diagnose")
REPORT = Format("report", "report.json of all but diagnose", "identify, tune, evaluate, bench, close-the-loop", NOBODY)

FORMATS: dict[str, Format] = {
    f.kind: f
    for f in (
        AXIS, DRIVE_PROFILE, MODEL, SIMULATED, SCENARIO, FACTS, COMMISSIONING, ADOPTIONS, DIAGNOSIS, REPORT,
        IDENTIFICATION, TUNING, CIRCLE, FLEET, FLEET_REPORT, FLEET_COMPARISON, FLEET_DIAGNOSIS, POPULATION,
    )
}  # fmt: skip


def kind_of(data: Any) -> str | None:
    """The kind that a parsed file says it is of; None where it says none."""
    match = _WORD.fullmatch(str(data.get("format"))) if isinstance(data, Mapping) else None
    return None if match is None else match[1]


def migrated(data: Document, kind: str) -> Document:
    """The document as a file of today's number has it. Raises FormatError."""
    wanted = FORMATS[kind]
    said = data.get("format", f"fffo_drive/{kind}/1")
    match = _WORD.fullmatch(said) if isinstance(said, str) else None
    if match is None:
        raise FormatError(f"{said!r} is no format of this program; write {wanted.word}")
    if match[1] != kind:
        raise FormatError(f"{said} where {wanted.word} is needed ({wanted.what}): this is another kind of file")
    number = int(match[2])
    if number > wanted.newest:
        raise FormatError(_too_new(data, said, wanted))
    for migrate in wanted.migrations[number - 1 :]:
        try:
            data = migrate(data)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise FormatError(f"{said} cannot be brought to {wanted.word}: {error}") from None
    return data if number == wanted.newest else {**data, "format": wanted.word}


def _too_new(data: Document, said: str, wanted: Format) -> str:
    writer = writer_of(data)
    whose = (
        f"fffo-drive {writer} wrote it: read it with that version, or a later one"
        if writer is not None
        else "it does not say which version wrote it: read it with a later one"
    )
    return f"{said} is newer than what fffo-drive {__version__} reads ({wanted.word} and older); {whose}"


def writer_of(data: Document) -> str | None:
    """Version of the program that wrote a file, as far as the file says."""
    provenance = data.get("provenance")
    for place in (data, provenance if isinstance(provenance, Mapping) else {}):
        match = _VERSION.search(str(place.get("tool", "")))
        if match is not None:
            return match[1]
    return None
