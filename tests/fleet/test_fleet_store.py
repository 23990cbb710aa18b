"""The store: what is written is whole and there once, whoever writes beside, whatever the disk does."""

from __future__ import annotations

import errno
import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fleet.fleet_rig import files_of

from fffo_drive.documents import DocumentError
from fffo_drive.fleet.backlash import GAP_UPPER
from fffo_drive.fleet.compare import side_of_store
from fffo_drive.fleet.history import balance_of_rows, estimates_of, histories, history, matrix_of, model_records
from fffo_drive.fleet.place import StorePlace
from fffo_drive.fleet.regress import PARAMETERS, UPPER
from fffo_drive.fleet.schema import HIGHEST_ORDER, RECORD_SCHEMA, SCHEMA_VERSION, file_bytes, table_of
from fffo_drive.fleet.store import FleetStore

START = datetime(2026, 1, 5, tzinfo=UTC)


def row(number, drive="d1", days=0, version=SCHEMA_VERSION, size=1.0):
    """A record with numbers of its own."""
    draw = np.random.default_rng(number)
    half = draw.standard_normal((40, len(PARAMETERS)))
    normal = half.T @ half
    return {
        "run": f"{number:064x}", "schema_version": version, "tool": "test", "drive": drive, "model": "m1",
        "path": f"/runs/{number}.mcap", "start": START + timedelta(days=days), "duration_s": 10.0, "units": "rotary",
        "normal": normal[UPPER], "moment": normal @ np.ones(len(PARAMETERS)), "energy_nm2": size * 1e4, "rows": 40.0,
        "effective_rows": 20.0, "rms_nm": 0.1 * size, "speed_rms_rps": 1.0,
        "order_amplitude_nm": draw.uniform(0.0, 1.0, HIGHEST_ORDER),
    }  # fmt: skip


def entry(number, drive="d1", days=0):
    return {
        "run": f"{number:064x}", "drive": drive, "model": "m1", "path": f"/runs/{number}.mcap",
        "start": START + timedelta(days=days), "bytes": 1, "stamp": "", "facts": None,
    }  # fmt: skip


@pytest.fixture
def store(tmp_path):
    return FleetStore(str(tmp_path / "store"), create=True)


def test_a_place_without_a_store_and_one_with_other_files_are_reported(tmp_path):
    with pytest.raises(DocumentError, match="fleet add"):
        FleetStore(str(tmp_path / "nothing"))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("dear")
    with pytest.raises(DocumentError, match="not empty"):
        FleetStore(str(tmp_path / "full"), create=True)


def test_a_store_of_a_later_program_is_refused(tmp_path):
    (tmp_path / "store.json").write_text(json.dumps({"format": "fffo_drive/fleet/9"}))
    with pytest.raises(DocumentError, match="newer"):
        FleetStore(str(tmp_path))


def test_runs_are_added_once(store):
    assert store.add([entry(1), entry(2)]) == 2
    assert store.add([entry(2), entry(3)]) == 1
    assert store.index().num_rows == 3
    assert [one["run"] for one in store.waiting()] == [f"{n:064x}" for n in (1, 2, 3)]


def test_two_who_add_the_same_at_once_double_nothing(store):
    other = FleetStore(store.place.address)
    known = FleetStore.index
    seen = []

    def late(self):  # the second one writes between the first one's look and its own file
        table = known(self)
        if self is store and not seen:
            seen.append(1)
            other.add([entry(1) | {"path": "/elsewhere/1.mcap"}, entry(2)])
        return table

    FleetStore.index = late
    try:
        store.add([entry(1)])
    finally:
        FleetStore.index = known
    assert len(store.place.files("index", ".parquet")) == 2
    assert store.index().num_rows == 2
    assert store.index().column("path").to_pylist()[0] == "/elsewhere/1.mcap"  # the first by name, whoever was first


def test_merging_loses_and_doubles_nothing_and_done_again_it_changes_nothing(store):
    for number in range(7):
        store.write_record(row(number, days=20 * number))
    before = store.records().sort_by("run")
    assert store.compact().records == 7
    first = files_of(Path(store.place.address))
    assert store.records().sort_by("run").equals(before)
    assert not store.place.files("records/new", "")
    store.compact()
    assert files_of(Path(store.place.address)) == first
    months = {name.split("/")[2] for name in first if name.startswith("records/merged")}
    assert months == {"2026-01", "2026-02", "2026-03", "2026-04", "2026-05"}


def test_the_order_in_which_records_came_and_were_merged_leaves_no_trace(store, tmp_path):
    for number in (3, 1, 2, 0):
        store.write_record(row(number))
        store.compact()
    other = FleetStore(str(tmp_path / "other"), create=True)
    for number in range(4):
        other.write_record(row(number))
    other.compact()
    assert files_of(Path(other.place.address)) == files_of(Path(store.place.address))


