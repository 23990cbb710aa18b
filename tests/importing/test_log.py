"""Tables of other programs: values, units, and clear words about everything that is wrong with them."""

from __future__ import annotations

import gzip
import json
import re
import shlex
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from importing.axis_log import Dialect, as_text, raw_columns, truth
from mcap.writer import Writer
from scipy.io import savemat
from shared_data import shared_files

import fffo_drive as fd
from fffo_drive.cli import main
from fffo_drive.documents import DocumentError
from fffo_drive.identification.dataset import load_record
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.importing.candidates import DeclaredColumn, Hints
from fffo_drive.importing.log import SIGNAL_UNITS, read_log
from fffo_drive.importing.read import read_source
from fffo_drive.recording.errors import RecordingError

FIVE = "time_s,current_a,velocity_rps\n0.0,1.5,2\n0.1,1.25,3\n0.2,-1,4.5\n0.3,0.5,5\n0.4,0.25,6\n"
LINEAR = Hints(
    linear=True,
    columns=(
        DeclaredColumn("t", "time_s"),
        DeclaredColumn("vir", "current_command_a", "V"),
        DeclaredColumn("qm", "position_rev", "mm", scale=1e3),
    ),
)


def declared(*columns: DeclaredColumn, rate_hz: float | None = None) -> Hints:
    return Hints(rate_hz, columns=columns)


def lines(count: int, changes: dict[int, str]) -> str:
    """Rows at 10 Hz under our names; some of them (counted from line 2) changed."""
    rows = [f"{0.1 * k:.1f},{0.5 * (k % 7)},{k % 5}" for k in range(count)]
    for line, text in changes.items():
        rows[line - 2] = text
    return "\n".join(["time_s,current_a,velocity_rps", *rows, ""])


@pytest.fixture
def table(tmp_path):
    """Write a text, read it as a log."""

    def read(text: str, hints: Hints | None = None, name: str = "log.csv"):
        (tmp_path / name).write_bytes(text.encode())
        return read_log(tmp_path / name, hints)

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
    found = read_log(
        path,
        declared(
            DeclaredColumn("current_a", "current_a"), DeclaredColumn("velocity_rps", "velocity_rps"), rate_hz=500.0
        ),
    )
    assert np.array_equal(found.columns["current_a"], [a for a, _ in values])
    assert np.array_equal(found.columns["velocity_rps"], [b for _, b in values])
    assert np.array_equal(found.columns["time_s"], np.arange(len(values)) / 500.0)


def test_columns_by_their_own_names(table):
    found = table(FIVE)
    assert list(found.columns) == ["time_s", "current_a", "velocity_rps"]
    assert found.remarks == ()
    assert found.columns["velocity_rps"].flags.c_contiguous


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
    hints = declared(DeclaredColumn("t ms", "time_s", "ms"), DeclaredColumn("x", signal, unit, scale))
    found = table(f'"t ms", x\n0,{raw!r}\n1,0\n', hints)
    assert found.columns[signal][0] == pytest.approx(value, rel=1e-15)
    assert found.columns["time_s"][1] == 1e-3


