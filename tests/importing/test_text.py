"""Headings that do not fit their rows, decimal commas with dots between thousands, and channels of one name."""

from __future__ import annotations

import numpy as np
import pytest
from importing.axis_log import truth

from fffo_drive.importing.text import read_text

LOG = truth()
NAMES = ["Time [ms]", "Actual speed [rpm]", "Encoder [rev]", "Demand [mA]"]
VALUES = np.stack([1e3 * LOG.time_s, 60.0 * LOG.velocity_rps, LOG.position_rev, 1e3 * LOG.current_a], axis=1)


def written(tmp_path, heading, delimiter, ending=""):
    path = tmp_path / "log.txt"
    rows = [delimiter.join(f"{value:.6f}" for value in row) + ending for row in VALUES]
    path.write_text("\n".join([heading, *rows]) + "\n")
    return read_text(path)


@pytest.mark.parametrize(
    ("heading", "delimiter", "ending"),
    [
        (";".join(NAMES), ";", ";"),
        (";".join(NAMES) + ";", ";", ";"),
        (";".join(NAMES) + ";", ";", ""),
        (",".join(NAMES), " ", ""),
        ("# " + ",".join(NAMES), " ", ""),
        ("# " + ",".join(NAMES), "\t", ""),
        ("% " + "\t".join(NAMES), ",", ""),
        ("# " + " ".join(name.replace(" ", "") for name in NAMES), ",", ""),
    ],
)
def test_a_heading_is_used_whatever_its_lines_end_in_and_separates_it(tmp_path, heading, delimiter, ending):
    source = written(tmp_path, heading, delimiter, ending)
    assert source.remarks == ()
    assert [name.replace(" ", "") for name in source.columns] == ["Time", "Actualspeed", "Encoder", "Demand"]
    assert list(source.units.values()) == ["ms", "rpm", "rev", "mA"]
    np.testing.assert_allclose(np.stack(list(source.columns.values()), axis=1), VALUES, atol=1e-6)


@pytest.mark.parametrize(
    ("heading", "delimiter", "cells"),
    [
        (";".join(NAMES[:3]), ";", 3),
        (";".join([*NAMES, "more"]), ";", 5),
        ("# " + ",".join(NAMES[:3]), " ", 3),
        (" ".join(NAMES), " ", 9),
    ],
)
def test_a_heading_that_does_not_fit_is_not_dropped_without_a_word(tmp_path, heading, delimiter, cells):
    source = written(tmp_path, heading, delimiter)
    assert source.remarks == (f"the heading has {cells} cells, the rows 4: its names are not used",)
    assert list(source.columns) == [f"column {k}" for k in (1, 2, 3, 4)]


def german(value, digits):
    return f"{value:,.{digits}f}".translate(str.maketrans(",.", ".,"))


@pytest.mark.parametrize("digits", [0, 1])
def test_dots_between_thousands_are_no_decimal_points(tmp_path, digits):
    counts = np.round(40_960.0 * LOG.position_rev - 2000.0, digits)
    rows = [
        f"{german(1e3 * t, 1)};{german(c, digits)};{german(1e3 * i, 2)}"
        for t, c, i in zip(LOG.time_s, counts, LOG.current_a, strict=True)
    ]
    assert any(row.split(";")[1].count(".") for row in rows)
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["Zeit [ms];Position [counts];Strom [mA]", *rows]) + "\n")
    source = read_text(path)
    np.testing.assert_allclose(source.columns["Position"], counts, atol=1e-9)
    np.testing.assert_allclose(source.columns["Zeit"], np.round(1e3 * LOG.time_s, 1), atol=1e-9)
    assert source.remarks == ()


def test_a_dot_that_groups_no_thousands_is_no_number_beside_decimal_commas(tmp_path):
    rows = [f"{k};{german(LOG.position_rev[k], 6)};{german(LOG.current_a[k], 6)}" for k in range(LOG.time_s.size)]
    rows[40] = "40;3.1416;0,5"
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["t;pos;i", *rows]) + "\n")
    source = read_text(path)
    assert np.flatnonzero(np.isnan(source.columns["pos"])).tolist() == [40]
    assert "the first is '3.1416' in line 42, column 'pos'" in source.remarks[0]


def test_two_channels_of_one_name_are_both_there(tmp_path):
    """An export of TwinCAT Scope of two axes."""
    channels = {"ActPos": "rev", "ActTorque": "Nm"}
    names, units = [*channels, *channels], [*channels.values(), *channels.values()]
    values = [LOG.position_rev, LOG.current_a, -LOG.position_rev, -LOG.current_a]
    lines = [
        "Name;Scope Project", "", ";".join(f"Name;{name}" for name in names),
        ";".join("SampleTime[ms];2" for _ in names), ";".join(f"Unit;{unit}" for unit in units), "",
    ]  # fmt: skip
    for k, t in enumerate(LOG.time_s):
        lines.append(";".join(f"{1e3 * t:.3f};{column[k]:.6f}" for column in values))
    (tmp_path / "scope.csv").write_text("\n".join(lines) + "\n")
    source = read_text(tmp_path / "scope.csv")
    assert list(source.columns) == ["time", "ActPos", "ActTorque", "ActPos (2)", "ActTorque (2)"]
    np.testing.assert_allclose(source.columns["ActPos"], LOG.position_rev, atol=1e-6)
    np.testing.assert_allclose(source.columns["ActPos (2)"], -LOG.position_rev, atol=1e-6)
    assert source.units["ActTorque (2)"] == "Nm"


def test_a_slow_angle_of_twincat_is_interpolated_through_its_wraps(tmp_path):
    angle = np.mod(3.0 * 360.0 * LOG.position_rev, 360.0)
    lines = [
        "Name;Scope Project", "", "Name;ActPos;Name;ActTorque", "SampleTime[ms];10;SampleTime[ms];2",
        "Unit;deg;Unit;Nm", "",
    ]  # fmt: skip
    for k, t in enumerate(LOG.time_s):
        slow = f"{1e3 * LOG.time_s[5 * k]:.3f};{angle[5 * k]:.9g}" if 5 * k < LOG.time_s.size else ";"
        lines.append(f"{slow};{1e3 * t:.3f};{LOG.current_a[k]:.9g}")
    (tmp_path / "scope.csv").write_text("\n".join(lines) + "\n")
    source = read_text(tmp_path / "scope.csv")
    given = np.isfinite(source.columns["ActPos"])
    assert np.flatnonzero(~given).tolist() == [1196, 1197, 1198, 1199]  # after the last sample of the angle
    away = np.mod(source.columns["ActPos"] - 1080.0 * LOG.position_rev + 180.0, 360.0)[given] - 180.0
    assert np.max(np.abs(away)) < 1.1  # a T^2 / 8 of a straight line
