"""The commissioning record: what was checked on which drive, with which declared facts, and what came of it.

A YAML file with a content hash. It stands for one drive (vendor, product, serial number) and one set of declared
scaling facts: with another drive, or once a fact is changed, it no longer counts.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from .. import formats
from ..documents import StrictRecord, load, refuse
from ..drive.port import DriveIdentity
from ..units import NORMAL_95

OK: Literal["ok"] = "ok"
WARNING: Literal["warning"] = "warning"
FAILED: Literal["failed"] = "failed"
NOT_DONE: Literal["not_done"] = "not_done"
Verdict = Literal["ok", "warning", "failed", "not_done"]

HASH_LENGTH = 64
MILLI = 1e-3


def _without(name: str, found: dict[str, Any]) -> dict[str, Any]:
    """A record without this key where it has no value."""
    return {key: value for key, value in found.items() if key != name or value is not None}


class DeclaredFacts(StrictRecord):
    """What an axis file and its model declare about the scaling of a drive; None where the drive has no such thing."""

    drive_kind: Annotated[Literal["canopen", "simulated"], Field(description="drive.kind")]
    counts_per_rev: Annotated[
        float | None, Field(description="drive.counts_per_rev, or what drive.resolver_bits gives")
    ] = None
    velocity_units_per_rps: Annotated[float | None, Field(description="drive.velocity_units_per_rps")] = None
    torque_constant_nm_per_a: Annotated[float, Field(description="of the model")]
    rated_torque_nm: Annotated[float | None, Field(description="drive.rated_torque_nm")] = None
    rated_current_a: Annotated[float | None, Field(description="drive.rated_current_a")] = None
    rated_current_unit_a: Annotated[float, Field(description="of 0x6075")] = MILLI
    rated_torque_unit_nm: Annotated[float, Field(description="of 0x6076")] = MILLI
    inverted: Annotated[bool, Field(description="drive.inverted")] = False
    sdo: Annotated[list[str], Field(description="drive.sdo: its units may change every scale")] = Field(
        default_factory=list
    )

    command: Annotated[str, Field(description="mode and objects, where they are not those of mode 10")] = ""

    @model_serializer(mode="wrap")
    def _without_nothing(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Records of drives without these keep their hash."""
        found: dict[str, Any] = dump(self)
        usual = {"sdo": [], "command": "", "rated_current_unit_a": MILLI, "rated_torque_unit_nm": MILLI}
        return {key: value for key, value in found.items() if key not in usual or value != usual[key]}

    @property
    def digest(self) -> str:
        """SHA-256 over all of them."""
        return _digest(self.model_dump(mode="json"))


class DriveRecord(StrictRecord):
    """What the drive said that it is (0x1018, 0x1008, 0x100A)."""

    vendor_id: Annotated[int, Field(description="0x1018:1")]
    product_code: Annotated[int, Field(description="0x1018:2")]
    revision: Annotated[int, Field(description="0x1018:3")]
    serial_number: Annotated[int, Field(description="0x1018:4")]
    device_name: Annotated[str, Field(description="0x1008; empty: not reported")] = ""
    software_version: Annotated[str, Field(description="0x100A; empty: not reported")] = ""

    @classmethod
    def of(cls, identity: DriveIdentity) -> DriveRecord:
        """From what bring-up read."""
        return cls(**identity._asdict())


class BoundsRecord(StrictRecord):
    """What no check was to exceed."""

    current_a: Annotated[float, Field(description="largest command")]
    speed_rps: Annotated[float, Field(description="highest speed")]
    travel_rev: Annotated[
        float, Field(description="largest distance from where the axis stood at the beginning, either way")
    ]
    time_s: Annotated[float, Field(description="of all motion together")]


UNEXPLAINED_SHARE = "unexplained_share"  # in the numbers of the check `motion`, where it is a warning


class CheckRecord(StrictRecord):
    """One check: what was measured and expected, and what to do when the two disagree."""

    name: Annotated[str, Field(description="short name of the check")]
    what: Annotated[str, Field(description="what is checked, in a few words")]
    verdict: Annotated[Verdict, Field(description="not_done: commissioning ended before it could be made")]
    measured: Annotated[float | None, Field(description="null: no number belongs to the check")] = None
    expected: Annotated[float | None, Field(description="what measured is compared with; null: no number")] = None
    lowest: Annotated[float | None, Field(description="lowest value that is ok")] = None
    highest: Annotated[float | None, Field(description="highest value that is ok")] = None
    unit: Annotated[str, Field(description="of measured, expected, lowest and highest; -: none")] = "-"
    text: Annotated[str, Field(description="what was found, in words")] = ""
    remedy: Annotated[str, Field(description="what to do; empty when all is well")] = ""
    numbers: Annotated[dict[str, float], Field(description="what else was measured")] = Field(default_factory=dict)


