"""The scope page in a real browser, beside an axis that runs: what it shows, what its buttons and keys do."""

from __future__ import annotations

import csv
import json
from itertools import pairwise
from pathlib import Path

import pytest
from live.scope_page import INKED, LAPTOP, Page
from live.served import Served

from fffo_drive.live.keys import Keys
from fffo_drive.signals import SIGNALS

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.browser, pytest.mark.timeout(400)]
TABLET, UPRIGHT = (1024, 768), (768, 1024)


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    with Served(tmp_path_factory.mktemp("served")) as served:
        yield served


@pytest.fixture
def page(served, chromium):
    served.rest()
    page = Page(chromium, served).open()
    yield page
    page.context.close()
    assert page.troubles == []


CURVES = [
    ("Velocity", "blue"), ("Velocity", "ink"), ("Error", "orange"), ("Current", "ink"), ("Current", "purple"),
    ("Friction", "green"), ("Position, rev", "blue"), ("Ticks", "purple"),
]  # fmt: skip


def test_a_run_is_drawn_and_nobody_else_is_asked(served, page):
    page.tab.select_option("#seconds", "5")
    served.run()
    page.until_state("running")
    before = page.js("fffoScope.pictures")
    page.see(3.0)
    assert page.js("fffoScope.pictures") > before
    for title, colour in CURVES:
        assert page.tab.evaluate(INKED, [title, colour]) > 20, (title, colour)
    assert "sine" in page.tab.text_content("#meaning")
    assert page.tab.text_content("#axis") == "bench"
    assert float(page.tab.text_content("#rms")) > 0.0
    assert page.js("Chart.prototype.yShown.call({}, 0, 0)") == [-1, 1]  # a friction estimate that is off
    assert page.js("document.querySelectorAll('#histogram tr:not([hidden])').length") > 0
    assert "running" in page.tab.text_content("#events")
    own = served.url.rstrip("/")
    assert all(url.startswith((own, own.replace("http", "ws"))) for url in page.requests), page.requests


def test_the_toggle_changes_the_error_visibly(served, page):
    page.tab.select_option("#seconds", "2")  # one period
    served.run()
    page.until_state("running")
    page.see(4.0)
    with_friction_rps = float(page.tab.text_content("#rms"))
    page.tab.click("label:has(input[value=off])")
    page.until("document.querySelector('#facts').textContent.includes('friction off')")
    page.see(3.0)
    without_rps = float(page.tab.text_content("#rms"))
    assert without_rps > 1.3 * with_friction_rps


def test_a_fault_is_shown_as_one_and_triggers(served, page):
    page.tab.select_option("#seconds", "2")
    page.tab.select_option("#trigger", "fault")
    served.run()
    page.until_state("running")
    page.see(2.0)
    assert not page.tab.is_visible("#fault")
    served.break_down()
    page.until_state("fault")
    assert page.tab.is_visible("#fault")
    assert page.tab.get_attribute("#fault", "role") == "alert"
    assert "emergency" in page.tab.text_content("#fault").lower()
    assert page.tab.text_content("#state") == "FAULT"
    page.until("!!fffoScope.taken")
    trips = page.js("columnsOf(fffoScope.taken, fffoScope.fields, ['trip']).trip")
    assert trips[0] == 0
    assert trips[-1] != 0
    assert page.tab.is_disabled("#start")
    page.tab.click("#reset")
    page.until_state("ready")
    assert not page.tab.is_visible("#fault")


