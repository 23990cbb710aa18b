"""Frames of a trace of a CAN bus: candump (printed or logged), Vector ASC, PEAK TRC, BLF and python-can CSV.

python-can's readers do the work; candump is parsed here, because python-can reads no more than its log files.
"""

from __future__ import annotations

import datetime
import io
import logging
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats
from ..can.frame import MAX_DATA, STANDARD_MASK
from ..recording.errors import RecordingError
from ..recording.files import LARGEST_TEXT_BYTES, table_text

Ints = npt.NDArray[np.int64]

BLF_MAGIC = b"LOGG"
_CANDUMP = re.compile(  # (stamp) can0 181#0102, or as it is printed: (stamp) can0 RX - - 181 [2] 01 02
    r"^[ \t]*(?:\((?P<stamp>[^)\n]*)\)[ \t]+)?(?P<channel>\w+)[ \t]+(?:[RT]X[ \t]+\S+[ \t]+\S+[ \t]+)?"
    r"(?P<id>[0-9A-Fa-f]{3,8})(?:#(?P<logged>[0-9A-Fa-f]*)(?=\s|\Z)|"
    r"[ \t]+\[\d+\](?P<printed>(?:[ \t]+[0-9A-Fa-f]{2}\b)*(?![ \t]+remote)))",
    re.MULTILINE,
)
KINDS = {  # a line of each, which no table of numbers has
    "candump": re.compile(
        r"[ \t]*(\([^)]*\)\s+)?\w+\s+([RT]X\s+\S+\s+\S+\s+)?[0-9A-Fa-f]{3,8}(#[0-9A-FR]*(\s|$)|\s+\[\d+\](\s|$))"
    ),
    "PCAN-View, TRC": re.compile(r";\$FILEVERSION=|;.*\bPCAN\b"),
    "Vector ASC": re.compile(r"base\s+(hex|dec)\s+timestamps\b", re.IGNORECASE),
    "python-can CSV": re.compile(r"timestamp,arbitration_id,", re.IGNORECASE),
}
MOST_DAMAGED = 100  # lines of a text
DELTAS = 0.1  # of the steps that go back: more are no disorder, the stamps are differences


class Frames(NamedTuple):
    """Classic data frames with 11-bit identifiers, in the order of the file."""

    stamps_s: Floats | None  # (n,); None: the trace has none
    ids: Ints  # (n,)
    lengths: Ints  # (n,) bytes
    data: npt.NDArray[np.uint8]  # (n, 8), zeros behind the length
    channels: npt.NDArray[np.int64]  # (n,) index into `channel_names`
    channel_names: tuple[str, ...]
    remarks: tuple[str, ...]  # what was left out

    def of(self, chosen: npt.NDArray[Any]) -> Frames:
        """Some of them."""
        return self._replace(
            stamps_s=None if self.stamps_s is None else self.stamps_s[chosen],
            ids=self.ids[chosen],
            lengths=self.lengths[chosen],
            data=self.data[chosen],
            channels=self.channels[chosen],
        )


_Taken = tuple[float, int, bytes, str]  # stamp (NaN: none), identifier, data, channel


def trace_kind(begin: bytes) -> str | None:
    """The program or format of a trace of a CAN bus, by its first bytes; None for any other file."""
    if begin.startswith(BLF_MAGIC):
        return "BLF"
    if not begin or b"\0" in begin:
        return None
    lines = begin.decode("latin-1").splitlines()
    return next((kind for kind, shape in KINDS.items() if any(shape.match(line) for line in lines)), None)


