"""What is proposed: only what a refit of the base cannot say, with the chance of it over everything that was tried."""

from functools import cache

import numpy as np
import pytest
from diagnosis.planted import FACTS, based, left, nothing, only, runs

from fffo_drive.diagnosis.base import BASE
from fffo_drive.diagnosis.fitting import consistent_scenes, jacobian
from fffo_drive.diagnosis.propose import (
    LAW_RUNG,
    TABLE_RUNG,
    TABLES,
    WAVE_RUNG,
    Search,
    beside,
    evidence_of,
    machine_orders,
    orthonormal,
    proposal,
    quick_score,
    score,
    scores,
    search_context,
)
from fffo_drive.diagnosis.scenes import strength_columns
from fffo_drive.identification.criterion import sandwich_p

WAVE_NM = 0.004
NONE = frozenset[str]()
CURVES = frozenset({"curves"})


def wave(motion):
    return WAVE_NM * np.cos(2.0 * np.pi * 5.0 * motion.position_rev + 0.3)


@cache
def axis(wavy=False, one_way=False):
    """(data, base, its jacobian, evidence)."""
    options = {"peak_a": 0.15, "bias_a": 0.4} if one_way else {}
    load = wave if wavy else nothing
    data, base = based(runs(load, load, **options))
    matrix = jacobian(data, base)
    return data, base, matrix, evidence_of(data, base, matrix)


def proposed(without=NONE, rung=LAW_RUNG, facts=FACTS, wavy=True, ablate=CURVES):
    """(search, its proposals) for one round."""
    data, base, _, evidence = axis(wavy)
    search = Search(facts, without, ablate)
    return search, search.proposals(data, base, evidence, rung)


def columns_of(name, wavy=False, **shapes):
    data, base, _, evidence = axis(wavy)
    scenes = consistent_scenes(data, base.physical, ())
    return data, evidence, strength_columns(data.rows, scenes, name, shapes)


def test_what_the_base_can_say_is_no_evidence_and_has_no_rank():
    data, base, matrix, evidence = axis()
    for name in ("inertia_nm_s2_per_rev", "viscous_nm_per_rps", "delay_s"):
        found = score(evidence, matrix[:, [BASE.index(name)]])
        assert (found.rank, found.explained, found.p) == (0, 0.0, 1.0)
    bent = left(data, base, data.rows.velocity_rps * 1e-4)  # an error of the viscous coefficient
    after = evidence_of(data, bent, matrix)
    assert after.energy < 1.02 * evidence.energy


def test_columns_that_are_one_have_one_rank():
    data, evidence, columns = columns_of("cogging", order=5.0)
    white = data.white(columns.values)
    assert score(evidence, white).rank == 2
    assert score(evidence, np.concatenate([white, white @ np.array([[1.0], [2.0]])], axis=1)).rank == 2
    assert score(evidence, np.zeros_like(white)).rank == 0


