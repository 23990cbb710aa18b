"""Observation of a connection in one cycle of the supervisor, as events of the state machine."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..config.axis import blind_ticks
from ..control import envelope as env
from ..control.reference import MODE_IDLE
from ..drive.cia402 import (
    STATE_QUICK_STOP_ACTIVE,
    has_torque,
    is_operation_enabled,
    state_of,
)
from ..runtime import blocks as b
from ..runtime.tick import in_local_control
from ..workflows.plan import Plan
from .connection import Connection
from .states import StateEvent

RESET_TICKS = 60  # duration of a reset request (requests.FAULT_RESET_TICKS, and the drive's answer)
STANDSTILL_RPS = 0.05
MEASURED_S = (
    0.02  # of which a measured velocity is the mean; at rest it is small twice, or the shaft may just turn back
)
SILENT_S = 0.5  # without an answer to SYNC for this long, at rest, the drive counts as lost

# trips after which the drive is lost, unreachable, or in somebody else's hands; these faults: bring it up again
LOST_TRIPS = frozenset(
    {
        env.TRIP_BUS_OFF,
        env.TRIP_HEARTBEAT,
        env.TRIP_REBOOT,
        env.TRIP_NOT_OPERATIONAL,
        env.TRIP_FEEDBACK_MISSING,
        env.TRIP_STATUS_MISSING,
        env.TRIP_FOREIGN_COMMAND,
        env.TRIP_SETTINGS_CHANGED,
    }
)
GONE = frozenset({"silent", "loop_stalled", *(env.TRIP_NAMES[trip] for trip in LOST_TRIPS)})


class Latched(NamedTuple):
    """Why the axis is in fault."""

    name: str
    text: str
    tick: int


class Shaft(NamedTuple):
    """What the feedback shows."""

    velocity_rps: float
    at_rest: bool


class Trouble(NamedTuple):
    """An event that ends the motion, with a name for programs and a text for people."""

    event: StateEvent
    name: str
    text: str


def silent_ticks(plan: Plan) -> int:
    """Time without an answer after which the drive counts as lost, also at rest, where the envelope does not check."""
    limits, rate_hz = plan.axis.envelope, plan.axis.loop.rate_hz
    return max(blind_ticks(plan.axis), limits.status_missing_ticks, round(SILENT_S * rate_hz))


class Watcher:
    """Observes one connection, cycle by cycle. Times are monotonic seconds."""

    def __init__(self, connection: Connection, silent_ticks: int, stall_s: float, now_s: float) -> None:
        """Without an answer for `silent_ticks` the drive is lost, without a row for `stall_s` the loop."""
        self.connection = connection
        self._silent_ticks = silent_ticks
        self._stall_s = stall_s
        self._head = connection.head
        self._head_s = now_s
        self._stalled_s = 0.0
        self._reset_tick: int | None = None

    @property
    def moving(self) -> bool:
        """Whether the loop's head moved in the last cycles."""
        return self._stalled_s == 0.0

    def reset(self) -> None:
        """A reset was requested: what is latched now is old."""
        self._reset_tick = self.connection.session.status(b.TICK)

    @property
    def resetting(self) -> bool:
        """Whether a reset is in progress."""
        return self._reset_tick is not None

    def look(self, now_s: float) -> Trouble | None:
        """The present problem. `moving`, `reasons` and the rest describe the present state."""
        connection = self.connection
        head = connection.head
        if head != self._head:
            self._head, self._head_s = head, now_s
        self._stalled_s = 0.0 if now_s - self._head_s < self._stall_s else now_s - self._head_s
        if not connection.running:
            return self._ended()
        if self._stalled_s > 0.0:
            return Trouble(StateEvent.LOOP_ENDED, "loop_stalled", f"the loop has not moved for {self._stalled_s:.1f} s")
        tick = connection.session.status(b.TICK)
        if self._reset_tick is not None:
            if tick > self._reset_tick + RESET_TICKS:
                self._reset_tick = None
            elif tick <= self._reset_tick + 1:
                return None
        return self._tripped(connection.trip)

    def _ended(self) -> Trouble:
        if self.connection.session.status(b.ABANDONED):
            text = "the loop stopped the drive and ended: the supervisor was silent (daemon.supervisor_timeout_s)"
            return Trouble(StateEvent.LOOP_ENDED, "abandoned", text)
        error = self.connection.session.error
        return Trouble(
            StateEvent.LOOP_ENDED, "loop_ended", f"the loop's thread ended: {error or 'no error was raised'}"
        )

    def _tripped(self, trip: int) -> Trouble | None:
        if trip != env.TRIP_NONE:
            event = StateEvent.DRIVE_LOST if trip in LOST_TRIPS else StateEvent.TRIPPED
            return Trouble(event, env.TRIP_NAMES[trip], env.TRIP_TEXTS[trip])
        row = self.connection.last_row()
        if row is not None and int(row["velocity_age"]) > self._silent_ticks:
            text = f"no answer to {int(row['velocity_age'])} SYNCs"
            return Trouble(StateEvent.DRIVE_LOST, "silent", text)
        return None

    def obstacles(self, missing_ticks: int, status_ticks: int) -> list[str]:
        """Reasons on the drive's side why it may not be enabled now."""
        row = self.connection.last_row()
        if row is None or self.resetting:
            return ["the loop has just begun" if row is None else "a reset is under way"]
        found = []
        if row["velocity_age"] >= missing_ticks:
            found.append(f"the velocity feedback is {int(row['velocity_age'])} periods old")
        if row["status_age"] >= status_ticks:
            found.append(f"the statusword is {int(row['status_age'])} periods old")
        if not self.connection.clear:
            found.append("the drive is in fault")
        if in_local_control(self.connection.session.config.loop.served_status_bits, int(row["statusword"])):
            found.append(env.TRIP_TEXTS[env.TRIP_LOCAL_CONTROL])
        return found

    def shaft(self, period_s: float) -> Shaft | None:
        """What the feedback shows of the shaft; None while the drive or the loop is silent."""
        rows = self.connection.last_rows(2 * max(1, round(MEASURED_S / period_s)))
        if not (rows and self.connection.running and self.moving) or int(rows[-1]["velocity_age"]) >= len(rows):
            return None
        velocities_rps = np.array([row["velocity_rps"] for row in rows])
        before_rps, now_rps = (float(np.mean(half)) for half in np.array_split(velocities_rps, 2))
        return Shaft(now_rps, max(abs(before_rps), abs(now_rps)) < STANDSTILL_RPS)

    @property
    def torque_on(self) -> bool:
        """Whether the drive is in Operation Enabled."""
        return bool(is_operation_enabled(self.connection.session.status(b.STATUSWORD)))

    @property
    def commanding(self) -> bool:
        """Whether the law acts: Operation Enabled, and the time for the brake to open has passed
        (drive.enable_delay_s).
        """
        return self.connection.session.status(b.MODE) != MODE_IDLE

    @property
    def torque_off(self) -> bool:
        """Whether the drive's power stage is off."""
        return not has_torque(self.connection.session.status(b.STATUSWORD))

    @property
    def holds_after_quick_stop(self) -> bool:
        """Whether the drive is in Quick Stop Active and stays there (0x605A of 5 to 8)."""
        row = self.connection.last_row()
        held = state_of(self.connection.session.status(b.STATUSWORD)) == STATE_QUICK_STOP_ACTIVE
        return row is not None and held and abs(float(row["velocity_rps"])) < STANDSTILL_RPS
