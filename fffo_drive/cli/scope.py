"""Print the address of a daemon's scope page (fffo-drive serve --scope PORT), with the key that permits commands.

Only users of the daemon's control socket can read the key; without it the page is read-only and has no Stop.
--role prints an address with fewer rights, and --name one with a name for the daemon's log.
--viewers prints the address for Foxglove, Lichtblick and PlotJuggler (serve --foxglove PORT) and the key for services.
Through ssh: ssh -L PORT:127.0.0.1:PORT HOST, with the same PORT on both sides.
"""

from __future__ import annotations

import argparse
import sys
import webbrowser
from pathlib import Path

from ..daemon.client import ClientError
from ..daemon.serving import find_socket
from ..documents import DocumentError
from ..live.keys import LONGEST_NAME, Keys
from ..live.places import TOKEN_FILE, URL_FILE, VIEWERS_FILE
from ..roles import ROLES
from .exits import EXIT_UNAVAILABLE


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("--axis", metavar="NAME", help="which daemon: name of its directory (vcan0, bench)")
    parser.add_argument("--sockets", metavar="DIR", help="directory of the daemon's sockets")
    parser.add_argument("--open", action="store_true", help="open the page in a browser on this machine")
    parser.add_argument("--watch", action="store_true", help="print the address without the key: read-only")
    parser.add_argument("--role", choices=ROLES, default=ROLES[-1], help="rights of the address (%(default)s)")
    parser.add_argument("--name", metavar="NAME", help="user of the address, for the daemon's log")
    parser.add_argument(
        "--viewers", action="store_true", help="print the WebSocket address for Foxglove and others, and the key"
    )


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    try:
        directory = find_socket(options.axis, options.sockets, watching=True).parent
        url, key = _url(directory, options.viewers), "" if options.watch else key_of(directory, options)
    except ClientError as error:
        print(f"fffo-drive scope: {error}", file=sys.stderr)
        return EXIT_UNAVAILABLE
    if options.viewers:
        print(url)
        print(f"key for services: {key}" if key else "without the key: to look, and nothing else")
        return 0
    url = f"{url}#{key}" if key else url
    print(url)
    if options.open:
        webbrowser.open(url)
    return 0


def _url(directory: Path, viewers: bool) -> str:
    """Where it is served. Raises ClientError where it is not."""
    name, option, what = (
        (VIEWERS_FILE, "--foxglove", "no WebSocket for viewers") if viewers else (URL_FILE, "--scope", "no scope")
    )
    try:
        return (directory / name).read_text(encoding="utf-8").strip()
    except OSError:
        text = f"{directory}: this daemon serves {what}; start it with fffo-drive serve AXIS {option} PORT"
        raise ClientError(text) from None


def key_of(directory: Path, options: argparse.Namespace) -> str:
    """The key of a role, with a name before it where one is given; empty where it may not be read."""
    try:
        keys = Keys((directory / TOKEN_FILE).read_text(encoding="utf-8").strip())
    except OSError as error:
        print(f"without the key, read-only: {TOKEN_FILE} {error.strerror}", file=sys.stderr)
        return ""
    key = f"{options.name}:{keys.of(options.role)}" if options.name else keys.of(options.role)
    if keys.asker(key) is None:
        raise DocumentError(f"--name {options.name}: letters, digits, blanks, '.' and '-', at most {LONGEST_NAME}")
    return key
