"""Recorded runs to what the model lacks: the diagnosis, and what the declared weight of the load says about it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from ..diagnosis.results import Diagnosis
from ..identification.coverage import coverage_of
from ..identification.dataset import Record
from ..identification.declared import weight_remarks
from ..identification.facts import DriveFacts
from ..model.parameters import ModelFile

if TYPE_CHECKING:
    from ..diagnosis.diagnose import DiagnosisSettings


def diagnose(
    fit: Sequence[Record], held_out: Sequence[Record], facts: DriveFacts, model: ModelFile | None = None,
    settings: DiagnosisSettings | None = None, progress: Callable[[float], None] | None = None,
) -> Diagnosis:  # fmt: skip
    """Find effects on the runs `fit`, prove them on `held_out`. `model`: the base (None: identified from the runs)."""
    from ..diagnosis.diagnose import DiagnosisSettings  # compiles the library
    from ..diagnosis.diagnose import diagnose as search

    def told(share: float, _text: str) -> None:
        if progress is not None:
            progress(share)

    found = search(list(fit), list(held_out), facts, model, settings or DiagnosisSettings(), told)
    accepted = [(f.name, [(n.name, n.value, n.sd) for n in f.parameters]) for f in found.findings if f.accepted]
    remarks = weight_remarks(facts, accepted, coverage_of(list(fit)).travel_rev)
    return replace(found, cautions=(*found.cautions, *remarks))
