"""The table of bad days, made by living through them: `tools/bad_days_table` writes it; a test holds it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from interpreted import hex_results

from fffo_drive.control.envelope import TRIP_NONE, TRIP_TEXTS

TABLE = Path(__file__).resolve().parents[2] / "tools" / "tables" / "bad_days.md"
HEAD = """\
# Bad days of the loop

Made by `tools/bad_days_table` on a fake clock: 480 ticks of 0.5 ms; each event begins at tick 200. `fffo-drive run`
and `bench` report every count under its name (`--json`: `ticks`). In no case is torque commanded after a trip.

| what happens | counted as | what the loop does |
| --- | --- | --- |
"""


def row(day: dict[str, Any]) -> str:
    """One line of the table."""
    counts = ", ".join(f"`{name}` {count}" for name, count in day["counts"].items()) or "nothing"
    reaction = "goes on"
    if day["trip"] != TRIP_NONE:
        reaction = f"trips in tick {day['trip_tick']}: {TRIP_TEXTS[day['trip']]}"
    return f"| {day['happened'].rstrip('.')} | {counts} | {reaction} |"


def all_days() -> list[dict[str, Any]]:
    """Live through them in an interpreter without compilation."""
    days: list[Any] = hex_results("bad_days.loop_days", "run_all")
    return days


if __name__ == "__main__":
    TABLE.write_text(HEAD + "\n".join(map(row, all_days())) + "\n", encoding="utf-8")
