"""The cyclic error of a position sensor: orders, lag and intervals of a known one, and nothing where nothing is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fffo_drive.identification.cyclic import ARCMIN, cyclic_error, cyclic_lines
from fffo_drive.identification.dataset import DataError, Record
from fffo_drive.report.cyclic import cyclic_section, cyclic_table
from fffo_drive.units import TWO_PI

PERIOD_S = 1e-3
ERRORS = {1: (3e-4, 0.2), 2: (1e-4, 0.7), 8: (4e-5, 0.05)}  # order: amplitude in rev, phase
LAG_S = 2e-4


def sensor(angle_rev, orders):
    return sum((a * np.cos(TWO_PI * (k * angle_rev - p)) for k, (a, p) in orders.items()), np.zeros_like(angle_rev))


def record(seed=0, orders=ERRORS, noise_rev=2e-5, turns=3.0, name="axis"):
    """Back and forth over some turns; the sensor errs at its own angle, is late and noisy."""
    draw = np.random.default_rng(seed)
    time_s = PERIOD_S * np.arange(20_000)
    true_rev = 0.3 + turns / 2.0 * np.sin(TWO_PI * 0.1 * time_s)
    velocity = np.gradient(true_rev, PERIOD_S)
    position = true_rev
    for _ in range(8):  # its error is that of the angle which it shows
        position = true_rev + LAG_S * velocity + sensor(position, orders)
    position = position + noise_rev * draw.normal(size=time_s.size)
    return Record(
        name, Path(f"{name}.mcap"), PERIOD_S, 0.1, np.zeros(time_s.size), position, None, None, 1e-6, (), "",
        reference_position_rev=true_rev + 7.0,
    )  # fmt: skip


def test_orders_phases_and_lag_of_a_known_sensor_are_found_within_their_intervals():
    found = cyclic_error([record(1), record(2)])
    assert {one.order for one in found.sure} == set(ERRORS)
    for one in found.sure:
        amplitude, phase = ERRORS[one.order]
        assert abs(one.amplitude_rev - amplitude) < 4.0 * one.sd_rev
        assert one.sd_rev < 0.05 * amplitude
        assert one.phase_rev == pytest.approx(phase, abs=0.01)
    assert found.lag_s == pytest.approx(LAG_S, abs=4.0 * found.lag_sd_s)
    fine = np.linspace(0.0, 1.0, 5001)
    assert found.peak_to_peak_rev == pytest.approx(np.ptp(sensor(fine, ERRORS)), rel=0.02)
    np.testing.assert_allclose(found.error_rev(fine), sensor(fine, ERRORS), atol=3e-6)
    assert found.left_rms_rev == pytest.approx(2e-5, rel=0.05)
    assert [one.order for one in found.sure] == [1, 2, 8]  # the largest first


def test_without_an_error_hardly_an_order_is_found():
    """At four standard deviations one order of some thousands."""
    found = [len(cyclic_error([record(seed, {})]).sure) for seed in range(40)]
    assert sum(found) <= 3
    assert "no order is beyond noise" in cyclic_lines(cyclic_error([record(0, {})]))[-1]


def test_a_run_with_another_zero_and_samples_that_were_filled_in_change_nothing():
    one, other = record(1), record(2)
    other = replace(other, reference_position_rev=other.reference_position_rev - 123.4)
    spoilt = one.position_rev.copy()
    spoilt[5000:5040] += 1e-3
    good = np.ones(one.samples, bool)
    good[5000:5040] = False
    found = cyclic_error([replace(one, position_rev=spoilt, good=good), other])
    plain = cyclic_error([record(1), record(2)])
    assert found.samples == plain.samples - np.count_nonzero(~good)
    for a, b in zip(found.sure, plain.sure, strict=True):
        assert a.amplitude_rev == pytest.approx(b.amplitude_rev, rel=0.01)


def test_a_sensor_of_another_shaft_and_less_than_a_turn_are_refused():
    one = record()
    with pytest.raises(DataError, match="not that of the same shaft"):
        cyclic_error([replace(one, reference_position_rev=-one.reference_position_rev)])
    with pytest.raises(DataError, match="needs a whole turn"):
        cyclic_error([record(turns=0.8)])
    assert cyclic_error([replace(one, reference_position_rev=None)]) is None


def test_table_figure_and_lines_say_the_same():
    found = cyclic_error([record(1)])
    table = cyclic_table(found)
    assert [row.label for row in table.rows][:3] == ["1 a turn", "2 a turn", "8 a turn"]
    assert table.rows[0].cells[0].value == pytest.approx(ARCMIN * found.sure[0].amplitude_rev)
    (figure,) = cyclic_section(found).figures
    assert np.nanmax(np.abs(figure.series[0].y)) == pytest.approx(ARCMIN * 3.9e-4, rel=0.2)
    assert "arcmin" in cyclic_lines(found)[1]
