"""Replay of live set points: the reference recomputed from their records, compared with the rows bit for bit.

The rows say which set point was taken in which tick, and which parameters (and with them how far the reference is read
ahead) were in use. Memory is known from the first row of a motion on, or from the record of it with which a file
begins, as long as no row is missing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..control.controller import unpack_controller
from ..control.set_point import (
    HISTORY,
    LiveMotion,
    advance_motion,
    begin_motion,
    no_motion,
    unpack_set_point,
    with_set_point,
)
from ..jit import njit
from ..runtime.records import MemoryBefore

# recomputed fields of the row
LIVE_FIELDS = (
    "set_point_rps", "reference_rps", "reference_rps2", "reference_ahead_rps", "reference_ahead_rps2", "expected_rps",
)  # fmt: skip

_int64: Any = np.int64


class LiveRows(NamedTuple):
    """Rows of motions by live set points."""

    as_asked: int  # their reference is that of the recorded set points, bit for bit
    other: int
    not_followed: int  # the start of the motion, or a row of it, is missing


class LiveMemory(NamedTuple):
    """Memory from row to row."""

    known: bool
    motion: LiveMotion
    row_number: int


@njit
def follow_into(
    set_points: Floats, parameters: Floats, period_s: float, memory: LiveMemory, trajectory: Floats, rows: Any,
    set_points_at: Integers, parameters_at: Integers, out: Floats,
) -> LiveMemory:  # fmt: skip
    """The references of rows (n,) of signals.ROW into `out` (n, len(LIVE_FIELDS)), NaN where they are not known.

    `set_points` (m, SET_POINT_SIZE), `parameters` (p, CONTROLLER_BLOCK_SIZE); `set_points_at`, `parameters_at` (n,):
    which of them each row names, -1: none that is known.
    """
    known, motion, row_number = memory.known, memory.motion, memory.row_number
    for k in range(rows.size):
        row = rows[k]
        sample, tick = _int64(row["set_point_sample"]), _int64(row["tick"])
        number = _int64(row["set_point_number"])
        follows = _int64(row["row_number"]) == (row_number + 1) & 0xFFFFFFFF
        row_number = _int64(row["row_number"])
        if sample < 0:
            known = False
            continue
        if sample == 0:
            known, motion = True, begin_motion(trajectory, number, tick)
        else:
            known = known and follows
        known = known and set_points_at[k] >= 0 and parameters_at[k] >= 0
        if not known:
            continue
        if number != motion.number:
            motion = with_set_point(motion, number, tick)
        set_point = unpack_set_point(set_points[set_points_at[k]])
        config = unpack_controller(parameters[parameters_at[k]]).feedforward
        motion, target_rps, reference = advance_motion(
            config, set_point, motion, trajectory, tick, row["position_rev"], row["velocity_rps"], period_s
        )
        out[k, 0] = target_rps
        out[k, 1] = reference.value
        out[k, 2] = reference.derivative
        out[k, 3] = reference.ahead
        out[k, 4] = reference.ahead_derivative
        out[k, 5] = reference.expected
    return LiveMemory(known, motion, row_number)


class LiveReplay:
    """The rows of one session, file by file."""

    def __init__(self) -> None:
        self._memory = LiveMemory(False, no_motion(0), -1)
        self._trajectory = np.zeros((2, HISTORY))

    def begin_from(self, before: MemoryBefore) -> None:
        """Take a recorded memory."""
        motion = before.packed.memory.motion
        self._memory = LiveMemory(motion.start_tick >= 0, motion, before.row_number - 1)
        self._trajectory[:] = before.packed.trajectory

    def run(
        self, set_points: Floats, parameters: Floats, period_s: float, rows: Any, set_points_at: Integers,
        parameters_at: Integers,
    ) -> Floats:  # fmt: skip
        """The references (n, len(LIVE_FIELDS)) of the next rows."""
        out = np.full((rows.size, len(LIVE_FIELDS)), np.nan)
        if rows.size:
            self._memory = follow_into(
                set_points, parameters, period_s, self._memory, self._trajectory, rows, set_points_at, parameters_at,
                out,
            )  # fmt: skip
        return out
