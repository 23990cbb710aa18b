"""Strangers: what they are refused costs nobody anything, and the page's Stop goes out whatever they do.

The order of events on a control socket that answers as the test says; nothing is asserted about time.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct

import pytest
from daemon.rig import PATIENCE_S
from live.scope_rig import ScopeRig, hear, say
from live.scripted_daemon import NEVER, Refusal, ScriptedDaemon
from live.viewer import SERVICE_REQUEST, ServiceFailure, Viewer
from websockets.exceptions import ConnectionClosed, InvalidStatus

from fffo_drive.daemon.clients import ENDING
from fffo_drive.daemon.parameters import METHODS, Enable, Method, Start
from fffo_drive.live import listener, viewers
from fffo_drive.live import messages as m
from fffo_drive.live.peer import CALLS
from fffo_drive.live.services import MethodKind
from fffo_drive.live.viewers import CALLS_IN_ALL, REQUEST_BYTES, VIEWERS

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]


class EpochStart(Start):
    """With an epoch, as `enable` below."""

    epoch: int | None = None


class EpochEnable(Enable):
    epoch: int | None = None


EPOCHS = {
    **METHODS, "start": Method(EpochStart, "move", "run a profile"), "enable": Method(EpochEnable, "move", "torque")
}  # fmt: skip


@pytest.fixture
def scope(tmp_path):
    with ScopeRig(tmp_path, viewers=True, daemon=ScriptedDaemon(tmp_path), methods=EPOCHS) as rig:
        yield rig


def viewer_of(scope):
    viewer = Viewer(scope.server.viewers_url)
    viewer.meet(len(m.SCHEMAS), len(EPOCHS) - 2)
    return viewer


def request(viewer, name, number, body):
    """Asked without waiting for the answer."""
    head = struct.pack("<BIII", SERVICE_REQUEST, viewer.services[f"/fffo_drive/{name}"]["id"], number, 4)
    return head + b"json" + body


def hear_until_dropped(viewer):
    """The test's patience ends otherwise."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            viewer.hear()


def threads():
    return len(os.listdir("/proc/self/task"))


def stop_goes_out(scope, page, number):
    """The page's Stop is answered, and went to the daemon on the connection that is its own."""
    before = len(scope.rig.asked("disable", "quick_stop"))
    say(page, do="stop", id=number)
    assert hear(page, "answer") == {"kind": "answer", "id": number, "result": {"method": "disable", "state": "running"}}
    gone = scope.rig.asked("disable", "quick_stop")
    assert len(gone) == before + 1
    return gone[-1].connection


REFUSED = [
    *((name, b"{}") for name in (*ENDING, "enable", "toggle", "reset_fault", "record", "reload", "set", "model")),
    ("stop", b'{"key": "wrong"}'), ("stop", b'{"bogus": 1}'), ("stop", b"no json"), ("stop", b"\xff"),
    ("stop", b"[" * 5000), ("events", b'{"limit": 0}'), ("events", b'{"limit": true}'), ("info", b'{"x": 1}'),
    ("info", b'{"method": "stop"}'), ("events", b'{"limit": 1, "limit": 2}'), ("events", b'{"limit": NaN}'),
]  # fmt: skip
WITH_KEY = [
    ("stop", '"wait_s": "x"'), ("stop", '"wait_s": true'), ("stop", '"wait_s": 601'), ("stop", '"wait_s": 1e999'),
    ("start", '"profile": 3'), ("start", '"profile": {"kind": "sine"}'), ("start", '"wait_s": 1'),
    ("set", '"value": 1'), ("start", '"profile": "default", "epoch": "7"'), ("enable", '"hold": 1'),
    ("model", f'"text": "{"a" * 200_001}"'),
]  # fmt: skip


