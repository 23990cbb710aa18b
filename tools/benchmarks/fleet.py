"""Records of runs: the cost of one, and queries and figures over a million."""

from __future__ import annotations

import hashlib
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import ROOT, Report, finish, main, parser, shown
from threadpoolctl import threadpool_limits

NAME = "fleet"
PURPOSE = (
    "A record of a simulated run of 60 s at 2 kHz: processor time after imports, and bytes. Then a store of records "
    "drawn around such runs (two models, 50 weekly runs per drive; 20,000 drives are a million records) is queried by "
    "`fleet report`, `fleet watch` and DuckDB, each in a process of its own."
)
RUNS, DRIVES, SAMPLE_DRIVES = 50, 20_000, 400
CPU_S, BYTES = 0.3, 4096
LARGEST_S, LARGEST_MB = 10.0, 2048.0
WEEK_US = 7 * 86_400 * 1_000_000
START_US = 1_767_225_600_000_000  # 2026-01-01
REPEATS = 7
DRIVE_SD, RUN_SD = 0.05, 0.02  # of parameters, between drives and between runs
AXIS = ROOT / "configs" / "axis_simulated.yaml"
PROFILES = {"paper": None, "identify": ROOT / "configs" / "profiles" / "identify.yaml"}
QUERY = """
import sys, duckdb
found = duckdb.sql(f"select model, drive, avg(coulomb_nm), stddev(coulomb_nm), max(start) "
                   f"from '{sys.argv[1]}/records/merged/*/*.parquet' group by model, drive").fetchall()
print(len(found))
"""


def recorded(folder: Path) -> list[Path]:
    """A run of each profile."""
    import fffo_drive as fd

    for name, profile in PROFILES.items():
        fd.run(AXIS, folder / f"{name}.mcap", profile=profile)
    return [folder / f"{name}.mcap" for name in PROFILES]


def record_cost(path: Path) -> tuple[float, dict[str, Any]]:
    """Processor time (s) of a record, the median of some, and the record."""
    from fffo_drive.fleet.adding import Given, entry_of
    from fffo_drive.fleet.work import record_row

    entry = entry_of(str(path), Given())
    times = []
    with threadpool_limits(1):
        for _ in range(REPEATS):
            begin = time.process_time()
            row = record_row(entry)
            times.append(time.process_time() - begin)
    return float(np.median(times[1:])), row


def drawn_store(address: Path, rows: list[dict[str, Any]], drives: int, progress: Any) -> int:
    """A merged store of records drawn around these; how many bytes its records take."""
    import pyarrow as pa

    from fffo_drive.fleet.regress import PARAMETERS, unpacked
    from fffo_drive.fleet.schema import RECORD_SCHEMA, SORTED_BY, file_bytes, table_of
    from fffo_drive.fleet.store import FleetStore

    store = FleetStore(str(address), create=True)
    draw = np.random.default_rng(2)
    bases = table_of(rows)
    own = np.exp(DRIVE_SD * draw.standard_normal((drives, len(PARAMETERS))))
    total = 0
    by_month: dict[str, list[int]] = {}
    for week in range(RUNS):
        by_month.setdefault(f"{np.datetime64(START_US + week * WEEK_US, 'us').astype('datetime64[M]')}", []).append(
            week
        )
    for number, (month, weeks) in enumerate(by_month.items()):
        drive = np.repeat(np.arange(drives), len(weeks))
        week = np.tile(np.array(weeks), drives)
        base = drive % len(rows)
        table = bases.take(pa.array(base))
        size = np.exp(0.1 * draw.standard_normal(drive.size))
        truth = np.array([[row[name] or 0.0 for name in PARAMETERS] for row in rows])[base]
        theta = truth * own[drive] * np.exp(RUN_SD * draw.standard_normal(truth.shape))
        normal = np.array([row["normal"] for row in rows])[base] * size[:, None]
        moment = np.einsum("nij,nj->ni", unpacked(normal), theta)
        rms = np.array([row["rms_nm"] for row in rows])[base] * np.exp(0.1 * draw.standard_normal(drive.size))
        count = np.array([row["rows"] for row in rows])[base] * size
        energy = np.einsum("ni,ni->n", moment, theta) + rms**2 * count
        amplitude = np.array([row["order_amplitude_nm"] for row in rows])[base]
        amplitude = amplitude * np.exp(0.1 * draw.standard_normal(amplitude.shape))
        new: dict[str, Any] = {
            "run": [hashlib.sha256(b"%d %d" % pair).hexdigest() for pair in zip(drive, week, strict=True)],
            "drive": [f"SN{k:06d}" for k in drive], "model": [f"model {k}" for k in base],
            "path": [f"/data/SN{d:06d}/week{w:03d}.mcap" for d, w in zip(drive, week, strict=True)],
            "start": START_US + week * WEEK_US + drive, "normal": normal.ravel(), "moment": moment.ravel(),
            "energy_nm2": energy, "rows": count, "effective_rows": count / 50.0, "rms_nm": rms,
            "order_amplitude_nm": amplitude.ravel(),
        } | {name: theta[:, k] for k, name in enumerate(PARAMETERS)}  # fmt: skip
        for name, values in new.items():
            kind = RECORD_SCHEMA.field(name).type
            array = (
                pa.FixedSizeListArray.from_arrays(pa.array(values, kind.value_type), kind.list_size)
                if pa.types.is_fixed_size_list(kind)
                else pa.array(values, kind)
            )
            table = table.set_column(RECORD_SCHEMA.get_field_index(name), RECORD_SCHEMA.field(name), array)
        data = file_bytes(table.sort_by(SORTED_BY))
        store.place.write(f"records/merged/{month}/{hashlib.sha256(data).hexdigest()[:16]}.parquet", data)
        total += len(data)
        if progress is not None:
            progress((number + 1) / len(by_month))
    return total


