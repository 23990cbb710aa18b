"""A drive beside the population of its model: prior, its own runs and both together, for fits and pages.

The numbers are those of the force balance (`fleet.regress`), which every run of every drive has in common. The
population is fitted in `fleet.prior`; here is what a fit, a diagnosis and a page need of it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..documents import counted
from ..model.parameters import ModelFile, Quantity
from ..units import inertia_kg_m2, text_on, unit_on
from .coordinates import PARAMETERS
from .fit import Fit

SOURCE = "fitted, with the population as prior"
INERTIA = "inertia_nm_s2_per_rev"
FROM_POPULATION = (INERTIA, "viscous_nm_per_rps", "coulomb_nm")  # the same in the balance and in the 2SEP model
MOVED = (*FROM_POPULATION, "static_nm", "stribeck_velocity_rps")  # what goes with them in a fit of little motion
LARGEST_LOG_SD = 2.0  # of a fit's parameter: beyond a factor of seven nothing is known, as in a diagnosis' wide prior
NAMED_SD = 2.0  # of a parameter's deviation, from which on it is named as one that is out
ADVICE = (
    "The prior was not used. Check the drive's type, its load, the torque constant and the units of the run; if they "
    "are right, the drive differs from the others: record the full recipe and run without --prior"
)


class PopulationRow(NamedTuple):
    """One parameter of the force balance; each with its standard deviation."""

    name: str
    label: str  # in words
    unit: str
    prior: float
    prior_sd: float  # between drives
    own: float | None  # by the runs alone; None: they do not determine it
    own_sd: float | None  # with the scatter between runs of one drive
    posterior: float
    posterior_sd: float
    interval_95: tuple[float, float]  # of the posterior
    away_sd: float | None  # of the runs from the population, in standard deviations of both


class AgainstPopulation(NamedTuple):
    """Runs of a drive against the population of its model."""

    model: str
    source: str  # store or file
    drives: int
    temperature_degc: float | None  # that prior and posterior are at; None: not logged, or not in the population
    p: float  # chance that a drive of the population is as far out
    other_population: bool
    rows: tuple[PopulationRow, ...]
    covariance: Floats  # (rows, rows) of a run's parameters, before any run of the drive: between drives and runs
    effective_rows: float  # independent rows of the runs' balances

    def as_plain(self) -> dict[str, Any]:
        """JSON-ready."""
        plain = {k: v for k, v in self._asdict().items() if k not in ("rows", "covariance", "effective_rows")}
        rows = [row._asdict() | {"interval_95": list(row.interval_95)} for row in self.rows]
        return plain | {"parameters": rows, "says": self.sentence()}

    def in_words_of(self, linear: bool) -> AgainstPopulation:
        """With the words and units of a linear axis, where it is one."""
        rows = tuple(
            row._replace(label=text_on(row.label, linear), unit=unit_on(row.unit, linear)) for row in self.rows
        )
        return self._replace(rows=rows)

    def sentence(self) -> str:
        """Whether the drive is one of the population, and if not, which parameters are out, how far, what to do."""
        warm = "" if self.temperature_degc is None else f" at {self.temperature_degc:.0f} degC"
        whose = f"{counted(self.drives, 'drive')} of {self.model}{warm} ({self.source})"
        if not self.other_population:
            return f"prior: {whose}; the runs agree with it (p {self.p:.2g})"
        far = sorted(
            (row for row in self.rows if row.away_sd is not None and abs(row.away_sd) > 0.0),
            key=lambda row: -abs(row.away_sd or 0.0),
        )
        out = [row for row in far if abs(row.away_sd or 0.0) >= NAMED_SD] or far[:1]
        return (
            f"this drive is not one of the population: {whose}, p {self.p:.2g}: {', '.join(map(_out, out))}. {ADVICE}"
        )


def with_population(model: ModelFile, fit: Fit, against: AgainstPopulation) -> ModelFile:
    """A fitted model with what the population adds: inertia, viscous and Coulomb friction, and what goes with them.

    The population is a measurement of these three beside the runs, each with its covariance, in the coordinates of the
    fit: parameters that the runs determine stay as fitted, the others become those of the population.
    Unchanged for a drive of another population.
    """
    rows = [(k, row) for k, row in enumerate(against.rows) if row.name in FROM_POPULATION and row.prior > 0.0]
    names = [name for name in MOVED if fit.uncertainty.sd[PARAMETERS.index(name)] > 0.0]  # others stand at a bound
    rows = [(k, row) for k, row in rows if row.name in names]
    if against.other_population or not rows:
        return model
    places = [PARAMETERS.index(name) for name in names]
    value = np.array([fit.value(name) for name in names])
    sd = np.minimum(fit.uncertainty.sd[places] / value, LARGEST_LOG_SD)
    covariance = fit.uncertainty.correlation[np.ix_(places, places)] * np.outer(sd, sd)
    kept, measured = [k for k, _ in rows], [names.index(row.name) for _, row in rows]
    mean = np.array([row.prior for _, row in rows])
    spread = against.covariance[np.ix_(kept, kept)] / np.outer(mean, mean)
    gain = np.linalg.solve(covariance[np.ix_(measured, measured)] + spread, covariance[measured]).T
    moved = value * np.exp(gain @ np.log(mean / value[measured]))
    moved_sd = moved * np.sqrt(np.maximum(np.diag(covariance - gain @ covariance[measured]), 0.0))
    found = {
        name: Quantity(value=float(moved[k]), sd=float(moved_sd[k]), source=SOURCE) for k, name in enumerate(names)
    }
    friction = model.friction.model_copy(update={name: one for name, one in found.items() if name != INERTIA})
    if friction.static_nm.value < friction.coulomb_nm.value:
        static = friction.static_nm.model_copy(update={"value": friction.coulomb_nm.value})
        friction = friction.model_copy(update={"static_nm": static})
    inertia = found.get(INERTIA)
    if inertia is None:
        return model.model_copy(update={"friction": friction})
    factor = inertia_kg_m2(1.0)
    scaled = Quantity(value=factor * inertia.value, sd=factor * (inertia.sd or 0.0), source=SOURCE)
    return model.model_copy(update={"inertia_kg_m2": scaled, "friction": friction})


def _out(row: PopulationRow) -> str:
    assert row.own is not None
    assert row.away_sd is not None
    away = row.own - row.prior
    size = f"{100.0 * away / abs(row.prior):+.0f} %" if abs(row.prior) > row.prior_sd else f"{away:+.3g} {row.unit}"
    return f"{row.label} {size} ({abs(row.away_sd):.1f} sd)"