def test_what_is_refused_asks_the_daemon_nothing_and_takes_no_thread(scope):
    scope.until(lambda: len(scope.rig.asked("subscribe")) == 2)
    bodies = [*REFUSED, *((n, f'{{"key": "{scope.server.key}", {rest}}}'.encode()) for n, rest in WITH_KEY)]
    asking = [viewer_of(scope) for _ in bodies[::10]]
    before, running = list(scope.rig.lines), threads()
    for place, (name, body) in enumerate(bodies):
        with pytest.raises(ServiceFailure) as refused:
            asking[place // 10].call(f"/fffo_drive/{name}", body)
        assert "Error" not in str(refused.value)
        assert "pydantic" not in str(refused.value)
    assert scope.rig.lines == before
    assert threads() == running
    for viewer in asking:
        viewer.close()


def test_the_page_has_a_way_for_stops_that_nothing_else_takes(scope):
    page = scope.open(key=True)
    scope.rig.answers |= {"disable": {"state": "running"}, "toggle": NEVER, "enable": NEVER, "info": NEVER}
    for number in range(5):
        say(page, do="call", method="toggle", params={"to": "off"}, id=number)
    asking = [viewer_of(scope) for _ in range(3)]
    for viewer in asking:
        viewer.socket.send(request(viewer, "info", 1, b"{}"))
        viewer.socket.send(request(viewer, "enable", 2, b'{"key": "%s"}' % scope.server.key.encode()))
    scope.until(lambda: len(scope.rig.asked("toggle", "enable")) == 8)
    own = stop_goes_out(scope, page, 9)
    assert [line.method for line in scope.rig.lines if line.connection == own] == ["subscribe", "disable"]
    for viewer in asking:
        viewer.close()


@pytest.mark.parametrize("body", [b'{"bogus": 1}', b"{}"])
def test_the_stop_goes_out_while_twenty_viewers_ask_as_fast_as_they_can(scope, body):
    page = scope.open(key=True)
    scope.rig.answers["disable"] = {"state": "running"}
    hostile = [viewer_of(scope) for _ in range(20)]
    running = threads()
    for viewer in hostile:
        calls = [request(viewer, "stop", number, body) for number in range(150)]
        with contextlib.suppress(ConnectionClosed):
            for call in calls:
                viewer.socket.send(call)
    stop_goes_out(scope, page, 1)
    for viewer in hostile:
        hear_until_dropped(viewer)
        viewer.close()
    assert not scope.rig.asked("stop", "quick_stop")
    assert threads() <= running
    stop_goes_out(scope, page, 2)


def test_so_many_calls_may_wait_and_a_stop_always_passes(scope):
    scope.rig.answers["enable"] = NEVER
    key = b'{"key": "%s"}' % scope.server.key.encode()
    viewers = [viewer_of(scope) for _ in range(3)]
    for viewer in viewers[:2]:
        for number in range(CALLS):
            viewer.socket.send(request(viewer, "enable", 100 + number, key))
    in_all = CALLS_IN_ALL[MethodKind.COMMANDS]
    assert in_all == 2 * CALLS
    scope.until(lambda: len(scope.rig.asked("enable")) == in_all)
    with pytest.raises(ServiceFailure, match="your calls are pending"):
        viewers[0].call("/fffo_drive/enable", key)
    with pytest.raises(ServiceFailure, match=f"{in_all} calls of viewers are pending already"):
        viewers[2].call("/fffo_drive/enable", key)
    assert len(scope.rig.asked("enable")) == in_all
    for viewer in viewers:
        assert viewer.call("/fffo_drive/stop", key) == {}
    assert viewers[2].call("/fffo_drive/info", {})["axis"] == "bench"  # looking has a way of its own
    assert len(scope.rig.asked("stop")) == 3
    assert {line.connection for line in scope.rig.asked("stop")}.isdisjoint(
        line.connection for line in scope.rig.asked("enable", "info")
    )
    for viewer in viewers:
        viewer.close()


@pytest.mark.parametrize("which", ["page", "viewers"])
def test_half_open_connections_hold_no_place(scope, monkeypatch, which):
    monkeypatch.setattr(listener, "AT_THE_DOOR", 4)
    monkeypatch.setattr(listener, "OPEN_S", 1e9)
    inside = scope.open(key=True)
    scope.rig.answers["disable"] = {"state": "running"}
    port = scope.port if which == "page" else scope.server.wanted.viewers.port
    half_open = [socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) for _ in range(4)]
    half_open[1].sendall(b"G")  # and no more
    (scope.open if which == "page" else lambda: viewer_of(scope).close())()  # one more comes in
    assert half_open[0].recv(1) == b""  # the oldest went for it
    half_open[1].settimeout(0.0)
    with pytest.raises(BlockingIOError):
        half_open[1].recv(1)
    stop_goes_out(scope, inside, 1)
    for connection in half_open:
        connection.close()


def test_viewers_have_so_many_places_and_no_more(scope):
    looking = [viewer_of(scope) for _ in range(VIEWERS)]
    with pytest.raises(InvalidStatus) as refused:
        Viewer(scope.server.viewers_url)
    assert refused.value.response.status_code == 503
    for viewer in looking:
        viewer.close()


@pytest.mark.parametrize("what", ["pings", "long", "nonsense", "binary nonsense"])
def test_who_sends_too_much_or_nonsense_is_dropped_and_nobody_else(scope, what):
    good, bad = viewer_of(scope), viewer_of(scope)
    with contextlib.suppress(ConnectionClosed):
        for _ in range(200):
            if what == "pings":
                bad.socket.ping()
            else:
                bad.socket.send({"long": b"\x02" * 200_000, "nonsense": "x", "binary nonsense": b"\x09"}[what])
    hear_until_dropped(bad)
    assert good.call("/fffo_drive/info", {})["axis"] == "bench"
    for viewer in (good, bad):
        viewer.close()


