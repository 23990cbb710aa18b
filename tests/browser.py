"""A headless Chromium for the tests of one module: playwright's event loop must not outlive it in this thread."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    sys.path.append(str(Path(__file__).resolve().parents[1] / "tools"))
    from headless import chromium

    with chromium() as browser:
        yield browser
