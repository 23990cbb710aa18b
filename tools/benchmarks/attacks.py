"""Attacks on the service and its bus, each a number of times: who can move the axis that should not?"""

from __future__ import annotations

from collections.abc import Callable

from common import Report, Section, finish, main, parser
from foreign_frames import foreign_frames
from motion_after_stop import motion_after_stop

from fffo_drive.daemon.client import ClientError

NAME = "attacks"
RACES, SAMPLE_RACES = 1000, 4
# each with the number of races of a kind
SECTIONS: tuple[Callable[[int, int], Section], ...] = (motion_after_stop, foreign_frames)


def run() -> int:
    """The command."""
    options = parser(NAME, __doc__ or "", 1, 1)
    options.add_argument("--races", type=int, help=f"of each kind (default {RACES}; {SAMPLE_RACES} with --sample)")
    options.add_argument("--side-by-side", type=int, default=1, metavar="N", help="kinds of races at a time (1)")
    options.add_argument("--only", metavar="TEXT", help="sections whose name contains this, with _ between its words")
    chosen = options.parse_args()
    count = chosen.races or (SAMPLE_RACES if chosen.sample else RACES)
    report = Report(
        NAME, "Attacks on the service at 2 kHz on the loopback bus, the simulated drive a process of its own."
    )
    for make in SECTIONS:
        if not chosen.only or chosen.only in make.__name__:
            report.add(make(count, chosen.side_by_side))
    return finish(report, chosen)


if __name__ == "__main__":
    main(run, RuntimeError, ClientError)
