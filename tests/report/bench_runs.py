"""Recordings of a made-up bench: the paper's reference, and errors that stick at reversals by a known amount."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fffo_drive.control.reference import Profile, paper_reference
from fffo_drive.drive.port import ExchangeCounts
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.writer import RunWriter
from fffo_drive.report.bench import BenchRecord
from fffo_drive.signals import ROW

PERIOD_NS = 500_000
WALL_NS = 1_700_000_000_000_000_000
STICTION_RPS = {"PI": 0.20, "PI+FBFO": 0.08, "PI+FFFO": 0.04, "PI+FFFO+": 0.02}
AXIS_FILE = b"name: bench\nloop: {rate_hz: 2000} # <script>alert(1)</script>\n"


def reference(duration_s: float) -> Profile:
    """The reference of `tools/bench`, of any length."""
    return paper_reference(duration_s, PERIOD_NS / 1e9, 0.2, 15.0, 0.01, 10.0, 31, -0.5, 1)


def bench_rows(profile: Profile, stiction_rps: float, seed: int) -> np.ndarray:
    """Rows of one run with a standstill before and after the profile."""
    rng = np.random.default_rng(seed)
    n, ends = profile.values.size, 200
    rows = np.zeros(n + 2 * ends, ROW)
    rows["tick"] = np.arange(rows.size)
    rows["deadline_ns"] = rows["tick"].astype(np.int64) * PERIOD_NS
    rows["lateness_ns"] = rng.gamma(4.0, 8000.0, rows.size)
    rows["late"] = rows["lateness_ns"] > 100_000
    rows["turnaround_ns"] = rng.gamma(20.0, 8000.0, rows.size)
    rows["profile_sample"] = -1
    inside = slice(ends, ends + n)
    rows["profile_sample"][inside] = np.arange(n)
    rows["reference_rps"][inside] = profile.values
    stuck = stiction_rps * np.exp(-np.abs(profile.values)) * np.sign(profile.derivatives)
    rows["velocity_rps"][inside] = profile.values - stuck + rng.normal(0.0, 0.01, n)
    rows["friction_nm"][inside] = 0.0 if stiction_rps == STICTION_RPS["PI"] else 0.05 * np.tanh(profile.values)
    return rows


def bench_records(directory: Path, duration_s: float, skipped: int = 0) -> dict[str, BenchRecord]:
    """Four runs, written as MCAP and read back; every `skipped`-th tick of them is missing."""
    profile = reference(duration_s)
    records = {}
    for seed, (name, stiction_rps) in enumerate(STICTION_RPS.items()):
        rows = bench_rows(profile, stiction_rps, seed)
        if skipped:
            rows = np.delete(rows, np.s_[250::skipped])
        metadata = {
            "axis": "bench",
            "drive": "made up & <b>bold</b>",
            "profile_samples": str(profile.values.size),
            "period_s": repr(profile.period_s),
        }
        path = directory / f"{name.lower().replace('+', '_')}.mcap"
        writer = RunWriter(path, metadata, [("axis.yaml", "application/yaml", AXIS_FILE)], WALL_NS)
        writer.write_rows(rows)
        records[name] = BenchRecord((read_run(writer.close()),), ExchangeCounts(late_feedback=3))
    return records
