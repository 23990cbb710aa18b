"""Normal equations of runs: they add up to the fit on all rows, and say honestly what they know."""

from __future__ import annotations

import operator

import numpy as np
import pytest
from fleet.fleet_rig import FACTS, TRUTH, motion, torque_nm
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.fleet.regress import (
    COULOMB,
    EXCESS,
    OFFSET,
    PARAMETERS,
    Balance,
    balance_columns,
    balance_of,
    explained_by,
    packed,
    solve,
    unpacked,
)
from fffo_drive.identification.rows import RegressionRows


def rows_of(seed, noise_nm=0.0, memory=0.0, truth=None, one_way=False, duration_s=8.0):
    """Rows as if the filter had taken nothing; noise is an autoregression with this memory."""
    _, position, velocity, acceleration = motion(seed, duration_s)
    if one_way:
        velocity = np.abs(velocity) + 0.5
    torque = torque_nm(position, velocity, acceleration, TRUTH if truth is None else truth)
    white = np.random.default_rng(seed + 77).standard_normal(torque.size) * np.sqrt(1.0 - memory**2)
    noise = np.zeros(torque.size)
    last = white[0] / np.sqrt(1.0 - memory**2)
    for k in range(torque.size):
        last = memory * last + white[k]
        noise[k] = last
    size = torque.size
    return RegressionRows(
        np.zeros(size, dtype=np.int64), position, velocity, acceleration, np.sign(velocity), torque + noise_nm * noise,
        np.abs(velocity) > 0.05, ((0, size),), 1.0 / 500.0, 1e6,
    )  # fmt: skip


def balance(rows):
    return balance_of(balance_columns(rows, FACTS), rows)


@given(
    seeds=st.lists(st.integers(0, 10_000), min_size=1, max_size=5, unique=True),
    noise_nm=st.sampled_from([1e-4, 2e-3, 0.05]),
)
def test_records_of_an_axis_add_up_to_the_fit_on_all_of_its_rows(seeds, noise_nm):
    runs = [rows_of(seed, noise_nm, duration_s=3.0) for seed in seeds]
    total = balance(runs[0])
    for run in runs[1:]:
        total = Balance(*map(operator.add, total, balance(run)))
    columns = np.concatenate([balance_columns(run, FACTS)[run.sliding] for run in runs])
    target = np.concatenate([run.torque_nm[run.sliding] for run in runs])
    wanted, *_ = np.linalg.lstsq(columns, target, rcond=None)
    found = solve(total)
    scale = np.linalg.norm(columns, axis=0)
    assert np.abs((found.theta - wanted) * scale).max() <= 1e-7 * np.linalg.norm(target)
    left_nm2 = float(np.mean((target - columns @ wanted) ** 2))
    # a difference of sums of squares: its error is a share of the whole, not of what is left
    assert found.rms_nm**2 == pytest.approx(left_nm2, rel=1e-6, abs=1e-9 * float(np.mean(target**2)))


def test_a_normal_matrix_comes_back_from_its_triangle():
    normal = balance(rows_of(1, 1e-3)).normal
    assert np.array_equal(unpacked(packed(normal)), normal)
    both = np.stack([packed(normal), packed(2.0 * normal)])
    assert np.array_equal(unpacked(both)[1], 2.0 * normal)


def test_the_truth_is_found_where_nothing_disturbs():
    found = solve(balance(rows_of(3)))
    assert found.theta == pytest.approx(np.array(list(TRUTH.values())), rel=1e-6)


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_intervals_cover_the_truth_also_where_rows_resemble_their_neighbours(memory):
    truth = np.array(list(TRUTH.values()))
    scores = np.array([_score(seed, memory, truth) for seed in range(150)])
    spread = float(np.sqrt(np.mean(scores**2)))
    assert 0.8 < spread < 1.35  # of errors over their standard deviations: 1 is honest


def _score(seed, memory, truth):
    found = solve(balance(rows_of(seed, 5e-3, memory, duration_s=30.0)))
    return (found.theta - truth) / found.sd


def test_information_is_the_inverse_of_the_covariance_and_grows_with_the_runs():
    one = solve(balance(rows_of(5, 2e-3)))
    assert np.sqrt(np.diag(np.linalg.inv(one.information))) == pytest.approx(one.sd, rel=1e-6)
    first = balance(rows_of(5, 2e-3))
    both = solve(Balance(*map(operator.add, first, first)))
    assert both.sd == pytest.approx(one.sd / np.sqrt(2.0), rel=1e-3)


def test_what_one_direction_cannot_tell_apart_is_not_claimed():
    rows = rows_of(2, 1e-3, one_way=True)
    found = solve(balance(rows))
    assert np.isnan(found.sd[[OFFSET, EXCESS]]).all()
    assert found.information[OFFSET, OFFSET] == 0.0
    assert np.isfinite(found.theta).all()
    assert np.isfinite(found.sd[COULOMB])


def test_gravity_needs_an_angle_that_is_the_same_in_every_run():
    rows = rows_of(2, 1e-3)
    free = FACTS.model_copy(update={"absolute_angle": False})
    assert not balance_columns(rows, free)[:, PARAMETERS.index("gravity_cos_nm") :].any()


def test_a_rung_explains_what_it_stands_for():
    rows = rows_of(4, 1e-3)
    assert explained_by(balance(rows), (OFFSET,)) > 0.5
    none = rows_of(4, 1e-3, truth=TRUTH | {"offset_nm": 0.0})
    assert explained_by(balance(none), (OFFSET,)) < 0.01


def test_hardly_any_row_is_no_error():
    empty = Balance(np.zeros((8, 8)), np.zeros(8), 0.0, 0.0, 0.0)
    found = solve(empty)
    assert found.rms_nm == 0.0
    assert np.isnan(found.sd).all()
