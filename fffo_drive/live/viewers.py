"""A WebSocket for the viewers that people already use: Foxglove, Lichtblick, PlotJuggler's bridge (foxglove-sdk).

The SDK sends on threads of its own and drops what a slow viewer does not take; here it is only handed what the feed has
made. Services are the methods of the control API, as the daemon lists them. The protocol knows no origin and no user:
whoever reaches the port may look and may stop the axis; every other command needs the key in its request.
"""

from __future__ import annotations

import asyncio
import hmac
import json
from collections.abc import Mapping
from functools import partial
from typing import Any

import foxglove
import numpy as np
from foxglove.websocket import Capability, MessageSchema, Service, ServiceRequest, ServiceSchema, WebSocketServer

from ..config.address import Address
from ..recording.events import encode_event
from ..recording.schema import EVENT_TOPIC, MESSAGE_ENCODING, SCHEMA_ENCODING
from ..signals import SIGNALS
from . import messages as m
from .control_link import ControlLink
from .decimation import LAST, LATENESS_EDGES_US
from .feed import Taken

PREFIX = "/fffo_drive/"
ENDING = ("stop", "disable", "quick_stop")  # take torque or motion away: no key
UNSERVED = ("subscribe", "schema")  # of the connection, or served as the services' own schemas
BACKLOG = 256  # messages for a viewer that does not read: a few seconds
REQUEST_BYTES = 256 * 1024
LATENESS_NS = 1_000_000_000
DEADLINE = next(i for i, signal in enumerate(SIGNALS) if signal.name == "deadline_ns")


class RefusedCallError(Exception):
    """A call that is not let through, and why."""


class Tally:
    """How late the ticks of about a second woke."""

    def __init__(self, begun_ns: int = 0) -> None:
        self._begun_ns = begun_ns
        self._counts = np.zeros(len(LATENESS_EDGES_US) + 1, np.int64)
        self._ticks = self._late = self._lost = 0

    def add(self, taken: Taken) -> None:
        """Count these."""
        self._counts += taken.lateness
        self._ticks += taken.ticks
        self._late += taken.late
        self._lost += taken.lost

    def due(self, first_ns: int, last_ns: int) -> bool:
        """The second is over with these bins."""
        self._begun_ns = self._begun_ns or first_ns
        return last_ns - self._begun_ns >= LATENESS_NS

    def payload(self) -> bytes:
        """As a message."""
        return m.lateness_payload(self._counts.tolist(), self._ticks, self._late, self._lost)


