"""A stop that was acknowledged has stopped everything that was asked for before; nothing stands before a stop."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest
from daemon.rig import PATIENCE_S, Rig
from daemon.test_supervisor import stopped

from fffo_drive.daemon import clients, methods, one_client, rpc
from fffo_drive.daemon.client import CallError, DaemonClient
from fffo_drive.daemon.clients import ENDING
from fffo_drive.daemon.one_client import Budget, SocketLimits
from fffo_drive.daemon.places import CONTROL, WATCH
from fffo_drive.daemon.watch import Watcher
from fffo_drive.drive.simulated.node.objects import OVERCURRENT

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]

INLINE = {"kind": "sine", "duration_s": 10, "amplitude": 1, "frequency_hz": 0.5}


def raw(rig: Rig, name: str = CONTROL) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    sock.settimeout(PATIENCE_S)
    sock.connect(str(rig.sockets / name))
    return sock


def line_of(method: str, number: int = 1, **params: Any) -> bytes:
    return json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": params}).encode() + b"\n"


def answers(sock: socket.socket) -> Iterator[dict[str, Any]]:
    return map(json.loads, sock.makefile("rb"))


def refused(call: Callable[[], Any], *words: str) -> None:
    with pytest.raises(CallError) as error:
        call()
    assert error.value.code == rpc.REFUSED
    for word in words:
        assert word in str(error.value)


def present(rig: Rig) -> int:
    """The epoch, as somebody sees it who is about to act."""
    return int(rig.do(lambda: rig.supervisor.machine.epoch.value))


class Held:
    """Profiles that take as long to compute as a test wants."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun, self.go_on = threading.Event(), threading.Event()
        compute = methods.chosen_profile

        def held(*arguments: Any) -> Any:
            self.begun.set()
            assert self.go_on.wait(PATIENCE_S)
            return compute(*arguments)

        monkeypatch.setattr(methods, "chosen_profile", held)


def in_thread(call: Callable[[], Any]) -> Callable[[], Any]:
    """Begin a call; what comes back waits for what it returns or raises."""
    found: list[Any] = []

    def run() -> None:
        try:
            found.append(call())
        except CallError as error:
            found.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()

    def outcome() -> Any:
        thread.join(PATIENCE_S)
        if isinstance(found[0], CallError):
            raise found[0]
        return found[0]

    return outcome


@contextmanager
def standing_still(rig: Rig) -> Iterator[None]:
    """The clients' thread does nothing as long as the block lasts: what arrives stays in the sockets."""
    blocked, go_on = threading.Event(), threading.Event()

    def stand() -> None:
        blocked.set()
        assert go_on.wait(PATIENCE_S)

    rig.server.clients.post(stand)
    assert blocked.wait(PATIENCE_S)
    try:
        yield
    finally:
        go_on.set()


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with Rig(tmp_path_factory.mktemp("d"), clients=200) as found:
        found.until("ready")
        yield found


@pytest.fixture
def enabled(rig: Rig) -> Iterator[DaemonClient]:
    client = rig.client()
    client.call("enable")
    yield client
    client.call("disable")


@pytest.mark.parametrize("profile", ["default", INLINE], ids=["named", "inline"])
@pytest.mark.parametrize("ending", [["stop"], ["disable"], ["quick_stop"], ["disable", "enable"], ["stop", "stop"]])
def test_a_start_that_is_being_prepared_ends_with_a_stop(rig, enabled, monkeypatch, profile, ending):
    held, other = Held(monkeypatch), rig.client()
    outcome = in_thread(lambda: enabled.act("start", profile=profile))
    assert held.begun.wait(PATIENCE_S)
    assert other.call("status")["state"] == "preparing"
    for method in ending:
        state = other.call(method)["state"]
    held.go_on.set()
    refused(outcome, "epoch")
    status = rig.do(lambda: rig.supervisor.state.value)
    assert status == state == ("enabled" if ending[-1] in ("stop", "enable") else "ready")
    assert rig.do(lambda: rig.supervisor.profile) is None


def test_a_second_start_while_one_is_prepared_is_refused_and_the_first_one_runs(rig, enabled, monkeypatch):
    held, other = Held(monkeypatch), rig.client()
    outcome = in_thread(lambda: enabled.act("start", profile=INLINE))
    assert held.begun.wait(PATIENCE_S)
    refused(lambda: other.act("start", profile="default"), "preparing", "enabled")
    held.go_on.set()
    assert outcome()["state"] == "running"


