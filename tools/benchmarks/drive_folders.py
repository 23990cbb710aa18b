"""Folders of simulated drives, as shared/data/blind or as `tools/benchmarks/blind generate` writes them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple


class DriveFolder(NamedTuple):
    """One drive: its logs, and its truth where there is one."""

    name: str
    logs: Path
    truth: dict[str, Any] | None

    @property
    def effects(self) -> str:
        """What is in it, for a table."""
        if self.truth is None:
            return "unknown"
        return ", ".join(f"`{effect['name']}`" for effect in self.truth["effects"]) or "nothing"


def drive_folders(paths: Sequence[Path]) -> list[DriveFolder]:
    """All drives of these folders. Raises FileNotFoundError for a folder without one."""
    found: list[DriveFolder] = []
    for path in paths:
        generated = (path / "logs").is_dir()
        logs = sorted(file.parent for file in (path / "logs" if generated else path).glob("*/drive.yaml"))
        if not logs:
            raise FileNotFoundError(f"{path}: no drive in it; give a folder of drives, or what `generate` wrote")
        for folder in logs:
            truth = path / "truth" / f"{folder.name}.json"
            known = json.loads(truth.read_text()) if generated and truth.exists() else None
            found.append(DriveFolder(f"{path.name}/{folder.name}", folder, known))
    return found
