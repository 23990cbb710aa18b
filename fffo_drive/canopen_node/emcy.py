"""Emergency object (CiA 301, 7.2.7): errors that exist, 0x1001, the history 0x1003, the EMCY messages.

An error is identified by its code and a detail (such as the silent node). One message announces it and one its end,
with code 0x0000 and what remains in the error register. In STOPPED nothing is sent; the messages follow afterwards.
"""

from __future__ import annotations

import struct
from collections import deque

from ..can.frame import STANDARD_MASK
from .abort import Abort, SdoAbortError
from .bus import NEVER, NS_PER_100_US, Bus, Timed
from .cob_id import INVALID, check_can_id, is_restricted
from .dictionary import ObjectDictionary
from .nmt import NmtSlave

ERROR_REGISTER = 0x1001
HISTORY = 0x1003
COB_ID_EMCY = 0x1014
INHIBIT_TIME_EMCY = 0x1015

# error codes
COMMUNICATION = 0x8100
HEARTBEAT_LOSS = 0x8130
BUS_OFF_RECOVERED = 0x8140
PDO_LENGTH = 0x8210
PDO_LENGTH_EXCEEDED = 0x8220
SYNC_LENGTH = 0x8240
RPDO_TIMEOUT = 0x8250
SYNC_LOSS = 0x8700
MANUFACTURER = 0xFF00

# those that a reset of the communication ends
COMMUNICATION_ERRORS = frozenset(
    {HEARTBEAT_LOSS, PDO_LENGTH, PDO_LENGTH_EXCEEDED, SYNC_LENGTH, RPDO_TIMEOUT, SYNC_LOSS}
)

QUEUE_LENGTH = 16
_MESSAGE = struct.Struct("<HB5s")
_REGISTER_BITS = {0x2: 0x02, 0x3: 0x04, 0x4: 0x08, 0x7: 0x20, 0xF: 0x80}  # by the first digit of the code


def register_bit(code: int) -> int:
    """The bit of 0x1001 that an error code belongs to, beside bit 0 (generic), which every error sets."""
    if code >> 12 == 0x8:
        return 0x10 if code >> 8 in (0x81, 0x82) else 0x20
    return _REGISTER_BITS.get(code >> 12, 0x01)


class EmergencyProducer(Timed):
    """Errors of the device. 0x1003 bounds the history, 16 the queue to the bus; the oldest are dropped."""

    def __init__(self, bus: Bus, od: ObjectDictionary, nmt: NmtSlave) -> None:
        super().__init__(bus)
        self.od, self.nmt = od, nmt
        self._active: dict[tuple[int, int], None] = {}
        self._queue: deque[bytes] = deque(maxlen=QUEUE_LENGTH)
        self._history: deque[int] = deque(maxlen=len(od.subs(HISTORY)))
        self._allowed_ns = 0  # inhibit time: no message before
        od.guard(HISTORY, self._check_history)
        od.on_write(HISTORY, lambda sub, value: self._history.clear())
        od.on_read(HISTORY, self._read_history)
        od.guard(COB_ID_EMCY, self._check_cob_id)

    def reset(self, whole_node: bool) -> None:
        """After an NMT reset: empty the queue. Errors of the drive survive a reset of the communication."""
        self._queue.clear()
        self._allowed_ns = 0
        self.deadline_ns = NEVER
        if whole_node:
            self._active.clear()
            self._history.clear()
        for error in [e for e in self._active if e[0] in COMMUNICATION_ERRORS]:
            del self._active[error]
        self._update_register()

    def raise_error(self, code: int, detail: int = 0) -> None:
        """Announce an error, unless it exists already. `detail` (32 bit) goes with it."""
        if (code, detail) not in self._active:
            self._active[code, detail] = None
            self._update_register()
            self.announce(code, detail)

    def clear(self, code: int, detail: int | None = None) -> None:
        """An error is gone (with detail None: all of this code)."""
        gone = [k for k in self._active if k[0] == code and detail in (None, k[1])]
        for error in gone:
            del self._active[error]
        if gone:
            self._update_register()
            self._queue.append(_MESSAGE.pack(0, self.od.number(ERROR_REGISTER), b""))
            self.flush()

    def announce(self, code: int, detail: int = 0) -> None:
        """Report an event that leaves no error (it goes into the history)."""
        self._history.appendleft(code | (detail & 0xFFFF) << 16)
        self._queue.append(
            _MESSAGE.pack(code, self.od.number(ERROR_REGISTER), (detail & 0xFFFFFFFF).to_bytes(5, "little"))
        )
        self.flush()

    def _update_register(self) -> None:
        register = 0x01 if self._active else 0x00
        for code, _ in self._active:
            register |= register_bit(code)
        self.od.put(ERROR_REGISTER, 0, register)

    def poll(self) -> None:
        """Send what waited for the inhibit time."""
        self.flush()

    def flush(self) -> None:
        """Send what may be sent now; the rest after the inhibit time."""
        self.deadline_ns = NEVER
        cob_id = self.od.number(COB_ID_EMCY)
        if cob_id & INVALID or is_restricted(cob_id & STANDARD_MASK):
            self._queue.clear()
        if not self.nmt.communicates:
            return
        inhibit_ns = self.od.number(INHIBIT_TIME_EMCY) * NS_PER_100_US
        while self._queue and self.bus.now_ns >= self._allowed_ns:
            self.bus.send(cob_id & STANDARD_MASK, self._queue.popleft())
            self._allowed_ns = self.bus.now_ns + inhibit_ns
        if self._queue:
            self.deadline_ns = self._allowed_ns

    def _read_history(self, sub: int) -> int:
        if sub == 0:
            return len(self._history)
        if sub > len(self._history):
            default = self.od.find(HISTORY, sub).default
            if isinstance(default, int):  # some drives have an empty field, others none
                return default
            raise SdoAbortError(Abort.NO_DATA)
        return self._history[sub - 1]

    def _check_history(self, sub: int, value: int) -> None:
        if value != 0:
            raise SdoAbortError(Abort.INVALID_VALUE)

    def _check_cob_id(self, sub: int, value: int) -> None:
        check_can_id(value & ~INVALID)
        existing = self.od.number(COB_ID_EMCY)
        if not existing & INVALID and not value & INVALID and existing != value:
            raise SdoAbortError(Abort.INVALID_VALUE)
