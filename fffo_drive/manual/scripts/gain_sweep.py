"""A sweep of 50 gains on a simulated axis, on all cores: python gain_sweep.py AXIS.yaml"""

import os
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import fffo_drive as fd


def ise(gain: float) -> float:
    return fd.simulate(axis, gains={"proportional_a_per_rps": gain}, seed=1).metrics.measured.ise


axis = fd.read_axis(sys.argv[1])
gains = np.linspace(0.7, 1.1, 50) * axis.file.controller.proportional_a_per_rps
with ThreadPoolExecutor(os.cpu_count()) as cores:
    for gain, found in zip(gains, cores.map(ise, gains), strict=True):
        print(f"Kp {gain:.3f} A/rps: ISE {found:.7f} rps^2 s")
