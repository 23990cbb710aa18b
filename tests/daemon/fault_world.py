"""Faults of a moving axis, lived through on the simulated drive's own clock. `run_all` runs interpreted.

Loop, law, envelope and port are the product's, the node is the simulated drive with its plant, the wire between them is
a script (`bad_days.world`). The axis turns at 10 rps when the fault begins. Two times are measured from there: until no
torque of ours acts any more (Operation Enabled has been left, or no current is asked for), and until the shaft stands.
The drive's own braking current is not ours.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from bad_days.loop_days import ENETDOWN, put_into
from bad_days.world import (
    HEARTBEAT,
    NODE,
    NS_PER_MS,
    PERIOD_NS,
    RPDO1,
    SYNC,
    TPDO1,
    TPDO2,
    Wire,
    World,
    live,
    ramp_to,
)
from daemon.fault_table import PARTS
from interpreted import TESTS

from fffo_drive.can.frame import ERROR_BUS_OFF, NMT, Frame, pack_frame, unpack_frame
from fffo_drive.canopen_node.nmt import NmtState
from fffo_drive.config.axis import controller_config, read_axis
from fffo_drive.control.envelope import LIMIT_CONTROLLER, EnvelopeConfig
from fffo_drive.drive.simulated import state as plant_numbers
from fffo_drive.drive.simulated.cia402_device import OPERATION_ENABLED, STATE_NAMES
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.faults import Fault, FaultKind
from fffo_drive.drive.simulated.node.personality import Personality
from fffo_drive.drive.simulated.node.simulated_plant import SimulatedPlant
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.model.parameters import read_model
from fffo_drive.runtime import blocks as b

SPEED_RPS, STEP_RPS = 10.0, 0.05  # 100 rps^2
BEGIN, TICKS, LONG = 300, 1250, 2000
SLICE_NS = 500_000
SILENCE = 300  # ticks without a sign of life of the supervisor
AFTERWARDS_NS = 300 * NS_PER_MS
EXCESS_RPS = 8.0  # following_error_rps of the axis file
STANDSTILL_RPS = 0.05
OUR_HEARTBEAT = 0x700 + 127


class FaultWorld(World):
    """A world that looks at the drive every half millisecond of its clock."""

    def __init__(self, keeps_torque: bool = False, effects: tuple[EffectConfig, ...] = ()) -> None:
        self.began_ns = 0
        self.ours_ns = 0  # when torque of ours acted last
        self.moving_ns = 0  # when the shaft moved last
        self.fastest_rps = 0.0
        self.answers: list[int] = []  # error codes of the drive's EMCY, after the fault began
        config = NodeConfig(sync_loss_tolerance_ms=50, personality=Personality(keeps_torque=keeps_torque))
        config = replace(config, plant=replace(config.plant, effects=effects))
        super().__init__(SimulatedPlant(config.plant), config)
        deliver = self.to_host

        def listening(frame: Any, raw: bytes, flight_ns: int) -> list[tuple[int, bytes]]:
            if frame.can_id == 0x081 and self.began_ns:
                code = int.from_bytes(frame.data[:2], "little")
                self.answers += [code] if code else []
            return deliver(frame, raw, flight_ns)

        self.to_host = listening

    def begin(self) -> None:
        """The fault happens now."""
        self.began_ns = self.ours_ns = self.moving_ns = self.now_ns

    def advance_to(self, until_ns: int, readable: bool = False) -> None:
        """As the base class, in slices; the plant is lived up to each of them."""
        while True:
            super().advance_to(min(until_ns, self.now_ns + SLICE_NS), readable)
            if self.began_ns:
                self._look()
            if self.now_ns >= until_ns or (readable and self.wire_end_has_sent()):
                return

    def _look(self) -> None:
        node = self.node
        node.bus.now_ns = self.now_ns
        node.advance()
        node.drive.update()
        drive, plant = node.drive, node.drive.plant
        speed_rps = abs(plant.true_velocity_rps)
        self.fastest_rps = max(self.fastest_rps, speed_rps)
        if drive.state == OPERATION_ENABLED and not drive.braking and drive.current_command_a != 0.0:
            self.ours_ns = self.now_ns
        if speed_rps > STANDSTILL_RPS:
            self.moving_ns = self.now_ns


Prepare = Callable[[FaultWorld], None]
Envelope = Callable[[EnvelopeConfig], EnvelopeConfig]


class Script(NamedTuple):
    """One fault: what happens at tick BEGIN, and the limits where they are not the file's."""

    prepare: Prepare
    envelope: Envelope = lambda config: config
    ticks: int = TICKS
    supervisor_ticks: int = 0
    keeps_torque: bool = False  # the drive, when it leaves NMT operational
    effects: tuple[EffectConfig, ...] = ()  # of the plant
    from_excess: bool = (
        False  # times count from the first tick at the current limit, or with an error beyond EXCESS_RPS
    )

    @property
    def ending(self) -> dict[str, int]:
        """A loop that ends by itself is no reason not to look at the shaft any longer."""
        return {"silence": self.supervisor_ticks, "afterwards_ns": AFTERWARDS_NS if self.supervisor_ticks else 0}