def test_a_start_by_somebody_who_has_gone_is_not_carried_out(rig, enabled, monkeypatch):
    held = Held(monkeypatch)
    with raw(rig) as sock:
        sock.sendall(line_of("start", profile="default", epoch=present(rig)))
        assert held.begun.wait(PATIENCE_S)
    rig.until("enabled")
    held.go_on.set()
    enabled.act("start", profile={"kind": "points", "points": [[0, 0], [0.1, 0.1], [0.2, 0]]}, wait_s=30)
    assert not [event for event in rig.events("command") if event["text"].startswith("start default")]


@pytest.mark.parametrize(("method", "given"), [("start", {"profile": "default"}), ("enable", {"wait_s": 0})])
def test_what_lies_in_a_socket_when_a_stop_is_acknowledged_is_older_than_it(rig, enabled, method, given):
    epoch = {"epoch": present(rig)} if method == "start" else {}
    with raw(rig) as starter, raw(rig) as stopper:
        starter.sendall(line_of("status"))
        next(answers(starter))
        with standing_still(rig):
            stopper.sendall(line_of("disable" if method == "enable" else "stop"))
            starter.sendall(line_of(method, **given, **epoch))
        stopped, started = next(answers(stopper)), next(answers(starter))
        assert stopped["result"]["reached"]
        assert started["error"]["code"] == rpc.REFUSED
        assert rig.do(lambda: rig.supervisor.profile) is None
        # the epoch of the acknowledgement is the one in which the next request holds
        assert stopped["result"]["epoch"] == enabled.call("status")["epoch"]


def test_a_start_behind_other_requests_of_its_client_is_older_than_a_stop_that_overtook_it(rig, enabled):
    with raw(rig) as starter:
        with standing_still(rig):
            start = line_of("start", 2, profile="default", epoch=present(rig))
            starter.sendall(line_of("info", 1) * 20 + start + line_of("stop", 3))
        found = answers(starter)
        outcome = {}
        while {2, 3} - outcome.keys():
            answer = next(found)
            outcome[answer["id"]] = answer
        assert outcome[3]["result"]["state"] == "enabled"
        assert outcome[2]["error"]["code"] == rpc.REFUSED


def test_an_epoch_that_a_client_has_seen_binds_its_start(rig, enabled):
    seen = rig.client(watching=True).call("status")["epoch"]
    rig.client().call("stop")
    refused(lambda: enabled.act("start", profile="default", epoch=seen), "epoch", str(seen))
    refused(lambda: enabled.call("enable", epoch=seen), "epoch")
    now = enabled.call("status")["epoch"]
    assert now > seen
    assert enabled.act("start", profile="default", epoch=now)["state"] == "running"


def test_a_stop_overtakes_five_hundred_requests_of_its_own_client(rig):
    # short answers: all of them together are less than a client may be owed, however late it reads
    requests = b"".join(line_of("events", number, since=10**9) for number in range(500))
    with raw(rig) as sock:
        sock.sendall(requests + line_of("quick_stop", 1000))
        found = answers(sock)
        order = [next(found)["id"] for _ in range(501)]
    assert sorted(order[:-1]) != order[:-1]
    assert order.index(1000) < 250
    assert [number for number in order if number != 1000] == list(range(500))


def test_a_stop_finds_a_place_where_no_other_request_does(tmp_path):
    with Rig(tmp_path, drive=False, clients=3, retry_s=600) as rig, ExitStack() as held:
        for _ in range(3):
            held.enter_context(raw(rig)).sendall(line_of("info"))
        for method in ENDING:
            with raw(rig) as sock:
                sock.sendall(line_of("info", 1) + line_of(method, 2))
                found = answers(sock)
                refusal, answer = next(found), next(found)
            assert refusal["error"]["code"] == rpc.LIMIT
            assert "stop, disable, quick_stop" in refusal["error"]["message"]
            assert answer["result"]["state"] == "offline"
        # however many come and say nothing: the newest has a place
        silent = [held.enter_context(raw(rig)) for _ in range(clients.STOP_PLACES + 20)]
        with raw(rig) as sock:
            sock.sendall(line_of("stop", 3))
            assert next(answers(sock))["result"]["reached"]
        assert rig.server.clients.count <= 3 + clients.STOP_PLACES
        assert silent


