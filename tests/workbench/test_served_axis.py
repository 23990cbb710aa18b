"""What a page asks of the daemon that has the axis: what is sent on which connection, refused, and logged."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from live.scripted_daemon import Refusal, ScriptedDaemon

from fffo_drive.daemon.places import CONTROL, WATCH
from fffo_drive.daemon.served_run import record_served
from fffo_drive.documents import DocumentError
from fffo_drive.live.keys import Asker, Keys
from fffo_drive.live.places import TOKEN_FILE, URL_FILE
from fffo_drive.workbench.bench import AUDIT_NAME, ForbiddenError, Workbench
from fffo_drive.workbench.gain_trial import Trial, try_gain
from fffo_drive.workbench.served_axis import PAGES, PRESENCE_S, ServedAxis, scope_address
from fffo_drive.workflows.errors import DriveFaultError

pytestmark = pytest.mark.timeout(120)
CONFIGS = Path(__file__).resolve().parents[2] / "configs"
ANNA = Asker("tune", "anna")
STATUS = {"state": "enabled", "epoch": 7, "obstacles": [], "fault": None, "toggle": "ff", "profile": None,
          "recording": {"on": False}, "set_point": None}  # fmt: skip


@pytest.fixture
def daemon(tmp_path):
    with ScriptedDaemon(tmp_path) as daemon:
        (daemon.sockets / WATCH).symlink_to(daemon.sockets / CONTROL)
        yield daemon


@pytest.fixture
def bench(tmp_path, daemon):
    shutil.copytree(CONFIGS, tmp_path / "configs")
    return Workbench(tmp_path / "out", tmp_path / "configs" / "axis_canopen.yaml", None, (), daemon.sockets)


def test_a_request_says_on_whose_behalf_and_in_which_epoch(bench, daemon):
    bench.ask(ANNA, "jog", {"to_rps": 1.0, "epoch": 7})
    bench.ask(Asker("move"), "start", {"profile": "default", "epoch": 7})
    (jog,), (start,) = daemon.asked("jog"), daemon.asked("start")
    assert jog.params == {"to_rps": 1.0, "epoch": 7, "who": "anna (tune)"}
    assert start.params["who"] == "role move"
    entries = [json.loads(line) for line in (bench.directory / AUDIT_NAME).read_text().splitlines()]
    assert [(one["role"], one.get("name"), one["action"]) for one in entries] == [
        ("tune", "anna", "jog"), ("move", None, "start"),
    ]  # fmt: skip


@pytest.mark.parametrize("method", ["enable", "start", "jog", "velocity", "step"])
def test_what_moves_without_the_state_that_was_shown_is_not_asked_for(bench, daemon, method):
    with pytest.raises(DocumentError, match="does not say in which state"):
        bench.ask(ANNA, method, {"to_rps": 1.0})
    assert daemon.asked(method) == []


@pytest.mark.parametrize(
    ("role", "method"),
    [("look", "disable"), ("look", "quick_stop"), ("stop", "enable"), ("stop", "reset_fault"), ("move", "set"),
     ("move", "toggle")],
)  # fmt: skip
def test_a_role_that_may_not_asks_nothing(bench, daemon, role, method):
    with pytest.raises(ForbiddenError, match="your key does not allow it"):
        bench.ask(Asker(role), method, {"epoch": 7})
    assert daemon.asked(method) == []


def test_a_stop_needs_its_role_and_nothing_else(bench, daemon):
    daemon.answers["disable"] = {"state": "stopping"}
    assert bench.ask(Asker("stop"), "disable", {"wait_s": 0}) == {"state": "stopping"}


def test_what_the_page_has_no_business_with_is_refused(bench):
    for method in ("model", "subscribe", "nothing"):
        with pytest.raises(DocumentError, match="no method of the axis"):
            bench.ask(ANNA, method, {})


def test_the_daemons_own_words_reach_the_page(bench, daemon):
    daemon.answers["start"] = Refusal(-32000, "start is not possible in state ready")
    with pytest.raises(DocumentError, match="not possible in state ready"):
        bench.ask(ANNA, "start", {"profile": "default", "epoch": 7})


def test_renewing_a_jog_is_not_logged_each_time(bench):
    for wish in ({}, {"renews": 3}, {"renews": 4}):
        bench.ask(ANNA, "jog", {"to_rps": 1.0, "epoch": 7, **wish})
    assert len((bench.directory / AUDIT_NAME).read_text().splitlines()) == 1


def test_what_opens_the_bus_itself_waits_for_the_daemons_end_and_a_recording_asks_the_daemon(bench, daemon):
    for name in ("commission", "circle"):
        with pytest.raises(DocumentError, match="the daemon has the drive: stop the daemon first"):
            bench.act(ANNA, name, {})
    with pytest.raises(DocumentError, match="a daemon has this axis already"):
        bench.act(ANNA, "serve", {})
    job = bench.act(ANNA, "record", {"motion": "profile"})
    bench.close()
    assert f"--served --sockets {daemon.sockets} --who 'anna (tune)'" in job["line"]


def test_the_axis_hangs_on_the_page_that_enabled_it_and_on_its_connection(daemon):
    axis = ServedAxis(lambda: 0.0)
    messages = axis.messages(daemon.sockets)
    hello = next(messages)
    axis.call(daemon.sockets, ANNA, "enable", {"epoch": 7, "page": hello["page"], "wait_s": 0})
    (line,) = [line for line in daemon.lines if line.method == "enable"]
    assert line.params == {"epoch": 7, "who": "anna (tune)", "wait_s": 0, "hold": True}
    assert line.connection not in {other.connection for other in daemon.lines if other.method != "enable"}
    messages.close()
    with pytest.raises(DocumentError, match="not connected"):
        axis.call(daemon.sockets, ANNA, "enable", {"epoch": 7, "page": hello["page"]})


def test_a_page_that_says_nothing_is_taken_for_gone(daemon):
    now_s = [0.0]
    axis = ServedAxis(lambda: now_s[0])
    messages = axis.messages(daemon.sockets)
    page = next(messages)["page"]
    assert next(messages)["kind"] == "status"
    now_s[0] = PRESENCE_S - 0.1
    axis.heard(page)
    now_s[0] = 2 * PRESENCE_S
    assert list(messages) == []


def test_a_page_is_not_gone_because_the_daemon_took_long_to_greet_it(daemon):
    now_s = [0.0]

    def clock():  # of a machine that has no time for the daemon: each look at it is a minute later
        now_s[0] += 60.0
        return now_s[0]

    axis = ServedAxis(clock)
    messages = axis.messages(daemon.sockets)
    page = axis._pages[next(messages)["page"]]
    assert next(messages)["kind"] == "status"
    assert page.heard_s == now_s[0] == 120.0, "its time begins when it was greeted"
    messages.close()


def test_so_many_pages_look_and_no_more_so_that_a_stop_finds_a_connection(daemon):
    axis = ServedAxis(lambda: 0.0)
    looking = [axis.messages(daemon.sockets) for _ in range(PAGES)]
    for messages in looking:
        next(messages)
    with pytest.raises(DocumentError, match="close one of them"):
        next(axis.messages(daemon.sockets))
    looking[0].close()
    next(axis.messages(daemon.sockets))


def test_the_scope_is_shown_with_the_key_of_the_role_and_no_more(tmp_path):
    keys = Keys()
    assert scope_address(tmp_path, ANNA) == ""
    (tmp_path / URL_FILE).write_text("http://127.0.0.1:1/\n")
    (tmp_path / TOKEN_FILE).write_text(keys.last)
    assert scope_address(tmp_path, Asker("look")) == "http://127.0.0.1:1/"
    assert scope_address(tmp_path, Asker("move")) == f"http://127.0.0.1:1/#{keys.of('move')}"
    assert scope_address(tmp_path, Asker("stop", "bo")) == f"http://127.0.0.1:1/#bo:{keys.of('stop')}"


@pytest.mark.parametrize(
    ("wish", "text"),
    [
        ({}, "needs a key, a value"), ({"key": "k", "value": "x", "epoch": 7}, "needs a key, a value"),
        ({"key": "k", "value": 1.0, "by_rps": 0, "for_s": 1, "epoch": 7}, "not 0"),
        ({"key": "k", "value": 1.0, "by_rps": 1, "for_s": 0, "epoch": 7}, "above 0"),
    ],
)  # fmt: skip
def test_a_trial_that_makes_no_sense_is_not_begun(bench, daemon, wish, text):
    with pytest.raises(DocumentError, match=text):
        bench.try_gain(ANNA, wish)
    with pytest.raises(ForbiddenError):
        bench.try_gain(Asker("move"), wish)
    assert daemon.asked("step") == []


@pytest.mark.parametrize(
    ("answers", "says"),
    [
        ({"status": STATUS | {"state": "ready"}}, "enable it first"),
        ({"status": STATUS, "step": Refusal(-32000, "epoch 7 is over")}, "epoch 7 is over"),
    ],
)
def test_a_trial_that_fails_says_where_and_sets_nothing(daemon, answers, says):
    daemon.answers |= {"info": {"keys": {"k": 1.0}}, "record": {"files": []}, **answers}
    trial = Trial(1, "k", 2.0, 1.0, 0.5)
    try_gain(trial, daemon.sockets, 7, "role tune", sleep=lambda _: None)
    assert (trial.state, trial.old_value) == ("failed", 1.0)
    assert says in trial.says
    assert daemon.asked("set") == []


class Axis:
    """Answers as an axis does whose profile is over after two statuses, in the state that the test wants."""

    def __init__(self, daemon, recording, before, after):
        self.states = iter([before, before, {"state": "running"}, {"state": "running"}])
        self.after = after
        daemon.answers |= {
            "status": self.status, "record": {"files": [str(recording)]}, "enable": {"epoch": 7}, "start": {},
        }  # fmt: skip

    def status(self):
        return STATUS | next(self.states, self.after)


@pytest.fixture
def recording(tmp_path):
    file = tmp_path / "daemon.mcap"
    file.write_bytes(b"rows")
    return file


def test_a_served_run_leaves_the_axis_as_it_was_and_its_recording_where_it_is_wanted(daemon, recording, tmp_path):
    Axis(daemon, recording, {"state": "ready"}, {"state": "enabled"})
    out = tmp_path / "one.mcap"
    files = record_served(daemon.sockets, {"kind": "sine"}, "off", out, "anna (move)", sleep=lambda _: None)
    assert files == [out]
    assert out.read_bytes() == b"rows"
    asked = [line for line in daemon.lines if line.method != "status"]
    assert [line.method for line in asked] == ["toggle", "enable", "record", "start", "record", "disable", "toggle"]
    assert [line.params["to"] for line in asked if line.method in ("toggle", "record")] == ["off", "on", "off", "ff"]
    assert asked[3].params == {"profile": {"kind": "sine"}, "epoch": 7, "who": "anna (move)"}


@pytest.mark.parametrize(
    ("after", "why"),
    [({"state": "fault", "fault": {"text": "too fast", "name": "overspeed"}}, "too fast"),
     ({"state": "ready", "epoch": 8}, "somebody stopped")],
)  # fmt: skip
def test_a_served_run_that_was_ended_says_why_and_keeps_what_was_recorded(daemon, recording, tmp_path, after, why):
    Axis(daemon, recording, {"state": "enabled"}, after)
    with pytest.raises(DriveFaultError, match=why):
        record_served(daemon.sockets, "default", None, tmp_path / "one.mcap", sleep=lambda _: None)
    assert (tmp_path / "one.mcap").read_bytes() == b"rows"
    assert daemon.asked("disable", "enable") == []


def test_an_interrupt_brakes_before_anything_else(daemon, recording, tmp_path):
    Axis(daemon, recording, {"state": "ready"}, {"state": "enabled"})

    def interrupted(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_served(daemon.sockets, "default", None, tmp_path / "one.mcap", sleep=interrupted)
    methods = [line.method for line in daemon.lines if line.method != "status"]
    assert methods == ["enable", "record", "start", "stop", "record", "disable"]


def test_a_served_run_begins_only_where_the_axis_is_at_rest_or_held(daemon, tmp_path):
    daemon.answers["status"] = STATUS | {"state": "running"}
    with pytest.raises(DriveFaultError, match="in state running"):
        record_served(daemon.sockets, "default", None, tmp_path / "one.mcap")
    assert {line.method for line in daemon.lines} == {"status"}