def at_begin(what: Prepare) -> Prepare:
    """At the SYNC of tick BEGIN."""

    def prepare(world: FaultWorld) -> None:
        def happen(w: World) -> None:
            world.begin()
            what(world)

        world.at = [(BEGIN, happen)]

    return prepare


def frames_lost(*can_ids: int) -> Prepare:
    """Frames with these identifiers no longer arrive, either way."""

    def without(wire: Wire, world: FaultWorld) -> Wire:
        def pass_on(frame: Frame, raw: bytes, flight_ns: int) -> list[tuple[int, bytes]]:
            return [] if frame.can_id in can_ids and world.tick >= BEGIN else wire(frame, raw, flight_ns)

        return pass_on

    def prepare(world: FaultWorld) -> None:
        world.to_host, world.to_drive = without(world.to_host, world), without(world.to_drive, world)
        at_begin(lambda w: None)(world)

    return prepare


def host_stops(for_ns: int) -> Prepare:
    """The whole process, or the loop's thread alone, does nothing any more for so long."""

    def prepare(world: FaultWorld) -> None:
        world.stalls = {BEGIN: for_ns}
        begin_ns = world.sleep_until

        def sleep_until(deadline_ns: int) -> None:
            if world._sleeps == BEGIN:
                world.advance_to(deadline_ns)
                world.begin()
            begin_ns(deadline_ns)

        world.sleep_until = sleep_until  # type: ignore[method-assign]

    return prepare


def drive_fault(kind: FaultKind, **details: Any) -> Prepare:
    """A fault of the drive's own."""
    return at_begin(lambda world: world.node.faults.inject(Fault(kind, **details)))


def drive_put_into(command: int) -> Prepare:
    """Somebody commands the drive's NMT state; its next heartbeat is due one millisecond later."""

    def prepare(world: FaultWorld) -> None:
        put_into(command, BEGIN)(world)
        *before, (tick, tell) = world.at

        def happen(w: World) -> None:
            world.begin()
            tell(w)

        world.at = [*before, (tick, happen)]

    return prepare


