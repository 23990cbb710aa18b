"""Two sets of runs compared: what differs, by how much, and whether beyond chance.

Each law of each run is estimated as in `channels`; the difference of the means is a generalised least squares with
the scatter between runs, with temperature and speed beside it. That scatter and the slopes are those of the fleet, so
that two single runs can be compared. Of so many laws one may differ by chance: p is corrected after Holm (Scand. J.
Statist. 6, 1979), and the intervals are as wide as that asks for (Bonferroni).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import stats

from ..documents import counted
from .channels import COLUMNS, WITHOUT_TEMPERATURE, Channels, Stack, channels_of, learned, stacked
from .detector import CLIP, ChannelPrior
from .history import RunHistory

Floats = npt.NDArray[np.float64]

CONFIDENCE = 0.95
LARGEST_P = 0.05  # after the correction
BOTH = "both sets"


class LawDifference(NamedTuple):
    """One law of the second set against the first."""

    law: str
    change: float  # share of `scale`; of a ripple and the residual: of its size in the first set
    interval: tuple[float, float]  # all intervals hold together with 95 %
    scale: str
    size: float | None  # in the unit of `column`
    column: str | None
    p: float  # corrected for the number of laws
    differs: bool
    text: str


class Difference(NamedTuple):
    """What differs between two sets of runs."""

    laws: tuple[LawDifference, ...]  # those that differ first
    runs: tuple[int, int]
    temperature_degc: tuple[float, float]  # means; nan where not logged
    remarks: tuple[str, ...]

    def as_plain(self) -> dict[str, Any]:
        """JSON-ready: nan is None."""
        degc = [None if math.isnan(value) else value for value in self.temperature_degc]
        return {**self._asdict(), "laws": [law._asdict() for law in self.laws], "temperature_degc": degc}


def difference(first: RunHistory, second: RunHistory, fleet: Mapping[str, RunHistory] | None = None) -> Difference:
    """Compare two sets of runs of one drive, or of two drives of one model.

    `fleet`: what scatter and slopes are learned from; None: from these runs themselves. Raises ValueError for a set
    without runs, and for records with other columns.
    """
    counts = (int(first.time_s.size), int(second.time_s.size))
    if not min(counts):
        raise ValueError(f"the {'first' if not counts[0] else 'second'} set has no runs")
    if first.names != second.names:
        raise ValueError(f"columns {', '.join(second.names)} of the second set are not those of the first")
    degc = (_mean(first.temperature_degc), _mean(second.temperature_degc))
    joined = _joined(first, second)
    known = stacked(fleet if fleet is not None else {"first": first, "second": second})
    prior, own = learned(known)
    stack = stacked({BOTH: joined}, known.orders)
    group = np.concatenate([np.zeros(counts[0]), np.ones(counts[1])])
    channels = channels_of(stack, prior)
    found = [_compared(stack, channels, own, c, group) for c in range(len(channels.laws))]
    kept = [(c, one) for c, one in enumerate(found) if one is not None]
    corrected = _holm([one[2] for _, one in kept])
    share = 1.0 - (1.0 - CONFIDENCE) / max(len(kept), 1)
    laws = [_law(stack, channels, c, one, p, share) for (c, one), p in zip(kept, corrected, strict=True)]
    laws.sort(key=lambda law: (not law.differs, law.p))
    remarks = []
    unlogged = not stack.logged[0]
    if unlogged:
        remarks.append(
            f"no temperature is logged: {', '.join(WITHOUT_TEMPERATURE)} is the thermometer and not compared. A change "
            "that moves it together with Coulomb friction cannot be distinguished from temperature"
        )
    return Difference(tuple(laws), counts, degc, tuple(remarks))


def _joined(first: RunHistory, second: RunHistory) -> RunHistory:
    return RunHistory(
        np.concatenate([first.time_s, second.time_s]), np.concatenate([first.theta, second.theta]),
        np.concatenate([first.information, second.information]), first.names,
        np.concatenate([first.rms_nm, second.rms_nm]),
        np.concatenate([first.order_amplitude_nm, second.order_amplitude_nm]), first.orders,
        np.concatenate([first.speed_rms_rps, second.speed_rms_rps]),
        np.concatenate([first.temperature_degc, second.temperature_degc]), np.concatenate([first.run, second.run]),
    )  # fmt: skip


def _compared(
    stack: Stack, channels: Channels, prior: ChannelPrior, c: int, group: Floats
) -> tuple[float, float, float, float] | None:
    """Difference of one channel, its standard deviation, p and degrees of freedom; None where a set has no value."""
    y = channels.y[:, c]
    known = np.flatnonzero(np.isfinite(y))
    if np.ptp(group[known]) == 0.0 if known.size else True:
        return None
    white = 1.0 / np.sqrt(channels.variance[known, c] * prior.variance[c])
    design = np.column_stack([np.ones(known.size), channels.covariates[known], group[known]]) * white[:, None]
    slope_sd = np.sqrt(np.diag(prior.covariance[c])[1:] * prior.variance[c])
    ridge = np.diag([0.0, *(slope_sd**-2.0), 0.0])
    target = y[known] * white
    weight = np.ones(known.size)
    for _ in range(4):
        own = design * weight[:, None]
        normal = own.T @ design + ridge
        solution = np.linalg.solve(normal, own.T @ target + ridge @ np.concatenate([prior.mean[c], [0.0]]))
        residual = target - design @ solution
        weight = np.minimum(1.0, CLIP / np.maximum(np.abs(residual), 1e-300))
    # the fleet's scatter and this drive's own, each by its degrees of freedom
    left = float(np.sum(np.clip(residual, -CLIP, CLIP) ** 2))
    dof = 2.0 * prior.shape[c] + max(known.size - 2.0, 0.0)
    spread = math.sqrt((2.0 * prior.shape[c] + left) / dof)
    alike = math.sqrt((1.0 + prior.memory[c]) / (1.0 - prior.memory[c])) if known.size > 2 else 1.0
    sd = math.sqrt(float(np.linalg.inv(normal)[3, 3])) * spread * alike
    return float(solution[3]), sd, float(2.0 * stats.t.sf(abs(solution[3]) / sd, dof)), dof


def _holm(values: list[float]) -> list[float]:
    """p of each after Holm's correction."""
    order = np.argsort(values)
    corrected, largest = [1.0] * len(values), 0.0
    for place, k in enumerate(order):
        largest = max(largest, min(1.0, (len(values) - place) * values[k]))
        corrected[int(k)] = largest
    return corrected


