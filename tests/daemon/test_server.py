"""The sockets and whoever comes to them: bad lines, wrong parameters, slow, silent, many. The drive is away."""

from __future__ import annotations

import asyncio
import json
import os
import queue
import socket
import stat
import threading
import time

import pytest
from daemon.rig import PATIENCE_S, Rig
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fffo_drive.daemon import clients, one_client, rpc
from fffo_drive.daemon.client import CallError, ClientError, DaemonClient
from fffo_drive.daemon.methods import Api
from fffo_drive.daemon.parameters import METHODS
from fffo_drive.daemon.places import CONTROL, WATCH
from fffo_drive.daemon.sockets import SocketTakenError, bound, give_to
from fffo_drive.documents import DocumentError

pytestmark = [pytest.mark.realtime]


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    with Rig(tmp_path_factory.mktemp("d"), drive=False, retry_s=600) as found:
        yield found


def raw(rig: Rig, name: str = CONTROL) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    sock.settimeout(PATIENCE_S)
    sock.connect(str(rig.sockets / name))
    return sock


def request(method: str, number: int = 1, **params: object) -> dict:
    return {"jsonrpc": "2.0", "id": number, "method": method, "params": params}


def line_of(content: object) -> bytes:
    return json.dumps(content).encode() + b"\n"


def answer(sock: socket.socket) -> dict:
    return json.loads(sock.makefile("rb").readline())


def code(call) -> int:
    with pytest.raises(CallError) as error:
        call()
    return error.value.code


def connections(rig: Rig) -> int:
    return rig.do(lambda: rig.server.clients.count)


def wait_for_clients(rig: Rig, count: int) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while connections(rig) != count:
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def test_every_method_has_its_handler_and_nothing_else_has_one():
    assert all(callable(getattr(Api, name)) for name in METHODS)
    assert {name for name, method in METHODS.items() if method.watching} == {
        "info", "status", "events", "subscribe", "schema",
    }  # fmt: skip


def test_the_sockets_have_their_modes(rig):
    assert stat.S_IMODE(os.stat(rig.sockets / CONTROL).st_mode) == 0o660
    assert stat.S_IMODE(os.stat(rig.sockets / WATCH).st_mode) == 0o666


def test_each_mistake_of_a_client_has_its_error_and_the_connection_goes_on(rig):
    client = rig.client()
    assert code(lambda: client.call("no_such_method")) == rpc.METHOD_NOT_FOUND
    assert code(lambda: client.call("toggle")) == rpc.INVALID_PARAMS
    assert code(lambda: client.call("toggle", to="sideways")) == rpc.INVALID_PARAMS
    assert code(lambda: client.call("status", verbose=True)) == rpc.INVALID_PARAMS
    assert code(lambda: client.call("subscribe", status_hz=1e6)) == rpc.INVALID_PARAMS
    assert code(lambda: client.call("enable", hold="long")) == rpc.INVALID_PARAMS
    assert code(lambda: client.call("enable")) == rpc.REFUSED
    assert code(lambda: client.act("start", profile="no such")) == rpc.REFUSED
    assert code(lambda: client.act("start", profile={"kind": "sine"})) == rpc.INVALID_PARAMS
    assert code(lambda: client.call("set", key="loop.rate_hz", value=1)) == rpc.BAD_DOCUMENT
    assert code(lambda: client.call("model", text="{")) == rpc.BAD_DOCUMENT
    with pytest.raises(CallError) as error:
        client.call("toggle", to="sideways", extra=1)
    assert len(error.value.data["errors"]) == 2  # all at once
    assert client.call("status")["state"] == "offline"


def test_the_watching_socket_only_watches(rig):
    client = rig.client(watching=True)
    for name, method in METHODS.items():
        if not method.watching:
            assert code(lambda name=name: client.call(name)) == rpc.READ_ONLY
    assert client.call("status")["state"] == "offline"
    assert client.call("schema")["start"]["parameters"]["properties"]["profile"]


def test_a_batch_is_answered_in_one_line_and_notifications_not_at_all(rig):
    with raw(rig) as sock:
        request = {"jsonrpc": "2.0", "method": "status"}
        sock.sendall(
            json.dumps([{**request, "id": 1}, request, {**request, "id": 2, "method": "x"}, 7]).encode() + b"\n"
        )
        answers = answer(sock)
        assert {item["id"]: "result" in item for item in answers} == {1: True, 2: False, None: False}
        sock.sendall(
            json.dumps([request, request]).encode() + b"\n" + json.dumps({**request, "id": 3}).encode() + b"\n"
        )
        assert answer(sock)["id"] == 3  # nothing came for the batch of notifications


