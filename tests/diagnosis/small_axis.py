"""A small axis with Dahl's friction and an encoder, at 500 Hz: it shares nothing with the controller's model."""

from functools import cache

import numpy as np
from diagnosis.machine import Machine, run

from fffo_drive.identification.facts import DriveFacts

PERIOD_S = 0.002
MACHINE = Machine(
    inertia_kg_m2=1.5e-4,
    coulomb_nm=0.028,
    viscous_nm_per_rps=0.003,
    torque_constant_nm_per_a=0.08,
    static_nm=0.01,
    stribeck_rps=0.4,
    rough_nm=4e-4,
    rough_hz=8.0,
    current_noise_a=0.004,
    presliding_rev=1e-3,
    lsb_rev=2.0**-16,
    encoder_noise_rev=2e-6,
)
FACTS = DriveFacts(torque_constant_nm_per_a=0.08, rated_current_a=3.0, resolver_bits=16, sample_rate_hz=500.0)
LINE_HZ = 2.6  # the third sine of the motion
PARTS = ((4.0, 0.29, 0.4), (2.4, 0.78, 1.0), (0.9, LINE_HZ, 0.3))  # rps, Hz, rad


@cache
def three_sines(machine=MACHINE, duration_s=16.0):
    """Two runs of three sines."""
    time_s = np.arange(round(duration_s / PERIOD_S)) * PERIOD_S
    reference = np.sum([a * np.sin(2.0 * np.pi * f * time_s + p) for a, f, p in PARTS], axis=0)
    return _runs(machine, reference * np.clip(np.minimum(time_s, time_s[-1] - time_s) / 0.5, 0.0, 1.0))


@cache
def there_and_back(every_s, duration_s=20.0):
    """Two runs of a motion that comes again after `every_s`."""
    time_s = np.arange(round(duration_s / PERIOD_S)) * PERIOD_S
    corners = ((0.0, 0.1, 0.35, 0.5, 0.6, 0.9, 1.0), (0.0, 6.0, 6.0, 0.0, -4.8, -4.8, 0.0))
    return _runs(MACHINE, np.interp(np.mod(time_s / every_s, 1.0), *corners))


def _runs(machine, reference):
    begins_s = (0.0, reference.size * PERIOD_S + 2.0)
    return [
        run(machine, reference, gains=(0.6, 5.0), period_s=PERIOD_S, name=f"run-{k}", begin_s=begin_s, seed=k)
        for k, begin_s in enumerate(begins_s, 1)
    ]