def test_offset_stands_in_the_unit_of_the_column(table):
    hints = declared(DeclaredColumn("rpm", "velocity_rps", "rpm", offset=-60.0), rate_hz=1.0)
    assert table("rpm\n120\n60\n", hints).columns["velocity_rps"].tolist() == [1.0, 0.0]


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
    assert found.columns["time_s"].tolist() == [0.0, 0.1, 0.2, 0.3, 0.4]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FIVE.replace("1.25", "x1"), r"log\.csv, line 3, column 'current_a': 'x1' is not a number"),
        (FIVE.replace("1.25", ""), r"20 % of its rows would be left out .*line 3, column 'current_a'"),
        (FIVE.replace("1.25", "nan"), r"line 3, column 'current_a'"),
        (FIVE.replace("4.5", "-inf"), r"line 4, column 'velocity_rps'"),
        ("# c\n\n" + FIVE.replace("1.25", "nan"), r"line 5, column 'current_a'"),
        (FIVE.replace("0.2,-1", "0.1,-1"), r"whose stamp is not later .* the first is line 4"),
        (FIVE.replace("0.3,", "0.05,"), r"whose stamp is not later .* the first is line 5"),
        (FIVE.replace("current_a", "time_s"), r"'time_s' stands several times"),
        ("time_s,current_a\n", "no lines of numbers"),
        ("time_s,current_a\n1,2\n", "1 rows of numbers"),
        ("", "the file is empty"),
        ("a,b\n1,2\n3,4\n", r"no time can be seen among the columns 'a', 'b'.*\n.*import .*log\.csv .*--rate HZ"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(table, text, message):
    with pytest.raises(RecordingError, match=message):
        table(text)


@pytest.mark.parametrize(
    ("changes", "share"),
    [
        ({5: "0.3,,4"}, None),
        ({5: "0.3,nan,4", 6: "0.4,1,"}, None),
        ({line: "0.1,nan,4" for line in range(5, 9)}, "1.33"),
        ({line: f"0.3,1,{line}" for line in range(5, 12)}, "2"),
    ],
)
def test_up_to_a_hundredth_of_the_rows_may_be_left_out_and_is_told(table, changes, share):
    text = lines(300, changes)
    if share is not None:
        with pytest.raises(RecordingError, match=rf"{share} % of its rows would be left out.*\n.*import .*--drop$"):
            table(text)
        return
    found = table(text)
    assert found.columns["time_s"].size == 300 - len(changes)
    (said,) = found.remarks
    assert f"{len(changes)} of 300 rows miss a number and are left out" in said
    assert "log.csv: " in said
    assert "line 5, column 'current_a'" in said


def test_a_last_line_that_is_cut_is_left_out(table):
    found = table(FIVE.removesuffix(",6\n"))
    assert found.columns["time_s"].size == 4
    assert "the last line ends in the middle" in found.remarks[0]


def test_several_runs_in_one_file_are_for_import(table):
    text = lines(60, {})
    assert table(text + text.partition("\n")[2]).columns["time_s"].size == 60  # one run that was written twice
    text = lines(60, {7: "0.5,2,2"})
    with pytest.raises(RecordingError, match=r"holds 2 runs.*\n.*fffo-drive import .*log\.csv --out log_imported$"):
        table(text + lines(60, {}).partition("\n")[2])


def test_constant_columns_are_told(table):
    (told,) = table("time_s,current_a,velocity_rps\n0,1,2\n1,1,3\n").remarks
    assert "column 'current_a' (current_a) is 1 throughout" in told


OWN = DeclaredColumn("current_a", "current_a")


@pytest.mark.parametrize(
    ("hints", "message"),
    [
        (declared(DeclaredColumn("curent", "current_a"), rate_hz=1.0), "no column 'curent': did you mean 'current_a'"),
        (declared(DeclaredColumn("current_a", "current"), rate_hz=1.0), "no signal 'current': did you mean"),
        (
            declared(DeclaredColumn("current_a", "velocity_rps", "rpn"), rate_hz=1.0),
            "'rpn' is no unit .* did you mean .*'rpm'",
        ),
        (declared(DeclaredColumn("current_a", "velocity_rps", "m/s"), rate_hz=1.0), "on a rotary axis"),
        (declared(DeclaredColumn("current_a", "current_a", scale=0.0), rate_hz=1.0), "scale 0.0"),
        (declared(OWN), "nothing gives time_s"),
    ],
)
def test_mistakes_in_what_is_declared(table, hints, message):
    with pytest.raises(RecordingError, match=message):
        table(FIVE, hints)


def test_all_mistakes_at_once(table):
    hints = declared(DeclaredColumn("curent", "current_a"), DeclaredColumn("velocity_rps", "velocity_rps", "A"))
    with pytest.raises(RecordingError) as caught:
        table(FIVE, hints)
    for part in ("no column 'curent'", "'A' is no unit of velocity_rps", "nothing gives time_s"):
        assert part in str(caught.value)


def test_torn_gzip_and_what_is_not_there(tmp_path):
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(FIVE.encode() * 100)[:-20])
    with pytest.raises(RecordingError, match="not whole"):
        read_log(path)
    with pytest.raises(FileNotFoundError):
        read_log(tmp_path / "none.csv")
    with pytest.raises(FileNotFoundError):
        read_log(tmp_path / "none.mat")


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
    found = read_log(mat_file(tmp_path / "a.mat"), LINEAR)
    assert set(found.columns) == {"time_s", "current_command_a", "position_rev"}
    assert read_source(tmp_path / "a.mat").scalars == {"gtau": 35.15}
    assert found.columns["position_rev"][-1] == pytest.approx(0.1)
    fields = declared(DeclaredColumn("t", "time_s"), DeclaredColumn("log.deep.current", "current_a"))
    assert read_log(tmp_path / "a.mat", fields).columns["current_a"].tolist() == list(range(0, 80, 2))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"qm": None}, "no column 'qm': there is .*qg, t"),
        ({"qm": np.zeros((4, 10))}, "no column 'qm': there is"),
        ({"qm": np.zeros(40) + 1j}, "no column 'qm': holds no numbers"),
        ({"qm": np.zeros(39)}, "no column 'qm': has 39 samples, the others 40"),
        ({"vir": np.where(np.arange(40) == 7, np.nan, 1.0)}, r"row 8, column 'vir'"),
        ({"t": np.arange(40) % 20 * 1e-3}, "not later than all before are left out, the first is row 21"),
    ],
)
def test_mat_files_with_faults(tmp_path, changes, message):
    with pytest.raises(RecordingError, match=message):
        read_log(mat_file(tmp_path / "a.mat", **changes), LINEAR)


