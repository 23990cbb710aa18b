"""How far an axis can run away within the tolerances of its file, before any limit of the envelope can act.

Without velocity feedback the envelope sees no speed. For `feedback_missing_ticks` periods the law acts on the last
feedback, and may command up to `current_limit_a`; the axis then gains

    dw = T Kt i / J,    T = feedback_missing_ticks / rate,    and turns by T dw / 2 farther than at a constant speed.

With a range of inertia J is the least.

It may have turned at the speed limit before. A machine must stand 1.2 times its highest speed (IEC 60034-1, overspeed),
so dw may be at most a fifth of `speed_limit_rps`. The other tolerances are not blind: while a statusword or a heartbeat
is late, while the velocity error is too large for less than `following_error_s`, and while the supervisor is silent,
the feedback is there, and the speed limit acts. The axis's own delay comes on top, with any tolerance: the speed that
trips is as old as that, and so is the torque that goes.
"""

from __future__ import annotations

from typing import NamedTuple

from ..control.stability import over_loads
from ..model.parameters import ModelFile
from .axis import AxisFile, blind_ticks, loop_axis
from .drive_section import CanopenDriveSection

OVERSPEED_SHARE = 0.2  # of the speed limit, that may be gained without feedback: IEC 60034-1 tests at 1.2


class Runaway(NamedTuple):
    """The worst case, without friction."""

    ticks: int
    blind_s: float
    acceleration_rps2: float  # at envelope.current_limit_a
    gained_rps: float
    gained_rev: float  # beyond the way at the speed before
    delay_rps: float  # what the axis's delay adds to any trip
    limit_rps: float

    @property
    def allowed(self) -> bool:
        """Whether the overspeed stays inside what a machine must stand."""
        return self.gained_rps <= OVERSPEED_SHARE * self.limit_rps


def runaway_of(axis: AxisFile, model: ModelFile) -> Runaway:
    """Of this file, on this model."""
    limits, believed = axis.envelope, model.axis_config()
    least = over_loads(loop_axis(axis, model))[0].inertia_nm_s2_per_rev
    acceleration_rps2 = limits.current_limit_a * believed.torque_constant_nm_per_a / least
    ticks = blind_ticks(axis)
    blind_s = ticks * axis.loop.period_s
    gained_rps = acceleration_rps2 * blind_s
    return Runaway(
        ticks,
        blind_s,
        acceleration_rps2,
        gained_rps,
        0.5 * gained_rps * blind_s,
        acceleration_rps2 * believed.delay_s,
        limits.speed_limit_rps,
    )


def most_ticks(limit_rps: float, acceleration_rps2: float, rate_hz: float) -> int:
    """Ticks without feedback that are safe; 0 where even one is too long."""
    return int(OVERSPEED_SHARE * limit_rps * rate_hz / acceleration_rps2)


def fewer_ticks(axis: AxisFile, model: ModelFile) -> int | None:
    """For `feedback_missing_ticks`, where the file's own are not safe and fewer are; None: it stays."""
    found = runaway_of(axis, model)
    if found.allowed or axis.envelope.accept_runaway:
        return None
    return most_ticks(found.limit_rps, found.acceleration_rps2, axis.loop.rate_hz) or None


def most_current_a(limit_rps: float, rps2_per_a: float, rate_hz: float) -> float:
    """The current with which one tick is safe."""
    return OVERSPEED_SHARE * limit_rps * rate_hz / rps2_per_a


def runaway_problems(axis: AxisFile, model: ModelFile) -> list[str]:
    """What of the tolerances is not safe, unless the file accepts it by name."""
    found = runaway_of(axis, model)
    if found.allowed or axis.envelope.accept_runaway:
        return []
    most = most_ticks(found.limit_rps, found.acceleration_rps2, axis.loop.rate_hz)
    fewer = f"at most {_counted(most)}, or " if most else ""
    return [
        f"envelope.feedback_missing_ticks: {_gain(found)}, more than {OVERSPEED_SHARE:.0%} of speed_limit_rps "
        f"{found.limit_rps:g}: {fewer}a lower current_limit_a, or accept it by envelope.accept_runaway: true, "
        "which is reported each time"
    ]


def accepted_words(axis: AxisFile, model: ModelFile) -> list[str]:
    """What the file accepts by name and would be refused otherwise, for every start."""
    found = runaway_of(axis, model)
    if found.allowed or not axis.envelope.accept_runaway:
        return []
    return [f"accepted by envelope.accept_runaway: {_gain(found)}; speed_limit_rps is {found.limit_rps:g}"]


def runaway_lines(axis: AxisFile, model: ModelFile) -> list[str]:
    """The figures, for `config check`."""
    found = runaway_of(axis, model)
    lines = [
        f"without feedback: {_gain(found)}, {found.gained_rps / found.limit_rps:.0%} of speed_limit_rps; the delay of "
        f"the axis adds up to {found.delay_rps:.3g} rps to every trip"
    ]
    section = axis.drive
    if isinstance(section, CanopenDriveSection) and section.command_timeout_ms:
        held_s = section.command_timeout_ms / 1e3
        lines.append(
            f"without this PC: the drive holds its last command for {section.command_timeout_ms} ms "
            f"(drive.command_timeout_ms): {found.acceleration_rps2 * held_s:.3g} rps if that was current_limit_a"
        )
    return lines


def _gain(found: Runaway) -> str:
    return (
        f"blind for at most {_counted(found.ticks)} = {found.blind_s * 1e3:g} ms: {found.gained_rps:.3g} rps and "
        f"{found.gained_rev:.2g} rev at current_limit_a"
    )


def _counted(ticks: int) -> str:
    return "1 tick" if ticks == 1 else f"{ticks} ticks"
