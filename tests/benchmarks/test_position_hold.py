"""The benchmark of the hold at rest: what counts as creep, and a sample of the whole on one axis."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "tools" / "benchmarks"
CREEP = """
import json
import numpy as np
from chain import COUNTS_PER_REV, crept_counts
period_s, counts = 5e-4, 37.0
time_s = period_s * np.arange(17_000)
shaken = []
for phase_rev in np.linspace(0.0, 1.0, 16, endpoint=False):
    angle = 2.0 * np.pi * (7.3 * time_s + phase_rev)
    shaken.append(crept_counts(2.0 * np.pi * 7.3 * counts / COUNTS_PER_REV * np.cos(angle), 3200, period_s))
steady = crept_counts(np.full(17_000, 2.0 / COUNTS_PER_REV), 3200, period_s)
jump = np.zeros(17_000)
jump[8000] = 6.0 / COUNTS_PER_REV / period_s
print(json.dumps({"shaken": max(shaken), "steady": steady, "jump": crept_counts(jump, 3200, period_s)}))
"""


def python(*arguments: str) -> dict:
    """What it printed, in a process of its own, as from a terminal."""
    inherited = {name: value for name, value in os.environ.items() if name != "NUMBA_DISABLE_JIT"}
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, timeout=560, cwd=BENCHMARKS, env=inherited
    )
    assert done.returncode == 0, done.stderr
    found: dict = json.loads(done.stdout)
    return found


def test_a_periodic_disturbance_is_no_creep_but_a_drift_and_a_slip_are():
    found = python("-c", CREEP)
    assert found["shaken"] < 0.5  # 37 counts to each side, at any phase
    assert found["steady"] == pytest.approx(10.0)  # two counts a second for five seconds
    assert found["jump"] == pytest.approx(6.0)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_every_variant_of_the_hold_runs_on_an_axis():
    facts = python(str(BENCHMARKS / "position_hold.py"), "--sample", "--first", "6001", "--json")
    assert facts["axes"] == 1
    assert set(facts["variants"]) >= {"not held", "gain 1", "travel 1", "travel 128"}
    for figures in facts["variants"].values():
        assert all(math.isfinite(value) for values in figures.values() for value in values)
    held, free = (facts["variants"][name] for name in ("gain 1", "not held"))
    assert held["creep_counts"][0] < 5.0
    assert held["load_counts"][0] < free["load_counts"][0]
