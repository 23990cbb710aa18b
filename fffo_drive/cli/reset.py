"""The option that clears a drive's fault first: the same for every command that can."""

from __future__ import annotations

import argparse


def add_reset_option(parser: argparse.ArgumentParser) -> None:
    """--reset-fault."""
    parser.add_argument(
        "--reset-fault",
        action="store_true",
        help="clear the fault of a drive on a bus first, with one reset; without it such a drive is refused. Remove "
        "the cause before",
    )
