"""A drive port that plays a script on a fake clock: when the loop wakes, what answers, what the drive says."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fffo_drive.drive.port import (
    NMT_OPERATIONAL,
    new_feedback,
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)
from fffo_drive.jit import njit

ENABLED = 0x0637
SWITCH_ON_DISABLED = 0x0250
FAULT = 0x0218

# columns of the log
SYNC_NS, CONTROLWORD, CURRENT_A = 0, 1, 2
# columns of the script
WAKE_DELAY_NS, ANSWERS, STATUSWORD, EMERGENCIES, BUS_OFF, BOOTS, NMT_STATE, NMT_EXITS, FOREIGN_FRAMES = range(9)
SCRIPT_COLUMNS = 9


class ScriptedPort(NamedTuple):
    feedback: Any
    clock_ns: Any  # (1,) int64
    wakes: Any  # (1,) int64, how often the loop has slept
    script: Any  # (n, SCRIPT_COLUMNS) int64, one row for each sleep
    velocity_rps: Any  # (n,) by tick
    log: Any  # (n, 3) float64 by tick; NaN where nothing was sent


def scripted(n: int, velocity_rps: float = 0.0) -> ScriptedPort:
    """n ticks on time, every SYNC answered, the drive in Operation Enabled."""
    script = np.zeros((n, SCRIPT_COLUMNS), np.int64)
    script[:, ANSWERS] = 1
    script[:, STATUSWORD] = ENABLED
    script[:, NMT_STATE] = NMT_OPERATIONAL
    log = np.full((n, 3), np.nan)
    return ScriptedPort(
        new_feedback(), np.zeros(1, np.int64), np.zeros(1, np.int64), script, np.full(n, velocity_rps), log
    )


@port_now_ns.register(ScriptedPort)
@njit
def now_ns(port):
    return port.clock_ns[0]


@port_sleep_until.register(ScriptedPort)
@njit
def sleep_until(port, deadline_ns):
    delay_ns = port.script[min(port.wakes[0], port.script.shape[0] - 1), WAKE_DELAY_NS]
    port.clock_ns[0] = max(port.clock_ns[0], deadline_ns) + delay_ns
    port.wakes[0] += 1
    return 0


@port_sync.register(ScriptedPort)
@njit
def sync(port, tick):
    port.log[tick, SYNC_NS] = port.clock_ns[0]
    return 0


@port_receive.register(ScriptedPort)
@njit
def receive(port, tick, cutoff_ns):
    row = port.script[tick]
    record = port.feedback[0]
    record["emergency_count"] = row[EMERGENCIES]
    record["bus_off"] = row[BUS_OFF]
    record["boot_count"] = row[BOOTS]
    record["nmt_state"] = row[NMT_STATE]
    record["nmt_exits"] = row[NMT_EXITS]
    record["foreign_frames"] = row[FOREIGN_FRAMES]
    if row[ANSWERS] == 0:
        port.clock_ns[0] = cutoff_ns
        return 0
    port.clock_ns[0] += 50_000
    record["received_ns"] = port.clock_ns[0]
    record["velocity_rps"] = port.velocity_rps[tick]
    record["velocity_tick"] = tick
    record["status_tick"] = tick
    record["statusword"] = row[STATUSWORD]
    return 1


@port_command.register(ScriptedPort)
@njit
def command(port, tick, controlword, current_a):
    if np.isnan(port.log[tick, CONTROLWORD]):  # the closing zero command repeats the last tick's number
        port.log[tick, CONTROLWORD] = controlword
        port.log[tick, CURRENT_A] = current_a
    return current_a


@port_housekeeping.register(ScriptedPort)
@njit
def housekeeping(port, tick, tripped):
    return 0