class Viewers:
    """The server and its channels. All but the services' handlers is called from the live server's thread."""

    def __init__(self, address: Address, name: str, key: str, links: tuple[ControlLink, ControlLink]) -> None:
        """`links`: for what ends a motion, and for all other calls, so that nothing stands before a stop."""
        self._address, self._name, self._key = address, name, key
        self._ending, self._others = links
        self._context = foxglove.Context()
        self._channels = {
            topic: foxglove.Channel(
                topic, message_encoding=MESSAGE_ENCODING, context=self._context,
                schema=foxglove.Schema(name=kind, encoding=SCHEMA_ENCODING, data=text.encode()),
            )
            for topic, (kind, text) in m.SCHEMAS.items()
        }  # fmt: skip
        self._server: WebSocketServer | None = None
        self.begin()

    async def start(self) -> Address:
        """Listen. Returns where. Raises OSError when the address cannot be had, LinkError without a daemon."""
        self._loop = asyncio.get_running_loop()
        methods = await self._others.call("schema")
        services = [self._service(name, method) for name, method in methods.items() if name not in UNSERVED]
        begin = partial(
            foxglove.start_server, name=self._name, host=self._address.host, port=self._address.port,
            capabilities=[Capability.Services], supported_encodings=["json"], services=services,
            context=self._context, message_backlog_size=BACKLOG,
        )  # fmt: skip
        try:
            self._server = await asyncio.to_thread(begin)
        except RuntimeError as error:
            raise OSError(f"the WebSocket for viewers cannot listen on {self._address.names[0]}: {error}") from error
        self._address = self._address._replace(port=self._server.port)
        return self._address

    async def close(self) -> None:
        """Stop listening, drop everybody."""
        server, self._server = self._server, None
        if server is not None:
            await asyncio.to_thread(server.stop)
        for channel in self._channels.values():
            channel.close()

    # what goes out

    @property
    def looking(self) -> bool:
        """Somebody has subscribed to something."""
        return self._server is not None and any(channel.has_sinks() for channel in self._channels.values())

    def begin(self) -> None:
        """What follows has nothing to do with what was before."""
        self._tally = Tally()

    def rows(self, taken: Taken) -> None:
        """Bins, and once a second how late the ticks woke."""
        times_ns = (taken.bins[:, DEADLINE, LAST].astype(np.int64) + taken.wall_offset_ns).tolist()
        for payload, time_ns in zip(m.bin_payloads(taken.bins), times_ns, strict=True):
            self._channels[m.BIN_TOPIC].log(payload, log_time=time_ns)
        self._tally.add(taken)
        if times_ns and self._tally.due(times_ns[0], times_ns[-1]):
            self._channels[m.LATENESS_TOPIC].log(self._tally.payload(), log_time=times_ns[-1])
            self._tally = Tally(times_ns[-1])

    def status(self, status: Mapping[str, Any]) -> None:
        """A status of the control API."""
        self._channels[m.STATE_TOPIC].log(m.state_payload(status))

    def event(self, event: Mapping[str, Any]) -> None:
        """An event of the control API."""
        told = m.event_of(event)
        self._channels[EVENT_TOPIC].log(encode_event(told), log_time=told.time_ns)
        self._channels[m.LOG_TOPIC].log(m.log_payload(told), log_time=told.time_ns)

    # what comes in, on threads of the SDK

    def _service(self, name: str, method: Mapping[str, Any]) -> Service:
        needs_key = not method["watching"] and name not in ENDING
        request = dict(method["parameters"], description=method["summary"])
        if needs_key:
            key = {"type": "string", "description": "what `fffo-drive scope --viewers` says"}
            request["properties"] = {"key": key, **request.get("properties", {})}
            request["required"] = ["key", *request.get("required", [])]
        schemas = [
            MessageSchema(
                encoding="json",
                schema=foxglove.Schema(
                    name=f"fffo_drive/{name}_{end}", encoding="jsonschema", data=json.dumps(content).encode()
                ),
            )
            for end, content in (("Request", request), ("Response", {"type": "object"}))
        ]
        return Service(
            name=PREFIX + name,
            schema=ServiceSchema(name=f"fffo_drive/{name}", request=schemas[0], response=schemas[1]),
            handler=partial(self._serve, name, needs_key),
        )

    def _serve(self, name: str, needs_key: bool, request: ServiceRequest) -> bytes:
        """Ask the daemon. What is raised is the viewer's answer."""
        given = _given(request.payload)
        key = given.pop("key", "")
        if needs_key and not hmac.compare_digest(str(key).encode("utf-8", "replace"), self._key.encode()):
            raise RefusedCallError(f"{name} needs the key: put what `fffo-drive scope --viewers` says into the request")
        link = self._ending if name in ENDING else self._others
        answer = asyncio.run_coroutine_threadsafe(link.call(name, **given), self._loop)
        return json.dumps(answer.result()).encode()


def _given(payload: bytes) -> dict[str, Any]:
    """The parameters in a request; an empty one has none."""
    try:
        given = json.loads(payload or b"{}") if len(payload) <= REQUEST_BYTES else None
    except (ValueError, RecursionError):
        given = None
    if not isinstance(given, dict) or "method" in given:
        raise RefusedCallError(f"a request is one JSON object with the parameters, of {REQUEST_BYTES} bytes at most")
    return given
