"""The axis tab in a real browser, beside a daemon with the simulated drive: torque, jog, gains, faults, roles."""

from __future__ import annotations

import json
import shutil
import time
from contextlib import contextmanager

import pytest
import yaml
from live.served import Served
from workbench.test_workbench_in_a_browser import COMPILING_S, CONFIGS, Shown

from fffo_drive.can.link import free_loopback_port
from fffo_drive.commissioning.judge import CHECKS
from fffo_drive.commissioning.record import read_record
from fffo_drive.config.axis import read_axis
from fffo_drive.recording.reader import read_run
from fffo_drive.workbench.bench import AUDIT_NAME, Workbench

MOST_LAPSES = 5
NOT_CONFIRMED = "STOP NOT CONFIRMED"
LAPSED = ("is over", "no status of it comes")  # of a jog that the page could not renew, or not see, in time
TURNS = "fffoAxis.status.state === 'following' && fffoAxis.status.motion.velocity_rps > 0.5"
pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.browser, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    with Served(tmp_path_factory.mktemp("served")) as served:
        yield served


class AxisPage(Shown):
    """The tab of an axis that is served; the page of this role, with a name."""

    def __init__(self, chromium, served, directory, role="tune"):
        super().__init__(chromium, Workbench(directory / "out", served.axis, None, (), served.sockets), role)
        self.served = served
        self.log = directory / "out" / AUDIT_NAME
        self.lapses = 0  # of jogs that the page could not renew in time
        self.page.click("#tab-axis")
        self.until("fffoAxis.status !== null")

    def state(self, *wanted):
        self.until(f"fffoAxis.status && {json.dumps(wanted)}.includes(fffoAxis.status.state)")

    def says(self, *texts):
        """One of them."""
        said = "document.querySelector('#axis-said').textContent"
        self.until(f"{json.dumps(texts)}.some((text) => {said}.includes(text))")

    def enable(self):
        """With torque: the axis may be moved."""
        self.state("ready")
        self.until("!document.querySelector('#enable').disabled")
        self.page.click("#enable")
        self.page.click("#ask-yes")
        self.until("!document.querySelector('#jog-ahead').disabled")

    @contextmanager
    def press(self, button, so, key=None):
        """A jog button is held, by the mouse or by this key, until `so`; again where the jog lapsed under load."""
        for _ in range(MOST_LAPSES):
            self.until(f"!fffoAxis.turning && !document.querySelector('{button}').disabled")
            self.page.evaluate("document.querySelector('#axis-said').textContent = ''")
            self._down(button, key)
            try:
                assert self.page.text_content("#axis-said").startswith("Jog"), "the page did not take the press"
                if self.until(f"fffoAxis.status && ({so}) ? 'so' : !fffoAxis.turning && 'over'") == "so":
                    yield
                    return
            finally:
                self._up(key)
            said = self.page.text_content("#axis-said")
            assert any(text in said for text in LAPSED), said
            self.lapses += 1
        raise AssertionError(f"lapsed again and again: {said}")

    def _down(self, button, key):
        if key is not None:
            self.page.focus(button)
            self.page.keyboard.down(key)
            return
        self.page.locator(button).hover()  # its middle, once it stands still and nothing covers it
        self.page.mouse.down()

    def _up(self, key):
        if key is None:
            self.page.mouse.up()
        else:
            self.page.keyboard.up(key)

    def actions(self):
        return [json.loads(line)["action"] for line in self.log.read_text().splitlines()]


@pytest.fixture
def shown(served, chromium, tmp_path):
    served.rest()
    page = AxisPage(chromium, served, tmp_path)
    yield page
    served.rest()
    page.close()


def test_torque_jog_by_mouse_and_by_keys_alone_and_stop(shown):
    shown.enable()
    with shown.press("#jog-ahead", TURNS):
        pass
    shown.state("enabled")
    shown.says("Jog ended at standstill")
    with shown.press("#jog-back", "fffoAxis.status.motion.velocity_rps < -0.5", "Space"):
        pass
    shown.state("enabled")
    shown.page.keyboard.press("Escape")
    shown.state("ready")
    shown.says("the axis is at rest, no torque")
    begun_and_ended = ["jog"] * (2 * 2 + shown.lapses)  # of one that lapsed the beginning
    assert shown.actions() == ["enable", *begun_and_ended, "disable"]
    assert "by role tune through pid" in shown.page.text_content("#axis-events")


