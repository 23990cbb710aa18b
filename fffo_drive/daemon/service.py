"""The process around the supervisor: signals, the service manager, the cycle, and an orderly end."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol

from .. import __version__
from ..config.axis import realtime_request
from ..config.runaway import accepted_words
from ..documents import DocumentError
from ..recording.events import Level
from ..runtime.realtime import require_realtime
from ..workflows.plan import Plan, make_plan
from .connection import require_served
from .journal import Journal
from .methods import Api
from .notify import Notifier
from .places import recordings_directory, socket_directory
from .record_keeper import Sources
from .server import Server
from .states import AT_REST, StateEvent
from .status import line_of
from .supervisor import TURN_S, Supervisor
from .worker import Worker

FEEDS_PER_WATCHDOG = 4.0
STATUS_S = 0.5
SWITCH_S = 0.0005  # switch interval of busy threads: how long a stop waits for the clients' and the live thread
DETACH_S = 0.5  # for the companions of the daemon to end


class AttachedService(Protocol):
    """A companion of the daemon, on its own threads, while the sockets are open."""

    @property
    def greeting(self) -> str:
        """What it serves and where, for the log."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class Options(NamedTuple):
    """Options from the command line."""

    file: Path
    bus: str | None = None
    sockets: Path | None = None
    uncommissioned: bool = False
    attach: Callable[[Supervisor, Path], AttachedService | None] | None = None  # with the sockets' directory; may wait


def serve(options: Options) -> None:
    """Serve one axis until SIGTERM or SIGINT.

    Raises DocumentError for bad files, DiskSilentError, RealtimeRefusedError, and fatal errors.
    """
    plan, sources = asyncio.run(_read(options.file))
    require_served(plan)
    if plan.axis.realtime.required:
        require_realtime(realtime_request(plan.axis))  # before the service counts as started
    sys.setswitchinterval(SWITCH_S)
    service = _Service(plan, sources, options)
    asyncio.run(service.run())
    if service.work_in_progress:  # do not wait for a compiler or a disk, as the interpreter's normal exit would
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)


async def _read(path: Path) -> tuple[Plan, Sources]:
    """What the service is made from. Raises DocumentError; DiskSilentError where a file does not come."""

    def read() -> tuple[Plan, Sources]:
        plan = make_plan(path)
        return plan, Sources(plan)

    return await Worker("fffo-files", lambda text, silent: None).run(read, doing="reading", at=path)


class _Service:
    """One run."""

    def __init__(self, plan: Plan, sources: Sources, options: Options) -> None:
        self.plan, self.sources, self.options = plan, sources, options
        self.notifier = Notifier()
        self.journal = Journal()
        self._stop = asyncio.Event()
        self._stops = 0
        self._fed_s = 0.0
        self._status_s = 0.0
        self._attaching = Worker("fffo-attach")

    @property
    def work_in_progress(self) -> bool:
        """Whether something is still in progress for which the end of the service did not wait."""
        supervisor = self.supervisor
        workers = (supervisor.bus_work, supervisor.files, self.api.work, self._attaching)
        keeper = supervisor.recorder
        return keeper.busy or keeper.hangs or any(worker.busy or worker.hangs for worker in workers)

    async def run(self) -> None:
        """From the sockets to the last frame."""
        options = self.options
        self.supervisor = supervisor = Supervisor(
            self.plan, self.journal, options.bus, options.uncommissioned, recordings_directory(), sources=self.sources
        )
        supervisor.recorder.wanted = self.plan.axis.daemon.record == "on"
        self.api = Api(supervisor)
        directory = options.sockets or socket_directory(self.plan.axis.name)
        self.server = Server(self.api, directory, self.plan.axis.daemon.clients)
        self._reloads: set[asyncio.Task[None]] = set()
        attached: AttachedService | None = None
        try:
            await self.server.open(self.plan.axis.daemon.control_group)
            if options.attach is not None:
                attached = await self._attaching.run(options.attach, supervisor, directory)
            self._catch_signals()
            supervisor.log.add("started", f"fffo-drive {__version__} serves {options.file} on {directory}")
            for text in accepted_words(self.plan.axis, self.plan.model):
                supervisor.log.add("started", text, Level.WARNING)
            if attached is not None:
                supervisor.log.add("started", attached.greeting)
            living = asyncio.create_task(supervisor.run())
            turning = asyncio.create_task(self._turn_for_ever())
            self.notifier.ready()
            stopping = asyncio.create_task(self._stop.wait())
            await asyncio.wait({living, turning, stopping}, return_when=asyncio.FIRST_COMPLETED)
            self.notifier.stopping()
            supervisor.log.add("stopping", "the daemon ends")
            if not turning.done():
                await supervisor.stop_in_order()
            stopping.cancel()
            turning.cancel()
        finally:
            await supervisor.close()
            if supervisor.fatal is not None:
                supervisor.log.add("stopping", f"it cannot go on: {supervisor.fatal}", Level.FATAL)
            if attached is not None:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._attaching.run(attached.close), DETACH_S)
            await self.server.close()
            self.journal.close()
        if supervisor.fatal is not None:
            raise supervisor.fatal
        if turning.done() and not turning.cancelled() and turning.exception() is not None:
            raise turning.exception() or RuntimeError

    async def _turn_for_ever(self) -> None:
        while True:
            self.supervisor.turn()
            self.server.turn()
            self._feed(time.monotonic())
            await asyncio.sleep(TURN_S)

    def _feed(self, now_s: float) -> None:
        """The watchdog, only while all is consistent; and one line of status."""
        supervisor, watchdog_s = self.supervisor, self.notifier.watchdog_s
        if watchdog_s is not None and now_s - self._fed_s > watchdog_s / FEEDS_PER_WATCHDOG and supervisor.consistent:
            self._fed_s = now_s
            self.notifier.alive()
        if now_s - self._status_s > STATUS_S:
            self._status_s = now_s
            self.notifier.status(line_of(supervisor))

    def _catch_signals(self) -> None:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._on_stop)
        loop.add_signal_handler(signal.SIGHUP, self._on_reload)

    def _on_stop(self) -> None:
        """The first signal requests a controlled stop, the next a quick stop."""
        self._stops += 1
        self._stop.set()
        if self._stops > 1 and self.supervisor.state not in AT_REST:
            self.supervisor.apply(StateEvent.QUICK_STOP, who="a signal")

    def _on_reload(self) -> None:
        task = asyncio.get_running_loop().create_task(self._reload())
        self._reloads.add(task)
        task.add_done_callback(self._reloads.discard)

    async def _reload(self) -> None:
        """SIGHUP. An invalid file changes nothing."""
        self.notifier.reloading()
        try:
            await self.api.reload_file("SIGHUP", {})
        except (DocumentError, OSError) as error:
            text = f"not reloaded, all goes on as it was: {error}"
            self.supervisor.log.add("reload", text, Level.ERROR)
        self.notifier.ready()
