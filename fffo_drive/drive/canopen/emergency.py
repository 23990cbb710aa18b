"""Fault information of a drive in words: EMCY codes, the error register, bits of the statusword, vendor objects.

Codes of CiA 301 (emergency error codes) and CiA 402-2 (error codes of 0x603F); a code in neither is named by its class,
the upper half.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from ...units import NS_PER_S
from ..cia402 import (
    STATE_OPERATION_ENABLED,
    STATE_TABLE,
    STATUS_FOLLOWS_COMMAND,
    STATUS_INTERNAL_LIMIT,
    STATUS_REMOTE,
    STATUS_VOLTAGE_ENABLED,
    STATUS_WARNING,
    state_of,
)
from ..port import DriveRefusedError
from .service import Emergency, Service

ERROR_CODE, ERROR_HISTORY, DIGITAL_INPUTS, DC_LINK_MV = 0x603F, 0x1003, 0x60FD, 0x6079
LONGEST_HISTORY = 3  # newest entries of 0x1003 that are reported
BURST_NS = NS_PER_S  # EMCY this close together have one cause: all are reported
LONGEST_BURST = 3
OLD_NS = 2 * NS_PER_S  # an EMCY older than this is reported with its age
WARNING_GAP_NS = NS_PER_S  # shortest time between two reports of the same warning
INPUT_BITS = {0: "negative limit switch", 1: "positive limit switch", 2: "home switch", 3: "interlock (STO, enable)"}
FIRST_VENDOR_INPUT = 16  # bits of 0x60FD from here on are vendor-specific

REGISTER_BITS = (
    "generic", "current", "voltage", "temperature", "communication", "device profile", "reserved", "manufacturer",
)  # fmt: skip
CODES = {  # whole codes
    0x2310: "continuous over-current at the output", 0x2320: "short circuit or earth leakage at the output",
    0x2330: "earth leakage at the output", 0x2340: "short circuit at the output", 0x2350: "I2t overload",
    0x3110: "mains over-voltage", 0x3120: "mains under-voltage", 0x3130: "phase failure",
    0x3210: "DC link over-voltage", 0x3220: "DC link under-voltage", 0x3310: "output over-voltage",
    0x4210: "device too hot", 0x4310: "drive too hot",
    0x5111: "15 V supply", 0x5112: "24 V supply", 0x5113: "5 V supply",
    0x5530: "non-volatile memory", 0x6010: "watchdog",
    0x6320: "parameter error", 0x7110: "brake chopper", 0x7120: "motor", 0x7121: "motor blocked",
    0x7122: "motor error or commutation", 0x7300: "sensor", 0x7303: "resolver 1", 0x7304: "resolver 2",
    0x7305: "incremental sensor 1", 0x7306: "incremental sensor 2", 0x7310: "speed", 0x7320: "position",
    0x8110: "CAN overrun, frames were lost", 0x8120: "CAN error passive", 0x8130: "heartbeat or life guarding of the "
    "PC was missed", 0x8140: "recovered from bus-off", 0x8150: "collision of CAN identifiers",
    0x8210: "PDO too short", 0x8220: "PDO too long", 0x8240: "unexpected SYNC length", 0x8250: "RPDO timed out",
    0x8311: "torque too high", 0x8331: "torque fault", 0x8400: "speed controller", 0x8500: "position controller",
    0x8700: "SYNC was missed or came out of time", 0x8611: "following error", 0x8612: "limit of the reference",
}  # fmt: skip
CLASSES = {  # upper half of a code
    0x10: "generic", 0x20: "current", 0x21: "current at the input", 0x22: "current inside",
    0x23: "current at the output",
    0x30: "voltage", 0x31: "mains voltage", 0x32: "voltage inside", 0x33: "output voltage", 0x40: "temperature",
    0x41: "ambient temperature", 0x42: "device temperature", 0x43: "drive temperature", 0x44: "supply temperature",
    0x50: "hardware", 0x51: "supply", 0x52: "control hardware", 0x53: "operating unit", 0x54: "power section",
    0x55: "memory", 0x60: "software", 0x61: "internal software", 0x62: "user software", 0x63: "parameters",
    0x70: "additional modules", 0x71: "power module", 0x72: "measuring module", 0x73: "sensor", 0x80: "monitoring",
    0x81: "communication", 0x82: "protocol", 0x83: "torque", 0x84: "speed", 0x85: "position", 0x86: "positioning",
    0x90: "external error", 0xF0: "additional functions", 0xFF: "the vendor's own",
}  # fmt: skip


def code_text(code: int) -> str:
    """For instance 0x8611 (following error)."""
    words = CODES.get(code) or CLASSES.get(code >> 8, "in no table")
    return f"0x{code:04X} ({words})"


def history_text(entry: int) -> str:
    """An entry of 0x1003: the code in the lower half, the vendor's number in the upper one (CiA 301 7.5.2.4)."""
    vendors = entry >> 16 & 0xFFFF
    return code_text(entry & 0xFFFF) + (f" with 0x{vendors:04X}" if vendors else "")


