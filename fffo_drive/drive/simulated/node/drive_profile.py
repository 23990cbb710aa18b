"""CiA 402 above the plant: state machine, option codes, faults, statusword, feedback objects.

The transitions are `cia402_device.device_step`. A controlword acts when it is written; between writes the
drive makes only its own transitions. The target torque acts in OPERATION ENABLED alone; in the other states
the power stage carries current only while the drive brakes (quick stop, fault reaction, slow-down ramp).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from ....canopen_node.abort import Abort, SdoAbortError
from ....canopen_node.bus import Bus
from ....canopen_node.dictionary import ObjectDictionary, multiplexer
from ....canopen_node.emcy import SYNC_LOSS, EmergencyProducer
from ....units import S_PER_MIN
from .. import cia402_device as cia402
from ..braking import COAST, SLOW_RAMP, BrakeSettings, brake_kind
from .braking import PERIOD_NS, Brake
from .objects import (
    DC_LINK_OVERVOLTAGE,
    DC_LINK_UNDERVOLTAGE,
    MODE_CYCLIC_TORQUE,
    MODE_NONE,
    MODE_TORQUE_PROFILE,
    OVERCURRENT,
    OVERSPEED,
    OVERTEMPERATURE,
    RESOLVER,
)
from .personality import Personality
from .ratings import Ratings
from .scales import NodeScales
from .setpoint import Setpoint

if TYPE_CHECKING:
    from .simulated_plant import SimulatedPlant

ABORT_CONNECTION, ERROR_CODE, CONTROLWORD, STATUSWORD = 0x6007, 0x603F, 0x6040, 0x6041
QUICK_STOP_OPTION, SHUTDOWN_OPTION, DISABLE_OPTION, HALT_OPTION, FAULT_OPTION = 0x605A, 0x605B, 0x605C, 0x605D, 0x605E
MODE, MODE_DISPLAY = 0x6060, 0x6061
MAX_TORQUE, MAX_SPEED, SLOW_DOWN, QUICK_STOP = 0x6072, 0x6080, 0x6084, 0x6085
CYCLE_PERIOD, INTERPOLATION_PERIOD, DIGITAL_INPUTS, SUPPORTED = 0x1006, 0x60C2, 0x60FD, 0x6502
WRONG_PERIOD = 1  # detail of EMCY 0x8700: SYNC and interpolation period differ

MALFUNCTION, DISABLE_VOLTAGE, STOP_QUICKLY = 1, 2, 3  # 0x6007
CW_HALT = 0x0100
MODE_BITS = 32  # of 0x6502: from bit 16 on the vendor's modes -1, -2 ...
OVERSPEED_FACTOR = 1.2  # of 0x6080
OVERCURRENT_FACTOR = 1.5  # of the peak
NO_COMMAND = cia402.CW_ENABLE_VOLTAGE | cia402.CW_QUICK_STOP | cia402.CW_FAULT_RESET
UNABLE_TO_BRAKE = frozenset({RESOLVER, OVERCURRENT, DC_LINK_OVERVOLTAGE, DC_LINK_UNDERVOLTAGE})
_POWERED_STATES = (cia402.OPERATION_ENABLED, cia402.QUICK_STOP_ACTIVE)
_RISING = frozenset({cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION})
_STATES_BELOW_POWER = frozenset({cia402.SWITCH_ON_DISABLED, cia402.READY_TO_SWITCH_ON, cia402.SWITCHED_ON})
LARGEST_INDEX = 9  # powers of ten of the interpolation period that have a meaning: 1 ns to 1e9 s
_INT32 = 1 << 31


class NodeDrive:
    """The drive. `advance_to` advances its time, `update` computes what it does next."""

    def __init__(
        self,
        bus: Bus,
        od: ObjectDictionary,
        emergency: EmergencyProducer,
        plant: SimulatedPlant,
        ratings: Ratings,
        personality: Personality,
    ) -> None:
        self.bus, self.od, self.emergency, self.plant, self.ratings = bus, od, emergency, plant, ratings
        self.personality = personality
        self.state = cia402.START
        self.scales = NodeScales(od, ratings, personality, lambda: self.powered)
        self.setpoint = Setpoint(od, self.scales, personality)
        self.time_ns = 0  # of the plant
        self.stuck = False  # fault injection: the statusword no longer changes
        self.injected: set[int] = set()  # fault conditions in effect
        self.on_transition: list[Callable[[int], None]] = []
        self._word = 0  # the last controlword
        self._settled_word = -1  # a word that changes nothing any more
        self._deferred_word: int | None = None  # carried out when the slow-down ramp has ended
        self._brake: Brake | None = None
        self._halting = False  # the brake is that of a halt, in OPERATION ENABLED
        self._current_a = 0.0
        self._updated_ns = 0
        self._fault_code = 0
        self._own_error = 0  # the EMCY that a fault reset ends; 0 where another service announced it
        self._status_slot = od.slots[multiplexer(STATUSWORD, 0)]
        self._mode_slot = od.slots[multiplexer(MODE_DISPLAY, 0)]
        self._register_slot = od.slots[multiplexer(0x1001, 0)]
        self._max_speed_slot = od.slots[multiplexer(MAX_SPEED, 0)]
        self._follows = personality.command_following == "shown"
        self._shows_limit = personality.limit_shown
        self._obeys_target = personality.command_following != "refused"
        self._millivolts = 1000.0 * personality.dc_link_share
        self._without_power = (
            personality.sto_active or personality.dc_link_share * plant.dc_link_v < ratings.undervoltage_v
        )
        self._steady_bits = cia402.SW_REMOTE if personality.remote else 0
        self._late_mode: int | None = None  # written, and not in force yet
        self._highest_rpm = round(ratings.max_speed_rps * S_PER_MIN)
        self._overcurrent_a = OVERCURRENT_FACTOR * ratings.peak_permille * ratings.a_per_permille
        self._feedback_slots = tuple(od.slots[multiplexer(i, 0)] for i in (0x6064, 0x606C, 0x6077, 0x6078, 0x6079))
        self._scale()
        self.scales.on_change.append(self._scale)
        self._listen()
        self.restart()

    def _scale(self) -> None:
        """Read the scales again."""
        scales = self.scales
        self._a_per_permille = scales.a_per_permille
        self._current_a_per_permille = scales.current_a_per_permille
        self._current_differs = scales.current_a_per_permille != scales.a_per_permille
        self._velocity_per_rps = scales.velocity_per_rps
        self._position = scales.position if scales.converts_position else None

    @property
    def powered(self) -> bool:
        """The power stage may work."""
        return self.state in _POWERED_STATES or self.state == cia402.FAULT_REACTION_ACTIVE

    def _listen(self) -> None:
        od = self.od
        od.on_write(CONTROLWORD, lambda sub, value: self.command(value))
        od.on_write(MODE, lambda sub, value: self._select_mode(value))
        od.guard(MODE, lambda sub, value: self._check_mode(value))
        od.guard(QUICK_STOP_OPTION, _one_of(0, 1, 2, 3, 5, 6, 7))
        for index in (0x6072, 0x6073, 0x60E0, 0x60E1):
            if not od.foreign:  # others have limits of their own
                od.guard(index, self._check_torque_limit)

    def _check_torque_limit(self, sub: int, value: int) -> None:
        if value > round(self.scales.peak_permille):
            raise SdoAbortError(Abort.VALUE_TOO_HIGH)

    def _has_mode(self, mode: int) -> bool:
        """0x6502 has it, or it is the vendor's own. What is no torque mode is shown, and gives no torque."""
        if mode in (MODE_NONE, self.personality.vendor_mode):
            return True
        bit = mode - 1 if mode > 0 else 15 - mode
        return bit < MODE_BITS and bool(self.od.number(SUPPORTED) >> bit & 1)

    def _check_mode(self, value: int) -> None:
        if not self._has_mode(_signed(value)):
            raise SdoAbortError(Abort.INVALID_VALUE)

    def restart(self) -> None:
        """Power-on, or reset of the whole node: the machine starts at the beginning, the shaft turns on."""
        self.state = cia402.START
        self._word, self._settled_word, self._deferred_word = 0, -1, None
        self._release_brake()
        self._current_a = 0.0
        self._fault_code = self._own_error = 0
        self.setpoint.clear()
        self._late_mode = None
        self.scales.renew()
        self.od.put(ERROR_CODE, 0, 0)
        mode = _signed(self.od.number(MODE))
        self.od.put(MODE_DISPLAY, 0, mode if self._has_mode(mode) else MODE_NONE)
        self.od.put(DIGITAL_INPUTS, 0, self.personality.sto_active << self.personality.sto_input_bit)
        self._step()
        self.update()

    # time

    def advance_to(self, until_ns: int) -> None:
        """Advance the plant to `until_ns` of its time with the command in force; latch the feedback."""
        while self._brake is not None and self.time_ns < until_ns:
            to_ns = min(self.time_ns + PERIOD_NS, until_ns)
            self._current_a = self._brake.step(self.plant.velocity_rps, to_ns - self.time_ns)
            self._run_plant(to_ns)
            if self._brake.stopped:
                self._end_braking()
        if self.time_ns < until_ns:
            self._run_plant(until_ns)
        self._latch()

    def _run_plant(self, until_ns: int) -> None:
        self.plant.advance(until_ns, self._current_a)
        self.time_ns = until_ns

    def _latch(self) -> None:
        plant, values = self.plant, self.od.values
        position, velocity, torque, current, voltage = self._feedback_slots
        counts = plant.counts if self._position is None else self._position(plant.counts)
        values[position] = (counts + _INT32) % (2 * _INT32) - _INT32
        speed = round(plant.velocity_rps * self._velocity_per_rps)
        values[velocity] = min(max(speed, -_INT32), _INT32 - 1)
        permille = min(max(round(plant.current_a / self._a_per_permille), -32768), 32767)
        values[torque] = values[current] = permille
        if self._current_differs:
            permille = round(plant.current_a / self._current_a_per_permille)
            values[current] = min(max(permille, -32768), 32767)
        values[voltage] = max(0, round(plant.dc_link_v * self._millivolts))

    def update(self) -> None:
        """Supervise, and compute the current command and the statusword from what is known now."""
        self._supervise()
        self._halt()
        if self.state == cia402.OPERATION_ENABLED and self._brake is None and self._obeys_target:
            self._current_a = self.setpoint.current_a(
                self.od.values[self._mode_slot], self.plant.velocity_rps, self.time_ns - self._updated_ns
            )
        elif self._brake is None:
            self._current_a = 0.0
        self._updated_ns = self.time_ns
        if not self.stuck:
            self.od.values[self._status_slot] = self._statusword()

    @property
    def current_command_a(self) -> float:
        """Command of the current loop."""
        return self._current_a

    @property
    def braking(self) -> bool:
        """The drive's own velocity loop is closed."""
        return self._brake is not None

    # state machine

    def command(self, word: int) -> None:
        """A controlword was written."""
        if word == self._settled_word or not self.personality.remote:
            return
        if self._without_power and self.state in _STATES_BELOW_POWER and cia402.command_of(word) in _RISING:
            self._word = word
            return
        previous, self._word = self._word, word
        if self.state != cia402.OPERATION_ENABLED or not self._defers(word):
            if self._deferred_word is not None:  # another command ends the ramp
                self._deferred_word = None
                self._release_brake()
            self._step(word, previous)
        self._settled_word = word

    def _defers(self, word: int) -> bool:
        """Shutdown and disable operation with option 1 first run the motor down, in OPERATION ENABLED."""
        options = {cia402.SHUTDOWN: SHUTDOWN_OPTION, cia402.SWITCH_ON: DISABLE_OPTION}
        option = options.get(cia402.command_of(word))
        if option is None or self.od.number(option) != SLOW_RAMP:
            return False
        self.setpoint.clear()
        brake = self._new_brake(SLOW_RAMP)
        if brake.stopped:
            return False
        self._deferred_word, self._brake, self._halting = word, brake, False
        return True

    def _halt(self) -> None:
        """Bit 8 of the controlword in the torque profile mode (the cyclic mode has no halt): 0x605D."""
        mode = self.od.values[self._mode_slot]
        wanted = self.state == cia402.OPERATION_ENABLED and mode == MODE_TORQUE_PROFILE and bool(self._word & CW_HALT)
        if wanted and self._brake is None:
            self.setpoint.pause()
            self._brake, self._halting = self._new_brake(self.od.number(HALT_OPTION)), True
        elif self._halting and not wanted:
            self._release_brake()

    def _release_brake(self) -> None:
        self._brake, self._halting = None, False

    def _step(self, word: int = NO_COMMAND, previous: int = NO_COMMAND, fault: bool = False) -> None:
        """Make every transition that is due: those of the command `word`, and those of the drive itself."""
        option = self.od.number(QUICK_STOP_OPTION)
        for _ in range(len(cia402.STATE_NAMES)):
            source = self.state
            done = self._brake is None
            present = fault or (source == cia402.FAULT and self._fault_remains())
            self.state, number = cia402.device_step(source, word, previous, present, done, option)
            if number == cia402.NO_TRANSITION:
                return
            previous = word
            fault = False
            self._settled_word = -1
            self._act_out(number, powered=source in _POWERED_STATES)

    def _act_out(self, number: int, powered: bool) -> None:
        """What a transition does beside changing the state. `powered`: from a state with torque."""
        if cia402.clears_target(number):
            self.setpoint.clear()
        self._halting = False
        if number == 4:
            self.settle_mode()
            self._check_period()
        if number == 11:
            self._begin_braking(brake_kind(self.od.number(QUICK_STOP_OPTION)))
        elif number == 13:
            able = powered and self._fault_code not in UNABLE_TO_BRAKE
            self._begin_braking(self.od.number(FAULT_OPTION) if able else COAST)
        else:
            self._release_brake()
        if number == 15:
            self.emergency.clear(self._own_error, 0)
            self._fault_code = self._own_error = 0
            self.od.put(ERROR_CODE, 0, 0)
        self._current_a = 0.0  # until the target, or the brake's first step, says otherwise
        for listener in self.on_transition:
            listener(number)

    def _begin_braking(self, kind: int) -> None:
        self._brake = None if kind == COAST else self._new_brake(kind)

    def _new_brake(self, kind: int) -> Brake:
        ratings, scales = self.ratings, self.scales
        limit_permille = min(abs(self.od.number(MAX_TORQUE)), scales.peak_permille)
        settings = BrakeSettings(
            slow_rps2=self._ramp_rps2(SLOW_DOWN, ratings.slow_rps2),
            quick_rps2=self._ramp_rps2(QUICK_STOP, ratings.quick_rps2),
            gain_a_per_rps=ratings.brake_a_per_rps,
            limit_a=limit_permille * scales.a_per_permille,
            standstill_rps=ratings.standstill_rps,
        )
        return Brake(settings, kind, self.plant.velocity_rps)

    def _ramp_rps2(self, index: int, otherwise_rps2: float) -> float:
        """Deceleration of a ramp from its object in velocity units a second; without the object the drive's own."""
        units = self.od.number(index) if self.od.has(index) else 0
        return units / self.scales.units_per_rps if units > 0 else otherwise_rps2

    def _end_braking(self) -> None:
        if self._halting or (self.state == cia402.QUICK_STOP_ACTIVE and self._holds_standstill()):
            return
        self._release_brake()
        self._current_a = 0.0
        if self._deferred_word is not None:
            word, self._deferred_word = self._deferred_word, None
            self._step(word, word)
        else:
            self._step()

    def _holds_standstill(self) -> bool:
        return self.od.number(QUICK_STOP_OPTION) >= cia402.QUICK_STOP_STAYS

    # faults

    def trip(self, code: int, announce: bool = True) -> None:
        """A fault: EMCY (unless another service announced it), 0x603F, and the fault reaction."""
        if self.state in (cia402.FAULT_REACTION_ACTIVE, cia402.FAULT):
            return
        self._fault_code = code
        self._deferred_word = None
        self.od.put(ERROR_CODE, 0, code)
        if announce:
            self._own_error = code
            self.emergency.raise_error(code)
        self._step(fault=True)

    def connection_lost(self, code: int, announce: bool = False) -> None:
        """The master is gone (heartbeat, RPDO, SYNC, bus-off, NMT): do as 0x6007 says, if torque is on."""
        if self.state not in _POWERED_STATES:
            return
        option = self.od.number(ABORT_CONNECTION)
        if option == MALFUNCTION:
            self.trip(code, announce)
        elif option == DISABLE_VOLTAGE:
            self.command(0)
        elif option == STOP_QUICKLY:
            self.command(cia402.CW_ENABLE_VOLTAGE)

    def _supervise(self) -> None:
        if self.state in _POWERED_STATES:
            self._supervise_power()
        if self.injected and self.state not in (cia402.FAULT, cia402.FAULT_REACTION_ACTIVE):
            self.trip(next(iter(self.injected)))

    def _supervise_power(self) -> None:
        plant, ratings = self.plant, self.ratings
        if plant.dc_link_v < ratings.undervoltage_v:
            self.trip(DC_LINK_UNDERVOLTAGE)
        elif plant.dc_link_v > ratings.overvoltage_v:
            self.trip(DC_LINK_OVERVOLTAGE)
        elif abs(plant.velocity_rps) > (
            OVERSPEED_FACTOR * (abs(self.od.values[self._max_speed_slot]) or self._highest_rpm) / S_PER_MIN
        ):
            self.trip(OVERSPEED)
        elif abs(plant.current_a) > self._overcurrent_a:
            self.trip(OVERCURRENT)
        elif plant.temperature_k > ratings.highest_temperature_k:
            self.trip(OVERTEMPERATURE)

    def _fault_remains(self) -> bool:
        """A fault condition that blocks a fault reset; it is measured without torque too."""
        plant, ratings = self.plant, self.ratings
        hot = plant.temperature_k > ratings.highest_temperature_k
        return bool(self.injected) or hot or plant.dc_link_v > ratings.overvoltage_v

    def _check_period(self) -> None:
        """A cyclic mode needs an interpolation period equal to the SYNC period (0x1006, if it is set)."""
        number = self.od.number
        period_us = number(CYCLE_PERIOD)
        power = min(max(number(INTERPOLATION_PERIOD, 2), -LARGEST_INDEX), LARGEST_INDEX)
        interpolated_us = number(INTERPOLATION_PERIOD, 1) * 10 ** (6 + power)
        if self.od.values[self._mode_slot] == MODE_CYCLIC_TORQUE and period_us not in (0, interpolated_us):
            self.emergency.raise_error(SYNC_LOSS, WRONG_PERIOD)
        else:
            self.emergency.clear(SYNC_LOSS, WRONG_PERIOD)

    # modes and statusword

    def _select_mode(self, value: int) -> None:
        mode = _signed(value)
        if not self._has_mode(mode):  # by RPDO
            return
        self._late_mode = mode
        follows = self.personality.mode_display
        if follows == "at_once" or (follows == "when_enabled" and self.state == cia402.OPERATION_ENABLED):
            self.settle_mode()

    def settle_mode(self) -> None:
        """The mode that was written last is in force, and 0x6061 shows it."""
        mode, self._late_mode = self._late_mode, None
        if mode is not None and mode != self.od.values[self._mode_slot]:
            self.od.values[self._mode_slot] = mode
            self.setpoint.clear()
            if self.state == cia402.OPERATION_ENABLED:
                self._check_period()

    def _statusword(self) -> int:
        bits = self._steady_bits
        if self.plant.dc_link_v >= self.ratings.undervoltage_v and not self._without_power:
            bits |= cia402.SW_VOLTAGE_ENABLED
        if self.od.values[self._register_slot] and self.state not in (cia402.FAULT, cia402.FAULT_REACTION_ACTIVE):
            bits |= cia402.SW_WARNING
        if self.state == cia402.OPERATION_ENABLED:
            mode = self.od.values[self._mode_slot]
            limited = self._shows_limit and (self.setpoint.limited or self.plant.limited)
            if limited:
                bits |= cia402.SW_INTERNAL_LIMIT
            if mode == MODE_CYCLIC_TORQUE and self._brake is None and not limited and self._follows:
                bits |= cia402.SW_FOLLOWS_COMMAND
            if mode == MODE_TORQUE_PROFILE and self._reached:
                bits |= cia402.SW_TARGET_REACHED
        return cia402.statusword_of(self.state, bits)

    @property
    def _reached(self) -> bool:
        """Bit 10 in the torque profile mode: the ramp has arrived; in a halt: the motor stands."""
        if self._brake is not None:
            return self._halting and self._brake.stopped
        return self.setpoint.reached


def _signed(mode: int) -> int:
    """A mode of operation, also where a file has 0x6060 without a sign."""
    return (mode & 0xFF ^ 0x80) - 0x80


def _one_of(*allowed: int) -> Callable[[int, int], None]:
    def check(sub: int, value: int) -> None:
        if value not in allowed:
            raise SdoAbortError(Abort.INVALID_VALUE)

    return check
