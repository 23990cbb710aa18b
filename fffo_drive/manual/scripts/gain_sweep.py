"""A sweep of gains on one simulated axis: python gain_sweep.py AXIS.yaml"""

import sys

import numpy as np

import fffo_drive as fd

axis = fd.read_axis(sys.argv[1])
own = axis.file.controller.proportional_a_per_rps
for share in np.linspace(0.7, 1.1, 5):
    run = fd.simulate(axis, gains={"proportional_a_per_rps": share * own}, seed=1)
    print(f"Kp {share * own:.3f} A/rps: ISE {run.metrics.measured.ise:.5f} rps^2 s")