class SwingRecord(StrictRecord):
    """How the axis was moved for its response, and how far it went."""

    speed_rps: Annotated[float, Field(description="while it moved back and forth")]
    swing_hz: Annotated[float, Field(description="how often")]
    sweep_rps: Annotated[float, Field(description="amplitude of the sweep where inertia alone is moved ...")]
    most_sweep_a: Annotated[float, Field(description="... with no more current than this")]
    largest_a: Annotated[float, Field(description="largest command")]
    largest_rps: Annotated[float, Field(description="highest speed")]
    travel_rev: Annotated[float, Field(description="from the lowest to the highest position")]


class ElasticRecord(StrictRecord):
    """A load on a damped spring, as the effect `elasticity` has it, with standard deviations."""

    share: Annotated[float, Field(description="of the inertia")]
    share_sd: Annotated[float, Field(description="standard deviation of share")]
    frequency_hz: Annotated[float, Field(description="resonance of motor against load")]
    frequency_sd_hz: Annotated[float, Field(description="standard deviation of frequency_hz")]
    damping: Annotated[float, Field(description="damping ratio of the resonance")]
    damping_sd: Annotated[float, Field(description="standard deviation of damping")]

    @property
    def antiresonance_hz(self) -> float:
        """Where the load takes the torque, and the motor stands."""
        return self.frequency_hz * math.sqrt(1.0 - self.share)


class ContactRecord(StrictRecord):
    """What holds the axis at rest under a sweep of one amplitude."""

    current_a: Annotated[float, Field(description="amplitude of the sweep")]
    travel_rev: Annotated[float, Field(description="from the lowest to the highest position")]
    contact_per_s2: Annotated[float, Field(description="stiffness of the contact over the inertia")]
    contact_sd_per_s2: Annotated[float, Field(description="standard deviation of contact_per_s2")]
    damping_per_s: Annotated[float, Field(description="friction over the inertia")]


class ResponsePoints(StrictRecord):
    """A measured response of velocity to current."""

    frequency_hz: Annotated[list[float], Field(description="rising")]
    gain_rps_per_a: Annotated[list[float], Field(description="velocity over current")]
    phase_deg: Annotated[list[float], Field(description="of velocity behind current, with every delay between them")]
    coherence: Annotated[list[float], Field(description="share of the answer that repeats with the sweep")]


class RestRecord(ResponsePoints):
    """The response of the axis at rest to the largest of its sweeps, and its contact under each of them."""

    contacts: Annotated[list[ContactRecord], Field(min_length=2, description="by rising amplitude")]

    @property
    def contact_per_s2(self) -> tuple[float, float]:
        """The contact over the inertia, as soft and as stiff as these amplitudes show it.

        Friction gives way the more it is loaded. The stiffest is that of no load, on the line through the smallest and
        the largest amplitude.
        """
        first, last = self.contacts[0], self.contacts[-1]
        falls = max(0.0, first.contact_per_s2 - last.contact_per_s2) / (last.current_a - first.current_a)
        softest = min(one.contact_per_s2 - NORMAL_95 * one.contact_sd_per_s2 for one in self.contacts)
        stiffest = max(one.contact_per_s2 + NORMAL_95 * one.contact_sd_per_s2 for one in self.contacts)
        return softest, stiffest + falls * first.current_a


