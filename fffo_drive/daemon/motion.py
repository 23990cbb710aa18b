"""What the supervisor asks of the loop: torque or not, a profile, set points, standstill. Python side of its blocks."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Floats
from ..config.axis import feedforward_config
from ..control.reference import MODE_VELOCITY, Profile
from ..drive.cia402 import GOAL_ENABLED
from ..runtime import blocks as b
from ..runtime.blocks import NO_PAST
from ..runtime.session import Session
from ..workflows.plan import Plan
from .connection import Connection
from .profiles import STOP, braking_ramp
from .set_points import AskedSetPoint, standstill

SETTLED_TICKS = 3  # between two profiles handed to the loop: it must have taken the first one


class MotionRequests:
    """Requests to one session, and what became of the profile that was handed over last."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.profile: Profile | None = None
        self._number: int | None = None
        self._handed_tick = 0
        self._brake_pending = False
        self.asked: AskedSetPoint | None = None  # the last one, while a motion by set points lasts
        self.set_point_number = 0
        self._reported_lapsed = 0
        self._reported_blocked = False

    @property
    def _session(self) -> Session:
        return self.connection.session

    def ask(self, goal: int) -> None:
        """cia402.GOAL_*."""
        self._session.request(b.GOAL, goal)

    @property
    def wants_torque(self) -> bool:
        """Operation Enabled is asked for."""
        return int(self._session.blocks.control[b.GOAL]) == GOAL_ENABLED

    def hand(self, profile: Profile, past: Floats = NO_PAST) -> None:
        """A profile to the loop, which starts it once the drive is enabled. `past`: see `publish_profile`."""
        self._number = self._session.start_profile(profile, past)
        self._handed_tick = self._session.status(b.TICK)
        self.profile = profile

    def follow(self, asked: AskedSetPoint) -> None:
        """A set point to the loop."""
        before_rps = 0.0 if self.asked is None else self.asked.set_point.target_rps
        if before_rps * asked.set_point.target_rps <= 0.0:  # a jog that is renewed at the edge is no news
            self._reported_blocked = False
        self.set_point_number = self._session.set_point(asked.set_point)
        self.asked = asked

    @property
    def lapsed(self) -> bool:
        """The last set point has held for its time."""
        return self._session.status(b.SET_POINT_LAPSED) == self.set_point_number != 0

    def newly_lapsed(self) -> AskedSetPoint | None:
        """The set point that has just lapsed; once."""
        if self.asked is None or not self.lapsed or self._reported_lapsed == self.set_point_number:
            return None
        self._reported_lapsed = self.set_point_number
        return self.asked

    @property
    def blocked(self) -> bool:
        """Whether the last set point would leave the position window, and was braked before its edge."""
        return self._session.status(b.SET_POINT_BLOCKED) == self.set_point_number != 0

    def newly_blocked(self) -> bool:
        """True once, when the motion has just reached the edge of the window."""
        newly = self.blocked and not self._reported_blocked
        self._reported_blocked = self._reported_blocked or newly
        return newly

    @property
    def target_rps(self) -> float:
        """The present set point; 0 without one."""
        if self.asked is None:
            return 0.0
        set_point = self.asked.set_point
        return set_point.after_rps if self.lapsed else set_point.target_rps

    def there(self, number: int, velocity_rps: float) -> bool:
        """Whether the reference has reached this velocity by this set point, or the motion has ended there."""
        if self.asked is None and self.set_point_number == number:
            return velocity_rps == 0.0
        row = self.connection.last_row()
        return row is not None and int(row["set_point_number"]) == number and row["reference_rps"] == velocity_rps

    def can_renew(self, number: int) -> bool:
        """Whether it is the latest set point, on a lease that has not ended."""
        leased = self.asked is not None and self.asked.leased
        return leased and number == self.set_point_number and not self.lapsed

    def drop(self) -> None:
        """The motion ends at once; the law holds zero velocity if there is torque."""
        if self.asked is not None:
            self._session.request(b.SET_POINT_ABORT, self.set_point_number)
        self.asked = None
        self._brake_pending = False
        self.profile = None
        if self._number is not None:
            self._session.request(b.PROFILE_ABORT, self._number)
        self._number = None

    def ended(self) -> bool:
        """True once, when the profile, or the motion by set points, has ended."""
        if self.asked is not None and self._session.status(b.SET_POINT_DONE) == self.set_point_number:
            self.asked = None
            return True
        if self._number is None or self._session.status(b.PROFILE_DONE) != self._number:
            return False
        self._number, self.profile = None, None
        return True

    def reset_fault(self) -> None:
        """Clear the latched trip, and the drive's fault."""
        self._session.reset_fault()

    @property
    def braking(self) -> bool:
        """Whether the axis is being braked to standstill, or is about to be."""
        if self.asked is not None:
            return self.asked.kind == STOP
        return self._brake_pending or (self.profile is not None and self.profile.name == STOP)

    def brake(self, plan: Plan) -> None:
        """Brake to standstill: a live motion now, a profile as soon as `brake_when_settled` may do so."""
        if self.asked is not None:
            if not self.braking:
                self.follow(standstill(plan))
            return
        self._brake_pending = self._brake_pending or not self.braking

    def brake_when_settled(self, plan: Plan) -> Profile | None:
        """Replace the profile by a ramp, once the loop has taken the profile. Return a ramp that begins."""
        if not self._brake_pending or self._session.status(b.TICK) < self._handed_tick + SETTLED_TICKS:
            return None
        self._brake_pending = False
        controller, period_s = plan.axis.controller, plan.axis.loop.period_s
        feedforward = feedforward_config(controller.feedforward, plan.model, period_s, controller.velocity)
        past = self._velocities_rps(max(1, math.ceil(feedforward.behind_ticks)))
        ramp = braking_ramp(past[-1], plan.axis.daemon.stop_rps2, period_s)
        self.hand(ramp, past)
        return ramp

    def _velocities_rps(self, count: int) -> Floats:
        """Of the last ticks, oldest first: the reference, or the feedback where the loop was open."""
        rows = self.connection.last_rows(count)
        found = [row["reference_rps"] if row["mode"] == MODE_VELOCITY else row["velocity_rps"] for row in rows]
        finite: Floats = np.nan_to_num(np.array(found or [0.0]), posinf=0.0, neginf=0.0)
        return finite
