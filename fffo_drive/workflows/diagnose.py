"""Diagnosis of recorded runs: the search, the check against the declared weight of the load, the files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..diagnosis.results import Diagnosis
from ..identification.coverage import Coverage, coverage_of
from ..identification.dataset import Record
from ..identification.declared import weight_remarks
from ..identification.facts import DriveFacts
from ..identification.population import AgainstPopulation
from ..identification.stretches import MOST_DIAGNOSED, load_logs
from ..identification.torque_sensor import sensor_remarks
from ..model.parameters import ModelFile, read_model, write_model
from ..report.coverage import coverage_section
from ..report.diagnose import KIND, DiagnosisSource, write_diagnosis_report
from ..report.document import provenance, source_log
from ..report.page import refuse_other_report
from .progress import Bar, Share, no_bar
from .recorded_facts import facts_for

if TYPE_CHECKING:
    from ..diagnosis.diagnose import DiagnosisSettings

MODEL_NAME = "model.yaml"


class Diagnosed(NamedTuple):
    """A diagnosis and its files."""

    diagnosis: Diagnosis
    page: Path
    report: Path  # JSON, which an adoption reads
    model: Path | None  # None if nothing lowers the error of the held-out runs
    removed: Path | None  # model of an earlier diagnosis, which these runs do not confirm


def diagnose(
    fit: Sequence[Record], held_out: Sequence[Record], facts: DriveFacts, model: ModelFile | None = None,
    settings: DiagnosisSettings | None = None, progress: Share | None = None,
    prior: AgainstPopulation | None = None,
) -> Diagnosis:  # fmt: skip
    """Find effects on the runs `fit`, prove them on `held_out`. `model`: the base (None: identified from the runs).

    `prior`: the runs `fit` against the population of the drive's model.
    """
    from ..diagnosis.diagnose import DiagnosisSettings  # compiles the library
    from ..diagnosis.diagnose import diagnose as search

    found = search(list(fit), list(held_out), facts, model, settings or DiagnosisSettings(), progress, prior)
    accepted = [(f.name, [(n.name, n.value, n.sd) for n in f.parameters]) for f in found.findings if f.accepted]
    remarks = weight_remarks(facts, accepted, coverage_of(list(fit)).travel_rev)
    other = (prior.sentence(),) if prior is not None and prior.other_population else ()
    sensed = sensor_remarks([*fit, *held_out])
    return replace(found, cautions=(*found.cautions, *remarks, *sensed, *other))


def diagnose_recordings(
    fit: Sequence[str | Path], held_out: Sequence[str | Path], out: Path, *, facts_file: Path | None = None,
    model_file: Path | None = None, name: str | None = None, settings: DiagnosisSettings | None = None,
    without: Sequence[str] = (), covered: Callable[[list[Record], Coverage, DriveFacts], None] | None = None,
    bar: Bar = no_bar, prior: Callable[[DriveFacts], AgainstPopulation | None] | None = None,
) -> Diagnosed:  # fmt: skip
    """`diagnose` on files, written to `out` as page, report and model.

    `facts_file`: what is declared about the drive (None: recordings carry it). `without`: what the search leaves out.
    `covered` gets the records and what they cover before the search begins. `prior` compares the runs `fit` with the
    population of their model. Raises DocumentError, DataError.
    """
    from ..diagnosis.diagnose import DiagnosisSettings  # compiles the library

    facts = facts_for(None if facts_file is None else str(facts_file), [*fit, *held_out])
    require_place(out)
    settings = settings or DiagnosisSettings()
    settings = settings._replace(without=settings.without | frozenset(without))
    model = None if model_file is None else read_model(model_file)
    with bar("read") as progress:
        records = load_logs([*fit, *held_out], facts, progress, MOST_DIAGNOSED)
    against = None if prior is None else prior(facts)
    if covered is not None:
        covered(records, coverage_of(records[: len(fit)]), facts)
    with bar("diagnose") as progress:
        found = diagnose(records[: len(fit)], records[len(fit) :], facts, model, settings, progress, against)
    files = [Path(file) for file in (facts_file, model_file, *fit, *held_out) if file is not None]
    return write_diagnosis(found, records[: len(fit)], facts, files, out, name)


def require_place(out: Path) -> None:
    """Refuse to overwrite a model that is not from a diagnosis. Raises DocumentError."""
    refuse_other_report(out, KIND, MODEL_NAME)


def write_diagnosis(
    found: Diagnosis, fit: Sequence[Record], facts: DriveFacts, files: Iterable[Path], out: Path, name: str | None
) -> Diagnosed:  # fmt: skip
    """Page, report and model in `out`; `files`: the inputs. `name`: of the model (None: the directory's)."""
    name = name or out.resolve().name
    out.mkdir(parents=True, exist_ok=True)
    model_path = out / MODEL_NAME
    written, removed = found.model_after is not None, False
    if found.model_after is not None:
        write_model(model_path, found.model_after.model_copy(update={"name": name}))
    elif model_path.exists():
        model_path.unlink()
        removed = True
    sources = provenance([source_log(path) for path in files], {"units": facts.units})
    data = coverage_section(list(fit), coverage_of(list(fit)), facts.units == "linear")
    source = DiagnosisSource(facts.name or name, sources, str(model_path) if written else "", data)
    paths = write_diagnosis_report(source, found, out)
    return Diagnosed(
        found, paths.page, paths.json, model_path if written else None, model_path if removed else None
    )  # fmt: skip
