"""The population of each model: how much its drives differ in every number, and who stands outside."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import scipy  # its modules load where they are first used

from ..arrays import Floats, Integers
from ..jit import njit
from ..units import MAD_TO_SD
from .history import SCALARS, US_PER_S, column_of, edges_of, matrix_of
from .regress import PARAMETERS, UPPER, solve_each, unpacked
from .schema import HIGHEST_ORDER, unit_of

SPREAD_COLUMNS = (
    "model", "drive", "start", "units", "normal", "moment", *SCALARS, "order_amplitude_nm",
)  # fmt: skip
OUTSIDE_P = 0.01  # chance that any drive of a model is reported as an outlier in one number
LEAST_DRIVES = 5  # that make a population
LEAST_ORDER_RUNS = 0.5  # of a drive's runs have to resolve an order
RESIDUAL = "residual_rms_nm"
MAD_DOF = 0.5  # of the drives: with it 0.3 to 1.3 % of 5 to 400 normal drives have one outside by chance (20,000 draws)
SEPARATOR = "\x1f"


class Outsider(NamedTuple):
    """A drive that stands outside of its model's population in one number."""

    drive: str
    quantity: str
    value: float
    sd: float
    median: float
    distance: float  # from the median, over what drives and its own uncertainty scatter


class QuantitySpread(NamedTuple):
    """One number over the drives of a model."""

    name: str
    unit: str
    drives: int  # that determine it
    median: float
    spread: float  # standard deviation between drives, robust, their own uncertainty taken out
    low: float  # 5 % of the drives lie below ...
    high: float  # ... and above


class ModelSpread(NamedTuple):
    """The d drives of one model; q quantities: PARAMETERS and the residual."""

    model: str
    units: str
    drives: tuple[str, ...]
    runs: npt.NDArray[np.int64]  # (d,)
    first_s: Floats  # (d,) start of the first run, UTC
    last_s: Floats  # (d,)
    quantities: tuple[str, ...]  # (q,)
    values: Floats  # (d, q) by all runs of each drive together; nan where not determined
    sds: Floats  # (d, q)
    spreads: tuple[QuantitySpread, ...]  # of quantities that any drive determines
    outsiders: tuple[Outsider, ...]  # furthest first

    def as_plain(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "model": self.model, "units": self.units, "drives": len(self.drives), "runs": int(self.runs.sum()),
            "spreads": [one._asdict() for one in self.spreads],
            "outsiders": [one._asdict() for one in self.outsiders],
        }  # fmt: skip


class _Sums:
    """What adds up over the runs of each drive, drive by drive as they come."""

    def __init__(self) -> None:
        self.place: dict[str, int] = {}
        self.units: list[str] = []
        widths = {"normal": UPPER[0].size, "moment": len(PARAMETERS), "scalars": len(SCALARS), "runs": 1,
                  "power": HIGHEST_ORDER, "seen": HIGHEST_ORDER}  # fmt: skip
        self.sums = {name: np.zeros((0, width)) for name, width in widths.items()}
        self.first, self.last = np.zeros(0), np.zeros(0)

    def take(self, table: pa.Table) -> None:
        """Add the records of a table (SPREAD_COLUMNS)."""
        begins = edges_of(table, "model", "drive")[:-1]
        heads = table.select(["model", "drive", "units"]).take(begins)
        keys = pc.binary_join_element_wise(heads.column("model"), heads.column("drive"), SEPARATOR)
        at = np.array([self.place.setdefault(key, len(self.place)) for key in keys.to_pylist()], dtype=np.int64)
        known = len(self.units)
        new, firsts = np.unique(at, return_index=True)
        self.units += heads.column("units").take(firsts[new >= known]).to_pylist()
        if len(self.place) > known:
            self._grow(len(self.place) - known)
        scalars = np.stack([column_of(table, name) for name in SCALARS], axis=1)
        by_row = np.repeat(at, np.diff(begins, append=table.num_rows))
        _add_rows(
            by_row, matrix_of(table, "normal"), matrix_of(table, "moment"), scalars,
            matrix_of(table, "order_amplitude_nm", np.float32), *self.sums.values(),
        )  # fmt: skip
        start_s = table.column("start").cast(pa.int64()).to_numpy() / US_PER_S
        np.minimum.at(self.first, by_row, start_s)
        np.maximum.at(self.last, by_row, start_s)

    def _grow(self, more: int) -> None:
        self.sums = {name: np.pad(values, ((0, more), (0, 0))) for name, values in self.sums.items()}
        self.first = np.pad(self.first, (0, more), constant_values=np.inf)
        self.last = np.pad(self.last, (0, more), constant_values=-np.inf)


@njit
def _add_rows(
    at: Integers, normal: Floats, moment: Floats, scalars: Floats, amplitude: npt.NDArray[np.float32],
    sum_normal: Floats, sum_moment: Floats, sum_scalars: Floats, runs: Floats, power: Floats, seen: Floats,
) -> None:  # fmt: skip
    """Add rows (n, ...) to sums (d, ...), each to that at its place (n,)."""
    for n in range(at.size):
        d = at[n]
        runs[d, 0] += 1.0
        for k in range(normal.shape[1]):
            sum_normal[d, k] += normal[n, k]
        for k in range(moment.shape[1]):
            sum_moment[d, k] += moment[n, k]
        for k in range(scalars.shape[1]):
            sum_scalars[d, k] += scalars[n, k]
        for k in range(amplitude.shape[1]):
            value = np.float64(amplitude[n, k])
            if value - value == 0.0:  # finite: the order is resolved
                power[d, k] += value * value
                seen[d, k] += 1.0


