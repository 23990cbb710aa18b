"""sd_notify(3) by hand: one datagram with NAME=VALUE lines to $NOTIFY_SOCKET. Without that variable nothing happens."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Mapping

from ..units import NS_PER_S

US_PER_S = 1_000_000
AWAITED = ("READY=1", "RELOADING=1", "STOPPING=1")  # said once, and the manager waits for them
LONGEST_WAIT_S = 0.1  # for room in its queue


class Notifier:
    """Reports the state of the service to the service manager."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        self.watchdog_s = _watchdog_s(environment)
        self.failures = 0
        self._status = ""

    def ready(self) -> None:
        """Ready: the control API answers."""
        self._send("READY=1")

    def reloading(self) -> None:
        """A reload begins; `ready` ends it."""
        self._send("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() * US_PER_S // NS_PER_S}")

    def stopping(self) -> None:
        """The service is stopping."""
        self._send("STOPPING=1")

    def status(self, text: str) -> None:
        """One line for `systemctl status`; sent when it changes, and retried while the manager is busy."""
        line = " ".join(text.split())
        if line != self._status and self._send(f"STATUS={line}"):
            self._status = line

    def alive(self) -> None:
        """Feed the watchdog."""
        self._send("WATCHDOG=1")

    def _send(self, *lines: str) -> bool:
        if not self._address:
            return True
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
                sock.settimeout(LONGEST_WAIT_S if lines[0] in AWAITED else 0.0)
                sock.sendto("\n".join(lines).encode(), address)
        except OSError:  # the manager is gone or busy: the service continues
            self.failures += 1
            return False
        return True


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    """Watchdog interval of the manager (sd_watchdog_enabled(3)); None: no watchdog."""
    try:
        pid = int(environment.get("WATCHDOG_PID", os.getpid()))
        period_s = int(environment["WATCHDOG_USEC"]) / US_PER_S
    except (KeyError, ValueError):
        return None
    return period_s if pid == os.getpid() and period_s > 0.0 else None
