"""Friction models of all laws fitted to the same record: the plant's own friction along the motion of a run.

Least squares over the logarithms of the parameters, from Table I; the rms shows what a model cannot describe. The
motion must follow the reference, on which the laws compute their friction. With a motion that sticks at every reversal,
as under PI, the parameters of a model that differs from the plant diverge (2SEP on five surfaces: K goes to its bound
from any start).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np
import scipy  # its modules load where they are first used

from ...arrays import Floats
from ...jit import njit
from ...model.effects import slots as s
from ...model.effects.laws.second_surface import MEMORY_RATIO, TRAVEL_RATIO, second_surface
from ...model.effects.slots import MEMORY_SLOTS as EFFECT_MEMORY
from ...model.friction import OMEGA_CLIPPED, REST, FrictionConfig, friction_step
from .constants import MEMORY_SLOTS
from .lugre import LugreModel, lugre_torque
from .maxwell_slip import SlipModel, slip_torque

Model = TypeVar("Model", bound=tuple[Any, ...])

REACH = 4.0  # of the logarithm of a parameter, either way: 55 times
TABLE_1 = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, OMEGA_CLIPPED)
LUGRE_START = LugreModel(0.025, 0.067, 0.733, 1.07, 0.003, 20.0, 0.002)
SLIP_START = SlipModel(0.025, 0.067, 0.733, 1.07, 0.003, 12.0, 0.4, 2.0)
SECOND_SHARE = 0.1  # of the level and of the rise: with which the second surface begins
SECOND_SPEEDS = (0.3, 3.0)  # over the Stribeck velocity: where its own begins; the better one stays


class TwoSurfaces(NamedTuple):
    """The 2SEP model with the effect second_surface beside it: FrictionConfig, then the effect's parameters."""

    coulomb_nm: float
    static_nm: float
    stribeck_velocity_rps: float
    stribeck_exponent: float
    viscous_nm_per_rps: float
    stiffness_per_rev: float
    attraction_nm_per_rev: float
    omega_form: int
    level_nm: float
    rise_nm: float
    travel_rev: float
    speed_rps: float
    memory_rev: float

    @property
    def first(self) -> FrictionConfig:
        """The model's own surface."""
        return FrictionConfig(**{name: getattr(self, name) for name in FrictionConfig._fields})

    @property
    def second(self) -> dict[str, float]:
        """The effect's parameters by name."""
        return {name: getattr(self, name) for name in self._fields[len(FrictionConfig._fields) :]}


class FittedPeer(NamedTuple):
    """A model, and the share of the friction (rms) that it leaves."""

    model: Any
    left: float


@njit
def _along_2sep(model: FrictionConfig, velocity_rps: Floats, period_s: float, torque_nm: Floats) -> None:
    state = REST
    for k in range(velocity_rps.shape[0]):
        state = friction_step(model, state, velocity_rps[k], 0.0, period_s)
        torque_nm[k] = state.torque_nm


@njit
def _along_lugre(model: LugreModel, velocity_rps: Floats, period_s: float, torque_nm: Floats) -> None:
    bristles_nm = 0.0
    for k in range(velocity_rps.shape[0]):
        torque_nm[k], bristles_nm = lugre_torque(model, bristles_nm, velocity_rps[k], 0.0, period_s)


@njit
def _along_slip(model: SlipModel, velocity_rps: Floats, period_s: float, torque_nm: Floats, memory: Floats) -> None:
    for k in range(velocity_rps.shape[0]):
        torque_nm[k] = slip_torque(model, memory, velocity_rps[k], period_s)


@njit
def _add_second_surface(
    parameters: Floats, velocity_rps: Floats, period_s: float, torque_nm: Floats, signals: Floats, memory: Floats
) -> None:
    signals[s.STEP_S] = period_s
    for k in range(velocity_rps.shape[0]):
        signals[s.VELOCITY_RPS] = velocity_rps[k]
        signals[s.LOAD_NM] = 0.0
        second_surface(signals, parameters, memory)
        torque_nm[k] += signals[s.LOAD_NM]


def friction_along(model: Any, velocity_rps: Floats, period_s: float) -> Floats:
    """Friction torque (n,) of a model, Nm, along a velocity (n,) from rest."""
    torque_nm = np.zeros(velocity_rps.size)
    if isinstance(model, FrictionConfig):
        _along_2sep(model, velocity_rps, period_s, torque_nm)
    elif isinstance(model, TwoSurfaces):
        _along_2sep(model.first, velocity_rps, period_s, torque_nm)
        parameters, signals, memory = (
            np.array(list(model.second.values())),
            np.zeros(s.N_SLOTS),
            np.zeros(EFFECT_MEMORY),
        )
        _add_second_surface(parameters, velocity_rps, period_s, torque_nm, signals, memory)
    elif isinstance(model, LugreModel):
        _along_lugre(model, velocity_rps, period_s, torque_nm)
    else:
        _along_slip(model, velocity_rps, period_s, torque_nm, np.zeros(MEMORY_SLOTS))
    return torque_nm


def fit_friction(start: Model, velocity_rps: Floats, friction_nm: Floats, period_s: float) -> FittedPeer:
    """The parameters of a model (all positive) along a motion; arrays (n,)."""
    fixed = [name for name in start._fields if name == "omega_form"]  # type: ignore[attr-defined]
    names = [name for name in start._fields if name not in fixed]  # type: ignore[attr-defined]
    replaced: Callable[..., Model] = start._replace  # type: ignore[attr-defined]

    def model(logarithms: Floats) -> Model:
        return replaced(**dict(zip(names, (float(x) for x in np.exp(logarithms)), strict=True)))

    def left(logarithms: Floats) -> Floats:
        return friction_along(model(logarithms), velocity_rps, period_s) - friction_nm

    first = np.log([getattr(start, name) for name in names])
    found = scipy.optimize.least_squares(left, first, bounds=(first - REACH, first + REACH), x_scale=0.3, max_nfev=60)
    rms = float(np.sqrt(np.mean(found.fun**2) / np.mean(friction_nm**2)))
    return FittedPeer(model(found.x), rms)


def fit_two_surfaces(
    two_state: FrictionConfig, velocity_rps: Floats, friction_nm: Floats, period_s: float
) -> FittedPeer:
    """Both surfaces together, from the fitted 2SEP model and from Table I; arrays (n,).

    One surface fitted to the friction of several can end far from any of them (on GMS its Fc ends at its bound), and a
    fit that starts there stays there.
    """
    found = [
        fit_friction(
            TwoSurfaces(
                *first,
                SECOND_SHARE * first.coulomb_nm,
                SECOND_SHARE * abs(first.static_nm - first.coulomb_nm),
                TRAVEL_RATIO / first.stiffness_per_rev,
                speed * first.stribeck_velocity_rps,
                MEMORY_RATIO * first.static_nm / first.attraction_nm_per_rev,
            ),
            velocity_rps,
            friction_nm,
            period_s,
        )
        for first in (two_state, TABLE_1)
        for speed in SECOND_SPEEDS
    ]
    return min(found, key=lambda one: one.left)
