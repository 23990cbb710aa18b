"""What the manual takes from the code and from the tables of the source tree when it is built."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from .building import SCRIPTS, SOURCE_TREE
from .figures import draw_all
from .reference import pages

PICTURES = SOURCE_TREE / "tools" / "pictures"
TABLES = SOURCE_TREE / "tools" / "tables"
RESULTS = SOURCE_TREE / "tools" / "benchmarks" / "results"
LINK = re.compile(r"\]\((?!https?://|#)([^)]+)\)")


def write_generated(source: Path) -> None:
    """Write all generated pages and pictures below the copied sources."""
    draw_all(source / "figures", SOURCE_TREE / "configs", RESULTS)
    reference = source / "reference"
    for name, text in pages().items():
        (reference / f"{name}.md").write_text(text, encoding="utf-8")
    shutil.copytree(SOURCE_TREE / "configs", source / "configs", ignore=shutil.ignore_patterns("*.md"))
    (source / "pictures").mkdir()
    for picture in PICTURES.glob("*.png"):
        shutil.copy(picture, source / "pictures")
    for folder, origin in (("tables", TABLES), ("results", RESULTS)):
        _copy_pages(origin, source / folder)
    (source / "howto" / "mistakes.md").write_text(mistakes((TABLES / "bad_input.md").read_text(encoding="utf-8")))
    if SCRIPTS.is_dir():
        shutil.copytree(SCRIPTS, source / "scripts", ignore=shutil.ignore_patterns("__pycache__"))
    (source / "tutorial" / "library.md").write_text(library(source / "scripts"), encoding="utf-8")


def _copy_pages(origin: Path, folder: Path) -> None:
    """Copy tables of the source tree; links that lead out of the manual become plain text."""
    folder.mkdir()
    for path in origin.iterdir():
        if path.suffix != ".md":
            shutil.copy(path, folder)
            continue
        text = LINK.sub(
            lambda found: found[0] if (origin / found[1].partition("#")[0]).is_file() else "]",
            path.read_text(encoding="utf-8"),
        )
        (folder / path.name).write_text(f"---\norphan: true\n---\n\n{text}", encoding="utf-8")


def mistakes(text: str) -> str:
    """The page of mistakes: one section for each, from the table that runs every one of them."""
    lines = [
        "# What a mistake looks like",
        "",
        (
            "Each line was run; a test keeps this page current. `axis.yaml` is an axis in process, "
            "`bus.yaml` one on CANopen."
        ),
        "Search this page for a word of the message that you see.",
        "",
    ]
    for line in text.splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip().strip("|"))]
        if not line.startswith("| ") or len(cells) != 4 or cells[0] in ("mistake", "---"):
            continue
        mistake, command, code, message = (cell.replace("\\|", "|") for cell in cells)
        shown = message.replace("<br>", "\n").replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
        lines += [
            f"## {mistake[:1].upper()}{mistake[1:]}",
            "",
            f"{command}, exit code {code}:",
            "",
            "```text",
            shown,
            "```",
            "",
        ]
    return "\n".join(lines)


def library(scripts: Path) -> str:
    """The chapter on the library, with each script that ships."""
    found = sorted(scripts.glob("*.py")) if scripts.is_dir() else []
    lines = [
        "# Using the library",
        "",
        "The commands are functions of the package. A script or a notebook imports them:",
        "",
        "```python",
        "import fffo_drive",
        "```",
        "",
    ]
    if not found:
        lines += LIBRARY_TODAY
    for path in found:
        title = path.stem.replace("_", " ")
        lines += [
            f"## {title[:1].upper()}{title[1:]}",
            "",
            f"```{{literalinclude}} ../scripts/{path.name}",
            ":language: python",
            "```",
            "",
        ]
    return "\n".join([*lines, "The layout of the package is described in {doc}`/explanation/house`.", ""])


LIBRARY_TODAY = """\
## Read a recording

```python
from fffo_drive.recording.reader import read_run

run = read_run("runs/first.mcap")
time_s, velocity_rps = run.columns["time_s"], run.columns["velocity_rps"]
```

Every column of {doc}`/reference/signals` is a NumPy array. All arrays have the same length, so
`pandas.DataFrame(run.columns)` works where pandas is installed.

## Fit a model to arrays or a data frame

```python
from fffo_drive.identification.fit import FitSettings, fit_records
from fffo_drive.importing.frames import record_of

record, facts, found = record_of(frame, torque_constant_nm_per_a=0.13)
fit = fit_records([record], FitSettings(), facts)
```

`frame` is a dictionary of arrays, or a frame of pandas or polars. `found` says which column was taken for which signal.
""".splitlines()
