"""What the scope measures, in a browser: cursors, zoom, triggers, saved views, spectrum, step response, phase.

Each with the mouse and with the keys alone.
"""

from __future__ import annotations

import json
import re
from itertools import pairwise

import pytest
from live.scope_page import Page
from live.served import RATE_HZ, Served

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.browser, pytest.mark.timeout(400)]
SINE_RPS, SINE_HZ = 2.0, 0.5
STEPS = {"kind": "points", "points": [[0, 0], *([t + k, v] for t in range(2, 90, 4) for k, v in
         ((0, 0), (1.0 / RATE_HZ, 1), (2, 1), (2 + 1.0 / RATE_HZ, 0)))]}  # fmt: skip
TURNING = {"kind": "points", "points": [[0, 0], [1, 2], [90, 2]]}
NARROW = (420, 800)
SERIOUS = ("serious", "critical")
LARGEST_BYTES = 1_500_000
TICK_S = 1.0 / RATE_HZ


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


def run(served, profile):
    served.rest()
    served.client.call("enable")
    served.client.act("start", profile=profile)


def choose(page, name, key):
    """A choice of a list, with keys alone."""
    page.reach(name)
    page.tab.keyboard.press(key)
    page.tab.keyboard.press("Enter")


def focus_plot(page, aria):
    """With Tab, to a plot."""
    for _ in range(120):
        page.tab.keyboard.press("Tab")
        if page.js(f"(document.activeElement.getAttribute('aria-label') || '').startsWith('{aria}')"):
            return
    pytest.fail(f"{aria} is not reached with Tab")


def plot(page, key="Velocity"):
    """Where a plot's own area is."""
    figure = page.tab.locator(f"figure[data-analysis={key}], figure:has(b:text-matches('^{key}'))").first
    return page.settled(figure.locator(".u-over"))


Y = "(() => { const u = Chart.current.plot; return [u.scales.y.min, u.scales.y.max]; })()"


def test_two_cursors_give_values_and_differences_with_the_mouse(served, page):
    page.tab.select_option("#seconds", "2")  # all of it with curves: a cursor stands where there is something
    served.run()
    page.see(3.0)
    page.tab.click("#pause")
    page.until("!!fffoScope.taken")
    for share in (0.3, 0.7):
        box = plot(page)  # the values of a cursor take room
        page.tab.mouse.click(box["x"] + share * box["width"], box["y"] + 40)
    begin_s, end_s = page.js("fffoScope.view")
    a_s, b_s = page.js("[Chart.current.cursors.at.a, Chart.current.cursors.at.b]")
    assert b_s - a_s == pytest.approx(0.4 * (end_s - begin_s), rel=0.03)
    rows = page.js("""(() => { const c = columnsOf(fffoScope.taken, fffoScope.fields, ['tick', 'velocity_rps']);
                      return Object.fromEntries(c.tick.map((t, i) => [Number(t), c.velocity_rps[i]])); })()""")
    low, high = (rows[str(round(at * RATE_HZ))] for at in (a_s, b_s))
    page.until("!document.querySelector('figure .cursors').hidden")
    text = page.tab.locator("figure .cursors").first.text_content().replace("−", "-")
    assert float(re.search(r"velocity [^Δ]*Δ (\S+) rps", text)[1]) == pytest.approx(high - low, rel=6e-4)
    assert f"1/(B-A) {1.0 / (b_s - a_s):.4g}"[:12] in text
    assert page.js("[...document.querySelectorAll('.cursors')].filter((c) => !c.hidden).length") >= 5
    box = plot(page)
    page.tab.mouse.dblclick(box["x"] + 0.5 * box["width"], box["y"] + 40)
    assert page.js("fffoScope.view") is None
    assert page.js("document.querySelector('figure .cursors').hidden")


