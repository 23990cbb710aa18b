"""Every mistake gives one clear message and its exit code, and nothing moves."""

from __future__ import annotations

import re

import pytest
from bad_input.cases import CASES, run_case
from bad_input.table import HEAD, TABLE, row


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.mistake)
def test_a_mistake_is_reported_and_nothing_moves(case, tmp_path):
    result = run_case(case, tmp_path)
    assert result.code == case.code, result.message
    for part in case.said:
        assert re.search(part, result.message, re.DOTALL), result.message
    assert "Traceback" not in result.message
    assert result.printed == ""
    assert result.provocations == ()
    assert result.left_behind == ()
    assert row(case, result.message) in TABLE.read_text(encoding="utf-8"), "write it again: tools/bad_input_table"


def test_the_table_holds_the_mistakes_and_nothing_else():
    text = TABLE.read_text(encoding="utf-8")
    assert text.startswith(HEAD)
    assert len(text.removeprefix(HEAD).splitlines()) == len(CASES)
    assert len({case.mistake for case in CASES}) == len(CASES)
