"""Check whether this machine can run the loop: kernel, limits, CPU, interrupts, CAN interface.

fffo-drive doctor                 with the defaults of an axis file, and every CAN interface
fffo-drive doctor AXIS            for one axis: its rate, priority, CPU, bus and bit rate
fffo-drive doctor --record DIR    also save the data read to DIR; `--root DIR` checks them again, on any machine

Each line is ok, a warning or a failure, with the command that helps. Nothing is changed. For a few seconds it measures
how late a thread with the loop's priority and CPU wakes; measure for longer, under the usual load, before you rely on
it. Meanwhile it listens on the bus of the axis, without sending, for other masters and for the nodes there.

exit codes: 0 no failure, 1 one or more failures, 74 DIR cannot be read or written, 78 bad axis file
"""

from __future__ import annotations

import argparse
import errno
from pathlib import Path
from typing import TYPE_CHECKING

from ..system.doctor import as_json, as_text, counts, examine
from ..system.findings import HostFinding, Severity, Wanted
from ..system.host import Host
from .exits import EXIT_REFUSED

if TYPE_CHECKING:
    from ..system.bus_masters import BusMasters


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument(
        "axis", metavar="AXIS", nargs="?", help="axis file (default: the default values of an axis file)"
    )
    parser.add_argument("--bus", help="bus instead of the file's: socketcan:can0")
    parser.add_argument(
        "--seconds", type=_seconds, default=3.0, metavar="S", help="seconds of lateness measurement (3; 0: none)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--root", default="/", metavar="DIR", help="check what --record saved on another machine; nothing is measured"
    )
    parser.add_argument("--record", metavar="DIR", help="save all data read to DIR")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    if not Path(options.root).is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "no such directory: it is what `doctor --record` wrote", options.root)
    wanted = wanted_of(options.axis, options.bus)
    host = Host(options.root)
    findings = examine(host, wanted)
    if host.live:
        masters = bus_masters_of(options.axis, options.bus, options.seconds)  # hears while lateness is measured
        findings += _of_this_process(wanted, options.seconds)
        findings += masters.findings() if masters is not None else []
    if options.record:
        host.write_record(Path(options.record))
    print(as_json(findings) if options.json else as_text(findings))
    return EXIT_REFUSED if counts(findings)[Severity.FAILURE] else 0


def wanted_of(path: str | None, bus: str | None) -> Wanted:
    """What an axis file asks of the machine. Raises DocumentError."""
    if path is None:
        return Wanted(bus=bus)
    from ..config.axis import loop_config, read_axis, realtime_request
    from ..config.drive_section import CanopenDriveSection

    axis = read_axis(path)
    request = realtime_request(axis)
    drive = axis.drive if isinstance(axis.drive, CanopenDriveSection) else None
    return Wanted(
        axis.loop.rate_hz,
        request.priority,
        request.cpu,
        request.lock_memory,
        bus or (drive.bus if drive else None),
        drive.bitrate_hz if drive else Wanted().bitrate_hz,
        loop_config(axis).late_ns / loop_config(axis).period_ns,
    )


def bus_masters_of(path: str | None, bus: str | None, seconds: float) -> BusMasters | None:
    """Begin to listen to the bus of an axis file; None where it has none. Raises DocumentError, MappingError."""
    if path is None:
        return None
    from ..config.axis import read_axis
    from ..config.drive_section import CanopenDriveSection
    from ..system.bus_masters import BusMasters
    from ..units import NS_PER_S

    axis = read_axis(path)
    if not isinstance(axis.drive, CanopenDriveSection):
        return None
    no_scale = 1.0  # who is who takes identifiers alone
    config = axis.drive.drive_config(no_scale, NS_PER_S // axis.loop.rate_hz, bus)
    return BusMasters(config, max(seconds, config.listen_s))


def _of_this_process(wanted: Wanted, seconds: float) -> list[HostFinding]:
    from ..jit import cache_directory, kernel_digest
    from ..system.compiled import cache_findings
    from ..system.lateness import lateness_findings, measure_lateness

    findings = cache_findings(cache_directory(), kernel_digest())
    if seconds > 0.0:
        findings += lateness_findings(measure_lateness(wanted, seconds), wanted)
    return findings


def _seconds(text: str) -> float:
    seconds = float(text)
    if not 0.0 <= seconds <= 86_400.0:
        raise argparse.ArgumentTypeError(f"{text} is outside 0 .. 86400")
    return seconds
