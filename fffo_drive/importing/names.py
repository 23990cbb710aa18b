"""What the heading of a column says of it: the quantity, and whether it is what was asked for or what was measured."""

from __future__ import annotations

import re
from typing import NamedTuple

from ..arrays import Floats
from .evidence import wrap_of
from .units import ANGLE, COUNT, CURRENT, FORCE, LENGTH, PACE, SHARE, SPEED, TIME, TORQUE, UNITS, VOLTAGE, turn_of

POSITION, VELOCITY, ACCELERATION, ENABLE = "position", "velocity", "acceleration", "enable"
INPUTS = (CURRENT, TORQUE, VOLTAGE)  # what drives the axis, the best first

_WORDS = {
    TIME: "t time timestamp timestamps zeit stamp seconds sec secs elapsed uptime",
    POSITION: "pos position positions angle angles theta phi winkel lage encoder enc resolver q qm rotor",
    VELOCITY: "vel velo velocity velocities speed spd geschwindigkeit drehzahl omega w dq qd qdot rpm",
    ACCELERATION: "acc accel acceleration beschleunigung ddq qdd",
    CURRENT: "curr current currents strom iq amp amps amperes isq",
    TORQUE: "torque torques tau moment drehmoment trq mom effort efforts force kraft load gtau",
    VOLTAGE: "volt volts voltage spannung vir pwm duty uq",
    ENABLE: "enable enabled",
}
_QUANTITY = {word: quantity for quantity, words in _WORDS.items() for word in words.split()}
_ASKED = set(
    [
        "ref",
        "reference",
        "des",
        "desired",
        "target",
        "cmd",
        "command",
        "commanded",
        "set",
        "setpoint",
        "soll",
        "sollwert",
        "goal",
        "demand",
        "demanded",
        "dmd",
        "requested",
        "setvalue",
        "sp",
    ]
)
_MEASURED = set(["act", "actual", "meas", "measured", "ist", "istwert", "fb", "feedback", "real", "mess"])
# of the supply or of a phase: not what drives the axis
_ASIDE = set(
    [
        "input",
        "bus",
        "dc",
        "supply",
        "link",
        "id",
        "temp",
        "temperature",
        "error",
        "err",
        "following",
        "deviation",
        "limit",
        "max",
        "min",
        "count",
        "counter",
        "index",
        "alpha",
        "beta",
        "ia",
        "ib",
        "ic",
    ]
)
_OF_UNIT = {
    TIME: TIME, ANGLE: POSITION, LENGTH: POSITION, SPEED: VELOCITY, PACE: VELOCITY, CURRENT: CURRENT, TORQUE: TORQUE,
    FORCE: TORQUE, VOLTAGE: VOLTAGE,
}  # fmt: skip
_LETTERS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")


class Meaning(NamedTuple):
    """What a heading says."""

    quantity: str | None  # None: nothing that is known
    asked: bool  # a reference or command, not a measurement
    measured: bool
    aside: bool  # of the kind, but of something else


def meaning_of(name: str, unit: str | None) -> Meaning:
    """The meaning of a heading with its unit: a unit says more than a word, but shares and counts say nothing."""
    tokens = [token.lower() for token in _LETTERS.findall(name)]
    measures = UNITS[unit].measures if unit else None
    quantity = _OF_UNIT.get(measures or "")
    named = [_QUANTITY[token] for token in tokens if token in _QUANTITY]
    if quantity is None and named:
        # "torque enable": the flag; "reference velocity of the current loop": the first
        quantity = ENABLE if ENABLE in named else named[0]
    if measures in (SHARE, COUNT) and quantity is None:
        quantity = TORQUE if measures == SHARE else POSITION
    asked = any(token in _ASKED for token in tokens)
    measured = any(token in _MEASURED for token in tokens)
    return Meaning(quantity, asked and not measured, measured, any(token in _ASIDE for token in tokens))


def measured_wrap(name: str, unit: str | None, values: Floats) -> float | None:
    """The range at which a column wraps by its heading and its values: a measured position does, which moves steadily.

    A set point and a current may jump for other reasons.
    """
    found = meaning_of(name, unit)
    jumps = wrap_of(values, turn_of(unit)) if found.quantity == POSITION and not found.asked else None
    return None if jumps is None else jumps.at
