"""Units, and the only place where one becomes another.

Rotation is in revolutions, as the paper and the drive have it: `_rev _rps _rps2`; torque in `_nm`, current in `_a`,
time in `_s` or `_ns`, frequency in `_hz`. Counts and per mille exist only on the wire; their factors are made here.

A linear axis is the same maths: m stands for rev, N for Nm, and so on. Inside the program and in the keys of its files
the names of a rotary axis stay. What people read goes through `unit_on`, `name_on` and `text_on`.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

TWO_PI = 2.0 * math.pi
NS_PER_S = 1_000_000_000
PERMILLE = 1000.0
S_PER_MIN = 60.0
S_PER_HOUR = 3600.0
S_PER_DAY = 86_400.0
MAD_TO_SD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
NORMAL_95 = 1.96  # standard deviations to each side of the two-sided 95 % interval of a normal distribution

# suffix of a public name -> its unit as people read it (the longest that fits counts); a test holds every signal and
# configuration key against it
SUFFIXES = {
    "nm_per_a": "Nm/A",
    "nm_per_rps2": "Nm/rps²",
    "nm_per_rps": "Nm/rps",
    "nm_per_rev": "Nm/rev",
    "nm_per_s": "Nm/s",
    "nm_per_k": "Nm/K",
    "a_per_rps": "A/rps",
    "a_per_rev": "A/rev",
    "a_per_s": "A/s",
    "a2s": "A²s",
    "per_rev": "1/rev",
    "units_per_rps": "1/rps",
    "counts_per_rps": "1/rps",
    "units_per_a": "1/A",
    "per_k": "1/K",
    "k_per_w": "K/W",
    "kg_m2": "kg m²",
    "rps3": "rev/s³",
    "rps2": "rev/s²",
    "rps": "rev/s",
    "rev": "rev",
    "nm": "Nm",
    "ms": "ms",
    "us": "µs",
    "ns": "ns",
    "hz": "Hz",
    "deg": "degree",
    "permille": "1/1000",
    "status_bits": "",
    "ticks": "ticks",
    "ratio": "1",
    "bits": "bits",
    "ohm": "Ω",
    "v": "V",
    "h": "h",
    "a": "A",
    "s": "s",
    "k": "K",
    "c": "°C",
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


class LinearUnit(NamedTuple):
    """What stands for a unit of a rotary axis on a linear one."""

    unit: str
    suffix: str  # of names in the unit of the rotary axis ...
    linear_suffix: str  # ... and in this one


LINEAR = {  # unit of a rotary axis ->
    "rev": LinearUnit("m", "rev", "m"),
    "rps": LinearUnit("m/s", "rps", "mps"),
    "rps2": LinearUnit("m/s2", "rps2", "mps2"),
    "1/rev": LinearUnit("1/m", "per_rev", "per_m"),
    "Nm": LinearUnit("N", "nm", "n"),
    "Nm/s": LinearUnit("N/s", "nm_per_s", "n_per_s"),
    "Nm/A": LinearUnit("N/A", "nm_per_a", "n_per_a"),
    "Nm/rev": LinearUnit("N/m", "nm_per_rev", "n_per_m"),
    "Nm/rps": LinearUnit("N s/m", "nm_per_rps", "n_s_per_m"),
    "Nm/rps2": LinearUnit("N s^2/m^2", "nm_per_rps2", "n_s2_per_m2"),
    "A/rps": LinearUnit("A s/m", "a_per_rps", "a_s_per_m"),
    "A/rev": LinearUnit("A/m", "a_per_rev", "a_per_m"),
    "A/rev/s": LinearUnit("A/m/s", "a_per_rev_s", "a_per_m_s"),
    "Nm s^2/rev": LinearUnit("kg", "nm_s2_per_rev", "kg"),
}
LINEAR_WORDS = {  # longer ones first
    "an inertia": "a mass", "inertia": "mass", "torques": "forces", "torque": "force",
    "motor angle": "position", "output angle": "position", "angle": "position",
    "at the motor shaft": "at the motor", "motor turn": "metre",
}  # fmt: skip
# a word by itself: no part of a key, an option, a file's name or an effect's (unknown:torque, drag(torque))
_BY_ITSELF = r"(?<![\w./'-])(?<!\w[:(])(?:{})(?![\w/^'(-]|[.:]\w)"
_WORDS = re.compile(_BY_ITSELF.format("|".join(LINEAR_WORDS)), re.IGNORECASE)
_UNITS = re.compile(_BY_ITSELF.format("|".join(re.escape(unit) for unit in sorted(LINEAR, key=len, reverse=True))))


def unit_on(unit: str, linear: bool) -> str:
    """A unit of a rotary axis, on this kind of axis."""
    return LINEAR[unit].unit if linear and unit in LINEAR else unit


def unit_in(name: str) -> str:
    """The unit of a rotary axis that a name ends in, where LINEAR has it: torque_nm is in Nm; else nothing."""
    fitting = [unit for unit, row in LINEAR.items() if f"_{name}".endswith(f"_{row.suffix}")]
    return max(fitting, key=lambda unit: len(LINEAR[unit].suffix), default="")


def name_on(name: str, unit: str, linear: bool) -> str:
    """What people read for a name in a unit of a rotary axis: excess_nm_per_rps in Nm/rps is excess_n_s_per_m."""
    if not linear:
        return name
    stem = name
    if unit in LINEAR:
        _, suffix, linear_suffix = LINEAR[unit]
        if f"_{name}".endswith(f"_{suffix}"):
            stem = name[: -len(suffix)] + linear_suffix
    return "_".join(LINEAR_WORDS.get(part, part) for part in stem.split("_"))


def text_on(text: str, linear: bool) -> str:
    """A sentence about a rotary axis, on this kind of axis: units and words that stand by themselves."""
    if not linear:
        return text
    text = _UNITS.sub(lambda found: LINEAR[found[0]].unit, text)
    return _WORDS.sub(_linear_word, text)


def axis_word_on(word: str, linear: bool) -> str:
    """The axis of a finding in words: motor_angle is `motor angle`, and what repeats along the way of a linear axis."""
    if linear and word == "motor_angle":  # the other one, output_angle, is its position
        return "periodic position"
    return text_on(word.replace("_", " "), linear)


def _linear_word(found: re.Match[str]) -> str:
    word = LINEAR_WORDS[found[0].lower()]
    return word[0].upper() + word[1:] if found[0][0].isupper() else word
