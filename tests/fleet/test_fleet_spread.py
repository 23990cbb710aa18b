"""Populations: the spread between drives, and who stands outside, at the rate of false ones that the page says."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from fffo_drive.fleet.regress import PARAMETERS, UPPER, packed
from fffo_drive.fleet.schema import HIGHEST_ORDER, table_of
from fffo_drive.fleet.spread import LEAST_DRIVES, RESIDUAL, spreads_of

P = len(PARAMETERS)
BASE = np.array([1e-3, 3e-3, 0.025, 0.01, 0.002, 4e-4, 0.006, -0.004])
ROWS = 1000.0


def records(thetas, runs=2, rms=1e-3, model="m", own_sd=0.0, seed=0):
    """Records of drives with these parameters (d, p), each run estimating them with this share of noise."""
    draw = np.random.default_rng(seed)
    half = draw.standard_normal((200, P)) / BASE
    normal = half.T @ half
    rows = []
    for drive, theta in enumerate(thetas):
        for run in range(runs):
            parameters = theta * (1.0 + own_sd * draw.standard_normal(P))
            moment = normal @ parameters
            rows.append(
                {
                    "run": f"{model}{drive}.{run}", "model": model, "drive": f"d{drive}", "units": "rotary",
                    "start": datetime(2026, 1, 1 + run, tzinfo=UTC), "normal": packed(normal), "moment": moment,
                    "energy_nm2": float(parameters @ moment) + rms**2 * ROWS, "rows": ROWS, "effective_rows": ROWS,
                    "order_amplitude_nm": np.full(HIGHEST_ORDER, np.nan),
                }
            )  # fmt: skip
    return table_of(rows)


def drives(count, sd, seed):
    return BASE * (1.0 + sd * np.random.default_rng(seed).standard_normal((count, P)))


def test_the_spread_between_drives_is_found():
    (found,) = spreads_of([records(drives(400, 0.05, 1))])
    assert len(found.drives) == 400
    for k, name in enumerate(PARAMETERS):
        one = next(spread for spread in found.spreads if spread.name == name)
        assert one.median == pytest.approx(BASE[k], rel=0.02)
        assert one.spread == pytest.approx(0.05 * abs(BASE[k]), rel=0.2)
        assert one.low < one.median < one.high


def test_parts_in_any_order_give_the_same_as_the_whole():
    whole = records(drives(12, 0.05, 3), runs=3)
    (one,) = spreads_of([whole])
    order = np.random.default_rng(1).permutation(whole.num_rows)
    (other,) = spreads_of([whole.take(order[:10]), whole.take(order[10:25]), whole.take(order[25:])])
    assert other.drives == one.drives
    assert other.runs.tolist() == [3] * 12
    assert other.values == pytest.approx(one.values, rel=1e-9, nan_ok=True)
    assert (other.first_s.tolist(), other.last_s.tolist()) == (one.first_s.tolist(), one.last_s.tolist())


def test_models_are_populations_of_their_own():
    found = spreads_of([records(drives(6, 0.03, 1), model="a"), records(2.0 * drives(6, 0.03, 2), model="b")])
    assert [one.model for one in found] == ["a", "b"]
    assert not any(one.outsiders for one in found)


def test_a_drive_that_stands_outside_is_named_with_its_size():
    theta = drives(20, 0.03, 5)
    theta[7, 2] *= 1.6
    (found,) = spreads_of([records(theta)])
    furthest = found.outsiders[0]
    assert (furthest.drive, furthest.quantity) == ("d7", "coulomb_nm")
    assert furthest.value == pytest.approx(theta[7, 2])
    assert {one.drive for one in found.outsiders if one.quantity != RESIDUAL} == {"d7"}


@pytest.mark.parametrize("count", [6, 40])
def test_none_stands_outside_by_chance_more_often_than_is_said(count):
    """One number of a model in a hundred: 200 models of normal drives, eight numbers each."""
    models = [records(drives(count, 0.05, seed), runs=1, model=f"m{seed:03d}") for seed in range(200)]
    found = [one for spread in spreads_of(models) for one in spread.outsiders if one.quantity != RESIDUAL]
    numbers = {(one.drive, one.quantity, one.median) for one in found}
    assert len(numbers) <= 0.02 * 200 * P


def test_few_drives_are_no_population():
    theta = drives(LEAST_DRIVES - 1, 0.01, 1)
    theta[0] *= 3.0
    (found,) = spreads_of([records(theta)])
    assert found.outsiders == ()
    assert UPPER[0].size == P * (P + 1) // 2