def register_text(register: int) -> str:
    """For instance 0x21 (generic, device profile)."""
    names = [name for bit, name in enumerate(REGISTER_BITS) if register >> bit & 1]
    return f"0x{register:02X} ({', '.join(names) if names else 'no error: a warning'})"


def emergency_text(emergency: Emergency) -> str:
    """All fields of a message."""
    text = f"EMCY {code_text(emergency.code)}, error register {register_text(emergency.error_register)}"
    return text + (f", vendor bytes {emergency.vendor.hex(' ')}" if any(emergency.vendor) else "")


def statusword_text(statusword: int, unserved_bits: Sequence[int] = (), what: str = "statusword") -> str:
    """The state, and the bits that prevent enabling or following; `unserved_bits`: never set by this drive."""
    unset = ~(statusword | sum(1 << bit for bit in unserved_bits))
    name = next((row.name for row in STATE_TABLE if row.state == state_of(statusword)), "no state of CiA 402")
    found = [f"{what} 0x{statusword:04X}: {name}"]
    if unset & STATUS_REMOTE:
        found.append("bit 9 is 0: the drive is in local control and ignores our controlword")
    if unset & STATUS_VOLTAGE_ENABLED:
        found.append("bit 4 is 0: no voltage at the power stage (supply, STO)")
    limited = statusword & STATUS_INTERNAL_LIMIT
    if state_of(statusword) == STATE_OPERATION_ENABLED and unset & STATUS_FOLLOWS_COMMAND and not limited:
        found.append("bit 12 is 0: the drive ignores the target torque")
    if statusword & STATUS_WARNING:
        found.append("bit 7: the drive warns of something")
    return "; ".join(found)


def inputs_text(inputs: int) -> str:
    """0x60FD: limit switches, home switch and interlock of CiA 402; vendor bits by number."""
    names = [name for bit, name in INPUT_BITS.items() if inputs >> bit & 1]
    vendors = [str(bit) for bit in range(FIRST_VENDOR_INPUT, 32) if inputs >> bit & 1]
    names += [f"the vendor's bits {', '.join(vendors)}"] if vendors else []
    return f"0x60FD 0x{inputs:08X} ({', '.join(names) or 'no limit switch, no interlock'})"


def standing(emergencies: Iterable[Emergency], warning_codes: Sequence[int], now_ns: int) -> list[Emergency]:
    """EMCY with an error, newest first. One that the drive has called off (code 0) stands for OLD_NS more."""
    found: list[Emergency] = []
    for one in emergencies:
        if one.code == 0:
            found = [error for error in found if now_ns - error.monotonic_ns <= OLD_NS]
        elif one.code not in warning_codes:
            found.append(one)
    return found[::-1]


