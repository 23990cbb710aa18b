"""Say what we can and cannot do with a drive, from its EDS alone.

fffo-drive drive-info FILE.eds     modes, PDO mappings, objects that are missing, and a drive section for an axis file

Nothing is sent. Exit code 0 when the file speaks for the drive or leaves it open, 78 when it speaks against it.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

from ..drive.canopen.eds import Eds, default_of, read_eds
from ..drive.canopen.eds_fitness import Fitness, fitness_of, has_cyclic_torque, mode_names, snippet
from .exits import EXIT_BAD_INPUT, EXIT_OK


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("file", metavar="EDS", help="electronic data sheet (CiA 306) of the drive: .eds or .dcf")
    parser.add_argument("--node", type=int, default=1, metavar="ID", help="node id (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    eds = read_eds(options.file, options.node)
    fitness = fitness_of(eds, options.node)
    if options.json:
        print(json.dumps(_facts(eds, options.node, fitness), indent=2))
    else:
        print("\n".join(_lines(eds, options.node, fitness)))
    return EXIT_BAD_INPUT if fitness.refusals else EXIT_OK


def _facts(eds: Eds, node_id: int, fitness: Fitness) -> dict[str, Any]:
    device = eds.dictionary.device_information
    return {
        "file": eds.path,
        "drive": eds.drive_name,
        "vendor_number": device.vendor_number,
        "product_number": device.product_number,
        "revision_number": device.revision_number,
        "device_type": default_of(eds.dictionary, 0x1000),
        "modes": None if fitness.modes is None else mode_names(fitness.modes),
        "usable": not fitness.refusals,
        "refusals": fitness.refusals,
        "missing": fitness.welcome_missing,
        "pdos": {pdo.name: pdo.problems for pdo in fitness.pdos},
        "drive_section": fitness.facts,
        "remarks": [str(remark) for remark in eds.remarks],
        "snippet": snippet(eds, node_id, fitness),
    }


def _lines(eds: Eds, node_id: int, fitness: Fitness) -> list[str]:
    device = eds.dictionary.device_information
    identity = [
        f"{name} 0x{value:08X}"
        for name, value in (
            ("vendor", device.vendor_number),
            ("product", device.product_number),
            ("revision", device.revision_number),
        )
        if value is not None
    ]
    lines = [f"{eds.path}: {eds.drive_name}", f"  {', '.join(identity) or 'no identity'}", ""]
    lines += [_verdict(eds, fitness), "", "modes (0x6502):"]
    modes = None if fitness.modes is None else ", ".join(mode_names(fitness.modes)) or "none"
    lines.append(f"  {modes or 'not told by the file; the drive is asked when it is connected'}")
    lines += ["", "PDO mappings that we set up:"]
    for pdo in fitness.pdos:
        state = "; ".join(pdo.problems) or "possible"
        lines.append(f"  {pdo.name}  {pdo.objects:<16}  {pdo.purpose}: {state}")
    if fitness.welcome_missing:
        lines += [
            "",
            "objects that we would use, and that it lacks:",
            *(f"  {text}" for text in fitness.welcome_missing),
        ]
    if eds.remarks:
        lines += ["", f"the file is not as CiA 306 has it ({len(eds.remarks)}):"]
        lines += [f"  {remark}" for remark in eds.remarks]
    if not fitness.refusals:
        lines += ["", "for an axis file (`fffo-drive config check` reads it):", "", snippet(eds, node_id, fitness)]
    return lines


def _verdict(eds: Eds, fitness: Fitness) -> str:
    if fitness.refusals:
        head = f"cannot be used: {eds.drive_name}"
        if has_cyclic_torque(fitness) is False:
            head += " has no cyclic synchronous torque mode"
        return "\n".join([head, *(f"  {text}" for text in fitness.refusals)])
    if has_cyclic_torque(fitness) is None:
        return "can be used if it has cyclic synchronous torque: the file does not say"
    return "can be used, as far as the file says"
