"""The live server of one daemon, on its own thread and asyncio loop: scope page and viewers' WebSocket.

It reaches the daemon only through the control socket, like any other client, and reads the control loop only through
the ring. Whatever fails here, both continue.
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
THREAD_NAME = "fffo-live"  # also shown by `top -H`


class WantedServices(NamedTuple):
    """Addresses of the services; None: not served."""

    scope: Address | None
    viewers: Address | None = None


class LiveServer:
    """Serves from `start` to `close`."""

    def __init__(
        self, wanted: WantedServices, directory: Path, control: str, source: Callable[[], FeedSource | None],
        methods: Mapping[str, ServiceMethod], name: str = "axis",
    ) -> None:  # fmt: skip
        """`directory` has the daemon's socket `control`; addresses and key are written there as files.

        `methods`: those of the control API, by name, from which the viewers' services are made.
        """
        self.wanted = wanted  # with the actual ports, once started
        self.keys = Keys()
        self._directory, self._control, self._source, self._name = directory, control, source, name
        self._methods = methods
        self._thread = threading.Thread(target=self._work, name=THREAD_NAME, daemon=True)
        self._ready = threading.Event()
        self._failure: BaseException | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None

    def start(self) -> None:
        """Listen. Raises OSError when an address is not available."""
        self._thread.start()
        if not self._ready.wait(START_S):
            raise OSError("the live server does not start")
        if self._failure is not None:
            raise self._failure
        group = (self._directory / self._control).stat().st_gid  # whoever may use the control socket may read the key
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
        """The key of the last role."""
        return self.keys.last

    @property
    def url(self) -> str:
        """Address of the scope page for a browser; empty without one."""
        return f"http://{self.wanted.scope.names[0]}/" if self.wanted.scope else ""

    @property
    def viewers_url(self) -> str:
        """Address for Foxglove and other viewers; empty without one."""
        return f"ws://{self.wanted.viewers.names[0]}" if self.wanted.viewers else ""

    @property
    def greeting(self) -> str:
        """One line for the log."""
        sentences = [f"the scope is on {self.url}"] if self.url else []
        sentences += [f"Foxglove connects to {self.viewers_url}"] if self.viewers_url else []
        addresses = (self.wanted.scope, self.wanted.viewers) if in_unit() else ()
        sentences += [text for address in addresses if address and (text := sandbox_problem(address))]
        return "; ".join((*sentences, "fffo-drive scope gives the addresses with the key"))

    def _files(self) -> list[tuple[str, str, int]]:
        urls = [(URL_FILE, self.url, URL_MODE), (VIEWERS_FILE, self.viewers_url, URL_MODE)]
        return [*(file for file in urls if file[1]), (TOKEN_FILE, self.keys.last, TOKEN_MODE)]

    def _work(self) -> None:
        with contextlib.suppress(OSError):
            Path("/proc/thread-self/comm").write_text(THREAD_NAME)
        try:
            asyncio.run(self._run())
        except BaseException as error:
            if self._ready.is_set():  # nobody waits for the result any more: log it; the axis continues without a scope
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
    """Write a file that at no time is readable beyond `mode`, or by another group."""
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(text + "\n")
        try:
            os.fchown(file.fileno(), -1, group)
        except PermissionError:  # the service is not a member: the file stays with its own user
            mode = mode if mode & stat.S_IROTH else 0o600
        os.fchmod(file.fileno(), mode)
