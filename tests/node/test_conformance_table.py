"""The committed table is what the tests say, and no row of the checklist is left open."""

from __future__ import annotations

from node.conformance import TABLE, claims, problems, table


def test_every_row_has_a_test_or_a_reason() -> None:
    assert problems(claims()) == []


def test_the_committed_table_is_that_of_the_marks() -> None:
    assert TABLE.read_text(encoding="utf-8") == table(claims()), "run tools/conformance_table"
