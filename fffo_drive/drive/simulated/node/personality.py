"""Deviations of a drive from the default behaviour of the simulated one: the section `personality:` of its file.

Every entry is behaviour of some vendor's drive. The defaults are those of a drive without deviations.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from ....canopen_node.dictionary import multiplexer
from ..ranges import key, note

NAMED_OBJECT = re.compile(r"0x([0-9A-Fa-f]{4}):([0-9A-Fa-f]{1,2})")
TARGET_BITS = (8, 16, 32)


@dataclass(frozen=True)
class Personality:
    """Deviations of the drive. Objects are named 0xINDEX:SUB, both in hexadecimal."""

    rtr_bit: Literal["free", "required"] = note(
        "free", "bit 30 (no remote frames) of a TPDO's COB-ID: free to be 0 or 1, or required to be 1 (else 06090030)"
    )
    mode_display: Literal["at_once", "with_sync", "when_enabled"] = note(
        "at_once", "when 0x6061 follows 0x6060: at once, with the next SYNC, or not before OPERATION ENABLED"
    )
    command_following: Literal["shown", "not_shown", "refused"] = note(
        "shown", "statusword bit 12: shown; not_shown: 0 although the target acts; refused: 0, and no target acts"
    )
    limit_shown: bool = note(True, "statusword bit 11; false: the drive limits its torque without a word")
    keeps_torque: bool = note(False, "keeps its state and torque when it leaves NMT operational, whatever 0x6007 says")
    starts_itself: bool = note(False, "goes OPERATIONAL after boot-up without its master, whatever 0x1F80 says")
    remote: bool = note(True, "statusword bit 9; false: the drive is in local control and takes no controlword")
    warning_code: int = key(0, "-", 0, 0xFFFF, "code of an emergency message that is only a warning; 0 for none")
    warning_at_s: float = key(
        -1.0, "s", -1.0, 1e6, "when it is sent, after power-on; -1: each time the drive is enabled"
    )
    brake_release_s: float = key(0.0, "s", 0.0, 10.0, "holding brake: time to open after enabling; 0 for no brake")
    sto_active: bool = note(False, "safe torque off: bit 4 of the statusword is 0, the drive does not switch on")
    sto_input_bit: int = key(3, "-", 0, 31, "bit of 0x60FD that is 1 while safe torque off is active")
    dc_link_share: float = key(
        1.0, "-", 0.0, 2.0, "share of plant.dc_link_v that 0x6079 reports; if too low, the drive does not switch on"
    )
    encoder_counts_per_rev: int = key(0, "-", 0, 1 << 30, "counts of the encoder; 0: as in 0x608F, or the resolver's")
    rated_torque_unit_nm: float = key(1e-3, "Nm", 1e-9, 1.0, "unit of 0x6076")
    rated_current_unit_a: float = key(1e-3, "A", 1e-9, 1.0, "unit of 0x6075")
    connection_loss_option: int = key(
        0, "-", 0, 3, "what a drive without 0x6007 does when the connection is lost; values as in 0x6007"
    )
    vendor_mode: int = key(0, "-", -128, 0, "a vendor-specific torque mode; 0 for none")
    vendor_target: str = note("", "object with the target of the vendor's mode")
    vendor_target_bits: int = key(32, "-", 8, 32, "size of this object if the drive's file does not give it: 8, 16, 32")
    vendor_units_per_a: float = key(1.0, "1/A", 1e-6, 1e9, "units of the target per ampere")
    values: Mapping[str, int] = note({}, "by object: another value at power-on")
    lowest: Mapping[str, int] = note({}, "by object: lowest value that it accepts")
    highest: Mapping[str, int] = note({}, "by object: highest value that it accepts")

    def errors(self) -> list[tuple[str, str]]:
        """Problems in addition to the ranges: pairs of key and text."""
        found = [
            (f"{name}.{text}", "an object is named 0xINDEX:SUB, as 0x60C2:02")
            for name in ("values", "lowest", "highest")
            for text in getattr(self, name)
            if not NAMED_OBJECT.fullmatch(text)
        ]
        if (self.vendor_mode or self.vendor_target) and not NAMED_OBJECT.fullmatch(self.vendor_target):
            found.append(("vendor_target", "the vendor's mode needs an object for its target, as 0x201C:00"))
        if self.vendor_target_bits not in TARGET_BITS:
            found.append(("vendor_target_bits", f"{self.vendor_target_bits} is none of 8, 16, 32"))
        return found


def named(text: str) -> int:
    """Index and sub-index of an object's name in one number."""
    match = NAMED_OBJECT.fullmatch(text)
    assert match is not None, text
    return multiplexer(int(match[1], 16), int(match[2], 16))
