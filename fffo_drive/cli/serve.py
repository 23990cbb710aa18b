"""Serve one axis on a bus: connect, keep it connected, supervise, record, and listen on a Unix socket (fffo-drive ctl).

Runs in the foreground until SIGTERM or Ctrl-C, which stop the axis in order. SIGHUP reads the file again. Under systemd
it is `fffo-drive@NAME.service`; by hand its sockets are in $XDG_RUNTIME_DIR/fffo-drive/NAME. With --scope it also
serves a page for a browser (fffo-drive scope says where), on this machine alone unless an address is given.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from ..daemon.places import CONTROL
from ..daemon.service import Attachment, Options, serve
from ..daemon.supervisor import Supervisor
from ..documents import DocumentError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("config", metavar="AXIS", help="axis file (YAML) of a drive on a bus")
    parser.add_argument("--bus", help="bus instead of the file's: socketcan:can0, loopback:PORT")
    parser.add_argument("--sockets", metavar="DIR", help="directory of control.sock and watch.sock")
    parser.add_argument("--uncommissioned", action="store_true", help="enable a drive without a commissioning record")
    parser.add_argument("--scope", metavar="[HOST:]PORT", help="serve the scope page here; HOST is 127.0.0.1")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    sockets = Path(options.sockets) if options.sockets else None
    attach = _scope(options.scope) if options.scope else None
    serve(Options(Path(options.config), options.bus, sockets, options.uncommissioned, attach))
    return 0


def _scope(where: str) -> Callable[[Supervisor, Path], Attachment]:
    """What puts the scope beside a daemon. Raises DocumentError."""
    try:
        from ..live.server import LiveServer, address_of
    except ModuleNotFoundError as error:
        if error.name != "websockets":
            raise
        raise DocumentError("--scope needs the extra `live`: pip install 'fffo-drive[live]'") from None
    from ..live.feed import Source

    try:
        address = address_of(where)
    except ValueError as error:
        raise DocumentError(f"--scope {error}") from None

    def attach(supervisor: Supervisor, directory: Path) -> Attachment:
        def source() -> Source | None:
            connection, plan = supervisor.connection, supervisor.plan
            if connection is None:
                return None
            constant = plan.model.torque_constant_nm_per_a
            return Source(connection.number, connection.session.ring, plan.axis.loop.rate_hz, constant)

        server = LiveServer(address, directory, CONTROL, source)
        server.start()
        supervisor.log.add("started", f"the scope is on {server.url}; fffo-drive scope gives the address with its key")
        return server

    return attach
