"""Tables of other programs: values, units, and clear words about everything that is wrong with them."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat
from shared_data import shared_files

from fffo_drive.recording.column_map import SIGNAL_UNITS, ColumnMap, MappedColumn, conversions
from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.load import read_log
from fffo_drive.recording.table import read_table

FIVE = "time_s,current_a,velocity_rps\n0.0,1.5,2\n0.1,1.25,3\n0.2,-1,4.5\n0.3,0.5,5\n0.4,0.25,6\n"
LINEAR = ColumnMap(
    (
        MappedColumn("t", "time_s"),
        MappedColumn("vir", "current_command_a", "V"),
        MappedColumn("qm", "position_rev", "mm", scale=1e3),
    ),
    linear=True,
    extra=("qg",),
)


@pytest.fixture
def table(tmp_path):
    """Write a text, read it as a table."""

    def read(text: str, mapping: ColumnMap | None = None, name: str = "log.csv", **options):
        (tmp_path / name).write_bytes(text.encode())
        return read_table(tmp_path / name, mapping, **options)

    return read


@settings(max_examples=50)
@given(
    values=st.lists(
        st.tuples(st.floats(allow_nan=False, allow_infinity=False), st.floats(-1e6, 1e6)),
        min_size=2,
        max_size=20,
    ),
    delimiter=st.sampled_from([",", ";", "\t", " "]),
    newline=st.sampled_from(["\n", "\r\n"]),
    packed=st.booleans(),
)
def test_every_number_comes_back_exactly(tmp_path_factory, values, delimiter, newline, packed):
    lines = [delimiter.join(("current_a", "velocity_rps", "note"))]
    lines += [delimiter.join((repr(a), repr(b), "0")) for a, b in values]
    data = newline.join(lines).encode()
    path = tmp_path_factory.getbasetemp() / ("log.csv.gz" if packed else "log.csv")
    path.write_bytes(gzip.compress(data) if packed else data)
    mapping = ColumnMap(
        (MappedColumn("current_a", "current_a"), MappedColumn("velocity_rps", "velocity_rps")), rate_hz=500.0
    )
    found = read_table(path, mapping)
    assert np.array_equal(found.columns["current_a"], [a for a, _ in values])
    assert np.array_equal(found.columns["velocity_rps"], [b for _, b in values])
    assert np.array_equal(found.time_s, np.arange(len(values)) / 500.0)


def test_columns_by_their_own_names(table):
    found = table(FIVE)
    assert list(found.columns) == ["time_s", "current_a", "velocity_rps"]
    assert found.units == {"time_s": "s", "current_a": "A", "velocity_rps": "rps"}
    assert found.period_s == pytest.approx(0.1)
    assert found.warnings == found.gaps == ()
    assert found.columns["velocity_rps"].flags.c_contiguous
    with pytest.raises(RecordingError, match="did you mean 'current_a'"):
        found.column("curent_a")


@pytest.mark.parametrize(
    ("signal", "unit", "scale", "raw", "value"),
    [
        ("velocity_rps", "rpm", 1.0, 90.0, 1.5),
        ("velocity_rps", "rad/s", 1.0, np.pi, 0.5),
        ("velocity_rps", "deg/s", 1.0, 90.0, 0.25),
        ("position_rev", "rad", 1.0, np.pi, 0.5),
        ("position_rev", "rev", 1.0 / 4096.0, 1024.0, 0.25),
        ("current_a", "mA", -1.0, 1500.0, -1.5),
        ("reference_rps2", "rad/s2", 1.0, 2 * np.pi, 1.0),
        ("friction_nm", "mNm", 1.0, 12.0, 0.012),
        ("current_command_a", "V", 2.0, 3.0, 6.0),
    ],
)
def test_units(table, signal, unit, scale, raw, value):
    mapping = ColumnMap((MappedColumn("t ms", "time_s", "ms"), MappedColumn("x", signal, unit, scale)))
    found = table(f'"t ms", x\n0,{raw!r}\n1,0\n', mapping)
    assert found.columns[signal][0] == pytest.approx(value, rel=1e-15)
    assert found.time_s[1] == 1e-3


def test_offset_stands_in_the_unit_of_the_column(table):
    mapping = ColumnMap((MappedColumn("rpm", "velocity_rps", "rpm", offset=-60.0),), rate_hz=1.0)
    assert table("rpm\n120\n60\n", mapping).columns["velocity_rps"].tolist() == [1.0, 0.0]


@pytest.mark.parametrize(
    "text",
    [
        "# made by a logger\n% and more\n\n" + FIVE,
        "\ufeff" + FIVE,
        FIVE.replace("\n", "\r\n"),
        FIVE.replace(",", ";"),
        FIVE.replace(",", "\t"),
        FIVE.replace(",", "   "),
        FIVE.replace("\n", "\n\n"),
        "# " + FIVE,  # as numpy.savetxt writes names
        FIVE.rstrip("\n"),
        FIVE.replace("time_s,current_a", '"time_s", "current_a"'),
    ],
)
def test_dialects(table, text):
    found = table(text)
    assert found.columns["current_a"].tolist() == [1.5, 1.25, -1.0, 0.5, 0.25]
    assert found.time_s.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FIVE.replace("1.25", "x1"), r"log\.csv, line 3, column 'current_a': 'x1' is not a number"),
        (FIVE.replace("1.25", ""), r"line 3, column 'current_a': the cell is empty"),
        (FIVE.replace("1.25", "nan"), r"line 3, column 'current_a' \(current_a\): nan"),
        (FIVE.replace("4.5", "-inf"), r"line 4, column 'velocity_rps' .*-inf"),
        ("# c\n\n" + FIVE.replace("1.25", "nan"), r"line 5, column 'current_a'"),
        (FIVE.replace(",1.25,", ",1.25,0,"), r"line 3: 4 cells, but the header names 3"),
        (FIVE.replace(",4.5", ""), r"line 4: 2 cells"),
        (FIVE.replace("0.2,-1", "0.1,-1"), r"line 4: the stamp of the line before again"),
        (FIVE.replace("0.3,", "0.05,"), r"line 5: time runs backwards, 0.2 s to 0.05 s"),
        (FIVE.replace("0.4,", "0.6,"), r"line 6: a gap in time of 0.3 s \(3.0 periods\)"),
        (FIVE.replace(",", ";").replace(".", ","), r"line 2, column 'time_s': '0,0' has a decimal comma"),
        (FIVE.split("\n", 1)[1], r"line 1: numbers where the names"),
        (FIVE.replace("current_a", "time_s"), r"'time_s' stands 2 times"),
        ("time_s,current_a\n", "no line of numbers"),
        ("time_s,current_a\n1,2\n", "1 rows of numbers"),
        ("", "no line with names"),
        ("a,b\n1,2\n3,4\n", r"no column is named as a signal \(a, b\): give a column map"),
        (FIVE.replace("time_s", "time"), r"nothing gives time_s: did you mean 'time'"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(table, text, message):
    with pytest.raises(RecordingError, match=message):
        table(text)


def test_all_faults_of_the_data_at_once(table):
    text = FIVE.replace("1.25", "nan").replace("4.5", "nan").replace("0.4,", "0.9,").replace("0.3,", "0.2,")
    with pytest.raises(RecordingError) as caught:
        table(text)
    for part in ("'current_a'", "'velocity_rps'", "a gap", "stamp of the line before"):
        assert part in str(caught.value)


def test_rounded_stamps_get_advice(table):
    lines = [f"{i / 2000:.3f},{i}" for i in range(100)]
    with pytest.raises(RecordingError, match="rounded: leave the column out and give rate_hz"):
        table("time_s,current_a\n" + "\n".join(lines))


def test_gaps_may_be_allowed(table):
    found = table(FIVE.replace("0.4,", "0.9,"), uneven_time=True)
    assert found.gaps == (4,)
    assert "line 6: a gap" in found.warnings[0]
    assert "log.csv" in found.warnings[0]


def test_constant_columns_are_a_warning(table):
    (warning,) = table("time_s,current_a,velocity_rps\n0,1,2\n1,1,3\n").warnings
    assert "column 'current_a' (current_a) is 1 throughout" in warning


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        (ColumnMap((MappedColumn("curent", "current_a"),), 1.0), "no column 'curent': did you mean 'current_a'"),
        (ColumnMap((MappedColumn("current_a", "current"),), 1.0), "no signal 'current': did you mean"),
        (
            ColumnMap((MappedColumn("current_a", "velocity_rps", "RPM"),), 1.0),
            "'RPM' is no unit .* did you mean 'rpm'",
        ),
        (ColumnMap((MappedColumn("current_a", "velocity_rps", "m/s"),), 1.0), "on a rotary axis"),
        (ColumnMap((MappedColumn("current_a", "current_a", scale=0.0),), 1.0), "scale 0.0"),
        (ColumnMap((MappedColumn("a", "current_a"), MappedColumn("b", "current_a")), 1.0), "mapped twice"),
        (ColumnMap((MappedColumn("time_s", "time_s"),), 1.0), "leave one out"),
        (ColumnMap((MappedColumn("current_a", "current_a"),), -1.0), "positive"),
        (ColumnMap((MappedColumn("current_a", "current_a"),)), "nothing gives time_s"),
        (ColumnMap((MappedColumn("current_a", "current_a"),), 1.0, extra=("current_a",)), "mapped already"),
    ],
)
def test_mistakes_in_the_map(table, mapping, message):
    with pytest.raises(RecordingError, match=message):
        table(FIVE, mapping)


def test_required_signals(table):
    with pytest.raises(RecordingError, match="nothing gives reference_rps"):
        table(FIVE, require=("time_s", "current_a", "reference_rps"))


def test_torn_gzip_and_unknown_kinds(tmp_path):
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(FIVE.encode() * 100)[:-20])
    with pytest.raises(RecordingError, match="not whole"):
        read_table(path)
    with pytest.raises(RecordingError, match="unknown kind"):
        read_table(tmp_path / "log.xlsx")
    with pytest.raises(FileNotFoundError):
        read_table(tmp_path / "none.csv")
    with pytest.raises(FileNotFoundError):
        read_table(tmp_path / "none.mat")
    with pytest.raises(RecordingError, match="leave the column map out"):
        read_log(tmp_path / "run.mcap", LINEAR)


def mat_file(path: Path, **changes) -> Path:
    count = 40
    content = {
        "t": np.arange(count)[:, None] * 1e-3,
        "qm": np.linspace(0.0, 0.1, count)[:, None],
        "qg": np.linspace(0.0, 0.1, count)[:, None],
        "vir": np.sin(np.arange(count))[None, :],
        "gtau": 35.15,
        "note": "text",
        "log": {"velocity": np.arange(count) * 1.0, "deep": {"current": np.arange(count) * 2}},
        **changes,
    }
    savemat(path, {name: value for name, value in content.items() if value is not None})
    return path


def test_mat_files(tmp_path):
    found = read_table(mat_file(tmp_path / "a.mat"), LINEAR)
    assert found.units == {"time_s": "s", "current_command_a": "V", "position_rev": "m", "qg": "-"}
    assert found.scalars == {"gtau": 35.15}
    assert found.columns["position_rev"][-1] == pytest.approx(0.1)
    fields = ColumnMap((MappedColumn("t", "time_s"), MappedColumn("log.deep.current", "current_a")))
    assert read_table(tmp_path / "a.mat", fields).columns["current_a"].tolist() == list(range(0, 80, 2))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"qm": None}, "no variable 'qm': there is .*, qg, t"),
        ({"qm": np.zeros((4, 10))}, r"'qm' has shape \(4, 10\)"),
        ({"qm": np.zeros(40) + 1j}, "type complex128"),
        ({"qm": np.zeros(39)}, "unequal length: t 40, vir 40, qm 39"),
        (
            {"vir": np.where(np.arange(40) == 7, np.nan, 1.0)},
            r"sample 8, column 'vir' \(current_command_a\): nan",
        ),
        ({"t": np.arange(40) % 20 * 1e-3}, "sample 21: time runs backwards"),
    ],
)
def test_mat_files_with_faults(tmp_path, changes, message):
    with pytest.raises(RecordingError, match=message):
        read_table(mat_file(tmp_path / "a.mat", **changes), LINEAR)


@settings(max_examples=60)
@given(data=st.binary(max_size=300), header=st.booleans())
def test_bytes_that_are_no_mat_file(tmp_path_factory, data, header):
    path = tmp_path_factory.getbasetemp() / "noise.mat"
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" if header else b""
    path.write_bytes(head + data)
    with pytest.raises(RecordingError):
        read_table(path, LINEAR)


@settings(max_examples=100)
@given(data=st.text(alphabet='0123456789.,;\n\t -e#%naif"ti_s\r\0é', max_size=80))
def test_any_text_is_read_or_refused_with_its_name(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "noise.csv"
    path.write_text("time_s,current_a\n" + data)
    try:
        found = read_table(path)
    except RecordingError as error:
        assert "noise.csv" in str(error)  # noqa: PT017
        return
    assert np.isfinite(found.columns["current_a"]).all()
    assert (np.diff(found.time_s) > 0.0).all()


@pytest.mark.slow
def test_logs_of_the_blind_drives():
    """2 kHz, no gap, all columns."""
    for path in sorted({*shared_files("blind/*/recipe.csv.gz"), *shared_files("blind/d01/*.csv.gz")}):
        found = read_table(path, require=("time_s", "current_command_a", "current_a", "velocity_rps", "position_rev"))
        assert found.warnings == ()
        assert found.period_s == pytest.approx(5e-4, rel=1e-6)
        assert ("reference_rps" in found.columns) == ("identify" not in path.name)


def test_measured_emps_files():
    """24841 samples at 1 kHz and the constants of the authors."""
    for path in shared_files("emps/*.mat"):
        found = read_table(path, LINEAR)
        assert len(found.time_s) == 24841
        assert found.period_s == pytest.approx(1e-3, rel=1e-3)
        assert found.scalars["kp"] == 160.18
        assert found.warnings == ()


@pytest.mark.parametrize("linear", [False, True])
def test_every_signal_can_be_mapped_in_its_own_unit(linear):
    columns = tuple(MappedColumn(name.upper(), name) for name in SIGNAL_UNITS)
    found = conversions(ColumnMap(columns, linear=linear))
    assert {name: (one.factor, one.shift) for name, one in found.items()} == dict.fromkeys(SIGNAL_UNITS, (1.0, 0.0))
