"""The last events: what clients cause is counted and reported once a second, and displaces nothing else."""

from __future__ import annotations

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.daemon.event_log import CAUSED_BY_CLIENTS, KEPT, EventLog
from fffo_drive.daemon.journal import Journal


class Log(EventLog):
    """On a clock that a test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.written = io.StringIO()
        super().__init__(Journal({}, self.written), clock=lambda: self.now_s)


@pytest.mark.parametrize("kind", CAUSED_BY_CLIENTS)
def test_a_flood_of_ten_minutes_displaces_nothing_and_is_counted(kind):
    log = Log()
    log.add("started", "seen before the flood")
    for second in range(600):
        for step in range(200):
            log.now_s = second + step / 200
            log.add(kind, f"cut off {step}")
    log.now_s = 601.0
    log.turn()
    for limit in (1, 10, KEPT):
        found = log.since(0, limit)
        assert len(found) <= limit
        assert [event["number"] for event in found] == sorted(event["number"] for event in found)
    assert any(event["text"] == "seen before the flood" for event in log.since(0, KEPT))
    lines = log.written.getvalue().splitlines()
    assert len(lines) <= 1 + 600 * (CAUSED_BY_CLIENTS[kind] + 1)
    assert f"{200 - CAUSED_BY_CLIENTS[kind]} more in a second, the last: cut off 199" in log.written.getvalue()


def test_few_events_are_reported_as_they_happen():
    log = Log()
    for second, text in enumerate("abc"):
        log.now_s = float(second)
        log.add("client", text)
    assert [event["text"] for event in log.since(0, 10)] == ["a", "b", "c"]


@given(st.lists(st.sampled_from(["state", "fault", "command", "client"]), max_size=60), st.integers(1, 40))
def test_the_newest_are_reported_in_their_order_and_no_more_than_asked_for(kinds, limit):
    log = Log()
    for number, kind in enumerate(kinds):
        log.now_s = float(number)
        log.add(kind, str(number))
    found = log.since(0, limit)
    assert len(found) == min(limit, len(kinds))
    assert [event["number"] for event in found] == sorted({event["number"] for event in found})
