"""The Fleet tab in a real browser: a store's status, records made, the report with a drive's history and what moved."""

from __future__ import annotations

import json
import shutil

import pytest
import yaml
from fleet.fleet_rig import facts_file, write_run  # noqa: F401
from fleet.test_fleet_command import DRIVES, OUTSIDE, RUNS, fleet  # noqa: F401
from workbench.test_workbench_in_a_browser import CONFIGS, Shown

from fffo_drive.workbench.bench import Workbench

pytestmark = [pytest.mark.slow, pytest.mark.browser, pytest.mark.timeout(900)]
IDLE_TAB = "fffoFleet.state && !fffoWorkbench.state.jobs.some((job) => job.state === 'running')"


class FleetPage(Shown):
    """The tab of a store, of a workbench that has a run which is not in it."""

    def __init__(self, chromium, directory, store, facts, role="tune"):
        run = write_run(directory / "new.csv", 900)
        super().__init__(chromium, Workbench(directory / "out", None, facts, (run,), None, str(store)), role)
        self.page.focus("#tab-work")
        self.page.keyboard.press("ArrowRight")  # to the axis
        self.page.keyboard.press("ArrowRight")
        self.until(IDLE_TAB)

    def typed(self, selector, text):
        """Into a field, with keys alone."""
        self.page.focus(selector)
        self.page.keyboard.press("Control+A")
        self.page.keyboard.type(text)


@pytest.fixture
def shown(fleet, facts_file, chromium, tmp_path):  # noqa: F811
    shown = FleetPage(chromium, tmp_path, fleet, facts_file)
    yield shown
    shown.close()


@pytest.mark.long
def test_a_run_is_added_its_record_made_and_the_report_read_with_keys_alone_and_by_a_screen_reader(shown):
    state = shown.page.evaluate("fffoFleet.state")
    assert (state["runs"], state["waiting"], state["drives"]) == (DRIVES * RUNS, 0, DRIVES)
    assert shown.page.locator("#fleet-drives tbody tr").count() == DRIVES
    line = shown.do("#fleet-add", by_key=True)["line"]
    assert line.startswith("fffo-drive fleet add ")
    shown.until("fffoFleet.state.waiting === 1")
    assert f"{DRIVES * RUNS} have a record" in shown.page.text_content("#fleet-status")
    assert ", 1 wait, 0 failed" in shown.page.text_content("#fleet-status")
    assert shown.page.locator("#fleet-share").evaluate("(bar) => bar.value") == DRIVES * RUNS / (DRIVES * RUNS + 1)
    shown.do("#fleet-work", by_key=True)
    shown.until("fffoFleet.state.waiting === 0 && fffoFleet.state.recorded === fffoFleet.state.runs")
    assert shown.page.is_visible("#job-title")
    shown.typed("#fleet-serial", f"SN{OUTSIDE}")
    shown.typed("#fleet-rate", "0.5")
    line = shown.do("#fleet-report", by_key=True)["line"]
    assert line.endswith(f"--alarms-per-drive-year=0.5 --serial=SN{OUTSIDE}")
    shown.until("document.querySelector('#fleet-viewer').src.endsWith('fleet_1/report.html')")
    frame = shown.page.frame_locator("#fleet-viewer")
    frame.locator("figure canvas").first.wait_for()
    assert "outside of the population" in shown.page.text_content("#fleet-headline")
    report = json.loads((shown.server.bench.directory / "fleet_1" / "report.json").read_text())
    histories = {figure["title"].split(":")[0] for figure in report["figures"] if figure["name"].startswith("history")}
    assert histories == {f"SN{OUTSIDE}"}
    assert report["results"]["moved"]  # the watch went over each model
    shown.is_found_by_a_screen_reader_and_fits_a_narrow_screen()
    line = shown.do("#fleet-diagnose", by_key=True)["line"]
    assert line.startswith("fffo-drive fleet diagnose ")
    assert line.endswith(f"--serial=SN{OUTSIDE}")
    shown.until("document.querySelector('#fleet-viewer').src.endsWith('fleet_drives_1/report.html')")
    now = next(shown.server.bench.directory.glob("fleet_drives_1/*/*/now"))
    assert json.loads((now / "report.json").read_text())["kind"] == "diagnose"
    shown.page.click("#tab-work")  # no report of a fleet is a step of this axis, nor is one of its drives
    assert shown.page.locator("#pages tbody tr").count() == 0
    assert shown.page.is_visible("#job-title")


