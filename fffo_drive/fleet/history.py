"""A drive's records in the order of time, as plain arrays."""

from __future__ import annotations

import functools
import itertools
import operator
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from ..arrays import Floats, Integers
from ..documents import DocumentError
from .backlash import GAP_REV, Gap, GapSums, gap_of
from .regress import PARAMETERS, Balance, Estimates, solve_each, unpacked
from .schema import ORDERS
from .store import FleetStore

US_PER_S = 1e6
FEW_DRIVES = 32
ROWS_AT_ONCE = 1_000  # solved at once: the intermediate arrays fit the processor's cache
IN_TIME = [("start", "ascending"), ("run", "ascending")]
BY_DRIVE = [("drive", "ascending"), *IN_TIME]
SCALARS = ("energy_nm2", "rows", "effective_rows")
HISTORY_COLUMNS = (
    "run", "start", "normal", "moment", "energy_nm2", "rows", "effective_rows", "rms_nm", "order_amplitude_nm",
    "speed_rms_rps", "temperature_degc", "gap_rev", "gap_log_sd",
)  # fmt: skip


class RunHistory(NamedTuple):
    """n runs of one drive, oldest first; p base parameters, k orders. Linear: revolutions stand for m, Nm for N."""

    time_s: Floats  # (n,) start, UTC, seconds since 1970
    theta: Floats  # (n, p) base parameters, finite; what a run does not determine is the smallest that fits
    information: Floats  # (n, p, p) inverse covariance of theta; 0 along what a run does not determine
    names: tuple[str, ...]  # (p,) `fleet.regress.PARAMETERS`, with their units
    rms_nm: Floats  # (n,) of the residual of the run's own regression
    order_amplitude_nm: npt.NDArray[Any]  # (n, k) of the residual, float32 or 64; nan where a run does not resolve it
    orders: Floats  # (k,) periods a motor turn
    speed_rms_rps: Floats  # (n,)
    temperature_degc: Floats  # (n,) mean; nan where not logged
    run: npt.NDArray[np.str_]  # (n,) content hash of each run, hex
    gap_rev: Floats  # (n,) backlash at the motor shaft; nan where the run shows none
    gap_log_sd: Floats  # (n,) standard deviation of its logarithm


BY_RUN = tuple(name for name in RunHistory._fields if name not in ("names", "orders"))


def history(store: FleetStore, drive: str, model: str | None = None) -> RunHistory:
    """A drive's records. Raises DocumentError where there is none of it, and where several models have its number."""
    return history_of(records_of_drive(store, drive, model, HISTORY_COLUMNS), drive)


def records_of_drive(
    store: FleetStore, drive: str, model: str | None, columns: Sequence[str] | None = None,
    where: pc.Expression | None = None,
) -> pa.Table:  # fmt: skip
    """Records of one drive: of this serial number, and of this model where it is given.

    Raises DocumentError where several models have a drive of that number and none is given.
    """
    own = pc.field("drive") == drive
    own = own if model is None else own & (pc.field("model") == model)
    wanted = None if columns is None else tuple(dict.fromkeys((*columns, "model")))
    found = store.records(wanted, own if where is None else own & where)
    models = sorted(set(found.column("model").to_pylist()))
    if len(models) > 1:
        raise DocumentError(f"drive {drive!r} is one of each of {', '.join(models)}: say which with --model")
    return found


def histories(store: FleetStore, model: str, drives: Sequence[str] | None = None) -> Histories:
    """Histories of drives (None: of all) of a model, by drive; one without records is left out."""
    where = pc.field("model") == model
    where = where if drives is None else where & _any_of(drives)
    return _by_drive(_sorted(store.records(("drive", *HISTORY_COLUMNS), where)))


def models_of(store: FleetStore) -> list[str]:
    """Models that have records."""
    return sorted(pc.unique(store.records(("model",)).column("model")).to_pylist())