@pytest.mark.parametrize("how", ["hidden", "blur", "gone"])
def test_a_page_that_goes_away_ends_its_jog(shown, how):
    shown.page.uncheck("#tied")  # the daemon alone, or the page, brakes: nothing hangs on the connection
    shown.enable()
    with shown.press("#jog-ahead", TURNS):
        if how == "gone":
            shown.page.route("**/axis/**", lambda route: route.abort())  # nothing that it sends arrives any more
        else:
            event = "new Event('visibilitychange')" if how == "hidden" else "new Event('blur')"
            target = "document" if how == "hidden" else "window"
            shown.page.evaluate(
                f"Object.defineProperty(document, 'hidden', {{ get: () => {str(how == 'hidden').lower()} }});"
                f"{target}.dispatchEvent({event})"
            )
        shown.served.until(lambda: shown.served.state == "enabled")


def test_a_jog_that_is_let_go_brakes_at_once_and_a_press_while_it_brakes_is_not_lost(shown):
    shown.enable()
    shown.page.evaluate("""() => {
      const ask = window.fetch;
      window.sent = [];
      window.fetch = (what, how) => {
        if (what === "axis/jog") window.sent.push(JSON.parse(how.body));
        return ask(what, how);
      };
      const later = window.setTimeout; // no renewal comes: what ends the jog is the button
      window.setTimeout = (what, ms) => (ms > 500 ? 0 : later(what, ms));
    }""")
    with shown.press("#jog-ahead", "fffoAxis.status.state === 'following'"):
        pass
    shown.page.keyboard.down("Space")  # the button has the focus
    shown.until("window.sent.filter((jog) => jog.to_rps).length === 2")
    shown.page.keyboard.up("Space")
    shown.until("!fffoAxis.turning")
    assert shown.page.evaluate("window.sent.map((jog) => jog.to_rps)") == [1, 0, 1, 0]


def test_nothing_moves_before_the_drive_has_torque_and_a_held_button_that_is_greyed_lets_go(shown):
    shown.enable()
    shown.page.evaluate("""() => {
      window.hear = fffoAxis.source.onmessage;
      window.last = fffoAxis.status;
      fffoAxis.source.onmessage = null;
      window.tell = (more) => hear({ data: JSON.stringify({ kind: "status", status: { ...last, ...more } }) });
    }""")
    for mode, moves in (("idle", False), ("velocity", True)):
        shown.page.evaluate(f"tell({{ motion: {{ ...last.motion, mode: '{mode}' }} }})")
        for button in ("#jog-back", "#jog-ahead", "#go", "#step", "#start"):
            assert shown.page.is_enabled(button) is moves
        assert ("no torque yet" in shown.page.text_content("#axis-doing")) is not moves
    shown.page.locator("#jog-ahead").hover()
    shown.page.mouse.down()
    assert shown.page.evaluate("fffoAxis.turning !== null")
    shown.page.evaluate("fffoAxis.heardMs = -1e9")  # no status any more
    shown.says("Jog ended at standstill: no status of it comes")
    shown.page.mouse.up()


def test_no_button_jumps_from_under_the_mouse(shown):
    """Whatever the page tells: the words have their line, and the values stand below what moves the axis."""
    place = "JSON.stringify(document.querySelector('#jog-ahead').getBoundingClientRect())"
    shown.state("ready")
    before = shown.page.evaluate(place)
    shown.page.evaluate("""() => {
      for (const id of ["connection", "axis-said", "axis-link", "axis-obstacles", "next", "axis-doing"])
        document.getElementById(id).textContent = "no status for some seconds: the data are old";
      document.getElementById("axis-live").append("more ".repeat(200));
    }""")
    assert shown.page.evaluate(place) == before
    shown.page.evaluate("fffoAxis.source.onmessage = null; fffoAxis.status = null; fffoWorkbench.look()")
    assert shown.page.evaluate(place) == before, "its status is not known yet: is a simulated drive offered beside it?"


