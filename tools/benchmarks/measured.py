"""Measured machines: published findings, a textbook fit, and `diagnose` as typed, with each run held out in turn.

A cause counts as named by the page where its opening says it in words (`CAUSES`): what the owner reads first.
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from common import ROOT, Report, finish, main, parser, shown
from engine import Call, accepted_of, claimed, first_names, in_parallel, residual_is_reported, typed, write_answer
from measured_sets import write_all
from rows import CUTOFF_HZ, Textbook, needed_nm, rms, rows_of

from fffo_drive.identification.dataset import load_records
from fffo_drive.identification.facts import read_facts

NAME = "measured"
PURPOSE = (
    "Measured machines as their authors published them: EMPS (Janot, Gautier and Brunot, 2019), LAAS "
    "(heitor-andrade/laas_anti_cogging, BSD-3-Clause), BAM (Rhoban/bam, Apache-2.0), Lorenz "
    "(TeacherRock/Lorenz_Friction), TX40 (thanhndv212/figaroh-examples). Effects are chosen on the fit runs alone. The "
    "textbook fit is least squares with inertia, viscous and Coulomb friction and a constant, on BAM also sin and cos "
    "of the angle."
)
EMPS_PERCENT = 3.0  # of the command, held out
LAAS_SHARE = 0.5  # of the textbook's error
LAAS_S = 5.0
MOST_MB = 1000.0
TRUTH = {
    "emps": "asymmetric viscous friction, 1/rev ripple with a datum a file, 0.5 ms lag, low-speed shape",
    "laas": "cogging of order 72, beside it 18, 12, 144; stiction",
    "bam": "gravity, then friction that grows with load",
    "lorenz": "constant torque, Coulomb friction that rises over the runs, orders 1, 5, 10",
    "lorenz mixed": "runs that contradict each other: two logs lack a feed-forward torque",
    "tx40 joint 1": "a smooth rest, by the other joints",
    "tx40 joint 6": "waves of order 1 and 3",
}
CAUSES = {  # what the opening of the page has to say
    "emps": "viscous friction is .* higher (forwards|backwards)",
    "laas": r"\b72 periods per motor turn",
    "bam": "weight of the load needs",
    "lorenz": "constant torque of",
    "lorenz mixed": "contradict each other",
    "tx40 joint 1": "smooth and unexplained|Unexplained",
    "tx40 joint 6": r"\b[13] periods per motor turn",
}
OWN_BAND_HZ = {"emps": 45.0, "laas": 150.0, "bam": 15.0}  # in which the textbook's figures are known
FIRST = {  # what must lead, with its order
    "emps": ("asymmetric_viscous", None),
    "laas": ("cogging", 72.0),
    "bam": ("unbalance", None),
    "lorenz": ("torque_offset", None),
}
TRAJECTORIES = ("sin_sin", "lift_and_drop", "up_and_down", "sin_time_square")
LAAS_FILES = ("speed_test", "speed_test1", "speed_test_old")


class Case(NamedTuple):
    """One machine, with the logs that are fitted and those that are held out."""

    machine: str
    fit: tuple[str, ...]
    held_out: tuple[str, ...]
    name: str  # as it stands in the table
    inside: str  # key of TRUTH and CAUSES


def cases() -> list[Case]:
    """All machines and splits."""
    emps = ("DATA_EMPS", "DATA_EMPS_PULSES")
    splits = [("emps", (a,), (b,)) for a, b in (emps, emps[::-1])]
    splits += [("laas", tuple(n for n in LAAS_FILES if n != held), (held,)) for held in LAAS_FILES]
    for name in LAAS_FILES:
        splits += [("laas", (f"{name}_{a}",), (f"{name}_{b}",)) for a, b in ("ab", "ba")]
    splits += [("tx40", (f"joint6_{a}",), (f"joint6_{b}",)) for a, b in ("ab", "ba")]
    splits += [("tx40", (f"joint1_{a}",), (f"joint1_{b}",)) for a, b in ("ab", "ba")]
    splits += [("lorenz", ("Jm_1", "Jm_3", "Jm_4"), ("Jm_7",)), ("lorenz", ("Jm_4", "Jm_7", "Jm_10"), ("Jm_1",))]
    splits += [("lorenz", ("Jm_1", "Bm_1", "Fc_1"), ("Bm_5",))]
    found = [
        Case(machine, fit, held, f"{machine}: {', '.join(fit)} -> {held[0]}", inside_of(machine, fit))
        for machine, fit, held in splits
    ]
    gains = (("kp100", "kp400"), ("kp200", "kp800"))
    for fit, held in (gains, gains[::-1]):
        logs = [tuple(f"{g}_{t}" for g in part for t in TRAJECTORIES) for part in (fit, held)]
        found.append(Case("bam", logs[0], logs[1], f"bam: {', '.join(fit)} -> {', '.join(held)}", "bam"))
    return found


def inside_of(machine: str, fit: tuple[str, ...]) -> str:
    """What these runs have inside."""
    if machine == "tx40":
        return f"tx40 joint {fit[0][len('joint')]}"
    return "lorenz mixed" if machine == "lorenz" and "Bm_1" in fit else machine


def records_of(case: Case, sets: Path) -> tuple[Any, Any]:
    folder = sets / case.machine
    facts = read_facts(folder / "drive.yaml")
    fit, held_out = (
        load_records([folder / f"{name}.csv" for name in names], facts) for names in (case.fit, case.held_out)
    )
    return fit, held_out


def judge(case: Case, sets: Path, answer: Path) -> None:
    """Textbook and diagnosis of one case, to a file. An answer that exists is kept."""
    if answer.exists():
        return
    said: dict[str, Any] = {}
    logs = [[f"{name}.csv" for name in names] for names in (case.fit, case.held_out)]
    with tempfile.TemporaryDirectory() as out:
        try:
            said["report"] = typed(sets / case.machine, *logs, Path(out))
        except ValueError as error:  # a refusal is a result of the bench
            said["failure"] = str(error)
    fit, held_out = records_of(case, sets)
    cutoff_hz = said.get("report", {}).get("settings", {}).get("cutoff_hz", CUTOFF_HZ)
    said["same_band"] = textbook(case, fit, held_out, cutoff_hz)
    said["own_band"] = textbook(case, fit, held_out, OWN_BAND_HZ.get(case.machine, cutoff_hz))
    write_answer(answer, said)


def textbook(case: Case, fit: Any, held_out: Any, cutoff_hz: float) -> dict[str, float]:
    """Held-out error of least squares in Nm, with what it is held against: command and needed torque, rms in Nm."""
    rows, held = rows_of(fit, cutoff_hz), rows_of(held_out, cutoff_hz)
    with_angle = case.machine == "bam"
    return {
        "left_nm": rms(Textbook.fit(rows, with_angle).left(held)),
        "command_nm": rms(held.torque_nm),
        "needed_nm": rms(needed_nm(rows, held, with_angle)),
        "cutoff_hz": cutoff_hz,
    }


def run() -> int:
    """All cases, each in a process of its own."""
    options = _options()
    wanted = [case for case in cases() if not options.only or case.machine in options.only]
    if options.sample:
        wanted = wanted[:1]
    with tempfile.TemporaryDirectory() as folder, shown("measured machines") as progress:
        sets, answers = Path(folder) / "sets", options.answers or Path(folder) / "answers"
        write_all(options.data, sets, sorted({case.machine for case in wanted}))
        calls: list[Call] = [(judge, (case, sets, answers / f"{k:02d}.json")) for k, case in enumerate(wanted)]
        in_parallel(calls, 1, progress, fresh=True)  # one at a time: the time of each counts
        found = [json.loads((answers / f"{k:02d}.json").read_text()) for k in range(len(wanted))]
    report = Report(NAME, PURPOSE)
    rows = [_row(report, case, said) for case, said in zip(wanted, found, strict=True)]
    header = [
        "machine: fitted -> held out", "inside", "said", "textbook in its own band", "textbook", "base", "ours",
        "does the page lead to the cause", "residual reported",
        "diagnosis; fresh process: wall, CPU, memory",
    ]  # fmt: skip
    report.table(header, rows)
    report.notes += [
        "Errors: rms of the held-out torque residual, relative to the rms of the command / of the torque that the axis "
        "needs by the textbook (inertia and friction: one reference for all), in the band of the diagnosis "
        f"(its `cutoff_hz`, else {CUTOFF_HZ:g} Hz). Own bands of the textbook: "
        + ", ".join(f"{machine} {hz:g} Hz" for machine, hz in OWN_BAND_HZ.items())
        + ". The diagnosis' own figures are "
        "over its own rows, which omit the parts of a log that give no rows.",
        "On BAM the command is a voltage (load times supply).",
        "tro2021 is omitted: three logs with velocity and torque only, 500 samples at 16 to 78 Hz, one speed each.",
    ]
    return finish(report, options)


def _options() -> argparse.Namespace:
    made = parser(NAME, PURPOSE, 1, 1)
    made.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data", help="holds measured/ and emps/")
    made.add_argument("--only", nargs="+", choices=sorted({case.machine for case in cases()}), help="these machines")
    made.add_argument("--answers", type=Path, help="a folder that keeps the answers, for interrupted runs")
    return made.parse_args()


def _row(report: Report, case: Case, said: dict[str, Any]) -> list[str]:
    book, own = said["same_band"], said["own_band"]

    def percent(error_nm: float, scale: dict[str, float] = book) -> str:
        return f"{100 * error_nm / scale['command_nm']:.1f} / {100 * error_nm / scale['needed_nm']:.1f} %"

    start = [case.name, TRUTH[case.inside]]
    books = [percent(own["left_nm"], own), percent(book["left_nm"])]
    if "report" not in said:
        report.bounded(case.name, said["failure"], False, "an answer")
        return [*start, said["failure"], *books, "-", "-", "-", "-", "-"]
    answer = said["report"]
    before = answer["before"]["held_out"]
    # without an effect that carries over no model is written, and the one in service stays
    after = (answer["after"]["held_out"] if accepted_of(answer) else None) or before
    ours_nm, cost = after["torque_rms_nm"], answer["process"]
    _targets(report, case, answer, ours_nm, book)
    report.facts[case.name] = {**book, "ours_nm": ours_nm, "said": first_names(answer), **cost}
    return [
        *start, first_names(answer), *books, percent(before["torque_rms_nm"]), percent(ours_nm),
        "yes" if leads_to_cause(case, answer) else "no",
        "yes" if residual_is_reported(answer) else "no",
        f"{answer['seconds']:.1f} s; {cost['wall_s']:.1f} s, {cost['cpu_s']:.1f} s, {cost['peak_mb']:.0f} MB",
    ]  # fmt: skip


def leads_to_cause(case: Case, answer: dict[str, Any]) -> bool:
    """Whether the opening of the page says what the machine has."""
    return re.search(CAUSES[case.inside], answer["page"], re.IGNORECASE) is not None


def _targets(report: Report, case: Case, answer: dict[str, Any], ours_nm: float, book: dict[str, float]) -> None:
    percent, textbook_percent = (100 * nm / book["command_nm"] for nm in (ours_nm, book["left_nm"]))
    most = {"emps": EMPS_PERCENT, "laas": LAAS_SHARE * textbook_percent}.get(case.machine, textbook_percent)
    report.figure(f"{case.name}: held-out torque error, of the command", percent, "%", round(most, 2), 3)
    report.bounded(
        f"{case.name}: the page leads to the cause",
        "yes" if leads_to_cause(case, answer) else "no",
        leads_to_cause(case, answer),
        "yes",
    )
    if case.inside in FIRST:
        name, order = FIRST[case.inside]
        leads = next(iter(claimed(answer)), None)
        right = leads is not None and (name in (leads["name"], *leads["alternatives"]))
        if right and order is not None:
            right = round(leads["parameters"].get("order", order)) == order
        wanted = f"`{name}`" + (f" of order {order:g}" if order else "")
        report.bounded(f"{case.name}: leads", first_names(answer, 1), right, wanted)
    report.figure(f"{case.name}: memory", answer["process"]["peak_mb"], "MB", MOST_MB)
    if case.machine == "laas":
        report.figure(f"{case.name}: diagnosis", answer["seconds"], "s", LAAS_S)


if __name__ == "__main__":
    main(run)
