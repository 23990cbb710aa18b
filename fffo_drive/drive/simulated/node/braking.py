"""One braking of the drive: the brake of `simulated.braking`, stepped on the node's clock.

Quick stop, fault reaction and slow-down ramp use it. Their ramps are ramps of speed, in torque mode too: the drive
closes its own velocity loop.
"""

from __future__ import annotations

from ....units import NS_PER_S
from ..braking import BrakeSettings, brake_step

PERIOD_NS = 500_000  # of the drive's velocity loop
PATIENCE_NS = 3_000_000_000  # then braking ends, even if the load still moves


class Brake:
    """`kind` as in `simulated.braking`. `stopped`: the motor stands, or the time is up."""

    def __init__(self, settings: BrakeSettings, kind: int, velocity_rps: float) -> None:
        self.settings, self.kind = settings, kind
        self.stopped = abs(velocity_rps) < settings.standstill_rps
        self._ramp_rps = velocity_rps
        slowest_rps2 = min(settings.slow_rps2, settings.quick_rps2)
        self._left_ns = int(abs(velocity_rps) / slowest_rps2 * NS_PER_S) + PATIENCE_NS

    def step(self, velocity_rps: float, duration_ns: int) -> float:
        """Current command (A) for the next `duration_ns`."""
        self._ramp_rps, current_a, done = brake_step(
            self.settings, self.kind, self._ramp_rps, velocity_rps, duration_ns / NS_PER_S
        )
        self._left_ns -= duration_ns
        self.stopped = self.stopped or done or self._left_ns <= 0
        return current_a
