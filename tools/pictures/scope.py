"""Screenshots and a recording of the scope page beside a run of the simulated drive, in headless Chromium."""

from __future__ import annotations

import argparse
import html
import io
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "tools" / "benchmarks")]

from live import Streaming, recorded_axis  # noqa: E402  # of the benchmarks: a daemon with the scope
from PIL import Image  # noqa: E402
from playwright.sync_api import Browser, Page  # noqa: E402
from running_axis import Axis  # noqa: E402

from fffo_drive.can.frame import EMERGENCY, pack_frame  # noqa: E402
from fffo_drive.can.link import open_link  # noqa: E402
from fffo_drive.live.places import TOKEN_FILE, URL_FILE  # noqa: E402

PICTURE = Path(__file__).with_suffix(".png")
DRIVE = ROOT / "configs" / "simulated_drive.yaml"
SIZES = {"telephone": (390, 844), "upright": (768, 1024), "tablet": (1024, 768), "laptop": (1366, 768)}
WINDOW_S = 10.0
RECORDING = PICTURE.with_name("recording.webp")
RECORDING_SIZE = (1366, 768)
RECORDING_SHARE = 0.6  # of the page's size
BENCH = ("tools/bench", "--quick")
LINE_S, READ_S = 0.12, 3.0  # a line of the bench, and its table
FRAME_S, SCOPE_S = 0.25, 12.0
QUALITY = 55  # of WebP
STYLE = "margin:24px;color:#e6edf3;font:20px monospace"
TERMINAL = f"<body style='margin:0;background:#1b1f24'><pre style='{STYLE}'>{{}}</pre>"


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
        for name in ("telephone", "laptop"):
            page.set_viewport_size(dict(zip(("width", "height"), SIZES[name], strict=True)))
            time.sleep(1.0)
            shoot(page, directory / f"{prefix}whole_{name}_{scheme}.png", whole=True)


def look(daemon: Streaming, axis: Axis, bus: str, everything: Path | None) -> None:
    """The README's picture, or all of them for somebody who looks them over."""
    import headless

    with headless.chromium() as browser:
        width, height = SIZES["laptop"]
        page = browser.new_page(viewport={"width": width, "height": height}, color_scheme="light")
        page.set_default_timeout(120_000)
        page.goto(f"{daemon.published(URL_FILE)}#{daemon.published(TOKEN_FILE)}")
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
        axis.keep_running("browser")  # the profile may have ended meanwhile
        for key in "spab":  # spectrum, phase, cursors
            page.keyboard.press(key)
        wait(page, "fffoScope.analyses.phase.found && fffoScope.analyses.spectrum.found")
        every_way(page, everything, "measured_")
        page.select_option("#trigger", "fault")
        with open_link(bus) as link:
            link.send(pack_frame(EMERGENCY + 1, bytes([0x10, 0x23, 0x03, 0, 0, 0, 0, 0])))
        wait(page, "!!fffoScope.taken")
        every_way(page, everything, "fault_")


def bench_frames(browser: Browser, directory: str) -> list[tuple[Image.Image, float]]:
    """The bench as a terminal shows it, line by line: pictures and the seconds that each stands."""
    command = [*BENCH, "--out", directory]
    done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
    page = browser.new_page(viewport=dict(zip(("width", "height"), RECORDING_SIZE, strict=True)))
    lines = [f"$ {' '.join(BENCH)}", *(done.stdout.replace(directory, "runs").rstrip().splitlines())]
    frames = []
    for count in range(1, len(lines) + 1):
        shown = lines[max(0, count - 28) : count]
        page.set_content(TERMINAL.format(html.escape("\n".join(shown))))
        frames.append((frame_of(page), LINE_S))
    return [*frames[:-1], (frames[-1][0], READ_S)]


def scope_frames(browser: Browser, daemon: Streaming, axis: Axis) -> list[tuple[Image.Image, float]]:
    """The scope beside a run, with the friction observer switched off and on."""
    page = browser.new_page(viewport=dict(zip(("width", "height"), RECORDING_SIZE, strict=True)), color_scheme="light")
    page.set_default_timeout(120_000)
    page.goto(f"{daemon.published(URL_FILE)}#{daemon.published(TOKEN_FILE)}")
    wait(page, "fffoScope.store && fffoScope.mayCommand")
    axis.keep_running("browser")
    wait(page, "document.body.dataset.state === 'running'")
    frames, begin_s = [], time.monotonic()
    toggles = {0.4 * SCOPE_S: "off", 0.7 * SCOPE_S: "ff"}
    while time.monotonic() - begin_s < SCOPE_S:
        for after_s in [after_s for after_s in toggles if time.monotonic() - begin_s > after_s]:
            axis.client.call("toggle", to=toggles.pop(after_s))
        frames.append((frame_of(page), FRAME_S))
        time.sleep(max(0.0, begin_s + len(frames) * FRAME_S - time.monotonic()))
    return frames


def frame_of(page: Page) -> Image.Image:
    """What a page shows now, made smaller."""
    picture = Image.open(io.BytesIO(page.screenshot(animations="disabled"))).convert("RGB")
    return picture.resize([round(RECORDING_SHARE * length) for length in picture.size], Image.Resampling.LANCZOS)


def record(path: Path) -> None:
    """The recording of the README: the bench, then the scope."""
    import headless

    with tempfile.TemporaryDirectory() as directory, headless.chromium() as browser:
        frames = bench_frames(browser, directory)
        with recorded_axis() as (daemon, client, _):
            frames += scope_frames(browser, daemon, Axis(client))
    pictures = [picture for picture, _ in frames]
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=[round(1e3 * shown_s) for _, shown_s in frames],
        loop=0, quality=QUALITY, method=6,
    )  # fmt: skip
    print(f"{path}: {len(pictures)} pictures, {path.stat().st_size / 1024:.0f} KiB")


def main() -> None:
    """The command."""
    options = argparse.ArgumentParser(prog="tools/pictures/scope", description=__doc__)
    options.add_argument("--all", type=Path, metavar="DIR", help="every size, light and dark, a fault too, to look at")
    options.add_argument("--recording", action="store_true", help=f"the recording of the README, {RECORDING.name}")
    given = options.parse_args()
    if given.recording:
        record(RECORDING)
        return
    everything: Path | None = given.all
    if everything is not None:
        everything.mkdir(parents=True, exist_ok=True)
    with recorded_axis() as (daemon, client, bus):
        look(daemon, Axis(client), bus, everything)


if __name__ == "__main__":
    main()
