"""The fit: prediction errors of the position, all parameters together, from several starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..model.effects.table import Term
from ..symbols import SYMBOLS
from .coordinates import (
    LONGEST_PRESLIDING,
    MODEL_PARAMETERS,
    NUISANCES,
    PARAMETERS,
    Coordinates,
    coordinates,
    start_vector,
    to_coordinates,
    to_physical,
)
from .dataset import SAME_RATE, DataError, Record
from .effects_fit import COULOMB, STATIC, FittedEffect, effects_of, joint_coordinates, scales_of
from .facts import DriveFacts
from .kinematics import low_pass
from .ladder import LARGEST_P, WAVES, Ladder, climb
from .layout import EffectLayout, EffectStart, layout_of
from .noise_bias import noise_shift
from .prediction import BANDWIDTH_PERIODS, Problem, make_problem, residual, residuals
from .ranking import first_best, ranked
from .regression import TorqueStart, regression_start, start_problems
from .residuals import WINDOW_S, RunResidual, run_residuals, torque_residual
from .rows import LAST_DELAY_S
from .solver import Solution, huber_cost, refine, robust_scale, solve
from .uncertainty import Disagreement, Uncertainty, ratio_sd, uncertainty_of, undetermined

Progress = Callable[[float, str], None]

BANDWIDTH_HZ = 40.0  # of the observer: below about 10 Hz it is unstable where the Stribeck curve falls
OTHER_RATIOS = (0.75, 0.5)  # the fit is repeated at these shares of the bandwidth, and the mean of all is taken
MEAN_COST = 1e-3  # the mean is taken where the loss rises by no larger share than this
PRESLIDING_LSB = (4.0, 10.0, 25.0, 60.0, 150.0, 400.0, 1000.0)  # 1/K at the start, in counts ...
PRESLIDING_STEP = 2.5  # ... and on by this factor where the sensor is so fine that presliding has more of them
LAG_RATIOS = (2.0, 8.0, 25.0)  # Fs/B at the start, in multiples of 1/K
STARTS = 2
START_S = 25.0  # of each record, to choose among the starts
START_ITERATIONS = 6
# Fs, and viscous friction at high speed, over the largest friction torque that acted in the logs; beyond it they are an
# extrapolation to speeds that were not run (tools/benchmarks/results/static_friction.md)
MOST_ACTED = 1.5
LAG_BLOCK_S = 1.0  # blocks that are resampled for the sensor's lag
LAG_HZ = 60.0
LAG_STRETCH_S, LAG_EDGE_S = 1.0, 0.1  # shortest stretch without a gap; what its filter spoils at each end
LARGEST_FREE_RUN = 1.0 / 3.0  # error of the velocity simulated freely, of the velocity: such a model is not believed
LARGEST_NOISY_SD = 0.025  # of an inertia that is seen below the sensor's noise only: beyond it is not determined
# share by which force balance and simulation may differ in the inertia (EMPS 0.1, blind and lorenz up to 4 %; a log of
# 20 Hz 9 %, a pendulum of BAM, jittered, 30 %)
LARGEST_APART = 0.07
STRIBECK_SDS = 2.0  # of Fs - Fc, by which a Stribeck curve is seen
INERTIA = "inertia_nm_s2_per_rev"
# what steady speeds tell of; the Stribeck curve where there is one
STEADY = ("viscous_nm_per_rps", "coulomb_nm", "static_nm", "stribeck_velocity_rps", "stribeck_exponent")
OFFSET = "torque_offset"  # the effect that the kernels have a parameter of their own for
OFFSET_PLACE = PARAMETERS.index("offset_nm")


class FitSettings(NamedTuple):
    """Options of a fit."""

    bandwidth_hz: float = BANDWIDTH_HZ
    effects: tuple[EffectStart, ...] | None = None  # in addition to the model; None: those accepted by `ladder.climb`
    compare_literal: bool = True  # try the rising Stribeck curve too
    starts: int = STARTS


class Fit(NamedTuple):
    """A fitted model of one axis."""

    physical: Floats  # all of coordinates.PARAMETERS; those of effects follow them in `solution`
    uncertainty: Uncertainty
    space: Coordinates
    problem: Problem
    solution: Solution
    start: TorqueStart
    sensor_delay_s: float | None  # lag of the drive's own velocity behind the position; None: no velocity in the logs
    sensor_delay_sd_s: float | None
    literal_loss: float | None  # loss of the rising Stribeck curve over that of the falling one
    warnings: tuple[str, ...]
    runs: tuple[RunResidual, ...]  # residuals of each record
    effects: tuple[FittedEffect, ...] = ()
    ladder: Ladder | None = None  # None: the effects were given

    def terms(self, run: int) -> list[Term]:
        """The effects in one run, without the constant torque, which is in `physical`."""
        return [effect.term(run) for effect in self.effects if effect.name != OFFSET]

    def value(self, name: str) -> float:
        """One parameter by its name in PARAMETERS."""
        return float(self.physical[PARAMETERS.index(name)])

    @property
    def apart(self) -> float:
        """Logarithm of the ratio of the inertias that simulation and force balance ask for, without its sign."""
        return abs(math.log(self.value(INERTIA) / self.start.inertia_nm_s2_per_rev))


def fit_records(
    records: Sequence[Record], settings: FitSettings | None = None, facts: DriveFacts | None = None,
    progress: Progress | None = None,
) -> Fit:  # fmt: skip
    """Fit one axis, with the effects of the first rungs, to one or several records of it.

    An effect whose strength in the fit may be zero is left out again, the weakest first (backward elimination): a wave
    at which the rows of the ladder hint, of the hundreds that were tried, can be another effect's. So are all waves,
    where with them force balance and simulation contradict each other and more torque is left than without.
    Raises DataError if the data do not permit a fit.
    """
    settings = settings or FitSettings()
    tell = progress or (lambda share, text: None)
    _same_rate(records)
    tell(0.0, "start")
    start = regression_start(records)
    if settings.effects is not None:
        return _fit(records, settings, facts, tell, start, settings.effects)

    def fitted(ladder: Ladder) -> Fit:
        effects = tuple(one.start(len(records)) for one in ladder.accepted)
        return _fit(records, settings, facts, tell, ladder.start, effects)._replace(ladder=ladder)

    ladder = climb(records, start, facts)
    fit = fitted(ladder)
    while fit.effects:
        chances = [effect.chance for effect in fit.effects]
        weakest = int(np.argmax(chances))
        if chances[weakest] <= LARGEST_P:
            break
        ladder = ladder._replace(accepted=ladder.accepted[:weakest] + ladder.accepted[weakest + 1 :])
        fit = fitted(ladder)
    waves = frozenset(one.candidate.name for one in ladder.accepted if one.candidate.rung == WAVES)
    if waves and fit.apart > LARGEST_APART:
        try:
            bare = fitted(climb(records, start, facts, waves))
        except DataError:  # without them it is no axis
            return fit
        cutoff_hz = min(fit.start.cutoff_hz, bare.start.cutoff_hz)
        return min(fit, bare, key=lambda one: _left_nm(records, one, cutoff_hz))
    return fit


def _fit(
    records: Sequence[Record],
    settings: FitSettings,
    facts: DriveFacts | None,
    tell: Progress,
    start: TorqueStart,
    effects: Sequence[EffectStart],
) -> Fit:
    problems = start_problems(start, records[0].torque_constant_nm_per_a, facts.rated_current_a if facts else None)
    if problems and start.has_inertia:
        raise DataError("\n".join(problems))
    bandwidth_hz = min(settings.bandwidth_hz, BANDWIDTH_PERIODS / records[0].period_s)
    bandwidth_hz = min(bandwidth_hz, start.cutoff_hz) if start.is_noisy else bandwidth_hz
    problem = make_problem(records, bandwidth_hz)
    offsets = [effect for effect in effects if effect.name == OFFSET]
    first = start_vector(start, 1.0, 1.0)
    first[OFFSET_PLACE] = sum(effect.values["torque_nm"] for effect in offsets)
    layout = layout_of([effect for effect in effects if effect.name != OFFSET], scales_of(problem, first))
    free = (*_seen(start), *(NUISANCES[1:] if offsets else ()))
    least_per_rev = 1.0 / LONGEST_PRESLIDING[facts.units if facts else "rotary"]
    most_nm, most_viscous = MOST_ACTED * start.most_friction_nm, MOST_ACTED * start.most_viscous_nm_per_rps
    frame = _Frame(free, layout, most_nm, least_per_rev, most_viscous)
    tell(0.1, "starts")
    physical = _best_start(records, start, first[OFFSET_PLACE], bandwidth_hz, frame, settings.starts)
    problem = frame.of(problem)
    space = frame.space(physical, records[0].period_s)
    tell(0.3, "fit")
    solution = solve(problem, space, to_coordinates(physical, space.scale), progress=_between(tell, 0.3, 0.7))
    solution = refine(problem, space, solution)
    literal_loss = None
    if settings.compare_literal:
        tell(0.7, "other Stribeck curve")
        part = frame.of(make_problem(records, bandwidth_hz, START_S))
        literal_loss = _literal(part, space, solution, records[0].period_s, frame)
    tell(0.75, "noise")
    bias = noise_shift(problem, space, solution.values)
    others = []
    for number, ratio in enumerate(OTHER_RATIOS):
        tell(0.8 + 0.06 * number, "other bandwidths")
        other = frame.of(make_problem(records, ratio * bandwidth_hz))
        others.append(refine(other, space, solution).values)
    solution, disagreement = mean_of_fits(problem, space, solution, others)
    solution = _levels_in_order(solution)
    tell(0.91, "uncertainty")
    physical = to_physical(solution.values, space.scale)
    uncertainty = uncertainty_of(problem, space, solution, bias, disagreement)
    lag_s, lag_sd_s = sensor_delay(records)
    constant = [_constant(physical, uncertainty)] if offsets else []
    fit = Fit(
        physical[: len(PARAMETERS)], uncertainty, space, problem, solution, start, lag_s, lag_sd_s, literal_loss,
        tuple(_warnings(solution, space, literal_loss)), (),
        (*constant, *effects_of(problem.layout, physical, uncertainty.sd)),
    )  # fmt: skip
    tell(0.95, "residuals")
    terms = [fit.terms(k) for k in range(len(records))]
    fit = _judged(fit._replace(runs=tuple(run_residuals(records, fit.physical, terms, start.cutoff_hz))))
    tell(1.0, "done")
    return fit


def _left_nm(records: Sequence[Record], fit: Fit, cutoff_hz: float) -> float:
    """Rms of the torque that a model leaves in all records, below a cut-off."""
    parts = [
        torque_residual(record, fit.physical, cutoff_hz, fit.terms(number)) for number, record in enumerate(records)
    ]
    return float(np.sqrt(np.mean(np.concatenate([one.residual_nm[one.kept] for one in parts]) ** 2)))


def _seen(start: TorqueStart) -> tuple[str, ...]:
    """Parameters that the motion of the logs tells of; the others are held at the start."""
    if start.has_inertia:
        return (*MODEL_PARAMETERS, NUISANCES[0])
    return STEADY if start.has_stribeck else STEADY[:2]


def _judged(fit: Fit) -> Fit:
    """The fit without the intervals that what is known of the logs, and its own simulation, do not support."""
    start, sd = fit.start, fit.uncertainty.sd
    coulomb, static = (PARAMETERS.index(name) for name in ("coulomb_nm", "static_nm"))
    mixed = float(fit.uncertainty.correlation[coulomb, static]) * sd[coulomb] * sd[static]
    excess_sd = math.sqrt(max(0.0, sd[coulomb] ** 2 + sd[static] ** 2 - 2.0 * mixed))
    worst = max(fit.runs, key=lambda run: run.free_run_share)
    found = [
        (
            not start.has_inertia,
            tuple(name for name in MODEL_PARAMETERS if name not in _seen(start)),
            "hardly anything accelerates: steady speeds tell of friction alone",
        ),
        (not start.has_delay, (INERTIA, "delay_s"), f"up to {1e3 * LAST_DELAY_S:g} ms no delay fits best"),
        (
            start.is_noisy and sd[0] > LARGEST_NOISY_SD * fit.value(INERTIA),
            (INERTIA,),
            f"the sensor's noise hides the acceleration above {start.cutoff_hz:g} Hz",
        ),
        (
            fit.apart > LARGEST_APART,
            (INERTIA,),
            f"force balance and simulation ask for values that are {100.0 * fit.apart:.0f} % apart",
        ),
        (
            worst.free_run_share > LARGEST_FREE_RUN,
            (INERTIA, "delay_s"),
            f"simulated freely over {WINDOW_S:g} s the velocity is wrong by {100.0 * worst.free_run_share:.0f} % of "
            f"itself in {worst.record.name}: the model does not move as the axis does",
        ),
        (
            fit.value("static_nm") - fit.value("coulomb_nm") < STRIBECK_SDS * excess_sd,
            STEADY[3:],
            "no Stribeck curve is seen: Fs may be Fc",
        ),
    ]
    known = fit.uncertainty
    for holds, names, reason in found:
        if holds:
            known = undetermined(known, fit.space.names, names, reason)
    return fit._replace(uncertainty=known)


class _Frame(NamedTuple):
    """Free parameters of a fit: those of the model, and the effects."""

    free: tuple[str, ...]
    layout: EffectLayout
    most_static_nm: float
    least_stiffness_per_rev: float
    most_viscous_nm_per_rps: float

    def of(self, problem: Problem) -> Problem:
        """A problem with the effects; unchanged without effects."""
        return problem._replace(layout=self.layout) if self.layout.parameters else problem

    def vector(self, physical: Floats) -> Floats:
        """The model's own parameters, with the effects where they begin behind them."""
        return np.concatenate([physical[: len(PARAMETERS)], [p.value for p in self.layout.parameters]])

    def space(self, physical: Floats, period_s: float, rising: bool = False) -> Coordinates:
        """Coordinates around a vector."""
        most_nm = math.inf if rising else self.most_static_nm  # there Fs is the level of high speeds
        base = coordinates(
            physical[: len(PARAMETERS)],
            period_s,
            self.free,
            rising,
            most_nm,
            self.least_stiffness_per_rev,
            self.most_viscous_nm_per_rps,
        )
        return joint_coordinates(base, self.layout) if self.layout.parameters else base


