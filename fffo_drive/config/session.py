"""Everything that a session is made from, of an axis file and its model."""

from __future__ import annotations

from ..model.parameters import ModelFile
from ..runtime.session import SessionConfig
from .axis import AxisFile, controller_config, envelope_config, loop_config, model_note, realtime_request
from .effects import compensation_table

RING_S = 4.0  # what the recorder may lag behind the loop on a bus


def session_config(
    axis: AxisFile, model: ModelFile, longest_profile: int, ring_rows: int | None = None
) -> SessionConfig:
    """Everything that a session is made from. `ring_rows`: None for what a recorder beside the loop needs."""
    return SessionConfig(
        loop_config(axis),
        controller_config(axis, model),
        envelope_config(axis),
        realtime_request(axis),
        axis.realtime.required,
        longest_profile,
        ring_rows or round(RING_S * axis.loop.rate_hz),
        compensation_table(axis, model),
        model_note(model),
    )
