"""The simulated drive in process: the plant behind the drive port, on a clock that only the loop advances.

At each SYNC the plant advances to the present with the current applied at the last SYNC, and the drive latches its
feedback and takes the latest command, as a drive does with synchronous PDOs. Nothing waits, so a run takes as long as
its computation, and the same seed gives the same bits.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ...jit import njit
from ...units import NS_PER_S, permille_per_a
from ..port import (
    NMT_OPERATIONAL,
    CurrentLimit,
    DriveIdentity,
    new_feedback,
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)
from .braking import BrakeSettings
from .cia402_device import FAULT, START, SWITCH_ON_DISABLED, device_step
from .pack import new_state, plant_parameters
from .parameters import DeviceConfig, PlantConfig
from .state import Floats, Integers, PlantParameters, PlantState
from .sync_cycle import (
    APPLIED_A,
    CLOCK_NS,
    CONTROLWORD,
    COUNTS_PER_REV,
    CYCLE_ADDRESS,
    DEVICE_STATE,
    FAULT_PRESENT,
    FAULT_REACTION_OPTION,
    LATCHED_A,
    LATCHED_FRICTION_NM,
    LATCHED_REV,
    LATCHED_RPS,
    LATCHED_STATUSWORD,
    LATCHED_TRUE_RPS,
    N_VALUES,
    N_WORDS,
    NO_STATUS,
    PERMILLE_PER_A,
    QUICK_STOP_OPTION,
    SENT_STATUSWORD,
    STATUS_PERIOD,
    SYNC_NS,
    SYNCS,
    TARGET_PERMILLE,
    TURNAROUND_NS,
    call_cycle,
    cycle_address,
)

INT16_MAX = 32767


class SimulatedPort(NamedTuple):
    """The compiled side of the simulated drive."""

    feedback: np.ndarray[Any, np.dtype[np.void]]
    parameters: PlantParameters
    state: PlantState
    brake: BrakeSettings
    words: Integers  # (N_WORDS,)
    values: Floats  # (N_VALUES,)


@port_now_ns.register(SimulatedPort)  # type: ignore[attr-defined, untyped-decorator]
@njit
def _now_ns(port: SimulatedPort) -> int:
    return int(port.words[CLOCK_NS])


@port_sleep_until.register(SimulatedPort)  # type: ignore[attr-defined, untyped-decorator]
@njit
def _sleep_until(port: SimulatedPort, deadline_ns: int) -> int:
    if deadline_ns > port.words[CLOCK_NS]:
        port.words[CLOCK_NS] = deadline_ns
    return 0


@port_sync.register(SimulatedPort)  # type: ignore[attr-defined, untyped-decorator]
@njit
def _sync(port: SimulatedPort, tick: int) -> int:
    call_cycle(port.parameters, port.state, port.brake, port.words, port.values)
    return 0


@port_receive.register(SimulatedPort)  # type: ignore[attr-defined, untyped-decorator]
@njit
def _receive(port: SimulatedPort, tick: int, cutoff_ns: int) -> int:
    words, values = port.words, port.values
    feedback = port.feedback[0]
    received_ns = int(words[SYNC_NS]) + int(words[TURNAROUND_NS])
    if received_ns > cutoff_ns:
        # it arrives after the cut-off: the loop counts it as missing, the port as late
        words[CLOCK_NS] = max(int(words[CLOCK_NS]), cutoff_ns)
        feedback["late_feedback"] += 1
        return 0
    words[CLOCK_NS] = max(int(words[CLOCK_NS]), received_ns)
    feedback["velocity_rps"] = values[LATCHED_RPS]
    feedback["position_rev"] = values[LATCHED_REV]
    feedback["true_velocity_rps"] = values[LATCHED_TRUE_RPS]
    feedback["true_friction_nm"] = values[LATCHED_FRICTION_NM]
    feedback["received_ns"] = received_ns
    feedback["velocity_tick"] = tick
    feedback["heartbeat_ns"] = received_ns
    statusword = int(words[LATCHED_STATUSWORD])
    if statusword != words[SENT_STATUSWORD] or words[SYNCS] % words[STATUS_PERIOD] == 0:
        words[SENT_STATUSWORD] = statusword
        feedback["statusword"] = statusword
        feedback["current_a"] = values[LATCHED_A]
        feedback["status_tick"] = tick
    return 1


@port_command.register(SimulatedPort)  # type: ignore[attr-defined, untyped-decorator]
@njit
def _command(port: SimulatedPort, tick: int, controlword: int, current_a: float) -> float:
    per_a = float(port.values[PERMILLE_PER_A])
    counts = current_a * per_a
    permille = 0  # also for a current that is not a number
    if counts >= INT16_MAX:
        permille = INT16_MAX
    elif counts <= -INT16_MAX:
        permille = -INT16_MAX
    elif counts == counts:
        permille = math.floor(counts + 0.5)
    port.words[CONTROLWORD] = controlword
    port.words[TARGET_PERMILLE] = permille
    return permille / per_a


@port_housekeeping.register(SimulatedPort)  # type: ignore[attr-defined, untyped-decorator]
@njit
def _housekeeping(port: SimulatedPort, tick: int, tripped: bool) -> int:
    return 0


class SimulatedDrive:
    """A drive that exists in memory only, behind the `Drive` protocol of `fffo_drive.drive.port`.

    The run is determined by the configuration, the seed and the commands. Raises PlantConfigError for an invalid
    configuration.
    """

    def __init__(self, plant: PlantConfig | None = None, device: DeviceConfig | None = None) -> None:
        self.plant_config = (plant or PlantConfig()).validate()
        self.device_config = (device or DeviceConfig()).validate()
        config = self.plant_config
        self._port = SimulatedPort(
            feedback=new_feedback(),
            parameters=plant_parameters(config),
            state=new_state(config),
            brake=self.device_config.brake(config.peak_current_a),
            words=np.zeros(N_WORDS, np.int64),
            values=np.zeros(N_VALUES),
        )
        self.reset(config.seed)

    def reset(self, seed: int | None = None) -> None:
        """Power-on: clock zero, shaft at rest, device in START, noise from `seed` (the configured one when
        None).

        The arrays stay the same objects, so that an existing port remains valid.
        """
        if seed is not None:
            self.plant_config = replace(self.plant_config, seed=seed).validate()
        port, device = self._port, self.device_config
        for field, fresh in zip(port.state, new_state(self.plant_config), strict=True):
            field[...] = fresh
        port.feedback[...] = new_feedback()
        port.values[...] = 0.0
        port.values[PERMILLE_PER_A] = permille_per_a(
            self.plant_config.torque_constant_nm_per_a, self.plant_config.rated_torque_nm
        )
        port.values[COUNTS_PER_REV] = 1 << self.plant_config.resolver.bits
        words = port.words
        kept_address = int(words[CYCLE_ADDRESS])
        words[...] = 0
        words[DEVICE_STATE] = START
        words[QUICK_STOP_OPTION] = device.quick_stop_option
        words[FAULT_REACTION_OPTION] = device.fault_reaction_option
        words[STATUS_PERIOD] = device.status_period
        words[TURNAROUND_NS] = round(device.turnaround_s * NS_PER_S)
        words[SENT_STATUSWORD] = NO_STATUS
        words[CYCLE_ADDRESS] = kept_address

    def connect(self) -> DriveIdentity:
        """Take the device from START to SWITCH ON DISABLED, as a drive does while it boots."""
        state = int(self._port.words[DEVICE_STATE])
        while state != SWITCH_ON_DISABLED and state != FAULT:
            state, _ = device_step(state, 0, 0, False, True, self.device_config.quick_stop_option)
        self._port.words[DEVICE_STATE] = state
        feedback = self._port.feedback[0]
        feedback["boot_count"] = 1
        feedback["nmt_state"] = NMT_OPERATIONAL
        feedback["heartbeat_ns"] = self._port.words[CLOCK_NS]
        return DriveIdentity(0, 0, 1, self.plant_config.seed & 0xFFFFFFFF, "simulated drive, in process", "1")

    @property
    def port(self) -> SimulatedPort:
        """The compiled side; with the first use, the plant is compiled or taken from the cache."""
        self._port.words[CYCLE_ADDRESS] = cycle_address()
        return self._port

    @property
    def feedback(self) -> np.ndarray[Any, np.dtype[np.void]]:
        """The port's memory, shape (1,), dtype FEEDBACK."""
        return self._port.feedback

    @property
    def realtime(self) -> bool:
        """False: the clock is the loop's own."""
        return False

    @property
    def plant_state(self) -> PlantState:
        """State of the plant, not a copy."""
        return self._port.state

    @property
    def plant_parameters(self) -> PlantParameters:
        """The plant's constants."""
        return self._port.parameters

    @property
    def device_state(self) -> int:
        """State of the CiA 402 device (`cia402_device`)."""
        return int(self._port.words[DEVICE_STATE])

    def raise_fault(self, emergency_code: int) -> None:
        """A fault condition from now until `clear_fault`, announced with this EMCY code."""
        self._port.words[FAULT_PRESENT] = 1
        feedback = self._port.feedback[0]
        feedback["emergency_code"] = emergency_code
        feedback["emergency_count"] += 1

    def clear_fault(self) -> None:
        """Remove the fault's cause. The device stays in FAULT until it is reset by the controlword."""
        self._port.words[FAULT_PRESENT] = 0
        self._port.feedback[0]["emergency_code"] = 0

    @property
    def current_limit(self) -> CurrentLimit:
        """Of its power stage."""
        return CurrentLimit(self.plant_config.peak_current_a, "the simulated drive's plant.peak_current_a")

    def fault_words(self, statusword: int | None = None, ask: bool = True) -> str:
        """Nothing: its statusword is in every row."""
        return ""

    def warnings(self) -> list[str]:
        """It never warns."""
        return []

    def close(self, loop_ended: bool = True) -> None:
        """Leave the drive without torque."""
        self._port.words[CONTROLWORD] = 0
        self._port.words[TARGET_PERMILLE] = 0
        self._port.values[APPLIED_A] = 0.0
