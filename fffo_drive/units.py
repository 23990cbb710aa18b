"""Units, and the only place where one becomes another.

Rotation is in revolutions, as the paper and the drive have it: `_rev _rps _rps2`; torque in `_nm`, current in `_a`,
time in `_s` or `_ns`, frequency in `_hz`. Counts and per mille exist only on the wire; their factors are made here.
"""

from __future__ import annotations

import math

TWO_PI = 2.0 * math.pi
NS_PER_S = 1_000_000_000
PERMILLE = 1000.0
S_PER_MIN = 60.0

# suffix of a public name -> what it stands for; a test holds every signal and configuration key against it
SUFFIXES = {
    "rev": "revolutions",
    "rps": "revolutions per second",
    "rps2": "revolutions per second squared",
    "nm": "newton metre",
    "nm_per_a": "newton metre per ampere",
    "nm_per_rev": "newton metre per revolution",
    "nm_per_rps": "newton metre per revolution per second",
    "nm_per_s": "newton metre per second",
    "a": "ampere",
    "a_per_s": "ampere per second",
    "a2s": "ampere squared second",
    "a_per_rps": "ampere per revolution per second",
    "a_per_rev": "ampere per revolution",
    "v": "volt",
    "s": "second",
    "ms": "millisecond",
    "us": "microsecond",
    "ns": "nanosecond",
    "hz": "hertz",
    "kg_m2": "kilogram square metre",
    "per_rev": "per revolution",
    "deg": "degree of phase",
}


def inertia_nm_s2_per_rev(inertia_kg_m2: float) -> float:
    """Inertia as torque per acceleration in rev/s^2: T = J dw/dt with w in rad/s = 2 pi rev/s."""
    return TWO_PI * inertia_kg_m2


def inertia_kg_m2(inertia_nm_s2_per_rev: float) -> float:
    """The inverse of `inertia_nm_s2_per_rev`."""
    return inertia_nm_s2_per_rev / TWO_PI


def rps_from_rpm(speed_rpm: float) -> float:
    """Revolutions per second from revolutions per minute."""
    return speed_rpm / S_PER_MIN


def permille_per_a(torque_constant_nm_per_a: float, rated_torque_nm: float) -> float:
    """0x6071 and 0x6077 count thousandths of the rated torque (0x6076): counts per ampere of torque-forming current."""
    return PERMILLE * torque_constant_nm_per_a / rated_torque_nm


def counts_per_rev(resolver_bits: int) -> int:
    """Counts of one revolution of a resolver-to-digital converter."""
    return 1 << resolver_bits
