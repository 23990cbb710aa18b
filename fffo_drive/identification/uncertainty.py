"""Uncertainty of the parameters of a fit, and parameters that the data do not determine.

Residuals of a mechanical axis are coloured: neighbouring residuals are correlated. The covariance is therefore the
sandwich over whole windows: the score of each window counts once, with any correlation inside it, and adjacent windows
may be dependent:

    C = H^-1 (sum_w sum_l b_l (g_w g_w+l' + g_w+l g_w')) H^-1,   H = J' W J,   g_w = J_w' W e_w,   b_l = 1/2, 2/3, 1/3

A model is also never exact. The fit is repeated with observers of other bandwidths, which weigh slow and fast
errors differently: an exact model gives the same parameters except for noise. Further disagreement of the k fits is a
between-fit variance tau^2 (method of moments, as in a meta-analysis), and the mean of k fits has tau^2 / k of it. It is
added in quadrature as specification error, and so is the bias by the sensor's noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..least_squares import SINGULAR, huber_weights, normal_equations, spectrum, sums_by
from .coordinates import LOG_SPAN, Coordinates, physical_slope
from .prediction import Problem, jacobian
from .ranking import ranked
from .solver import HUBER, LARGEST_STEP, Point, Solution, point_at, slopes_at

UNKNOWN_SD = 0.25  # of a coordinate (25 % of a positive parameter): the data do not determine it
COLLINEAR_VIF = 200.0
COLLINEAR_SD = 0.02  # a collinear parameter with a smaller deviation counts as determined
SHARED_ERROR = 0.17  # correlation of the errors of fits of one data set at 1, 3/4 and 1/2 of the bandwidth, 30 seeds
DEPENDS = 0.05  # of a coordinate (5 %): a parameter that moves so far with one that a bound has stopped depends on it
FEWEST_BLOCKS = 8  # blocks for resampling; fewer do not give a standard deviation
FEWEST_MOMENTS = 4.0  # a parameter that fewer windows determine counts as undetermined, whatever the sandwich gives
UNFIT = "slow and fast errors ask for different values: the model lacks something that acts on it"
UNFIT_ADVICE = "no other excitation, but a look at the residuals: an effect is missing"
ADVICE = {
    "inertia_nm_s2_per_rev": ("too little acceleration", "accelerate/brake pairs, or the current chirp up to 10 Hz"),
    "delay_s": ("too little fast torque", "the chirp to 50 Hz"),
    "viscous_nm_per_rps": ("too narrow a range of speeds", "a staircase of constant speeds up to the highest"),
    "coulomb_nm": ("too little sliding at middle speeds", "a staircase of constant speeds, both ways"),
    "static_nm": ("too few slow motions", "slow triangles and break-aways after dwells"),
    "stribeck_velocity_rps": ("too few slow speeds", "a staircase with levels around the Stribeck velocity"),
    "stribeck_exponent": ("too few slow speeds", "a staircase with levels around the Stribeck velocity"),
    "stiffness_per_rev": ("too few reversals", "slow triangles at two accelerations"),
    "attraction_nm_per_rev": ("too few reversals at different accelerations", "slow triangles and biased sines"),
    "offset_nm": ("motion one way only", "the same motion both ways"),
}


class Doubt(NamedTuple):
    """A parameter that the data do not determine."""

    name: str
    reason: str
    excitation: str
    confused_with: tuple[str, ...]


class Disagreement(NamedTuple):
    """Disagreement of fits with other observers in the same coordinates."""

    sd: Floats  # standard deviation between them; where `fits` is 1 the largest shift
    fits: int  # of which the solution is the mean


class Uncertainty(NamedTuple):
    """In the order of coordinates.PARAMETERS; fixed parameters have zero."""

    sd: Floats  # physical units
    statistical_sd: Floats  # the part from noise
    specification_sd: Floats  # the part from the bandwidths and from the bias
    correlation: Floats  # (p, p)
    inflation: Floats  # variance inflation factors
    windows: int
    moments: Floats  # effective number of windows that determine each parameter
    doubts: tuple[Doubt, ...]


def uncertainty_of(
    problem: Problem, space: Coordinates, solution: Solution, shift: Floats, disagreement: Disagreement | None = None
) -> Uncertainty:
    """Standard deviations of a solution. `shift` (coordinates): possible bias, of either sign."""
    size = len(space.names)
    point = point_at(problem, space, solution.values)
    errors = point.errors
    free, matrix = slopes_at(problem, space, point)
    weights = huber_weights(errors, HUBER * solution.scale)
    found = spectrum(normal_equations(matrix, errors, weights).matrix, SINGULAR)
    scaled = found.inverse()
    inverse = scaled / np.outer(found.lengths, found.lengths)
    clusters = problem.clusters()
    scores = sums_by(clusters, (weights * errors)[:, None] * matrix)
    windows = scores.shape[0]
    covariance = inverse @ _dependent_sum(scores) @ inverse * (windows / max(1.0, windows - free.size))
    statistical = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    statistical[np.isinf(found.lengths)] = LOG_SPAN
    doubtful = np.abs(shift[free])
    if disagreement is not None:
        explained = (1.0 - SHARED_ERROR) * statistical * statistical if disagreement.fits > 1 else 0.0
        between = np.maximum(0.0, disagreement.sd[free] ** 2 - explained)
        doubtful = np.sqrt(doubtful * doubtful + between / disagreement.fits)
    coordinate_sd = np.zeros((2, size))
    coordinate_sd[:, free] = statistical, doubtful
    sd = coordinate_sd * physical_slope(solution.values, space.scale)
    correlation = np.eye(size)
    scale = np.where(statistical > 0.0, statistical, 1.0)
    correlation[np.ix_(free, free)] = covariance / np.outer(scale, scale)
    inflation = np.ones(size)
    inflation[free] = np.diag(scaled)
    moments = np.zeros(size)
    moments[free] = _moments(np.sqrt(weights)[:, None] * matrix, inverse, clusters)
    doubts = _doubts(space, coordinate_sd, correlation, inflation, moments)
    known = Uncertainty(np.hypot(*sd), sd[0], sd[1], correlation, inflation, windows, moments, doubts)
    for stopped, names in _dependent(problem, space, point, solution.scale, free, coordinate_sd).items():
        known = undetermined(known, space.names, names, f"depends on {stopped}, which stands at a bound of the fit")
    return known


def undetermined(known: Uncertainty, order: Sequence[str], names: Sequence[str], reason: str) -> Uncertainty:
    """Without an interval of these parameters of the `order`, and with a doubt of each, for a reason."""
    arrays = [known.sd.copy(), known.statistical_sd.copy(), known.specification_sd.copy()]
    doubts = [doubt for doubt in known.doubts if doubt.name not in names]
    for name in names:
        for array in arrays:
            array[order.index(name)] = 0.0
        if name in ADVICE:
            doubts.append(Doubt(name, reason, ADVICE[name][1], ()))
    doubts.sort(key=lambda doubt: order.index(doubt.name))
    return known._replace(sd=arrays[0], statistical_sd=arrays[1], specification_sd=arrays[2], doubts=tuple(doubts))


def _dependent(
    problem: Problem, space: Coordinates, point: Point, scale: float, free: Integers, sd: Floats
) -> dict[str, list[str]]:
    """Free parameters by the one at a bound that they depend on: they would move with the step that the bound stops.

    A delay of zero is no bound of the fit but of nature, and what stands there is known.
    """
    movable = np.flatnonzero(space.high > space.low)
    stopped = [k for k in movable if k not in free and not (space.names[k] == "delay_s" and point.values[k] <= 0.0)]
    if not stopped or not free.size:
        return {}
    places = np.concatenate([free, np.array(stopped, dtype=np.int64)])
    matrix = jacobian(problem, space, point.values, point.errors, places, central=False)
    normal = normal_equations(matrix, -point.errors, huber_weights(point.errors, HUBER * scale))
    size, found = free.size, {}
    inverse = spectrum(normal.matrix[:size, :size], SINGULAR)
    for column, k in enumerate(stopped, size):
        step = normal.moment[column] / max(float(normal.matrix[column, column]), 1e-300)
        moved = inverse.solution(normal.matrix[:size, column]) * min(abs(step), LARGEST_STEP)
        far = np.abs(moved) > np.maximum(DEPENDS, np.hypot(*sd[:, free]))
        names = [space.names[j] for j, large in zip(free, far, strict=True) if large]
        if names:
            found[space.names[k]] = names
    return found


def ratio_sd(numerators: Floats, denominators: Floats, draws: int = 1000, seed: int = 1) -> float | None:
    """Standard deviation of sum(numerators) / sum(denominators) over resampled blocks (n,); None for too few."""
    if numerators.size < FEWEST_BLOCKS:
        return None
    drawn = np.random.default_rng(seed).integers(0, numerators.size, (draws, numerators.size))
    below = denominators[drawn].sum(axis=1)
    return float(np.std(numerators[drawn].sum(axis=1)[below > 0.0] / below[below > 0.0]))


def _moments(matrix: Floats, inverse: Floats, clusters: Integers) -> Floats:
    """1 / sum of squared shares of the windows in what is known of each parameter, the others projected out."""
    own = (matrix @ inverse) ** 2
    shares = sums_by(clusters, own) / np.maximum(own.sum(axis=0), 1e-300)
    return np.asarray(1.0 / np.maximum((shares * shares).sum(axis=0), 1e-300))


def _dependent_sum(scores: Floats) -> Floats:
    """Sum of outer products of the windows' scores; the next two windows count 2/3 and 1/3 (Bartlett)."""
    total = scores.T @ scores
    for lag, weight in ((1, 2.0 / 3.0), (2, 1.0 / 3.0)):
        cross = scores[:-lag].T @ scores[lag:]
        total = total + weight * (cross + cross.T)
    return np.asarray(total)


