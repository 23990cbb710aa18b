"""What all pages share: one feed, one look at the status, one way to stop. Lives on the live server's thread."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from websockets.asyncio.server import ServerConnection

from . import frames
from .client import Client
from .control_link import ControlLink, LinkError
from .decimation import LATENESS_EDGES_US
from .feed import CAPTURE_S, Feed

FRAMES_HZ = 25.0
STATUS_HZ = 10.0
RETRY_S = 0.5
EVENTS = 50


class Hub:
    """The pages that look, and what they are shown."""

    def __init__(self, feed: Feed, control_path: Path, token: str) -> None:
        self.feed, self.control_path, self.token = feed, control_path, token
        self.clients: set[Client] = set()
        self._link = ControlLink(control_path, self._hear)  # stands all the time: a stop finds its way open
        self._somebody = asyncio.Event()
        self._status_hz = -1.0
        self._state = ""
        self._loop: int | None = -1

    async def serve(self, connection: ServerConnection) -> None:
        """One page, until it goes."""
        client = Client(self, connection)
        try:
            client.offer(await self._greeting())
        except LinkError:
            return
        self.clients.add(client)
        self._somebody.set()
        try:
            await client.live()
        finally:
            self.clients.discard(client)

    async def _greeting(self) -> str:
        info, status = await self._link.call("info"), await self._link.call("status")
        events = await self._link.call("events", limit=EVENTS)
        return frames.text(
            "hello", info={name: info[name] for name in ("axis", "profiles", "fffo_drive")}, status=status,
            events=events["events"], fields=frames.fields(), lateness_edges_us=LATENESS_EDGES_US,
            capture_s=CAPTURE_S, **self.feed.facts(),
        )  # fmt: skip

    async def run(self) -> None:
        """Read the ring and tell everybody, while there is anybody; for ever."""
        while True:
            await self._subscribe()
            if not self.clients:
                self._somebody.clear()
                self.feed.end()
                try:
                    await asyncio.wait_for(self._somebody.wait(), RETRY_S)
                except TimeoutError:
                    continue
                self.feed.begin()
            self._turn()
            await asyncio.sleep(1.0 / FRAMES_HZ)

    def _turn(self) -> None:
        facts = self.feed.facts()
        if facts["loop"] != self._loop:
            self._loop = facts["loop"]
            self._tell(frames.text("loop", **facts))
        frame = self.feed.poll()
        if frame is not None:
            self._tell(frame)

    def _tell(self, frame: str | bytes) -> None:
        for client in list(self.clients):
            client.offer(frame)

    async def _subscribe(self) -> None:
        """Statuses while somebody looks; events always, so that the connection is never taken for forgotten."""
        wanted = STATUS_HZ if self.clients else 0.0
        if self._link.is_open and wanted == self._status_hz:
            return
        try:
            await self._link.call("subscribe", status_hz=wanted, events=True)
            self._status_hz = wanted
        except LinkError:
            self._status_hz = -1.0
            await asyncio.sleep(RETRY_S)

    def _hear(self, method: str, params: dict[str, Any]) -> None:
        if method == "status":
            self._state = params["state"]
            self._tell(frames.text("status", status=params))
        elif method == "event":
            self._tell(frames.text("event", event=params))

    async def stop(self) -> Any:
        """Brake to standstill, then no torque; asked for again while it stops: the drive's quick stop."""
        method = "quick_stop" if self._state == "stopping" else "disable"
        result = await self._link.call(method, wait_s=0.0)
        self._state = result["state"]
        return {"method": method, **result}

    def close(self) -> None:
        """Drop everybody."""
        for client in list(self.clients):
            client.drop("the service ends")
        self._link.close()
