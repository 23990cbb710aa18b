"""A fleet's store: what runs there are, the record of each, and what could not be made; Parquet and JSON files.

    store.json                      which format it is
    index/DIGEST.parquet            runs that were added: where they are, of which drive
    records/new/RUN-VERSION.parquet one record, as it was made
    records/merged/YYYY-MM/DIGEST.parquet
                                    the records of a month after `compact`, sorted by model, drive, time and run
    failed/RUN.json                 a run that makes no record, and why
    failed/tries/RUN-K.json         an attempt that has begun; gone when it ends well. K 0: its file was not reached

Every file appears whole under a name that its content gives. Whoever writes the same thing writes the same file, so
that several may write at once; whoever merges deletes only what stands in the merged file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from .. import formats
from ..documents import DocumentError, counted
from .place import StorePlace
from .schema import INDEX_SCHEMA, RECORD_SCHEMA, SCHEMA_VERSION, SORTED_BY, file_bytes, said_in_index, table_of

STORE_FILE = "store.json"
INDEX, NEW, MERGED, FAILED, TRIES = "index", "records/new", "records/merged", "failed", "failed/tries"
PARQUET = ".parquet"
MOST_TRIES = 3
UNREACHED = 0  # number of a note that a run's file could not be reached: no attempt
RELISTED = 5  # times that a listing is made again because somebody merged meanwhile


class Attempt(NamedTuple):
    """One try at a record that has begun."""

    run: str
    path: str
    number: int  # from 1
    reason: str  # why it ended badly; of one that is under way, or whose worker died, that


class Failure(NamedTuple):
    """A run that makes no record."""

    run: str
    path: str
    tries: int
    reason: str


class StoreStatus(NamedTuple):
    """How far the work is."""

    runs: int
    recorded: int
    failed: int
    new_files: int  # records that are not merged yet
    merged_files: int
    record_bytes: int
    drives: int
    models: int

    @property
    def waiting(self) -> int:
        """Runs that have neither a record nor failed."""
        return self.runs - self.recorded - self.failed

    @property
    def share(self) -> float:
        """Of the runs that are done, 0 to 1."""
        return (self.recorded + self.failed) / self.runs if self.runs else 1.0


class Compacted(NamedTuple):
    """What `compact` did."""

    records: int
    files: int
    removed: int  # records that were too old to keep


class FleetStore:
    """The store at a directory or a URL."""

    def __init__(self, address: str, create: bool = False) -> None:
        """`create`: make it where there is none. Raises DocumentError for what is no store of this version."""
        self.place = StorePlace(address)
        if create and not self.place.exists(STORE_FILE):
            if self.place.files("", ""):
                raise DocumentError(f"{address}: no store ({STORE_FILE} is missing), and not empty: give another place")
            text = json.dumps({"format": formats.FLEET.word}, indent=2) + "\n"
            self.place.write(STORE_FILE, text.encode())
        try:
            document = json.loads(self.place.read(STORE_FILE))
        except FileNotFoundError:
            raise DocumentError(
                f"{address}: no store here: check the path; `fffo-drive fleet add {address} RUN...` makes a new one"
            ) from None
        except ValueError as error:
            raise DocumentError(f"{address}: {STORE_FILE} cannot be read: {error}") from None
        try:
            formats.migrated(document, "fleet")
        except formats.FormatError as error:
            raise DocumentError(f"{address}: {STORE_FILE}: {error}") from None

    # ---- index

    def index(self) -> pa.Table:
        """What was added, one row a run (`schema.INDEX_SCHEMA`), sorted by run."""
        return self._read(lambda: self.place.files(INDEX, PARQUET), INDEX_SCHEMA)

    def add(self, entries: Sequence[Mapping[str, Any]]) -> int:
        """Put runs on the index; how many are new. Raises OSError."""
        known = set(self.index().column("run").to_pylist())
        fresh = {str(entry["run"]): entry for entry in entries if entry["run"] not in known}
        if fresh:
            self._put(INDEX, table_of((fresh[run] for run in sorted(fresh)), INDEX_SCHEMA))
        return len(fresh)

    def _put(self, folder: str, table: pa.Table) -> str:
        data = file_bytes(table)
        name = f"{folder}/{hashlib.sha256(data).hexdigest()[:16]}{PARQUET}"
        self.place.write(name, data)
        return name

    # ---- records

    def record_name(self, run: str) -> str:
        """The file of a record as it is made."""
        return f"{NEW}/{run}-{SCHEMA_VERSION}{PARQUET}"

    def write_record(self, row: Mapping[str, Any]) -> None:
        """Put one record. Raises OSError."""
        self.place.write(self.record_name(str(row["run"])), file_bytes(table_of([row]), small=True))

    def records(self, columns: Sequence[str] | None = None, where: pc.Expression | None = None) -> pa.Table:
        """Records, one a run, in no order. `columns`: None for all; `where`: which. Raises DocumentError, OSError."""
        return self._records_in(self._record_files, columns, where)

    def parts(self, columns: Sequence[str]) -> Iterator[pa.Table]:
        """`records` in parts that hold different runs: month by month, where all is merged."""
        if self.place.files(NEW, PARQUET):  # looked for first: what is merged meanwhile is in a month by then
            yield self.records(columns)
            return
        months = {name.split("/")[2] for name in self.place.files(MERGED, PARQUET)}
        for month in sorted(months):
            yield self._records_in(partial(self.place.files, f"{MERGED}/{month}", PARQUET), columns, None)

    def _records_in(
        self, listed: Callable[[], dict[str, int]], columns: Sequence[str] | None, where: pc.Expression | None
    ) -> pa.Table:
        wanted = list(RECORD_SCHEMA.names) if columns is None else list(columns)
        table = self._read(listed, RECORD_SCHEMA, [*dict.fromkeys([*wanted, "schema_version"])], where)
        newest = pc.max(table.column("schema_version")).as_py() if table.num_rows else None
        if newest is not None and newest > SCHEMA_VERSION:
            raise DocumentError(
                f"{self.place.address}: has records of version {newest}, this program reads {SCHEMA_VERSION} and "
                "older: read it with the fffo-drive that made them, or a later one"
            )
        return table.select(wanted)

    def recorded(self) -> pa.ChunkedArray:
        """Runs that have a record of this version; one may be there twice."""
        ending = f"-{SCHEMA_VERSION}{PARQUET}"
        new = [name.rsplit("/", 1)[1] for name in self.place.files(NEW, ending)]  # first, as in parts
        merged = partial(self.place.files, MERGED, PARQUET)
        table = self._read(merged, RECORD_SCHEMA, ["run"], pc.field("schema_version") >= SCHEMA_VERSION)
        own = pa.array([name.removesuffix(ending) for name in new], pa.string())
        return pa.chunked_array([own, *table.column("run").chunks])

    def _record_files(self) -> dict[str, int]:
        # new ones first: what is merged between the two listings is then seen twice, never missed
        return {**self.place.files(NEW, PARQUET), **self.place.files(MERGED, PARQUET)}

    def _read(
        self, listed: Callable[[], dict[str, int]], schema: pa.Schema, columns: Sequence[str] | None = None,
        where: pc.Expression | None = None,
    ) -> pa.Table:  # fmt: skip
        """Rows of the files that a listing names, one a run.

        Listed again where somebody merged files away meanwhile.
        """
        wanted = list(schema.names if columns is None else columns)
        for last in (*([False] * (RELISTED - 1)), True):
            names = list(listed())
            if not names:
                break
            apart = _hold_different_runs(names)
            needed = wanted if apart else [*dict.fromkeys([*wanted, "run"])]
            files = [self.place.full(name) for name in names]
            try:
                source = ds.dataset(files, schema=schema, format="parquet", filesystem=self.place.filesystem)
                # threads wait for a network side by side; what a disk gives, they only slow down: memory that is new
                # to the process is handed to one of them at a time
                table = source.to_table(columns=needed, filter=where, use_threads=not self.place.is_local)
            except FileNotFoundError:
                if last:
                    raise
            else:
                return table if apart else _first_of_each(table, table.schema).select(wanted)
        return schema.empty_table().select(wanted)

    # ---- failures

    def begin_attempt(self, run: str, path: str) -> Attempt | None:
        """Note that a try at a record begins; None where there were enough, which is then noted as a failure."""
        tried = self.place.files(TRIES, ".json")
        numbers = [int(name[:-5].rsplit("-", 1)[1]) for name in tried if name.startswith(f"{TRIES}/{run}-")]
        attempt = Attempt(run, path, max(numbers, default=0) + 1, "its worker died, or was stopped, while on it")
        if attempt.number > MOST_TRIES:
            last = json.loads(self.place.read(f"{TRIES}/{run}-{MOST_TRIES}.json"))
            self._fail(Failure(run, path, MOST_TRIES, str(last["reason"])))
            return None
        self._note(attempt)
        return attempt

    def note_unreached(self, run: str, path: str, reason: str) -> None:
        """The place of a run's file did not answer: it waits, and this is no failure of the file."""
        self._note(Attempt(run, path, UNREACHED, reason))

    def unreached(self) -> list[Attempt]:
        """Runs that wait because the place of their file did not answer when it was last asked, by run."""
        names = self.place.files(TRIES, f"-{UNREACHED}.json")
        return [Attempt(**json.loads(self.place.read(name))) for name in names]

    def _note(self, attempt: Attempt) -> None:
        text = json.dumps(attempt._asdict(), indent=2) + "\n"
        self.place.write(f"{TRIES}/{attempt.run}-{attempt.number}.json", text.encode())

    def end_attempt(self, attempt: Attempt, reason: str | None, for_good: bool = False) -> None:
        """A try has ended: well, and nothing is left of it, or badly, with a reason, `for_good` if any other would."""
        if reason is not None and (for_good or attempt.number >= MOST_TRIES):
            self._fail(Failure(attempt.run, attempt.path, attempt.number, reason))
        elif reason is not None:
            self._note(attempt._replace(reason=reason))
        else:
            self._forget(attempt.run)

    def give_back(self, attempt: Attempt) -> None:
        """A try that was stopped from outside does not count."""
        self.place.delete([f"{TRIES}/{attempt.run}-{attempt.number}.json"])

    def _fail(self, failure: Failure) -> None:
        text = json.dumps(failure._asdict(), indent=2) + "\n"
        self.place.write(f"{FAILED}/{failure.run}.json", text.encode())
        self._forget(failure.run)

    def _forget(self, run: str) -> None:
        self.place.delete(f"{TRIES}/{run}-{number}.json" for number in range(MOST_TRIES + 1))

    def failures(self) -> list[Failure]:
        """Runs that make no record, by run."""
        names = [name for name in self.place.files(FAILED, ".json") if not name.startswith(f"{TRIES}/")]
        return [Failure(**json.loads(self.place.read(name))) for name in names]

    def has_failed(self, run: str) -> bool:
        """Whether this run is known to make no record."""
        return self.place.exists(f"{FAILED}/{run}.json")

    def forgive(self) -> int:
        """Forget all failures, so that they are tried again; how many there were."""
        names = list(self.place.files(FAILED, ".json"))
        self.place.delete(names)
        return sum(not name.startswith(f"{TRIES}/") for name in names)

    # ---- what is left to do

    def waiting(self) -> list[dict[str, Any]]:
        """Entries of the index that have neither a record nor failed, by run."""
        failed = pa.array([failure.run for failure in self.failures()], pa.string())
        done = pa.chunked_array([failed, *self.recorded().chunks])
        index = self.index()
        entries: list[dict[str, Any]] = index.filter(pc.invert(pc.is_in(index.column("run"), done))).to_pylist()
        return entries

    def status(self) -> StoreStatus:
        """Counts."""
        index = self.index()
        new, merged = self.place.files(NEW, PARQUET), self.place.files(MERGED, PARQUET)
        known = index.column("run")
        failed = pa.array([failure.run for failure in self.failures()], pa.string())
        return StoreStatus(
            runs=index.num_rows,
            recorded=pc.sum(pc.is_in(known, self.recorded())).as_py() or 0,
            failed=pc.sum(pc.is_in(failed, known)).as_py() or 0,
            new_files=len(new),
            merged_files=len(merged),
            record_bytes=sum(new.values()) + sum(merged.values()),
            drives=pc.count_distinct(index.column("drive")).as_py(),
            models=pc.count_distinct(index.column("model")).as_py(),
        )

    def drives(self) -> pa.Table:
        """model, drive, runs, first and last start of each drive of the index."""
        grouped = self.index().group_by(["model", "drive"])
        table = grouped.aggregate([("run", "count"), ("start", "min"), ("start", "max")])
        named = table.select(["model", "drive", "run_count", "start_min", "start_max"])
        return named.rename_columns(["model", "drive", "runs", "first", "last"]).sort_by(
            [("model", "ascending"), ("drive", "ascending")]
        )

    # ---- merging

    def compact(self, keep_days: float | None = None, now: datetime | None = None) -> Compacted:
        """Merge the records of each month that has new ones, and the index.

        `keep_days`: runs that began longer ago are removed. Writers and readers may go on meanwhile; interrupted, it
        is done again from where it was. Raises OSError.
        """
        oldest = None if keep_days is None else (now or datetime.now(UTC)) - timedelta(days=keep_days)
        self.place.sweep()
        kept = None if oldest is None else pc.field("start") >= pa.scalar(oldest, pa.timestamp("us", "UTC"))
        self._merge(list(self.place.files(INDEX, PARQUET)), INDEX, INDEX_SCHEMA, kept)
        new = self._by_month(list(self.place.files(NEW, PARQUET)))
        merged: dict[str, list[str]] = {}
        for name in self.place.files(MERGED, PARQUET):
            merged.setdefault(name.split("/")[2], []).append(name)
        records = removed = 0
        for month in sorted({*new, *merged}):
            names = [*merged.get(month, []), *new.get(month, [])]
            stayed, gone = self._merge(names, f"{MERGED}/{month}", RECORD_SCHEMA, kept)
            records, removed = records + stayed, removed + gone
        return Compacted(records, len(self.place.files(MERGED, PARQUET)), removed)

    def drop(self, runs: Sequence[str]) -> None:
        """Take runs off the index, with their records and failures: another file is the same run. Raises OSError."""
        others = ~pc.field("run").isin(list(runs))
        self._merge(list(self.place.files(INDEX, PARQUET)), INDEX, INDEX_SCHEMA, others)
        for run in runs:
            self.place.delete([self.record_name(run), f"{FAILED}/{run}.json"])
            self._forget(run)
        for name in self.place.files(MERGED, PARQUET):
            self._merge([name], name.rsplit("/", 1)[0], RECORD_SCHEMA, others)

    def change(self, entries: Sequence[Mapping[str, Any]]) -> None:
        """Put runs on the index anew, as another drive, type, date or temperature; their records follow.

        Raises OSError.
        """
        said = {str(entry["run"]): entry for entry in entries}
        rows = self.records(where=pc.field("run").isin(list(said))).to_pylist()
        self.drop(list(said))
        self.add(entries)
        for row in rows:
            self.write_record(row | said_in_index(said[row["run"]]))

    def _by_month(self, names: list[str]) -> dict[str, list[str]]:
        """New records by the month in which their run began."""
        found: dict[str, list[str]] = {}
        for name in names:
            table = self._table(name, RECORD_SCHEMA, ["start"])
            if table is not None:
                found.setdefault(f"{table.column('start')[0].as_py():%Y-%m}", []).append(name)
        return found

    def _table(self, name: str, schema: pa.Schema, columns: Sequence[str] | None = None) -> pa.Table | None:
        """A file with the columns of today; None where somebody merged it away."""
        try:
            table = pq.read_table(pa.BufferReader(self.place.read(name)), columns=columns)
        except FileNotFoundError:
            return None
        wanted = schema if columns is None else pa.schema([schema.field(column) for column in columns])
        missing = [field for field in wanted if field.name not in table.schema.names]
        for field in missing:
            table = table.append_column(field, pa.nulls(table.num_rows, field.type))
        return table.select(wanted.names).cast(wanted)

    def _merge(self, names: list[str], folder: str, schema: pa.Schema, where: pc.Expression | None) -> tuple[int, int]:
        """Files into one, and only then away with them; how many rows are kept (all, or those of `where`), and not."""
        if len(names) == 1 and names[0].startswith(f"{folder}/"):
            alone = self._table(names[0], schema, ["run", "start"])
            if alone is not None and (where is None or alone.filter(where).num_rows == alone.num_rows):
                return alone.num_rows, 0  # merged already
        tables = {name: self._table(name, schema) for name in names}
        read = {name: table for name, table in tables.items() if table is not None}
        if not read:
            return 0, 0
        whole = _first_of_each(pa.concat_tables(read.values()), schema)
        kept = whole if where is None else whole.filter(where)
        target = ""
        if kept.num_rows:
            order = SORTED_BY if schema is RECORD_SCHEMA else [("run", "ascending")]
            target = self._put(folder, kept.sort_by(order))
        self.place.delete(name for name in read if name != target)
        return kept.num_rows, whole.num_rows - kept.num_rows


