"""The start of the fit: a linear regression of the motor's torque on the motion.

    Kt i(t - Td) = J a + sigma w + sgn(w) (Fc + (Fs - Fc) exp(-(|w| / Vs)^delta)) + constant

Linear in J, sigma, Fc, Fs - Fc and the constant; Td, Vs and delta are scanned, on the rows of `rows`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..least_squares import LinearFit, least_squares
from .dataset import CUTOFF_PERIODS, DataError, Record
from .kinematics import DEFAULT_CUTOFF_HZ
from .ranking import lower
from .rows import (
    CONSTANT,
    DIRECTION,
    RegressionRows,
    rigid_balance,
    rigid_columns,
    rows_at,
    stretches_of,
    turns_one_way,
)

EXPONENTS = (1.0, 1.5, 2.0)  # below, a curve of half the top speed takes in a drag
LEAST_ROWS = 200
# Noise of the acceleration makes the inertia small. The cut-off is halved while that raises the inertia by LOST_INERTIA
# and what the acceleration explains by BETTER_TOLD (a Hall sensor of 42 edges a turn: 40 to 10 Hz; measured and blind
# drives: none)
WELL_TOLD, BETTER_TOLD, LOST_INERTIA = 0.95, 0.03, 0.04
LOWEST_CUTOFF_HZ = 4.0
STRIBECK_SHARE = 0.02  # of the squared residual, that a Stribeck curve has to explain to be seen
LEAST_TOLD = 0.005  # of the torque beside friction: with less the acceleration is not seen (steady speeds: 0.001)
HELD_RPS2 = 1000.0  # acceleration of the inertia that then stands in by the static friction
TORQUE_TO_INERTIA_RPS2 = (5.0, 30_000.0)  # acceleration at the rated current of any sane rotary axis


class TorqueStart(NamedTuple):
    """Result of the regression; torques in Nm (N), with revolutions (m)."""

    inertia_nm_s2_per_rev: float
    viscous_nm_per_rps: float
    coulomb_nm: float
    static_nm: float
    stribeck_velocity_rps: float
    stribeck_exponent: float
    delay_s: float
    sliding_travel_rev: float
    constant_nm: float  # 0 if the axis turns one way only
    most_friction_nm: float = math.inf  # that acted in the logs, stuck or sliding, without its viscous part
    cutoff_hz: float = DEFAULT_CUTOFF_HZ
    is_noisy: bool = False  # the cut-off is lowered: above it the sensor's noise hides the acceleration
    has_inertia: bool = True  # False: hardly anything accelerates, and the inertia is held at no value of the axis
    has_stribeck: bool = True  # False: nor does the friction fall with speed, and Fs is Fc
    has_delay: bool = True  # False: the scan has no minimum, and the delay is not known
    most_viscous_nm_per_rps: float = math.inf  # as much at high speed as all that acted in the logs beside the inertia


def _solve(rows: RegressionRows, bump: Floats | None = None) -> LinearFit:
    """Inertia, viscous and Coulomb friction, what multiplies `bump` (m,), a constant.

    The constant is left out where the axis turns one way, and is then the same thing as Coulomb friction.
    """
    columns = rigid_columns(rows)[rows.sliding]
    if turns_one_way(columns[:, DIRECTION]):
        columns[:, CONSTANT] = 0.0
    if bump is not None:
        columns = np.insert(columns, CONSTANT, bump, axis=1)
    return least_squares(columns, rows.torque_nm[rows.sliding])


def regression_start(records: Sequence[Record], cutoff_hz: float = DEFAULT_CUTOFF_HZ) -> TorqueStart:
    """Start values from one or several records of one axis.

    Raises DataError if the records do not contain enough sliding motion.
    """
    highest_hz = cutoff_hz = min(cutoff_hz, CUTOFF_PERIODS / records[0].period_s)
    stretches, travel_rev = stretches_of(records, cutoff_hz)
    count = sum(int(np.count_nonzero(stretch.sliding[stretch.rows])) for stretch in stretches)
    if count < LEAST_ROWS:
        raise DataError(
            f"only {count} samples of sure sliding motion in {len(records)} log(s), {LEAST_ROWS} "
            "are needed: raise the current of the excitation, or add a run at higher speed"
        )
    rigid = rigid_balance(stretches, cutoff_hz)
    while rigid.told < WELL_TOLD and 0.5 * cutoff_hz > LOWEST_CUTOFF_HZ:
        slower, other_rev = stretches_of(records, 0.5 * cutoff_hz)
        if sum(int(np.count_nonzero(stretch.sliding[stretch.rows])) for stretch in slower) < LEAST_ROWS:
            break
        other = rigid_balance(slower, 0.5 * cutoff_hz)
        noisy = other.inertia_nm_s2_per_rev > (1.0 + LOST_INERTIA) * rigid.inertia_nm_s2_per_rev
        if not (noisy and other.told > rigid.told + BETTER_TOLD):
            break
        rigid, stretches, travel_rev, cutoff_hz = other, slower, other_rev, 0.5 * cutoff_hz
    delay_s = rigid.delay_s
    rows = rows_at(stretches, cutoff_hz, delay_s)
    direction = rows.direction[rows.sliding]
    torque_nm = rows.torque_nm[rows.sliding]
    speed = np.abs(rows.velocity_rps[rows.sliding])
    best = (np.inf, 1.0, 1.0, np.zeros(5))
    low, high = float(np.quantile(speed, 0.02)), float(np.quantile(speed, 0.9))
    for velocity in np.geomspace(max(low, 1e-3 * high), 0.5 * high, 14):
        for exponent in EXPONENTS:
            found = _solve(rows, direction * np.exp(-((speed / velocity) ** exponent)))
            if (found.values[1:4] > 0.0).all() and lower(found.cost, best[0]):
                best = (found.cost, float(velocity), exponent, found.values)
    has_inertia = bool(rigid.told > LEAST_TOLD)
    found = _solve(rows)
    has_stribeck = has_inertia or best[0] < (1.0 - STRIBECK_SHARE) * found.cost
    if not (np.isfinite(best[0]) and has_stribeck):
        best = (found.cost, 0.1 * high, 1.0, np.insert(found.values, CONSTANT, 0.1 * abs(found.values[2])))
    velocity, exponent = best[1:3]
    inertia, viscous, coulomb, excess, constant = (float(value) for value in best[3])
    coulomb = max(coulomb, 1e-3 * float(np.abs(torque_nm).mean()))
    viscous = max(viscous, 1e-3 * coulomb / high)
    static = coulomb + (min(max(excess, 0.02 * coulomb), 6.0 * coulomb) if has_stribeck else 0.0)
    if not has_inertia:
        inertia = static / HELD_RPS2
    acted = rows.torque_nm - inertia * rows.acceleration_rps2 - constant
    friction = acted - viscous * rows.velocity_rps
    return TorqueStart(
        inertia,
        viscous,
        coulomb,
        static,
        velocity,
        exponent,
        delay_s,
        travel_rev,
        constant,
        max(static, float(np.abs(friction).max())),
        cutoff_hz,
        cutoff_hz < highest_hz,
        has_inertia,
        has_stribeck,
        rigid.has_minimum,
        float(np.abs(acted).max()) / high,
    )


def start_problems(start: TorqueStart, torque_constant_nm_per_a: float, rated_current_a: float | None) -> list[str]:
    """Sentences if the start suggests wrong units rather than a real axis; empty if it is plausible."""
    problems = []
    inertia = start.inertia_nm_s2_per_rev
    if not inertia > 0.0:
        return [
            f"the fitted inertia is {inertia:.3g} Nm s^2/rev: torque and acceleration have opposite signs, or hardly "
            "anything accelerates. Check the signs of command and position, and that both are of the same run"
        ]
    if rated_current_a is not None:
        acceleration = torque_constant_nm_per_a * rated_current_a / inertia
        low, high = TORQUE_TO_INERTIA_RPS2
        if not low <= acceleration <= high:
            way = "small" if acceleration > high else "large"
            problems.append(
                f"the fitted inertia is absurdly {way}: {inertia:.3g} Nm s^2/rev would accelerate at "
                f"{acceleration:.3g} rev/s^2 under the rated current ({low:g} to {high:g} are sane). A unit is "
                "wrong: rpm for rps is a factor of 60, rad for rev 6.28, degrees 360; or the torque constant is not "
                "that of this drive"
            )
    return problems
