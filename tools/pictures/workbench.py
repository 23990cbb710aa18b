"""Screenshots of the workbench in headless Chromium: an effect that it found, and an axis whose gain it tries."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "tests")]

from fleet.fleet_rig import TRUTH, write_run  # noqa: E402  # of the tests: axes whose every number is known
from headless import chromium  # noqa: E402
from playwright.sync_api import Browser, Page  # noqa: E402

from fffo_drive.can.link import free_loopback_port  # noqa: E402
from fffo_drive.cli import main as command  # noqa: E402
from fffo_drive.workbench.bench import Workbench  # noqa: E402
from fffo_drive.workbench.server import WorkbenchServer  # noqa: E402
from fffo_drive.workflows.simulated_process import SimulatedProcess  # noqa: E402

PICTURE = Path(__file__).with_suffix(".png")
REPORT = PICTURE.with_name("report.png")
AXIS = PICTURE.with_name("workbench_axis.png")
FLEET = PICTURE.with_name("workbench_fleet.png")
FLEET_DRIVES, FLEET_WEEKS = 6, 12  # of the fleet's picture
MORE_FRICTION = {2: (1.5, 0), 4: (1.3, 8)}  # drive: times the Coulomb friction of the others, from that week on
FIRST_WEEK_S, WEEK_S = 1_772_409_600, 604_800  # 2026-03-02, UTC
SCREEN, TALL = {"width": 1280, "height": 800}, {"width": 1280, "height": 1180}
PATIENCE_S = 180.0  # a first start compiles
AT_WORK = "fffoWorkbench.state.jobs.some((job) => job.state === 'running')"


def until(page: Page, expression: str) -> None:
    """Wait until it is so."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not page.evaluate(expression):
        if time.monotonic() > deadline_s:
            raise RuntimeError(f"never: {expression}; the page says: {page.text_content('#axis-said')}")
        time.sleep(0.1)


def do(page: Page, button: str) -> None:
    """Press a button, and wait for the end of its job."""
    before = page.evaluate("fffoWorkbench.state.jobs.length")
    until(page, f"!document.querySelector('{button}').disabled")
    page.click(button)
    until(page, f"fffoWorkbench.state.jobs.length > {before} && !{AT_WORK}")
    time.sleep(1.0)  # the result is laid out


def try_a_gain(browser: Browser, place: Path) -> None:
    """An axis that a daemon has: enable, a step, another gain, the step again."""
    axis, bus = place / "configs" / "axis_canopen.yaml", f"loopback:{free_loopback_port()}"
    sockets = place / "sockets"
    command = [sys.executable, "-m", "fffo_drive", "serve", str(axis), "--bus", bus, "--sockets", str(sockets)]
    with SimulatedProcess(place / "configs" / "simulated_drive.yaml", bus):
        daemon = subprocess.Popen([*command, "--uncommissioned", "--scope", "0"], stderr=subprocess.DEVNULL)
        server = WorkbenchServer(Workbench(place / "runs" / "axis", axis, None, (), sockets))
        server.start()
        try:
            page = browser.new_page(viewport=TALL)
            page.goto(server.url("tune"))
            page.click("#tab-axis")
            until(page, "fffoAxis.status && fffoAxis.status.state === 'ready'")
            page.click("#enable")
            page.click("#ask-yes")
            until(page, "fffoAxis.status.state === 'enabled'")
            page.locator("#gains input").first.fill("1.3")
            page.locator("#gains button").nth(1).click()
            page.click("#ask-yes")
            until(page, "fffoWorkbench.state.trials.some((trial) => trial.state !== 'running')")
            page.locator("#trial .uplot canvas").wait_for()
            time.sleep(1.0)
            page.evaluate("scrollTo(0, 0)")
            page.screenshot(path=AXIS, animations="disabled")
        finally:
            server.close()
            daemon.terminate()
            daemon.wait()


def a_fleet(browser: Browser, place: Path) -> None:
    """The store of a few drives: one with more friction than the others, one that changes."""
    facts = place / "facts.yaml"
    facts.write_text("torque_constant_nm_per_a: 0.1\nposition_lsb_rev: 1.0e-6\nabsolute_angle: true\n")
    for drive in range(FLEET_DRIVES):
        runs = place / f"drive{drive}"
        runs.mkdir()
        factor, since = MORE_FRICTION.get(drive, (1.0, 0))
        for week in range(FLEET_WEEKS):
            own = {
                name: value * (1.0 + 0.01 * ((7 * drive + 3 * k) % 5 - 2))
                for k, (name, value) in enumerate(TRUTH.items())
            }
            own["coulomb_nm"] *= factor if week >= since else 1.0
            path = write_run(runs / f"run{week}.csv", FLEET_WEEKS * drive + week, own)
            os.utime(path, (FIRST_WEEK_S + WEEK_S * week,) * 2)
        words = ["--drive", str(facts), "--serial", f"SN{drive}", "--model", "M1", "--from", str(runs)]
        command(["fleet", "add", str(place / "plant"), *words])
    server = WorkbenchServer(Workbench(place / "runs" / "fleet", None, None, (), None, str(place / "plant")))
    server.start()
    page = browser.new_page(viewport=TALL)
    page.goto(server.url("tune"))
    page.click("#tab-fleet")
    do(page, "#fleet-work")
    do(page, "#fleet-report")
    page.frame_locator("#fleet-viewer").locator("figure canvas").first.wait_for()
    until(page, "fffoFleet.state.waiting === 0")
    page.screenshot(path=FLEET, animations="disabled")
    server.close()


def main() -> None:
    """Record three runs, diagnose, show; then the axis, and a fleet."""
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
        until(page, "fffoWorkbench.state")
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
        try_a_gain(browser, Path(place))
        a_fleet(browser, Path(place))
    print(PICTURE, REPORT, AXIS, FLEET, sep="\n")


if __name__ == "__main__":
    main()