def test_lines_that_come_in_pieces_and_several_at_once(rig):
    line = b'{"jsonrpc": "2.0", "id": 1, "method": "info"}\n'
    with raw(rig) as sock:
        for byte in line:
            sock.sendall(bytes([byte]))
        assert answer(sock)["result"]["protocol"] == 1
    with raw(rig) as sock:
        sock.sendall(line * 20 + b"\n \n")
        file = sock.makefile("rb")
        assert all(json.loads(file.readline())["result"] for _ in range(20))


def test_a_client_that_ends_its_side_is_still_answered(rig):
    with raw(rig) as sock:
        sock.sendall(b'{"jsonrpc": "2.0", "id": 1, "method": "info"}\n')
        sock.shutdown(socket.SHUT_WR)
        data = b"".join(iter(lambda: sock.recv(65536), b""))
    assert json.loads(data)["id"] == 1


def test_a_line_without_an_end_is_cut_off_with_a_message(rig):
    with raw(rig) as sock:
        try:
            for _ in range(64):
                sock.sendall(b"x" * (one_client.CONTROL_LIMITS.line_bytes // 16))
        except OSError:
            pass
        said = answer(sock)
        assert said["error"]["code"] == rpc.LIMIT
        assert "longer" in said["error"]["message"]


def test_a_client_that_does_not_read_is_cut_off_and_the_others_are_not(rig):
    before = connections(rig)
    slow, other = raw(rig, WATCH), rig.client()
    slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    slow.sendall(b'{"jsonrpc": "2.0", "id": 1, "method": "subscribe", "params": {"events": true}}\n')
    assert answer(slow)["result"]["events"]

    def flood() -> None:
        for _ in range(50):
            rig.supervisor.log.add("command", "x" * 10_000)

    def cut_off() -> bool:
        return any("too slow" in event["text"] for event in rig.do(lambda: rig.supervisor.log.since(0, 1000)))

    deadline_s = time.monotonic() + PATIENCE_S
    while not cut_off() or connections(rig) > before + 1:
        rig.do(flood)
        assert time.monotonic() < deadline_s
        assert other.call("status")["state"] == "offline"
    slow.close()


def test_a_line_that_is_never_ended_and_a_client_that_says_nothing_are_cut_off(rig):
    with raw(rig) as sock, raw(rig) as idle, raw(rig, WATCH) as listening:
        listening.sendall(b'{"jsonrpc": "2.0", "id": 1, "method": "subscribe"}\n')
        answer(listening)
        sock.sendall(b'{"jsonrpc": "2.0"')
        later_s = time.monotonic() + clients.IDLE_S + clients.PARTIAL_S
        rig.server.clients.post(lambda: rig.server.clients.tidy(later_s))
        assert "ended" in answer(sock)["error"]["message"]
        assert "silent" in answer(idle)["error"]["message"]
        listening.sendall(b'{"jsonrpc": "2.0", "id": 2, "method": "info"}\n')
        found = (json.loads(line) for line in listening.makefile("rb"))
        assert next(message for message in found if message.get("id") == 2)["result"]


def test_a_client_that_was_cut_off_says_why_at_its_next_call(rig):
    client = rig.client()
    client.call("status")
    with raw(rig) as witness:  # its end comes after the client's
        rig.server.clients.post(lambda: rig.server.clients.tidy(time.monotonic() + clients.IDLE_S + clients.PARTIAL_S))
        assert "silent" in answer(witness)["error"]["message"]
    with pytest.raises(ClientError, match="silent for 300 s"):
        client.call("status")


def test_more_clients_than_allowed_are_told_so(tmp_path):
    with Rig(tmp_path, drive=False, clients=3, retry_s=600) as rig:
        for _ in range(3):
            rig.client().call("status")
        with raw(rig) as sock:
            assert "3 clients" in answer(sock)["error"]["message"]
        rig.client(watching=True).call("status")  # each socket has its own


def test_a_subscriber_hears_statuses_and_events(rig):
    client = rig.client(watching=True)
    client.call("subscribe", status_hz=50, events=True)
    rig.do(lambda: rig.supervisor.log.add("command", "hello"))
    heard = {}
    while set(heard) != {"status", "event"}:
        message = client.next_notification(PATIENCE_S)
        if message["method"] == "status" or message["params"]["text"] == "hello":
            heard[message["method"]] = message["params"]
    assert heard["status"]["state"] == "offline"
    assert heard["event"]["number"] > 0


def test_a_flood_is_read_slowly_and_everybody_else_is_served(rig):
    """Twenty clients that ask without a pause; what they get is bounded by the rate, and another one is answered."""
    stop = threading.Event()
    line = b'{"jsonrpc": "2.0", "id": 1, "method": "status"}\n'

    def hammer() -> None:
        with raw(rig, WATCH) as sock:
            file = sock.makefile("rb")
            while not stop.is_set():
                sock.sendall(line)
                file.readline()

    threads = [threading.Thread(target=hammer, daemon=True) for _ in range(20)]
    for thread in threads:
        thread.start()
    try:
        client = rig.client()
        assert all(client.call("info")["protocol"] == 1 for _ in range(5))
    finally:
        stop.set()
        for thread in threads:
            thread.join(PATIENCE_S)


LINES = st.binary(min_size=1, max_size=200).filter(lambda line: b"\n" not in line and line.strip())


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.binary(min_size=1, max_size=200).filter(lambda line: b"\n" not in line and line.strip()), max_size=5)
)
def test_whatever_bytes_come_the_next_request_is_answered(rig, lines):
    with raw(rig, WATCH) as sock:
        sock.sendall(b"\n".join([*lines, b'{"jsonrpc": "2.0", "id": "last", "method": "info"}']) + b"\n")
        for reply in sock.makefile("rb"):
            message = json.loads(reply)
            if isinstance(message, dict) and message.get("id") == "last":
                return
    raise AssertionError("no answer")


