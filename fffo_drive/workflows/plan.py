"""An axis file into a connected drive, a session and the header of its runs; for subcommands and the daemon."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..config.axis import (
    TOGGLES,
    AxisFile,
    beside,
    build_profile,
    deciding_section,
    model_of,
    read_axis,
)
from ..config.checks import bus_problems, law_problems, motion_problems, profile_problems, require, velocity_problems
from ..config.drive_profile import profile_path
from ..config.drive_section import CanopenDriveSection
from ..config.effects import compensated_names, effect_problems
from ..config.profile_sections import ProfileSection
from ..config.runaway import runaway_problems
from ..config.sections import length_problems
from ..control.friction_observer import TOGGLE_NAMES, TOGGLE_OFF
from ..control.own_law import ControlLaw
from ..control.reference import Profile
from ..documents import StrictRecord, check, parse, read_text, refuse, require_named
from ..drive.port import Drive, DriveIdentity, DriveRefusedError
from ..model.parameters import ModelFile
from ..recording.settings import RunHeader
from ..units import NS_PER_S

if TYPE_CHECKING:
    from ..config.commissioning import Permission
    from ..runtime.effect_monitor import EffectMonitor
    from ..runtime.session import SessionConfig

YAML_TYPE = "application/yaml"


class Plan(NamedTuple):
    """A checked axis file with all files that it names."""

    path: Path
    axis: AxisFile
    model: ModelFile
    profile: Profile
    controller: ControlLaw | None = None  # of a user, in place of the file's

    @property
    def toggle(self) -> int:
        """The toggle of the file."""
        return TOGGLES[self.axis.controller.observer.toggle]


class ProfileFile(StrictRecord):
    """A profile in a file of its own, for `run --profile`: for any axis whose limits allow it."""

    profile: ProfileSection


def read_profile_file(path: str | Path) -> ProfileFile:
    """A profile in a file of its own. Raises DocumentError with every error in it."""
    data, lines = parse(read_text(Path(path)), str(path))
    if isinstance(data, dict) and "format" in data:
        text = f"{data['format']} where a file with only a `profile:` section is needed: this is another kind of file"
        refuse(path, [("format", text)])
    return check(data, ProfileFile, str(path), lines)


def make_plan(
    path: str | Path, toggles: tuple[int, ...] | None = None, decide: str | None = None,
    profile_file: str | Path | None = None,
) -> Plan:  # fmt: skip
    """Read an axis file and everything that it names, and check that it may run with these toggles (None: its own).

    With `decide`, the name of an effect, the profile is the motion that separates it from its lookalikes; with
    `profile_file` it is that of another file.
    Raises DocumentError with every problem found.
    """
    path = Path(path)
    axis = read_axis(path)
    if decide is not None:
        axis = axis.model_copy(update={"profile": deciding_section(axis, decide)})
    if profile_file is not None:
        axis = axis.model_copy(update={"profile": read_profile_file(profile_file).profile})
    return checked_plan(path, axis, model_of(path, axis), toggles, profile_file)


def checked_plan(
    path: Path, axis: AxisFile, model: ModelFile, toggles: tuple[int, ...] | None = None,
    profile_file: str | Path | None = None, argument: str | None = None,
) -> Plan:  # fmt: skip
    """As `make_plan`, for files that were read already or changed since. Raises DocumentError.

    `argument`: what a message names instead of the axis file, whose lines are not what was given.
    """
    of_profile = path if profile_file is None else Path(profile_file)
    of_argument = argument if profile_file is None else None
    require(of_profile, length_problems(axis.profile, axis.loop), of_argument)
    profile = build_profile(axis.profile, axis.loop.period_s)
    problems = profile_problems(axis, profile) + motion_problems(axis, profile, model)
    if profile_file is not None:
        require(of_profile, problems)
        problems = []
    problems += bus_problems(axis, model) + runaway_problems(axis, model)
    toggles = toggles or (TOGGLES[axis.controller.observer.toggle],)
    proof = proof_problems(axis, model, toggles, profile)
    problems += proof + [text for text in velocity_problems(axis, model) if text not in proof]
    require(path, problems, argument)
    return Plan(path, axis, model, profile)


def proof_problems(
    axis: AxisFile, model: ModelFile, toggles: tuple[int, ...], profile: Profile | None = None
) -> list[str]:
    """Objections to the law with these toggles; none if the file accepts an unproven law.

    With a profile also objections to compensating the model's effects in it.
    """
    problems: list[str] = []
    if not axis.controller.accept_unproven:
        for observer_on in sorted({toggle != TOGGLE_OFF for toggle in toggles}):
            found = law_problems(axis, model, observer_on)
            if profile is not None:
                found += effect_problems(axis, model, profile, observer_on)
            problems += [text for text in found if text not in problems]
    return problems


def open_drive(plan: Plan, bus: str | None = None) -> Drive:
    """The drive of an axis file, not yet connected. `bus` replaces the bus of the file."""
    section = plan.axis.drive
    period_ns = NS_PER_S // plan.axis.loop.rate_hz
    if isinstance(section, CanopenDriveSection):
        from ..drive.canopen.drive import CanopenDrive

        on_bus = section.drive_config(plan.model.torque_constant_nm_per_a, period_ns, bus)
        if on_bus.eds is not None:
            eds = require_named(plan.path, "drive.eds", beside(plan.path, on_bus.eds))
            on_bus = dataclasses.replace(on_bus, eds=str(eds))
        return CanopenDrive(on_bus)
    from ..config.simulated import read_simulated
    from ..drive.simulated.in_process import SimulatedDrive

    if bus is not None:
        require(plan.path, [f"drive.kind: simulated runs in process and has no bus: leave --bus {bus} out"])

    config = read_simulated(require_named(plan.path, "drive.file", beside(plan.path, section.file)))
    return SimulatedDrive(config.plant, config.device)


def plan_session(plan: Plan, ring_rows: int | None = None) -> SessionConfig:
    """The session of a plan."""
    from ..config.session import session_config

    config = session_config(plan.axis, plan.model, plan.profile.values.size, ring_rows)
    return config._replace(own_law=plan.controller)


def effect_monitor(plan: Plan) -> EffectMonitor | None:
    """The monitor of the model's effects in a live run; None if no effect is compensated or monitored."""
    from ..runtime.effect_monitor import EffectMonitor, MonitorConfig

    section = plan.axis.controller.effects
    names = compensated_names(plan.axis, plan.model)
    if not section.monitor or not names:
        return None
    return EffectMonitor(plan.axis.loop.period_s, names, MonitorConfig(window_s=section.monitor_window_s))


