"""Files that hold far more than they are: refused before the memory is filled; long standstills are read."""

from __future__ import annotations

import gzip
import io
import struct
import tracemalloc
import zlib
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Chunk, Header, Schema
from scipy.io import loadmat, savemat

from fffo_drive.cli import main
from fffo_drive.importing.log import read_log
from fffo_drive.importing.read import read_source
from fffo_drive.recording import unpack
from fffo_drive.recording.container import MAGIC, record_bytes
from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.mat_elements import unpacked
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.recover import recover
from fffo_drive.recording.unpack import FREE_BYTES, LARGEST_RATIO
from fffo_drive.recording.writer import RunWriter
from fffo_drive.signals import ROW

GIGABYTE = 10**9
LARGEST_MEMORY = 100_000_000  # bytes, of what Python and NumPy ask for
HEAD = MAGIC + record_bytes(Header("ros2", "somebody"))


@contextmanager
def little_memory():
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < LARGEST_MEMORY
    finally:
        tracemalloc.stop()


def zeros(size: int) -> bytes:
    """So many zeros, by zstd, without making them all at once."""
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    block = bytes(1 << 20)
    parts = [packer.compress(block[: min(len(block), size - at)]) for at in range(0, size, len(block))]
    return b"".join([*parts, packer.flush()])


def chunk(data: bytes, size: int, compression: str = "zstd") -> bytes:
    return record_bytes(
        Chunk(
            compression=compression, data=data, message_start_time=0, message_end_time=1, uncompressed_crc=0,
            uncompressed_size=size,
        )
    )  # fmt: skip


@pytest.fixture(scope="module")
def bomb(tmp_path_factory):
    path = tmp_path_factory.mktemp("bomb") / "zeros.mcap"
    path.write_bytes(HEAD + chunk(zeros(GIGABYTE), GIGABYTE))
    assert path.stat().st_size < 40_000
    return path


def test_a_gigabyte_of_zeros_in_30_kb_is_refused_by_all_who_read_recordings(bomb, tmp_path, capsys):
    facts = tmp_path / "facts.yaml"
    facts.write_text("torque_constant_nm_per_a: 0.1\n")
    with little_memory():
        with pytest.raises(RecordingError, match="unpacks to more than"):
            read_run(bomb)
        with pytest.raises(RecordingError, match="unpacks to more than"):
            recover(bomb, tmp_path / "whole.mcap")
        commands = (
            ["log", "info", str(bomb)],
            ["log", "recover", str(bomb), str(tmp_path / "other.mcap")],
            ["identify", str(bomb), "--drive", str(facts), "--out", str(tmp_path / "out")],
        )
        for words in commands:
            assert main(words) == 78
            assert f"{bomb}: unpacks to more than" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["facts.yaml"]


def test_many_chunks_that_are_each_allowed_are_counted_together(tmp_path):
    path = tmp_path / "many.mcap"
    message = struct.pack("<BQ", 5, FREE_BYTES) + bytes(FREE_BYTES)  # one, of a channel that nobody reads
    one = chunk(zstandard.ZstdCompressor().compress(message), len(message))
    del message
    path.write_bytes(HEAD + one * 20)
    with little_memory(), pytest.raises(RecordingError, match=f"{LARGEST_RATIO} times its size"):
        read_run(path)


def test_a_chunk_that_does_not_say_the_truth_about_its_size_is_damage(tmp_path):
    path = tmp_path / "lies.mcap"
    for stated in (1000, 1 << 62):
        path.write_bytes(HEAD + chunk(zeros(GIGABYTE), stated))
        with little_memory():
            run = read_run(path)
        assert not run.complete
        assert f"does not unpack to the {stated} bytes" in run.reason
    path.write_bytes(HEAD + chunk(b"x" * 100, 1 << 62, ""))
    assert "does not unpack" in read_run(path).reason


@pytest.mark.parametrize("opcode", [0, 2, 6, 0x80])
def test_a_chunk_holds_schemas_channels_and_messages_alone(tmp_path, opcode):
    path = tmp_path / "other.mcap"
    content = record_bytes(Schema(id=1, name="", encoding="", data=b"")) + struct.pack("<BQ", opcode, 0) * 100
    path.write_bytes(HEAD + chunk(content, len(content), ""))
    assert "in a chunk, which holds schemas, channels and messages" in read_run(path).reason


def test_zeros_behind_the_last_record_end_the_scan(tmp_path):
    path = tmp_path / "preallocated.mcap.part"
    path.write_bytes(HEAD)
    with path.open("r+b") as file:
        file.truncate(1 << 32)  # sparse: a file system that lost power leaves such
    run = read_run(path)
    assert f"is damaged at byte {len(HEAD)}: a record of kind 0" in run.reason


