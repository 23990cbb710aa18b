"""From target torque to current command: offset, limits, speed limit, ramp of the torque profile mode.

CiA 402-2: cyclic synchronous torque (10) takes 0x6071 + 0x60B2 as they come with each SYNC; torque profile
(4) approaches 0x6071 with the slope 0x6087. Both obey 0x6072, 0x60E0, 0x60E1, 0x6073 and the speed limit
0x6080. A torque mode of the vendor's own has its own target, in units of its own, and the same limits.
"""

from __future__ import annotations

from operator import itemgetter

from ....canopen_node.dictionary import ObjectDictionary, multiplexer
from ....units import NS_PER_S, rps_from_rpm
from .objects import MODE_CYCLIC_TORQUE, MODE_TORQUE_PROFILE
from .personality import Personality, named
from .scales import NodeScales

NO_SLOPE = 1e9  # per mille in one call: 0x6087 = 0 is a slope that was never set, and torque jumps
LARGEST_DEMAND = 32767  # of 0x6074
SPEED_TAPER = 0.02  # share below the speed limit at which accelerating torque begins to fall

_ADJUSTABLE = (0x6071, 0x6072, 0x6073, 0x6080, 0x6087, 0x60B2, 0x60E0, 0x60E1)


class Setpoint:
    """Torque demand in thousandths of the rated torque. `limited` and `reached` are for the statusword."""

    def __init__(self, od: ObjectDictionary, scales: NodeScales, personality: Personality) -> None:
        self.od, self.scales = od, scales
        self._pick = itemgetter(*(od.slots[multiplexer(index, 0)] for index in _ADJUSTABLE))
        self._vendor_mode = personality.vendor_mode
        self._vendor_slot = od.slots[named(personality.vendor_target)] if self._vendor_mode else -1
        self._vendor_units_per_a = personality.vendor_units_per_a
        self._demand_slot = od.slots[multiplexer(0x6074, 0)]
        self.ramped = 0.0
        self.limited = False
        self.reached = False
        self.renew()
        scales.on_change.append(self.renew)

    def renew(self) -> None:
        """Read the scales again."""
        scales = self.scales
        self._a_per_permille = scales.a_per_permille
        self._peak = min(scales.peak_permille, LARGEST_DEMAND)
        self._own_thousandths = not self.od.foreign and scales.as_made
        self._current_share = scales.current_a_per_permille / scales.a_per_permille

    def clear(self) -> None:
        """Zero the target: on entering and leaving OPERATION ENABLED, and with a change of mode."""
        self.od.put(0x6071, 0, 0)
        self.od.put(0x60B2, 0, 0)
        if self._vendor_mode:
            self.od.values[self._vendor_slot] = 0
        self.ramped = 0.0
        self.idle()

    def idle(self) -> None:
        """No torque is asked for."""
        self.od.values[self._demand_slot] = 0
        self.limited = False
        self.reached = False

    def pause(self) -> None:
        """A halt: the target stays, its ramp begins again at zero."""
        self.ramped = 0.0
        self.idle()

    def current_a(self, mode: int, velocity_rps: float, elapsed_ns: int) -> float:
        """Current command in OPERATION ENABLED; `elapsed_ns` since the last call (for the slope)."""
        target, most, most_current, speed_rpm, slope, offset, forward, backward = self._pick(self.od.values)
        if mode == MODE_CYCLIC_TORQUE:
            wanted: float = target + offset
        elif mode == MODE_TORQUE_PROFILE:
            wanted = self._ramp(target, slope, elapsed_ns) + offset
        elif mode == self._vendor_mode and mode:
            wanted = self.od.values[self._vendor_slot] / self._vendor_units_per_a / self._a_per_permille
        else:
            self.idle()
            return 0.0
        if self._own_thousandths:
            most = min(most, most_current, self._peak)
            demand = min(max(wanted, -min(most, backward)), min(most, forward))
        else:
            most = min(abs(most), abs(most_current) * self._current_share, self._peak)
            demand = min(max(wanted, -min(most, abs(backward))), min(most, abs(forward)))  # 0x60E1 may have a sign
        demand = self._within_speed(demand, velocity_rps, rps_from_rpm(abs(speed_rpm)))
        self.limited = demand != wanted
        self.od.values[self._demand_slot] = round(demand)
        return demand * self._a_per_permille

    def _ramp(self, target: int, slope: int, elapsed_ns: int) -> float:
        step = abs(slope) * elapsed_ns / NS_PER_S if slope else NO_SLOPE
        self.ramped = min(max(float(target), self.ramped - step), self.ramped + step)
        self.reached = self.ramped == target
        return self.ramped

    def _within_speed(self, demand: float, velocity_rps: float, limit_rps: float) -> float:
        if demand * velocity_rps <= 0.0:
            return demand
        room_rps = limit_rps - abs(velocity_rps)
        taper_rps = SPEED_TAPER * limit_rps
        if room_rps >= taper_rps:
            return demand
        return demand * max(0.0, room_rps / taper_rps) if taper_rps else 0.0
