"""The bootstrap of ratios: known ratios are inside, pairing helps, short runs get none."""

import numpy as np
import pytest

from fffo_drive.report.intervals import LEAST_STRETCHES, ratio_intervals

AGAINST = {"ise": "b", "mae": "b", "std": "b"}


def errors(n, seed=0):
    """Errors whose size changes along the run, common to both, with a ratio of 2 between them."""
    rng = np.random.default_rng(seed)
    size = np.repeat(rng.uniform(0.1, 3.0, n // 100), 100)
    return {"a": 2.0 * size * rng.normal(size=n), "b": size * rng.normal(size=n)}


def test_a_known_ratio_lies_inside_and_the_interval_is_narrow_because_runs_are_paired():
    found = ratio_intervals(errors(40_000), AGAINST, 1000)["a"]
    for metric, ratio in (("ise", 4.0), ("mae", 2.0), ("std", 2.0)):
        assert found[metric].low < ratio < found[metric].high
        assert found[metric].high / found[metric].low < 1.25


def test_intervals_cover_the_truth_as_often_as_they_say():
    inside = [
        end.low <= 2.0 <= end.high
        for seed in range(60)
        for end in [ratio_intervals(errors(20_000, seed), AGAINST, 500, draws=400)["a"]["mae"]]
    ]
    assert 0.85 <= np.mean(inside) <= 1.0


def test_a_run_against_itself_is_exactly_one():
    for end in ratio_intervals(errors(40_000), AGAINST, 1000)["b"].values():
        assert end == (1.0, 1.0)


def test_missing_samples_do_not_bias_the_ratio():
    runs = errors(40_000)
    runs["a"][::3] = np.nan
    end = ratio_intervals(runs, AGAINST, 1000)["a"]["ise"]
    assert end.low < 4.0 < end.high


def test_too_short_a_run_has_no_interval():
    assert ratio_intervals(errors(1000), AGAINST, 1000 // (LEAST_STRETCHES - 1)) == {}


def test_seeded():
    runs = errors(20_000)
    assert ratio_intervals(runs, AGAINST, 500) == ratio_intervals(runs, AGAINST, 500)
    assert pytest.approx(1.0) != ratio_intervals(runs, AGAINST, 500)["a"]["ise"].low
