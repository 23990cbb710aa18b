"""What the supervisor asks of the loop: torque or not, a profile, a ramp to standstill. Python side of its blocks."""

from __future__ import annotations

from ..config.plan import Plan
from ..control.reference import MODE_VELOCITY, Profile
from ..drive.cia402 import GOAL_ENABLED
from ..runtime import blocks as b
from ..runtime.session import Session
from .connection import Connection
from .profiles import STOP, braking_ramp

SETTLED_TICKS = 3  # between two profiles handed to the loop: it must have taken the first one


class Motion:
    """Requests to one session, and what became of the profile that was handed over last."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.profile: Profile | None = None
        self._number: int | None = None
        self._handed_tick = 0
        self._brake_pending = False

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

    def hand(self, profile: Profile) -> None:
        """A profile to the loop, which starts it once the drive is enabled."""
        self._number = self._session.start_profile(profile)
        self._handed_tick = self._session.status(b.TICK)
        self.profile = profile

    def drop(self) -> None:
        """The profile ends at once; the law holds zero velocity if there is torque."""
        self._brake_pending = False
        self.profile = None
        if self._number is not None:
            self._session.request(b.PROFILE_ABORT, self._number)
        self._number = None

    def ended(self) -> bool:
        """True once, when the profile has ended."""
        if self._number is None or self._session.status(b.PROFILE_DONE) != self._number:
            return False
        self._number, self.profile = None, None
        return True

    def reset_fault(self) -> None:
        """Clear the latched trip, and the drive's fault."""
        self._session.request(b.RESET_NUMBER, int(self._session.blocks.control[b.RESET_NUMBER]) + 1)

    @property
    def braking(self) -> bool:
        """A ramp to standstill runs, or is about to."""
        return self._brake_pending or (self.profile is not None and self.profile.name == STOP)

    def brake(self) -> None:
        """Brake to standstill, as soon as `brake_when_settled` may do so."""
        self._brake_pending = self._brake_pending or not self.braking

    def brake_when_settled(self, plan: Plan) -> Profile | None:
        """Replace the profile by a ramp, not before the loop has taken the profile. Returns a ramp that begins."""
        if not self._brake_pending or self._session.status(b.TICK) < self._handed_tick + SETTLED_TICKS:
            return None
        self._brake_pending = False
        row = self.connection.last_row()
        velocity_rps = 0.0
        if row is not None:
            follows = int(row["mode"]) == MODE_VELOCITY
            velocity_rps = float(row["reference_rps"] if follows else row["velocity_rps"])
        ramp = braking_ramp(velocity_rps, plan.axis.daemon.stop_rps2, plan.axis.loop.period_s)
        self.hand(ramp)
        return ramp
