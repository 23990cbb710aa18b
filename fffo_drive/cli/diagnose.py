"""Find what the model of an axis lacks, name it, add it, and show the error before and after on held-out runs.

RUN is a recording (MCAP) or a table (CSV, CSV.GZ, MAT). Effects are chosen on the runs of --fit alone; those of
--held-out are looked at once, for the proof. Without --model the base model is identified from the same runs. Writes
the page DIR/report.html, DIR/report.json (its schema is stable) and DIR/model.yaml, the base with what was found, which
`fffo-drive adopt` puts in service. On a linear axis (`units: linear` in the facts) the force balance of a rigid axis is
diagnosed, on the first run of --fit.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..diagnosis.results import Diagnosis, ErrorFigures, Finding
from ..documents import DocumentError
from ..identification.dataset import Record, load_records
from ..identification.facts import DriveFacts, read_facts
from ..model.effects.laws.lookup import KindWord
from ..model.parameters import ModelFile, read_model, write_model
from ..report.diagnose import KIND, DiagnosisSource, write_diagnosis_report
from ..report.document import SourceFile, provenance, source_file
from ..report.page import refuse_other_report
from .progress import progress_bar

MODEL_NAME = "model.yaml"
CURVES: dict[KindWord, str] = {
    "torque": "a torque from {} to {} Nm", "friction": "friction from {} to {} Nm", "viscous": "from {} to {} Nm/rps",
    "response": "shares from {} to {} of the motor torque", "drag": "a drag from {} to {} Nm",
    "wound": "springs along the travel that slip and then pull with {} to {} Nm",
}  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("--drive", required=True, metavar="FILE", help="declared facts about the drive (YAML)")
    parser.add_argument("--fit", required=True, nargs="+", metavar="RUN", help="runs on which effects are chosen")
    parser.add_argument("--held-out", nargs="+", default=[], metavar="RUN", help="runs for the proof alone")
    parser.add_argument("--model", metavar="MODEL", help="base model to start from (default: identified from the runs)")
    parser.add_argument("--out", required=True, metavar="DIR", help="directory for report and model")
    parser.add_argument("--name", help="name of the model (default: the directory's)")
    parser.add_argument("--json", action="store_true", help="print report.json in place of the summary")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    facts = read_facts(options.drive)
    out = Path(options.out)
    refuse_other_report(out, KIND)
    shared = {Path(path).resolve() for path in options.fit} & {Path(path).resolve() for path in options.held_out}
    if shared:
        raise DocumentError(f"{sorted(shared)[0]}: a run cannot be fitted and held out")
    model = read_model(options.model) if options.model else None
    records = load_records([*options.fit, *options.held_out], facts)
    fit, held_out = records[: len(options.fit)], records[len(options.fit) :]
    for record in records:
        for warning in record.warnings:
            print(f"warning: {warning}", file=sys.stderr)
    with progress_bar("diagnose", options.json) as bar:
        found = _diagnosed(fit, held_out, facts, model, bar)
    name = options.name or out.resolve().name
    out.mkdir(parents=True, exist_ok=True)
    write_model(out / MODEL_NAME, found.model_after.model_copy(update={"name": name}))
    files = _files([options.drive, *options.fit, *options.held_out, *([options.model] if options.model else [])])
    source = DiagnosisSource(name, provenance(files, {"units": facts.units}), str(out / MODEL_NAME))
    paths = write_diagnosis_report(source, found, out)
    if options.json:
        print(json.dumps(json.loads(paths.json.read_text(encoding="utf-8")), indent=2))
        return 0
    _print(found)
    print(out / MODEL_NAME)
    print(paths.page)
    return 0


def _diagnosed(
    fit: Sequence[Record],
    held_out: Sequence[Record],
    facts: DriveFacts,
    model: ModelFile | None,
    bar: object,
) -> Diagnosis:
    """The diagnosis of this kind of axis."""

    def tell(share: float, text: str) -> None:
        if callable(bar):
            bar(share)

    if facts.units == "rotary":
        from ..diagnosis.diagnose import diagnose  # compiles the library

        return diagnose(fit, held_out, facts, model=model, progress=tell)
    from ..diagnosis.rigid import diagnose_rigid

    if model is not None:
        raise DocumentError("--model: the force balance of a linear axis finds its own base; leave it out")
    found = diagnose_rigid(fit[0], held_out, facts, tell)
    if len(fit) == 1:
        return found
    text = f"Effects were chosen on {fit[0].name} alone: the force balance of a rigid axis takes one run to fit."
    return replace(found, cautions=(*found.cautions, text))


def _files(paths: Sequence[str]) -> list[SourceFile]:
    return [source_file(Path(path).name, Path(path).read_bytes()) for path in paths]


def _print(found: Diagnosis) -> None:
    print(found.headline)
    for finding in found.findings:
        if not finding.accepted:
            continue
        family = f" or {' or '.join(finding.alternatives)}" if finding.alternatives else ""
        numbers = curve_words(finding) or ", ".join(
            f"{n.name} {n.value:.4g} {n.unit}".rstrip(" -") for n in finding.parameters
        )
        share = 100.0 * finding.explained_fraction
        chance = finding.false_alarm_probability
        print(f"  {finding.name}{family}: {share:.0f} % of what was left, p {chance:.2g}; {numbers}")
        if finding.alternatives:
            print(f"    what would decide: {finding.experiment} (fffo-drive run AXIS --decide {finding.name})")
    places = (("held out", found.before, found.after), ("fitted", found.fit_before, found.fit_after))
    for place, before, after in places:
        if before is not None and after is not None:
            print(f"  {place}: {_errors(before, after, found.units == 'linear')}")
    for caution in found.cautions:
        print(f"caution: {caution}", file=sys.stderr)


def curve_words(finding: Finding) -> str:
    """A free curve in words; empty for a law with a name."""
    curve = finding.curve
    if curve is None:
        return ""
    values = np.array(curve.values)
    size = CURVES[curve.kind].format(f"{values.min():.3g}", f"{values.max():.3g}")
    low, high = (f"{place:.4g}" for place in (curve.knots[0], curve.knots[-1]))
    if curve.across is not None:
        reach = f"{curve.levels[0]:.4g} to {curve.levels[-1]:.4g}"
        return f"a table over {low} to {high} and the {curve.across.replace('_', ' ')}, {reach}: {size}"
    if curve.kind == "wound":
        reach_rev = curve.knots[int(np.argmax(np.abs(values)))]
        return f"{size}, after {low} to {high} rev; the strongest after {reach_rev:.3g} rev"
    return f"a curve of {len(curve.knots)} knots over {low} to {high}: {size}"


def _errors(before: ErrorFigures, after: ErrorFigures, linear: bool) -> str:
    torque, speed = ("force", "m/s") if linear else ("torque", "rps")
    first, last = before.torque_relative_percent, after.torque_relative_percent
    text = f"{torque} error {first.value:.2f} to {last.value:.2f} % ({last.low:.2f} to {last.high:.2f})"
    if before.velocity_rms_rps.value == 0.0:  # simulated for the held-out runs alone
        return text
    return f"{text}, velocity {before.velocity_rms_rps.value:.3g} to {after.velocity_rms_rps.value:.3g} {speed}"
