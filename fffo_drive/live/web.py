"""The scope over HTTP: the page on `/`, a WebSocket on `/live`, nothing else, and for nobody but our own page.

A request must name us as its host, a WebSocket must come from our own page (Origin). That lets a page look; what it may
ask for beyond that is the key's affair.
"""

from __future__ import annotations

from http import HTTPStatus
from urllib.parse import urlsplit

from websockets.http11 import Request, Response

from ..config.address import Address
from .hub import Hub
from .listener import Listener, answer
from .page import headers, page

PATH = "/live"
PAGES = 8
MESSAGE_BYTES = 4096


class Web:
    """Listens from `start` to `close`, on the live server's thread."""

    def __init__(self, address: Address, hub: Hub) -> None:
        self._listener = Listener(address, hub.serve, self._judge, PAGES, hub.keys, MESSAGE_BYTES)

    async def start(self) -> Address:
        """Listen. Returns where. Raises OSError when the address cannot be had."""
        return await self._listener.start()

    def close(self) -> None:
        """Stop listening, drop everybody."""
        self._listener.close()

    def _judge(self, request: Request) -> Response | None:
        """The page, the WebSocket, or why not."""
        names = self._listener.address.names
        if request.headers.get_all("Host") not in [[name] for name in names]:
            return answer(HTTPStatus.MISDIRECTED_REQUEST, f"this is http://{names[0]}/\n")
        path = urlsplit(request.path).path
        if path == "/":
            return answer(HTTPStatus.OK, page(), headers())
        if path != PATH:
            return answer(HTTPStatus.NOT_FOUND, "not here\n")
        if request.headers.get_all("Origin") not in [[f"http://{name}"] for name in names]:
            return answer(HTTPStatus.FORBIDDEN, "not from this page\n")
        return None