def burst_text(errors: Sequence[Emergency], now_ns: int) -> list[str]:
    """The last EMCY of `errors` (newest first), then those just before it: one cause often sends several. Each once."""
    counted = Counter(one._replace(monotonic_ns=0) for one in errors)
    newest: dict[Emergency, int] = {}  # without its time -> when it last came
    for one in errors:
        if errors[0].monotonic_ns - one.monotonic_ns <= BURST_NS:
            newest.setdefault(one._replace(monotonic_ns=0), one.monotonic_ns)
    found = []
    for one, heard_ns in list(newest.items())[:LONGEST_BURST]:
        age_ns = now_ns - heard_ns
        count = f", {counted[one]} times" if counted[one] > 1 else ""
        age = f", {age_ns / NS_PER_S:.0f} s ago" if age_ns > OLD_NS else ""
        hint = "" if one.error_register else f"; if it only warns: drive.warning_codes: [0x{one.code:04X}]"
        found.append(emergency_text(one) + count + age + hint)
    return found


class AskedWords(NamedTuple):
    """What a drive answers when it is asked about a fault; each empty where it has nothing to say."""

    error: list[str]  # 0x603F
    supplies: list[str]  # inputs and DC link
    history: list[str]  # 0x1003


def asked_words(service: Service, heard: Sequence[int]) -> AskedWords:
    """Read by SDO. Whatever the drive lacks or refuses is left out, and so are codes that an EMCY has told (`heard`).

    Raises BusUnavailableError.
    """
    error, supplies, history = [], [], []
    told = list(heard)
    with contextlib.suppress(DriveRefusedError):
        code = service.read_optional_int(ERROR_CODE, 0)
        if code and code not in told:
            error.append(f"0x603F {code_text(code)}")
            told.append(code)
        elif code == 0 and not told:
            error.append("0x603F says no error")
    with contextlib.suppress(DriveRefusedError):
        entries = [entry for entry in _history(service) if entry & 0xFFFF not in told]
        if entries:
            counted = Counter(map(history_text, entries))
            shown = [text if count == 1 else f"{text}, {count} times" for text, count in counted.items()]
            history.append(f"earlier, by 0x1003, newest first: {', '.join(shown)}")
    with contextlib.suppress(DriveRefusedError):
        inputs = service.read_optional_int(DIGITAL_INPUTS, 0)
        if inputs is not None:
            supplies.append(inputs_text(inputs))
    with contextlib.suppress(DriveRefusedError):
        voltage_mv = service.read_optional_int(DC_LINK_MV, 0)
        if voltage_mv is not None:
            supplies.append(f"DC link {voltage_mv / 1e3:.1f} V (0x6079)")
    return AskedWords(error, supplies, history)


def _history(service: Service) -> list[int]:
    """Newest entries of 0x1003."""
    entries = service.read_optional_int(ERROR_HISTORY, 0) or 0
    return [service.read_optional_int(ERROR_HISTORY, sub) or 0 for sub in range(1, min(entries, LONGEST_HISTORY) + 1)]


class WarningNews:
    """Warnings of a drive, each reported once: EMCY of `codes`, and statusword bit 7. At most one report per
    WARNING_GAP_NS.
    """

    def __init__(self, codes: Sequence[int]) -> None:
        self._codes = codes
        self._heard_ns = 0  # of the last EMCY reported
        self._reported_ns = -WARNING_GAP_NS
        self._bit = False
        self._risen = False

    def look(self, emergencies: Iterable[Emergency], statusword: int, now_ns: int) -> list[str]:
        """A sentence for each new warning; a repeated one gives one sentence."""
        bit = bool(statusword & STATUS_WARNING)
        self._risen |= bit and not self._bit
        self._bit = bit
        if now_ns - self._reported_ns < WARNING_GAP_NS:
            return []
        new = [one for one in emergencies if one.code in self._codes and one.monotonic_ns > self._heard_ns]
        counted = Counter(emergency_text(one) for one in new)
        found = [text if count == 1 else f"{text} ({count} times)" for text, count in counted.items()]
        if self._risen:
            found.append("statusword bit 7")
        if found:
            self._reported_ns, self._risen = now_ns, False
            self._heard_ns = max([self._heard_ns, *(one.monotonic_ns for one in new)])
        return [f"the drive warns: {text}" for text in found]
