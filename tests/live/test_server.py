"""Who may look, who may command (with the key, a stop too), and what becomes of clients that stall or mean harm."""

from __future__ import annotations

import contextlib
import http.client
import re
import socket
import stat
import threading

import pytest
from daemon.rig import PATIENCE_S
from live.ring_writer import rows_of, write
from live.scope_rig import ScopeRig, hear, say
from pydantic import ValidationError
from websockets.exceptions import ConnectionClosed, InvalidStatus

from fffo_drive.cli import main
from fffo_drive.config.address import Address, address_of
from fffo_drive.config.sections import DaemonSection
from fffo_drive.live import client as client_module
from fffo_drive.live import peer as peer_module
from fffo_drive.live.page import page
from fffo_drive.live.web import PAGES

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    with ScopeRig(tmp_path_factory.mktemp("scope")) as rig:
        yield rig


@pytest.fixture
def scope(served):
    yield served
    served.leave()


def get(scope, path="/", host=None):
    connection = http.client.HTTPConnection("127.0.0.1", scope.port, timeout=30)
    connection.request("GET", path, headers={"Host": host or f"127.0.0.1:{scope.port}"})
    response = connection.getresponse()
    body = response.read().decode()
    connection.close()
    return response, body


def test_the_page_is_whole_and_may_load_nothing_else(scope):
    response, body = get(scope)
    assert response.status == 200
    assert body == page()
    policy = response.getheader("Content-Security-Policy")
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert not re.search(r"(src|href)\s*=\s*[\"']?(https?:)?//", body)
    assert "{{" not in body.split("<body")[1].split("<script")[0]
    assert get(scope, "/etc/passwd")[0].status == 404


def test_a_name_that_is_not_ours_gets_nothing(scope):
    port = scope.port
    assert get(scope, host=f"localhost:{port}")[0].status == 200
    assert get(scope, host=f"evil.example:{port}")[0].status == 421
    assert get(scope, host="127.0.0.1")[0].status == 421


@pytest.mark.parametrize(
    "origin", [None, "null", "http://evil.example", "https://127.0.0.1:{port}", "http://localhost"]
)
def test_a_page_of_somebody_else_may_not_even_look(scope, origin):
    wrong = origin and origin.format(port=scope.port)
    with pytest.raises(InvalidStatus) as refused:
        scope.open(origin=wrong)
    assert refused.value.response.status_code == 403


def test_rows_come_decimated_and_a_capture_is_exact(scope):
    page = scope.open()
    scope.until(lambda: scope.server.hub.feed._reader is not None)
    rows = rows_of(0, 800)
    write(scope.ring, rows)
    bins = ticks = 0
    while ticks < 800:
        frame = hear(page, "rows")
        assert frame["lost"] == 0
        bins, ticks = bins + frame["bins"], ticks + frame["ticks"]
        assert sum(frame["lateness"]) == frame["ticks"]
    assert bins == 20
    say(page, do="capture", seconds=0.3)
    taken, total = b"", 1
    while len(taken) < total * rows.dtype.itemsize:
        part = hear(page, "capture")
        taken, total = taken + part["payload"], part["total"]
    assert taken == rows[-600:].tobytes()


def test_commands_need_the_token_and_go_through_the_control_api(scope):
    page = scope.open()
    toggle = {"do": "call", "method": "toggle", "params": {"to": "off"}}
    say(page, **toggle, id=1)
    assert "may only look" in hear(page, "answer")["error"]
    say(page, do="token", token="wrong")
    assert hear(page, "rights")["role"] == "look"
    say(page, do="token", token=scope.server.key)
    assert hear(page, "rights")["role"] == "tune"
    say(page, **toggle, id=2)
    answer = hear(page, "answer")
    assert answer["id"] == 2
    assert answer["result"] == {"toggle": "off"}
    assert scope.rig.client().call("status")["toggle"] == "off"
    assert any("friction off" in event["text"] for event in scope.rig.events("parameters"))
    say(page, do="call", method="model", params={"text": "x"}, id=3)
    assert "not a command of the scope" in hear(page, "answer")["error"]
    say(page, do="call", method="enable", params={}, id=4)
    assert hear(page, "answer")["error"]  # no drive: the daemon's own words
    assert hear(page, "status")["status"]["state"] == "offline"


def test_a_stop_is_carried_out_though_its_page_is_gone(scope, monkeypatch):
    asked, disable = threading.Event(), scope.rig.api.disable

    def heard(wanted, caller):
        asked.set()
        return disable(wanted, caller)

    monkeypatch.setattr(scope.rig.api, "disable", heard)
    page = scope.open(key=True)
    say(page, do="stop", id=1)
    page.socket.close()
    assert asked.wait(PATIENCE_S)


def test_a_stop_needs_the_key_and_nothing_else(scope):
    page = scope.open()
    for number, what in enumerate(("stop", "stop", "call")):
        say(page, do=what, method="disable", id=number)
        assert "fffo-drive scope" in hear(page, "answer")["error"]
    say(page, do="token", token=scope.server.key)
    say(page, do="stop", id=9)
    answer = hear(page, "answer")
    assert answer["id"] == 9
    assert "offline" in answer.get("error", answer.get("result", {}).get("state", ""))


def test_a_token_cannot_be_guessed_in_peace(scope):
    page = scope.open()
    for number in range(client_module.WRONG_KEYS - 1):
        say(page, do="token", token=str(number))
        assert hear(page, "rights")["role"] == "look"
    say(page, do="token", token="last")
    with pytest.raises(ConnectionClosed):
        hear(page, "never")


