"""A short sample of the comparison with peers: every law runs, on every plant, and the margins are those asked for."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "tools" / "benchmarks"
PEERS = {"2sep observer+", "lugre observer+", "lugre forward+", "gms forward+", "dob+", "eso+", "luenberger+"}
PLUS = "pi+fffo+"
VARIANTS = {f"{PLUS} {what}" for what in ("estimated", "second surface", "both", "both, 300 Hz")}
PLAIN = {"pi", "pi, all integral", "pi+inertia+preview", "drive 2 ms", "drive 1 ms"}
HELPED = {f"drive {delay_ms} ms + torque {rate_hz} Hz" for delay_ms in (1, 2) for rate_hz in (250, 1000)}
OWN = {"pi+fffo", PLUS, "lugre forward+ estimated", "gms forward+ estimated"} | VARIANTS
LAWS = PLAIN | HELPED | OWN | PEERS
PLANTS = ("five_surfaces", "single_2sep", "lugre", "maxwell_slip")


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_every_law_runs_on_every_plant_with_the_margins_that_were_asked_for():
    inherited = {name: value for name, value in os.environ.items() if name != "NUMBA_DISABLE_JIT"}
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / "control_peers.py"), "--sample", "--json"],
        capture_output=True, text=True, timeout=560, cwd=BENCHMARKS, env=inherited,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    phase_deg, gain = facts["asked"]
    assert (phase_deg, gain) == (45.0, 2.5)  # as tune asks for where nobody says otherwise
    for found in facts["margins"].values():
        assert found[0] >= phase_deg
        assert found[1] >= gain
    # what has no model of the reference ahead is far behind what has one, on every plant
    for plant in PLANTS:
        for slope in ("0", "-0.5"):
            ises = facts[f"{plant}, slope {slope}"]
            assert set(ises) == LAWS | {"typed"}
            assert all(math.isfinite(ise) and ise > 0.0 for ise in ises.values())
            assert ises["pi+fffo+"] < 0.1 * ises["pi+fffo"] < 0.1 * ises["pi"]
            assert all(ises[PLUS] < ises[law] for law in PLAIN - {"drive 1 ms"})
        assert set(facts["axes"][plant]) == LAWS
        assert set(facts["axes"][plant].values()) == {1}
    # each model is at home on its own plant
    for plant, place in (("single_2sep", 0), ("lugre", 1), ("maxwell_slip", 2)):
        left = facts["left"][plant]
        assert left[place] == min(left[:3]) < 0.05
    for left in facts["left"].values():
        assert left[3] <= left[0]  # two surfaces contain one
