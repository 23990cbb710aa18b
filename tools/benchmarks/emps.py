"""The measured EMPS axis: effects chosen on the fit file alone, error on the held-out file, the part of the hold."""

from __future__ import annotations

from common import ROOT, Report, finish, main, parser, shown
from rigid_regression import RigidSettings, fit_rigid, rigid_error_percent

from fffo_drive.diagnosis.diagnose import diagnose
from fffo_drive.diagnosis.results import Diagnosis, Finding
from fffo_drive.identification.dataset import Record, load_record
from fffo_drive.identification.facts import read_facts
from fffo_drive.units import NORMAL_95

NAME = "emps"
PURPOSE = (
    "EMPS (Janot, Gautier and Brunot, 2019), a measured linear axis at 1 kHz. Effects and their number are chosen on "
    "`DATA_EMPS` alone; `DATA_EMPS_PULSES` is held out. Force errors of the rigid models by the authors' metric; those "
    "of the diagnosis are of the force that the axis needs, on its own rows."
)
FITTED, HELD_OUT = "DATA_EMPS", "DATA_EMPS_PULSES"
MOST_PERCENT = 3.1
PUBLISHED = {"rigid, symmetric, fit": 4.0834, "rigid, symmetric, held out": 5.9824}


def run() -> int:
    """One diagnosis."""
    options = parser(NAME, PURPOSE, 1, 1).parse_args()
    data = ROOT.parent / "shared" / "data" / "emps"
    facts = read_facts(ROOT / "tests" / "identification" / "emps.yaml")
    fit, held_out = (load_record(data / f"{name}.mat", facts) for name in (FITTED, HELD_OUT))
    with shown("EMPS") as progress:
        tell = None if progress is None else lambda share, text: progress(share)
        found = diagnose([fit], [held_out], facts, progress=tell)
    report = Report(NAME, PURPOSE)
    _rigid(report, fit, held_out)
    _figures(report, found)
    report.table(
        [
            "effect",
            "of what all others leave",
            "p over the library",
            "size / friction",
            "parameters",
            "nearest rival",
            "why",
        ],
        [_row(finding) for finding in found.findings if finding.accepted],
    )
    rejected = [f"`{f.name}`: {f.reason}" for f in found.findings if not f.accepted]
    report.notes += [f"Tried and not accepted: {text}." for text in rejected]
    report.notes += [f"{caution}." for caution in found.cautions]
    report.notes.append(
        f"{found.headline} The hold: a sampled command acts half a sample late on average. It is in the base and is no "
        "finding; the first three lines show its influence alone."
    )
    return finish(report, options)


def _rigid(report: Report, fit: Record, held_out: Record) -> None:
    """The published figures again, and what the hold of the command does alone."""
    plain, held = RigidSettings(), RigidSettings(hold=True)
    rigid = fit_rigid(fit, plain)
    errors = (rigid.error_percent, rigid_error_percent(held_out, rigid.parameters, plain))
    for (name, published), error in zip(PUBLISHED.items(), errors, strict=True):
        report.figure(f"published {name}: {published} %; here", error, "%", digits=4)
    error = rigid_error_percent(held_out, fit_rigid(fit, held).parameters, held)
    report.figure("the same with the hold of the command, held out", error, "%", digits=4)


def _figures(report: Report, found: Diagnosis) -> None:
    assert found.before is not None
    assert found.after is not None
    report.figure("with the effects, fit", found.fit_after.torque_relative_percent.value, "%", digits=4)
    after = found.after.torque_relative_percent
    report.figure(
        f"with the effects, held out (95 %: {after.low:.2f} to {after.high:.2f})", after.value, "%", MOST_PERCENT, 4
    )
    for when, figures in (("base with hold", found.before), ("with the effects", found.after)):
        velocity = figures.velocity_rms_rps
        reach = f"{velocity.low:.4f} to {velocity.high:.4f}"
        what = f"velocity over windows of 0.25 and 0.5 s, held out, {when} (95 %: {reach})"
        report.figure(what, velocity.value, "m/s")
    if found.ceiling.explained_of_explainable is not None:
        what = f"explained of what any model could explain on the fit file ({found.ceiling.note})"
        report.figure(what, 100.0 * found.ceiling.explained_of_explainable, "%")
    report.figure("computing", found.seconds, "s")


def _row(finding: Finding) -> list[str]:
    numbers = ", ".join(
        f"{n.name} {n.value:.4g}{f' ± {NORMAL_95 * n.sd:.2g}' if n.sd is not None else ''} {n.unit}".rstrip()
        for n in finding.parameters
    )
    nearest = "none"
    if finding.rivals:
        rival = min(finding.rivals, key=lambda rival: rival.loss_ratio)
        nearest = f"{rival.name}: {100.0 / rival.loss_ratio:.0f} % of its gain in its place"
    return [
        f"`{finding.name}`" + "".join(f" or `{name}`" for name in finding.alternatives),
        f"{100 * finding.explained_fraction:.0f} %",
        f"{finding.false_alarm_probability:.2g}",
        f"{finding.strength_percent:.1f} %",
        numbers,
        nearest,
        finding.reason,
    ]


if __name__ == "__main__":
    main(run)
