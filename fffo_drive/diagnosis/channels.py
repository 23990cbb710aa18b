"""Localise a residual: how much of it a free curve over each axis explains."""

from __future__ import annotations

from ..arrays import Floats
from ..identification.threads import in_threads
from ..model.effects.laws.lookup import UNKNOWN
from .curves import Curve, curves
from .fitting import Data, Fitted, consistent_scenes
from .propose import Evidence, evidence_of, score
from .results import ResidualChannel


def channels(
    data: Data, base: tuple[Fitted, Floats], fitted: tuple[Fitted, Floats], rate: float
) -> tuple[ResidualChannel, ...]:
    """The best curve over each axis. Models come with their sensitivities."""
    scenes = consistent_scenes(data, base[0].physical, base[0].effects)
    before, after = (evidence_of(data, *model) for model in (base, fitted))
    rows = int(data.used.size)

    def scored(curve: Curve) -> tuple[str, list[tuple[float, float]]]:
        return curve.name.removeprefix(UNKNOWN), [_explained(evidence, data, curve) for evidence in (before, after)]

    found = list(in_threads(scored, curves(data.rows, scenes)))
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
    found = score(evidence, data.white(curve.columns))
    return found.explained / max(evidence.energy, 1e-300), found.p
