"""Torn and damaged files: the whole chunks are read, the rest is named, nothing is raised."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from recording.samples import WALL_NS, random_rows, same_bits, write_run
from rosbags.highlevel import AnyReader

from fffo_drive.cli import main
from fffo_drive.recording.container import MAGIC
from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.events import Event, Level
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.recover import recover
from fffo_drive.recording.schema import ROW_TOPIC
from fffo_drive.recording.writer import RunWriter

ROWS = random_rows(400, seed=5)


def sample_file(directory, compression) -> Path:
    """A file with all kinds of records: metadata, attachment, chunks of rows and events, indexes, summary."""
    path = directory / f"{compression}.mcap"
    writer = RunWriter(
        path,
        {"axis": "bench"},
        [("a", "text/plain", b"A" * 300)],
        WALL_NS,
        chunk_size=6000,
        compression=compression,
    )
    for begin in range(0, len(ROWS), 50):
        writer.write_rows(ROWS[begin : begin + 50])
        writer.write_event(Event(WALL_NS + begin, Level.INFO, "loop", "state", {"begin": begin}))
    writer.close()
    return path


@pytest.fixture(scope="module", params=["zstd", "none"])
def sample(request, tmp_path_factory) -> Path:
    """A whole file; the tests cut and damage copies of it."""
    return sample_file(tmp_path_factory.mktemp("torn"), request.param)


@pytest.mark.slow
def test_cut_off_anywhere(sample, tmp_path):
    """At every byte of the first and last 300, and every 211th between: a prefix of the rows, no exception."""
    path = tmp_path / "cut.mcap.part"
    whole = sample.read_bytes()
    size = len(whole)
    cuts = {*range(300), *range(300, size, 211), *range(size - 300, size)}
    last = 0
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        run = read_run(path)
        assert not run.complete
        assert f"ends at byte {cut}" in run.reason
        assert same_bits(run.rows, ROWS[: len(run.rows)])
        assert len(run.rows) >= last
        last = len(run.rows)
    assert last == len(ROWS)
    path.write_bytes(whole)
    assert read_run(path).complete


@pytest.mark.parametrize(
    "words", [["replay"], ["identify", "--out", "new"], ["diagnose", "--out", "new", "--fit"], ["evaluate", "--runs"]]
)
@pytest.mark.parametrize("size", [0, 8])
def test_what_a_torn_file_lacks_is_said_with_the_tear(words, size, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "torn.mcap"
    path.write_bytes(MAGIC[:size])
    assert main([*words, str(path)]) == 78
    said = capsys.readouterr().err
    assert f"torn.mcap ends at byte {size}" in said
    assert "log recover" not in said  # there is nothing to recover


@settings(max_examples=150)
@given(data=st.data())
def test_flipped_bytes(sample, tmp_path_factory, data):
    """Damage inside: either a prefix of the rows with the reason, or a clear error; rows are never wrong."""
    damaged = bytearray(sample.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= data.draw(st.integers(1, 255))
    path = tmp_path_factory.getbasetemp() / "flipped.mcap"
    path.write_bytes(damaged)
    try:
        run = read_run(path)
    except RecordingError as error:
        assert str(path) in str(error)  # noqa: PT017
        return
    assert same_bits(run.rows, ROWS[: len(run.rows)])
    if run.complete:
        assert len(run.rows) == len(ROWS)


@settings(max_examples=100)
@given(data=st.binary(max_size=400))
def test_bytes_behind_the_magic(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "noise.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + data)
    assert not read_run(path).complete


def test_no_recording_at_all(tmp_path):
    path = tmp_path / "x.mcap"
    path.write_text("time_s,current_a\n")
    with pytest.raises(RecordingError, match="not an MCAP file"):
        read_run(path)
    path.write_bytes(b"")
    run = read_run(path)
    assert (run.complete, len(run.rows), run.columns["time_s"].size) == (False, 0, 0)
    with pytest.raises(FileNotFoundError):
        read_run(tmp_path / "none.mcap")


def opened_by_others(path, rows):
    """mcap by its index, and rosbags, see the same rows."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = b"".join(message.data[4:] for _, _, message in reader.iter_messages(topics=ROW_TOPIC))
        assert reader.get_summary().statistics.message_count >= len(rows)
    assert found == rows.tobytes()
    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic == ROW_TOPIC]
        ticks = [reader.deserialize(raw, c.msgtype).tick for c, _, raw in reader.messages(connections=connections)]
    assert ticks == rows["tick"].tolist()


