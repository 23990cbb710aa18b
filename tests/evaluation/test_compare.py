"""Intervals that hold what they promise, and the order of a comparison."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fffo_drive.control.envelope import TRIP_NONE, TRIP_OVERSPEED
from fffo_drive.evaluation.campaign import Evaluation
from fffo_drive.evaluation.compare import compare_metric, mean_interval, ratio_interval
from fffo_drive.evaluation.measures import Yardstick, measure
from fffo_drive.evaluation.summary import as_object, summarise
from fffo_drive.evaluation.trace import Trace
from fffo_drive.evaluation.workers import over_cores


def test_the_interval_of_a_mean_covers_it_as_often_as_it_says():
    rng = np.random.default_rng(4)
    inside = sum(low <= 5.0 <= high for _, low, high in (mean_interval(rng.normal(5.0, 2.0, 10)) for _ in range(2000)))
    assert inside / 2000 == pytest.approx(0.95, abs=0.015)


def test_what_cannot_be_negative_has_no_interval_below_zero():
    few = np.array([0.001, 0.03, 0.002])
    value, low, high = mean_interval(few)
    assert 0.0 < low < value < high
    near = mean_interval(few + 10.0)  # where the scatter is small it is Student's
    assert near.value - near.low == pytest.approx(near.high - near.value, rel=0.01)
    assert mean_interval(few - 0.01).low < 0.0
    assert mean_interval(np.array([0.0, 6.0, 0.0])).low == 0.0  # reversals missed, by seed


def test_a_common_factor_of_paired_runs_leaves_the_ratio_alone():
    """Seeds scale both controllers: the means scatter, the ratio does not."""
    scale = np.random.default_rng(5).uniform(0.2, 5.0, 10)
    ratio = ratio_interval(0.3 * scale, scale)
    assert ratio.value == pytest.approx(0.3)
    assert ratio.high - ratio.low < 1e-12
    wide = mean_interval(scale)
    assert wide.high - wide.low > 1.0


def test_one_seed_has_no_interval():
    assert math.isnan(mean_interval(np.array([1.0])).low)
    assert math.isnan(ratio_interval(np.array([1.0]), np.array([2.0])).high)


def test_per_cent_is_of_the_smallest_unless_a_base_is_named():
    values = {"a": np.array([2.0, 4.0]), "b": np.array([1.0, 2.0])}
    found = compare_metric(values)
    assert (found.base, found.percent["a"].value, found.percent["b"].value) == ("b", pytest.approx(200.0), 100.0)
    assert compare_metric(values, "a").percent["b"].value == pytest.approx(50.0)
    assert compare_metric(values, "not there").base == "b"


def evaluation(name: str, seed: int, error_rps: float, trip: int = TRIP_NONE) -> Evaluation:
    reference = np.sin(0.01 * np.arange(4000) + seed)
    trace = Trace(5e-4, reference, reference - error_rps, reference - 0.1 * error_rps, reference)
    measures = measure([trace], Yardstick((0.0, 1000.0), np.linspace(-1.0, 1.0, 21)))
    return Evaluation(name, seed, trip, measures if trip == TRIP_NONE else None, ())


def test_a_seed_that_one_controller_did_not_finish_counts_for_nobody():
    runs = [evaluation(name, seed, error) for seed in (1, 2, 3) for name, error in (("pi", 0.2), ("ff", 0.1))]
    runs[2] = evaluation("pi", 2, 0.2, TRIP_OVERSPEED)
    summary = summarise(runs)
    assert summary.seeds == (1, 3)
    assert summary.failures == ("pi, seed 2: velocity beyond envelope.speed_limit_rps",)
    assert summary.figures["measured.mae"].percent["pi"].value == pytest.approx(200.0)
    assert summary.figure("true.mae", "ff") == pytest.approx(0.01)
    assert summary.histograms["true"]["ff"].sum() == 8000
    assert as_object(summary)["figures"]["measured.mae"]["ff"]["value"] == pytest.approx(0.1)


def test_nothing_to_compare_is_an_error_that_says_why():
    with pytest.raises(ValueError, match="pi, seed 1: velocity beyond"):
        summarise([evaluation("pi", 1, 0.1, TRIP_OVERSPEED)])


def _double(number: int) -> int:
    if number < 0:
        raise ValueError("below zero")
    return 2 * number


@pytest.mark.slow
def test_work_over_processes_comes_back_in_order_and_raises_what_they_raise():
    seen: list[int] = []
    assert over_cores(abs, range(-7, 0), 2, seen.append) == [7, 6, 5, 4, 3, 2, 1]
    assert seen[-1] == 7
    with pytest.raises(TypeError):
        over_cores(abs, ["a", 1], 2)


def test_work_in_this_process_is_the_same():
    assert over_cores(_double, range(4), 1) == [0, 2, 4, 6]
    with pytest.raises(ValueError, match="below zero"):
        over_cores(_double, [1, -1], 1)
