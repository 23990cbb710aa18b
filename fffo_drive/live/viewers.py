"""A WebSocket for existing viewers: Foxglove, Lichtblick, PlotJuggler's bridge.

All are served on the live server's thread, each with its own queue; one that does not read, or sends too much, is
dropped. Services are the methods of the control API. A request is checked completely before the daemon is asked. Reads,
commands and stops use three separate connections to the daemon: clients without a key cannot delay those with one, and
pending commands cannot delay a stop. An enable with hold uses one of its own viewer, which ends with the viewer.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from websockets.asyncio.server import ServerConnection

from ..config.address import Address
from ..recording.events import encode_event
from ..recording.schema import EVENT_TOPIC, MESSAGE_ENCODING, SCHEMA_ENCODING
from ..signals import SIGNALS
from . import foxglove_protocol as protocol
from . import messages as m
from .control_link import ControlLink, ControlLinkError
from .decimation import LAST, LATENESS_EDGES_US
from .feed import Taken
from .keys import Keys
from .listener import Listener
from .peer import DroppedError, Peer
from .services import MethodKind, RefusedCallError, Request, ServiceMethod, Services

VIEWERS = 24
REQUEST_BYTES = 256 * 1024  # large enough for a model file
CALLS_IN_ALL = {MethodKind.LOOKS: 16, MethodKind.COMMANDS: 16, MethodKind.ENDS: math.inf}  # pending at a time
LATENESS_NS = 1_000_000_000
DEADLINE = next(i for i, signal in enumerate(SIGNALS) if signal.name == "deadline_ns")


class Tally:
    """Lateness of the ticks of about a second."""

    def __init__(self, begun_ns: int = 0) -> None:
        self._begun_ns = begun_ns
        self._counts = np.zeros(len(LATENESS_EDGES_US) + 1, np.int64)
        self._ticks = self._late = self._lost = 0

    def add(self, taken: Taken) -> None:
        """Count these ticks."""
        self._counts += taken.lateness
        self._ticks += taken.ticks
        self._late += taken.late
        self._lost += taken.lost

    def due(self, first_ns: int, last_ns: int) -> bool:
        """Whether these bins complete the second."""
        self._begun_ns = self._begun_ns or first_ns
        return last_ns - self._begun_ns >= LATENESS_NS

    def payload(self) -> bytes:
        """As a message."""
        return m.lateness_payload(self._counts.tolist(), self._ticks, self._late, self._lost)


class ViewersLine:
    """A connection to the daemon for calls of viewers, with a limit on pending calls."""

    def __init__(self, control_path: Path, most: float = math.inf) -> None:
        self.link = ControlLink(control_path)
        self._most = most
        self._waiting = 0

    async def ask(self, request: Request) -> bytes:
        """The answer as JSON. Raises LinkError."""
        if self._waiting >= self._most:
            raise ControlLinkError(f"{self._most} calls of viewers are pending already; try again")
        self._waiting += 1
        try:
            return json.dumps(await self.link.call(request.method, request.params)).encode()
        finally:
            self._waiting -= 1


class Viewers:
    """The server, its topics and services. Runs on the live server's thread."""

    def __init__(
        self, address: Address, name: str, keys: Keys, control_path: Path, methods: Mapping[str, ServiceMethod]
    ) -> None:
        """`methods`: those of the control API, by name."""
        self.control_path = control_path
        self._listener = Listener(
            address, self._serve, lambda _: None, VIEWERS, keys, REQUEST_BYTES, protocol.SUBPROTOCOL
        )
        self.services = Services(methods, keys)
        self.channels = [
            protocol.Channel(number, topic, MESSAGE_ENCODING, kind, text, SCHEMA_ENCODING)
            for number, (topic, (kind, text)) in enumerate(m.SCHEMAS.items(), start=1)
        ]
        self._number_of = {channel.topic: channel.id for channel in self.channels}
        self._greeting = (
            protocol.server_info(name, str(time.time_ns())),
            protocol.advertise(self.channels),
            protocol.advertise_services(self.services.offered()),
        )
        self.lines = {kind: ViewersLine(control_path, CALLS_IN_ALL[kind]) for kind in MethodKind}
        self._viewers: set[Viewer] = set()
        self.begin()

    async def start(self) -> Address:
        """Listen. Returns the address. Raises OSError when it is not available."""
        return await self._listener.start()

    def close(self) -> None:
        """Stop listening, drop everybody."""
        self._listener.close()
        for line in self.lines.values():
            line.link.close()

    async def _serve(self, connection: ServerConnection) -> None:
        """Serve one viewer until it leaves."""
        viewer = Viewer(self, connection)
        for text in self._greeting:
            viewer.offer(text)
        self._viewers.add(viewer)
        try:
            await viewer.live()
        finally:
            self._viewers.discard(viewer)

    # what goes out

    @property
    def looking(self) -> bool:
        """Whether any viewer has a subscription."""
        return any(viewer.subscriptions for viewer in self._viewers)

    def begin(self) -> None:
        """What follows belongs to a new loop."""
        self._tally = Tally()

    def rows(self, taken: Taken) -> None:
        """Send bins, and once a second the lateness of the ticks."""
        times_ns = (taken.bins[:, DEADLINE, LAST].astype(np.int64) + taken.wall_offset_ns).tolist()
        for payload, time_ns in zip(m.bin_payloads(taken.bins), times_ns, strict=True):
            self._tell(m.BIN_TOPIC, payload, time_ns)
        self._tally.add(taken)
        if times_ns and self._tally.due(times_ns[0], times_ns[-1]):
            self._tell(m.LATENESS_TOPIC, self._tally.payload(), times_ns[-1])
            self._tally = Tally(times_ns[-1])

    def status(self, status: Mapping[str, Any]) -> None:
        """A status of the control API."""
        self._tell(m.STATE_TOPIC, m.state_payload(status), time.time_ns())

    def event(self, event: Mapping[str, Any]) -> None:
        """An event of the control API."""
        message = m.event_of(event)
        self._tell(EVENT_TOPIC, encode_event(message), message.time_ns)
        self._tell(m.LOG_TOPIC, m.log_payload(message), message.time_ns)

    def _tell(self, topic: str, payload: bytes, time_ns: int) -> None:
        """Send one message to all subscribers of its topic."""
        channel = self._number_of[topic]
        for viewer in list(self._viewers):
            subscription = viewer.subscriptions.get(channel)
            if subscription is not None:
                viewer.offer(protocol.message_data(subscription, time_ns, payload))


