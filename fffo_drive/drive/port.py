"""The port between the loop and a drive: the interface of every backend, compiled side and Python side.

The compiled side is a NamedTuple (a *port*) for which the generic functions below are registered; the loop calls only
these. Its memory is a one-element array of `FEEDBACK`, written by the port and read by the loop. The Python side is the
`Drive` protocol: bring-up before the loop, and services for ordinary threads.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..jit import generic

NMT_OPERATIONAL = 5  # state in a heartbeat (CiA 301, 7.2.8.3.2.2)

FEEDBACK = np.dtype(
    [
        # measured values as last received, in the units of signals.py
        ("velocity_rps", "<f8"),
        ("position_rev", "<f8"),  # multi-turn: the port unwraps the drive's counter
        ("current_a", "<f8"),
        ("true_velocity_rps", "<f8"),  # NaN where the port cannot know it
        ("true_friction_nm", "<f8"),
        ("received_ns", "<i8"),  # time of this SYNC's feedback
        ("velocity_tick", "<i8"),  # tick of the last fresh velocity; -1 before the first
        ("status_tick", "<i8"),  # tick of the last fresh statusword; -1 before the first
        ("statusword", "<i8"),
        # from the drive, outside the cycle
        ("emergency_code", "<i8"),  # error code of the last EMCY, 0 after a reset message
        ("emergency_count", "<i8"),  # EMCY frames with an error, without warnings
        ("warning_code", "<i8"),  # of the last EMCY that only warns; 0 before the first
        ("warning_count", "<i8"),  # EMCY frames that only warn
        ("heartbeat_ns", "<i8"),  # time of the drive's last heartbeat; -1 before the first
        ("boot_count", "<i8"),  # boot-up messages seen
        ("nmt_state", "<i8"),  # last state in a heartbeat; -1 before the first
        ("nmt_exits", "<i8"),  # heartbeats that report a state other than OPERATIONAL; a boot-up is counted separately
        # statistics of the exchange, counted since the port was made
        ("late_feedback", "<i8"),  # answers that came late or were duplicated: counted, never used
        ("duplicate_feedback", "<i8"),  # of these: second answers to a SYNC when none was owed
        ("bad_frames", "<i8"),  # short, over-long, remote or extended frames: counted, never used
        ("error_frames", "<i8"),  # CAN error frames
        ("bus_off", "<i8"),  # 1 while the controller is off the bus or the interface is gone
        ("bus_losses", "<i8"),  # number of such losses
        ("send_errors", "<i8"),
        ("dropped_frames", "<i8"),  # frames that the socket's queue lost
        ("foreign_frames", "<i8"),  # frames that only we may send, from somebody else
        ("foreign_id", "<i8"),  # identifier of the first; before one, of the last second answer to a SYNC; -1: none
        ("settings_changed", "<i8"),  # objects of the drive that lost the value they were given (by other threads)
    ]
)


def new_feedback() -> np.ndarray[Any, np.dtype[np.void]]:
    """The port's memory: shape (1,), nothing received yet."""
    feedback = np.zeros(1, FEEDBACK)
    for name in ("velocity_tick", "status_tick", "heartbeat_ns", "nmt_state", "foreign_id"):
        feedback[name] = -1
    feedback["true_velocity_rps"] = np.nan
    feedback["true_friction_nm"] = np.nan
    return feedback


class ExchangeCounts(NamedTuple):
    """Counters of bus errors in the port, one for each row of the statistics."""

    late_feedback: int = 0  # answers that came late or were duplicated: never used
    duplicate_feedback: int = 0  # of these: second answers to a SYNC when none was owed
    bad_frames: int = 0  # short, over-long, remote or extended: never used
    error_frames: int = 0  # of the CAN controller
    bus_losses: int = 0  # bus-off, or an interface that went away
    send_errors: int = 0  # frames that the kernel did not accept; they are not sent later
    dropped_frames: int = 0  # lost by the socket's queue; -1: unknown
    emergency_count: int = 0  # EMCY messages with an error
    boot_count: int = 0  # the drive restarted
    nmt_exits: int = 0  # a heartbeat said that the drive left NMT operational
    foreign_frames: int = 0  # frames that only we may send, from somebody else
    warning_count: int = 0  # EMCY messages that only warn

    def since(self, before: ExchangeCounts) -> ExchangeCounts:
        """Counts since `before`."""
        return ExchangeCounts(*(max(now - then, min(now, 0)) for now, then in zip(self, before, strict=True)))


