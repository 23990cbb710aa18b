"""Blind drives: generate them, diagnose them without their truth, and score what was found. See `--help`."""

from __future__ import annotations

from blind_drives.command import parser
from common import main, shown


def run() -> int:
    """One subcommand."""
    options = parser().parse_args()
    with shown(options.command) as progress:
        return int(options.execute(options, progress))


if __name__ == "__main__":
    main(run)
