"""Watch a daemon in the terminal: state, ticks, error, current, recorder. It changes nothing; Ctrl-C ends it.

It reads the daemon's read-only socket. Without a terminal, or with --once, it prints one page and exits.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import deque
from typing import Any, NamedTuple

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ..daemon.client import ClientError, DaemonClient
from ..daemon.serving import find_socket
from .exits import EXIT_UNAVAILABLE

STATUS_HZ = 10.0
KEPT = 60  # statuses in the sparklines
KEPT_EVENTS = 8
BARS = " ▁▂▃▄▅▆▇█"
STATE_STYLE = {
    "fault": "bold red",
    "running": "bold green",
    "following": "bold green",
    "enabled": "green",
    "stopping": "yellow",
}
LEVEL_STYLE = {"error": "red", "fatal": "bold red", "warning": "yellow"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("--axis", metavar="NAME", help="which daemon: name of its directory (vcan0, bench)")
    parser.add_argument("--sockets", metavar="DIR", help="directory of the daemon's sockets")
    parser.add_argument("--once", action="store_true", help="print one page and exit")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    try:
        with DaemonClient(find_socket(options.axis, options.sockets, watching=True)) as client:
            view = View(client.call("info"))
            view.see(client.call("status"))
            for event in client.call("events", limit=KEPT_EVENTS)["events"]:
                view.hear(event)
            console = Console()
            if options.once or not console.is_terminal:
                console.print(view.page())
            else:
                _follow(client, view, console)
        return 0
    except ClientError as error:
        print(f"fffo-drive top: {error}", file=sys.stderr)
        return EXIT_UNAVAILABLE


def _follow(client: DaemonClient, view: View, console: Console) -> None:
    client.call("subscribe", status_hz=STATUS_HZ, events=True)
    with Live(view.page(), console=console, screen=True, auto_refresh=False) as live:
        while True:
            message = client.next_notification()
            if message["method"] == "event":
                view.hear(message["params"])
            else:
                view.see(message["params"])
                live.update(view.page(), refresh=True)


class Moment(NamedTuple):
    """What the sparklines and rates are made from."""

    tick: int
    late: int
    error_rps: float
    current_a: float


class View:
    """What has been heard of one daemon, as a page."""

    def __init__(self, info: dict[str, Any]) -> None:
        self._info = info
        self._status: dict[str, Any] = {}
        self._events: deque[dict[str, Any]] = deque(maxlen=KEPT_EVENTS)
        self._moments: deque[Moment] = deque(maxlen=KEPT)

    def see(self, status: dict[str, Any]) -> None:
        """A status, as the API answers it."""
        self._status = status
        motion, loop = status["motion"], status["loop"]
        if motion is None or loop is None:
            self._moments.clear()
            return
        if self._moments and loop["tick"] < self._moments[-1].tick:
            self._moments.clear()  # another connection
        moment = Moment(loop["tick"], loop["late"], motion["error_rps"], motion["current_command_a"])
        self._moments.append(moment)

    def hear(self, event: dict[str, Any]) -> None:
        """An event, as the API sends it."""
        self._events.append(event)

    def page(self) -> Group:
        """Everything, for a terminal of any width."""
        return Group(self._head(), Text(), self._table(), Text(), *self._event_lines())

    def _head(self) -> Text:
        status, info = self._status, self._info
        state = status["state"]
        head = Text(f"{info['axis']}  ", style="bold")
        head.append(state.upper(), style=STATE_STYLE.get(state, "cyan"))
        head.append(f" for {status['state_s']:.0f} s, friction {status['toggle']}, model {status['model']['name']}")
        head.append(f", {info['rate_hz']} Hz")
        if status["fault"]:
            fault = status["fault"]
            head.append(f"\nfault: {fault['text']} ({fault['name']}, tick {fault['tick']})", style="bold red")
        for obstacle in status["obstacles"]:
            head.append(f"\nnot ready: {obstacle}", style="yellow")
        return head

    def _table(self) -> Table:
        table = Table.grid(padding=(0, 2))
        table.add_column(style="dim")
        table.add_column()
        for name, text in self._lines():
            table.add_row(name, text)
        return table

    def _lines(self) -> list[tuple[str, str]]:
        status = self._status
        loop, drive, motion, recording = (status[name] for name in ("loop", "drive", "motion", "recording"))
        lines = []
        if drive is not None:
            lines.append(("drive", f"{drive['name']}: {drive['state']}, statusword 0x{drive['statusword']:04X}"))
        if motion is not None:
            speed = f"{motion['velocity_rps']:9.4f} rps of {motion['reference_rps']:9.4f}"
            lines.append(("velocity", f"{speed}, at {motion['position_rev']:.3f} rev"))
            error = [moment.error_rps for moment in self._moments]
            lines.append(("error", f"{motion['error_rps']:9.4f} rps  {sparkline(error)}"))
            current = [moment.current_a for moment in self._moments]
            asked = f"{motion['current_command_a']:9.4f} A commanded, {motion['current_a']:9.4f} A measured"
            lines.append(("current", f"{asked}  {sparkline(current)}"))
            lines.append(("friction", f"{motion['friction_nm']:9.4f} Nm"))
        if loop is not None:
            lines.append(("ticks", f"{loop['tick']}, {loop['late']} late{self._late_now()}, {loop['skipped']} skipped"))
            wire = ", ".join(f"{count} {name}" for name, count in loop["exchange"].items() if count)
            lines.append(("feedback", f"{loop['missing_feedback']} missing{'; ' + wire if wire else ''}"))
        if status["profile"]:
            profile = status["profile"]
            done = max(0, profile["sample"]) / max(1, profile["samples"])
            lines.append(("profile", f"{profile['name']}, {100.0 * done:.0f} % of {profile['duration_s']:.1f} s"))
        if status.get("set_point"):
            given = status["set_point"]
            lines.append(("set point", f"{given['kind']} to {given['to_rps']:.4g} rps"))
        lines.append(("recorder", _recorder_text(recording)))
        return lines

    def _late_now(self) -> str:
        """Share of late ticks over what the sparklines show."""
        if len(self._moments) < 2:
            return ""
        first, last = self._moments[0], self._moments[-1]
        ticks = last.tick - first.tick
        return f" ({100.0 * (last.late - first.late) / ticks:.2f} % of the last {ticks})" if ticks > 0 else ""

    def _event_lines(self) -> list[Text]:
        return [
            Text(f"{event['time'][11:23]} {event['kind']:12s} {event['text']}", LEVEL_STYLE.get(event["level"], ""))
            for event in self._events
        ]


def _recorder_text(recording: dict[str, Any]) -> str:
    if not recording["on"]:
        return "off"
    trouble = f"; {recording['trouble']}" if recording["trouble"] else ""
    return f"{recording['file']}, {recording['rows_written']} rows, {recording['rows_lost']} lost{trouble}"


def sparkline(values: list[float]) -> str:
    """Magnitudes as bars, the largest one full. NaN is a gap."""
    largest = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    if largest == 0.0:
        return BARS[1] * len(values)
    steps = len(BARS) - 1
    return "".join(
        BARS[max(1, math.ceil(abs(value) / largest * steps))] if math.isfinite(value) else " " for value in values
    )
