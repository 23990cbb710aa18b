"""Files as written: round trip, agreement with mcap's writer and independent readers, errors of the disk."""

from __future__ import annotations

import io
import json
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, Writer
from recording.samples import PERIOD_NS, WALL_NS, Disk, random_rows, same_bits, write_run
from rosbags.highlevel import AnyReader

from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.events import EVENT_SCHEMA, Event, Level, encode_event
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.run_records import (
    RECORD_SCHEMA,
    RECORD_TOPIC,
    RECORD_TYPE,
    RunRecord,
    encode_record,
)
from fffo_drive.recording.schema import (
    CDR_HEADER,
    EVENT_TOPIC,
    EVENT_TYPE,
    METADATA_NAME,
    ROW_TOPIC,
    ROW_TYPE,
    SUMMARY_NAME,
    schema_text,
)
from fffo_drive.recording.settings import BinaryFile, open_new
from fffo_drive.recording.writer import LIBRARY, RunWriter, wall_clock_offset_ns
from fffo_drive.signals import ROW, UNITS

EVENT = Event(WALL_NS + 7, Level.ERROR, "loop", "trip: following error", {"code": 4, "limit_rev": 0.5})
RECORD = RunRecord(
    WALL_NS, 7, 3, "parameters", ("pi.proportional_a_per_rps", "b"), (0.1, 5e-324), {"model": "ab", "note": "µ"}
)


@settings(max_examples=30)
@given(
    count=st.integers(0, 700),
    batch=st.integers(1, 300),
    chunk_size=st.sampled_from([1, 500, 4096, 262144]),
    compression=st.sampled_from(["zstd", "none"]),
    seed=st.integers(0, 2**32),
)
def test_rows_come_back_bit_for_bit(tmp_path_factory, count, batch, chunk_size, compression, seed):
    path = tmp_path_factory.mktemp("run") / "a.mcap"
    rows = random_rows(count, seed)
    write_run(path, rows, batch, chunk_size=chunk_size, compression=compression)
    run = read_run(path)
    assert run.complete
    assert same_bits(run.rows, rows)
    assert np.array_equal(run.log_time_ns, rows["deadline_ns"] + WALL_NS)


def test_what_stands_beside_the_rows(tmp_path):
    writer = RunWriter(tmp_path / "a.mcap", {"axis": "bench"}, [("m.yaml", "application/yaml", b"x: 1\n")], WALL_NS)
    writer.write_event(EVENT)
    writer.write_rows(random_rows(10, first_tick=100))
    assert writer.close({"reason": "done"}) == tmp_path / "a.mcap"
    assert os.listdir(tmp_path) == ["a.mcap"]
    run = read_run(tmp_path / "a.mcap")
    assert run.metadata["axis"] == "bench"
    assert run.metadata["time_offset_ns"] == str(WALL_NS)
    assert run.attachments["m.yaml"].data == b"x: 1\n"
    assert run.events == (EVENT,)
    assert run.units == UNITS
    expected = {"rows": "10", "events": "1", "first_tick": "100", "last_tick": "109", "reason": "done"}
    assert expected.items() <= run.summary.items()