def _constant(physical: Floats, uncertainty: Uncertainty) -> FittedEffect:
    """The constant torque, a parameter of the kernels, as an effect."""
    sd = float(uncertainty.sd[OFFSET_PLACE])
    return FittedEffect(
        OFFSET, {"torque_nm": float(physical[OFFSET_PLACE])}, {"torque_nm": sd} if sd > 0.0 else {}, {}, {}
    )


def _same_rate(records: Sequence[Record]) -> None:
    if not records:
        raise DataError("no logs: at least one is needed")
    for record in records[1:]:
        if abs(record.period_s / records[0].period_s - 1.0) > SAME_RATE:
            raise DataError(
                f"{record.path}: sampled every {record.period_s:.6g} s, {records[0].path} every "
                f"{records[0].period_s:.6g} s: logs that are fitted together need one rate (dataset.one_rate)"
            )


def _between(tell: Progress, low: float, high: float) -> Callable[[int], None]:
    return lambda iteration: tell(low + (high - low) * (1.0 - 0.8**iteration), f"fit, iteration {iteration}")


def _best_start(
    records: Sequence[Record], start: TorqueStart, constant_nm: float, bandwidth_hz: float, frame: _Frame, starts: int
) -> Floats:
    """Starts for presliding and lag, which are not in the regression: a grid on part of the data, the best few
    refined.
    """
    part = frame.of(make_problem(records, bandwidth_hz, START_S))
    presliding_rev = [counts * part.lsb_rev for counts in PRESLIDING_LSB]
    while presliding_rev[-1] < start.sliding_travel_rev / PRESLIDING_STEP:
        presliding_rev.append(PRESLIDING_STEP * presliding_rev[-1])
    longest_rev = 1.0 / frame.least_stiffness_per_rev
    presliding_rev = list(dict.fromkeys(min(length_rev, longest_rev) for length_rev in presliding_rev))
    candidates = [
        start_vector(start, 1.0 / length_rev, start.static_nm / (ratio * length_rev))
        for length_rev in presliding_rev
        for ratio in LAG_RATIOS
    ]
    for candidate in candidates:
        candidate[OFFSET_PLACE] = constant_nm
    candidates = [frame.vector(candidate) for candidate in candidates]
    errors = residuals(part, candidates)
    scale = min(robust_scale(e) for e in errors)
    order = ranked(range(len(candidates)), lambda k: huber_cost(errors[k], scale))
    improved = []
    for k in order[:starts]:
        space = frame.space(candidates[k], records[0].period_s)
        found = solve(part, space, to_coordinates(candidates[k], space.scale), START_ITERATIONS)
        improved.append(to_physical(found.values, space.scale))
    return first_best(improved, lambda physical: huber_cost(residual(part, physical), scale))


