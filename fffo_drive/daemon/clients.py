"""The thread that owns the sockets: it accepts, reads, splits lines, and sees a stop on arrival.

Whatever clients send is read at once, up to a bound, and the lines wait here. A line that asks for a stop goes to the
supervisor before anything else is parsed, costs no budget, and finds a place beyond the limit of clients. All other
lines are answered one at a time, clients in turn, from a budget of bytes a second that all clients of a socket share.

Each line carries the epoch in which it arrived. Before a stop is acknowledged, everything that lies in the sockets is
read as of the epoch that ends with it: a start that was sent before the acknowledgement is never carried out after it.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import selectors
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Protocol

from ..runtime.states import Epoch
from . import rpc
from .rpc import RpcError

READ_BYTES = 256 * 1024  # more than the kernel keeps for a Unix socket: one read empties it
SEND_LIMIT = 256 * 1024  # bytes that wait for a client before it is cut off
WAITING_LINES = 1000  # of one client, before it is cut off
WAITING_CALLS = 16  # of one client, that the supervisor has not answered
STOP_LINE_BYTES = 4096  # a line that asks for a stop is shorter
LINE_COST_BYTES = 512  # what the shortest line takes from the budget
IDLE_S = 300.0
PARTIAL_S = 10.0  # for the rest of a line
STOP_PLACES = 64  # connections to the control socket beyond the limit, for stops alone
STOP_PLACE_S = 2.0
BACKLOG = 128
ACCEPTS_PER_ROUND = 64
PAUSE_S = 0.05  # of a listening socket that too many want to watch through, or without descriptors left
ROUND_S = 0.25  # the longest time between two looks at what has been forgotten
ANSWER_S = 0.002  # to answer lines before what has arrived is read again: a stop waits no longer
BUDGET_WAIT_S = 0.01

ENDING = ("stop", "disable", "quick_stop")  # methods
_STOP = re.compile(rb'"method"\s*:\s*"(?:' + "|".join(ENDING).encode() + rb')"')


class SocketLimits(NamedTuple):
    """What the clients of one socket may send."""

    line_bytes: int
    waiting_bytes: int  # of one client
    bytes_per_s: float  # of all clients together
    burst_bytes: float


CONTROL_LIMITS = SocketLimits(256 * 1024, 1024 * 1024, 256 * 1024.0, 512 * 1024.0)  # a model file fits a line
WATCH_LIMITS = SocketLimits(4 * 1024, 64 * 1024, 128 * 1024.0, 64 * 1024.0)


class Line(NamedTuple):
    """A line as it arrived."""

    content: bytes
    epoch: int


class Handler(Protocol):
    """What becomes of lines and clients; called on the thread of the clients."""

    def stop_line(self, client: Client, line: Line) -> bool:
        """A line that looks like a stop. False when it is none that can be carried out: it waits like any other."""
        ...

    def line(self, client: Client, line: Line) -> None:
        """Any other line, when it is its turn."""
        ...

    def status_line(self) -> bytes:
        """The newest status as a notification."""
        ...

    def cut_off(self, client: Client, reason: str) -> None:
        """A client was cut off."""
        ...

    def turned_away(self, watching: bool, reason: str) -> None:
        """A connection was not let in."""
        ...

    def left(self, client: Client) -> None:
        """A client is gone."""
        ...

    def holds(self, client: Client) -> bool:
        """The axis hangs on this connection."""
        ...


class Budget:
    """Bytes a second, kept up to a burst."""

    def __init__(self, limits: SocketLimits, now_s: float) -> None:
        self._limits, self._left, self._filled_s = limits, limits.burst_bytes, now_s

    def take(self, line_bytes: int, now_s: float) -> bool:
        """Pay for a line, if it can be paid. A line longer than the burst never can: lines are shorter."""
        gained = (now_s - self._filled_s) * self._limits.bytes_per_s
        self._left = min(self._limits.burst_bytes, self._left + gained)
        self._filled_s = now_s
        cost = max(line_bytes, LINE_COST_BYTES)
        if self._left < cost:
            return False
        self._left -= cost
        return True


class Client:
    """One connection. All but `name`, `credentials` and `watching` belongs to the thread of the clients."""

    def __init__(self, sock: socket.socket, watching: bool, limits: SocketLimits, now_s: float, place: bool) -> None:
        self.sock, self.watching, self.limits = sock, watching, limits
        self.has_place = place  # False: beyond the limit, for a stop alone
        self.joined_s = self.heard_s = now_s
        self.partial = bytearray()
        self.lines: deque[Line] = deque()
        self.waiting_bytes = 0
        self.out = bytearray()
        self.calls = 0  # lines that were handed on and are not answered
        self.ended = False  # it will say no more
        self.closed = False
        self.awaited = 0  # selectors.EVENT_*
        self.status_period_s = 0.0
        self.status_due_s = 0.0
        self.wants_events = False
        pid, uid, gid = struct.unpack("3i", sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        self.credentials = {"client_pid": pid, "client_uid": uid, "client_gid": gid}
        self.name = f"pid {pid} (uid {uid})"

    @property
    def listens(self) -> bool:
        """It has subscribed to something."""
        return bool(self.status_period_s or self.wants_events)

    def subscribe(self, status_hz: float, events: bool) -> None:
        """What it wants to hear from now on."""
        self.status_period_s = 1.0 / status_hz if status_hz > 0 else 0.0
        self.status_due_s = time.monotonic()
        self.wants_events = events


class Clients:
    """Both sockets and everybody on them, from `start` to `close`."""

    def __init__(self, sockets: tuple[socket.socket, socket.socket], handler: Handler, epoch: Epoch, most: int) -> None:
        """`sockets`: listening, for control and for watching; `most`: clients of each, at a time."""
        self._listeners, self._handler, self._epoch, self._most = sockets, handler, epoch, most
        self._selector = selectors.DefaultSelector()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._waking = threading.Lock()  # so that nobody writes to a number that is another file by now
        self._posts: deque[Callable[[], None]] = deque()
        self._clients: dict[int, Client] = {}
        self._turn: deque[Client] = deque()  # those whose lines wait
        self._stamp: int | None = None  # epoch of what is read before an acknowledgement
        self._too_poor = False  # nobody whose lines wait can pay for one
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
            self._selector.register(listener, selectors.EVENT_READ, watching)
        self._selector.register(self._wake, selectors.EVENT_READ, None)
        self._thread.start()

    def close(self, timeout_s: float = 1.0) -> None:
        """Hang up on everybody and end the thread."""
        self._ending = True
        with self._waking:
            os.eventfd_write(self._wake, 1)
        self._thread.join(timeout_s)
        with self._waking:
            wake, self._wake = self._wake, -1
            os.close(wake)

    def post(self, what: Callable[[], None]) -> None:
        """Do this on the thread of the clients, soon."""
        self._posts.append(what)
        with self._waking:
            if self._wake >= 0:
                os.eventfd_write(self._wake, 1)

    @property
    def count(self) -> int:
        """Connections."""
        return len(self._clients)

    @property
    def anybody_listens(self) -> bool:
        """Somebody has subscribed to statuses."""
        return any(client.status_period_s for client in list(self._clients.values()))

    # -- its own thread --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while not self._ending:
                self._read_all(self._patience_s())
                self._run_posts()
                self._answer()
                self._look_after(time.monotonic())
        except BaseException as error:
            self.failure = error
        finally:
            for client in list(self._clients.values()):
                self._flush(client)
                self._drop(client)
            self._selector.close()
            for listener in self._listeners:
                listener.close()

    def _patience_s(self) -> float:
        if self._posts:
            return 0.0
        if self._turn:
            return BUDGET_WAIT_S if self._too_poor else 0.0
        return ROUND_S

    def _read_all(self, patience_s: float) -> None:
        """Whatever has arrived, once from everybody: connections first, so that what they brought is read too."""
        ready = self._selector.select(patience_s)
        for key, _ in ready:
            if isinstance(key.data, bool):
                self._accept(key.fileobj, key.data)  # type: ignore[arg-type]
            elif key.data is None:
                with contextlib.suppress(BlockingIOError):
                    os.eventfd_read(self._wake)
        for key, events in ready:
            client = key.data
            if isinstance(client, Client) and not client.closed:
                if events & selectors.EVENT_READ:
                    self._read(client)
                if events & selectors.EVENT_WRITE:
                    self._flush(client)

    def _run_posts(self) -> None:
        for _ in range(len(self._posts)):
            self._posts.popleft()()

    # connections

    def _accept(self, listener: socket.socket, watching: bool) -> None:
        for _ in range(ACCEPTS_PER_ROUND):
            try:
                sock, _ = listener.accept()
            except BlockingIOError:
                return
            except OSError as error:  # out of descriptors: those who are here come first
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
        """The oldest connection beyond the limit gives way, unless its stop is under way."""
        beyond = [client for client in self._clients.values() if not client.has_place and not client.calls]
        if len(beyond) >= STOP_PLACES:
            self._drop(beyond[0])

    def _pause(self, watching: bool) -> None:
        """Leave newcomers in the kernel's queue for a moment."""
        if watching not in self._paused:
            self._paused[watching] = time.monotonic() + PAUSE_S
            self._selector.unregister(self._listeners[watching])

    # what comes in

    def _read(self, client: Client) -> None:
        try:
            data = client.sock.recv(READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            self._drop(client)
            return
        if not data:
            client.ended = True
            self._await(client)
            if _hung_up(client.sock):
                self._drop(client)
            self._drop_when_done(client)
            return
        client.heard_s = time.monotonic()
        epoch = self._epoch.value if self._stamp is None else self._stamp
        *whole, rest = data.split(b"\n")
        if whole:
            whole[0] = bytes(client.partial) + whole[0]
            client.partial = bytearray(rest)
        else:
            client.partial += rest
        for content in whole:
            if client.closed:
                return
            if content.strip():
                self._arrived(client, Line(content, epoch))
        if len(client.partial) > client.limits.line_bytes:
            self.cut_off(client, f"a line is longer than {client.limits.line_bytes} bytes")

    def _arrived(self, client: Client, line: Line) -> None:
        size = len(line.content)
        express = not client.watching and size <= STOP_LINE_BYTES and _STOP.search(line.content)
        if express and self._handler.stop_line(client, line):
            return
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
        """Read whatever lies in the sockets as of the present epoch, then begin a new one. Returns the new one."""
        self._stamp = self._epoch.value
        self._read_all(0.0)
        self._stamp = None
        return self._epoch.advance()

    # whose turn it is

    def _answer(self) -> None:
        """Lines, for a moment; then whatever has arrived meanwhile is read."""
        begun_s = now_s = time.monotonic()
        while now_s - begun_s < ANSWER_S and self._answer_one(now_s):
            now_s = time.monotonic()

    def _answer_one(self, now_s: float) -> bool:
        """One line of the first client that can pay for it. False when there is none."""
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
            self._too_poor = False
            self._handler.line(client, line)
            self._drop_when_done(client)
            return True
        return False

    # what goes out

    def send(self, client: Client, line: bytes) -> None:
        """One encoded line; a client that does not read is cut off."""
        if client.closed:
            return
        if len(client.out) + len(line) > SEND_LIMIT:
            self.cut_off(client, "too slow: what was sent is not read")
            return
        client.out += line
        self._flush(client)

    def broadcast_event(self, line: bytes) -> None:
        """To everybody who listens to events."""
        for client in list(self._clients.values()):
            if client.wants_events:
                self.send(client, line)

    def broadcast_status(self) -> None:
        """To everybody for whom a status is due, made once."""
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
        """Tell the selector what to wait for; one that has ended its side would be ready to read for ever."""
        wanted = (0 if client.ended else selectors.EVENT_READ) | (selectors.EVENT_WRITE if client.out else 0)
        if wanted == client.awaited:
            return
        if not client.awaited:
            self._selector.register(client.sock, wanted, client)
        elif not wanted:
            self._selector.unregister(client.sock)
        else:
            self._selector.modify(client.sock, wanted, client)
        client.awaited = wanted

    # the end of a connection

    def answered(self, client: Client) -> None:
        """A line that was handed on has its answer."""
        client.calls -= 1
        self._drop_when_done(client)

    def _drop_when_done(self, client: Client) -> None:
        """It has ended its side, and everything that it asked is answered."""
        if client.ended and not (client.lines or client.calls or client.out or client.closed):
            self._drop(client)

    def cut_off(self, client: Client, reason: str) -> None:
        """Say why, then hang up."""
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
            self._selector.unregister(client.sock)
        client.sock.close()
        client.lines.clear()
        self._handler.left(client)

    def _look_after(self, now_s: float) -> None:
        """Listen again, and cut off what has been forgotten."""
        for watching, until_s in list(self._paused.items()):
            if now_s >= until_s:
                del self._paused[watching]
                self._selector.register(self._listeners[watching], selectors.EVENT_READ, watching)
        if now_s - self._looked_s >= ROUND_S:
            self._looked_s = now_s
            self.tidy(now_s)

    def tidy(self, now_s: float) -> None:
        """Cut off who has been silent for too long."""
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
    """It does not only say no more, it does not listen any more either."""
    poller = select.poll()
    poller.register(sock, 0)
    return bool(poller.poll(0))


def _farewell(sock: socket.socket, text: str) -> None:
    sock.setblocking(False)
    with sock, contextlib.suppress(OSError):
        sock.send(rpc.encode(rpc.error_of(None, RpcError(rpc.LIMIT, text))))
