"""The first rungs of the ladder: effects common to many machines, tested first, by linear least squares.

A constant torque, friction that differs by direction, gravity, and waves at the orders of the machine, in this order,
on the rows of `rows`. Forward selection on each rung, then the next rung. An accepted candidate has a gain on held-out
rows (`criterion`), is significant over all candidates tried, and removes more than `LEAST_SHARE` of the squared
residual; at the end, each must still do so given all others (backward elimination).

A wave's column is g(N w) [cos, sin](2 pi N angle) with the gain g of the rows' own filter: no order aliases. It is
judged by strokes in which the wave comes back: in a shorter one a contact that yields looks like a wave of the stroke's
own order. A wave of the measured angle, e, is one of -(J e'' + D e') in the balance of what was measured, and stands
beside the waves of the torque: they differ in how they grow with the speed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats
from ..least_squares import least_squares, sums_by
from ..model.effects.registry import law_of
from .criterion import SDS, Folds, Gain, clipped, folds_of, gain, hotelling_p, levels, unseen_loss
from .dataset import CUTOFF_PERIODS, Record
from .facts import DriveFacts
from .kinematics import DEFAULT_CUTOFF_HZ, FILTER_ORDER, stroke_lengths_rev
from .layout import EffectStart
from .regression import HELD_RPS2, LEAST_TOLD, TorqueStart
from .rows import (
    CONSTANT,
    RegressionRows,
    RegressionStretch,
    rigid_columns,
    rows_at,
    scanned_delay,
    stretches_of,
    told_by_acceleration,
    turns_one_way,
)

CONSTANT_TORQUE, DIRECTION_RUNG, GRAVITY, WAVES = range(4)  # the rungs
LARGEST_P = 0.01  # over all that was tried
LEAST_SHARE = 0.02  # smallest share of the squared residual that an effect has to explain
MOST_EFFECTS = 6
SPEED_CLASSES = 6  # each with its own noise level
HIGHEST_ORDER = 200  # that is searched, periods a turn
STANDING_OUT = 6  # orders of a scan that are tried in addition to the declared ones
SLOW_QUANTILE = 0.1  # of speed: an order is seen where the axis turns this slowly ...
SEEN_HZ = 1.5  # ... if it is below the cut-off there; the cut-off is so many times what the declared orders ask
HIGHEST_CUTOFF_HZ = 150.0
HIGHEST_CUTOFF_PERIODS = 0.15
GRAVITY_PERIODS = 0.25  # a quarter turn of a pendulum bends enough; less is a constant and a slope
WAVE_PERIODS = 2.0  # a wave has to come back, within a stroke
SENSOR_ERROR = law_of("resolver_error")
SENSOR_ORDERS = (1.0, 2.0)  # its waves, in the order of its strengths
MOVED_SAMPLES = 2.0  # by which the delay is another: the step of its scan
SAME_COLUMNS = 1e-4  # of a column's squared norm that must remain after projecting out the known columns


class EffectCandidate(NamedTuple):
    """A candidate: an effect at one shape."""

    rung: int
    name: str  # of the law
    strengths: tuple[str, ...]
    shape: Mapping[str, float]
    order: float  # per motor turn; 0: no wave
    per_run: bool  # a phase for each run
    family: tuple[str, ...] = ()  # laws that the rows do not distinguish from it


class AcceptedEffect(NamedTuple):
    """An accepted candidate, with its evidence given all others."""

    candidate: EffectCandidate
    coefficients: Floats  # strengths; one set per run if its phase is per run
    gain: Gain
    p: float  # p-value, over all candidates tried
    share: float  # share of the squared residual left by the others

    def start(self, runs: int) -> EffectStart:
        """Start of a refit."""
        names = self.candidate.strengths
        shape = dict(self.candidate.shape)
        if not self.candidate.per_run:
            return EffectStart(self.candidate.name, shape | dict(zip(names, self.coefficients.tolist(), strict=True)))
        by_run = self.coefficients.reshape(runs, len(names))
        return EffectStart(self.candidate.name, shape, {name: by_run[:, k].tolist() for k, name in enumerate(names)})


class Ladder(NamedTuple):
    """Accepted candidates, and the start of the fit with them."""

    accepted: tuple[AcceptedEffect, ...]
    start: TorqueStart
    tried: int
    cutoff_hz: float


class _Bench(NamedTuple):
    """The rows, and the columns of every model."""

    rows: RegressionRows
    folds: Folds
    base: Floats  # (m, p) columns of the axis itself
    classes: npt.NDArray[np.int64]
    level_nm: Floats  # of friction at these speeds, by the start
    start: TorqueStart
    runs: int
    stroke_rev: Floats  # (m,) travel from one reversal to the next, of the stroke that a row is in
    stretches: Sequence[RegressionStretch]


class _Weighted(NamedTuple):
    """Target and known columns, whitened, and the residual of the target. (m,), (m, q), (m,)"""

    weight: Floats
    target: Floats
    known: Floats
    residual: Floats


def climb(
    records: Sequence[Record],
    start: TorqueStart,
    facts: DriveFacts | None = None,
    without: frozenset[str] = frozenset(),
) -> Ladder:
    """Climb the rungs on records of one rate, starting from the axis of the regression; `without`: laws left out.

    Waves look like a noisy sensor: where the cut-off is lowered for one, they are searched at the usual one as well.
    """
    if start.is_noisy:
        seen = _climbed(records, start._replace(cutoff_hz=DEFAULT_CUTOFF_HZ, is_noisy=False), facts, without)
        if any(one.candidate.rung == WAVES for one in seen.accepted):
            return seen
    return _climbed(records, start, facts, without)


def _climbed(
    records: Sequence[Record], start: TorqueStart, facts: DriveFacts | None, without: frozenset[str], again: bool = True
) -> Ladder:
    """As `climb`, at one cut-off; `again`: a second time, where the delay is another beside what was found."""
    linear = facts is not None and facts.units == "linear"
    bench, cutoff_hz = _bench(records, start, [] if linear else _declared_orders(facts))
    same_zero = len(records) == 1 or (facts is not None and facts.absolute_angle)
    chosen: list[EffectCandidate] = []
    tried = 0
    for rung in range(CONSTANT_TORQUE, CONSTANT_TORQUE + 2 if linear else WAVES + 1):
        while len(chosen) < MOST_EFFECTS:
            candidates, looked_at = _on_rung(bench, rung, chosen, facts, same_zero)
            candidates = [one for one in candidates if one.name not in without]
            tried += looked_at
            best = _best(bench, chosen, candidates, max(looked_at, 1))
            if best is None:
                break
            chosen.append(best)
    while chosen:
        found = [_given_others(bench, chosen, k, max(tried, 1)) for k in range(len(chosen))]
        weak = [k for k, one in enumerate(found) if not stands(one)]
        if not weak:
            delay_s = _delay_beside(bench, chosen)
            if again and delay_s is not None and abs(delay_s - start.delay_s) > MOVED_SAMPLES * records[0].period_s:
                return _climbed(records, start._replace(delay_s=delay_s), facts, without, again=False)
            return Ladder(tuple(found), _improved(bench, chosen, start), tried, cutoff_hz)
        # of two equivalent candidates neither is needed given the other: the higher rung is removed first
        del chosen[max(weak, key=lambda k: (chosen[k].rung, -found[k].gain.value))]
    return Ladder((), start, tried, cutoff_hz)


def _delay_beside(bench: _Bench, chosen: Sequence[EffectCandidate]) -> float | None:
    """The delay beside the chosen candidates: waves that pass quickly look like an acceleration at another delay."""
    if all(one.rung != WAVES for one in chosen):
        return None
    known = np.column_stack([bench.base, *(_columns(bench, one) for one in chosen)])
    return scanned_delay(bench.stretches, bench.rows.cutoff_hz, lambda rows: known)[0]


def _declared_orders(facts: DriveFacts | None) -> list[float]:
    """Periods a motor turn of poles, slots, and of the cogging that the two make."""
    if facts is None:
        return []
    orders: list[float] = [facts.pole_pairs] if facts.pole_pairs else []
    if facts.slots:
        orders += [facts.slots, 2.0 * facts.slots]
        if facts.pole_pairs:
            orders.append(float(np.lcm(facts.slots, 2 * facts.pole_pairs)))
    return sorted({float(order) for order in orders})


def _bench(records: Sequence[Record], start: TorqueStart, orders: Sequence[float]) -> tuple[_Bench, float]:
    period_s = records[0].period_s
    cutoff_hz = min(DEFAULT_CUTOFF_HZ, CUTOFF_PERIODS / period_s)
    highest_hz = min(HIGHEST_CUTOFF_HZ, HIGHEST_CUTOFF_PERIODS / period_s)
    if start.is_noisy:
        cutoff_hz = highest_hz = start.cutoff_hz
    stretches, _ = stretches_of(records, cutoff_hz)
    slow_rps = _slow_rps(rows_at(stretches, cutoff_hz, start.delay_s))
    asked_hz = min(highest_hz, SEEN_HZ * max(orders, default=0.0) * slow_rps)
    if asked_hz > cutoff_hz:
        cutoff_hz = asked_hz
        stretches, _ = stretches_of(records, cutoff_hz)
    rows = rows_at(stretches, cutoff_hz, start.delay_s)
    speed = np.abs(rows.velocity_rps)
    fall = np.exp(-((speed / start.stribeck_velocity_rps) ** start.stribeck_exponent))
    columns = rigid_columns(rows)
    base = np.column_stack([columns[:, :CONSTANT], fall * rows.direction])
    edges = np.quantile(speed[rows.sliding], np.linspace(0.0, 1.0, SPEED_CLASSES + 1)[1:-1])
    level_nm = start.coulomb_nm + (start.static_nm - start.coulomb_nm) * fall
    folds = folds_of(rows.bounds, rows.period_s)
    strokes_rev = np.concatenate([stroke_lengths_rev(s.motion)[s.rows] for s in stretches])
    return _Bench(
        rows, folds, base, np.searchsorted(edges, speed), level_nm, start, len(records), strokes_rev, stretches
    ), cutoff_hz


def _slow_rps(rows: RegressionRows) -> float:
    return float(np.quantile(np.abs(rows.velocity_rps[rows.sliding]), SLOW_QUANTILE))


def _on_rung(
    bench: _Bench, rung: int, chosen: Sequence[EffectCandidate], facts: DriveFacts | None, same_zero: bool
) -> tuple[list[EffectCandidate], int]:
    """Remaining candidates of a rung, and the number of candidates searched."""
    if rung == CONSTANT_TORQUE:
        found = [EffectCandidate(rung, "torque_offset", ("torque_nm",), {}, 0.0, False)]
    elif rung == DIRECTION_RUNG:
        found = [
            EffectCandidate(rung, "asymmetric_coulomb", ("share",), {}, 0.0, False),
            EffectCandidate(rung, "asymmetric_viscous", ("excess_nm_per_rps",), {}, 0.0, False),
        ]
    elif rung == GRAVITY:
        ratio = (facts.gear_ratio if facts is not None else None) or 1.0
        found = [
            EffectCandidate(rung, "unbalance", ("cos_nm", "sin_nm"), {"ratio": ratio}, 1.0 / ratio, per_run)
            for per_run in ((False,) if same_zero else (False, True))
        ]
    else:
        orders, looked_at = _orders(bench, chosen, facts)
        phases = (False,) if same_zero else (False, True)
        taken = {one.order for one in chosen if one.name != SENSOR_ERROR.name}
        found = [
            EffectCandidate(rung, "cogging", ("cos_nm", "sin_nm"), {"order": order}, order, per_run)
            for order in orders
            if order not in taken
            for per_run in phases
        ]
        if bench.start.has_inertia and not any(one.name == SENSOR_ERROR.name for one in chosen):
            names = tuple(p.name for p in SENSOR_ERROR.strengths)
            found += [EffectCandidate(rung, SENSOR_ERROR.name, names, {}, SENSOR_ORDERS[0], p) for p in phases]
            looked_at += 1
        return [one for one in found if _comes_back(bench, one.order).any()], looked_at * len(phases)
    taken_names = {(candidate.name, candidate.order) for candidate in chosen}
    if turns_one_way(bench.rows.direction[bench.rows.sliding]) and rung in (CONSTANT_TORQUE, DIRECTION_RUNG):
        return [], 0  # they are Coulomb friction there
    found = [
        one for one in found if (one.name, one.order) not in taken_names and _passed(bench, one.order, GRAVITY_PERIODS)
    ]
    return found, len(found)


def _passed(bench: _Bench, order: float, periods: float) -> bool:
    """Whether the motion covers at least this many periods."""
    return order == 0.0 or order * float(np.ptp(bench.rows.position_rev[bench.rows.sliding])) >= periods


def _comes_back(bench: _Bench, order: float) -> npt.NDArray[np.bool_]:
    """Rows that slide in a stroke of enough periods of a wave. (m,)"""
    return np.asarray(bench.rows.sliding & (order * bench.stroke_rev >= WAVE_PERIODS))


def _orders(bench: _Bench, chosen: Sequence[EffectCandidate], facts: DriveFacts | None) -> tuple[list[float], int]:
    """Declared orders and peaks of a scan of integer orders; and the number of orders searched."""
    slow_rps = max(_slow_rps(bench.rows), 1e-9)
    highest = min(HIGHEST_ORDER, int(bench.rows.cutoff_hz / slow_rps))
    declared = [order for order in _declared_orders(facts) if order <= highest]
    ranked = np.argsort(_scanned(bench, _weighted(bench, chosen), highest), kind="stable")[::-1] + 1
    standing = [float(order) for order in ranked[:STANDING_OUT] if float(order) not in declared]
    return [*declared, *standing], highest


def _scanned(bench: _Bench, white: _Weighted, highest: int) -> Floats:
    """Loss explained by a wave of each integer order up to `highest`, with a phase per run. (highest,)

    The residual is orthogonal to the known columns, so they need not be projected out of the waves.
    """
    return np.asarray(waves_in(bench.rows, clipped(white.residual), white.weight, highest).explained.sum(axis=0))


class Waves(NamedTuple):
    """Waves of whole orders 1 to n in values at rows, with a phase for each of r runs."""

    amplitude: npt.NDArray[np.complex128]  # (r, n) of the values over the weight; its phase is that of the angle
    explained: Floats  # (r, n) of the values' squares


class WaveSums(NamedTuple):
    """Sums over rows from which waves follow: those of two sets of rows of the same runs are added field by field."""

    product: npt.NDArray[np.complex128]  # (r, n) of wave and values
    power: Floats  # (r, n) of the wave
    square: npt.NDArray[np.complex128]  # (r, n) of the wave with itself


def waves_in(rows: RegressionRows, values: Floats, weight: Floats, highest: int) -> Waves:
    """The wave of each whole order up to `highest`, by itself, in values (m,) at rows of this weight (m,)."""
    return waves_of(wave_sums(rows, values, weight, highest))


def wave_sums(rows: RegressionRows, values: Floats, weight: Floats, highest: int) -> WaveSums:
    """The sums of `waves_in`."""
    edges = np.flatnonzero(np.diff(rows.run, prepend=-1))
    turn = np.exp(2j * np.pi * rows.position_rev)
    wave = np.ones(rows.run.size, dtype=np.complex128)
    product = np.zeros((edges.size, highest), dtype=np.complex128)
    power, square = np.zeros((edges.size, highest)), np.zeros_like(product)
    for order in range(1, highest + 1):
        wave *= turn
        column = wave * (weight * _passed_by_filter(rows, order))
        product[:, order - 1] = np.add.reduceat(column * values, edges)
        power[:, order - 1] = np.add.reduceat(np.abs(column) ** 2, edges)
        square[:, order - 1] = np.add.reduceat(column * column, edges)
    return WaveSums(product, power, square)


def waves_of(sums: WaveSums) -> Waves:
    """The waves that sums give."""
    product, power, square = sums
    # the 2 x 2 normal equations of cosine and sine, in complex numbers
    determinant = np.maximum(power**2 - np.abs(square) ** 2, SAME_COLUMNS * power**2 + 1e-300)
    amplitude = 2.0 * (power * product - square * np.conj(product)) / determinant
    return Waves(amplitude, (np.conj(amplitude) * product).real)


def wave_columns(rows: RegressionRows, order: float) -> Floats:
    """Cosine and sine of an order behind the rows' filter. (m, 2)"""
    angle = 2.0 * np.pi * order * rows.position_rev
    return np.asarray(_passed_by_filter(rows, order)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def _passed_by_filter(rows: RegressionRows, order: float) -> Floats:
    return np.asarray(1.0 / (1.0 + np.square(order * rows.velocity_rps / rows.cutoff_hz) ** (FILTER_ORDER // 2)))


def _columns(bench: _Bench, candidate: EffectCandidate) -> Floats:
    """Columns of a candidate. (m, strengths), or (m, runs x strengths)"""
    rows = bench.rows
    if candidate.name == "torque_offset":
        return np.ones((rows.run.size, 1))
    if candidate.name == "asymmetric_coulomb":
        return bench.level_nm[:, None]
    if candidate.name == "asymmetric_viscous":
        return np.abs(rows.velocity_rps)[:, None]
    if candidate.name == SENSOR_ERROR.name:
        wave = np.column_stack([_sensor_columns(rows, bench.start, order) for order in SENSOR_ORDERS])
    else:
        wave = wave_columns(rows, candidate.order)
    if not candidate.per_run:
        return wave
    return np.column_stack([wave * (rows.run == number)[:, None] for number in range(bench.runs)])


def _sensor_columns(rows: RegressionRows, start: TorqueStart, order: float) -> Floats:
    """What a cosine and a sine of an order in the measured angle, a revolution high, add to the torque. (m, 2), Nm"""
    turn = 2j * np.pi * order
    slope = turn * rows.velocity_rps
    curvature = slope * slope + turn * rows.acceleration_rps2
    torque_nm = -(start.inertia_nm_s2_per_rev * curvature + start.viscous_nm_per_rps * slope)
    wave = torque_nm * np.exp(turn * rows.position_rev) * _passed_by_filter(rows, order)
    return np.column_stack([wave.real, wave.imag])


def _evidence(bench: _Bench, candidate: EffectCandidate) -> Floats:
    """The columns by which it is judged: those of a wave only where it comes back, though it acts everywhere."""
    return _columns(bench, candidate) * _counts(bench, candidate)[:, None]


def _counts(bench: _Bench, candidate: EffectCandidate) -> npt.NDArray[np.bool_]:
    """Rows that tell of a candidate. (m,)"""
    return _comes_back(bench, candidate.order) if candidate.rung == WAVES else bench.rows.sliding


def _weighted(bench: _Bench, chosen: Sequence[EffectCandidate]) -> _Weighted:
    """The model with the chosen candidates: columns and target, each row divided by the noise of its speed class."""
    kept, torque_nm = bench.rows.sliding, bench.rows.torque_nm
    known = np.column_stack([bench.base, *(_columns(bench, one) for one in chosen)])
    weight = kept.astype(np.float64)
    for _ in range(2):  # once unweighted, for the levels
        residual = torque_nm - known @ least_squares(known, torque_nm, weight**2).values
        weight = levels(residual, kept, bench.classes)
    return _Weighted(weight, torque_nm * weight, known * weight[:, None], residual * weight)


def _beside(white: _Weighted, columns: Floats) -> Floats:
    """Columns (m, k), whitened, with the known columns projected out; empty if nothing is left."""
    own = columns * white.weight[:, None]
    square = np.einsum("ij,ij->j", own, own)
    left = least_squares(white.known, own).residual
    free = np.einsum("ij,ij->j", left, left) > SAME_COLUMNS * square
    return np.asarray(left[:, free])


def _explained(white: _Weighted, columns: Floats) -> float:
    """Share of the squared residual (outliers clipped) that columns explain in addition to the known ones."""
    left = _beside(white, columns)
    if not left.shape[1]:
        return 0.0
    pulled = clipped(white.residual)
    energy = float(pulled @ pulled)
    return 1.0 - least_squares(left, pulled).cost / energy if energy > 0.0 else 0.0


def _chance(bench: _Bench, white: _Weighted, columns: Floats, tried: int) -> float:
    """p of the windows' scores."""
    left = _beside(white, columns)
    if not left.shape[1]:
        return 1.0
    scores = left * clipped(white.residual)[:, None]
    return hotelling_p(sums_by(bench.folds.window, scores), tried)


def _best(
    bench: _Bench, chosen: Sequence[EffectCandidate], candidates: Sequence[EffectCandidate], tried: int
) -> EffectCandidate | None:
    """The candidate of a rung with the largest gain; among equals the first with the fewest parameters."""
    white = _weighted(bench, chosen)
    without = unseen_loss(white.residual, white.known, bench.folds)
    passed = []
    for candidate in candidates:
        columns = _evidence(bench, candidate)
        if _explained(white, columns) <= LEAST_SHARE or _chance(bench, white, columns, tried) > LARGEST_P:
            continue
        with_it = unseen_loss(
            white.residual, np.column_stack([white.known, columns * white.weight[:, None]]), bench.folds
        )
        found = gain(without, with_it, bench.folds, bench.rows.sliding)
        if found.holds:
            passed.append((candidate, found, with_it, columns.shape[1]))
    if not passed:
        return None
    top = max(passed, key=lambda one: one[1].value)
    family = []
    for one in passed:
        behind = gain(one[2], top[2], bench.folds, bench.rows.sliding)
        if one is top or behind.value <= SDS * behind.sd:
            family.append(one)
    chosen_one = min(family, key=lambda one: one[3])[0]
    others = dict.fromkeys(one[0].name for one in family if one[0].name != chosen_one.name)
    return chosen_one._replace(family=tuple(others))


def _given_others(bench: _Bench, chosen: Sequence[EffectCandidate], k: int, tried: int) -> AcceptedEffect:
    """The evidence for one of them, given all others."""
    others = [one for j, one in enumerate(chosen) if j != k]
    white = _weighted(bench, others)
    columns = _evidence(bench, chosen[k])
    judged = np.column_stack([white.known, columns * white.weight[:, None]])
    without = unseen_loss(white.residual, white.known, bench.folds)
    found = gain(without, unseen_loss(white.residual, judged, bench.folds), bench.folds, bench.rows.sliding)
    values = least_squares(judged, white.target, _counts(bench, chosen[k]).astype(np.float64)).values
    return AcceptedEffect(
        chosen[k], values[white.known.shape[1] :], found,
        _chance(bench, white, columns, tried), _explained(white, columns),
    )  # fmt: skip


def stands(one: AcceptedEffect) -> bool:
    """Whether the evidence for an effect, given all others, is enough, and its size one that the law permits."""
    return one.gain.holds and one.share > LEAST_SHARE and one.p <= LARGEST_P and _is_possible(one)


def _is_possible(one: AcceptedEffect) -> bool:
    """Whether the law permits these strengths: of two columns that are nearly one, each takes what the other adds."""
    strengths = {parameter.name: parameter for parameter in law_of(one.candidate.name).strengths}
    limits = [strengths[name] for name in one.candidate.strengths]
    by_run = one.coefficients.reshape(-1, len(limits))
    return all(p.low <= value <= p.high for row in by_run for p, value in zip(limits, row, strict=True))


def _improved(bench: _Bench, chosen: Sequence[EffectCandidate], start: TorqueStart) -> TorqueStart:
    """The start of the fit with the accepted candidates; unchanged if the result is not a valid axis."""
    white = _weighted(bench, chosen)
    fit = least_squares(white.known, white.target)
    inertia, viscous, coulomb, excess = (float(value) for value in fit.values[: bench.base.shape[1]])
    friction = (bench.base[:, 1:] @ fit.values[1 : bench.base.shape[1]]) * bench.rows.direction
    if not float(friction[bench.rows.sliding].mean()) > 0.0:  # it would drive the axis: torque of the wrong sign
        return start
    has_inertia = start.has_inertia and inertia > 0.0 and told_by_acceleration(fit, fit.cost) >= LEAST_TOLD
    if not coulomb > 0.0:  # at one speed it is not told from viscous friction
        seen = inertia if has_inertia else start.static_nm / HELD_RPS2
        return start._replace(has_inertia=has_inertia, inertia_nm_s2_per_rev=seen)
    static = coulomb * (1.0 + min(max(excess / coulomb, 0.02), 6.0))
    return start._replace(
        inertia_nm_s2_per_rev=inertia if has_inertia else static / HELD_RPS2,
        has_inertia=has_inertia,
        viscous_nm_per_rps=max(viscous, 1e-2 * start.viscous_nm_per_rps),
        coulomb_nm=coulomb,
        static_nm=static,
    )
