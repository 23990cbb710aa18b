"""Screenshots of the workbench, with an effect that it found on the simulated drive, in headless Chromium."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))

from headless import chromium  # noqa: E402
from playwright.sync_api import Page  # noqa: E402

from fffo_drive.workbench.bench import Workbench  # noqa: E402
from fffo_drive.workbench.server import WorkbenchServer  # noqa: E402

PICTURE = Path(__file__).with_suffix(".png")
REPORT = PICTURE.with_name("report.png")
SCREEN = {"width": 1280, "height": 800}
AT_WORK = "fffoWorkbench.state.jobs.some((job) => job.state === 'running')"


def do(page: Page, button: str) -> None:
    """Press a button, and wait for the end of its job."""
    page.click(button)
    time.sleep(1.5)
    while page.evaluate(AT_WORK):
        time.sleep(0.3)
    time.sleep(1.0)


def main() -> None:
    """Record three runs, diagnose, show."""
    with tempfile.TemporaryDirectory() as place, chromium() as browser:
        os.chdir(place)  # paths are shown as they are typed there
        shutil.copytree(ROOT / "configs", Path(place) / "configs")
        bench = Workbench(
            Path(place) / "runs" / "workbench", Path(place) / "configs" / "axis_undeclared.yaml", None, ()
        )
        server = WorkbenchServer(bench)
        server.start()
        page = browser.new_page(viewport=SCREEN)
        page.goto(server.url("tune"))
        time.sleep(1.0)
        for motion in ("profile", "identify", "recipe"):
            page.select_option("#motion", motion)
            do(page, "#record")
        page.locator("#runs tbody tr").first.locator("input").nth(1).check()
        do(page, "#diagnose")
        page.frame_locator("#viewer").locator("figure canvas").first.wait_for()
        page.screenshot(path=PICTURE, animations="disabled")
        report = browser.new_page(viewport=SCREEN)
        report.goto(server.url("look") + "files/diagnose_1/report.html")
        report.wait_for_selector("figure canvas")
        report.screenshot(path=REPORT, animations="disabled")
        server.close()
    print(PICTURE, REPORT, sep="\n")


if __name__ == "__main__":
    main()
