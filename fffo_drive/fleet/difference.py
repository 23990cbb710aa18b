"""Two sets of runs compared: what differs, by how much, and whether beyond chance.

The columns of the regression are compared all at once. With P_t the inverse covariance of run t (its information and
the scatter between runs, as in `channels`), the difference d of the two generalised least-squares means has the
covariance C = (sum P_t)^-1 of the first set + that of the second + that of the temperature slope. d' C^-1 d tests all
columns together. Then laws are chosen forwards: a change along e explains (e' C^-1 d)^2 / e' C^-1 e of it, the law that
explains most is taken first, and the next one only if it explains what is left beyond chance. The change
attributed to a law is thus what the other changed laws leave, not what their change looks like in its column. Laws
whose likelihood is nearly that of the chosen one are named with it. Amplitudes and the gap are compared one by one
(`_compared`).

The scatter and the slopes are those of the fleet, so that two single runs can be compared. Of so many laws one may
differ by chance: p is corrected after Holm (Scand. J. Statist. 6, 1979), and the intervals are as wide as that asks for
(Bonferroni).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats
from ..documents import counted
from ..least_squares import spectrum
from .change import fit_change
from .channels import (
    COLUMNS,
    WITHOUT_TEMPERATURE,
    Channels,
    FleetPrior,
    Stack,
    channels_of,
    stacked,
)
from .detector import ChannelPrior
from .history import RunHistory, joined
from .learning import learned
from .matrices import inverse_total

CONFIDENCE = 0.95
LARGEST_P = 0.05  # after the correction
BOTH = "both sets"
SAME_FIT = 3.84  # fall of the squared misfit, in variances, by which another law is told apart: 95 % of chi-squared
LEAST_INFORMATION = 1e-6  # of a column over its scale: it then says nothing, and the matrix has an inverse
LARGEST_SD = 10.0  # of a change, over the scale: beyond it nothing is known of a law


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
    others: tuple[str, ...]  # laws that explain the same difference nearly as well
    text: str


class Difference(NamedTuple):
    """What differs between two sets of runs."""

    laws: tuple[LawDifference, ...]  # those that differ first
    joint_p: float  # of all columns of the regression together; nan where a set determines none
    runs: tuple[int, int]
    temperature_degc: tuple[float, float]  # means; nan where not logged
    remarks: tuple[str, ...]

    def as_plain(self) -> dict[str, Any]:
        """JSON-ready: nan is None."""
        degc = [None if math.isnan(value) else value for value in self.temperature_degc]
        joint_p = None if math.isnan(self.joint_p) else self.joint_p
        laws = [law._asdict() for law in self.laws]
        return {**self._asdict(), "laws": laws, "joint_p": joint_p, "temperature_degc": degc}


class _Change(NamedTuple):
    """A change of one law."""

    change: float
    sd: float
    p: float  # not corrected
    dof: float  # of Student's t
    others: tuple[str, ...] = ()


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
    sets = joined({"first": first, "second": second})
    known = stacked(fleet if fleet is not None else sets)
    prior, own = learned(known)
    stack = stacked({BOTH: sets.whole}, known.orders)
    group = np.concatenate([np.zeros(counts[0]), np.ones(counts[1])])
    channels = channels_of(stack, prior)
    columns, joint_p = _columns_compared(stack, prior, own, group)
    found = columns + [_compared(channels, own, c, group) for c in range(len(columns), len(channels.laws))]
    kept = [(c, one) for c, one in enumerate(found) if one is not None]
    corrected = _holm([one.p for _, one in kept])
    share = 1.0 - (1.0 - CONFIDENCE) / max(len(kept), 1)
    laws = [_law(stack, channels, c, one, p, share) for (c, one), p in zip(kept, corrected, strict=True)]
    laws.sort(key=lambda law: (not law.differs, law.p))
    remarks = []
    if stack.seen[0] != 1.0:
        why = "no temperature is logged" if np.isnan(stack.seen[0]) else "the logged temperature does not show it all"
        remarks.append(
            f"{why}: {', '.join(WITHOUT_TEMPERATURE)} stands in for it and is not compared. A "
            "change that moves it together with Coulomb friction cannot be distinguished from temperature"
        )
    return Difference(tuple(laws), joint_p, counts, degc, tuple(remarks))


class _MeanDifference(NamedTuple):
    """Difference of the columns' means of two sets, over the scales."""

    change: Floats  # (p,)
    precision: Floats  # (p, p)
    dof: float  # of the scatter that it rests on