def _doubts(
    space: Coordinates, sd: Floats, correlation: Floats, inflation: Floats, moments: Floats
) -> tuple[Doubt, ...]:
    """`sd` (2, parameters): from noise and from specification, in coordinates."""
    total = np.hypot(sd[0], sd[1])
    found = []
    for k, name in enumerate(space.names):
        if name not in ADVICE or space.high[k] <= space.low[k]:
            continue
        unknown = total[k] > UNKNOWN_SD or total[k] == 0.0
        alike = np.abs(correlation[k]).tolist()
        nearest = ranked(range(len(alike)), key=[-share for share in alike].__getitem__)[:4]
        partners = tuple(space.names[j] for j in nearest if j != k and alike[j] > 0.95)
        rare = 0.0 < moments[k] < FEWEST_MOMENTS
        if unknown or rare or (inflation[k] > COLLINEAR_VIF and partners and total[k] > COLLINEAR_SD):
            reason, excitation = ADVICE[name]
            if not rare and unknown and 0.0 < sd[0, k] < 0.5 * sd[1, k]:
                found.append(Doubt(name, UNFIT, UNFIT_ADVICE, partners))
                continue
            if rare:
                reason = f"only about {moments[k]:.1f} quarter seconds of the data bear on it ({reason})"
            elif not unknown:
                reason = f"hardly distinguishable from {', '.join(partners)} ({reason})"
            found.append(Doubt(name, reason, excitation, partners))
    return tuple(found)
