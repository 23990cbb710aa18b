"""From anyone's CSV to a named effect: python csv_to_effect.py FIT.csv HELD_OUT.csv

The files have the columns t (s), angle (deg) and iq (A); another file needs other names and factors below.
"""

import sys

import numpy as np

import fffo_drive as fd


def read(path: str) -> fd.MeasuredRun:
    data = np.genfromtxt(path, delimiter=",", names=True)
    signals = {"time_s": data["t"], "position_rev": data["angle"] / 360.0, "current_command_a": data["iq"]}
    return fd.read_run(signals, torque_constant_nm_per_a=0.148, name=path)


fit, held_out = read(sys.argv[1]), read(sys.argv[2])
found = fd.diagnose(fit, held_out)
print(found.headline)
for finding in found.findings:
    if finding.accepted:
        numbers = ", ".join(f"{n.name} {n.value:.4g} {n.unit}" for n in finding.parameters)
        print(f"{finding.name}: {numbers}")
