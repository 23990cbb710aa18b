"""Profiles of drive families: defaults of the drive section of an axis file for one family, as data.

A profile holds keys of the drive section. They are the defaults of an axis file that names it, so the file can override
each; entries of `sdo` are joined, and an entry of the file replaces that of the same object, sub-index and phase. What
belongs to one axis (bus, node id, ratings of the motor) is no part of a profile.
"""

from __future__ import annotations

import copy
import functools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, create_model

from .. import formats
from ..documents import DocumentError, StrictRecord, load, refuse
from ..system.service_files import sources
from .drive_section import CanopenDriveSection, merged
from .names import is_file_name

if TYPE_CHECKING:
    from .eds_fitness import Fitness

OF_ONE_AXIS = frozenset({
    "kind", "bus", "bitrate_hz", "node_id", "master_id", "profile", "eds", "inverted", "rated_torque_nm",
    "rated_current_a",
})  # fmt: skip
OF_THE_MOTOR = frozenset({"counts_per_rev"})  # of its encoder; a family takes many
SUFFIX = ".yaml"


def _optional_fields() -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, field in CanopenDriveSection.model_fields.items():
        if name not in OF_ONE_AXIS:
            changed = copy.copy(field)
            changed.default, changed.default_factory = None, None
            found[name] = (field.annotation, changed)
    return found


ProfileKeys: type[StrictRecord] = create_model(
    "ProfileKeys",
    __base__=StrictRecord,
    __doc__="Keys of an axis file's drive section that a family of drives has in common.",
    **_optional_fields(),
)


class DriveProfile(StrictRecord):
    """A family of drives."""

    format: Annotated[str, formats.DRIVE_PROFILE.key] = formats.DRIVE_PROFILE.word
    family: Annotated[str, Field(description="common name of vendor and series")]
    vendor_id: Annotated[int | None, Field(ge=0, lt=1 << 32, description="0x1018:1; null: not known")] = None
    product_codes: Annotated[
        list[int], Field(description="0x1018:2 of the family; empty: every drive of the vendor")
    ] = Field(default_factory=list)
    tried: Annotated[str, Field(min_length=3, description="what was tested, on which drive, and nothing else")]
    remarks: Annotated[list[str], Field(description="what to know when wiring such a drive, one sentence each")] = (
        Field(default_factory=list)
    )
    to_fill_in: Annotated[
        dict[str, str],
        Field(description="keys of the drive section that each axis file gives, and where their values are found"),
    ] = Field(default_factory=dict)
    drive: Annotated[ProfileKeys, Field(description="keys of the drive section")]  # type: ignore[valid-type]

    @property
    def notes(self) -> list[str]:
        """What to know before such a drive is used: what was tried, remarks, and what each axis file must give."""
        return [f"tried: {self.tried}", *self.remarks, *(f"drive.{k}: {text}" for k, text in self.to_fill_in.items())]

    @property
    def keys(self) -> dict[str, Any]:
        """The keys that it sets, as a file has them."""
        found: dict[str, Any] = self.drive.model_dump(exclude_unset=True)  # type: ignore[attr-defined]
        return found


def read_profile(path: Path) -> DriveProfile:
    """Read and check a profile. Raises DocumentError."""
    return load(path, DriveProfile)


@functools.cache
def shipped_profiles() -> dict[str, Path]:
    """Names and files of the profiles supplied with the program."""
    try:
        folder = sources()[1] / "drives"
    except FileNotFoundError:
        return {}
    return {path.stem: path for path in sorted(folder.glob(f"*{SUFFIX}"))}


def profile_path(axis_path: Path, name: str) -> Path:
    """The file of a profile: as named, relative to the axis file, else one supplied with the program.

    Raises DocumentError naming those that there are.
    """
    given = Path(name if name.endswith(SUFFIX) else name + SUFFIX)
    for path in (axis_path.parent / given, axis_path.parent / given.name):  # the second: what a recording carries
        if path.is_file():
            return path
    if given.stem in shipped_profiles() and given.name == str(given):
        return shipped_profiles()[given.stem]
    raise DocumentError(
        f"{axis_path}: drive.profile: '{name}' is neither a file next to this one nor a profile that comes with the "
        f"program: {', '.join(shipped_profiles())}"
    )


def profile_for(vendor_id: int | None, product_code: int | None) -> tuple[str, DriveProfile] | None:
    """Name and profile of the family that a drive reports (0x1018); None if it is unknown."""
    if not vendor_id:
        return None
    found = None
    for name, path in shipped_profiles().items():
        profile = read_profile(path)
        if profile.vendor_id != vendor_id:
            continue
        if product_code in profile.product_codes:
            return name, profile
        if not profile.product_codes:
            found = found or (name, profile)
    return found


def with_profile(data: Any, axis_path: Path) -> Any:
    """A parsed axis file with the keys of the profile that it names. Raises DocumentError."""
    section = data.get("drive") if isinstance(data, Mapping) else None
    name = section.get("profile") if isinstance(section, Mapping) else None
    if not isinstance(section, Mapping) or not isinstance(name, str) or not is_file_name(name):
        return data  # what it has instead is refused with the other keys
    try:
        path = profile_path(axis_path, name)
    except DocumentError as error:  # with the line of the key
        refuse(axis_path, [("drive.profile", str(error).partition("drive.profile: ")[2])])
        raise
    keys = read_profile(path).keys
    return {**data, "drive": merged(keys, section)}


def profile_text(family: str, device: Any, fitness: Fitness) -> str:
    """A profile file from an EDS (`device`: its DeviceInfo), without what belongs to a single axis."""
    from .drive_proposal import section_lines  # of no axis file that is only read

    shared = fitness.proposal._replace(
        section={key: value for key, value in fitness.section.items() if key not in OF_ONE_AXIS | OF_THE_MOTOR}
    )
    lines = [
        f"format: {formats.DRIVE_PROFILE.word}",
        f"family: {json.dumps(family)}",
        f"vendor_id: {f'0x{device.vendor_number:X}' if device.vendor_number else 'null'}",
        f"product_codes: [{f'0x{device.product_number:X}' if device.product_number else ''}]",
        "tried: nothing yet; made from the EDS by drive-info",
        "drive:" if shared.section else "drive: {}",
        *section_lines(shared),
    ]
    return "\n".join(lines) + "\n"
