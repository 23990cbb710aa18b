"""What the heading of a column says of it: the quantity, and whether it is what was asked for or what was measured.

One table of words: English, German, French, Italian, Spanish, and what drives and robot programs write (VESC, ODrive,
moteus, Feetech, EPOS Studio, TwinCAT, ROS, mujoco).
"""

from __future__ import annotations

import itertools
import re
import unicodedata
from functools import lru_cache
from typing import NamedTuple

from ..arrays import Floats
from .evidence import wrap_of
from .units import (
    ACCELERATION,
    ANGLE,
    COUNT,
    CURRENT,
    FORCE,
    LENGTH,
    LINEAR_ACCELERATION,
    PACE,
    SHARE,
    SPEED,
    TEMPERATURE,
    TIME,
    TORQUE,
    UNITS,
    VOLTAGE,
    bare_name,
    turn_of,
)

POSITION, VELOCITY, ENABLE = "position", "velocity", "enable"
INPUTS = (CURRENT, TORQUE, VOLTAGE)  # what drives the axis, the best first

_WORDS = {
    TIME: "t time timestamp timestamps zeit zeitstempel stamp seconds sec secs nanosec nsec elapsed uptime today temps "
    "tempo tiempo",
    POSITION: "pos position positions angle angles theta phi winkel lage posizione posicion angolo angulo qpos posicao",
    VELOCITY: "vel velo velocity velocities speed spd geschwindigkeit drehzahl omega w dq qd qdot rpm erpm qvel "
    "vitesse velocita velocidad",
    ACCELERATION: "acc accel acceleration beschleunigung ddq qdd qacc",
    CURRENT: "cur curr current currents strom iq amp amps amperes isq courant corrente corriente",
    TORQUE: "torque torques tau moment drehmoment trq mom effort efforts force kraft load gtau couple coppia qfrc",
    VOLTAGE: "volt volts voltage spannung vir pwm duty uq vq tension tensione",
    ENABLE: "enable enabled",
    TEMPERATURE: "temp temperature temperatures temperatur temperatura",
}
_DEVICES = {  # what a quantity is of: they name one where nothing else does
    POSITION: "q encoder enc resolver qm rotor tachometer"
}


def _listed(words: str) -> set[str]:
    return set(words.split())


_RATES = _listed("dot rate deriv derivative punkt")  # of a position: its velocity
_QUANTITY = {word: quantity for quantity, words in _WORDS.items() for word in words.split()}
_DEVICE = {word: quantity for quantity, words in _DEVICES.items() for word in words.split()}
_ASKED = _listed(
    "ref reference des desired target cmd command commanded set setpoint control soll sollwert goal demand demanded "
    "dmd dem requested request req setvalue sp vorgabe vorgegeben consigne consigna riferimento referencia cible action"
)
_MEASURED = _listed(
    "act actual meas measured ist istwert fb feedback real mess messwert present mesure misurata medida estimate"
)
# of the supply, of a phase, of a model, or of a limit: not what drives the axis
_ASIDE = _listed(
    "input bus battery dc supply link id vd ud error err fault following deviation limit max min count counter index "
    "alpha beta ia ib ic reactive magnetising magnetizing "
    "magnetisierung predicted prediction model modelled modeled simulated expected"
)
_ELSEWHERE = _listed("mos fet mosfet board driver inverter bridge igbt ambient cpu")  # a temperature's place
_OF_UNIT = {
    TIME: TIME, ANGLE: POSITION, LENGTH: POSITION, SPEED: VELOCITY, PACE: VELOCITY, CURRENT: CURRENT, TORQUE: TORQUE,
    FORCE: TORQUE, VOLTAGE: VOLTAGE, TEMPERATURE: TEMPERATURE,
    ACCELERATION: ACCELERATION, LINEAR_ACCELERATION: ACCELERATION,
}  # fmt: skip
_LETTERS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_MOTION = {word for word, of in _QUANTITY.items() if of in (POSITION, VELOCITY)}  # "current speed" is one, now
_AXES = {"i": CURRENT, "u": VOLTAGE, "v": VOLTAGE}  # i_q, u_q: not the coordinate q
_SENSORS = _listed("shaft sensor transducer cell messwelle capteur sensore aufnehmer")
_FILLERS = _listed("motor achse axis joint shaft wert value")
_KNOWN = {*_QUANTITY, *_DEVICE, *_RATES, *_ASKED, *_MEASURED, *_ASIDE, *_FILLERS}
LEAST_PART = 3  # letters of a word within a compound: "Sollstrom", "thetadot"


