"""The other end of a WebSocket: its send queue, its pending calls, and when it is dropped.

Nothing here waits for a peer: frames go into its own queue, and a peer that does not empty the queue, or sends invalid
messages, is disconnected. One that sends too much is disconnected earlier (`listener.py`).
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

STALL_S = 10.0  # time to send one frame
MOST_WAITING = 500  # frames: several seconds
CALLS = 8  # pending calls of one peer


class DroppedError(Exception):
    """The peer must be dropped; the text says why."""


class Peer:
    """A WebSocket that was accepted."""

    _kept: ClassVar[set[asyncio.Task[None]]] = set()  # calls that are completed even if the peer disconnects

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
        """Serve it until it leaves or is dropped."""
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
        """Handle a message. Raises DroppedError."""
        raise NotImplementedError

    # what goes out

    def offer(self, frame: str | bytes) -> None:
        """Queue a frame, or drop the peer when it does not read."""
        if self.dropped:
            return
        if not (self._queue or self._bulk or self._sending):
            self._sent_s = time.monotonic()
        elif time.monotonic() - self._sent_s > STALL_S or len(self._queue) >= MOST_WAITING:
            self.drop("does not read its messages")
            return
        self._queue.append(frame)
        self._filled.set()

    def offer_bulk(self, frames: list[bytes]) -> None:
        """Queue frames that are sent when nothing else waits."""
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
        """Close the connection at once, whatever the peer does."""
        if not self.dropped:
            self.dropped = why
            self._queue.clear()
            self._connection.transport.abort()

    # what comes in

    @property
    def busy(self) -> bool:
        """As many of its calls are pending as allowed."""
        return len(self._calls) >= CALLS

    def answer_later(self, answering: Coroutine[Any, Any, None], to_the_end: bool = False) -> None:
        """Run a call without delaying others. `to_the_end`: even if the peer disconnects meanwhile, for a stop."""
        held = self._kept if to_the_end else self._calls
        task = asyncio.create_task(answering)
        held.add(task)
        task.add_done_callback(held.discard)
