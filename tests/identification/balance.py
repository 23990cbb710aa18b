"""Records made from the force balance itself: a motion that is given, and the command that it needs, exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from identification.synthetic import KT, PERIOD_S, record_of

INERTIA, VISCOUS, COULOMB = 9e-4, 3e-3, 0.03
TURN = 2.0 * np.pi
BOTH_WAYS = ((4.0, 0.31, 0.0), (2.0, 1.3, 1.0), (0.5, 4.7, 2.0))  # (rps, Hz, rad) of the sines of a velocity


def balance_record(
    name, mean_rps=0.0, sines=BOTH_WAYS, duration_s=30.0, inertia=INERTIA, viscous=VISCOUS, coulomb=COULOMB,
    load=lambda time_s, position_rev, velocity_rps: 0.0 * time_s, noise_nm=2e-4, seed=1, begin_s=0.0,
    sensor_rev=lambda position_rev: 0.0,
):  # fmt: skip
    """J a + sigma w + Fc sgn(w) + load, without a delay; white noise of `noise_nm` on the torque, whole counts.

    `sensor_rev`: error of the measured angle over the angle.
    """
    fine_s = np.arange(round(duration_s / PERIOD_S)) * PERIOD_S
    middle_s = fine_s + 0.5 * PERIOD_S  # the command is held: what it has to be in the middle of its period

    def motion(at_s):
        position, velocity, acceleration = mean_rps * at_s, mean_rps + 0.0 * at_s, 0.0 * at_s
        for rps, hz, phase in sines:
            position = position - rps / (TURN * hz) * np.cos(TURN * hz * at_s + phase)
            velocity = velocity + rps * np.sin(TURN * hz * at_s + phase)
            acceleration = acceleration + TURN * hz * rps * np.cos(TURN * hz * at_s + phase)
        return position, velocity, acceleration

    position, velocity, acceleration = motion(middle_s)
    torque = inertia * acceleration + viscous * velocity + coulomb * np.sign(velocity)
    torque = torque + load(middle_s, position, velocity)
    torque = torque + noise_nm * np.random.default_rng(seed).standard_normal(fine_s.size)
    lsb_rev, angle = 2.0**-15, motion(fine_s)[0]
    return replace(
        record_of(torque[:200] / KT, name=name), begin_s=begin_s,
        current_a=torque / KT, position_rev=np.floor((angle + sensor_rev(angle)) / lsb_rev) * lsb_rev,
    )  # fmt: skip
