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
from engine import Call, accepted_of, first_names, in_parallel, residual_is_reported, write_answer
from rows import CUTOFF_HZ, Floats, rms

from fffo_drive.identification.coordinates import PARAMETERS
from fffo_drive.identification.dataset import Record
from fffo_drive.identification.residuals import torque_residual
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


def peer_rows(records: Sequence[Record], base: dict[str, list[float]]) -> PeerRows:
    """Rows of records under a base model, standstill left out."""
    value = {name: numbers[0] for name, numbers in base.items()}
    value["inertia_nm_s2_per_rev"] = inertia_nm_s2_per_rev(value["inertia_kg_m2"])
    value["delay_s"] -= value["sensor_delay_s"]
    physical = np.array([value.get(name, 0.0) for name in PARAMETERS])
    parts = []
    for number, record in enumerate(records):
        found = torque_residual(record, physical, CUTOFF_HZ)
        position = record.position_rev[np.searchsorted(record_times(record), found.time_s - 0.5 * record.period_s)]
        step = max(1, round(1.0 / (record.period_s * RATE_HZ)))
        kept = np.flatnonzero(found.kept)[::step]
        velocity = found.velocity_rps[kept]
        turns = 2.0 * np.pi * np.outer(position[kept], ORDERS)
        columns = [
            found.acceleration_rps2[kept], velocity, np.tanh(velocity / SIGN_RPS), position[kept] % 1.0,
            position[kept], found.travel_rev[kept], np.sin(turns), np.cos(turns),
        ]  # fmt: skip
        parts.append((
            np.column_stack(columns), found.residual_nm[kept], np.full(kept.size, float(number)), found.torque_nm[kept],
        ))  # fmt: skip
    return PeerRows(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def record_times(record: Record) -> Floats:
    """Stamps of a record (n,), s."""
    return np.asarray(record.begin_s + np.arange(record.samples) * record.period_s)


def fit_peers(drive: DriveFolder, ours: Path, answer: Path) -> None:
    """Run our diagnosis, and the peers on the rows of its base model; each answer goes to a file. Existing answers are
    kept."""
    diagnose_folder(drive.logs, ours)
    if answer.exists():
        return
    fit, held_out, _ = records_of(drive.logs)
    base = json.loads(ours.read_text())["base"]
    rows, held = peer_rows(fit, base), peer_rows(held_out, base)
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
    false_ours: list[int] = []
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
            false_ours.append(len(accepted_of(ours)))
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
        report.bounded("findings per drive without effects, ours", f"{np.mean(false_ours):.2f}")
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
        "Errors: held-out torque residual over the command, both rms below 45 Hz. The peers fit the residual of our "
        f"base model (inertia, delay, friction of one surface), on rows at {RATE_HZ:g} Hz without standstill; our "
        "error is over the rows of the diagnosis. In brackets: terms (gplearn: nodes of its program) and time.",
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
