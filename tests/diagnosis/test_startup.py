"""The base model from nothing: J right beside a constant torque and gravity; one-way runs do not crash."""

from pathlib import Path

import numpy as np
import pytest
from diagnosis.planted import (
    DELAY_S,
    FACTS,
    INERTIA,
    PERIOD_S,
    TRUTH,
    based,
    nothing,
    planted,
    runs,
)

from fffo_drive.diagnosis.base import NAMES
from fffo_drive.diagnosis.diagnose import physical_of, prepared
from fffo_drive.diagnosis.fitting import evaluate
from fffo_drive.diagnosis.rows import make_filter
from fffo_drive.identification.dataset import DataError
from fffo_drive.model.parameters import read_model

TABLE_1 = Path(__file__).parents[2] / "configs" / "models" / "table1.yaml"


def constant(motion):
    return np.full(motion.time_s.size, 0.04)


def pendulum(motion):
    return 0.06 * np.sin(2.0 * np.pi * motion.position_rev + 0.4)


def both(motion):
    return constant(motion) + pendulum(motion)


def begun(records, model=None):
    """Data as a search begins with them, and the first rungs."""
    return prepared(records, FACTS, make_filter(PERIOD_S), model)


@pytest.mark.parametrize("load", [nothing, constant, pendulum, both])
def test_the_start_gets_inertia_and_delay_right_beside_a_constant_torque_and_gravity(load):
    """Short swings: without a column of their own, both look like inertia."""
    _, climbed = begun([planted(load, duration_s=10.0, peak_a=0.8)])
    found = climbed.start
    assert found.inertia_nm_s2_per_rev == pytest.approx(INERTIA, rel=0.05)
    assert found.delay_s == pytest.approx(DELAY_S, abs=1.5e-3)
    assert found.coulomb_nm == pytest.approx(0.025, rel=0.35)


def test_runs_that_turn_one_way_have_no_constant_torque_beside_their_friction():
    """Direction and a constant are nearly one column: beside each other, both took absurd values on half a LAAS log."""
    records = runs(nothing, nothing, duration_s=6.0, peak_a=0.3, bias_a=0.7)
    assert (np.diff(records[0].position_rev[1000:-1000:100]) > 0.0).all()
    _, climbed = begun(records)
    found = climbed.start
    assert not climbed.accepted
    assert found.constant_nm == 0.0
    assert found.coulomb_nm == pytest.approx(0.025, rel=0.6)  # the constant torque of the bias is in it
    assert found.inertia_nm_s2_per_rev == pytest.approx(INERTIA, rel=0.05)
    assert found.static_nm > found.coulomb_nm
    data, base = based(records)
    assert np.isfinite(base.physical).all()
    assert np.isfinite(base.loss)
    needed = INERTIA * data.rows.acceleration_rps2[data.used]
    assert np.sqrt(np.mean(base.residual_nm[data.used] ** 2)) < 0.5 * np.sqrt(np.mean(needed**2))


def test_what_hardly_moves_is_refused_in_a_sentence():
    record = planted(peak_a=0.01, duration_s=4.0)
    with pytest.raises(DataError, match="sure sliding motion"):
        begun([record])


def test_a_torque_of_the_wrong_sign_is_refused():
    record = planted(duration_s=6.0)
    turned = type(record)(**{**vars(record), "current_a": -record.current_a})
    with pytest.raises(DataError):
        begun([turned])


def test_the_start_is_near_enough_for_the_fit_that_follows():
    data, _ = begun([planted(duration_s=10.0)])
    start = data.start
    for name in ("stiffness_per_rev", "attraction_nm_per_rev", "static_nm"):
        k = NAMES.index(name)
        assert 0.1 < start[k] / TRUTH[k] < 10.0
    residual, _ = evaluate(data, start, ())
    level_nm = 1.0 / data.weight.max()
    assert level_nm == pytest.approx(np.sqrt(np.mean(residual.residual_nm[data.used] ** 2)), rel=0.6)
    assert not data.weight[~data.rows.kept].any()


def test_parameters_that_are_known_are_where_the_fits_begin():
    model = read_model(TABLE_1)
    data, _ = begun([planted(duration_s=6.0)], model)
    assert data.start == pytest.approx(physical_of(model))