def test_a_record_that_lands_while_merging_is_kept(store, monkeypatch):
    store.write_record(row(1))
    merge = FleetStore._merge

    def busy(self, *arguments):
        store.write_record(row(2))
        return merge(self, *arguments)

    monkeypatch.setattr(FleetStore, "_merge", busy)
    store.compact()
    monkeypatch.undo()
    assert store.records(["run"]).num_rows == 2
    store.compact()
    assert store.records(["run"]).num_rows == 2


def test_a_merge_that_is_cut_off_before_it_deletes_is_made_good(store, monkeypatch):
    for number in range(3):
        store.write_record(row(number))

    def cut(self, names):
        raise KeyboardInterrupt

    monkeypatch.setattr(StorePlace, "delete", cut)
    with pytest.raises(KeyboardInterrupt):
        store.compact()
    monkeypatch.undo()
    assert len(store.place.files("records", ".parquet")) == 4  # three and the merged one
    assert store.records(["run"]).num_rows == 3
    assert store.compact() == (3, 1, 0)
    assert len(store.place.files("records", ".parquet")) == 1


def test_two_who_merge_at_once_lose_and_double_nothing(store, monkeypatch):
    for number in range(5):
        store.write_record(row(number))
    other = FleetStore(store.place.address)
    put, seen = FleetStore._put, []

    def late(self, folder, table):  # the other merges while this one has read and not yet written
        if self is store and not seen:
            seen.append(1)
            other.write_record(row(99))
            other.compact()
        return put(self, folder, table)

    monkeypatch.setattr(FleetStore, "_put", late)
    store.compact()
    monkeypatch.undo()
    assert store.records(["run"]).num_rows == 6
    assert store.compact() == (6, 1, 0)


def test_who_reads_while_another_merges_sees_all(store, monkeypatch):
    for number in range(3):
        store.write_record(row(number))
    listed, seen = FleetStore._record_files, []

    def stale(self):
        found = listed(self)
        if not seen:
            seen.append(1)
            FleetStore(self.place.address).compact()  # what was listed is gone
        return found

    monkeypatch.setattr(FleetStore, "_record_files", stale)
    assert store.records(["run"]).num_rows == 3


def test_what_is_too_old_is_removed_from_records_and_index(store):
    store.add([entry(1, days=0), entry(2, days=400)])
    for number, days in ((1, 0), (2, 400)):
        store.write_record(row(number, days=days))
    done = store.compact(keep_days=30.0, now=START + timedelta(days=410))
    assert (done.records, done.removed) == (1, 1)
    assert store.index().column("run").to_pylist() == [f"{2:064x}"]
    assert store.waiting() == []
    assert store.compact(keep_days=1.0, now=START + timedelta(days=410)).removed == 1
    assert store.records(["run"]).num_rows == 0


def test_records_of_an_older_version_are_read_and_the_newest_of_a_run_counts(store):
    old = table_of([row(1, size=2.0) | {"schema_version": 0}]).drop_columns(["temperature_degc", "complete"])
    store.place.write(f"records/new/{1:064x}-0.parquet", file_bytes(old, small=True))
    assert store.records(["rms_nm"]).column("rms_nm").to_pylist() == [0.2]
    assert np.isnan(history(store, "d1").temperature_degc).all()
    assert store.recorded().to_pylist() == []  # of this version there is none: work makes it
    store.write_record(row(1))
    assert store.records(["rms_nm"]).column("rms_nm").to_pylist() == [0.1]
    store.compact()
    assert store.records(["rms_nm"]).column("rms_nm").to_pylist() == [0.1]


def test_records_of_before_the_gap_are_read_beside_newer_ones_and_merged(store):
    gap = [name for name in RECORD_SCHEMA.names if name.startswith("gap_")]
    old = table_of([row(1) | {"schema_version": 1}]).drop_columns(gap)
    store.place.write(f"records/new/{1:064x}-1.parquet", file_bytes(old, small=True))
    newer = {"gap_rev": 0.02, "gap_log_sd": 0.03, "gap_normal": np.ones(GAP_UPPER[0].size), "gap_rows": 5.0}
    store.write_record(row(2, days=1) | newer)
    for _ in range(2):
        found = history(store, "d1")
        assert np.array_equal(found.gap_rev, [np.nan, 0.02], equal_nan=True)
        summed = matrix_of(store.records(["gap_normal"]), "gap_normal")
        assert np.nansum(summed) == GAP_UPPER[0].size
        store.compact()


def test_drives_of_two_models_with_one_number_are_two_drives(store):
    store.write_record(row(1))
    store.write_record(row(2, days=1) | {"model": "m2"})
    with pytest.raises(DocumentError, match=r"one of each of m1, m2.*--model"):
        history(store, "d1")
    assert history(store, "d1", "m2").run.tolist() == [f"{2:064x}"]
    assert histories(store, "m1")["d1"].run.tolist() == [f"{1:064x}"]
    assert side_of_store(store, "..", "d1", "m1").records.num_rows == 1


def test_records_of_a_later_version_are_refused_with_a_word(store):
    store.place.write("records/new/x-9.parquet", file_bytes(table_of([row(1, version=9)]), small=True))
    with pytest.raises(DocumentError, match="version 9"):
        store.records()


