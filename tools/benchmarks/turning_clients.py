"""Clients that turn the axis, each in a process of its own: `turning_clients.py SOCKET DIRECTORY`, then a line each.

A line on stdin is `jog`, `velocity`, `hold` or `stream N`; the answer is the process id and a file of three int64: the
epoch to name, how many requests were sent, and how many were refused. A program that is imported once and forks is
faster than one that is started for each client.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

from fffo_drive.daemon.client import CallError, ClientError, DaemonClient

RPS = 2.0
STREAM_S = 0.02  # between two set points, 50 Hz
ANSWER_S = 180.0
EPOCH, SENT, REFUSED = range(3)
UNNAMED = 0


class Shared:
    """The three numbers, for both sides."""

    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._words = memoryview(mmap.mmap(file.fileno(), 24)).cast("q")
        self._lock = threading.Lock()

    @staticmethod
    def made(path: Path) -> Path:
        """A file of zeros."""
        path.write_bytes(bytes(24))
        return path

    def __getitem__(self, place: int) -> int:
        return self._words[place]

    def __setitem__(self, place: int, value: int) -> None:
        self._words[place] = value

    def count(self, place: int) -> None:
        """One more."""
        with self._lock:
            self._words[place] += 1


def ask(client: DaemonClient, shared: Shared, **given: Any) -> bool:
    """Ask for a velocity. False if it was refused."""
    shared.count(SENT)
    try:
        client.call("velocity", to_rps=RPS, **given)
    except CallError:
        shared.count(REFUSED)
        return False
    return True


def stream(path: Path, shared: Shared, new_each: bool) -> None:
    """Set points at 50 Hz, whatever it hears."""
    client: DaemonClient | None = None
    while True:
        due_s = time.monotonic() + STREAM_S
        epoch = shared[EPOCH]
        with contextlib.suppress(ClientError):
            client = client or DaemonClient(path, ANSWER_S)
            ask(client, shared, **({"epoch": epoch} if epoch != UNNAMED else {}))
        if new_each and client is not None:
            client.close()
            client = None
        time.sleep(max(0.0, due_s - time.monotonic()))


def turn(path: Path, shared: Shared, method: str) -> None:
    """Turn the axis as `ctl` does. Once it is over, insist: with new requests, of its epoch and of none."""
    with DaemonClient(path, ANSWER_S) as client:
        epoch = client.call("status")["epoch"]
        with contextlib.suppress(CallError):
            if method == "hold":
                epoch = client.call("enable", hold=True)["epoch"]
                client.call("velocity", to_rps=RPS, run_on=True, epoch=epoch)
                client.call("subscribe", status_hz=10)
                while client.next_notification(ANSWER_S)["params"].get("held_by", "") is not None:
                    pass
            answer = client.call(method, to_rps=RPS, epoch=epoch)
            while True:
                time.sleep(0.25 * answer["renew_within_s"])
                answer = client.call(method, to_rps=RPS, epoch=epoch, renews=answer["set_point"])
        while True:
            ask(client, shared, epoch=epoch)
            ask(client, shared)
            time.sleep(STREAM_S)


def live(path: Path, shared: Shared, words: list[str]) -> None:
    """One client, or a stream of several, until it is killed."""
    if words[0] != "stream":
        turn(path, shared, words[0])
        return
    for number in range(int(words[1])):
        threading.Thread(target=stream, args=(path, shared, number % 2 == 1)).start()
    threading.Event().wait()


def main() -> None:
    """Until stdin ends."""
    path, directory = Path(sys.argv[1]), Path(sys.argv[2])
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    for number, line in enumerate(sys.stdin):
        file = Shared.made(directory / str(number))
        child = os.fork()
        if child == 0:
            try:
                live(path, Shared(file), line.split())
            finally:
                os._exit(0)
        print(child, file, flush=True)


if __name__ == "__main__":
    main()
