"""One loop on one drive: memory, thread, start, requests and stop. The same for a bus and for a simulated drive.

With a wall clock the loop runs in a thread of its own; with a simulated clock `run_profile` calls it directly and
returns when the profile has ended, as fast as the machine allows.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..arrays import Floats
from ..control.controller import CONTROLLER_BLOCK_SIZE, ControllerConfig, pack_controller
from ..control.envelope import TRIP_NONE, EnvelopeConfig
from ..control.own_law import ControlLaw, failure_of, forget_failure
from ..control.reference import Profile
from ..control.set_point import SetPoint
from ..documents import DocumentError
from ..drive.cia402 import GOAL_DISABLED, GOAL_ENABLED
from ..drive.port import NO_LIMIT, CurrentLimit, Drive, limit_words, port_now_ns
from ..jit import INTERPRETED
from ..jit.atomic import load_acquire, store_release
from ..recording.run_records import FileStart, RecordBook, RunRecord
from . import blocks as b
from . import records
from .blocks import (
    Blocks,
    ask_for_memory,
    new_blocks,
    publish_controller,
    publish_effects,
    publish_profile,
    publish_set_point,
    require_room,
)
from .loop import run_loop
from .realtime import (
    RealtimeRefusedError,
    RealtimeReport,
    RealtimeRequest,
    enter_realtime,
    require_realtime,
    unlock_memory,
)
from .records import WORD_KINDS, ModelNote, Unnumbered
from .ring import HEAD, Ring, copy_row, new_ring
from .tick import LoopConfig

_COMPILING = threading.Lock()  # one dispatcher for all sessions of a process: one must not disable it for another

START_AHEAD_NS = 20_000_000  # first deadline after the thread is ready
STOP_TIMEOUT_S = 10.0  # for the loop's thread, which normally ends within two periods


class LoopHungError(Exception):
    """The loop's thread does not end. The process has to end: nothing else releases the bus."""


class SessionConfig(NamedTuple):
    """Configuration of a session."""

    loop: LoopConfig
    controller: ControllerConfig
    envelope: EnvelopeConfig
    realtime: RealtimeRequest
    realtime_required: bool
    longest_profile: int  # samples
    ring_rows: int
    effects: Floats | None = None  # table of compensated effects (control/compensation)
    model: ModelNote | None = None  # that the controller was made with
    own_law: ControlLaw | None = None  # of a user, in place of the controller


def raise_failure(session: Session) -> None:
    """Raise DocumentError, from the error of its own, if the step of a user's law failed in a run."""
    error, law = failure_of(session.blocks.own_law), session.config.own_law
    if error is not None and law is not None:
        raise DocumentError(f"controller {law.name!r}: step raised {type(error).__name__}: {error}") from error


class OnPaper(NamedTuple):
    """A drive that is not connected yet, to compile the loop for its port."""

    port: Any
    current_limit: CurrentLimit = NO_LIMIT


class PortHolder(Protocol):
    """The part of a drive that compilation needs."""

    @property
    def port(self) -> Any:
        """The compiled port."""
        ...

    @property
    def current_limit(self) -> CurrentLimit:
        """The drive's own."""
        ...