def test_same_bytes_as_the_writer_of_mcap(tmp_path):
    """Record by record and offset by offset: the file is what mcap's own writer makes of the same calls."""
    rows = random_rows(3000, seed=3)
    writer = RunWriter(
        tmp_path / "a.mcap",
        {"axis": "bench"},
        [("m", "text/plain", b"abc")],
        WALL_NS,
        wall_ns=lambda: WALL_NS,
    )
    writer.write_rows(rows[:1700])
    writer.write_event(EVENT)
    writer.write_record(RECORD, EVENT.time_ns)
    writer.write_rows(rows[1700:2000])
    writer.flush()
    writer.write_rows(rows[2000:])
    writer.close()
    run = read_run(tmp_path / "a.mcap")

    stream = io.BytesIO()
    other = Writer(stream, chunk_size=256 * 1024, compression=CompressionType.ZSTD)
    other.start("ros2", LIBRARY)
    other.add_metadata(METADATA_NAME, dict(run.metadata))
    other.add_attachment(WALL_NS, WALL_NS, "m", "text/plain", b"abc")
    row_schema = other.register_schema(ROW_TYPE, "ros2msg", schema_text().encode())
    event_schema = other.register_schema(EVENT_TYPE, "ros2msg", EVENT_SCHEMA.encode())
    record_schema = other.register_schema(RECORD_TYPE, "ros2msg", RECORD_SCHEMA.encode())
    row_channel = other.register_channel(ROW_TOPIC, "cdr", row_schema)
    event_channel = other.register_channel(EVENT_TOPIC, "cdr", event_schema)
    record_channel = other.register_channel(RECORD_TOPIC, "cdr", record_schema)

    def add(part):
        for row in part:
            stamp = int(row["deadline_ns"]) + WALL_NS
            other.add_message(row_channel, stamp, CDR_HEADER + row.tobytes(), stamp, int(row["tick"]))

    add(rows[:1700])
    other.add_message(event_channel, EVENT.time_ns, encode_event(EVENT), EVENT.time_ns)
    other.add_message(record_channel, EVENT.time_ns, encode_record(RECORD), EVENT.time_ns, RECORD.sequence)
    add(rows[1700:2000])
    other.flush()
    add(rows[2000:])
    other.flush()
    other.add_metadata(SUMMARY_NAME, dict(run.summary))
    other.finish()
    assert (tmp_path / "a.mcap").read_bytes() == stream.getvalue()


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_mcap_reads_it(tmp_path, compression):
    rows = random_rows(3000, seed=1)
    path = write_run(tmp_path / "a.mcap", rows, flush_every=500, compression=compression)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary.statistics.message_count == 3000
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) >= 6
        messages = [message for _, _, message in reader.iter_messages(topics=ROW_TOPIC)]
        assert [a.name for a in reader.iter_attachments()] == ["axis.yaml"]
        assert [m.name for m in reader.iter_metadata()] == [METADATA_NAME, SUMMARY_NAME]
    assert b"".join(message.data[4:] for message in messages) == rows.tobytes()
    assert [message.log_time for message in messages] == (rows["deadline_ns"] + WALL_NS).tolist()
    assert [message.sequence for message in messages] == rows["tick"].tolist()
    with path.open("rb") as file:  # by the indexes: only what lies in this window
        window = {
            "starting_at": messages[1000].log_time,
            "ending_before": messages[1000].log_time + 10 * PERIOD_NS,
        }
        assert len(list(make_reader(file).iter_messages(**window))) == 10
    with path.open("rb") as file:  # and without them
        assert sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages()) == 3000


def test_rosbags_reads_it_value_for_value(tmp_path):
    rows = random_rows(300, seed=2)
    path = tmp_path / "a.mcap"
    writer = RunWriter(path, {}, [], WALL_NS)
    writer.write_rows(rows)
    writer.write_event(EVENT)
    writer.write_record(RECORD, WALL_NS + 9)
    writer.close()
    with AnyReader([path]) as reader:
        found = {topic: [] for topic in (ROW_TOPIC, EVENT_TOPIC, RECORD_TOPIC)}
        for connection, _, raw in reader.messages():
            found[connection.topic].append(reader.deserialize(raw, connection.msgtype))
    assert len(found[ROW_TOPIC]) == 300
    for name in ROW.names:
        values = np.array([getattr(message, name) for message in found[ROW_TOPIC]], ROW[name])
        assert same_bits(values, np.ascontiguousarray(rows[name])) or ROW[name].kind == "f", name
        assert np.array_equal(values, rows[name], equal_nan=ROW[name].kind == "f"), name
    (event,) = found[EVENT_TOPIC]
    assert (event.time_ns, event.level, event.source, event.text) == EVENT[:4]
    (record,) = found[RECORD_TOPIC]
    assert (record.time_ns, record.sequence, record.number, record.kind) == RECORD[:4]
    assert tuple(record.names) == RECORD.names
    assert tuple(record.values.tolist()) == RECORD.values
    assert json.loads(record.data) == RECORD.data


def test_infinities_and_nan_survive(tmp_path):
    rows = random_rows(4)
    rows["velocity_rps"] = [np.nan, np.inf, -np.inf, -0.0]
    run = read_run(write_run(tmp_path / "a.mcap", rows))
    assert np.isnan(run.columns["velocity_rps"][0])
    assert np.array_equal(run.columns["velocity_rps"][1:3], [np.inf, -np.inf])
    assert np.signbit(run.columns["velocity_rps"][3])


def test_nothing_is_overwritten(tmp_path):
    path = write_run(tmp_path / "a.mcap", random_rows(3))
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        RunWriter(path, {})
    second = RunWriter(tmp_path / "b.mcap", {})
    with pytest.raises(FileExistsError):
        RunWriter(tmp_path / "b.mcap", {})
    second.write_rows(random_rows(5))
    (tmp_path / "b.mcap").write_bytes(b"someone else's")
    with pytest.raises(FileExistsError):
        second.close()
    assert (tmp_path / "b.mcap").read_bytes() == b"someone else's"
    assert len(read_run(tmp_path / "b.mcap.part").rows) == 5
    assert path.read_bytes() == before


