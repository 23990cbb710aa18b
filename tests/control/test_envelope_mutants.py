"""The table of mutants is the one of this envelope; a sample of it is run (`.ci/run` runs all)."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from control.mutants import EQUIVALENT, SOURCE, TABLE, make_table
from control.mutation import mutants_of

EVERY = 23


def test_the_table_is_of_this_envelope():
    mutants = mutants_of(SOURCE.read_text(encoding="utf-8"))
    names = [mutant.name for mutant in mutants]
    assert len(set(names)) == len(names)
    survivors = [name for name in names if name in EQUIVALENT]
    assert len(survivors) == len(EQUIVALENT)
    assert TABLE.read_text(encoding="utf-8") == make_table(len(names), survivors)


def test_mutants_are_other_programs_than_the_original_in_one_place():
    source = "def f(a):\n    if a < 3 and not a:\n        a |= 4\n    return min(a, -1.5)\n"
    mutants = mutants_of(source)
    texts = {mutant.source for mutant in mutants}
    assert len(texts) == len(mutants)
    for expected in (
        "a <= 3",
        "a > 3",
        "a < 4",
        "a < 2",
        "or not a",
        "if True",
        "a &= 4",
        "pass",
        "max(a",
        "min(a, 1.5)",
    ):
        assert any(expected in text for text in texts), expected
    assert all(compile(text, "mutant", "exec") for text in texts)


@pytest.mark.slow
def test_a_sample_of_the_mutants_is_noticed():
    environment = dict(os.environ, NUMBA_DISABLE_JIT="1", PYTHONPATH=str(Path(__file__).resolve().parents[1]))
    done = subprocess.run(
        [sys.executable, "-m", "control.mutants", str(EVERY)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert re.match(r"\d+ of \d+ mutants ran", done.stdout)
