"""Runs of a drive against the population of its model: from a store or a population's file to what a fit needs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..documents import DocumentError, counted, did_you_mean, finite, parse, read_text
from ..identification.facts import DriveFacts
from ..identification.population import AgainstPopulation, PopulationRow
from .adding import Given, entry_of
from .history import histories
from .measure import balance_in
from .pieces import LogPieces
from .place import is_url
from .prior import LEAST_DRIVES, Population, Posterior, RunEstimate, population_from_plain, population_of, posterior
from .regress import PARAMETERS, Balance, solve
from .schema import unit_of
from .store import FleetStore
from .words import word_of

FILES = (".json", ".yaml", ".yml")


class Who(NamedTuple):
    """Which drive runs are of; empty where they do not say."""

    drive: str
    model: str


def who_of(path: Path, facts: DriveFacts | None, model: str | None) -> Who:
    """What `fleet add` would say of a run. `model`: given, in place of what it says."""
    try:
        entry = entry_of(str(path), Given(None, model, facts))
    except DocumentError:
        return Who("", model or "")
    return Who(str(entry["drive"]), str(entry["model"]))


def population_at(source: str, who: Who) -> Population:
    """The population of a model in a store, without the drive itself, or that of a file.

    Raises DocumentError where there is no store or file, none of this model, or too few drives.
    """
    if not is_url(source) and source.lower().endswith(FILES):
        try:
            kept = population_from_plain(parse(read_text(Path(source)), source)[0])
        except ValueError as error:
            raise DocumentError(f"--prior {source}: {error}: `Population.as_plain` makes one") from None
        if kept.model and who.model and kept.model != who.model:
            raise DocumentError(
                f"--prior {source}: is of type {kept.model}, the runs are of {who.model}: give the file of their "
                f"type, or --prior-model {kept.model}"
            )
        return kept._replace(model=kept.model or who.model)
    store = FleetStore(source)
    models = sorted(set(store.records(("model",)).column("model").to_pylist()))
    if not models:
        raise DocumentError(f"--prior {source}: no record yet: `fffo-drive fleet work {source}` makes them")
    if not who.model and len(models) > 1:
        raise DocumentError(
            f"--prior {source}: the runs do not say of which type their drive is: give --prior-model: "
            f"{', '.join(models)}"
        )
    model = who.model or models[0]
    if model not in models:
        raise DocumentError(
            f"--prior {source}: no record of type {model!r}: {did_you_mean(model, models)}: give --prior-model "
            "NAME, or add runs of such drives"
        )
    drives = dict(histories(store, model))
    drives.pop(who.drive, None)  # the drive itself is no part of its prior
    found = population_of(drives, model) if len(drives) >= LEAST_DRIVES else None
    least = LEAST_DRIVES if found is None else len(found.names) + 2  # or no drive shows a direction of the covariance
    if found is None or found.drives < least:
        beside = f" beside {who.drive}" if who.drive else ""
        # fewer than three drives show no parameters: at most all there are
        needed = f"at most {len(PARAMETERS) + 2}" if found is None else f"here {least}, so {least - found.drives} more"
        raise DocumentError(
            f"--prior {source}: {counted(len(drives), 'drive')} of type {model}{beside}: a prior needs two "
            f"more drives than parameters ({needed}): add runs of more drives with `fffo-drive fleet add`, or run "
            "without --prior"
        )
    return found


def against_population(
    population: Population, source: str, balances: Sequence[Balance], temperatures_degc: Sequence[float | None],
    facts: DriveFacts,
) -> AgainstPopulation:  # fmt: skip
    """Balances of runs of one drive against a population; the temperature of each, None where it was not logged."""
    pairs = zip(balances, temperatures_degc, strict=True)
    runs = [_estimate(balance, degc) for balance, degc in pairs]
    found = posterior(population, runs)
    ends = found.interval()
    sd = np.sqrt(np.diag(found.covariance))
    rows = tuple(_row(found, k, float(sd[k]), ends[k]) for k in range(sd.size))
    degc = [one for one in temperatures_degc if one is not None]
    logged = population.warming is not None and len(degc) == len(balances)
    at_degc = float(np.mean(degc)) if logged else None
    covariance = population.at(at_degc)[1] + population.scatter
    effective = float(sum(balance.effective_rows for balance in balances))
    against = AgainstPopulation(
        population.model, source, population.drives, at_degc, found.p, found.other_population, rows, covariance,
        effective,
    )  # fmt: skip
    return against.in_words_of(facts.units == "linear")


def _row(found: Posterior, k: int, sd: float, ends: Floats) -> PopulationRow:
    name = found.names[k]
    return PopulationRow(
        name, word_of(name), unit_of(name), float(found.prior[k]), float(found.prior_sd[k]), finite(found.own[k]),
        finite(found.own_sd[k]), float(found.theta[k]), sd, (float(ends[0]), float(ends[1])), finite(found.away_sd[k]),
    )  # fmt: skip


def _estimate(balance: Balance, degc: float | None) -> RunEstimate:
    solved = solve(balance)
    return RunEstimate(PARAMETERS, solved.theta, solved.information, degc)


def files_against_population(
    source: str, paths: Sequence[str | Path], facts: DriveFacts, model: str | None = None
) -> AgainstPopulation:
    """Runs (files of one drive) against the population at `source`. `model`: in place of what the runs say.

    Raises DocumentError (see `population_at`) and DataError.
    """
    population = population_at(source, who_of(Path(paths[0]), facts, model))
    balances, degc = [], []
    for path in map(Path, paths):
        pieces = LogPieces(path, facts, "")  # however long the log is
        balances.append(balance_in(pieces, facts, path).balance)
        degc.append(pieces.temperature().get("temperature_degc"))
    return against_population(population, source, balances, degc, facts)
