"""Any law on the simulated drive in process: the loop's own tick without service traffic and without an envelope.

A loop in the drive itself runs in the same way, several times in a tick.

Wake, SYNC, feedback, reference, law, command, as fffo_drive/runtime/loop.py has them; this project's controller runs
here bit for bit as it does there. The profile begins in the tick in which the drive says that it is enabled.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...arrays import Floats
from ...control.compensation import ALL_EFFECTS, compensation_step, new_memory, no_compensation
from ...control.controller import (
    ControllerConfig,
    controller_at_rest,
    controller_step,
    pack_controller,
    unpack_controller,
)
from ...control.feedforward import FeedforwardConfig, read_reference
from ...control.reference import Profile
from ...control.velocity_estimator import (
    COMMANDS,
    Measured,
    VelocityEstimatorConfig,
    estimator_at_rest,
    keep_command,
    velocity_estimator_step,
)
from ...drive.cia402 import GOAL_ENABLED, controlword_towards, is_operation_enabled
from ...drive.port import port_command, port_receive, port_sleep_until, port_sync
from ...drive.simulated.in_process import SimulatedDrive
from ...drive.simulated.parameters import DeviceConfig, PlantConfig, delay_budget
from ...jit import njit
from ...packing import pack
from ...units import NS_PER_S
from ..trace import Trace
from .constants import MEMORY_SLOTS, PeerConfig, pi_with_offset_step
from .disturbance_observer import ObserverLoop, observer_loop_step
from .drive_loop import PER_TICK, DriveLoop, as_the_drive_has_it, finer, offsets_nm
from .luenberger import LuenbergerLoop, luenberger_step
from .lugre import LugreConfig, lugre_step
from .maxwell_slip import SlipConfig, slip_step

OWN_LAW, LUGRE, MAXWELL_SLIP, OBSERVER, LUENBERGER, IN_DRIVE = range(6)
MEASURED_RPS, TRUE_RPS, FRICTION_NM, COMMAND_A = range(4)

Config = ControllerConfig | LugreConfig | SlipConfig | ObserverLoop | LuenbergerLoop | PeerConfig


class PeerLaw(NamedTuple):
    """A law under test."""

    name: str
    config: Config
    toggle: int = 0  # friction_observer.TOGGLE_*, of this project's law
    effects: Floats | None = None  # table of control.compensation, of this project's law
    drive: DriveLoop | None = None  # of a PeerConfig: the loop is in the drive

    @property
    def common(self) -> ControllerConfig | PeerConfig:
        """The part that all laws have."""
        return self.config if isinstance(self.config, ControllerConfig | PeerConfig) else self.config.peer

    @property
    def kind(self) -> int:
        """Which step."""
        kinds = {
            ControllerConfig: OWN_LAW,
            LugreConfig: LUGRE,
            SlipConfig: MAXWELL_SLIP,
            ObserverLoop: OBSERVER,
            LuenbergerLoop: LUENBERGER,
            PeerConfig: IN_DRIVE,
        }
        return kinds[type(self.config)]


@njit
def _run(
    port: Any, period_ns: int, cutoff_ns: int, kind: int, toggle: int, parameters: Floats,
    feedforward: FeedforwardConfig, velocity: VelocityEstimatorConfig, values: Floats, derivatives: Floats,
    memory: Floats, effects: Floats, effects_memory: Floats, commands_a: Floats, added_nm: Floats, found: Floats,
) -> None:  # fmt: skip
    state = controller_at_rest()
    estimator = estimator_at_rest()
    feedback = port.feedback[0]
    controlword = 0
    length = values.shape[0]
    tick, sample = 0, 0
    while sample < length:
        deadline_ns = (tick + 1) * period_ns
        port_sleep_until(port, deadline_ns)
        port_sync(port, tick)
        port_receive(port, tick, deadline_ns + cutoff_ns)
        controlword = controlword_towards(feedback["statusword"], GOAL_ENABLED, False, controlword)
        if not is_operation_enabled(feedback["statusword"]):
            port_command(port, tick, controlword, 0.0)
        else:
            velocity_rps, position_rev = feedback["velocity_rps"], feedback["position_rev"]
            measured = Measured(tick, deadline_ns, True, position_rev, velocity_rps)
            estimate, estimator = velocity_estimator_step(velocity, estimator, commands_a, measured)
            followed_rps = estimate.followed_rps
            reference = read_reference(feedforward, values, derivatives, length, sample)
            if kind == OWN_LAW:
                config = unpack_controller(parameters)
                effects_nm = compensation_step(effects, effects_memory, ALL_EFFECTS, reference, position_rev)
                terms, state = controller_step(
                    config, state, toggle, reference, velocity_rps, effects_nm, followed_rps, position_rev
                )
                command_a = terms.command_a
            elif kind == LUGRE:
                command_a = lugre_step(parameters, memory, reference, followed_rps)
            elif kind == MAXWELL_SLIP:
                command_a = slip_step(parameters, memory, reference, followed_rps)
            elif kind == OBSERVER:
                command_a = observer_loop_step(parameters, memory, reference, followed_rps)
            elif kind == LUENBERGER:
                command_a = luenberger_step(parameters, memory, reference, followed_rps, position_rev)
            else:
                command_a = pi_with_offset_step(parameters, memory, reference, followed_rps, added_nm[sample])
            found[MEASURED_RPS, sample] = velocity_rps
            found[TRUE_RPS, sample] = feedback["true_velocity_rps"]
            found[FRICTION_NM, sample] = feedback["true_friction_nm"]
            sent_a = port_command(port, tick, controlword, command_a)
            keep_command(commands_a, tick, sent_a)
            found[COMMAND_A, sample] = sent_a
            sample += 1
        tick += 1


class Ran(NamedTuple):
    """A run."""

    trace: Trace
    friction_nm: Floats  # the plant's own, (n,)


def run_law(plant: PlantConfig, device: DeviceConfig, law: PeerLaw, profile: Profile) -> Ran:
    """The profile under a law, from power-on: the same axis, noise and reference for every law.

    Raises PlantConfigError for a loop in the drive that is shorter than the axis allows.
    """
    ticks, feedforward, added_nm = 1, law.common.feedforward, np.zeros(1)
    if law.drive is not None:
        ticks = PER_TICK
        profile = finer(profile, ticks)
        plant = as_the_drive_has_it(plant, law.drive.delay_s, profile.period_s)
        added_nm = np.zeros(profile.values.size)
        if law.drive.torque is not None:
            sensor_s = delay_budget(plant).tracking_loop_s
            added_nm = offsets_nm(law.drive.torque, profile, law.drive.delay_s - sensor_s)
            feedforward = feedforward._replace(behind_ticks=sensor_s / profile.period_s)
    drive = SimulatedDrive(plant, device)
    drive.connect()
    parameters = pack_controller(law.config) if isinstance(law.config, ControllerConfig) else pack(law.config)
    found = np.zeros((4, profile.values.size))
    period_ns = round(profile.period_s * NS_PER_S)
    _run(
        drive.port, period_ns, period_ns // 2, law.kind, law.toggle, parameters, feedforward, law.common.velocity,
        profile.values, profile.derivatives, np.zeros(MEMORY_SLOTS),
        no_compensation() if law.effects is None else law.effects, new_memory(), np.zeros(COMMANDS), added_nm, found,
    )  # fmt: skip
    found = found[:, ::ticks]
    trace = Trace(
        ticks * profile.period_s, profile.values[::ticks], found[MEASURED_RPS], found[TRUE_RPS], found[COMMAND_A]
    )
    return Ran(trace, found[FRICTION_NM])