def timed(command: list[str]) -> tuple[float, float, float, str]:
    """Seconds, processor seconds and peak memory (MB) of a process of its own, and what it said."""
    script = "import os, resource, subprocess, sys, time\nb = time.monotonic()\n"
    script += "d = subprocess.run(sys.argv[1:], capture_output=True, text=True)\n"
    script += "u = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
    script += "print(d.stdout, d.stderr, file=sys.stderr)\n"
    script += "print(time.monotonic() - b, u.ru_utime + u.ru_stime, u.ru_maxrss / 1024.0, d.returncode)"
    done = subprocess.run([sys.executable, "-c", script, *command], capture_output=True, text=True, check=True)
    wall_s, cpu_s, peak_mb, code = (float(word) for word in done.stdout.split())
    if code:
        raise RuntimeError(done.stderr)
    return wall_s, cpu_s, peak_mb, done.stderr


def run() -> int:
    """One record, then very many."""
    made = parser(NAME, PURPOSE, 3, 1)
    made.add_argument("--drives", type=int, default=DRIVES, help="drives of the drawn store, 50 records each")
    options = made.parse_args()
    report = Report(NAME, PURPOSE)
    drives = SAMPLE_DRIVES if options.sample else options.drives
    with tempfile.TemporaryDirectory() as folder, shown("fleet") as progress:
        from fffo_drive.fleet.schema import file_bytes, table_of

        rows = []
        for path in recorded(Path(folder)):
            cpu_s, row = record_cost(path)
            rows.append(row)
            report.figure(f"record of {path.stem}: processor time", cpu_s, "s", CPU_S)
            report.figure(
                f"record of {path.stem}: its file before merging", len(file_bytes(table_of([row]), True)), "B", digits=4
            )
        begin = time.monotonic()
        total = drawn_store(Path(folder) / "store", rows, drives, progress)
        count = drives * RUNS
        report.figure("records drawn", count, "", digits=8)
        report.figure("bytes a record, merged", total / count, "B", BYTES, digits=4)
        report.figure("size of the store", total / 1e6, "MB", digits=4)
        report.notes.append(f"Drawing and writing the store took {time.monotonic() - begin:.0f} s.")
        program = [sys.executable, "-m", "fffo_drive", "fleet"]
        store = f"{folder}/store"
        for what, command in {
            "fleet report (populations, outsiders, six histories a model, page)": [
                *program, "report", store, "--out", f"{folder}/page"],
            "fleet report --serial (the history of one drive)": [
                *program, "report", store, "--serial", "SN000007", "--out", f"{folder}/page7"],
            "fleet watch (every drive's own history)": [*program, "watch", store],
            "DuckDB: mean and spread by drive": [sys.executable, "-c", QUERY, store],
        }.items():  # fmt: skip
            figures = [timed(command) for _ in range(options.passes or (1 if options.sample else 3))]
            wall_s, cpu_s, peak_mb = (float(np.median([one[k] for one in figures])) for k in range(3))
            report.figure(f"{what}: time on the clock", wall_s, "s", LARGEST_S)  # `watch` uses two threads
            report.figure(f"{what}: processor time", cpu_s, "s")
            report.figure(f"{what}: peak memory", peak_mb, "MB", LARGEST_MB, digits=4)
        size = (Path(folder) / "page" / "report.html").stat().st_size
        report.figure("the page", size / 1e6, "MB")
        report.facts["peak_mb_here"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return finish(report, options)


if __name__ == "__main__":
    main(run)
