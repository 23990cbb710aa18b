"""NMT slave (CiA 301, 7.3.2): the node's communication state, boot-up, and the two resets.

Services ask here what the state permits: `communicates` (SDO, SYNC, EMCY) and `exchanges` (PDO).
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

from ..can.frame import DATA_OFFSET, HEARTBEAT, LENGTH_OFFSET
from .bus import Bus


class NmtState(IntEnum):
    """States as the heartbeat reports them."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """Command specifiers of the NMT master's message."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


UNCONFIGURED = 255  # in place of a node-ID: none

_TARGETS = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}


class NmtSlave:
    """The state machine. `on_change(old, new)` follows each change, `on_reset(whole_node)` initialises.

    A reset leads through INITIALISING to PRE-OPERATIONAL, announced by the boot-up message, and on to OPERATIONAL in a
    node that starts itself. `on_reset` may change the node-ID.
    """

    def __init__(
        self,
        bus: Bus,
        node_id: int,
        on_change: Callable[[NmtState, NmtState], None],
        on_reset: Callable[[bool], None],
        starts_itself: Callable[[], bool] = lambda: False,
    ) -> None:
        self.bus = bus
        self.node_id = node_id
        self.state = NmtState.INITIALISING
        self.communicates = False  # SDO, SYNC and EMCY exist: PRE-OPERATIONAL and OPERATIONAL
        self.exchanges = False  # PDOs exist: OPERATIONAL
        self._on_change = on_change
        self._on_reset = on_reset
        self._starts_itself = starts_itself

    def receive(self, frame: bytes) -> None:
        """An NMT command; one for another node, of a wrong length or unknown is ignored."""
        if frame[LENGTH_OFFSET] != 2 or frame[DATA_OFFSET + 1] not in (0, self.node_id):
            return
        command = frame[DATA_OFFSET]
        if command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            self.reset(whole_node=command == NmtCommand.RESET_NODE)
        elif command in _TARGETS:
            self.enter(_TARGETS[NmtCommand(command)])

    def reset(self, whole_node: bool) -> None:
        """Initialise the node (or only its communication), send boot-up, and go to PRE-OPERATIONAL."""
        self.enter(NmtState.INITIALISING)
        self._on_reset(whole_node)
        if self.node_id == UNCONFIGURED:  # LSS alone, until there is a node-ID
            return
        self.bus.send(HEARTBEAT + self.node_id, b"\x00")
        self.enter(NmtState.PRE_OPERATIONAL)
        if self._starts_itself():
            self.enter(NmtState.OPERATIONAL)

    def enter(self, state: NmtState) -> None:
        """Change the state (also from within: 0x1029)."""
        old = self.state
        if state is not old:
            self.state = state
            self.exchanges = state is NmtState.OPERATIONAL
            self.communicates = self.exchanges or state is NmtState.PRE_OPERATIONAL
            self._on_change(old, state)
