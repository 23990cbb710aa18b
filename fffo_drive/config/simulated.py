"""The file of a simulated drive: plant, effects, device, node. For `fffo-drive sim`, and as an axis file's drive."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import create_model

from .. import formats
from ..documents import StrictRecord, load, refuse, refuse_argument
from ..drive.simulated.effects.registry import effect_errors
from ..drive.simulated.node.config import NodeConfig
from ..drive.simulated.parameters import EffectConfig, PlantConfigError
from .mirror import dataclass_of, record_of


class _Head(StrictRecord):
    format: Annotated[str, formats.SIMULATED.key] = formats.SIMULATED.word


SimulatedDriveRecord: type[StrictRecord] = create_model(
    "SimulatedDrive",
    __base__=(record_of(NodeConfig), _Head),
    __doc__="A simulated drive: plant, effects, device, node.",
)


def read_simulated(path: str | Path) -> NodeConfig:
    """Read and check the file of a simulated drive. Raises DocumentError with every error in it."""
    record: Any = load(path, SimulatedDriveRecord)
    config = dataclass_of(NodeConfig, record)
    try:
        config.validate()
    except PlantConfigError as error:
        found = [line.partition(": ") for line in str(error).splitlines()]
        refuse(path, [(key.removeprefix("node."), text) for key, _, text in found])
    return config


def plant_effects(given: Mapping[str, Mapping[str, float]]) -> tuple[EffectConfig, ...]:
    """Effects of a simulated drive: parameters by name of the effect. Raises DocumentError with every error."""
    problems = []
    for name, parameters in given.items():
        for key, text in effect_errors(name, parameters):
            problems.append((name if key == "name" else f"{name}.{key.removeprefix('parameters.')}", text))
    refuse_argument("effects", problems)
    return tuple(EffectConfig(name, dict(parameters)) for name, parameters in given.items())
