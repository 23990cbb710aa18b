"""A figure of how an import read each column: every signal with the derivative or signal that it should match."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..arrays import Floats
from ..importing.candidates import (
    COMMAND_A,
    CURRENT_A,
    ENCODER_REV,
    POSITION_REV,
    REFERENCE_RPS,
    TIME_S,
    VELOCITY_RPS,
    Guess,
)
from ..importing.evidence import smooth_derivative
from ..units import name_on, text_on, unit_in, unit_on
from .figures import TIME, Figure, PlotAxis, Series

CUTOUT_S = 3.0  # of the log, around its fastest motion
MOST_POINTS = 4000


def column_figures(
    guesses: Sequence[Guess], columns: Mapping[str, Floats], torque_unit: str, linear: bool
) -> list[list[Figure]]:
    """Rows of figures for one sheet, one per signal except time, with the reason for the guess in the caption."""
    turn, speed = (unit_on(unit, linear) for unit in ("rev", "rps"))
    units = {POSITION_REV: turn, ENCODER_REV: turn, VELOCITY_RPS: speed, REFERENCE_RPS: speed,
             COMMAND_A: torque_unit or "-", CURRENT_A: torque_unit or "-"}  # fmt: skip
    part = _cutout(columns)
    time_s = columns[TIME_S][part] - columns[TIME_S][0]
    rows = []
    for guess in guesses:
        values = columns.get(guess.signal)
        if values is None or guess.signal not in units:
            continue
        series = [Series(guess.signal, time_s, values[part], "orange", weight=2.4)]
        partner = _partner(guess.signal, columns)
        if partner is not None:
            partner_name, other = partner
            series.append(Series(partner_name, time_s, other[part], "blue", dash="dashed", weight=1.3))
        grounds = f"{'' if guess.sure else '? '}{text_on(guess.evidence, linear)}"
        name = name_on(guess.signal, unit_in(guess.signal), linear)
        heading = f"{name} is {guess.column!r} [{guess.unit}]"
        rows.append([
            Figure(
                guess.signal, "xy", heading, f"{grounds}.",
                TIME, PlotAxis(name, units[guess.signal]), tuple(series), height_px=190,
            )
        ])  # fmt: skip
    return rows


def _cutout(columns: Mapping[str, Floats]) -> slice:
    """CUTOUT_S around the fastest motion, thinned to MOST_POINTS."""
    time_s = columns[TIME_S]
    motion = columns.get(VELOCITY_RPS)
    if motion is None:
        motion = np.gradient(columns[POSITION_REV], time_s)
    middle_s = float(time_s[int(np.nanargmax(np.abs(motion)))])
    begin, end = np.searchsorted(time_s, [middle_s - 0.5 * CUTOUT_S, middle_s + 0.5 * CUTOUT_S])
    return slice(int(begin), int(end), max(1, int(end - begin) // MOST_POINTS))


def _partner(signal: str, columns: Mapping[str, Floats]) -> tuple[str, Floats] | None:
    """What a signal should look like, computed from another one."""
    position = columns.get(POSITION_REV)
    if position is None:
        return None
    if signal in (VELOCITY_RPS, REFERENCE_RPS):
        return "derivative of the position, smoothed", smooth_derivative(position, columns[TIME_S])[0]
    if signal == ENCODER_REV:
        return "position", position - position.mean() + columns[ENCODER_REV].mean()
    return None
