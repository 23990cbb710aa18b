"""A WebSocket listener with limits: on places, on connections without a request, and on the data of each client.

A client that has not sent its request yet (half-open, or one byte a second) is the first to be dropped when too many
wait; accepted clients are not affected. When all places are taken, a client with the key (`?key=` in the address) takes
the place of the first one without. Frames are counted on arrival, before they are decoded, so that one read from one
client never delays the others for long.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from functools import partial
from http import HTTPStatus
from typing import Any, cast

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.frames import Frame
from websockets.http11 import Request, Response
from websockets.protocol import Event

from ..config.address import Address
from .http_rules import TEXT, headers, target_of
from .keys import Keys

AT_THE_DOOR = 64  # connections without a request; one more drops the oldest
OPEN_S = 5.0  # time for the request
RATE_HZ, BURST = 20.0, 40.0  # frames of one connection of this size; a longer frame counts as several
COUNTED_BYTES = 8192
READ_BYTES = 1024  # bytes decoded at a time: some hundred of the shortest frames
PING_S, PONG_S, CLOSE_S = 10.0, 20.0, 1.0
_SILENT = logging.Logger("fffo_drive.live", logging.CRITICAL + 1)  # the library logs every caller that fails

Judge = Callable[[Request], Response | None]


class Listener:
    """Listens from `start` to `close`, on the live server's thread."""

    def __init__(
        self, address: Address, handler: Callable[[ServerConnection], Awaitable[None]], judge: Judge, places: int,
        keys: Keys, message_bytes: int, subprotocol: str | None = None,
    ) -> None:  # fmt: skip
        """`judge` answers a request, or accepts it with None; at most `places` are accepted. `address`: port 0 is
        any.
        """
        self.address = address
        self._places, self._keys = places, keys
        self._handler, self._judge = handler, judge
        self._options: dict[str, Any] = {"max_size": message_bytes}
        if subprotocol is not None:
            self._options["subprotocols"] = [subprotocol]
        self._door: dict[ServerConnection, None] = {}  # in order of arrival
        self._inside: dict[ServerConnection, bool] = {}  # in order of arrival, and whether with the key
        self._server: Server | None = None

    async def start(self) -> Address:
        """Listen. Returns the address. Raises OSError when it is not available."""
        self._server = await serve(
            self._handler, self.address.host, self.address.port, process_request=self._process,
            create_connection=cast(type[ServerConnection], partial(_Connection, self)), compression=None,
            max_queue=4, open_timeout=OPEN_S, ping_interval=PING_S, ping_timeout=PONG_S, close_timeout=CLOSE_S,
            server_header=None, backlog=AT_THE_DOOR, logger=_SILENT, **self._options,
        )  # fmt: skip
        self.address = self.address._replace(port=next(iter(self._server.sockets)).getsockname()[1])
        return self.address

    def close(self) -> None:
        """Stop listening, drop everybody."""
        if self._server is not None:
            self._server.close(close_connections=True)

    def _process(self, connection: ServerConnection, request: Request) -> Response | None:
        response = self._judge(request)
        target = target_of(request.path)
        asker = self._keys.asker(next(iter(target.query.get("key", ())), "")) if target else None
        with_key = asker is not None and asker.role != "look"
        if response is None and not self._has_place(with_key):
            response = answer(HTTPStatus.SERVICE_UNAVAILABLE, f"{self._places} are connected already\n")
        if response is None:
            self._door.pop(connection, None)
            self._inside[connection] = with_key
        return response

    def _has_place(self, with_key: bool) -> bool:
        """Whether a place is free, or can be made free."""
        if len(self._inside) < self._places:
            return True
        without = [one for one, has_key in self._inside.items() if not has_key]
        if not with_key or not without:
            return False
        del self._inside[without[0]]
        without[0].transport.abort()
        return True

    def came(self, connection: ServerConnection) -> None:
        """A connection was opened."""
        self._door[connection] = None
        if len(self._door) > AT_THE_DOOR:
            oldest = next(iter(self._door))
            del self._door[oldest]
            oldest.transport.abort()

    def went(self, connection: ServerConnection) -> None:
        """A connection was closed."""
        self._door.pop(connection, None)
        self._inside.pop(connection, None)


class _Connection(ServerConnection):
    """A connection that reports opening and closing, and closes when it receives too much."""

    def __init__(self, owner: Listener, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._owner = owner
        self._tokens, self._tokens_s = BURST, time.monotonic()

    def data_received(self, data: bytes) -> None:
        for at in range(0, len(data), READ_BYTES):
            if self.transport.is_closing():
                return
            super().data_received(data[at : at + READ_BYTES])

    def process_event(self, event: Event) -> None:
        if isinstance(event, Frame) and not self._counted(event):
            self.transport.abort()
            return
        super().process_event(event)

    def _counted(self, frame: Frame) -> bool:
        now_s = time.monotonic()
        self._tokens = min(BURST, self._tokens + (now_s - self._tokens_s) * RATE_HZ)
        self._tokens -= 1 + len(frame.data) // COUNTED_BYTES
        self._tokens_s = now_s
        return self._tokens >= 0.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._owner.came(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._owner.went(self)
        super().connection_lost(exc)


def answer(status: HTTPStatus, text: str, more: dict[str, str] | None = None) -> Response:
    """A response of HTTP, after which the connection is closed."""
    body = text.encode()
    given = more or headers(TEXT)
    head = Headers([*given.items(), ("Content-Length", str(len(body))), ("Connection", "close")])
    return Response(status.value, status.phrase, head, body)
