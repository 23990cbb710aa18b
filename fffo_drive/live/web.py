"""The scope over HTTP: the page at `/` and a WebSocket at `/live`, for our own page only.

A request must name us as its host, and a WebSocket must come from our own page (Origin). That allows a page to look;
its key decides the rest.
"""

from __future__ import annotations

from http import HTTPStatus

from websockets.http11 import Request, Response

from ..config.address import Address
from .http_rules import HTML, headers, is_one_of, target_of
from .hub import Hub
from .listener import Listener, answer
from .page import allowed, page

PATH = "/live"
PAGES = 8
MESSAGE_BYTES = 4096


class Web:
    """Listens from `start` to `close`, on the live server's thread."""

    def __init__(self, address: Address, hub: Hub) -> None:
        self._listener = Listener(address, hub.serve, self._judge, PAGES, hub.keys, MESSAGE_BYTES)

    async def start(self) -> Address:
        """Listen. Returns the address. Raises OSError when it is not available."""
        return await self._listener.start()

    def close(self) -> None:
        """Stop listening, drop everybody."""
        self._listener.close()

    def _judge(self, request: Request) -> Response | None:
        """None for the WebSocket, else the page, or a refusal."""
        names = self._listener.address.names
        if not is_one_of(request.headers.get_all("Host"), names):
            return answer(HTTPStatus.MISDIRECTED_REQUEST, f"this is http://{names[0]}/\n")
        target = target_of(request.path)
        if target is None:
            return answer(HTTPStatus.BAD_REQUEST, "no address that a browser sends\n")
        if target.path == "/":
            return answer(HTTPStatus.OK, page(), headers(HTML, allowed()))
        if target.path != PATH:
            return answer(HTTPStatus.NOT_FOUND, "not here\n")
        if not is_one_of(request.headers.get_all("Origin"), names, "http://"):
            return answer(HTTPStatus.FORBIDDEN, "not from this page\n")
        return None
