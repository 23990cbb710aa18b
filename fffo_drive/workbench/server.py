"""The workbench over HTTP, on this machine alone: the page, its state, what it asks for, pages that were written.

The first part of every path is a key, and the key says what may be done. A request must name us as its host, and one
that changes something must come from our own page.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NoReturn
from urllib.parse import parse_qs, unquote, urlsplit

from ..documents import DocumentError
from ..live.keys import Asker
from ..roles import Role, may
from .actions import ACTIONS
from .bench import ForbiddenError, Workbench
from .jobs import BusyError
from .page import headers, page

HOST = "127.0.0.1"
LARGEST_BYTES = 1 << 30  # of a file that is taken in
LARGEST_WISH_BYTES = 1 << 16
STALLED_S = 5.0  # a page that does not read what it is sent for so long is cut off
SHOWN = {".html": "text/html; charset=utf-8", ".json": "application/json", ".yaml": "text/plain; charset=utf-8",
         ".svg": "image/svg+xml", ".png": "image/png"}  # fmt: skip
INTERRUPT_S = 0.5  # longest until Ctrl-C is seen


class WorkbenchServer:
    """Serves a workbench from `start` to `close`."""

    def __init__(self, bench: Workbench, port: int = 0) -> None:
        """`port`: 0 is any that is free. Raises OSError where it cannot be had."""
        self.bench = bench
        handler = type("BoundHandler", (_Handler,), {"workbench": bench})
        self._server = ThreadingHTTPServer((HOST, port), handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    def start(self) -> None:
        """Serve, on a thread of its own."""
        self._thread.start()

    def url(self, role: Role) -> str:
        """The address that gives a role."""
        return f"http://{HOST}:{self._server.server_address[1]}/{self.bench.keys.of(role)}/"

    def wait(self) -> NoReturn:
        """Until it is interrupted: raises KeyboardInterrupt."""
        while True:  # the kernel may give the signal to another thread, which does not wake this one
            self._thread.join(INTERRUPT_S)

    def close(self) -> None:
        """Cancel what runs, stop serving."""
        self.bench.close()
        self._server.shutdown()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    """One request."""

    workbench: Workbench
    server_version = "fffo-drive"
    sys_version = ""
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the key would stand in it."""

    def handle(self) -> None:
        """As usual; a page that has gone meanwhile is no error."""
        with contextlib.suppress(ConnectionError):
            super().handle()

    def do_GET(self) -> None:
        """The page, its state, a page that was written."""
        found = self._judged()
        if found is None:
            return
        asker, rest = found
        if rest == "":
            self._answer(HTTPStatus.OK, page().encode(), headers())
        elif rest == "state":
            self._json(HTTPStatus.OK, self.workbench.state(asker))
        elif rest == "fleet":
            self._asked(self.workbench.fleet)
        elif rest == "axis/live":
            self._live()
        elif rest == "axis/info":
            self._asked(lambda: self.workbench.served.info(self.workbench.sockets()))
        elif rest.startswith("checks/"):
            self._asked(lambda: self.workbench.jobs.checks(rest.removeprefix("checks/")))
        elif rest.startswith("axis/trial/"):
            self._asked(lambda: self.workbench.served.trial(rest.removeprefix("axis/trial/")))
        elif rest.startswith("files/"):
            self._file(rest.removeprefix("files/"))
        else:
            self._json(HTTPStatus.NOT_FOUND, {"error": "not here"})

    def _asked(self, what: Callable[[], Any]) -> None:
        try:
            self._json(HTTPStatus.OK, what())
        except DocumentError as error:
            self._json(HTTPStatus.NOT_FOUND, {"error": str(error)})

    def do_POST(self) -> None:
        """What the page asks for."""
        found = self._judged()
        if found is None:
            return
        asker, rest = found
        host = self.headers.get("Host", "")
        if self.headers.get("Origin") != f"http://{host}":
            self._json(HTTPStatus.FORBIDDEN, {"error": "not from this page"})
            return
        size = int(self.headers.get("Content-Length") or 0)
        largest = LARGEST_BYTES if rest == "take" and may(asker.role, "move") else LARGEST_WISH_BYTES
        if not 0 <= size <= largest:
            self.close_connection = True  # the body is not read
            self._json(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, {"error": f"at most {largest:,} bytes can be taken in"})
            return
        body = self.rfile.read(size)
        if len(body) < size:  # of a file that is taken in, a part would look like the whole
            self.close_connection = True
            self._json(HTTPStatus.BAD_REQUEST, {"error": "the request was cut off: nothing was done"})
            return
        try:
            self._json(HTTPStatus.OK, self._do(asker, rest, body))
        except ForbiddenError as error:
            self._json(HTTPStatus.FORBIDDEN, {"error": str(error)})
        except BusyError as error:
            self._json(HTTPStatus.CONFLICT, {"error": str(error)})
        except (DocumentError, OSError) as error:
            self._json(HTTPStatus.BAD_REQUEST, {"error": str(error)})

    def _do(self, asker: Asker, what: str, body: bytes) -> dict[str, Any]:
        if what == "take":
            name = parse_qs(urlsplit(self.path).query).get("name", [""])[0]
            self.workbench.take(asker, name, body)
            return {}
        try:
            wish = json.loads(body or b"{}")
        except ValueError:
            wish = None
        if not isinstance(wish, dict):
            raise DocumentError("not understood: a JSON object is needed")
        if what == "cancel":
            self.workbench.cancel(asker, wish.get("service"))
            return {}
        if what == "answer":
            self.workbench.answer(asker, wish)
            return {}
        if what == "use_axis":
            self.workbench.use_axis(asker, wish.get("path"))
            return {}
        if what == "axis/here":
            self.workbench.served.heard(wish.get("page"))
            return {}
        if what == "axis/try_gain":
            return self.workbench.try_gain(asker, wish)
        if what.startswith("axis/"):
            return {"result": self.workbench.ask(asker, what.removeprefix("axis/"), wish)}
        if what not in ACTIONS:
            raise DocumentError(f"no action is called {what!r}; known: {', '.join(ACTIONS)}")
        return self.workbench.act(asker, what, wish)

    def _live(self) -> None:
        """The axis as its daemon tells it, as server-sent events, until one of the two is gone."""
        try:
            messages = self.workbench.served.messages(self.workbench.sockets())
            first = next(messages)
        except DocumentError as error:
            self._json(HTTPStatus.SERVICE_UNAVAILABLE, {"error": str(error)})
            return
        self.close_connection = True
        self.connection.settimeout(STALLED_S)
        self.send_response(HTTPStatus.OK.value)
        for name, value in (("Content-Type", "text/event-stream"), ("Cache-Control", "no-store")):
            self.send_header(name, value)
        self.end_headers()
        with contextlib.closing(messages), contextlib.suppress(OSError, DocumentError):
            for message in itertools.chain((first,), messages):
                self.wfile.write(b"data: " + json.dumps(message).encode() + b"\n\n")

    def _judged(self) -> tuple[Asker, str] | None:
        """(who asks, rest of the path); None where an answer was given: another host, no key."""
        port = self.connection.getsockname()[1]
        if self.headers.get_all("Host") not in [[f"{name}:{port}"] for name in (HOST, "localhost")]:
            self._json(HTTPStatus.MISDIRECTED_REQUEST, {"error": f"this is http://{HOST}:{port}/"})
            return None
        key, _, rest = unquote(urlsplit(self.path).path).lstrip("/").partition("/")
        asker = self.workbench.keys.asker(key)
        if asker is None:
            self._json(
                HTTPStatus.NOT_FOUND, {"error": "not here: open the address that `fffo-drive workbench` printed"}
            )
            return None
        return asker, rest

    def _file(self, name: str) -> None:
        """A file under the bench's directory."""
        path = (self.workbench.directory / name).resolve()
        kind = SHOWN.get(path.suffix)
        if kind is None or not path.is_relative_to(self.workbench.directory.resolve()) or not path.is_file():
            self._json(HTTPStatus.NOT_FOUND, {"error": f"{name}: not here"})
            return
        self._answer(HTTPStatus.OK, path.read_bytes(), {"Content-Type": kind, "X-Content-Type-Options": "nosniff"})

    def _json(self, status: HTTPStatus, content: Any) -> None:
        self._answer(status, json.dumps(content).encode(), {"Content-Type": "application/json"})

    def _answer(self, status: HTTPStatus, body: bytes, more: dict[str, str]) -> None:
        self.send_response(status.value)
        for name, value in {**more, "Cache-Control": "no-store", "Referrer-Policy": "no-referrer"}.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)
