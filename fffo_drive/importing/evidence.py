"""What the data say of their columns: wraps, steps in time, derivatives, and torque against acceleration."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats
from ..least_squares import least_squares

LEAST_STEPS = 8
LEAST_RUN_ROWS = 50  # of a run within a file
STEADY = 0.5  # of the median step: of a time that scatters, most steps are within
RISING_SHARE = 0.95
MOSTLY = 0.9  # of the steps of a time
COUNTS_TOLERANCE = 0.02
DAY_S = 86_400.0
ANGLE_WRAPS = (1.0, 2.0 * np.pi, 360.0, 4.0 * np.pi, 720.0)
WHOLE_ANGLE_WRAPS = (360.0, 720.0)
COUNTER_WRAPS = tuple(float(1 << bits) for bits in range(8, 33))
STAMP_WRAPS = (
    *COUNTER_WRAPS[8:],
    1e6,
    1e9,
)  # from 2^16: an angle's turn is no reason to wind time on; of the us and ns of a second
WRAP_TOLERANCE = 0.02  # of an angle, which may be scaled and rounded; a counter wraps at a whole number
LEAST_JUMP = 8.0  # smallest steps: a sensor at rest toggles between few values
LARGE_JUMP = 0.5  # of the range: what a motion does not do in one sample
SMOOTH_SAMPLES = 9
SMOOTH_S = 0.01
MOST_POINTS = 200_000  # from which a relation is recognised
LEAST_REGISTER = 128.0  # of 8 bits: smaller numbers may be anything
WORD = 2.0**15  # highest bit of 16
CROSSING = 4.0  # usual steps: how far a number may go where its sign changes
OUTER = 0.25  # a signed number that is stored without its sign lies in the outer quarters of its range


class Relation(NamedTuple):
    """`one` = `slope` times `other`, with this correlation."""

    slope: float
    correlation: float


def is_time(values: Floats) -> bool:
    """Whether values (n,) rise as stamps do: nearly always, by steps that are nearly one."""
    given = values[np.isfinite(values)]
    steps = np.diff(given)
    if steps.size < LEAST_STEPS or not np.mean(steps > 0.0) > RISING_SHARE:
        return False
    usual = float(np.median(steps))
    return bool(np.mean(np.abs(steps - usual) < STEADY * usual) > RISING_SHARE)


def counts_rows(values: Floats) -> bool:
    """Whether values (n,) count rows: whole numbers that go on by one, but where some are lost or it begins anew."""
    steps = np.diff(values[np.isfinite(values)])
    return steps.size >= LEAST_STEPS and are_whole(values) and float(np.mean(steps == 1.0)) > RISING_SHARE


def begins_anew(stamps: Floats) -> list[slice]:
    """The runs of one file: stretches of stamps (n,) at each end of which the clock goes back.

    A step back by a few samples is none (stamps that scatter), nor is a stretch of a few rows.
    """
    places = np.flatnonzero(np.isfinite(stamps))
    steps = np.diff(stamps[places])
    usual = float(np.median(np.abs(steps))) if steps.size else 0.0
    cuts = [0, *(places[1:][steps < -LEAST_STEPS * usual]).tolist(), stamps.size]
    runs = [slice(first, last) for first, last in itertools.pairwise(cuts)]
    return runs if all(run.stop - run.start >= LEAST_RUN_ROWS for run in runs) else [slice(0, stamps.size)]


class Wrap(NamedTuple):
    """What the jumps of a position or a counter say."""

    at: float | None  # the range at which it is unwrapped; None: jumps that are no wrap
    jump: float  # median size, without the motion meanwhile
    sure: bool  # it is a turn, or a range that is known; an assumption otherwise


def wrap_of(values: Floats, turn: float | None = None) -> Wrap | None:
    """The range at which a position wraps; None where nothing jumps. `turn`: one turn in its unit, where that is known.

    Whole turns go first: an encoder of 4000 counts wraps at 4000, close to a power of two.
    """
    found = _jumps(values)
    if found is None:
        return None
    if turn is not None and found.doubt < 0.5 * turn:  # beyond that any multiple would fit
        turns = max(1.0, round(found.size / turn)) * turn
        if abs(found.size - turns) <= found.doubt:
            return Wrap(turns, found.size, True)
    whole = are_whole(values)
    known = [(at, 0.0) for at in (*COUNTER_WRAPS, *(WHOLE_ANGLE_WRAPS if whole else ()))]
    known += [] if whole else [(at, WRAP_TOLERANCE * at) for at in ANGLE_WRAPS]
    fitting = [at for at, tolerance in known if abs(found.size - at) <= found.doubt + tolerance]
    if fitting:
        nearest = min(fitting, key=lambda at: abs(at - found.size))
        return Wrap(nearest, found.size, found.doubt <= WRAP_TOLERANCE * nearest)
    if found.size < LEAST_JUMP * found.smallest_step:
        return None
    # a counter that jumps by one size again and again wraps there, whatever that is: a modulo axis
    return Wrap(float(round(found.size)) if whole and found.alike else None, found.size, False)


def stamp_wrap_of(values: Floats, day: float = math.inf) -> float | None:
    """The range at which a counter of time begins anew, or a `day` in its unit; None where neither does."""
    found = _jumps(values)
    if found is None:
        return None
    able = [*(STAMP_WRAPS if are_whole(values) else ()), day]
    return next((at for at in able if abs(found.size - at) <= found.doubt), None)


class _Jumps(NamedTuple):
    size: float
    doubt: float  # by how much the size may be wrong
    smallest_step: float
    alike: bool  # several, of one size


def _jumps(values: Floats) -> _Jumps | None:
    """Steps that no motion makes in one sample; each without the motion, which is as in the samples beside it."""
    given = values[np.isfinite(values)]
    steps = np.diff(given)
    large = np.abs(steps) > LARGE_JUMP * (float(np.ptp(given)) if given.size else 0.0)
    places = np.flatnonzero(large)
    if not places.size or places.size > LARGE_JUMP * steps.size:
        return None
    others = np.flatnonzero(~large)
    small = steps[others]
    sizes = np.abs(steps[places] - np.interp(places, others, small))
    behind = np.minimum(np.searchsorted(others, places), others.size - 1)
    changes = np.abs(small[behind] - small[np.maximum(behind - 1, 0)])  # of the motion, at the jumps
    usual = float(np.quantile(np.abs(np.diff(small)), 0.9)) if small.size > 1 else 0.0
    size = float(np.median(sizes))
    doubt = max(2.0 * usual, float(np.median(changes))) + (1.0 if are_whole(values) else 1e-9 * size)
    moving = np.abs(small[small != 0.0])
    alike = sizes.size > 1 and float(np.median(np.abs(sizes - size))) <= doubt
    return _Jumps(size, doubt, float(moving.min()) if moving.size else size, alike)


def are_whole(values: Floats) -> bool:
    """Whether values (n,) are whole numbers, those that are missing apart."""
    given = values[np.isfinite(values)]
    return bool(np.array_equal(given, np.round(given)))


def unwrapped(values: Floats, wrap: float) -> Floats:
    """A position without the wraps at `wrap`; missing samples are left as they are."""
    found = values.copy()
    given = np.isfinite(values)
    found[given] = np.unwrap(values[given], period=wrap)
    return found


class Register(NamedTuple):
    """How a signed number lies in a register without a sign."""

    kind: str
    at: float  # two's complement: its range; else the smallest number with the sign's bit, or that stands for zero

    @property
    def said(self) -> str:
        """In words, for the evidence."""
        return f"stored as {self.kind} ({self.at:g}), sign restored"


TWOS, MAGNITUDE, OFFSET = "two's complement", "sign and magnitude", "offset binary"


def sign_bit_of(values: Floats) -> Register | None:
    """The highest bit of whole positive numbers (n,), which may be their sign; None of others."""
    given = values[np.isfinite(values)]
    if given.size < LEAST_STEPS or given.min() < 0.0 or given.max() < LEAST_REGISTER or not are_whole(given):
        return None
    return Register(MAGNITUDE, 2.0 ** math.floor(math.log2(given.max())))


def register_of(values: Floats, counter: bool = False) -> Register | None:
    """The register that signed numbers (n,) were stored in without their sign; None where they were not.

    `counter`: a position, which wraps and does not overflow. Feetech servos have the sign in bit 10, 11 or 15.
    """
    found = sign_bit_of(values)
    if found is None:
        return None
    given, bit = values[np.isfinite(values)], found.at
    if not counter and bit in (WORD, WORD**2 * 2.0):  # nothing between small numbers and those with the bit
        low, high = given[given < bit], given[given >= bit]
        if low.size and low.max() < 0.5 * bit:
            if high.min() > 1.5 * bit:
                return Register(TWOS, 2.0 * bit)
            if high.max() < 1.5 * bit:
                return found
    crossing = np.diff(given >= bit)
    raw, folded = np.abs(np.diff(given)), np.abs(np.diff(signed(given, found)))
    if int(crossing.sum()) >= 2 and not crossing.all():
        # through zero the number goes on as it does elsewhere; what lies in the register jumps by the bit
        usual = CROSSING * float(np.quantile(folded[~crossing], 0.9)) + 1.0
        if float(np.median(folded[crossing])) <= usual < min(float(np.median(raw[crossing])), 0.5 * bit):
            return found
    return None


def offset_of(values: Floats, least: float = LEAST_REGISTER) -> Register | None:
    """A power of two about which whole positive numbers (n,) swing to both sides, as of a converter without a sign.

    `least`: smallest one that may be it.
    """
    given = values[np.isfinite(values)]
    if not given.size or given.min() < 0.0 or given.max() < LEAST_REGISTER or not are_whole(given):
        return None
    zero = 2.0 ** round(math.log2(max(float(np.median(given)), 1.0)))
    below, above = zero - float(given.min()), float(given.max()) - zero
    balanced = min(below, above) > (1.0 - LARGE_JUMP) * max(below, above)
    wide = zero >= WORD or below > OUTER**2 * zero
    return Register(OFFSET, zero) if balanced and zero >= least and wide else None


def signed(values: Floats, register: Register | None) -> Floats:
    """Values with the sign that was lost; as they are where there is no register."""
    if register is None:
        return values
    kind, at = register
    if kind == OFFSET:
        return values - at
    return np.where(
        values >= (at if kind == MAGNITUDE else 0.5 * at), at - values if kind == MAGNITUDE else values - at, values
    )


def at_stamps(values: Floats, stamps: Floats, wanted: Floats, wrap: float | None = None) -> Floats:
    """Values of some stamps at others of the same clock, by straight lines; NaN before the first and after the last.

    What wraps is interpolated through its wraps and wraps afterwards: where it does tells of its unit.
    """
    given = np.isfinite(values) & np.isfinite(stamps)
    order = np.argsort(stamps[given], kind="stable")
    values, stamps = values[given][order], stamps[given][order]
    if not values.size:
        return np.full(wanted.size, np.nan)
    running = values if wrap is None else unwrapped(values, wrap)
    found = np.interp(wanted, stamps, running, left=np.nan, right=np.nan)
    return np.asarray(found if wrap is None else np.mod(found - values.min(), wrap) + values.min())


def smooth_derivative(values: Floats, time_s: Floats) -> tuple[Floats, Floats]:
    """Derivative (n,) of values by time over a short window, and its own derivative."""
    period_s = float(np.median(np.diff(time_s)))
    half = max(SMOOTH_SAMPLES, round(SMOOTH_S / period_s) | 1) // 2

    def slope(of: Floats) -> Floats:
        before = np.maximum(np.arange(of.size) - half, 0)
        behind = np.minimum(np.arange(of.size) + half, of.size - 1)
        return np.asarray((of[behind] - of[before]) / np.maximum(time_s[behind] - time_s[before], 1e-300))

    first = slope(values)
    return first, slope(first)


def smoothed(values: Floats) -> Floats:
    """Values (n,) over the window of `smooth_derivative`."""
    return np.asarray(scipy.ndimage.uniform_filter1d(values, SMOOTH_SAMPLES))


def _thinned(values: Floats) -> Floats:
    """Every so many of values (n,), MOST_POINTS of them and not twice as many."""
    return values[:: max(1, values.size // MOST_POINTS)]


def relation(one: Floats, other: Floats) -> Relation:
    """Least squares of `one` on `other`, (n,) each, without constants."""
    one, other = _thinned(one), _thinned(other)
    use = np.isfinite(one) & np.isfinite(other)
    one, other = one[use], other[use]
    power, own = float(other @ other), float(one @ one)
    if power <= 0.0 or own <= 0.0:
        return Relation(0.0, 0.0)
    product = float(one @ other)
    return Relation(product / power, product / np.sqrt(power * own))


class Driven(NamedTuple):
    """What a column that may drive the axis has in common with its motion."""

    share: float  # R^2 by inertia and friction
    inertia: float  # of the column, in its unit and that of the acceleration
    against: bool  # it takes power out on the whole, and opposes the acceleration: its sign is reversed


def driven_by(column: Floats, velocity: Floats, acceleration: Floats) -> Driven:
    """How much of a column (n,) inertia and friction explain, and whether its sign is that of the motion."""
    column, velocity, acceleration = _thinned(column), _thinned(velocity), _thinned(acceleration)
    sign = np.tanh(velocity / max(0.05 * float(np.quantile(np.abs(velocity), 0.9)), 1e-12))
    matrix = np.stack([acceleration, velocity, sign, np.ones_like(sign)], axis=1)
    use = np.isfinite(column) & np.isfinite(matrix).all(axis=1)
    matrix, target = matrix[use], column[use]
    if target.size < LEAST_STEPS or float(np.ptp(target)) == 0.0:
        return Driven(0.0, 0.0, False)
    found = least_squares(matrix, target)
    share = 1.0 - float(np.var(found.residual)) / float(np.var(target))
    return Driven(share, float(found.values[0]), float(target @ matrix[:, 1]) < 0.0 and float(found.values[0]) < 0.0)


def rises(values: Floats) -> bool:
    """Whether values (n,) hardly ever fall."""
    steps = np.diff(values[np.isfinite(values)])
    return bool((steps > 0.0).any()) and float(np.mean(steps >= 0.0)) > MOSTLY


def is_flag(values: Floats) -> bool:
    """Nothing but 0 and 1."""
    return bool(np.isin(values[np.isfinite(values)], (0.0, 1.0)).all())


def says_nothing(values: Floats) -> bool:
    """All missing, or one number throughout."""
    given = values[np.isfinite(values)]
    return given.size < 2 or bool(given.min() == given.max())


def bridged(values: Floats) -> Floats:
    """Missing samples by straight lines, for derivatives."""
    given = np.isfinite(values)
    if given.all():
        return values
    places = np.arange(values.size)
    return np.interp(places, places[given], values[given])


def likely_counts(found: float) -> float:
    """Counts of a turn: a power of two or a round number nearby, else the next whole number."""
    power = 2.0 ** round(math.log2(found)) if found > 1.0 else found
    if abs(found / power - 1.0) < COUNTS_TOLERANCE:
        return power
    digits = 10.0 ** max(0, math.floor(math.log10(max(found, 1.0))) - 1)
    rounded = round(found / digits) * digits
    return rounded if abs(found / rounded - 1.0) < COUNTS_TOLERANCE else float(round(found))
