"""A connection to the daemon's control socket for the live server's asyncio loop. Commands are sent through it only."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

LINE_LIMIT = 4 * 1024 * 1024
ANSWER_S = 15.0  # in addition to the time that a call itself may take


class ControlLinkError(Exception):
    """The daemon refused (`code` of JSON-RPC) or does not answer (`code` 0)."""

    def __init__(self, message: str, code: int = 0) -> None:
        super().__init__(message)
        self.code = code


Listener = Callable[[str, dict[str, Any]], None]


class ControlLink:
    """Calls and notifications over one connection, opened by the first call and reopened after a failure."""

    def __init__(self, path: Path, listener: Listener | None = None) -> None:
        """`listener` gets method and parameters of each notification."""
        self._path = path
        self._listener = listener
        self._number = 0
        self._waiting: dict[int, asyncio.Future[Any]] = {}
        self._writer: asyncio.StreamWriter | None = None
        self._reading: asyncio.Task[None] | None = None
        self._opening = asyncio.Lock()

    @property
    def is_open(self) -> bool:
        """The connection is open."""
        return self._writer is not None

    async def call(self, method: str, params: Mapping[str, Any] | None = None) -> Any:
        """The result. Raises LinkError."""
        params = params or {}
        wait_s = params.get("wait_s", 0.0)
        patience_s = ANSWER_S + (wait_s if isinstance(wait_s, int | float) else 0.0)
        await self._open()
        writer = self._writer
        if writer is None:
            raise ControlLinkError("the daemon closed the connection")
        self._number += 1
        number, answer = self._number, asyncio.get_running_loop().create_future()
        self._waiting[number] = answer
        request = {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
        writer.write(json.dumps(request).encode() + b"\n")
        try:
            return await asyncio.wait_for(answer, patience_s)
        except TimeoutError:
            raise ControlLinkError("the daemon does not answer") from None
        finally:
            self._waiting.pop(number, None)

    def say_alive(self) -> None:
        """A sign of life, of a client that holds the axis by this connection."""
        if self._writer is not None:
            self._writer.write(b"\n")

    async def _open(self) -> None:
        async with self._opening:
            if self._writer is not None:
                return
            try:
                reader, self._writer = await asyncio.open_unix_connection(str(self._path), limit=LINE_LIMIT)
            except OSError as error:
                raise ControlLinkError(f"no daemon answers: {error.strerror or error}") from error
            self._reading = asyncio.create_task(self._read(reader))

    async def _read(self, reader: asyncio.StreamReader) -> None:
        with contextlib.suppress(OSError, ValueError):  # closed, or a line beyond the limit
            while line := await reader.readline():
                self._hear(json.loads(line))
        self._drop()

    def _hear(self, message: dict[str, Any]) -> None:
        if "method" in message:
            if self._listener is not None:
                self._listener(message["method"], message["params"])
            return
        answer = self._waiting.get(message.get("id") or 0)
        if answer is None or answer.done():
            return
        if "error" in message:
            answer.set_exception(ControlLinkError(message["error"]["message"], message["error"]["code"]))
        else:
            answer.set_result(message["result"])

    def _drop(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(ControlLinkError("the daemon closed the connection"))

    def close(self) -> None:
        """Close the connection; the daemon then does what it does when a client that holds the axis disconnects."""
        if self._reading is not None:
            self._reading.cancel()
        self._drop()