def read_frames(path: Path, kind: str) -> Frames:
    """All data frames of a trace, as far as it can be read. Raises RecordingError where none can."""
    taken: list[_Taken] = []
    remarks: list[str] = []
    others = 0
    logger = logging.getLogger("can.io")
    level = logger.level
    logger.setLevel(logging.CRITICAL)  # what is damaged is counted here
    try:
        for frame in _candump(table_text(path)) if kind == "candump" else _by_library(path, kind):
            if isinstance(frame, int):
                others += frame
            else:
                taken.append(frame)
    except RecordingError:
        raise
    except Exception as error:  # python-can's readers raise whatever a damaged file leads them to
        why = f"{type(error).__name__}: {error}".removesuffix(": ")
        if not taken:
            raise RecordingError(f"{path}: a trace of a CAN bus ({kind}) that cannot be read: {why}") from error
        remarks.append(f"the trace is damaged after {len(taken)} frames ({why}): read up to there")
    finally:
        logger.setLevel(level)
    if not taken:
        raise RecordingError(f"{path}: a trace of a CAN bus ({kind}) without a data frame of an 11-bit identifier")
    if others:
        remarks.append(
            f"left out: {others} lines or frames that are damaged, or no data frames with an 11-bit identifier"
        )
    stamps, ids, data, channels = zip(*taken, strict=True)
    names = tuple(dict.fromkeys(channels))
    numbers = {name: k for k, name in enumerate(names)}
    stamps_s = np.array(stamps)
    return Frames(
        _since_begin(stamps_s) if np.isfinite(stamps_s).all() else None,
        np.array(ids, np.int64),
        np.fromiter(map(len, data), np.int64, len(data)),
        np.frombuffer(b"".join([one.ljust(MAX_DATA, b"\0") for one in data]), np.uint8).reshape(-1, MAX_DATA),
        np.fromiter(map(numbers.__getitem__, channels), np.int64, len(data)),
        names,
        tuple(remarks),
    )


def _since_begin(stamps: Floats) -> Floats:
    """Stamps, or the differences that a program writes in their place, as seconds since the first."""
    steps = np.diff(stamps)
    stamps = np.cumsum(stamps) if steps.size and np.mean(steps < 0.0) > DELTAS else stamps
    return np.asarray(stamps - stamps[0])


def _candump(text: str) -> Iterator[_Taken | int]:
    """Frames; how many lines are none that is wanted."""
    lines = sum(1 for line in text.splitlines() if line.strip())
    for found in _CANDUMP.finditer(text):
        stamp, channel, can_id, logged, printed = found.groups()
        digits = printed if logged is None else logged
        if len(can_id) > 3 or digits is None:
            continue
        try:
            data = bytes.fromhex(digits)
        except ValueError:
            continue
        lines -= 1
        yield _stamp_s(stamp), int(can_id, 16), data[:MAX_DATA], channel
    yield lines


def _stamp_s(text: str | None) -> float:
    """A stamp of candump: seconds, or a date with the time of day."""
    if text is None:
        return math.nan
    try:
        return float(text)
    except ValueError:
        try:
            return datetime.datetime.fromisoformat(text.strip()).replace(tzinfo=datetime.UTC).timestamp()
        except ValueError:
            return math.nan


def _by_library(path: Path, kind: str) -> Iterator[_Taken | int]:
    from can.io import ASCReader, BLFReader, CSVReader, TRCReader

    if kind == "BLF":
        if path.stat().st_size > LARGEST_TEXT_BYTES:
            raise RecordingError(f"{path}: at most {LARGEST_TEXT_BYTES} bytes of a trace can be read: split it")
        reader: Any = BLFReader(io.BytesIO(path.read_bytes()))
    else:
        readers = {"PCAN-View, TRC": TRCReader, "Vector ASC": ASCReader, "python-can CSV": CSVReader}
        reader = readers[kind](io.StringIO(table_text(path)))
    wrong, since_begin = 0, 0.0
    while True:
        try:
            for message in reader:
                since_begin += message.timestamp
                if message.is_extended_id or message.is_error_frame or message.is_remote_frame or message.is_fd:
                    yield 1
                elif message.arbitration_id <= STANDARD_MASK:
                    channel = "" if message.channel is None else str(message.channel)
                    differences = getattr(reader, "timestamps_format", None) == "relative"  # of ASC
                    stamp = since_begin if differences else message.timestamp
                    yield stamp, message.arbitration_id, bytes(message.data), channel
            return
        except Exception as error:  # whatever a damaged line leads the readers to; a text goes on with the next one
            wrong += 1
            if kind == "BLF":
                raise
            if wrong > MOST_DAMAGED:
                raise RecordingError(
                    f"{path}: a trace of a CAN bus ({kind}) with more than {MOST_DAMAGED} lines that cannot be read: "
                    f"{error}"
                ) from error
            yield 1
