"""A law: a kernel, its parameters, and the metadata that the search and the reports need."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
FigureKind = Literal["axis", "order", "friction", "level", "reversal", "transfer", "limit"]
Shape = dict[str, float]
Folded = tuple[Literal["motor_angle", "time"], float]  # signal to fold over, and period in rev or s

PER_TURN = "1/rev"  # unit of an order: periods in a motor turn
STRENGTH_STEP = 0.05  # of the numeric derivative over a strength: share of its typical value
SHAPE_STEP = 0.02  # ... over a shape: relative
ORDER_STEP_TURNS = 0.01  # ... over an order: phase shift at the end of the data, in periods
STEP_OF_NEEDED = 0.05  # ... over a shape that needs another: share of that shape


class Parameter(NamedTuple):
    """One parameter of a law.

    The effect is linear in a strength, or nearly so, and zero where all strengths are zero; a shape is searched.
    `typical`: the strength at which a regressor is computed, or the default of a shape.
    """

    name: str
    unit: str
    kind: Literal["strength", "shape"]
    low: float
    high: float
    typical: float
    meaning: str
    needs: str = ""  # a shape; while that is zero, this parameter has no influence
    step: float | None = None  # of the numeric derivative, in `unit`; None: by `step_at`
    logarithmic: bool = False  # a fit moves its logarithm, and `step` is relative
    held: bool = False  # a shape that a fit leaves where the search put it
    span: bool = False  # a shape that is a period of the motor angle, rev
    plausible: tuple[float, float] | None = None  # range on real machines; None: the whole range

    @property
    def may_be_left_out(self) -> bool:
        """Whether a file may leave it out: a strength, or a shape that is off or neutral at its typical 0."""
        return self.kind == STRENGTH or self.typical == 0.0

    def is_off(self, values: Mapping[str, float]) -> bool:
        """Whether it has no influence with these shapes: the shape it needs is zero, or it is a shape at zero."""
        if self.needs:
            return values.get(self.needs, 0.0) <= 0.0
        return self.kind == SHAPE and values.get(self.name, 0.0) == 0.0

    def step_at(self, values: Mapping[str, float], turns: float) -> float:
        """Step of the numeric derivative with these shapes, for data over `turns` motor turns."""
        if self.step is not None:
            return self.step
        if self.kind == STRENGTH:
            return STRENGTH_STEP * self.typical
        if self.unit == PER_TURN:
            return ORDER_STEP_TURNS / max(turns, 1.0)
        return STEP_OF_NEEDED * values[self.needs] if self.needs else SHAPE_STEP


class SearchContext(NamedTuple):
    """Facts of the data that determine the search grids, all in the units of the model. None: not declared."""

    duration_s: float  # of the longest run
    period_s: float
    lowest_rps: float  # slowest speed that can be distinguished from rest
    highest_rps: float
    low_rev: float  # where the axis has been
    high_rev: float
    highest_current_a: float
    highest_torque_nm: float
    coulomb_nm: float
    static_nm: float
    stiffness_per_rev: float
    attraction_nm_per_rev: float
    slow_rps: float = 0.0  # 10 % quantile of the speed in motion; 0: not known, `lowest_rps` is used
    driving_a: float = 0.0  # current that most of the motion needs at least; 0: not known
    gear_ratio: float | None = None
    pole_pairs: int | None = None
    slots: int | None = None
    orders: tuple[float, ...] = ()  # peaks of the residual over the motor angle, per rev: orders not in the grid
    slow_orders: tuple[float, ...] = ()  # the largest of each band of long waves, of the residual itself ...
    slow_level_orders: tuple[float, ...] = ()  # ... and of the residual times the direction
    frequencies_hz: tuple[float, ...] = ()  # peaks of the residual over time
    first_s: float = 0.0  # where the data begin, on the clock of the log

    @property
    def turns(self) -> float:
        """Range of the motor angle, rev."""
        return self.high_rev - self.low_rev


def not_folded(values: Mapping[str, float]) -> None:
    """No folding: the effect is not periodic."""
    return


def folded_over_order(values: Mapping[str, float]) -> Folded:
    """Folding of a wave over the motor angle."""
    return "motor_angle", 1.0 / values["order"]


@dataclass(frozen=True)
class Law:
    """The formula of one effect, with its metadata."""

    name: str
    axis: Axis
    kernel: VectorKernel  # signals, parameters, memory: adds to LOAD_NM or SENSOR_REV
    parameters: tuple[Parameter, ...]
    search: Callable[[SearchContext], list[Shape]]  # shapes to try; shapes left out are typical
    meaning: str
    plain_name: str  # as a machine builder would call it
    cause: str  # usual cause
    remedy: str  # remedy at the machine and in the controller
    compensable: bool  # feed-forward can supply the torque
    regime: str  # where it acts
    lookalikes: tuple[str, ...]  # laws that it can be confused with
    experiment: str  # how to tell it apart from those
    motions: tuple[str, ...]  # the part of it that a run can do: parts of the recipe
    # (identification.excitation.PARTS), or CHIRP
    picture: Axis  # the axis over which a plot shows it best
    figure: FigureKind = "axis"  # what is drawn beside that, of diagnosis.law_pictures; axis: nothing else
    per_run: tuple[str, ...] = ()  # strengths with a datum per run, unless the drive declares an absolute angle
    feedforward: VectorKernel | None = None  # None: the same kernel, on the reference's signals
    level: bool = False  # it changes the level of the friction
    form: bool = False  # a different form of friction than one surface: reported separately from effects
    acts_on: Literal["motion", "torque", "command"] = "motion"  # inputs of its torque along a known motion: the
    # motion and its friction; also the torque that the model requires; or the command, at the rate of the record
    joint: bool = False  # its torque is computed from the motion: fed back as a torque it would be unstable
    shown_by_current: bool = False  # a measured current falls short of its command by the torque lost
    needs_current: bool = False  # cannot be identified without a measured current: the command contains the residual
    rotary: bool = False  # exists on rotating shafts only, not on a linear axis
    in_base: bool = False  # already part of the base model: a note, never a finding
    rung: Literal[0, 1, 2, 3, 4] = 3  # of the ladder: 0 constants; 1 weight; 2 cogging; 3 other laws; 4 free curves
    place: Callable[[Mapping[str, float]], str] | None = None  # where, with these shapes; None: from `fold` or `regime`
    fold: Callable[[Mapping[str, float]], Folded | None] = not_folded  # of the plot; None: plotted over `picture`
    wave: Literal["", "plain", "torque", "friction"] = ""  # cos and sin of the motor angle, times 1, the motor's torque
    # or the friction level (which acts late, over a travel of level / attraction); such a column needs no kernel and
    # does not alias

    def place_of(self, values: Mapping[str, float]) -> str:
        """Where on the machine, or in its motion, the effect with these parameters is."""
        if self.place is not None:
            return self.place(values)
        folded = self.fold(values)
        if folded is None:
            return self.regime
        over, period = folded
        if over == "time":
            return f"at {1.0 / period:.4g} Hz, whatever the axis does"
        return f"one wave in {period:.4g} rev" if period >= 1.0 else f"{1.0 / period:.4g} waves in a motor turn"

    @property
    def follows_model(self) -> bool:
        """Whether its torque depends on the parameters of the axis, and not only on the motion."""
        return self.level or self.feedforward is not None

    @property
    def strengths(self) -> tuple[Parameter, ...]:
        """Parameters in which the effect is linear."""
        return tuple(p for p in self.parameters if p.kind == STRENGTH)

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """Parameters that are searched."""
        return tuple(p for p in self.parameters if p.kind == SHAPE)

    def filled(self, values: Mapping[str, float]) -> dict[str, float]:
        """All parameters in the kernel's order: missing strengths are zero, missing shapes typical."""
        return {p.name: float(values.get(p.name, 0.0 if p.kind == STRENGTH else p.typical)) for p in self.parameters}


def no_shape(context: SearchContext) -> list[Shape]:
    """Search of a law without shapes: one trial."""
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
    """Orders of the motor turn that the data can resolve: integers, those of winding and gear, and peaks found.

    With `half` also half orders. The data must cover two periods of an order, and a period must last four samples where
    the axis is slow: at top speed a period of order 72 lasts less than one sample.
    """
    slow_rps = context.slow_rps if context.slow_rps > 0.0 else context.lowest_rps
    highest = 0.25 / (context.period_s * max(slow_rps, 1e-9))
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
