"""Records: their bytes, what is in force in a file, and that no row of a file names one that is not in it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording.samples import WALL_NS, FakeClock, FakeRing, random_rows

from fffo_drive.recording.reader import Run, read_run
from fffo_drive.recording.recorder import Recorder
from fffo_drive.recording.recover import recover
from fffo_drive.recording.run_records import (
    NAMED_BY_ROWS,
    RecordBook,
    RecordKind,
    RunRecord,
    decode_record,
    encode_record,
    still_in_force,
)
from fffo_drive.recording.settings import RecorderHooks, RecorderSettings, RotationPolicy, RunHeader
from fffo_drive.signals import ROW

TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
NUMBER = st.integers(0, 2**32 - 1)


@given(
    st.integers(0, 2**64 - 1), NUMBER, NUMBER, TEXT,
    st.lists(st.tuples(TEXT, st.floats(allow_nan=False)), max_size=8),
    st.dictionaries(TEXT, st.one_of(TEXT, st.integers(-(2**53), 2**53), st.booleans(), st.none()), max_size=4),
)  # fmt: skip
def test_a_record_comes_back_from_its_bytes(time_ns, sequence, number, kind, pairs, data):
    names, values = tuple(name for name, _ in pairs), tuple(value for _, value in pairs)
    record = RunRecord(time_ns, sequence, number, kind, names, values, data)
    back = decode_record(encode_record(record))
    assert back == record
    assert [math.copysign(1.0, value) for value in back.values] == [math.copysign(1.0, value) for value in values]


@given(st.binary(max_size=200), st.integers(0, 200))
def test_bytes_that_are_no_record_are_refused_without_much_work(noise, cut):
    whole = encode_record(RunRecord(1, 2, 3, RecordKind.GOAL, ("goal",), (3.0,), {}))
    for payload in (noise, whole[:cut], whole[:4] + noise):
        try:
            decode_record(payload)
        except ValueError:
            continue
        assert payload[:2] == whole[:2]


def test_a_list_that_claims_to_be_huge_is_refused():
    whole = bytearray(encode_record(RunRecord(1, 2, 3, "k", (), (), {})))
    begin = whole.index(b"k\0") + 2
    begin += -(begin - 4) % 4
    whole[begin : begin + 4] = (2**32 - 1).to_bytes(4, "little")
    with pytest.raises(ValueError, match="a list of 4294967295 items"):
        decode_record(bytes(whole))


class FakeSession:
    """A session as the recorder sees it: requests become records, then rows name them; all by a list of choices."""

    def __init__(self) -> None:
        self.book = RecordBook(lambda: WALL_NS)
        self.ring = FakeRing(1 << 12)
        self.sequence = self.tick = 0
        self.published = dict.fromkeys(NAMED_BY_ROWS, -1)  # last number of each kind
        self.in_use = dict.fromkeys(NAMED_BY_ROWS, 0)
        for kind in NAMED_BY_ROWS:
            self.ask(kind)

    def ask(self, kind: str) -> None:
        self.sequence += 1
        number = 0
        if kind in self.published:
            self.published[kind] += 1
            number = self.published[kind]
        data = {
            RecordKind.PARAMETERS: {"model": str(number // 3)},
            RecordKind.MODEL: {"content_hash": str(self.sequence % 3)},
        }
        self.book.add(RunRecord(0, self.sequence, number, kind, (), (), data.get(RecordKind(kind), {})))

    def rows(self, count: int, behind: bool) -> None:
        """Rows; `behind`: of a loop that has not seen the last requests yet."""
        if not behind:
            self.in_use = dict(self.published)
        rows = np.zeros(count, ROW)
        rows["tick"] = rows["row_number"] = self.tick + np.arange(count)
        rows["deadline_ns"] = rows["tick"].astype(np.int64) * 500_000
        rows["request_number"] = self.sequence if not behind else self.seen
        for kind, name in NAMED_BY_ROWS.items():
            rows[name] = self.in_use[kind]
        self.seen = int(rows["request_number"][-1])
        self.tick += count
        self.ring.push(rows)

    seen = 0


STEPS = st.one_of(
    st.tuples(st.just("ask"), st.sampled_from([kind.value for kind in RecordKind])),
    st.tuples(st.just("rows"), st.tuples(st.integers(1, 40), st.booleans())),
    st.tuples(st.just("drain"), st.just(0)),
    st.tuples(st.just("forget"), st.just(0)),
)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(STEPS, max_size=40), st.sampled_from([1, 3000, None]), st.integers(0, 10))
def test_no_row_names_a_record_that_its_file_has_not(tmp_path_factory, steps, max_bytes, late):
    session, clock = FakeSession(), FakeClock()
    directory = tmp_path_factory.mktemp("runs")
    rotation = RotationPolicy(max_bytes=max_bytes)
    recorder = None
    for place, (what, value) in enumerate([*steps, ("drain", 0)]):
        if recorder is None and place >= min(late, len(steps)):  # a recording that begins in the middle
            recorder = Recorder(
                session.ring, directory / "run.mcap", RunHeader(time_offset_ns=WALL_NS),
                RecorderSettings(flush_interval_s=0.0, rotation=rotation), RecorderHooks(clock),
                from_now=True, records=session.book,
            )  # fmt: skip
        if what == "ask":
            session.ask(value)
        elif what == "rows":
            session.rows(*value)
        elif what == "forget" and session.tick:
            session.book.forget(session.ring.rows[(session.tick - 1) % len(session.ring.rows)])
        elif what == "drain" and recorder is not None:
            recorder.drain_once()
            clock.advance_s(0.1)
    recorder.close()
    for file in directory.glob("*.mcap"):
        run = read_run(file)
        numbers = {kind: {r.number for r in run.records if r.kind == kind} for kind in NAMED_BY_ROWS}
        for kind, name in NAMED_BY_ROWS.items():
            assert set(run.rows[name].tolist()) <= numbers[kind], (file.name, kind)
        if len(run.rows):  # and whatever the loop had not seen before the file is recorded in it, or was before
            assert [record.sequence for record in run.records] == sorted({r.sequence for r in run.records})
    recorded = {r.sequence for file in directory.glob("*.mcap") for r in read_run(file).records}
    after = recorder.statistics
    assert after.rows_lost == 0
    assert session.sequence in recorded


def test_what_is_in_force_does_not_grow_with_what_was_asked():
    session = FakeSession()
    for _ in range(500):
        for kind in RecordKind:
            session.ask(kind)
        session.rows(1, behind=False)
        session.book.forget(session.ring.rows[(session.tick - 1) % len(session.ring.rows)])
        assert len(session.book.listen(lambda record: None)) <= 2 * len(RecordKind)


def test_a_record_that_a_later_version_knows_is_kept_as_the_last_of_its_kind():
    row = np.zeros(1, ROW)[0]
    row["request_number"] = 9
    records = [RunRecord(0, sequence, 0, "brake", (), (), {}) for sequence in (3, 5, 11)]
    assert [record.sequence for record in still_in_force(records, row)] == [5, 11]


def test_a_listener_hears_of_every_record_once_and_of_none_after_it_left():
    session = FakeSession()
    heard = []
    before = session.book.listen(heard.append)
    session.ask(RecordKind.GOAL)
    session.book.leave(heard.append)
    session.ask(RecordKind.GOAL)
    assert [record.sequence for record in (*before, *heard)] == list(range(1, len(NAMED_BY_ROWS) + 2))


def test_a_recording_that_cannot_be_opened_leaves_the_book_alone(tmp_path):
    session = FakeSession()
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError):
        Recorder(session.ring, tmp_path / "file" / "run.mcap", records=session.book)
    assert session.book._listeners == []


def test_records_survive_a_torn_file(tmp_path):
    session, clock = FakeSession(), FakeClock()
    recorder = Recorder(
        session.ring, tmp_path / "a.mcap", RunHeader(time_offset_ns=WALL_NS), RecorderSettings(flush_interval_s=0.0),
        RecorderHooks(clock), records=session.book,
    )  # fmt: skip
    session.rows(50, behind=False)
    recorder.drain_once()
    part = recorder.current_path.read_bytes()
    (tmp_path / "torn.mcap").write_bytes(part + b"\x05torn")
    recorder.close()
    torn = read_run(tmp_path / "torn.mcap")
    recover(tmp_path / "torn.mcap", tmp_path / "whole.mcap")
    whole = read_run(tmp_path / "whole.mcap")
    assert not torn.complete
    assert whole.complete
    assert len(torn.records) == len(NAMED_BY_ROWS)
    assert whole.records == torn.records
    assert read_run(tmp_path / "a.mcap").summary["records"] == str(len(NAMED_BY_ROWS))


def test_random_rows_are_no_trouble_for_what_is_in_force():
    session = FakeSession()
    still_in_force(session.book.listen(lambda record: None), random_rows(1)[0])


def test_the_profile_that_ran_is_the_one_whose_record_its_rows_name():
    rows = np.zeros(8, ROW)
    rows["profile_sample"] = [-1, 0, 1, 2, 3, -1, -1, -1]
    rows["profile_number"] = [1, 2, 2, 2, 2, 2, 2, 2]
    sizes = {1: 100, 2: 4}
    records = tuple(
        RunRecord(0, number, number, RecordKind.PROFILE, ("samples",), (float(samples),), {})
        for number, samples in sizes.items()
    )
    run = Run(Path("run.mcap"), rows, rows["deadline_ns"], {}, {}, {}, {}, {}, (), records, True, "")
    assert run.profile_samples == 4
    rows["profile_number"][1] = 1
    assert run.profile_samples is None  # a service's recording: two ran
    assert replace(run, records=()).profile_samples is None
    assert replace(run, records=(), metadata={"profile_samples": "7"}).profile_samples == 7  # files of older versions