def test_an_axis_that_hangs_on_the_page_is_stopped_when_it_is_closed(served, chromium, tmp_path):
    served.rest()
    page = AxisPage(chromium, served, tmp_path)
    page.enable()
    page.page.click("#start")
    page.page.click("#ask-yes")
    page.state("running")
    page.context.close()
    served.until(lambda: served.state == "ready")
    page.server.close()


def test_what_the_person_does_not_agree_to_is_not_asked_for(shown):
    shown.state("ready")
    shown.page.click("#enable")
    assert "Is everybody out of its reach" in shown.page.text_content("#ask-text")
    shown.page.click("#ask-no")
    shown.page.click("#quick")
    shown.until("document.querySelector('#axis-said').textContent.includes('at rest')")
    assert shown.actions() == ["quick_stop"]


def test_set_points_and_a_profile_and_its_end(shown):
    shown.enable()
    shown.page.fill("#velocity", "1.5")
    shown.page.click("#go")
    turns = "fffoAxis.status.set_point"
    shown.until(f"{turns} && {turns}.to_rps === 1.5 && !{turns}.run_on")
    first = shown.page.evaluate("fffoAxis.status.set_point.number")
    shown.page.fill("#velocity", "1.25")
    shown.page.click("#go")  # in motion
    shown.until(f"{turns} && {turns}.to_rps === 1.25 && {turns}.number > {first} + 1")  # and the page renews it
    shown.served.client.call("stop")
    shown.says("Velocity: stopped by pid")
    shown.state("enabled")
    shown.page.check("#run-on")
    shown.page.fill("#velocity", "1.5")
    shown.page.click("#go")
    shown.until(f"{turns} && {turns}.to_rps === 1.5 && {turns}.run_on")
    shown.page.fill("#step-by", "0.5")
    shown.page.fill("#step-for", "60")
    shown.page.click("#step")
    shown.until("fffoAxis.status.set_point && fffoAxis.status.set_point.to_rps === 2")
    shown.page.click("#end")
    shown.state("enabled")
    shown.page.click("#start")
    shown.page.click("#ask-yes")
    shown.state("running")
    shown.until("document.querySelector('#axis-doing').textContent.includes(' %')")
    shown.page.click("#disable")
    shown.state("ready")
    shown.page.check("input[name=friction][value=off]")
    shown.until("fffoAxis.status.toggle === 'off'")


def test_a_gain_is_tried_with_a_step_before_and_after_and_taken_back(shown):
    shown.enable()
    row = shown.page.locator("#gains tbody tr").first
    assert "proportional_a_per_rps" in row.text_content()
    row.locator("input").fill("0.12")
    row.locator("button").nth(1).click()
    shown.page.click("#ask-yes")
    shown.until("fffoWorkbench.state.trials.some((trial) => trial.state !== 'running')")
    assert shown.page.evaluate("fffoWorkbench.state.trials[0].says") == "done"
    shown.page.locator("#trial .uplot canvas").wait_for()
    figures = shown.page.locator("#trial > table tbody tr")
    assert [figures.nth(k).locator("td").first.text_content() for k in range(2)] == ["before", "after"]
    assert shown.served.client.call("info")["keys"]["controller.proportional_a_per_rps"] == 0.12
    shown.page.get_by_role("button", name="Take it back: 0.1").click()
    shown.until("document.querySelector('#gains tbody tr td:nth-child(2)').textContent === '0.1'")
    assert shown.served.client.call("info")["keys"]["controller.proportional_a_per_rps"] == 0.1


def test_a_value_that_the_gates_refuse_is_reported_and_nothing_changes(shown):
    shown.state("ready")
    row = shown.page.locator("#gains tbody tr").nth(4)
    row.locator("input").fill("-3")
    row.locator("button").first.click()
    shown.until("document.querySelector('#axis-said.bad')")
    shown.says("clamp_ratio")
    assert shown.served.client.call("info")["keys"]["controller.observer.clamp_ratio"] == 2


def test_a_fault_is_shown_with_the_drives_words_and_reset(shown):
    shown.enable()
    shown.served.break_down()
    shown.state("fault")
    assert shown.page.is_visible("#axis-fault")
    assert "Remove the cause, then reset it." in shown.page.text_content("#axis-fault")
    assert shown.page.is_disabled("#enable")
    shown.page.click("#reset")
    shown.state("ready")
    assert not shown.page.is_visible("#axis-fault")


