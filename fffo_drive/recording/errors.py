"""The only exception of this package: a file that cannot be used as requested. Its text names file and place."""

from __future__ import annotations


class RecordingError(Exception):
    """A recording or table is invalid. A torn file is not an error: its complete part is read."""
