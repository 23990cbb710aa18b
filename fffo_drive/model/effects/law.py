"""What a law is: a kernel, its parameters, and what a search and a reader need to know about it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np

from ...jit.by_address import VectorKernel

Axis = Literal[
    "time", "velocity", "direction", "acceleration", "motor_angle", "output_angle", "current", "torque", "dwell",
    "travel_since_reversal", "frequency", "memory",
]  # fmt: skip
STRENGTH: Final = "strength"
SHAPE: Final = "shape"
Shape = dict[str, float]


class Parameter(NamedTuple):
    """One parameter of a law.

    The effect is linear in a strength, or nearly so, and zero where all strengths are; a shape is searched. `typical`:
    where a strength is probed when a regressor is made, and what a shape has where nothing is given.
    """

    name: str
    unit: str
    kind: Literal["strength", "shape"]
    low: float
    high: float
    typical: float
    meaning: str
    needs: str = ""  # a shape without which, at zero, this strength does nothing

    @property
    def held(self):
        return self.name in ("pitch_rev", "ratio", "contact_hz", "axis", "kind", "scale", "count")

    @property
    def plausible(self):
        return {"tau_s": (0.0, 0.005) if self.meaning == "time constant" else None, "damping": (0.001, 0.5)}.get(self.name)


class SearchContext(NamedTuple):
    """Facts of the data that a search is laid over, all in the units of the model. None: not declared."""

    duration_s: float  # of the longest run
    period_s: float
    lowest_rps: float  # slowest speed that is told from rest
    highest_rps: float
    low_rev: float  # where the axis has been
    high_rev: float
    highest_current_a: float
    highest_torque_nm: float
    coulomb_nm: float
    static_nm: float
    stiffness_per_rev: float
    attraction_nm_per_rev: float
    driving_a: float = 0.0  # current that most of the motion needs at least; 0: not known
    gear_ratio: float | None = None
    pole_pairs: int | None = None
    slots: int | None = None
    orders: tuple[float, ...] = ()  # peaks of the residual over the motor angle, per rev: orders that nobody foresaw
    slow_orders: tuple[float, ...] = ()  # the largest of each band of long waves, of the residual itself ...
    slow_level_orders: tuple[float, ...] = ()  # ... and of the residual times the direction
    frequencies_hz: tuple[float, ...] = ()  # peaks of the residual over time
    windows_rev: tuple[tuple[float, float], ...] = ()  # (centre, width) of places where the residual stands out
    bands_rps: tuple[float, ...] = ()  # speeds at which it does

    @property
    def turns(self) -> float:
        """Range of the motor angle, rev."""
        return self.high_rev - self.low_rev


@dataclass(frozen=True)
class Law:
    """An effect that a model may have."""

    name: str
    axis: Axis
    kernel: VectorKernel  # signals, parameters, memory: adds to LOAD_NM or SENSOR_REV
    parameters: tuple[Parameter, ...]
    search: Callable[[SearchContext], list[Shape]]  # shapes to try; those that it leaves out are typical
    meaning: str
    compensable: bool  # a feed-forward can give the torque
    regime: str  # where it acts
    lookalikes: tuple[str, ...]  # laws that it is confused with
    experiment: str  # what tells it from them
    motions: tuple[str, ...]  # what of it a run can do: parts of the recipe (identification.excitation.PARTS), or CHIRP
    picture: Axis  # the axis over which a plot convinces
    per_run: tuple[str, ...] = ()  # strengths with a datum per run, unless the drive declares an absolute angle
    feedforward: VectorKernel | None = None  # None: the same kernel, on the reference's signals
    level: bool = False  # it changes the level of the friction

    @property
    def acts_on(self):
        return "command" if self.name in ("voltage_limit", "delay", "current_lag", "dead_zone") else "motion"

    @property
    def wave(self):
        return {"cogging": "plain", "unbalance": "plain", "torque_ripple": "torque", "friction_ripple": "friction"}.get(self.name, "")

    @property
    def joint(self):
        return self.name in ("elasticity", "backlash")

    @property
    def shown_by_current(self):
        return self.name in ("voltage_limit", "current_lag")

    @property
    def needs_current(self):
        return self.name in ("voltage_limit",)

    @property
    def in_base(self):
        return self.name == "delay"

    @property
    def rung(self):
        return {"torque_offset": 0, "asymmetric_coulomb": 0, "unbalance": 1, "cogging": 2, "lookup": 4}.get(self.name, 3)

    @property
    def follows_model(self) -> bool:
        """Whether its torque changes with the parameters of the axis, and not only with the motion."""
        return self.level or self.feedforward is not None

    @property
    def strengths(self) -> tuple[Parameter, ...]:
        """Parameters that the effect is linear in."""
        return tuple(p for p in self.parameters if p.kind == STRENGTH)

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """Parameters that are searched."""
        return tuple(p for p in self.parameters if p.kind == SHAPE)

    def vector(self, values: dict[str, float]) -> list[float]:
        """All parameters in the kernel's order: strengths that are not given are zero, shapes typical."""
        return [float(values.get(p.name, 0.0 if p.kind == STRENGTH else p.typical)) for p in self.parameters]


def no_shape(context: SearchContext) -> list[Shape]:
    """The search of a law without a shape: one trial."""
    return [{}]


def over(name: str, values: Sequence[float]) -> list[Shape]:
    """Trials of one shape."""
    return [{name: float(value)} for value in values]


def geometric(low: float, high: float, count: int) -> list[float]:
    """Numbers from low to high with a constant ratio; one number where the range is empty."""
    if not high > low > 0.0:
        return [max(low, high)]
    return [float(x) for x in np.geomspace(low, high, count)]


def motor_orders(context: SearchContext, half: bool = False, slow: Sequence[float] = ()) -> list[float]:
    """Orders of the motor turn that the data can carry: whole, of the winding and the gear, and what was found.

    With `half` also halves. An order needs to be passed twice, and its period to last four samples at top speed.
    """
    highest = 0.25 / (context.period_s * max(context.lowest_rps, 1e-9))
    orders = {float(k) for k in range(1, 25)}
    if half:
        orders |= {k + 0.5 for k in range(8)}
    if context.pole_pairs is not None:
        orders |= {float(context.pole_pairs * k) for k in (1, 2, 6, 12)}
    if context.slots is not None:
        orders |= {float(context.slots), 2.0 * context.slots}
        if context.pole_pairs is not None:
            orders.add(float(np.lcm(context.slots, 2 * context.pole_pairs)))
    orders |= {*context.orders, *slow}
    lowest = 2.0 / max(context.turns, 1e-9)
    return sorted(order for order in orders if lowest <= order <= highest)


def slow_periods_rev(context: SearchContext) -> list[float]:
    """Periods longer than a motor turn: of the gear's output, its halves, and a grid over the range of the motion."""
    periods = {float(x) for x in geometric(1.5, 2.0 * max(context.turns, 1.0), 12)} if context.turns > 0.75 else set()
    if context.gear_ratio is not None and context.gear_ratio > 1.0:
        periods |= {context.gear_ratio / k for k in (1.0, 2.0, 3.0, 4.0)}
    periods |= {1.0 / order for order in (*context.orders, *context.slow_level_orders) if 0.0 < order < 1.0}
    return sorted(p for p in periods if 1.0 < p <= 2.0 * max(context.turns, 1e-9))
