"""libc calls that work inside a kernel and, with the same names, in plain Python.

Each is a ctypes function for the interpreter and an `ExternalFunction` for compiled code (resolved by symbol, so that
kernels stay cacheable). Addresses are integers (`array.ctypes.data`). A failing call returns -errno.
"""

from __future__ import annotations

import ctypes
import time
from typing import Any

import numpy as np

from ..units import NS_PER_S
from . import when_compiling

_C = ctypes.CDLL(None, use_errno=True)

CLOCK_MONOTONIC = 1
TIMER_ABSTIME = 1
MSG_DONTWAIT = 0x40
POLLIN = 0x001
EINTR = 4
EAGAIN = 11


def _declare(name: str, result: Any, *arguments: Any) -> Any:
    function = getattr(_C, name)
    function.restype = result
    function.argtypes = arguments
    return function


_PTR = ctypes.c_size_t
_recv = _declare("recv", ctypes.c_ssize_t, ctypes.c_int, _PTR, ctypes.c_size_t, ctypes.c_int)
_send = _declare("send", ctypes.c_ssize_t, ctypes.c_int, _PTR, ctypes.c_size_t, ctypes.c_int)
_ppoll = _declare("ppoll", ctypes.c_int, _PTR, ctypes.c_ulong, _PTR, _PTR)
_clock_nanosleep = _declare("clock_nanosleep", ctypes.c_int, ctypes.c_int, ctypes.c_int, _PTR, _PTR)


def recv(fd: int, address: int, length: int, flags: int) -> int:
    """recv(2): bytes received, or -errno."""
    n = int(_recv(fd, address, length, flags))
    return n if n >= 0 else -ctypes.get_errno()


def send(fd: int, address: int, length: int, flags: int) -> int:
    """send(2): bytes sent, or -errno."""
    n = int(_send(fd, address, length, flags))
    return n if n >= 0 else -ctypes.get_errno()


def wait_readable(scratch: np.ndarray[Any, np.dtype[np.int64]], fd: int, timeout_ns: int) -> int:
    """ppoll(2) on one descriptor: 1 when readable, 0 at the timeout, or -errno.

    `scratch` (at least 4 int64) is the caller's memory for the C structures, so that nothing is allocated.
    """
    scratch[0] = fd | (POLLIN << 32)
    scratch[1] = timeout_ns // NS_PER_S
    scratch[2] = timeout_ns % NS_PER_S
    base = scratch.ctypes.data
    n = int(_ppoll(base, 1, base + 8, 0))
    return n if n >= 0 else -ctypes.get_errno()


def monotonic_ns(scratch: np.ndarray[Any, np.dtype[np.int64]]) -> int:
    """CLOCK_MONOTONIC in nanoseconds. `scratch`: at least 2 int64 of the caller's memory."""
    return time.monotonic_ns()


def sleep_until(scratch: np.ndarray[Any, np.dtype[np.int64]], deadline_ns: int) -> int:
    """clock_nanosleep(2) to an absolute CLOCK_MONOTONIC time: 0, or an errno (EINTR). `scratch`: 2 int64."""
    scratch[0] = deadline_ns // NS_PER_S
    scratch[1] = deadline_ns % NS_PER_S
    return int(_clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, scratch.ctypes.data, 0))


@when_compiling
def _for_kernels() -> None:
    """The same in compiled code."""
    from numba import types
    from numba.core import cgutils
    from numba.extending import intrinsic, overload

    x_recv = types.ExternalFunction("recv", types.intp(types.intc, types.uintp, types.uintp, types.intc))
    x_send = types.ExternalFunction("send", types.intp(types.intc, types.uintp, types.uintp, types.intc))
    x_ppoll = types.ExternalFunction("ppoll", types.intc(types.uintp, types.uintp, types.uintp, types.uintp))
    x_clock_gettime = types.ExternalFunction("clock_gettime", types.intc(types.intc, types.uintp))
    x_clock_nanosleep = types.ExternalFunction(
        "clock_nanosleep", types.intc(types.intc, types.intc, types.uintp, types.uintp)
    )
    x_errno_location = types.ExternalFunction("__errno_location", types.uintp())

    @intrinsic
    def load_int32(typingctx: Any, address: Any) -> Any:
        """Read a C int at an address (for errno)."""

        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = builder.inttoptr(arguments[0], cgutils.int32_t.as_pointer())
            return builder.load(pointer)

        return types.int32(types.uintp), codegen

    def declare(function: Any, external: Any) -> None:
        """Of a system call that moves bytes: how many, or -errno."""

        def compiled(fd: Any, address: Any, length: Any, flags: Any) -> Any:
            def implementation(fd: Any, address: Any, length: Any, flags: Any) -> Any:
                n = external(fd, address, length, flags)
                if n >= 0:
                    return np.int64(n)
                return -np.int64(load_int32(x_errno_location()))

            return implementation

        overload(function)(compiled)

    declare(recv, x_recv)
    declare(send, x_send)

    @overload(wait_readable)
    def wait_readable_compiled(scratch: Any, fd: Any, timeout_ns: Any) -> Any:
        def implementation(scratch: Any, fd: Any, timeout_ns: Any) -> Any:
            scratch[0] = np.int64(fd) | (POLLIN << 32)
            scratch[1] = timeout_ns // NS_PER_S
            scratch[2] = timeout_ns % NS_PER_S
            base = scratch.ctypes.data
            n = x_ppoll(base, 1, base + 8, 0)
            if n >= 0:
                return np.int64(n)
            return -np.int64(load_int32(x_errno_location()))

        return implementation

    @overload(monotonic_ns)
    def monotonic_ns_compiled(scratch: Any) -> Any:
        def implementation(scratch: Any) -> Any:
            x_clock_gettime(CLOCK_MONOTONIC, scratch.ctypes.data)
            return scratch[0] * NS_PER_S + scratch[1]

        return implementation

    @overload(sleep_until)
    def sleep_until_compiled(scratch: Any, deadline_ns: Any) -> Any:
        def implementation(scratch: Any, deadline_ns: Any) -> Any:
            scratch[0] = deadline_ns // NS_PER_S
            scratch[1] = deadline_ns % NS_PER_S
            return np.int64(x_clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, scratch.ctypes.data, 0))

        return implementation
