"""A daemon without a drive, its live server on a free port, and a ring that the test writes into."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from daemon.rig import PATIENCE_S, Rig
from live.viewer import CLIENT
from websockets.sync.client import ClientConnection, connect

from fffo_drive.config.address import Address
from fffo_drive.daemon.parameters import METHODS
from fffo_drive.daemon.places import CONTROL
from fffo_drive.live import frames
from fffo_drive.live.feed import FeedSource
from fffo_drive.live.server import LiveServer, WantedServices
from fffo_drive.live.services import ServiceMethod
from fffo_drive.runtime.ring import new_ring


class ScopeRig:
    """`rig` is the daemon, `server` the live server."""

    def __init__(
        self, directory: Path, ring_rows: int = 4096, viewers: bool = False, daemon: Any = None,
        methods: Mapping[str, ServiceMethod] = METHODS,
    ) -> None:  # fmt: skip
        self.ring = new_ring(ring_rows)
        self.rig = daemon or Rig(directory, drive=False)
        self.source: FeedSource | None = FeedSource(1, self.ring, 2000.0, 0.148)
        free = Address("127.0.0.1", 0)
        wanted = WantedServices(free, free if viewers else None)
        self.server = LiveServer(wanted, self.rig.sockets, CONTROL, lambda: self.source, methods, "bench")
        self._pages = contextlib.ExitStack()

    def __enter__(self) -> ScopeRig:
        self.rig.__enter__()
        self.server.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.server.close()
        self._pages.close()
        self.rig.__exit__(*error)

    @property
    def port(self) -> int:
        assert self.server.wanted.scope is not None
        return self.server.wanted.scope.port

    @property
    def origin(self) -> str:
        return self.server.url.rstrip("/")

    def open(self, key: bool = False, **options: Any) -> ClientConnection:
        """A page, after its greeting; with the key, or to look."""
        address = self.origin.replace("http", "ws") + (f"/live?key={self.server.key}" if key else "/live")
        page = self._pages.enter_context(connect(address, **CLIENT | {"origin": self.origin} | options))
        assert hear(page, "hello")["info"]["axis"]
        if key:
            say(page, do="token", token=self.server.key)
            assert hear(page, "rights")["role"] == "tune"
        return page

    def leave(self) -> None:
        """Close all pages, until the server knows."""
        self._pages.close()
        self.until(lambda: not self.server.hub.clients and self.server.hub.feed._reader is None)

    def until(self, condition: Callable[[], bool]) -> None:
        """Wait for something that the server's thread does."""
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline_s
            time.sleep(0.02)


def taken_apart(frame: bytes) -> tuple[dict[str, Any], bytes]:
    """Head and payload of a binary frame."""
    length = int.from_bytes(frame[: frames.HEAD_BYTES], "little")
    head: dict[str, Any] = json.loads(frame[frames.HEAD_BYTES : frames.HEAD_BYTES + length])
    return head, frame[frames.HEAD_BYTES + length :]


def hear(page: ClientConnection, kind: str) -> dict[str, Any]:
    """The next message of this kind; a binary one has its numbers as `payload`."""
    while True:
        message = page.recv(timeout=PATIENCE_S)
        if isinstance(message, bytes):
            head, payload = taken_apart(message)
            content = {**head, "payload": payload}
        else:
            content = json.loads(message)
        if content["kind"] == kind:
            return content


def say(page: ClientConnection, **content: Any) -> None:
    """A message of the page."""
    page.send(json.dumps(content))
