"""Write the example files: axis files, drives, models, profiles, scenarios and layouts, with comments.

They go to DIR/configs, so that you can copy the manual's commands and run them in DIR. If a file exists and differs
from its example (you edited it, or it is of another version of this program), nothing is written: --missing writes only
the files that are not there, --force replaces all.

After an upgrade, `fffo-drive init --missing` adds the new examples and names the files that differ. To see how an
example differs from yours, write all of them to another DIR and compare: diff -r DIR/configs configs
"""

from __future__ import annotations

import argparse
import itertools
import shlex
from pathlib import Path

from ..documents import DocumentError
from ..system.service_files import example_files

FOLDER = "configs"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("directory", metavar="DIR", nargs="?", default=".", help="where to write (default: here)")
    existing = parser.add_mutually_exclusive_group()
    existing.add_argument("--missing", action="store_true", help="write only files that are not there")
    existing.add_argument("--force", action="store_true", help="replace existing files")
    parser.add_argument("--list", action="store_true", help="list the files, write nothing")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    files = example_files()
    if options.list:
        for name, content in files.items():
            print(f"{FOLDER}/{name}  {_meaning(content)}".rstrip())
        return 0
    target = Path(options.directory) / FOLDER
    changed = [name for name, content in files.items() if _differs(target / name, content)]
    if changed and not (options.force or options.missing):
        raise DocumentError(
            f"these files exist and differ from the examples:\n{_listed(target, changed)}\n"
            "--missing writes only files that are not there, --force replaces these; or choose another DIR"
        )
    written = [name for name in files if not (options.missing and (target / name).exists())]
    for name in written:
        path = target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(files[name])
    if options.missing:
        if written:
            print(f"new:\n{_listed(target, written)}")
        if changed:
            print(f"left alone, since they differ from the examples of this version:\n{_listed(target, changed)}")
        print(f"unchanged examples: {len(files) - len(written) - len(changed)}")
        return 0
    print(f"{len(files)} files in {target}; next:")
    if Path(options.directory) != Path():
        print(f"cd {shlex.quote(options.directory)}")
    print(f"fffo-drive run {FOLDER}/axis_simulated.yaml        # one profile on the simulated drive")
    print(
        f"fffo-drive close-the-loop {FOLDER}/axis_undeclared.yaml   # find an undeclared effect and compensate for it"
    )
    print("fffo-drive manual                                  # the tutorial")
    return 0


def _listed(target: Path, names: list[str]) -> str:
    return "\n".join(f"  {target / name}" for name in names)


def _differs(path: Path, content: bytes) -> bool:
    return path.exists() and path.read_bytes() != content


def _meaning(content: bytes) -> str:
    """The first sentence of the comment at a file's head."""
    lines = itertools.takewhile(lambda line: line.startswith("#"), content.decode("utf-8", "replace").splitlines())
    return " ".join(line.lstrip("# ") for line in lines).partition(". ")[0].rstrip(".:")