def test_a_batch_of_a_client_that_is_gone_at_once_leaves_no_stop_behind(rig, monkeypatch):
    """Its jog is cancelled before its first step; the stop in front of it is answered all the same."""
    stands, go_on, gone, left = threading.Event(), threading.Event(), threading.Event(), rig.server.left

    def tell(client: one_client.Client) -> None:
        left(client)
        if client.calls:
            gone.set()

    monkeypatch.setattr(rig.server, "left", tell)
    rig._loop.call_soon_threadsafe(lambda: (stands.set(), go_on.wait(PATIENCE_S)))
    assert stands.wait(PATIENCE_S)
    with raw(rig) as sock:
        sock.sendall(line_of([request("stop"), request("jog", to_rps=1.0)]))
    assert gone.wait(PATIENCE_S)
    go_on.set()
    deadline_s = time.monotonic() + PATIENCE_S
    while rig.server._epoch.stopping:  # its answer ends the epoch, also that of a jog read just before it
        assert time.monotonic() < deadline_s, "the stop of the client that is gone is never answered"
    with pytest.raises(CallError, match="offline"):
        rig.client().act("jog", to_rps=1.0)


def test_stops_that_differ_do_not_become_a_flood_for_the_supervisor(rig, monkeypatch):
    count, go_on = 100, asyncio.Event()

    async def stop(wanted, caller):
        await go_on.wait()
        return {"state": "enabled", "reached": True}

    monkeypatch.setattr(rig.api, "stop", stop)
    lines = [line_of(request("stop", number, wait_s=10 + number / count)) for number in range(count)]
    with raw(rig) as sock:
        sock.sendall(b"".join(lines))
        while waiting_calls(rig) < count:
            pass
        assert rig.do(lambda: len(rig.server._tasks)) == clients.WAITING_CALLS
        rig.do(go_on.set)
        file = sock.makefile("rb")
        found = [json.loads(file.readline()) for _ in range(count)]
    assert {one["id"] for one in found} == set(range(count))
    assert all(one["result"]["reached"] for one in found)
    assert not rig.server._stops


def waiting_calls(rig: Rig) -> int:
    """Lines that are not answered yet, counted on the thread that they belong to."""
    found: queue.SimpleQueue[int] = queue.SimpleQueue()
    served = rig.server.clients
    served.post(lambda: found.put(sum(client.calls for client in served._clients.values())))
    return found.get(timeout=PATIENCE_S)


def test_a_socket_that_a_dead_process_left_is_replaced_and_a_living_one_is_not(tmp_path):
    path = tmp_path / "s"
    bound(path, 0o600).close()
    with bound(path, 0o660) as again:
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
        with pytest.raises(SocketTakenError, match="another daemon"):
            bound(path, 0o660)
        assert again.fileno() >= 0


def test_a_file_in_the_place_of_a_socket_is_left_alone(tmp_path):
    path = tmp_path / CONTROL
    path.write_text("important")
    with pytest.raises(OSError, match="move it away"):
        bound(path, 0o660)
    assert path.read_text() == "important"


def test_a_path_that_is_too_long_for_a_socket_is_reported_as_such(tmp_path):
    directory = tmp_path / ("a" * 100)
    directory.mkdir()
    with pytest.raises(OSError, match=r"control socket: .*too long"):
        bound(directory / CONTROL, 0o660)
    with pytest.raises(ClientError, match=r"no daemon answers \(.*too long\)"):
        DaemonClient(directory / CONTROL)


def test_a_group_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(DocumentError, match="no group 'nobody-has-this'"):
        give_to(tmp_path, "nobody-has-this")


def test_a_client_without_a_daemon_is_told_what_to_do(tmp_path):
    with pytest.raises(ClientError, match="fffo-drive serve"):
        DaemonClient(tmp_path / CONTROL)
