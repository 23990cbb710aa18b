"""What happened, once for everybody: the journal, the recording, and clients that listen."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from ..recording.events import Level, utc_text
from ..runtime.journal import Journal

KEPT = 1000

Listener = Callable[[dict[str, Any]], None]


class EventLog:
    """The last events, numbered from 1. `context` adds fields (state, fault) to what goes to the journal."""

    def __init__(self, journal: Journal, context: Callable[[], Mapping[str, Any]] = dict) -> None:
        self._journal = journal
        self._context = context
        self._events: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._number = 0
        self.listeners: list[Listener] = []

    @property
    def last_number(self) -> int:
        """Number of the newest event; 0 before the first."""
        return self._number

    def add(
        self, kind: str, text: str, level: Level = Level.INFO, data: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """Add an event and tell everybody. `kind` is a key of journal.MESSAGE_IDS."""
        self._number += 1
        event = {
            "number": self._number,
            "time": utc_text(time.time_ns()),
            "kind": kind,
            "level": level.name.lower(),
            "text": text,
            "data": dict(data or {}),
        }
        self._events.append(event)
        self._journal.write(kind, level, text, {**self._context(), **(data or {})})
        for listener in list(self.listeners):
            listener(event)
        return event

    def since(self, number: int, limit: int) -> list[dict[str, Any]]:
        """The newest `limit` events after `number`, oldest first."""
        newer = [event for event in self._events if event["number"] > number]
        return newer[-limit:]
