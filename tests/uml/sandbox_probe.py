"""What a process in the unit's sandbox can and cannot do: tried from inside, one JSON object on the given path.

Runs as ExecStartPre= of the service, so with its user, limits, mounts and filters; with the standard library alone.
"""

from __future__ import annotations

import ctypes
import errno
import json
import mmap
import os
import socket
import sys
import time
from collections.abc import Callable

CLONE_NEWUSER = 0x10000000
MCL_CURRENT, MCL_ONFAULT = 1, 4
LIBC = ctypes.CDLL(None, use_errno=True)


def call(result: int) -> None:
    """Of libc: its errno as an exception."""
    if result != 0:
        raise OSError(ctypes.get_errno(), "")


def write(path: str) -> None:
    with open(path, "w", encoding="utf-8") as file:
        file.write("probe")
    os.unlink(path)


def fifo(priority: int) -> None:
    """Up and down again; who may not do it is not rid of SCHED_RESET_ON_FORK either."""
    for policy, level in ((os.SCHED_FIFO, priority), (os.SCHED_OTHER, 0)):
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_param(level))


def lock_memory() -> None:
    call(LIBC.mlockall(MCL_CURRENT | MCL_ONFAULT))
    LIBC.munlockall()


def foreign_process() -> None:
    """Raises ENOENT unless a process of another user can be seen."""
    own = os.getuid()
    for name in os.listdir("/proc"):
        if name.isdigit() and os.stat(f"/proc/{name}").st_uid != own:
            return
    raise OSError(errno.ENOENT, "")


ATTEMPTS: dict[str, Callable[[], object]] = {
    "write to /etc": lambda: write("/etc/probe"),
    "write beside the program": lambda: write(os.path.join(sys.prefix, "probe")),
    "write to the state directory": lambda: write(os.path.join(os.environ["STATE_DIRECTORY"], "probe")),
    "write to the cache directory": lambda: write(os.path.join(os.environ["CACHE_DIRECTORY"], "probe")),
    "read /home": lambda: os.listdir("/home"),
    "read /root": lambda: os.listdir("/root"),
    "see a process of others": foreign_process,
    "open /dev/mem": lambda: os.open("/dev/mem", os.O_RDONLY),
    "change a kernel setting": lambda: os.open("/proc/sys/kernel/hostname", os.O_WRONLY),
    "mount": lambda: call(LIBC.mount(b"none", b"/tmp", b"tmpfs", 0, None)),
    "new user namespace": lambda: call(LIBC.unshare(CLONE_NEWUSER)),
    "set the clock": lambda: time.clock_settime(time.CLOCK_REALTIME, time.time()),
    "become root": lambda: os.setuid(0),
    "CAN socket": lambda: socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW),
    "packet socket": lambda: socket.socket(socket.AF_PACKET, socket.SOCK_RAW),
    "netlink socket": lambda: socket.socket(socket.AF_NETLINK, socket.SOCK_RAW),
    "FIFO priority 98": lambda: fifo(98),
    "FIFO priority 99": lambda: fifo(99),
    "lock memory": lock_memory,
    "compiled code": lambda: mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC),
}


def outcome(attempt: Callable[[], object]) -> str:
    """`ok`, or the name of the error."""
    try:
        attempt()
    except OSError as error:
        return errno.errorcode.get(error.errno or 0, str(error))
    return "ok"


if __name__ == "__main__":
    found = {name: outcome(attempt) for name, attempt in ATTEMPTS.items()}
    with open(sys.argv[1], "w", encoding="utf-8") as result:
        json.dump(found, result)
