"""A CAN link: a file descriptor that carries `struct can_frame`, on AF_CAN or on a loopback bus.

`socketcan:can0` is a kernel interface (hardware or vcan). `loopback:PORT` is a bus for machines without
AF_CAN: UDP broadcast on 127.255.255.255, one port a bus; every socket bound there with SO_REUSEADDR hears
every frame but those of its own link. The loopback bus has no arbitration, no wire time, no acknowledge and
no error frames of its own.
"""

from __future__ import annotations

import errno
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import NamedTuple, Self, TypeVar

from . import bpf
from .bpf import CanFilter
from .frame import FRAME_SIZE

T = TypeVar("T")

__all__ = ["CanFilter", "Link", "LinkError", "StampedFrame", "free_loopback_port", "open_link"]

BROADCAST = "127.255.255.255"
LOOPBACK = "127.0.0.1"
RECEIVE_BUFFER = 4 << 20  # bytes; the kernel counts about 800 for a frame

_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_SO_MEMINFO = 55
_MSG_CONFIRM = 0x800  # AF_CAN marks a frame of one's own with it
_TIMESPEC = struct.Struct("@ll")
_STAMP_SPACE = socket.CMSG_SPACE(_TIMESPEC.size)
_MEMINFO = struct.Struct("=9I")
_MEMINFO_DROPS = 8
_COUNTER_MASK = 0xFFFF_FFFF
_SOL_CAN_RAW = 101
_CAN_RAW_ERR_FILTER = 2
_CAN_RAW_RECV_OWN_MSGS = 4
_ALL_ERRORS = 0x1FFF_FFFF


class LinkError(Exception):
    """The link cannot be opened or used. The text names the interface or port, and what to do."""


class StampedFrame(NamedTuple):
    """A received frame with the time of its arrival (CLOCK_REALTIME, seconds)."""

    raw: bytes
    time_s: float
    own: bool  # sent by the link that received it


