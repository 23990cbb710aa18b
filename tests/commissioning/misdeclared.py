"""A drive whose scaling is not what is declared: the simulated drive behind factors on what goes in and out.

It keeps the extremes of the true speed and the true angle at all ticks, which no declaration can touch. Its port has a
gate in its clock as well (`evaluation.gated`): the loop is compiled once for both.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fffo_drive.drive.port import (
    DriveRefusedError,
    new_feedback,
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)
from fffo_drive.drive.simulated.in_process import SimulatedDrive, SimulatedPort
from fffo_drive.drive.simulated.state import ANGLE_REV, VELOCITY_RPS
from fffo_drive.jit import njit
from fffo_drive.jit.atomic import load_acquire, store_release

OPEN_UNTIL, WAITS = 0, 1  # of the gate: how many ticks may begin; how many have begun, and 1 more where the loop waits
# numbers of MisdeclaredPort
TORQUE, VELOCITY, POSITION, CURRENT, HOLD, DRIFT_REV = range(6)
HIGHEST_RPS, LOWEST_REV, HIGHEST_REV, HIGHEST_A, HELD_RPS = range(6, 11)
N_NUMBERS = 11


class MisdeclaredPort(NamedTuple):
    feedback: Any
    numbers: Any  # (N_NUMBERS,)
    inner: SimulatedPort
    gate: Any  # (2,) int64


def wrapped(feedback, inner, *, torque=1.0, velocity=1.0, position=1.0, current=1.0, hold=1, drift=0.0):
    """The port, with its gate open."""
    numbers = np.zeros(N_NUMBERS)
    numbers[:6] = torque, velocity, position, current, hold, drift
    return MisdeclaredPort(feedback, numbers, inner, np.array([np.iinfo(np.int64).max, 0]))


@port_now_ns.register(MisdeclaredPort)
@njit
def now_ns(port):
    return port_now_ns(port.inner)


@port_sleep_until.register(MisdeclaredPort)
@njit
def sleep_until(port, deadline_ns):
    begun = port.gate[WAITS] + 1
    store_release(port.gate, WAITS, begun)
    while load_acquire(port.gate, OPEN_UNTIL) < begun:
        pass
    return port_sleep_until(port.inner, deadline_ns)


@port_sync.register(MisdeclaredPort)
@njit
def sync(port, tick):
    return port_sync(port.inner, tick)


@port_receive.register(MisdeclaredPort)
@njit
def receive(port, tick, cutoff_ns):
    answered = port_receive(port.inner, tick, cutoff_ns)
    numbers, values = port.numbers, port.inner.state.values
    numbers[HIGHEST_RPS] = max(numbers[HIGHEST_RPS], abs(values[VELOCITY_RPS]))
    numbers[LOWEST_REV] = min(numbers[LOWEST_REV], values[ANGLE_REV])
    numbers[HIGHEST_REV] = max(numbers[HIGHEST_REV], values[ANGLE_REV])
    inside, outside = port.inner.feedback[0], port.feedback[0]
    outside["received_ns"] = inside["received_ns"]
    outside["velocity_tick"] = inside["velocity_tick"]
    outside["status_tick"] = inside["status_tick"]
    outside["statusword"] = inside["statusword"]
    outside["heartbeat_ns"] = inside["heartbeat_ns"]
    outside["boot_count"] = inside["boot_count"]
    outside["emergency_count"] = inside["emergency_count"]
    outside["true_velocity_rps"] = inside["true_velocity_rps"]
    if numbers[HOLD] < 2.0 or tick % int(numbers[HOLD]) == 0:
        numbers[HELD_RPS] = inside["velocity_rps"]
    outside["velocity_rps"] = numbers[VELOCITY] * numbers[HELD_RPS]
    outside["position_rev"] = numbers[POSITION] * inside["position_rev"] + numbers[DRIFT_REV] * tick
    outside["current_a"] = numbers[CURRENT] * inside["current_a"]
    return answered


@port_command.register(MisdeclaredPort)
@njit
def command(port, tick, controlword, current_a):
    port.numbers[HIGHEST_A] = max(port.numbers[HIGHEST_A], abs(current_a))
    torque = port.numbers[TORQUE]
    sent_a = port_command(port.inner, tick, controlword, torque * current_a)
    return sent_a / torque if torque != 0.0 else current_a


@port_housekeeping.register(MisdeclaredPort)
@njit
def housekeeping(port, tick, tripped):
    return port_housekeeping(port.inner, tick, tripped)


class MisdeclaredDrive:
    """Behind the `Drive` protocol. Factors: of what is there, over what is declared."""

    def __init__(self, plant=None, device=None, **factors):
        self.inner = SimulatedDrive(plant, device)
        self.port = wrapped(new_feedback(), self.inner.port, **factors)
        self.connected = 0

    def connect(self):
        identity = self.inner.connect()
        self.connected += 1
        return identity

    @property
    def feedback(self):
        return self.port.feedback

    @property
    def current_limit(self):
        return self.inner.current_limit

    @property
    def realtime(self):
        return False

    def fault_words(self, statusword=None, ask=True):
        return ""

    def warnings(self):
        return []

    def close(self):
        self.inner.close()
        self.connected -= 1


class TalkingDrive(MisdeclaredDrive):
    """With objects to read: (index, sub) -> number."""

    objects: dict[tuple[int, int], int]

    def __init__(self, objects, **factors):
        super().__init__(**factors)
        self.objects = objects

    def read_object(self, index, sub):
        if (index, sub) not in self.objects:
            raise DriveRefusedError(f"no object {index:04X}:{sub:02X}")
        return self.objects[index, sub].to_bytes(4, "little")