def test_a_standstill_of_minutes_is_read(tmp_path):
    """Rows in which nothing but tick and time changes: what a real recording packs best."""
    rows = np.zeros(400_000, ROW)
    rows["tick"] = np.arange(rows.size)
    rows["deadline_ns"] = rows["tick"].astype(np.int64) * 500_000 + GIGABYTE
    writer = RunWriter(tmp_path / "still.mcap", {})
    writer.write_rows(rows)
    path = writer.close()
    assert rows.nbytes / path.stat().st_size < 0.1 * LARGEST_RATIO
    run = read_run(path)
    assert run.complete
    assert (run.rows["tick"] == rows["tick"]).all()


def table(rows: int) -> str:
    return "time_s,velocity_rps\n" + "".join(f"{0.0005 * k:.4f},0\n" for k in range(rows))


def test_a_csv_file_that_unpacks_to_far_more_is_refused(tmp_path):
    path = tmp_path / "zeros.csv.gz"
    with gzip.open(path, "wb") as file:
        file.write(b"time_s,velocity_rps\n")
        for _ in range(100):
            file.write(b"0,0\n" * 250_000)
    with little_memory(), pytest.raises(RecordingError, match=rf"{path}: unpacks to more than"):
        read_log(path)


def test_a_csv_file_in_parts_cut_off_or_padded(tmp_path):
    path = tmp_path / "log.csv.gz"
    text = table(2000).encode()
    packed = gzip.compress(text[:1000]) + gzip.compress(text[1000:])
    path.write_bytes(packed + bytes(512))
    assert len(read_log(path).columns["time_s"]) == 2000
    for length in (len(packed) - 20, 40, 5):
        path.write_bytes(packed[:length])
        with pytest.raises(RecordingError, match=rf"{path}: the compressed file is not whole$"):
            read_log(path)


def mat(content: dict[str, object], **options: bool) -> bytes:
    file = io.BytesIO()
    savemat(file, content, **options)
    return file.getvalue()


def test_a_mat_file_that_unpacks_to_far_more_is_refused(tmp_path):
    path = tmp_path / "zeros.mat"
    path.write_bytes(mat({"time_s": np.zeros(12_500_000)}, do_compression=True))
    assert path.stat().st_size < 100_000
    with little_memory(), pytest.raises(RecordingError, match=rf"{path}: unpacks to more than"):
        read_log(path)


HOLDERS = {"c": np.array([1, 2], dtype=object), "s": {"a": 1.0, "c": np.array([3, 4], dtype=object)}}


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize("compressed", [False, True])
def test_an_array_that_says_it_holds_more_arrays_than_there_is_room_for_is_refused(tmp_path, nested, compressed):
    raw = mat(HOLDERS)
    two = struct.pack("<ii", 1, 2)
    at = raw.rindex(two) if nested else raw.index(two)
    raw = raw[:at] + struct.pack("<ii", 1, 100_000_000) + raw[at + 8 :]
    if compressed:
        packed = zlib.compress(raw[128:])
        raw = raw[:128] + struct.pack("<II", 15, len(packed)) + packed
    path = tmp_path / "cells.mat"
    path.write_bytes(raw)
    with little_memory(), pytest.raises(RecordingError, match=rf"{path}: not a whole MAT file"):
        read_log(path)


@pytest.mark.parametrize("form", ["4", "5"])
@pytest.mark.parametrize("compressed", [False, True])
def test_what_scipy_reads_is_the_same_unpacked(tmp_path, form, compressed):
    content = {"time_s": np.arange(500) * 5e-4, "gain": 0.25, "name": "axis"}
    content |= HOLDERS if form == "5" else {}
    path = tmp_path / "log.mat"
    path.write_bytes(mat(content, do_compression=compressed, format=form))
    flat = loadmat(io.BytesIO(unpacked(path)), squeeze_me=True)
    whole = loadmat(io.BytesIO(path.read_bytes()), squeeze_me=True)
    for name in content:
        assert repr(flat[name]) == repr(whole[name])
    table = read_source(path)
    assert table.scalars["gain"] == 0.25
    assert (table.columns["time_s"] == content["time_s"]).all()


@given(st.integers(0, 10_000), st.binary(min_size=1, max_size=8), st.booleans())
def test_a_damaged_mat_file_is_read_or_refused_in_our_words(tmp_path_factory, place, damage, compressed):
    path = tmp_path_factory.mktemp("mat") / "log.mat"
    raw = mat({"time_s": np.arange(20) * 5e-4, **HOLDERS}, do_compression=compressed)
    place %= len(raw)
    path.write_bytes(raw[:place] + damage + raw[place + len(damage) :])
    message = ""
    try:
        read_log(path)
    except RecordingError as error:
        message = str(error)
    assert not message or message.startswith(str(path))
    assert "Error" not in message.removeprefix(str(path))


@given(st.binary(max_size=2000), st.sampled_from([15, 31]))
def test_what_was_packed_is_unpacked(data, window_bits):
    packed = gzip.compress(data) if window_bits == 31 else zlib.compress(data)
    assert unpack.inflated(packed, window_bits, unpack.Allowance(Path("x"), len(packed))) == data