@settings(max_examples=60)
@given(data=st.binary(max_size=300), header=st.booleans())
def test_bytes_that_are_no_mat_file(tmp_path_factory, data, header):
    path = tmp_path_factory.getbasetemp() / "noise.mat"
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" if header else b""
    path.write_bytes(head + data)
    with pytest.raises(RecordingError):
        read_log(path, LINEAR)


@settings(max_examples=100)
@given(data=st.text(alphabet='0123456789.,;\n\t -e#%naif"ti_s\r\0é', max_size=80))
def test_any_text_is_read_or_refused_with_its_name(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "noise.csv"
    path.write_text("time_s,current_a\n" + data)
    try:
        found = read_log(path)
    except RecordingError as error:
        assert "noise.csv" in str(error)  # noqa: PT017
        return
    assert np.isfinite(found.columns["current_a"]).all()
    assert (np.diff(found.columns["time_s"]) > 0.0).all()


@pytest.mark.slow
def test_logs_of_the_blind_drives():
    """2 kHz, no gap, all columns."""
    for path in sorted({*shared_files("blind/*/recipe.csv.gz"), *shared_files("blind/d01/*.csv.gz")}):
        found = read_log(path)
        assert {"time_s", "current_command_a", "current_a", "velocity_rps", "position_rev"} <= set(found.columns)
        assert found.remarks == ()
        assert np.median(np.diff(found.columns["time_s"])) == pytest.approx(5e-4, rel=1e-6)
        assert ("reference_rps" in found.columns) == ("identify" not in path.name)


def test_measured_emps_files():
    """24841 samples at 1 kHz and the constants of the authors."""
    for path in shared_files("emps/*.mat"):
        found = read_log(path, LINEAR)
        assert found.columns["time_s"].size == 24841
        assert np.median(np.diff(found.columns["time_s"])) == pytest.approx(1e-3, rel=1e-3)
        assert read_source(path).scalars["kp"] == 160.18
        assert found.remarks == ()


@pytest.mark.parametrize("linear", [False, True])
def test_every_signal_can_be_declared_in_its_own_unit(table, linear):
    columns = tuple(DeclaredColumn(name.upper(), name) for name in SIGNAL_UNITS)
    rows = [",".join([str(value)] * len(columns)) for value in (1, 2)]
    text = "\n".join([",".join(column.column for column in columns), *rows])
    found = table(text, Hints(linear=linear, columns=columns))
    assert {name: values.tolist() for name, values in found.columns.items()} == {
        name: [1.0, 2.0] for name in SIGNAL_UNITS
    }


LOG = truth()
GERMAN = ["Zeit [ms]", "Position [deg]", "Geschwindigkeit [rpm]", "Strom [A]"]
DIALECT = Dialect(delimiter=";", decimal=",", time="ms", position="deg", speed="rpm")


def german(headings: list[str]) -> str:
    """A log with semicolons and decimal commas under these headings; a column of the heading "-" is left out."""
    rows = [headings, *(line.split(";") for line in as_text(LOG, DIALECT).splitlines()[1:])]
    kept = [k for k, name in enumerate(headings) if name != "-"]
    return "\n".join(";".join(row[k] for k in kept) for row in rows) + "\n"


def test_a_log_without_a_doubt_is_read_as_import_reads_it(tmp_path):
    columns = list(raw_columns(LOG, DIALECT).values())
    (tmp_path / "log.csv").write_text(german(GERMAN))
    np.savez(tmp_path / "log.npz", **dict(zip(GERMAN, columns, strict=True)))
    short = ("t_ms", "pos_deg", "speed_rpm", "current_A")
    savemat(tmp_path / "log.mat", dict(zip(short, columns, strict=True)))
    assert main(["import", str(tmp_path / "log.csv"), "--out", str(tmp_path / "out")]) == 0
    imported = fd.read_run(tmp_path / "out" / "log.mcap")
    for name in ("log.csv", "log.npz", "log.mat"):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            found = fd.read_run(tmp_path / name)
        assert "read as time_s = " in str(told[0].message)
        for signal in ("time_s", "position_rev", "velocity_rps", "current_a"):
            np.testing.assert_allclose(found[signal], imported[signal], rtol=1e-6, atol=1e-8, err_msg=name)


@pytest.mark.parametrize(
    ("headings", "asked", "options"),
    [
        (["Zeit [ms]", "phi", "-", "Strom [A]"], "'phi' .*rad is assumed", "--position phi --unit phi=rad"),
        (["Zeit [ms]", "phi [deg]", "-", "Strom"], "'Strom' .*A is assumed", "--current Strom --unit Strom=A"),
        (["-", "phi [deg]", "-", "Strom [A]"], "no time can be seen", "--rate HZ"),
        (["Zeit [ms]", "Encoder [counts]", "-", "Strom [A]"], "in counts", "--counts-per-turn N"),
        (["Zeit [ms]", "phi [deg]", "-", "Moment [Nm]"], "in Nm", ""),
        (["Zeit [ms]", "phi [mm]", "-", "Kraft [N]"], "a linear axis", ""),
        (["Zeit [ms]", "phi [deg]", "v [rps]", "Strom [A]"], "times the derivative", "--position phi --unit phi=deg"),
    ],
)
def test_the_line_that_is_given_answers_what_is_open(tmp_path, headings, asked, options, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.csv").write_text(german(headings))
    (tmp_path / "facts.yaml").write_text("torque_constant_nm_per_a: 0.1\n")
    assert main(["identify", "run.csv", "--drive", "facts.yaml", "--out", "model"]) == 78
    said = capsys.readouterr().err
    assert re.search(asked, said)
    line = said.rpartition("import it with: fffo-drive ")[2].strip()
    assert line.startswith("import run.csv --out run_imported")
    assert options in line
    assert main(shlex.split(line.replace(" HZ", " 500").replace(" N", " 360"))) == 0
    assert (tmp_path / "run_imported" / "run.mcap").exists()


def test_an_mcap_of_another_program_is_read_or_names_import(tmp_path, capsys):
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name="motor", encoding="jsonschema", data=b'{"type": "object"}')
        channel = writer.register_channel(topic="/motor", message_encoding="json", schema_id=schema)
        for stamp, place, current in zip(LOG.time_s, LOG.position_rev, LOG.current_a, strict=True):
            data = json.dumps({"pos_rev": place, "current_A": current}).encode()
            stamp_ns = round(1e9 * (1.0 + stamp))
            writer.add_message(channel_id=channel, log_time=stamp_ns, publish_time=stamp_ns, data=data)
        writer.finish()
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        found = fd.read_run(path)
    np.testing.assert_allclose(found["position_rev"], LOG.position_rev, atol=1e-9)
    facts = DriveFacts(torque_constant_nm_per_a=0.1)
    np.testing.assert_allclose(load_record(path, facts).position_rev, LOG.position_rev, atol=1e-6)
    assert main(["identify", str(path), "--out", str(tmp_path / "model")]) == 78
    assert f"fffo-drive import {path} --out DIR" in capsys.readouterr().err


def test_plain_numbers_are_read_without_pyarrow_and_others_say_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "plain.csv").write_text(german(["time_s", "position_rev", "velocity_rps", "current_a"]))
    (tmp_path / "other.csv").write_text(german(GERMAN).replace("\n", ";x\n"))
    found = read_source(tmp_path / "plain.csv").columns
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    again = read_source(tmp_path / "plain.csv").columns
    assert list(again) == list(found)
    assert all(np.array_equal(again[name], found[name]) for name in found)
    with pytest.raises(RecordingError, match=r"other\.csv: .*extra `import`: .*pyarrow"):
        read_source(tmp_path / "other.csv")