def test_cursors_and_the_zoom_of_the_values_with_keys_alone(served, page):
    served.run()
    page.see(2.0)
    page.tab.keyboard.press("Space")
    focus_plot(page, "Velocity")
    page.tab.keyboard.press("a")
    page.tab.keyboard.press("b")
    before = page.js("Chart.current.cursors.at")
    page.tab.keyboard.press("Shift+ArrowRight")
    after = page.js("Chart.current.cursors.at")
    assert before["a"] == after["a"] < before["b"] < after["b"]
    low, high = page.js(Y)
    page.tab.keyboard.press("PageUp")
    near = page.js(Y)
    assert near[1] - near[0] == pytest.approx((high - low) / 1.25)
    page.tab.keyboard.press("ArrowUp")
    moved = page.js(Y)
    assert moved[0] > near[0]
    assert moved[1] - moved[0] == pytest.approx(near[1] - near[0])
    page.tab.keyboard.press("y")
    assert page.js(Y) == [low, high]
    page.tab.keyboard.press("Delete")
    assert page.js("Chart.current.cursors.at") == {"a": None, "b": None}


def test_wheel_and_drag_zoom_and_move_the_values_and_the_page_still_scrolls(served, page):
    served.run()
    page.see(2.0)
    page.tab.click("#pause")
    box = plot(page)
    over_numbers = (box["x"] - 25, box["y"] + 0.5 * box["height"])
    page.tab.mouse.move(*over_numbers)
    low, high = page.js(Y)
    page.tab.mouse.wheel(0, -100)
    page.until(f"{Y}[1] - {Y}[0] < {0.9 * (high - low)}")
    near = page.js(Y)
    page.tab.mouse.down()
    page.tab.mouse.move(over_numbers[0], over_numbers[1] + 0.25 * box["height"], steps=4)
    page.tab.mouse.up()
    moved = page.js(Y)
    assert moved[0] - near[0] == pytest.approx(0.25 * (near[1] - near[0]), rel=0.1)
    view_s = page.js("fffoScope.view")
    page.tab.keyboard.down("Shift")
    page.tab.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 40)
    page.tab.mouse.down()
    page.tab.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 40, steps=4)
    page.tab.mouse.up()
    page.tab.keyboard.up("Shift")
    assert page.js("fffoScope.view")[0] - view_s[0] == pytest.approx(0.25 * (view_s[1] - view_s[0]), rel=0.1)
    page.tab.click("text=values: automatic")
    page.tab.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 40)
    page.tab.mouse.wheel(0, 300)
    page.until("scrollY > 0")


EVENTS = """(() => { const c = columnsOf(fffoScope.taken, fffoScope.fields, ['tick', 'reference_rps']);
             return c.tick.map((t, i) => [Number(t) / fffoScope.rate, c.reference_rps[i]]); })()"""


def test_a_level_triggers_at_its_edge_and_holds(served, page):
    page.tab.select_option("#seconds", "1")
    page.tab.select_option("#trigger", "level")
    page.tab.select_option("#trigger-signal", "reference_rps")
    page.tab.fill("#level", "1.5")
    page.tab.press("#level", "Enter")
    page.tab.select_option("#edge", "falling")
    page.tab.select_option("#pre", "25")
    served.run()
    page.until("fffoScope.taken && fffoScope.view")
    begin_s, end_s = page.js("fffoScope.view")
    assert end_s - begin_s == pytest.approx(1.0)
    event_s = begin_s + 0.25
    falls = [after[0] for before, after in pairwise(page.js(EVENTS)) if before[1] >= 1.5 > after[1]]
    assert min(abs(fall - event_s) for fall in falls) < 0.5 * TICK_S


def test_normal_waits_for_the_next_and_auto_goes_on_live(served, page):
    page.tab.select_option("#seconds", "0.5")
    page.tab.select_option("#trigger", "reversal")
    page.tab.select_option("#mode", "normal")
    served.run()
    first_s = page.until("fffoScope.held && fffoScope.event")
    assert page.js("fffoScope.view") is None
    page.until(f"fffoScope.event > {first_s}")
    page.tab.select_option("#mode", "auto")
    page.until("!!fffoScope.held")
    served.client.call("stop")  # the loop goes on without a reversal
    page.until("fffoScope.held === null && fffoScope.trigger.pending === null")