def test_a_recording_is_made_by_the_daemon_and_listed(shown):
    served = shown.served
    content = yaml.safe_load(served.axis.read_text())
    profile = {"profile": {"kind": "sine", "duration_s": 3, "amplitude": 1, "frequency_hz": 1}}
    short = shown.log.parent / "short.yaml"
    served.axis.write_text(yaml.safe_dump(content | profile, sort_keys=False))
    try:
        shown.page.click("#tab-work")
        shown.until("!document.querySelector('#record').disabled")
        shown.page.click("#record")
        shown.page.click("#ask-yes")
        shown.until("fffoWorkbench.state.jobs.length && fffoWorkbench.state.jobs[0].state !== 'running'")
        assert shown.job["state"] == "done", shown.job
        assert "--served" in shown.job["line"]
        shown.until("fffoWorkbench.state.runs.length === 1")
    finally:
        served.axis.write_text(yaml.safe_dump(content, sort_keys=False))
    run = read_run(next((shown.log.parent / "runs").glob("*.mcap")))
    assert run.metadata["source"] == "daemon"
    assert served.state == "ready"
    assert not short.exists()


@pytest.mark.parametrize(
    ("role", "off", "on"),
    [
        ("look", ("#halt", "#quick", "#enable", "#serve"), ()),
        ("stop", ("#enable", "#start", "#serve"), ("#halt", "#quick")),
        ("move", ("input[name=friction][value=off]", "#gains button"), ("#halt", "#enable")),
    ],
)
def test_what_a_role_may_not_cannot_be_pressed_and_is_refused_all_the_same(
    served, chromium, tmp_path, role, off, on
):  # fmt: skip
    served.rest()
    page = AxisPage(chromium, served, tmp_path, role)
    page.state("ready")
    page.until(f"document.querySelector('#where').textContent.endsWith('role: {role}')")
    for selector in off:
        assert page.page.locator(selector).first.is_disabled(), selector
    for selector in on:
        page.until(f"!document.querySelector('{selector}').disabled")
    refused = {"look": "disable", "stop": "enable", "move": "set"}[role]
    answer = page.page.evaluate(
        f"fetch('axis/{refused}', {{ method: 'POST', body: '{{}}' }})"
        ".then(async (answer) => [answer.status, (await answer.json()).error])"
    )
    assert answer[0] == 403
    assert f"this page has {role}" in answer[1]
    if role == "look":
        page.page.keyboard.press("Escape")
        page.says("Use the emergency stop of the machine")
    assert served.state == "ready"
    page.close()


def test_a_stop_that_nobody_confirms_says_so_until_the_state_does(shown):
    shown.enable()
    shown.page.route("**/axis/disable", lambda route: route.abort())
    shown.page.keyboard.press("Escape")
    shown.says(NOT_CONFIRMED)
    assert "emergency stop of the machine" in shown.page.text_content("#axis-said")
    shown.served.client.call("disable")
    shown.says("confirmed late, by its state: ready")


def test_a_stop_that_is_not_confirmed_is_said_whatever_was_asked_for_since(shown):
    shown.enable()
    held = []
    shown.page.route("**/axis/disable", lambda route: held.append(route))
    with shown.page.expect_request("**/axis/disable"):
        shown.page.keyboard.press("Escape")
    with shown.page.expect_response("**/axis/toggle") as answered:
        shown.page.click("input[name=friction][value=off]")
    answered.value.finished()
    # a machine that takes 3 s for this has heard already that nothing confirmed the stop
    shown.says("Friction off: done", NOT_CONFIRMED)
    held.pop().abort()
    shown.says(NOT_CONFIRMED)
    shown.served.client.call("disable")
    shown.says("confirmed late, by its state: ready")


