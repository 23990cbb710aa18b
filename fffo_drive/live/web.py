"""The scope over HTTP: the page on `/`, a WebSocket on `/live`, nothing else, and for nobody but our own page.

A request must name us as its host, a WebSocket must come from our own page (Origin); commands need the key besides.
Stop needs neither key nor a free place in a queue.
"""

from __future__ import annotations

import asyncio
from functools import partial
from http import HTTPStatus
from typing import Any, cast

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from ..config.address import Address
from .hub import Hub
from .page import headers, page

PATH = "/live"
CLIENTS = 8
CONNECTIONS = 32  # open at all, half-open ones among them
MESSAGE_BYTES = 4096


class Web:
    """Listens from `start` to `close`, on the live server's thread."""

    def __init__(self, address: Address, hub: Hub) -> None:
        self.address = address
        self._hub = hub
        self._open = 0
        self._server: Server | None = None

    async def start(self) -> Address:
        """Listen. Returns where. Raises OSError when the address cannot be had."""
        self._server = await serve(
            self._hub.serve, self.address.host, self.address.port, process_request=self._process,
            create_connection=cast(type[ServerConnection], partial(_Connection, self)), compression=None,
            max_size=MESSAGE_BYTES, max_queue=4, open_timeout=5.0,
            ping_interval=10.0, ping_timeout=20.0, close_timeout=1.0, server_header=None, backlog=CONNECTIONS,
        )  # fmt: skip
        self.address = self.address._replace(port=next(iter(self._server.sockets)).getsockname()[1])
        return self.address

    def close(self) -> None:
        """Stop listening, drop everybody."""
        if self._server is not None:
            self._server.close(close_connections=True)

    def _process(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, the WebSocket, or why not."""
        if request.headers.get_all("Host") not in [[name] for name in self.address.names]:
            return _answer(HTTPStatus.MISDIRECTED_REQUEST, f"this is http://{self.address.names[0]}/\n")
        if request.path == "/":
            return _answer(HTTPStatus.OK, page(), headers())
        if request.path != PATH:
            return _answer(HTTPStatus.NOT_FOUND, "not here\n")
        if request.headers.get_all("Origin") not in [[f"http://{name}"] for name in self.address.names]:
            return _answer(HTTPStatus.FORBIDDEN, "not from this page\n")
        if len(self._hub.clients) >= CLIENTS:
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

    def __init__(self, owner: Web, *arguments: Any, **options: Any) -> None:
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
