"""Run the simulated drive as a CANopen node on a bus, until SIGTERM or Ctrl-C.

FILE describes plant, effects, device and node (configs/simulated_drive.yaml). Prints one line when it is ready.
"""

from __future__ import annotations

import argparse
import dataclasses
import signal
import threading
from typing import Any

from ..can.link import open_link
from ..config.simulated import read_simulated
from ..drive.simulated.node.process import run_node


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("file", metavar="FILE", help="simulated drive (YAML)")
    parser.add_argument(
        "--bus", default="loopback:29500", help="socketcan:vcan0 or loopback:PORT (default: %(default)s)"
    )
    parser.add_argument("--node", type=int, metavar="ID", help="node id instead of the file's")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    config = read_simulated(options.file)
    if options.node is not None:
        config = dataclasses.replace(config, node_id=options.node).validate()
    stop = threading.Event()

    def leave(signal_number: int, frame: Any) -> None:
        stop.set()

    signal.signal(signal.SIGTERM, leave)
    signal.signal(signal.SIGINT, leave)
    with open_link(options.bus) as link:
        run_node(config, link, stop)
    return 0
