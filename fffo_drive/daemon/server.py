"""The two sockets: clients, lines, limits. One connection is one `Client`; nothing of it can hold up the supervisor.

A client is cut off, with a message, when its line is too long, its answers pile up because it does not read, or it says
nothing for long and listens to nothing. One that asks faster than `RATE_HZ` is read more slowly, so that what all of
them cost is bounded.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import inspect
import socket
import struct
import time
from collections import deque
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from ..documents import DocumentError, key_of, what_is_wrong
from ..drive.port import DriveError
from ..recording.events import Level
from ..runtime.states import RefusedError
from . import rpc
from .methods import Api
from .parameters import METHODS
from .places import CONTROL, WATCH
from .rpc import Call, RpcError
from .sockets import CONTROL_MODE, WATCH_MODE, bound, give_to

LINE_LIMIT = 256 * 1024  # bytes; a model file fits
SEND_LIMIT = 256 * 1024  # bytes that wait for a client before it is cut off
RATE_HZ = 50.0  # requests of one client; more are read later
BURST = 50.0
WAITING_CALLS = 16  # of one client: enable, start and the like
IDLE_S = 300.0
PARTIAL_S = 10.0  # for the rest of a line
FAREWELL_S = 2.0  # to read why it is cut off


class Client(asyncio.Protocol):
    """One connection."""

    def __init__(self, server: Server, watching: bool) -> None:
        self._server, self._watching = server, watching
        self._buffer = bytearray()
        self._lines: deque[bytes] = deque()
        self._tasks: set[asyncio.Task[None]] = set()
        self._tokens, self._filled_s = BURST, time.monotonic()
        self._working = False
        self._paused = False
        self.heard_s = time.monotonic()
        self.closing = False
        self.status_period_s = 0.0
        self.status_due_s = 0.0
        self.wants_events = False
        self.credentials: dict[str, int] = {}
        self.name = "?"

    # connection

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Accepted."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        transport.set_write_buffer_limits(high=SEND_LIMIT)
        raw = transport.get_extra_info("socket").getsockopt(
            socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")
        )
        pid, uid, gid = struct.unpack("3i", raw)
        self.credentials = {"client_pid": pid, "client_uid": uid, "client_gid": gid}
        self.name = f"pid {pid} (uid {uid})"
        self._server.joined(self)

    def connection_lost(self, error: Exception | None) -> None:
        """Gone, for whatever reason."""
        self.closing = True
        for task in self._tasks:
            task.cancel()
        self._server.left(self)

    def eof_received(self) -> bool:
        """It will say no more; what it asked is still answered."""
        self._server.loop.call_soon(self._close_when_done)
        return True

    def _close_when_done(self) -> None:
        if self.closing:
            return
        if self._lines or self._tasks or self._working:
            self._server.loop.call_later(0.05, self._close_when_done)
        else:
            self.closing = True
            self._transport.close()

    # lines

    def data_received(self, data: bytes) -> None:
        """Bytes from the client."""
        self.heard_s = time.monotonic()
        self._buffer += data
        *lines, rest = self._buffer.split(b"\n")
        if len(rest) > LINE_LIMIT or any(len(line) > LINE_LIMIT for line in lines):
            self.cut_off(f"a line is longer than {LINE_LIMIT} bytes")
            return
        self._buffer = bytearray(rest)
        self._lines.extend(bytes(line) for line in lines if line.strip())
        self._schedule()

    def _schedule(self) -> None:
        if self._lines and not self._working and not self.closing:
            self._working = True
            self._server.loop.call_soon(self._work)

    def _work(self) -> None:
        """One line, then others get their turn."""
        self._working = False
        if self.closing or not self._lines:
            return
        now_s = time.monotonic()
        self._tokens = min(BURST, self._tokens + (now_s - self._filled_s) * RATE_HZ)
        self._filled_s = now_s
        if self._tokens < 1.0 or len(self._tasks) >= WAITING_CALLS:
            self._pause(True)
            self._working = True
            self._server.loop.call_later(1.0 / RATE_HZ, self._work)
            return
        self._tokens -= 1.0
        document = rpc.read_line(self._lines.popleft())
        self._answer(document)
        if self._lines:
            self._schedule()
        else:
            self._pause(False)

    def _pause(self, wanted: bool) -> None:
        if wanted != self._paused and not self._transport.is_closing():
            self._paused = wanted
            (self._transport.pause_reading if wanted else self._transport.resume_reading)()

    # calls

    def _answer(self, document: rpc.Document) -> None:
        answers: list[Any] = []
        waiting: list[tuple[Call, Any]] = []
        for item in document.items:
            if not isinstance(item, Call):
                answers.append(item)
                continue
            outcome = self._server.call(item, self, self._watching)
            if inspect.isawaitable(outcome):
                waiting.append((item, outcome))
            elif item.id is not rpc.NOTIFICATION:
                answers.append(outcome)
        if waiting:
            task = self._server.loop.create_task(self._answer_later(answers, waiting, document.batch))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        else:
            self._send_answers(answers, document.batch)

    async def _answer_later(self, answers: list[Any], waiting: list[tuple[Call, Any]], batch: bool) -> None:
        for call, outcome in waiting:
            answer = await outcome
            if call.id is not rpc.NOTIFICATION:
                answers.append(answer)
        self._send_answers(answers, batch)

    def _send_answers(self, answers: list[Any], batch: bool) -> None:
        if answers:
            self.send(rpc.encode(answers if batch else answers[0]))

    # what goes out

    def send(self, line: bytes) -> None:
        """One encoded line; a client that does not read is cut off."""
        if self.closing:
            return
        if self._transport.get_write_buffer_size() + len(line) > SEND_LIMIT:
            self.cut_off("too slow: what was sent is not read")
            return
        self._transport.write(line)

    def cut_off(self, reason: str) -> None:
        """Say why, then close."""
        if self.closing:
            return
        self.closing = True
        self._server.refused += 1
        error = rpc.error_of(None, RpcError(rpc.LIMIT, f"cut off: {reason}"))
        self._server.api.supervisor.log.add("client", f"{self.name} cut off: {reason}", Level.WARNING, self.credentials)
        self._transport.write(rpc.encode(error))
        self._transport.close()
        self._server.loop.call_later(FAREWELL_S, self._transport.abort)

    def subscribe(self, status_hz: float, events: bool) -> None:
        """What it wants to hear from now on."""
        self.status_period_s = 1.0 / status_hz if status_hz > 0 else 0.0
        self.status_due_s = time.monotonic()
        self.wants_events = events

    def tidy(self, now_s: float) -> None:
        """Cut off what has been forgotten."""
        silent_s = now_s - self.heard_s
        if self._buffer and silent_s > PARTIAL_S:
            self.cut_off(f"a line that was not ended within {PARTIAL_S:g} s")
        elif silent_s > IDLE_S and not (self.status_period_s or self.wants_events or self._tasks or self.holds):
            self.cut_off(f"silent for {IDLE_S:g} s")

    @property
    def holds(self) -> bool:
        """The axis hangs on this connection."""
        return self._server.api.holder is self


class Server:
    """Both sockets, and all clients."""

    def __init__(self, api: Api, directory: Path, clients: int) -> None:
        self.api = api
        self.directory = directory
        self.loop = asyncio.get_running_loop()
        self.refused = 0
        self._limit = clients
        self._clients: set[Client] = set()
        self._servers: list[asyncio.AbstractServer] = []
        self._paths: list[Path] = []
        self._tidied_s = 0.0
        api.supervisor.log.listeners.append(self._on_event)

    async def open(self, group: str | None) -> None:
        """Listen. Raises SocketTakenError, OSError; DocumentError for a group that does not exist."""
        self.directory.mkdir(parents=True, exist_ok=True)
        for name, mode, watching in ((CONTROL, CONTROL_MODE, False), (WATCH, WATCH_MODE, True)):
            path = self.directory / name
            sock = bound(path, mode)
            self._paths.append(path)
            if group is not None and not watching:
                give_to(path, group)
            factory = functools.partial(Client, self, watching)
            self._servers.append(await self.loop.create_unix_server(factory, sock=sock))

    async def close(self) -> None:
        """Stop listening, close every connection."""
        for server in self._servers:
            server.close()
        for client in list(self._clients):
            client.closing = True
            client._transport.close()
        for path in self._paths:
            with contextlib.suppress(OSError):
                path.unlink()
        await asyncio.sleep(0)

    @property
    def client_count(self) -> int:
        """Connections."""
        return len(self._clients)

    def joined(self, client: Client) -> None:
        """A connection was made."""
        same = sum(other._watching == client._watching for other in self._clients)
        self._clients.add(client)
        if same >= self._limit:
            client.cut_off(f"{self._limit} clients are connected already (daemon.clients)")

    def left(self, client: Client) -> None:
        """A connection is gone."""
        self._clients.discard(client)
        self.api.client_left(client)

    def turn(self, now_s: float) -> None:
        """Statuses that are due, each made once; and what has been forgotten."""
        line: bytes | None = None
        for client in list(self._clients):
            if client.status_period_s and now_s >= client.status_due_s:
                if line is None:
                    line = rpc.encode(rpc.notification("status", self.api.full_status()))
                client.status_due_s = max(client.status_due_s + client.status_period_s, now_s)
                client.send(line)
        if now_s - self._tidied_s > 1.0:
            self._tidied_s = now_s
            for client in list(self._clients):
                client.tidy(now_s)

    def _on_event(self, event: dict[str, Any]) -> None:
        listeners = [client for client in self._clients if client.wants_events]
        if listeners:
            line = rpc.encode(rpc.notification("event", event))
            for client in listeners:
                client.send(line)

    # calls

    def call(self, call: Call, client: Client, watching: bool) -> Any:
        """The answer, or an awaitable of it; every error is one."""
        try:
            method = METHODS.get(call.method)
            if method is None:
                known = ", ".join(METHODS)
                raise RpcError(rpc.METHOD_NOT_FOUND, f"no method '{call.method}'; known: {known}")
            if watching and not method.watching:
                text = f"{call.method} is not for this socket, which only watches; use {CONTROL}"
                raise RpcError(rpc.READ_ONLY, text)
            wanted = _checked(method.parameters, call.params)
            result = getattr(self.api, call.method)(wanted, client)
        except Exception as error:
            return self._failed(call, error)
        if inspect.isawaitable(result):
            return self._finish(call, result)
        return rpc.result_of(call, result)

    async def _finish(self, call: Call, waiting: Any) -> Any:
        try:
            return rpc.result_of(call, await waiting)
        except Exception as error:
            return self._failed(call, error)

    def _failed(self, call: Call, error: Exception) -> Any:
        number = None if call.id is rpc.NOTIFICATION else call.id
        return rpc.error_of(number, _as_rpc(error, self.api))


def _as_rpc(error: Exception, api: Api) -> RpcError:
    """Every error that a method raises, as the client sees it."""
    if isinstance(error, RpcError):
        return error
    if isinstance(error, RefusedError):
        allowed = [state.value for state in error.allowed]
        return RpcError(rpc.REFUSED, str(error), {"state": error.state.value, "allowed": allowed})
    if isinstance(error, DocumentError | ValueError):
        return RpcError(rpc.BAD_DOCUMENT, str(error))
    if isinstance(error, DriveError):
        return RpcError(rpc.DRIVE_ERROR, str(error))
    if isinstance(error, OSError):
        return RpcError(rpc.BAD_DOCUMENT, f"{error.filename or ''}: {error.strerror}".lstrip(": "))
    api.supervisor.log.add("command", f"internal error: {type(error).__name__}: {error}", Level.ERROR)
    return RpcError(rpc.INTERNAL_ERROR, f"internal error: {type(error).__name__}: {error}")


def _checked(parameters: type[BaseModel], given: dict[str, Any]) -> BaseModel:
    try:
        return parameters.model_validate(given)
    except ValidationError as error:
        found = error.errors()
        # a name or a profile: of an object, only what is wrong as a profile
        found = [e for e in found if e["type"] != "string_type" or not isinstance(e["input"], dict)] or found
        texts = [
            f"{key_of(e, given)}: {what_is_wrong(e, parameters, given).replace('unknown key', 'unknown parameter')}"
            for e in found
        ]
        unique = list(dict.fromkeys(texts))
        known = ", ".join(parameters.model_fields) or "none"
        raise RpcError(rpc.INVALID_PARAMS, f"{'; '.join(unique)} (parameters: {known})", {"errors": unique}) from None