def test_the_basis_is_orthonormal_and_spans_its_columns():
    draw = np.random.default_rng(1)
    columns = draw.normal(size=(500, 4)) * np.array([1.0, 1e-6, 1e6, 1.0])
    columns = np.concatenate([columns, columns[:, :1] - columns[:, 3:], np.zeros((500, 1))], axis=1)
    basis = orthonormal(columns)
    assert basis.shape == (500, 4)
    np.testing.assert_allclose(basis.T @ basis, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(basis @ (basis.T @ columns), columns, rtol=1e-6, atol=1e-6)


def test_a_law_finds_its_own_strength_beside_the_base():
    data, base, matrix, clean = axis()
    _, _, columns = columns_of("quadratic_drag")
    white = data.white(columns.values)
    evidence = evidence_of(data, left(data, base, 5e-7 * columns.values[:, 0]), matrix)
    change = score(evidence, white).strengths[0] - score(clean, white).strengths[0]
    assert change == pytest.approx(5e-7, rel=0.1)


def test_a_planted_wave_is_proposed_first_and_its_chance_is_tiny():
    search, found = proposed()
    best = max(found, key=lambda one: one.worth)
    assert best.name == "cogging"
    assert best.effect.shapes["order"] == pytest.approx(5.0, abs=0.02)
    size = np.hypot(best.effect.strengths["cos_nm"][0], best.effect.strengths["sin_nm"][0])
    assert size == pytest.approx(WAVE_NM, rel=0.05)
    assert best.score.p * search.tried < 1e-6
    assert search.tried > 100


def test_without_an_effect_no_chance_is_small_over_all_that_was_tried():
    """But that of a lag of the command, which has the residual in its column: the gates are for that."""
    search, found = proposed(frozenset({"current_lag"}), wavy=False)
    assert min(one.score.p for one in found) * search.tried > 0.01


def test_the_chance_is_that_of_the_windows_scores_by_what_is_left_beside_the_candidate():
    data, evidence, columns = columns_of("cogging", wavy=True, order=5.0)
    white = data.white(columns.values)
    found = score(evidence, white)
    axes, _ = np.linalg.qr(white - evidence.basis @ (evidence.basis.T @ white))
    left = evidence.residual - axes @ (axes.T @ evidence.residual)
    window = evidence.folds.window

    def in_windows(values):
        return np.stack([np.bincount(window, values * axis) for axis in axes.T], axis=1)

    leverage = np.bincount(window, np.sum(axes**2, axis=1))
    assert found.p == pytest.approx(sandwich_p(in_windows(evidence.residual), in_windows(left), leverage), rel=1e-3)


def test_many_candidates_scored_side_by_side_have_the_scores_that_each_has_alone():
    data, evidence, columns = columns_of("cogging", wavy=True, order=5.0)
    white = data.white(columns.values)
    rows = np.arange(white.shape[0])[:, None]
    others = np.sin(rows * np.array([[0.1, 0.23, 0.31]]))
    together = scores(evidence, np.concatenate([others, white, np.zeros_like(white)], axis=1), [3, 2, 2])
    for found, alone in zip(together, (others, white, np.zeros_like(white)), strict=True):
        known = score(evidence, alone)
        assert found.rank == known.rank
        assert found.explained == pytest.approx(known.explained, rel=1e-9)
        np.testing.assert_allclose(found.strengths, known.strengths, rtol=1e-9)
        assert found.p == 1.0


def test_of_each_law_the_best_shape_is_kept():
    _, found = proposed()
    names = [one.kind for one in found]
    assert len(names) == len(set(names))
    data, base, _, evidence = axis(True)
    scenes = consistent_scenes(data, base.physical, ())
    best = next(one for one in found if one.name == "cogging")
    for order in (3.0, 4.0, 6.0):
        columns = strength_columns(data.rows, scenes, "cogging", {"order": order})
        found = quick_score(evidence, data.white(columns.values))
        assert proposal(data, "cogging", "cogging", {"order": order}, columns, found).worth < best.worth


def test_what_is_left_out_is_not_tried():
    _, found = proposed(frozenset({"cogging"}))
    assert "cogging" not in {one.name for one in found}
    assert "torque_ripple" in {one.name for one in found}


def test_a_kind_of_curve_is_left_out_by_its_name_and_all_over_an_axis_by_theirs():
    laws = only()
    _, found = proposed(laws, ablate=NONE)
    kinds = {one.kind for one in found}
    assert {"torque(velocity)", "friction(time)", "wound(memory)"} <= kinds
    _, fewer = proposed(laws | {"friction(time)", "unknown:velocity"}, ablate=NONE)
    left_over = {one.kind for one in fewer}
    assert not {"friction(time)", "torque(velocity)"} & left_over
    assert "viscous(time)" in left_over
    assert all(one.name.startswith("unknown:") for one in found)
    assert all(not one.name.startswith("unknown:velocity") for one in fewer)
    assert not any(" x " in one.kind for one in found)
    assert not {one.kind for one in proposed(laws, ablate=CURVES)[1]}


def test_curves_are_a_rung_of_their_own_and_count_among_what_was_tried():
    laws = only("torque_offset")
    search, found = proposed(laws, WAVE_RUNG, ablate=NONE)
    assert all(not one.name.startswith("unknown:") for one in found)
    assert search.tried == 1
    search, _ = proposed(laws, ablate=NONE)
    curves = search.tried
    assert curves > 30
    search, found = proposed(laws, TABLE_RUNG, ablate=NONE)
    assert search.tried > 20
    tables = [one.kind for one in found if " x " in one.kind]
    assert 0 < len(tables) <= TABLES
    _, fewer = proposed(laws | {tables[0]}, TABLE_RUNG, ablate=NONE)
    assert tables[0] not in {one.kind for one in fewer}


def test_the_orders_that_the_machine_s_design_gives():
    facts = FACTS.model_copy(update={"slots": 18, "pole_pairs": 12})
    assert machine_orders(facts) == {1.0, 2.0, 3.0, 12.0, 24.0, 72.0, 144.0, 18.0, 36.0}
    assert machine_orders(FACTS) == {1.0, 2.0, 3.0}


def test_orders_beyond_what_the_slow_part_can_show_are_not_tried():
    """At five turns a second and more, a filter of 45 Hz leaves nothing of orders above nine."""
    data, base, _, _ = axis(one_way=True)
    assert np.quantile(np.abs(data.rows.velocity_rps[data.rows.kept]), 0.1) > 5.0
    context = search_context(data, base, consistent_scenes(data, base.physical, ()), FACTS)
    assert context.slow_rps > 5.0
    whole = [order for order in context.orders if order == round(order)]
    assert max(whole) <= 45.0 / context.slow_rps
    data, base, _, _ = axis()
    slow = search_context(data, base, consistent_scenes(data, base.physical, ()), FACTS)
    assert max(slow.orders) > 40.0


def test_an_order_that_nobody_foresaw_is_found_by_its_line():
    data, base, _, _ = axis()
    rows = data.rows
    line = 0.004 * np.cos(2.0 * np.pi * 5.37 * rows.position_rev) * rows.filter.gain(5.37 * rows.velocity_rps)
    scenes = consistent_scenes(data, base.physical, ())
    context = search_context(data, left(data, base, line), scenes, FACTS)
    assert min(abs(order - 5.37) for order in context.orders) < 0.02
    linear = FACTS.model_copy(update={"units": "linear"})
    assert 1.0 in context.orders
    assert 1.0 not in search_context(data, left(data, base, line), scenes, linear).orders


def test_a_datum_per_run_is_tried_where_the_angle_is_not_absolute():
    relative = FACTS.model_copy(update={"absolute_angle": False})
    laws = only("cogging")
    for facts, ablate, wanted in (
        (FACTS, CURVES, 0), (relative, CURVES, 1), (relative, CURVES | {"datum"}, 0),
    ):  # fmt: skip
        _, found = proposed(laws, facts=facts, ablate=ablate)
        assert sum(bool(one.effect.per_run) for one in found) == wanted
        assert len(found) == 1 + wanted


def test_a_table_counts_by_what_its_axes_do_not_say_one_by_one():
    data, base, matrix, _ = axis()
    first = np.tanh(data.rows.velocity_rps)
    second = np.sin(data.rows.time_s)
    evidence = evidence_of(data, left(data, base, 2e-3 * first + 2e-3 * second), matrix)
    table = data.white(np.stack([first, second, first * second], axis=1))
    assert score(evidence, table).explained > 10.0 * score(beside(evidence, table[:, :2]), table).explained


def test_gravity_is_none_of_a_linear_axis():
    linear = FACTS.model_copy(update={"units": "linear"})
    laws = only("unbalance", "torque_offset")
    assert {one.name for one in proposed(laws, facts=linear)[1]} == {"torque_offset"}
    assert {one.name for one in proposed(laws)[1]} == {"torque_offset", "unbalance"}
