"""Does the measured current show it? What acts between command and current is seen there, without any mechanics.

A limit of the voltage or a lag of the current loop leaves the measured current short of its command by just what the
motion misses. Where a current was measured, a law of that kind is believed only if the current says so.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .base import delayed
from .candidates import Effect, effect_rows
from .fitting import Data, Fitted, consistent_scenes

Floats = npt.NDArray[np.float64]

SHOWN_BY_CURRENT = frozenset({"voltage_limit", "current_lag"})
LEAST_SHARE = 0.5  # of an effect's torque that has to be missing in the measured current
LONGEST_SAMPLES = 20
FINENESS = 4  # delays tried a sample


def missing_rows(data: Data) -> Floats | None:
    """Torque that the measured current is short of its command, at the rows (m,); None where none was measured."""
    parts = []
    for stretch in data.stretches:
        if stretch.measured_a is None:
            return None
        delays = np.arange(0, LONGEST_SAMPLES * FINENESS) / FINENESS
        thin = slice(None, min(stretch.current_a.size, 40_000))
        errors = [float(np.mean((delayed(stretch.current_a[thin], d) - stretch.measured_a[thin]) ** 2)) for d in delays]
        best = float(delays[int(np.argmin(errors))])
        short = delayed(stretch.current_a, best) - stretch.measured_a
        parts.append(data.rows.filter.rows(stretch.torque_constant_nm_per_a * short))
    return np.concatenate(parts)


def shown_share(data: Data, missing_nm: Floats, fitted: Fitted, effect: Effect) -> float:
    """Share of an effect's torque that is missing in the measured current: 1 for what acts on the command."""
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    load = effect_rows(scenes, effect, data.rows.laws)
    kept = data.rows.kept
    power = float(load[kept] @ load[kept])
    return float(load[kept] @ missing_nm[kept]) / power if power > 0.0 else 0.0
