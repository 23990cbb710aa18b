"""What a viewer reads whose request is wrong: the parameter, what is wanted there with its range, what came."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fffo_drive.daemon.clients import ENDING
from fffo_drive.daemon.parameters import METHODS
from fffo_drive.live.keys import Keys
from fffo_drive.live.services import MethodKind, RefusedCallError, Services

KEY = "k" * 32
SERVICES = Services(METHODS, Keys(KEY))
NUMBER = {service.name.removeprefix("/fffo_drive/"): service.id for service in SERVICES.offered()}


def outcome(name, params):
    """The request that is let through, or the words of the refusal."""
    key_name = "access_key" if name == "set" else "key"  # it has a parameter `key`
    try:
        return SERVICES.checked(NUMBER[name], json.dumps({key_name: KEY, **params}).encode())
    except RefusedCallError as error:
        return str(error)


def refusal(name, **params):
    problem = outcome(name, params)
    assert isinstance(problem, str)
    return problem


@pytest.mark.parametrize("name", [*ENDING, "enable", "start", "reset_fault"])
@pytest.mark.parametrize(
    ("value", "problem"),
    [("x", "(got 'x')"), ("1", "(got '1')"), (True, "(got true)"), (-1, "(got -1)"), (601, "(got 601)"), ([], "")],
)
def test_a_wait_is_a_number_in_its_range(name, value, problem):
    profile = {"profile": "default"} if name == "start" else {}
    expected = f"{name}: wait_s: a number from 0 to 600 is needed {problem}".rstrip() + " (parameters: "
    assert refusal(name, wait_s=value, **profile).startswith(expected)


@pytest.mark.parametrize(
    ("name", "params", "problem"),
    [
        ("stop", {"bogus": 1}, "bogus: unknown parameter"),
        ("toggle", {"to": "x"}, "to: 'ff', 'fb' or 'off' is needed (got 'x')"),
        ("toggle", {}, "to: missing"),
        ("events", {"limit": 0}, "limit: a number from 1 to 1000 is needed (got 0)"),
        ("enable", {"hold": 1}, "hold: true or false is needed (got 1)"),
        ("start", {}, "profile: missing"),
        (
            "start", {"profile": 3},
            "profile: text is needed (in quotes, where it looks like something else) (got 3); "
            "profile: a mapping of keys to values is needed (got 3)",
        ),
        (
            "start", {"profile": {"kind": "x"}},
            "profile.kind: 'x' is none of 'paper', 'sine', 'points', 'identify', 'frf', 'recipe', 'decide'",
        ),
        (
            "start", {"profile": {"kind": "sine", "duration_s": 1e6, "amplitude": 1}},
            "profile.duration_s: a number above 0 and up to 86400 is needed (got 1000000.0); "
            "profile.frequency_hz: missing",
        ),
        (
            "start", {"profile": {"kind": "points", "points": [[0, 0], ["a", 1]]}},
            "profile.points.1.0: a number is needed (got 'a')",
        ),
        (
            "start", {"profile": {"kind": "points", "points": [[0, 0], [0, 1]]}},
            "profile.points: times must start at 0 and rise from point to point",
        ),
        (
            "set", {"key": "a", "value": "x"},
            "value: a number is needed (got 'x'); value: true or false is needed (got 'x')",
        ),
    ],
)  # fmt: skip
def test_each_wrong_parameter_is_named_with_what_is_wanted(name, params, problem):
    assert refusal(name, **params).startswith(f"{name}: {problem} (parameters: ")


def test_what_ends_a_motion_is_what_the_daemon_takes_for_a_stop_on_arrival():
    assert {name for name in NUMBER if SERVICES.kind(name) is MethodKind.ENDS} == set(ENDING)


def test_what_is_right_goes_through_as_it_came():
    sine = {"kind": "sine", "duration_s": 1, "amplitude": 1, "frequency_hz": 1}
    checked = SERVICES.checked(NUMBER["start"], json.dumps({"key": KEY, "profile": sine}).encode())
    who = {"who": "role tune"}
    assert checked == ("start", {"profile": sine, **who}, MethodKind.COMMANDS)
    assert outcome("set", {"key": "a", "value": 1.5}) == ("set", {"key": "a", "value": 1.5, **who}, MethodKind.COMMANDS)
    assert SERVICES.checked(NUMBER["status"], b"") == ("status", {}, MethodKind.LOOKS)
    assert SERVICES.checked(NUMBER["stop"], b'{"key": "%s", "wait_s": 0}' % KEY.encode()).kind is MethodKind.ENDS


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5)
    | st.sampled_from(["sine", "points", "kind", "default"]),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.sampled_from(["kind", "points", "mode", "x"]) | st.text(max_size=3), inner, max_size=4),
    max_leaves=8,
)  # fmt: skip


@given(
    name=st.sampled_from(sorted(NUMBER)), value=JSON, parameter=st.sampled_from(["profile", "wait_s", "value", "to"])
)
@settings(max_examples=200, derandomize=True, deadline=None)
def test_whatever_comes_is_let_through_or_refused_in_words(name, value, parameter):
    found = outcome(name, {parameter: value})
    if not isinstance(found, str):
        assert found.params == {parameter: value}
        return
    assert parameter in found
    for word in ("Error", "nput should", "pydantic", "tagged-union"):
        assert word not in found.replace(json.dumps(value)[:40], "")


@given(payload=st.binary(max_size=60) | st.text(max_size=60).map(str.encode))
@settings(max_examples=200, derandomize=True, deadline=None)
def test_without_the_key_no_bytes_ask_for_more_than_looking(payload):
    for number in NUMBER.values():
        try:
            assert SERVICES.checked(number, payload).kind is MethodKind.LOOKS
        except RefusedCallError:
            continue
