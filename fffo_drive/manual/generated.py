"""What the manual takes from the code and from the tables of the source tree when it is built."""

from __future__ import annotations

import inspect
import re
import shutil
from pathlib import Path

import fffo_drive

from .figures import draw_all
from .reference import pages

SCRIPTS = Path(__file__).resolve().parent / "scripts"
LINK = re.compile(r"\]\((?!https?://|#)([^)]+)\)")


def write_generated(source: Path, tree: Path) -> None:
    """Write all generated pages and pictures below the copied sources. `tree`: the source tree."""
    configs, tables, results = tree / "configs", tree / "tools" / "tables", tree / "tools" / "benchmarks" / "results"
    draw_all(source / "figures", configs, results)
    reference = source / "reference"
    for name, text in pages().items():
        (reference / f"{name}.md").write_text(text, encoding="utf-8")
    shutil.copytree(configs, source / "configs", ignore=shutil.ignore_patterns("*.md"))
    (source / "pictures").mkdir()
    for picture in (tree / "tools" / "pictures").glob("*.png"):
        shutil.copy(picture, source / "pictures")
    for folder, origin in (("tables", tables), ("results", results)):
        _copy_pages(origin, source / folder)
    (source / "howto" / "mistakes.md").write_text(mistakes((tables / "bad_input.md").read_text(encoding="utf-8")))
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
    """The chapter on the library: every public name, and each script that ships."""
    lines = [
        "# Using the library",
        "",
        "The commands are functions of the package. A script or a notebook imports them:",
        "",
        "```python",
        "import fffo_drive as fd",
        "",
        'run = fd.simulate("configs/axis_simulated.yaml", toggle="ff")',
        "print(run.metrics.measured)",
        'velocity_rps = run["velocity_rps"]',
        "```",
        "",
        "A run is a set of arrays with units in their names ({doc}`/reference/signals`). It comes from a recording, a",
        "table, arrays of your own, or the simulated drive; `run.to_pandas()` makes a data frame of it. You need no",
        "files: arrays are enough.",
        "",
        "What you change in memory is what `simulate` uses: `axis.change({...})`, another model, `gains=`, a reference",
        "of your own as an array (`profile=`), other effects of the simulated drive (`effects=`), a law of your own",
        "(`controller=`). `fd.write_axis` and `fd.write_model` make files of it, which `run` needs. A simulated minute",
        "takes 0.15 s of processor time, and runs in threads use all cores: the sweep of 50 gains below takes 8 s of",
        "it in all.",
        "",
        "An effect and a control law of your own have chapters: {doc}`own_effect`, {doc}`own_controller`.",
        "",
    ]
    for path in sorted(scripts.glob("*.py")):
        title = path.read_text(encoding="utf-8").partition(":")[0].lstrip('"')  # of its first line
        lines += [
            f"## {title}",
            "",
            f"```{{literalinclude}} ../scripts/{path.name}",
            ":language: python",
            "```",
            "",
        ]
    lines += ["## All names", ""]
    for name in fffo_drive.__all__:
        member = getattr(fffo_drive, name)
        called = f"fd.{name}{inspect.signature(member)}" if inspect.isfunction(member) else f"fd.{name}"
        lines += ["```text", called.replace("'", ""), "```", "", inspect.getdoc(member) or "", ""]
    return "\n".join([*lines, "The layout of the package is described in {doc}`/explanation/house`.", ""])
