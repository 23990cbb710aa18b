"""The live server: HTTP and WebSocket on one port, on a thread and an asyncio loop of its own.

It answers with the page on `/` and speaks WebSocket on `/live`. A request must name us as its host, a WebSocket must
come from our own page (Origin); commands need the token besides. Stop needs neither token nor a free place in a queue.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import threading
from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Any, NamedTuple, cast

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from .feed import Feed, Source
from .hub import Hub
from .page import headers, page
from .places import TOKEN_FILE, TOKEN_MODE, URL_FILE, URL_MODE

PATH = "/live"
CLIENTS = 8
CONNECTIONS = 32  # open at all, half-open ones among them
MESSAGE_BYTES = 4096
START_S, END_S = 120.0, 5.0  # a first start may compile
WILDCARDS = ("", "0.0.0.0", "::", "*")


class Address(NamedTuple):
    """Where to listen. Port 0: a free one."""

    host: str
    port: int

    @property
    def names(self) -> tuple[str, ...]:
        """What a browser may call us."""
        hosts = ("127.0.0.1", "localhost") if self.host in ("127.0.0.1", "localhost") else (self.host,)
        return tuple(f"[{host}]:{self.port}" if ":" in host else f"{host}:{self.port}" for host in hosts)


def address_of(text: str) -> Address:
    """`PORT`, or `HOST:PORT`. Raises ValueError."""
    host, _, port = text.rpartition(":")
    host = host.strip("[]") if host else "127.0.0.1"
    if not port.isdecimal() or int(port) > 65535:
        raise ValueError(f"'{text}': give PORT or HOST:PORT")
    if ":" in text and host in WILDCARDS:
        raise ValueError(f"'{text}': give the address or name that browsers use, not all of them")
    return Address(host, int(port))


class LiveServer:
    """Serves the scope of one daemon, from `start` to `close`."""

    def __init__(self, address: Address, directory: Path, control: str, source: Callable[[], Source | None]) -> None:
        """`directory` has the daemon's socket `control`; address and token are left there as files."""
        self.address = address
        self.token = secrets.token_urlsafe(24)
        self._directory, self._control, self._source = directory, control, source
        self._thread = threading.Thread(target=self._work, name="fffo-live", daemon=True)
        self._ready = threading.Event()
        self._failure: BaseException | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None
        self._open = 0

    def start(self) -> None:
        """Listen. Raises OSError when the address cannot be had."""
        self._thread.start()
        if not self._ready.wait(START_S):
            raise OSError(f"{self.url}: the live server does not start")
        if self._failure is not None:
            raise self._failure
        _write(self._directory / URL_FILE, self.url, URL_MODE)
        _write(self._directory / TOKEN_FILE, self.token, TOKEN_MODE)

    def close(self) -> None:
        """Drop all clients and end the thread."""
        if self._loop is not None and self._end is not None:
            with contextlib.suppress(RuntimeError):  # ended by itself
                self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(END_S)
        for name in (URL_FILE, TOKEN_FILE):
            (self._directory / name).unlink(missing_ok=True)

    @property
    def url(self) -> str:
        """For a browser."""
        return f"http://{self.address.names[0]}/"

    def _work(self) -> None:
        try:
            asyncio.run(self._run())
        except BaseException as error:
            if self._ready.is_set():  # nobody waits for it any more: to stderr, and the axis goes on without a scope
                raise
            self._failure = error
        self._ready.set()

    async def _run(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        self.hub = hub = Hub(Feed(self._source), self._directory / self._control, self.token)
        async with serve(
            hub.serve, self.address.host, self.address.port, process_request=self._process,
            create_connection=cast(type[ServerConnection], partial(_Connection, self)), compression=None,
            max_size=MESSAGE_BYTES, max_queue=4, open_timeout=5.0,
            ping_interval=10.0, ping_timeout=10.0, close_timeout=1.0, server_header=None, backlog=CONNECTIONS,
        ) as server:  # fmt: skip
            port = next(iter(server.sockets)).getsockname()[1]
            self.address = self.address._replace(port=port)
            working = asyncio.create_task(hub.run())
            self._ready.set()
            await asyncio.wait({working, asyncio.create_task(self._end.wait())}, return_when="FIRST_COMPLETED")
            hub.close()
            server.close(close_connections=True)
            if working.done():
                working.result()
            working.cancel()

    def _process(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, the WebSocket, or why not."""
        if request.headers.get_all("Host") not in [[name] for name in self.address.names]:
            return _answer(HTTPStatus.MISDIRECTED_REQUEST, f"this is {self.url}\n")
        if request.path == "/":
            return _answer(HTTPStatus.OK, page(), headers())
        if request.path != PATH:
            return _answer(HTTPStatus.NOT_FOUND, "not here\n")
        if request.headers.get_all("Origin") not in [[f"http://{name}"] for name in self.address.names]:
            return _answer(HTTPStatus.FORBIDDEN, "not from this page\n")
        if len(self.hub.clients) >= CLIENTS:
            return _answer(HTTPStatus.SERVICE_UNAVAILABLE, f"{CLIENTS} pages are open already\n")
        return None

    def joined(self) -> bool:
        """A connection was made; False when it is one too many."""
        self._open += 1
        return self._open <= CONNECTIONS

    def left(self) -> None:
        """A connection is gone."""
        self._open -= 1


class _Connection(ServerConnection):
    """A connection that counts."""

    def __init__(self, owner: LiveServer, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._owner = owner

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if not self._owner.joined():
            self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._owner.left()
        super().connection_lost(exc)


def _answer(status: HTTPStatus, text: str, more: dict[str, str] | None = None) -> Response:
    body = text.encode()
    given = more or {"Content-Type": "text/plain; charset=utf-8", "X-Content-Type-Options": "nosniff"}
    head = Headers([*given.items(), ("Content-Length", str(len(body))), ("Connection", "close")])
    return Response(status.value, status.phrase, head, body)


def _write(path: Path, text: str, mode: int) -> None:
    """A file that never was readable for more than `mode` says."""
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "w") as file:
        file.write(text + "\n")