def _columns_compared(
    stack: Stack, fleet: FleetPrior, prior: ChannelPrior, group: Floats
) -> tuple[list[_Change | None], float]:
    """Change of each column's law, None where a set says nothing of it, and p of all columns together."""
    laws = [COLUMNS[name][0] for name in stack.columns]
    found = _mean_difference(stack, fleet, prior, group)
    along = fleet.directions @ found.precision
    size, moment = np.einsum("ij,ij->i", along, fleet.directions), along @ found.change
    asked = [k for k, law in enumerate(laws) if stack.seen[0] == 1.0 or law not in WITHOUT_TEMPERATURE]
    asked = [k for k in asked if size[k] > LARGEST_SD**-2.0]
    if not asked:
        return [None] * len(laws), math.nan
    joint = float(found.change @ found.precision @ found.change)
    known = int(np.sum(np.linalg.eigvalsh(found.precision) > LARGEST_SD**-2.0))
    joint_p = float(scipy.stats.f.sf(joint / known, known, found.dof))
    product = along @ fleet.directions.T
    chosen: list[int] = []
    changes: dict[int, _Change] = {}
    while left := [k for k in asked if k not in chosen]:
        beside = {k: _beside(product, moment, [*chosen, k], found.dof) for k in left}
        best = min(left, key=lambda k: (beside[k].p, -abs(beside[k].change / beside[k].sd)))
        power = {k: (one.change / one.sd) ** 2 for k, one in beside.items()}
        changes.update(beside)
        if beside[best].p * len(left) > LARGEST_P:
            break
        others = {laws[k] for k in left if k != best and power[k] > power[best] - SAME_FIT} - {laws[best]}
        changes[best] = beside[best]._replace(others=tuple(sorted(others)))
        chosen.append(best)
    for number, k in enumerate(chosen):  # beside all that were chosen
        again = _beside(product, moment, [*chosen[:number], *chosen[number + 1 :], k], found.dof)
        changes[k] = again._replace(p=changes[k].p, others=changes[k].others)
    return [changes.get(k) for k in range(len(laws))], joint_p


def _beside(product: Floats, moment: Floats, chosen: Sequence[int], dof: float) -> _Change:
    """Change of the last of these laws, beside changes of the others."""
    part = np.ix_(chosen, chosen)
    found = spectrum(product[part])
    change = float(found.solution(moment[list(chosen)])[-1])
    sd = float(np.linalg.norm(found.basis()[-1]))
    return _Change(change, sd, float(2.0 * scipy.stats.t.sf(abs(change) / sd, dof)), dof)


