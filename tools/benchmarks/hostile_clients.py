"""Clients that mean harm, in processes of their own: on both sockets, and viewers that ask for what is refused."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any, NamedTuple

from fffo_drive.daemon.places import CONTROL, WATCH

LONG_LINE_BYTES = 260_000
NOBODY = 65534
VIEWERS = 20
PATIENCE_S = 60.0
SLOW_S = 0.1


class Kind(NamedTuple):
    """What so many clients of a socket do, over and over."""

    count: int
    socket: str
    attack: Callable[[socket.socket], None]
    text: str


def _line(method: str, **params: Any) -> bytes:
    return json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}).encode() + b"\n"


_LONG = _line("info", x="a" * LONG_LINE_BYTES)
_SHORT = _line("info") * 50
_REFUSED_STOPS = _line("stop", bogus=1) * 50


def _long_lines(sock: socket.socket) -> None:
    sock.sendall(_LONG)


def _flood(sock: socket.socket) -> None:
    sock.sendall(_SHORT)
    sock.recv(1 << 16)


def _flood_unread(sock: socket.socket) -> None:
    sock.sendall(_SHORT)


def _refused_stops(sock: socket.socket) -> None:
    sock.sendall(_REFUSED_STOPS)
    sock.recv(1 << 16)


def _slow(sock: socket.socket) -> None:
    for byte in _line("info"):
        sock.sendall(bytes([byte]))
        time.sleep(SLOW_S)


def _silent(sock: socket.socket) -> None:
    sock.settimeout(PATIENCE_S)
    sock.recv(1)


def _connect_only(sock: socket.socket) -> None:
    raise ConnectionResetError


KINDS = (
    Kind(16, WATCH, _long_lines, "lines of 260 kB"),
    Kind(6, WATCH, _flood, "requests without a pause"),
    Kind(6, WATCH, _flood_unread, "requests without a pause, answers not read"),
    Kind(8, WATCH, _connect_only, "connections without a pause"),
    Kind(6, WATCH, _slow, "ten bytes a second"),
    Kind(6, WATCH, _silent, "connected and silent"),
    Kind(4, CONTROL, _long_lines, "lines of 260 kB"),
    Kind(4, CONTROL, _flood, "requests without a pause"),
    Kind(4, CONTROL, _refused_stops, "stops that are refused, without a pause"),
    Kind(4, CONTROL, _slow, "ten bytes a second"),
)
COUNT = sum(kind.count for kind in KINDS)


def _attack(directory: str, kind: Kind, stop: Event, done: Any) -> None:
    while not stop.is_set():
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock, contextlib.suppress(OSError):
            sock.settimeout(1.0)
            sock.connect(f"{directory}/{kind.socket}")
            while not stop.is_set():
                kind.attack(sock)
                done.value += 1


def _clients(directory: str, name: str, stop: Event, done: Any) -> None:
    """All clients of one socket: a process, with no rights where the socket asks for none."""
    if name == WATCH and os.geteuid() == 0:
        os.setgroups([])
        os.setresuid(NOBODY, NOBODY, NOBODY)
    threads = [
        threading.Thread(target=_attack, args=(directory, kind, stop, done), daemon=True)
        for kind in KINDS if kind.socket == name for _ in range(kind.count)
    ]  # fmt: skip
    for thread in threads:
        thread.start()
    stop.wait()


class ViewerCalls:
    """The services of the viewers' WebSocket (protocol foxglove.sdk.v1)."""

    def __init__(self, url: str) -> None:
        from websockets.sync.client import connect

        options: dict[str, Any] = {"subprotocols": ["foxglove.sdk.v1"], "compression": None, "max_size": None}
        self._socket = connect(url, **options, ping_interval=None)
        self._services: dict[str, int] = {}
        self._number = 0
        while not self._services:
            content = self._socket.recv(timeout=PATIENCE_S)
            parsed = json.loads(content) if isinstance(content, str) else {}
            if parsed.get("op") == "advertiseServices":
                self._services = {s["name"].rpartition("/")[2]: s["id"] for s in parsed["services"]}

    def call(self, method: str, params: dict[str, Any]) -> Any:
        """The result. Raises PermissionError with the server's words."""
        self._number += 1
        head = struct.pack("<BIII", 2, self._services[method], self._number, 4)
        self._socket.send(head + b"json" + json.dumps(params).encode())
        while True:
            raw = self._socket.recv(timeout=PATIENCE_S)
            if isinstance(raw, bytes):
                if raw[0] == 3 and struct.unpack_from("<II", raw, 1)[1] == self._number:
                    return json.loads(raw[13 + struct.unpack_from("<I", raw, 9)[0] :])
                continue
            parsed = json.loads(raw)
            if parsed["op"] == "serviceCallFailure" and parsed["callId"] == self._number:
                raise PermissionError(parsed["message"])

    def close(self) -> None:
        """Hang up."""
        self._socket.close()


def _viewers(url: str, stop: Event, done: Any) -> None:
    """Viewers without the key that ask for stops which are refused."""
    from websockets.exceptions import WebSocketException

    def one() -> None:
        while not stop.is_set():
            with (
                contextlib.suppress(WebSocketException, OSError, TimeoutError),
                contextlib.closing(ViewerCalls(url)) as viewer,
            ):
                while not stop.is_set():
                    with contextlib.suppress(PermissionError):
                        viewer.call("stop", {"bogus": 1})
                    done.value += 1

    threads = [threading.Thread(target=one, daemon=True) for _ in range(VIEWERS)]
    for thread in threads:
        thread.start()
    stop.wait()


@contextlib.contextmanager
def hostile(directory: Path, viewers_url: str | None = None) -> Iterator[list[Any]]:
    """All of them as long as the block lasts. Yields counters of what they did, by process."""
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    targets: list[tuple[Any, tuple[Any, ...]]] = [(_clients, (str(directory), name)) for name in (WATCH, CONTROL)]
    if viewers_url:
        targets.append((_viewers, (viewers_url,)))
    counters = [context.Value("q", 0, lock=False) for _ in targets]
    processes = [
        context.Process(target=target, args=(*arguments, stop, counter), daemon=True)
        for (target, arguments), counter in zip(targets, counters, strict=True)
    ]
    for process in processes:
        process.start()
    try:
        deadline_s = time.monotonic() + PATIENCE_S
        while not all(counter.value for counter in counters) and time.monotonic() < deadline_s:
            time.sleep(0.05)
        yield counters
    finally:
        stop.set()
        for process in processes:
            process.join(5.0)
            if process.is_alive():
                process.kill()
                process.join()


def described() -> list[tuple[str, str, str]]:
    """What they do, for the report."""
    return [(str(kind.count), kind.socket, kind.text) for kind in KINDS]