def mean_of_fits(
    problem: Problem, space: Coordinates, solution: Solution, others: Sequence[Floats]
) -> tuple[Solution, Disagreement]:
    """Mean of fits with observers of several bandwidths, and their disagreement.

    A fast observer lets more sensor noise into the reversals (stiffness comes out low), a slow one attenuates fast
    motion: the mean is closer to the true value than either. If the loss is clearly higher at the mean, as in a flat
    valley, the solution is kept and the largest shift is taken as its uncertainty.
    """
    fits = np.array([solution.values, *others])
    mean = np.clip(fits.mean(axis=0), space.low, space.high)
    at_bound = (solution.values <= space.low) | (solution.values >= space.high)
    mean = np.where(at_bound, solution.values, mean)
    cost = huber_cost(residual(problem, to_physical(mean, space.scale)), solution.scale)
    if not cost <= solution.cost * (1.0 + MEAN_COST):
        return solution, Disagreement(np.abs(fits - solution.values).max(axis=0), 1)
    return solution._replace(values=mean, cost=cost), Disagreement(fits.std(axis=0, ddof=1), len(fits))


def _levels_in_order(solution: Solution) -> Solution:
    """The solution with Fs of at least Fc: static friction is never the smaller one."""
    values = solution.values.copy()
    values[STATIC] = max(values[STATIC], values[COULOMB])
    return solution._replace(values=values)