@pytest.mark.parametrize(
    "message",
    [
        "no json",
        "[]",
        "1",
        '{"do": "dance"}',
        '{"do": "capture", "seconds": 1e9}',
        '{"do": "capture", "seconds": 1, "signals": "tick"}',
        '{"do": "capture", "seconds": 1, "signals": ["bogus"]}',
        '{"do": "capture", "seconds": 1, "signals": ["tick", "tick"]}',
        "[" * 4000,
        b"bytes",
    ],
)
def test_who_talks_nonsense_is_dropped_and_nobody_else(scope, message):
    good, bad = scope.open(), scope.open()
    bad.send(message)
    with pytest.raises(ConnectionClosed):
        hear(bad, "never")
    assert hear(good, "status")


def test_who_sends_too_much_is_dropped(scope):
    good, loud, wide = scope.open(), scope.open(), scope.open()
    for harmful, messages in ((wide, ["x" * 100_000]), (loud, ['{"do": "stop"}'] * 200)):
        with contextlib.suppress(ConnectionClosed):
            for message in messages:
                harmful.send(message)
        with pytest.raises(ConnectionClosed):
            hear(harmful, "never")
    assert hear(good, "status")


def test_a_client_that_does_not_read_is_dropped_and_disturbs_nobody(tmp_path, monkeypatch):
    monkeypatch.setattr(peer_module, "STALL_S", 1.0)
    with ScopeRig(tmp_path, ring_rows=32768) as scope:
        small = socket.socket()
        small.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # the kernel takes nothing in its place
        small.connect(("127.0.0.1", scope.port))
        good = scope.open(key=True, max_queue=None)  # it reads also while this test waits for the other
        stalled = scope.open(sock=small, max_queue=1)
        scope.until(lambda: scope.server.hub.feed._reader is not None)
        write(scope.ring, rows_of(0, 20_000))
        hear(good, "rows")
        say(stalled, do="capture", seconds=10)  # more megabytes than the sender's kernel takes
        scope.until(lambda: len(scope.server.hub.clients) == 1)
        write(scope.ring, rows_of(20_000, 200))
        assert hear(good, "rows")["lost"] == 0
        say(good, do="stop", id=1)
        assert hear(good, "answer")["id"] == 1


def test_there_are_so_many_places_and_no_more(scope):
    pages = [scope.open() for _ in range(PAGES)]
    with pytest.raises(InvalidStatus) as refused:
        scope.open()
    assert refused.value.response.status_code == 503
    pages[0].close()
    scope.until(lambda: len(scope.server.hub.clients) < PAGES)
    scope.open()


def test_who_shows_the_key_takes_the_place_of_one_who_did_not(scope):
    with_key = scope.open(key=True)
    looking = [scope.open() for _ in range(PAGES - 1)]
    another = scope.open(key=True)
    with pytest.raises(ConnectionClosed):
        hear(looking[0], "never")
    for staying in (with_key, *looking[1:], another):
        assert hear(staying, "status")
    for _ in range(PAGES - 2):
        scope.open(key=True)
    with pytest.raises(InvalidStatus) as refused:
        scope.open(key=True)  # all have it
    assert refused.value.response.status_code == 503


def test_the_ring_is_left_alone_when_the_last_page_goes(scope):
    scope.open().close()
    scope.until(lambda: not scope.server.hub.clients and scope.server.hub.feed._reader is None)


def test_the_command_says_where_the_page_is(served, capsys):
    sockets = served.rig.sockets
    key, control = (sockets / "scope.token").stat(), (sockets / "control.sock").stat()
    assert stat.S_IMODE(key.st_mode) == 0o640  # for those who may command anyway
    assert key.st_gid == control.st_gid
    assert main(["scope", "--sockets", str(sockets)]) == 0
    assert capsys.readouterr().out.strip() == f"{served.server.url}#{served.server.key}"
    assert main(["scope", "--sockets", str(sockets), "--watch"]) == 0
    assert capsys.readouterr().out.strip() == served.server.url
    assert main(["scope", "--sockets", str(sockets), "--viewers"]) == 69
    assert "--foxglove PORT" in capsys.readouterr().err
    assert main(["scope", "--sockets", str(sockets / "none")]) == 69
    assert "--scope PORT" in capsys.readouterr().err


def test_addresses():
    assert address_of("8700") == Address("127.0.0.1", 8700)
    assert address_of("[::1]:8700").names == ("[::1]:8700",)
    assert address_of("rig.lan:80").names == ("rig.lan:80",)
    for wrong in ("x", "0.0.0.0:80", "[::]:80", ":80", "1:99999"):
        with pytest.raises(ValueError):
            address_of(wrong)


def test_addresses_are_keys_of_the_axis_file():
    section = DaemonSection.model_validate({"scope": 8700, "foxglove": "192.0.2.7:8765"})
    assert (section.scope, section.foxglove) == ("8700", "192.0.2.7:8765")
    assert DaemonSection().scope is DaemonSection().foxglove is None
    for wrong in (70000, True, 1.5, "here", "0.0.0.0:80", ":80"):
        with pytest.raises(ValidationError, match=r"PORT|address"):
            DaemonSection.model_validate({"scope": wrong})
    known = DaemonSection.model_json_schema()["properties"]["scope"]["anyOf"]
    assert {"type": "null"} in known
    assert any("integer" in str(kind) for kind in known)
