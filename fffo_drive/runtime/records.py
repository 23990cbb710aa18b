"""Records of a session, written from the inputs of the loop and read back for a replay."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..control.compensation import effect_names, table_numbers, table_of
from ..control.controller import CONTROLLER_NAMES
from ..control.envelope import EnvelopeConfig
from ..control.reference import Profile
from ..control.set_point import SET_POINT_NAMES, SetPoint
from ..recording.run_records import RecordKind, RunRecord
from ..units import NS_PER_S
from . import blocks as b
from .tick import LoopConfig

WORD_KINDS = {  # control words whose changes are records of their own
    b.STOP: RecordKind.STOP,
    b.GOAL: RecordKind.GOAL,
    b.TOGGLE: RecordKind.TOGGLE,
    b.PROFILE_ABORT: RecordKind.ABORT,
    b.SET_POINT_ABORT: RecordKind.SET_POINT_ABORT,
    b.RESET_NUMBER: RecordKind.RESET,
    b.AUTOSTOP: RecordKind.AUTOSTOP,
    b.EFFECTS: RecordKind.IN_SERVICE,
}
REACTION = "envelope.reactions."
LONGEST_TEXT = 1000  # characters of a value in a request


class ModelNote(NamedTuple):
    """A model file in a record."""

    name: str
    content_hash: str
    text: str  # of the whole file


class Unnumbered(NamedTuple):
    """A record without its place, as `Session` adds it."""

    number: int
    kind: RecordKind
    names: tuple[str, ...]
    values: tuple[float, ...]
    data: Mapping[str, Any]


def of_session(session_id: str, loop: LoopConfig, envelope: EnvelopeConfig) -> Unnumbered:
    """Times of the loop and limits of the envelope, constant for the whole session."""
    values = {f"loop.{name}": value for name, value in loop._asdict().items()}
    limits = envelope._asdict()
    reactions = limits.pop("reactions")
    values |= {f"envelope.{name}": value for name, value in limits.items()}
    values |= {f"{REACTION}{trip}": reaction for trip, reaction in enumerate(reactions)}
    return Unnumbered(0, RecordKind.SESSION, tuple(values), _floats(values.values()), {"session": session_id})


def of_model(number: int, model: ModelNote) -> Unnumbered:
    """A model file."""
    return Unnumbered(number, RecordKind.MODEL, (), (), model._asdict())


def of_parameters(number: int, block: Floats, model: ModelNote | None) -> Unnumbered:
    """A packed controller block, and the model from which it was made."""
    data = {} if model is None else {"model": model.content_hash}
    return Unnumbered(number, RecordKind.PARAMETERS, CONTROLLER_NAMES, _floats(block), data)


def of_effects(number: int, table: Floats) -> Unnumbered:
    """A table of compensated effects."""
    names, numbers = table_numbers(table)
    return Unnumbered(number, RecordKind.EFFECTS, tuple(names), _floats(numbers), {"effects": effect_names(table)})


def of_profile(number: int, profile: Profile) -> Unnumbered:
    """A profile. Its samples are in the rows, bit for bit; the record holds what is needed to compare them."""
    names = ("mode", "period_s", "samples", "least", "largest")
    extremes = (float(profile.values.min()), float(profile.values.max())) if profile.values.size else (0.0, 0.0)
    values = _floats((profile.mode, profile.period_s, profile.values.size, *extremes))
    return Unnumbered(
        number,
        RecordKind.PROFILE,
        names,
        values,
        {"name": profile.name, "values_sha256": values_digest(profile.values)},
    )


def of_set_point(number: int, set_point: SetPoint) -> Unnumbered:
    """A live set point, from which a replay recomputes the reference."""
    return Unnumbered(number, RecordKind.SET_POINT, SET_POINT_NAMES, _floats(set_point), {})


def values_digest(values: Floats) -> str:
    """SHA-256 of samples as little-endian float64."""
    return hashlib.sha256(np.ascontiguousarray(values, "<f8").tobytes()).hexdigest()


def of_word(kind: RecordKind, value: int) -> Unnumbered:
    """A written control word."""
    return Unnumbered(value if kind is RecordKind.RESET else 0, kind, (kind.value,), (float(value),), {})


def of_request(who: str, what: str, values: Mapping[str, Any], epoch: int | None) -> Unnumbered:
    """A request and its sender. Long texts (a model has its own record) are replaced by their digest."""
    epoch_entry = {} if epoch is None else {"epoch": epoch}
    short = {name: _shortened(value) for name, value in values.items()}
    return Unnumbered(0, RecordKind.REQUEST, (), (), {"who": who, "what": what, "values": short, **epoch_entry})


def _shortened(value: Any) -> Any:
    if isinstance(value, str) and len(value) > LONGEST_TEXT:
        return f"sha256:{hashlib.sha256(value.encode()).hexdigest()}"
    return value


# ---- and back


def envelope_of(record: RunRecord) -> EnvelopeConfig:
    """The envelope of a `session` record. Raises ValueError for one that lacks a limit of today."""
    values = record.by_name
    fields: dict[str, Any] = {}
    for name, kind in EnvelopeConfig.__annotations__.items():
        if name == "reactions":
            continue
        if f"envelope.{name}" not in values:
            raise ValueError(f"the record of the session has no envelope.{name}")
        fields[name] = _as_declared(kind, values[f"envelope.{name}"])
    reactions = [int(value) for name, value in values.items() if name.startswith(REACTION)]
    return EnvelopeConfig(**fields, reactions=np.array(reactions, np.int64))


def period_s_of(record: RunRecord) -> float:
    """Period of the loop of a `session` record, as the loop has it."""
    return record.by_name["loop.period_ns"] / NS_PER_S


def block_of(record: RunRecord) -> Floats:
    """The packed controller block of a `parameters` record. Raises ValueError for one of other parameters."""
    if record.names != CONTROLLER_NAMES:
        other = sorted(set(record.names) ^ set(CONTROLLER_NAMES))
        raise ValueError(f"parameters {record.number} have other names than this version's: {', '.join(other)}")
    return np.array(record.values)


def set_point_of(record: RunRecord) -> Floats:
    """The packed set point of a `set_point` record. Raises ValueError for one of other names."""
    if record.names != SET_POINT_NAMES:
        raise ValueError(f"set point {record.number} has other names than this version's: {', '.join(record.names)}")
    return np.array(record.values)


def effects_of(record: RunRecord) -> Floats:
    """The table of an `effects` record, for this process. Raises ValueError for effects that are not known here."""
    try:
        return table_of(record.values, record.data["effects"])
    except KeyError as error:
        raise ValueError(f"effects {record.number}: no effect is called {error} here") from None


def _as_declared(kind: str, value: float) -> float | int | bool:
    if kind == "bool":
        return bool(value)
    return int(value) if kind == "int" else value


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
