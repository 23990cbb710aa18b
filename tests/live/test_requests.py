"""Requests that no browser sends, to the scope and to the viewers' service: an answer or a closed connection."""

from __future__ import annotations

import http.client

import pytest
from hypothesis import HealthCheck, given, settings
from live.raw_requests import ANSWER_S, answered, is_clean, raw_bytes, requests
from live.scope_rig import ScopeRig
from live.scripted_daemon import ScriptedDaemon

pytestmark = [pytest.mark.slow, pytest.mark.realtime]
NAMES = requests(1, "")


@pytest.fixture(scope="module")
def ports(tmp_path_factory):
    directory = tmp_path_factory.mktemp("scope")
    with ScopeRig(directory, viewers=True, daemon=ScriptedDaemon(directory)) as rig:
        yield rig.port, rig.server.wanted.viewers.port


def looked(port, path="/"):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=ANSWER_S)
    connection.request("GET", path)
    answer = connection.getresponse()
    connection.close()
    return answer


@pytest.mark.parametrize("name", NAMES)
def test_a_request_that_no_browser_sends_has_its_answer(ports, capfd, name):
    for port in ports:
        answer = answered(port, requests(port, "")[name])
        assert is_clean(answer)
        assert answer[9:12] != b"500"
        assert looked(port).status < 500
    assert capfd.readouterr() == ("", "")


@given(raw_bytes(1, ""))
@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_have_an_answer_or_a_closed_connection(ports, capfd, sent):
    for port in ports:
        assert is_clean(answered(port, sent.replace(b"127.0.0.1:1", f"127.0.0.1:{port}".encode())))
        assert looked(port).status < 500
    assert capfd.readouterr() == ("", "")


def test_every_answer_of_the_scope_has_the_policy_of_its_page(ports):
    for path, status in (("/", 200), ("/none", 404), ("/live", 403), ("//[", 400)):
        answer = looked(ports[0], path)
        assert answer.status == status
        assert answer.getheader("Content-Security-Policy").startswith("default-src 'none'")
        assert answer.getheader("X-Content-Type-Options") == "nosniff"
