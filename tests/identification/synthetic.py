"""Records of the model itself: no sensor, no noise, and every number known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fffo_drive.identification.dataset import Record
from fffo_drive.identification.excitation import identification_sequence
from fffo_drive.model.axis import AxisConfig, AxisState, simulate
from fffo_drive.model.friction import OMEGA_CLIPPED, REST, FrictionConfig

PERIOD_S = 0.0005
KT = 0.148
FRICTION = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, OMEGA_CLIPPED)
AXIS = AxisConfig(9.4e-4, KT, 0.0021, FRICTION)
TRUTH = np.array([9.4e-4, 0.0021, 0.003, 0.025, 0.067, 0.733, 1.07, 778.0, 2.33, 0.0, 0.0])


def record_of(current_a, axis=AXIS, lsb_rev=0.0, name="synthetic", noise_rev=0.0, seed=1, **changes):
    """The model's own motion under a current, with the position in whole counts where `lsb_rev` is given."""
    states, _ = simulate(axis, AxisState(0.0, 0.0, REST), current_a, PERIOD_S, 1)
    position = states[:, 1] + noise_rev * np.random.default_rng(seed).standard_normal(current_a.size)
    if lsb_rev:
        position = np.floor(position / lsb_rev) * lsb_rev
    fields = {
        "name": name, "path": Path(name), "period_s": PERIOD_S, "torque_constant_nm_per_a": KT,
        "current_a": np.ascontiguousarray(current_a), "position_rev": position, "velocity_rps": None,
        "reference_rps": None, "lsb_rev": lsb_rev or 2.0**-15, "breaks": (), "digest": "",
    }  # fmt: skip
    return Record(**{**fields, **changes})


def chirp_record(duration_s=20.0, **options):
    """The paper's sequence on the model's own axis."""
    return record_of(identification_sequence(duration_s, PERIOD_S, 0.5, 1.1, 0.1, 10.0).values, **options)