def test_columns_of_text_are_left_out_and_told(tmp_path):
    rows = german(GERMAN).splitlines()
    state = ["Zustand", *(["IDLE"] * 5), *(["RUN"] * (len(rows) - 6))]
    (tmp_path / "log.csv").write_text("\n".join(f"{row};{word}" for row, word in zip(rows, state, strict=True)))
    log = read_log(tmp_path / "log.csv")
    assert log.columns["time_s"].size == len(rows) - 1
    assert any("'Zustand' holds text" in remark for remark in log.remarks)


# From Python


class Frame:
    """As a data frame of pandas has it: columns by name, and an index."""

    def __init__(self, columns, index=None):
        self.of, self.columns, self.index = columns, list(columns), index

    def __getitem__(self, name):
        return Series(self.of[name])


class Series:
    def __init__(self, values, name=None):
        self.values, self.name = values, name

    def to_numpy(self):
        return self.values


def as_arrays(columns):
    return columns


def as_frame(columns):
    return Frame(columns)


def as_indexed_frame(columns):
    name, *others = columns
    return Frame({other: columns[other] for other in others}, Series(columns[name], name))


def as_arrow(columns):
    import pyarrow

    return pyarrow.table(columns)


@pytest.mark.parametrize("make", [as_arrays, as_frame, as_indexed_frame, as_arrow])
def test_arrays_and_frames_by_other_names_are_recognised_with_the_doubts_in_the_result(make):
    columns = dict(zip(["t [ms]", "phi", "Drehzahl", "Strom [A]"], raw_columns(LOG, DIALECT).values(), strict=True))
    run = fd.read_run(make(columns), torque_constant_nm_per_a=0.1)
    assert not run.doubts  # degrees with rpm: no other pair of units fits
    for signal, truth_of in (("position_rev", LOG.position_rev), ("velocity_rps", LOG.velocity_rps)):
        np.testing.assert_allclose(run[signal], truth_of, rtol=1e-9, atol=1e-9)
    assert run.record().measured_current_a is not None
    alone = {name: columns[name] for name in ("t [ms]", "phi", "Strom [A]")}
    (doubt,) = fd.read_run(make(alone), torque_constant_nm_per_a=0.1).doubts
    assert "position_rev is 'phi' [rad]: rad is assumed" in doubt
    known = fd.read_run(make(alone), torque_constant_nm_per_a=0.1, units={"phi": "deg"})
    assert not known.doubts
    np.testing.assert_allclose(known["position_rev"], LOG.position_rev)


def test_arrays_of_a_torque_need_no_constant_and_a_grave_doubt_is_an_error():
    columns = {"t [s]": LOG.time_s, "angle [deg]": 360.0 * LOG.position_rev, "torque [Nm]": 0.1 * LOG.current_a}
    run = fd.read_run(columns)
    assert run.facts.torque_constant_nm_per_a == 1.0
    np.testing.assert_allclose(run["current_a"], 0.1 * LOG.current_a)
    with pytest.raises(RecordingError, match=r"180/pi.*the inertia depends on it"):
        fd.read_run(columns | {"speed [rpm]": 60.0 * 180.0 / np.pi * LOG.velocity_rps})
    with pytest.raises(DocumentError, match="a data frame is needed, not int"):
        fd.read_run(3)
