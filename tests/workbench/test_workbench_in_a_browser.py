"""The workbench in a real browser: from an axis with an effect that nobody declared to the error before and after."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from browser import waited_for

from fffo_drive.recording.reader import read_run
from fffo_drive.workbench.bench import Workbench
from fffo_drive.workbench.server import WorkbenchServer

pytestmark = [pytest.mark.slow, pytest.mark.browser, pytest.mark.timeout(900)]
CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PATIENCE_S = 120.0
COMPILING_S = 600.0  # the first start of a loop, or a diagnosis, on a busy machine
SCREEN = {"width": 1280, "height": 800}
NARROW = {"width": 420, "height": 900}
SERIOUS = ("serious", "critical")
# what a page shows when something has not come about: the axis, what the page says, the job
PAGE_TEXT = """(() => {
  const text = (id) => document.getElementById(id).textContent;
  const places = ["connection", "axis-said", "axis-link", "axis-fault", "axis-obstacles", "said", "ask-text"];
  return JSON.stringify({ axis: fffoAxis.status, jogging: Boolean(fffoAxis.turning),
    says: Object.fromEntries(places.filter(text).map((id) => [id, text(id)])),
    job: fffoWorkbench.state && fffoWorkbench.state.jobs[0] }, null, 1);
})()"""


class Shown:
    """A workbench, and the page that works on it."""

    def __init__(self, chromium, bench, role="tune"):
        self.server = WorkbenchServer(bench)
        self.server.start()
        self.context = chromium.new_context(viewport=SCREEN)
        self.page = self.context.new_page()
        self.troubles, self.asked = [], []
        self.page.on("pageerror", lambda error: self.troubles.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(self.server.url(role))
        self.until("fffoWorkbench.state")

    def until(self, expression, patience_s=PATIENCE_S):
        """Wait until it is so."""
        value = waited_for(self.page, expression, patience_s)
        assert value, f"never: {expression}; {self.page.evaluate(PAGE_TEXT)}"
        return value

    def is_found_by_a_screen_reader_and_fits_a_narrow_screen(self):
        """Assert that axe finds nothing serious at either width, and that the narrow page does not scroll sideways."""
        axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
        for width in (SCREEN, NARROW):
            self.page.set_viewport_size(width)
            found = axe.run(self.page).response["violations"]
            assert [(one["id"], one["nodes"][0]["html"][:120]) for one in found if one["impact"] in SERIOUS] == []
        assert self.page.evaluate("document.documentElement.scrollWidth") <= NARROW["width"]

    @property
    def job(self):
        return self.page.evaluate("fffoWorkbench.state.jobs[0]")

    def jobs(self):
        return self.page.evaluate("fffoWorkbench.state.jobs.length")

    by_key = False  # no mouse

    def do(self, button, by_key=False):
        """Press a button, and wait for its job to end well."""
        before = self.jobs()
        self.until(f"!document.querySelector('{button}').disabled")
        if by_key or self.by_key:
            self.page.focus(button)
            self.page.keyboard.press("Enter")
        else:
            self.page.click(button)
        ended = f"fffoWorkbench.state.jobs.length > {before} && fffoWorkbench.state.jobs[0].state !== 'running'"
        self.until(ended, COMPILING_S)
        assert self.job["state"] == "done", "\n".join(self.job["output"])
        return self.job

    def record(self, motion, **how):
        self.choose("#motion", motion)
        return self.do("#record", **how)

    def choose(self, select, value):
        if not self.by_key:
            self.page.select_option(select, value)
            return
        options = self.page.locator(f"{select} option").evaluate_all("(all) => all.map((one) => one.value)")
        self.page.focus(select)
        self.page.keyboard.press("Home")
        for _ in range(options.index(value)):
            self.page.keyboard.press("ArrowDown")
        assert self.page.input_value(select) == value

    def tick(self, number, column, on=True):
        box = self.page.locator("#runs tbody tr").nth(number).locator("input").nth(column)
        if not self.by_key:
            box.set_checked(on)
        elif box.is_checked() != on:
            box.focus()
            self.page.keyboard.press("Space")
            assert box.is_checked() == on

    def __enter__(self):
        return self

    def __exit__(self, kind, *_):
        self.context.close()
        self.server.close()  # ends what was started
        if kind is None:
            self._asked_nobody_else()

    def close(self):
        self.__exit__(None)

    def _asked_nobody_else(self):
        assert self.troubles == []
        own = self.server.url("look").rsplit("/", 2)[0]
        assert all(url.startswith((own, "data:")) for url in self.asked), self.asked


@pytest.fixture
def shown(tmp_path, chromium):
    shutil.copytree(CONFIGS, tmp_path / "configs")
    axis = tmp_path / "configs" / "axis_undeclared.yaml"
    content = yaml.safe_load(axis.read_text())
    content["profile"]["duration_s"] = 20
    axis.write_text(yaml.safe_dump(content))
    shown = Shown(chromium, Workbench(tmp_path / "out", axis, None, ()))
    yield shown
    shown.close()


@pytest.mark.long
def test_a_run_is_recorded_identified_and_tuned_with_keys_alone_and_a_screen_reader_finds_everything(shown):
    assert shown.page.text_content("#next") == "Next: record a run, or add a file"
    for motion in ("identify", "recipe"):
        shown.record(motion, by_key=True)
    assert shown.do("#identify", by_key=True)["share"] == 1.0
    shown.until("document.querySelector('#viewer').src.endsWith('identify_1/report.html')")
    frame = shown.page.frame_locator("#viewer")
    frame.locator("figure canvas").first.wait_for()
    assert "Identification of undeclared" in frame.locator("h1").text_content()
    shown.until("document.querySelector('#model').value.endsWith('identify_1/model.yaml')")
    shown.do("#tune", by_key=True)
    shown.until("fffoWorkbench.state.axis_files.length === 2")
    shown.page.select_option("#axis-file", index=1)
    shown.until("fffoWorkbench.state.axis.path.includes('/tune_1/')")
    assert "identify_1" in shown.page.text_content("#axis-facts")
    shown.is_found_by_a_screen_reader_and_fits_a_narrow_screen()


def test_what_a_key_does_not_allow_cannot_be_pressed(tmp_path, chromium):
    shutil.copytree(CONFIGS, tmp_path / "configs")
    bench = Workbench(tmp_path / "out", tmp_path / "configs" / "axis_undeclared.yaml", None, ())
    shown = Shown(chromium, bench, role="look")
    for button in ("#record", "#circle", "#identify", "#tune", "#adopt", "#roll_back"):
        assert shown.page.is_disabled(button)
    assert "role: look" in shown.page.text_content("#where")
    shown.close()


def test_a_page_that_is_not_current_says_so(shown):
    shown.page.route("**/state", lambda route: route.abort())
    shown.until("document.querySelector('#connection').textContent.includes('the data shown are old')")


def test_a_motion_is_cancelled_from_the_page(shown):
    shown.page.select_option("#motion", "recipe")
    shown.page.click("#record")
    shown.until("fffoWorkbench.state.jobs.length === 1")
    shown.page.click("#cancel")
    shown.until("fffoWorkbench.state.jobs[0].state === 'cancelled'")


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_new_user_finds_adopts_and_sees_before_and_after_without_a_command_line(shown):
    """With keys alone; then what changes the axis once more with the mouse, which recorded and diagnosed below."""
    shown.by_key = True
    for motion in ("profile", "identify", "recipe"):
        shown.record(motion)
    assert shown.page.text_content("#next") == "Next: tick the runs, hold one out, diagnose"
    shown.tick(0, 1)
    shown.do("#diagnose")
    shown.until("document.querySelector('#headline').textContent.includes('cogging')")
    assert shown.page.text_content("#next") == "Next: show the gates, and adopt what was found"
    frame = shown.page.frame_locator("#viewer")
    assert frame.locator(".words dd").first.text_content() == "cogging"
    for number, shown.by_key in ((1, True), (2, False)):
        shown.do("#gates")
        assert "held-out error" in shown.page.text_content("#job-output")
        shown.do("#adopt")
        shown.until("document.querySelector('#axis-facts').textContent.includes('cogging')")
        if number == 1:
            shown.record("profile")
        for place in range(4):
            shown.tick(place, 0)
            shown.tick(place, 0, place in (0, 3))
        shown.do("#compare")
        shown.until(f"document.querySelector('#viewer').src.endsWith('compare_{number}/report.html')")
        shown.until("document.querySelector('#headline').textContent.includes('after has the smallest')")
        shown.do("#roll_back")
        shown.until("!document.querySelector('#axis-facts').textContent.includes('cogging')")
        shown.page.get_by_role("button", name="diagnose_1").click()  # its model is the one to adopt again


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_file_of_somebody_else_is_taken_in_and_diagnosed(shown, tmp_path, chromium):
    """Its facts are chosen with keys, the file with the mouse."""
    shown.record("recipe")
    run = read_run(next((tmp_path / "out" / "runs").glob("*.mcap")))
    columns = {name: np.asarray(run.columns[name]) for name in ("time_s", "position_rev", "current_command_a")}
    foreign = tmp_path / "theirs.csv"
    with foreign.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    facts = tmp_path / "facts.yaml"
    facts.write_text("name: their axis\ntorque_constant_nm_per_a: 0.148\nresolver_bits: 15\nabsolute_angle: true\n")
    other = Shown(chromium, Workbench(tmp_path / "other", None, None, ()))
    other.page.on("filechooser", lambda _: None)  # asked for early: begun with the press, it may come after it
    other.page.focus("#take")
    with other.page.expect_file_chooser() as chooser:
        other.page.keyboard.press("Enter")
    chooser.value.set_files([str(facts)])
    other.until("fffoWorkbench.state.facts")
    with other.page.expect_file_chooser() as chooser:
        other.page.click("#take")
    chooser.value.set_files([str(foreign)])
    other.until("fffoWorkbench.state.runs.length === 1")
    assert other.page.is_disabled("#record")
    other.do("#diagnose")
    other.until("document.querySelector('#headline').textContent.includes('cogging')")
    assert "their axis" in other.page.frame_locator("#viewer").locator("h1").text_content()
    other.close()