class Link:
    """An open link; made by `open_link`. Threads may share it for sending; one thread receives.

    `rx_fd` and `tx_fd` are for code that calls recv(2) and send(2) by itself with frames of 16 bytes; they
    are non-blocking, and the same descriptor on AF_CAN.
    """

    def __init__(self, spec: str, rx: socket.socket, tx: socket.socket, own_port: int | None, receive_own: bool):
        self.spec = spec
        self.rx_fd = rx.fileno()
        self.tx_fd = tx.fileno()
        self._rx, self._tx = rx, tx
        self._own_port = own_port  # None on AF_CAN
        self._receive_own = receive_own
        self._filtered = False
        self._stamped = False
        self._sending = threading.Lock()
        self._sent = 0
        self._lost = 0
        self._drops_before = self._kernel_drops()

    @property
    def is_loopback(self) -> bool:
        """True on the loopback bus, which has no wire time."""
        return self._own_port is not None

    def set_filters(self, filters: Sequence[CanFilter] | None) -> None:
        """Frames that the kernel hands over from now on; None for all. See `CanFilter`."""
        chosen = filters or ()
        own = None if self._receive_own else self._own_port
        offset = bpf.UDP_HEADER if self.is_loopback else 0
        try:
            bpf.attach(self._rx, bpf.program(chosen, frame_offset=offset, own_port=own))
        except OSError as error:
            raise LinkError(
                f"{self.spec}: the kernel refuses a socket filter ({error.strerror}); "
                "check net.core.optmem_max and the service's system-call filter"
            ) from error
        self._filtered = bool(chosen)

    def send(self, frame: bytes) -> None:
        """Send one frame of 16 bytes. Raises LinkError when the interface is gone or its queue is full."""
        with self._sending:
            self._sent += 1  # before, see dropped_frames
            try:
                self._tx.send(frame)
            except OSError as error:
                self._sent -= 1
                raise LinkError(f"{self.spec}: cannot send: {_advice_on_use(error, self.spec)}") from error

    def receive(self, timeout_s: float) -> bytes | None:
        """The next frame (16 bytes), or None when none came within `timeout_s` (0: what is there already).

        Raises LinkError when the interface went away; the link may be used again once it is back.
        """
        return self._arrived(lambda: self._rx.recv(FRAME_SIZE), timeout_s)

    def receive_stamped(self, timeout_s: float) -> StampedFrame | None:
        """As `receive`, with the kernel's CLOCK_REALTIME of the arrival and whether the frame is our own."""
        if not self._stamped:
            self._rx.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            self._stamped = True
        arrived = self._arrived(lambda: self._rx.recvmsg(FRAME_SIZE, _STAMP_SPACE), timeout_s)
        if arrived is None:
            return None
        raw, control, flags, sender = arrived
        stamp_s = time.time()  # for frames that were in the queue before stamps were asked for
        for level, kind, data in control:
            if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS) and len(data) == _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack(data)
                stamp_s = seconds + nanoseconds * 1e-9
        own = sender[1] == self._own_port if self.is_loopback else bool(flags & _MSG_CONFIRM)
        return StampedFrame(raw, stamp_s, own)

    def _arrived(self, take: Callable[[], T], timeout_s: float) -> T | None:
        """What `take` reads from the socket, or None when nothing came within `timeout_s`. Raises LinkError."""
        try:
            while True:
                try:
                    return take()
                except BlockingIOError:
                    if not self._readable(timeout_s):
                        return None
                    timeout_s = 0.0
        except OSError as error:
            raise LinkError(f"{self.spec}: cannot receive: {_advice_on_use(error, self.spec)}") from error

    def _readable(self, timeout_s: float) -> bool:
        if timeout_s <= 0.0:
            return False
        poll = select.poll()
        poll.register(self.rx_fd, select.POLLIN)
        return bool(poll.poll(timeout_s * 1000.0))

    def dropped_frames(self, sent_elsewhere: Callable[[], int] | None = None) -> int:
        """Frames that the receive queue lost since the link was opened, because nobody read them in time.

        The kernel's counter (SO_MEMINFO, the same as SO_RXQ_OVFL's) of a UDP socket also holds what a filter turned
        away. This link's own frames are known and taken off; `sent_elsewhere` tells how many other code has sent on
        `tx_fd`, counted before each send. What identifier filters turned away is not known, so that a loopback link
        with filters answers -1: count on a link without them. On AF_CAN the figure is exact either way.
        """
        if self.is_loopback and self._filtered:
            return -1
        drops = self._kernel_drops() - self._drops_before
        # only now: a frame that is sent in between may be known and not yet dropped, never the other way round
        if self.is_loopback and not self._receive_own:
            drops -= self._sent + (sent_elsewhere() if sent_elsewhere else 0)
        drops &= _COUNTER_MASK  # the kernel's counter has 32 bits
        if drops <= _COUNTER_MASK // 2:
            self._lost = max(self._lost, drops)
        return self._lost

    def close(self) -> None:
        """Close both sockets; a second call does nothing."""
        self._rx.close()
        self._tx.close()

    def _kernel_drops(self) -> int:
        raw = self._rx.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
        return int(_MEMINFO.unpack(raw)[_MEMINFO_DROPS])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_link(spec: str, *, filters: Sequence[CanFilter] | None = None, receive_own: bool = False) -> Link:
    """Open `socketcan:INTERFACE` or `loopback:PORT`.

    `filters` work in the kernel. With `receive_own` the link hears its own frames too. Raises LinkError.
    """
    kind, separator, where = spec.partition(":")
    if not separator or not where or kind not in ("socketcan", "loopback"):
        raise LinkError(f"bus {spec!r}: write socketcan:INTERFACE (socketcan:can0) or loopback:PORT (loopback:20000)")
    link = (
        _open_socketcan(spec, where, receive_own) if kind == "socketcan" else _open_loopback(spec, where, receive_own)
    )
    try:
        if filters or link.is_loopback:
            link.set_filters(filters)
    except BaseException:
        link.close()
        raise
    return link


