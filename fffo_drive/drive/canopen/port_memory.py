"""The compiled side of a CANopen drive and its memory layout."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...can import frame as can
from ...can.link import Link
from ..port import NMT_OPERATIONAL, new_feedback
from .config import CanopenDriveConfig
from .object_map import CONTROLWORD, Scaling, command_payload, field_table, pdo_table
from .service_queue import QueueMemory
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
MEMORY_WORDS = 12  # behind these: codes of EMCY that only warn (an array of their own costs 0.5 us in each cycle)

Bytes = np.ndarray[Any, np.dtype[np.uint8]]
Words = np.ndarray[Any, np.dtype[np.int64]]


class CanopenPort(NamedTuple):
    """Data of the kernels of `cyclic`. The arrays are created once; nothing allocates afterwards."""

    rx_fd: int
    tx_fd: int
    node_id: int
    heartbeat_period_ns: int
    question: int  # word of a guarding request; -1 where the node is not guarded
    answer_mask: int  # bits of the TPDOs that answer every SYNC
    controlword_at: int  # byte in the command frame
    target_at: int
    target_bytes: int
    scaling: Scaling
    pdos: Words  # object_map.pdo_table
    fields: Words  # object_map.field_table
    feedback: Any  # FEEDBACK, shape (1,)
    memory: Words
    scratch: Words  # for the C structures of libc calls
    received: Bytes  # struct can_frame
    received_words: np.ndarray[Any, np.dtype[np.uint32]]  # the same bytes
    sync_frame: Bytes
    command_frame: Bytes
    heartbeat_frame: Bytes
    queue: QueueMemory


class Descriptors(NamedTuple):
    """The file descriptors that a port takes from a link."""

    rx_fd: int
    tx_fd: int


NO_LINK = Descriptors(-1, -1)


def make_port(config: CanopenDriveConfig, link: Link | Descriptors, queue: QueueMemory) -> CanopenPort:
    """A port on an open link, with nothing received and nothing sent."""
    pdos = pdo_table(config.answers)
    received = np.zeros(can.FRAME_SIZE, np.uint8)
    memory = np.array([0] * MEMORY_WORDS + list(config.warning_codes), np.int64)
    command = config.command
    guarded = config.silence_detection == LIFE_GUARDING
    if guarded:  # the guarding request replaces our heartbeat
        heartbeat = can.pack_frame(can.HEARTBEAT + config.node_id, bytes(1), remote=True)
    else:
        heartbeat = can.pack_frame(can.HEARTBEAT + config.master_id, bytes([NMT_OPERATIONAL]))
    return CanopenPort(
        rx_fd=link.rx_fd,
        tx_fd=link.tx_fd,
        node_id=config.node_id,
        heartbeat_period_ns=config.heartbeat_ms * 1_000_000,
        question=can.REMOTE_FLAG | can.HEARTBEAT + config.node_id if guarded else -1,
        answer_mask=int(sum(1 << slot for slot in range(len(pdos)) if pdos[slot, 2])),
        controlword_at=can.DATA_OFFSET + command.offset_of(CONTROLWORD),
        target_at=can.DATA_OFFSET + command.offset_of(config.target.index),
        target_bytes=config.target.bits // 8,
        scaling=config.scaling,
        pdos=pdos,
        fields=field_table(config.answers, config.torque),
        feedback=new_feedback(),
        memory=memory,
        scratch=np.zeros(8, np.int64),
        received=received,
        received_words=received.view(np.uint32),
        sync_frame=_frame_array(can.pack_frame(can.SYNC)),
        command_frame=_frame_array(can.pack_frame(command.cob_id, command_payload(command, config.mode))),
        heartbeat_frame=_frame_array(heartbeat),
        queue=queue,
    )


def _frame_array(raw: bytes) -> Bytes:
    return np.frombuffer(raw, np.uint8).copy()
