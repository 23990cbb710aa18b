"""Show from the EDS of a drive whether and how it can be used.

fffo-drive drive-info FILE.eds                 modes, PDO mappings, missing objects, a drive section for an axis file
fffo-drive drive-info FILE.eds --profile OUT   ... and write the profile of its family, for drive.profile

All unmet requirements are listed, with the keys of an axis file that work around them; the section has these keys.
Nothing is sent. Exit code 0 if the drive can be used, with these keys if need be, or the file does not say; 78 if no
key helps.
"""

from __future__ import annotations

import argparse
import json
import textwrap
from pathlib import Path
from typing import Any

from ..config.drive_profile import DriveProfile, profile_for, profile_text, read_profile
from ..config.drive_section import CanopenDriveSection
from ..config.eds_fitness import Fitness, fitness_of, mode_names, snippet
from ..drive.canopen.eds import Eds, default_of, read_eds
from ..drive.canopen.needs import Need, keys_text, mode_text
from .exits import EXIT_BAD_INPUT, EXIT_OK


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("file", metavar="EDS", help="electronic data sheet (CiA 306) of the drive: .eds or .dcf")
    parser.add_argument("--node", type=int, default=1, metavar="ID", help="node id (default: %(default)s)")
    parser.add_argument("--profile", type=Path, metavar="OUT", help="write the profile of the drive's family to OUT")
    parser.add_argument(
        "--without-profile",
        action="store_true",
        help="use only the file, even if the program has a profile of the family",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    eds = read_eds(options.file, options.node)
    device = eds.dictionary.device_information
    known = None if options.without_profile else profile_for(device.vendor_number, device.product_number)
    profile = known[1] if known else None
    fitness = fitness_of(eds, options.node, profile.keys if profile else None, profile.to_fill_in if profile else None)
    if options.json:
        print(json.dumps(_facts(eds, options.node, fitness, known), indent=2))
    else:
        print("\n".join(_lines(eds, options.node, fitness, known)))
    if options.profile is not None and not fitness.refusals:
        options.profile.write_text(profile_text(eds.drive_name, device, fitness), encoding="utf-8")
        read_profile(options.profile)
        if not options.json:
            print(f"\nwrote {options.profile}: name it in the axis file as drive.profile")
    return EXIT_BAD_INPUT if fitness.refusals else EXIT_OK


WIDTH = 80  # columns of a terminal
Known = tuple[str, DriveProfile] | None


def _facts(eds: Eds, node_id: int, fitness: Fitness, known: Known) -> dict[str, Any]:
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
        "needs": [_need(one) for one in (*fitness.proposal.needs, *fitness.proposal.mended)],
        "left_to_the_drive": fitness.open,
        "missing": fitness.welcome_missing,
        "pdos": {pdo.name: pdo.problems for pdo in fitness.pdos},
        "mode": fitness.mode,
        "profile": known[0] if known else None,
        "unit_remarks": fitness.proposal.remarks,
        "bit_rates_hz": fitness.bit_rates_hz,
        "rate_hz": fitness.rate_hz,
        "drive_section": fitness.section,
        "to_fill_in": fitness.to_fill_in,
        "remarks": [str(remark) for remark in eds.remarks],
        "snippet": snippet(eds, node_id, fitness, known[0] if known else None),
    }


def _lines(eds: Eds, node_id: int, fitness: Fitness, known: Known) -> list[str]:
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
    lines += [*_verdict(eds, fitness), "", "modes (0x6502):"]
    modes = None if fitness.modes is None else ", ".join(mode_names(fitness.modes)) or "none"
    listed = modes or "not in the file; they are read from the drive when it is connected"
    lines += _wrapped(listed, "  ")
    if fitness.refusals:
        return lines + _remarks(eds)
    lines.append(f"  used: {mode_text(fitness.mode)}")
    if known is not None:
        lines += ["", f"profile of its family: {known[0]} ({known[1].family})", f"  tested with: {known[1].tried}"]
        lines += [f"  {remark}" for remark in known[1].remarks]
    units = [f"  {text}" for text in fitness.proposal.remarks]
    section = fitness.section
    if velocity := section.get("velocity_units_per_rps"):
        units.append(f"  one unit of velocity is {1.0 / velocity:.3g} rps")
    if fitness.bit_rates_hz:
        rates = ", ".join(f"{rate / 1e3:g}" for rate in fitness.bit_rates_hz)
        units.append(f"  bit rates (BaudRate_*): {rates} kbit/s")
    bit_rate_hz = section.get("bitrate_hz", CanopenDriveSection.model_fields["bitrate_hz"].default)
    bus = f"the bus (at {bit_rate_hz / 1e3:g} kbit/s)"
    units.append(f"  loop.rate_hz: {fitness.rate_hz}, the highest usual rate that the drive and {bus} take")
    if units:
        lines += ["", "units, rate and axes:", *units]
    lines += ["", "PDO mappings that the program sets up:"]
    for pdo in fitness.pdos:
        state = "; ".join(pdo.problems) or "possible"
        lines.append(f"  {pdo.name}  {pdo.objects:<16}  {pdo.purpose}: {state}")
    if fitness.welcome_missing:
        lines += [
            "",
            "optional objects that it lacks:",
            *(f"  {text}" for text in fitness.welcome_missing),
        ]
    text = snippet(eds, node_id, fitness, known[0] if known else None)
    return lines + _remarks(eds) + ["", "for an axis file (`fffo-drive config check` reads it):", "", text]


def _remarks(eds: Eds) -> list[str]:
    """What of the file is not as the standard has it."""
    if not eds.remarks:
        return []
    head = f"the file departs from CiA 306 ({len(eds.remarks)}):"
    return ["", head, *(f"  {remark}" for remark in eds.remarks)]


def _verdict(eds: Eds, fitness: Fitness) -> list[str]:
    """Whether it can be used, and all unmet requirements."""
    if fitness.refusals:
        lines = [f"cannot be used: {eds.drive_name}", *(f"  {text}" for text in fitness.refusals)]
    else:
        keys = f" with {keys_text(fitness.keys)}" if fitness.keys else ""
        condition = f" if it has {', '.join(fitness.open)}: the file does not say" if fitness.open else ""
        lines = _wrapped(f"can be used{keys}{condition or ', as far as the file says'}", "")
    choices = [need for need in fitness.proposal.needs if need.choice]
    if fitness.proposal.mended or choices:
        lines += ["", "unmet requirements, and the key that works around each:"]
        for need in (*fitness.proposal.mended, *choices):
            lines += _wrapped(need.text, "  ")
            keys = ", ".join(need.keys) + f": {need.choice}" if need.choice else keys_text(need.keys)
            lines += _wrapped(f"-> {keys}", "    ")
    return lines


def _need(need: Need) -> dict[str, Any]:
    return {"text": need.text, "keys": {} if need.choice else dict(need.keys), "to_decide": need.choice}


def _wrapped(text: str, indent: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent + "  ", break_on_hyphens=False)
