"""The recorder on good and bad days: nothing blocks, nothing is lost without being counted."""

from __future__ import annotations

import errno
import os
import shutil
import threading

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording.samples import WALL_NS, Disk, FakeClock, FakeRing, random_rows, same_bits

from fffo_drive.recording.events import Level
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.recorder import EVENT_QUEUE, Recorder
from fffo_drive.recording.settings import RecorderHooks, RecorderSettings, RotationPolicy, RunHeader

ROWS = random_rows(20_000, seed=8)
HEADER = RunHeader({"axis": "bench"}, (("axis.yaml", "application/yaml", b"x"),), WALL_NS)


class Bench:
    """A recorder with its ring, clock, disk and ears, driven by hand."""

    def __init__(self, directory, capacity: int = 1024, room: int | None = None, **changes) -> None:
        self.ring = FakeRing(capacity)
        self.clock = FakeClock()
        self.disk = Disk(room)
        self.events = []
        self.batches = []
        self.pushed = 0
        self.path = directory / "run.mcap"
        hooks = RecorderHooks(self.clock, self.disk, self.events.append, self.batches.append)
        settings_ = RecorderSettings(chunk_size=5000, **changes)
        self.recorder = Recorder(self.ring, self.path, HEADER, settings_, hooks)

    def push(self, count: int) -> None:
        self.ring.push(ROWS[self.pushed : self.pushed + count])
        self.pushed += count

    def turn(self, count: int = 100, seconds: float = 0.05) -> None:
        """So many rows, so much time, one drain."""
        self.push(count)
        self.clock.advance_s(seconds)
        self.recorder.drain_once()

    def check_sum(self, undrained: int = 0) -> None:
        s = self.recorder.statistics
        assert s.rows_written + s.rows_pending + s.rows_dropped + s.rows_lost + undrained == self.pushed

    def rows_in_files(self) -> list[int]:
        found = []
        for path in self.recorder.statistics.files:
            found += read_run(path).rows["tick"].tolist()
        return found

    @property
    def texts(self) -> list[str]:
        return [event.text for event in self.events]


def test_rows_and_events_of_a_good_day(tmp_path):
    bench = Bench(tmp_path / "new" / "directory")
    bench.recorder.event(Level.INFO, "supervisor", "enabled", {"axis": 1})
    bench.recorder.event(999, "drive", "emergency", time_ns=WALL_NS)
    for _ in range(50):
        bench.turn()
    statistics = bench.recorder.close({"reason": "done"})
    assert statistics.files == (bench.path,)
    assert (statistics.rows_written, statistics.rows_lost, statistics.rows_dropped) == (5000, 0, 0)
    run = read_run(bench.path)
    assert run.complete
    assert same_bits(run.rows, ROWS[:5000])
    assert [(e.level, e.source, e.text) for e in run.events] == [
        (20, "supervisor", "enabled"),
        (255, "drive", "emergency"),
    ]
    assert run.events[0].time_ns == WALL_NS + FakeClock().now_ns
    assert (run.summary["reason"], run.summary["rows_lost"]) == ("done", "0")
    assert run.metadata["axis"] == "bench"
    assert sum(len(batch) for batch in bench.batches) == 5000
    assert bench.recorder.close() == statistics  # closing again changes nothing
    assert bench.events == []


