"""Serve one axis on a bus: connect, keep it connected, supervise, record, and listen on a Unix socket (fffo-drive ctl).

Runs in the foreground until SIGTERM or Ctrl-C, which stop the axis in order. SIGHUP reads the file again. Under systemd
it is `fffo-drive@NAME.service`; by hand its sockets are in $XDG_RUNTIME_DIR/fffo-drive/NAME.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ..daemon.service import Options, serve


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("config", metavar="AXIS", help="axis file (YAML) of a drive on a bus")
    parser.add_argument("--bus", help="bus instead of the file's: socketcan:can0, loopback:PORT")
    parser.add_argument("--sockets", metavar="DIR", help="directory of control.sock and watch.sock")
    parser.add_argument("--uncommissioned", action="store_true", help="enable a drive without a commissioning record")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    sockets = Path(options.sockets) if options.sockets else None
    serve(Options(Path(options.config), options.bus, sockets, options.uncommissioned))
    return 0