class Session:
    """A loop on a connected drive. Use as a context manager, or call `close`.

    Everything that the loop is asked for goes through here and is a record in `records`, made before the loop can see
    what it tells of.
    """

    def __init__(self, drive: Drive, config: SessionConfig) -> None:
        self.drive = drive
        self._limit_news: list[str] = []
        self.config = config = config._replace(controller=self._within_drive(config.controller))
        self.blocks: Blocks = new_blocks(config.controller, config.longest_profile)
        if config.effects is not None:
            self.blocks.effects[:] = config.effects
        if config.own_law is not None:
            self.blocks.own_law[:] = config.own_law.block()
            forget_failure(self.blocks.own_law)
        self.ring: Ring = new_ring(config.ring_rows)
        self.realtime_report: RealtimeReport | None = None
        self.error: BaseException | None = None
        self._thread: threading.Thread | None = None
        self._ready = threading.Event()
        self._scratch = np.zeros((2, CONTROLLER_BLOCK_SIZE))
        self.records = RecordBook()
        self._asking = threading.Lock()
        self._model = config.model
        self._models = 0
        first = [
            records.of_session(uuid.uuid4().hex, config.loop, config.envelope),
            records.of_parameters(0, self.blocks.parameters[0], config.model, config.own_law),
            records.of_effects(0, self.blocks.effects[0]),
            *(records.of_word(kind, int(self.blocks.control[word])) for word, kind in WORD_KINDS.items()),
        ]
        if config.model is not None:
            first.insert(1, records.of_model(0, config.model))
        for record in first:
            with self._recorded(record):
                pass

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    # -- requests of ordinary threads -------------------------------------------------------------------------------

    def request(self, word: int, value: int) -> None:
        """Write a control word (blocks.GOAL, TOGGLE, ...)."""
        kind = WORD_KINDS.get(word)
        if kind is None:  # a beat is not a request
            store_release(self.blocks.control, word, value)
            return
        with self._asking, self._recorded(records.of_word(kind, value)):
            store_release(self.blocks.control, word, value)

    def reset_fault(self) -> None:
        """Ask for a reset: the latched trip is cleared, and the drive's fault by one rise of bit 7."""
        self.request(b.RESET_NUMBER, self._next(b.RESET_NUMBER))

    def note_request(self, who: str, what: str, values: Mapping[str, Any], epoch: int | None = None) -> None:
        """Record a request of a client, before the records of its consequences."""
        with self._asking, self._recorded(records.of_request(who, what, values, epoch)):
            pass

    def status(self, word: int) -> int:
        """Read a status word (blocks.TRIP, PROFILE_DONE, ...)."""
        return load_acquire(self.blocks.status, word)

    @property
    def stop_statusword(self) -> int:
        """The statusword that explains why the axis stopped: of the tick of the trip, else the last one."""
        return self.status(b.STATUSWORD if self.status(b.TRIP) == TRIP_NONE else b.TRIP_STATUSWORD)

    def set_model(self, model: ModelNote) -> None:
        """The model of the next parameters and effects, for the records."""
        with self._asking:
            self._models += 1
            self._model = model
            with self._recorded(records.of_model(self._models, model)):
                pass

    def _within_drive(self, controller: ControllerConfig) -> ControllerConfig:
        """With the drive's own current limit, where that is the smaller one: the law's anti-windup has to know it."""
        limit = self.drive.current_limit
        self._limit_news = limit_words(controller.current_limit_a, limit)
        return controller._replace(current_limit_a=min(controller.current_limit_a, limit.current_a))

    def warnings(self) -> list[str]:
        """News since the last call that stop nothing, one sentence each: of the drive and its limits; never waits."""
        said, self._limit_news = self._limit_news, []
        return [*said, *self.drive.warnings()]

    def set_controller(self, controller: ControllerConfig) -> None:
        """New gains and model, taken at a tick boundary. The law's current limit is never above the drive's."""
        controller = self._within_drive(controller)
        block = pack_controller(controller)
        with (
            self._asking,
            self._recorded(
                records.of_parameters(self._next(b.PARAMETER_NUMBER), block, self._model, self.config.own_law)
            ),
        ):
            publish_controller(self.blocks, controller)

    def set_effects(self, table: Floats) -> None:
        """New effects to compensate, taken at a tick boundary and switched on with a ramp. No effect if unchanged."""
        with self._asking:
            if np.array_equal(table, self.blocks.effects[self.blocks.control[b.EFFECTS_NUMBER] & 1]):
                return
            with self._recorded(records.of_effects(self._next(b.EFFECTS_NUMBER), table)):
                publish_effects(self.blocks, table)

    def start_profile(self, profile: Profile, past: Floats = b.NO_PAST) -> int:
        """Request a profile; it starts once the drive is enabled. Return its number.

        `past`: see `publish_profile`.
        """
        require_room(self.blocks, profile)
        record = records.of_profile(0, profile)  # its digest takes time: before anybody has to wait
        with self._asking, self._recorded(record._replace(number=self._next(b.PROFILE_NUMBER))):
            return publish_profile(self.blocks, profile, past)

    def set_point(self, set_point: SetPoint) -> int:
        """Request a velocity now; a motion begins with it once the drive is enabled. Return its number."""
        with self._asking, self._recorded(records.of_set_point(self._next(b.SET_POINT_NUMBER), set_point)):
            return publish_set_point(self.blocks, set_point)

    def ask_for_memory(self) -> int | None:
        """Ask for the loop's memory behind the next tick; None when the loop has ended."""
        with self._asking:
            return None if self.status(b.FINISHED) else ask_for_memory(self.blocks)

    def memory_given(self, number: int) -> FileStart | None:
        """The memory asked for by `number`, or by somebody else since; None until the loop has given it."""
        with self._asking:  # nobody asks meanwhile, so the loop leaves the copy alone
            given = self.status(b.MEMORY_GIVEN)
            if given < number or given != self.blocks.control[b.MEMORY_NUMBER]:
                return None
            row = int(self.blocks.status[b.MEMORY_ROW])
            record = records.of_memory(self.blocks.memory, copy_row(self.ring, row - 1))
        return FileStart(row, record)

    def _next(self, word: int) -> int:
        return int(self.blocks.control[word]) + 1

    @contextmanager
    def _recorded(self, record: Unnumbered) -> Iterator[None]:
        """Write a record before the change that it describes, then the number by which rows refer to it."""
        sequence = self._next(b.REQUEST_NUMBER)
        self.records.add(RunRecord(0, sequence, *record))
        yield
        store_release(self.blocks.control, b.REQUEST_NUMBER, sequence)
        head = int(self.ring.words[HEAD])
        if head:
            self.records.forget(copy_row(self.ring, head - 1))

    @property
    def running(self) -> bool:
        """True while the loop's thread is alive."""
        return self._thread is not None and self._thread.is_alive()

    # -- running ---------------------------------------------------------------------------------------------------

    def compile(self) -> None:
        """Compile everything that the loop calls, then disable compilation: it would stop the tick for seconds."""
        if INTERPRETED:
            return
        from numba import typeof

        dispatcher: Any = run_loop
        with _COMPILING:
            dispatcher.disable_compile(False)
            dispatcher.compile(tuple(typeof(argument) for argument in self._arguments(0)))
            dispatcher.disable_compile()

    def run_profile(self, profile: Profile, toggle: int) -> int:
        """Enable, run the profile to its end or to a trip, disable. For a simulated clock. Return ticks run."""
        self.compile()
        self.request(b.AUTOSTOP, 1)
        self.request(b.STOP, 0)
        self.request(b.TOGGLE, toggle)
        self.request(b.GOAL, GOAL_ENABLED)
        self.start_profile(profile)
        first_ns = port_now_ns(self.drive.port) + self.config.loop.period_ns
        ticks = int(run_loop(*self._arguments(first_ns)))
        self.request(b.GOAL, GOAL_DISABLED)
        return ticks

    def run_ticks(self, ticks: int) -> int:
        """Run the loop for a number of ticks with the present requests, for a simulated clock. Return ticks run.

        A trip stays latched, and the loop goes on, until the last of them. The drive is left without voltage.
        """
        self.compile()
        self.request(b.STOP, 0)
        first_ns = port_now_ns(self.drive.port) + self.config.loop.period_ns
        port, loop, *others = self._arguments(first_ns)
        return int(run_loop(port, loop._replace(max_ticks=ticks), *others))

    def start(self) -> RealtimeReport:
        """Start the loop's thread for a wall clock: SYNC runs from here on, without torque until GOAL requests it.

        Raises RealtimeRefusedError if the system refuses what the configuration requires.
        """
        if self.config.realtime_required:
            require_realtime(self.config.realtime._replace(lock_memory=False))  # the thread itself reports that
        self.compile()
        self._thread = threading.Thread(target=self._run, name="fffo-loop", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self.error is not None:
            raise self.error
        assert self.realtime_report is not None
        return self.realtime_report

    def stop(self) -> None:
        """Request no torque, end the loop and join its thread. Raises LoopHungError if it does not end."""
        self.request(b.GOAL, GOAL_DISABLED)
        self.request(b.STOP, 1)
        if self._thread is None:
            return
        self._thread.join(STOP_TIMEOUT_S)
        if self._thread.is_alive():
            raise LoopHungError(
                f"the loop's thread hangs in tick {self.status(b.TICK)} and did not end within {STOP_TIMEOUT_S:g} s: "
                "the drive was told to stop without it, and this process has to end"
            )
        self._thread = None
        unlock_memory()

    def close(self) -> None:
        """Stop the loop, then leave the drive without torque.

        Raises LoopHungError, but only after the drive was released.
        """
        try:
            self.stop()
        except LoopHungError:
            self.drive.close(loop_ended=False)
            raise
        self.drive.close()

    @staticmethod
    def rehearse(drive: PortHolder, config: SessionConfig) -> None:
        """Compile for ports of this type before a drive is connected, which would have to wait."""
        on_paper: Any = drive
        Session(on_paper, config._replace(longest_profile=1, ring_rows=1)).compile()

    def _arguments(self, first_deadline_ns: int) -> tuple[Any, ...]:
        return (
            self.drive.port,
            self.config.loop,
            self.config.envelope,
            self.blocks,
            self._scratch,
            self.ring,
            first_deadline_ns,
        )

    def _run(self) -> None:
        try:
            self.realtime_report = enter_realtime(self.config.realtime)
            if self.config.realtime_required and self.realtime_report.refusals:
                raise RealtimeRefusedError("; ".join(self.realtime_report.refusals))
        except BaseException as error:
            self.error = error
            self._ready.set()
            return
        self._ready.set()
        first_ns = port_now_ns(self.drive.port) + START_AHEAD_NS
        run_loop(*self._arguments(first_ns))