def spreads_of(parts: Iterable[pa.Table]) -> list[ModelSpread]:
    """The population of each model, of records in parts (SPREAD_COLUMNS), by the model's name."""
    sums = _Sums()
    for part in parts:
        if part.num_rows:
            sums.take(part)
    by_model: dict[tuple[str, str], list[tuple[str, int]]] = {}
    for key, place in sums.place.items():
        model, drive = key.split(SEPARATOR, 1)
        by_model.setdefault((model, sums.units[place]), []).append((drive, place))
    return [_model(model, units, sorted(drives), sums) for (model, units), drives in sorted(by_model.items())]


def _model(model: str, units: str, drives: Sequence[tuple[str, int]], sums: _Sums) -> ModelSpread:
    at = np.array([place for _, place in drives], dtype=np.int64)
    names = tuple(drive for drive, _ in drives)
    own = {name: values[at] for name, values in sums.sums.items()}
    found = solve_each(unpacked(own["normal"]), own["moment"], *own["scalars"].T)
    runs = own["runs"][:, 0]
    rms_sd = found.rms_nm / np.sqrt(2.0 * np.maximum(own["scalars"][:, SCALARS.index("effective_rows")], 1.0))
    often = own["seen"] >= np.maximum(1.0, LEAST_ORDER_RUNS * runs[:, None])
    amplitude = np.where(often, np.sqrt(own["power"] / np.maximum(own["seen"], 1.0)), np.nan)
    shown = _standing_out(amplitude)
    quantities = (*PARAMETERS, RESIDUAL, *(order_name(order) for order in shown))
    waves = amplitude[:, [order - 1 for order in shown]]
    theta = np.where(np.isfinite(found.sd), found.theta, np.nan)
    values = np.column_stack([theta, found.rms_nm, waves])
    sds = np.column_stack([found.sd, rms_sd, np.zeros_like(waves)])
    spreads, outsiders = [], []
    for k, quantity in enumerate(quantities):
        known = np.flatnonzero(np.isfinite(values[:, k]))
        if known.size:
            spread = _spread(quantity, values[known, k], sds[known, k])
            spreads.append(spread)
            outsiders += [_outsider(names[known[i]], spread, values[known[i], k], sds[known[i], k], distance)
                          for i, distance in _outside(spread, values[known, k], sds[known, k])]  # fmt: skip
    outsiders.sort(key=lambda one: (-abs(one.distance), one.drive, one.quantity))
    return ModelSpread(
        model, units, names, runs.astype(np.int64), sums.first[at], sums.last[at], quantities, values, sds,
        tuple(spreads), tuple(outsiders),
    )  # fmt: skip


MOST_ORDERS = 4


def _standing_out(amplitude: Floats) -> list[int]:
    """The orders that are largest over all drives (d, orders), in order; those that few resolve are not meant."""
    enough = np.isfinite(amplitude).mean(axis=0) >= 0.5 if amplitude.size else np.zeros(HIGHEST_ORDER, dtype=bool)
    typical = np.zeros(amplitude.shape[1])
    typical[enough] = np.nanmedian(amplitude[:, enough], axis=0)
    ranked = [int(k) for k in np.argsort(-typical, kind="stable")[:MOST_ORDERS] if typical[k] > 0.0]
    return sorted(k + 1 for k in ranked)


def order_name(order: int) -> str:
    """What the amplitude of an order is called among quantities."""
    return f"wave_{order}_nm"


def _spread(name: str, values: Floats, sds: Floats) -> QuantitySpread:
    median = float(np.median(values))
    scatter = MAD_TO_SD * float(np.median(np.abs(values - median)))
    own = max(0.0, scatter**2 - float(np.median(sds)) ** 2)
    low, high = (float(np.quantile(values, share)) for share in (0.05, 0.95))
    return QuantitySpread(name, unit_of(name), values.size, median, float(np.sqrt(own)), low, high)


def _outside(spread: QuantitySpread, values: Floats, sds: Floats) -> Iterator[tuple[int, float]]:
    """Drives that are further out than chance takes any of so many, with their distance."""
    if spread.drives < LEAST_DRIVES:
        return
    scale = np.hypot(spread.spread, sds)
    distance = np.where(scale > 0.0, (values - spread.median) / np.where(scale > 0.0, scale, 1.0), 0.0)
    limit = -float(scipy.special.stdtrit(MAD_DOF * (spread.drives - 1), OUTSIDE_P / (2.0 * spread.drives)))
    for k in np.flatnonzero(np.abs(distance) > limit):
        yield int(k), float(distance[k])


def _outsider(drive: str, spread: QuantitySpread, value: float, sd: float, distance: float) -> Outsider:
    return Outsider(drive, spread.name, float(value), float(sd), spread.median, distance)
