"""The table of a drive beside the population of its model: prior, its own runs, and both together."""

from __future__ import annotations

import math

from ..identification.population import AgainstPopulation
from ..units import NORMAL_95
from .document import Cell, Heading, Row, Table, number

DASH = Cell(text="–")


def population_table(against: AgainstPopulation) -> Table:
    """Prior, own data and posterior side by side."""
    rows = []
    for row in against.rows:
        reach, own = NORMAL_95 * row.prior_sd, DASH
        if row.own is not None and row.own_sd is not None:
            ends = (row.own - NORMAL_95 * row.own_sd, row.own + NORMAL_95 * row.own_sd)
            own = number(row.own, 4, *ends)
        rows.append(Row(
            label=row.label, unit=row.unit,
            cells=[
                number(row.prior, 4, row.prior - reach, row.prior + reach), own,
                number(row.posterior, 4, *row.interval_95), number(math.nan if row.away_sd is None else row.away_sd, 2),
            ],
        ))  # fmt: skip
    said = against.sentence()
    return Table(
        name="population", title=f"Beside drives of {against.model}", corner="parameter", rows=rows,
        columns=[
            Heading(label="prior: the population"), Heading(label="these runs alone"), Heading(label="both together"),
            Heading(label="runs from population", unit="sd"),
        ],
        note=f"{said[0].upper()}{said[1:]}. Parameters of the force balance, with 95 % intervals; those of the runs "
        "include the scatter between runs of one drive.",
    )  # fmt: skip
