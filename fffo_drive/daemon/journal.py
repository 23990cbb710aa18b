"""The log: structured fields to the journal's own socket where stderr is the journal's, else lines on stderr.

A line on stderr is `TEXT [NAME=VALUE NAME="a value with blanks"]`: a value in quotes is a JSON string.

Protocol of systemd's JOURNAL_NATIVE_PROTOCOL: a datagram of NAME=VALUE lines; a value with a line break stands as NAME,
line break, length (uint64, little-endian), bytes, line break.
"""

from __future__ import annotations

import json
import os
import re
import socket
import struct
import sys
from collections.abc import Mapping
from typing import Any, TextIO

from ..recording.events import Level

SOCKET = "/run/systemd/journal/socket"
IDENTIFIER = "fffo-drive"
_PLAIN = re.compile(r"[\w.,:;/@%+-]+", re.ASCII)  # needs no quotes
LONGEST_VALUE = 16_384  # of a field; a datagram must not be refused
PRIORITIES = {Level.DEBUG: 7, Level.INFO: 6, Level.WARNING: 4, Level.ERROR: 3, Level.FATAL: 2}  # syslog(3)

# kinds of messages -> MESSAGE_ID, for `journalctl MESSAGE_ID=...`
MESSAGE_IDS = {
    "started": "4c2f1ad1fb5549c2a1ac4cf2b1a3a0d1",
    "stopping": "9f8ab0e0d1ce4f66ab4b5b7f7d35b6a2",
    "state": "c8b0bb92a35f4bbd8ee2a6f3f8b0b5c3",
    "fault": "0d5a9d0f94c74d0f9f1d7c8e53f5a4e4",
    "command": "71a3c5e8be0946a6b5bb8f6aa0d7c2f5",
    "client": "e2bb2b2a9c5747f88b3d18d6a9c0e1b6",
    "reload": "3b6e81ed0be142d4b6d4e1f7c2a9d8c7",
    "recording": "a94f7b3b5d7c4f0d9bb2a61c8f3e7d98",
    "drive": "58d7c1e3a2f64d0ab1c9e4b7f6a3d2c9",
    "parameters": "b15c7f9e2d8a4a6f93c1d0e5b8f7a6da",
    "effects": "64790da58888bf64c49e371c686ef238",
    "adaptation": "38d3411d22d240ad8f7c0a97cdb002bc",
    "set_point": "d1b6b8ed4c2f4a079dc8f4acb5763229",
    "files": "8b428f4538734ef2b76182e93448b385",
}


class Journal:
    """Writes messages without waiting; one that cannot be written is counted."""

    def __init__(
        self, environment: Mapping[str, str] = os.environ, stream: TextIO | None = None, address: str = SOCKET
    ) -> None:
        self._stream = stream if stream is not None else sys.stderr
        self.failures = 0
        self._socket: socket.socket | None = None
        if _is_journal(self._stream, environment.get("JOURNAL_STREAM", "")) and os.path.exists(address):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
            self._address = address

    @property
    def structured(self) -> bool:
        """Fields go to the journal."""
        return self._socket is not None

    def write(self, kind: str, level: int, text: str, fields: Mapping[str, Any] | None = None) -> None:
        """One message. `kind` is a key of MESSAGE_IDS; `fields` get the prefix FFFO_."""
        priority = PRIORITIES.get(Level(level), 6) if level in set(Level) else 6
        named = {f"FFFO_{key.upper()}": _text(value) for key, value in (fields or {}).items()}
        if self._socket is not None:
            whole = {
                "MESSAGE": text,
                "MESSAGE_ID": MESSAGE_IDS[kind],
                "PRIORITY": str(priority),
                "SYSLOG_IDENTIFIER": IDENTIFIER,
                "FFFO_KIND": kind,
                **named,
            }
            try:
                self._socket.sendto(encode_fields(whole), self._address)
                return
            except OSError:  # the journal restarts, or its queue is full: stderr still leads there
                self.failures += 1
        self._print(priority, text, named)

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _print(self, priority: int, text: str, named: Mapping[str, str]) -> None:
        prefix = f"<{priority}>" if "JOURNAL_STREAM" in os.environ else ""
        try:
            people = self._stream.isatty()  # the text has it all
            fields = {} if people else {k: value for k, value in named.items() if " " not in value or value not in text}
            extra = " ".join(f"{key}={quoted(value)}" for key, value in fields.items())
            print(f"{prefix}{' '.join(text.split())}{f' [{extra}]' if extra else ''}", file=self._stream, flush=True)
        except (OSError, ValueError):
            self.failures += 1


def quoted(value: str) -> str:
    """A value in a line: a JSON string unless it is one plain word."""
    return value if _PLAIN.fullmatch(value) else json.dumps(value, ensure_ascii=not value.isprintable())


def _text(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def encode_fields(fields: Mapping[str, str]) -> bytes:
    """A datagram of the native protocol."""
    out = bytearray()
    for name, value in fields.items():
        raw = value.encode("utf-8", "replace")[:LONGEST_VALUE]
        if b"\n" in raw:
            out += name.encode() + b"\n" + struct.pack("<Q", len(raw)) + raw + b"\n"
        else:
            out += name.encode() + b"=" + raw + b"\n"
    return bytes(out)


def _is_journal(stream: TextIO, declared: str) -> bool:
    """$JOURNAL_STREAM names the device and inode of the stream that leads to the journal."""
    try:
        status = os.fstat(stream.fileno())
    except (OSError, ValueError):
        return False
    return declared == f"{status.st_dev}:{status.st_ino}"
