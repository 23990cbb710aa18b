"""What Foxglove, Lichtblick and PlotJuggler get: channels, messages that others can decode, and services with a key."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from live.ring_writer import rows_of, write
from live.scope_rig import ScopeRig
from live.viewer import ServiceFailure, Viewer
from websockets.exceptions import InvalidStatus

from fffo_drive.cli import main
from fffo_drive.live import messages as m
from fffo_drive.live.decimation import LATENESS_EDGES_US, Decimator, bin_ticks_of
from fffo_drive.recording.schema import EVENT_TOPIC
from fffo_drive.signals import SIGNALS

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]
SERVICES = {
    "info", "status", "events", "enable", "disable", "start", "jog", "velocity", "step", "stop", "quick_stop", "toggle",
    "reset_fault", "model", "set", "reload", "record",
}  # fmt: skip


@pytest.fixture(scope="module")
def scope(tmp_path_factory):
    with ScopeRig(tmp_path_factory.mktemp("viewers"), viewers=True) as rig:
        yield rig


@pytest.fixture
def viewer(scope):
    viewer = Viewer(scope.server.viewers_url)
    viewer.meet(len(m.SCHEMAS), len(SERVICES))
    yield viewer
    viewer.close()
    scope.until(lambda: scope.server.hub.feed._reader is None)  # nobody looks: nothing is read


def followed(scope):
    """The feed reads the ring from now on: rows that are written are seen."""
    scope.until(lambda: scope.server.hub.feed._reader is not None)


def test_channels_are_reported_with_schemas_that_all_viewers_read(viewer):
    assert viewer.info["name"] == "bench"
    assert set(viewer.channels) == set(m.SCHEMAS)
    for channel in viewer.channels.values():
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
    assert {name.removeprefix("/fffo_drive/") for name in viewer.services} == SERVICES


def test_bins_arrive_with_every_extreme_and_their_time(scope, viewer):
    viewer.subscribe(m.BIN_TOPIC)
    followed(scope)
    rows = rows_of(0, 400)
    write(scope.ring, rows)
    expected = Decimator(bin_ticks_of(2000.0)).feed(rows)
    times_ns = []
    for bin_ in expected:
        time_ns, message = viewer.message(m.BIN_TOPIC)
        times_ns.append(time_ns)
        for signal, (low, high, last) in zip(SIGNALS, bin_, strict=True):
            got = [getattr(message, f"{signal.name}{end}") for end in ("_min", "_max", "")]
            np.testing.assert_array_equal(got, [low, high, last])
    assert set(np.diff(times_ns)) == {20_000_000}


def test_lateness_is_counted_once_a_second(scope, viewer):
    viewer.subscribe(m.LATENESS_TOPIC)
    followed(scope)
    rows = rows_of(0, 2500)
    rows["late"][:7] = 1
    write(scope.ring, rows)
    _, message = viewer.message(m.LATENESS_TOPIC)
    assert message.ticks <= 2500
    assert message.late == 7
    classes = [f"within_{edge}_us" for edge in LATENESS_EDGES_US] + ["beyond_10000_us"]
    assert sum(getattr(message, name) for name in classes) == message.ticks > 1900


def test_state_and_events_are_reported(scope, viewer):
    viewer.subscribe(m.STATE_TOPIC, EVENT_TOPIC, m.LOG_TOPIC)
    _, state = viewer.message(m.STATE_TOPIC)
    assert (state.state, state.toggle, state.recording) == ("offline", "ff", False)
    assert math.isnan(state.profile_share)
    assert state.obstacles
    scope.rig.client().call("toggle", to="fb")
    _, event = viewer.message(EVENT_TOPIC)
    assert event.text.startswith("friction fb by ")
    _, line = viewer.message(m.LOG_TOPIC)
    assert (line.msg, line.level, line.name) == (event.text, 20, "supervisor")
    assert line.stamp.sec * 10**9 + line.stamp.nanosec == event.time_ns
    scope.rig.client().call("toggle", to="ff")


def test_all_but_looking_needs_the_key(scope, viewer):
    key = scope.server.key
    assert viewer.call("/fffo_drive/status", b"")["toggle"] == "ff"
    for wrong in ({}, {"key": ""}, {"key": "ä" * 9}, {"key": None}, {"key": key[:-1]}):
        with pytest.raises(ServiceFailure, match="toggle needs the key"):
            viewer.call("/fffo_drive/toggle", {"to": "off", **wrong})
    assert viewer.call("/fffo_drive/status", {})["toggle"] == "ff"
    assert viewer.call("/fffo_drive/toggle", {"to": "off", "key": key}) == {"toggle": "off"}
    assert viewer.call("/fffo_drive/toggle", {"to": "ff", "key": key}) == {"toggle": "ff"}
    for ending in ("stop", "disable", "quick_stop"):
        with pytest.raises(ServiceFailure, match=f"{ending} needs the key"):
            viewer.call(f"/fffo_drive/{ending}", {"wait_s": 0})
    with pytest.raises(ServiceFailure, match="offline"):
        viewer.call("/fffo_drive/enable", {"key": key})


@pytest.mark.parametrize("payload", [b"no json", b"[]", b"[" * 5000, b'{"method": "enable"}', b'{"to": 1}', b"\xff"])
def test_a_request_that_is_none_is_refused_in_words(scope, viewer, payload):
    with pytest.raises(ServiceFailure, match=r"JSON object|key"):
        viewer.call("/fffo_drive/toggle", payload)
    assert viewer.call("/fffo_drive/info", {})["axis"] == "bench"


def test_a_request_names_its_parameters(viewer):
    service = viewer.services["/fffo_drive/toggle"]
    request = service["request"]
    assert (request["encoding"], request["schemaEncoding"]) == ("json", "jsonschema")
    for word in ("key", "to", "ff", "fb", "off"):
        assert f'"{word}"' in request["schema"]
    assert '"key"' in viewer.services["/fffo_drive/disable"]["request"]["schema"]
    assert '"key"' not in viewer.services["/fffo_drive/status"]["request"]["schema"]


def test_it_listens_on_this_machine_alone(scope):
    port = f":{scope.server.wanted.viewers.port:04X}"
    listening = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    assert [words[1] for words in listening if words[1].endswith(port) and words[3] == "0A"] == [f"0100007F{port}"]
    assert not any(line.split()[1].endswith(port) for line in Path("/proc/net/tcp6").read_text().splitlines()[1:])


def test_another_protocol_is_turned_away(scope):
    with pytest.raises(InvalidStatus):
        Viewer(scope.server.viewers_url, subprotocols=["foxglove.websocket.v1"])


def test_a_viewer_that_does_not_read_holds_up_nobody(scope, viewer):
    stalled = Viewer(scope.server.viewers_url, max_queue=1)
    stalled.meet(len(m.SCHEMAS), 0)
    stalled.subscribe(m.BIN_TOPIC)
    viewer.subscribe(m.BIN_TOPIC, m.LATENESS_TOPIC)
    followed(scope)
    page = scope.open()
    tick = 0
    for _ in range(30):  # more than the sockets and the backlog hold
        write(scope.ring, rows_of(tick, 2000))
        tick += 2000
        while viewer.message(m.BIN_TOPIC)[1].tick < tick - 1:
            pass
    page.close()
    stalled.close()


def test_the_command_says_where_and_gives_the_key(scope, capsys):
    where = ["scope", "--sockets", str(scope.rig.sockets), "--viewers"]
    assert main(where) == 0
    url, key = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"ws://127\.0\.0\.1:\d+", url)
    assert key == f"key for services: {scope.server.key}"
    assert main([*where, "--watch"]) == 0
    assert scope.server.key not in capsys.readouterr().out


def test_times_are_read_as_they_are_written():
    assert m.time_ns_of("1970-01-01T00:00:01.000000002Z") == 1_000_000_002
    event = {"time": "2026-11-21T08:15:25.123456789Z", "level": "error", "kind": "fault", "text": "ä", "data": {}}
    message = m.event_of(event)
    assert (message.time, message.level) == (event["time"], 40)