def _mean_difference(stack: Stack, fleet: FleetPrior, prior: ChannelPrior, group: Floats) -> _MeanDifference:
    """Generalised least squares of each set; a run far from its set's mean counts for less."""
    logged = bool(stack.logged[0])
    size = len(stack.columns)
    inverse = inverse_total(stack.information, fleet.between(stack.seen[0]))
    known = np.isfinite(stack.temperature) & (np.einsum("nii->n", inverse) > 0.0)
    steps = np.where(known, stack.temperature, 0.0)
    theta = stack.theta - steps[:, None] * fleet.slope * logged
    weight = known.astype(np.float64)
    ridge = LEAST_INFORMATION * np.eye(size)
    for _ in range(4):
        weighted = inverse * weight[:, None, None]
        totals = [weighted[group == k].sum(axis=0) + ridge for k in (0, 1)]
        moments = [np.einsum("nij,nj->i", weighted[group == k], theta[group == k]) for k in (0, 1)]
        means = np.array([np.linalg.solve(total, right) for total, right in zip(totals, moments, strict=True)])
        away = theta - means[group.astype(np.int64)]
        distance = np.einsum("ni,nij,nj->n", away, inverse, away)
        weight = np.where(known, np.minimum(1.0, 2.0 * size / np.maximum(distance, 1e-9)), 0.0)
    # the fleet's scatter and these runs' own, each by its degrees of freedom; neighbours that are alike say less
    runs, shape = float(known.sum()), float(np.median(prior.shape[:size]))
    dof = 2.0 * shape + max(runs - 2.0, 0.0)
    spread = (2.0 * shape + float(weight @ distance) / size) / dof
    memory = float(prior.memory[:size].max())
    alike = (1.0 + memory) / (1.0 - memory) if runs > 2.0 else 1.0
    warmer = [float(np.average(steps[group == k], weights=np.maximum(weight[group == k], 1e-9))) for k in (0, 1)]
    covariance = spread * alike * sum((np.linalg.inv(total) for total in totals), np.zeros((size, size)))
    covariance += (warmer[1] - warmer[0]) ** 2 * np.diag(fleet.slope_sd**2) * logged
    return _MeanDifference(means[1] - means[0], np.asarray(np.linalg.inv(covariance), dtype=np.float64), dof)


def _compared(channels: Channels, prior: ChannelPrior, c: int, group: Floats) -> _Change | None:
    """Difference of one channel; None where a set has no value."""
    known = np.flatnonzero(np.isfinite(channels.y[:, c]))
    if np.ptp(group[known]) == 0.0 if known.size else True:
        return None
    found = fit_change(channels, prior, c, known, group[known])
    # the fleet's scatter and this drive's own, each by its degrees of freedom
    dof = 2.0 * prior.shape[c] + max(known.size - 2.0, 0.0)
    spread = math.sqrt((2.0 * prior.shape[c] + found.misfit) / dof)
    alike = math.sqrt((1.0 + prior.memory[c]) / (1.0 - prior.memory[c])) if known.size > 2 else 1.0
    sd = found.sd * spread * alike
    return _Change(found.size, sd, float(2.0 * scipy.stats.t.sf(abs(found.size) / sd, dof)), dof)


def _holm(values: list[float]) -> list[float]:
    """p of each after Holm's correction."""
    order = np.argsort(values)
    corrected, largest = [1.0] * len(values), 0.0
    for place, k in enumerate(order):
        largest = max(largest, min(1.0, (len(values) - place) * values[k]))
        corrected[int(k)] = largest
    return corrected


def _law(
    stack: Stack, channels: Channels, c: int, found: _Change, p: float, confidence: float
) -> LawDifference:  # fmt: skip
    change, sd, _, dof, others = found
    reach = float(scipy.stats.t.ppf(0.5 + 0.5 * confidence, dof)) * sd
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
        text += f"; these runs cannot distinguish it from {' or '.join(others)}" if others else ""
    else:
        low, high = 100.0 * ends[0], 100.0 * ends[1]
        text = f"{law}: no difference beyond chance; it lies between {low:+.1f} and {high:+.1f} %{of}"
    return LawDifference(law, change, ends, scale, size, column, p, differs, others, text)


def _mean(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


def difference_lines(found: Difference) -> list[str]:
    """What the command prints."""
    degc = " and ".join("not logged" if math.isnan(value) else f"{value:.0f} degC" for value in found.temperature_degc)
    lines = [f"{counted(found.runs[0], 'run')} against {found.runs[1]}; temperature {degc}"]
    if not any(law.differs for law in found.laws):
        lines.append("nothing differs beyond chance")
    if not math.isnan(found.joint_p):
        lines.append(f"inertia, friction and constant torques all together: p = {found.joint_p:.2g}")
    return [*lines, *(law.text for law in found.laws), *found.remarks]