@settings(max_examples=25)
@given(share=st.floats(0.0, 1.0))
def test_recovered_files_are_whole(sample, tmp_path_factory, share):
    directory = tmp_path_factory.mktemp("recover")
    torn = directory / "a.mcap.part"
    torn.write_bytes(sample.read_bytes()[: int(share * sample.stat().st_size)])
    before = read_run(torn)
    if torn.stat().st_size < 60:  # not even the header
        with pytest.raises(RecordingError, match="nothing to recover"):
            recover(torn, directory / "b.mcap")
        assert os.listdir(directory) == ["a.mcap.part"]
        return
    report = recover(torn, directory / "b.mcap")
    after = read_run(directory / "b.mcap")
    assert after.complete
    assert same_bits(after.rows, before.rows)
    assert (after.events, after.attachments) == (before.events, before.attachments)
    assert report.rows == len(before.rows)
    assert report.messages == len(before.rows) + len(before.events)
    assert report.was_complete == before.complete
    assert report.bytes_in == torn.stat().st_size
    assert after.summary["recovered"] == "true"
    assert after.summary["rows"] == str(report.rows)
    if before.metadata:
        assert after.metadata == dict(before.metadata) | {
            "recovered": "true",
            "recovered_from": "a.mcap.part",
        }
    if report.rows:
        opened_by_others(directory / "b.mcap", before.rows)


def test_recover_overwrites_nothing(sample, tmp_path):
    (tmp_path / "a.mcap").write_bytes(sample.read_bytes())
    (tmp_path / "b.mcap").write_bytes(b"mine")
    with pytest.raises(FileExistsError):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    with pytest.raises(FileExistsError):
        recover(tmp_path / "a.mcap", tmp_path / "a.mcap")
    assert (tmp_path / "b.mcap").read_bytes() == b"mine"
    with pytest.raises(FileNotFoundError):
        recover(tmp_path / "none.mcap", tmp_path / "c.mcap")
    (tmp_path / "text").write_text("hello, this is text")
    with pytest.raises(RecordingError, match="not an MCAP file"):
        recover(tmp_path / "text", tmp_path / "c.mcap")
    assert sorted(os.listdir(tmp_path)) == ["a.mcap", "b.mcap", "text"]


def test_damaged_chunk_ends_the_recovery_in_front_of_it(tmp_path):
    whole = write_run(tmp_path / "a.mcap", ROWS, flush_every=100).read_bytes()
    clean = read_run(tmp_path / "a.mcap")
    chunk = whole.index(b"\x28\xb5\x2f\xfd", whole.index(b"\x28\xb5\x2f\xfd") + 1)  # the second zstd frame
    (tmp_path / "b.mcap").write_bytes(whole[: chunk + 500] + bytes(20) + whole[chunk + 520 :])
    run = read_run(tmp_path / "b.mcap")
    assert "is damaged at byte" in run.reason
    assert same_bits(run.rows, ROWS[:100])
    report = recover(tmp_path / "b.mcap", tmp_path / "c.mcap")
    assert (report.rows, report.was_complete) == (100, False)
    assert report.bytes_discarded > len(whole) // 2
    assert read_run(tmp_path / "c.mcap").attachments == clean.attachments


WRITE_UNTIL_KILLED = """
import sys
from recording.samples import WALL_NS, random_rows
from fffo_drive.recording.writer import RunWriter
writer = RunWriter(sys.argv[1], {"axis": "bench"}, [("a", "text/plain", b"A")], WALL_NS)
rows = random_rows(200_000, seed=9)
for begin in range(0, len(rows), 100):
    writer.write_rows(rows[begin:begin + 100])
    if begin % 2000 == 1900:
        writer.flush()
        print(begin + 100, flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("flushes", [1, 7])
def test_killed_process_loses_only_what_was_not_flushed(tmp_path, flushes):
    path = tmp_path / "a.mcap"
    roots = [os.path.dirname(os.path.dirname(__file__)), os.getcwd(), *sys.path]
    process = subprocess.Popen(
        [sys.executable, "-c", WRITE_UNTIL_KILLED, str(path)],
        stdout=subprocess.PIPE,
        env=dict(os.environ, PYTHONPATH=os.pathsep.join(roots)),
        text=True,
    )
    with process:
        flushed = [int(process.stdout.readline()) for _ in range(flushes)][-1]
        process.send_signal(signal.SIGKILL)
        flushed = max([flushed, *(int(line) for line in process.stdout)])
    assert os.listdir(tmp_path) == ["a.mcap.part"]
    torn = read_run(tmp_path / "a.mcap.part")
    assert not torn.complete
    assert len(torn.rows) >= flushed
    assert same_bits(torn.rows, random_rows(200_000, seed=9)[: len(torn.rows)])
    report = recover(tmp_path / "a.mcap.part", path)
    assert report.rows == len(torn.rows)
    assert read_run(path).attachments["a"].data == b"A"
    opened_by_others(path, torn.rows[: len(torn.rows)])
    assert np.array_equal(np.diff(torn.log_time_ns), np.full(len(torn.rows) - 1, 500_000))
