"""Effects in a joint fit with the model's own parameters: their sizes, their coordinates, and what was found of them.

Adding an effect changes the other parameters: without it, Coulomb friction absorbs the mean of a drift, J the slope of
an elasticity. So nothing is held that the data determine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats
from ..model.effects.registry import law_of
from ..model.effects.table import Term
from ..model.parameters import EffectModel, effect_model
from .coordinates import PARAMETERS, Coordinates
from .layout import SHARED, EffectLayout, EffectScales
from .prediction import Problem

BASE = len(PARAMETERS)
COULOMB, STATIC = (PARAMETERS.index(name) for name in ("coulomb_nm", "static_nm"))


class FittedEffect(NamedTuple):
    """A fitted effect; standard deviations under the same names, without held parameters."""

    name: str
    values: Mapping[str, float]
    sd: Mapping[str, float]
    per_run: Mapping[str, tuple[float, ...]]
    per_run_sd: Mapping[str, tuple[float, ...]]

    @property
    def chance(self) -> float:
        """p-value of its strengths where they are zero, by the standard deviations of the fit; 0 where all are held."""
        names = {p.name for p in law_of(self.name).strengths}
        pairs = [(self.values[name], sd) for name, sd in self.sd.items() if name in names]
        pairs += [pair for name, sd in self.per_run_sd.items() for pair in zip(self.per_run[name], sd, strict=True)]
        known = [value / sd for value, sd in pairs if sd > 0.0]
        return float(scipy.stats.chi2.sf(sum(one * one for one in known), len(known))) if known else 0.0

    def term(self, run: int = 0) -> Term:
        """The effect in one run."""
        return Term(self.name, {**self.values, **{key: values[run] for key, values in self.per_run.items()}})

    def model(self, alternatives: Sequence[str] = (), provenance: str = "") -> EffectModel:
        """For a model file; of a parameter with a value for each run the first one stands there."""
        sd = {**self.sd, **{key: spread[0] for key, spread in self.per_run_sd.items()}}
        return effect_model(
            self.name, self.term().values, {key: spread or None for key, spread in sd.items()},
            datum="run" if self.per_run else "absolute", alternatives=alternatives, provenance=provenance,
        )  # fmt: skip


def scales_of(problem: Problem, physical: Floats) -> EffectScales:
    """Sizes of the data of a problem."""
    period_s = problem.shooting.period_s
    span = max(1, round(0.01 / period_s))
    speed = max(float(np.abs(s.position_rev[span:] - s.position_rev[:-span]).max()) for s in problem.stretches)
    return EffectScales(
        max(float(physical[COULOMB]), float(physical[STATIC])),
        speed / (span * period_s),
        max(float(np.ptp(s.position_rev)) for s in problem.stretches),
        max(s.position_rev.size for s in problem.stretches) * period_s,
        period_s,
        problem.lsb_rev,
    )


def joint_coordinates(base: Coordinates, layout: EffectLayout) -> Coordinates:
    """The space of the model's own parameters with that of the effects behind it."""
    parameters = layout.parameters
    scale = np.array([p.scale for p in parameters])
    values = np.array([p.value for p in parameters]) / scale
    low = np.array([p.low for p in parameters]) / scale
    high = np.array([p.high for p in parameters]) / scale
    held = ~np.array([p.free for p in parameters], dtype=bool)
    low[held] = high[held] = values[held]
    return Coordinates(
        (*base.names, *layout.labels), np.concatenate([base.scale, scale]), np.concatenate([base.low, low]),
        np.concatenate([base.high, high]), base.rising,
    )  # fmt: skip


def effects_of(layout: EffectLayout | None, physical: Floats, sd: Floats | None) -> tuple[FittedEffect, ...]:
    """The effects of a layout with the values of a fit, (parameters,), and their standard deviations where given."""
    found = []
    for k, name in enumerate(layout.names if layout else ()):
        assert layout is not None
        values: dict[str, float] = {}
        spread: dict[str, float] = {}
        runs: dict[str, tuple[float, ...]] = {}
        runs_spread: dict[str, tuple[float, ...]] = {}
        for j, p in enumerate(layout.parameters):
            if p.effect != k:
                continue
            value, own = float(physical[BASE + j]), float(sd[BASE + j]) if sd is not None and p.free else 0.0
            if p.run == SHARED:
                values[p.name] = value
                if own > 0.0:
                    spread[p.name] = own
            else:
                runs[p.name] = (*runs.get(p.name, ()), value)
                runs_spread[p.name] = (*runs_spread.get(p.name, ()), own)
        found.append(FittedEffect(name, values, spread, runs, runs_spread))
    return tuple(found)
