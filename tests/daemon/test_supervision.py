"""The supervisor without a drive, on a clock that the test moves: deadlines, what is recorded, and disks that hang."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import importlib
import io
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from daemon.rig import PATIENCE_S, Rig, axis_file, edit

from fffo_drive.config.commissioning import Permission
from fffo_drive.daemon import supervisor as supervisors
from fffo_drive.daemon.client import CallError
from fffo_drive.daemon.event_log import EventLog
from fffo_drive.daemon.journal import Journal
from fffo_drive.daemon.record_keeper import LULL_S, RecordKeeper
from fffo_drive.daemon.rpc import BAD_DOCUMENT
from fffo_drive.daemon.states import Action, State, StateEvent
from fffo_drive.daemon.supervisor import Supervisor
from fffo_drive.drive.port import DriveError
from fffo_drive.workflows.plan import make_plan

STOP_S = 3.0
KEY = "controller.proportional_a_per_rps"


class Clock:
    """Monotonic seconds."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class QuietMotion:
    """Takes every request; nothing comes of it."""

    wants_torque = True

    def drop(self) -> None: ...

    def ask(self, goal: int) -> None: ...

    def brake_when_settled(self, plan: object) -> None: ...

    def newly_lapsed(self) -> None: ...

    def newly_blocked(self) -> bool:
        return False

    def ended(self) -> bool:
        return False


class QuietWatcher:
    """Sees a drive without torque and without obstacles."""

    torque_on = commanding = False

    def look(self, now_s: float) -> None: ...

    def obstacles(self, *_: int) -> list[str]:
        return []


QUIET = SimpleNamespace(
    beat=lambda: None,
    session=SimpleNamespace(status=lambda word: 0, warnings=lambda: []),
)


class Supervised:
    """A supervisor with a drive of which nothing is heard."""

    def __init__(self, directory: Path, **daemon: object) -> None:
        plan = make_plan(axis_file(directory / "axis", stop_timeout_s=STOP_S, **daemon))
        self.clock = Clock()
        self.supervisor = Supervisor(plan, Journal({}, io.StringIO()), clock=self.clock)
        self.supervisor.connection = QUIET
        self.supervisor._watcher, self.supervisor.motion = QuietWatcher(), QuietMotion()
        self.supervisor._permission = Permission(None, None, "")

    @property
    def state(self) -> State:
        return self.supervisor.state

    def put(self, state: State) -> None:
        """As if it had come there."""
        self.supervisor.machine.state = state

    def later(self, seconds: float) -> None:
        """So much later, one turn."""
        self.clock.now_s += seconds
        self.supervisor.turn()

    def obstacles(self) -> list[str]:
        """Of the next turn."""
        self.later(0.0)
        return self.supervisor.obstacles

    def said(self) -> list[str]:
        """About the recording."""
        return [event["text"] for event in self.supervisor.log.since(0, 100) if event["kind"] == "recording"]


@pytest.fixture
def required(tmp_path):
    return Supervised(tmp_path, record="on", record_required=True)


# -- stops -------------------------------------------------------------------------------------------------------------


def test_a_quick_stop_that_is_asked_for_again_and_again_has_no_more_time(tmp_path):
    axis = Supervised(tmp_path)
    for _ in range(2):  # the second quick stop has a time of its own
        axis.put(State.RUNNING)
        axis.supervisor.apply(StateEvent.QUICK_STOP)
        axis.later(0.6 * STOP_S)
        axis.supervisor.apply(StateEvent.QUICK_STOP)
        assert axis.state is State.STOPPING
        axis.later(0.6 * STOP_S)
        assert axis.state is State.FAULT
        assert axis.supervisor.fault.name == "stop_failed"
        axis.later(10 * STOP_S)


def test_a_quick_stop_after_a_controlled_one_has_its_own_time(tmp_path):
    axis = Supervised(tmp_path)
    axis.put(State.ENABLED)
    axis.supervisor.apply(StateEvent.DISABLE)
    axis.later(0.6 * STOP_S)
    axis.supervisor.apply(StateEvent.QUICK_STOP)
    axis.later(0.6 * STOP_S)
    assert axis.state is State.STOPPING
    axis.later(0.6 * STOP_S)
    assert axis.state is State.FAULT


# -- what is recorded --------------------------------------------------------------------------------------------------


def full(*_: object) -> Path:
    raise OSError(errno.ENOSPC, "No space left on device")


