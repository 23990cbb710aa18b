"""The units of `work` on the workers of a dask cluster: of one that runs, or of one on this machine."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Sequence
from typing import Any

from distributed import Client, KilledWorker, LocalCluster, as_completed

from ..documents import DocumentError
from .store import FleetStore
from .work import Entry, Progress, make_record

LOCAL = "local"
IN_FLIGHT = 2_000  # units that the scheduler knows of at a time
CONNECT_S = 10.0


def work_on_dask(where: str, address: str, entries: Sequence[Entry], progress: Progress | None = None) -> None:
    """Units on the cluster at `where`: the address of a scheduler (tcp://HOST:PORT), or `local`.

    The workers need this program and the store's address as it is here. A unit whose workers died three times ends with
    the store's failures. Raises DocumentError where no scheduler answers, StoreWriteError.
    """
    with _client(where) as client:
        left = iter(entries)
        running = as_completed()
        for entry in itertools.islice(left, IN_FLIGHT):
            running.add(_submit(client, address, entry))
        for done, future in enumerate(running, 1):
            error = future.exception()
            if isinstance(error, KilledWorker):
                _killed(address, str(future.key).removeprefix("record-"), entries)
            elif error is not None:
                raise error
            if progress is not None:
                progress(done / len(entries))
            for entry in itertools.islice(left, 1):
                running.add(_submit(client, address, entry))


def _submit(client: Client, address: str, entry: Entry) -> Any:
    return client.submit(make_record, address, entry, key=f"record-{entry['run']}", pure=False)


def _killed(address: str, run: str, entries: Sequence[Entry]) -> None:
    """The scheduler gives a unit up after so many workers: the store is told, and nobody tries it again."""
    store = FleetStore(address)
    path = next(str(entry["path"]) for entry in entries if entry["run"] == run)
    while store.begin_attempt(run, path) is not None:  # each one that died has counted already
        continue


@contextlib.contextmanager
def _client(where: str) -> Iterator[Client]:
    if where == LOCAL:
        own = LocalCluster(threads_per_worker=1, dashboard_address=None, host="127.0.0.1")
        with own as cluster, Client(cluster) as client:
            yield client
        return
    try:
        client = Client(where, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise DocumentError(f"--on dask:{where}: no scheduler answers there: {error}") from None
    with client:
        yield client