def test_a_full_disk_leaves_no_part_of_a_file(store, monkeypatch):
    store.write_record(row(1))
    real = Path.replace

    def full(self, target):
        raise OSError(errno.ENOSPC, "No space left on device", str(self))

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OSError, match="No space"):
        store.write_record(row(2))
    with pytest.raises(OSError, match="No space"):
        store.compact()
    monkeypatch.setattr(Path, "replace", real)
    assert list(files_of(Path(store.place.address))) == [f"records/new/{1:064x}-{SCHEMA_VERSION}.parquet", "store.json"]
    store.write_record(row(2))
    assert store.compact().records == 2


def test_forgotten_unfinished_files_are_swept_and_young_ones_are_not(store, monkeypatch):
    young = Path(store.place.address) / ".a.parquet.0.tmp"
    young.write_bytes(b"half")
    store.compact()
    assert young.exists()
    monkeypatch.setattr("fffo_drive.fleet.place.FORGOTTEN_S", -1.0)
    store.compact()
    assert not young.exists()


def test_history_has_the_shapes_that_are_agreed_on(store):
    for number in (2, 1, 3):
        store.write_record(row(number, days=number))
    store.write_record(row(9, drive="d2"))
    found = history(store, "d1")
    assert found.run.tolist() == [f"{n:064x}" for n in (1, 2, 3)]
    assert np.diff(found.time_s).tolist() == [86_400.0, 86_400.0]
    assert found.time_s[0] == (START + timedelta(days=1)).timestamp()
    p = len(PARAMETERS)
    assert found.theta.shape == (3, p)
    assert found.theta == pytest.approx(np.ones((3, p)))
    assert found.information.shape == (3, p, p)
    assert found.order_amplitude_nm.shape == (3, found.orders.size)
    with pytest.raises(DocumentError, match="no record of drive 'd7'"):
        history(store, "d7")


def test_records_that_are_read_once_become_the_same_histories_piece_by_piece(store):
    for number, drive in ((4, "d2"), (2, "d1"), (1, "d3"), (3, "d1"), (5, "d2")):
        store.write_record(row(number, drive, days=number))
    records = model_records(store, "m1")
    whole = histories(store, "m1")
    pieces = [records.histories(np.array(places)) for places in ([0, 2], [1])]
    assert [list(piece) for piece in pieces] == [["d1", "d3"], ["d2"]]
    for piece in pieces:
        for drive, found in piece.items():
            assert found.run.tolist() == whole[drive].run.tolist()
            assert np.array_equal(found.theta, whole[drive].theta)


def test_a_run_in_two_merged_files_of_a_month_is_one_record(store):
    for number in range(3):
        store.write_record(row(number))
    store.compact()
    store.place.write("records/merged/2026-01/other.parquet", file_bytes(table_of([row(1), row(3)])))
    assert sorted(store.records(["run"]).column("run").to_pylist()) == [f"{number:064x}" for number in range(4)]


def test_records_are_solved_in_batches_as_all_at_once(monkeypatch):
    table = table_of([row(number) for number in range(5)])
    whole = estimates_of(table)
    monkeypatch.setattr("fffo_drive.fleet.history.ROWS_AT_ONCE", 2)
    for found, expected in zip(estimates_of(table), whole, strict=True):
        assert np.array_equal(found, expected)


def test_records_are_added_by_adding_their_columns(store):
    rows = [row(number) for number in range(4)]
    total = balance_of_rows(table_of(rows))
    assert total.rows == 160.0
    assert total.moment == pytest.approx(sum(one["moment"] for one in rows))


def test_other_programs_read_the_store(store):
    for number in range(3):
        store.write_record(row(number))
    store.compact()
    glob = f"{store.place.address}/records/merged/*/*.parquet"
    answer = duckdb.sql(f"select drive, count(*), avg(rms_nm), any_value(normal)[1] from '{glob}' group by drive")
    drive, count, rms_nm, first = answer.fetchall()[0]
    assert (drive, count) == ("d1", 3)
    assert rms_nm == pytest.approx(0.1)
    assert first > 0.0
    (file,) = Path(store.place.address).glob("records/merged/*/*.parquet")
    schema = pq.read_schema(file)
    assert schema.field("rms_nm").metadata[b"unit"] == b"Nm"
    assert schema.metadata[b"fffo_drive_fleet"] == str(SCHEMA_VERSION).encode()
    assert [field.type for field in schema] == [field.type for field in RECORD_SCHEMA]


def test_rows_come_in_groups_that_a_reader_can_skip(monkeypatch):
    """By drive: a history is read without the rest."""
    monkeypatch.setattr("fffo_drive.fleet.schema.ROWS_A_GROUP", 2)
    table = table_of([row(n, drive=f"d{n // 2}") for n in range(6)])
    file = pq.ParquetFile(pa.BufferReader(file_bytes(table)))
    groups = [file.metadata.row_group(k).column(3).statistics for k in range(file.num_row_groups)]
    assert [(one.min, one.max) for one in groups] == [(f"d{k}", f"d{k}") for k in range(3)]
