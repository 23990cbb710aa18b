"""The API on its two sockets: lines become calls, calls reach the supervisor, answers go back.

Lines are parsed and checked, and read-only calls answered, on the clients' thread (`clients.py`). Calls that change
something run on the supervisor's own loop, calls that end a motion first. No client can block it: the calls are limited
by the clients' budget, and calls that end a motion, which need none, by joining those of their kind in progress.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import math
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from ..documents import DocumentError, wrong_parameters
from ..drive.port import DriveError
from ..recording.events import Level
from . import rpc
from .clients import ENDING, WAITING_CALLS, Clients
from .methods import Api, asker
from .one_client import Client, ReceivedLine
from .parameters import METHODS, Bound, Motion
from .places import CONTROL, WATCH
from .rpc import Call, RpcError
from .sockets import CONTROL_MODE, WATCH_MODE, ListeningSocket
from .states import RefusedError
from .worker import DiskSilentError, Worker

LOOK_S = 1.0  # between looks for the sockets

Answer = Callable[[dict[str, Any]], None]  # on the clients' thread


class _Asked(NamedTuple):
    """A checked call for the supervisor."""

    call: Call
    wanted: BaseModel
    client: Client
    answer: Answer


class _Reply:
    """The answer to one line, as far as it is complete. On the clients' thread."""

    def __init__(self, clients: Clients, client: Client, document: rpc.Document) -> None:
        self._clients, self._client, self._batch = clients, client, document.batch
        self._answers: list[dict[str, Any] | None] = [None] * len(document.items)
        self._missing = len(document.items)
        self.stops = 0  # calls in it that end a motion
        self.acknowledged: list[dict[str, Any]] = []  # results of those that succeeded
        client.calls += 1

    def put(self, place: int, answer: dict[str, Any] | None) -> bool:
        """Add an answer, or None if none is expected. True with the last of them."""
        self._answers[place] = answer
        self._missing -= 1
        return self._missing == 0

    def send(self) -> None:
        """All of it, in the order of the line."""
        found = [answer for answer in self._answers if answer is not None]
        if found:
            self._clients.send(self._client, rpc.encode(found if self._batch else found[0]))
        self._clients.answered(self._client)