def test_what_a_kill_costs_is_bounded_by_the_flush_interval(tmp_path):
    """At any turn the file on disk holds all rows that are older than flush interval and drain together."""
    bench = Bench(tmp_path)
    for turn in range(1, 70):
        bench.turn(count=10)
        on_disk = len(read_run(bench.recorder.current_path).rows)
        assert on_disk >= (turn // 20) * 200
    bench.recorder.close()


@settings(max_examples=40)
@given(bursts=st.lists(st.integers(0, 200), min_size=1, max_size=25))
def test_overrun_is_counted_exactly(tmp_path_factory, bursts):
    bench = Bench(tmp_path_factory.mktemp("overrun"), capacity=64)
    expected = []
    for burst in bursts:
        expected += range(bench.pushed + max(0, burst - 63), bench.pushed + burst)
        bench.turn(burst)
    statistics = bench.recorder.close()
    assert bench.rows_in_files() == expected
    assert statistics.rows_lost == bench.pushed - len(expected)
    assert any("ran over" in text for text in bench.texts) == (statistics.rows_lost > 0)


def test_slow_disk_costs_rows_of_the_ring_and_nothing_else(tmp_path):
    """While one write takes its time, the loop writes three times the ring."""
    bench = Bench(tmp_path, capacity=256)
    bench.turn(50)
    bench.disk.on_write = lambda: (bench.push(768), setattr(bench.disk, "on_write", lambda: None))
    bench.turn(100, seconds=1.0)  # flushes
    assert bench.recorder.statistics.rows_lost == 0
    bench.turn(0)
    bench.check_sum()
    assert bench.recorder.statistics.rows_lost == 768 - 255
    assert bench.texts == [f"the ring ran over: {768 - 255} rows lost"]
    bench.recorder.close()
    assert bench.rows_in_files() == [*range(150), *range(150 + 768 - 255, 918)]


def test_full_disk_is_reported_once_and_every_row_counted(tmp_path):
    bench = Bench(tmp_path, room=30_000, retry_interval_s=5.0)
    for _ in range(190):  # nine and a half seconds
        bench.turn()
        bench.check_sum()
    assert [event.level for event in bench.events] == [Level.ERROR]
    assert "run.mcap failed: OSError" in bench.texts[0]
    assert bench.recorder.statistics.write_errors == 2  # the first, and one more try
    statistics = bench.recorder.close()
    assert statistics.rows_written + statistics.rows_dropped == bench.pushed
    assert bench.rows_in_files() == list(range(statistics.rows_written))
    assert 0 < statistics.rows_written < 200


@pytest.mark.parametrize("room", range(2000, 60_000, 4111))
def test_after_a_full_disk_recording_goes_on_in_a_new_file(tmp_path, room):
    bench = Bench(tmp_path, room=room)
    while not bench.events:
        bench.turn(20)
        bench.check_sum()
    kept = bench.recorder.statistics.rows_written
    for _ in range(20):
        bench.turn(20)
    bench.disk.room = None
    bench.clock.advance_s(5.0)
    first_again = bench.pushed
    for _ in range(25):
        bench.turn(20)
        bench.check_sum()
    statistics = bench.recorder.close()
    assert [event.level for event in bench.events] == [Level.ERROR, Level.WARNING]
    assert f"{first_again - kept} rows are missing" in bench.texts[1]
    assert bench.events[1].data["rows_missing"] == statistics.rows_dropped == first_again - kept
    assert bench.rows_in_files() == [*range(kept), *range(first_again, bench.pushed)]
    last = read_run(statistics.files[-1])
    assert last.complete
    assert (last.metadata["segment"], last.metadata["continues"]) == ("2", "run.mcap")
    assert [event.text for event in last.events] == bench.texts
    assert last.attachments.keys() == {"axis.yaml"}


@pytest.mark.parametrize("code", [errno.EIO, errno.EROFS, errno.EDQUOT])
def test_any_error_of_the_disk_is_survived(tmp_path, code):
    bench = Bench(tmp_path)
    bench.turn()
    bench.disk.error, bench.disk.room = code, 0
    for _ in range(250):
        bench.turn(count=20)
        bench.check_sum()
    statistics = bench.recorder.close()
    assert os.strerror(code) in statistics.last_error or "injected" in statistics.last_error
    assert len(bench.events) == 1
    assert statistics.rows_written + statistics.rows_dropped == bench.pushed


def test_vanished_directory(tmp_path):
    bench = Bench(tmp_path / "disk")
    for _ in range(25):
        bench.turn()
    shutil.rmtree(tmp_path / "disk")
    bench.turn(seconds=1.0)
    bench.check_sum()
    assert "deleted or moved" in bench.texts[0]
    assert bench.recorder.statistics.rows_written == 0  # what was written is gone with the directory
    first_again = bench.pushed
    for _ in range(30):
        bench.turn(seconds=1.0)
    statistics = bench.recorder.close()
    bench.check_sum()
    assert statistics.files == (tmp_path / "disk" / "run_002.mcap",)
    ticks = bench.rows_in_files()
    assert ticks == list(range(ticks[0], bench.pushed))
    assert ticks[0] <= first_again + 500


def test_directory_moved_away_keeps_its_rows(tmp_path):
    bench = Bench(tmp_path / "disk")
    bench.turn(200)
    (tmp_path / "disk").rename(tmp_path / "moved")
    bench.turn(100, seconds=1.0)
    assert "deleted or moved" in bench.texts[0]
    bench.recorder.close()
    bench.check_sum()
    run = read_run(tmp_path / "moved" / "run.mcap.part")
    assert same_bits(run.rows, ROWS[:300])
    assert bench.recorder.statistics.rows_written >= 300


def test_a_path_that_cannot_be_written_is_an_error_at_once(tmp_path):
    (tmp_path / "file").write_text("not a directory")
    with pytest.raises(OSError, match="file"):
        Recorder(FakeRing(16), tmp_path / "file" / "run.mcap")
    Recorder(FakeRing(16), tmp_path / "run.mcap").close()
    with pytest.raises(FileExistsError):
        Recorder(FakeRing(16), tmp_path / "run.mcap")


def test_rotation_by_size(tmp_path):
    bench = Bench(tmp_path, rotation=RotationPolicy(max_bytes=60_000))
    for _ in range(60):
        bench.turn()
    statistics = bench.recorder.close()
    names = [path.name for path in statistics.files]
    assert len(names) > 3
    assert names == sorted(names) == ["run.mcap", *(f"run_{i:03d}.mcap" for i in range(2, len(names) + 1))]
    assert bench.rows_in_files() == list(range(6000))
    for path in statistics.files:
        run = read_run(path)
        assert run.complete
        assert path.stat().st_size < 60_000 + 100 * 211 + 20_000
        assert run.metadata["axis"] == "bench"
    assert statistics.bytes_written == sum(path.stat().st_size for path in statistics.files)
    assert bench.events == []


def test_rotation_by_time(tmp_path):
    bench = Bench(tmp_path, rotation=RotationPolicy(max_duration_s=10.0))
    for _ in range(35):
        bench.turn(20, seconds=1.0)
    files = bench.recorder.close().files
    assert [len(read_run(path).rows) for path in files] == [200, 200, 200, 100]
    assert read_run(files[0]).summary["ended_by"] == "rotation"


def test_quota_deletes_the_oldest_segments(tmp_path):
    policy = RotationPolicy(max_bytes=40_000, quota_bytes=200_000)
    bench = Bench(tmp_path, rotation=policy, quota_interval_s=1.0)
    for _ in range(190):
        bench.turn()
        sizes = [path.stat().st_size for path in tmp_path.iterdir()]
        assert sum(sizes) < 200_000 + 20 * 100 * 211  # the interval's rows, at most
    statistics = bench.recorder.close()
    left = sorted(tmp_path.iterdir())
    assert left == [path for path in statistics.files if path.exists()]
    assert left == list(statistics.files[-len(left) :])  # the youngest
    assert len(left) < len(statistics.files)
    assert all("deleted to stay below recording.quota_bytes, 200 kB" in text for text in bench.texts)
    deleted = [name for event in bench.events for name in event.data["files"]]
    assert deleted == [path.name for path in statistics.files[: len(deleted)]]


def test_quota_that_cannot_be_kept_is_said_once(tmp_path):
    bench = Bench(tmp_path, rotation=RotationPolicy(quota_bytes=10_000), quota_interval_s=1.0)
    for _ in range(100):
        bench.turn()
    bench.recorder.close()
    assert len(bench.texts) == 1
    assert "none may be deleted" in bench.texts[0]
    assert bench.rows_in_files() == list(range(10_000))


def test_events_beyond_the_queue_are_counted(tmp_path):
    bench = Bench(tmp_path)
    for number in range(EVENT_QUEUE + 10):
        bench.recorder.event(Level.DEBUG, "loop", "flood", {"number": number})
    bench.turn()
    statistics = bench.recorder.close()
    assert statistics.events_lost == 10
    events = read_run(bench.path).events
    assert [event.data["number"] for event in events] == list(range(10, EVENT_QUEUE + 10))


def test_broken_viewer_is_counted_and_ignored(tmp_path):
    bench = Bench(tmp_path)

    def broken(rows) -> None:
        raise RuntimeError("viewer")

    hooks = RecorderHooks(bench.clock, on_rows=broken)
    recorder = Recorder(bench.ring, tmp_path / "b.mcap", HEADER, hooks=hooks)
    bench.push(50)
    recorder.drain_once()
    statistics = recorder.close()
    assert (statistics.rows_written, statistics.hook_errors) == (50, 1)
    assert "viewer" in statistics.last_error
    bench.recorder.close()


def test_thread_drains_and_closes(tmp_path):
    """On its thread; the test waits for what the recorder has seen, not for time."""
    ring = FakeRing(8192)
    seen = threading.Semaphore(0)
    hooks = RecorderHooks(on_rows=lambda rows: seen.release(len(rows)))
    recorder = Recorder(ring, tmp_path / "a.mcap", HEADER, RecorderSettings(drain_interval_s=0.001), hooks)
    recorder.start()
    for begin in range(0, 3000, 100):
        ring.push(ROWS[begin : begin + 100])
        for _ in range(100):
            assert seen.acquire(timeout=60)
    ring.push(ROWS[3000:3005])
    assert recorder.stop({"reason": "done"})
    assert recorder.stop()
    run = read_run(tmp_path / "a.mcap")
    assert same_bits(run.rows, ROWS[:3005])
    assert run.summary["reason"] == "done"


def test_thread_survives_what_it_does_not_expect(tmp_path):
    ring = FakeRing(64)
    failed = threading.Event()
    seen = threading.Event()
    hooks = RecorderHooks(on_rows=lambda rows: seen.set())
    recorder = Recorder(ring, tmp_path / "a.mcap", HEADER, RecorderSettings(drain_interval_s=0.001), hooks)
    read = recorder._reader.read

    def short_of_memory():
        recorder._reader.read = read
        failed.set()
        raise MemoryError("for a moment")

    recorder._reader.read = short_of_memory
    recorder.start()
    assert failed.wait(60)
    ring.push(ROWS[:10])
    assert seen.wait(60)
    assert recorder.stop()
    statistics = recorder.statistics
    assert (statistics.rows_written, statistics.write_errors) == (10, 1)
    assert "MemoryError" in statistics.last_error


def test_thread_never_inherits_realtime_priority(tmp_path):
    """Started from a thread that is FIFO (where the machine allows it) and pinned, it is ordinary and free."""
    policies: list[tuple[int, set[int]]] = []
    all_cpus = os.sched_getaffinity(0)

    def start_from_realtime() -> None:
        os.sched_setaffinity(0, {min(all_cpus)})
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
        except PermissionError:
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        settings_ = RecorderSettings(cpus=frozenset(all_cpus))
        with Recorder(FakeRing(16), tmp_path / "a.mcap", settings=settings_) as recorder:
            recorder.start()
            thread = recorder.thread_id
            policies.append((os.sched_getscheduler(thread), os.sched_getaffinity(thread)))

    starter = threading.Thread(target=start_from_realtime)
    starter.start()
    starter.join()
    assert policies == [(os.SCHED_OTHER, all_cpus)]


def test_cpus_that_do_not_exist_are_reported(tmp_path):
    events = []
    settings_ = RecorderSettings(cpus=frozenset({100_000}))
    recorder = Recorder(
        FakeRing(16), tmp_path / "a.mcap", settings=settings_, hooks=RecorderHooks(on_event=events.append)
    )
    recorder.start()
    assert recorder.stop()
    assert "runs where it was started" in events[0].text


def test_from_now_leaves_older_rows_out(tmp_path):
    ring = FakeRing(64)
    ring.push(ROWS[:40])
    recorder = Recorder(ring, tmp_path / "a.mcap", HEADER, from_now=True)
    ring.push(ROWS[40:50])
    statistics = recorder.close()
    assert (statistics.rows_written, statistics.rows_lost) == (11, 0)
    assert same_bits(read_run(tmp_path / "a.mcap").rows, ROWS[39:50])  # with the row before
