"""Measured and blind data, which is not part of the project: `../shared/data` beside the checkout."""

from __future__ import annotations

from pathlib import Path

import pytest

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def shared_files(pattern: str) -> list[Path]:
    """The files of a pattern, sorted. A test that needs them and does not find them says so and is not counted."""
    found = sorted(DATA.glob(pattern))
    if not found:
        pytest.skip(f"needs ../shared/data/{pattern}, which is not beside this checkout")
    return found
