"""What a drive says of a fault, in words: EMCY codes, the error register, bits of the statusword.

Codes of CiA 301 (emergency error codes) and CiA 402-2 (error codes of 0x603F); a code in neither is named by its class,
the upper half.
"""

from __future__ import annotations

from ..cia402 import STATE_TABLE, STATUS_REMOTE, STATUS_VOLTAGE_ENABLED, state_of
from .service import Emergency

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
    """0x8611 (following error)."""
    words = CODES.get(code) or CLASSES.get(code >> 8, "in no table")
    return f"0x{code:04X} ({words})"


def register_text(register: int) -> str:
    """0x21 (generic, device profile)."""
    names = [name for bit, name in enumerate(REGISTER_BITS) if register >> bit & 1]
    return f"0x{register:02X} ({', '.join(names) if names else 'no error: a warning'})"


def emergency_text(emergency: Emergency) -> str:
    """Everything that a message says."""
    text = f"EMCY {code_text(emergency.code)}, error register {register_text(emergency.error_register)}"
    return text + (f", vendor bytes {emergency.vendor.hex(' ')}" if any(emergency.vendor) else "")


def statusword_text(statusword: int) -> str:
    """The state, and the bits that keep a drive from being enabled."""
    name = next((row.name for row in STATE_TABLE if row.state == state_of(statusword)), "no state of CiA 402")
    found = [f"statusword 0x{statusword:04X}: {name}"]
    if not statusword & STATUS_REMOTE:
        found.append("bit 9 is 0: the drive is in local control and ignores our controlword")
    if not statusword & STATUS_VOLTAGE_ENABLED:
        found.append("bit 4 is 0: no voltage at the power stage (supply, STO)")
    return "; ".join(found)
