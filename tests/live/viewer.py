"""A viewer as Foxglove is one: the WebSocket protocol `foxglove.sdk.v1` in a few lines, messages decoded by rosbags."""

from __future__ import annotations

import contextlib
import json
import struct
from typing import Any

from daemon.rig import PATIENCE_S
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from websockets.sync.client import connect

SUBPROTOCOL = "foxglove.sdk.v1"
# No pings: their thread draws from the global random numbers, which property tests watch.
CLIENT: dict[str, Any] = {"compression": None, "max_size": None, "close_timeout": 1.0, "ping_interval": None}
MESSAGE_DATA, SERVICE_RESPONSE = 1, 3  # from the server
SERVICE_REQUEST = 2  # from the client


class ServiceFailure(Exception):  # noqa: N818  # what the protocol calls it
    """The server's words."""


class Viewer:
    """A connection, after the server has said what it has."""

    def __init__(self, url: str, **options: Any) -> None:
        self._held = contextlib.ExitStack()
        self.socket = self._held.enter_context(connect(url, **CLIENT | {"subprotocols": [SUBPROTOCOL]} | options))
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self._subscribed: dict[int, str] = {}
        self._calls = 0
        self._store = get_typestore(Stores.EMPTY)

    def close(self) -> None:
        self._held.close()

    def hear(self) -> bytes | dict[str, Any]:
        """The next message; what tells of channels and services is kept, too."""
        message = self.socket.recv(timeout=PATIENCE_S)
        if isinstance(message, bytes):
            return message
        content: dict[str, Any] = json.loads(message)
        if content["op"] == "serverInfo":
            self.info = content
        elif content["op"] == "advertise":
            self.channels |= {channel["topic"]: channel for channel in content["channels"]}
        elif content["op"] == "advertiseServices":
            self.services |= {service["name"]: service for service in content["services"]}
        return content

    def meet(self, topics: int, services: int) -> None:
        """Until so many are known."""
        while len(self.channels) < topics or len(self.services) < services:
            self.hear()

    def subscribe(self, *topics: str) -> None:
        """Its messages from now on."""
        wanted = []
        for topic in topics:
            channel = self.channels[topic]
            self._store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
            self._subscribed[channel["id"]] = topic
            wanted.append({"id": channel["id"], "channelId": channel["id"]})
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def message(self, topic: str) -> tuple[int, Any]:
        """The next one of a topic: its time in ns, and the message."""
        while True:
            raw = self.hear()
            if isinstance(raw, bytes) and raw[0] == MESSAGE_DATA:
                number, time_ns = struct.unpack_from("<IQ", raw, 1)
                if self._subscribed[number] == topic:
                    return time_ns, self._store.deserialize_cdr(raw[13:], self.channels[topic]["schemaName"])

    def call(self, service: str, payload: dict[str, Any] | bytes) -> Any:
        """Raises ServiceFailure."""
        self._calls += 1
        body = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        head = struct.pack("<BIII", SERVICE_REQUEST, self.services[service]["id"], self._calls, 4)
        self.socket.send(head + b"json" + body)
        while True:
            raw = self.hear()
            if isinstance(raw, dict) and raw["op"] == "serviceCallFailure" and raw["callId"] == self._calls:
                raise ServiceFailure(raw["message"])
            if isinstance(raw, bytes) and raw[0] == SERVICE_RESPONSE:
                _, number, length = struct.unpack_from("<III", raw, 1)
                if number == self._calls:
                    return json.loads(raw[13 + length :])
