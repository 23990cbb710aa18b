"""Say where the scope page of a daemon is (fffo-drive serve --scope PORT), with the key that lets it command.

Whoever may use the daemon's control socket reads the key; others get the page to look at, where Stop works too.
Through ssh: ssh -L PORT:127.0.0.1:PORT HOST, with one and the same PORT.
"""

from __future__ import annotations

import argparse
import sys
import webbrowser

from ..daemon.client import ClientError
from ..live.places import TOKEN_FILE, URL_FILE
from .ctl import find_socket
from .exits import EXIT_UNAVAILABLE


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("--axis", metavar="NAME", help="which daemon: name of its directory (vcan0, bench)")
    parser.add_argument("--sockets", metavar="DIR", help="directory of the daemon's sockets")
    parser.add_argument("--open", action="store_true", help="open it in the browser of this machine")
    parser.add_argument("--watch", action="store_true", help="without the key: to look, and to stop")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    try:
        url = address(options)
    except ClientError as error:
        print(f"fffo-drive scope: {error}", file=sys.stderr)
        return EXIT_UNAVAILABLE
    print(url)
    if options.open:
        webbrowser.open(url)
    return 0


def address(options: argparse.Namespace) -> str:
    """The address of the page. Raises ClientError where there is none."""
    directory = find_socket(options, watching=True).parent
    try:
        url = (directory / URL_FILE).read_text(encoding="utf-8").strip()
    except OSError:
        text = f"{directory}: this daemon serves no scope; start it with fffo-drive serve AXIS --scope PORT"
        raise ClientError(text) from None
    if options.watch:
        return url
    try:
        token = (directory / TOKEN_FILE).read_text(encoding="utf-8").strip()
    except OSError as error:
        print(f"without the key, to look and to stop: {TOKEN_FILE} {error.strerror}", file=sys.stderr)
        return url
    return f"{url}#{token}"
