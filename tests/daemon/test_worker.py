"""Threads that may hang in a file: who waits is answered, what comes late is dropped, and the next work goes on."""

from __future__ import annotations

import asyncio
import os
import threading
from pathlib import Path

import pytest
from daemon.rig import PATIENCE_S

from fffo_drive.daemon import worker as workers
from fffo_drive.daemon.worker import MOST_HUNG, DiskSilentError, Stillness, Worker

SHORT_S = 0.2


class Told(list):
    """What a worker said of the disk."""

    def __call__(self, text: str, silent: bool) -> None:
        self.append((text, silent))


@pytest.fixture
def fifo(tmp_path):
    """A file that does not come until somebody writes it."""
    path = tmp_path / "axis.yaml"
    os.mkfifo(path)
    yield path
    for _ in range(MOST_HUNG):  # nobody is left in it
        try:
            os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK))
        except OSError:
            break


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(workers, "DISK_PATIENCE_S", SHORT_S)


def silent(told: Told) -> Worker:
    return Worker("test", told)


def test_who_waits_for_a_file_that_hangs_is_told_which_and_the_next_work_goes_on(fifo):
    told = Told()

    async def story() -> None:
        worker = silent(told)
        waiting = asyncio.create_task(worker.run(fifo.read_text, doing="reading"))
        behind = asyncio.create_task(worker.run(lambda: 1))
        for task in (waiting, behind):
            with pytest.raises(DiskSilentError, match=f"the disk does not answer: reading {fifo} takes longer"):
                await task
        assert worker.silent
        assert worker.hangs
        assert not worker.busy
        assert await worker.run(lambda: 2) == 2  # on another thread
        assert worker.silent == ""

    asyncio.run(story())
    assert [silent for _, silent in told] == [True, False]


def test_what_a_file_says_too_late_is_dropped_and_goes_to_who_cleans_up(fifo):
    told, late, cleaned = Told(), [], threading.Event()

    async def story() -> None:
        worker = silent(told)

        def clean(text: str) -> None:
            late.append(text)
            cleaned.set()

        with pytest.raises(DiskSilentError):
            await worker.run(fifo.read_text, doing="reading", late=clean)
        await asyncio.to_thread(fifo.write_text, "late")
        assert await asyncio.to_thread(cleaned.wait, PATIENCE_S)
        while worker.hangs:
            await asyncio.sleep(0)
        assert worker.silent == ""

    asyncio.run(story())
    assert late == ["late"]
    assert told[-1] == ("the disk answers again", False)


def test_threads_that_hang_are_bounded_and_come_back(fifo):
    async def story() -> None:
        worker = silent(Told())
        for _ in range(MOST_HUNG):
            with pytest.raises(DiskSilentError):
                await worker.run(fifo.read_text, doing="reading")
        before = threading.active_count()
        with pytest.raises(DiskSilentError, match="restart the service"):
            await worker.run(lambda: 1)
        assert threading.active_count() == before
        writer = await asyncio.to_thread(os.open, fifo, os.O_WRONLY)
        os.close(writer)
        while worker.hangs:
            await asyncio.sleep(0)
        assert await worker.run(lambda: 1) == 1

    asyncio.run(story())


def test_long_arithmetic_is_no_disk_that_hangs():
    def count() -> int:
        end_s = os.times().user + 3 * SHORT_S
        while os.times().user < end_s:
            pass
        return 3

    async def story() -> None:
        assert await silent(Told()).run(count) == 3

    asyncio.run(story())


def test_a_process_that_was_stopped_finds_no_disk_that_hangs():
    stillness = Stillness(0.5)
    assert stillness.look(1, 100.0) == 0.0
    assert stillness.look(1, 1000.0) == 0.5
    assert stillness.look(1, 1000.2) == pytest.approx(0.7)
    assert stillness.look(2, 1000.4) == 0.0


def test_an_error_of_the_work_is_an_answer(tmp_path):
    async def story() -> None:
        worker = silent(Told())
        with pytest.raises(FileNotFoundError):
            await worker.run((tmp_path / "nothing").read_text)
        assert not worker.busy

    asyncio.run(story())
    assert not Path(tmp_path / "nothing").exists()