def test_a_trigger_is_set_with_keys_alone(served, page):
    choose(page, "trigger", "l")
    choose(page, "trigger-signal", "v")
    page.reach("level")
    page.tab.keyboard.type("0.5")
    choose(page, "mode", "w")
    kept = page.js("fffoScope.trigger.settings")
    assert (kept["kind"], kept["signal"], kept["level"], kept["mode"]) == ("level", "velocity_rps", 0.5, "normal")
    served.run()
    page.until("!!fffoScope.held")


def test_views_are_saved_by_name_and_as_files(served, page, tmp_path):
    served.run()
    page.see(1.0)
    page.tab.select_option("#signal", "integral_a")
    page.tab.click("#show-spectrum")
    page.tab.select_option("[data-setting=window]", "flattop")
    page.tab.click("figcaption button:has-text('reference') >> nth=0")
    page.tab.select_option("#seconds", "5")
    page.tab.select_option("#trigger", "reversal")
    focus_plot(page, "Velocity")
    page.tab.keyboard.press("PageUp")
    wanted_y = page.js("Chart.current.yRange")
    page.tab.fill("#view-name", "tuning")
    page.tab.click("#view-save")
    with page.tab.expect_download() as coming:
        page.tab.click("#view-export")
    coming.value.save_as(tmp_path / "view.json")
    content = json.loads((tmp_path / "view.json").read_text())
    assert content["view"]["signals"] == ["integral_a"]
    assert content["view"]["values"]["Velocity"] == wanted_y

    page.tab.reload()
    page.until("fffoScope.mayCommand && fffoScope.store")
    assert not page.js("'spectrum' in fffoScope.analyses")
    choose(page, "view", "t")  # with keys alone
    shows = "[[...fffoScope.own.keys()], fffoScope.analyses.spectrum?.settings.window, fffoScope.seconds]"
    assert page.js(shows) == [["integral_a"], "flattop", 5]
    assert page.js("fffoScope.trigger.settings.kind") == "reversal"
    assert page.js("document.querySelector('figure figcaption button:nth-of-type(2)').ariaPressed") == "false"
    assert page.tab.is_visible("text=values: automatic")

    page.tab.click("#view-delete")
    assert page.js("JSON.parse(localStorage['fffo-scope-views'])") == {}
    page.tab.set_input_files("#view-import", tmp_path / "view.json")
    page.until("document.querySelector('#view').value === 'tuning'")


@pytest.mark.parametrize(
    ("spoil", "refusal"),
    [
        (lambda content: "{", "no JSON"),
        (lambda content: {**content, "format": "other"}, "no saved view"),
        (lambda content: {**content, "version": 9}, "its version is 9"),
        (lambda content: {**content, "view": {**content["view"], "seconds": "x"}}, "view.seconds"),
        (lambda content: {**content, "view": {**content["view"], "signals": ["nothing_nm"]}}, "has no nothing_nm"),
    ],
)
def test_a_file_that_is_no_view_is_refused_in_words(page, tmp_path, spoil, refusal):
    page.until("fffoScope.store")
    trigger = {"kind": "none", "signal": "reference_rps", "level": 0, "edge": "rising", "mode": "single", "pre": 50}
    view = {"seconds": 5, "signals": [], "off": {}, "values": {}, "trigger": trigger, "analysis": {}}
    wrong = spoil({"format": "fffo-drive scope view", "version": 1, "name": "wrong", "view": view})
    file = tmp_path / "wrong.json"
    file.write_text(wrong if isinstance(wrong, str) else json.dumps(wrong))
    page.tab.set_input_files("#view-import", file)
    page.until(f"document.querySelector('#said').textContent.includes({json.dumps(refusal)})")