class ModelRecords(NamedTuple):
    """Records of a model, read once and converted to histories in parts, which take several times the memory."""

    batches: Sequence[pa.RecordBatch]  # as they were read: a copy of all of them takes as long as the reading
    order: Integers  # (n,) their rows by drive and time
    bounds: Integers  # (d + 1,) of each drive, in this order

    def histories(self, drives: Integers) -> Histories:
        """Of the drives at these places."""
        rows = np.concatenate([self.order[self.bounds[k] : self.bounds[k + 1]] for k in drives])
        ends = np.cumsum([len(batch) for batch in self.batches])
        as_read = np.sort(rows)
        cuts = np.searchsorted(as_read, [0, *ends])
        parts = []
        for batch, end, (a, b) in zip(self.batches, ends, itertools.pairwise(cuts), strict=True):
            own = as_read[a:b] - (end - len(batch))
            if own.size:  # of neighbours, as a merged file has them, no copy
                parts.append(batch.slice(own[0], b - a) if own[-1] - own[0] < b - a else batch.take(own))
        table = pa.Table.from_batches(parts).combine_chunks()
        return _by_drive(table.take(np.searchsorted(as_read, rows)))


def model_records(store: FleetStore, model: str) -> ModelRecords:
    """All records of a model."""
    table = store.records(("drive", *HISTORY_COLUMNS), pc.field("model") == model)
    keys = table.select(["drive", "start", "run"])
    order = pc.sort_indices(keys, BY_DRIVE)
    return ModelRecords(table.to_batches(), order.to_numpy().astype(np.int64), edges_of(keys.take(order), "drive"))


def _sorted(table: pa.Table) -> pa.Table:
    return table.sort_by(BY_DRIVE).combine_chunks()


def edges_of(table: pa.Table, *columns: str) -> Integers:
    """Where rows begin that have other words in these columns than the row before, and where the last ones end."""
    changed = np.zeros(max(table.num_rows - 1, 0), dtype=bool)
    for column in (table.column(name).combine_chunks() for name in columns):
        changed |= pc.not_equal(column[1:], column[:-1]).to_numpy(zero_copy_only=False)
    return np.array([0, *(np.flatnonzero(changed) + 1), table.num_rows])


class Histories(Mapping[str, RunHistory]):
    """Histories of d drives, cut out of those of all of their runs."""

    def __init__(self, drives: Sequence[str], bounds: Integers, whole: RunHistory) -> None:
        """`bounds` (d + 1,): drive k has the runs bounds[k]:bounds[k + 1] of `whole`."""
        self.bounds, self.whole = bounds, whole
        self._place = {drive: k for k, drive in enumerate(drives)}

    def __getitem__(self, drive: str) -> RunHistory:
        """The runs of one."""
        k = self._place[drive]
        runs = slice(int(self.bounds[k]), int(self.bounds[k + 1]))
        by_run: dict[str, Any] = {name: getattr(self.whole, name)[runs] for name in BY_RUN}
        return self.whole._replace(**by_run)

    def __iter__(self) -> Iterator[str]:
        """Drives, in order."""
        return iter(self._place)

    def __len__(self) -> int:
        """How many drives."""
        return len(self._place)


def joined(histories: Mapping[str, RunHistory]) -> Histories:
    """Histories of at least one drive, one after the other. Raises ValueError where their columns differ."""
    if isinstance(histories, Histories):
        return histories
    parts = list(histories.values())
    first = next(iter(histories))
    for name, one in histories.items():
        if one.names != parts[0].names:
            raise ValueError(f"drive {name}: columns {', '.join(one.names)}, not those of drive {first}")
    bounds = np.concatenate([[0], np.cumsum([one.time_s.size for one in parts])]).astype(np.int64)
    by_run: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in parts]) for name in BY_RUN}
    return Histories(list(histories), bounds, parts[0]._replace(**by_run))


def _by_drive(table: pa.Table) -> Histories:
    """Histories of rows that are in order."""
    bounds = edges_of(table, "drive") if table.num_rows else np.zeros(1, dtype=np.int64)
    return Histories(table.column("drive").take(bounds[:-1]).to_pylist(), bounds, _history_of_rows(table))


