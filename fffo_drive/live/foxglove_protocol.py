"""Encoding and decoding of Foxglove's WebSocket protocol (`foxglove.sdk.v1`), as far as it is used here; no sockets.

Source: https:
github.com/foxglove/foxglove-sdk, rust/foxglove/src/protocol/v1. Numbers are little-endian. A test compares this with
that SDK. The SDK's own server is not used, because it limits neither connections (including half-open ones) nor the
requests of a client, and each service call takes a thread (up to 512).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from ..documents import json_object

SUBPROTOCOL = "foxglove.sdk.v1"
MESSAGE_DATA, SERVICE_CALL_RESPONSE = 1, 3  # opcodes of the server
SERVICE_CALL_REQUEST = 2  # of the client
ENCODING = "json"  # of requests and answers
ERROR = 2  # level of a status
LARGEST_ID = 1 << 32
_DATA = struct.Struct("<BIQ")
_CALL = struct.Struct("<BIII")


class ProtocolError(Exception):
    """A message that violates the protocol."""


class Channel(NamedTuple):
    """A topic."""

    id: int
    topic: str
    encoding: str
    schema_name: str
    schema: str
    schema_encoding: str


class AdvertisedService(NamedTuple):
    """A service; the schemas are JSON schemas."""

    id: int
    name: str
    type: str
    request: Mapping[str, Any]
    response: Mapping[str, Any]


class SubscribeRequest(NamedTuple):
    """Pairs of subscription and channel."""

    wanted: list[tuple[int, int]]


class Unsubscribe(NamedTuple):
    """Subscriptions."""

    ids: list[int]


class ServiceCall(NamedTuple):
    """A request to a service."""

    service: int
    number: int
    encoding: str
    payload: bytes


class Unserved(NamedTuple):
    """An operation of the protocol that is not offered here."""

    operation: str


Asked = SubscribeRequest | Unsubscribe | ServiceCall | Unserved


def server_info(name: str, session: str) -> str:
    """The first message to every client."""
    facts = {"name": name, "metadata": {}, "sessionId": session}
    return _text("serverInfo", **facts, capabilities=["services"], supportedEncodings=[ENCODING])


def advertise(channels: Iterable[Channel]) -> str:
    """These topics exist."""
    entries = [
        {
            "id": c.id, "topic": c.topic, "encoding": c.encoding, "schemaName": c.schema_name,
            "schemaEncoding": c.schema_encoding, "schema": c.schema,
        }
        for c in channels
    ]  # fmt: skip
    return _text("advertise", channels=entries)


def advertise_services(services: Iterable[AdvertisedService]) -> str:
    """These services exist."""
    entries = [
        {
            "id": s.id, "name": s.name, "type": s.type,
            "request": _schema(f"{s.type}_Request", s.request), "response": _schema(f"{s.type}_Response", s.response),
        }
        for s in services
    ]  # fmt: skip
    return _text("advertiseServices", services=entries)


def _schema(name: str, schema: Mapping[str, Any]) -> dict[str, str]:
    return {"encoding": ENCODING, "schemaName": name, "schemaEncoding": "jsonschema", "schema": json.dumps(schema)}


def message_data(subscription: int, time_ns: int, payload: bytes) -> bytes:
    """A message of a topic."""
    return _DATA.pack(MESSAGE_DATA, subscription, time_ns) + payload


def service_answer(call: ServiceCall, payload: bytes) -> bytes:
    """The answer of a service."""
    encoding = ENCODING.encode()
    return _CALL.pack(SERVICE_CALL_RESPONSE, call.service, call.number, len(encoding)) + encoding + payload


def service_failure(call: ServiceCall, why: str) -> str:
    """The failure of a service."""
    return _text("serviceCallFailure", serviceId=call.service, callId=call.number, message=why)


def status(level: int, text: str) -> str:
    """A message for people."""
    return _text("status", level=level, message=text)


def parse(message: str | bytes) -> Asked:
    """Decode a client's message. Raises ProtocolError."""
    return _call(message) if isinstance(message, bytes) else _operation(message)


def _operation(text: str) -> Asked:
    try:
        content = json_object(text)
    except ValueError:
        raise ProtocolError("no JSON object") from None
    operation = content.get("op")
    if not isinstance(operation, str):
        raise ProtocolError("not a JSON object with an `op`")
    if operation == "subscribe":
        wanted = _list(content, "subscriptions")
        return SubscribeRequest([(_id(one, "id"), _id(one, "channelId")) for one in wanted])
    if operation == "unsubscribe":
        return Unsubscribe([_id({"id": one}, "id") for one in _list(content, "subscriptionIds")])
    return Unserved(operation[:40])


def _list(content: Mapping[str, Any], name: str) -> Sequence[Any]:
    found = content.get(name)
    if not isinstance(found, list):
        raise ProtocolError(f"{content['op']} without a list `{name}`")
    return found


def _id(content: Any, name: str) -> int:
    found = content.get(name) if isinstance(content, dict) else None
    if not isinstance(found, int) or isinstance(found, bool) or not 0 <= found < LARGEST_ID:
        raise ProtocolError(f"`{name}` is not a 32-bit number")
    return found


def _call(message: bytes) -> ServiceCall | Unserved:
    if message[:1] != bytes([SERVICE_CALL_REQUEST]):
        return Unserved(f"opcode {message[0]}" if message else "an empty message")
    if len(message) < _CALL.size:
        raise ProtocolError("a truncated service request")
    _, service, number, length = _CALL.unpack_from(message)
    end = _CALL.size + length
    if end > len(message):
        raise ProtocolError("a truncated service request")
    return ServiceCall(service, number, message[_CALL.size : end].decode("ascii", "replace"), message[end:])


def _text(operation: str, **content: Any) -> str:
    return json.dumps({"op": operation, **content}, separators=(",", ":"))