def _law(
    stack: Stack, channels: Channels, c: int, found: tuple[float, float, float, float], p: float, confidence: float
) -> LawDifference:
    change, sd, _, dof = found
    reach = float(stats.t.ppf(0.5 + 0.5 * confidence, dof)) * sd
    ends = (change - reach, change + reach)
    column = stack.columns[c] if c < len(stack.columns) else None
    size, scale = None, "its size in the first set"
    if column is None:
        change, ends = math.expm1(change), (math.expm1(ends[0]), math.expm1(ends[1]))
    else:
        size, scale = change * float(stack.scales[0, c]), COLUMNS[COLUMNS[column][1]][0]
    law = channels.laws[c]
    of = "" if column is None or scale == law else f" of {scale}"
    span = f"{100.0 * ends[0]:+.1f} to {100.0 * ends[1]:+.1f} %"
    differs = p <= LARGEST_P
    if differs:
        text = f"{law}: {100.0 * change:+.1f} %{of} ({span}), beyond chance (p = {p:.2g})"
    else:
        low, high = 100.0 * ends[0], 100.0 * ends[1]
        text = f"{law}: no difference beyond chance; it lies between {low:+.1f} and {high:+.1f} %{of}"
    return LawDifference(law, change, ends, scale, size, column, p, differs, text)


def _mean(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


def difference_lines(found: Difference) -> list[str]:
    """What the command prints."""
    degc = " and ".join("not logged" if math.isnan(value) else f"{value:.0f} degC" for value in found.temperature_degc)
    lines = [f"{counted(found.runs[0], 'run')} against {found.runs[1]}; temperature {degc}"]
    if not any(law.differs for law in found.laws):
        lines.append("nothing differs beyond chance")
    return [*lines, *(law.text for law in found.laws), *found.remarks]