class Meaning(NamedTuple):
    """What a heading says."""

    quantity: str | None  # None: nothing that is known
    asked: bool  # a reference or command, not a measurement
    measured: bool
    aside: bool  # of the kind, but of something else
    by_device: bool = False  # no word says the quantity, a part of the motor does: "encoder", "q"


@lru_cache(maxsize=4096)
def _parts(token: str) -> tuple[str, ...]:
    """A compound as the known words that it is made of; anything else as it is."""
    if token not in _KNOWN:
        for cut in range(len(token) - LEAST_PART, LEAST_PART - 1, -1):
            rest = _parts(token[cut:]) if token[:cut] in _KNOWN else ()
            if rest and all(part in _KNOWN for part in rest):
                return (token[:cut], *rest)
    return (token,)


def _tokens(name: str) -> list[str]:
    plain = "".join(c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c))
    return [part for token in _LETTERS.findall(plain) for part in _parts(token.lower())]


def _quantity_of(tokens: list[str]) -> str | None:
    """The quantity that words name: that of a part of the motor only where no other is named."""
    pairs = set(itertools.pairwise(tokens))
    tokens = [t for t, after in zip(tokens, [*tokens[1:], ""], strict=False) if t != "current" or after not in _MOTION]
    named = [_QUANTITY[token] for token in tokens if token in _QUANTITY]
    if ENABLE in named:  # "torque enable": the flag
        return ENABLE
    if TEMPERATURE in named:  # "motor current sensor temperature"
        return TEMPERATURE
    axis = next((of for letter, of in _AXES.items() if {(letter, "q"), (letter, "d")} & pairs), None)
    if axis is not None:
        return axis
    found = named[0] if named else None  # "reference velocity of the current loop": the first
    if found is None and ("q", "axis") not in pairs:
        found = next((_DEVICE[token] for token in tokens if token in _DEVICE), None)
    if found == POSITION:
        at = next(k for k, token in enumerate(tokens) if token in _QUANTITY or token in _DEVICE)
        rated = not _RATES.isdisjoint(tokens) or tokens[at - 1 : at] == ["d"] or tokens[at + 1 :] == ["p"]
        return VELOCITY if rated or VELOCITY in named else POSITION
    return found


def names_a_sensor(name: str) -> bool:
    """Whether a heading says that a sensor of its own measured: of a torque beside a current."""
    return not _SENSORS.isdisjoint(_tokens(name))


def meaning_of(name: str, unit: str | None) -> Meaning:
    """The meaning of a heading with its unit: a unit says more than a word, but shares and counts say nothing."""
    tokens = _tokens(bare_name(name, unit))
    measures = UNITS[unit].measures if unit else None
    quantity = _OF_UNIT.get(measures or "") or _quantity_of(tokens)
    if measures in (SHARE, COUNT) and quantity is None:
        quantity = TORQUE if measures == SHARE else POSITION
    asked = any(token in _ASKED for token in tokens)
    if quantity in (POSITION, VELOCITY, TORQUE):  # q_d, tau_d: desired; of a current it is the direct axis
        asked |= len(tokens) > 1 and tokens[-1] == "d"
    measured = any(token in _MEASURED for token in tokens)
    aside = any(token in _ASIDE and not (token == "id" and "iq" in tokens) for token in tokens)
    if quantity == TEMPERATURE:
        aside = not _ELSEWHERE.isdisjoint(tokens)
    elif quantity in (CURRENT, VOLTAGE):  # of the direct axis; into the drive, not the motor
        aside |= "d" in tokens or tokens[-1:] == ["in"]
    by_device = measures not in _OF_UNIT and not any(_QUANTITY.get(token) == quantity for token in tokens)
    return Meaning(quantity, asked and not measured, measured, aside, by_device)


def measured_wrap(name: str, unit: str | None, values: Floats) -> float | None:
    """The range at which a column wraps by its heading and its values: a measured position does, which moves steadily.

    A set point and a current may jump for other reasons.
    """
    found = meaning_of(name, unit)
    jumps = wrap_of(values, turn_of(unit)) if found.quantity == POSITION and not found.asked else None
    return None if jumps is None else jumps.at
