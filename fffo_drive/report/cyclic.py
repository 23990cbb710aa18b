"""The cyclic error of a position sensor: a table of its orders and the error over a turn."""

from __future__ import annotations

import numpy as np

from ..identification.cyclic import ARCMIN, CyclicError
from ..units import NORMAL_95
from .document import Heading, Row, Section, Table, number
from .figures import Figure, PlotAxis, Series

SHOWN_ORDERS = 12


def cyclic_table(found: CyclicError) -> Table:
    """Significant orders, the largest first."""
    rows = [
        Row(
            label=f"{one.order} a turn",
            cells=[
                number(
                    ARCMIN * one.amplitude_rev, 3,
                    low=ARCMIN * (one.amplitude_rev - NORMAL_95 * one.sd_rev),
                    high=ARCMIN * (one.amplitude_rev + NORMAL_95 * one.sd_rev),
                ),
                number(360.0 * one.phase_rev, 3),
            ],
        )
        for one in found.sure[:SHOWN_ORDERS]
    ]  # fmt: skip
    rows.append(
        Row(label="all together, peak to peak", cells=[number(ARCMIN * found.peak_to_peak_rev, 3), number(np.nan)])
    )
    rows.append(Row(label="remaining, rms", cells=[number(ARCMIN * found.left_rms_rev, 3), number(np.nan)]))
    return Table(
        name="cyclic", title="Position sensor", corner="order", rows=rows,
        note="Position minus that of the reference encoder, by periods per revolution; 95 % intervals. The error "
             "at the angle x is the sum of amplitude times cos(order x - phase). No torque is needed for it.",
        columns=[Heading(label="amplitude", unit="arcmin"), Heading(label="phase", unit="deg")],
    )  # fmt: skip


def cyclic_section(found: CyclicError) -> Section:
    """The error over a turn, measured and by its orders."""
    fine = np.linspace(0.0, 1.0, 721)
    figure = Figure(
        "cyclic", "xy", "Cyclic error over a revolution",
        "Mean in each degree, without lag and offset; the line is the sum of the orders in the table.",
        PlotAxis("angle of the sensor", "deg"), PlotAxis("error", "arcmin"),
        (
            Series("measured", 360.0 * found.angle_rev, ARCMIN * found.mean_rev, "orange", draw="points"),
            Series("by orders", 360.0 * fine, ARCMIN * found.error_rev(fine), "blue"),
        ),
        height_px=220,
    )  # fmt: skip
    return Section("Position sensor", "Against the reference encoder on the same shaft.", (figure,))
