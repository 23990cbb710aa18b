"""The drive of a trace of a CAN bus, from what the user names: an EDS or DCF, a drive profile, an axis file, scales."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..config.drive_profile import SUFFIX, DriveProfile, profile_for, read_profile, shipped_profiles
from ..config.drive_proposal import config_of, open_units
from ..config.drive_section import CanopenDriveSection
from ..documents import DocumentError, parse, read_text
from ..drive.canopen.config import CanopenDriveConfig
from ..drive.canopen.eds import read_eds
from ..importing.source import TraceDrive
from ..units import NS_PER_S

ANY_NODE = 1  # of an EDS of which only the vendor is asked for
SCALES = ("counts_per_rev", "velocity_units_per_rps", "rated_torque_nm", "rated_current_a")


def trace_drive(
    files: Sequence[str | Path] = (),
    node: str | None = None,
    scales: Mapping[str, float | None] | None = None,
    torque_constant_nm_per_a: float | None = None,
) -> TraceDrive:
    """What is said of it. `files`: EDS or DCF, drive profile (a file, or the name of one that is supplied),
    axis file; `scales`: keys of SCALES.

    Raises DocumentError, MappingError naming the file.
    """
    keys = {key: value for key, value in (scales or {}).items() if value is not None}
    eds: Path | None = None
    found: dict[str, Any] = {}
    for name in map(str, files):
        if name in shipped_profiles():
            found = _of_profile(read_profile(shipped_profiles()[name]), f"the profile {name}")
        elif not name.lower().endswith((SUFFIX, ".yml")):
            eds = Path(name)
        else:
            found = _of_yaml(Path(name))
    if eds is not None and not found:
        device = read_eds(str(eds), ANY_NODE).dictionary.device_information
        known = profile_for(device.vendor_number, device.product_number)
        if known is not None:
            found = {**_of_profile(known[1], f"the profile {known[0]}"), "profile_named": False}
    own = {"keys": {}, "torque_constant_nm_per_a": None} | found
    if torque_constant_nm_per_a is not None:
        own["torque_constant_nm_per_a"] = torque_constant_nm_per_a
    return TraceDrive(node, eds, **{**own, "keys": {**own["keys"], **keys}}, files=tuple(map(str, files)), scales=keys)


def _of_yaml(path: Path) -> dict[str, Any]:
    """A profile or an axis file. Raises DocumentError."""
    from ..config.axis import model_of, read_axis  # loads slowly

    data, _ = parse(read_text(path), str(path))
    if isinstance(data, dict) and "family" in data:
        return _of_profile(read_profile(path), str(path))
    axis = read_axis(path)
    if not isinstance(axis.drive, CanopenDriveSection):
        raise DocumentError(f"{path}: drive.kind: {axis.drive.kind}: no drive on a CAN bus")
    constant = model_of(path, axis).torque_constant_nm_per_a
    config = axis.drive.drive_config(constant, NS_PER_S // axis.loop.rate_hz)
    keys = {key: getattr(config, key) for key in SCALES}
    own = {"config": config, "said": str(path), "node_of_axis": config.node_id}
    return {**own, "keys": keys, "torque_constant_nm_per_a": constant}


def _of_profile(profile: DriveProfile, said: str) -> dict[str, Any]:
    keys = profile.keys
    try:
        config: CanopenDriveConfig = config_of(keys, ANY_NODE)
    except ValidationError as error:
        raise DocumentError(f"{said}: {error}") from error
    open_ones = open_units(keys)  # of the vendor's units that nobody gave: placeholders
    config = replace(
        config,
        target_units_per_a=None if "target" in open_ones else config.target_units_per_a,
        torque_units_per_a=None if "torque_feedback" in open_ones else config.torque_units_per_a,
    )
    known = {key: keys[key] for key in SCALES if key in keys}
    return {"config": config, "said": said, "profile_keys": known, "profile_named": True}
