"""Owns the drive, the loop and the recorder, and moves them by the table of `daemon.states`.

It runs in one thread on one asyncio loop. `turn` checks the real-time loop 25 times a second; operations that wait for
the bus or the disk (bring-up, release, files) run on other threads and are awaited. Nothing here affects the tick:
requests reach the loop through its blocks, and its state is read from its status words and rows.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from pathlib import Path

from ..can.link import LinkError
from ..config.axis import blind_ticks, controller_config, model_note
from ..config.commissioning import Permission, permission, require_identity
from ..config.effects import compensation_table
from ..control.reference import Profile
from ..documents import DocumentError
from ..drive.cia402 import GOAL_DISABLED, GOAL_ENABLED, GOAL_QUICK_STOP
from ..drive.port import Drive, DriveError, DriveRefusedError
from ..model.parameters import content_hash
from ..recording.events import Level
from ..runtime import blocks as b
from ..runtime.adaptation_watch import BoundWatch
from ..runtime.runs import NOT_ENABLED, with_words
from ..runtime.session import LoopHungError
from ..workflows.plan import Plan, open_drive
from .connection import Connection, bring_up, leave
from .effects_watch import EffectsWatch
from .event_log import EventLog
from .journal import Journal
from .motion import MotionRequests
from .record_keeper import RecordKeeper, Sources
from .set_points import AskedSetPoint, longest_stop_s
from .states import AT_REST, TORQUE_STATES, WANTING_TORQUE, Action, Machine, RefusedError, State, StateEvent
from .watch import GONE, LOST_TRIPS, Latched, Shaft, Trouble, Watcher, silent_ticks
from .worker import DiskSilentError, Worker

TURN_S = 0.04
MAX_SPEED_FACTOR = 1.5  # of the speed limit: the longest ramp begins there
NEVER_S = float("inf")
# the service's end, within five seconds in all
ORDERLY_STOP_S = 2.0  # for a controlled stop; then a quick stop
QUICK_STOP_S = 1.0
HEARING_S = 2.0  # how long a client waits for the drive's fault description
CLOSE_S = 1.5  # for releasing the drive and closing the recording


class Supervisor:
    """One axis. `run` runs until `close`; the methods are called from its loop only."""

    def __init__(
        self, plan: Plan, journal: Journal, bus: str | None = None, uncommissioned: bool = False,
        recordings: Path | None = None, clock: Callable[[], float] = time.monotonic, sources: Sources | None = None,
        wall_clock: Callable[[], float] = time.time,
    ) -> None:  # fmt: skip
        self.plan = plan
        self.model_hash = content_hash(plan.model)
        self.sources = sources or Sources(plan)
        self.toggle = plan.toggle
        self.log = EventLog(journal, self._context)
        self.recorder = RecordKeeper(self.log, recordings, clock)
        self.effects = EffectsWatch(plan, self.log)
        self.log.listeners.append(self.recorder.tell)
        self.machine = Machine(wall_clock)
        self.changed: Callable[[], None] = lambda: None  # called after each step of the state machine
        self.bus_work = Worker("fffo-bus")
        self.files = Worker("fffo-files", self.log.tell_disk)
        self.since_s = clock()
        self.fault: Latched | None = None
        self.obstacles: list[str] = ["not connected yet"]
        self.connection: Connection | None = None
        self.motion: MotionRequests | None = None
        self.not_enabled = ""  # why the last attempt did not reach Operation Enabled
        self.fatal: BaseException | None = None
        self._bus, self._uncommissioned, self._clock = bus, uncommissioned, clock
        self._given: Permission | str = ""  # by the commissioning record, or why nothing is
        self._permission: Permission | None = None  # ... and for the connected drive
        self._watcher: Watcher | None = None
        self._bounds = BoundWatch()
        self._to_leave: Connection | None = None
        self._wake = asyncio.Event()
        self._hearing: asyncio.Future[None] | None = None
        self._lived = asyncio.Event()  # `run` has ended, or has not begun
        self._lived.set()
        self._connections = 0
        self._unread = False  # the disk did not answer when the drive was to be brought up
        self._closing = False
        self._next_profile: Profile | None = None
        self._next_set_point: AskedSetPoint | None = None
        self._set_point_by = "nobody"  # who asked for the last one
        self._deadline_s = NEVER_S
        self._torque_seen = False
        self._quick = False
        self._said = ""  # the last reason for a missing drive, reported once
        self._forbidding = ""
        self._unrecorded = False  # what should be recorded is not; reported once

    # -- the state machine -----------------------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """Where the axis is."""
        return self.machine.state

    def apply(self, event: StateEvent, asked_in: int | None = None, who: str = "", what: str = "") -> bool:
        """Take the transition of the table. False if there is none. Raises RefusedError for a request not possible now.

        The rest as in `Machine.take`.
        """
        before = self.state
        row = self.machine.take(event, asked_in, who, what)
        if row is None:
            return False
        now_s = self._clock()
        if row.to is not before:
            self.since_s = now_s
        for action in row.actions:
            self._act(action, now_s)
        if row.to is not before:
            self._tell_state(before, event)
        self.changed()
        return True

    def _act(self, action: Action, now_s: float) -> None:
        if action is Action.RELEASE:
            self.fault = None
            self._to_leave, self.connection = self.connection, None
            self.effects.attach(None)
            self._watcher = self.motion = None
            self._wake.set()
            return
        motion = self.motion
        if motion is None:
            return
        timeouts = self.plan.axis.daemon
        if action is Action.ENABLE:
            self._torque_seen, self.not_enabled = False, ""
            self._deadline_s = now_s + timeouts.enable_timeout_s
            motion.ask(GOAL_ENABLED)
        elif action is Action.START:
            assert self._next_profile is not None
            motion.hand(self._next_profile)
        elif action is Action.FOLLOW:
            assert self._next_set_point is not None
            motion.follow(self._next_set_point)
        elif action is Action.BRAKE:
            self._brake(motion, now_s)
        elif action is Action.CLEAR:
            self.fault = None
            if self._watcher is not None:
                self._watcher.reset()
            motion.reset_fault()
        else:
            again = self._quick and action is Action.QUICK_STOP
            self._quick = action is Action.QUICK_STOP
            if not again:  # asked for once more, a quick stop has no more time than it had
                self._deadline_s = NEVER_S if action is Action.FORGET else now_s + timeouts.stop_timeout_s
            motion.drop()
            motion.ask(GOAL_QUICK_STOP if self._quick else GOAL_DISABLED)

    def _brake(self, motion: MotionRequests, now_s: float) -> None:
        """Brake to standstill under control; without torque there is nothing to brake."""
        if self._torque_seen and self._watcher is not None and self._watcher.commanding:
            motion.brake(self.plan)
            motion.brake_when_settled(self.plan)
            self._quick = False
            if self.state is State.STOPPING:
                longest_s = longest_stop_s(self.plan, MAX_SPEED_FACTOR * self.plan.axis.envelope.speed_limit_rps)
                self._deadline_s = now_s + longest_s + self.plan.axis.loop.tail_s + self.plan.axis.daemon.stop_timeout_s
        elif self.state is State.STOPPING:
            self._act(Action.DISABLE, now_s)
        else:
            motion.drop()
            self.apply(StateEvent.PROFILE_ENDED)

    # -- observation -----------------------------------------------------------------------------------------------

    def turn(self) -> None:
        """One cycle of supervision."""
        now_s = self._clock()
        if self.connection is not None and self._watcher is not None:
            self.connection.beat()
            for text in self.connection.session.warnings():
                self.log.add("drive", text, Level.WARNING)
            reached = self._bounds.news(self.connection.session.status(b.ADAPTED_TO_BOUND))
            if reached is not None:
                self.log.add("adaptation", reached, Level.WARNING)
            trouble = self._watcher.look(now_s)
            if trouble is not None:
                self._meet(trouble)
            else:
                self._follow(now_s)
        self._watch_deadline(now_s)
        self._watch_recording()
        self.effects.look(now_s)
        self.log.turn()

    def _meet(self, trouble: Trouble) -> None:
        """Handle an event that ended the motion."""
        if self.state in (State.FAULT, State.OFFLINE):
            return
        latches = trouble.event is not StateEvent.DRIVE_LOST or self.state in TORQUE_STATES
        statusword = None if self.connection is None else self.connection.session.stop_statusword
        text = self._heard(trouble.text, statusword)
        if latches:
            tick = -1 if self.connection is None else self.connection.last_tick
            self.fault = Latched(trouble.name, text, tick)
        self._said = text
        self.obstacles = [text]
        if trouble.event is StateEvent.TRIPPED or (latches and trouble.event is StateEvent.DRIVE_LOST):
            self._hear_out(trouble.text, statusword)
        self.apply(trouble.event, who=f"{'a fault' if latches else 'the loss of the drive'}: {trouble.name}")

    def _heard(self, text: str, statusword: int | None) -> str:
        """A reason, with the messages that the drive has sent by itself."""
        words = self.connection.drive.fault_words(statusword, ask=False) if self.connection is not None else ""
        return with_words(text, words)

    def _hear_out(self, text: str, statusword: int | None) -> None:
        """Read the drive's further fault objects, on the bus's thread, for log and fault."""
        if self.connection is not None and not self._closing:
            self._hearing = asyncio.ensure_future(self._ask_drive(self.connection, text, self.fault, statusword))

    async def _ask_drive(
        self, connection: Connection, text: str, fault: Latched | None, statusword: int | None
    ) -> None:
        words = await self.bus_work.run(connection.drive.fault_words, statusword)
        if not words:
            return
        if fault is None:
            self.not_enabled = with_words(text, words)
        elif self.fault is fault:
            self.fault = fault._replace(text=with_words(text, words))
        self.log.add("drive", f"the drive says: {words}", Level.ERROR)
        self.changed()

    async def heard_out(self) -> None:
        """Wait, for a bounded time, while the drive's fault objects are being read."""
        if self._hearing is not None:
            await asyncio.wait({self._hearing}, timeout=HEARING_S)

    def _follow(self, now_s: float) -> None:
        """Whether the loop runs without a fault."""
        watcher, motion = self._watcher, self.motion
        assert watcher is not None
        assert motion is not None
        self._look_for_obstacles()
        if self.state in TORQUE_STATES and watcher.torque_on:
            if not self._torque_seen and self.state is not State.STOPPING:
                self._deadline_s = NEVER_S
            self._torque_seen = True
        motion.brake_when_settled(self.plan)
        self._look_for_lapse(motion)
        if motion.newly_blocked():
            text = "the set point leads out of envelope.position_window_rev: braked before its edge"
            self.log.add("set_point", text, Level.WARNING)
        if motion.ended():
            self.apply(StateEvent.PROFILE_ENDED)
        if self.state is State.STOPPING and not motion.wants_torque:
            if self._quick and watcher.holds_after_quick_stop:
                motion.ask(GOAL_DISABLED)
            if watcher.torque_off:
                self.apply(StateEvent.TORQUE_OFF)

    def _look_for_lapse(self, motion: MotionRequests) -> None:
        """Whether a set point was not renewed in time, which is as good as a stop by its client."""
        lapsed = motion.newly_lapsed()
        if lapsed is None or not lapsed.leased:
            return
        what = f"{lapsed.kind} of {self._set_point_by} that was not renewed within"
        timeout_s = lapsed.set_point.hold_ticks * self.plan.axis.loop.period_s
        text = f"the {what} {timeout_s:g} s (daemon.set_points.jog_timeout_s): braked"
        self.log.add("set_point", text, Level.WARNING)
        self.apply(StateEvent.LAPSED, who=f"a {what} {timeout_s:g} s")

    def _look_for_obstacles(self) -> None:
        """Whether the axis may be enabled."""
        if self.state not in (State.CONNECTED, State.READY) or self._watcher is None:
            return
        limits = self.plan.axis.envelope
        self.obstacles = self._forbidden() + self._watcher.obstacles(
            blind_ticks(self.plan.axis), limits.status_missing_ticks
        )
        self.apply(StateEvent.FORBIDDEN if self.obstacles else StateEvent.PERMITTED)

    def _forbidden(self) -> list[str]:
        """Why commissioning or recording does not permit the axis to be enabled."""
        found = [] if self._permission is not None else [self._forbidding]
        if self.plan.axis.daemon.record_required and (failure := self.recorder.failure()):
            found.append(f"daemon.record_required: {failure}")
        return found

    def read_permission(self, plan: Plan) -> Permission | str:
        """What the commissioning record of a plan gives, or why nothing. It waits for the disk: for another thread."""
        try:
            return permission(plan.path, plan.axis, plan.model, self._uncommissioned)
        except DocumentError as error:
            return str(error)

    def permit(self, given: Permission | str) -> None:
        """Take what was read, and compare it with the connected drive."""
        self._given, self._permission = given, None
        if self.connection is None:
            return
        if isinstance(given, str):
            self._forbidding = given
            return
        try:
            require_identity(given, self.connection.identity)
            self._permission = given
        except DriveRefusedError as error:
            self._forbidding = str(error)

    def _watch_deadline(self, now_s: float) -> None:
        if now_s < self._deadline_s:
            return
        self._deadline_s = NEVER_S
        if self.state in WANTING_TORQUE:
            statusword = None if self.connection is None else self.connection.session.stop_statusword
            self.not_enabled = self._heard(NOT_ENABLED, statusword)
            self.log.add("state", self.not_enabled, Level.ERROR)
            self._hear_out(NOT_ENABLED, statusword)
            self.apply(StateEvent.ENABLE_TIMEOUT)
        elif self.state is State.STOPPING and not self._quick:
            self.log.add("state", "the controlled stop takes too long: quick stop", Level.ERROR)
            self.apply(StateEvent.STOP_TIMEOUT)
        elif self.state is State.STOPPING:
            self.fault = Latched("stop_failed", "the drive keeps its torque after a quick stop", -1)
            self.apply(StateEvent.STOP_FAILED)

    def _watch_recording(self) -> None:
        if self.recorder.busy:  # a file is being opened or closed
            return
        failure, before = self.recorder.failure(), self._unrecorded
        self._unrecorded = bool(failure)
        if failure and not before:
            self.log.add("recording", f"recording: {failure}", Level.ERROR)
        if failure and self.plan.axis.daemon.record_required and self.state in WANTING_TORQUE:
            self.log.add("recording", "daemon.record_required: the axis is stopped", Level.ERROR)
            self.apply(StateEvent.DISABLE, who="daemon.record_required")

    @property
    def consistent(self) -> bool:
        """Condition for feeding the watchdog: the loop's head moves, and state, loop and requests are consistent."""
        if self.connection is None or self._watcher is None:
            return self.state in (State.OFFLINE, State.FAULT)
        if self.motion is None or (self.motion.wants_torque and self.state not in TORQUE_STATES):
            return False
        if not self.connection.running:
            return self.state is State.FAULT
        return self.state is not State.OFFLINE and self._watcher.moving

    # -- requests --------------------------------------------------------------------------------------------------

    def reset_fault(self, who: str) -> None:
        """Leave a fault: in place if the drive answers, else by bringing it up again."""
        connection = self.connection
        away = connection is None or not connection.running or connection.trip in LOST_TRIPS
        lost = self.fault is not None and self.fault.name in GONE
        self.apply(StateEvent.RESET_AWAY if away or lost else StateEvent.RESET, who=who)

    def begin_start(self, asked_in: int | None) -> int:
        """Begin to prepare a profile. Return the epoch to which the start is bound. Raises RefusedError."""
        self.apply(StateEvent.START, asked_in)
        return self.machine.epoch.value

    def start(self, profile: Profile, epoch: int) -> None:
        """Run a prepared profile. Raises RefusedError, or ValueError if it is too long for the loop."""
        if self.connection is not None and profile.values.size > self.connection.session.config.longest_profile:
            raise ValueError(f"profile '{profile.name}' is longer than loop.longest_profile_s")
        self._next_profile = profile
        self.apply(StateEvent.PREPARED, epoch)

    def require_renewable(self, kind: str, number: int | None, asked_in: int | None) -> None:
        """Raise RefusedError, with what ended it, where a request renews a set point that is over."""
        if self.motion is not None:
            self._look_for_lapse(self.motion)  # what has lapsed since the last turn ends the epoch now
        self.machine.require_epoch(StateEvent.SET_POINT, asked_in, kind)
        if number is not None and (self.motion is None or not self.motion.can_renew(number)):
            text = f"{kind}: set point {number} is over: another one, by {self._set_point_by}, came after it"
            raise RefusedError(text, self.state, ())

    def follow(self, asked: AskedSetPoint, asked_in: int | None, who: str) -> MotionRequests:
        """Follow a live set point of `who` from now on. Raises RefusedError."""
        acts = self._watcher is not None and self._watcher.commanding
        if self.state is State.ENABLED and not acts:
            text = "the axis has no torque yet: wait for enable to answer, and for the brake (drive.enable_delay_s)"
            raise RefusedError(text, self.state, (State.ENABLED, State.FOLLOWING))
        self._next_set_point = asked
        self.apply(StateEvent.SET_POINT, asked_in, what=asked.kind)
        self._set_point_by = who
        assert self.motion is not None
        return self.motion

    def start_failed(self, epoch: int) -> None:
        """A profile could not be prepared; no effect if a stop or a fault has already ended the start."""
        with contextlib.suppress(RefusedError):
            self.apply(StateEvent.NOT_PREPARED, epoch)

    @property
    def profile(self) -> Profile | None:
        """The profile that runs."""
        return None if self.motion is None else self.motion.profile

    @property
    def has_torque(self) -> bool:
        """Whether torque was requested and is on."""
        return self.state in WANTING_TORQUE and self._torque_seen

    @property
    def shaft(self) -> Shaft | None:
        """What the feedback shows of the shaft; None where nothing is measured."""
        return None if self._watcher is None else self._watcher.shaft(self.plan.axis.loop.period_s)

    def set_plan(self, plan: Plan) -> None:
        """Change gains, model and other settings without a new loop; the loop takes the law at a tick boundary."""
        before, self.plan = self.plan, plan
        self.model_hash = content_hash(plan.model)
        if self.connection is not None:
            if plan.model is not before.model:
                self.connection.session.set_model(model_note(plan.model))
            self.connection.session.set_controller(controller_config(plan.axis, plan.model))
            self.connection.session.set_effects(compensation_table(plan.axis, plan.model))
        if plan.model is not before.model or plan.axis.controller.effects != before.axis.controller.effects:
            self.effects.begin(plan)

    def set_toggle(self, toggle: int) -> None:
        """Switch the friction term: from the reference, from the feedback, or off."""
        self.toggle = toggle
        if self.connection is not None:
            self.connection.session.request(b.TOGGLE, toggle)

    async def reached(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition, checked in each cycle. False if it was not met in time."""
        deadline_s = self._clock() + timeout_s
        while not condition():
            if self._clock() > deadline_s or self.fatal is not None:
                return False
            await asyncio.sleep(TURN_S)
        return True

    async def start_recording(self) -> str:
        """Begin a file now, or with the next connection. Raises OSError."""
        note = self._permission.note if self._permission is not None else "none"
        path = await self.recorder.begin(self.plan, self.connection, self.sources, self.toggle, note)
        self._look_for_obstacles()  # before the answer: an enable may follow it at once
        return path

    # -- life cycle ------------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Keep the drive connected until `close`. Errors not due to the drive end it: see `fatal`."""
        self._lived.clear()
        try:
            while not self._closing and self.fatal is None:
                await self._leave_old()
                if self.state is State.OFFLINE and self.connection is None:
                    await self._try_to_connect()
                if not self._closing and self._to_leave is None:
                    timeout_s = self.plan.axis.daemon.retry_s if self.connection is None else None
                    await self._sleep(timeout_s)
        except Exception as error:
            self.fatal = error
        finally:
            self._lived.set()

    async def _sleep(self, timeout_s: float | None) -> None:
        try:
            await asyncio.wait_for(self._wake.wait(), timeout_s)
        except TimeoutError:
            return
        self._wake.clear()

    async def _leave_old(self) -> None:
        old, self._to_leave = self._to_leave, None
        if old is not None:
            self.fatal = await self._leave(old)

    async def _leave(self, connection: Connection) -> LoopHungError | None:
        """The bus first: torque and SYNC end whatever the state of the disk."""
        leaving = asyncio.ensure_future(self.bus_work.run(leave, connection))
        with contextlib.suppress(DiskSilentError):  # it was told
            await self.recorder.end()
        return await leaving

    async def _try_to_connect(self) -> None:
        plan = self.plan
        if not self._said:
            self.obstacles = ["connecting; the very first time compiles the loop"]
        given_before = self._given
        try:
            if self._unread and self.files.silent:  # each attempt would leave a thread behind; a reload makes one
                raise DiskSilentError(self.files.silent)
            # once the loop runs, no disk may keep the supervisor waiting
            given, drive = await self.files.run(self._read_for, plan, doing="reading", at=plan.path)
            connection = await self.bus_work.run(self._bring_up, plan, drive)
        except (DriveError, LinkError, DiskSilentError) as error:
            self._unread = isinstance(error, DiskSilentError)
            self.obstacles = [str(error)]
            if str(error) != self._said:  # once, not at each attempt
                self._said = str(error)
                self.log.add("drive", f"no drive: {error}", Level.WARNING)
            return
        if connection is None:
            return
        self._said, self._unread = "", False
        self._connections += 1
        self.connection = connection
        now_s = self._clock()
        self.motion = MotionRequests(connection)
        self._watcher = Watcher(connection, silent_ticks(plan), plan.axis.daemon.supervisor_timeout_s, now_s)
        connection.session.request(b.TOGGLE, self.toggle)
        if self.plan.model is not plan.model:  # changed while the drive was brought up
            connection.session.set_model(model_note(self.plan.model))
        connection.session.set_controller(controller_config(self.plan.axis, self.plan.model))
        connection.session.set_effects(compensation_table(self.plan.axis, self.plan.model))
        self.effects.attach(connection)
        for refusal in connection.realtime.refusals:
            self.log.add("drive", f"without real-time properties: {refusal}", Level.WARNING)
        identity = connection.identity
        self.log.add("drive", f"connected to {identity.device_name}", data=identity._asdict())
        self.permit(given if self._given is given_before else self._given)  # a reload meanwhile has read it again
        self.apply(StateEvent.FOUND)
        if self.recorder.wanted:
            with contextlib.suppress(OSError):  # the next turn reports it
                await self.start_recording()

    def _read_for(self, plan: Plan) -> tuple[Permission | str, Drive]:
        """All that bring-up reads from files."""
        return self.read_permission(plan), open_drive(plan, self._bus)

    def _bring_up(self, plan: Plan, drive: Drive) -> Connection | None:
        """On the bus's thread. No connection if the service ended meanwhile; the drive is then released again."""
        connection = bring_up(plan, self._connections + 1, drive)
        if not self._closing:
            return connection
        leave(connection)
        return None

    async def stop_in_order(self) -> None:
        """Brake, disable, and wait until the power stage is off: controlled stop, then quick stop, each for a bounded
        time.
        """
        self.apply(StateEvent.DISABLE, who="the end of the service")
        if not await self.reached(lambda: self.state in AT_REST, ORDERLY_STOP_S):
            self.log.add("stopping", f"not at rest within {ORDERLY_STOP_S:g} s: quick stop", Level.WARNING)
            self.apply(StateEvent.QUICK_STOP, who="the end of the service")
            await self.reached(lambda: self.state in AT_REST, QUICK_STOP_S)

    async def close(self) -> None:
        """Leave the axis without torque, the bus without traffic, the recording complete, within CLOSE_S."""
        self._closing = True
        self._wake.set()
        try:
            await asyncio.wait_for(self._leave_for_good(), CLOSE_S)
        except TimeoutError:
            waits = "the disk" if self.recorder.busy else "the bus"
            self.log.add("stopping", f"{waits} does not answer within {CLOSE_S:g} s: ended without it", Level.ERROR)
        self.machine.state = State.OFFLINE
        self.machine.epoch.advance()

    async def _leave_for_good(self) -> None:
        connection, self.connection = self.connection or self._to_leave, None
        self._to_leave = self._watcher = self.motion = None
        if connection is not None:
            self.fatal = await self._leave(connection) or self.fatal
        await self._lived.wait()

    # -- status ----------------------------------------------------------------------------------------------------

    def _context(self) -> dict[str, str]:
        fault = {"fault": self.fault.name} if self.fault is not None else {}
        return {"axis": self.plan.axis.name, "state": self.state.value, **fault}

    def _tell_state(self, before: State, event: StateEvent) -> None:
        data = {"from": before.value, "to": self.state.value, "event": event.value}
        if self.state is State.FAULT and self.fault is not None:
            self.log.add("fault", f"fault: {self.fault.text}", Level.ERROR, {**data, **self.fault._asdict()})
            return
        reason = ""
        if self.state is State.CONNECTED and self.obstacles and before is State.READY:
            reason = f": {self.obstacles[0]}"
        if self.state is State.OFFLINE:
            reason = f": {self._said}" if self._said else ""
        level = Level.WARNING if self.state is State.OFFLINE else Level.INFO
        self.log.add("state", f"{before.value} -> {self.state.value} ({event.value}){reason}", level, data)
