"""Parameters of the API are what they look like: no text, true or null for a number; refused with key and range."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.config.axis import controller_config
from fffo_drive.daemon import parameters as p
from fffo_drive.daemon import settings
from fffo_drive.daemon.parameters import METHODS, PROTOCOLS, agreed_protocol
from fffo_drive.daemon.rpc import INVALID_PARAMS, RpcError
from fffo_drive.daemon.server import _checked
from fffo_drive.daemon.states import Change
from fffo_drive.documents import DocumentError
from fffo_drive.workflows.plan import make_plan

SINE = {"kind": "sine", "duration_s": 5, "amplitude": 1, "frequency_hz": 1}


@pytest.mark.parametrize(
    ("method", "given", "said"),
    [
        ("stop", {"wait_s": "1"}, "wait_s: a number from 0 to 600 is needed (got '1')"),
        ("stop", {"wait_s": True}, "wait_s: a number from 0 to 600 is needed (got true)"),
        ("stop", {"wait_s": None}, "wait_s: a number from 0 to 600 is needed (got null)"),
        ("stop", {"wait_s": 601}, "wait_s: a number from 0 to 600 is needed (got 601)"),
        ("stop", {"bogus": 1}, "bogus: unknown parameter"),
        ("enable", {"hold": 1}, "hold: true or false is needed (got 1)"),
        ("enable", {"hold": "true"}, "hold: true or false is needed (got 'true')"),
        ("events", {"limit": 2.5}, "limit: a whole number from 1 to 1000 is needed (got 2.5)"),
        ("events", {"limit": 20.0}, "limit: a whole number from 1 to 1000 is needed: write 20 (got 20.0)"),
        ("events", {"since": False}, "since: a whole number from 0 up is needed (got false)"),
        ("subscribe", {"status_hz": "20"}, "status_hz: a number from 0 to 50 is needed (got '20')"),
        ("toggle", {"to": "on"}, "to: 'ff', 'fb' or 'off' is needed (got 'on')"),
        ("set", {"key": "k", "value": "1"}, "value: a number is needed (got '1')"),
        ("set", {"key": 1, "value": 1}, "key: text is needed"),
        ("start", {}, "profile: missing"),
        ("start", {"profile": SINE | {"duration_s": True}}, "profile.duration_s: a number above 0 and up to 86400"),
        ("start", {"profile": SINE | {"amplitude": "2"}}, "profile.amplitude: a number above 0 and up to 1000"),
        ("start", {"profile": SINE | {"amplitud": 2}}, "profile.amplitud: unknown parameter"),
        ("start", {"profile": {"kind": "sin"}}, "profile.kind: 'sin' is none of 'paper', 'sine'"),
        ("start", {"profile": {"kind": "points", "points": [[0, 0], [1, True]]}}, "profile.points.1.1: a number"),
        ("model", {"text": "x" * 200_001}, "text: at most 200000 characters are allowed"),
    ],
)
def test_what_is_no_number_is_refused_with_key_and_range(method, given, said):
    with pytest.raises(RpcError) as caught:
        _checked(METHODS[method].parameters, given)
    assert caught.value.code == INVALID_PARAMS
    assert caught.value.message.startswith(said)
    assert "Input should" not in caught.value.message
    assert len(caught.value.message) < 500


def test_whole_numbers_are_numbers_and_lists_are_points():
    assert _checked(p.Ending, {"wait_s": 1}) == p.Ending(wait_s=1.0)
    points = _checked(p.Start, {"profile": {"kind": "points", "points": [[0, 0], [1, 2]]}})
    assert points.profile.points == [(0.0, 0.0), (1.0, 2.0)]


def plan_with_a_notch(tmp_path):
    from bad_input.cases import AXIS, DRIVE, FILES, MODEL

    for name in (AXIS, DRIVE, MODEL):
        text = (FILES / name).read_text()
        (tmp_path / name).write_text(
            text.replace("controller:\n", "controller:\n  notches: [{frequency_hz: 180, width: 0.3}]\n")
        )
    return make_plan(tmp_path / AXIS)


def test_a_notch_is_set_live_and_one_that_is_not_there_is_not(tmp_path):
    plan = plan_with_a_notch(tmp_path)
    key = "controller.notches.0.frequency_hz"
    assert key in settings.live_keys(plan.axis)
    assert settings.change_of(plan.axis, key) is Change.GAINS
    assert settings.value_of(plan.axis, key) == 180.0
    changed = settings.with_value(plan, plan.toggle, key, 170.0)
    assert settings.value_of(changed.axis, key) == 170.0
    assert controller_config(changed.axis, changed.model).notches != controller_config(plan.axis, plan.model).notches
    with pytest.raises(DocumentError, match=r"notches\.1\.depth: no key that may be set"):
        settings.change_of(plan.axis, "controller.notches.1.depth")


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("controller.proportional_a_per_rps", True, "proportional_a_per_rps: a number above 0 and up to 10000"),
        ("controller.observer.clamp_ratio", False, "observer.clamp_ratio: a number from 1 to 10 is needed (got false)"),
        ("controller.feedforward.inertia", 1.0, "feedforward.inertia: true or false is needed (got 1.0)"),
        ("controller.notches.0.depth", 1.0, "notches.0.depth: a number from 0 to 0.95 is needed (got 1.0)"),
        ("controller.notches.0.frequency_hz", 900.0, "notches.0.frequency_hz: 900 Hz; at most 800 Hz is possible"),
    ],
)
def test_set_takes_no_switch_for_a_number_and_no_value_out_of_range(tmp_path, key, value, said):
    plan = plan_with_a_notch(tmp_path)
    with pytest.raises(DocumentError) as caught:
        settings.with_value(plan, plan.toggle, key, value)
    assert said in str(caught.value)


def test_the_versions_of_the_api_are_agreed_on():
    assert agreed_protocol(None) == PROTOCOLS[-1]
    assert agreed_protocol(1) == 1
    assert agreed_protocol([7, 1, 3]) == 1
    for spoken in (0, 2, [2, 3]):
        with pytest.raises(DocumentError, match="this daemon speaks 1 of its API, the client "):
            agreed_protocol(spoken)


@given(st.lists(st.integers(0, 6), min_size=1), st.lists(st.integers(0, 6), min_size=1, unique=True).map(sorted))
def test_the_newest_that_both_speak_is_taken(spoken, ours):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(p, "PROTOCOLS", tuple(ours))
        if set(spoken) & set(ours):
            assert agreed_protocol(spoken) == max(set(spoken) & set(ours))
        else:
            with pytest.raises(DocumentError):
                agreed_protocol(spoken)