def test_a_late_answer_to_enable_does_not_cover_a_stop_that_nobody_confirms(shown):
    held = []
    shown.page.route("**/axis/enable", lambda route: held.append((route, route.fetch())))
    shown.enable()
    shown.page.route("**/axis/disable", lambda route: route.abort())
    shown.page.keyboard.press("Escape")
    shown.says(NOT_CONFIRMED)
    route, response = held.pop()
    with shown.page.expect_response("**/axis/enable") as answered:
        route.fulfill(response=response)
    answered.value.finished()
    shown.page.evaluate("fetch('axis/info', { method: 'POST', body: '{}' }).then((answer) => answer.text())")
    assert "emergency stop of the machine" in shown.page.text_content("#axis-said")
    shown.served.client.call("disable")
    shown.says("confirmed late, by its state: ready")


def test_a_status_that_is_old_allows_nothing_but_a_stop(shown):
    shown.state("ready")
    shown.until("!document.querySelector('#enable').disabled")
    shown.page.evaluate("fffoAxis.source.onmessage = null, fffoAxis.heardMs = -1e9")
    shown.until("document.querySelector('#enable').disabled")
    assert "the data shown are old" in shown.page.text_content("#axis-link")
    assert not shown.page.is_disabled("#halt")


def test_a_screen_reader_finds_everything_and_a_narrow_page_needs_no_scrolling_sideways(shown):
    shown.enable()
    shown.is_found_by_a_screen_reader_and_fits_a_narrow_screen()


# what a shared machine needs to be commissioned: a plant that SYNC steps, a slow loop, and patience
PATIENT_LINES = {
    "rated_current_a: 8.3\n": "  heartbeat_timeout_ms: 5000\n  command_timeout_ms: 5000\n",
    "following_error_s: 0.2\n": "  feedback_missing_ticks: 4000\n  accept_runaway: true\n"
    "  status_missing_ticks: 8000\n"
    "  heartbeat_timeout_s: 10\nloop: {rate_hz: 250, cutoff_share: 0.9}\n",
}


@pytest.fixture
def uncommissioned(tmp_path):
    """An axis file without a record, with the file of its simulated drive beside it."""
    shutil.copytree(CONFIGS, tmp_path / "configs")
    axis, bus = tmp_path / "configs" / "axis_canopen.yaml", f"loopback:{free_loopback_port()}"
    text = axis.read_text().replace("loopback:29500", bus)
    for line, more in PATIENT_LINES.items():
        assert text.count(line) == 1
        text = text.replace(line, line + more)
    axis.write_text(text)
    drive = yaml.safe_load((CONFIGS / "simulated_drive.yaml").read_text())
    drive |= {"step_by_sync": True, "sync_loss_tolerance_ms": 60_000, "realtime_priority": 0}
    axis.with_name("simulated_drive.yaml").write_text(yaml.safe_dump(drive, sort_keys=False))
    return axis


def keys_yes(page):
    """From "Do not", which has the focus, to "Move it"."""
    for _ in range(2):
        page.keyboard.press("Shift+Tab")
    page.keyboard.press("Enter")


def click_yes(page):
    page.click("#ask-yes")


def keys_all(page):
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Enter")


