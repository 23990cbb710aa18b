"""The measured EMPS axis: effects chosen on the fit file alone, error on the held-out file, the hold's part apart."""

from __future__ import annotations

from common import ROOT, Report, finish, main, parser, shown

from fffo_drive.diagnosis.results import Diagnosis, Finding
from fffo_drive.diagnosis.rigid import diagnose_rigid
from fffo_drive.identification.dataset import load_record
from fffo_drive.identification.facts import read_facts

NAME = "emps"
PURPOSE = (
    "EMPS (Janot, Gautier and Brunot, 2019), a measured linear axis at 1 kHz. Effects and their number are chosen on "
    "`DATA_EMPS` alone; `DATA_EMPS_PULSES` is held out. Relative force error by the authors' metric."
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
        found = diagnose_rigid(fit, [held_out], facts, tell)
    report = Report(NAME, PURPOSE)
    _figures(report, found)
    report.table(
        [
            "effect",
            "explains of what was left",
            "p over the library",
            "size / friction",
            "parameters",
            "nearest rival",
            "why",
        ],
        [_row(finding) for finding in found.findings if finding.accepted],
    )
    rejected = [f"`{f.name}`: {f.reason}" for f in found.findings if not f.accepted]
    report.notes += [f"Looked at and not accepted: {text}." for text in rejected]
    report.notes += [f"{caution}." for caution in found.cautions]
    report.notes.append(
        "The hold: a sampled command acts half a sample late on average. It is in the base and is no effect that was "
        "found; the first three lines show what it does alone."
    )
    report.notes.append(
        "The selection was fixed on the fit file before the held-out file was looked at. Columns of effects are made "
        "with the force of the base model and not with the measured one, which has the residual in it."
    )
    return finish(report, options)


def _figures(report: Report, found: Diagnosis) -> None:
    hold = found.settings["hold"]
    for name, published in PUBLISHED.items():
        run_name = FITTED if name.endswith("fit") else HELD_OUT
        report.figure(f"published {name}: {published} %; here", hold["without_hold"][run_name], "%", digits=4)
    report.figure("the same with the hold of the command, held out", hold["with_hold"][HELD_OUT], "%", digits=4)
    assert found.before is not None
    assert found.after is not None
    report.figure("with the effects, fit", found.fit_after.torque_relative_percent.value, "%", digits=4)
    after = found.after.torque_relative_percent
    report.figure(
        f"with the effects, held out (95 %: {after.low:.2f} to {after.high:.2f})", after.value, "%", MOST_PERCENT, 4
    )
    for when, figures in (("base with hold", found.before), ("with the effects", found.after)):
        velocity = figures.velocity_rms_rps
        what = f"velocity over 0.5 s, held out, {when} (95 %: {velocity.low:.4f} to {velocity.high:.4f})"
        report.figure(what, velocity.value, "m/s")
    if found.ceiling.explained_of_explainable is not None:
        what = f"explained of what any model could explain on the fit file ({found.ceiling.note})"
        report.figure(what, 100.0 * found.ceiling.explained_of_explainable, "%")
    report.figure("computing", found.seconds, "s")


def _row(finding: Finding) -> list[str]:
    numbers = ", ".join(
        f"{n.name} {n.value:.4g}{f' ± {1.96 * n.sd:.2g}' if n.sd is not None else ''} {n.unit}".rstrip()
        for n in finding.parameters
    )
    rivals = [rival for rival in finding.rivals if rival.collinearity > 0.5]
    nearest = f"{rivals[0].name}: loss {rivals[0].loss_ratio:.2f} in its place" if rivals else "none alike"
    return [
        f"`{finding.name}`" + "".join(f" or `{name}`" for name in finding.alternatives),
        f"{100 * finding.explained_fraction:.0f} %",
        f"{finding.false_alarm_probability:.3f}",
        f"{finding.strength_percent:.1f} %",
        numbers,
        nearest,
        finding.reason,
    ]


if __name__ == "__main__":
    main(run)
