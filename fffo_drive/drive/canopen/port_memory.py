"""The compiled side of a CANopen drive and its memory layout."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...can import frame as can
from ...can.link import Link
from ..cia402 import CONTROL_DISABLE_VOLTAGE
from ..port import NMT_OPERATIONAL, new_feedback
from .config import CanopenDriveConfig
from .listening import masters_frames
from .object_map import CONTROLWORD, EVERY_SYNC, MappedObject, Scaling, command_payload, field_table
from .service import NMT_PRE_OPERATIONAL, expedited_download
from .service_queue import SENT_ASIDE, QueueMemory
from .silence import LIFE_GUARDING

# words of the port's memory
ANSWERED = 0  # TPDOs that answered this tick's SYNC, one bit each
ANSWERED_TWICE = 1
EXPECTED = 2  # the bits that have to come; 0 when SYNC could not be sent
AMBIGUOUS = 3  # 1 while an answer to the previous SYNC is outstanding
POSITION_KNOWN = 4
POSITION_RAW = 5
POSITION_COUNTS = 6
NEXT_HEARTBEAT_NS = 7
SEND_ATTEMPTS = 8  # on tx_fd by the loop
CONTROLLER_OFF = 9  # error frame "bus off"
INTERFACE_OFF = 10  # the kernel says that the interface is down or gone
RETURNING = 11  # 1 from a loss of the bus until the drive has been told to stop
SECOND_ANSWERS = 12  # level of a leaky bucket, see SECOND_SHARE
HEARD_ASIDE = 13  # frames that the service may send beside the loop, heard and known
TRIPPED_TICKS = 14  # since a fault was latched; 0: none is
DISOBEYS = 15  # 1: enabled in spite of it
ANSWERS = 16  # TPDOs that answer every SYNC: how many
OWED = 17  # answers to SYNCs that have not come
IN_TIME_TICKS = 18  # for which all answers have come in time
MEMORY_WORDS = 19  # behind these: codes of EMCY that only warn (an array of their own costs 0.5 us in each cycle)

# rows of `frames`, which the loop sends
SYNC_FRAME, COMMAND_FRAME, HEARTBEAT_FRAME, ZERO_TARGET, SAME_CONTROLWORD, BE_PRE_OPERATIONAL = range(6)
SDO_DATA = can.DATA_OFFSET + 4  # where the value of an expedited SDO download begins

# kinds of identifiers in `known`
OF_DRIVE, ANSWERS_SYNC = 0, 1  # a TPDO; one that is sent with every SYNC
OF_LOOP, OF_SERVICE = 2, 3  # ours, sent by the loop alone; also beside it by the service, while no loop runs

Bytes = np.ndarray[Any, np.dtype[np.uint8]]
Words = np.ndarray[Any, np.dtype[np.int64]]


class CanopenPort(NamedTuple):
    """Data of the kernels of `cyclic`. The arrays are created once; nothing allocates afterwards."""

    rx_fd: int
    tx_fd: int
    node_id: int
    heartbeat_period_ns: int
    answer_mask: int  # bits of the TPDOs that answer every SYNC
    controlword_at: int  # byte in the command frame
    target_at: int
    target_bytes: int
    scaling: Scaling
    known: Words  # known_identifiers
    fields: Words  # object_map.field_table
    feedback: Any  # FEEDBACK, shape (1,)
    memory: Words
    scratch: Words  # for the C structures of libc calls
    received: Bytes  # struct can_frame
    received_words: np.ndarray[Any, np.dtype[np.uint32]]  # the same bytes
    frames: Bytes  # (6, 16) struct can_frame: SYNC_FRAME, COMMAND_FRAME, ...
    queue: QueueMemory


class Descriptors(NamedTuple):
    """The file descriptors that a port takes from a link."""

    rx_fd: int
    tx_fd: int


NO_LINK = Descriptors(-1, -1)


def make_port(config: CanopenDriveConfig, link: Link | Descriptors, queue: QueueMemory) -> CanopenPort:
    """A port on an open link, with nothing received and nothing sent."""
    known = known_identifiers(config)
    received = np.zeros(can.FRAME_SIZE, np.uint8)
    memory = np.array([0] * MEMORY_WORDS + list(config.warning_codes), np.int64)
    memory[HEARD_ASIDE] = queue.words[SENT_ASIDE]  # the link is open from now on
    memory[ANSWERS] = np.count_nonzero(known[:, 2] == ANSWERS_SYNC)
    command = config.command
    return CanopenPort(
        rx_fd=link.rx_fd,
        tx_fd=link.tx_fd,
        node_id=config.node_id,
        heartbeat_period_ns=config.heartbeat_ms * 1_000_000,
        answer_mask=int(sum(1 << slot for slot in range(len(known)) if known[slot, 2] == ANSWERS_SYNC)),
        controlword_at=can.DATA_OFFSET + command.offset_of(CONTROLWORD),
        target_at=can.DATA_OFFSET + command.offset_of(config.target.index),
        target_bytes=config.target.bits // 8,
        scaling=config.scaling,
        known=known,
        fields=field_table(config.answers, config.torque),
        feedback=new_feedback(),
        memory=memory,
        scratch=np.zeros(8, np.int64),
        received=received,
        received_words=received.view(np.uint32),
        frames=np.frombuffer(b"".join(_frames(config)), np.uint8).reshape(-1, can.FRAME_SIZE).copy(),
        queue=queue,
    )


def known_identifiers(config: CanopenDriveConfig) -> Words:
    """One row per identifier that is listened for, shape (n, 3): its word, length in bytes (of a TPDO), kind.

    The TPDOs first, in their order; then all that only a master sends (`listening.masters_frames`).
    """
    rows = [
        (pdo.cob_id, pdo.data_bytes, ANSWERS_SYNC if pdo.transmission == EVERY_SYNC else OF_DRIVE)
        for pdo in config.answers
    ]
    of_service = (can.NMT, can.SDO_REQUEST + config.node_id, can.REMOTE_FLAG | can.HEARTBEAT + config.node_id)
    rows += [(word, 0, OF_SERVICE if word in of_service else OF_LOOP) for word in masters_frames(config)]
    return np.array(rows, np.int64)


def _frames(config: CanopenDriveConfig) -> tuple[bytes, ...]:
    """What the loop sends, in the order of SYNC_FRAME, COMMAND_FRAME, ..."""
    command, target = config.command, config.target
    if config.silence_detection == LIFE_GUARDING:  # the guarding request replaces our heartbeat
        heartbeat = can.pack_frame(can.HEARTBEAT + config.node_id, bytes(1), remote=True)
    else:
        heartbeat = can.pack_frame(can.HEARTBEAT + config.master_id, bytes([NMT_OPERATIONAL]))
    return (
        can.pack_frame(can.SYNC),
        can.pack_frame(command.cob_id, command_payload(command, config.mode)),
        heartbeat,
        expedited_download(config.node_id, target, 0),
        expedited_download(config.node_id, MappedObject(CONTROLWORD, 0, 16), CONTROL_DISABLE_VOLTAGE),
        can.pack_frame(can.NMT, bytes([NMT_PRE_OPERATIONAL, config.node_id])),
    )
