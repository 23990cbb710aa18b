"""Records of the runs that have none: one unit a run, by processes here, by one share of many, or by dask.

A unit writes its record itself and returns nothing. One that is done again finds the record and does no work. What a
run's file does wrong is noted with the store; what the store's disk does ends the work. A file whose place does not
answer is no failure of the file: it is noted, and the run waits for the next work.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from ..documents import DocumentError
from ..evaluation.workers import prepared_processes, take_environment
from ..identification.dataset import DataError
from ..recording.errors import RecordingError
from .adding import facts_of
from .measure import measured
from .place import digest_of, is_url, local_copy
from .schema import said_in_index
from .store import FleetStore

Entry = dict[str, Any]
Progress = Callable[[float], None]


class StoreWriteError(OSError):
    """The store does not take a record: the disk, not the run."""


class UnreachedError(Exception):
    """The place of a run's file does not answer."""


def make_record(address: str, entry: Entry) -> None:
    """One unit: the record of a run, if there is none. Raises StoreWriteError where the store cannot be written."""
    store = FleetStore(address)
    run = str(entry["run"])
    while not store.place.exists(store.record_name(run)) and not store.has_failed(run):
        with _storing():
            attempt = store.begin_attempt(run, entry["path"])
        if attempt is None:
            return
        try:
            row = record_row(entry)
        except UnreachedError as error:
            with _storing():
                store.give_back(attempt)
                store.note_unreached(run, entry["path"], str(error))
            return
        except Exception as error:  # whatever is in the file: it stops nobody else
            of_file = isinstance(error, DataError)
            reason = str(error) if of_file else f"{type(error).__name__}: {error}"
            with _storing():
                store.end_attempt(attempt, reason, for_good=of_file)
            continue
        except BaseException:
            store.give_back(attempt)
            raise
        try:
            with _storing():
                store.write_record(row)
        except StoreWriteError:
            store.give_back(attempt)  # a full disk is not the run's doing
            raise
        with _storing():
            store.end_attempt(attempt, None)


def record_row(entry: Entry) -> dict[str, Any]:
    """The record of a run that the index names. Raises DataError for what its file does wrong, UnreachedError."""
    path = str(entry["path"])
    with contextlib.ExitStack() as kept:
        copy = reached_file(entry, kept)
        try:
            with threadpool_limits(1):  # sums in another order would be other bytes
                row = measured(copy, str(entry["run"]), facts_of(entry))
        except (RecordingError, DocumentError) as error:
            raise DataError(str(error).replace(str(copy), path)) from error
    return row | said_in_index(entry)


def reached_file(entry: Entry, kept: contextlib.ExitStack) -> Path:
    """The file of a run on this machine, for as long as `kept`: what was added, byte by byte.

    Raises DataError where it has changed, or is gone from a place that answers; UnreachedError where that does not.
    """
    path = str(entry["path"])
    try:
        copy = kept.enter_context(local_copy(path))
        digest = digest_of(copy)
    except DocumentError:
        raise
    except FileNotFoundError as error:
        if is_url(path) or Path(path).parent.is_dir():
            raise DataError(f"{path}: {error.strerror or 'no such file'}: it is gone since it was added") from None
        raise UnreachedError(f"{path}: its directory is not there") from error
    except Exception as error:  # clients of object stores have their own
        raise UnreachedError(f"{path}: cannot be reached: {error}") from error
    if digest != entry["run"]:
        raise DataError(f"{path}: has changed since it was added: add it again")
    return copy


@contextlib.contextmanager
def _storing() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise StoreWriteError(error.errno, error.strerror or str(error), error.filename) from error


# ---- engines


def work(address: str, entries: Sequence[Entry], workers: int | None = None, progress: Progress | None = None) -> None:
    """Units in processes of this machine. `workers`: None for all cores; one is this process itself.

    A worker that dies is replaced, and its unit tried again. Raises StoreWriteError; what was not begun then waits.
    """
    workers = min(workers or len(os.sched_getaffinity(0)), max(1, len(entries)))
    if workers == 1:
        for number, entry in enumerate(entries):
            make_record(address, entry)
            _tell(progress, number + 1, len(entries))
        return
    todo = list(reversed(entries))
    crew = [_Hand(address) for _ in range(workers)]
    done = 0
    try:
        for hand in crew:
            hand.give(todo.pop())
        while busy := [hand for hand in crew if hand.entry is not None]:
            wait([hand.pipe for hand in busy])
            for hand in busy:
                if not hand.pipe.poll():
                    continue
                if hand.has_died():
                    hand.begin_again()
                    continue
                done += 1
                _tell(progress, done, len(entries))
                if todo:
                    hand.give(todo.pop())
    finally:
        for hand in crew:
            hand.dismiss()


def shard_of(entries: Sequence[Entry], number: int, count: int) -> list[Entry]:
    """Share `number` (from 1) of `count`: the same runs whoever asks, whenever."""
    return [entry for entry in entries if int(str(entry["run"])[:12], 16) % count == number - 1]


class _Hand:
    """A worker process and the unit that it has."""

    def __init__(self, address: str) -> None:
        self._address = address
        self.entry: Entry | None = None
        self.pipe: Connection
        self._process: ForkServerProcess
        self.replace()

    def replace(self) -> None:
        """A process that takes units."""
        context = prepared_processes(__name__)
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_units, args=(self._address, theirs, dict(os.environ)), daemon=True)
        self._process.start()
        theirs.close()
        self.entry = None

    def begin_again(self) -> None:
        """A new process, with the unit of the one that died: the store counts how often."""
        unit = self.entry
        self.replace()
        if unit is not None:
            self.give(unit)

    def give(self, entry: Entry) -> None:
        """A unit to work on."""
        self.entry = entry
        with contextlib.suppress(OSError):  # one that died meanwhile is found when it is asked
            self.pipe.send(entry)

    def has_died(self) -> bool:
        """Take the answer; the unit is then done. Raises StoreWriteError."""
        try:
            problem = self.pipe.recv()
        except (EOFError, OSError):
            self._process.join()
            return True
        self.entry = None
        if problem is not None:
            raise problem
        return False

    def dismiss(self) -> None:
        """End the process; a unit that it has is given back."""
        self.pipe.close()
        if self.entry is not None:
            self._process.terminate()
        self._process.join()


def _units(address: str, pipe: Connection, environment: Mapping[str, str]) -> None:
    """In a worker: units until nobody asks for more."""
    take_environment(environment)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who asked, who then ends this
    signal.signal(signal.SIGTERM, _stop)
    while True:
        try:
            entry = pipe.recv()
        except (EOFError, OSError):
            return
        problem: BaseException | None = None
        try:
            make_record(address, entry)
        except Exception as error:
            problem = error
        pipe.send(problem)


def _stop(*_: object) -> None:
    raise SystemExit


def _tell(progress: Progress | None, done: int, count: int) -> None:
    if progress is not None:
        progress(done / count)