def test_a_stop_succeeds_in_every_state_and_says_what_is(rig):
    client = rig.client()
    for method in ENDING:
        assert client.call(method)["state"] == "ready"
    client.call("enable")
    assert client.call("stop")["state"] == "enabled"
    assert rig.node is not None
    rig.node.tell(lambda node: node.drive.injected.add(OVERCURRENT))
    rig.until("fault", client)
    for method in ENDING:
        assert client.call(method)["state"] == "fault"
    rig.node.tell(lambda node: node.drive.injected.clear())
    assert client.call("reset_fault")["state"] == "ready"


def test_stops_without_a_pause_are_one_stop_for_the_supervisor_and_all_are_answered(rig, enabled):
    before = len(rig.events("command"))
    with raw(rig) as sock:
        sock.sendall(b"".join(line_of("stop", number) for number in range(1000)))
        found = answers(sock)
        assert [next(found)["id"] for _ in range(1000)] == list(range(1000))
    assert len(rig.events("command")) - before < 100


def test_a_stop_in_a_batch_ends_what_was_sent_before_it_too(rig, enabled):
    start = line_of("start", 2, profile="default", epoch=present(rig))
    batch = [json.loads(line_of("stop", 1)), json.loads(start)]
    with raw(rig) as sock:
        sock.sendall(json.dumps(batch).encode() + b"\n")
        stopped, started = next(answers(sock))
    assert stopped["result"]["state"] == "enabled"
    assert started["error"]["code"] == rpc.REFUSED


def test_a_wrong_stop_is_an_error_and_the_next_one_a_stop(rig):
    client = rig.client()
    with pytest.raises(CallError) as error:
        client.call("stop", bogus=1)
    assert error.value.code == rpc.INVALID_PARAMS
    assert client.call("stop")["reached"]
    with pytest.raises(CallError) as error:
        rig.client(watching=True).call("stop")
    assert error.value.code == rpc.READ_ONLY


def test_lines_of_those_who_watch_are_short(rig):
    with raw(rig, WATCH) as sock:
        sock.sendall(line_of("info", x="a" * one_client.WATCH_LIMITS.line_bytes))
        assert "longer than 4096 bytes" in next(answers(sock))["error"]["message"]


@pytest.mark.parametrize("line_bytes", [1, one_client.LINE_COST_BYTES, 4096])
def test_a_budget_gives_what_its_rate_gives_and_never_more_than_a_burst(line_bytes):
    limits = SocketLimits(4096, 65536, 10_000.0, 20_000.0)
    budget = Budget(limits, 0.0)
    cost = max(line_bytes, one_client.LINE_COST_BYTES)
    paid = 0
    for tick in range(1000):  # ten seconds
        while budget.take(line_bytes, tick * 0.01):
            paid += cost
    assert paid == pytest.approx(limits.burst_bytes + 9.99 * limits.bytes_per_s, abs=cost)
    assert budget.take(line_bytes, 1e6)
    paid = cost
    while budget.take(line_bytes, 1e6):
        paid += cost
    assert paid <= limits.burst_bytes


def test_who_comes_to_be_in_charge_or_goes_begins_an_epoch(rig):
    other = rig.client()
    before = other.call("status")["epoch"]
    with raw(rig) as holder:
        holder.sendall(line_of("enable", hold=True))
        assert next(answers(holder))["result"]["state"] == "enabled"
        held = other.call("status")
        assert held["held_by"] is not None
        assert held["epoch"] > before
        refused(lambda: other.act("start", profile="default", epoch=before), "epoch")
    rig.until("ready")  # the axis hung on the connection: daemon.client_loss
    assert other.call("status")["epoch"] > held["epoch"]


# -- a stop latches ----------------------------------------------------------------------------------------------------

STREAM = {"to_rps": 2.0}


