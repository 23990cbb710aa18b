"""What we can and cannot do with a drive, as far as its EDS says: modes, objects, PDO mappings, scales, rates.

Nothing here asks the drive. What the file leaves open stays open; bring-up checks it on the drive itself, against the
same needs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

from ..drive.canopen.config import CanopenDriveConfig, bus_carries
from ..drive.canopen.eds import Eds, FileObjects, bit_rates_hz, eds_needs, left_to_the_drive, rates_hz, supported_modes
from ..drive.canopen.needs import MODE_NAMES, VENDOR_MODES, Need, keys_text, pdos_of, yaml_text
from .drive_proposal import (
    SNIPPET_BUS,
    USUAL_RATES_HZ,
    DriveProposal,
    config_of,
    open_units,
    propose,
    section_lines,
)
from .drive_section import CanopenDriveSection, merged

# objects that we use where a drive has them, and what for
WELCOME = {
    (0x1006, 0): "the drive knows the SYNC period",
    (0x1400, 5): "the drive detects missing commands",
    (0x605A, 0): "how a quick stop brakes",
    (0x605E, 0): "how the drive reacts to a fault",
    (0x6072, 0): "a torque limit in the drive",
    (0x6075, 0): "the rated current is compared",
    (0x6076, 0): "the rated torque is compared",
    (0x6080, 0): "a speed limit in the drive",
    (0x60C2, 1): "the drive knows the control period",
}
# keys that every axis needs, and where their values are found
TO_FILL_IN = {
    "counts_per_rev": "increments of 0x6064 per revolution (quadrature: four times the lines): see the drive's manual",
    "velocity_units_per_rps": "0x606C at one revolution per second: see the drive's manual",
    "rated_torque_nm": "0x6076, from the motor's data sheet",
}
FILL_IN = "fill in: "  # before what a user must give
TURNAROUND_S = CanopenDriveSection.model_fields["turnaround_us"].default * 1e-6


class PdoFitness(NamedTuple):
    """One PDO that we want."""

    name: str  # RPDO1
    purpose: str
    objects: str
    problems: tuple[str, ...]


class Fitness(NamedTuple):
    """The whole answer. The drive can be used as far as the file says when `refusals` is empty."""

    modes: int | None
    mode: int  # that we would use
    refusals: tuple[str, ...]  # what no key mends
    proposal: DriveProposal  # with all that its keys mend
    open: tuple[str, ...]  # what the drive must have, and the file does not say
    welcome_missing: tuple[str, ...]
    pdos: tuple[PdoFitness, ...]
    section: dict[str, Any]  # keys of an axis file's drive section: the profile's, then what the file tells
    to_fill_in: dict[str, str]  # key, of a mapping key.key -> where its value is found
    bit_rates_hz: tuple[int, ...]  # that the file names; empty: none
    rate_hz: int  # the highest usual rate of the loop that drive and bus take

    @property
    def keys(self) -> dict[str, Any]:
        """Keys without which the drive cannot be used."""
        names = dict.fromkeys(key for need in self.proposal.mended for key in need.keys)
        return {name: self.proposal.section[name] for name in names}


def fitness_of(
    eds: Eds, node_id: int, base: Mapping[str, Any] | None = None, to_fill_in: Mapping[str, str] | None = None
) -> Fitness:
    """What the service could do with this drive under this node-ID.

    `base`, `to_fill_in`: the drive section from its profile, and where the values are found that it leaves open.
    """
    dictionary = eds.dictionary
    proposal = propose(FileObjects(dictionary), node_id, partial(eds_needs, dictionary), base)
    section = merged(base or {}, proposal.section)
    config = config_of(section, node_id)
    refusals = [need.text for need in proposal.needs if not need.choice]
    rate_hz = _highest_rate_hz(dictionary, section, node_id)
    if rate_hz is None and not refusals:
        bus = f"at {config.bitrate_hz / 1e3:g} kbit/s the bus has no time for {USUAL_RATES_HZ[-1]} Hz"
        refusals.append(f"{bus}: SYNC, feedback and command do not fit into a period")
    return Fitness(
        modes=supported_modes(dictionary),
        mode=config.mode,
        refusals=tuple(dict.fromkeys(refusals)),
        proposal=proposal,
        open=tuple(left_to_the_drive(dictionary, config)),
        welcome_missing=tuple(_welcome_missing(dictionary)),
        pdos=tuple(_pdos(config, proposal.needs)),
        section=section,
        to_fill_in=_to_fill_in(section, proposal.needs, to_fill_in or {}),
        bit_rates_hz=tuple(bit_rates_hz(dictionary)),
        rate_hz=rate_hz or USUAL_RATES_HZ[-1],
    )


def _to_fill_in(section: Mapping[str, Any], needs: tuple[Need, ...], told: Mapping[str, str]) -> dict[str, str]:
    """Keys that the axis file must give. `told`: what the profile tells of them."""
    found = {key: need.choice for need in needs if need.choice for key in need.keys}
    for key, index in open_units(section).items():
        found[f"{key}.units_per_a"] = (
            f"units of 0x{index:04X} per ampere of torque-forming current (amplitude): see this object in the drive's "
            "manual"
        )
    found |= {key: text for key, text in TO_FILL_IN.items() if key not in section}
    if "resolver_bits" in section:
        found.pop("counts_per_rev", None)
    return {key: told.get(key, text) for key, text in found.items()}


def _highest_rate_hz(dictionary: Any, section: Mapping[str, Any], node_id: int) -> int | None:
    """The highest usual rate that the drive takes and that the bus has time for; None: there is none."""
    taken = rates_hz(dictionary)
    limit_hz = section.get("highest_rate_hz") or USUAL_RATES_HZ[0]
    usual = [rate for rate in USUAL_RATES_HZ if rate <= limit_hz and rate in taken]
    rates = usual or [rate for rate in reversed(taken) if rate <= limit_hz]
    return next((rate for rate in rates if bus_carries(config_of(section, node_id, rate), TURNAROUND_S)), None)


def _pdos(config: CanopenDriveConfig, needs: tuple[Need, ...]) -> Iterator[PdoFitness]:
    purposes = (
        "command with each SYNC",
        "motion with each SYNC",
        f"status and torque with every {config.status_every}th SYNC",
        "status on change",
    )
    for (kind, _, pdo), purpose in zip(pdos_of(config), purposes, strict=False):
        name = f"{kind}{pdo.number}"
        said = tuple(need.text.removeprefix(f"{name}: ") for need in needs if need.text.startswith(name))
        yield PdoFitness(name, purpose, ", ".join(f"0x{item.index:04X}" for item in pdo.objects), said)


def mode_names(modes: int) -> list[str]:
    """Names of the bits of 0x6502."""
    names = [MODE_NAMES.get(bit + 1, f"mode {bit + 1}") for bit in range(VENDOR_MODES) if modes >> bit & 1]
    return names + ["manufacturer's modes"] * bool(modes >> VENDOR_MODES)


def snippet(eds: Eds, node_id: int, fitness: Fitness, profile: str | None = None) -> str:
    """The drive section of an axis file, as far as the EDS fills it; keys from its profile need not stand in it.

    Beside it the loop section, where drive or bus do not take the loop's default rate.
    """
    lines = ["drive:", "  kind: canopen", f"  bus: {SNIPPET_BUS}", f"  node_id: {node_id}"]
    lines.append(f"  eds: {yaml_text(eds.path)}")
    if profile is not None:
        lines.append(f"  profile: {yaml_text(profile)}")
    blank = fitness.to_fill_in
    nested = dict.fromkeys(key.partition(".")[0] for key in blank if "." in key)
    kept = {key: value for key, value in fitness.proposal.section.items() if key not in nested}
    lines += section_lines(fitness.proposal._replace(section=kept))
    for key in nested:
        lines.append(f"  {key}:")
        known = fitness.proposal.section.get(key, {})
        lines += [f"    {keys_text({name: value})}" for name, value in known.items()]
        lines += [f"    {name}:   # {FILL_IN}{text}" for outer, name, text in _inner(blank) if outer == key]
    lines += [f"  {key}:   # {FILL_IN}{text}" for key, text in blank.items() if "." not in key]
    if fitness.rate_hz != USUAL_RATES_HZ[0]:
        why = "the highest usual rate that drive and bus take"
        lines += ["loop:", f"  rate_hz: {fitness.rate_hz}   # {why}"]
    return "\n".join(lines)


def _inner(blank: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:
    """(key, key in it, text) of the keys inside a mapping."""
    for key, text in blank.items():
        outer, _, inner = key.partition(".")
        if inner:
            yield outer, inner, text


def _welcome_missing(dictionary: Any) -> Iterator[str]:
    for (index, sub), purpose in WELCOME.items():
        if dictionary.get_variable(index, sub) is None:
            yield f"0x{index:04X}:{sub:02X}: {purpose}"
