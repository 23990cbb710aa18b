"""Import of foreign logs, typed: generated, damaged, large and published ones, and a robot's data set."""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import resource
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import ROOT, Report, finish, main, parser, shown
from importing_logs import PROGRAMS, TORQUE_CONSTANT_NM_PER_A, Case, Reading, case, wrong_in

from fffo_drive.cli import main as command
from fffo_drive.importing.units import split_name
from fffo_drive.recording.reader import read_run

NAME = "importing"
PURPOSE = (
    "`fffo-drive import` as it is typed: logs that are generated with the truth behind each (names, units, "
    "rates, restarts, registers, headings that lie), files that are damaged, a CSV of 100 MB beside pyarrow's parser "
    "alone on the same file, a LeRobot directory, and the published logs as their authors wrote them, each imported "
    "with one command and then identified. What is timed has a process of its own."
)
ROWS, SAMPLE_ROWS = 1_900_000, 20_000
PERIOD_S = 5e-4
LARGEST_S, LARGEST_MB = 6.0, 800.0
LOGS, DAMAGED, SAMPLE_LOGS = 300, 100, 12
SEED = 20261129
MOST_ASKED = 0.25  # of the generated logs
AT_ONCE = 2  # processes
EPISODES, FRAMES, JOINTS, FRAMES_HZ = 50, 600, 6, 50.0
LARGEST_DATASET_S = 10.0
LONGEST_MESSAGE = 2000  # characters of a refusal
KINDS = ("units", "program", "no units", "a heading that lies")
OUTCOMES = ("right", "wrong", "asked: right", "asked: other", "asked: --yes refuses", "refused")
DATA = ROOT.parent / "shared" / "data"
PARSE = "import sys; from pyarrow import csv; csv.read_csv(sys.argv[1])"


MAGICS = {  # of the kinds of files that damaged ones claim to be
    "npz": b"PK\x03\x04",
    "parquet": b"PAR1",
    "mat": b"MATLAB 5.0 MAT-file",
    "mcap": b"\x89MCAP0\r\n",
    "blf": b"LOGG",
    "trc": b";$FILEVERSION=2.0\n",
    "asc": b"date Sun Nov 29 2026\nbase hex timestamps absolute\n",
    "json": b"[",
}


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


def kind_of(one: Case) -> str:
    """The line of the table that a generated log counts in."""
    if one.undecided == "no units":
        return KINDS[2]
    return KINDS[3] if one.undecided else KINDS[1] if one.kind in PROGRAMS else KINDS[0]


def typed(words: list[str]) -> tuple[int, str, str]:
    """Exit code, output and errors of a command line, here: interpreters take longer to start than to read."""
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        try:
            code = command(words)
        except Exception:  # what a user would see as a traceback
            code = 1
            traceback.print_exc(file=errors)
    return code, out.getvalue(), errors.getvalue()


def outcome_of(one: Case, folder: Path) -> tuple[str, str]:
    """What became of a generated log without and with --yes, and in words what is wrong."""
    path, out = folder / f"{one.number}.csv", folder / f"{one.number}"
    path.write_text(one.text)
    words = ["import", str(path), *one.options, "--torque-constant", str(TORQUE_CONSTANT_NM_PER_A), "--json"]
    code, said, errors = typed([*words, "--out", str(out)])
    asked = "are assumptions: accept them with --yes" in errors
    if asked:
        code, said, errors = typed([*words, "--out", str(out), "--yes"])
    if "Traceback" in errors:
        return "wrong", "a traceback"
    if code:
        errors = errors.strip().replace(f"{folder}/", "").partition("fffo-drive import: ")[2]
        return "asked: --yes refuses" if asked else "refused", errors
    readings = []
    for log in json.loads(said)["logs"]:
        columns = {signal: guess["column"] for signal, guess in log["signals"].items()}
        readings.append(Reading(read_run(Path(log["recording"])).columns, columns, log["torque_unit"]))
    wrong = wrong_in(one, readings, lambda heading: split_name(heading)[0])
    named = "asked: other" if asked else "wrong"
    return (named, "; ".join(wrong)) if wrong else ("asked: right" if asked else "right", "")


def outcomes_of(cases: list[Case], folder: Path) -> list[tuple[str, str]]:
    """`outcome_of` of each."""
    with ProcessPoolExecutor(AT_ONCE) as pool:
        return list(pool.map(outcome_of, cases, [folder] * len(cases), chunksize=4))


def of_generated(seed: int, number: int, folder: Path, report: Report) -> None:
    """Logs with the truth behind them: the targets, and a table by kind."""
    cases = [case(seed, k) for k in range(number)]
    found = outcomes_of(cases, folder)
    counts = Counter((kind_of(one), outcome) for one, (outcome, _) in zip(cases, found, strict=True))
    wrong = sum(counts[kind, "wrong"] for kind in KINDS)
    asked = number - wrong - sum(counts[kind, "right"] for kind in KINDS)
    report.bounded(f"{number} generated logs (seed {seed}): silently wrong", str(wrong), wrong == 0, "0")
    share = asked / number
    report.bounded(
        "likewise: asked about or refused",
        f"{100.0 * share:.0f} %",
        share <= MOST_ASKED,
        f"<= {100.0 * MOST_ASKED:g} %",
    )
    decided = sum(counts[kind, one] for kind in KINDS[:2] for one in OUTCOMES)
    open_ones = sum(counts[kind, one] for kind in KINDS[:2] for one in OUTCOMES[2:])
    report.bounded("likewise, of those with units and true headings", f"{100.0 * open_ones / max(decided, 1):.0f} %")
    rows = [[kind, *(str(counts[kind, one]) for one in OUTCOMES)] for kind in KINDS]
    report.table(["generated log", *OUTCOMES], rows)
    for one, (outcome, said) in zip(cases, found, strict=True):
        if outcome == "wrong":
            report.notes.append(f"wrong: log {one.number} ({one.kind}, {one.how}): {said}")