def test_rows_of_another_kind_are_refused(tmp_path):
    writer = RunWriter(tmp_path / "a.mcap", {})
    with pytest.raises(RecordingError, match=r"signals\.ROW"):
        writer.write_rows(np.zeros(3, [("a", "f8")]))
    early = random_rows(2)
    early["deadline_ns"] = -1
    with pytest.raises(RecordingError, match="epoch"):
        writer.write_rows(early)
    with pytest.raises(ValueError, match="lz9"):
        RunWriter(tmp_path / "b.mcap", {}, compression="lz9")
    writer.close()
    assert sorted(os.listdir(tmp_path)) == ["a.mcap"]


@settings(max_examples=60)
@given(room=st.integers(0, 40_000), batch=st.integers(1, 60))
def test_full_disk_at_any_byte_leaves_whole_records(tmp_path_factory, room, batch):
    """Wherever the disk ends, the file ends with a whole record and holds a prefix of the rows."""
    path = tmp_path_factory.mktemp("full") / "a.mcap"
    rows = random_rows(300)
    disk = Disk(room)
    writer = fill(disk, path, rows, batch)
    assert disk.room == 0
    if writer is None:
        assert os.listdir(path.parent) == []
        return
    size = writer.size_bytes
    writer.abandon()
    if writer.rows_written == 0:
        assert os.listdir(path.parent) == []
        return
    run = read_run(writer.part_path)
    assert not run.complete
    assert "never closed" in run.reason  # cut off cleanly: no torn record at its end
    assert same_bits(run.rows, rows[: writer.rows_written])
    assert writer.part_path.stat().st_size == size


def fill(disk: Disk, path, rows, batch) -> RunWriter | None:
    """The writer after the disk's last byte; None when not even the beginning of the file found room."""
    writer = None
    try:
        writer = RunWriter(path, {}, [("x", "y", b"z" * 500)], WALL_NS, chunk_size=2000, opener=disk)
        for begin in range(0, len(rows), batch):
            writer.write_rows(rows[begin : begin + batch])
        writer.close()
    except OSError:
        return writer
    raise AssertionError("a file larger than the disk")


def test_a_device_that_is_really_full(tmp_path):
    """/dev/full: ENOSPC from the kernel."""

    def opener(path) -> BinaryFile:
        path.touch()
        return io.FileIO("/dev/full", "wb")

    with pytest.raises(OSError, match="No space left"):
        RunWriter(tmp_path / "a.mcap", {}, opener=opener)


def test_deleted_and_moved_files_are_noticed(tmp_path):
    deleted = RunWriter(tmp_path / "a.mcap", {})
    deleted.write_rows(random_rows(5))
    deleted.part_path.unlink()
    with pytest.raises(FileNotFoundError, match="deleted or moved"):
        deleted.flush()
    assert deleted.deleted
    deleted.abandon()
    moved = RunWriter(tmp_path / "b.mcap", {})
    moved.write_rows(random_rows(5))
    (tmp_path / "b.mcap.part").rename(tmp_path / "c.mcap.part")
    with pytest.raises(FileNotFoundError, match=r"b\.mcap\.part"):
        moved.close()
    assert not moved.deleted
    moved.abandon()
    assert len(read_run(tmp_path / "c.mcap.part").rows) == 5


def test_fsync_is_paced(tmp_path, monkeypatch):
    synced: list[int] = []
    real = os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: (synced.append(fd), real(fd)))
    now = [0]
    writer = RunWriter(tmp_path / "a.mcap", {}, fsync_interval_s=10.0, clock_ns=lambda: now[0])
    at_begin = len(synced)
    assert at_begin > 0  # the new name, too
    for second in range(1, 25):
        now[0] = second * 1_000_000_000
        writer.write_rows(random_rows(1, first_tick=second))
        writer.flush()
    assert len(synced) == at_begin * 3  # at 10 s and 20 s
    writer.close()
    assert len(synced) > at_begin * 3
    plain = len(synced)
    write_run(tmp_path / "b.mcap", random_rows(10))
    assert len(synced) == plain


def test_wall_clock_offset_maps_one_clock_onto_the_other():
    import time

    before = time.time_ns() - time.monotonic_ns()
    offset = wall_clock_offset_ns()
    after = time.time_ns() - time.monotonic_ns()
    assert min(before, after) - 10**9 < offset < max(before, after) + 10**9


def test_open_new_refuses_what_is_there(tmp_path):
    open_new(tmp_path / "x").close()
    with pytest.raises(FileExistsError):
        open_new(tmp_path / "x")
