"""What the manual takes from the code when it is built: the reference pages and the figures."""

from __future__ import annotations

from pathlib import Path


def write_generated(source: Path) -> None:
    """Write all generated pages and pictures below the copied sources."""
