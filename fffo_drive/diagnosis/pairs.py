"""Two axes at once: what neither of them explains, nor both of them one by one.

Pairs are scored by coarse tables beyond the sum of two curves: that tells where a residual lives. The best of them gets
a table with more knots, which is a law like any other.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..identification.ranking import first_best
from ..model.effects.laws.lookup import BRAKE, FRICTION, KNOTS, PLAIN, UNKNOWN, across_word, code_of
from .candidates import Scene
from .curves import Axis, abscissa, factor, hats
from .evidence import Evidence, Score, orthonormal, score, whiten
from .free_curves import curve_trial, knots_of
from .paths import Rows
from .screening import Trial

Floats = npt.NDArray[np.float64]

COARSE = 5  # knots of each axis of a coarse table
ANGLES = ("motor_angle", "output_angle")
FINE = 40  # knots of the curve that says where those of a table over an angle lie
STEEPEST = 20.0  # bend of that curve over its median, beyond which it counts no more
EVEN_SHARE = 0.5  # of the knots' density that is even, over what follows the bends
LEVEL_SHARES = (0.05, 0.35, 0.65, 0.95)  # of the rows below each level of a fine one: of the velocity, two each way
TURNS = 3.0  # of the motor, for its angle to be an axis
AXES = (  # the finer of a pair first
    Axis("motor_angle", PLAIN, 1.0), Axis("output_angle", PLAIN, 0.0), Axis("velocity", PLAIN, 0.0),
    Axis("travel_since_reversal", FRICTION, 0.0), Axis("time", FRICTION, 0.0), Axis("current", PLAIN, 0.0),
    Axis("memory", FRICTION, 3.0), Axis("acceleration", PLAIN, 0.0),
)  # fmt: skip
SPEED = Axis("memory", FRICTION, 0.0)  # a memory without a length
OVER_SPEED = ("motor_angle", "output_angle", "travel_since_reversal", "time", "memory")


class Pair(NamedTuple):
    """A table over two axes; the first is the finer."""

    along: Axis
    across: Axis

    @property
    def name(self) -> str:
        """As a channel is called."""
        drag = " (drag)" if self.along.kind == BRAKE else ""
        return f"{self.along.word} x {across_word(self.shapes)}{drag}"

    @property
    def shapes(self) -> dict[str, float]:
        """What the law of its table is told of the axes."""
        return {
            "kind": self.along.kind, "scale": self.along.scale,
            "across": code_of(self.across.word), "across_scale": self.across.scale,
        }  # fmt: skip


def pairs_of(turns: float) -> list[Pair]:
    """All pairs that are tried: torque over the velocity, friction and drag over its size, either over the others."""
    axes = {axis.word: axis for axis in AXES if axis.word != "motor_angle" or turns > TURNS}
    found = [_pair(first, second) for first, second in itertools.combinations(axes.values(), 2)]
    found += [Pair(axes[word]._replace(kind=FRICTION), SPEED) for word in OVER_SPEED if word in axes]
    return found + [Pair(axes[word]._replace(kind=BRAKE), SPEED) for word in ANGLES if word in axes]


def _pair(first: Axis, second: Axis) -> Pair:
    frictional = FRICTION in (first.kind, second.kind) and "velocity" not in (first.word, second.word)
    return Pair(first._replace(kind=FRICTION if frictional else PLAIN), second)


class Coarse(NamedTuple):
    """Columns of a coarse table, and of the two curves that it holds."""

    pair: Pair
    columns: Floats  # (m, k)
    beside: Floats  # (m, j)


def coarse_tables(rows: Rows, scenes: Sequence[Scene]) -> list[Coarse]:
    """A coarse table of every pair over which the data move. Thinned, not filtered: it changes slowly."""
    step = rows.laws.step
    curves: dict[tuple[str, float], Floats | None] = {}
    found = []
    for pair in pairs_of(float(np.ptp(rows.position_rev))):
        for axis in pair:
            if (axis.word, axis.scale) not in curves:
                at = np.concatenate([place[::step] for place in abscissa(scenes, axis)])
                knots = np.unique(np.quantile(at[rows.kept], np.linspace(0.01, 0.99, COARSE)))
                own = hats(np.clip(at, knots[0], knots[-1]), knots) if knots.size >= 3 else None
                curves[axis.word, axis.scale] = own
        first, second = (curves[axis.word, axis.scale] for axis in pair)
        if first is None or second is None:
            continue
        weight = np.concatenate([factor(s, pair.along.kind)[::step] for s in scenes])[:, None]
        table = (first[:, :, None] * second[:, None, :]).reshape(first.shape[0], -1)
        found.append(Coarse(pair, table * weight, np.concatenate([first, second], axis=1) * weight))
    return found


def score_beyond(evidence: Evidence, columns: Floats, beside: Floats) -> Score:
    """What columns explain beyond others that are fitted anyway."""
    white = whiten(evidence.rows, evidence.whitening, beside)
    white = white - evidence.basis @ (evidence.basis.T @ white)
    more = orthonormal(white)
    left = evidence.residual - more @ (more.T @ evidence.residual)
    basis = np.concatenate([evidence.basis, more], axis=1)
    return score(evidence._replace(residual=left, basis=basis), columns)


def table_trial(evidence: Evidence, scenes: Sequence[Scene], pair: Pair) -> Trial | None:
    """A fine table over a pair."""
    places = [abscissa(scenes, axis) for axis in pair]
    moving = [np.concatenate([p[s.moving > 0.0] for p, s in zip(own, scenes, strict=True)]) for own in places]
    levels = np.unique(np.quantile(moving[1], LEVEL_SHARES))
    if pair.along.word in ANGLES:  # a window may be narrow
        knots = bent_knots(evidence, scenes, places[0], KNOTS)
    else:
        knots = thinned(knots_of(moving[0], pair.along), KNOTS)
    if knots.size < 4 or levels.size < 2:
        return None
    name = UNKNOWN + pair.along.word
    shapes = {**pair.shapes, "count": float(knots.size), "levels": float(levels.size)}
    shapes |= {f"x{k:02d}": float(x) for k, x in enumerate(knots)}
    shapes |= {f"z{k:02d}": float(z) for k, z in enumerate(levels)}
    return curve_trial(evidence, scenes, name, shapes)


def thinned(knots: Floats, most: int) -> Floats:
    """At most so many of the knots, both ends among them."""
    if knots.size <= most:
        return knots
    return np.asarray(knots[np.unique(np.rint(np.linspace(0, knots.size - 1, most)).astype(int))])


def bent_knots(evidence: Evidence, scenes: Sequence[Scene], places: Sequence[Floats], count: int) -> Floats:
    """Knots where a fine curve over an axis bends, as what explains most: torque, friction or drag."""
    step = evidence.rows.laws.step
    at = np.concatenate([place[::step] for place in places])
    low, high = float(at[evidence.rows.kept].min()), float(at[evidence.rows.kept].max())
    if not high > low:
        return np.zeros(0)
    fine = np.linspace(low, high, FINE)
    columns = hats(at, fine, 0.0)
    weights = [np.concatenate([factor(s, kind)[::step] for s in scenes])[:, None] for kind in (PLAIN, FRICTION, BRAKE)]
    best = first_best((score(evidence, columns * weight) for weight in weights), key=lambda found: -found.explained)
    bend = np.abs(np.diff(best.strengths, 2, prepend=best.strengths[0], append=best.strengths[-1]))
    bend = np.minimum(bend, STEEPEST * float(np.median(bend))) if bend.any() else np.ones(FINE)
    density = np.sqrt(np.convolve(bend, np.full(3, 1.0 / 3.0), mode="same"))
    density = density / density.sum() + EVEN_SHARE / FINE
    reached = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.unique(np.interp(np.linspace(0.0, reached[-1], count), reached, fine))