def test_a_drive_of_the_list_is_the_one_whose_history_is_drawn_and_a_wrong_name_is_reported(shown):
    shown.page.get_by_role("button", name="history of SN3").click()
    assert shown.page.input_value("#fleet-serial") == "SN3"
    shown.page.fill("#fleet-serial", "SN33")
    shown.page.click("#fleet-report")
    shown.until("fffoWorkbench.state.jobs.length && fffoWorkbench.state.jobs[0].state === 'failed'")
    shown.until("document.querySelector('#job-output').textContent.includes('did you mean')")
    shown.page.fill("#fleet-rate", "0")
    shown.page.click("#fleet-report")
    shown.until("document.querySelector('#said').textContent.includes('above 0')")


def test_who_only_looks_sees_the_store_and_can_press_nothing(fleet, facts_file, chromium, tmp_path):  # noqa: F811
    shown = FleetPage(chromium, tmp_path, fleet, facts_file, role="look")
    assert "100 % done" in shown.page.text_content("#fleet-status")
    for button in ("#fleet-add", "#fleet-work", "#fleet-report", "#fleet-diagnose"):
        assert shown.page.is_disabled(button)
    shown.close()


def test_a_place_without_a_store_is_reported_and_adding_makes_one(facts_file, chromium, tmp_path):  # noqa: F811
    shown = FleetPage(chromium, tmp_path, tmp_path / "new store", facts_file)
    shown.until("document.querySelector('#fleet-error').textContent.includes('no store here')")
    assert shown.page.text_content("#next") == "Next: tick runs on the first tab, and add them"
    assert shown.page.is_disabled("#fleet-work")
    assert shown.page.is_disabled("#fleet-report")
    shown.do("#fleet-add")
    shown.until("fffoFleet.state.runs === 1 && !document.querySelector('#fleet-work').disabled")
    assert shown.page.text_content("#next") == "Next: make the records"
    shown.close()


@pytest.mark.parametrize(
    ("store", "next_step"),
    [
        (None, "Next: name a store, with --fleet STORE or as daemon.fleet in the axis file"),
        ("new store", "Next: add runs, from the first tab or a folder: fffo-drive fleet add STORE --from FOLDER"),
    ],
)
def test_without_store_or_runs_the_tab_says_what_helps_there(store, next_step, chromium, tmp_path):
    place = None if store is None else str(tmp_path / store)
    shown = Shown(chromium, Workbench(tmp_path / "out", None, None, (), None, place))
    assert shown.page.text_content("#next") == "Next: record a run, or add a file"
    shown.page.click("#tab-fleet")
    shown.until("fffoFleet.state")
    assert shown.page.text_content("#next") == next_step
    shown.page.click("#tab-work")
    assert shown.page.text_content("#next") == "Next: record a run, or add a file"
    shown.close()


def test_the_store_of_the_served_axis_is_chosen_unless_another_is_given(fleet, chromium, tmp_path):  # noqa: F811
    shutil.copytree(CONFIGS, tmp_path / "configs")
    axis = tmp_path / "configs" / "axis_canopen.yaml"
    content = yaml.safe_load(axis.read_text())
    content["daemon"]["fleet"] = str(fleet)
    axis.write_text(yaml.safe_dump(content))
    for given, store in ((None, fleet), (str(tmp_path / "other"), tmp_path / "other")):
        shown = Shown(chromium, Workbench(tmp_path / "out", axis, None, (), None, given))
        shown.page.click("#tab-fleet")
        shown.until("fffoFleet.state")
        assert shown.page.text_content("#fleet-store") == str(store)
        assert not shown.page.is_visible("#no-fleet")
        drives = shown.page.locator("#fleet-drives tbody tr").count()
        assert drives >= DRIVES if store == fleet else drives == 0  # a test before this one may have added a drive
        shown.close()
