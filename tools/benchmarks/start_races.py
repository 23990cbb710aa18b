"""Races of a start with what ends it a moment later, on every way on which somebody can ask for them."""

from __future__ import annotations

import contextlib
import io
import json
import random
import threading
import time
from collections import Counter
from typing import Any

from common import shown
from daemon import PATIENCE_S, until
from hostile_clients import ViewerCalls
from live import Streaming
from shaft_on_bus import ShaftOnBus
from stops import patiently

from fffo_drive.cli import main as command
from fffo_drive.daemon.client import CallError, DaemonClient
from fffo_drive.live.places import TOKEN_FILE, URL_FILE, VIEWERS_FILE

LONGEST_DELAY_S = 0.1  # from a start to what ends it
STANDSTILL_RPS, WATCHED_S = 0.05, 0.1
LONG_TO_PREPARE = {"kind": "paper", "duration_s": 60}  # takes tens of milliseconds: a stop falls into that time
ENDINGS = (("stop",), ("disable",), ("disable", "enable"), ("quick_stop",))


class Channels:
    """The ways on which somebody asks for a start or a stop, each on a connection of its own."""

    def __init__(self, daemon: Streaming, held: contextlib.ExitStack) -> None:
        from websockets.sync.client import connect

        self._daemon = daemon
        self.key = daemon.published(TOKEN_FILE)
        url = daemon.published(URL_FILE)
        self._page = held.enter_context(
            connect(f"{url.replace('http', 'ws')}live", origin=url.rstrip("/"), compression=None, max_size=None)  # type: ignore[arg-type]
        )
        self._page.send(json.dumps({"do": "token", "token": self.key}))
        self._viewer = held.enter_context(contextlib.closing(ViewerCalls(daemon.published(VIEWERS_FILE))))
        self._control = held.enter_context(daemon.client())
        self._numbers = iter(range(1, 1_000_000))

    def ask(self, channel: str, method: str, **params: Any) -> Any:
        """The answer, or an error of whatever kind."""
        return getattr(self, f"_by_{channel}")(method, params)

    def _by_control(self, method: str, params: dict[str, Any]) -> Any:
        return self._control.call(method, **params)

    def _by_ctl(self, method: str, params: dict[str, Any]) -> Any:
        words = ["ctl", "--sockets", str(self._daemon.sockets), method.replace("_", "-")]
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as error:
            code = command([*words, *([params["profile"]] if "profile" in params else [])])
        if code:
            raise CallError(code, error.getvalue())
        return {"reached": True}

    def _by_page(self, method: str, params: dict[str, Any]) -> Any:
        number = next(self._numbers)
        if method in ("stop", "disable", "quick_stop"):
            self._page.send(json.dumps({"do": "stop", "id": number}))
        else:
            self._page.send(json.dumps({"do": "call", "id": number, "method": method, "params": params}))
        while True:
            message = self._page.recv(timeout=PATIENCE_S)
            parsed = json.loads(message) if isinstance(message, str) else {}
            answer = parsed.get("answer", parsed)
            if answer.get("id") == number:
                if answer.get("error"):
                    raise CallError(0, str(answer["error"]))
                return answer["result"]

    def _by_viewer(self, method: str, params: dict[str, Any]) -> Any:
        try:
            return self._viewer.call(method, {**params, "key": self.key})
        except PermissionError as failure:
            raise CallError(0, str(failure)) from None


def races(daemon: Streaming, count: int, shaft: ShaftOnBus) -> tuple[list[tuple[str, str, int, int, int]], list[str]]:
    """By way of the stop and what it asked for: races, starts refused, axes that moved afterwards; these in words."""
    draw = random.Random(15)
    tally: Counter[tuple[str, str, str]] = Counter()
    wrong: list[str] = []
    with contextlib.ExitStack() as held, shown("races") as progress:
        channels = Channels(daemon, held)
        client = held.enter_context(daemon.client())
        starter = held.enter_context(daemon.client())
        for number in range(count):
            channel = ("control", "ctl", "page", "viewer")[number % 4]
            ending = ENDINGS[number // 4 % len(ENDINGS)]
            profile = "default" if number // 16 % 2 else LONG_TO_PREPARE
            one_race(
                channels,
                client,
                starter,
                shaft,
                (channel, ending, profile, draw.uniform(0.0, LONGEST_DELAY_S)),
                tally,
                wrong,
            )
            if progress is not None:
                progress((number + 1) / count)
    rows = sorted({(channel, how) for channel, how, _ in tally})
    table = [
        (channel, how, *(tally[channel, how, what] for what in ("races", "refused", "moved"))) for channel, how in rows
    ]
    return table, wrong


def one_race(
    channels: Channels,
    client: DaemonClient,
    starter: DaemonClient,
    shaft: ShaftOnBus,
    race: tuple[str, tuple[str, ...], Any, float],
    tally: Counter[tuple[str, str, str]],
    wrong: list[str],
) -> None:
    """A start on one connection, what ends it on another a moment later; then nothing may move."""
    channel, ending, profile, delay_s = race
    how = " + ".join(ending if channel != "page" else ("disable", *ending[1:]))
    if client.call("status")["state"] == "fault":
        client.call("reset_fault")
    if client.call("status")["state"] != "enabled":
        patiently(lambda: client.call("enable"))
    outcome: list[str] = []
    sent = threading.Event()
    params = {"profile": profile, "epoch": client.call("status")["epoch"]}  # as somebody sees it who is about to act

    def start() -> None:
        starter.send_line(json.dumps({"jsonrpc": "2.0", "id": 1, "method": "start", "params": params}).encode())
        sent.set()
        outcome.append("error" if "error" in starter.read() else "result")

    thread = threading.Thread(target=start)
    thread.start()
    sent.wait()
    time.sleep(delay_s)
    with contextlib.suppress(CallError):
        for method in ending:
            if channel == "page" and method == "enable":
                until(client, "ready")
            by = "control" if channel == "page" and method == "enable" else channel
            answer = channels.ask(by, method)
        if channel == "page":  # its stop does not wait for standstill
            while client.call("status")["state"] == "stopping":
                time.sleep(0.01)
        tally[channel, how, "races"] += 1
        travel_rev = shaft.moved_rev(time.time_ns(), WATCHED_S)
        status = client.call("status")
        thread.join()
        tally[channel, how, "refused"] += outcome == ["error"]
        allowed = ("ready", "enabled", "stopping", "connected")
        if status["state"] not in allowed or travel_rev > STANDSTILL_RPS * WATCHED_S:
            tally[channel, how, "moved"] += 1
            wrong.append(f"{channel}, {how}, {1e3 * delay_s:.1f} ms: {status['state']}, {travel_rev:.4f} rev, {answer}")
        return
    thread.join()
    if (status := client.call("status"))["fault"] is not None:
        wrong.append(f"{channel}, {how}: not counted, fault {status['fault']['name']}")
        return
    wrong.append(f"{channel}, {how}: not acknowledged, {status['state']}")
