"""`run --profile FILE`: the profiles in configs/profiles are read, fit the example axis, and are run."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from fffo_drive.documents import DocumentError
from fffo_drive.workflows.plan import make_plan

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PROFILES = sorted((CONFIGS / "profiles").glob("*.yaml"))


@pytest.mark.parametrize("path", PROFILES, ids=lambda p: p.stem)
def test_a_profile_of_ours_fits_the_example_axis(path):
    plan = make_plan(CONFIGS / "axis_simulated.yaml", profile_file=path)
    assert plan.axis.profile.kind == {"short": "points"}.get(path.stem, path.stem)
    assert plan.profile.duration_s > 4.0


def test_there_is_a_file_for_each_profile_that_identifies():
    assert {path.stem for path in PROFILES} == {"identify", "frf", "recipe", "decide", "short"}


def test_a_mistake_in_a_profile_file_is_named_with_its_line(tmp_path):
    wrong = tmp_path / "profile.yaml"
    wrong.write_text("profile:\n  kind: recipe\n  high_rpm: 14\n")
    with pytest.raises(DocumentError, match=r"profile\.yaml:3.*high_rpm"):
        make_plan(CONFIGS / "axis_simulated.yaml", profile_file=wrong)


def test_an_axis_file_in_place_of_a_profile_is_named_as_such():
    axis = CONFIGS / "axis_bench.yaml"
    with pytest.raises(DocumentError) as error:
        make_plan(CONFIGS / "axis_simulated.yaml", profile_file=axis)
    (said,) = str(error.value).splitlines()  # not a line for each of its keys
    assert re.search(r"axis_bench\.yaml:\d+: format: fffo_drive/axis/2 where a file with only a `profile:`", said)


def test_the_short_profile_runs_each_speed_both_ways_for_as_long():
    """Then both directions have the same history, and nothing but a constant torque looks like one."""
    plan = make_plan(CONFIGS / "axis_simulated.yaml", profile_file=CONFIGS / "profiles" / "short.yaml")
    points = np.array(plan.axis.profile.points)
    held = {}
    for (begin_s, speed), (end_s, after) in itertools.pairwise(points):
        if speed == after and speed:
            held[speed] = held.get(speed, 0.0) + end_s - begin_s
    assert len(held) == 6
    for speed, time_s in held.items():
        assert held[-speed] == pytest.approx(time_s)
