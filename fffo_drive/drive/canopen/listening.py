"""Detection of other masters: the program listens on a bus before it sends anything.

Within `listen_s`, a running master is detected by its SYNC, NMT commands, or frames to our drive, and two nodes with
the drive's id by contradicting heartbeats. Not detected are: a master that is silent for this time, or addresses other
nodes only and sends neither SYNC nor NMT commands; two nodes with one id and identical heartbeats (bring-up finds them
by two answers to one request); a master that starts at the same moment (on this machine the lease of the bus prevents
that). The running loop watches the same identifiers, and takes any such frame that is not ours as a fault.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import NamedTuple

from ...can import frame as can
from ...can.bpf import CanFilter
from ...can.frame import Frame, unpack_frame
from ...can.link import open_link
from .config import ONE_MASTER, CanopenDriveConfig
from .service import STATE_BOOT_UP, STATE_OPERATIONAL, STATE_PRE_OPERATIONAL, STATE_STOPPED
from .silence import LIFE_GUARDING

MOST_FRAMES = 1 << 16  # frames examined: more than a bus at 1 Mbit/s carries in 3 s
NODE_ID_MASK = 0x7F
STATE_NAMES = {
    STATE_BOOT_UP: "boot-up",
    STATE_STOPPED: "stopped",
    STATE_OPERATIONAL: "operational",
    STATE_PRE_OPERATIONAL: "pre-operational",
}
TWO_NODES = "two nodes have this id, or its supply fails: look at both"


class Obstacle(NamedTuple):
    """A reason not to start on a bus, with its remedy."""

    text: str
    remedy: str


def masters_frames(config: CanopenDriveConfig) -> dict[int, str]:
    """What only a master of this bus or of this drive sends: COB-ID (with its flag, of a remote frame), description."""
    node, master = config.node_id, config.master_id
    commands = {base + node for base in (can.RPDO1, can.RPDO2, can.RPDO3, can.RPDO4)} | {config.command.cob_id}
    commands -= {pdo.cob_id for pdo in config.answers}
    ours, asked = can.HEARTBEAT + master, can.HEARTBEAT + node
    guarded = config.silence_detection == LIFE_GUARDING
    guarding = {can.REMOTE_FLAG | asked: f"guarding requests to node {node} (0x{asked:03X})"} if guarded else {}
    return {
        can.SYNC: "SYNC (0x080)",
        can.NMT: "NMT commands (0x000)",
        can.SDO_REQUEST + node: f"SDO requests to node {node} (0x{can.SDO_REQUEST + node:03X})",
        ours: f"the heartbeat of node {master} (0x{ours:03X}), which is ours (drive.master_id)",
        **{cob_id: f"commands to node {node} (RPDO 0x{cob_id:03X})" for cob_id in sorted(commands)},
        **guarding,
    }


def foreign_text(config: CanopenDriveConfig, can_id: int) -> str:
    """What a frame is that somebody else sent in our name, or in the drive's."""
    texts = {word & can.STANDARD_MASK: text for word, text in masters_frames(config).items()}
    texts |= {pdo.cob_id: f"feedback of node {config.node_id} (TPDO 0x{pdo.cob_id:03X})" for pdo in config.answers}
    return texts.get(can_id, f"frames 0x{can_id:03X}")


def frames_of_any_master() -> dict[int, str]:
    """As `masters_frames` before a drive is chosen: for any node, in the predefined connection set (CiA 301)."""
    found = {can.SYNC: "SYNC (0x080)", can.NMT: "NMT commands (0x000)"}
    for node in can.NODE_IDS:
        found[can.SDO_REQUEST + node] = f"SDO requests to node {node} (0x{can.SDO_REQUEST + node:03X})"
        for base in (can.RPDO1, can.RPDO2, can.RPDO3, can.RPDO4):
            found[base + node] = f"commands to node {node} (RPDO 0x{base + node:03X})"
    return found


class _Life:
    """NMT states in the heartbeats of one node since its last boot-up."""

    def __init__(self) -> None:
        self.states: list[int] = []  # each change of state
        self.boot_ups = 0
        self.disagree = ""

    def take(self, state: int) -> None:
        """A node returns to an earlier state only after a boot-up, or on an NMT command, which is heard as well."""
        if state == STATE_BOOT_UP:
            self.states.clear()
            self.boot_ups += 1
        elif self.states and state != self.states[-1] and state in self.states:
            self.disagree = f"{state_name(self.states[-1])} and {state_name(state)} in turn"
        if not self.states or state != self.states[-1]:
            self.states.append(state)


class Heard:
    """Frames heard on a bus before anything is sent, and reasons not to start there.

    With a configuration: for its drive; without one: for every node.
    """

    def __init__(self, config: CanopenDriveConfig | None = None) -> None:
        self.nodes: set[int] = set()  # ids of heartbeats and boot-ups
        self._of_masters = frames_of_any_master() if config is None else masters_frames(config)
        self._watched: Iterable[int] = can.NODE_IDS if config is None else (config.node_id,)
        self._masters: set[int] = set()
        self._lives: dict[int, _Life] = {}

    def take(self, frame: Frame) -> None:
        """Take one frame of the bus; frames come in order."""
        if frame.extended or frame.error:
            return
        word = frame.can_id | (can.REMOTE_FLAG if frame.remote else 0)
        if word in self._of_masters:
            self._masters.add(word)
        if frame.remote:
            return
        if frame.can_id & ~NODE_ID_MASK == can.HEARTBEAT and len(frame.data) == 1:
            node = frame.can_id & NODE_ID_MASK
            self.nodes.add(node)
            if node in self._watched:
                self._lives.setdefault(node, _Life()).take(frame.data[0] & 0x7F)

    def obstacles(self) -> list[Obstacle]:
        """Reasons not to start here."""
        found = []
        if self._masters:
            signs = ", ".join(text for can_id, text in self._of_masters.items() if can_id in self._masters)
            found.append(Obstacle(f"somebody else commands here: {signs}", ONE_MASTER))
        for node, life in sorted(self._lives.items()):
            if life.disagree or life.boot_ups > 1:
                said = life.disagree or f"{life.boot_ups} boot-up messages"
                found.append(Obstacle(f"node {node} says {said}", TWO_NODES))
        return found


def state_name(state: int) -> str:
    """An NMT state in words."""
    return STATE_NAMES.get(state, f"state 0x{state:02X}")


class Listening:
    """A bus on which the program listens without sending: the kernel buffers the frames until `heard` reads them."""

    def __init__(self, config: CanopenDriveConfig | str, listen_s: float) -> None:
        """For the drive of a configuration, or for every node of a bus. Raises LinkError."""
        self._config = None if isinstance(config, str) else config
        bus = config if isinstance(config, str) else config.bus
        filters = None
        if self._config is not None:
            heartbeats = CanFilter(can.HEARTBEAT, can.STANDARD_MASK & ~NODE_ID_MASK)
            filters = [heartbeats, *(CanFilter(can_id) for can_id in masters_frames(self._config))]
        self._link = open_link(bus, filters=filters)
        self._end_s = time.monotonic() + listen_s

    def heard(self) -> Heard:
        """Frames received until `listen_s` has passed, and until now. Raises LinkError."""
        heard = Heard(self._config)
        for _ in range(MOST_FRAMES):
            raw = self._link.receive(max(0.0, self._end_s - time.monotonic()))
            if raw is None:
                break
            heard.take(unpack_frame(raw))
        return heard

    def close(self) -> None:
        """Stop listening."""
        self._link.close()
