"""JSON-RPC 2.0 as bytes: the specification's examples, and whatever bytes come."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fffo_drive.daemon import rpc
from fffo_drive.daemon.rpc import BATCH_LIMIT, DEEPEST, NOTIFICATION, Call, RpcError, encode, error_of, read_line

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=10,
)


def only(line: str | bytes):
    document = read_line(line if isinstance(line, bytes) else line.encode())
    assert len(document.items) == 1
    return document.items[0]


def code(line: str | bytes) -> int:
    item = only(line)
    assert not isinstance(item, Call)
    assert item["jsonrpc"] == "2.0"
    assert item["error"]["message"]
    return item["error"]["code"]


def test_a_call_has_its_id_method_and_parameters():
    call = only('{"jsonrpc": "2.0", "id": 7, "method": "status", "params": {"a": 1}}')
    assert call == Call(7, "status", {"a": 1})
    assert only('{"jsonrpc": "2.0", "id": "x", "method": "m"}') == Call("x", "m", {})
    assert only('{"jsonrpc": "2.0", "method": "m"}').id is NOTIFICATION
    assert only('{"jsonrpc": "2.0", "id": null, "method": "m"}').id is None
    assert only('{"jsonrpc": "2.0", "id": 1, "method": "m", "params": []}').params == {}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ('{"jsonrpc": "2.0", "method": "foobar, "params": "bar", "baz]', rpc.PARSE_ERROR),  # from the specification
        ("", rpc.PARSE_ERROR),
        ("nonsense", rpc.PARSE_ERROR),
        (b"\xff\xfe", rpc.PARSE_ERROR),
        ('{"jsonrpc": "2.0", "id": 1, "method": "m", "params": {"x": NaN}}', rpc.PARSE_ERROR),
        ("[" * 10_000, rpc.PARSE_ERROR),
        ("[" * (DEEPEST + 1) + "]" * (DEEPEST + 1), rpc.PARSE_ERROR),
        ('{"jsonrpc": "2.0", "method": 1, "params": "bar"}', rpc.INVALID_REQUEST),
        ('{"id": 1, "method": "m"}', rpc.INVALID_REQUEST),
        ('{"jsonrpc": "1.0", "id": 1, "method": "m"}', rpc.INVALID_REQUEST),
        ('{"jsonrpc": "2.0", "id": {}, "method": "m"}', rpc.INVALID_REQUEST),
        ('{"jsonrpc": "2.0", "id": true, "method": "m"}', rpc.INVALID_REQUEST),
        ('{"jsonrpc": "2.0", "id": 1, "method": "m", "params": [1]}', rpc.INVALID_PARAMS),
        ('{"jsonrpc": "2.0", "id": 1, "method": "m", "params": "x"}', rpc.INVALID_PARAMS),
        ("[]", rpc.INVALID_REQUEST),
        ("1", rpc.INVALID_REQUEST),
        ("null", rpc.INVALID_REQUEST),
        (json.dumps([1] * (BATCH_LIMIT + 1)), rpc.LIMIT),
    ],
)
def test_each_malformed_request_has_its_error(line, expected):
    assert code(line) == expected


def test_an_error_names_the_request_where_it_can_be_known():
    assert only('{"jsonrpc": "2.0", "id": 5}')["id"] == 5
    assert only('{"id": 5, "method": "m"}')["id"] == 5
    assert only("1")["id"] is None


def test_a_batch_keeps_its_order_and_answers_each_item():
    document = read_line(b'[1, {"jsonrpc": "2.0", "id": 2, "method": "m"}, 3]')
    assert document.batch
    assert [isinstance(item, Call) for item in document.items] == [False, True, False]


@given(st.binary(max_size=300))
@example(b'{"a":' * 500)
def test_any_bytes_are_a_call_or_an_error(line):
    for item in read_line(line).items:
        if not isinstance(item, Call):
            assert item["error"]["code"] in (rpc.PARSE_ERROR, rpc.INVALID_REQUEST, rpc.INVALID_PARAMS, rpc.LIMIT)
            assert json.loads(encode(item)) == item


@given(VALUES)
def test_any_json_is_a_call_or_an_error(content):
    for item in read_line(json.dumps(content).encode()).items:
        assert isinstance(item, Call) or item["error"]["code"]


@given(st.one_of(st.text(), st.integers()), st.text(), st.dictionaries(st.text(), VALUES, max_size=4))
def test_a_well_formed_call_comes_back_as_it_was(number, method, params):
    line = json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": params})
    if rpc._too_much(line.encode()) is None:
        assert only(line) == Call(number, method, params)


@given(VALUES)
def test_an_encoded_message_is_one_line_of_json(content):
    line = encode(content)
    assert line.count(b"\n") == 1
    assert json.loads(line) == content


def test_numbers_that_json_lacks_become_null():
    assert json.loads(encode({"a": [math.nan, math.inf, 1.0], "b": (-math.inf,)})) == {
        "a": [None, None, 1.0],
        "b": [None],
    }


def test_data_of_an_error_is_there_when_it_is_something():
    assert "data" not in error_of(1, RpcError(rpc.REFUSED, "no"))["error"]
    assert error_of(1, RpcError(rpc.REFUSED, "no", {"state": "fault"}))["error"]["data"] == {"state": "fault"}


def depth(text: str) -> int:
    """Deepest nesting of brackets, character by character, strings not told apart."""
    deepest = now = 0
    for character in text:
        now = max(0, now + (character in "[{") - (character in "]}"))
        deepest = max(deepest, now)
    return deepest


@given(
    st.text("[]{}a", max_size=200) | st.lists(st.integers(1, 40)).map(lambda n: "".join("[" * k + "]" * k for k in n))
)
@example("[" * DEEPEST + "]" * DEEPEST)
@example("[" * (DEEPEST + 1) + "]" * (DEEPEST + 1))
@example("[]" * 1000 + "[" * (DEEPEST + 1))
def test_the_depth_is_never_taken_for_less_than_it_is(text):
    refused = rpc._too_much(text.encode()) is not None
    assert refused or depth(text) <= DEEPEST
    if refused:  # what closes before it opens, and what never closes, counts at most once more
        assert depth(text) + text.count("[") + text.count("{") > DEEPEST


def test_balanced_brackets_are_refused_exactly_beyond_the_limit():
    for inner in (DEEPEST, DEEPEST + 1):
        line = b"[" + b"[]," * 500 + b"[" * (inner - 1) + b"]" * (inner - 1) + b"]"
        assert (rpc._too_much(line) is None) == (inner == DEEPEST)


@pytest.mark.parametrize(
    "line",
    [
        b"[" + b",".join([b"1"] * rpc.MOST_VALUES) + b",1]",
        b"[" + b",".join([b"[]"] * rpc.MOST_VALUES) + b"]",
        b'{"jsonrpc":"2.0","method":"m","params":{"x":"' + b"[]" * 130_000 + b'"}}',
    ],
)
def test_a_line_of_more_values_than_a_request_has_is_not_parsed(line, monkeypatch):
    monkeypatch.setattr(rpc.json, "loads", lambda *_, **__: pytest.fail("parsed"))
    assert only(line)["error"]["message"].startswith(f"more than {rpc.MOST_VALUES} values")


def test_a_model_file_and_a_profile_of_thousands_of_points_pass():
    points = [[0.01 * k, 1.5] for k in range(3000)]
    assert only(json.dumps({"jsonrpc": "2.0", "id": 1, "method": "start", "params": {"points": points}})).params
    text = "effects: [{name: cogging, parameters: {order: {value: 6, sd: 0.1}}}]\n" * 800
    assert only(json.dumps({"jsonrpc": "2.0", "id": 1, "method": "model", "params": {"text": text}})).params


@pytest.mark.parametrize(
    ("line", "key"),
    [
        ('{"jsonrpc":"2.0","id":1,"method":"info","method":"stop"}', "method"),
        ('{"jsonrpc":"2.0","id":1,"method":"set","params":{"key":"a","value":1,"value":2}}', "value"),
        ('[{"jsonrpc":"2.0","id":1,"id":2,"method":"info"}]', "id"),
        ('{"jsonrpc":"2.0","method":"m","params":{"a":{"b":[{"c":1,"c":1}]}}}', "c"),
    ],
)
def test_a_key_that_stands_twice_refuses_the_whole_line(line, key):
    item = only(line)
    assert item["error"] == {"code": rpc.INVALID_REQUEST, "message": f"{key!r} is given twice in one object"}


@pytest.mark.parametrize("text", ["9" * 5000, "-" + "9" * 5000, '{"a": NaN}', "[1e999999999"])
def test_what_is_no_number_is_reported_in_our_words(text):
    message = only(text)["error"]["message"]
    assert "set_int_max_str_digits" not in message
    assert only(text)["error"]["code"] == rpc.PARSE_ERROR
