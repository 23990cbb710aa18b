"""A file that begins in the midst of a running loop waits for the loop's memory, and begins exactly behind it."""

from __future__ import annotations

from recording.samples import Disk, FakeClock, FakeRing, random_rows

from fffo_drive.recording.reader import read_run
from fffo_drive.recording.recorder import Recorder
from fffo_drive.recording.run_records import FileStart, RecordKind, RunRecord
from fffo_drive.recording.settings import RecorderHooks, RecorderSettings, RotationPolicy

ROWS = random_rows(10_000, seed=4)
ROTATE_S = 10.0


class Loop:
    """A ring, and a loop that answers with the next row once it is let: as `runtime.session.Session` does."""

    def __init__(self, capacity: int = 4096) -> None:
        self.ring = FakeRing(capacity)
        self.pushed = self.asked = 0
        self.running = True
        self.given: FileStart | None = None

    def ask_for_memory(self) -> int | None:
        if not self.running:
            return None
        self.asked, self.given = self.asked + 1, None
        return self.asked

    def memory_given(self, number: int) -> FileStart | None:
        assert number == self.asked
        return self.given

    def push(self, count: int) -> None:
        self.ring.push(ROWS[self.pushed : self.pushed + count])
        self.pushed += count

    def answer(self) -> None:
        """Behind the row that was written last."""
        record = RunRecord(0, 0, self.pushed, RecordKind.MEMORY, ("x",), (float(self.pushed),))
        self.given = FileStart(self.pushed, record)


class Bench:
    """A recorder of that loop, driven by hand."""

    def __init__(self, directory, loop: Loop, room: int | None = None, rotate_s: float | None = ROTATE_S) -> None:
        self.loop, self.clock, self.disk = loop, FakeClock(), Disk(room)
        self.events = []
        hooks = RecorderHooks(self.clock, self.disk, self.events.append)
        settings = RecorderSettings(chunk_size=5000, rotation=RotationPolicy(max_duration_s=rotate_s))
        self.recorder = Recorder(loop.ring, directory / "run.mcap", None, settings, hooks, memory=loop)

    def turn(self, count: int = 20, seconds: float = 1.0) -> None:
        self.loop.push(count)
        self.clock.advance_s(seconds)
        self.recorder.drain_once()

    def files(self):
        """Of each: ticks, and the place that its memory is of."""
        found = []
        for path in self.recorder.close().files:
            run = read_run(path)
            memories = [record for record in run.records if record.kind == RecordKind.MEMORY]
            found.append((run.rows["tick"].tolist(), [record.number for record in memories]))
        return found


def test_the_next_file_begins_behind_the_row_of_the_memory_and_no_row_is_lost(tmp_path):
    loop = Loop()
    bench = Bench(tmp_path, loop)
    for _ in range(10):
        bench.turn()
    assert loop.asked == 1  # due; rows go on into the first file until the loop has answered
    bench.turn()
    assert loop.asked == 1
    loop.push(7)
    loop.answer()  # in the midst of what is drained next
    bench.turn(13)
    assert bench.files() == [(list(range(227)), []), (list(range(227, 240)), [227])]


def test_a_memory_of_a_row_that_was_not_read_yet_waits_for_it(tmp_path):
    loop = Loop()
    bench = Bench(tmp_path, loop)
    for _ in range(10):
        bench.turn()
    loop.push(5)
    original = loop.memory_given

    def given_late(number):  # the loop answers after the rows were read, and before they are written
        loop.memory_given = original
        loop.push(3)
        loop.answer()
        return loop.given

    loop.memory_given = given_late
    bench.recorder.drain_once()
    bench.turn()
    assert bench.files() == [(list(range(208)), []), (list(range(208, 228)), [208])]


def test_rows_lost_beyond_the_memory_make_it_worthless_and_it_is_asked_for_again(tmp_path):
    loop = Loop(capacity=64)
    bench = Bench(tmp_path, loop)
    for _ in range(10):
        bench.turn()
    loop.answer()
    bench.turn(200)  # the ring runs over
    assert loop.asked == 2
    loop.answer()
    bench.turn()
    (_, (later, numbers)) = bench.files()
    assert numbers == [later[0]] == [400]


def test_where_no_loop_is_left_to_answer_the_file_begins_at_once(tmp_path):
    loop = Loop()
    bench = Bench(tmp_path, loop)
    loop.running = False
    for _ in range(12):
        bench.turn()
    assert bench.files() == [(list(range(200)), []), (list(range(200, 240)), [])]


def test_a_file_after_a_full_disk_begins_with_the_memory_too(tmp_path):
    loop = Loop()
    bench = Bench(tmp_path, loop, room=20_000, rotate_s=None)
    while not bench.recorder.statistics.write_errors:
        bench.turn(50)
    bench.disk.room = None
    while not loop.asked:  # after the retry interval
        bench.turn()
    begin = loop.pushed + 4
    loop.push(4)
    loop.answer()
    bench.turn()
    *_, (later, numbers) = bench.files()
    assert numbers == [later[0]] == [begin]
    statistics = bench.recorder.statistics
    assert statistics.rows_written + statistics.rows_dropped == loop.pushed