def free_loopback_port() -> int:
    """A port on which no loopback bus runs at this moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((BROADCAST, 0))
        except OSError as error:
            raise LinkError(f"loopback bus: no free UDP port on {BROADCAST}: {error.strerror}") from error
        return int(probe.getsockname()[1])


def _open_loopback(spec: str, where: str, receive_own: bool) -> Link:
    if not where.isdecimal() or not 1024 <= int(where) <= 65535:
        raise LinkError(f"bus {spec!r}: the port of a loopback bus is a number from 1024 to 65535")
    port = int(where)
    rx = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
    tx = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
    try:
        tx.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        tx.bind((LOOPBACK, 0))
        tx.connect((BROADCAST, port))
        own_port = int(tx.getsockname()[1])
        rx.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        _enlarge_queue(rx)
        # the filter comes before the address: no frame may slip in between
        own = None if receive_own else own_port
        bpf.attach(rx, bpf.program((), frame_offset=bpf.UDP_HEADER, own_port=own))
        rx.bind((BROADCAST, port))
        return Link(spec, rx, tx, own_port, receive_own)
    except OSError as error:
        rx.close()
        tx.close()
        if error.errno == errno.EADDRINUSE:
            raise LinkError(
                f"bus {spec!r}: UDP port {port} is in use by a program that is no loopback bus; choose another port"
            ) from error
        raise LinkError(f"bus {spec!r}: cannot open UDP broadcast on {BROADCAST}: {error.strerror}") from error


def _open_socketcan(spec: str, interface: str, receive_own: bool) -> Link:
    if len(interface) > 15:
        raise LinkError(f"bus {spec!r}: an interface name has at most 15 characters")
    try:
        sock = socket.socket(
            socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC, socket.CAN_RAW
        )
    except OSError as error:
        raise LinkError(
            f"bus {spec!r}: this kernel has no AF_CAN ({error.strerror}); load the modules can and can-raw, "
            "or use a loopback bus: loopback:20000"
        ) from error
    try:
        sock.setsockopt(_SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ALL_ERRORS)
        sock.setsockopt(_SOL_CAN_RAW, _CAN_RAW_RECV_OWN_MSGS, int(receive_own))
        # the smallest send queue: commands that cannot go out now must not go out later
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 0)
        _enlarge_queue(sock)
        sock.bind((interface,))
        return Link(spec, sock, sock, None, receive_own)
    except OSError as error:
        sock.close()
        raise LinkError(f"bus {spec!r}: {_advice_on_interface(error, interface)}") from error


def _enlarge_queue(sock: socket.socket) -> None:
    """Room for a reader that is held up. Beyond net.core.rmem_max only a privileged process gets it."""
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)


def _advice_on_interface(error: OSError, interface: str) -> str:
    if error.errno == errno.ENODEV:
        return (
            f"there is no interface {interface}; for hardware: "
            f"ip link set {interface} up type can bitrate 1000000 restart-ms 100; for a virtual bus: "
            f"ip link add {interface} type vcan && ip link set {interface} up"
        )
    if error.errno == errno.ENETDOWN:
        return f"interface {interface} is down: ip link set {interface} up"
    return f"cannot use interface {interface}: {error.strerror}"


def _advice_on_use(error: OSError, spec: str) -> str:
    if error.errno in (errno.ENOBUFS, errno.EAGAIN):
        return "the send queue is full, nobody acknowledges: check wiring, termination, bit rate and the drive's power"
    if error.errno in (errno.ENETDOWN, errno.ENXIO, errno.ENODEV):
        return f"the interface is down or gone: ip link set {spec.partition(':')[2]} up"
    return str(error.strerror)
