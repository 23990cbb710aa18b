"""Wire faults: frames dropped, doubled, delayed or reordered on their way to or from the node.

Used only while such a fault is in effect. The random generator is seeded, so that a run can be repeated.
"""

from __future__ import annotations

import heapq
import random
from enum import IntEnum
from typing import NamedTuple

from ....can.frame import EXTENDED_MASK
from ....canopen_node.bus import NEVER, identifier


class WireEffect(IntEnum):
    """What happens to a frame."""

    DROP = 1
    DUPLICATE = 2
    DELAY = 3
    REORDER = 4  # it goes after the next one


class WireRule(NamedTuple):
    """Which frames are affected. `can_ids` None: all. A delay is `delay_ns` and up to `jitter_ns` more."""

    effect: WireEffect
    can_ids: frozenset[int] | None = None
    probability: float = 1.0
    delay_ns: int = 0
    jitter_ns: int = 0


class FaultyWire:
    """One direction of the wire. `transfer` gives the frames that arrive now, `due` the delayed ones."""

    def __init__(self, chance: random.Random) -> None:
        self.rules: list[WireRule] = []
        self._chance = chance
        self._delayed: list[tuple[int, int, bytes]] = []
        self._held: list[bytes] = []
        self._sequence = 0

    @property
    def idle(self) -> bool:
        """No rule, and nothing on the way."""
        return not (self.rules or self._delayed or self._held)

    @property
    def deadline_ns(self) -> int:
        """When the next delayed frame arrives."""
        return self._delayed[0][0] if self._delayed else NEVER

    def clear(self) -> None:
        """End all faults; what was delayed or held back is lost."""
        self.rules.clear()
        self._delayed.clear()
        self._held.clear()

    def transfer(self, frame: bytes, now_ns: int) -> list[bytes]:
        """Frames that arrive because this one was sent."""
        arriving = [frame]
        for rule in self.rules:
            concerned = rule.can_ids is None or identifier(frame) & EXTENDED_MASK in rule.can_ids
            if concerned and arriving and self._chance.random() < rule.probability:
                arriving = self._apply(rule, arriving, now_ns)
        if arriving and self._held:
            arriving += self._held
            self._held = []
        return arriving

    def _apply(self, rule: WireRule, frames: list[bytes], now_ns: int) -> list[bytes]:
        if rule.effect is WireEffect.DUPLICATE:
            return [*frames, frames[0]]  # one more per rule: copies of copies would fill the memory
        if rule.effect is WireEffect.DELAY:
            for frame in frames:
                self._sequence += 1
                at_ns = now_ns + rule.delay_ns + round(self._chance.random() * rule.jitter_ns)
                heapq.heappush(self._delayed, (at_ns, self._sequence, frame))
        elif rule.effect is WireEffect.REORDER:
            if self._held:
                return frames
            self._held = frames
        return []

    def due(self, now_ns: int) -> list[bytes]:
        """Delayed frames that arrive by now."""
        frames = []
        while self._delayed and self._delayed[0][0] <= now_ns:
            frames.append(heapq.heappop(self._delayed)[2])
        return frames