class Viewer(Peer):
    """One connected viewer."""

    def __init__(self, viewers: Viewers, connection: ServerConnection) -> None:
        super().__init__(connection)
        self._all = viewers
        self._channels = {channel.id for channel in viewers.channels}
        self.subscriptions: dict[int, int] = {}  # channel -> subscription
        self._own = ViewersLine(viewers.control_path)  # the axis may hang on it

    async def live(self) -> None:
        """Serve it until it leaves or is dropped."""
        try:
            await super().live()
        finally:
            self._own.link.close()  # a viewer that holds the axis: the daemon reacts as daemon.client_loss says

    def take(self, message: str | bytes) -> None:
        """Handle a message of the protocol. Raises DroppedError."""
        self._own.link.say_alive()  # of a viewer that holds the axis the daemon has to hear
        try:
            asked = protocol.parse(message)
        except protocol.ProtocolError as error:
            raise DroppedError(str(error)) from None
        if isinstance(asked, protocol.SubscribeRequest):
            self._subscribe(asked)
        elif isinstance(asked, protocol.Unsubscribe):
            gone = set(asked.ids)
            self.subscriptions = {c: s for c, s in self.subscriptions.items() if s not in gone}
        elif isinstance(asked, protocol.ServiceCall):
            self._call(asked)
        else:
            self.offer(protocol.status(protocol.ERROR, f"{asked.operation} is not offered"))

    def _subscribe(self, asked: protocol.SubscribeRequest) -> None:
        for subscription, channel in asked.wanted:
            if channel not in self._channels:
                self.offer(protocol.status(protocol.ERROR, f"no channel {channel}"))
            else:
                self.subscriptions[channel] = subscription

    def _call(self, call: protocol.ServiceCall) -> None:
        """Ask the daemon after the request has been checked."""
        try:
            if call.encoding != protocol.ENCODING:
                raise RefusedCallError(f"requests are {protocol.ENCODING}")
            request = self._all.services.checked(call.service, call.payload)
            ends = request.kind is MethodKind.ENDS
            if self.busy and not ends:
                raise RefusedCallError("too many of your calls are pending")
        except RefusedCallError as error:
            self.offer(protocol.service_failure(call, str(error)))
        else:
            self.answer_later(self._answer(call, request), to_the_end=ends)

    async def _answer(self, call: protocol.ServiceCall, request: Request) -> None:
        line = self._own if request.params.get("hold") else self._all.lines[request.kind]
        try:
            self.offer(protocol.service_answer(call, await line.ask(request)))
        except ControlLinkError as error:
            self.offer(protocol.service_failure(call, str(error)))
