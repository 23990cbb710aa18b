"""Whether an axis may be enabled: its commissioning record against the declared facts and the drive that answers.

A drive on a bus needs a record. The simulated drive in process needs none: it is made from the same file as its facts.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from ..commissioning.record import (
    UNEXPLAINED_SHARE,
    CheckRecord,
    CommissioningRecord,
    DeclaredFacts,
    NoiseRecord,
    ResponseRecord,
    fact_differences,
    identity_differences,
    read_record,
)
from ..documents import refuse
from ..drive.port import DriveIdentity, DriveRefusedError
from ..model.parameters import ModelFile
from .axis import AxisFile, beside
from .drive_section import RATED_CURRENT_UNITS, RATED_TORQUE_UNITS, CanopenDriveSection

AGAIN = "commission it again (fffo-drive commission {path}), or give --uncommissioned"


class Permission(NamedTuple):
    """To enable an axis: by which record (None: without one), and what a run's metadata says about it."""

    file: Path | None
    record: CommissioningRecord | None
    note: str


def declared_facts(axis: AxisFile, model: ModelFile) -> DeclaredFacts:
    """The scaling that an axis file and its model declare."""
    constant = model.torque_constant_nm_per_a
    section = axis.drive
    if not isinstance(section, CanopenDriveSection):
        return DeclaredFacts(drive_kind="simulated", torque_constant_nm_per_a=constant)
    return DeclaredFacts(
        drive_kind="canopen",
        counts_per_rev=section.counts,
        velocity_units_per_rps=section.velocity_units_per_rps,
        torque_constant_nm_per_a=constant,
        rated_torque_nm=section.rated_torque_nm,
        rated_current_a=section.rated_current_a,
        rated_current_unit_a=RATED_CURRENT_UNITS[section.rated_current_unit],
        rated_torque_unit_nm=RATED_TORQUE_UNITS[section.rated_torque_unit],
        inverted=section.inverted,
        sdo=[entry.write().text for entry in section.sdo],
        command=_command_text(section),
    )


def _command_text(section: CanopenDriveSection) -> str:
    """Mode, target and feedback where they are not those of CiA 402's cyclic synchronous torque."""
    standard = CanopenDriveSection.model_fields
    keys = ("mode", "target", "torque_feedback")
    own = {key: getattr(section, key) for key in keys if getattr(section, key) != standard[key].default}
    return "; ".join(f"{key} {value}" for key, value in own.items())


def permission(path: str | Path, axis: AxisFile, model: ModelFile, uncommissioned: bool = False) -> Permission:
    """Permission as far as files can tell; `require_identity` asks the drive.

    Raises DocumentError where a record is needed and is missing, has not passed, or stands for other declared facts.
    """
    if not isinstance(axis.drive, CanopenDriveSection):
        return Permission(None, None, "not needed: simulated in process")
    if uncommissioned:
        return Permission(None, None, "none: --uncommissioned was given")
    if axis.commissioning is None:
        text = (
            "signs, scales and limits of this axis were never checked: run fffo-drive commission "
            f"{path} and name its record here, or give --uncommissioned"
        )
        refuse(path, [("commissioning", text)])
    file = beside(path, str(axis.commissioning))
    if not file.exists():
        text = f"{file} is not there: run fffo-drive commission {path}, which writes it, or give --uncommissioned"
        refuse(path, [("commissioning", text)])
    record = read_record(file)
    again = AGAIN.format(path=path)
    differences = fact_differences(record, declared_facts(axis, model))
    problems = []
    if not record.passed:
        open_checks = [check for check in record.checks if check.verdict in ("failed", "not_done")]
        problems.append(f"{file} of {record.date} has not passed: {_first(open_checks)}; correct that, then {again}")
    if differences:
        problems.append(f"{file} of {record.date} is for other declared facts: {'; '.join(differences)}; {again}")
    refuse(path, [("commissioning", text) for text in problems])
    return Permission(file, record, f"{record.verdict}: {file.name} of {record.date}, SHA-256 {record.content_hash}")


class Commissioned(NamedTuple):
    """What commissioning measured of the axis' dynamics."""

    delay_s: float | None = None  # command to measured velocity, without the hold
    unexplained_share: float = 0.0  # of the velocity variance, by a single rigid inertia; 0 where it was no warning
    response: ResponseRecord | None = None  # to the sweep
    noise: NoiseRecord | None = None  # of position and velocity in motion


NOT_COMMISSIONED = Commissioned()


def commissioned(path: str | Path, axis: AxisFile) -> Commissioned:
    """What the record of this axis says; nothing where there is none.

    An axis file of `bring-up` names its record before there is one. Raises DocumentError for one that was edited.
    """
    if axis.commissioning is None or not (file := beside(path, axis.commissioning)).exists():
        return NOT_COMMISSIONED
    record = read_record(file)
    return commissioned_in(record.checks)._replace(response=record.response, noise=record.noise)


def commissioned_in(checks: Iterable[CheckRecord]) -> Commissioned:
    """The same in checks."""
    by_name = {check.name: check for check in checks}
    delay, motion = by_name.get("delay"), by_name.get("motion")
    return Commissioned(
        None if delay is None else delay.measured,
        0.0 if motion is None else motion.numbers.get(UNEXPLAINED_SHARE, 0.0),
    )


def require_identity(given: Permission, identity: DriveIdentity) -> None:
    """Raise DriveRefusedError when the drive on the bus is not the one of the record."""
    if given.record is None:
        return
    differences = identity_differences(given.record, identity)
    if differences:
        raise DriveRefusedError(
            f"this is not the drive that was commissioned in {given.file}: {'; '.join(differences)}; commission the "
            "axis again, or give --uncommissioned"
        )


def _first(checks: list[CheckRecord]) -> str:
    """The checks that stand in the way, the first with its text."""
    failed = [check for check in checks if check.verdict == "failed"] or checks
    if not failed:
        return "no check was made"
    names = ", ".join(check.name for check in failed)
    return f"{names} ({failed[0].text})"
