"""Screenshots of the scope page beside a run of the simulated drive, in headless Chromium."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "tools" / "benchmarks")]

from live import Streaming, recorded_axis  # noqa: E402  # of the benchmarks: a daemon with the scope
from playwright.sync_api import Page  # noqa: E402
from running_axis import Axis  # noqa: E402

from fffo_drive.can.frame import EMERGENCY, pack_frame  # noqa: E402
from fffo_drive.can.link import open_link  # noqa: E402
from fffo_drive.live.places import TOKEN_FILE, URL_FILE  # noqa: E402

PICTURE = Path(__file__).with_suffix(".png")
DRIVE = ROOT / "configs" / "simulated_drive.yaml"
SIZES = {"telephone": (390, 844), "upright": (768, 1024), "tablet": (1024, 768), "laptop": (1366, 768)}
WINDOW_S = 10.0


def wait(page: Page, expression: str) -> None:
    """Until it is so."""
    deadline_s = time.monotonic() + 60.0
    while not page.evaluate(expression):
        if time.monotonic() > deadline_s:
            raise RuntimeError(f"never: {expression}")
        time.sleep(0.1)


def shoot(page: Page, path: Path, whole: bool = False) -> None:
    """A picture; what moves stands still meanwhile."""
    page.screenshot(path=path, full_page=whole, animations="disabled")
    print(path)


def every_way(page: Page, directory: Path, prefix: str) -> None:
    """All sizes, light and dark."""
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        for name, (width, height) in SIZES.items():
            page.set_viewport_size({"width": width, "height": height})
            time.sleep(1.0)  # for the pictures to be drawn anew
            shoot(page, directory / f"{prefix}{name}_{scheme}.png")
        shoot(page, directory / f"{prefix}whole_{scheme}.png", whole=True)


def look(daemon: Streaming, axis: Axis, bus: str, everything: Path | None) -> None:
    """The README's picture, or all of them for somebody who looks them over."""
    import headless

    with headless.chromium() as browser:
        width, height = SIZES["laptop"]
        page = browser.new_page(viewport={"width": width, "height": height}, color_scheme="light")
        page.set_default_timeout(120_000)
        page.goto(f"{daemon.told(URL_FILE)}#{daemon.told(TOKEN_FILE)}")
        wait(page, "fffoScope.store && fffoScope.mayCommand")
        axis.keep_running("browser")
        wait(page, "document.body.dataset.state === 'running'")
        begin_s = page.evaluate("fffoScope.store.now")
        for after, toggle in ((1.1, "off"), (1.4, "ff"), (1.7, "ff")):
            wait(page, f"fffoScope.store.now > {begin_s + after * WINDOW_S}")
            axis.client.call("toggle", to=toggle)
        if everything is None:
            shoot(page, PICTURE)
            return
        every_way(page, everything, "")
        page.select_option("#trigger", "fault")
        with open_link(bus) as link:
            link.send(pack_frame(EMERGENCY + 1, bytes([0x10, 0x23, 0x03, 0, 0, 0, 0, 0])))
        wait(page, "!!fffoScope.triggered")
        every_way(page, everything, "fault_")


def main() -> None:
    """The command."""
    options = argparse.ArgumentParser(prog="tools/pictures/scope", description=__doc__)
    options.add_argument("--all", type=Path, metavar="DIR", help="every size, light and dark, a fault too, to look at")
    everything: Path | None = options.parse_args().all
    if everything is not None:
        everything.mkdir(parents=True, exist_ok=True)
    with recorded_axis() as (daemon, client, bus):
        look(daemon, Axis(client), bus, everything)


if __name__ == "__main__":
    main()
