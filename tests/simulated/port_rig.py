"""A little master in front of the simulated drive's port: enables it and runs commands, compiled or not."""

from __future__ import annotations

import numpy as np

from fffo_drive.drive.port import (
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)
from fffo_drive.drive.simulated.effects.registry import EFFECTS
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig, paper_plant
from fffo_drive.jit import njit

PERIOD_NS = 500_000
FIELDS = (
    "velocity_rps",
    "position_rev",
    "current_a",
    "true_velocity_rps",
    "true_friction_nm",
    "statusword",
    "velocity_tick",
    "status_tick",
    "received_ns",
)


@njit
def run_port(port, first_tick, controlwords, commands_a, rows):
    """One tick a row: SYNC, feedback, then the command. Fields as in FIELDS, then what came back of the command."""
    for k in range(rows.shape[0]):
        tick = first_tick + k
        deadline_ns = (tick + 1) * PERIOD_NS
        port_sleep_until(port, deadline_ns)
        port_sync(port, tick)
        port_receive(port, tick, port_now_ns(port) + PERIOD_NS // 2)
        feedback = port.feedback[0]
        rows[k, 0] = feedback["velocity_rps"]
        rows[k, 1] = feedback["position_rev"]
        rows[k, 2] = feedback["current_a"]
        rows[k, 3] = feedback["true_velocity_rps"]
        rows[k, 4] = feedback["true_friction_nm"]
        rows[k, 5] = feedback["statusword"]
        rows[k, 6] = feedback["velocity_tick"]
        rows[k, 7] = feedback["status_tick"]
        rows[k, 8] = feedback["received_ns"]
        rows[k, 9] = port_command(port, tick, controlwords[k], commands_a[k])
        port_housekeeping(port, tick, False)


class Master:
    """Runs a drive tick after tick."""

    def __init__(self, drive: SimulatedDrive) -> None:
        self.drive, self.tick = drive, 0
        drive.connect()

    def run(self, controlword: int, commands_a) -> np.ndarray:
        """One controlword and a current a tick (n,): rows (n, 10)."""
        commands_a = np.asarray(commands_a, float)
        rows = np.zeros((commands_a.size, 10))
        words = np.full(commands_a.size, controlword, np.int64)
        run_port(self.drive.port, self.tick, words, commands_a, rows)
        self.tick += commands_a.size
        return rows

    def enable(self) -> None:
        for word in (0x06, 0x07, 0x0F, 0x0F):
            self.run(word, [0.0])


def short_runs() -> list[str]:
    """float.hex() of everything that a few short runs leave behind: plain, paper's surface, every effect at once."""
    everything = tuple(EffectConfig(name) for name in EFFECTS if name != "backlash")
    results: list[str] = []
    for config, ticks in (
        (PlantConfig(seed=3), 60),
        (paper_plant(), 60),
        (PlantConfig(effects=everything), 60),
        (PlantConfig(effects=(EffectConfig("backlash"), EffectConfig("odd_cable"))), 30),
    ):
        master = Master(SimulatedDrive(config))
        master.enable()
        commands = 3.0 * np.sin(0.21 * np.arange(ticks)) + 0.7
        rows = master.run(0x0F, commands)
        stop = master.run(0x0B, np.zeros(20))
        results += [float(x).hex() for x in rows.ravel()] + [float(x).hex() for x in stop.ravel()]
        for field in master.drive.plant_state:
            results += [float(x).hex() for x in field.ravel()]
    return results