def test_a_reversal_triggers_and_is_taken_at_the_full_rate(served, page, tmp_path):
    page.tab.select_option("#seconds", "2")
    served.run()
    page.until_state("running")
    page.see(1.0)
    page.tab.select_option("#trigger", "reversal")
    page.until("!!fffoScope.taken")
    assert page.tab.get_attribute("#pause", "aria-pressed") == "true"
    begin_s, end_s = page.js("fffoScope.view")
    taken = page.js("""(() => {
      const { tick, reference_rps } = columnsOf(fffoScope.taken, fffoScope.fields, ["tick", "reference_rps"]);
      return { times: tick.map((t) => Number(t) / fffoScope.rate), reference: reference_rps };
    })()""")
    pairs = zip(taken["times"], pairwise(taken["reference"]), strict=False)
    reversals = [time_s for time_s, (before, after) in pairs if before * after < 0]
    middle_s = 0.5 * (begin_s + end_s)
    assert min(abs(t - middle_s) for t in reversals) < 0.05
    with page.tab.expect_download() as coming:
        page.tab.keyboard.press("c")
    coming.value.save_as(tmp_path / "capture.csv")
    with Path(tmp_path / "capture.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [signal.name for signal in SIGNALS]
    assert len(rows) == len(taken["times"]) > 100
    ticks = [int(row["tick"]) for row in rows]
    assert all(a < b for a, b in pairwise(ticks))
    assert [float(row["reference_rps"]) for row in rows] == taken["reference"]


def test_stop_stops(served, page):
    served.run()
    page.until_state("running")
    page.tab.click("#stop")
    page.until_state("ready")
    assert "standstill" in page.said


def test_without_the_key_a_page_looks_and_says_so(served, page, chromium):
    served.run()
    watching = Page(chromium, served, key=False).open()
    watching.until_state("running")
    assert watching.tab.is_disabled("#stop")
    assert watching.tab.is_disabled("#enable")
    for place in ("#rights", "#may-look"):
        assert watching.tab.is_visible(place)
        assert "fffo-drive scope" in watching.tab.text_content(place)
    assert not watching.tab.is_visible("#may-stop")
    assert page.tab.is_visible("#may-stop")
    assert not page.tab.is_visible("#may-look")
    watching.tab.keyboard.press("Escape")
    assert "not available" in watching.said
    watching.see(0.5)
    assert served.state == "running"
    watching.context.close()
    assert watching.troubles == []


# what the page sends, and a status with an epoch that the test sets: the daemon's own are not changed for this
RECORD_CALLS = """
  window.sent = [];
  const send = WebSocket.prototype.send;
  WebSocket.prototype.send = function (text) { window.sent.push(JSON.parse(text)); send.call(this, text); };
  const parse = JSON.parse;
  JSON.parse = function (text) {
    const message = parse(text);
    if (message && message.status && "epoch" in window) message.status.epoch = window.epoch;
    return message;
  };
"""


@pytest.mark.parametrize("epoch", [7, None])
def test_what_gives_torque_or_motion_carries_the_epoch_that_was_shown(served, chromium, epoch):
    served.rest()
    page = Page(chromium, served)
    page.tab.add_init_script(RECORD_CALLS + f"window.epoch = {'undefined' if epoch is None else epoch};")
    page.open()
    page.until_state("ready")
    for button in ("#enable", "#start"):
        page.js(f"document.querySelector('{button}').disabled = false, document.querySelector('{button}').click()")
    calls = page.js("window.sent.filter((m) => m.do === 'call')")
    assert [call["method"] for call in calls] == ["enable", "start"]
    for call in calls:
        assert call["params"].get("epoch") == epoch
        assert ("epoch" in call["params"]) == (epoch is not None)
    page.context.close()


def test_a_stop_that_nobody_confirms_says_so_until_the_state_does(served, chromium):
    page = Page(chromium, served)
    sockets = []
    page.tab.route_web_socket("**/live?key=*", lambda socket: sockets.append(socket))  # hears, and does not answer
    page.tab.goto(page.address)
    page.until("document.querySelector('#connection').textContent === 'connected, waiting for the daemon'")
    assert not page.tab.is_visible("#rights")  # nobody has refused the key yet
    page.tab.click("#stop")
    page.js("document.querySelector('#commands').disabled = false, document.querySelector('#enable').click()")
    page.until("document.querySelector('#said').textContent.startsWith('Enable')")  # asked for since; the stop is said
    page.until("document.querySelector('#said').textContent.includes('NOT CONFIRMED')")
    assert "emergency stop of the machine" in page.said
    page.js("document.querySelector('#view-save').click()")  # says that a view needs a name: not over this
    assert "NOT CONFIRMED" in page.said
    status = {"state": "running", "epoch": 1, "obstacles": [], "toggle": "ff", "model": {"name": "m"}}
    status |= {"recording": {"on": False}, "profile": None, "fault": None, "drive": None, "set_point": None}
    sockets[0].send(json.dumps({"kind": "status", "status": status}))
    page.until("document.querySelector('#state').textContent === 'RUNNING'")
    assert "NOT CONFIRMED" in page.said  # it still turns
    sockets[0].send(json.dumps({"kind": "status", "status": status | {"state": "ready"}}))
    page.until("document.querySelector('#said').textContent.includes('confirmed late')")
    page.until("document.querySelector('#connection').textContent.startsWith('no status for')")
    assert "the data shown are old" in page.js("document.querySelector('#connection').textContent")
    page.context.close()


def test_what_a_connection_may_is_told_apart(served, page, chromium):
    served.run()
    page.until("document.querySelector('#connection').textContent === 'connected, with the key'")
    watching = Page(chromium, served, key=False).open()
    watching.until("document.querySelector('#connection').textContent === 'connected, view only'")
    watching.context.close()


def test_friction_is_drawn_over_velocity_and_any_signal_by_its_name(served, page):
    served.run()
    page.see(1.0)
    page.until("document.querySelector('#friction-map canvas')")
    assert page.tab.evaluate(INKED, ["Friction over velocity", "green"]) > 20
    page.tab.select_option("#signal", "integral_a")
    page.see(0.5)
    assert page.tab.evaluate(INKED, ["integral_a, A", "purple"]) > 20
    page.tab.select_option("#signal", "")
    assert page.js("[...document.querySelectorAll('figure')].every((f) => !f.textContent.startsWith('integral_a'))")


def test_the_crosshair_gives_the_values_of_its_time(served, page):
    served.run()
    page.see(2.0)
    page.tab.keyboard.press("Space")
    last = page.tab.locator("figure").first.locator(".value").first.text_content()
    box = page.settled(page.tab.locator("figure .u-over").first)
    page.tab.mouse.move(box["x"] + 0.98 * box["width"], box["y"] + 30)
    seen = set()
    for k in range(1, 6):
        page.tab.mouse.move(box["x"] + (0.98 - 0.01 * k) * box["width"], box["y"] + 30)
        seen.add(page.tab.locator("figure").first.locator(".value").first.text_content())
    assert len(seen - {last}) >= 2
    page.tab.keyboard.press("0")


def test_everything_can_be_done_with_keys(served, page):
    page.js("document.activeElement.blur()")
    page.tab.keyboard.press("Tab")
    assert page.js("document.activeElement.id") == "stop"  # first of all
    page.reach("enable")
    page.tab.keyboard.press("Enter")
    page.until_state("enabled")
    page.reach("start")
    page.tab.keyboard.press("Enter")
    page.until_state("running")
    page.reach("ff")
    page.tab.keyboard.press("ArrowRight")
    page.until("document.querySelector('#facts').textContent.includes('friction fb')")
    page.reach("seconds")
    page.tab.keyboard.press("Escape")
    page.until_state("ready")


def test_pause_and_zoom(served, page):
    page.tab.select_option("#seconds", "5")
    page.see(1.0)
    page.tab.keyboard.press("Space")
    begin_s, end_s = page.until("fffoScope.view")
    assert end_s - begin_s == pytest.approx(5.0)
    page.see(0.5)  # the axis goes on, the view does not
    assert page.js("fffoScope.view") == [begin_s, end_s]
    page.tab.keyboard.press("+")
    middle = page.js("fffoScope.view")
    assert middle[1] - middle[0] == pytest.approx(2.5)
    page.tab.keyboard.press("ArrowLeft")
    assert page.js("fffoScope.view")[0] < middle[0]
    box = page.settled(page.tab.locator("figure .u-over").first)
    before_s = page.js("fffoScope.view")
    page.tab.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 30)
    page.tab.mouse.down()
    page.tab.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 40, steps=5)
    page.tab.mouse.up()
    width_s = before_s[1] - before_s[0]
    page.until(f"Math.abs(fffoScope.view[1] - fffoScope.view[0] - {0.5 * width_s}) < {0.05 * width_s}")
    page.tab.keyboard.press("0")
    assert page.js("fffoScope.view") is None
    assert page.tab.get_attribute("#pause", "aria-pressed") == "false"


