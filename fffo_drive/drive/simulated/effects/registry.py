"""The registry: every effect by name, the checks of a configuration, and what the tables of effects say.

An effect is added by a kernel and one row in the `EFFECTS` of its file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from ....documents import did_you_mean
from . import friction_effects, mechanics, odd, torque
from .declaration import PlantEffect, PlantParameter

EFFECTS: dict[str, PlantEffect] = {
    effect.name: effect for module in (torque, friction_effects, mechanics, odd) for effect in module.EFFECTS
}


def effect_values(name: str, given: Mapping[str, float]) -> dict[str, float]:
    """All parameters of an effect in the kernel's order: what is given, else the default."""
    return {p.name: float(given.get(p.name, p.default)) for p in EFFECTS[name].parameters}


def is_present(name: str, values: Mapping[str, float]) -> bool:
    """False when every strength parameter is zero: such an effect is left out of the plant altogether."""
    return any(p.strength and values[p.name] != 0.0 for p in EFFECTS[name].parameters)


def effect_errors(name: str, given: Mapping[str, float]) -> list[tuple[str, str]]:
    """What is wrong with a request for an effect: pairs of key (empty for the name itself) and text."""
    effect = EFFECTS.get(name)
    if effect is None:
        return [("name", f"no effect is called {name!r}: {did_you_mean(name, EFFECTS)}")]
    known = {p.name: p for p in effect.parameters}
    errors = []
    for key, value in given.items():
        if key not in known:
            text = f"effect {name!r} has no parameter {key!r}: {did_you_mean(key, known)}"
            errors.append((f"parameters.{key}", text))
            continue
        p = known[key]
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            errors.append((f"parameters.{key}", f"{value!r} is not a number ({p.low:g} to {p.high:g} {p.unit})"))
        elif not p.low <= value <= p.high:
            errors.append((f"parameters.{key}", f"{value:g} is outside {p.low:g} to {p.high:g} {p.unit}"))
    return errors


PARAMETER_COLUMNS = ("parameter", "unit", "default", "range", "meaning")


def parameter_cells(p: PlantParameter) -> tuple[str, ...]:
    """A parameter under `PARAMETER_COLUMNS`, for the terminal and for the manual."""
    strength = " (strength)" if p.strength else ""
    return p.name, p.unit, f"{p.default:g}", f"{p.low:g} to {p.high:g}", f"{p.meaning}{strength}"
