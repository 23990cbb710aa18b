"""The axis as its daemon has it: what a page may ask of it, the pages that look, and step responses around a new gain.

The methods are those of `fffo-drive ctl`, on the daemon's control socket. A request for torque or motion names the
epoch of the status that the page showed. Each call has a connection of its own, so that none waits behind another;
only a page that holds the axis keeps one, and the daemon does as daemon.client_loss says when that page goes away.
"""

from __future__ import annotations

import contextlib
import secrets
import threading
import time
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any

from ..daemon.client import CallError, ClientError, DaemonClient
from ..daemon.parameters import METHODS, Bound
from ..daemon.places import CONTROL, WATCH
from ..documents import DocumentError
from ..live.keys import Asker, Keys
from ..live.places import TOKEN_FILE, URL_FILE
from ..roles import Role, may
from .gain_trial import Trial, try_gain

CALLS = (
    "enable", "disable", "start", "stop", "quick_stop", "jog", "velocity", "step", "toggle", "set", "reset_fault",
    "reload", "record",
)  # fmt: skip
PAGES = 4  # that look at a time: a browser has six connections to a server, and a stop needs one
STATUS_HZ = 5.0
PRESENCE_S = 5.0  # without a word of a page, which answers what it is sent, it is taken for gone
ANSWER_S = 10.0
EVENTS = 30


class Page:
    """One page that looks, from its first message to its last."""

    def __init__(self, directory: Path, now_s: float) -> None:
        self.name = secrets.token_urlsafe(9)
        self.directory = directory
        self.heard_s = now_s
        self._held: DaemonClient | None = None
        self._lock = threading.Lock()
        self._gone = False

    def hold(self, params: Mapping[str, Any]) -> Any:
        """Enable, with the axis tied to this page. Raises CallError, ClientError."""
        with self._lock:
            if self._gone:
                raise ClientError("this page is taken for gone: load it again")
            if self._held is not None:  # cut off for its silence, perhaps
                self._held.close()
            self._held = DaemonClient(self.directory / CONTROL, ANSWER_S)
            return self._held.call("enable", **{**params, "hold": True})

    def speak(self, now_s: float) -> None:
        """It is there; the daemon hears so from the one that holds the axis."""
        self.heard_s = now_s
        with self._lock, contextlib.suppress(ClientError):
            if self._held is not None:
                self._held.send_line(b"")

    def close(self) -> None:
        """It is gone."""
        with self._lock:
            self._gone = True
            if self._held is not None:
                self._held.close()


class ServedAxis:
    """What the pages of a workbench ask of the daemon; called from the server's threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._pages: dict[str, Page] = {}
        self._lock = threading.Lock()
        self.trials: list[Trial] = []
        self._trying = threading.Lock()

    def methods_of(self, role: Role) -> list[str]:
        """What a role may ask for."""
        return [name for name in CALLS if may(role, METHODS[name].role)]

    def call(self, directory: Path, asker: Asker, method: str, wish: Mapping[str, Any]) -> Any:
        """One method. Raises DocumentError for one that the daemon, or this page, does not allow now."""
        params = {name: value for name, value in wish.items() if name != "page"}
        if issubclass(METHODS[method].parameters, Bound) and not isinstance(params.get("epoch"), int):
            raise DocumentError(f"{method}: the page does not say in which state it showed the axis (epoch)")
        params["who"] = asker.text
        try:
            if method == "enable" and wish.get("page") is not None:
                page = self._pages.get(str(wish["page"]))
                if page is None:
                    raise ClientError("this page is not connected: wait until it shows the axis, then enable again")
                return page.hold({**params, "wait_s": 0})
            with DaemonClient(directory / CONTROL, ANSWER_S) as client:
                return client.call(method, **params)
        except (CallError, ClientError) as error:
            raise DocumentError(str(error)) from None

    def info(self, directory: Path) -> Any:
        """What the daemon says of itself, with the gains in use. Raises DocumentError."""
        try:
            with DaemonClient(directory / WATCH, ANSWER_S) as client:
                return client.call("info")
        except (CallError, ClientError) as error:
            raise DocumentError(str(error)) from None

    def heard(self, name: Any) -> None:
        """A page is there."""
        page = self._pages.get(str(name))
        if page is not None:
            page.speak(self._clock())

    def messages(self, directory: Path) -> Generator[dict[str, Any], None, None]:
        """What a page is sent until the daemon ends or the page is gone. Raises DocumentError."""
        page = Page(directory, self._clock())
        with self._lock:
            if len(self._pages) >= PAGES:
                raise DocumentError(f"{PAGES} pages look at the axis already: close one of them")
            self._pages[page.name] = page
        try:
            with DaemonClient(directory / WATCH, ANSWER_S) as client:
                info, events = client.call("info"), client.call("events", limit=EVENTS)["events"]
                yield {"kind": "hello", "page": page.name, "info": info, "events": events}
                page.heard_s = self._clock()  # now it can answer, however long the daemon took
                yield {"kind": "status", "status": client.call("status")}
                client.call("subscribe", status_hz=STATUS_HZ, events=True)
                while self._clock() - page.heard_s < PRESENCE_S:
                    message = client.next_notification(ANSWER_S)
                    yield {"kind": message["method"], message["method"]: message["params"]}
        except (CallError, ClientError) as error:
            raise DocumentError(str(error)) from None
        finally:
            with self._lock:
                self._pages.pop(page.name, None)
            page.close()

    def try_gain(self, directory: Path, asker: Asker, wish: Mapping[str, Any]) -> dict[str, Any]:
        """Begin a trial of a gain: a step, the new value, the same step again. Raises DocumentError."""
        key, value = wish.get("key"), wish.get("value")
        by_rps, for_s, epoch = wish.get("by_rps"), wish.get("for_s"), wish.get("epoch")
        if not isinstance(key, str) or not isinstance(value, int | float) or not isinstance(epoch, int):
            raise DocumentError("a trial needs a key, a value and the epoch of the status that was shown")
        if not isinstance(by_rps, int | float) or not isinstance(for_s, int | float) or by_rps == 0 or for_s <= 0:
            raise DocumentError("a trial needs a step: by so many rps (not 0), for so many seconds (above 0)")
        if not self._trying.acquire(blocking=False):
            raise DocumentError("a trial is under way: wait for its end, or stop the axis")
        trial = Trial(len(self.trials) + 1, key, value, float(by_rps), float(for_s))
        self.trials.append(trial)

        def work() -> None:
            try:
                try_gain(trial, directory, epoch, asker.text)
            finally:
                self._trying.release()

        threading.Thread(target=work, name="fffo-trial", daemon=True).start()
        return trial.as_object(curves=False)

    def trial(self, number: str) -> dict[str, Any]:
        """A trial with its curves. Raises DocumentError for one that is not there."""
        found = next((trial for trial in self.trials if str(trial.number) == number), None)
        if found is None:
            raise DocumentError(f"no trial {number}")
        return found.as_object(curves=True)


def scope_address(directory: Path, asker: Asker) -> str:
    """Where the daemon's scope is, with the key of this role; empty where it serves none."""
    try:
        url = (directory / URL_FILE).read_text(encoding="utf-8").strip()
    except OSError:
        return ""
    if asker.role == "look":
        return url
    try:
        keys = Keys((directory / TOKEN_FILE).read_text(encoding="utf-8").strip())
    except OSError:
        return url  # this user may not have the key: to look only
    key = keys.of(asker.role)
    return f"{url}#{asker.name}:{key}" if asker.name else f"{url}#{key}"
