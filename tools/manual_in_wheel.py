"""Put the built manual into a wheel: a hook of hatchling.

It needs the extra `manual` and the program's own dependencies, in the environment that builds or in the clone's .venv.
Where neither has them the build fails with the line that installs them; FFFO_DRIVE_WITHOUT_MANUAL=1 in the environment
builds without pages.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

NEEDED = "import sphinx, myst_parser, furo, sphinx_copybutton, matplotlib, numba, pydantic, canopen, mcap"
WITHOUT = (
    "the wheel would have no manual inside: its tools are not installed here. Type `tools/environment test` in the "
    "clone, and build again; for a wheel without a manual set FFFO_DRIVE_WITHOUT_MANUAL=1"
)


class ManualHook(BuildHookInterface):
    """Builds the pages before the wheel, and takes them in."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the pages as fffo_drive/manual/built. Raises RuntimeError where they cannot be made."""
        if version == "editable" or os.environ.get("FFFO_DRIVE_WITHOUT_MANUAL"):
            return
        root = Path(self.root)
        environment = dict(os.environ, PYTHONPATH=str(root))
        candidates = [Path(sys.executable), root / ".venv" / "bin" / "python"]
        for python in candidates:
            if not python.exists():
                continue
            asked = subprocess.run([python, "-c", NEEDED], env=environment, capture_output=True, check=False)
            if asked.returncode != 0:
                continue
            self._pages = tempfile.TemporaryDirectory(prefix="fffo-drive-wheel-")
            out = Path(self._pages.name) / "built"
            command = [python, "-m", "fffo_drive", "manual", "--build", out]
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                raise RuntimeError(f"the manual cannot be built: {done.stderr.strip()}")
            build_data["force_include"][str(out)] = "fffo_drive/manual/built"
            return
        raise RuntimeError(WITHOUT)
