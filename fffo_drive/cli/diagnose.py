"""Find what the model of an axis lacks, name it, add it, and show the error before and after on held-out runs.

RUN is a recording (MCAP), or a log of another program without a doubt, as `identify` takes it. Effects are chosen on
the --fit runs only; the --held-out runs are used once, to test the result. Without --model the base model is
identified from the --fit runs; with --prior, other drives of the same model supply what these determine poorly. Writes
the page DIR/report.html, DIR/report.json (its schema is stable) and DIR/model.yaml, the base model with the effects
found, which `fffo-drive adopt` puts in service.

If the effects found do not lower the error of the held-out runs, no model is written and a DIR/model.yaml of an earlier
diagnosis is removed.

--without excludes parts of the search: laws (cogging), curves over a variable (unknown:velocity), kinds of curves
(friction(time)) and tables over two variables ('motor_angle x speed').

Exit codes: 0 done, also if no effect was found; 65 the held-out runs confirm none of the effects, no model is written;
74 disk error; 78 bad input.
"""

from __future__ import annotations

import argparse
import difflib
import json
import sys
from functools import partial
from pathlib import Path

import numpy as np

from ..diagnosis.results import Diagnosis, ErrorFigures, Finding
from ..documents import DocumentError
from ..identification.coverage import Coverage, coverage_lines
from ..identification.dataset import Record
from ..identification.facts import DriveFacts
from ..identification.population import AgainstPopulation
from ..model.effects.laws.lookup import KindWord
from ..report.cause_words import in_words
from ..report.diagnose_figures import ROTARY, DiagnosisWords, words_of
from ..report.diagnose_verdict import doubts, unproven
from ..workflows.diagnose import MODEL_NAME, diagnose_recordings
from .exits import EXIT_NOT_CONFIRMED, printable
from .prior import add_prior_arguments, prior_lines, prior_of
from .progress import progress_bar

CURVES: dict[KindWord, tuple[str, str]] = {  # in words, and the unit of its values
    "torque": ("a {0} from {1} to {2}", "Nm"), "friction": ("friction from {1} to {2}", "Nm"),
    "viscous": ("from {1} to {2}", "Nm/rps"), "response": ("shares from {1} to {2} of the motor {0}", ""),
    "drag": ("a drag from {1} to {2}", "Nm"),
    "wound": ("springs along the travel that slip and then pull with {1} to {2}", "Nm"),
}  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument(
        "--drive", metavar="FILE", help="declared facts about the drive (YAML); recordings contain them"
    )
    parser.add_argument("--fit", required=True, nargs="+", metavar="RUN", help="runs to choose and to fit effects on")
    parser.add_argument("--held-out", nargs="+", default=[], metavar="RUN", help="runs to test the result on")
    parser.add_argument("--model", metavar="MODEL", help="base model to start from (default: identified from the runs)")
    parser.add_argument("--out", required=True, metavar="DIR", help="directory for report and model")
    parser.add_argument(
        "--alpha", type=float, metavar="P",
        help="largest accepted p-value of a finding (default: 0.01)",
    )  # fmt: skip
    parser.add_argument("--without", nargs="+", default=[], metavar="NAME", help="names to exclude from the search")
    parser.add_argument("--name", help="name of the model (default: the directory's)")
    parser.add_argument("--json", action="store_true", help="print report.json instead of the summary")
    add_prior_arguments(parser)


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    from ..diagnosis.diagnose import DiagnosisSettings  # compiles the library

    out = Path(options.out)
    _require(options, out)
    settings = DiagnosisSettings()
    if options.alpha is not None:
        settings = settings._replace(false_alarm_rate=options.alpha)

    def covered(records: list[Record], coverage: Coverage, facts: DriveFacts) -> None:
        for record in records:
            for warning in record.warnings:
                print(f"warning: {printable(warning)}", file=sys.stderr)
        if not options.json:
            print("\n".join(coverage_lines(coverage, facts.units == "linear")), flush=True)

    def prior(facts: DriveFacts) -> AgainstPopulation | None:
        against = prior_of(options, options.fit, facts)
        if against is not None and not (options.json or against.other_population):  # that is a caution
            print("\n".join(prior_lines(against)), flush=True)
        return against

    done = diagnose_recordings(
        options.fit, options.held_out, out, facts_file=Path(options.drive) if options.drive else None,
        model_file=Path(options.model) if options.model else None, name=options.name, settings=settings,
        without=options.without, covered=covered, bar=partial(progress_bar, quiet=options.json), prior=prior,
    )  # fmt: skip
    if done.removed is not None:
        print(f"{done.removed}: from an earlier diagnosis, removed: these runs give no model", file=sys.stderr)
    if options.json:
        print(json.dumps(json.loads(done.report.read_text(encoding="utf-8")), indent=2))
    else:
        _print(done.diagnosis)
        if done.model is not None:
            print(done.model)
        print(done.page)
    return EXIT_NOT_CONFIRMED if done.diagnosis.verdict == "nothing_carries_over" else 0