class Stream:
    """A client that sends set points without a pause, on one connection or a new one each time, whatever it hears."""

    def __init__(self, rig: Rig, new_connections: bool, **given: Any) -> None:
        self._rig, self._new, self._given = rig, new_connections, given
        self._end, self.answered = threading.Event(), threading.Semaphore(0)
        self.said: list[str] = []  # why it was refused
        self.taken = 0
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        with ExitStack() as held:
            client = held.enter_context(DaemonClient(self._rig.sockets / CONTROL, PATIENCE_S))
            while not self._end.is_set():
                if self._new:
                    client.close()
                    client = held.enter_context(DaemonClient(self._rig.sockets / CONTROL, PATIENCE_S))
                try:
                    client.call("velocity", **STREAM, **self._given)
                    self.taken += 1
                except CallError as error:
                    self.said.append(str(error))
                self.answered.release()

    def __enter__(self) -> Stream:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join(PATIENCE_S)

    def answer_more(self, count: int) -> None:
        """Wait for so many answers to what it sends from now on."""
        while self.answered.acquire(blocking=False):
            pass
        for _ in range(count + 1):
            assert self.answered.acquire(timeout=PATIENCE_S)


def rests(rig: Rig, client: DaemonClient, *streams: Stream) -> None:
    """Set points went on coming, and were refused; the shaft stands still by its feedback."""
    for stream in streams:
        stream.answer_more(20)

    # the law swings out for some tenths of a second on a body without the friction of its model
    def at_rest():
        shaft = rig.supervisor.shaft  # None while a busy machine keeps the drive silent
        return shaft is not None and shaft.at_rest

    status = rig.until_status(lambda status: rig.do(at_rest), client)
    assert status["state"] == "enabled"
    assert status["motion"]["reference_rps"] == 0.0


@pytest.mark.parametrize("named", [False, True], ids=["unnamed", "named"])
@pytest.mark.parametrize("new_connections", [False, True], ids=["one connection", "a connection each"])
def test_a_stream_of_set_points_ends_with_a_stop_and_nothing_revives_it(tmp_path, new_connections, named):
    with Rig(tmp_path, clients=64) as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("enable")
        given = {"epoch": present(rig)} if named else {}
        with Stream(rig, new_connections, **given) as stream, Stream(rig, new_connections, **given) as other:
            rig.until_status(lambda status: (status["motion"] or {"velocity_rps": 0.0})["velocity_rps"] > 1.0, client)
            answer = client.call("stop", who="anna (stop)", wait_s=PATIENCE_S)
            assert stopped(answer) == "enabled"
            rests(rig, client, stream, other)
            assert "velocity: stopped by anna (stop) through pid" in stream.said[-1]
            assert f"ask again with epoch {answer['epoch']}" in stream.said[-1]
            # neither somebody else's deliberate act ...
            client.act("velocity", to_rps=0.5, for_s=0.1)
            rig.until("enabled", client)
            rests(rig, client, stream, other)
            # ... nor a stop that nobody waits for, a disable and an enable revive it
            client.act("velocity", to_rps=2.0, run_on=True)
            at_once = client.call("stop", wait_s=0)
            assert not at_once["reached"]
            rig.until("enabled", client)
            client.call("disable", wait_s=PATIENCE_S)
            client.call("enable", wait_s=PATIENCE_S)
            taken = stream.taken + other.taken
            rests(rig, client, stream, other)
            assert stream.taken + other.taken == taken


def test_the_epoch_of_an_earlier_daemon_moves_nothing(tmp_path):
    with Rig(tmp_path / "1") as rig:
        earlier = rig.client().call("status")["epoch"]
    with Rig(tmp_path / "2") as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("enable")
        assert client.call("status")["last_stop"] is None
        refused(
            lambda: client.call("velocity", **STREAM, epoch=earlier), "first one of this daemon", f"not in {earlier}"
        )
        assert (
            client.call("velocity", **STREAM)["state"] == "following"
        )  # on the first day nobody has to know of epochs


def test_no_stop_is_told_while_a_drive_that_answers_is_silent_for_a_moment(rig, enabled, monkeypatch):
    measured, gaps = Watcher.shaft, [None] * 5
    monkeypatch.setattr(Watcher, "shaft", lambda self, period_s: gaps.pop() if gaps else measured(self, period_s))
    assert enabled.call("disable", wait_s=0)["reached"] is False
    assert stopped(enabled.call("disable")) == "ready"  # at rest by measurement, in a state without torque too
    assert not gaps