def exchange_counts(feedback: np.ndarray[Any, np.dtype[np.void]]) -> ExchangeCounts:
    """The counts in a port's memory."""
    return ExchangeCounts(*(int(feedback[name][0]) for name in ExchangeCounts._fields))


@generic
def port_now_ns(port: Any) -> int:
    """The port's clock (CLOCK_MONOTONIC, or simulated time), in nanoseconds."""
    raise NotImplementedError


@generic
def port_sleep_until(port: Any, deadline_ns: int) -> int:
    """Wait for an absolute time of the port's clock. Returns 0."""
    raise NotImplementedError


@generic
def port_sync(port: Any, tick: int) -> int:
    """Empty the receive queue (what is in it is late), then send SYNC for `tick`. Returns 0, or -errno."""
    raise NotImplementedError


@generic
def port_receive(port: Any, tick: int, cutoff_ns: int) -> int:
    """Wait for the answer to this tick's SYNC until `cutoff_ns`. Returns 1 when it came, else 0.

    A fresh answer updates `port.feedback[0]` and sets its velocity_tick (status_tick) to `tick`.
    """
    raise NotImplementedError


@generic
def port_command(port: Any, tick: int, controlword: int, current_a: float) -> float:
    """Send controlword and current command. Returns the current (A) after rounding to the resolution of the bus."""
    raise NotImplementedError


@generic
def port_housekeeping(port: Any, tick: int, tripped: bool) -> int:
    """The slot after the command: heartbeat when due, or one queued service (SDO) frame. Returns 0.

    `tripped`: a fault is latched; the torque is withdrawn by every way that the drive may hear, first of all.
    """
    raise NotImplementedError


class DriveIdentity(NamedTuple):
    """Identity reported by the drive (0x1018, 0x1008, 0x100A)."""

    vendor_id: int
    product_code: int
    revision: int
    serial_number: int
    device_name: str
    software_version: str


class CurrentLimit(NamedTuple):
    """The largest current of the drive itself."""

    current_a: float  # inf: not known
    source: str  # what says so


NO_LIMIT = CurrentLimit(math.inf, "")


def limit_words(asked_a: float, limit: CurrentLimit) -> list[str]:
    """What there is to say of a law whose current limit is above the drive's own."""
    if asked_a <= limit.current_a:
        return []
    return [
        f"controller.current_limit_a is {asked_a:.4g} A, but the drive limits itself to {limit.current_a:.4g} A "
        f"({limit.source}): the law takes that for its limit. Set the key to it, or raise the limit in the drive"
    ]


class DriveError(Exception):
    """The drive, or the connection to it, does not work as required. The text names object, value and remedy."""


class BusUnavailableError(DriveError):
    """The bus cannot be opened, or no node answers on it."""


class BusOccupiedError(BusUnavailableError):
    """Another master is active on the bus, or two nodes have the drive's id. Nothing was sent."""


class DriveRefusedError(DriveError):
    """The drive answers, but lacks or refuses an object that the service needs: it is not enabled."""


class Drive(Protocol):
    """A drive behind the port, seen from ordinary Python."""

    def connect(self) -> DriveIdentity:
        """Bring the drive to the state in which the loop can start: NMT operational, mapped, verified, not enabled."""
        ...

    @property
    def port(self) -> Any:
        """The compiled side; valid between `connect` and `close`."""
        ...

    @property
    def feedback(self) -> np.ndarray[Any, np.dtype[np.void]]:
        """The port's memory, shape (1,), dtype FEEDBACK."""
        ...

    @property
    def current_limit(self) -> CurrentLimit:
        """The drive's own limit, known from `connect` on: the law takes the smaller one of this and its own."""
        ...

    @property
    def realtime(self) -> bool:
        """True if the port uses the wall clock: the loop then needs its own thread and priority."""
        ...

    def fault_words(self, statusword: int | None = None, ask: bool = True) -> str:
        """The drive's own description of a fault, or of why it is not enabled; empty if there is none.

        `statusword`: at the relevant moment, None for now. Without `ask`: only messages already received, without
        waiting.
        """
        ...

    def warnings(self) -> list[str]:
        """Warnings of the drive since the last call, one sentence each; never waits."""
        ...

    def close(self, loop_ended: bool = True) -> None:
        """Leave the drive without torque and stop our bus traffic. Never raises.

        `loop_ended` False: the loop's thread hangs and may wake; what it uses stays open.
        """
        ...
