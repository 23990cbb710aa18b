"""`--prior` of the commands that fit: the population of the drive's type, from a store or a file."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ..documents import DocumentError
from ..extras import needs_extra
from ..identification.facts import DriveFacts
from ..identification.population import AgainstPopulation


def add_prior_arguments(parser: argparse.ArgumentParser) -> None:
    """--prior and --prior-model."""
    parser.add_argument(
        "--prior", metavar="STORE|FILE",
        help="use other drives of this type as prior: a store of `fffo-drive fleet`, or a population file",
    )  # fmt: skip
    parser.add_argument("--prior-model", metavar="NAME", help="type of drive in STORE (default: as in the runs)")


def prior_of(options: argparse.Namespace, runs: Sequence[str | Path], facts: DriveFacts) -> AgainstPopulation | None:
    """The runs against the population of --prior; None without it. Raises DocumentError, DataError."""
    if options.prior is None:
        if options.prior_model is not None:
            raise DocumentError("--prior-model names a type of drive in a store: give the store with --prior")
        return None
    try:
        from ..fleet.standing import files_against_population
    except ImportError as error:
        raise DocumentError(f"{error}: {needs_extra('--prior', 'fleet')}") from None
    return files_against_population(options.prior, runs, facts, options.prior_model)


def prior_lines(against: AgainstPopulation) -> list[str]:
    """What the prior adds, for the terminal: a sentence, and prior, own runs and posterior of each parameter."""
    lines = [against.sentence()]
    if against.other_population:
        return lines
    for row in against.rows:
        own = "-" if row.own is None else f"{row.own:.4g}"
        low, high = row.interval_95
        lines.append(
            f"  {row.label}: prior {row.prior:.4g} +- {row.prior_sd:.2g}, runs {own}, both {row.posterior:.4g} "
            f"({low:.4g} to {high:.4g}) {row.unit}"
        )
    return lines
