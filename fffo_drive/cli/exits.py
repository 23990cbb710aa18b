"""Exit codes (sysexits.h): one code for one meaning, and which error has which."""

from __future__ import annotations

from ..directories import ForeignDirectoryError
from ..documents import DocumentError
from ..workflows.errors import DriveFaultError, RecordingGapError

EXIT_OK = 0
EXIT_REFUSED = 1
EXIT_WRONG_USAGE = 2  # argparse's own
EXIT_NOT_CONFIRMED = 65
EXIT_UNAVAILABLE = 69
EXIT_DRIVE_FAULT = 70
EXIT_IO = 74
EXIT_NOT_PERMITTED = 77
EXIT_BAD_INPUT = 78  # systemd does not restart on it
EXIT_INTERRUPTED = 130

MEANINGS = {  # for --help and the manual
    EXIT_OK: "done",
    EXIT_REFUSED: "a gate refuses, a check or a system program fails, or a replay differs from its recording",
    EXIT_WRONG_USAGE: "wrong usage",
    EXIT_NOT_CONFIRMED: "the held-out runs do not confirm a diagnosis",
    EXIT_UNAVAILABLE: "no bus, or nobody answers",
    EXIT_DRIVE_FAULT: "the drive refuses or reports a fault, or the envelope tripped",
    EXIT_IO: "disk error",
    EXIT_NOT_PERMITTED: "real-time rights are required and refused",
    EXIT_BAD_INPUT: "bad input",
    EXIT_INTERRUPTED: "interrupted",
}


class UnconfirmedError(Exception):
    """Something would move, and nobody said that it may."""


def exit_code_of(error: Exception) -> int | None:
    """The exit code of a known error; None for a bug, which shows its traceback."""
    from ..can.link import LinkError
    from ..daemon.client import CallError, ClientError
    from ..drive.canopen.object_map import MappingError
    from ..drive.port import BusUnavailableError, DriveError
    from ..drive.simulated.parameters import PlantConfigError
    from ..recording.errors import RecordingError
    from ..runtime.realtime import RealtimeRefusedError
    from ..runtime.session import LoopHungError

    codes: list[tuple[type[Exception], int]] = [
        (DocumentError, EXIT_BAD_INPUT),
        (UnconfirmedError, EXIT_BAD_INPUT),
        (MappingError, EXIT_BAD_INPUT),
        (PlantConfigError, EXIT_BAD_INPUT),
        (BusUnavailableError, EXIT_UNAVAILABLE),
        (LinkError, EXIT_UNAVAILABLE),
        (ClientError, EXIT_UNAVAILABLE),
        (CallError, EXIT_DRIVE_FAULT),
        (DriveError, EXIT_DRIVE_FAULT),
        (DriveFaultError, EXIT_DRIVE_FAULT),
        (LoopHungError, EXIT_DRIVE_FAULT),
        (RealtimeRefusedError, EXIT_NOT_PERMITTED),
        (RecordingError, EXIT_BAD_INPUT),
        (RecordingGapError, EXIT_IO),
        (ForeignDirectoryError, EXIT_IO),
        (FileNotFoundError, EXIT_BAD_INPUT),
        (IsADirectoryError, EXIT_BAD_INPUT),
        (OSError, EXIT_IO),
    ]
    return next((code for kind, code in codes if isinstance(error, kind)), None)


def printable(text: str) -> str:
    """Text out of a file as a terminal may show it: control characters as their escapes, lines as they are."""
    if text.isprintable():
        return text
    kept = (sign if sign.isprintable() or sign == "\n" else sign.encode("unicode_escape").decode() for sign in text)
    return "".join(kept)


def message_of(error: Exception) -> str:
    """One message: the error's own text, and for the system's errors the file as well."""
    if isinstance(error, IsADirectoryError):
        return f"{error.filename}: is a directory, and one file is expected here; name a file in it"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)
