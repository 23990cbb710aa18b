"""The table of mistakes, made by running them: `tools/bad_input_table` writes it, a test checks that it is current."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from bad_input.cases import CASES, Case, run_case, shown

TABLE = Path(__file__).resolve().parents[2] / "tools" / "tables" / "bad_input.md"
HEAD = """\
# Mistakes and their messages

Made by `tools/bad_input_table`, which runs every line; a test checks that it is current. Nothing moves in any of them:
neither torque nor Operation Enabled is ever requested. `axis.yaml` is an axis in process, `bus.yaml` one on CANopen.

| mistake | command | exit code | message |
| --- | --- | --- | --- |
"""


def row(case: Case, message: str) -> str:
    """One line of the table."""
    words = " ".join("loopback:PORT" if word == "BUS" else word for word in case.words)
    return f"| {case.mistake} | `fffo-drive {words}` | {case.code} | {shown(message)} |"


def make_table() -> str:
    """Run all cases; AssertionError for one whose exit code is not what it should be."""
    rows = []
    for case in CASES:
        with tempfile.TemporaryDirectory() as directory:
            result = run_case(case, Path(directory))
        assert result.code == case.code, (case.mistake, result)
        rows.append(row(case, result.message))
    return HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    TABLE.parent.mkdir(exist_ok=True)
    TABLE.write_text(make_table(), encoding="utf-8")
    print(f"{TABLE}: {len(CASES)} mistakes", file=sys.stderr)
