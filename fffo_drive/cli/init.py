"""Lay the example files down: axis files, drives, models, profiles, scenarios, layouts, with comments on every key.

They go to DIR/configs, so that the manual's lines work in DIR as they stand. Files that are there and differ are named
and nothing is written; --force replaces them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ..documents import DocumentError
from ..system.service_files import example_files

FOLDER = "configs"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("directory", metavar="DIR", nargs="?", default=".", help="where (default: here)")
    parser.add_argument("--force", action="store_true", help="replace files that are there")
    parser.add_argument("--list", action="store_true", help="say what there is, write nothing")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    files = example_files()
    if options.list:
        for name, content in files.items():
            print(f"{FOLDER}/{name}  {_meaning(content)}".rstrip())
        return 0
    target = Path(options.directory) / FOLDER
    changed = [name for name, content in files.items() if _differs(target / name, content)]
    if changed and not options.force:
        names = "\n".join(f"  {target / name}" for name in changed)
        raise DocumentError(f"there already, and not as laid down:\n{names}\nanother DIR, or --force replaces them")
    for name, content in files.items():
        path = target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    print(f"{len(files)} files in {target}; next:")
    if Path(options.directory) != Path():
        print(f"cd {options.directory}")
    print(f"fffo-drive run {FOLDER}/axis_simulated.yaml        # one profile on the simulated drive")
    print(f"fffo-drive close-the-loop {FOLDER}/axis_undeclared.yaml   # find an undeclared effect, and compensate it")
    print("fffo-drive manual                                  # the tutorial, from here on")
    return 0


def _differs(path: Path, content: bytes) -> bool:
    return path.exists() and path.read_bytes() != content


def _meaning(content: bytes) -> str:
    """The first sentence of a file's first comment."""
    first = content.decode("utf-8", "replace").partition("\n")[0]
    return first.lstrip("# ").partition(". ")[0].rstrip(".:") if first.startswith("#") else ""
