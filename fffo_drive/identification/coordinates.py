"""Parameters of the model as coordinates of the fit: logarithms where a parameter is positive, with bounds."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..model.axis import AxisConfig
from ..model.friction import OMEGA_CLIPPED, FrictionConfig
from ..model.parameters import LIMITS
from ..symbols import FRICTION, SYMBOLS
from .regression import TorqueStart
from .shooting import Nuisance

PARAMETERS = tuple(SYMBOLS)  # the order of all vectors and matrices of the fit
MODEL_PARAMETERS = ("inertia_nm_s2_per_rev", "delay_s", *FRICTION)
NUISANCES = tuple(name for name in PARAMETERS if name not in MODEL_PARAMETERS)
# positive parameters, fitted as logarithms
LOGARITHMIC = frozenset(PARAMETERS).difference(("delay_s", "stribeck_exponent", *NUISANCES))
LOG_SPAN = math.log(1e3)  # a positive parameter stays within this factor of its start
STRIBECK_EXPONENTS = (0.3, 3.0)
LONGEST_DELAY_S = 0.1
LONGEST_PRESLIDING = {"rotary": 0.05, "linear": 1e-3}  # 1/K of a machine, rev and m: 18 degrees of a motor, 1 mm


class Coordinates(NamedTuple):
    """The space in which the fit moves: scales that make a unit step small, and bounds."""

    names: tuple[str, ...]
    scale: Floats
    low: Floats  # in coordinates
    high: Floats
    rising: bool  # the literal Stribeck curve: exponent < 0


def start_vector(start: TorqueStart, stiffness_per_rev: float, attraction_nm_per_rev: float) -> Floats:
    """Physical parameters (all of PARAMETERS) at the start of a fit."""
    values = {**start._asdict(), **dict.fromkeys(NUISANCES, 0.0)}
    values.update(stiffness_per_rev=stiffness_per_rev, attraction_nm_per_rev=attraction_nm_per_rev)
    return np.array([values[name] for name in PARAMETERS])


def coordinates(
    physical: Floats, period_s: float, free: tuple[str, ...], rising: bool = False, most_static_nm: float = math.inf,
    least_stiffness_per_rev: float = 0.0, most_viscous_nm_per_rps: float = math.inf,
) -> Coordinates:  # fmt: skip
    """Coordinates around a start. `free`: the fitted parameters; the others are held. The last three bound Fs, K
    and sigma.
    """
    names = PARAMETERS
    torque_nm = float(physical[names.index("coulomb_nm")])
    scale = np.ones(len(names))
    for name, size in (("delay_s", 2.0 * period_s), ("sensor_lag_s2", period_s**2), ("offset_nm", torque_nm)):
        scale[names.index(name)] = size
    values = to_coordinates(physical, scale)
    low, high = values - LOG_SPAN, values + LOG_SPAN
    exponents = STRIBECK_EXPONENTS if not rising else (-STRIBECK_EXPONENTS[1], -STRIBECK_EXPONENTS[0])
    for name, bounds in (
        ("delay_s", (0.0, LONGEST_DELAY_S)),
        ("stribeck_exponent", exponents),
        ("sensor_lag_s2", (-20.0 * period_s**2, 20.0 * period_s**2)),
        ("offset_nm", (-100.0 * torque_nm, 100.0 * torque_nm)),
    ):
        k = names.index(name)
        low[k], high[k] = bounds[0] / scale[k], bounds[1] / scale[k]
    for name in LOGARITHMIC.intersection(FRICTION):  # what a model file may hold
        k, (least, most) = names.index(name), LIMITS[f"friction.{name}"]
        high[k] = max(values[k], min(high[k], math.log(most)))
        if least > 0.0:
            low[k] = min(values[k], max(low[k], math.log(least)))
    for name, bound in (("static_nm", most_static_nm), ("viscous_nm_per_rps", most_viscous_nm_per_rps)):
        k = names.index(name)
        high[k] = max(values[k], min(high[k], math.log(bound)))
    if least_stiffness_per_rev > 0.0:
        stiffness = names.index("stiffness_per_rev")
        low[stiffness] = max(low[stiffness], math.log(least_stiffness_per_rev))
    for k, name in enumerate(names):
        if name not in free:
            low[k] = high[k] = values[k]
    return Coordinates(names, scale, low, high, rising)


def to_coordinates(physical: Floats, scale: Floats) -> Floats:
    """Logarithm where the parameter is positive by nature, else value over scale; so all that follow PARAMETERS."""
    return np.array([
        math.log(value) if logarithmic else value / size
        for logarithmic, value, size in zip(_logarithmic(scale.size), physical, scale, strict=True)
    ])  # fmt: skip


def to_physical(values: Floats, scale: Floats) -> Floats:
    """The inverse of `to_coordinates`."""
    return np.array([
        math.exp(value) if logarithmic else value * size
        for logarithmic, value, size in zip(_logarithmic(scale.size), values, scale, strict=True)
    ])  # fmt: skip


def physical_slope(values: Floats, scale: Floats) -> Floats:
    """d physical / d coordinate, for standard deviations."""
    return np.array([
        math.exp(value) if logarithmic else size
        for logarithmic, value, size in zip(_logarithmic(scale.size), values, scale, strict=True)
    ])  # fmt: skip


def _logarithmic(size: int) -> list[bool]:
    """Which parameters of a fit are logarithms; those of effects are not."""
    own = [name in LOGARITHMIC for name in PARAMETERS]
    return own + [False] * (size - len(own))


def axis_of(physical: Floats, torque_constant_nm_per_a: float) -> tuple[AxisConfig, Nuisance]:
    """Constants of the kernels from physical parameters. The delay is that of the position: without a sensor's lag."""
    p = dict(zip(PARAMETERS, (float(value) for value in physical), strict=False))  # those of effects follow
    friction = FrictionConfig(**{name: p[name] for name in FRICTION}, omega_form=OMEGA_CLIPPED)
    axis = AxisConfig(p["inertia_nm_s2_per_rev"], torque_constant_nm_per_a, p["delay_s"], friction)
    return axis, Nuisance(**{name: p[name] for name in NUISANCES})