def foreign(*raws: bytes, ticks: int = TICKS - BEGIN) -> Prepare:
    """Somebody sends these frames in turn at our rate, after our command; drive and host hear them."""

    def after_ours(raw: bytes) -> Callable[[World], None]:
        def send(w: World) -> None:
            for to_drive in (False, True):
                w._fly(3 * PERIOD_NS // 4, to_drive, raw)

        return send

    def prepare(world: FaultWorld) -> None:
        at_begin(after_ours(raws[0]))(world)
        world.at += [(BEGIN + k, after_ours(raws[k % len(raws)])) for k in range(1, ticks)]

    return prepare


def command(controlword: int, permille: int = 300) -> bytes:
    """A command to the drive."""
    return pack_frame(RPDO1, struct.pack("<Hh", controlword, permille))


ENABLING = tuple(command(word) for word in (0x06, 0x07, *[0x0F] * 18))
STANDS_STILL = pack_frame(TPDO1, bytes(8))
OTHER_MODE = pack_frame(0x601, struct.pack("<BHBbxxx", 0x2F, 0x6060, 0, 8))


WARNING_CODE = 0xFF42  # in drive.warning_codes of the axis file


def warns(world: FaultWorld) -> None:
    """An EMCY of a code that only warns."""
    world.node.emergency.announce(WARNING_CODE, 0)


def never_says(bits: int) -> Prepare:
    """From now on the drive's statusword lacks these bits; it obeys all the same."""

    def change(world: FaultWorld) -> None:
        statusword = world.node.drive._statusword
        world.node.drive._statusword = lambda: statusword() & ~bits  # type: ignore[method-assign]

    return at_begin(change)


def host_bus_off(world: FaultWorld) -> None:
    """Our CAN controller leaves the bus: nothing arrives any more, either way."""
    world.say(ERROR_BUS_OFF, error=True)
    world.to_host = world.to_drive = lambda frame, raw, flight_ns: []


def interface_gone(world: FaultWorld) -> None:
    """The kernel takes no frame any more, and none arrives."""
    world.refusal = ENETDOWN
    world.to_host = lambda frame, raw, flight_ns: []


def wall_clock_gone(world: FaultWorld) -> None:
    """Whoever reads the wall clock from now on has not understood: it may be stepped at any time."""

    def read() -> int:
        raise AssertionError("the loop read the wall clock")

    time.time = time.time_ns = read  # type: ignore[assignment]


def supervisor_falls_silent(world: FaultWorld) -> None:
    """A sign of life to the loop with each SYNC, and none any more from tick BEGIN on."""

    def beat(w: World) -> None:
        w.blocks.control[b.SUPERVISOR_BEAT] += 1

    at_begin(lambda w: None)(world)
    world.at[:0] = [(tick, beat) for tick in range(BEGIN)]


def limit(**changes: Any) -> Script:
    """A limit that this motion breaks, from its beginning on; the fault begins when the limit is broken."""
    return Script(lambda world: None, lambda config: config._replace(**changes))


def lose_load(world: FaultWorld) -> None:
    """Three quarters of the inertia are gone: the loop has four times its gain."""
    world.node.drive.plant._parameters.numbers[plant_numbers.SPEED_PER_TORQUE] *= 4.0


def effect_becomes(parameter: int, value: float) -> Prepare:
    """A parameter of the plant's only effect changes."""

    def change(world: FaultWorld) -> None:
        world.node.drive.plant._parameters.effect_parameters.reshape(-1)[parameter] = value

    return at_begin(change)


def gains_for_four_times_the_inertia(world: FaultWorld) -> None:
    """As `set` or a reload puts them into force."""
    axis = read_axis(TESTS / "bad_days" / "axis.yaml")
    gains = {"proportional_a_per_rps": 3.9, "integral_a_per_rev": 39.0}
    section = axis.controller.model_copy(update=gains)
    model = read_model(TESTS / "bad_input" / "files" / "model.yaml")
    b.publish_controller(world.blocks, controller_config(axis.model_copy(update={"controller": section}), model))


def torque_reversed(world: FaultWorld) -> None:
    """The drive turns the sign of 0x6071, as after a change of 0x607E: the loop feeds back with the wrong sign."""
    wire = world.to_drive

    def turned(frame: Frame, raw: bytes, flight_ns: int) -> list[tuple[int, bytes]]:
        if frame.can_id == RPDO1:
            torque = -int.from_bytes(frame.data[2:4], "little", signed=True)
            raw = pack_frame(RPDO1, frame.data[:2] + torque.to_bytes(2, "little", signed=True))
        return wire(unpack_frame(raw), raw, flight_ns)

    world.to_drive = turned


def effect(name: str, **parameters: float) -> tuple[EffectConfig, ...]:
    """The plant's only effect."""
    return (EffectConfig(name, parameters),)


def oscillates(prepare: Prepare, effects: tuple[EffectConfig, ...] = (), **changes: Any) -> Script:
    """A loop that begins to oscillate, or to run away, at tick BEGIN; times count from the first excess."""
    return Script(prepare, lambda config: config._replace(**changes), LONG, effects=effects, from_excess=True)


COUPLING = effect("backlash", gap_rev=1e-6, load_share=0.75, friction_share=0.3, contact_hz=250.0)
STIFF_JOINT = effect("elasticity", load_share=0.5, frequency_hz=400.0, damping=0.01)

SCRIPTS: dict[str, Script] = {
    "host_silent": Script(host_stops(400 * NS_PER_MS)),
    "host_pauses": Script(host_stops(5 * NS_PER_MS), ticks=600),
    "clock_stepped": Script(at_begin(wall_clock_gone), ticks=600),
    "answers_missing": Script(frames_lost(TPDO1)),
    "statusword_missing": Script(frames_lost(TPDO2, 0x381)),
    "sync_missing": Script(frames_lost(SYNC)),
    "commands_missing": Script(frames_lost(RPDO1)),
    "our_heartbeat_lost": Script(frames_lost(OUR_HEARTBEAT)),
    "drive_heartbeat_lost": Script(frames_lost(HEARTBEAT), ticks=LONG),
    "drive_fault": Script(drive_fault(FaultKind.OVERCURRENT)),
    "emergency": Script(drive_fault(FaultKind.EMCY_STORM, duration_s=0.005)),
    "warning": Script(at_begin(warns), ticks=600),
    "local_control": Script(never_says(1 << 9)),
    "not_following": Script(never_says(1 << 12)),
    "drive_rebooted": Script(drive_fault(FaultKind.REBOOT, duration_s=0.002)),
    "drive_not_operational": Script(drive_put_into(0x02)),
    "supply_lost": Script(drive_fault(FaultKind.DC_LINK_LOSS)),
    "resolver_lost": Script(drive_fault(FaultKind.RESOLVER_LOSS)),
    "drive_bus_off": Script(drive_fault(FaultKind.BUS_OFF)),
    "bus_off": Script(at_begin(host_bus_off)),
    "interface_gone": Script(at_begin(interface_gone)),
    "foreign_sync": Script(foreign(pack_frame(SYNC))),
    "foreign_command": Script(foreign(command(0x0F))),
    "foreign_master": Script(foreign(*ENABLING)),
    "foreign_feedback": Script(foreign(STANDS_STILL)),
    "foreign_heartbeat": Script(foreign(pack_frame(OUR_HEARTBEAT, bytes([5])))),
    "foreign_nmt": Script(foreign(pack_frame(NMT, bytes([0x02, NODE])), ticks=1), keeps_torque=True),
    "foreign_sdo": Script(foreign(OTHER_MODE, ticks=1)),
    "keeps_torque_pre_operational": Script(drive_put_into(0x80), keeps_torque=True),
    "keeps_torque_stopped": Script(drive_put_into(0x02), keeps_torque=True),
    "keeps_torque_silent": Script(at_begin(lambda world: world.node.nmt.enter(NmtState.STOPPED)), keeps_torque=True),
    "supervisor_silent": Script(supervisor_falls_silent, supervisor_ticks=SILENCE),
    "following_error": limit(following_error_rps=0.2, following_error_s=0.01),
    "overspeed": limit(speed_limit_rps=9.0),
    "position_window": limit(position_high_rev=0.5),
    "i2t": limit(continuous_current_a=0.1, i2t_time_s=0.0003),
    "lost_load": oscillates(at_begin(lose_load)),
    "lost_load_wide_limit": oscillates(at_begin(lose_load), following_error_rps=24.0, speed_limit_rps=40.0),
    "loose_coupling": oscillates(effect_becomes(0, 0.2), COUPLING),
    "wrong_inertia": oscillates(at_begin(gains_for_four_times_the_inertia)),
    "wrong_sign": oscillates(at_begin(torque_reversed)),
    "resonance": oscillates(effect_becomes(1, 110.0), STIFF_JOINT),
}


class Outcome(NamedTuple):
    """What came of it, in milliseconds of the drive's clock."""

    row: str
    trip: int
    emcy: list[int]
    torque_ms: float
    standstill_ms: float
    drive_state: str
    goes_on: bool  # the axis is enabled and turns at the end


def live_through(name: str) -> Outcome:
    """One fault, from a turning axis to its end."""
    script = SCRIPTS[name]
    world = FaultWorld(script.keeps_torque, script.effects)
    script.prepare(world)
    by_a_limit = not (world.at or world.stalls)
    if by_a_limit:  # looked at from the beginning; the fault begins with the row that breaks the limit
        world.begin()
    clocks = time.time, time.time_ns
    try:
        profile = ramp_to(SPEED_RPS, STEP_RPS, 2 * script.ticks)
        day = live(world, script.ticks, profile=profile, change=script.envelope, **script.ending)
    finally:
        time.time, time.time_ns = clocks
    began_ns = world.began_ns
    if by_a_limit:
        began_ns = int(day.rows["deadline_ns"][(day.rows["trip"] != 0).argmax()])
    if script.from_excess:
        error_rps = np.abs(day.rows["expected_rps"] - day.rows["velocity_rps"])
        at_limit = day.rows["limits"] & LIMIT_CONTROLLER != 0
        after = np.arange(day.rows.size) >= BEGIN
        began_ns = int(day.rows["deadline_ns"][(after & (at_limit | (error_rps > EXCESS_RPS))).argmax()])
    return Outcome(
        name,
        day.trip,
        world.answers,
        max(0.0, (world.ours_ns - began_ns) / NS_PER_MS),
        max(0.0, (world.moving_ns - began_ns) / NS_PER_MS),
        STATE_NAMES[world.node.drive.state],
        world.node.drive.state == OPERATION_ENABLED,
    )


def _part(number: int) -> list[dict[str, Any]]:
    return [live_through(name)._asdict() for name in list(SCRIPTS)[number::PARTS]]


def part_0() -> list[dict[str, Any]]:
    """A share of the faults; each part runs in an interpreter of its own."""
    return _part(0)


def part_1() -> list[dict[str, Any]]:
    """The next."""
    return _part(1)


def part_2() -> list[dict[str, Any]]:
    """The next."""
    return _part(2)


def part_3() -> list[dict[str, Any]]:
    """The last."""
    return _part(3)
