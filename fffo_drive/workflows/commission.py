"""Commissioning: a drive is checked before any loop is closed; `run` requires the record."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from .. import __version__
from ..commissioning.bounds import Bounds, BoundsError, make_bounds
from ..commissioning.procedure import MayMove, Seen, commission
from ..commissioning.record import BoundsRecord, CommissioningRecord, DriveRecord, overall, read_record, write_record
from ..config.axis import beside, build_profile, model_of, read_axis
from ..config.axis_text import replace_file, with_line
from ..config.checks import bus_problems, require
from ..config.commissioning import declared_facts, permission
from ..config.drive_section import CanopenDriveSection
from ..config.runaway import runaway_problems
from ..documents import DocumentError
from ..model.parameters import content_hash
from ..runtime.fault_at_start import clear_fault
from ..runtime.session import Session
from .plan import Plan, open_drive, plan_session


def commissioning_plan(path: Path) -> Plan:
    """The parts of the axis file that commissioning needs: law and profile may still be unfinished."""
    axis = read_axis(path)
    model = model_of(path, axis)
    require(path, bus_problems(axis, model) + runaway_problems(axis, model))
    return Plan(path, axis, model, build_profile(axis.profile, axis.loop.period_s))


def record_path(plan: Plan) -> Path:
    """Where the record of an axis belongs: where its file says, else NAME.commissioning.yaml beside it."""
    return beside(plan.path, plan.axis.commissioning or f"{plan.axis.name}.commissioning.yaml")


def bounds_of(
    plan: Plan, current_a: float | None = None, speed_rps: float | None = None, travel_rev: float | None = None
) -> Bounds:
    """Bounds of the motion, inside the file's envelope (None: made from it). Raises DocumentError, BoundsError."""
    try:
        return make_bounds(plan_session(plan).envelope, current_a, speed_rps, travel_rev)
    except BoundsError as error:
        require(plan.path, [f"envelope: {error}"])
        raise


def commission_axis(
    plan: Plan, bounds: Bounds, out: Path, bus: str | None = None, tell: Callable[[str], None] = lambda text: None,
    seen: Seen = lambda check, motion: None, may_move: MayMove = lambda motion: True, reset_fault: bool = False,
) -> CommissioningRecord:  # fmt: skip
    """Check the drive of an axis file with small pulses, and write the record to `out`. The axis moves.

    `bus`: replaces the file's; `tell` gets a line for each step, `seen` each check as it is done, and `may_move` says
    whether the next motion may be made; `reset_fault`: of a drive that is in fault, first of all.

    Raises DocumentError, DriveError, NotAgreedError, OSError.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(out.parent, os.W_OK):  # before anything moves
        raise PermissionError(13, "no record can be written here", str(out.parent))
    facts = declared_facts(plan.axis, plan.model)
    drive = open_drive(plan, bus)
    try:
        command = f"fffo-drive commission {shlex.quote(str(plan.path))} --reset-fault"

        def prepare(session: Session) -> None:
            if cleared := clear_fault(session, reset_fault, command):
                tell(cleared)

        outcome = commission(drive, plan_session(plan), plan.model, facts, bounds, tell, seen, may_move, prepare)
    except BoundsError as error:
        require(plan.path, [f"envelope.position_window_rev: {error}"])
        raise
    section = plan.axis.drive
    record = CommissioningRecord(
        axis=plan.axis.name,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        tool=f"fffo_drive {__version__}",
        bus=(bus or section.bus) if isinstance(section, CanopenDriveSection) else "in process",
        drive=DriveRecord.of(outcome.identity),
        facts=facts,
        facts_hash=facts.digest,
        model=f"{plan.model.name}, SHA-256 {content_hash(plan.model)}",
        bounds=BoundsRecord(**bounds._asdict()),
        verdict=overall(outcome.checks),
        checks=outcome.checks,
        response=outcome.response,
        noise=outcome.noise,
    )
    return write_record(out, record)


def accept_record(plan: Plan, record: Path) -> str:
    """Name a record that has passed in the axis file, whose comments stay. Returns the name.

    Raises DocumentError where the record has not passed, is of other facts, or the line cannot be written; OSError.
    """
    if not record.exists():
        raise DocumentError(f"{record}: there is no record yet: commission the axis first")
    if not read_record(record).passed:
        raise DocumentError(f"{record}: this commissioning has not passed: see its checks, and commission again")
    name = os.path.relpath(record.resolve(), plan.path.resolve().parent)
    permission(plan.path, plan.axis.model_copy(update={"commissioning": name}), plan.model)
    replace_file(plan.path, with_line(plan.path, "commissioning", name))
    return name
