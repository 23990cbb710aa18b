"""How an effect is declared: name, stage, kernel, parameters with unit, default and range, description."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

from ....jit.by_address import VectorKernel as EffectKernel

if TYPE_CHECKING:
    from ..parameters import PlantConfig

Values = Mapping[str, float]
Prepare = Callable[["PlantConfig", Values], "PlantConfig"]


class PlantParameter(NamedTuple):
    """One parameter of an effect. With every `strength` parameter at zero the effect is absent."""

    name: str
    unit: str  # "-" for a number without one
    default: float
    low: float
    high: float
    meaning: str
    strength: bool = False


class PlantEffect(NamedTuple):
    """One row of the registry. `parameters` are in the order in which the kernel reads them."""

    name: str
    stage: int
    kernel: EffectKernel | None  # None where only the configuration changes
    parameters: tuple[PlantParameter, ...]
    description: str
    prepare: Prepare | None = None  # changes the configuration that the plant is made from
