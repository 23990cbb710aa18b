"""The model's effects in a running daemon: which are in service, and the monitor that removes harmful ones.

An effect removed by the monitor stays out, also across a lost drive, until a model (even the same) is put in service.
The rows are read ten times a second, and only while effects are compensated and monitored.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ..config.effects import service_bits
from ..control.compensation import ALL_EFFECTS
from ..recording.events import Level
from ..recording.ring_reader import RingReader
from ..runtime import blocks as b
from ..runtime.effect_monitor import Phase
from ..workflows.plan import Plan, effect_monitor
from .connection import Connection
from .event_log import EventLog

LOOK_S = 0.1
NOT_WATCHED = "not watched"
TAKEN_OUT = "tracking got worse with it"


class Item(NamedTuple):
    """An effect of the model in use."""

    name: str
    bit: int | None  # None: not compensated
    reason: str | None  # why not


class EffectsWatch:
    """Effects of one model at a time, on one connection at a time."""

    def __init__(self, plan: Plan, log: EventLog) -> None:
        self._log = log
        self._connection: Connection | None = None
        self._reader: RingReader | None = None
        self._looked_s = 0.0
        self.begin(plan)

    def begin(self, plan: Plan) -> None:
        """A new model, or the same again: all effects that can be compensated are in service."""
        self._monitor = effect_monitor(plan)
        self._items = [Item(s.effect.name, bit, s.reason) for s, bit in service_bits(plan.axis, plan.model)]
        if self._connection is not None:
            self.attach(self._connection)

    def attach(self, connection: Connection | None) -> None:
        """The loop to monitor from now on; None for none."""
        self._connection, self._reader = connection, None
        if connection is None:
            return
        connection.session.request(b.EFFECTS, self.wanted)
        if self._monitor is not None:
            self._reader = RingReader(connection.session.ring, newest=0)

    @property
    def wanted(self) -> int:
        """Bits wanted in service now."""
        return ALL_EFFECTS if self._monitor is None else self._monitor.effects

    def look(self, now_s: float) -> None:
        """Evaluate the rows since the last call, and change the effects in service."""
        monitor, reader, connection = self._monitor, self._reader, self._connection
        if monitor is None or reader is None or connection is None or now_s - self._looked_s < LOOK_S:
            return
        self._looked_s = now_s
        for decision in monitor.observe(reader.read().rows):
            connection.session.request(b.EFFECTS, decision.effects)
            if decision.verdict is not None:
                level = Level.WARNING if decision.verdict.worse else Level.INFO
                data = {"in_service": ", ".join(self.in_service) or "none"}
                self._log.add("effects", monitor.sentence(decision.verdict), level, data)

    @property
    def in_service(self) -> list[str]:
        """Names of the effects not removed by a trial."""
        kept = ALL_EFFECTS if self._monitor is None else self._monitor.state.kept
        return [item.name for item in self._items if item.bit is not None and kept >> item.bit & 1]

    def status(self) -> dict[str, Any]:
        """For the API: activity of the monitor, and each effect with the reason why it is out of service."""
        kept = ALL_EFFECTS if self._monitor is None else self._monitor.state.kept
        found = []
        for item in self._items:
            serves = item.bit is not None and bool(kept >> item.bit & 1)
            reason = None if serves else item.reason or TAKEN_OUT
            found.append({"name": item.name, "in_service": serves, "reason": reason})
        return {"monitor": self._phase, "list": found}

    @property
    def _phase(self) -> str:
        if self._monitor is None:
            return NOT_WATCHED
        return "on trial" if self._monitor.state.phase is Phase.TRIAL else "watched"
