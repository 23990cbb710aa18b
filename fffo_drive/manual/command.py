"""Open the manual: static pages with search, which need no network.

fffo-drive manual              opens it in the browser, and builds it first where that is needed
fffo-drive manual --path       prints where the page is
fffo-drive manual --build DIR  builds it into a directory (extra `manual`)
"""

from __future__ import annotations

import argparse
import sys
import webbrowser
from pathlib import Path

from ..cli.exits import EXIT_UNAVAILABLE
from .building import ManualError, build, cache_directory, find


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("--path", action="store_true", help="print the path of the first page, and open nothing")
    parser.add_argument("--build", metavar="DIR", type=Path, help="build the pages into this directory")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    try:
        return _open(options)
    except ManualError as error:
        print(f"fffo-drive manual: {error}", file=sys.stderr)
        return EXIT_UNAVAILABLE


def _open(options: argparse.Namespace) -> int:
    if options.build is not None:
        print(build(options.build.absolute()))
        return 0
    page = find() or build(cache_directory())
    print(page)
    if not options.path and not webbrowser.open(page.as_uri()):
        print("no browser could be started: open this file in one")
    return 0