def test_a_set_point_whose_client_is_silent_ends_as_by_a_stop_of_it(rig, enabled):
    with Stream(rig, False, epoch=present(rig)) as stream:  # none of them is renewed: each is a new one
        stream.answer_more(5)
        rig.until("following")
    event = rig.until_status(lambda status: (status["last_stop"] or {"kind": ""})["kind"] == "lapsed")["last_stop"]
    assert event["text"].startswith("stopped by a velocity of pid")
    rig.until("enabled")
    with Stream(rig, False, epoch=event["epoch"] - 1) as stream:  # frozen, and now goes on
        rests(rig, enabled, stream)
        assert "that was not renewed within 0.5 s" in stream.said[-1]


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"for_s": 1e-308}, "for_s: a number from 0.01 to 600"),
        ({"for_s": 0}, "for_s: a number from 0.01 to 600"),
        ({"for_s": 1, "run_on": True}, "give one of renews, for_s and run_on"),
        ({"renews": 1, "run_on": True}, "give one of renews, for_s and run_on"),
        ({"wait_s": 5}, "wait_s needs for_s or run_on"),
    ],
)
def test_how_long_a_set_point_lives_is_said_in_one_way(rig, given, word):
    with pytest.raises(CallError) as error:
        rig.client().call("velocity", to_rps=1.0, **given)
    assert error.value.code == rpc.INVALID_PARAMS
    assert str(error.value).startswith(word)


def test_a_step_for_a_time_goes_back_to_what_may_run_on_and_to_nothing_else(rig, enabled):
    enabled.act("velocity", to_rps=1.0, run_on=True, wait_s=PATIENCE_S)
    enabled.act("step", by_rps=0.5, for_s=0.1)
    rig.until_status(lambda status: status["motion"]["reference_rps"] == 1.0 and status["set_point"]["lapsed"])
    enabled.act("velocity", to_rps=1.0, for_s=60, wait_s=PATIENCE_S)
    enabled.act("step", by_rps=0.5, for_s=0.1)  # takes the place of the sixty seconds too
    rig.until("enabled")


@pytest.mark.parametrize(("silent", "word"), [(True, "which does not answer"), (False, "is gone")])
def test_whoever_holds_the_axis_has_to_be_heard(tmp_path, silent, word):
    """A client that is frozen is a connection that says nothing; one that lives says an empty line now and then."""
    with Rig(tmp_path, client_silence_s=0.5) as rig:
        holder, watcher = rig.client(), rig.client(watching=True)
        rig.until("ready", watcher)
        epoch = holder.call("enable", hold=True)["epoch"]
        holder.call("velocity", to_rps=2.0, run_on=True, epoch=epoch)
        holder.call("subscribe", status_hz=50)
        status = {"state": "", "state_s": 0.0}
        while not (status["state"] == "following" and status["state_s"] > 1.5):  # thrice the limit, and the axis turns
            status = holder.next_notification(PATIENCE_S).get("params", {"state": ""})
            status = status if "state_s" in status else {"state": "", "state_s": 0.0}
        if not silent:
            holder.close()
        rig.until("ready", watcher)
        (event,) = [event for event in rig.events("client") if "the axis" in event["text"]]
        assert word in event["text"]
        status = watcher.call("status")
        assert status["held_by"] is None
        assert status["last_stop"]["who"] == f"daemon.client_loss ({event['text'].rpartition(':')[0]})"


def test_a_stop_says_what_it_sees(rig, enabled):
    enabled.act("velocity", to_rps=2.0, run_on=True, wait_s=PATIENCE_S)
    rig.until_status(lambda status: status["motion"]["velocity_rps"] > 1.0)
    answer = enabled.call("stop", wait_s=0)
    assert (answer["reached"], answer["at_rest"]) == (False, False)
    assert answer["velocity_rps"] == pytest.approx(2.0, abs=1.0)
    assert stopped(enabled.call("stop", wait_s=PATIENCE_S)) == "enabled"


def test_who_takes_charge_while_a_start_is_prepared_ends_it(rig, enabled, monkeypatch):
    held, other = Held(monkeypatch), rig.client()
    outcome = in_thread(lambda: enabled.act("start", profile=INLINE))
    assert held.begun.wait(PATIENCE_S)
    other.call("enable", hold=True)
    held.go_on.set()
    refused(outcome, "start: taken over by pid")
    assert enabled.call("status")["state"] == "enabled"
