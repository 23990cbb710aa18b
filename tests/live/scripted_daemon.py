"""A control socket that answers what a test says, and remembers which line came on which connection."""

from __future__ import annotations

import asyncio
import json
import threading
from pathlib import Path
from typing import Any, NamedTuple

from daemon.rig import PATIENCE_S

from fffo_drive.daemon.places import CONTROL

LINE_BYTES = 1 << 20
NEVER = object()  # an answer that does not come
ANSWERS: dict[str, Any] = {
    "info": {"axis": "bench", "profiles": ["default"], "fffo_drive": "0"},
    "status": {"state": "running", "epoch": 7},
    "events": {"events": [], "last": 0},
    "subscribe": {},
}  # everything else: {}


class Line(NamedTuple):
    """What was asked, on which connection."""

    connection: int
    method: str
    params: dict[str, Any]


class Refusal(NamedTuple):
    """An answer that is an error."""

    code: int
    message: str


class ScriptedDaemon:
    """`answers` may be changed while it runs, and one may be a function.

    `lines` is what came, `ended` are the connections that were closed, `signs_of_life` those of empty lines.
    """

    def __init__(self, directory: Path) -> None:
        self.sockets = directory / "s"
        self.answers = dict(ANSWERS)
        self.lines: list[Line] = []
        self.ended: list[int] = []
        self.signs_of_life: list[int] = []
        self._connections = 0
        self._opened = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._live()), daemon=True)

    def __enter__(self) -> ScriptedDaemon:
        self.sockets.mkdir(parents=True)
        self._thread.start()
        assert self._opened.wait(PATIENCE_S)
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(PATIENCE_S)

    def asked(self, *methods: str) -> list[Line]:
        """The lines with one of these methods."""
        return [line for line in list(self.lines) if line.method in methods]

    async def _live(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        server = await asyncio.start_unix_server(self._serve, self.sockets / CONTROL, limit=LINE_BYTES)
        self._opened.set()
        await self._end.wait()
        server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections += 1
        number = self._connections
        while line := await reader.readline():
            if not line.strip():
                self.signs_of_life.append(number)
                continue
            request = json.loads(line)
            self.lines.append(Line(number, request["method"], request["params"]))
            answer = self.answers.get(request["method"], {})
            answer = answer() if callable(answer) else answer
            if answer is NEVER:
                continue
            outcome = {"error": answer._asdict()} if isinstance(answer, Refusal) else {"result": answer}
            writer.write(json.dumps({"jsonrpc": "2.0", "id": request["id"], **outcome}).encode() + b"\n")
        self.ended.append(number)
        writer.close()
