"""The wheel of this source tree, with the built manual in it: once for all workers of pytest-xdist."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from shared_once import once

ROOT = Path(__file__).resolve().parents[1]


def built_wheel(place: Path) -> str:
    """The wheel, built into `place` as pip builds it."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(place)]
    done = subprocess.run(command, cwd=ROOT, env=dict(os.environ, PYTHONPATH=""), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (wheel,) = place.glob("*.whl")
    return str(wheel)


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its file."""
    return Path(once(tmp_path_factory, "wheel", lambda: built_wheel(tmp_path_factory.mktemp("wheel"))))


@pytest.fixture(scope="session")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, unpacked to a place without the source tree."""
    place = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(place)
    return place