@pytest.mark.long
def test_a_spectrum_over_frequency_has_the_amplitude_of_the_sine(served, page):
    served.run()
    page.see(9.0)
    page.tab.click("#show-spectrum")
    for setting, value in (("signal", "reference_rps"), ("window", "flattop")):
        page.tab.select_option(f"[data-analysis=spectrum] [data-setting={setting}]", value)
    found = page.until("fffoScope.analyses.spectrum.found && fffoScope.analyses.spectrum.found.peaks.length")
    assert found
    page.until("document.querySelector('.readout').textContent.includes('peaks')")
    # once the motion fills the window; place and value in one call, because the page draws on
    peak = "((s) => [s.found.peaks[0][1], s.data[1][s.found.peaks[0][0]]])(fffoScope.analyses.spectrum)"
    page.until(f"Math.abs({peak}[1] - {SINE_RPS}) < {0.05 * SINE_RPS} && Math.abs({peak}[0] - {SINE_HZ}) < 0.05")
    assert "rps amplitude" in page.tab.text_content("[data-analysis=spectrum] b")
    box = plot(page, "spectrum")
    page.tab.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 40)
    assert "Hz" in page.tab.text_content("[data-analysis=spectrum] .cursors")
    page.tab.mouse.move(box["x"] + 5, box["y"] + 30)
    page.tab.mouse.down()
    page.tab.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 35, steps=4)
    page.tab.mouse.up()
    assert page.js("fffoScope.analyses.spectrum.xRange[1]") == pytest.approx(0.2 * RATE_HZ / 2, rel=0.05)
    assert page.js("fffoScope.view") is None  # the time goes on


def test_a_spectrum_over_order_and_its_peaks_with_keys_alone(served, page):
    run(served, TURNING)
    page.see(3.0)
    page.js("document.activeElement.blur()")
    page.tab.keyboard.press("s")
    page.reach("error_rps")  # of
    page.tab.keyboard.type("velocity")
    page.tab.keyboard.press("Tab")
    page.tab.keyboard.press("o")
    assert page.js("fffoScope.analyses.spectrum.settings.over") == "order"
    page.until("fffoScope.analyses.spectrum.found && fffoScope.analyses.spectrum.spec.x.unit === '/rev'")
    revolutions = "revolutions in one direction"
    page.until(f"document.querySelector('.readout').textContent.includes('{revolutions}')")
    focus_plot(page, "Spectrum")
    page.tab.keyboard.press("Space")
    page.until("!!fffoScope.taken")
    page.see(0.5)  # computed anew from what is held
    page.tab.keyboard.press("]")
    at = page.until("Chart.current.cursors.at.a")
    assert at in page.js("Chart.current.found.peaks.map(([k]) => Chart.current.data[0][k])")


def test_orders_of_an_axis_that_only_swings_are_refused_in_words(served, page):
    served.run()
    page.tab.select_option("#seconds", "1")
    page.see(1.5)
    page.tab.click("#show-spectrum")
    page.tab.select_option("[data-analysis=spectrum] [data-setting=over]", "order")
    page.until("document.querySelector('.readout').textContent.includes('orders need 2')")


@pytest.mark.long
def test_a_step_response_is_triggered_measured_and_kept(served, page):
    page.tab.select_option("#seconds", "2")
    page.tab.click("#show-step")
    run(served, STEPS)
    page.see(5.0)
    page.tab.click("text=Trigger on its middle")
    page.tab.select_option("#pre", "10")
    page.tab.select_option("#mode", "normal")
    assert page.js("fffoScope.trigger.settings.level") == pytest.approx(0.5, abs=0.05)
    page.until("fffoScope.analyses.step.last && !fffoScope.analyses.step.last.found.problem")
    found = page.js("fffoScope.analyses.step.last.found")
    assert (found["from"], found["to"]) == (pytest.approx(0.0, abs=0.01), pytest.approx(1.0, abs=0.01))
    assert 0.0 < found["rise"] < 1.0
    for words in ("rise (10–90 %)", "overshoot", "settled (±2 %)"):
        assert words in page.tab.text_content("[data-analysis=step] .readout")
    page.tab.click("text=Keep (k)")
    page.until("fffoScope.analyses.step.last !== fffoScope.analyses.step.kept")
    assert "kept: rise" in page.tab.text_content("[data-analysis=step] .readout")