def fails_to_open(axis: Supervised, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(axis.supervisor.recorder, "_start", full)
    with pytest.raises(OSError, match="No space"):
        asyncio.run(axis.supervisor.start_recording())


def test_where_a_recording_is_required_an_axis_without_its_file_is_not_enabled(required, monkeypatch):
    required.put(State.READY)
    fails_to_open(required, monkeypatch)
    (obstacle,) = required.obstacles()
    assert "daemon.record_required: no file: " in obstacle
    assert required.state is State.CONNECTED
    required.later(1.0)
    required.later(1.0)
    assert [text.split(": ")[:2] for text in required.said()] == [["recording", "no file"]]  # once
    assert "No space" in required.supervisor.recorder.status()["trouble"]
    required.supervisor.recorder.wanted = False  # record off: nothing is to be recorded, and nothing fails
    assert required.obstacles() == []
    assert required.state is State.READY


def test_an_enable_may_follow_the_answer_to_record_on_at_once(required, monkeypatch):
    required.put(State.READY)
    fails_to_open(required, monkeypatch)
    assert required.obstacles() != []
    keeper = required.supervisor.recorder
    monkeypatch.setattr(keeper, "_start", lambda *_: (Recording(), Path("a.mcap")))
    asyncio.run(required.supervisor.start_recording())
    assert required.state is State.READY  # without another turn


def test_without_the_requirement_a_file_that_cannot_be_opened_is_reported_and_forbids_nothing(tmp_path, monkeypatch):
    axis = Supervised(tmp_path, record="on")
    axis.put(State.READY)
    fails_to_open(axis, monkeypatch)
    assert axis.obstacles() == []
    axis.put(State.RUNNING)
    axis.later(1.0)
    assert axis.state is State.RUNNING
    assert "No space" in str(axis.said())


def test_an_axis_in_motion_is_stopped_when_its_file_cannot_be_opened_but_not_while_it_is_being_opened(
    required, monkeypatch
):
    supervisor = required.supervisor
    begun, go_on = threading.Event(), threading.Event()

    def slow(*_: object) -> Path:
        begun.set()
        assert go_on.wait(PATIENCE_S)
        return full()

    async def record() -> None:
        opening = asyncio.create_task(supervisor.start_recording())
        assert await asyncio.to_thread(begun.wait, PATIENCE_S)
        required.put(State.RUNNING)
        required.later(1.0)
        assert required.state is State.RUNNING
        required.put(State.READY)
        assert required.obstacles() == ["daemon.record_required: no file is open yet"]
        required.put(State.RUNNING)
        go_on.set()
        with pytest.raises(OSError, match="No space"):
            await opening

    monkeypatch.setattr(supervisor.recorder, "_start", slow)
    asyncio.run(record())
    required.later(1.0)
    assert required.state is State.STOPPING


class Recording:
    """A recorder as the keeper sees it."""

    def __init__(self) -> None:
        self.alive = True
        self.turning, self._turns = True, 0
        self.current_path, self.disk_life = Path("a.mcap.part"), None
        self.statistics = SimpleNamespace(
            rows_dropped=0, rows_lost=0, write_errors=0, last_error="", files=(), rows_written=0
        )

    @property
    def turns(self) -> int:
        """It writes on, as long as no disk keeps it."""
        self._turns += self.turning
        return self._turns

    def event(self, *_: object) -> None:
        """Not written."""

    def lose(self, rows: int, why: str) -> None:
        """One write that fails."""
        self.statistics.rows_dropped += rows
        self.statistics.write_errors += 1
        self.statistics.last_error = why


def test_each_failure_of_a_required_recording_stops_the_axis_though_counters_never_go_back(required):
    recording = required.supervisor.recorder._recorder = Recording()
    required.put(State.READY)
    recording.lose(20, "OSError: once")
    required.later(1.0)
    assert "record_required: 20 rows are missing" in str(required.obstacles())
    required.later(LULL_S)
    assert required.obstacles() == []
    for _ in range(2):
        required.put(State.RUNNING)
        required.later(1.0)
        assert required.state is State.RUNNING  # a hiccup that is over
        recording.lose(80, "OSError: No space left on device")
        required.later(1.0)
        assert required.state is State.STOPPING
        required.supervisor.apply(StateEvent.TORQUE_OFF)
        required.later(LULL_S)
    reported = [text for text in required.said() if text.startswith("recording: ")]
    assert [text.split()[1] for text in reported] == ["20", "100", "180"]


def test_a_disk_that_is_full_all_the_time_is_reported_once(required):
    recording = required.supervisor.recorder._recorder = Recording()
    required.put(State.READY)
    for _ in range(50):
        recording.lose(20, "OSError: No space left on device")
        required.later(0.04)
    assert len(required.said()) == 1


def test_an_axis_whose_recorder_died_at_rest_is_not_enabled(required):
    recording = required.supervisor.recorder._recorder = Recording()
    required.put(State.READY)
    recording.alive = False
    required.later(10 * LULL_S)
    assert required.obstacles() == ["daemon.record_required: the recorder's thread has ended"]


# -- clients that leave, and disks that hang ---------------------------------------------------------------------------


class Keeper(RecordKeeper):
    """Opens and closes a file as slowly as the test wants."""

    def __init__(self) -> None:
        super().__init__(EventLog(Journal({}, io.StringIO())), None)
        self.begun, self.go_on = threading.Event(), threading.Event()
        self.made: list[Recording] = []
        self.stopped: list[object] = []

    def _slow(self) -> None:
        self.begun.set()
        assert self.go_on.wait(PATIENCE_S)

    def _directory(self, plan: object) -> Path:
        return Path()

    def _start(self, *_: object) -> tuple[Recording, Path]:
        self._slow()
        self.made.append(Recording())
        return self.made[-1], Path(f"{len(self.made)}.mcap")

    def _stop(self, recorder: object) -> tuple[Path, ...]:
        self._slow()
        self.stopped.append(recorder)
        return ()

    def another(self) -> asyncio.Task[str]:
        plan = SimpleNamespace(axis=SimpleNamespace(daemon=SimpleNamespace(fleet=None)))
        return asyncio.create_task(self.begin(plan, object(), None, 0, ""))

    async def go_on_soon(self) -> None:
        """Once everything that was asked for waits for the lock or the disk."""
        for _ in range(5):
            await asyncio.sleep(0)
        self.go_on.set()

    async def abandoned(self, change: asyncio.Task[object]) -> None:
        """Who asked for it goes away in the midst of it."""
        assert await asyncio.to_thread(self.begun.wait, PATIENCE_S)
        change.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await change
        self.begun.clear()


def test_a_file_whose_client_leaves_while_it_is_opened_is_the_only_one():
    async def story() -> None:
        keeper = Keeper()
        await keeper.abandoned(keeper.another())
        again = keeper.another()
        await keeper.go_on_soon()
        assert await again == ""  # it is recorded already
        assert len(keeper.made) == 1

    asyncio.run(story())


def test_a_file_whose_client_leaves_while_it_is_closed_is_closed_once_and_another_one_follows():
    async def story() -> None:
        keeper = Keeper()
        keeper._recorder = Recording()
        await keeper.abandoned(asyncio.create_task(keeper.end()))
        ending, again = asyncio.create_task(keeper.end()), keeper.another()
        await keeper.go_on_soon()
        assert await ending == []
        assert await again == "1.mcap"
        assert len(keeper.stopped) == 1
        assert keeper.running

    asyncio.run(story())


def test_a_drive_that_is_let_go_does_not_wait_for_the_disk(tmp_path, monkeypatch):
    """A service that ends meanwhile has no time for a disk that hangs: the drive would never be released."""
    left = threading.Event()
    monkeypatch.setattr(supervisors, "leave", lambda connection: left.set())

    def nobody(*_: object) -> None:
        raise DriveError("no drive")

    monkeypatch.setattr(supervisors, "bring_up", nobody)

    async def story() -> None:
        supervisor = Supervised(tmp_path).supervisor
        disk = asyncio.Event()
        supervisor.recorder = SimpleNamespace(wanted=False, busy=True, end=disk.wait, tell=lambda event: None)
        supervisor.machine.state = State.FAULT
        supervisor._act(Action.RELEASE, 0.0)
        supervisor.machine.state = State.OFFLINE
        living = asyncio.create_task(supervisor.run())
        assert await asyncio.to_thread(left.wait, PATIENCE_S)
        assert not disk.is_set()
        disk.set()
        await supervisor.close()
        await living

    asyncio.run(story())


def test_a_reload_reads_on_a_thread_of_its_own_and_changes_nothing_where_it_cannot_read(tmp_path, monkeypatch):
    """On the supervisor's thread a disk that hangs would be a silent supervisor."""
    importlib.import_module("fffo_drive.jit.compiler")  # reads all kernels when it is first needed, by whichever thread
    readers: set[tuple[str, str]] = set()
    broken = threading.Event()

    def reading(what, read):
        def noted(*arguments):
            readers.add((what, threading.current_thread().name))
            if what == "bytes" and broken.is_set():
                raise OSError(errno.EIO, "Input/output error")
            return read(*arguments)

        return noted

    with Rig(tmp_path, drive=False, retry_s=600) as rig:
        monkeypatch.setattr(Path, "read_bytes", reading("bytes", Path.read_bytes))
        monkeypatch.setattr(supervisors, "permission", reading("permission", supervisors.permission))
        client = rig.client()
        before = client.call("info")["keys"][KEY]
        edit(rig.path, lambda axis: axis["controller"].update(proportional_a_per_rps=0.9 * before))
        broken.set()
        with pytest.raises(CallError, match="Input/output") as error:
            client.call("reload")
        assert error.value.code == BAD_DOCUMENT
        assert client.call("info")["keys"][KEY] == before
        broken.clear()
        client.call("reload")
        assert client.call("info")["keys"][KEY] == 0.9 * before
    assert {("bytes", "fffo-files"), ("permission", "fffo-files")} <= readers
    assert {thread for _, thread in readers} == {"fffo-files"}
