"""The thread that owns the sockets: it accepts, reads, splits lines, and recognises a stop on arrival.

Data from clients of the control socket are read at once, up to a bound, and the lines are queued here. A line that
requests a stop goes to the supervisor before anything else is parsed, uses no budget, and is accepted beyond the limit
of clients. Read-only clients are read after that, for a short time each, and cannot delay others. All other lines are
answered one at a time, clients in turn, from a budget of bytes per second shared by all clients of a socket.

Each line carries the epoch in which it arrived. Before a stop is acknowledged, everything still in the sockets is read
and assigned to the ending epoch: a start sent before the acknowledgement is never carried out after it.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable

from . import rpc
from .one_client import CONTROL_LIMITS, WATCH_LIMITS, Budget, Client, Handler, ReceivedLine
from .rpc import RpcError
from .states import Epoch

READ_BYTES = 256 * 1024  # more than the kernel buffers for a Unix socket: one read empties it
WATCH_READ_BYTES = 8 * 1024
SEND_LIMIT = 256 * 1024  # unsent bytes for a client before it is disconnected
WAITING_LINES = 1000  # of one client, before it is cut off
WAITING_CALLS = 16  # unanswered calls of one client to the supervisor
STOP_LINE_BYTES = 4096  # a line that requests a stop is shorter
IDLE_S = 300.0
PARTIAL_S = 10.0  # for the rest of a line
STOP_PLACES = 64  # connections to the control socket beyond the limit, for stops only
STOP_PLACE_S = 2.0
BACKLOG = 128
ACCEPTS_PER_ROUND = 64
WATCH_ACCEPTS_PER_ROUND = 4
PAUSE_S = 0.05  # pause of a listening socket with too many clients, or without free file descriptors
ROUND_S = 0.25  # the longest time between checks for silent clients
SHARE_S = 0.002  # for read-only clients and answers before the control socket is read again: the longest wait of a stop
BUDGET_WAIT_S = 0.01

ENDING = ("stop", "disable", "quick_stop")  # methods
_STOP = re.compile(rb'"method"\s*:\s*"(?:' + "|".join(ENDING).encode() + rb')"')


class Clients:
    """Both sockets and all their clients, from `start` to `close`."""

    def __init__(self, sockets: tuple[socket.socket, socket.socket], handler: Handler, epoch: Epoch, most: int) -> None:
        """`sockets`: listening, for control and for watching; `most`: clients of each, at a time."""
        self._listeners, self._handler, self._epoch, self._most = list(sockets), handler, epoch, most
        self._control, self._watch = selectors.DefaultSelector(), selectors.EpollSelector()
        self._first = 0  # order of the read-only clients
        self._buffer = memoryview(bytearray(READ_BYTES))
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._waking = threading.Lock()  # so that a file descriptor reused for another file is not written to
        self._posts: deque[Callable[[], None]] = deque()
        self._clients: dict[int, Client] = {}
        self._turn: deque[Client] = deque()  # those whose lines wait
        self._stamp: int | None = None  # epoch of what is read before an acknowledgement
        self._too_poor = False  # no client with queued lines has enough budget for one
        now_s = time.monotonic()
        self._budgets = {False: Budget(CONTROL_LIMITS, now_s), True: Budget(WATCH_LIMITS, now_s)}
        self._paused: dict[bool, float] = {}  # listeners, until then
        self._looked_s = now_s
        self._ending = False
        self.failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="fffo-clients", daemon=True)

    # -- from any thread -------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin to listen."""
        for listener, watching in zip(self._listeners, (False, True), strict=True):
            listener.setblocking(False)
            listener.listen(BACKLOG)
            self._selector(watching).register(listener, selectors.EVENT_READ, watching)
        self._control.register(self._wake, selectors.EVENT_READ, self._wake)
        self._control.register(self._watch, selectors.EVENT_READ, self._watch)
        self._thread.start()

    def close(self, timeout_s: float = 1.0) -> None:
        """Disconnect all clients and end the thread."""
        self._ending = True
        with self._waking:
            os.eventfd_write(self._wake, 1)
        self._thread.join(timeout_s)
        with self._waking:
            wake, self._wake = self._wake, -1
            os.close(wake)

    def post(self, what: Callable[[], None]) -> None:
        """Schedule this on the clients' thread."""
        self._posts.append(what)
        with self._waking:
            if self._wake >= 0:
                os.eventfd_write(self._wake, 1)

    def listen_on(self, watching: bool, listener: socket.socket) -> None:
        """Accept connections here in place of the listener before. On the clients' thread."""
        selector, before = self._selector(watching), self._listeners[watching]
        if watching in self._paused:
            del self._paused[watching]
        else:
            selector.unregister(before)
        before.close()
        listener.listen(BACKLOG)
        self._listeners[watching] = listener
        selector.register(listener, selectors.EVENT_READ, watching)

    @property
    def count(self) -> int:
        """Connections."""
        return len(self._clients)

    @property
    def anybody_listens(self) -> bool:
        """Whether any client has subscribed to statuses."""
        return any(client.status_period_s for client in list(self._clients.values()))

    # -- its own thread --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while not self._ending:
                if self._read_control(self._patience_s()):
                    self._read_watch()
                self._run_posts()
                self._answer()
                self._look_after(time.monotonic())
        except BaseException as error:
            self.failure = error
        finally:
            for client in list(self._clients.values()):
                self._flush(client)
                self._drop(client)
            self._watch.close()
            self._control.close()
            for listener in self._listeners:
                listener.close()

    def _patience_s(self) -> float:
        if self._posts:
            return 0.0
        if self._turn:
            return BUDGET_WAIT_S if self._too_poor else 0.0
        return ROUND_S

    def _selector(self, watching: bool) -> selectors.BaseSelector:
        return self._watch if watching else self._control

    def _read_control(self, patience_s: float) -> bool:
        """Read all data that have arrived on the control socket. Return whether data are waiting on the other."""
        watched = False
        for key, events in self._control.select(patience_s):
            if key.data is self._watch:
                watched = True
            elif key.data is self._wake:
                with contextlib.suppress(BlockingIOError):
                    os.eventfd_read(self._wake)
            else:
                self._serve(key, events)
        return watched

    def _read_watch(self) -> None:
        """Read some of the read-only clients that have data, in turn."""
        begun_s = time.monotonic()
        ready = self._watch.select(0)
        for _ in ready:
            if time.monotonic() - begun_s > SHARE_S:
                return
            self._first += 1
            self._serve(*ready[self._first % len(ready)])

    def _serve(self, key: selectors.SelectorKey, events: int) -> None:
        if isinstance(key.data, bool):
            self._accept(key.fileobj, key.data)  # type: ignore[arg-type]
            return
        client = key.data
        if events & selectors.EVENT_READ and not client.closed:
            self._read(client)
        if events & selectors.EVENT_WRITE:
            self._flush(client)

    def _run_posts(self) -> None:
        for _ in range(len(self._posts)):
            self._posts.popleft()()

    # connections

    def _accept(self, listener: socket.socket, watching: bool) -> None:
        for _ in range(WATCH_ACCEPTS_PER_ROUND if watching else ACCEPTS_PER_ROUND):
            try:
                sock, _ = listener.accept()
            except BlockingIOError:
                return
            except OSError as error:  # out of file descriptors: existing clients come first
                self._handler.turned_away(watching, f"no connection can be accepted: {os.strerror(error.errno or 0)}")
                self._pause(watching)
                return
            self._let_in(sock, watching)

    def _let_in(self, sock: socket.socket, watching: bool) -> None:
        limits = WATCH_LIMITS if watching else CONTROL_LIMITS
        here = sum(client.watching == watching and client.has_place for client in self._clients.values())
        place = here < self._most
        if not place:
            self._handler.turned_away(watching, f"{self._most} clients are connected already (daemon.clients)")
            if watching:
                _farewell(sock, self._full())
                self._pause(watching)
                return
            self._make_room_for_a_stop()
        sock.setblocking(False)
        client = Client(sock, watching, limits, time.monotonic(), place)
        self._clients[sock.fileno()] = client
        self._await(client)
        self._read(client)

    def _full(self) -> str:
        return f"cut off: {self._most} clients are connected already (daemon.clients)"

    def _make_room_for_a_stop(self) -> None:
        """Disconnect the oldest connection beyond the limit, unless its stop is in progress."""
        beyond = [client for client in self._clients.values() if not client.has_place and not client.calls]
        if len(beyond) >= STOP_PLACES:
            self._drop(beyond[0])

    def _pause(self, watching: bool) -> None:
        """Leave new connections in the kernel's queue for a moment."""
        if watching not in self._paused:
            self._paused[watching] = time.monotonic() + PAUSE_S
            self._selector(watching).unregister(self._listeners[watching])

    # what comes in

    def _read(self, client: Client) -> None:
        try:
            count = client.sock.recv_into(self._buffer, WATCH_READ_BYTES if client.watching else READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            self._drop(client)
            return
        if not count:
            client.ended = True
            self._await(client)
            if _hung_up(client.sock):
                self._drop(client)
            self._drop_when_done(client)
            return
        client.heard_s = time.monotonic()
        epoch = self._epoch.value if self._stamp is None else self._stamp
        *whole, rest = bytes(self._buffer[:count]).split(b"\n")
        if whole:
            whole[0] = bytes(client.partial) + whole[0]
            client.partial = bytearray(rest)
        else:
            client.partial += rest
        for content in whole:
            if client.closed:
                return
            if content.strip():
                self._arrived(client, ReceivedLine(content, epoch))
        if len(client.partial) > client.limits.line_bytes:
            self.cut_off(client, f"a line is longer than {client.limits.line_bytes} bytes")

    def _arrived(self, client: Client, line: ReceivedLine) -> None:
        size = len(line.content)
        express = not (client.watching or client.no_stop) and size <= STOP_LINE_BYTES and _STOP.search(line.content)
        if express:
            if self._handler.stop_line(client, line):
                return
            client.no_stop = True
        if not client.has_place:
            self.send(client, rpc.encode(rpc.error_of(None, RpcError(rpc.LIMIT, self._only_a_stop()))))
        elif size > client.limits.line_bytes:
            self.cut_off(client, f"a line is longer than {client.limits.line_bytes} bytes")
        elif client.waiting_bytes + size > client.limits.waiting_bytes or len(client.lines) >= WAITING_LINES:
            self.cut_off(client, "more was asked than can wait here")
        else:
            client.lines.append(line)
            client.waiting_bytes += size
            if len(client.lines) == 1:
                self._turn.append(client)

    def _only_a_stop(self) -> str:
        return (
            f"{self._most} clients are connected already (daemon.clients); {', '.join(ENDING)} are taken all the same"
        )

    def end_epoch(self) -> int:
        """Read everything in the sockets as of the present epoch, then begin a new one and return it."""
        self._stamp = self._epoch.value
        self._read_control(0.0)
        self._stamp = None
        return self._epoch.advance()

    # whose turn it is

    def _answer(self) -> None:
        """Answer lines for a short time; then data that have arrived meanwhile are read."""
        begun_s = now_s = time.monotonic()
        while now_s - begun_s < SHARE_S and self._answer_one(now_s):
            now_s = time.monotonic()

    def _answer_one(self, now_s: float) -> bool:
        """Answer one line of the first client with enough budget. False if there is none."""
        self._too_poor = True
        for _ in range(len(self._turn)):
            client = self._turn.popleft()
            if client.closed or not client.lines:
                continue
            if client.calls >= WAITING_CALLS or not self._budgets[client.watching].take(
                len(client.lines[0].content), now_s
            ):
                self._turn.append(client)
                continue
            line = client.lines.popleft()
            client.waiting_bytes -= len(line.content)
            if client.lines:
                self._turn.append(client)
            else:
                client.no_stop = False
            self._too_poor = False
            self._handler.line(client, line)
            self._drop_when_done(client)
            return True
        return False

    # what goes out

    def send(self, client: Client, line: bytes) -> None:
        """Send one encoded line; a client that does not read is disconnected."""
        if client.closed:
            return
        if len(client.out) + len(line) > SEND_LIMIT:
            self.cut_off(client, "too slow: what was sent is not read")
            return
        client.out += line
        self._flush(client)

    def broadcast_event(self, line: bytes) -> None:
        """Send to all clients that subscribed to events."""
        for client in list(self._clients.values()):
            if client.wants_events:
                self.send(client, line)

    def broadcast_status(self) -> None:
        """Send a status, encoded once, to all clients for which it is due."""
        now_s = time.monotonic()
        line: bytes | None = None
        for client in list(self._clients.values()):
            if client.status_period_s and now_s >= client.status_due_s:
                line = line or self._handler.status_line()
                client.status_due_s = max(client.status_due_s + client.status_period_s, now_s)
                self.send(client, line)

    def _flush(self, client: Client) -> None:
        if client.closed:
            return
        try:
            while client.out:
                sent = client.sock.send(client.out)
                del client.out[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(client)
            return
        self._await(client)
        self._drop_when_done(client)

    def _await(self, client: Client) -> None:
        """Update the selector; a client that has closed its side would be ready to read for ever."""
        wanted = (0 if client.ended else selectors.EVENT_READ) | (selectors.EVENT_WRITE if client.out else 0)
        if wanted == client.awaited:
            return
        selector = self._selector(client.watching)
        if not client.awaited:
            selector.register(client.sock, wanted, client)
        elif not wanted:
            selector.unregister(client.sock)
        else:
            selector.modify(client.sock, wanted, client)
        client.awaited = wanted

    # the end of a connection

    def answered(self, client: Client) -> None:
        """Called when a line passed to the supervisor has its answer."""
        client.calls -= 1
        self._drop_when_done(client)

    def _drop_when_done(self, client: Client) -> None:
        """Whether it has closed its side, and all its requests are answered."""
        if client.ended and not (client.lines or client.calls or client.out or client.closed):
            self._drop(client)

    def cut_off(self, client: Client, reason: str) -> None:
        """Send the reason, then disconnect."""
        if client.closed:
            return
        self._handler.cut_off(client, reason)
        farewell = rpc.encode(rpc.error_of(None, RpcError(rpc.LIMIT, f"cut off: {reason}")))
        with contextlib.suppress(OSError):
            client.sock.send(bytes(client.out) + farewell)
        self._drop(client)

    def _drop(self, client: Client) -> None:
        if client.closed:
            return
        client.closed = True
        del self._clients[client.sock.fileno()]
        if client.awaited:
            self._selector(client.watching).unregister(client.sock)
        client.sock.close()
        client.lines.clear()
        self._handler.left(client)

    def _look_after(self, now_s: float) -> None:
        """Listen again, and disconnect silent clients."""
        for watching, until_s in list(self._paused.items()):
            if now_s >= until_s:
                del self._paused[watching]
                self._selector(watching).register(self._listeners[watching], selectors.EVENT_READ, watching)
        if now_s - self._looked_s >= ROUND_S:
            self._looked_s = now_s
            self.tidy(now_s)

    def tidy(self, now_s: float) -> None:
        """Disconnect clients that have been silent for too long."""
        for client in list(self._clients.values()):
            silent_s = now_s - client.heard_s
            if client.ended and _hung_up(client.sock):
                self._drop(client)
            elif client.calls:
                continue
            elif not client.has_place and now_s - client.joined_s > STOP_PLACE_S:
                self.cut_off(client, self._only_a_stop())
            elif client.partial and silent_s > PARTIAL_S:
                self.cut_off(client, f"a line that was not ended within {PARTIAL_S:g} s")
            elif silent_s > IDLE_S and not client.listens and not self._handler.holds(client):
                self.cut_off(client, f"silent for {IDLE_S:g} s")


def _hung_up(sock: socket.socket) -> bool:
    """Whether the client no longer reads either."""
    poller = select.poll()
    poller.register(sock, 0)
    return bool(poller.poll(0))


def _farewell(sock: socket.socket, text: str) -> None:
    sock.setblocking(False)
    with sock, contextlib.suppress(OSError):
        sock.send(rpc.encode(rpc.error_of(None, RpcError(rpc.LIMIT, text))))
