"""The status of the daemon, as `status` answers and `subscribe` sends it."""

from __future__ import annotations

from typing import Any

from ..control.envelope import TRIP_NAMES
from ..control.reference import MODE_CURRENT, MODE_VELOCITY
from ..drive.cia402 import state_name
from ..drive.port import exchange_counts
from ..runtime import blocks as b
from ..runtime.adaptation_watch import bound_names
from ..workflows.plan import toggle_name
from .parameters import agreed_protocol
from .profiles import profile_names
from .set_points import latency_s
from .settings import live_keys, value_of
from .states import State
from .supervisor import Supervisor

ADAPTED = ("offset_nm", "coulomb_nm", "viscous_nm_per_rps")  # of the row, behind adapted_
MOTION = (
    "velocity_rps", "position_rev", "current_a", "current_command_a", "reference_rps", "error_rps", "friction_nm",
)  # fmt: skip
MODES = {MODE_VELOCITY: "velocity", MODE_CURRENT: "current"}


def status_of(supervisor: Supervisor, now_s: float) -> dict[str, Any]:
    """All changing state as one JSON object. Numbers have their units in their names."""
    plan = supervisor.plan
    fault = supervisor.fault
    ready = supervisor.state not in (State.OFFLINE, State.CONNECTED)
    return {
        "state": supervisor.state.value,
        "state_s": round(now_s - supervisor.since_s, 3),
        "obstacles": [] if ready else supervisor.obstacles,
        "fault": None if fault is None else fault._asdict(),
        "toggle": toggle_name(supervisor.toggle),
        "model": {"name": plan.model.name, "hash": supervisor.model_hash},
        "effects": supervisor.effects.status(),
        "profile": _profile_of(supervisor),
        "set_point": _set_point_of(supervisor),
        "recording": supervisor.recorder.status(),
        "disk": supervisor.files.silent or supervisor.recorder.silent or None,
        "last_event": supervisor.log.last_number,
        **_loop_of(supervisor),
    }


def _profile_of(supervisor: Supervisor) -> dict[str, Any] | None:
    profile, connection = supervisor.profile, supervisor.connection
    if profile is None or connection is None:
        return None
    sample = connection.session.status(b.PROFILE_SAMPLE)
    return {
        "name": profile.name,
        "sample": sample,
        "samples": int(profile.values.size),
        "duration_s": profile.duration_s,
    }


def _set_point_of(supervisor: Supervisor) -> dict[str, Any] | None:
    motion = supervisor.motion
    if motion is None or motion.asked is None:
        return None
    hold_s = motion.asked.set_point.hold_ticks * supervisor.plan.axis.loop.period_s
    return {
        "kind": motion.asked.kind,
        "number": motion.set_point_number,
        "to_rps": motion.target_rps,
        "hold_s": hold_s or None,
        "run_on": motion.asked.set_point.hold_ticks == 0,
        "lapsed": motion.lapsed,
        "blocked": motion.blocked,
        "latency_s": latency_s(supervisor.plan),
    }


def _loop_of(supervisor: Supervisor) -> dict[str, Any]:
    """State of the loop and the drive; `loop`, `drive` and `motion` are null without a connection."""
    connection = supervisor.connection
    if connection is None:
        return {"loop": None, "drive": None, "motion": None}
    session = connection.session
    feedback = connection.drive.feedback
    row = connection.last_row()
    loop: dict[str, Any] = {
        "connection": connection.number,
        "running": connection.running,
        "tick": session.status(b.TICK),
        "rows": connection.head,
        "late": session.status(b.LATE_TICKS),
        "skipped": session.status(b.SKIPPED_TICKS),
        "missing_feedback": session.status(b.MISSING_FEEDBACK),
        "stale_blocks": session.status(b.STALE_BLOCKS),
        "trip": TRIP_NAMES.get(connection.trip),
        "exchange": exchange_counts(feedback)._asdict(),
    }
    statusword = session.status(b.STATUSWORD)
    drive = {
        "name": connection.identity.device_name,
        "statusword": statusword,
        "state": state_name(statusword),
        "emergency_code": int(feedback["emergency_code"][0]),
        "nmt_state": int(feedback["nmt_state"][0]),
    }
    if row is None:
        return {"loop": loop, "drive": drive, "motion": None}
    motion: dict[str, Any] = {name: float(row[name]) for name in MOTION}
    if supervisor.plan.axis.controller.adaptation.enabled:
        adapted = {name: float(row[f"adapted_{name}"]) for name in ADAPTED}
        loop["adaptation"] = {**adapted, "at_bound": bound_names(session.status(b.ADAPTED_TO_BOUND))}
    motion |= {"mode": MODES.get(int(row["mode"]), "idle"), "age": int(row["velocity_age"])}
    return {"loop": loop, "drive": drive, "motion": motion}


def line_of(supervisor: Supervisor) -> str:
    """One line, for `systemctl status`."""
    if supervisor.fault is not None:
        return f"fault: {supervisor.fault.text}"
    if supervisor.obstacles and supervisor.state in (State.OFFLINE, State.CONNECTED):
        return f"{supervisor.state.value}: {supervisor.obstacles[0]}"
    disk = supervisor.files.silent or supervisor.recorder.silent
    profile = supervisor.profile
    running = f" {profile.name}" if supervisor.state is State.RUNNING and profile is not None else ""
    if supervisor.state is State.FOLLOWING and supervisor.motion is not None and supervisor.motion.asked is not None:
        running = f" {supervisor.motion.asked.kind} to {supervisor.motion.target_rps:g} rps"
    return f"{supervisor.state.value}{running}, friction {toggle_name(supervisor.toggle)}{disk and f'; {disk}'}"


def info_of(supervisor: Supervisor, version: str, spoken: int | list[int] | None = None) -> dict[str, Any]:
    """Constant data: protocol, axis, drive, profiles, keys, states.

    `spoken`: versions of the API that the client supports. Raises DocumentError if there is no common version.
    """
    plan = supervisor.plan
    connection = supervisor.connection
    realtime = None if connection is None else connection.realtime._asdict()
    identity = None if connection is None else connection.identity._asdict()
    return {
        "protocol": agreed_protocol(spoken),
        "fffo_drive": version,
        "axis": plan.axis.name,
        "file": str(plan.path),
        "rate_hz": plan.axis.loop.rate_hz,
        "drive": identity,
        "realtime": realtime,
        "profiles": list(profile_names(plan)),
        "keys": {key: value_of(plan.axis, key) for key in live_keys(plan.axis)},
        "states": [state.value for state in State],
    }
