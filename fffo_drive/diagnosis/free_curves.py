"""What is in no list: free curves over every axis, as torque, friction, drag or viscous friction, and over memory.

Each curve is a table of the library's `lookup` law, so that what is found here is a law that can be refitted, written
to a model file and, over an axis that a feed-forward knows, compensated. Knots lie where the data are.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import numpy.typing as npt

from ..identification.prediction import THREADS
from ..identification.ranking import lower, ranked
from ..model.effects import slots
from ..model.effects.laws.lookup import BRAKE, FRICTION, PLAIN, RESPONSE, UNKNOWN, VISCOUS, WOUND
from .candidates import Columns, Scene, effect_of
from .curves import Axis, abscissa, curve_columns
from .evidence import Evidence, score
from .screening import Trial

Floats = npt.NDArray[np.float64]

KNOTS = 12
FINE_KNOTS = 22  # of an axis on which things happen at all scales, and of several turns
MOTOR_PERIODS_REV = (1.0, 2.0, 3.0, 4.0, 5.0)  # what meets again every so many turns
SCALELESS = ("dwell", "travel_since_reversal")
FREQUENCY = UNKNOWN + "frequency"
RESPONSE_KNOTS = 7
LOWEST_HZ = 0.5
LEAST_REACH_REV = 0.05  # of what is wound up: beyond presliding and what is near it
HIGHEST_SHARE = 0.4  # of the rate of the rows


def axes_of(turns: float) -> list[Axis]:
    """All axes that a motion over so many turns allows."""
    found = [
        Axis("time", FRICTION, 0.0), Axis("velocity", PLAIN, 0.0), Axis("acceleration", PLAIN, 0.0),
        Axis("current", PLAIN, 0.0), Axis("dwell", FRICTION, 0.0), Axis("travel_since_reversal", FRICTION, 0.0),
        Axis("memory", FRICTION, 0.5), Axis("memory", FRICTION, 3.0), Axis("memory", FRICTION, 12.0),
        Axis("direction", PLAIN, 0.0), Axis("torque", FRICTION, 0.0),
    ]  # fmt: skip
    found += [Axis("memory", FRICTION, time_constant_s, 1.0) for time_constant_s in (1.0, 4.0, 16.0)]
    for period_rev in MOTOR_PERIODS_REV:
        if turns > 3.0 * period_rev:
            found += [Axis("motor_angle", kind, period_rev) for kind in (PLAIN, FRICTION, BRAKE)]
    found += [Axis("output_angle", kind, 0.0) for kind in (PLAIN, FRICTION, BRAKE)]
    found += [Axis(word, VISCOUS, 0.0) for word in ("time", "current", "output_angle")]
    found += [Axis("memory", VISCOUS, 3.0), Axis("memory", VISCOUS, 12.0)]
    return found


def free_trials(evidence: Evidence, scenes: Sequence[Scene]) -> list[Trial]:
    """The best curve of every axis word, what explains most first."""
    turns = float(np.ptp(evidence.rows.position_rev))
    with ThreadPoolExecutor(THREADS) as pool:
        found = list(pool.map(partial(_trial, evidence, scenes), axes_of(turns)))
    found += [response_trial(evidence, scenes), wound_trial(evidence, scenes)]
    best: dict[str, Trial] = {}
    for trial in found:
        if trial is not None and (trial.name not in best or lower(-trial.explained, -best[trial.name].explained)):
            best[trial.name] = trial
    return ranked(best.values(), key=lambda t: -t.explained)


def _trial(evidence: Evidence, scenes: Sequence[Scene], axis: Axis) -> Trial | None:
    places = abscissa(scenes, axis)
    knots = knots_of(np.concatenate([p[s.moving > 0.0] for p, s in zip(places, scenes, strict=True)]), axis)
    if knots.size < 4:
        return None
    shapes = {**_shapes(axis.kind, knots), "scale": axis.scale, "of_current": axis.of_current}
    return curve_trial(evidence, scenes, UNKNOWN + axis.word, shapes)


def curve_trial(evidence: Evidence, scenes: Sequence[Scene], name: str, shapes: dict[str, float]) -> Trial | None:
    """The best values of a lookup with these shapes; None where the base can do all of it."""
    columns = np.concatenate([curve_columns(scene, name, shapes, evidence.rows.laws) for scene in scenes])
    names = tuple(f"y{k:02d}" for k in range(columns.shape[1]))
    joined = Columns(names, (-1,) * len(names), columns)
    found = score(evidence, joined.values)
    if found.rank == 0:
        return None
    effect = effect_of(name, shapes, joined, found.strengths, 1)
    return Trial(name, shapes, found.explained, found.rank, effect, found.window_scores, joined)


def response_trial(evidence: Evidence, scenes: Sequence[Scene]) -> Trial | None:
    """The best bank of bands over frequency: how the residual answers to the motor torque."""
    highest_hz = HIGHEST_SHARE / evidence.rows.filter.row_period_s
    knots = np.geomspace(LOWEST_HZ, highest_hz, RESPONSE_KNOTS)
    return curve_trial(evidence, scenes, FREQUENCY, _shapes(RESPONSE, knots))


def wound_trial(evidence: Evidence, scenes: Sequence[Scene]) -> Trial | None:
    """The best set of springs that slip, of reaches beyond presliding: hysteresis over the travel."""
    travel = np.concatenate([s.motion[s.moving > 0.0, slots.TRAVEL_REV] for s in scenes])
    furthest_rev = 0.5 * float(np.quantile(travel, 0.99)) if travel.size else 0.0
    if furthest_rev < 4.0 * LEAST_REACH_REV:
        return None
    knots = np.geomspace(LEAST_REACH_REV, furthest_rev, KNOTS)
    return curve_trial(evidence, scenes, UNKNOWN + "memory", _shapes(WOUND, knots))


def _shapes(kind: float, knots: Floats) -> dict[str, float]:
    return {"kind": kind, "count": float(knots.size)} | {f"x{k:02d}": float(x) for k, x in enumerate(knots)}


def knots_of(places: Floats, axis: Axis) -> Floats:
    """Knots where the data are: between even steps of the range and even shares of the samples."""
    low, high = (float(x) for x in np.quantile(places, (0.002, 0.998)))
    if not high > low:
        return np.zeros(0)
    if axis.scale > 0.0 and axis.word in ("motor_angle", "output_angle"):
        return np.linspace(0.0, axis.scale, KNOTS if axis.scale == 1.0 else FINE_KNOTS)
    shares = np.linspace(0.0, 1.0, KNOTS)
    if axis.word in SCALELESS:
        small = max(float(np.quantile(places[places > 0.0], 0.05)), 1e-3 * high) if (places > 0.0).any() else low
        found = np.geomspace(small, high, FINE_KNOTS)
    else:
        found = 0.5 * (np.quantile(places, 0.002 + 0.996 * shares) + low + (high - low) * shares)
    distinct = [float(found[0])]
    for x in found[1:]:
        if x - distinct[-1] > (0.0 if axis.word in SCALELESS else 0.01 * (high - low)):
            distinct.append(float(x))
    return np.array(distinct)
