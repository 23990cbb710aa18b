"""The row of a tick, filled in one place, and its way to other threads."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..control.envelope import EnvelopeInputs
from ..jit import njit
from ..jit.atomic import store_release
from . import blocks as b
from .blocks import Words
from .memory import LawMemory
from .requests import LawInUse, Requests
from .ring import HEAD, Ring
from .tick import Guard, LawOutput, LoopConfig, Sent, Timing


class Target(NamedTuple):
    """Which profile or set point the axis follows."""

    profile_sample: int  # -1: none runs
    profile_number: int
    set_point_sample: int  # -1: no motion by set points runs
    set_point_number: int
    set_point_rps: float


@njit(inline="always")
def write_row(
    ring: Ring, head: int, timing: Timing, config: LoopConfig, law_in_use: LawInUse, asked: Requests, target: Target,
    law: LawOutput, memory: LawMemory, guard: Guard, seen: EnvelopeInputs, feedback: Any, command_a: float,
    limits: int, sent: Sent, flags: int,
) -> Any:  # fmt: skip
    """Fill the next row of the ring. `memory.learned` is what the tick began with."""
    row = ring.rows[head & (ring.rows.size - 1)]
    lateness_ns = timing.woke_ns - timing.deadline_ns
    row["tick"] = timing.tick
    row["row_number"] = head & 0xFFFFFFFF
    row["deadline_ns"] = timing.deadline_ns
    row["lateness_ns"] = lateness_ns
    row["turnaround_ns"] = timing.turnaround_ns
    row["busy_ns"] = sent.busy_ns
    row["late"] = 1 if lateness_ns > config.late_ns else 0

    row["request_number"] = asked.number
    row["toggle"] = asked.toggle
    row["goal"] = asked.goal
    row["effects"] = asked.effects
    row["resetting"] = guard.reset_ticks
    row["parameters_number"] = law_in_use.parameters_number
    row["effects_number"] = law_in_use.effects_number
    row["profile_number"] = target.profile_number
    row["profile_sample"] = target.profile_sample
    row["set_point_number"] = target.set_point_number
    row["set_point_sample"] = target.set_point_sample
    row["set_point_rps"] = target.set_point_rps

    row["mode"] = law.mode
    row["reference_rps"] = law.reference.value
    row["reference_rps2"] = law.reference.derivative
    row["reference_ahead_rps"] = law.reference.ahead
    row["reference_ahead_rps2"] = law.reference.ahead_derivative
    row["expected_rps"] = law.reference.expected
    row["error_rps"] = law.terms.error_rps
    row["filtered_error_rps"] = law.terms.filtered_error_rps
    row["proportional_a"] = law.terms.proportional_a
    row["integral_a"] = law.terms.integral_a
    row["hold_a"] = law.terms.hold_a
    row["friction_nm"] = law.terms.friction_nm
    row["inertia_nm"] = law.terms.inertia_nm
    row["effects_nm"] = law.effects_nm
    row["adapted_nm"] = memory.adapted.torque_nm
    row["adapted_offset_nm"] = memory.learned.offset_nm
    row["adapted_coulomb_nm"] = memory.learned.coulomb_nm
    row["adapted_viscous_nm_per_rps"] = memory.learned.viscous_nm_per_rps
    row["observation_nm_per_s"] = law.terms.observation_nm_per_s
    row["estimated_rps"] = law.estimate.estimated_rps
    row["disturbance_nm"] = law.estimate.disturbance_nm
    row["requested_a"] = law.terms.requested_a

    row["limited_a"] = command_a
    row["limits"] = limits
    row["trip"] = guard.trip
    row["i2t_a2s"] = guard.envelope.i2t_a2s
    row["current_command_a"] = sent.current_a
    row["controlword"] = sent.controlword

    row["velocity_rps"] = seen.velocity_rps
    row["position_rev"] = seen.position_rev
    row["velocity_age"] = seen.feedback_age
    row["status_age"] = seen.status_age
    row["heartbeat_age_ns"] = seen.heartbeat_age_ns
    row["statusword"] = seen.statusword
    row["current_a"] = feedback["current_a"]
    row["true_velocity_rps"] = feedback["true_velocity_rps"]
    row["true_friction_nm"] = feedback["true_friction_nm"]
    row["foreign_id"] = feedback["foreign_id"]
    row["flags"] = flags
    return row


@njit
def publish_tick(ring: Ring, head: int, status: Words, timing: Timing, row: Any) -> None:
    """The row and the status words become visible to other threads."""
    store_release(ring.words, HEAD, head)
    status[b.DEADLINE_NS] = timing.deadline_ns
    status[b.MODE] = row["mode"]
    status[b.TRIP] = row["trip"]
    status[b.STATUSWORD] = row["statusword"]
    status[b.PROFILE_SAMPLE] = row["profile_sample"]
    store_release(status, b.TICK, timing.tick)
