"""The registry of effects: every law by its name, and checks of requests for one.

To add an effect, add its file in laws/ and a line in `NAMES`.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping

from ...documents import did_you_mean
from ...jit.by_address import VectorKernel
from .law import Axis, Law
from .laws.lookup import AXIS_CODES, KNOWN_AHEAD, NO_AXIS, UNKNOWN

NAMES = (
    "torque_offset",
    "asymmetric_coulomb",
    "asymmetric_viscous",
    "stribeck_shape",
    "presliding_shape",
    "frictional_lag",
    "second_surface",
    "dwell_stiction",
    "load_dependent_friction",
    "position_dependent_friction",
    "friction_ripple",
    "coulomb_drift",
    "viscous_drift",
    "torque_constant_drift",
    "quadratic_drag",
    "cogging",
    "torque_ripple",
    "unbalance",
    "torque_saturation",
    "dead_zone",
    "voltage_limit",
    "delay",
    "current_lag",
    "elasticity",
    "backlash",
    "resolver_error",
    "periodic_disturbance",
    "lookup",
)
LAWS: dict[str, Law] = {name: importlib.import_module(f"{__package__}.laws.{name}").LAW for name in NAMES}


def law_of(name: str) -> Law:
    """The law of a name; `unknown:AXIS` is the lookup over that axis. Raises KeyError for any other."""
    return LAWS["lookup" if name.startswith(UNKNOWN) else name]


def law_of_kernel(kernel: VectorKernel) -> str:
    """The law whose torque a controller computes by this kernel. Raises KeyError if there is none."""
    for law in LAWS.values():
        if kernel is (law.feedforward or law.kernel):
            return law.name
    raise KeyError(kernel)


def axis_of_effect(name: str) -> Axis:
    """The variable over which an effect acts."""
    if name.startswith(UNKNOWN):
        return next(word for word in AXIS_CODES if word == name.removeprefix(UNKNOWN))
    return LAWS[name].axis


def vector_of(name: str, values: Mapping[str, float]) -> list[float]:
    """Parameters in the kernel's order; of an `unknown:AXIS` the axis comes from the name."""
    given = dict(values)
    if name.startswith(UNKNOWN):
        given["axis"] = float(AXIS_CODES[axis_of_effect(name)])
    return list(law_of(name).filled(given).values())


def is_compensable(name: str, values: Mapping[str, float]) -> bool:
    """Whether feed-forward can supply the torque; for a lookup, only over variables that are known ahead."""
    law = law_of(name)
    if law.name != "lookup":
        return law.compensable
    axes = {vector_of(name, values)[0], values.get("across", NO_AXIS)} - {NO_AXIS}
    return axes <= KNOWN_AHEAD


def name_error(name: str) -> str | None:
    """Problem with the name of an effect; None if it is valid."""
    if name.startswith(UNKNOWN):
        word = name.removeprefix(UNKNOWN)
        return None if word in AXIS_CODES else f"no axis is called {word!r}: {did_you_mean(word, AXIS_CODES)}"
    return None if name in LAWS else f"no effect is called {name!r}: {did_you_mean(name, LAWS)}"


def parameter_errors(name: str, values: Mapping[str, float]) -> list[tuple[str, str]]:
    """(parameter, problem) for an effect with a valid name."""
    known = {p.name: p for p in law_of(name).parameters}
    errors = []
    for key, value in values.items():
        if key not in known:
            text = f"effect {name!r} has no parameter {key!r}: {did_you_mean(key, known)}"
            errors.append((key, text))
        elif not (math.isfinite(value) and known[key].low <= value <= known[key].high):
            p = known[key]
            errors.append((key, f"{value:g} is outside {p.low:g} to {p.high:g} {p.unit}"))
    missing = [p.name for p in law_of(name).parameters if p.name not in values and not p.may_be_left_out]
    if missing and law_of(name).name != "lookup":
        errors.append((missing[0], f"missing: effect {name!r} needs its shape ({', '.join(missing)})"))
    return errors