def test_a_step_response_with_keys_alone(served, page):
    page.tab.keyboard.press("t")
    page.reach("seconds")
    page.tab.keyboard.type("2")
    run(served, STEPS)
    page.see(5.0)
    focus_plot(page, "Step response")
    page.tab.keyboard.press("m")
    page.until("fffoScope.analyses.step.last")
    page.tab.keyboard.press("k")
    assert page.js("fffoScope.analyses.step.kept === fffoScope.analyses.step.last")
    page.tab.keyboard.press("a")
    page.tab.keyboard.press("b")
    assert "ms" in page.tab.text_content("[data-analysis=step] .cursors")


@pytest.mark.long
def test_the_phase_of_the_feedback_against_the_reference(served, page):
    served.run()
    page.see(9.0)
    page.tab.click("#show-phase")
    page.until("fffoScope.analyses.phase.found?.lag.clear")
    assert abs(page.js("fffoScope.analyses.phase.found.lag.samples")) < 1.0  # the reference is read ahead: on time
    text = page.tab.text_content("[data-analysis=phase] .readout")
    assert "lag" in text
    assert "coherence" in text
    found = page.js("fffoScope.analyses.phase.found")
    strongest = max(range(1, len(found["cross"])), key=lambda k: found["cross"][k])
    assert found["at"][strongest] < 1.6  # of the sine at 0.5 Hz, in steps of 0.8 Hz
    page.tab.select_option("[data-analysis=phase] [data-setting=as]", "ms")
    page.until("document.querySelector('[data-analysis=phase] b').textContent.endsWith('ms of lag')")
    page.tab.select_option("[data-analysis=phase] [data-setting=response]", "set_point_rps")
    page.until("document.querySelector('[data-analysis=phase] .readout').textContent.includes('does not change')")


def test_the_phase_with_keys_alone(served, page):
    served.run()
    page.see(4.0)
    page.tab.keyboard.press("p")
    page.until("fffoScope.analyses.phase && fffoScope.analyses.phase.found")
    page.tab.keyboard.press("Space")
    focus_plot(page, "Phase")
    page.tab.keyboard.press("+")
    low, high = page.js("Chart.current.xRange")
    page.tab.keyboard.press("ArrowRight")
    assert page.js("Chart.current.xRange")[0] == pytest.approx(low + 0.25 * (high - low))
    page.tab.keyboard.press("0")
    assert page.js("Chart.current.xRange") is None
    page.tab.keyboard.press("a")
    assert "coherence" in page.tab.text_content("[data-analysis=phase] .cursors")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_with_everything_open_it_fits_a_phone_and_a_screen_reader(served, chromium, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page = Page(chromium, served, NARROW, color_scheme=scheme).open()
    served.run()
    for name in ("spectrum", "step", "phase"):
        page.tab.click(f"#show-{name}")
    page.tab.select_option("#trigger", "level")
    page.tab.keyboard.press("a")
    page.see(2.0)
    assert page.js("document.scrollingElement.scrollWidth") <= NARROW[0]
    found = axe.run(page.tab).response["violations"]
    assert [(one["id"], one["nodes"][0]["html"][:120]) for one in found if one["impact"] in SERIOUS] == []
    assert page.js("document.documentElement.outerHTML.length") < LARGEST_BYTES
    page.context.close()
    assert page.troubles == []