def damaged(seed: int, number: int) -> list[tuple[str, bytes]]:
    """(name, bytes) of logs that were cut, overwritten, mixed up or emptied: text, NPZ, JSON, Parquet, MATLAB, MCAP."""
    rng = np.random.default_rng([seed, 1])
    files = []
    for k in range(number):
        whole = case(seed + 1, k).text.encode()
        suffix = ("csv", "csv.gz", "json", "npz", "parquet", "mat", "mcap", "trc", "blf", "asc")[k % 10]
        data = gzip.compress(whole) if suffix == "csv.gz" else MAGICS.get(suffix, b"") + whole
        at = int(rng.integers(1, len(data)))
        kind = rng.integers(6)
        if kind == 0:
            data = data[:at]
        elif kind == 1:
            data = data[:at] + rng.bytes(200) + data[at + 200 :]
        elif kind == 2:
            data = bytes(reversed(data))
        elif kind == 3:
            data = data.replace(b"1", b"x").replace(b"2", b"")
        elif kind == 4:
            data = b"\n".join(line[: int(rng.integers(1, 40))] for line in data.split(b"\n"))
        else:
            data = rng.bytes(3000)
        files.append((f"{k}.{suffix}", data))
    return files


def badly_told(name: str, data: bytes, folder: Path) -> bool:
    """Whether a damaged file is refused by anything but one message that names it."""
    path = folder / name
    path.write_bytes(data)
    code, _, errors = typed(["import", str(path), "--out", f"{path}.out", "--json"])
    sentence = errors.startswith("fffo-drive import: ") and len(errors) < LONGEST_MESSAGE
    named = name in errors or "are assumptions" in errors
    return "Traceback" in errors or (code != 0 and not (sentence and named))


def of_damaged(seed: int, number: int, folder: Path, report: Report) -> None:
    """Each is read as far as it is a log, asked about, or refused in one message that names it."""
    names, files = zip(*damaged(seed, number), strict=True)
    with ProcessPoolExecutor(AT_ONCE) as pool:
        count = sum(pool.map(badly_told, names, files, [folder] * number))
    report.bounded(f"{number} damaged files: not one message that names the file", str(count), count == 0, "0")


def write_dataset(folder: Path, episodes: int) -> Path:
    """A LeRobot directory: positions, efforts and actions of several joints, a Parquet file an episode."""
    import pyarrow
    from pyarrow import parquet

    names = [f"joint_{k}" for k in range(JOINTS)]
    feature = {"dtype": "float32", "shape": [JOINTS], "names": names}
    info = {"fps": FRAMES_HZ, "features": dict.fromkeys(("observation.state", "observation.effort", "action"), feature)}
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    place = folder / "data" / "chunk-000"
    place.mkdir(parents=True)
    for number in range(episodes):
        time_s = np.arange(FRAMES) / FRAMES_HZ
        phase = np.arange(JOINTS) + number
        state = np.sin(2.0 * np.pi * 0.3 * time_s[:, None] + phase)
        rate = 2.0 * np.pi * 0.3 * np.cos(2.0 * np.pi * 0.3 * time_s[:, None] + phase)
        effort = 0.3 * np.tanh(rate / 0.05) + 0.02 * rate - 0.1 * state
        columns = {"observation.state": state, "observation.effort": effort, "action": np.roll(state, -2, axis=0)}
        made = {name: pyarrow.array(list(values.astype(np.float32))) for name, values in columns.items()}
        made |= {"timestamp": pyarrow.array(time_s), "episode_index": pyarrow.array(np.full(FRAMES, number))}
        parquet.write_table(pyarrow.table(made), place / f"episode_{number:06d}.parquet")
    return folder


def run() -> int:
    """Generated and damaged logs, the large file, the data set, then the published ones."""
    arguments = parser(NAME, PURPOSE, 3, 1)
    arguments.add_argument("--seed", type=int, default=SEED, help="of the generated and damaged logs")
    options = arguments.parse_args()
    report = Report(NAME, PURPOSE)
    program = [sys.executable, "-m", "fffo_drive"]
    with tempfile.TemporaryDirectory() as folder, shown("importing") as progress:
        number = SAMPLE_LOGS if options.sample else LOGS
        of_generated(options.seed, number, Path(folder), report)
        of_damaged(options.seed, SAMPLE_LOGS if options.sample else DAMAGED, Path(folder), report)
        episodes = 3 if options.sample else EPISODES
        dataset = write_dataset(Path(folder) / "dataset", episodes)
        words = ["--joint", "joint_2", "--out", f"{folder}/robot", "--yes", "--json"]
        seconds, _, done = timed([*program, "import", str(dataset), *words])
        if done.returncode or len(json.loads(done.stdout)["logs"]) != episodes:
            raise RuntimeError(done.stderr)
        what = f"LeRobot directory of {episodes} episodes"
        report.bounded(what, f"{seconds:.1f} s", seconds <= LARGEST_DATASET_S, f"<= {LARGEST_DATASET_S:g} s")
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
