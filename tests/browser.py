"""A headless Chromium for the tests of one module: playwright's event loop must not outlive it in this thread."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest

# waits in the page, a slice at a time: a look from outside at every turn costs more than what is looked at
WAITING = """(async () => {{
  const end = performance.now() + {slice_ms};
  for (;;) {{
    const value = {expression};
    if (value || performance.now() > end) return value;
    await new Promise((again) => setTimeout(again, {poll_ms}));
  }}
}})()"""
SLICE_MS, POLL_MS = 1000, 20


def waited_for(page: Any, expression: str, patience_s: float) -> Any:
    """The value of an expression once it is true, or false at the end of patience.

    The pages' own policy forbids what playwright would do for this.
    """
    deadline_s = time.monotonic() + patience_s
    waiting = WAITING.format(expression=expression, slice_ms=SLICE_MS, poll_ms=POLL_MS)
    while not (value := page.evaluate(waiting)) and time.monotonic() < deadline_s:
        pass
    return value


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    from headless import chromium

    with chromium() as browser:
        yield browser
