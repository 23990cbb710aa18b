"""Peers on the same rows: PySINDy, SysIdentPy, boosted trees and symbolic regression beside the diagnosis."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from blind_drives.run import diagnose_folder, records_of
from blind_drives.score import wilson
from common import ROOT, Report, finish, main, parser, shown
from drive_folders import DriveFolder, drive_folders
from engine import Call, claimed, first_names, in_parallel, residual_is_reported, write_answer
from rows import Floats, rms

from fffo_drive.diagnosis.base import NAMES, models_along
from fffo_drive.diagnosis.diagnose import DiagnosisSettings, filter_for
from fffo_drive.diagnosis.fitting import evaluate
from fffo_drive.diagnosis.proof import data_of
from fffo_drive.diagnosis.rows import Filter
from fffo_drive.identification.dataset import Record
from fffo_drive.units import inertia_nm_s2_per_rev

NAME = "peers"
PURPOSE = (
    "Held-out torque error of the diagnosis beside that of peers that name no effects: PySINDy (STLSQ, products of two "
    "and orders 1 to 30 of the angle), SysIdentPy (FROLS, BIC), scikit-learn's boosted trees, gplearn (symbolic "
    "regression). All are given position, velocity, acceleration, sign, travel since reversal, sin and cos."
)
FIT = Path(__file__).resolve().parent / "peers_fit.py"
ORDERS = range(1, 31)
RATE_HZ = 100.0  # of the rows
OWN = 3  # regressors that any axis has: acceleration, velocity, sign of the velocity
SIGN_RPS = 0.05  # width of the smoothed sign
WITHIN, SHARE = 1.05, 0.95  # of the best peer's error, on this share of the drives


class PeerRows(NamedTuple):
    """What the peers are given: (n, k) regressors, the axis' own first; (n,) torque that the base model leaves, number
    of the run, and torque of the motor."""

    regressors: Floats
    left_nm: Floats
    run: Floats
    motor_nm: Floats


def peer_rows(records: Sequence[Record], filter_: Filter, base: dict[str, list[float]]) -> PeerRows:
    """The rows of the diagnosis that count in its proof, thinned, under a base model."""
    value = {name: numbers[0] for name, numbers in base.items()}
    value["inertia_nm_s2_per_rev"] = inertia_nm_s2_per_rev(value["inertia_kg_m2"])
    value["delay_s"] -= value["sensor_delay_s"]
    physical = np.array([value.get(name, 0.0) for name in NAMES])
    data = data_of(records, filter_, physical)
    rows, models = data.rows, models_along(data.stretches, physical)
    motor_nm = np.concatenate([filter_.rows(one.torque_nm) for one in models])
    travel_rev = rows.joined(one.travel_rev for one in models)
    turns = 2.0 * np.pi * np.outer(rows.position_rev, ORDERS)
    regressors = np.column_stack([
        rows.acceleration_rps2, rows.velocity_rps, np.tanh(rows.velocity_rps / SIGN_RPS), rows.position_rev % 1.0,
        rows.position_rev, travel_rev, np.sin(turns), np.cos(turns),
    ])  # fmt: skip
    left_nm = evaluate(data, physical, ())[0].residual_nm
    step = max(1, round(1.0 / (filter_.row_period_s * RATE_HZ)))
    kept = np.flatnonzero(rows.kept)[::step]
    return PeerRows(regressors[kept], left_nm[kept], rows.run[kept].astype(np.float64), motor_nm[kept])


def fit_peers(drive: DriveFolder, ours: Path, answer: Path) -> None:
    """Run our diagnosis, and the peers on the rows of its base model; each answer goes to a file. Existing answers are
    kept."""
    diagnose_folder(drive.logs, ours)
    if answer.exists():
        return
    fit, held_out, facts = records_of(drive.logs)
    base = json.loads(ours.read_text())["base"]
    filter_ = filter_for(fit, facts, DiagnosisSettings())
    rows, held = (peer_rows(records, filter_, base) for records in (fit, held_out))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rows.npz"
        np.savez(
            path, fit_X=rows.regressors, fit_y=rows.left_nm, fit_run=rows.run, held_X=held.regressors,
            held_y=held.left_nm, base=OWN,
        )  # fmt: skip
        python = Path(os.environ["FFFO_PEERS_ENV"]) / "bin" / "python"
        alone = {**os.environ, "PYTHONPATH": "", "OMP_NUM_THREADS": "1"}
        done = subprocess.run([python, FIT, path], capture_output=True, text=True, check=True, env=alone)
    said = json.loads(done.stdout.splitlines()[-1])
    write_answer(answer, {"peers": said, "command_nm": rms(held.motor_nm), "base_nm": rms(held.left_nm)})


def run() -> int:
    """Ours and the peers on every drive."""
    made = parser(NAME, PURPOSE, 1, 1)
    made.add_argument("folders", type=Path, nargs="*", default=[ROOT.parent / "shared" / "data" / "blind"])
    made.add_argument("--answers", type=Path, help="a folder that keeps the answers, for interrupted runs")
    options = made.parse_args()
    drives = drive_folders(options.folders)[: 1 if options.sample else None]
    with tempfile.TemporaryDirectory() as folder, shown("peers") as progress:
        answers = options.answers or Path(folder)
        ours = [answers / "ours" / f"{drive.name.replace('/', '_')}.json" for drive in drives]
        theirs = [answers / "peers" / path.name for path in ours]
        calls: list[Call] = [(fit_peers, each) for each in zip(drives, ours, theirs, strict=True)]
        in_parallel(calls, 2, progress, fresh=True)
        said = [(json.loads(a.read_text()), json.loads(b.read_text())) for a, b in zip(ours, theirs, strict=True)]
    return finish(peers_report(drives, said), options)


def peers_report(drives: Sequence[DriveFolder], said: Sequence[tuple[dict[str, Any], dict[str, Any]]]) -> Report:
    """A line a drive. `said`: our report and the peers' answer of each."""
    report = Report(NAME, PURPOSE)
    names = list(said[0][1]["peers"])
    table, near, silent = [], 0, 0
    false_terms: dict[str, list[int]] = {name: [] for name in names}
    false_ours: list[tuple[int, int]] = []  # named effects, and forms of the friction
    for drive, (ours, others) in zip(drives, said, strict=True):
        before = ours["before"]["held_out"]
        after = ours["after"]["held_out"] or before
        scale = 100.0 / others["command_nm"]
        errors = {name: peer["held_nm"] for name, peer in others["peers"].items() if "held_nm" in peer}
        best_nm = min(errors.values())
        near += after["torque_rms_nm"] <= WITHIN * best_nm
        beaten = best_nm < after["interval_95"]["torque_rms_nm"][0]
        silent += beaten and not residual_is_reported(ours)
        if drive.truth is not None and not drive.truth["effects"]:
            false_ours.append((len(claimed(ours)), len(ours.get("friction_form", []))))
            for name, peer in others["peers"].items():
                if peer.get("more") is not None:
                    false_terms[name].append(peer["more"])
        cells = [_cell(others["peers"][name], scale) for name in names]
        table.append([
            drive.name, drive.effects, first_names(ours), f"{scale * others['base_nm']:.2f}",
            f"{scale * before['torque_rms_nm']:.2f}", f"{scale * after['torque_rms_nm']:.2f}", *cells,
            "yes" if residual_is_reported(ours) else "no",
        ])  # fmt: skip
    share = wilson(near, len(drives))
    what = f"drives on which ours is within {WITHIN:g} times the best peer's held-out error"
    report.bounded(what, str(share), share.value >= SHARE, f">= {100 * SHARE:.0f} %")
    report.bounded("a peer better by more than our interval, and no residual reported", str(silent), silent == 0, "0")
    report.facts |= {"near": near, "silent": silent, "drives": len(drives), "peers": [peers for _, peers in said]}
    if false_ours:
        named, forms = np.mean(false_ours, axis=0)
        report.bounded("effects named per drive without effects, ours", f"{named:.2f}")
        report.bounded("forms of the friction per drive without effects, ours", f"{forms:.2f}")
        for name, terms in false_terms.items():
            if terms:
                report.bounded(f"terms beyond the axis' own per drive without effects, {name}", f"{np.mean(terms):.1f}")
    header = [
        "drive",
        "in it",
        "ours said",
        "base on the peers' rows, %",
        "base, %",
        "ours, %",
        *(f"{n}, %" for n in names),
    ]
    report.table([*header, "residual reported"], table)
    report.notes += [
        "Errors: held-out torque residual over the command, both rms over the rows of our proof. The peers fit the "
        f"residual of our base model (inertia, delay, friction of one surface) on these rows, thinned to {RATE_HZ:g} "
        "Hz. In brackets: terms (gplearn: nodes of its program) and time.",
        f"Versions: {', '.join(line for line in _pinned() if '==' in line)}.",
    ]
    return report


def _cell(peer: dict[str, Any], scale: float) -> str:
    if "failure" in peer:
        return str(peer["failure"])[:80]
    terms = "" if peer["terms"] is None else f"{peer['terms']}, "
    return f"{scale * peer['held_nm']:.2f} ({terms}{peer['seconds']:.0f} s)"


def _pinned() -> list[str]:
    return FIT.with_name("peers.txt").read_text().splitlines()


if __name__ == "__main__":
    main(run)
