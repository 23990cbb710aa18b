"""The figure that a law declares (`Law.figure`), shown beside the residual over its axis. Several laws share one
kind.

order      amplitude of the residual over orders of the motor turn (or frequency), with the orders of effects marked
friction   friction over velocity: measured, and modelled without and with the effect
level      level of friction or of the torque per ampere over time: measured, and modelled with the effect
reversal   torque around reversals of the motion, over the time since
transfer   torque that reaches the shaft over the commanded torque
limit      torque that reaches the shaft over speed, where the command was large
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..model.effects import slots
from ..model.effects.law import Folded
from ..model.effects.registry import law_of
from .fitting import Data, Fitted, consistent_scenes
from .pictures import bin_edges, binned, interval, shown_bins
from .results import FoundCurve, Picture, PictureMark
from .scenes import Effect, Scene, load_rows, wave_factor

SPECTRUM_POINTS = 480
LEAST_ORDERS = 8.0  # orders of the motor turn that a spectrum shows at least
BEYOND = 2.0  # the spectrum reaches this multiple of the effect's order
CHUNK_ROWS = 8192
BEFORE_REVERSAL_S, AFTER_REVERSAL_S = 0.1, 0.4
MUCH = 0.7  # quantile of the commanded torque above which a limit may act
LEAST_SPEED_SHARE = 0.02  # share of the highest speed; slower rows do not determine a viscous level
WITHOUT, WITH, SAYS = "measured", "model with the effect", "model without it"


class _Seen(NamedTuple):
    """A finding with the data of its figure; rows are (m,)."""

    data: Data
    scenes: Sequence[Scene]
    effect: Effect
    effects: Sequence[Effect]
    load_nm: Floats  # of the effect
    before_nm: Floats  # residual without it
    after_nm: Floats
    kept: Integers

    def along(self, place: int) -> Floats:
        """One slot of the motion at the rows. (m,)"""
        return np.concatenate([self.data.rows.laws.rows(scene.motion[:, place]) for scene in self.scenes])

    def commanded_nm(self) -> Floats:
        """Commanded torque. (m,)"""
        rows = self.data.rows
        return np.concatenate(
            [rows.laws.rows(s.commanded_thinned * s.axis.torque_constant_nm_per_a) for s in self.scenes]
        )

    def curves(
        self, place: Floats, rows: Integers, drawn: dict[str, Floats], points: Sequence[str]
    ) -> list[FoundCurve]:
        """Bin means over `place`; those in `points` as points with intervals, the others as lines."""
        edges = bin_edges(place[rows])
        count = edges.size - 1
        bins = np.clip(np.searchsorted(edges, place[rows], side="right") - 1, 0, count - 1)
        window = self.data.rows.folds.window[rows]
        shown = shown_bins(bins, window, count)
        x = binned(place[rows], bins, count)[shown]
        found = []
        for label, values in drawn.items():
            mean, reach = interval(values[rows], bins, window, count)
            y = mean[shown]
            if label in points:
                found.append(FoundCurve(label, x, y, y - reach[shown], y + reach[shown], "points"))
            else:
                found.append(FoundCurve(label, x, y, kind="line"))
        return found


def law_picture(data: Data, fitted: Fitted, number: int) -> Picture | None:
    """The figure that the law of an effect declares; None where that is the residual over its axis."""
    effect = fitted.effects[number]
    draw = _KINDS.get(law_of(effect.name).figure)
    if draw is None:
        return None
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    load = load_rows(data.rows, scenes, effect)
    kept = np.flatnonzero(data.rows.kept)
    seen = _Seen(data, scenes, effect, fitted.effects, load, fitted.residual_nm + load, fitted.residual_nm, kept)
    found = draw(seen)
    return found if found is not None and all(curve.x.size > 1 for curve in found.curves) else None


def _title(seen: _Seen, over: str) -> str:
    name = law_of(seen.effect.name).plain_name
    return f"{name[:1].upper()}{name[1:]}: {over}"


def _folded(effect: Effect) -> Folded | None:
    law = law_of(effect.name)
    return law.fold(law.filled(dict(effect.shapes)))


def _order(seen: _Seen) -> Picture | None:
    folded = _folded(seen.effect)
    if folded is None:
        return None
    signal, period = folded
    turns = signal == "motor_angle"
    along = seen.data.rows.position_rev if turns else seen.data.rows.time_s
    highest = max(BEYOND / period, LEAST_ORDERS if turns else 0.0)
    marks = []
    for effect in seen.effects:
        other = _folded(effect)
        if other is not None and other[0] == signal and 1.0 / other[1] <= highest:
            marks.append(PictureMark(1.0 / other[1], f"{law_of(effect.name).plain_name}, {1.0 / other[1]:.4g}"))
    grid = np.linspace(0.0, highest, SPECTRUM_POINTS + 1)[1:]
    grid = np.unique(np.concatenate([grid, [mark.x for mark in marks]]))
    wave = law_of(seen.effect.name).wave or "plain"
    factor = wave_factor(seen.data.rows, seen.scenes, wave)
    before, after = (_amplitudes(seen, along, values, factor, grid) for values in (seen.before_nm, seen.after_nm))
    times = {"torque": ", as a share of the motor's torque", "friction": ", of the friction's level"}.get(wave, "")
    return Picture(
        title=_title(seen, "spectrum over orders of the motor turn" if turns else "spectrum over frequency"),
        x_label="order, periods in a motor turn" if turns else "frequency",
        x_unit="" if turns else "Hz",
        y_label="amplitude of the residual",
        y_unit="Nm",
        curves=(
            FoundCurve("without the effect", grid, before, kind="line"),
            FoundCurve("with it", grid, after, kind="line"),
        ),
        note=f"Fit runs, each with a phase of its own{times}.",
        marks=tuple(marks),
        says="Amplitude of a wave in the residual torque, without and with the effect.",
    )


def _amplitudes(seen: _Seen, along: Floats, values: Floats, factor: Floats, grid: Floats) -> Floats:
    """Amplitude of a wave times `factor` in `values`: least squares at each order, rms over the runs. (g,)"""
    total, weight = np.zeros(grid.size), 0.0
    for run in np.unique(seen.data.rows.run[seen.kept]):
        rows = seen.kept[seen.data.rows.run[seen.kept] == run]
        power = float(factor[rows] @ factor[rows])
        if power <= 0.0:
            continue
        wave = np.zeros(grid.size, dtype=np.complex128)
        centred = (values - values[rows].mean()) * factor
        for begin in range(0, rows.size, CHUNK_ROWS):
            part = rows[begin : begin + CHUNK_ROWS]
            wave += np.exp(-2j * np.pi * np.outer(grid, along[part] - along[rows[0]])) @ centred[part]
        # amplitude as a torque, at the rms of the factor
        total += power * (2.0 * np.abs(wave) / power) ** 2
        weight += rows.size
    return np.asarray(np.sqrt(total / max(weight, 1.0)))


def _friction(seen: _Seen) -> Picture:
    friction = seen.along(slots.FRICTION_NM)
    drawn = {WITHOUT: friction + seen.before_nm, SAYS: friction, WITH: friction + seen.load_nm}
    return Picture(
        title=_title(seen, "friction over velocity"),
        x_label="velocity",
        x_unit="rps",
        y_label="friction torque",
        y_unit="Nm",
        curves=tuple(seen.curves(seen.data.rows.velocity_rps, seen.kept, drawn, (WITHOUT,))),
        note="Motor torque less inertia and all other effects.",
        says="Friction: measured, and modelled without and with the effect.",
    )


def _level(seen: _Seen) -> Picture:
    """A level over time by least squares in each bin: mean of torque times carrier over the mean of its square."""
    rows, axis, law = seen.data.rows, seen.scenes[0].axis, law_of(seen.effect.name)
    speed, friction = rows.velocity_rps, seen.scenes[0].axis.friction
    if law.acts_on == "torque":
        asked_a = seen.commanded_nm() / axis.torque_constant_nm_per_a
        what, base, unit, carrier = "torque per ampere", axis.torque_constant_nm_per_a, "Nm/A", -asked_a
    elif any(parameter.unit == "Nm/rps" for parameter in law.strengths):
        what, base, unit, carrier = "viscous friction", friction.viscous_nm_per_rps, "Nm/rps", speed
    else:
        what, base, unit, carrier = "Coulomb friction", friction.coulomb_nm, "Nm", np.sign(speed)
    fast = np.abs(speed) > LEAST_SPEED_SHARE * np.abs(speed[seen.kept]).max()
    kept = seen.kept[fast[seen.kept]]
    carrier = carrier / np.mean(carrier[kept] ** 2)
    drawn = {
        WITHOUT: base + seen.before_nm * carrier,
        SAYS: np.full(speed.size, base),
        WITH: base + seen.load_nm * carrier,
    }
    return Picture(
        title=_title(seen, f"{what} over time"),
        x_label="time",
        x_unit="s",
        y_label=what,
        y_unit=unit,
        curves=tuple(seen.curves(rows.time_s, kept, drawn, (WITHOUT,))),
        note="Runs in the order of the log's clock.",
        says=f"{what[0].upper()}{what[1:]}: measured, and modelled without and with the effect.",
    )


def _reversal(seen: _Seen) -> Picture | None:
    rows = seen.data.rows
    since, direction = np.full(rows.time_s.size, np.nan), np.zeros(rows.time_s.size)
    for begin, end in rows.bounds:
        sign = np.sign(rows.velocity_rps[begin:end])
        moving = np.flatnonzero(sign)
        turns = moving[1:][np.diff(sign[moving]) != 0]
        for turn in turns:
            at = rows.time_s[begin:end] - rows.time_s[begin + turn]
            near = np.flatnonzero((at >= -BEFORE_REVERSAL_S) & (at < AFTER_REVERSAL_S))
            since[begin + near], direction[begin + near] = at[near], sign[turn]
    kept = seen.kept[np.isfinite(since[seen.kept])]
    if not kept.size:
        return None
    drawn = {
        "without the effect": seen.before_nm * direction,
        "with it": seen.after_nm * direction,
        "torque of the effect": seen.load_nm * direction,
    }
    return Picture(
        title=_title(seen, "torque around reversals"),
        x_label="time since the reversal",
        x_unit="s",
        y_label="residual torque",
        y_unit="Nm",
        curves=tuple(seen.curves(since, kept, drawn, ("without the effect", "with it"))),
        note="All reversals of the fit runs.",
        says="Residual, positive in the new direction, without and with the effect: means with 95 % intervals.",
        marks=(PictureMark(0.0, "reversal"),),
    )


def _transfer(seen: _Seen) -> Picture:
    asked = seen.commanded_nm()
    return _arriving(
        seen, "delivered torque over commanded torque", asked, seen.kept, asked, np.ones(asked.size),
        ("commanded torque", "Nm"), "Torque delivered at the shaft, measured and modelled.",
    )  # fmt: skip


def _limit(seen: _Seen) -> Picture | None:
    asked, speed = seen.commanded_nm(), seen.data.rows.velocity_rps
    motoring = seen.kept[(asked * speed)[seen.kept] > 0.0]
    if not motoring.size:
        return None
    much = motoring[np.abs(asked[motoring]) >= np.quantile(np.abs(asked[motoring]), MUCH)]
    return _arriving(
        seen, "torque over speed", np.abs(speed), much, asked, np.sign(asked), ("speed", "rps"),
        f"Delivered torque in the {100.0 - 100.0 * MUCH:g} % of the driving rows with the largest commanded torque.",
    )  # fmt: skip


def _arriving(
    seen: _Seen, over: str, place: Floats, rows: Integers, asked_nm: Floats, sign: Floats, axis: tuple[str, str],
    says: str,
) -> Picture:  # fmt: skip
    drawn = {
        WITHOUT: (asked_nm - seen.before_nm) * sign,
        "commanded": asked_nm * sign,
        WITH: (asked_nm - seen.load_nm) * sign,
    }
    return Picture(
        title=_title(seen, over),
        x_label=axis[0],
        x_unit=axis[1],
        y_label="torque",
        y_unit="Nm",
        curves=tuple(seen.curves(place, rows, drawn, (WITHOUT,))),
        note="Measured: computed from the motion with inertia and friction.",
        says=says,
    )


_KINDS: dict[str, Callable[[_Seen], Picture | None]] = {
    "order": _order, "friction": _friction, "level": _level, "reversal": _reversal, "transfer": _transfer,
    "limit": _limit,
}  # fmt: skip
