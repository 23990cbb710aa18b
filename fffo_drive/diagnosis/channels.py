"""Localise a residual: how much of it a free curve over each axis, and a table over each pair of axes, explains."""

from __future__ import annotations

import itertools

from ..arrays import Floats
from ..identification.threads import in_threads
from ..model.effects.laws.lookup import UNKNOWN
from .curves import Curve, coarse_tables, curves
from .fitting import Data, Fitted, consistent_scenes
from .propose import Evidence, beside, evidence_of, score
from .results import ResidualChannel


def channels(
    data: Data, base: tuple[Fitted, Floats], fitted: tuple[Fitted, Floats], rate: float
) -> tuple[ResidualChannel, ...]:
    """The best curve over each axis, then each pair beyond its two axes. Models come with their sensitivities."""
    scenes = consistent_scenes(data, base[0].physical, base[0].effects)
    before, after = (evidence_of(data, *model) for model in (base, fitted))
    rows = int(data.used.size)

    def scored(curve: Curve) -> tuple[str, list[tuple[float, float]]]:
        name = curve.name.removeprefix(UNKNOWN) if curve.pair is None else curve.pair.name
        return name, [_explained(evidence, data, curve) for evidence in (before, after)]

    found = list(in_threads(scored, itertools.chain(curves(data.rows, scenes), coarse_tables(data.rows, scenes))))
    best: dict[str, list[tuple[float, float]]] = {}
    for name, pair in found:
        if name not in best or pair[0][0] > best[name][0][0]:
            best[name] = pair
    limit = rate / max(1, len(found))
    return tuple(
        ResidualChannel(name, first[0], last[0], first[1] <= limit, last[1] <= limit, rows)
        for name, (first, last) in best.items()
    )


def _explained(evidence: Evidence, data: Data, curve: Curve) -> tuple[float, float]:
    """Explained share of the squared residual, and its p-value."""
    known = evidence if curve.beside is None else beside(evidence, data.white(curve.beside))
    found = score(known, data.white(curve.columns))
    return found.explained / max(evidence.energy, 1e-300), found.p
