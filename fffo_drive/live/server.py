"""The live server of one daemon, on a thread and an asyncio loop of its own: scope page and viewers' WebSocket.

The daemon's own loop is asked through its control socket alone, like by any other client; the tick's loop is only read,
through its ring. Whatever happens here, both go on.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import stat
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from ..config.address import Address, in_unit, sandbox_problem
from .feed import Feed, FeedSource
from .hub import Hub
from .keys import Keys
from .places import TOKEN_FILE, TOKEN_MODE, URL_FILE, URL_MODE, VIEWERS_FILE
from .services import ServiceMethod
from .viewers import Viewers
from .web import Web

START_S, END_S = 120.0, 10.0  # a first start may compile
THREAD_NAME = "fffo-live"  # for `top -H` as well


class WantedServices(NamedTuple):
    """What is to be served, and where; None: not at all."""

    scope: Address | None
    viewers: Address | None = None


class LiveServer:
    """Serves from `start` to `close`."""

    def __init__(
        self, wanted: WantedServices, directory: Path, control: str, source: Callable[[], FeedSource | None],
        methods: Mapping[str, ServiceMethod], name: str = "axis",
    ) -> None:  # fmt: skip
        """`directory` has the daemon's socket `control`; addresses and key are left there as files.

        `methods`: those of the control API, by name, of which the services of the viewers are made.
        """
        self.wanted = wanted  # with the ports that were given, once started
        self.keys = Keys()
        self._directory, self._control, self._source, self._name = directory, control, source, name
        self._methods = methods
        self._thread = threading.Thread(target=self._work, name=THREAD_NAME, daemon=True)
        self._ready = threading.Event()
        self._failure: BaseException | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None

    def start(self) -> None:
        """Listen. Raises OSError when an address cannot be had."""
        self._thread.start()
        if not self._ready.wait(START_S):
            raise OSError("the live server does not start")
        if self._failure is not None:
            raise self._failure
        group = (self._directory / self._control).stat().st_gid  # who may use the control socket may read the key
        for name, text, mode in self._files():
            _write(self._directory / name, text, mode, group)

    def close(self) -> None:
        """Drop all clients and end the thread."""
        if self._loop is not None and self._end is not None:
            with contextlib.suppress(RuntimeError):  # ended by itself
                self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(END_S)
        for name in (URL_FILE, VIEWERS_FILE, TOKEN_FILE):
            (self._directory / name).unlink(missing_ok=True)

    @property
    def key(self) -> str:
        """Of the last role."""
        return self.keys.last

    @property
    def url(self) -> str:
        """Of the scope page, for a browser; empty without one."""
        return f"http://{self.wanted.scope.names[0]}/" if self.wanted.scope else ""

    @property
    def viewers_url(self) -> str:
        """For Foxglove and the like; empty where there is none."""
        return f"ws://{self.wanted.viewers.names[0]}" if self.wanted.viewers else ""

    @property
    def greeting(self) -> str:
        """One line for the log."""
        told = [f"the scope is on {self.url}"] if self.url else []
        told += [f"Foxglove connects to {self.viewers_url}"] if self.viewers_url else []
        addresses = (self.wanted.scope, self.wanted.viewers) if in_unit() else ()
        told += [text for address in addresses if address and (text := sandbox_problem(address))]
        return "; ".join((*told, "fffo-drive scope gives the addresses with the key"))

    def _files(self) -> list[tuple[str, str, int]]:
        urls = [(URL_FILE, self.url, URL_MODE), (VIEWERS_FILE, self.viewers_url, URL_MODE)]
        return [*(file for file in urls if file[1]), (TOKEN_FILE, self.keys.last, TOKEN_MODE)]

    def _work(self) -> None:
        with contextlib.suppress(OSError):
            Path("/proc/thread-self/comm").write_text(THREAD_NAME)
        try:
            asyncio.run(self._run())
        except BaseException as error:
            if self._ready.is_set():  # nobody waits for it any more: to stderr, and the axis goes on without a scope
                raise
            self._failure = error
        self._ready.set()

    async def _run(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        self.hub = hub = Hub(Feed(self._source), self._directory / self._control, self.keys, self._methods)
        async with contextlib.AsyncExitStack() as served:
            served.callback(hub.close)
            if self.wanted.scope is not None:
                web = Web(self.wanted.scope, hub)
                self.wanted = self.wanted._replace(scope=await web.start())
                served.callback(web.close)
            if self.wanted.viewers is not None:
                path = self._directory / self._control
                hub.audience = viewers = Viewers(self.wanted.viewers, self._name, self.keys, path, self._methods)
                self.wanted = self.wanted._replace(viewers=await viewers.start())
                served.callback(viewers.close)
            working = asyncio.create_task(hub.run())
            self._ready.set()
            ending = asyncio.create_task(self._end.wait())
            await asyncio.wait({working, ending}, return_when=asyncio.FIRST_COMPLETED)
            if working.done():
                working.result()
            working.cancel()


def _write(path: Path, text: str, mode: int, group: int) -> None:
    """A file that never was readable for more than `mode` says, nor for another group than this one."""
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(text + "\n")
        try:
            os.fchown(file.fileno(), -1, group)
        except PermissionError:  # the service is not in it: what is not for everybody stays its own user's
            mode = mode if mode & stat.S_IROTH else 0o600
        os.fchmod(file.fileno(), mode)