def connect(drive: Drive, given: Permission) -> DriveIdentity:
    """Bring a drive up that is to be enabled. Raises DriveError, also when it is not the one that was commissioned."""
    from ..config.commissioning import require_identity

    identity = drive.connect()
    try:
        require_identity(given, identity)
    except DriveRefusedError:
        drive.close()
        raise
    return identity


def run_header(plan: Plan, identity: DriveIdentity, toggle: int, given: Permission | None = None) -> RunHeader:
    """Metadata and attachments: the file as it was read, the model, the record of commissioning where there is one."""
    from ..runtime.runs import run_metadata

    profile = plan.profile
    extra = {"profile": profile.name, "profile_samples": str(profile.values.size)}
    if given:
        extra["commissioning"] = given.note
    metadata = run_metadata(plan.axis.name, identity, toggle, profile.period_s, extra)
    model_path = beside(plan.path, plan.axis.model)
    attachments: tuple[tuple[str, str, bytes], ...] = (
        (plan.path.name, YAML_TYPE, plan.path.read_bytes()),
        (model_path.name, YAML_TYPE, model_path.read_bytes()),
    )
    if isinstance(plan.axis.drive, CanopenDriveSection) and plan.axis.drive.profile is not None:
        family = profile_path(plan.path, plan.axis.drive.profile)
        attachments += ((family.name, YAML_TYPE, family.read_bytes()),)
    if given is not None and given.file is not None:
        attachments += ((given.file.name, YAML_TYPE, given.file.read_bytes()),)
    return RunHeader(metadata, attachments)


def toggle_name(toggle: int) -> str:
    """off, ff or fb."""
    return TOGGLE_NAMES[toggle]
