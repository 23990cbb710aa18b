"""One scope page in a browser: its requests, and what its key allows. Without a key it may only look."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from websockets.asyncio.server import ServerConnection

from ..documents import json_object
from ..roles import Role, may
from ..signals import UNITS
from . import frames
from .control_link import ControlLink, ControlLinkError
from .feed import CAPTURE_S
from .keys import Asker
from .peer import DroppedError, Peer
from .services import WHO

if TYPE_CHECKING:
    from .hub import Hub

Call = Callable[[], Awaitable[Any]]

COMMANDS = {"enable": 10.0, "disable": 10.0, "start": 0.0, "stop": 10.0, "toggle": None, "reset_fault": 10.0}
WRONG_KEYS = 5
NO_KEY = "this page may only look; `fffo-drive scope` prints the address with the key"


class LiveClient(Peer):
    """A page that was accepted."""

    def __init__(self, hub: Hub, connection: ServerConnection) -> None:
        super().__init__(connection)
        self._hub = hub
        self._wrong = 0
        self._asker = Asker("look")
        self._link = ControlLink(hub.control_path)

    async def live(self) -> None:
        """Serve it until it leaves or is dropped."""
        try:
            await super().live()
        finally:
            self._link.close()  # a page that holds the axis: the daemon reacts as daemon.client_loss says

    def take(self, message: str | bytes) -> None:
        """Carry out one request, a JSON object. Raises DroppedError."""
        try:
            wanted = json_object(message if isinstance(message, str) else b"")
        except ValueError:
            raise DroppedError("sent something other than a JSON object") from None
        what = wanted.get("do")
        if what == "token":
            self._check_key(wanted.get("token"))
        elif what == "capture":
            self._begin_capture(wanted)
        elif what == "here":
            self._link.say_alive()  # of a page that holds the axis the daemon has to hear
        elif what not in ("stop", "call"):
            raise DroppedError("sent an unknown request")
        elif self._asker.role == "look":
            self._refuse(wanted, NO_KEY)
        elif what == "stop":
            self.answer_later(self._answer(wanted, partial(self._hub.stop, self._asker.text)), to_the_end=True)
        else:
            self._call(wanted)

    def _check_key(self, given: object) -> None:
        asker = self._hub.keys.asker(given)
        if asker is None:
            self._wrong += 1
            if self._wrong >= WRONG_KEYS:
                raise DroppedError("sent a wrong key several times")
        self._asker = asker or Asker("look")
        allowed = [method for method in COMMANDS if may(self._asker.role, self._needed(method))]
        self.offer(frames.text("rights", role=self._asker.role, may=allowed))

    def _needed(self, method: str) -> Role:
        return self._hub.methods[method].role

    def _begin_capture(self, wanted: dict[str, Any]) -> None:
        seconds, until_tick, signals = wanted.get("seconds"), wanted.get("until_tick"), wanted.get("signals", [])
        if not isinstance(seconds, int | float) or not 0 < seconds <= CAPTURE_S:
            raise DroppedError("requested a capture of an invalid length")
        if until_tick is not None and (not isinstance(until_tick, int) or not 0 <= until_tick < 1 << 63):
            raise DroppedError("requested a capture at an invalid tick")
        if not isinstance(signals, list) or not all(isinstance(name, str) and name in UNITS for name in signals):
            raise DroppedError("requested a capture of unknown signals")
        if len(set(signals)) < len(signals):
            raise DroppedError("requested a signal twice")
        if not self._bulk:  # one at a time: the capture before is still being sent
            self.offer_bulk(self._hub.feed.captured(float(seconds), until_tick, signals, _number(wanted)))

    def _call(self, wanted: dict[str, Any]) -> None:
        method, params = wanted.get("method"), wanted.get("params", {})
        if not isinstance(method, str) or method not in COMMANDS or not isinstance(params, dict):
            self._refuse(wanted, f"not a command of the scope; known: {', '.join(COMMANDS)}")
        elif not may(self._asker.role, needed := self._needed(method)):
            self._refuse(wanted, f"{method} needs the role {needed}, the key of this page gives {self._asker.role}")
        elif self.busy:
            self._refuse(wanted, "too many commands are pending")
        else:
            wait_s = COMMANDS[method]
            waits = {} if wait_s is None else {"wait_s": wait_s}
            given = {**params, **waits, WHO: self._asker.text}
            self.answer_later(self._answer(wanted, partial(self._link.call, method, given)))

    def _refuse(self, wanted: dict[str, Any], why: str) -> None:
        self.offer(frames.text("answer", id=_number(wanted), error=why))

    async def _answer(self, wanted: dict[str, Any], call: Call) -> None:
        try:
            answer = frames.text("answer", id=_number(wanted), result=await call())
        except ControlLinkError as error:
            answer = frames.text("answer", id=_number(wanted), error=str(error))
        self.offer(answer)


def _number(wanted: dict[str, Any]) -> int | None:
    number = wanted.get("id")
    return number if isinstance(number, int) else None
