"""What one count on the wire is in the units of the axis, and where that is coarse."""

from __future__ import annotations

from typing import NamedTuple

from ..model.parameters import ModelFile
from ..units import permille_per_a
from .axis import AxisFile
from .drive_section import CanopenDriveSection

COARSE_SHARE = 0.1  # of what a count is compared with; up to this its steps drown in the noise of a sensor


class Resolution(NamedTuple):
    """One count of each word."""

    current_a: float  # per mille of 0x6071
    torque_nm: float  # the same
    velocity_rps: float  # of 0x606C
    position_rev: float  # of 0x6064


def resolution_of(axis: AxisFile, model: ModelFile) -> Resolution | None:
    """Of a drive on a bus; None for one in process, which has no words."""
    section = axis.drive
    if not isinstance(section, CanopenDriveSection):
        return None
    constant = model.torque_constant_nm_per_a
    current_a = 1.0 / permille_per_a(constant, section.rated_torque_nm)
    return Resolution(current_a, current_a * constant, 1.0 / section.velocity_units_per_rps, 1.0 / section.counts)


def resolution_lines(axis: AxisFile, model: ModelFile) -> list[str]:
    """One count of command and feedback, for people; empty for a drive in process."""
    one = resolution_of(axis, model)
    if one is None:
        return []
    return [
        f"one per mille of 0x6071 is {one.current_a:.3g} A ({one.torque_nm:.3g} Nm)",
        f"one unit of 0x606C is {one.velocity_rps:.3g} rps, one count of 0x6064 {one.position_rev:.3g} rev",
    ]


def coarse_words(axis: AxisFile, model: ModelFile) -> list[str]:
    """What is too coarse for this law on this axis, with the key concerned; empty where all is fine enough."""
    one = resolution_of(axis, model)
    if one is None:
        return []
    found = []
    band_rps, static_nm = axis.controller.observer.feedback_band_rps, model.friction.static_nm.value
    if one.velocity_rps > COARSE_SHARE * band_rps:
        found.append(
            f"drive.velocity_units_per_rps: one unit of 0x606C is {one.velocity_rps:.3g} rps, "
            f"{_share(one.velocity_rps, band_rps)} of controller.observer.feedback_band_rps ({band_rps:g}): its "
            "steps reverse the friction of `fb` and are amplified by every gain; give 0x606C a finer unit "
            "(0x60A9, drive.sdo)"
        )
    if one.torque_nm > COARSE_SHARE * static_nm:
        found.append(
            f"drive.rated_torque_nm: one per mille of 0x6071 is {one.torque_nm:.3g} Nm, "
            f"{_share(one.torque_nm, static_nm)} of the model's static friction ({static_nm:.3g} Nm): it is "
            "compensated in steps; a smaller rated torque (0x6076) makes them finer"
        )
    return found


def _share(part: float, whole: float) -> str:
    return f"{part / whole:.0%}" if whole > 0.0 else "more than all"
