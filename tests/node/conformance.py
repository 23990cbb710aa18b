"""The conformance table, made by the tests: `tools/conformance_table` runs what is marked and writes it.

`python -m node.conformance`: runs every test with the marker `conformance`, and writes the table only if all passed.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from node.checklist import CHECKLIST, NOT_DONE

TESTS = Path(__file__).resolve().parents[1]
TABLE = TESTS.parent / "tools" / "tables" / "conformance.md"
HEAD = """\
# Conformance of the simulated drive

Made by `tools/conformance_table`: the rows of CiA 301 and CiA 402 that matter for a torque drive, each with the tests
that show it (`tools/test tests/TEST`). All of them passed when the table was written.
"""


class Claim(NamedTuple):
    """A test that is marked with a row."""

    standard: str
    row: str
    test: str  # the id that pytest takes, from tests/ on


def claims() -> list[Claim]:
    """All marks in the test files, by file and line."""
    return [claim for path in sorted(TESTS.glob("*/test_*.py")) for claim in _claims_of(path)]


def _claims_of(path: Path) -> Iterator[Claim]:
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            for standard, row in _marks(node):
                yield Claim(standard, row, f"{path.relative_to(TESTS).as_posix()}::{node.name}")


def _marks(node: ast.FunctionDef | ast.ClassDef) -> Iterator[tuple[str, str]]:
    for decorator in node.decorator_list:
        if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) == "pytest.mark.conformance":
            standard, *rows = [ast.literal_eval(argument) for argument in decorator.args]
            yield from ((standard, row) for row in rows)


def rows() -> list[tuple[str, str]]:
    """The checklist, flat."""
    return [(s, row) for s, sections in CHECKLIST.items() for section in sections.values() for row in section]


def problems(found: list[Claim]) -> list[str]:
    """What does not fit between checklist, reasons and marks."""
    shown = {(claim.standard, claim.row) for claim in found}
    known = rows()
    wrong = [
        f"{c.test} shows an unknown row: {c.standard}, {c.row!r}" for c in found if (c.standard, c.row) not in known
    ]
    for standard, row in known:
        if ((standard, row) in shown) == (row in NOT_DONE):
            wrong.append(
                f"{standard}, {row!r}: " + ("shown, and 'not done'" if row in NOT_DONE else "no test, no reason")
            )
    if len(set(known)) != len(known):
        wrong.append("a row stands in the checklist twice")
    return wrong + [f"a reason for an unknown row: {row!r}" for row in NOT_DONE if row not in {r for _, r in known}]


def table(found: list[Claim]) -> str:
    """The Markdown file."""
    parts = [HEAD]
    done = len(rows()) - len(NOT_DONE)
    parts.append(f"{done} of {len(rows())} rows are shown by {len({c.test for c in found})} tests.\n")
    for standard, sections in CHECKLIST.items():
        for section, section_rows in sections.items():
            parts.append(f"## {standard}: {section}\n\n| row | shown by |\n| --- | --- |")
            parts += [f"| {row} | {_evidence(standard, row, found)} |" for row in section_rows]
            parts.append("")
    return "\n".join(parts)


def _evidence(standard: str, row: str, found: list[Claim]) -> str:
    if row in NOT_DONE:
        return f"**not done**: {NOT_DONE[row]}"
    return "<br>".join(f"`{c.test}`" for c in found if (c.standard, c.row) == (standard, row))


def main() -> int:
    """The tool."""
    import pytest

    found = claims()
    for problem in problems(found):
        print(problem, file=sys.stderr)
    if problems(found):
        return 1
    files = sorted({str(TESTS / claim.test.partition("::")[0]) for claim in found})
    code = int(pytest.main(["-q", "-p", "no:cacheprovider", "-m", "conformance", *files]))
    if code == 0:
        TABLE.write_text(table(found), encoding="utf-8")
        print(f"wrote {TABLE.relative_to(TESTS.parent)}")
    return code


if __name__ == "__main__":
    sys.exit(main())
