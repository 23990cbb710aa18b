"""The terminal view, from literal answers of the API."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from fffo_drive.cli.top import BARS, View, sparkline

INFO: dict[str, Any] = {"axis": "bench", "rate_hz": 2000}
OFFLINE: dict[str, Any] = {
    "state": "offline", "state_s": 3.0, "obstacles": ["no drive"], "fault": None, "toggle": "ff",
    "model": {"name": "table1", "hash": "cd59"}, "profile": None, "loop": None, "drive": None, "motion": None,
    "recording": {"on": False, "wanted": False, "file": None, "finished": [], "trouble": ""},
}  # fmt: skip


def running(tick: int, late: int, **changed: Any) -> dict[str, Any]:
    """A status while a profile runs."""
    return {
        **OFFLINE, "state": "running", "obstacles": [],
        "loop": {"tick": tick, "late": late, "skipped": 4, "missing_feedback": 2, "exchange": {"late_feedback": 2}},
        "drive": {"name": "servo", "state": "operation enabled", "statusword": 0x1237},
        "motion": {
            "velocity_rps": 1.5, "position_rev": 12.25, "current_a": 0.5, "current_command_a": 0.4,
            "reference_rps": 1.6, "error_rps": 0.1, "friction_nm": 0.03,
        },
        "profile": {"name": "paper", "sample": 500, "samples": 2000, "duration_s": 1.0},
        "recording": {**OFFLINE["recording"], "on": True, "file": "a.mcap", "rows_written": 99, "rows_lost": 1},
        **changed,
    }  # fmt: skip


def text_of(view: View) -> str:
    console = Console(width=120, force_terminal=False)
    with console.capture() as capture:
        console.print(view.page())
    return capture.get()


def test_a_daemon_without_a_drive_says_what_keeps_it():
    view = View(INFO)
    view.see(OFFLINE)
    page = text_of(view)
    assert "OFFLINE" in page
    assert "not ready: no drive" in page
    assert "velocity" not in page


def test_a_live_set_point_is_shown():
    view = View(INFO)
    view.see(running(10_000, 0, state="following", profile=None, set_point={"kind": "jog", "to_rps": -2.5}))
    page = text_of(view)
    assert "FOLLOWING" in page
    assert "jog to -2.5 rps" in page


def test_late_ticks_are_counted_over_what_is_shown():
    """12 late ones in 2000 ticks are 0.60 %, whatever was late before."""
    view = View(INFO)
    view.see(running(10_000, 500))
    view.see(running(12_000, 512))
    page = text_of(view)
    assert "12000, 512 late (0.60 % of the last 2000), 4 skipped" in page
    assert "paper, 25 % of 1.0 s" in page
    assert "a.mcap, 99 rows, 1 lost" in page


def test_another_connection_begins_the_count_anew():
    view = View(INFO)
    view.see(running(10_000, 500))
    view.see(running(100, 1))
    assert "of the last" not in text_of(view)


def test_a_fault_and_its_event_are_shown():
    view = View(INFO)
    fault = {"name": "speed", "text": "too fast", "tick": 77}
    view.see(running(10, 0, state="fault", fault=fault))
    view.hear({"time": "2026-01-01T10:00:00.123", "kind": "fault", "level": "error", "text": "too fast"})
    page = text_of(view)
    assert "FAULT" in page
    assert "fault: too fast (speed, tick 77)" in page
    assert "10:00:00.123 fault" in page


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=80))
def test_a_sparkline_has_a_bar_for_each_value(values: list[float]):
    line = sparkline(values)
    assert len(line) == len(values)
    assert set(line) <= set(BARS)


@pytest.mark.parametrize(("values", "line"), [([0.0, 0.0], "▁▁"), ([1.0, -8.0, math.nan], "▁█ ")])
def test_a_sparkline_shows_magnitudes(values: list[float], line: str):
    assert sparkline(values) == line
