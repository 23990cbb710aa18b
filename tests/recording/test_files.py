"""What is no file, or could be no table, is refused with its line before anything parses it."""

from __future__ import annotations

import gzip
import io
import json
import os
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.importing import binary
from fffo_drive.importing.log import read_log
from fffo_drive.importing.read import read_source
from fffo_drive.recording import files
from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.files import LONGEST_LINE_BYTES, MOST_COLUMNS, table_text
from fffo_drive.recording.reader import read_head, read_run
from fffo_drive.recording.recover import recover


def column_names(path):
    return list(read_source(path, rows=False).columns)


TEXT_READERS = (read_source, read_log, column_names)


@pytest.mark.parametrize("read", TEXT_READERS)
@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " ", "  "])
def test_more_columns_than_a_log_has_are_refused_with_their_line(tmp_path, read, delimiter):
    path = tmp_path / "log.csv"
    path.write_text("a log\n\n" + (delimiter.join(["1.5"] * (MOST_COLUMNS + 1)) + "\n") * 3)
    with pytest.raises(RecordingError, match=rf"{path}, line 3: {MOST_COLUMNS + 1} columns; at most {MOST_COLUMNS}"):
        read(path)


@pytest.mark.parametrize("read", TEXT_READERS)
@pytest.mark.parametrize(("line_end", "packed"), [("\n", False), ("\r\n", False), ("\r", False), ("\n", True)])
def test_a_line_longer_than_one_of_a_table_is_refused_with_its_place(tmp_path, read, line_end, packed):
    path = tmp_path / ("log.csv.gz" if packed else "log.csv")
    lines = ["time_s,velocity_rps", "0,1", "1" * (LONGEST_LINE_BYTES + 1), "2,3", ""]
    content = line_end.join(lines).encode()
    path.write_bytes(gzip.compress(content) if packed else content)
    with pytest.raises(
        RecordingError, match=rf"{path}, line 3: a line of \d+ bytes; a table has at most {LONGEST_LINE_BYTES}"
    ):
        read(path)


def test_as_many_columns_as_may_be_and_a_long_comment_are_read(tmp_path):
    path = tmp_path / "log.csv"
    names = [f"signal_{k}" for k in range(MOST_COLUMNS)]
    rows = [",".join([f"{row}.125"] * MOST_COLUMNS) for row in range(3)]
    path.write_text("\n".join(["# " + "made,by," * 5000, ",".join(names), *rows, ""]))
    assert column_names(path) == names
    source = read_source(path)
    assert list(source.columns) == names
    np.testing.assert_array_equal(source.columns[names[-1]], [0.125, 1.125, 2.125])


@given(st.lists(st.integers(0, 60), max_size=60), st.integers(0, 60))
def test_the_first_line_that_is_too_long_is_found_and_no_other(tmp_path_factory, lengths, excess):
    path = tmp_path_factory.mktemp("log") / "log.txt"
    path.write_text("\n".join("x" * length for length in lengths))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "MOST_COLUMNS", 5)
        patch.setattr(files, "LONGEST_LINE_BYTES", excess)
        first = next((k for k, length in enumerate(lengths) if length > max(5, excess)), None)
        if first is None:
            assert table_text(path) == path.read_text()
        else:
            with pytest.raises(RecordingError, match=rf", line {first + 1}: a line of {lengths[first]} bytes"):
                table_text(path)


def test_text_that_unpacks_to_more_than_can_be_read_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "LARGEST_TEXT_BYTES", 10_000)
    text = b"time_s,velocity_rps\n" + b"0,0\n" * 3000
    plain, packed = tmp_path / "log.csv", tmp_path / "log.csv.gz"
    plain.write_bytes(text)
    packed.write_bytes(gzip.compress(text))
    for path in (plain, packed):
        with pytest.raises(RecordingError, match=rf"{path}: .* 10000 .*split it"):
            read_log(path)


def to_out(path):
    return recover(path, path.with_name("whole.mcap"))


@pytest.mark.parametrize("read", [*TEXT_READERS, read_run, read_head, to_out])
@pytest.mark.parametrize("kind", ["a pipe", "a device"])
def test_what_is_no_file_is_not_waited_for(tmp_path, read, kind):
    for suffix in (".csv", ".mat", ".mcap"):
        path = tmp_path / f"log{suffix}"
        if kind == "a pipe":
            os.mkfifo(path)
        else:
            path.symlink_to("/dev/zero")
        with pytest.raises(RecordingError, match=rf"{path}: is {kind}, and one file is expected"):
            read(path)


@pytest.mark.parametrize("content", ["[" * 100_000, '{"a":' * 100_000])
def test_json_that_is_too_deep_is_refused(tmp_path, content):
    path = tmp_path / "log.json"
    path.write_text(content)
    with pytest.raises(RecordingError, match="nested too deeply"):
        read_source(path)


def test_records_and_arrays_of_too_many_columns_are_refused(tmp_path):
    records = tmp_path / "log.json"
    records.write_text(json.dumps([{f"k{k}": k for k in range(MOST_COLUMNS + 1)}] * 2))
    matrix = tmp_path / "log.npy"
    np.save(matrix, np.zeros((MOST_COLUMNS + 2, MOST_COLUMNS + 1), dtype=np.int8))
    for path in (records, matrix):
        with pytest.raises(RecordingError, match=rf"{path}, .*: {MOST_COLUMNS + 1} columns"):
            read_source(path)


def test_arrays_that_unpack_to_far_more_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "log.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        content = io.BytesIO()
        np.save(content, np.zeros(10_000_000))
        file.writestr("time_s.npy", content.getvalue())
    with pytest.raises(RecordingError, match=rf"{path}: unpacks to more than"):
        read_source(path)
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr(binary, "LARGEST_ARRAYS_BYTES", 1_000_000)
    path = tmp_path / "log.parquet"
    parquet.write_table(pyarrow.table({"time_s": np.zeros(200_000)}), path)
    with pytest.raises(RecordingError, match=rf"{path}: unpacks to more than 1000000 bytes"):
        read_source(path)