@pytest.mark.long
def test_a_simulated_drive_is_started_and_its_axis_commissioned_with_a_question_before_each_motion(
    uncommissioned, chromium, tmp_path
):
    with Shown(chromium, Workbench(tmp_path / "out", uncommissioned, None, ())) as shown:
        before = uncommissioned.read_text()
        record = uncommissioned.with_name("canopen.commissioning.yaml")
        asks = "document.querySelector('#ask').open && document.querySelector('#ask-text').textContent"
        ended = "fffoWorkbench.state.jobs[0].state !== 'running'"
        next_step = "Next: commission the axis, once its simulated drive runs (tab Axis)"
        assert shown.page.text_content("#next") == next_step
        shown.page.click("#tab-axis")
        shown.page.click("#simulate")
        shown.until("document.querySelector('#simulated-state').textContent.includes('ready')", COMPILING_S)
        shown.page.evaluate("fffoWorkbench.ask('simulate', {}).catch((error) => { window.refused = error.message; })")
        shown.until("(window.refused || '').includes('already')")
        shown.page.click("#tab-work")

        shown.page.click("#commission")
        asked = shown.until(asks, COMPILING_S)
        assert "canopen will move for motion, torque sign, velocity sign, position sign: pulses both ways" in asked
        assert "at most 4.15 A, 5 rps and 2 rev from here" in asked
        shown.page.click("#ask-no")
        shown.until("fffoWorkbench.state.jobs[0].state === 'failed'")
        assert "nothing was moved, and no record was written" in " ".join(shown.job["output"])
        assert not record.exists()

        left = f"{len(CHECKS) - 1} not done"  # all but the one without motion
        shown.until(f"document.querySelector('#checks-verdict').textContent.includes('{left}')")

        for _ in range(MOST_LAPSES):  # a machine that keeps no time measures another axis: once more, as a user would
            begun = shown.jobs() + 1
            shown.page.focus("#commission")
            shown.page.keyboard.press("Enter")
            shown.until(f"fffoWorkbench.state.jobs.length === {begun}")
            for words, answer in (("motion", keys_yes), ("counts per rev", click_yes), ("current limit", keys_all)):
                asked = shown.until(f"({asks} || '').includes('will move for {words}') ? {asks} : {ended}")
                if asked is True:
                    break
                assert "rps and " in asked
                answer(shown.page)
            shown.until(ended)
            if shown.job["state"] == "done":
                break
            assert "not passed" in shown.job["output"][-1]
        shown.until("document.querySelector('#ask').open")
        assert "Name its record in" in shown.page.text_content("#ask-text")
        assert uncommissioned.read_text() == before
        assert read_record(record).drive.product_code == 0x50455332
        shown.page.click("#ask-yes")
        shown.until("fffoWorkbench.state.axis.commissioning === ''")
        assert read_axis(uncommissioned).commissioning == record.name
        assert uncommissioned.read_text().replace(f"commissioning: {record.name}\n", "", 1) == before
        log = [json.loads(line) for line in (tmp_path / "out" / AUDIT_NAME).read_text().splitlines()]
        answers = [(one["checks"][0], one["answer"]) for one in log if one["action"] == "answer"]
        assert answers[0] == ("motion", "no")
        assert answers[-3:] == [("motion", "yes"), ("counts_per_rev", "yes"), ("current_limit", "all")]
        moved = [check.name for check in read_record(record).checks if check.name != "standstill"]
        for name in moved:
            check = shown.page.locator(f"#check-{name}")
            check.evaluate("(fold) => { fold.open = true; }")
            check.locator(".uplot canvas").first.wait_for()
        assert shown.page.text_content("#checks-verdict").startswith("passed: ")
        drive = shown.server.bench.services["simulate"].running
    assert drive.process.poll() is not None  # it ends with the workbench


@pytest.mark.long
def test_drive_and_daemon_are_started_and_stopped_from_the_page_and_commissioning_waits_for_its_end(chromium, tmp_path):
    shutil.copytree(CONFIGS, tmp_path / "configs")
    axis, bus = tmp_path / "configs" / "axis_canopen.yaml", f"loopback:{free_loopback_port()}"
    text = axis.read_text().replace("loopback:29500", bus).replace("name: canopen", f"name: b{time.monotonic_ns()}")
    axis.write_text(text)
    with Shown(chromium, Workbench(tmp_path / "out", axis, None, ())) as shown:
        shown.page.click("#tab-axis")
        for button, begun in (("#simulate", "services.simulate"), ("#serve", "daemon")):
            shown.until(f"!document.querySelector('{button}').disabled")
            shown.page.click(button)
            shown.until(f"fffoWorkbench.state.{begun}")
        shown.until("fffoAxis.status && fffoAxis.status.state === 'connected'", COMPILING_S)
        assert "commissioning" in shown.page.text_content("#axis-obstacles")
        assert shown.page.is_disabled("#enable")
        assert shown.page.is_disabled("#commission")
        shown.until("document.querySelector('#scope-link').href.startsWith('http://127.0.0.1:')", COMPILING_S)
        shown.page.click("#unserve")
        shown.until("!fffoWorkbench.state.daemon")
        shown.until("fffoWorkbench.state.services.serve.state === 'cancelled'")
        shown.page.click("#stop-simulation")
        shown.until("fffoWorkbench.state.services.simulate.state === 'cancelled'")
        shown.page.click("#tab-work")
        shown.until("!document.querySelector('#commission').disabled")