def _literal(problem: Problem, space: Coordinates, solution: Solution, period_s: float, frame: _Frame) -> float | None:
    """Loss of the literal Stribeck curve (exponent < 0) over that of the classical one, both fitted."""
    names = PARAMETERS
    physical = to_physical(solution.values, space.scale)
    coulomb, static, exponent = (names.index(n) for n in ("coulomb_nm", "static_nm", "stribeck_exponent"))
    physical[exponent] = -physical[exponent]
    physical[coulomb], physical[static] = physical[static], physical[coulomb]
    rising = frame.space(physical, period_s, rising=True)
    # the falling curve with the other sign is excluded: this one has to rise
    start = to_coordinates(physical, rising.scale)
    if start[static] < start[coulomb]:
        start[static] = start[coulomb]
    rising.low[static] = start[static]
    rising.high[coulomb] = start[static]
    errors = residuals(problem, [to_physical(solution.values, space.scale)])[0]
    found = residuals(problem, [to_physical(solve(problem, rising, start, 6).values, rising.scale)])[0]
    scale = robust_scale(errors)
    return huber_cost(found, scale) / huber_cost(errors, scale)


def sensor_delay(records: Sequence[Record]) -> tuple[float | None, float | None]:
    """Lag of the drive's velocity behind the derivative of its position, and its standard deviation, in seconds.

    Regression of their difference on the slope of the velocity; bootstrap over blocks of a second. (None, None) if no
    log has a velocity.
    """
    products: list[float] = []
    squares: list[float] = []
    for record in records:
        if record.velocity_rps is None:
            continue
        period_s = record.period_s
        block = max(1, round(LAG_BLOCK_S / period_s))
        edge = round(LAG_EDGE_S / period_s)
        for part in record.segments():
            if part.stop - part.start < round(LAG_STRETCH_S / period_s):
                continue
            position = low_pass(record.position_rev[part] - record.position_rev[part.start], LAG_HZ, period_s)
            velocity = np.gradient(position, period_s)
            slope = np.gradient(velocity, period_s)
            late = velocity - low_pass(record.velocity_rps[part], LAG_HZ, period_s)
            inside = slice(edge, -edge)
            edges = np.arange(0, late[inside].size, block)
            products += np.add.reduceat(late[inside] * slope[inside], edges).tolist()
            squares += np.add.reduceat(slope[inside] * slope[inside], edges).tolist()
    if sum(squares) <= 0.0:
        return None, None
    return sum(products) / sum(squares), ratio_sd(np.array(products), np.array(squares))


def _warnings(solution: Solution, space: Coordinates, literal_loss: float | None) -> list[str]:
    found = []
    if not solution.converged:
        found.append(f"the fit had not settled after {solution.iterations} iterations")
    for k, name in enumerate(space.names):
        if space.high[k] > space.low[k] and not space.low[k] < solution.values[k] < space.high[k]:
            symbol = SYMBOLS[name].symbol if name in SYMBOLS else name  # of an effect: effect.parameter
            why = "the data contradict this part of the model"
            if name == "static_nm" and not space.rising and solution.values[k] >= space.high[k]:
                why = f"{MOST_ACTED:g} times what acted in the logs. They have too few slow speeds to determine Fs"
            found.append(f"{symbol} stands at a bound of the fit: {why}")
    values = dict(zip(space.names, solution.values, strict=True))
    if "static_nm" in values and values["static_nm"] == values["coulomb_nm"]:
        found.append(
            "the fit put Fs below Fc; Fs is set to Fc: the logs have too few slow speeds, or friction rises with speed"
        )
    if literal_loss is not None and literal_loss < 0.995:
        found.append(
            f"the rising (literal) Stribeck curve fits better: its loss is {literal_loss:.3f} times the falling one's"
        )
    return found
