"""Import of foreign logs: time and memory for 100 MB of text, and the results on published logs."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import ROOT, Report, finish, main, parser, shown

NAME = "importing"
PURPOSE = (
    "`fffo-drive import` in a process of its own: a CSV of 100 MB beside pyarrow's parser alone on the same file, and "
    "the published logs as their authors wrote them, each imported with one command and then identified."
)
ROWS, SAMPLE_ROWS = 1_900_000, 20_000
PERIOD_S = 5e-4
LARGEST_S, LARGEST_MB = 10.0, 1000.0
DATA = ROOT.parent / "shared" / "data"
PARSE = "import sys; from pyarrow import csv; csv.read_csv(sys.argv[1])"


class Published(NamedTuple):
    """A published set, and what its user has to say."""

    name: str
    files: str
    words: tuple[str, ...]


SETS = (
    Published(
        "LAAS (outrunner, text, rad, missing samples)", "measured/laas/speed_test*.txt",
        ("--torque-constant", "0.025"),
    ),
    Published("BAM (servo on a pendulum, JSON, jitter, unsigned load)", "measured/bam/*.json", ()),
    Published("TRO2021 (screw drives, EPOS Studio, 25 Hz)", "measured/tro2021/*.csv", ()),
    Published("EMPS (linear, MAT, no units)", "emps/DATA_EMPS.mat", ("--linear", "--torque-constant", "35.15065")),
)  # fmt: skip


def write_large(path: Path, rows: int) -> None:
    """A motion with inertia and friction, five columns."""
    time_s = np.arange(rows) * PERIOD_S
    velocity = 3.0 * np.sin(5.0 * time_s) + np.sin(13.0 * time_s)
    acceleration = 15.0 * np.cos(5.0 * time_s) + 13.0 * np.cos(13.0 * time_s)
    position = np.cumsum(velocity) * PERIOD_S
    current = 3e-3 * acceleration + 0.2 * np.tanh(velocity / 0.05) + 0.01 * velocity
    header = "Time [s],Position [rev],Velocity [rps],Command current [A],Actual current [A]"
    columns = np.stack([time_s, position, velocity, current, 1.01 * current], axis=1)
    formats = ["%.4f", "%.9f", "%.8f", "%.7f", "%.7f"]
    np.savetxt(path, columns, fmt=formats, delimiter=",", header=header, comments="")


def timed(command: list[str]) -> tuple[float, float, subprocess.CompletedProcess[str]]:
    """Seconds, peak memory (MB) of the largest child so far, and what it said."""
    begin = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    peak_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
    return time.monotonic() - begin, peak_mb, done


def run() -> int:
    """The large file, then the published ones."""
    options = parser(NAME, PURPOSE, 3, 1).parse_args()
    report = Report(NAME, PURPOSE)
    program = [sys.executable, "-m", "fffo_drive"]
    with tempfile.TemporaryDirectory() as folder, shown("importing") as progress:
        large = Path(folder) / "large.csv"
        write_large(large, SAMPLE_ROWS if options.sample else ROWS)
        size_mb = large.stat().st_size / 1e6
        times, alone = [], []
        for k in range(options.passes or (1 if options.sample else 3)):
            alone.append(timed([sys.executable, "-c", PARSE, str(large)])[0])
            seconds, peak_mb, done = timed([*program, "import", str(large), "--out", f"{folder}/large{k}", "--json"])
            if done.returncode:
                raise RuntimeError(done.stderr)
            times.append(seconds)
        what = f"{size_mb:.0f} MB of CSV"
        seconds = float(np.median(times))
        report.bounded(f"{what}: time, median", f"{seconds:.1f} s", seconds <= LARGEST_S, f"<= {LARGEST_S:g} s")
        report.bounded(f"{what}: peak memory", f"{peak_mb:.0f} MB", peak_mb <= LARGEST_MB, f"<= {LARGEST_MB:g} MB")
        report.bounded("over pyarrow's parser alone", f"{np.median(np.array(times) / np.array(alone)):.1f}")
        rows = []
        for number, one in enumerate(SETS):
            rows.append(of_set(program, one, Path(folder) / f"set{number}", options.sample))
            if progress is not None:
                progress((number + 1) / len(SETS))
    report.table(["log", "files", "options given", "recognised", "assumed", "becomes"], rows)
    report.notes.append("`assumed`: what the import marks with '?' because neither names nor units nor data decide it.")
    return finish(report, options)


def of_set(program: list[str], one: Published, out: Path, sample: bool) -> list[str]:
    """A line of the table."""
    files = sorted(DATA.glob(one.files))
    if not files:
        return [one.name, "not beside this checkout", "-", "-", "-", "-"]
    files = files[:1] if sample else files
    done = timed([*program, "import", *map(str, files), "--out", str(out), "--yes", "--json", *one.words])[2]
    said = " ".join(one.words) or "nothing"
    if done.returncode:
        return [one.name, str(len(files)), said, "-", "-", f"refused: {done.stderr.strip()[:160]}"]
    log = json.loads(done.stdout)["logs"][0]
    signals = log["signals"]
    known = ", ".join(f"{name} `{g['column']}`" for name, g in signals.items())
    assumed = ", ".join(
        f"{g['column']} [{log['torque_unit'] if g['unit'] == '-' else g['unit']}]"
        for g in signals.values() if not g["sure"]
    )  # fmt: skip
    recordings = sorted(map(str, out.glob("*.mcap")))
    seconds, _, done = timed([*program, "identify", *recordings, "--out", str(out / "model"), "--json"])
    begin = [one.name, str(len(files)), said, known, assumed or "-"]
    if done.returncode:
        return [*begin, f"refused: {done.stderr.strip().splitlines()[-1].replace(f'{out}/', '')}"]
    parameters = {row["symbol"]: row for row in json.loads(done.stdout)["parameters"] if row["fitted"]}
    fitted = ", ".join(
        f"{name} {parameters[name]['value']:.4g} ± {parameters[name]['sd']:.2g} {parameters[name]['unit']}"
        for name in ("J", "Fc") if name in parameters and parameters[name]["sd"] is not None
    )  # fmt: skip
    return [*begin, f"{fitted} ({seconds:.0f} s)"]


if __name__ == "__main__":
    main(run)
