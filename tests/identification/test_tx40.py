"""Joint 6 of the measured TX40: waves and friction, and no error of its sensor."""

from __future__ import annotations

import numpy as np
from shared_data import shared_files

from fffo_drive.identification.dataset import record_of_columns
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.identification.fit import FitSettings, fit_records

RATE_HZ = 5000.0
FACTS = DriveFacts(torque_constant_nm_per_a=1.0, position_lsb_rev=1e-6, sample_rate_hz=RATE_HZ)  # torque is in A


def halves():
    """The first and the second half of the recording, as the rate is the same and the datum too."""
    files = (shared_files(f"measured/tx40/{name}.csv")[0] for name in ("pos_read_data", "curr_data"))
    position_rad, current_a = (np.genfromtxt(file, delimiter=",", names=True)["Joint_6"] for file in files)
    columns = {
        "time_s": np.arange(position_rad.size) / RATE_HZ,
        "position_rev": position_rad / (2.0 * np.pi),
        "current_command_a": current_a,
    }
    middle = position_rad.size // 2
    for name, part in (("a", slice(0, middle)), ("b", slice(middle, None))):
        yield record_of_columns(name, {key: values[part] for key, values in columns.items()}, FACTS)


def test_waves_with_which_more_torque_is_left_are_left_out():
    """The rows of the ladder show an error of the sensor; the fit with it leaves half as much torque again."""
    records = list(halves())
    fit = fit_records(records, FitSettings(compare_literal=False), FACTS)
    assert [effect.name for effect in fit.effects] == []
    left_nm = [float(np.sqrt(np.mean(run.torque.residual_nm[run.torque.kept] ** 2))) for run in fit.runs]
    assert max(left_nm) < 0.018