def _any_of(drives: Sequence[str]) -> pc.Expression:
    """One of few drives as alternatives, by which a reader skips groups of rows; of many as a set."""
    if not 0 < len(drives) <= FEW_DRIVES:
        return pc.field("drive").isin(list(drives))
    return functools.reduce(operator.or_, (pc.field("drive") == drive for drive in drives))


def history_of(table: pa.Table, drive: str) -> RunHistory:
    """As `history`, of records (`schema.RECORD_SCHEMA`, at least HISTORY_COLUMNS) of one drive."""
    if not table.num_rows:
        raise DocumentError(f"no record of drive {drive!r}: `fffo-drive fleet status STORE` lists the drives")
    return _history_of_rows(table.sort_by(IN_TIME))


def _history_of_rows(table: pa.Table) -> RunHistory:
    """Rows in the order in which they are."""
    solved = estimates_of(table)
    return RunHistory(
        time_s=table.column("start").cast(pa.int64()).to_numpy() / US_PER_S,
        theta=solved.theta,
        information=solved.information,
        names=PARAMETERS,
        rms_nm=column_of(table, "rms_nm"),
        order_amplitude_nm=matrix_of(table, "order_amplitude_nm", np.float32),
        orders=ORDERS,
        speed_rms_rps=column_of(table, "speed_rms_rps"),
        temperature_degc=column_of(table, "temperature_degc"),
        run=np.array(table.column("run").to_pylist(), dtype=np.str_),
        gap_rev=column_of(table, "gap_rev"),
        gap_log_sd=column_of(table, "gap_log_sd"),
    )


def balance_of_rows(table: pa.Table) -> Balance:
    """All records of a table together."""
    return Balance(
        unpacked(matrix_of(table, "normal").sum(axis=0)), matrix_of(table, "moment").sum(axis=0),
        *(float(column_of(table, name).sum()) for name in SCALARS),
    )  # fmt: skip


def estimates_of(table: pa.Table) -> Estimates:
    """What each record gives by itself. (n, ...)"""
    normal, moment = matrix_of(table, "normal"), matrix_of(table, "moment")
    scalars = np.stack([column_of(table, name) for name in SCALARS])
    size = moment.shape[1]
    shapes = (size,), (size, size), (size,), ()
    found = Estimates(*(np.empty((table.num_rows, *shape)) for shape in shapes))
    for begin in range(0, table.num_rows, ROWS_AT_ONCE):
        rows = slice(begin, begin + ROWS_AT_ONCE)
        solved = solve_each(unpacked(normal[rows]), moment[rows], *scalars[:, rows])
        for whole, part in zip(found, solved, strict=True):
            whole[rows] = part
    return found


def gap_of_rows(table: pa.Table) -> Gap:
    """The backlash of all records of a table together."""
    normal = unpacked(np.nansum(matrix_of(table, "gap_normal"), axis=0), GAP_REV.size)
    moment = np.nansum(matrix_of(table, "gap_moment"), axis=0)
    scalars = (float(np.nansum(column_of(table, f"gap_{name}"))) for name in SCALARS)
    return gap_of(GapSums(normal, moment, *scalars), str(table.column("units")[0].as_py()))


def column_of(table: pa.Table, name: str) -> Floats:
    """A column of numbers; nan where there is none. (n,)"""
    return np.asarray(table.column(name).to_numpy(), dtype=np.float64)


def matrix_of(table: pa.Table, name: str, kind: npt.DTypeLike = np.float64) -> npt.NDArray[Any]:
    """A column of lists of one length; nan in a row without one, of an older version. (n, length)

    Not to be written to: where the column is of this kind and has no gaps, it is the column itself.
    """
    column = table.column(name).combine_chunks()
    size = column.type.list_size
    flat = np.asarray(column.drop_null().flatten().to_numpy(zero_copy_only=False), dtype=kind).reshape(-1, size)
    if not column.null_count:
        return flat
    values = np.full((len(column), size), np.nan, dtype=kind)
    values[column.is_valid().to_numpy(zero_copy_only=False)] = flat
    return values