def test_a_model_file_fits(scope):
    viewer = viewer_of(scope)
    text = "a" * 190_000
    assert viewer.call("/fffo_drive/model", {"key": scope.server.key, "text": text}) == {}
    assert scope.rig.asked("model")[0].params["text"] == text
    assert len(text) < REQUEST_BYTES
    viewer.close()


def test_epochs_are_passed_through(scope):
    viewer, page, key = viewer_of(scope), scope.open(key=True), scope.server.key
    viewer.call("/fffo_drive/start", {"key": key, "profile": "default", "epoch": 7})
    viewer.call("/fffo_drive/enable", {"key": key, "epoch": 8})
    viewer.call("/fffo_drive/enable", {"key": key})
    say(page, do="call", method="start", params={"profile": "default", "epoch": 9}, id=1)
    hear(page, "answer")
    epochs = [line.params.get("epoch") for line in scope.rig.asked("start", "enable")]
    assert epochs == [7, 8, None, 9]
    viewer.close()


def test_a_start_of_an_epoch_that_is_over_is_refused_in_the_words_of_the_daemon(scope):
    page = scope.open(key=True)
    scope.rig.answers["start"] = Refusal(-32000, "start: stopped by anna")
    say(page, do="call", method="start", params={"profile": "default", "epoch": 6}, id=1)
    assert hear(page, "answer")["error"] == "start: stopped by anna"


def test_whoever_holds_the_axis_is_heard_by_the_daemon_as_long_as_it_lives(scope):
    page, viewer = scope.open(key=True), viewer_of(scope)
    say(page, do="here")  # it does not hold anything
    say(page, do="call", method="enable", params={"hold": True}, id=1)
    hear(page, "answer")
    viewer.call("/fffo_drive/enable", {"key": scope.server.key, "hold": True})
    by_page, by_viewer = (line.connection for line in scope.rig.asked("enable"))
    assert scope.rig.signs_of_life == []
    say(page, do="here")
    scope.until(lambda: scope.rig.signs_of_life == [by_page])
    viewer.call("/fffo_drive/status", {})
    scope.until(lambda: scope.rig.signs_of_life == [by_page, by_viewer])
    viewer.close()


def test_a_stop_is_carried_out_though_its_viewer_is_gone(scope):
    viewer = viewer_of(scope)
    viewer.socket.send(request(viewer, "disable", 1, b'{"key": "%s"}' % scope.server.key.encode()))
    viewer.socket.socket.close()
    scope.until(lambda: scope.rig.asked("disable"))


def test_the_connection_of_a_viewer_that_holds_the_axis_ends_with_it(scope):
    """The daemon sees that who is in charge has gone, whoever else goes on looking and commanding."""
    holder, other, key = viewer_of(scope), viewer_of(scope), scope.server.key
    holder.call("/fffo_drive/enable", {"key": key, "hold": True})
    other.call("/fffo_drive/enable", {"key": key})
    holder.call("/fffo_drive/jog", {"key": key, "to_rps": 1.0})
    (held, enabled, jogged) = [line.connection for line in scope.rig.asked("enable", "jog")]
    assert held != enabled == jogged
    holder.close()
    scope.until(lambda: scope.rig.ended != [])
    assert scope.rig.ended == [held]
    other.call("/fffo_drive/enable", {"key": key})
    assert scope.rig.asked("enable")[-1].connection == enabled
    other.close()


def test_a_broken_way_for_stops_is_opened_again_before_it_is_needed(scope):
    def ways():
        return len({line.connection for line in scope.rig.asked("subscribe")})

    scope.until(lambda: ways() == 2)
    hub = scope.server.hub
    scope.server._loop.call_soon_threadsafe(hub.stops.close)
    scope.until(lambda: ways() == 3)
    assert hub.stops.is_open


def test_a_status_is_made_into_a_message_once(scope, monkeypatch):
    made = []
    payload = m.state_payload

    def counted(status):
        made.append(status)
        return payload(status)

    monkeypatch.setattr(viewers.m, "state_payload", counted)
    looking = [viewer_of(scope) for _ in range(5)]
    for viewer in looking:
        viewer.subscribe(m.STATE_TOPIC)
    scope.until(lambda: sum(1 for v in scope.server.hub.audience._viewers if v.subscriptions) == 5)
    status = {
        "state": "ready", "state_s": 1.0, "obstacles": [], "fault": None, "toggle": "ff", "profile": None, "loop": None,
        "model": {"name": "m"}, "drive": None, "recording": {"on": False, "trouble": ""}, "epoch": 12,
    }  # fmt: skip
    hub = scope.server.hub
    scope.server._loop.call_soon_threadsafe(hub._hear, "status", status)
    for viewer in looking:
        assert viewer.message(m.STATE_TOPIC)[1].epoch == 12
        viewer.close()
    assert made == [status]