def _require(options: argparse.Namespace, out: Path) -> None:
    """Refuse what cannot be meant, before anything is computed."""
    model_path = out / MODEL_NAME
    if options.model and Path(options.model).resolve() == model_path.resolve():
        raise DocumentError(f"--model: {model_path} is where the result is written: give another --out")
    shared = {Path(path).resolve() for path in options.fit} & {Path(path).resolve() for path in options.held_out}
    if shared:
        raise DocumentError(f"{sorted(shared)[0]}: the same run cannot be both fitted and held out")
    if options.model and options.prior:
        raise DocumentError("--prior: the base model begins from --model: give one of them")
    if options.alpha is not None and not 0.0 < options.alpha < 1.0:
        raise DocumentError(f"--alpha: {options.alpha:g} is not a probability: give a number above 0 and below 1")
    known = searched_names()
    for name in options.without:
        if name not in known:
            close = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known)}"
            raise DocumentError(f"--without: the search has nothing called {name!r}; {hint}")


def searched_names() -> list[str]:
    """Everything that a search can leave out: laws, curves over an axis, kinds of curves, tables over two axes."""
    from ..diagnosis.curves import Curve, axes_of, kind_of_curve, pairs_of
    from ..model.effects.laws.lookup import UNKNOWN, WOUND
    from ..model.effects.registry import LAWS

    laws = [name for name, law in LAWS.items() if law.name != "lookup" and not law.in_base]
    nothing = np.zeros((0, 0))
    turns = float("inf")  # a motion over so many has every axis
    shapes = [(axis.word, {"kind": axis.kind, "scale": axis.scale, "of_current": axis.of_current})
              for axis in axes_of(turns)]  # fmt: skip
    shapes.append(("memory", {"kind": WOUND}))
    curves = [Curve(UNKNOWN + word, shape, nothing) for word, shape in shapes]
    tables = [Curve(UNKNOWN + pair.along.word, pair.shapes, nothing, pair=pair) for pair in pairs_of(turns)]
    both = [*curves, *tables]
    return list(dict.fromkeys([*laws, *(curve.name for curve in both), *(kind_of_curve(curve) for curve in both)]))


def _print(found: Diagnosis) -> None:
    words = words_of(found)
    print(found.headline)
    places = (("held-out runs", found.before, found.after), ("fitted runs", found.fit_before, found.fit_after))
    for place, before, after in places:
        if before is not None and after is not None:
            print(f"  {place}: {_errors(before, after, words)}")
    for finding in found.findings:
        if not finding.accepted:
            continue
        family = f" or {' or '.join(finding.alternatives)}" if finding.alternatives else ""
        numbers = curve_words(finding, words) or ", ".join(
            f"{words.name(n.name, n.unit)} {n.value:.4g} {words.unit(n.unit)}".rstrip(" -")
            + (f" ({n.per_run})" if n.per_run else "")
            for n in finding.parameters
        )
        share = 100.0 * finding.explained_fraction
        chance = finding.false_alarm_probability
        print(f"  {finding.name}{family}: {in_words(finding, found.model_after or found.model_before, words)}")
        print(f"    {share:.0f} % of the squared residual that the other effects leave, p {chance:.2g}; {numbers}")
        if unproven(finding):
            print("    it does not lower the error on the held-out runs")
        if finding.doubt:
            print(f"    in doubt: {words.text(finding.doubt)}")
        if finding.alternatives:
            print(f"    what would decide: {finding.experiment} (fffo-drive run AXIS --decide {finding.name})")
    remarks = [remark.text for remark in found.runs_look.remarks] if found.runs_look is not None else []
    for remark in remarks:
        print(f"  runs: {remark}")
    for caution in [*doubts(found), *found.cautions]:
        if caution not in remarks:
            print(f"caution: {printable(caution)}", file=sys.stderr)


def curve_words(finding: Finding, words: DiagnosisWords = ROTARY) -> str:
    """A free curve in words; empty for a law with a name."""
    curve = finding.curve
    if curve is None:
        return ""
    values = np.array(curve.values)
    text, unit = CURVES[curve.kind]
    size = f"{text.format(words.torque, f'{values.min():.3g}', f'{values.max():.3g}')} {words.unit(unit)}".rstrip()
    low, high = (f"{place:.4g}" for place in (curve.knots[0], curve.knots[-1]))
    if curve.across is not None:
        reach = f"{curve.levels[0]:.4g} to {curve.levels[-1]:.4g}"
        return f"a table over {low} to {high} and the {words.axis(curve.across)}, {reach}: {size}"
    if curve.kind == "wound":
        reach_rev = curve.knots[int(np.argmax(np.abs(values)))]
        length = words.unit("rev")
        return f"{size}, after {low} to {high} {length}; strongest after {reach_rev:.3g} {length}"
    return f"a curve of {len(curve.knots)} knots over {low} to {high}: {size}"


def _errors(before: ErrorFigures, after: ErrorFigures, words: DiagnosisWords) -> str:
    torque, speed = words.torque, words.unit("rps")
    first, last = before.torque_relative_percent, after.torque_relative_percent
    text = (
        f"{torque} error {first.value:.2f} % before, {last.value:.2f} % after (95 % interval {last.low:.2f} to "
        f"{last.high:.2f} %) of the {torque} that the axis needs"
    )
    if before.velocity_rms_rps.value == 0.0:  # no run is long enough for a free window
        return text
    return f"{text}; velocity error {before.velocity_rms_rps.value:.3g}, {after.velocity_rms_rps.value:.3g} {speed}"
