"""Requests that no browser sends: each has an answer or a closed connection, none costs a traceback or others' turn."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket

import pytest
from hypothesis import HealthCheck, given, settings
from live.raw_requests import ANSWER_S, answered, is_clean, raw_bytes, requests

from fffo_drive.workbench import server as server_module
from fffo_drive.workbench.bench import Workbench
from fffo_drive.workbench.server import MOST_WAITING, WorkbenchServer

KEY_OF_NOBODY = "guess"
NAMES = requests(1, KEY_OF_NOBODY)
STATUS = {
    "a length that is no number": 400,
    "a length below zero": 400,
    "a length of a hundred digits": 400,
    "a length of 5000 digits": 400,
    "a length in other digits": 400,
    "two lengths": 400,
    "no length": 411,
    "a body in chunks": 411,
    "a body that is deep": 400,
    "a body that is no UTF-8": 400,
    "a body with a number of 5000 digits": 400,
    "a body with a key twice": 400,
    "a file whose name no file may have": 400,
    "a file with a NUL in its name": 400,
    "a body behind a request to look": 200,
    "a NUL in a path": 400,
    "an encoded NUL in a path": 400,
    "a path out of the directory": 404,
    "a name that no file may have": 404,
    "a name that is no UTF-8": 404,
    "an address that is none": 400,
    "another address that is none": 404,
    "a path of 100 kB": 414,
    "a header of 100 kB": 431,
    "200 headers": 431,
    "two hosts": 421,
    "no version": 400,
    "a version that is none": 400,
    "HTTP/2": 505,
    "an unknown method": 501,
    "a proxy's method": 501,
    "TLS": 400,
    "an upgrade that is none": 404,
}


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    server = WorkbenchServer(Workbench(tmp_path_factory.mktemp("bench") / "out", None, None, ()))
    server.start()
    yield server
    server.close()


def place_of(served):
    return served._server.server_address[1], served.bench.keys.of("tune")


def is_alive(served):
    port, key = place_of(served)
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=ANSWER_S)
    connection.request("GET", f"/{key}/state")
    content = json.loads(connection.getresponse().read())
    connection.close()
    return content["role"] == "tune" and content["jobs"] == []


@pytest.mark.parametrize("name", NAMES)
def test_a_request_that_no_browser_sends_has_its_answer(served, capfd, name):
    port, key = place_of(served)
    answer = answered(port, requests(port, key)[name])
    if name in STATUS:
        head, _, body = answer.partition(b"\r\n\r\n")
        assert int(head.split()[1]) == STATUS[name]
        assert b"default-src 'none'" in head
        assert head.count(b"HTTP/1.1 ") + body.count(b"HTTP/1.1 ") == 1, "what follows is no request"
        assert STATUS[name] == 200 or json.loads(body)["error"]
    else:
        assert answer == b""
    assert answered(port, requests(port, KEY_OF_NOBODY)[name])[9:12] != b"200"
    assert is_alive(served)
    assert capfd.readouterr() == ("", "")


@given(raw_bytes(1, "KEY"))
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_have_an_answer_or_a_closed_connection(served, capfd, sent):
    port, key = place_of(served)
    answer = answered(port, sent.replace(b"127.0.0.1:1", f"127.0.0.1:{port}".encode()).replace(b"KEY", key.encode()))
    assert is_clean(answer)
    assert capfd.readouterr() == ("", "")
    assert is_alive(served)


def test_a_head_without_a_body_has_the_length_of_the_page(served):
    port, key = place_of(served)
    head, _, body = answered(port, f"HEAD /{key}/ HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode()).partition(
        b"\r\n\r\n"
    )
    assert b"Content-Length: " in head
    assert body == b""


HALF = {
    "nothing": "",
    "half a line": "GET /",
    "half a head": "GET /{key}/state HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n",
    "half a body": "POST /{key}/record HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\n"
    "Content-Length: 100\r\n\r\n{{",
}


@pytest.mark.parametrize("name", HALF)
def test_half_a_request_is_ended(served, monkeypatch, name):
    port, key = place_of(served)
    monkeypatch.setattr(server_module, "REQUEST_S", 0.0)
    monkeypatch.setattr(server_module._Handler, "_patience_s", 0.0)
    monkeypatch.setattr(server_module, "LEAST_BYTES_PER_S", 1e9)
    with socket.create_connection(("127.0.0.1", port), timeout=ANSWER_S) as connection:
        connection.sendall(HALF[name].format(port=port, key=key).encode())
        with connection.makefile("rb") as answer:
            assert is_clean(answer.read())
    monkeypatch.undo()
    assert is_alive(served)


def test_half_requests_keep_nobody_out_and_the_first_of_too_many_ends(served):
    port, _ = place_of(served)
    with contextlib.ExitStack() as stack:
        half = [stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=ANSWER_S)) for _ in range(50)]
        for connection in half:
            connection.sendall(b"GET / HTTP/1.1\r\nHost: ")
        assert is_alive(served)
        for _ in range(MOST_WAITING):
            more = stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=ANSWER_S))
            more.sendall(b"GET / HTTP/1.1\r\nHost: ")
        assert half[0].recv(1) in (b"", b"H")  # cut off, perhaps with a word
        assert is_alive(served)


def test_a_written_page_runs_its_own_scripts_and_reaches_nothing(served):
    port, key = place_of(served)
    page = served.bench.directory / "page.html"
    page.write_text("<script>draw()</script><script type='application/json'>{}</script>")
    answer = answered(
        port, f"GET /{key}/files/page.html HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n".encode()
    )
    policy = next(line for line in answer.decode().splitlines() if line.startswith("Content-Security-Policy: "))
    assert "default-src 'none'" in policy
    assert policy.count("'sha256-") == 1
    assert "sandbox allow-scripts" in policy
    assert "allow-same-origin" not in policy
    assert "connect-src" not in policy