class ResponseRecord(ResponsePoints):
    """Velocity over current of the sliding axis, from the command to the drive's own velocity, and the fit to it."""

    swing: SwingRecord
    gain_rps2_per_a: Annotated[float, Field(description="Kt/J of motor and load")]
    delay_s: Annotated[float, Field(description="from a command to the velocity that shows it, without the hold")]
    hold_s: Annotated[float, Field(description="half a period: a command is held that long on average")]
    damping_per_s: Annotated[float, Field(description="friction of the swing over the inertia")]
    contact_per_s2: Annotated[float, Field(description="stiffness of the contact, while it reverses, over the inertia")]
    evidence: Annotated[float, Field(description="F of an elastic load against none")]
    elastic: Annotated[ElasticRecord | None, Field(description="null: none was found in this band")] = None
    fit_error: Annotated[
        float | None, Field(description="of the fit over the response, median; null: small enough to be believed")
    ] = None
    at_rest: Annotated[RestRecord | None, Field(description="null: it was not measured, or shows no contact")] = None

    @model_serializer(mode="wrap")
    def _without_nothing(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Records without a response at rest keep their hash."""
        return _without("fit_error", _without("at_rest", dump(self)))

    def contact_nm_per_rev(self, torque_constant_nm_per_a: float) -> tuple[float, float] | None:
        """The contact at rest, softest and stiffest; None where it was not measured."""
        if self.at_rest is None:
            return None
        inertia = torque_constant_nm_per_a / self.gain_rps2_per_a
        softest, stiffest = self.at_rest.contact_per_s2
        return inertia * softest, inertia * stiffest


class NoiseRecord(StrictRecord):
    """Noise of the feedback in motion: one-sided power spectral densities, each the mean over a band (Welch)."""

    frequency_hz: Annotated[list[float], Field(min_length=2, description="centres of the bands, rising")]
    position_rev2_per_hz: Annotated[list[float], Field(description="of the position, its counts included")]
    velocity_rps2_per_hz: Annotated[list[float], Field(description="of the drive's velocity")]


class CommissioningRecord(StrictRecord):
    """What `fffo-drive commission` writes and `fffo-drive run` asks for."""

    format: Annotated[str, formats.COMMISSIONING.key] = formats.COMMISSIONING.word
    axis: Annotated[str, Field(description="name of the axis")]
    date: Annotated[str, Field(description="UTC, ISO 8601")]
    tool: Annotated[str, Field(description="program and version that wrote it")]
    bus: Annotated[str, Field(description="where the drive was, as `drive.bus`; `in process`: a simulated one")]
    drive: DriveRecord
    facts: DeclaredFacts
    facts_hash: Annotated[
        str, Field(min_length=HASH_LENGTH, max_length=HASH_LENGTH, description="SHA-256 of facts; checked")
    ]
    model: Annotated[str, Field(description="name and content hash of the model compared with")]
    bounds: BoundsRecord
    verdict: Annotated[
        Literal["ok", "warning", "failed"],
        Field(description="of all checks together; failed: also where one was not done"),
    ]
    checks: Annotated[list[CheckRecord], Field(description="what was checked")]
    response: Annotated[ResponseRecord | None, Field(description="to the sweep; null: it was not measured")] = None
    noise: Annotated[NoiseRecord | None, Field(description="in motion; null: it was not measured")] = None
    content_hash: Annotated[
        str | None, Field(description="SHA-256 of all else, written by the program; without it a file is refused")
    ] = None

    @model_serializer(mode="wrap")
    def _without_nothing(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Records without a response or noise keep their hash."""
        return _without("noise", _without("response", dump(self)))

    @property
    def passed(self) -> bool:
        """True when the axis may be enabled with it."""
        return self.verdict != FAILED


def overall(checks: list[CheckRecord]) -> Literal["ok", "warning", "failed"]:
    """The verdict of all checks together: a check that could not be made has not been passed."""
    verdicts = {check.verdict for check in checks}
    if not checks or verdicts & {FAILED, NOT_DONE}:
        return FAILED
    return WARNING if WARNING in verdicts else OK


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def content_hash(record: CommissioningRecord) -> str:
    """SHA-256 over everything but the hash itself."""
    return _digest(record.model_dump(mode="json", exclude={"content_hash"}))


class _Dumper(yaml.SafeDumper):
    """Lists of numbers in lines, not a line for each number."""


def _list_node(dumper: yaml.SafeDumper, data: list[Any]) -> yaml.SequenceNode:
    numbers = bool(data) and all(isinstance(value, float) for value in data)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=numbers or None)


_Dumper.add_representer(list, _list_node)


def write_record(path: Path, record: CommissioningRecord) -> CommissioningRecord:
    """Write a record with its content hash, in one step: a record is whole or not there. Returns it. Raises OSError."""
    stamped = record.model_copy(update={"content_hash": content_hash(record)})
    content = stamped.model_dump(mode="json", exclude_none=True)
    text = yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=110, allow_unicode=True)
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)
    return stamped


def read_record(path: Path) -> CommissioningRecord:
    """Read and check a record. Raises DocumentError naming file, line and key."""
    record = load(path, CommissioningRecord)
    problems = []
    if record.content_hash != content_hash(record):
        problems.append(
            ("content_hash", "does not match the content: a record is not edited by hand; commission the axis again")
        )
    elif record.facts_hash != record.facts.digest:
        problems.append(("facts_hash", "does not match the facts in the record; commission the axis again"))
    refuse(path, problems)
    return record


def fact_differences(record: CommissioningRecord, facts: DeclaredFacts) -> list[str]:
    """Declared facts that are no longer those of the record: one text each."""
    both = {name: (getattr(record.facts, name), getattr(facts, name)) for name in DeclaredFacts.model_fields}
    return [f"{name} was {then}, is {now}" for name, (then, now) in both.items() if then != now]


def identity_differences(record: CommissioningRecord, identity: DriveIdentity) -> list[str]:
    """What of vendor, product and serial number is not that of the record: one text each."""
    return [
        f"{name} 0x{then:08X} in the record, 0x{now:08X} on the bus"
        for name in ("vendor_id", "product_code", "serial_number")
        if (then := getattr(record.drive, name)) != (now := getattr(identity, name))
    ]
