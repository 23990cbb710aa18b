"""Units as logs write them: spellings, what they measure, and the factor to our own."""

from __future__ import annotations

import re
from typing import NamedTuple

from ..units import S_PER_MIN, TWO_PI

TIME, ANGLE, SPEED, ACCELERATION, CURRENT, TORQUE, VOLTAGE, LENGTH, PACE, FORCE, SHARE, COUNT, TEMPERATURE = (
    "time", "angle", "speed", "acceleration", "current", "torque", "voltage", "length", "linear speed", "force",
    "share", "count", "temperature",
)  # fmt: skip
LINEAR_ACCELERATION = "linear acceleration"
ELECTRIC = "erpm"  # turns of the field in a minute: pole pairs times those of the motor


class Unit(NamedTuple):
    """A unit: what it measures, and how many of ours (s, rev, rps, rps2, A, Nm, V, m, m/s, m/s2, N, 1) it is."""

    measures: str
    factor: float


_DEG = 1.0 / 360.0
UNITS = {
    "s": Unit(TIME, 1.0), "ms": Unit(TIME, 1e-3), "us": Unit(TIME, 1e-6), "ns": Unit(TIME, 1e-9),
    "min": Unit(TIME, S_PER_MIN),
    "rev": Unit(ANGLE, 1.0), "rad": Unit(ANGLE, 1.0 / TWO_PI), "deg": Unit(ANGLE, _DEG),
    "mrad": Unit(ANGLE, 1e-3 / TWO_PI),
    "rps": Unit(SPEED, 1.0), "rpm": Unit(SPEED, 1.0 / S_PER_MIN), "rad/s": Unit(SPEED, 1.0 / TWO_PI),
    "deg/s": Unit(SPEED, _DEG), ELECTRIC: Unit(SPEED, 1.0 / S_PER_MIN),
    "rps2": Unit(ACCELERATION, 1.0), "rad/s2": Unit(ACCELERATION, 1.0 / TWO_PI), "deg/s2": Unit(ACCELERATION, _DEG),
    "A": Unit(CURRENT, 1.0), "mA": Unit(CURRENT, 1e-3),
    "Nm": Unit(TORQUE, 1.0), "mNm": Unit(TORQUE, 1e-3), "kNm": Unit(TORQUE, 1e3),
    "V": Unit(VOLTAGE, 1.0), "mV": Unit(VOLTAGE, 1e-3),
    "m": Unit(LENGTH, 1.0), "mm": Unit(LENGTH, 1e-3), "um": Unit(LENGTH, 1e-6),
    "m/s": Unit(PACE, 1.0), "mm/s": Unit(PACE, 1e-3), "mm/min": Unit(PACE, 1e-3 / S_PER_MIN),
    "m/s2": Unit(LINEAR_ACCELERATION, 1.0), "mm/s2": Unit(LINEAR_ACCELERATION, 1e-3),
    "N": Unit(FORCE, 1.0), "kN": Unit(FORCE, 1e3),
    "%": Unit(SHARE, 1e-2), "permille": Unit(SHARE, 1e-3),
    "counts": Unit(COUNT, 1.0), "degC": Unit(TEMPERATURE, 1.0),
}  # fmt: skip
_SPELLINGS = {
    "s": "sec secs second seconds sek sekunden",
    "ms": "msec milliseconds millisecond millis",
    "us": "usec microseconds microsecond micros µs μs",
    "ns": "nsec nanoseconds nanosecond nanos",
    "min": "minutes minute",
    "rev": "revs turn turns revolution revolutions umdr u r",
    "rad": "radian radians rads",
    "deg": "degree degrees grad °",
    "rps": "rev/s turns/s turn/s r/s u/s 1/s s-1 revs/s rev/sec",
    "rpm": "1/min min-1 u/min rev/min r/min umdr/min tr/min giri/min u/min- rpm. min^-1",
    "rad/s": "rad/sec rads rad.s-1 rad*s-1 rad/s^1 rad_s radps rad/second",
    "deg/s": "°/s deg/sec grad/s degps deg_s degrees/s",
    "rps2": "rev/s2 rev/s^2 rps^2",
    "rad/s2": "rad/s^2 rad/s²",
    "deg/s2": "deg/s^2 °/s2 °/s^2 °/s²",
    "m/s2": "m/s^2 m/s²",
    "mm/s2": "mm/s^2 mm/s²",
    "A": "amp amps ampere amperes arms a_rms aeff a_eff apk",
    "mA": "milliamp milliampere ma_rms",
    "Nm": "n*m n.m n·m newtonmeter newtonmetre n-m",
    "mNm": "mn*m mn.m mn·m",
    "V": "volt volts",
    "m": "meter metre meters metres",
    "um": "µm μm micron",
    "m/s": "m/sec mps",
    "mm/s": "mm/sec",
    "%": "percent pct prozent %rated",
    "permille": "‰ 0.1% promille per_mille 1/1000",
    "degC": "c °c celsius deg_c degree_c",
    "counts": "count cnt cnts inc incs increments ticks tick steps step qc pulses pulse digits lsb",
}
# spelled alike but for their case: torque and milli, not mega
_EXACT = {"mNm": "mNm", "mA": "mA", "mV": "mV", "MS": "ms", "S": "s", "kNm": "kNm"}
_ALIASES = {
    **{name.lower(): name for name in UNITS},
    **{word: name for name, words in _SPELLINGS.items() for word in words.split()},
}
_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[\(\{](?P<unit>[^\[\](){}]*)[\]\)\}]\s*$")
_SCALED = re.compile(r"\s*\d*\.?\d+\s*[A-Za-z]")
_NO_UNIT = re.compile(r"[\d\s.,:-]*")  # in brackets: an index, or nothing
_OF_INDICES = {  # letters that are units after these words alone
    "a": re.compile(r"cur|strom|amp|iq|command|cmd|cour|corr", re.IGNORECASE),
    "n": re.compile(r"force|kraft|forza|fuerza", re.IGNORECASE),
    "c": re.compile(r"temp", re.IGNORECASE),
}
_IN = re.compile(r"^(?P<name>.*\w)\s+in\s+(?P<unit>\S+)$")  # "Drehzahl in 1/min"
_SLASHED = re.compile(r"^(?P<name>[^/\[({]*\w)\s*/\s*(?P<unit>\S+)$")
_SUFFIX = re.compile(
    r"^(?P<name>.*?[^\W_])_(?P<unit>(?:rad|deg|rev|mm|m)_(?:per_)?s(?:ec)?|[a-z]+(?:-1)?)$", re.IGNORECASE
)
_PER = re.compile(r"[ _]*per[ _]*")
# a suffix like _a or _m may be an index as well: these may not
_SAFE_SUFFIXES = {
    "s", "ms", "us", "ns", "sec", "rev", "rad", "deg", "rps", "rpm", "ma", "nm", "mnm", "amps", "counts", "inc",
    "ticks", "mm", "um", "radps", "degps", "a", "mps", "erpm", "c", "degc", "grad", "degrees", "turns", "msec", "usec",
    "min-1", "n", "kn", "percent", "pct", "steps",
}  # fmt: skip


