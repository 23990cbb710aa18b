"""Units as logs write them, in brackets and behind underscores, and as our own map has them."""

from __future__ import annotations

import pytest
import yaml

from fffo_drive.importing.units import UNITS, split_name, turn_of, unit_of, unknown_unit
from fffo_drive.workflows.import_logs import known_units, read_map


@pytest.mark.parametrize("unit", UNITS)
def test_every_unit_is_known_by_its_own_name(unit):
    assert unit_of(unit) == unit
    assert split_name(f"Value [{unit}]") == ("Value", unit)


def test_a_map_of_every_unit_is_read_back(tmp_path):
    (tmp_path / "map.yaml").write_text(yaml.safe_dump({"units": {f"in {unit}": unit for unit in UNITS}}))
    assert known_units(read_map(tmp_path / "map.yaml").units) == {f"in {unit}": unit for unit in UNITS}


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("percent", "%"), ("Percent", "%"), ("permille", "permille"), ("per_mille", "permille"),
        ("per mille", "permille"), ("rad per s", "rad/s"), ("rad_per_s", "rad/s"), ("deg per sec", "deg/s"),
        ("rev per min", "rpm"), ("counts per s", None), ("per", None),
    ],
)  # fmt: skip
def test_per_divides_where_it_stands_between_units_only(text, unit):
    assert unit_of(text) == unit


@pytest.mark.parametrize(
    ("heading", "unit"),
    [
        ("velocity_rad_s", "rad/s"), ("omega_rad_per_s", "rad/s"), ("speed_deg_s", "deg/s"), ("vel_mm_s", "mm/s"),
        ("vel_m_s", "m/s"), ("speed_rev_s", "rps"), ("speed_deg_per_sec", "deg/s"), ("Omega_Rad_S", "rad/s"),
        ("time_s", "s"), ("t_ms", "ms"), ("cycle_time_us", "us"), ("position_rad", "rad"), ("current_ma", "mA"),
        ("torque_nm", "Nm"), ("phase_a", None), ("i_q_a", None), ("accel_rad_s2", None),
    ],
)  # fmt: skip
def test_the_unit_behind_an_underscore_is_taken_whole(heading, unit):
    assert split_name(heading) == (heading, unit)


def test_a_turn_in_units_of_angle():
    assert turn_of("deg") == pytest.approx(360.0)
    assert turn_of("rev") == 1.0
    assert (turn_of("counts"), turn_of("mm"), turn_of(None)) == (None, None, None)


@pytest.mark.parametrize(
    ("heading", "unit"),
    [
        ("Drehzahl in 1/min", "rpm"),
        ("Winkel in °", "deg"),
        ("istdrehzahl_min-1", "rpm"),
        ("lage_grad", "deg"),
        ("Velocità_rpm", "rpm"),
        ("pos_um", "um"),
        ("force_N", "N"),
        ("cur_A", "A"),
        ("Stromistwert [Aeff]", "A"),
        ("mA", "mA"),
        ("Nm", "Nm"),
        ("Corriente_motor_a", "A"),
        ("tick", None),
        ("min", None),
        ("A", None),
        ("phase_n", None),
    ],
)
def test_units_as_headings_end_in_them(heading, unit):
    assert split_name(heading)[1] == unit


def test_a_number_before_a_unit_is_no_remark():
    assert unknown_unit("Speed (0.1 counts/s)") == "0.1 counts/s"
    assert unknown_unit("Current (0.01A)") == "0.01A"
    assert unknown_unit("velocity (filtered)") is None
