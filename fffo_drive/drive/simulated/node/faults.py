"""Fault injection: a schedule from the configuration, and object 0x2100 at run time.

0x2100: sub 1 the kind, 2 the CAN-ID concerned (0: all), 3 the probability in thousandths, 4 the value, 5 the
duration in ms (0: until cleared), then 6 the trigger: 1 injects (right after the answer), 2 clears everything; 7
counts the faults in effect. The value is microseconds for a delay (8: and up to so many more, by chance),
thousandths of a revolution for a resolver, hertz for an EMCY storm.
"""

from __future__ import annotations

import heapq
import random
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from ....canopen_node.abort import Abort, SdoAbortError
from ....canopen_node.bus import NEVER, NS_PER_MS, Bus, Timed
from ....canopen_node.dictionary import ObjectDictionary
from ....canopen_node.emcy import MANUFACTURER, EmergencyProducer
from ....units import NS_PER_S
from ..ranges import key, required_note
from .fault_wire import FaultyWire, WireEffect, WireRule
from .objects import OVERCURRENT, OVERTEMPERATURE, RESOLVER

if TYPE_CHECKING:
    from .fault_target import FaultTarget

INJECTION = 0x2100
TRIGGER_INJECT, TRIGGER_CLEAR = 1, 2
LONGEST_DELAY_US = 10_000_000


class FaultKind(IntEnum):
    """What can go wrong."""

    DROP_SENT = 1
    DROP_RECEIVED = 2
    DUPLICATE_SENT = 3
    DUPLICATE_RECEIVED = 4
    DELAY_SENT = 5
    DELAY_RECEIVED = 6
    REORDER_SENT = 7
    REORDER_RECEIVED = 8
    NO_SYNC_ANSWER = 9
    NO_HEARTBEAT = 10
    NO_RPDO = 11
    SILENCE = 12
    RESOLVER_LOSS = 20
    DC_LINK_LOSS = 21
    OVERCURRENT = 22
    OVERTEMPERATURE = 23
    STUCK_STATUSWORD = 24
    EMCY_STORM = 25
    REBOOT = 26
    BUS_OFF = 27
    RESOLVER_SLIP = 28  # the tracking loop locks to another angle, and nothing reports it


_WIRE_EFFECTS = {
    FaultKind.DROP_SENT: (WireEffect.DROP, True),
    FaultKind.DROP_RECEIVED: (WireEffect.DROP, False),
    FaultKind.DUPLICATE_SENT: (WireEffect.DUPLICATE, True),
    FaultKind.DUPLICATE_RECEIVED: (WireEffect.DUPLICATE, False),
    FaultKind.DELAY_SENT: (WireEffect.DELAY, True),
    FaultKind.DELAY_RECEIVED: (WireEffect.DELAY, False),
    FaultKind.REORDER_SENT: (WireEffect.REORDER, True),
    FaultKind.REORDER_RECEIVED: (WireEffect.REORDER, False),
    FaultKind.NO_SYNC_ANSWER: (WireEffect.DROP, True),
    FaultKind.NO_HEARTBEAT: (WireEffect.DROP, True),
    FaultKind.NO_RPDO: (WireEffect.DROP, False),
}
_CONDITIONS = {  # fault conditions of the drive that a fault holds present
    FaultKind.RESOLVER_LOSS: RESOLVER,
    FaultKind.OVERCURRENT: OVERCURRENT,
    FaultKind.OVERTEMPERATURE: OVERTEMPERATURE,
}
DARK_KINDS = frozenset({FaultKind.SILENCE, FaultKind.REBOOT, FaultKind.BUS_OFF})


@dataclass(frozen=True)
class Fault:
    """One fault."""

    kind: FaultKind = required_note(  # noqa: RUF009  # a field
        "what goes wrong; sent: with frames that the drive sends, received: with frames to the drive"
    )
    at_s: float = key(0.0, "s", 0.0, 1e6, "when it begins, since the node started")
    duration_s: float = key(0.0, "s", 0.0, 1e6, "how long it lasts; 0: until cleared")
    can_id: int = key(0, "-", 0, 0x7FF, "CAN id of the frames that are dropped, duplicated, ...; 0: all")
    probability: float = key(1.0, "-", 0.0, 1.0, "share of these frames that is affected")
    delay_s: float = key(0.0, "s", 0.0, 10.0, "delay of a delayed frame")
    jitter_s: float = key(0.0, "s", 0.0, 10.0, "random addition to this delay, up to this value")
    jump_rev: float = key(0.0, "rev", -1e4, 1e4, "the angle jumps by this when the resolver is lost or slips")
    rate_hz: float = key(100.0, "Hz", 0.1, 10_000.0, "rate of an EMCY storm")


