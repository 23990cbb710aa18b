"""A torque sensor between motor and load as the judge of the torque that the current is taken for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..least_squares import least_squares
from .dataset import Record

DECLARED_TOLERANCE = 0.1  # of a declared torque constant: catalogues give it within that
SMOOTHED_S = 0.02  # of a position before its second derivative


def sensor_remarks(records: Sequence[Record]) -> list[str]:
    """What the sensor says of the torque constant, one sentence; none where no run has a sensor.

    The sensor reads the torque of the motor without what its rotor takes: constant times current, less a share of the
    acceleration. Friction before the sensor counts as a smaller constant.
    """
    able = [record for record in records if record.measured_torque_nm is not None]
    if not able:
        return []
    rows, torque_nm = [], []
    for record in able:
        assert record.measured_torque_nm is not None
        current_a = record.current_a if record.measured_current_a is None else record.measured_current_a
        half = max(1, round(SMOOTHED_S / record.period_s))
        for part in record.segments():
            velocity_rps = np.gradient(record.position_rev[part], record.period_s)
            window = np.ones(2 * half + 1) / (2 * half + 1)
            smooth_rps = np.convolve(np.pad(velocity_rps, half, mode="edge"), window, "valid")
            acceleration_rps2 = np.gradient(smooth_rps, record.period_s)
            rows.append(np.stack([current_a[part], acceleration_rps2, np.ones(acceleration_rps2.size)], axis=1))
            torque_nm.append(record.measured_torque_nm[part])
    matrix, target = np.concatenate(rows), np.concatenate(torque_nm)
    found = least_squares(matrix, target)
    constant, declared = float(found.values[0]), able[0].torque_constant_nm_per_a
    rms_nm = float(np.std(found.residual))
    share = rms_nm / max(float(np.std(target)), 1e-300)
    said = (
        f"the torque sensor gives a torque constant of {constant:.4g} Nm/A, {declared:.4g} is declared; "
        f"{rms_nm:.3g} Nm rms ({100.0 * share:.2g} %) of its torque is not that of the current"
    )
    if abs(constant / declared - 1.0) <= DECLARED_TOLERANCE:
        return [said]
    return [f"{said}: inertia and friction are {declared / constant:.3g} times the true ones, or friction is before it"]
