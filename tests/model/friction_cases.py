"""Edge values of the friction step, computed to exact bits: imported by the test and by an interpreter without JIT."""

from __future__ import annotations

import itertools

from fffo_drive.model.friction import FrictionConfig, FrictionState, friction_step

TABLE1 = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, 0)


def edge_values() -> list[str]:
    """float.hex() of every field after every combination of edge inputs."""
    configs = [
        TABLE1,
        TABLE1._replace(stribeck_exponent=-1.07),
        TABLE1._replace(omega_form=1),
        TABLE1._replace(omega_form=2),
        TABLE1._replace(stiffness_per_rev=2.33 / 0.025, stribeck_exponent=0.0),
    ]
    torques = [0.0, -0.0, 0.067, -0.2, 1e-300]
    velocities = [0.0, -0.0, 5e-324, -1e-12, 0.06, -0.733, 15.0, -60.0]
    observations = [0.0, 1.5, -40.0]
    results: list[str] = []
    for config, torque, velocity, observation in itertools.product(configs, torques, velocities, observations):
        state = FrictionState(torque, 1e-3, 0.01, 1.0)
        for _ in range(3):
            state = friction_step(config, state, velocity, observation, 5e-4)
        results.extend(float(x).hex() for x in state)
    return results
