"""Run the simulated drive as a CANopen node on a bus, until SIGTERM or Ctrl-C.

FILE describes plant, effects, device and node (configs/simulated_drive.yaml). Prints one line when it is ready.
With --dictionary the node has the objects of another drive, from an EDS, a DCF or a list of objects in YAML. With
--eds it writes the electronic data sheet (CiA 306) of the drive and exits.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from ..can.link import open_link
from ..config.simulated import read_simulated
from ..documents import DocumentError
from ..drive.simulated.node.eds import eds_text
from ..drive.simulated.node.process import run_node, stop_on_signals
from ..drive.simulated.parameters import PlantConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("file", metavar="FILE", help="simulated drive (YAML)")
    parser.add_argument("--bus", default="loopback:29500", help="socketcan:vcan0, loopback:PORT (default: %(default)s)")
    parser.add_argument("--node", type=int, metavar="ID", help="node id instead of the file's")
    parser.add_argument(
        "--dictionary", type=Path, metavar="DRIVE", help="object dictionary of another drive: an EDS, a DCF, or YAML"
    )
    parser.add_argument("--eds", type=Path, metavar="PATH", help="write the drive's EDS to this file; do not run")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    config = read_simulated(options.file)
    if options.node is not None:
        try:
            config = dataclasses.replace(config, node_id=options.node).validate()
        except PlantConfigError as error:
            raise DocumentError(f"--node: {error}") from None
    if options.dictionary is not None:
        from ..drive.simulated.node.read_dictionary import read_dictionary  # brings in canopen

        try:
            config = dataclasses.replace(config, dictionary=read_dictionary(options.dictionary)).validate()
        except PlantConfigError as error:
            raise DocumentError(f"{options.file} with {options.dictionary}: {error}") from None
    if options.eds is not None:
        options.eds.write_text(eds_text(config, options.eds.name), encoding="ascii", errors="replace")
        print(f"wrote {options.eds}")
        return 0
    stop = stop_on_signals()
    with open_link(options.bus) as link:
        run_node(config, link, stop)
    return 0
