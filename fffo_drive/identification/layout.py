"""Layout of the effects' parameters in the vector of a fit: after the model's own, shared or one per run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ..arrays import Floats
from ..model.effects.law import PER_TURN, STRENGTH, Law, Parameter
from ..model.effects.laws.lookup import values_of
from ..model.effects.registry import law_of
from ..model.effects.table import Term

SHARED = -1
SHAPE_SPAN = 10.0  # a positive shape stays within this factor of its start
PHASE_TURNS = 0.05  # step of orders and frequencies: phase shift at the end of the data, in turns
RELATIVE_STEP = 0.3  # of other shapes
SHARE_STEP = 0.3
SENSOR_STEP_LSB = 20.0


class EffectStart(NamedTuple):
    """An effect at the start of a fit."""

    name: str
    values: Mapping[str, float]
    per_run: Mapping[str, Sequence[float]] = {}  # parameters with a value for each run
    free: tuple[str, ...] | None = None  # None: `default_free`


class EffectScales(NamedTuple):
    """Sizes of the data from which the steps of the parameters follow."""

    torque_nm: float  # level of friction
    highest_rps: float
    turns: float  # range of the motor angle, rev
    duration_s: float
    period_s: float
    lsb_rev: float


class LayoutParameter(NamedTuple):
    """One number of the vector."""

    effect: int
    name: str
    run: int  # SHARED, or the number of the record
    value: float
    scale: float
    low: float
    high: float
    free: bool


class EffectLayout(NamedTuple):
    """The effects' part of the vector."""

    names: tuple[str, ...]  # of the effects
    parameters: tuple[LayoutParameter, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """EFFECT.PARAMETER, with @RUN where it has a value for each."""
        return tuple(
            f"{self.names[p.effect]}.{p.name}" + (f"@{p.run}" if p.run != SHARED else "") for p in self.parameters
        )

    def terms(self, values: Floats, run: int) -> list[Term]:
        """The effects with these values, (parameters,), as they act in a run."""
        given: list[dict[str, float]] = [{} for _ in self.names]
        for p, value in zip(self.parameters, values, strict=True):
            if p.run in (SHARED, run):
                given[p.effect][p.name] = float(value)
        return [Term(name, value) for name, value in zip(self.names, given, strict=True)]


def default_free(law: Law, values: Mapping[str, float]) -> tuple[str, ...]:
    """Free parameters of an effect in a refit: strengths that act with these shapes, and shapes that are not held."""
    if law.name == "lookup":
        return tuple(f"y{k:02d}" for k in range(values_of(values)))
    # the order of a wave is determined by the scan, better than by a fit from a distance
    return tuple(p.name for p in law.parameters if not (p.held or _counts_turns(p) or p.is_off(values)))


def _counts_turns(p: Parameter) -> bool:
    return p.span or p.unit == PER_TURN


def layout_of(effects: Sequence[EffectStart], scales: EffectScales) -> EffectLayout:
    """All parameters of the effects in their order; shapes that are not given are typical."""
    found: list[LayoutParameter] = []
    for k, effect in enumerate(effects):
        law = law_of(effect.name)
        given = law.filled(effect.values)
        free = default_free(law, given) if effect.free is None else effect.free
        for p in law.parameters:
            if law.name == "lookup" and p.name not in effect.values and p.name not in free:
                continue
            runs = effect.per_run.get(p.name)
            for run, value in enumerate(runs) if runs is not None else [(SHARED, given[p.name])]:
                low, high = _bounds(p, float(value), given, scales)
                scale = _scale(p, float(value), given, scales)
                found.append(LayoutParameter(k, p.name, run, float(value), scale, low, high, p.name in free))
    return EffectLayout(tuple(effect.name for effect in effects), tuple(found))


def _scale(p: Parameter, value: float, given: Mapping[str, float], scales: EffectScales) -> float:
    if p.kind == STRENGTH:
        viscous = scales.torque_nm / max(scales.highest_rps, 1e-9)
        own = {
            "Nm": scales.torque_nm, "Nm/rps": viscous, "Nm/rps2": viscous / max(scales.highest_rps, 1e-9),
            "s": 2.0 * scales.period_s, "rev": SENSOR_STEP_LSB * scales.lsb_rev,
        }  # fmt: skip
        return own.get(p.unit, SHARE_STEP)
    turns = max(scales.turns, 1.0)
    if p.unit == PER_TURN:
        return PHASE_TURNS / turns
    if p.span:
        return max(PHASE_TURNS * value * value / turns, 1e-9)
    if _counts_periods(p):
        return PHASE_TURNS / max(scales.duration_s, scales.period_s)
    if p.needs:
        return max(RELATIVE_STEP * given.get(p.needs, 0.0), 1e-6)
    return max(RELATIVE_STEP * abs(value), 1e-9)


def _counts_periods(p: Parameter) -> bool:
    """Of a clock of its own, and not a resonance, which has a width."""
    return p.unit == "Hz" and not p.logarithmic


def _bounds(p: Parameter, value: float, given: Mapping[str, float], scales: EffectScales) -> tuple[float, float]:
    if p.kind == STRENGTH:
        return p.low, p.high
    reach = math.inf
    if _counts_turns(p) or _counts_periods(p):
        reach = 20.0 * _scale(p, value, given, scales)
    elif p.needs:
        reach = given.get(p.needs, 0.0)
    if math.isfinite(reach):
        return max(p.low, value - reach), min(p.high, value + reach)
    if value > 0.0:
        return max(p.low, value / SHAPE_SPAN), min(p.high, value * SHAPE_SPAN)
    return p.low, p.high
