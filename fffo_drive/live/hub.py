"""Shared by all who look: one feed and one status poll. Stops use a connection of their own.

Runs on the live server's thread. Each status and each batch of rows is made into a frame once, for all pages.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from websockets.asyncio.server import ServerConnection

from . import frames
from .client import LiveClient
from .control_link import ControlLink, ControlLinkError
from .decimation import LATENESS_EDGES_US
from .feed import CAPTURE_S, Feed
from .keys import Keys
from .services import WHO, ServiceMethod

if TYPE_CHECKING:
    from .viewers import Viewers

FRAMES_HZ = 50.0  # one per bin: a page draws each of them, as fast as its machine can
STATUS_HZ = 10.0
RETRY_S = 0.5
EVENTS = 50


class Hub:
    """The connected pages, and the data that they and the viewers get."""

    def __init__(self, feed: Feed, control_path: Path, keys: Keys, methods: Mapping[str, ServiceMethod]) -> None:
        """`methods`: those of the control API, by name."""
        self.feed, self.control_path, self.keys, self.methods = feed, control_path, keys, methods
        self.clients: set[LiveClient] = set()
        self.audience: Viewers | None = None
        self.link = ControlLink(control_path, self._hear)
        self.stops = ControlLink(control_path)  # kept open, and used for stops only
        self._greeted: asyncio.Task[str | None] | None = None
        self._somebody = asyncio.Event()
        self._status_hz = -1.0
        self._state = ""
        self._loop: int | None = -1

    async def serve(self, connection: ServerConnection) -> None:
        """Serve one page until it leaves."""
        client = LiveClient(self, connection)
        greeting = await self._greeting()
        if greeting is None:
            return
        client.offer(greeting)
        self.clients.add(client)
        self._somebody.set()
        try:
            await client.live()
        finally:
            self.clients.discard(client)

    async def _greeting(self) -> str | None:
        """Asked once for all pages that connect meanwhile; None without a daemon."""
        if self._greeted is None or self._greeted.done():
            self._greeted = asyncio.create_task(self._make_greeting())
        return await asyncio.shield(self._greeted)

    async def _make_greeting(self) -> str | None:
        try:
            info, status = await self.link.call("info"), await self.link.call("status")
            events = await self.link.call("events", {"limit": EVENTS})
        except ControlLinkError:
            return None
        return frames.text(
            "hello", info={name: info[name] for name in ("axis", "profiles", "fffo_drive")}, status=status,
            events=events["events"], fields=frames.fields(), lateness_edges_us=LATENESS_EDGES_US,
            capture_s=CAPTURE_S, **self.feed.facts(),
        )  # fmt: skip

    async def run(self) -> None:
        """Read the ring and send to all clients while there are any; runs for ever."""
        looked = False
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            looking = self._looking
            if looking != looked:
                looked = looking
                self._begin() if looking else self.feed.end()
            await self._subscribe(STATUS_HZ if looking else 0.0)
            if looking:
                self._turn()
                due_s = max(due_s + 1.0 / FRAMES_HZ, loop.time())  # a late turn is not repeated
                await asyncio.sleep(due_s - loop.time())
            else:
                await self._wait_for_somebody()

    def _begin(self) -> None:
        self.feed.begin()
        if self.audience is not None:
            self.audience.begin()

    @property
    def _looking(self) -> bool:
        return bool(self.clients) or (self.audience is not None and self.audience.looking)

    async def _wait_for_somebody(self) -> None:
        self._somebody.clear()
        try:
            await asyncio.wait_for(self._somebody.wait(), RETRY_S)
        except TimeoutError:
            return

    def _turn(self) -> None:
        facts = self.feed.facts()
        if facts["loop"] != self._loop:
            self._loop = facts["loop"]
            self._tell(frames.text("loop", **facts))
            if self.audience is not None:
                self.audience.begin()
        taken = self.feed.poll()
        if taken is None:
            return
        if self.clients:
            self._tell(taken.frame())
        if self.audience is not None:
            self.audience.rows(taken)

    def _tell(self, frame: str | bytes) -> None:
        for client in list(self.clients):
            client.offer(frame)

    async def _subscribe(self, wanted_hz: float) -> None:
        """Status polls while a client looks; events always, so that the connection is never idle for long."""
        try:
            if not self.stops.is_open:
                await self.stops.call("subscribe", {"status_hz": 0.0, "events": True})
            if not self.link.is_open or wanted_hz != self._status_hz:
                await self.link.call("subscribe", {"status_hz": wanted_hz, "events": True})
                self._status_hz = wanted_hz
        except ControlLinkError:
            self._status_hz = -1.0
            await asyncio.sleep(RETRY_S)

    def _hear(self, method: str, params: dict[str, Any]) -> None:
        if method not in ("status", "event"):
            return
        if method == "status":
            self._state = params["state"]
        self._tell(frames.text(method, **{method: params}))
        if self.audience is not None:
            getattr(self.audience, method)(params)

    async def stop(self, who: str) -> Any:
        """Brake to standstill, then no torque; requested again while it brakes: the drive's quick stop."""
        method = "quick_stop" if self._state == "stopping" else "disable"
        result = await self.stops.call(method, {"wait_s": 0.0, WHO: who})
        self._state = result["state"]
        return {"method": method, **result}

    def close(self) -> None:
        """Drop everybody."""
        for client in list(self.clients):
            client.drop("the daemon ends")
        self.link.close()
        self.stops.close()
