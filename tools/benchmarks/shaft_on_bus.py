"""The shaft as the drive sends it: position and time of every answer to SYNC, heard on the bus beside the daemon."""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from typing import Any

import numpy as np

from fffo_drive.can.bpf import CanFilter
from fffo_drive.can.frame import TPDO1, Frame, unpack_frame
from fffo_drive.can.link import open_link
from fffo_drive.config.drive_section import CanopenDriveSection
from fffo_drive.workflows.plan import Plan

FUNCTION_MASK = 0x780  # of an identifier: all but the node
KEPT = 1 << 15  # frames, 16 s at 2 kHz
SPEED_S = 0.01  # over which a speed is taken
MOVES_RPS = 0.1  # faster than that the shaft moves; at standstill the loop holds it with some hundredths
PATIENCE_S = 30.0
TURNS_S = 5.0  # until it turns


class ShaftError(Exception):
    """The shaft does not do what a race needs; the race does not count."""


class BusListener:
    """Hears frames of these functions (CiA 301: an identifier without its node) until `close`, on a thread of its own.

    Times are CLOCK_REALTIME, as the kernel stamps the frames, ns. A link does not hear what it sends itself.
    """

    def __init__(self, bus: str, *functions: int) -> None:
        self._link = open_link(bus, filters=[CanFilter(function, FUNCTION_MASK) for function in functions])
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while not self._end.is_set():
            heard = self._link.receive_stamped(0.2)
            if heard is not None:
                self.hear(round(heard.time_s * 1e9), unpack_frame(heard.raw))

    @abstractmethod
    def hear(self, at_ns: int, frame: Frame) -> None:
        """Take one frame."""

    def send(self, raw: bytes) -> None:
        """A frame of somebody else's."""
        self._link.send(raw)

    def close(self) -> None:
        """Hear no more."""
        self._end.set()
        self._thread.join()
        self._link.close()


class ShaftOnBus(BusListener):
    """Positions of the shaft, as the drive sends them."""

    def __init__(self, bus: str, plan: Plan) -> None:
        drive = plan.axis.drive
        assert isinstance(drive, CanopenDriveSection)
        self._counts_per_rev = float(drive.counts)
        self._time_ns, self._counts = np.zeros(KEPT, np.int64), np.zeros(KEPT, np.int64)
        self._heard = 0
        super().__init__(bus, TPDO1)

    def hear(self, at_ns: int, frame: Frame) -> None:
        """TPDO1 is velocity, then position, 32 bits each (drive/canopen/object_map)."""
        place = self._heard % KEPT
        self._time_ns[place] = at_ns
        self._counts[place] = int.from_bytes(frame.data[4:8], "little", signed=True)
        self._heard += 1

    def between(self, begin_ns: int, end_ns: int) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
        """(times in ns, positions in rev) of what was sent in between, shape (n,) each; waits until all is heard.

        Raises ShaftError where the drive sends nothing any more.
        """
        deadline_s = time.monotonic() + PATIENCE_S
        while not self._heard or self._time_ns[(self._heard - 1) % KEPT] < end_ns:
            if time.monotonic() > deadline_s:
                raise ShaftError("the drive sends nothing on the bus")
            time.sleep(0.001)
        return self.heard_between(begin_ns, end_ns)

    def heard_between(self, begin_ns: int, end_ns: int) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
        """As `between`, without waiting: the drive may have been silenced."""
        last = self._heard
        places = np.arange(max(0, last - KEPT + 1), last) % KEPT
        times_ns = self._time_ns[places]
        within = (times_ns >= begin_ns) & (times_ns <= end_ns)
        return times_ns[within], self._counts[places[within]] / self._counts_per_rev

    def travel_rev(self, begin_ns: int, end_ns: int) -> float:
        """From the smallest to the largest position in between."""
        positions = self.between(begin_ns, end_ns)[1]
        return float(np.ptp(positions)) if positions.size else 0.0

    def moved_rev(self, begin_ns: int, watched_s: float) -> float:
        """Travel within this time from `begin_ns` on; waits for its end."""
        return self.travel_rev(begin_ns, begin_ns + int(1e9 * watched_s))

    def until_turns(self, rps: float) -> None:
        """Wait until it turns at this speed. Raises ShaftError."""
        deadline_s = time.monotonic() + TURNS_S
        while True:
            now_ns = time.time_ns()
            times_ns, positions = self.between(now_ns - int(2e9 * SPEED_S), now_ns)
            if times_ns.size > 1 and abs(positions[-1] - positions[0]) * 1e9 >= rps * (times_ns[-1] - times_ns[0]):
                return
            if time.monotonic() > deadline_s:
                raise ShaftError(f"the axis does not turn at {rps:g} rps")
            time.sleep(0.002)

    def until_rests(self, since_ns: int) -> int:
        """Wait until it stands still. Returns when it moved last. Raises RuntimeError."""
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            now_ns = time.time_ns()
            times_ns, positions = self.between(now_ns - int(5e9 * SPEED_S), now_ns)
            # of a drive that a busy machine kept silent for a part of it nobody knows
            heard = times_ns.size > 1 and times_ns[-1] - times_ns[0] > 4e9 * SPEED_S
            if heard and np.ptp(positions) <= MOVES_RPS * 5 * SPEED_S:
                break
            if time.monotonic() > deadline_s:
                raise RuntimeError("the axis goes on turning")
        times_ns, positions = self.between(since_ns, now_ns)
        lag = max(1, int(SPEED_S * 1e9 / max(1.0, float(np.median(np.diff(times_ns))))))
        moves = np.abs(positions[lag:] - positions[:-lag]) * 1e9 > MOVES_RPS * (times_ns[lag:] - times_ns[:-lag])
        return int(times_ns[lag:][moves][-1]) if moves.any() else since_ns
