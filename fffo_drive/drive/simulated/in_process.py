"""The simulated drive in process: the plant behind the drive port, on a clock that only the loop moves.

Each SYNC the plant lives on to the present with the current that the last SYNC applied, the drive latches its
feedback, and takes the command that came last: what a drive does with synchronous PDOs. Nothing waits, so a
minute takes as long as its arithmetic, and the same seed gives the same bits.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ...jit import njit
from ...units import NS_PER_S, permille_per_a
from ..port import (
    DriveIdentity,
    new_feedback,
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)
from .braking import BrakeSettings, brake_kind, brake_step
from .cia402_device import (
    FAULT,
    FAULT_REACTION_ACTIVE,
    NO_TRANSITION,
    OPERATION_ENABLED,
    QUICK_STOP_ACTIVE,
    START,
    SW_FOLLOWS_COMMAND,
    SW_INTERNAL_LIMIT,
    SW_REMOTE,
    SW_VOLTAGE_ENABLED,
    SWITCH_ON_DISABLED,
    clears_target,
    device_step,
    follows_target,
    statusword_of,
)
from .pack import new_state, plant_parameters
from .parameters import DeviceConfig, PlantConfig
from .plant import substeps_due
from .plant_call import call_plant, plant_address
from .resolver import plant_latch
from .state import Floats, Integers, PlantParameters, PlantState, Report

INT16_MAX = 32767
NMT_OPERATIONAL = 5
NO_STATUS = -1

# SimulatedPort.words
CLOCK_NS = 0  # time of the port's clock
DEVICE_STATE = 1
CONTROLWORD = 2  # of the last command
PREVIOUS_CONTROLWORD = 3  # of the command before the one that the device took last
TARGET_PERMILLE = 4  # of the last command
FAULT_PRESENT = 5
QUICK_STOP_OPTION = 6
FAULT_REACTION_OPTION = 7
STATUS_PERIOD = 8
TURNAROUND_NS = 9
LATCHED_STATUSWORD = 10  # of this SYNC
SENT_STATUSWORD = 11  # NO_STATUS before the first
SYNC_NS = 12  # time of the last SYNC
SYNCS = 13
BRAKING = 14  # 1 when the power stage was on at the moment quick stop or fault reaction began
PLANT_ADDRESS = 15
N_WORDS = 16

# SimulatedPort.values
APPLIED_A = 0  # what the drive makes of the last command
PERMILLE_PER_A = 1
RAMP_RPS = 2  # of the brake
LATCHED_RPS = 3
LATCHED_REV = 4
LATCHED_A = 5
LATCHED_TRUE_RPS = 6
LATCHED_FRICTION_NM = 7
COUNTS_PER_REV = 8
N_VALUES = 9


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


@njit
def _latch(values: Floats, report: Report) -> None:
    values[LATCHED_RPS] = report.velocity_rps
    values[LATCHED_REV] = report.position_counts / values[COUNTS_PER_REV]
    values[LATCHED_A] = report.current_a
    values[LATCHED_TRUE_RPS] = report.true_velocity_rps
    values[LATCHED_FRICTION_NM] = report.true_friction_nm


@njit
def _brakes(
    words: Integers, values: Floats, brake: BrakeSettings, state: int, velocity_rps: float, step_s: float
) -> bool:
    """Run the brake of QUICK STOP ACTIVE or FAULT REACTION ACTIVE. True when nothing is left to wait for."""
    option = words[QUICK_STOP_OPTION] if state == QUICK_STOP_ACTIVE else words[FAULT_REACTION_OPTION]
    kind = brake_kind(int(option))
    ramp_rps, current_a, done = brake_step(brake, kind, float(values[RAMP_RPS]), velocity_rps, step_s)
    values[RAMP_RPS] = ramp_rps
    values[APPLIED_A] = current_a
    return done


@njit
def _device(words: Integers, values: Floats, brake: BrakeSettings, velocity_rps: float, step_s: float) -> int:
    """The CiA 402 device takes the last command: next state, which is returned, and current to apply."""
    before = int(words[DEVICE_STATE])
    done = True
    if words[BRAKING] != 0:
        done = _brakes(words, values, brake, before, velocity_rps, step_s)
    controlword = int(words[CONTROLWORD])
    state, transition = device_step(
        before,
        controlword,
        int(words[PREVIOUS_CONTROLWORD]),
        words[FAULT_PRESENT] != 0,
        done,
        int(words[QUICK_STOP_OPTION]),
    )
    words[PREVIOUS_CONTROLWORD] = controlword
    words[DEVICE_STATE] = state
    if clears_target(transition):
        words[TARGET_PERMILLE] = 0
    if transition != NO_TRANSITION:
        powered = before in (OPERATION_ENABLED, QUICK_STOP_ACTIVE)
        words[BRAKING] = 1 if powered and state in (QUICK_STOP_ACTIVE, FAULT_REACTION_ACTIVE) else 0
        values[RAMP_RPS] = velocity_rps
    if follows_target(state):
        values[APPLIED_A] = words[TARGET_PERMILLE] / values[PERMILLE_PER_A]
    elif words[BRAKING] == 0:
        values[APPLIED_A] = 0.0
    elif transition != NO_TRANSITION:
        _brakes(words, values, brake, state, velocity_rps, 0.0)
    return state


@port_sync.register(SimulatedPort)  # type: ignore[attr-defined, untyped-decorator]
@njit
def _sync(port: SimulatedPort, tick: int) -> int:
    words, values = port.words, port.values
    now_ns = int(words[CLOCK_NS])
    substeps = substeps_due(port.state, now_ns)
    call_plant(int(words[PLANT_ADDRESS]), port.parameters, port.state, float(values[APPLIED_A]), substeps)
    report = plant_latch(port.parameters, port.state)
    _latch(values, report)
    step_s = (now_ns - int(words[SYNC_NS])) / 1e9
    words[SYNC_NS] = now_ns
    words[SYNCS] += 1
    state = _device(words, values, port.brake, report.velocity_rps, step_s)
    bits = SW_VOLTAGE_ENABLED | SW_REMOTE
    if report.limited:
        bits |= SW_INTERNAL_LIMIT
    elif follows_target(state):
        bits |= SW_FOLLOWS_COMMAND
    words[LATCHED_STATUSWORD] = statusword_of(state, bits)
    return 0


@port_receive.register(SimulatedPort)  # type: ignore[attr-defined, untyped-decorator]
@njit
def _receive(port: SimulatedPort, tick: int, cutoff_ns: int) -> int:
    words, values = port.words, port.values
    feedback = port.feedback[0]
    received_ns = int(words[SYNC_NS]) + int(words[TURNAROUND_NS])
    if received_ns > cutoff_ns:
        # it comes when nobody waits any more: the loop counts it as missing, the port as late
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
def _housekeeping(port: SimulatedPort, tick: int) -> int:
    return 0


class SimulatedDrive:
    """A drive that exists in memory only, behind the `Drive` protocol of `fffo_drive.drive.port`.

    Everything that happens is decided by the configuration, the seed and the commands. Raises
    PlantConfigError for a configuration that makes no drive.
    """

    def __init__(self, plant: PlantConfig | None = None, device: DeviceConfig | None = None) -> None:
        self.plant_config = (plant or PlantConfig()).validate()
        self.device_config = (device or DeviceConfig()).validate()
        config = self.plant_config
        self._plant_address = plant_address()
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

        The arrays stay the same, so a port that was taken before remains valid.
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
        words[...] = 0
        words[DEVICE_STATE] = START
        words[QUICK_STOP_OPTION] = device.quick_stop_option
        words[FAULT_REACTION_OPTION] = device.fault_reaction_option
        words[STATUS_PERIOD] = device.status_period
        words[TURNAROUND_NS] = round(device.turnaround_s * NS_PER_S)
        words[SENT_STATUSWORD] = NO_STATUS
        words[PLANT_ADDRESS] = self._plant_address

    def connect(self) -> DriveIdentity:
        """The device walks from START to SWITCH ON DISABLED, as a drive does while it boots."""
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
        """The compiled side."""
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
        """The plant's memory itself; `state.copy_state` and `state.restore_state` take and set a snapshot."""
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
        """The fault's cause is gone. The device stays in FAULT until it is reset by the controlword."""
        self._port.words[FAULT_PRESENT] = 0
        self._port.feedback[0]["emergency_code"] = 0

    def close(self) -> None:
        """Leave the drive without torque."""
        self._port.words[CONTROLWORD] = 0
        self._port.words[TARGET_PERMILLE] = 0
        self._port.values[APPLIED_A] = 0.0
