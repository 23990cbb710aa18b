"""The protocol of the viewers: what we say is what foxglove-sdk says, and no bytes of a client break us."""

from __future__ import annotations

import contextlib
import json
import struct

import foxglove
import pytest
from foxglove.websocket import Capability, MessageSchema, ServiceSchema
from foxglove.websocket import Service as SdkService
from hypothesis import given, settings
from hypothesis import strategies as st
from live.viewer import ServiceFailure, Viewer
from websockets.sync.client import connect

from fffo_drive.live import foxglove_protocol as protocol

ID = st.integers(0, protocol.LARGEST_ID - 1)
CHANNEL = {
    "topic": "/a",
    "encoding": "cdr",
    "schema_name": "x/msg/A",
    "schema": "int32 a\n",
    "schema_encoding": "ros2msg",
}
REQUEST, RESPONSE = {"type": "object", "properties": {"key": {"type": "string"}}}, {"type": "object"}


def answered(request):
    if request.payload == b"fail":
        raise ValueError("why")
    return b'{"state": "ready"}'


@pytest.fixture(scope="module")
def sdk():
    """The SDK's server with one topic and one service; yields the channel and where it listens."""
    context = foxglove.Context()
    schema = foxglove.Schema(name=CHANNEL["schema_name"], encoding="ros2msg", data=CHANNEL["schema"].encode())
    channel = foxglove.Channel("/a", message_encoding="cdr", context=context, schema=schema)
    request, response = (
        MessageSchema(
            encoding="json", schema=foxglove.Schema(name=name, encoding="jsonschema", data=json.dumps(text).encode())
        )
        for name, text in (("fffo_drive/stop_Request", REQUEST), ("fffo_drive/stop_Response", RESPONSE))
    )
    service = SdkService(
        name="/fffo_drive/stop", handler=answered,
        schema=ServiceSchema(name="fffo_drive/stop", request=request, response=response),
    )  # fmt: skip
    server = foxglove.start_server(
        name="bench", host="127.0.0.1", port=0, capabilities=[Capability.Services], supported_encodings=["json"],
        services=[service], context=context, session_id="1",
    )  # fmt: skip
    yield channel, f"ws://127.0.0.1:{server.port}"
    server.stop()
    channel.close()


def test_we_say_what_the_sdk_says(sdk):
    channel, url = sdk
    with connect(url, subprotocols=[protocol.SUBPROTOCOL], compression=None, ping_interval=None) as socket:
        info, topics, services = (json.loads(socket.recv()) for _ in range(3))
        info["metadata"] = {}  # names the SDK
        number, service = topics["channels"][0]["id"], services["services"][0]["id"]
        ours = protocol.Channel(number, **CHANNEL)
        assert json.loads(protocol.server_info("bench", "1")) == info
        assert json.loads(protocol.advertise([ours])) == topics
        advertised = protocol.AdvertisedService(service, "/fffo_drive/stop", "fffo_drive/stop", REQUEST, RESPONSE)
        assert json.loads(protocol.advertise_services([advertised])) == services

        socket.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 5, "channelId": number}]}))
        socket.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 6, "channelId": 999}]}))
        complaint = json.loads(socket.recv())  # so that the first one has been heard
        assert complaint == json.loads(protocol.status(protocol.ERROR, complaint["message"]))
        channel.log(b"1234", log_time=10**18)
        assert protocol.message_data(5, 10**18, b"1234") == socket.recv()

        for payload in (b"{}", b"fail"):
            request = struct.pack("<BIII", protocol.SERVICE_CALL_REQUEST, service, 77, 4) + b"json" + payload
            call = protocol.parse(request)
            assert call == protocol.ServiceCall(service, 77, "json", payload)
            socket.send(request)
            if payload == b"{}":
                assert protocol.service_answer(call, b'{"state": "ready"}') == socket.recv()
            else:
                assert json.loads(protocol.service_failure(call, "ValueError: why")) == json.loads(socket.recv())


def test_the_viewer_of_our_tests_is_understood_by_the_sdk(sdk):
    viewer = Viewer(sdk[1])
    viewer.meet(1, 1)
    assert viewer.call("/fffo_drive/stop", {}) == {"state": "ready"}
    with pytest.raises(ServiceFailure, match="why"):
        viewer.call("/fffo_drive/stop", b"fail")
    viewer.close()


@given(pairs=st.lists(st.tuples(ID, ID), max_size=5), ids=st.lists(ID, max_size=5))
@settings(max_examples=50, derandomize=True)
def test_subscriptions_are_read(pairs, ids):
    wanted = [{"id": subscription, "channelId": channel} for subscription, channel in pairs]
    assert protocol.parse(json.dumps({"op": "subscribe", "subscriptions": wanted})) == protocol.SubscribeRequest(pairs)
    assert protocol.parse(json.dumps({"op": "unsubscribe", "subscriptionIds": ids})) == protocol.Unsubscribe(ids)
    assert protocol.parse('{"op": "getParameters"}') == protocol.Unserved("getParameters")
    assert protocol.parse(b"\x01" + bytes(20)) == protocol.Unserved("opcode 1")
    assert protocol.parse(b"") == protocol.Unserved("an empty message")


OPERATION = st.fixed_dictionaries(
    {"op": st.sampled_from(["subscribe", "unsubscribe", "x"])},
    optional={
        name: st.none() | st.lists(st.none() | st.integers() | st.booleans() | st.just({"id": 1}), max_size=3)
        for name in ("subscriptions", "subscriptionIds")
    },
)


@given(message=st.binary(max_size=40) | st.text(max_size=40) | OPERATION.map(json.dumps))
@settings(max_examples=300, derandomize=True)
def test_anything_else_is_refused_as_none_of_the_protocol(message):
    with contextlib.suppress(protocol.ProtocolError):
        protocol.parse(message)


@pytest.mark.parametrize(
    "message",
    [
        b"\x02", b"\x02" + bytes(11), b"\x02" + bytes(8) + b"\xff\xff\xff\xff", "[",
        "[" * 100_000, "{}", '{"op": 1}', '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": true, "channelId": 1}]}',
        '{"op": "unsubscribe", "subscriptionIds": [4294967296]}',
    ],
)  # fmt: skip
def test_what_is_none_of_the_protocol(message):
    with pytest.raises(protocol.ProtocolError):
        protocol.parse(message)
