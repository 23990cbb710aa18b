"""Transmit PDOs (CiA 301, 7.2.2): with every n-th SYNC, with a SYNC after an event, on events, on a timer.

The event of type 255 and of type 0 is the device profile's: a change of one of its event objects, where one is
mapped; type 254, and mappings without such an object, take any change of the data.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import Any

from ..can.frame import DATA_OFFSET, pack_frame
from .bus import NEVER, Bus, Timed
from .dictionary import ObjectDictionary
from .nmt import NmtSlave
from .pdo_parameters import EMPTY, EVENT_TYPES, HIGHEST_SYNC_TYPE, PdoParameters


class Tpdo(Timed):
    """One transmit PDO. `on_sync`, `check_event` and `poll` queue its frame when it is due."""

    def __init__(
        self,
        bus: Bus,
        od: ObjectDictionary,
        nmt: NmtSlave,
        number: int,
        on_change: Callable[[], None],
        event_objects: frozenset[int] = frozenset(),
        rtr_required: bool = False,
    ) -> None:
        super().__init__(bus)
        self.od, self.nmt = od, nmt
        self._announce_change = on_change
        self._event_objects = event_objects
        self.parameters = PdoParameters(od, number, False, self._changed, rtr_required)
        self.configure()

    def _changed(self) -> None:
        self.configure()
        self.restart()
        self._announce_change()

    def configure(self) -> None:
        """Take the parameters from the dictionary and prepare the frame."""
        parameters = self.parameters
        self.mapping = parameters.mapping() if parameters.valid else EMPTY
        self.exists = parameters.valid and self.mapping.length > 0
        self.type = parameters.transmission_type
        self.synchronous = self.exists and 1 <= self.type <= HIGHEST_SYNC_TYPE
        self.acyclic = self.exists and self.type == 0
        self.event_driven = self.exists and self.type in EVENT_TYPES
        self._template = bytearray(pack_frame(parameters.can_id, bytes(self.mapping.length)))
        self._pack_into = self.mapping.layout.pack_into
        self._pick = _picker(self.mapping.slots)
        watched = tuple(
            slot
            for slot, entry in zip(self.mapping.slots, self.mapping.entries, strict=True)
            if entry.index in self._event_objects
        )
        self._watch = _picker(watched if watched and self.type != EVENT_TYPES[0] else self.mapping.slots)

    def restart(self) -> None:
        """Start again: the parameters changed, or the node entered or left OPERATIONAL."""
        parameters = self.parameters
        self._awaits_start = parameters.sync_start != 0
        self._syncs = 0
        self._seen: tuple[Any, ...] | None = None  # nothing sent yet: that is an event
        self._allowed_ns = 0
        self.deadline_ns = NEVER
        if self.event_driven and self.nmt.exchanges:
            self.check_event()

    def frame(self) -> bytes:
        """The PDO with the present values."""
        self._pack_into(self._template, DATA_OFFSET, *self._pick(self.od.values))
        return bytes(self._template)

    def on_sync(self, counter: int) -> None:
        """A SYNC came (types 0 to 240; `counter` is 0 where it carries none)."""
        if self._awaits_start and counter:
            if counter != self.parameters.sync_start:
                return
            self._awaits_start = False
            self._syncs = self.type - 1  # the PDO goes out with this SYNC
        if self.synchronous:
            self._syncs += 1
            if self._syncs >= self.type:
                self._syncs = 0
                self.bus.outbox.append(self.frame())
        elif self.acyclic:
            current = self._watch(self.od.values)
            if current != self._seen:
                self._seen = current
                self.bus.outbox.append(self.frame())

    def check_event(self) -> None:
        """Send an event-driven PDO if its data changed, or at the end of the inhibit time."""
        if self._watch(self.od.values) == self._seen:
            return
        if self.bus.now_ns < self._allowed_ns:
            self.deadline_ns = self._allowed_ns
            return
        self._transmit()

    def poll(self) -> None:
        """The inhibit time after an event, or the event timer, ran out."""
        self._transmit()

    def _transmit(self) -> None:
        now_ns = self.bus.now_ns
        self._seen = self._watch(self.od.values)
        self._allowed_ns = now_ns + self.parameters.inhibit_ns
        timer_ns = self.parameters.event_timer_ns
        self.deadline_ns = now_ns + timer_ns if timer_ns else NEVER
        self.bus.outbox.append(self.frame())


def _picker(slots: tuple[int, ...]) -> Callable[[list[Any]], tuple[Any, ...]]:
    """A function from the dictionary's values to the tuple of those in `slots`."""
    if len(slots) == 1:
        only = slots[0]
        return lambda values: (values[only],)
    if not slots:
        return lambda values: ()
    return itemgetter(*slots)
