"""One page in a browser: what waits to be sent to it, what it asks for, and when it is dropped.

Nothing here waits for a client: what is offered goes into a queue of its own, and one that does not empty it, asks too
much, or asks for what it has no right to again and again, loses its connection.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import time
from collections import deque
from collections.abc import Awaitable, Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from . import frames
from .control_link import ControlLink, LinkError
from .feed import CAPTURE_S

if TYPE_CHECKING:
    from .hub import Hub

Call = Callable[[], Awaitable[Any]]

COMMANDS = {"enable": 10.0, "disable": 10.0, "start": 0.0, "stop": 10.0, "toggle": None, "reset_fault": 10.0}
STALL_S = 10.0  # for one frame to leave
MOST_WAITING = 500  # frames: several seconds
RATE_HZ, BURST = 20.0, 40.0  # messages of one client
WRONG_TOKENS = 5
CALLS = 8  # of one client at a time


class DroppedError(Exception):
    """This client is to be dropped, and why."""


class Client:
    """A WebSocket that was accepted."""

    def __init__(self, hub: Hub, connection: ServerConnection) -> None:
        self._hub, self._connection = hub, connection
        self._queue: deque[str | bytes] = deque()
        self._bulk: deque[bytes] = deque()  # of a capture: sent when nothing else waits
        self._filled = asyncio.Event()
        self._sending = False
        self._sent_s = time.monotonic()
        self._tokens, self._tokens_s = BURST, time.monotonic()
        self._wrong = 0
        self._may_command = False
        self._calls: set[asyncio.Task[None]] = set()
        self._link = ControlLink(hub.control_path)
        self.dropped = ""

    async def live(self) -> None:
        """Until it goes or is dropped."""
        writing = asyncio.create_task(self._write())
        try:
            async for message in self._connection:
                await self._take(message)
        except DroppedError as error:
            self.drop(str(error))
        except ConnectionClosed:
            pass
        finally:
            writing.cancel()
            for call in self._calls:
                call.cancel()
            self._link.close()  # where the axis hangs on this page, the daemon does as daemon.client_loss says

    # what goes out

    def offer(self, frame: str | bytes) -> None:
        """Put a frame into its queue, or drop the client when it does not read."""
        if self.dropped:
            return
        if not (self._queue or self._bulk or self._sending):
            self._sent_s = time.monotonic()
        elif time.monotonic() - self._sent_s > STALL_S or len(self._queue) >= MOST_WAITING:
            self.drop("does not read what is sent")
            return
        self._queue.append(frame)
        self._filled.set()

    async def _write(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                if not self._queue and not self._bulk:
                    self._filled.clear()
                    await self._filled.wait()
                frame = (self._queue or self._bulk).popleft()
                self._sending = True
                await self._connection.send(frame)
                self._sending = False
                self._sent_s = time.monotonic()

    def drop(self, why: str) -> None:
        """Cut the connection at once; nothing that it does can delay this."""
        if not self.dropped:
            self.dropped = why
            self._queue.clear()
            self._connection.transport.abort()

    # what comes in

    async def _take(self, message: str | bytes) -> None:
        now_s = time.monotonic()
        self._tokens = min(BURST, self._tokens + (now_s - self._tokens_s) * RATE_HZ) - 1.0
        self._tokens_s = now_s
        if self._tokens < 0.0:
            raise DroppedError("asks too often")
        try:
            wanted = json.loads(message) if isinstance(message, str) else None
        except (ValueError, RecursionError):
            wanted = None
        if not isinstance(wanted, dict):
            raise DroppedError("sends what is no JSON object")
        self._do(wanted)

    def _do(self, wanted: dict[str, Any]) -> None:
        what = wanted.get("do")
        if what == "stop":
            self._hub.keep(self._answer(wanted, self._hub.stop))
        elif what == "token":
            self._check_token(wanted.get("token"))
        elif what == "capture":
            self._begin_capture(wanted.get("seconds"), wanted.get("until_tick"))
        elif what == "call":
            self._call(wanted)
        else:
            raise DroppedError("asks for what there is not")

    def _check_token(self, token: object) -> None:
        given = token if isinstance(token, str) else ""
        self._may_command = hmac.compare_digest(given.encode("utf-8", "replace"), self._hub.token.encode())
        if not self._may_command:
            self._wrong += 1
            if self._wrong >= WRONG_TOKENS:
                raise DroppedError("wrong token, again and again")
        self.offer(frames.text("rights", command=self._may_command))

    def _begin_capture(self, seconds: object, until_tick: object) -> None:
        if not isinstance(seconds, int | float) or not 0 < seconds <= CAPTURE_S:
            raise DroppedError("asks for a capture of no length")
        if until_tick is not None and (not isinstance(until_tick, int) or not 0 <= until_tick < 1 << 63):
            raise DroppedError("asks for a capture at no tick")
        if self._bulk:
            return  # the one before is on its way
        self._bulk.extend(self._hub.feed.captured(float(seconds), until_tick))
        self._filled.set()

    def _call(self, wanted: dict[str, Any]) -> None:
        method, params = wanted.get("method"), wanted.get("params", {})
        if not self._may_command:
            self._refuse(wanted, "this page has no right to command; open it with the token (fffo-drive scope)")
        elif method not in COMMANDS or not isinstance(params, dict):
            self._refuse(wanted, f"no command of the scope; known: {', '.join(COMMANDS)}")
        else:
            wait_s = COMMANDS[method]
            given = {**params, "wait_s": wait_s} if wait_s is not None else params
            self._start(wanted, partial(self._link.call, method, **given))

    def _refuse(self, wanted: dict[str, Any], why: str) -> None:
        self.offer(frames.text("answer", id=_number(wanted), error=why))

    def _start(self, wanted: dict[str, Any], call: Call) -> None:
        """Answer later; what waits (enable) holds up nothing."""
        if len(self._calls) >= CALLS:
            self._refuse(wanted, "too many commands wait already")
            return
        task = asyncio.create_task(self._answer(wanted, call))
        self._calls.add(task)
        task.add_done_callback(self._calls.discard)

    async def _answer(self, wanted: dict[str, Any], call: Call) -> None:
        try:
            answer = frames.text("answer", id=_number(wanted), result=await call())
        except (LinkError, TypeError) as error:
            answer = frames.text("answer", id=_number(wanted), error=str(error))
        self.offer(answer)


def _number(wanted: dict[str, Any]) -> int | None:
    number = wanted.get("id")
    return number if isinstance(number, int) else None
