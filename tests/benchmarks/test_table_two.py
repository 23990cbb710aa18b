"""Table II over what the paper does not print: what a point changes, how the search steps, and a short run."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "tools" / "benchmarks"


def python(*arguments):
    """What it printed, in a process of its own, as from a terminal."""
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, cwd=BENCHMARKS, timeout=560)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


POINTS = """
import json, math
import numpy as np
from table_two import *

base = select_controllers(read_scenario(SCENARIO), [*OTHERS, BASE])
plain = base._replace(file=base.file.model_copy(update={
    "reference": base.file.reference.model_copy(update={"duration_s": PROJECT.length_s})}))
ours, files = case_of(scenario_of(base, PROJECT), 1), case_of(plain, 1)
half = case_of(scenario_of(base, PROJECT._replace(torque_constant_nm_per_a=0.074, delay_s=0.004)), 1)
rng = np.random.default_rng(1)
point, outside = PROJECT, []
for _ in range(300):
    point = step_from(point, 0.4, ("torque_constant_nm_per_a",), rng)
    outside += [name for name, (low, high) in (LOGARITHMIC | LINEAR).items()
                if name != "torque_constant_nm_per_a" and not low <= getattr(point, name) <= high]
series = details_of(SEEN)
own = np.ones((2, 4))
doubled = Found(SEEN, np.array([PAPER, 2.0 * PAPER]), own)
print(json.dumps({
    "same plant": ours.plant == files.plant,
    "same laws": ours.candidates == files.candidates,
    "same reference": bool((ours.profile.values == files.profile.values).all()),
    "acceleration of an ampere": [c.plant.torque_constant_nm_per_a / c.plant.inertia_kg_m2 for c in (files, half)],
    "later": [half.plant.delay_s - files.plant.delay_s, *(
        case_of(scenario_of(base, PROJECT._replace(delay_s=d, preview=True)), 1).candidates[2].controller.feedforward
        .ahead_ticks for d in (0.003, 0.004))],
    "outside": outside,
    "held": point.torque_constant_nm_per_a,
    "details": {name: [found._replace(**{name: getattr(SEEN, name)}) == SEEN for found in points]
                for name, points in series.items()},
    "with the best": [SEEN in points for points in series.values()],
    "factor": doubled.factor,
    "tripped": Found(SEEN, np.full((1, 8), math.nan), own).factor,
}))
"""


def test_a_point_changes_what_it_names_and_nothing_else():
    found = python("-c", POINTS)
    assert found["same plant"]
    assert found["same laws"]
    assert found["same reference"]
    # Gh / Th of the frequency response is held while Kt changes
    assert found["acceleration of an ampere"][1] == pytest.approx(found["acceleration of an ampere"][0], rel=1e-12)
    later_s, ahead, ahead_later = found["later"]
    assert later_s == pytest.approx(0.001)
    assert ahead_later - ahead == pytest.approx(2.0)  # periods of 0.5 ms: the law knows of the delay
    assert found["outside"] == []
    assert found["held"] == 0.148
    assert all(all(alone) and len(alone) > 1 for alone in found["details"].values())
    assert all(found["with the best"])
    assert found["factor"] == pytest.approx(2.0**0.5)
    assert found["tripped"] == float("inf")


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_short_search_comes_nearer_and_only_the_loop_in_nm_counts():
    facts = python("table_two.py", "--sample", "--json")
    project, nearest = (facts[f"worst factor of {name}, searched records"] for name in (
        "the project's scenario", "the nearest point"
    ))  # fmt: skip
    assert 1.0 < nearest < 0.5 * project
    # friction, inertia and gains in Nm are the same: Kt alone is a unit of the current, but for its noise and steps
    assert facts["worst factor with Kt 0.148 Nm/A and the same loop in Nm"] == pytest.approx(nearest, rel=0.02)
    for record in facts["project ratios"]:  # PI, then PI+FBFO: ISE, MAE, MAX, STD
        assert all(record[k] > record[4 + k] > 100.0 for k in (0, 1, 3))
