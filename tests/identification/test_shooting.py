"""The observer and the free windows on records of the model itself, where nothing may be left over."""

from __future__ import annotations

import numpy as np
import pytest
from identification.synthetic import AXIS, PERIOD_S, TRUTH, chirp_record
from interpreted import hex_results

from fffo_drive.identification.coordinates import (
    LOGARITHMIC,
    LONGEST_PRESLIDING,
    PARAMETERS,
    axis_of,
    coordinates,
    to_coordinates,
    to_physical,
)
from fffo_drive.identification.prediction import jacobian, make_problem, moving_blocks, observer, residual
from fffo_drive.identification.residuals import velocity_errors
from fffo_drive.identification.shooting import PATH_COLUMNS, Nuisance, follow, innovations, shoot
from fffo_drive.model.parameters import LIMITS
from fffo_drive.symbols import FRICTION

SHOOTING = observer(PERIOD_S, 40.0, 4)


def short():
    return chirp_record(2.0)


def kernel_results():
    record = short()
    errors = np.empty(60)
    innovations(AXIS, None, SHOOTING, Nuisance(1e-3, 2e-7), record.current_a, record.position_rev, 0, errors)
    path = np.empty((200, PATH_COLUMNS))
    follow(AXIS, None, SHOOTING, Nuisance(0.0, 0.0), record.current_a[:200], record.position_rev[:200], path)
    windows = np.empty((2, 10))
    shoot(
        AXIS, None, None, SHOOTING._replace(samples=40), 0.0, record.current_a,
        record.position_rev, np.array([100, 160]), 0, windows,
    )  # fmt: skip
    return [float(x).hex() for x in (*errors, *path.ravel(), *windows.ravel())]


def test_compiled_and_interpreted_kernels_agree_bit_for_bit():
    assert kernel_results() == hex_results("identification.test_shooting", "kernel_results")


def test_at_the_truth_nothing_is_left_over():
    record = chirp_record(10.0)
    problem = make_problem([record], 40.0)
    assert problem.rows > 1000
    assert np.abs(residual(problem, TRUTH)).max() < 1e-6
    errors, begins = velocity_errors(record, TRUTH)
    assert errors.shape[0] == begins.size > 10
    assert np.abs(errors).max() < 1e-6


def test_the_observer_carries_the_friction_of_the_motion():
    record = chirp_record(4.0)
    path = np.empty((record.samples, PATH_COLUMNS))
    follow(AXIS, None, SHOOTING, Nuisance(0.0, 0.0), record.current_a, record.position_rev, path)
    velocity = np.gradient(record.position_rev, PERIOD_S)
    assert np.abs(path[1:-1, 1] - velocity[1:-1]).max() < 0.1  # half a sample of acceleration
    assert np.abs(path[:, 2]).max() > 0.02
    assert np.all(path[:, 3] >= 0.0)


def test_a_torque_that_the_model_lacks_shows_as_a_steady_innovation():
    """At rest in the error, J wo^2 e = offset."""
    offset_nm, omega = 1e-3, 2.0 * np.pi * 40.0
    current = np.full(4000, 1.0)
    position = 0.5 * np.arange(4000) ** 2 * PERIOD_S**2 * (AXIS.torque_constant_nm_per_a / AXIS.inertia_nm_s2_per_rev)
    free = AXIS._replace(
        delay_s=0.0, friction=AXIS.friction._replace(coulomb_nm=1e-9, static_nm=1e-9, viscous_nm_per_rps=0.0)
    )
    errors = np.empty(1000)
    innovations(free, None, SHOOTING, Nuisance(offset_nm, 0.0), current, position, 0, errors)
    expected = offset_nm / (AXIS.inertia_nm_s2_per_rev * omega * omega)
    assert np.allclose(errors[500:], expected, rtol=1e-3)


def test_forward_and_central_differences_agree():
    record = chirp_record(10.0)
    problem = make_problem([record], 40.0)
    off = TRUTH * 1.03
    space = coordinates(off, PERIOD_S, ("inertia_nm_s2_per_rev", "coulomb_nm", "delay_s"))
    free = np.flatnonzero(space.high > space.low)
    values = to_coordinates(off, space.scale)
    assert [space.names[k] for k in free] == ["inertia_nm_s2_per_rev", "delay_s", "coulomb_nm"]
    base = residual(problem, to_physical(values, space.scale))
    forward = jacobian(problem, space, values, base, free, central=False)
    central = jacobian(problem, space, values, base, free, central=True)
    assert np.linalg.norm(forward - central) < 0.05 * np.linalg.norm(central)


def test_coordinates_are_inverted():
    space = coordinates(TRUTH, PERIOD_S, ())
    assert np.allclose(to_physical(to_coordinates(TRUTH, space.scale), space.scale), TRUTH)
    axis, nuisance = axis_of(TRUTH, AXIS.torque_constant_nm_per_a)
    assert axis == AXIS
    assert nuisance == Nuisance(0.0, 0.0)


def test_a_standstill_does_not_count():
    position = np.concatenate([np.zeros(2000), np.linspace(0.0, 1.0, 2000)])
    kept = moving_blocks(position, 1e-4, 4, PERIOD_S)
    assert not kept[60:440].any()
    assert kept[560:].all()


def test_a_fit_stays_within_what_a_model_file_may_hold():
    """Start values near the ends: a thousand times as much would be a file that nothing reads."""
    for name in sorted(LOGARITHMIC.intersection(FRICTION)):
        least, most = LIMITS[f"friction.{name}"]
        for value in (most / 10.0, 10.0 * max(least, 1e-12)):
            start = TRUTH.copy()
            start[PARAMETERS.index(name)] = value
            space = coordinates(start, PERIOD_S, (name,))
            k = PARAMETERS.index(name)
            assert to_physical(space.low, space.scale)[k] >= (1.0 - 1e-12) * least
            assert value < to_physical(space.high, space.scale)[k] <= (1.0 + 1e-12) * most


def test_presliding_is_no_longer_than_that_of_a_machine():
    k, least_per_rev = PARAMETERS.index("stiffness_per_rev"), 1.0 / LONGEST_PRESLIDING["rotary"]
    start = TRUTH.copy()
    start[k] = 2.0 * least_per_rev
    space = coordinates(start, PERIOD_S, ("stiffness_per_rev",), least_stiffness_per_rev=least_per_rev)
    assert to_physical(space.low, space.scale)[k] == pytest.approx(least_per_rev)


def test_friction_at_speed_is_no_more_than_the_torque_had_room_for():
    for name, bound in (("static_nm", "most_static_nm"), ("viscous_nm_per_rps", "most_viscous_nm_per_rps")):
        k = PARAMETERS.index(name)
        for most, wanted in ((1.5 * TRUTH[k], 1.5 * TRUTH[k]), (0.5 * TRUTH[k], TRUTH[k])):  # never below the start
            space = coordinates(TRUTH, PERIOD_S, (name,), **{bound: most})
            assert to_physical(space.high, space.scale)[k] == pytest.approx(wanted)
