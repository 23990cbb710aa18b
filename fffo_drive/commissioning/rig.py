"""Runs of the loop under one envelope: the same calls in simulated time and on a bus.

Each envelope gets a session of its own, brought up from scratch: limits are not changed under a running loop. The law
has no gains (`open_loop`), so that nothing closes a loop, and the drive is enabled for the length of one profile only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from ..control.envelope import TRIP_NONE, EnvelopeConfig
from ..control.friction_observer import TOGGLE_OFF
from ..control.reference import Profile
from ..drive.cia402 import GOAL_DISABLED, GOAL_ENABLED, has_torque
from ..drive.port import Drive, DriveIdentity, limit_words
from ..recording.ring_reader import RingReader
from ..runtime import blocks as b
from ..runtime.runs import ENABLE_TIMEOUT_S, fault_text
from ..runtime.session import Session, SessionConfig
from .bounds import SlowLoop, open_loop, slow_loop
from .motion import PulseMotion, motion_of

ENABLE_S = 0.5  # simulated time for the way to Operation Enabled
STOP_TIMEOUT_S = 5.0
POLL_S = 0.01
SETTLE_STEP_S = 0.1
SETTLE_TIMEOUT_S = 5.0
SETTLED_REV = 0.002  # in one step
LONGEST_PROFILE_S = 8.0
RING_S = 20.0


class TimeBoundError(Exception):
    """Commissioning has moved the axis for as long as it may."""


class PulseRun(NamedTuple):
    """One profile on the loop."""

    motion: PulseMotion
    trip: int  # envelope.TRIP_*
    enabled: bool  # the drive reached Operation Enabled
    drive_words: str = ""  # what the drive itself said of a fault

    @property
    def fault_text(self) -> str | None:
        """Why the profile did not run to its end; None when it did."""
        return fault_text(self.trip, self.enabled, self.drive_words)


class Rig:
    """A drive and the session to use it with."""

    def __init__(
        self,
        drive: Drive,
        session: SessionConfig,
        longest_s: float,
        tell: Callable[[str], None] = lambda text: None,
        prepare: Callable[[Session], None] = lambda session: None,
    ) -> None:
        """`prepare` gets the first session on a bus, before anything is asked of the drive."""
        self.drive = drive
        self._tell = tell
        self._prepare: Callable[[Session], None] | None = prepare
        self._reported: set[str] = set()
        self.period_s = session.loop.period_ns * 1e-9
        self.identity: DriveIdentity | None = None
        self.motion: PulseMotion | None = None  # the last that was made
        self._left_s = longest_s
        self._controller = session.controller  # of the law that the axis will have
        self._session = session._replace(
            controller=open_loop(session.controller),
            loop=session.loop._replace(tail_ticks=0),
            longest_profile=round(LONGEST_PROFILE_S / self.period_s),
            ring_rows=round(RING_S / self.period_s),
        )

    @contextmanager
    def under(self, envelope: EnvelopeConfig, loop: SlowLoop | None = None) -> Iterator[Runner]:
        """Bring the drive up and let the loop run with this envelope; at the end the drive is left without torque.

        `loop`: closed around a profile of velocity; None: no loop is closed.
        """
        self.identity = self.drive.connect()
        self.pass_on(limit_words(self._controller.current_limit_a, self.drive.current_limit))
        settings = self._session._replace(envelope=envelope)
        if loop is not None:
            settings = settings._replace(controller=slow_loop(self._controller, loop, envelope.current_limit_a))
        with Session(self.drive, settings) as session:
            session.request(b.TOGGLE, TOGGLE_OFF)
            if self.drive.realtime:
                for refusal in set(session.start().refusals) - self._reported:
                    self._reported.add(refusal)
                    self._tell(f"without real-time properties: {refusal}")
                if self._prepare is not None:
                    self._prepare(session)
                    self._prepare = None
            yield Runner(session, self)

    def pass_on(self, warnings: list[str]) -> None:
        """Tell what the drive warns of, each thing once."""
        for text in warnings:
            if text not in self._reported:
                self._reported.add(text)
                self._tell(text)

    def take_time(self, duration_s: float) -> None:
        """Count time in which the axis may move. Raises TimeBoundError."""
        self._left_s -= duration_s
        if self._left_s < 0.0:
            raise TimeBoundError


class Runner:
    """Profiles on one session."""

    def __init__(self, session: Session, rig: Rig) -> None:
        self.session = session
        self._rig = rig
        self._reader = RingReader(session.ring)
        self._delay_s = session.config.loop.enable_delay_s
        self._statusword = 0  # when the last profile ended, before the drive was disabled

    @property
    def realtime(self) -> bool:
        """The clock is the wall's."""
        return self.session.drive.realtime

    def listen(self, duration_s: float) -> PulseMotion:
        """SYNC and feedback, no voltage."""
        return self._collect(lambda: self._pass(duration_s))

    def run(self, profile: Profile, watch_s: float = 0.0, meanwhile: Callable[[], None] | None = None) -> PulseRun:
        """Enable, run the profile, watch for `watch_s` what follows (after a trip as well), disable, wait for rest.

        `meanwhile` is called again and again while the profile runs, on a bus only.
        """
        self._rig.take_time(profile.duration_s)
        motion = self._collect(lambda: self._act(profile, watch_s, meanwhile))
        tripped = motion.trip[motion.trip != TRIP_NONE]
        enabled = bool(motion.enabled.any())
        words = self.session.drive.fault_words(self._statusword) if tripped.size or not enabled else ""
        self._rig.pass_on(self.session.warnings())
        return PulseRun(motion, int(tripped[0]) if tripped.size else TRIP_NONE, enabled, words)

    def _act(self, profile: Profile, watch_s: float, meanwhile: Callable[[], None] | None) -> None:
        self._profile(profile, watch_s, meanwhile)
        self._settle()

    def _settle(self) -> None:
        """No voltage, until the axis stands or `SETTLE_TIMEOUT_S` has passed."""
        feedback = self.session.drive.port.feedback[0]
        last_rev = float(feedback["position_rev"])
        for _ in range(round(SETTLE_TIMEOUT_S / SETTLE_STEP_S)):
            self._pass(SETTLE_STEP_S)
            position_rev = float(feedback["position_rev"])
            if abs(position_rev - last_rev) < SETTLED_REV:
                return
            last_rev = position_rev

    def _collect(self, act: Callable[[], None]) -> PulseMotion:
        """All rows that come about while `act` runs."""
        self._reader.read()
        act()
        self._rig.motion = motion = motion_of(self._reader.read().rows)
        return motion

    def _pass(self, duration_s: float) -> None:
        if self.realtime:
            time.sleep(duration_s)
        else:
            self.session.run_ticks(round(duration_s / self._rig.period_s))

    def _profile(self, profile: Profile, watch_s: float, meanwhile: Callable[[], None] | None) -> None:
        session = self.session
        number = session.start_profile(profile)
        session.request(b.GOAL, GOAL_ENABLED)
        try:
            if self.realtime:
                self._follow(number, meanwhile)
                time.sleep(watch_s)
            else:
                self._pass(ENABLE_S + self._delay_s + profile.duration_s + watch_s)
        finally:
            self._statusword = session.stop_statusword
            session.request(b.GOAL, GOAL_DISABLED)
            session.request(b.PROFILE_ABORT, number)
        if self.realtime:
            self._until(lambda: not has_torque(session.status(b.STATUSWORD)), STOP_TIMEOUT_S)
        else:
            self._pass(10 * self._rig.period_s)

    def _follow(self, number: int, meanwhile: Callable[[], None] | None) -> None:
        session = self.session

        def over() -> bool:
            return session.status(b.PROFILE_DONE) == number or session.status(b.TRIP) != TRIP_NONE

        self._until(lambda: over() or session.status(b.PROFILE_SAMPLE) >= 0, ENABLE_TIMEOUT_S + self._delay_s)
        while session.running and not over() and session.status(b.PROFILE_SAMPLE) >= 0:
            if meanwhile is not None:
                meanwhile()
            time.sleep(POLL_S)

    def _until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """Wait, but not for ever: what has not come about shows in the rows."""
        deadline_s = time.monotonic() + timeout_s
        while self.session.running and not condition() and time.monotonic() < deadline_s:
            time.sleep(POLL_S)


def position_at_rest(motion: PulseMotion) -> float:
    """Median of the position, rev."""
    return float(np.median(motion.position_rev)) if motion.size else float("nan")
