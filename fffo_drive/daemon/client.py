"""A client of the daemon's socket, for programs without asyncio: calls and subscriptions."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from ..can.lease import bus_holders

SIGN_OF_LIFE_S = 0.2  # between two of a client in charge (enable with hold), which daemon.client_silence_s waits for


class ClientError(Exception):
    """There is no daemon on that socket, or it has ended."""


class CallError(Exception):
    """The daemon answered with an error. `code` and `data` as in JSON-RPC."""

    def __init__(self, code: int, message: str, data: Any = None) -> None:
        super().__init__(message)
        self.code, self.data = code, data


class DaemonClient:
    """A connection. One thread uses it."""

    def __init__(self, path: Path, timeout_s: float | None = 30.0) -> None:
        """`timeout_s`: for an answer, in addition to the waiting time of the call. Raises ClientError."""
        self.path = path
        self._timeout_s = timeout_s
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        self._buffer = b""
        self._number = 0
        self.notifications: list[dict[str, Any]] = []
        self._in_charge = False  # it has asked for that, and has to be heard
        self._sent_s = 0.0
        self._patience_s = timeout_s  # for the next message
        self._socket.settimeout(timeout_s)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise ClientError(_no_daemon(path, error)) from error

    def call(self, method: str, **params: Any) -> Any:
        """Call and wait for the result. Raises CallError, ClientError. Notifications meanwhile are kept."""
        self._number += 1
        self._in_charge = self._in_charge or bool(method == "enable" and params.get("hold"))
        request = {"jsonrpc": "2.0", "id": self._number, "method": method, "params": params}
        self.send_line(json.dumps(request).encode())
        waits_s = float(params.get("wait_s") or 0.0)
        self._patience_s = None if self._timeout_s is None else self._timeout_s + waits_s
        while True:
            message = self.read()
            if "method" in message:
                self.notifications.append(message)
            elif message.get("id") == self._number or (message.get("id") is None and "error" in message):
                if "error" in message:
                    error = message["error"]
                    raise CallError(error["code"], error["message"], error.get("data"))
                return message["result"]

    def act(self, method: str, **params: Any) -> Any:
        """Call as the deliberate act of a person: torque or motion in the epoch that is now.

        Not for what is repeated: a stream or a renewal keeps to the epoch in which it began, or no stop would end it.
        """
        return self.call(method, **{"epoch": self.call("status")["epoch"], **params})

    def next_notification(self, timeout_s: float | None = None) -> dict[str, Any]:
        """The next notification, in order. Raises ClientError if none arrives in time or the daemon ends."""
        if self.notifications:
            return self.notifications.pop(0)
        self._patience_s = timeout_s
        return self.read()

    def send_line(self, line: bytes) -> None:
        """Send raw bytes and a line break."""
        self._sent_s = time.monotonic()
        try:
            self._socket.sendall(line + b"\n")
        except OSError as error:
            reason = self._farewell() or f"the daemon went away: {error.strerror}"
            raise ClientError(f"{self.path}: {reason}") from error

    def read(self) -> dict[str, Any]:
        """The next message of any kind. While it waits, a client in charge gives signs of life."""
        begun_s = time.monotonic()
        while True:
            if self._in_charge and time.monotonic() - self._sent_s >= SIGN_OF_LIFE_S:
                self.send_line(b"")
            if b"\n" in self._buffer:
                break
            try:
                self._socket.settimeout(SIGN_OF_LIFE_S if self._in_charge else self._patience_s)
                data = self._socket.recv(65536)
            except TimeoutError:
                if self._in_charge and (self._patience_s is None or time.monotonic() - begun_s < self._patience_s):
                    continue
                raise ClientError(f"{self.path}: no answer in time") from None
            except OSError as error:
                raise ClientError(f"{self.path}: the daemon went away: {error.strerror}") from error
            if not data:
                raise ClientError(f"{self.path}: the daemon closed the connection")
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b"\n")
        message: dict[str, Any] = json.loads(line)
        return message

    def _farewell(self) -> str:
        """Why the daemon has ended the connection, where it said so; empty: it did not."""
        with contextlib.suppress(OSError):
            while data := self._socket.recv(65536, socket.MSG_DONTWAIT):
                self._buffer += data
        for line in reversed(self._buffer.split(b"\n")[:-1]):
            message = json.loads(line)
            if "error" in message and message.get("id") is None:
                return str(message["error"]["message"])
        return ""

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def _no_daemon(path: Path, error: OSError) -> str:
    if isinstance(error, PermissionError):
        return (
            f"{path}: not allowed; be root or a member of the socket's group (daemon.control_group), or watch only "
            "(--watch)"
        )
    text = f"{path}: no daemon answers ({error.strerror or error}); start it: fffo-drive serve AXIS, or systemctl start"
    return f"{text}{commanding()}"


def commanding() -> str:
    """Who commands on the buses of this machine, for one who finds no daemon; empty where nobody does."""
    return "".join(f"; on {bus} commands {who}" for bus, who in sorted(bus_holders().items()))
