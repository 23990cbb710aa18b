"""What becomes of an asked set point before it reaches the loop: bounds of the axis file, and what is reported."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml
from daemon.rig import axis_file, edit
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.config.axis import read_axis
from fffo_drive.control.feedforward import FeedforwardConfig
from fffo_drive.control.set_point import preview_ticks
from fffo_drive.daemon import set_points
from fffo_drive.documents import DocumentError
from fffo_drive.workflows.plan import make_plan

KEYS = {"acceleration_rps2": 20, "jerk_rps3": 300, "jog_timeout_s": 0.4, "largest_rps": 10}


def plan_of(directory: Path, change=lambda axis: None, **keys):
    path = axis_file(directory, set_points={**KEYS, **keys}, stop_rps2=40)
    edit(path, change)
    return make_plan(path)


@given(st.floats(-5.0, 500.0))
def test_the_latency_that_is_reported_is_how_far_the_generator_is_ahead(ahead_ticks):
    config = FeedforwardConfig(0.0, ahead_ticks, 0.0)
    assert config.preview_ticks == preview_ticks(config) >= max(0.0, ahead_ticks)


def test_the_preview_is_reported_in_whole_periods_and_without_it_there_is_none(tmp_path):
    """Td of 2.75 ms, half a period's hold, less Ts of 0.7 ms: 3.05 ms at 500 Hz, two periods of 2 ms."""
    preview = plan_of(tmp_path / "a", lambda axis: axis["controller"].update(feedforward={"preview": True}))
    delay_s, sensor_s = preview.model.delay_s.value, preview.model.sensor_delay_s.value
    assert (delay_s, sensor_s) == (0.00275, 0.0007)
    assert set_points.latency_s(preview) == pytest.approx(0.004)
    without = plan_of(tmp_path / "b", lambda axis: axis["controller"].update(feedforward={"preview": False}))
    assert set_points.latency_s(without) == 0.0
    assert set_points.latency_s(plan_of(tmp_path / "c")) == set_points.latency_s(preview)  # it is the default


def test_what_is_asked_for_takes_its_bounds_from_the_axis_file(tmp_path):
    plan = plan_of(tmp_path)
    infinite = (-math.inf, math.inf)
    jog, velocity, step = (
        set_points.jog(plan, -2.5),
        set_points.velocity(plan, -2.5, None, False),
        set_points.step(plan, None, -3.0, 0.5, None, False),
    )
    for leased in (jog, velocity, step):  # 0.4 s at 500 Hz, then as an ordered stop
        assert leased.leased
        assert leased.set_point[:6] == (-2.5, 20.0, 300.0, 200, 0.0, 40.0)
        assert leased.set_point[6:8] == infinite
    runs_on, timed = set_points.velocity(plan, 3.0, None, True), set_points.velocity(plan, 3.0, 1.0, False)
    assert runs_on.set_point[:6] == (3.0, 20.0, 300.0, 0, 0.0, 20.0)
    assert timed.set_point.hold_ticks == 500
    # back to what may run on by itself, and to nothing else
    for before, after_rps in ((runs_on, 3.0), (timed, 0.0), (velocity, 0.0), (None, 0.0)):
        asked = set_points.step(plan, before, 3.0, -0.5, 2.0, False)
        assert asked.set_point[:6] == (2.5, 20.0, 300.0, 1000, after_rps, 20.0)
        assert not asked.leased
        assert set_points.step(plan, asked, 2.5, 1.0, 1.0, False).set_point.after_rps == after_rps
    for stands in (set_points.jog(plan, 0.0), set_points.velocity(plan, 0.0, None, False)):
        assert (stands.leased, stands.set_point.hold_ticks) == (False, 0)  # nobody has to renew a standstill
    assert set_points.standstill(plan).set_point[:6] == (0.0, 40.0, 300.0, 0, 0.0, 40.0)
    assert math.copysign(1.0, set_points.velocity(plan, -0.0, None, True).set_point.target_rps) == 1.0


def test_a_set_point_beyond_the_limit_is_refused_with_its_key(tmp_path):
    plan = plan_of(tmp_path / "a")
    with pytest.raises(DocumentError, match=r"step: 10\.5 rps is beyond daemon\.set_points\.largest_rps 10"):
        set_points.step(plan, None, 10.0, 0.5, None, False)
    plan = plan_of(tmp_path / "b", largest_rps=None)
    set_points.jog(plan, -25.0)
    with pytest.raises(DocumentError, match=r"jog: -25\.1 rps is beyond envelope\.speed_limit_rps 25"):
        set_points.jog(plan, -25.1)


@pytest.mark.parametrize(("margin_rev", "edges"), [(0.1, (-1.9, 2.9)), (3.0, (-1.5, 2.5))])
def test_the_margin_of_the_window_is_at_most_a_tenth_of_it(tmp_path, margin_rev, edges):
    window = {"position_window_rev": [-2.0, 3.0]}
    plan = plan_of(tmp_path, lambda axis: axis["envelope"].update(window), window_margin_rev=margin_rev)
    for asked in (set_points.jog(plan, 1.0), set_points.standstill(plan)):
        assert asked.set_point[6:8] == pytest.approx(edges)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"largest_rps": 26}, "daemon.set_points.largest_rps: it must not exceed envelope.speed_limit_rps"),
        ({"jerk_rps3": 0}, "jerk_rps3"),
        ({"jog_timeout_s": 11}, "jog_timeout_s"),
        ({"acceleration_rps": 3}, "acceleration_rps2"),
    ],
)
def test_a_wrong_key_is_reported_with_what_is_right(tmp_path, keys, words):
    path = axis_file(tmp_path, set_points={**KEYS, **keys})
    with pytest.raises(DocumentError, match=words) as error:
        read_axis(path)
    assert path.name in str(error.value)
    assert yaml.safe_load(path.read_text())["daemon"]["set_points"]
