"""Whether an effect is as strong in one part of the data as in another: the truth is, what stands in for it is not."""

from functools import cache

import numpy as np
import pytest
from diagnosis.planted import based, effect, runs

from fffo_drive.diagnosis.fitting import evaluate, fit, jacobian
from fffo_drive.diagnosis.steady import STEADY, least_steady, parts_of

OFFSET_NM = 0.006
RUNS = "from run to run"
HALVES = "from the first to the second half of the runs"
SPEEDS = "from slow to fast motion"


def constant(motion):
    return np.full(motion.time_s.size, OFFSET_NM)


def nothing_here(motion):
    return np.zeros(motion.time_s.size)


def later(motion):
    """A constant torque that comes in the second half."""
    return np.where(motion.time_s > np.median(motion.time_s), OFFSET_NM, 0.0)


def slow(motion):
    """A constant torque at low speed only."""
    return np.where(np.abs(motion.velocity_rps) < np.median(np.abs(motion.velocity_rps)), OFFSET_NM, 0.0)


def drag(motion):
    return 3e-5 * motion.velocity_rps * np.abs(motion.velocity_rps)


def askew(motion):
    return 4e-4 * np.abs(motion.velocity_rps)


def with_drag(motion):
    """A constant torque, and beside it an effect that the model has not."""
    return constant(motion) + drag(motion)


@cache
def split(*loads, law="torque_offset", strength="torque_nm"):
    """How steady a law is that was fitted to these runs alone with the base."""
    data, base = based(runs(*loads, duration_s=9.0))
    fitted = fit(data, base.physical, [effect(law, {strength: 0.0})])
    matrix = jacobian(data, fitted)
    return least_steady(data, fitted, matrix, 0)


@pytest.mark.parametrize("load", [constant, with_drag])
def test_the_truth_is_steady_whatever_else_is_left(load):
    found = split(load, load)
    assert found.spread < 0.5 * STEADY
    assert not found.is_uneven


def test_a_law_of_another_sort_is_steady_too():
    assert not split(drag, drag, law="quadratic_drag", strength="drag_nm_per_rps2").is_uneven


@pytest.mark.parametrize(
    ("loads", "parts"), [((constant, nothing_here), RUNS), ((later, later), HALVES), ((slow, slow), SPEEDS)]
)
def test_what_stands_in_for_something_else_is_not(loads, parts):
    found = split(*loads)
    assert found.is_uneven
    assert found.spread > STEADY
    assert found.parts == parts


def test_an_unsteady_strength_that_unseen_rows_do_not_show_is_noise():
    """A strength of next to nothing differs from part to part as noise does."""
    data, base = based(runs(nothing_here, nothing_here, duration_s=9.0))
    fitted, _ = evaluate(data, base.physical, [effect("torque_offset", {"torque_nm": 1e-5})])
    matrix = jacobian(data, fitted)
    found = least_steady(data, fitted, matrix, 0)
    assert found.spread > STEADY
    assert not found.is_uneven


def test_what_the_base_can_say_itself_is_no_change():
    """Viscous friction that differs by direction, in one direction alone, is viscous friction."""
    found = split(askew, askew, law="asymmetric_viscous", strength="excess_nm_per_rps")
    assert found.spread < STEADY


def test_each_part_has_some_of_the_rows_that_count_and_not_all():
    data, _ = based(runs(constant, constant, duration_s=9.0))
    parts = list(parts_of(data))
    assert {RUNS, HALVES, SPEEDS} < {words for words, _ in parts}
    for _, part in parts:
        assert part.shape == data.used.shape
        assert 0 < part.sum() < part.size