@pytest.mark.parametrize("size", [LAPTOP, TABLET, UPRIGHT, (390, 844)])
def test_it_fits_and_stop_is_at_hand(served, chromium, size):
    page = Page(chromium, served, size, has_touch=True).open()
    assert page.js("document.scrollingElement.scrollWidth <= innerWidth")
    page.js("scrollTo(0, document.body.scrollHeight)")
    box = page.js("document.querySelector('#stop').getBoundingClientRect().toJSON()")
    assert 0 <= box["top"] < box["bottom"] <= size[1]  # also at the end of the page
    assert box["bottom"] - box["top"] >= 44
    if size != (390, 844):
        header = page.js("document.querySelector('header').offsetHeight")
        assert header < 0.3 * size[1]
    page.context.close()
    assert page.troubles == []


@pytest.mark.parametrize(("role", "commands", "toggle"), [("stop", False, False), ("move", True, False)])
def test_a_key_of_a_lesser_role_allows_less_and_the_log_says_who(served, chromium, role, commands, toggle):
    served.run()
    page = Page(chromium, served)
    page.address = f"{served.url}#anna:{Keys(served.key).of(role)}"
    page.tab.goto(page.address)
    page.until("document.querySelector('#rights').textContent.startsWith('(role ')")
    page.until_state("running")
    assert page.tab.text_content("#rights") == f"(role {role})"
    assert page.tab.is_enabled("#disable") is commands
    assert page.tab.is_enabled("input[name=toggle][value=off]") is toggle
    page.tab.keyboard.press("Escape")
    served.until(lambda: served.state == "ready")
    page.until("document.querySelector('#events').textContent.includes('disable by anna')")
    assert f"disable by anna ({role}) through pid" in page.tab.text_content("#events")
    page.context.close()
    assert page.troubles == []
