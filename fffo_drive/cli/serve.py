"""Serve one axis on a bus: connect, keep it connected, supervise, record, and listen on Unix sockets (fffo-drive ctl).

Runs in the foreground until SIGTERM or Ctrl-C; both brake the axis to standstill before the program ends. SIGHUP reads
the axis file again. Under systemd it is `fffo-drive@NAME.service`; started by hand, its sockets are in
$XDG_RUNTIME_DIR/fffo-drive/NAME.

With --scope (or daemon.scope in the axis file) it also serves a page for a browser, with --foxglove (daemon.foxglove) a
WebSocket for Foxglove, Lichtblick and PlotJuggler, on this machine only unless you give an address. `fffo-drive scope`
prints the address.
"""

from __future__ import annotations

import argparse
import errno
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..config.address import Address, address_of, sandbox_problem
from ..daemon.parameters import METHODS
from ..daemon.places import CONTROL
from ..daemon.service import AttachedService, Options, serve
from ..daemon.supervisor import Supervisor
from ..documents import DocumentError
from ..extras import needs_extra


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("config", metavar="AXIS", help="axis file (YAML) of a drive on a bus")
    parser.add_argument("--bus", help="bus instead of the file's: socketcan:can0, loopback:PORT")
    parser.add_argument("--sockets", metavar="DIR", help="directory of control.sock and watch.sock")
    parser.add_argument("--uncommissioned", action="store_true", help="enable a drive without a commissioning record")
    where: dict[str, Any] = {"metavar": "[HOST:]PORT", "type": _address}
    parser.add_argument(
        "--scope", help="address of the scope page (default HOST: 127.0.0.1; port 0: a free one)", **where
    )
    parser.add_argument("--foxglove", help="address of the WebSocket for Foxglove, Lichtblick, PlotJuggler", **where)


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    sockets = Path(options.sockets) if options.sockets else None
    attach = partial(_attach, options.scope, options.foxglove)
    serve(Options(Path(options.config), options.bus, sockets, options.uncommissioned, attach))
    return 0


def _address(text: str) -> Address:
    try:
        return address_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _attach(
    scope: Address | None, foxglove: Address | None, supervisor: Supervisor, directory: Path
) -> AttachedService | None:
    """Put the live server beside a daemon, where it is wanted. Raises DocumentError, OSError."""
    section = supervisor.plan.axis.daemon
    if scope is None and section.scope is not None:
        scope = address_of(section.scope)
    if foxglove is None and section.foxglove is not None:
        foxglove = address_of(section.foxglove)
    if scope is None and foxglove is None:
        return None
    if find_spec("websockets") is None:
        raise DocumentError(needs_extra("serving the scope or Foxglove", "live"))
    from ..live.feed import FeedSource
    from ..live.server import LiveServer, WantedServices

    def source() -> FeedSource | None:
        connection, plan = supervisor.connection, supervisor.plan
        if connection is None:
            return None
        constant = plan.model.torque_constant_nm_per_a
        return FeedSource(connection.number, connection.session.ring, plan.axis.loop.rate_hz, constant)

    name = supervisor.plan.axis.name
    server = LiveServer(WantedServices(scope, foxglove), directory, CONTROL, source, METHODS, name)
    try:
        server.start()
    except OSError as error:
        closed = [problem for address in (scope, foxglove) if address and (problem := sandbox_problem(address))]
        if error.errno == errno.EAFNOSUPPORT and closed:  # the sandbox refuses the address's whole family
            raise DocumentError("; ".join(closed)) from error
        raise
    return server
