"""Somebody at the other end of a WebSocket: what waits to be sent to it, what it asks for, and when it is dropped.

Nothing here waits for a peer: what is offered goes into a queue of its own, and one that does not empty it, or talks
nonsense, loses its connection. One that asks too often has lost it before (`listener.py`).
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import Coroutine
from typing import Any, ClassVar

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

STALL_S = 10.0  # for one frame to leave
MOST_WAITING = 500  # frames: several seconds
CALLS = 8  # of one peer at a time


class DroppedError(Exception):
    """This peer is to be dropped, and why."""


class Peer:
    """A WebSocket that was accepted."""

    _kept: ClassVar[set[asyncio.Task[None]]] = set()  # what is done to the end, whoever goes meanwhile

    def __init__(self, connection: ServerConnection) -> None:
        self._connection = connection
        self._queue: deque[str | bytes] = deque()
        self._bulk: deque[bytes] = deque()  # sent when nothing else waits
        self._filled = asyncio.Event()
        self._sending = False
        self._sent_s = time.monotonic()
        self._calls: set[asyncio.Task[None]] = set()
        self.dropped = ""

    async def live(self) -> None:
        """Until it goes or is dropped."""
        writing = asyncio.create_task(self._write())
        try:
            async for message in self._connection:
                self.take(message)
        except DroppedError as error:
            self.drop(str(error))
        except ConnectionClosed:
            pass
        finally:
            writing.cancel()
            for call in self._calls:
                call.cancel()

    def take(self, message: str | bytes) -> None:
        """A message. Raises DroppedError."""
        raise NotImplementedError

    # what goes out

    def offer(self, frame: str | bytes) -> None:
        """Put a frame into its queue, or drop the peer when it does not read."""
        if self.dropped:
            return
        if not (self._queue or self._bulk or self._sending):
            self._sent_s = time.monotonic()
        elif time.monotonic() - self._sent_s > STALL_S or len(self._queue) >= MOST_WAITING:
            self.drop("does not read what is sent")
            return
        self._queue.append(frame)
        self._filled.set()

    def offer_bulk(self, frames: list[bytes]) -> None:
        """Frames that wait until nothing else does."""
        self._bulk.extend(frames)
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

    @property
    def busy(self) -> bool:
        """As many of its calls wait as may."""
        return len(self._calls) >= CALLS

    def answer_later(self, answering: Coroutine[Any, Any, None], to_the_end: bool = False) -> None:
        """What waits holds up nothing. `to_the_end`: also when who asked is gone by then; a stop."""
        held = self._kept if to_the_end else self._calls
        task = asyncio.create_task(answering)
        held.add(task)
        task.add_done_callback(held.discard)