class FaultInjector(Timed):
    """Starts and ends faults at their times. While `dark`, no frame passes."""

    def __init__(
        self,
        bus: Bus,
        od: ObjectDictionary,
        emergency: EmergencyProducer,
        device: FaultTarget,
        schedule: tuple[Fault, ...],
        seed: int,
    ) -> None:
        super().__init__(bus)
        self.od, self.emergency, self.device = od, emergency, device
        chance = random.Random(seed)
        self.sent, self.received = FaultyWire(chance), FaultyWire(chance)
        self._schedule = list(schedule)
        self._events: list[tuple[int, int, bool, Fault]] = []  # time, order, whether it begins, fault
        self._order = 0
        self._active: list[Fault] = []
        self._storm_ns = NEVER
        self._storm_step_ns = NEVER
        self._storm_count = 0
        self.dark = False  # off the bus
        self.quiet = True  # frames pass unhindered
        self._injection = od.place(INJECTION)
        od.guard(self._injection, self._check)
        od.on_write(self._injection, self._on_write)
        od.on_read(self._injection, self._read)

    def start(self) -> None:
        """The node starts: `at_s` counts from now."""
        for fault in self._schedule:
            self._plan(self.bus.now_ns + round(fault.at_s * NS_PER_S), True, fault)

    def poll(self) -> None:
        """Begin and end what is due."""
        while self._events and self._events[0][0] <= self.bus.now_ns:
            _, _, begins, fault = heapq.heappop(self._events)
            if begins:
                self.inject(fault)
            elif fault in self._active:
                self._end(fault)
        if self._storm_ns <= self.bus.now_ns:
            self._blow()
        self.take_stock()

    def take_stock(self) -> None:
        """Update `dark`, `quiet` and the deadline, after any change."""
        self.dark = any(fault.kind in DARK_KINDS for fault in self._active)
        self.quiet = self.sent.idle and self.received.idle and not self.dark
        begin_or_end = self._events[0][0] if self._events else NEVER
        self.deadline_ns = min(begin_or_end, self._storm_ns, self.sent.deadline_ns, self.received.deadline_ns)

    def inject(self, fault: Fault) -> None:
        """Begin a fault now."""
        self._active.append(fault)
        if fault.duration_s > 0.0:
            self._plan(self.bus.now_ns + round(fault.duration_s * NS_PER_S), False, fault)
        self._switch(fault, True)
        self.renew()

    def renew(self) -> None:
        """Set the rules of the wire again from the faults in effect and the identifiers in use."""
        self.sent.rules.clear()
        self.received.rules.clear()
        for fault in self._active:
            if fault.kind in _WIRE_EFFECTS:
                effect, outgoing = _WIRE_EFFECTS[fault.kind]
                (self.sent if outgoing else self.received).rules.append(self._rule(effect, fault))
        self.take_stock()

    def clear(self) -> None:
        """End every fault, and forget those planned."""
        self._events.clear()
        for fault in list(self._active):
            self._end(fault)
        self.sent.clear()
        self.received.clear()
        self.take_stock()

    def _plan(self, at_ns: int, begins: bool, fault: Fault) -> None:
        self._order += 1
        heapq.heappush(self._events, (at_ns, self._order, begins, fault))
        self.take_stock()

    def _rule(self, effect: WireEffect, fault: Fault) -> WireRule:
        can_ids = frozenset({fault.can_id}) if fault.can_id else self.device.can_ids_of(fault.kind)
        delay_ns, jitter_ns = round(fault.delay_s * NS_PER_S), round(fault.jitter_s * NS_PER_S)
        return WireRule(effect, can_ids, fault.probability, delay_ns, jitter_ns)

    def _end(self, fault: Fault) -> None:
        self._active.remove(fault)
        self.renew()
        if not any(other.kind is fault.kind for other in self._active):
            self._switch(fault, False)

    def _switch(self, fault: Fault, present: bool) -> None:
        """Begin or end a fault that does not act on frames."""
        device, kind = self.device, fault.kind
        if kind in _CONDITIONS:
            device.hold_condition(_CONDITIONS[kind], present)
        if kind is FaultKind.RESOLVER_LOSS:
            device.lose_resolver(present, fault.jump_rev)
        elif kind is FaultKind.RESOLVER_SLIP and present:
            device.lose_resolver(True, fault.jump_rev)
            device.lose_resolver(False, 0.0)
        elif kind is FaultKind.DC_LINK_LOSS:
            device.lose_dc_link(present)
        elif kind is FaultKind.STUCK_STATUSWORD:
            device.stick_statusword(present)
        elif kind is FaultKind.EMCY_STORM:
            self._storm_step_ns = round(NS_PER_S / fault.rate_hz)
            self._storm_ns = self.bus.now_ns if present else NEVER
        elif kind is FaultKind.REBOOT:
            (device.power_down if present else device.power_up)()
        elif kind is FaultKind.BUS_OFF:
            device.bus_off(present)

    def _blow(self) -> None:
        while self._storm_ns <= self.bus.now_ns:
            self._storm_count += 1
            self.emergency.announce(MANUFACTURER, self._storm_count)
            self._storm_ns += self._storm_step_ns

    # object 0x2100

    def _check(self, sub: int, value: int) -> None:
        if sub == 1 and value and value not in FaultKind._value2member_map_:
            raise SdoAbortError(Abort.INVALID_VALUE)
        if sub == 6 and value == TRIGGER_INJECT and not self.od.number(self._injection, 1):
            raise SdoAbortError(Abort.DEVICE_STATE)

    def _on_write(self, sub: int, value: int) -> None:
        if sub != 6:
            return
        if value == TRIGGER_CLEAR:
            self.clear()
        elif value == TRIGGER_INJECT:
            number = self.od.number
            amount = number(self._injection, 4)
            fault = Fault(
                kind=FaultKind(number(self._injection, 1)),
                duration_s=number(self._injection, 5) * NS_PER_MS / NS_PER_S,
                can_id=number(self._injection, 2),
                probability=number(self._injection, 3) / 1000.0,
                delay_s=min(max(0, amount), LONGEST_DELAY_US) / 1e6,
                jitter_s=min(number(self._injection, 8), LONGEST_DELAY_US) / 1e6,
                jump_rev=amount / 1000.0,
                rate_hz=min(max(float(amount), 0.1), 10_000.0),
            )
            self._plan(self.bus.now_ns, True, fault)  # after the answer: the client that injects a silence gets it

    def _read(self, sub: int) -> int:
        return len(self._active) if sub == 7 else self.od.number(self._injection, sub)
