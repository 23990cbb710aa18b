"""Two things that only some vendors' drives do: a holding brake that opens with a delay, and a warning by EMCY."""

from __future__ import annotations

from ....canopen_node.bus import NEVER, Bus, Timed
from ....canopen_node.dictionary import ObjectDictionary
from ....canopen_node.emcy import EmergencyProducer
from ....units import NS_PER_S
from .drive_profile import NodeDrive

DIGITAL_OUTPUTS = 0x60FE
SET_BRAKE = 1  # bit 0 of 0x60FE:1, where its mask 0x60FE:2 lets it act
ENABLING = (4, 16)  # transitions


class HoldingBrake(Timed):
    """Holds the shaft without power, and for `release_s` after enabling; torque then acts on a held shaft."""

    def __init__(self, bus: Bus, od: ObjectDictionary, drive: NodeDrive, release_s: float) -> None:
        super().__init__(bus)
        self.od, self.drive = od, drive
        self._release_ns = round(release_s * NS_PER_S)
        self._open = False
        drive.on_transition.append(self._on_transition)
        od.on_write(DIGITAL_OUTPUTS, lambda sub, value: self._act())
        self._act()

    def _on_transition(self, number: int) -> None:
        if number in ENABLING and not self._open:
            self.deadline_ns = self.bus.now_ns + self._release_ns
        elif not self.drive.powered:
            self.deadline_ns = NEVER
            self._open = False
            self._act()

    def poll(self) -> None:
        """It is open."""
        self.deadline_ns = NEVER
        self._open = True
        self._act()

    def _act(self) -> None:
        number = self.od.number
        shut_by_output = number(DIGITAL_OUTPUTS, 1) & number(DIGITAL_OUTPUTS, 2) & SET_BRAKE
        self.drive.plant.hold(not self._open or bool(shut_by_output))


class EmcyWarning(Timed):
    """An emergency message without an error: the error register and the state stay as they are."""

    def __init__(self, bus: Bus, emergency: EmergencyProducer, drive: NodeDrive, code: int, at_s: float) -> None:
        super().__init__(bus)
        self.emergency, self.code = emergency, code
        self._at_ns = round(at_s * NS_PER_S) if at_s >= 0.0 else NEVER
        if at_s < 0.0:
            drive.on_transition.append(self._on_transition)

    def start(self) -> None:
        """Power-on."""
        self.deadline_ns = self.bus.now_ns + self._at_ns if self._at_ns != NEVER else NEVER

    def _on_transition(self, number: int) -> None:
        if number in ENABLING:
            self.emergency.announce(self.code)

    def poll(self) -> None:
        """Now."""
        self.deadline_ns = NEVER
        self.emergency.announce(self.code)
