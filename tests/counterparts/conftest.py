"""What a master knows of the drive."""

from __future__ import annotations

from pathlib import Path

import pytest

from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.eds import eds_text


@pytest.fixture(scope="session")
def eds_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive's data sheet."""
    path = tmp_path_factory.mktemp("eds") / "simulated_drive.eds"
    path.write_text(eds_text(NodeConfig()))
    return path
