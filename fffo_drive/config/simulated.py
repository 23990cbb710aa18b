"""The file of a simulated drive: plant, effects, device, node. For `fffo-drive sim`, and as an axis file's drive."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import create_model

from ..documents import DocumentError, Record, check, located, parse, read_text
from ..drive.simulated.node.config import NodeConfig
from ..drive.simulated.parameters import PlantConfigError
from .mirror import dataclass_of, record_of


class _Head(Record):
    format: Literal["fffo_drive/simulated/1"] = "fffo_drive/simulated/1"


SimulatedDriveRecord: type[Record] = create_model(
    "SimulatedDrive",
    __base__=(record_of(NodeConfig), _Head),
    __doc__="A simulated drive: plant, effects, device, node.",
)


def read_simulated(path: str | Path) -> NodeConfig:
    """Read and check the file of a simulated drive. Raises DocumentError with every error in it."""
    data, lines = parse(read_text(Path(path)), str(path))
    record: Any = check(data, SimulatedDriveRecord, str(path), lines)
    config = dataclass_of(NodeConfig, record)
    try:
        return config.validate()
    except PlantConfigError as error:
        found = [line.split(": ", 1) for line in str(error).splitlines()]
    raise DocumentError("\n".join(located(str(path), lines, key.removeprefix("node."), text) for key, text in found))
