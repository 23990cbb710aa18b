"""Distribution of events: to the journal, the recording, and subscribed clients."""

from __future__ import annotations

import heapq
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from typing import Any

from ..recording.events import Level, utc_text
from .journal import Journal

KEPT = 1000
# kinds that clients can cause at any rate, and the number reported per second; more are only counted. They are stored
# separately, so that they do not displace others.
CAUSED_BY_CLIENTS = {"client": 1, "command": 20, "parameters": 20}

Listener = Callable[[dict[str, Any]], None]


class EventLog:
    """The last events, numbered from 1, for any thread. `context` adds fields (state, fault) for the journal."""

    def __init__(
        self, journal: Journal, context: Callable[[], Mapping[str, Any]] = dict,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._journal = journal
        self._context = context
        self._clock = clock
        self._lock = threading.RLock()  # a listener may add an event, too
        self._events: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._caused: deque[dict[str, Any]] = deque(maxlen=KEPT)  # by clients
        self._number = 0
        self._second_s = clock()
        self._counts: Counter[str] = Counter()  # in this second, by kind
        self._suppressed: dict[str, str] = {}  # kinds with more, and the last of these
        self.listeners: list[Listener] = []

    @property
    def last_number(self) -> int:
        """Number of the newest event; 0 before the first."""
        return self._number

    def add(self, kind: str, text: str, level: Level = Level.INFO, data: Mapping[str, Any] | None = None) -> None:
        """Add an event and distribute it. `kind` is a key of journal.MESSAGE_IDS.

        Events that clients cause too often are counted, and reported as one event at the end of the second.
        """
        with self._lock:
            self.turn()
            if kind in CAUSED_BY_CLIENTS:
                self._counts[kind] += 1
                if self._counts[kind] > CAUSED_BY_CLIENTS[kind]:
                    self._suppressed[kind] = text
                    return
            self._add(kind, text, level, data)

    def tell_disk(self, text: str, silent: bool) -> None:
        """A disk does not answer, or does again (of a `Worker`)."""
        self.add("files", text, Level.ERROR if silent else Level.INFO)

    def turn(self) -> None:
        """Report counted events once their second is over. Call this periodically."""
        with self._lock:
            now_s = self._clock()
            if now_s - self._second_s < 1.0:
                return
            counts, suppressed = self._counts, self._suppressed
            self._second_s, self._counts, self._suppressed = now_s, Counter(), {}
            for kind, last in suppressed.items():
                count = counts[kind] - CAUSED_BY_CLIENTS[kind]
                self._add(kind, f"{count} more in a second, the last: {last}", Level.WARNING, {"count": count})

    def _add(self, kind: str, text: str, level: Level, data: Mapping[str, Any] | None) -> None:
        self._number += 1
        event = {
            "number": self._number,
            "time": utc_text(time.time_ns()),
            "kind": kind,
            "level": level.name.lower(),
            "text": text,
            "data": dict(data or {}),
        }
        (self._caused if kind in CAUSED_BY_CLIENTS else self._events).append(event)
        self._journal.write(kind, level, text, {**self._context(), **(data or {})})
        for listener in list(self.listeners):
            listener(event)

    def since(self, number: int, limit: int) -> list[dict[str, Any]]:
        """The newest `limit` events after `number`, oldest first; events caused by clients fill half, or the free
        space.
        """
        with self._lock:
            others = [event for event in self._events if event["number"] > number][-limit:]
            caused = [event for event in self._caused if event["number"] > number]
        caused = caused[max(0, len(caused) - max(limit // 2, limit - len(others))) :]
        others = others[max(0, len(others) - (limit - len(caused))) :]
        return list(heapq.merge(others, caused, key=lambda event: int(event["number"])))
