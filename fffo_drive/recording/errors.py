"""The exception of this package: a file that cannot be used as requested. Its text names file and place."""

from __future__ import annotations


class RecordingError(Exception):
    """A recording or table is invalid. A torn file is not an error: its complete part is read."""


class ForeignRecordingError(RecordingError):
    """A complete MCAP file of another program: it has no rows of ours."""