def _hold_different_runs(names: Sequence[str]) -> bool:
    """Whether files have no run in common: a merged one of each month at most, or one alone."""
    folders = {name.rsplit("/", 1)[0] for name in names}
    return (len(folders) == len(names) and NEW not in folders) or len(names) == 1


def _first_of_each(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """One row a run: of the newest version, else of the first path."""
    if pc.count_distinct(table.column("run")).as_py() == table.num_rows:
        return table
    order = [("run", "ascending")]
    order += [("schema_version", "descending")] if "schema_version" in schema.names else []
    order += [("path", "ascending")] if "path" in schema.names else []
    ordered = table.sort_by(order)
    run = ordered.column("run").combine_chunks()
    first = pa.concat_arrays([pa.array([True]), pc.not_equal(run[1:], run[:-1])])
    return ordered.filter(first)


def status_lines(status: StoreStatus) -> tuple[str, str]:
    """What there is, and how far it is."""
    drives_and_models = f"{counted(status.drives, 'drive')}, {counted(status.models, 'type')}"
    kilobytes = f"{status.record_bytes / 1e3:.0f} kB"
    return (
        f"{counted(status.runs, 'run')} of {drives_and_models}: {100.0 * status.share:.0f} % done",
        f"{status.recorded} have a record ({kilobytes}), {status.waiting} wait, {status.failed} failed",
    )


def status_object(store: FleetStore) -> dict[str, Any]:
    """How far a store is, for programs: counts, every drive with its time, every run that makes no record."""
    status = store.status()
    drives = [row | {end: str(row[end]) for end in ("first", "last")} for row in store.drives().to_pylist()]
    failures, unreached = ([one._asdict() for one in found] for found in (store.failures(), store.unreached()))
    counts = status._asdict() | {"waiting": status.waiting, "share": status.share}
    beside = {"by_drive": drives, "failures": failures, "unreached": unreached}
    return counts | {"text": status_lines(status)} | beside
