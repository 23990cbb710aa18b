"""Recorded feedback through the law again: the same law gives the same commands, bit for bit; another one is compared.

A row holds everything that the law read (references, velocity, toggle, what was limited), so that a record is
the proof of what was computed. A changed law is run on the same data open loop: what it would have asked for there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..control.compensation import compensation_rest, compensation_step, new_memory, no_compensation
from ..control.controller import ControllerConfig, controller_at_rest, controller_step, with_limited
from ..control.envelope import (
    LIMIT_CONTROLLER,
    TRIP_NONE,
    EnvelopeConfig,
    EnvelopeInputs,
    envelope_at_rest,
    envelope_step,
)
from ..control.feedforward import Reference
from ..control.reference import MODE_CURRENT, MODE_VELOCITY
from ..drive.cia402 import is_operation_enabled
from ..jit import njit

Rows = np.ndarray[Any, np.dtype[np.void]]
Floats = np.ndarray[Any, np.dtype[np.float64]]

# columns of the replayed record, by the names of the row
REPLAYED = (
    "error_rps", "filtered_error_rps", "proportional_a", "integral_a", "friction_nm", "inertia_nm", "effects_nm",
    "requested_a", "limited_a",
)  # fmt: skip
REQUESTED = REPLAYED.index("requested_a")


class ReplayReport(NamedTuple):
    """How a replay compares with its record."""

    rows: int  # in which the law acted
    identical: int  # of these, every term and the command the same to the last bit
    first_difference_tick: int  # -1: none
    rms_difference_a: float  # of requested_a
    largest_difference_a: float
    replayed: Floats  # (n, len(REPLAYED)), NaN where the law did not act

    @property
    def exact(self) -> bool:
        """True when the record is reproduced."""
        return self.rows > 0 and self.identical == self.rows


_int64: Any = np.int64  # rows hold narrower integers; the law has been compiled for these


@njit
def replay_into(
    config: ControllerConfig, limits_config: EnvelopeConfig, effects: Floats, memory: Floats, rows: Any, output: Any
) -> None:
    """Run the law and the envelope over rows (n,) of signals.ROW; output (n, len(REPLAYED)).

    `effects`: the table of compensated effects, `memory` theirs at rest.
    """
    state = controller_at_rest()
    envelope = envelope_at_rest()
    for k in range(rows.size):
        row = rows[k]
        requested_a = 0.0
        closed_loop = row["mode"] == MODE_VELOCITY
        if closed_loop:
            reference = Reference(
                row["reference_rps"],
                row["reference_rps2"],
                row["reference_ahead_rps"],
                row["reference_ahead_rps2"],
                row["expected_rps"],
            )
            effects_nm = compensation_step(effects, memory, _int64(row["effects"]), reference, row["position_rev"])
            terms, state = controller_step(
                config, state, _int64(row["toggle"]), reference, row["velocity_rps"], effects_nm
            )
            output[k, 0] = terms.error_rps
            output[k, 1] = terms.filtered_error_rps
            output[k, 2] = terms.proportional_a
            output[k, 3] = terms.integral_a
            output[k, 4] = terms.friction_nm
            output[k, 5] = terms.inertia_nm
            output[k, 6] = terms.effects_nm
            output[k, 7] = terms.requested_a
            requested_a = terms.command_a
        else:
            state = controller_at_rest()
            compensation_rest(memory)
            if row["mode"] == MODE_CURRENT:
                requested_a = row["requested_a"]
        wanted = row["mode"] != 0
        seen = EnvelopeInputs(
            requested_a,
            row["velocity_rps"],
            row["position_rev"],
            row["expected_rps"] - row["velocity_rps"],
            _int64(row["velocity_age"]),
            _int64(row["status_age"]),
            _int64(row["statusword"]),
            0,
            0,
            False,
            False,
            0,
            -1,
            wanted,
            is_operation_enabled(row["statusword"]),
            closed_loop,
            _int64(row["tick"]) - _int64(rows[k - 1]["tick"]) - 1 if k > 0 else 0,
        )
        limited_a, _, _, envelope = envelope_step(limits_config, envelope, seen)
        if row["limits"] & ~LIMIT_CONTROLLER:
            state = with_limited(state, True)
        if closed_loop:
            output[k, 8] = limited_a if row["trip"] == TRIP_NONE else 0.0


def replay(
    rows: Rows, config: ControllerConfig, envelope: EnvelopeConfig, effects: Floats | None = None
) -> ReplayReport:
    """Replay rows from the start of a loop (or from where the drive was last disabled), with a table of effects."""
    output = np.full((rows.size, len(REPLAYED)), np.nan)
    replay_into(config, envelope, no_compensation() if effects is None else effects, new_memory(), rows, output)
    acted = rows["mode"] == MODE_VELOCITY
    recorded = np.stack([rows[name] for name in REPLAYED], axis=1)
    # bit for bit: compared as integers, so that not even the sign of a zero may differ
    same = (recorded.view(np.int64) == output.view(np.int64)).all(axis=1)
    different = np.flatnonzero(acted & ~same)
    difference_a = (output[:, REQUESTED] - recorded[:, REQUESTED])[acted]
    return ReplayReport(
        int(acted.sum()),
        int((acted & same).sum()),
        int(rows["tick"][different[0]]) if different.size else -1,
        float(np.sqrt(np.mean(difference_a**2))) if difference_a.size else 0.0,
        float(np.abs(difference_a).max()) if difference_a.size else 0.0,
        output,
    )
