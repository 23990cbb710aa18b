"""Frames as no standard has them, in batches, from a seed: for the node and for the controller's receiving code."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from fffo_drive.can.frame import ERROR_FLAG, EXTENDED_FLAG, EXTENDED_MASK, FRAME_SIZE, REMOTE_FLAG

BATCH = 8192
FRAME = np.dtype([("word", "<u4"), ("length", "u1"), ("pad", "u1", 3), ("data", "u1", 8)])
SELECT_CYCLIC_TORQUE = np.array([0x2F, 0x60, 0x60, 0, 10, 0, 0, 0], np.uint8)  # 0x6060 by SDO
Frames = np.ndarray[Any, np.dtype[np.void]]


def _batch(generator: np.random.Generator, count: int, can_ids: np.ndarray[Any, Any]) -> Frames:
    """Data frames with these identifiers, random data, lengths mostly 8."""
    frames = np.zeros(count, FRAME)
    frames["word"] = generator.choice(can_ids, count)
    lengths = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 8, 8, 8], np.uint8)
    frames["length"] = generator.choice(lengths, count)
    frames["data"] = generator.integers(0, 256, (count, 8), np.uint8)
    return frames


def malformed(seed: int, count: int, own_ids: list[int]) -> Iterator[Frames]:
    """Frames that no node may take for its own: 29 bit, remote, too long, or with another's identifier."""
    generator = np.random.default_rng(seed)
    foreign = np.array([k for k in range(0x800) if k not in own_ids], np.uint32)
    for size in _sizes(count):
        frames = _batch(generator, size, np.array(own_ids, np.uint32))
        kind = generator.integers(0, 5, size)
        frames["word"][kind == 0] |= EXTENDED_FLAG
        frames["word"][kind == 1] |= REMOTE_FLAG
        frames["word"][kind == 2] = generator.choice(foreign, int((kind == 2).sum()))
        extended = generator.integers(0, EXTENDED_MASK, int((kind == 3).sum()), np.uint32)
        frames["word"][kind == 3] = extended | EXTENDED_FLAG
        frames["length"][kind == 4] = generator.integers(9, 256, int((kind == 4).sum()), np.uint8)
        yield frames


def anything(seed: int, count: int, own_ids: list[int], objects: list[int]) -> Iterator[Frames]:
    """Half frames that a node takes for its own, as often legal as not, half of any bits at all.

    `objects`: index << 8 | sub of what SDO requests ask for, every other time.
    """
    generator = np.random.default_rng(seed)
    for size in _sizes(count):
        frames = _batch(generator, size, np.array(own_ids, np.uint32))
        _make_plausible(generator, frames, objects)
        wild = generator.random(size) < 0.5
        noise = generator.integers(0, 256, (int(wild.sum()), FRAME_SIZE), np.uint8)
        noise[:, 4] %= 16  # as a length code of four bits
        frames[wild] = noise.view(FRAME)[:, 0]
        frames["word"][wild] &= np.uint32(0xFFFFFFFF ^ ERROR_FLAG)  # no error frames: these are the controller's own
        yield frames


def _make_plausible(generator: np.random.Generator, frames: Frames, objects: list[int]) -> None:
    """NMT commands for this node, SDO requests for objects that exist, PDOs of the mapped length."""
    word, length, data = frames["word"], frames["length"], frames["data"]
    chosen = generator.random(len(frames)) < 0.8
    nmt = chosen & (word == 0)
    length[nmt] = 2
    data[nmt, 0] = generator.choice(np.array([1] * 60 + [2, 128, 128, 129, 130], np.uint8), int(nmt.sum()))
    data[nmt, 1] = generator.integers(0, 2, int(nmt.sum()))
    sync = chosen & (word == 0x80)
    length[sync] = 0
    command = chosen & ((word & 0x780) == 0x200)
    length[command] = 4
    data[command, 0] = generator.choice(np.array([0, 2, 6, 7, 15, 15, 15, 128], np.uint8), int(command.sum()))
    request = chosen & ((word & 0x780) == 0x600)
    length[request] = 8
    data[request, 0] = generator.choice(
        np.array([0x40, 0x23, 0x2B, 0x2F, 0x22, 0x60, 0xA4, 0xC2], np.uint8), int(request.sum())
    )
    wanted = generator.choice(np.array(objects, np.uint32), int(request.sum()))
    data[request, 1], data[request, 2], data[request, 3] = wanted >> 8 & 0xFF, wanted >> 16, wanted & 0xFF
    data[request & (generator.random(len(frames)) < 0.1)] = SELECT_CYCLIC_TORQUE


def _sizes(count: int) -> Iterator[int]:
    for done in range(0, count, BATCH):
        yield min(BATCH, count - done)


def raw(frames: Frames) -> list[bytes]:
    """The 16 bytes of each."""
    data = frames.tobytes()
    return [data[k : k + FRAME_SIZE] for k in range(0, len(data), FRAME_SIZE)]
