"""Run one profile of an axis file on its simulated drive in process, without a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from ..config.axis import beside
from ..config.drive_section import SimulatedDriveSection
from ..config.simulated import plant_effects, read_simulated
from ..control.envelope import TRIP_NONE, TRIP_TEXTS
from ..documents import DocumentError, require_named
from ..drive.simulated.in_process import SimulatedDrive
from ..evaluation.metrics import Rows
from ..recording.ring_reader import RingReader
from ..runtime import blocks as b
from ..runtime.runs import simulated_ring_rows
from ..runtime.session import Session, raise_failure
from .plan import Plan, plan_session


class Simulated(NamedTuple):
    """Result of a run."""

    rows: Rows  # (n,) of signals.ROW
    fault: str | None  # why the envelope ended it; None when it did not


def simulate(
    plan: Plan, toggle: int, seed: int | None = None, effects: Mapping[str, Mapping[str, float]] | None = None
) -> Simulated:
    """Run the profile of a plan. `seed` of the drive's noise and `effects` of the drive: None for those of its file.

    Raises DocumentError for an axis whose drive is on a bus.
    """
    section = plan.axis.drive
    if not isinstance(section, SimulatedDriveSection):
        raise DocumentError(f"{plan.path}: drive.kind: the drive is on a bus: `run` moves it, `simulate` cannot")
    config = read_simulated(require_named(plan.path, "drive.file", beside(plan.path, section.file)))
    plant = config.plant if seed is None else replace(config.plant, seed=seed)
    if effects is not None:
        plant = replace(plant, effects=plant_effects(effects))
    drive = SimulatedDrive(plant, config.device)
    drive.connect()
    ring_rows = simulated_ring_rows(plan.profile, plan.axis.loop.tail_s)
    with Session(drive, plan_session(plan, ring_rows)) as session:
        session.run_profile(plan.profile, toggle)
        raise_failure(session)
        trip = session.status(b.TRIP)
        rows = RingReader(session.ring).read().rows
    return Simulated(rows, None if trip == TRIP_NONE else TRIP_TEXTS[trip])
