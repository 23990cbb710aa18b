"""A headless Chromium for tests, pictures and benchmarks: the machine's own, driven by playwright."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, sync_playwright

PROGRAMS = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome")
START_MS = 120_000


def program() -> str | None:
    """Where it is; None where there is none."""
    return next((found for name in PROGRAMS if (found := shutil.which(name))), None)


@contextmanager
def chromium() -> Iterator[Browser]:
    """One that is closed again. Raises FileNotFoundError where there is none."""
    path = program()
    if path is None:
        raise FileNotFoundError("no Chromium on this machine; on Debian: apt install chromium")
    arguments = ["--disable-dev-shm-usage", "--disable-gpu", "--force-color-profile=srgb"]
    if os.geteuid() == 0:
        arguments.append("--no-sandbox")  # it refuses to run as root with one
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=arguments, timeout=START_MS)
        try:
            yield browser
        finally:
            browser.close()