def unit_of(text: str) -> str | None:
    """The unit that a text names, by its own name in UNITS; None where it names none."""
    word = text.strip().strip("[](){}").strip()
    if word in _EXACT:
        return _EXACT[word]
    lower = word.lower()  # as it is first: permille and percent hold a "per" that divides nothing
    spelled = (lower, lower.replace(" ", "_"), _PER.sub("/", lower))
    return next((_ALIASES[one] for one in spelled if one in _ALIASES), None)


def split_name(text: str) -> tuple[str, str | None]:
    """A heading as name and unit: "Velocity [rpm]", "speed_rpm", "Zeit / ms", "rpm"."""
    plain = text.strip().strip("\"'").strip()
    whole = unit_of(plain)  # "rpm", "mA"; "tick" counts rows as well, "A" and "min" are other words too
    if whole and (UNITS[whole].measures == SPEED or (len(plain) > 1 and whole not in ("counts", "min"))):
        return plain, whole
    for pattern in (_BRACKETS, _IN, _SLASHED):
        found = pattern.match(plain)
        if found and (unit := unit_of(found["unit"])):
            return found["name"].strip() or plain, unit
    found = _SUFFIX.match(plain)
    if found and (needed := _OF_INDICES.get(found["unit"].lower())) and not needed.search(found["name"]):
        return plain, None  # an index: x_a, phase_c
    if found and (found["unit"].lower() in _SAFE_SUFFIXES or "_" in found["unit"]):
        unit = unit_of(re.sub(r"_(per_)?", "/", found["unit"].lower()) if "_" in found["unit"] else found["unit"])
        if found["unit"].lower() == "nm":
            unit = "Nm"
        if unit:
            return plain, unit
    return plain, None


def bare_name(heading: str, unit: str | None) -> str:
    """A heading without the unit that it ends in: "istdrehzahl_min-1"."""
    found = _SUFFIX.match(heading) if unit else None
    return found["name"] if found and split_name(heading)[1] == unit else heading


def unknown_unit(heading: str) -> str | None:
    """What stands in square brackets at the end of a heading and is no unit that is known; None where nothing does.

    Round brackets hold remarks as well, "velocity (filtered)", but a number with a unit is none: "(0.1 counts/s)".
    """
    found = _BRACKETS.match(heading)
    if not found or not (heading.rstrip().endswith("]") or _SCALED.match(found["unit"])):
        return None
    text = found["unit"].strip()
    return None if _NO_UNIT.fullmatch(text) or unit_of(text) else text


def turn_of(unit: str | None) -> float | None:
    """One turn in a unit of angle; None for any other."""
    return 1.0 / UNITS[unit].factor if unit is not None and UNITS[unit].measures == ANGLE else None


def time_scale(unit: str | None) -> float | None:
    """Seconds of a unit of time; None for any other."""
    name = None if unit is None else unit_of(unit)
    return UNITS[name].factor if name is not None and UNITS[name].measures == TIME else None
