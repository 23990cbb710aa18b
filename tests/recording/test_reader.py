"""Reading what other versions and other programs wrote, and what the reader offers."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from recording.samples import PERIOD_NS, WALL_NS, random_rows, same_bits, write_run

from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.reader import describe, read_run
from fffo_drive.recording.schema import ROW_TOPIC, ROW_TYPE, schema_text
from fffo_drive.signals import Signal

OTHER = (
    Signal("mode", "u1", "-", "a small field first: CDR pads behind it"),
    Signal("torque_nm", "<f8", "Nm", "torque"),
    Signal("count", "<u2", "-", "counter"),
    Signal("gain", "<f4", "A/rps", "gain"),
)


def foreign_file(path, payloads, signals=OTHER, encoding="cdr", schema_encoding="ros2msg", topic=ROW_TOPIC, **options):
    """Messages of another writer on `topic`."""
    with path.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start("ros2")
        schema = writer.register_schema(ROW_TYPE, schema_encoding, schema_text(signals).encode())
        channel = writer.register_channel(topic, encoding, schema)
        for number, payload in enumerate(payloads):
            writer.add_message(channel, 1000 + number, payload, 1000 + number)
        writer.finish()
    return path


def other_rows(count: int, order: str = "<") -> np.ndarray:
    layout = {
        "names": ["mode", "torque_nm", "count", "gain"],
        "formats": ["u1", order + "f8", order + "u2", order + "f4"],
        "offsets": [0, 8, 16, 20],
        "itemsize": 24,
    }
    rows = np.zeros(count, np.dtype(layout))
    rows["mode"] = np.arange(count) % 3
    rows["torque_nm"] = np.linspace(-1.0, 1.0, count)
    rows["count"] = np.arange(count) * 7
    rows["gain"] = 0.25 * np.arange(count)
    return rows


def assert_same_values(run, rows):
    assert len(run.rows) == len(rows)
    for name in rows.dtype.names:
        assert run.columns[name].dtype.isnative
        assert np.array_equal(run.columns[name], rows[name])


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.ZSTD, "chunk_size": 1000},
        {"compression": CompressionType.LZ4, "chunk_size": 1000},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"enable_crcs": False},
        {"use_statistics": False, "repeat_schemas": False, "repeat_channels": False},
    ],
    ids=lambda options: "-".join(options),
)
def test_other_fields_padding_and_layouts_of_the_file(tmp_path, options):
    rows = other_rows(100)
    path = foreign_file(tmp_path / "a.mcap", [b"\0\1\0\0" + row.tobytes() for row in rows], **options)
    run = read_run(path)
    assert run.complete
    assert_same_values(run, rows)
    assert run.units == {"mode": "-", "torque_nm": "Nm", "count": "-", "gain": "A/rps"}
    assert run.meanings["torque_nm"] == "torque"
    assert np.array_equal(run.log_time_ns, 1000 + np.arange(100))
    assert np.allclose(np.diff(run.time_s), 1e-9)
    assert describe(path) == describe(path, check=True)  # whatever the file has of an index


def test_big_endian_rows(tmp_path):
    rows = other_rows(50, ">")
    path = foreign_file(tmp_path / "a.mcap", [b"\0\0\0\0" + row.tobytes() for row in rows])
    assert_same_values(read_run(path), rows)


def test_payloads_of_varying_length(tmp_path):
    """Padding behind the row is no part of it, and differs from message to message here."""
    rows = other_rows(60)
    payloads = [b"\0\1\0\0" + row.tobytes() + bytes(i % 5) for i, row in enumerate(rows)]
    assert_same_values(read_run(foreign_file(tmp_path / "a.mcap", payloads)), rows)


def test_rows_that_are_too_short_end_the_reading(tmp_path):
    rows = other_rows(60)
    payloads = [b"\0\1\0\0" + row.tobytes() for row in rows]
    payloads[40] = payloads[40][:-3]
    run = read_run(foreign_file(tmp_path / "a.mcap", payloads, chunk_size=600))
    assert not run.complete
    assert "a row of 21 bytes where its schema needs 24" in run.reason
    assert 0 < len(run.rows) <= 40


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"encoding": "json"}, "json encoding"),
        ({"schema_encoding": "protobuf"}, "protobuf schema"),
        ({"topic": "/fffo_drive/rows"}, "did you mean '/fffo_drive/rows'"),
    ],
)
def test_files_that_cannot_give_columns(tmp_path, changes, message):
    path = foreign_file(tmp_path / "a.mcap", [bytes(28)], **changes)
    with pytest.raises(RecordingError, match=message):
        read_run(path)


def test_cdr_of_another_kind(tmp_path):
    path = foreign_file(tmp_path / "a.mcap", [b"\0\x07\0\0" + bytes(24)])
    with pytest.raises(RecordingError, match="0x0007"):
        read_run(path)


def test_another_topic_of_the_same_kind(tmp_path):
    rows = other_rows(5)
    path = foreign_file(tmp_path / "a.mcap", [b"\0\1\0\0" + row.tobytes() for row in rows], topic="/other")
    assert_same_values(read_run(path, topic="/other"), rows)


def test_columns_time_and_names(tmp_path):
    rows = random_rows(100)
    rows["deadline_ns"][50:] += 7 * PERIOD_NS  # skipped ticks
    run = read_run(write_run(tmp_path / "a.mcap", rows))
    assert np.allclose(run.columns["time_s"][[0, 1, 49, 50]], [0.0, 5e-4, 245e-4, 285e-4])
    assert run.columns["velocity_rps"].flags.c_contiguous
    assert same_bits(run.column("trip"), np.ascontiguousarray(rows["trip"]))
    with pytest.raises(RecordingError, match="did you mean 'velocity_rps'"):
        run.column("velocity_rp")


def test_description_is_json(tmp_path):
    described = json.loads(json.dumps(describe(write_run(tmp_path / "a.mcap", random_rows(10)))))
    assert described["rows"] == 10
    assert described["period_s"] == pytest.approx(5e-4)
    assert described["complete"] is True
    assert described["columns"]["velocity_rps"] == "rps"
    assert described["attachments"]["axis.yaml"]["bytes"] == 14
    assert described["metadata"]["time_offset_ns"] == str(WALL_NS)
    empty = describe(write_run(tmp_path / "b.mcap", random_rows(0)))
    assert (empty["rows"], empty["duration_s"], empty["period_s"]) == (0, 0.0, None)


def test_a_file_that_is_still_being_written(tmp_path):
    from fffo_drive.recording.writer import RunWriter

    rows = random_rows(100)
    with_flush = RunWriter(tmp_path / "a.mcap", {}, (), WALL_NS)
    with_flush.write_rows(rows[:60])
    with_flush.flush()
    with_flush.write_rows(rows[60:])
    assert same_bits(read_run(with_flush.part_path).rows, rows[:60])
    with_flush.close()
    assert same_bits(read_run(tmp_path / "a.mcap").rows, rows)