class Server:
    """Both sockets, for one supervisor. Handler of `Clients`."""

    def __init__(self, api: Api, directory: Path, clients: int) -> None:
        self.api = api
        self.directory = directory
        self.loop = asyncio.get_running_loop()
        self._most = clients
        self._epoch = api.supervisor.machine.epoch
        self._served: Clients | None = None
        self._urgent: deque[_Asked] = deque()
        self._ordinary: deque[_Asked] = deque()
        self._stops: dict[tuple[Client, str], dict[str, list[Answer]]] = {}  # by kind, then by parameters
        self._tasks: dict[asyncio.Task[dict[str, Any]], _Asked] = {}
        self._sockets: dict[bool, ListeningSocket] = {}  # by whether it is the one that only watches
        self._looking: asyncio.Task[None] | None = None
        self._looked_s = -math.inf
        self._missing = ""  # why a socket that is gone is not there again
        self._files = Worker("fffo-sockets", api.supervisor.log.tell_disk)

    async def open(self, group: str | None) -> None:
        """Listen. Raises SocketTakenError, OSError; DocumentError for a group that does not exist."""
        self._sockets[False] = ListeningSocket(self.directory / CONTROL, CONTROL_MODE, group)
        self._sockets[True] = ListeningSocket(self.directory / WATCH, WATCH_MODE)
        self.api.publish()
        listeners = self._sockets[False].socket, self._sockets[True].socket
        self._served = Clients(listeners, self, self._epoch, self._most)
        self.api.supervisor.log.listeners.append(self._on_event)
        self._served.start()

    async def close(self) -> None:
        """Stop listening, close every connection."""
        if self._looking is not None:
            self._looking.cancel()
        if self._served is not None:
            self.api.supervisor.log.listeners.remove(self._on_event)
            self._served.close()
        for listening in self._sockets.values():
            listening.unlink()
        for task in self._tasks:
            task.cancel()
        await asyncio.sleep(0)

    @property
    def clients(self) -> Clients:
        """All clients on the open sockets."""
        assert self._served is not None
        return self._served

    def turn(self) -> None:
        """Publish the present status for reads and subscriptions. Raises the exception that ended the clients'
        thread.
        """
        self.api.look_for_holder(time.monotonic())
        self.api.publish()
        if self.clients.failure is not None:
            raise self.clients.failure
        if self.clients.anybody_listens:
            self.clients.post(self.clients.broadcast_status)
        now_s = time.monotonic()
        looking = self._looking is not None and not self._looking.done()
        if now_s - self._looked_s >= LOOK_S and not looking and not self._files.hangs:
            self._looked_s = now_s
            self._looking = asyncio.ensure_future(self._look_for_sockets())

    async def _look_for_sockets(self) -> None:
        """Make sockets anew that somebody has deleted; connections go on."""
        log = self.api.supervisor.log
        for watching, lost in list(self._sockets.items()):
            try:
                fresh = await self._files.run(_again, lost, doing="looking for", at=lost.path, late=_not_needed)
            except DiskSilentError:
                return
            except (OSError, DocumentError) as error:
                problem = f"{lost.path} is gone and cannot be made anew: {getattr(error, 'strerror', None) or error}"
                if problem != self._missing:  # once
                    log.add("files", f"{problem}; restart the service", Level.ERROR)
                self._missing = problem
                return
            if fresh is not None:
                self._sockets[watching] = fresh
                self.clients.post(partial(self.clients.listen_on, watching, fresh.socket))
                log.add("files", f"{lost.path} was gone: made anew", Level.WARNING)
                self._missing = ""

    def _on_event(self, event: dict[str, Any]) -> None:
        line = rpc.encode(rpc.notification("event", event))
        self.clients.post(lambda: self.clients.broadcast_event(line))

    # -- on the clients' thread ------------------------------------------------------------------------------------

    def stop_line(self, client: Client, line: ReceivedLine) -> bool:
        """A line that looks like a stop, on arrival. False when it is a batch, or none that can be carried out."""
        document = rpc.read_line(line.content)
        (item,) = document.items[:1]
        if document.batch or not isinstance(item, Call) or item.method not in ENDING:
            return False
        with contextlib.suppress(RpcError):
            _checked(METHODS[item.method].parameters, item.params)
            self._begin(client, document, line.epoch)
            return True
        return False

    def line(self, client: Client, line: ReceivedLine) -> None:
        """Any other line."""
        self._begin(client, rpc.read_line(line.content), line.epoch)

    def status_line(self) -> bytes:
        """The newest status as a notification."""
        return rpc.encode(rpc.notification("status", self.api.latest))

    def cut_off(self, client: Client, reason: str) -> None:
        """A client was cut off."""
        self.api.supervisor.log.add("client", f"{client.name} cut off: {reason}", Level.WARNING, client.credentials)

    def turned_away(self, watching: bool, reason: str) -> None:
        """A connection was not let in."""
        name = WATCH if watching else CONTROL
        self.api.supervisor.log.add("client", f"{name}: a connection was not let in: {reason}", Level.WARNING)

    def left(self, client: Client) -> None:
        """A client is gone."""
        self._on_the_loop(self._client_left, client)

    def holds(self, client: Client) -> bool:
        """The axis hangs on this connection."""
        return self.api.holder is client

    def _begin(self, client: Client, document: rpc.Document, epoch: int) -> None:
        reply = _Reply(self.clients, client, document)
        for place, item in enumerate(document.items):
            if isinstance(item, Call):
                self._call(client, item, epoch, reply, self._filler(reply, place, item))
            elif reply.put(place, item):
                reply.send()

    def _filler(self, reply: _Reply, place: int, call: Call) -> Answer:
        """Deliver the answer to a call. The answer to a stop ends the epoch before it is sent."""

        def fill(answer: dict[str, Any]) -> None:
            own = {**answer, "id": None if call.id is rpc.NOTIFICATION else call.id}
            if call.method in ENDING and "result" in own:
                own["result"] = dict(own["result"])
                reply.acknowledged.append(own["result"])
            if not reply.put(place, None if call.id is rpc.NOTIFICATION else own):
                return
            if reply.acknowledged:
                epoch = self.clients.end_epoch()
                for result in reply.acknowledged:
                    result["epoch"] = epoch
            for _ in range(reply.stops):
                self._epoch.stop_answered()
            reply.send()

        return fill

    def _call(self, client: Client, call: Call, epoch: int, reply: _Reply, answer: Answer) -> None:
        """Answer at once, or hand the call to the supervisor; every error is an answer."""
        try:
            method = METHODS.get(call.method)
            if method is None:
                known = ", ".join(METHODS)
                raise RpcError(rpc.METHOD_NOT_FOUND, f"no method '{call.method}'; known: {known}")
            if client.watching and not method.watching:
                text = f"{call.method} is not for this socket, which only watches; use {CONTROL}"
                raise RpcError(rpc.READ_ONLY, text)
            wanted = _checked(method.parameters, call.params)
            if method.watching:
                answer(rpc.result_of(call, getattr(self.api, call.method)(wanted, client)))
                return
        except Exception as error:
            answer(rpc.error_of(None, self._as_rpc(error)))
            return
        if isinstance(wanted, Bound) and not isinstance(wanted, Motion) and wanted.epoch is None:
            wanted = wanted.model_copy(update={"epoch": epoch})
        asked = _Asked(call, wanted, client, answer)
        if call.method not in ENDING:
            self._ordinary.append(asked)
        else:
            reply.stops += 1
            self._epoch.stop_arrived()
            if self._joins(asked):
                return
            self._urgent.append(asked)
        self._on_the_loop(self._take)

    def _joins(self, asked: _Asked) -> bool:
        """Whether the same stop by the same client is in progress, so that its answer serves this one too.

        Beyond a number of them that differ in their parameters, the last one serves: the axis is being stopped already.
        """
        kind, parameters = _kind_and_parameters(asked)
        alike = self._stops.setdefault(kind, {})
        if parameters not in alike and len(alike) >= WAITING_CALLS:
            parameters = next(reversed(alike))
        alike.setdefault(parameters, []).append(asked.answer)
        return len(alike[parameters]) > 1

    def _stop_answered(self, asked: _Asked, answer: dict[str, Any]) -> None:
        kind, parameters = _kind_and_parameters(asked)
        served = self._stops[kind].pop(parameters)
        if not self._stops[kind]:
            del self._stops[kind]
        for fill in served:
            fill(answer)

    def _on_the_loop(self, what: Callable[..., None], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # closed: the service has ended
            self.loop.call_soon_threadsafe(what, *arguments)

    # -- on the supervisor's loop ----------------------------------------------------------------------------------

    def _take(self) -> None:
        """Everything that ends a motion, then one other call."""
        while self._urgent:
            self._carry_out(self._urgent.popleft())
        if self._ordinary:
            self._carry_out(self._ordinary.popleft())

    def _carry_out(self, asked: _Asked) -> None:
        task = self.loop.create_task(self._answer(asked))
        self._tasks[task] = asked
        task.add_done_callback(self._carried_out)

    async def _answer(self, asked: _Asked) -> dict[str, Any]:
        try:
            self._note(asked)
            result = getattr(self.api, asked.call.method)(asked.wanted, asked.client)
            return rpc.result_of(asked.call, await result if inspect.isawaitable(result) else result)
        except Exception as error:
            return rpc.error_of(None, self._as_rpc(error))

    def _carried_out(self, task: asyncio.Task[dict[str, Any]]) -> None:
        """Send the answer. Each call has one, even one that was cancelled before its first step: a stop in the same
        batch awaits it.
        """
        asked = self._tasks.pop(task)
        if task.cancelled():
            answer = rpc.error_of(None, RpcError(rpc.NOT_REACHED, "the daemon ends, or who asked has gone"))
        else:
            answer = task.result()
        self.api.publish()
        done = self._stop_answered if asked.call.method in ENDING else _answered
        self.clients.post(lambda: done(asked, answer))

    def _note(self, asked: _Asked) -> None:
        """The recording holds every request, before what it causes."""
        connection = self.api.supervisor.connection
        if connection is not None:
            values = asked.wanted.model_dump(mode="json")
            epoch = values.pop("epoch", None)
            name = asker(asked.client.name, values.pop("who", None))
            connection.session.note_request(name, asked.call.method, values, epoch)

    def _client_left(self, client: Client) -> None:
        """Cancel its pending requests, except stops."""
        for task, asked in list(self._tasks.items()):
            if asked.client is client and asked.call.method not in ENDING:
                task.cancel()
        self.api.client_left(client)

    def _as_rpc(self, error: Exception) -> RpcError:
        """Convert an exception of a method to the error for the client."""
        if isinstance(error, RpcError):
            return error
        if isinstance(error, RefusedError):
            now = self.api.latest
            data = {"state": error.state.value, "allowed": [state.value for state in error.allowed]}
            return RpcError(rpc.REFUSED, str(error), {**data, "epoch": now["epoch"], "stop": now["last_stop"]})
        if isinstance(error, DocumentError | ValueError):
            return RpcError(rpc.BAD_DOCUMENT, str(error))
        if isinstance(error, DriveError):
            return RpcError(rpc.DRIVE_ERROR, str(error))
        if isinstance(error, OSError):
            return RpcError(rpc.BAD_DOCUMENT, f"{error.filename or ''}: {error.strerror or error}".lstrip(": "))
        text = f"internal error: {type(error).__name__}: {error}"
        self.api.supervisor.log.add("command", text, Level.ERROR)
        return RpcError(rpc.INTERNAL_ERROR, text)


def _again(lost: ListeningSocket) -> ListeningSocket | None:
    """A socket in the place of one that is gone; None for one that is there."""
    return None if lost.is_there() else lost.anew()


def _not_needed(fresh: ListeningSocket | None) -> None:
    """Nobody waits for it any more."""
    if fresh is not None:
        fresh.unlink()
        fresh.socket.close()


def _answered(asked: _Asked, answer: dict[str, Any]) -> None:
    asked.answer(answer)


def _kind_and_parameters(asked: _Asked) -> tuple[tuple[Client, str], str]:
    return (asked.client, asked.call.method), asked.wanted.model_dump_json()


def _checked(parameters: type[BaseModel], given: dict[str, Any]) -> BaseModel:
    try:
        return parameters.model_validate(given)
    except ValidationError as error:
        wrong = wrong_parameters(error, parameters, given)
        known = ", ".join(parameters.model_fields) or "none"
        raise RpcError(rpc.INVALID_PARAMS, f"{'; '.join(wrong)} (parameters: {known})", {"errors": wrong}) from None
