"""The workbench over HTTP, on this machine alone: the page, its state, what it asks for, pages that were written.

The first part of every path is a key, and the key says what may be done. A request must name us as its host, and one
that changes something must come from our own page. Whatever a request is, it has an answer, or the connection is
closed: nobody who sends half of one, or none, holds a thread for long or keeps others out.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import re
import socket
import sys
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NoReturn

from ..documents import DocumentError, json_object
from ..live.http_rules import HTML, JSON, TEXT, headers, is_one_of, target_of, written_page
from ..live.keys import Asker
from ..roles import Role, may
from .actions import ACTIONS
from .bench import ForbiddenError, Workbench
from .jobs import BusyError
from .page import allowed, page

HOST = "127.0.0.1"
LARGEST_BYTES = 1 << 30  # of a file that is taken in
LARGEST_WISH_BYTES = 1 << 16
STALLED_S = 5.0  # a page that does not read what it is sent for so long is cut off
REQUEST_S, IDLE_S = 10.0, 60.0  # for a request, from its first byte on; between two of one connection
LEAST_BYTES_PER_S = 1 << 14  # of what is taken in
MOST_WAITING = 64  # connections that have not sent their request; one more cuts off the one that waits longest
LINGER_S = 1.0  # what still comes after the last answer is read: dropped unread, it would take the answer with it
BLOCK_BYTES = 1 << 16
SHOWN = {".html": HTML, ".json": JSON, ".yaml": TEXT, ".svg": "image/svg+xml", ".png": "image/png"}
GONE = (ConnectionError, TimeoutError)  # the other end, while it was answered
_LENGTH = re.compile(r"[0-9]{1,18}")
INTERRUPT_S = 0.5  # longest until Ctrl-C is seen


class WorkbenchServer:
    """Serves a workbench from `start` to `close`."""

    def __init__(self, bench: Workbench, port: int = 0) -> None:
        """`port`: 0 is any that is free. Raises OSError where it cannot be had."""
        self.bench = bench
        handler = type("BoundHandler", (_Handler,), {"workbench": bench})
        self._server = _Server((HOST, port), handler)
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


class _Server(ThreadingHTTPServer):
    """A thread for each connection, and a time for each request."""

    daemon_threads = True
    request_queue_size = MOST_WAITING

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._due_s: dict[socket.socket, float] = {}  # of those that wait for a request, the longest first
        self._lock = threading.Lock()
        super().__init__(address, handler)

    def expect(self, connection: socket.socket, for_s: float) -> None:
        """More of a request must come within this time, or the connection is cut off."""
        with self._lock:
            self._due_s[connection] = time.monotonic() + for_s
            if len(self._due_s) > MOST_WAITING:
                self._cut_off(next(iter(self._due_s)))

    def arrived(self, connection: socket.socket) -> None:
        """What was waited for has come."""
        with self._lock:
            self._due_s.pop(connection, None)

    def _cut_off(self, connection: socket.socket) -> None:
        del self._due_s[connection]
        with contextlib.suppress(OSError):  # it has left by itself
            connection.shutdown(socket.SHUT_RDWR)

    def service_actions(self) -> None:
        """Called by `serve_forever` every half second."""
        now_s = time.monotonic()
        with self._lock:
            for connection in [one for one, due_s in self._due_s.items() if due_s < now_s]:
                self._cut_off(connection)

    def shutdown_request(self, request: Any) -> None:
        """The end of a connection: what was answered is read before it is closed."""
        self.arrived(request)
        with contextlib.suppress(OSError):
            request.shutdown(socket.SHUT_WR)
            request.settimeout(LINGER_S)
            ending_s = time.monotonic() + LINGER_S
            while time.monotonic() < ending_s and request.recv(BLOCK_BYTES):
                pass
        self.close_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A connection that has gone is no error."""
        if not isinstance(sys.exc_info()[1], GONE):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """The requests of one connection."""

    workbench: Workbench
    server: _Server
    server_version = "fffo-drive"
    sys_version = ""
    protocol_version = "HTTP/1.1"
    default_request_version = "HTTP/1.0"  # what has none is answered with a head all the same
    _patience_s = REQUEST_S

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the key would stand in it."""

    def handle_one_request(self) -> None:
        """Wait for a request, and answer it."""
        self.connection.settimeout(None)
        self.server.expect(self.connection, self._patience_s)
        self._patience_s = IDLE_S
        if self.rfile.peek(1):  # type: ignore[attr-defined]  # a BufferedReader
            self.server.expect(self.connection, REQUEST_S)
            super().handle_one_request()
        else:
            self.close_connection = True

    def parse_request(self) -> bool:
        """Whether the head is one of HTTP/1; else it was answered."""
        words: list[bytes] = self.raw_requestline.split()  # type: ignore[attr-defined]  # set by its caller
        if words and not words[-1].startswith(b"HTTP/"):
            self.requestline, self.command, self.request_version = "", "", self.protocol_version
            self.send_error(HTTPStatus.BAD_REQUEST.value, "no request of HTTP/1")
            return False
        whole = super().parse_request()
        self.server.arrived(self.connection)
        return whole

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """An answer to what is not understood, after which the connection is closed."""
        self.close_connection = True
        status = HTTPStatus(code)
        self._json(status, {"error": message or status.phrase})

    def do_GET(self) -> None:
        """The page, its state, a page that was written."""
        more = self.headers.get("Content-Length", "0") != "0"
        if more or any(name in self.headers for name in ("Transfer-Encoding", "Upgrade")):
            self.close_connection = True  # what follows is no request
        self._work(self._look)

    def do_HEAD(self) -> None:
        """As GET, without the body."""
        self.do_GET()

    def do_POST(self) -> None:
        """What the page asks for."""
        self._work(self._change)

    def _work(self, work: Callable[[Asker, str], None]) -> None:
        found = self._judged()
        if found is None:
            return
        try:
            work(*found)
        except GONE:
            raise
        except Exception as error:  # a mistake of ours is answered, too
            text = f"{type(error).__name__}: {error}"
            print(f"fffo-drive workbench: {self.command} {found[1]!r}: {text}", file=sys.stderr)
            self.send_error(HTTPStatus.INTERNAL_SERVER_ERROR.value, f"the workbench failed: {text}")

    def _look(self, asker: Asker, rest: str) -> None:
        if rest == "":
            self._answer(HTTPStatus.OK, page().encode(), headers(HTML, allowed()))
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

    def _change(self, asker: Asker, rest: str) -> None:
        if not is_one_of(self.headers.get_all("Origin"), [self.headers.get("Host", "")], "http://"):
            self.send_error(HTTPStatus.FORBIDDEN.value, "not from this page")
            return
        body = self._body(LARGEST_BYTES if rest == "take" and may(asker.role, "move") else LARGEST_WISH_BYTES)
        if body is None:
            return
        try:
            done = self._do(asker, rest, body)
        except ForbiddenError as error:
            self._json(HTTPStatus.FORBIDDEN, {"error": str(error)})
        except BusyError as error:
            self._json(HTTPStatus.CONFLICT, {"error": str(error)})
        except (DocumentError, OSError) as error:
            self._json(HTTPStatus.BAD_REQUEST, {"error": str(error)})
        else:
            self._json(HTTPStatus.OK, done)

    def _body(self, largest: int) -> bytes | None:
        """What was sent with the head; None where it cannot be taken, which was answered."""
        lengths = self.headers.get_all("Content-Length") or []
        if not lengths or "Transfer-Encoding" in self.headers:  # a head that was cut off may have lost it
            self.send_error(HTTPStatus.LENGTH_REQUIRED.value, "a Content-Length is needed")
            return None
        if len(lengths) > 1 or not _LENGTH.fullmatch(lengths[0]):
            self.send_error(HTTPStatus.BAD_REQUEST.value, "Content-Length: one number of bytes is needed")
            return None
        size = int(lengths[0])
        if size > largest:
            self.send_error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE.value, f"at most {largest:,} bytes can be taken in")
            return None
        self.server.expect(self.connection, REQUEST_S + size / LEAST_BYTES_PER_S)
        body = self.rfile.read(size)
        self.server.arrived(self.connection)
        if len(body) < size:  # of a file that is taken in, a part would look like the whole
            self.send_error(HTTPStatus.BAD_REQUEST.value, "the request was cut off: nothing was done")
            return None
        return body

    def _do(self, asker: Asker, what: str, body: bytes) -> dict[str, Any]:
        if what == "take":
            target = target_of(self.path)
            self.workbench.take(asker, target.query.get("name", [""])[0] if target else "", body)
            return {}
        try:
            wish = json_object(body or b"{}")
        except ValueError as error:
            raise DocumentError(f"not understood ({error}): a JSON object is needed") from None
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
        for name, value in headers("text/event-stream").items():
            self.send_header(name, value)
        self.end_headers()
        with contextlib.closing(messages), contextlib.suppress(OSError, DocumentError):
            for message in itertools.chain((first,), messages):
                self.wfile.write(b"data: " + json.dumps(message).encode() + b"\n\n")

    def _judged(self) -> tuple[Asker, str] | None:
        """(who asks, rest of the path); None where an answer was given: another host, no key."""
        port = self.connection.getsockname()[1]
        if not is_one_of(self.headers.get_all("Host"), [f"{name}:{port}" for name in (HOST, "localhost")]):
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST.value, f"this is http://{HOST}:{port}/")
            return None
        target = target_of(self.path)
        if target is None:
            self.send_error(HTTPStatus.BAD_REQUEST.value, "no address that a browser sends")
            return None
        key, _, rest = target.path.lstrip("/").partition("/")
        asker = self.workbench.keys.asker(key)
        if asker is None:
            self.send_error(
                HTTPStatus.NOT_FOUND.value, "not here: open the address that `fffo-drive workbench` printed"
            )
            return None
        return asker, rest

    def _file(self, name: str) -> None:
        """A file under the bench's directory."""
        kind = content = None
        with contextlib.suppress(OSError):  # of a name that no file may have, too
            path = (self.workbench.directory / name).resolve()
            kind = SHOWN.get(path.suffix)
            if kind is not None and path.is_relative_to(self.workbench.directory.resolve()) and path.is_file():
                content = path.read_bytes()
        if kind is None or content is None:
            self._json(HTTPStatus.NOT_FOUND, {"error": f"{name}: not here"})
            return
        self._answer(HTTPStatus.OK, content, headers(kind, written_page(content), framed=True))

    def _json(self, status: HTTPStatus, content: Any) -> None:
        self._answer(status, json.dumps(content).encode(), headers(JSON))

    def _answer(self, status: HTTPStatus, body: bytes, head: dict[str, str]) -> None:
        self.connection.settimeout(STALLED_S)
        self.send_response(status.value)
        for name, value in head.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        sent = b"" if self.command == "HEAD" else body
        for begin in range(0, len(sent), BLOCK_BYTES):  # a time-out is of a whole write
            self.wfile.write(sent[begin : begin + BLOCK_BYTES])
