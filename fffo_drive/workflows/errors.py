"""Errors of runs on a drive, which the command line turns into exit codes."""

from __future__ import annotations


class DriveFaultError(Exception):
    """A run that ended with a fault."""


class RecordingGapError(Exception):
    """A run whose recording has gaps."""
