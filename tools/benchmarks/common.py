"""What the benchmarks share: interleaved passes, paired ratios with a bootstrap interval, and tables of results.

The speed of a shared machine changes from second to second. So every pass measures all variants in turn, in a rotating
order, and ratios are taken within a pass. The figure is the median of these ratios, with a percentile bootstrap
interval over the passes.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fffo_drive.cli.progress import progress_bar

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tools"))  # trial_axes, headless and whatever else is no part of the package
RESULTS = Path(__file__).resolve().parent / "results"
RESAMPLES = 4000
COVERAGE = 0.95
EXIT_MISSED = 1
EXIT_UNAVAILABLE = 69

Figures = Mapping[str, float]
Variant = Callable[[], Figures]


class Ratio(NamedTuple):
    """Median of paired ratios, and its bootstrap interval."""

    median: float
    low: float
    high: float
    passes: int

    def __str__(self) -> str:
        return f"{self.median:.3f} ({self.low:.3f} to {self.high:.3f})"


def interleaved(
    variants: Mapping[str, Variant], passes: int, progress: Callable[[float], None] | None = None
) -> dict[str, dict[str, np.ndarray[Any, np.dtype[np.float64]]]]:
    """Run every variant once per pass, in rotating order; figures by variant and name, shape (passes,)."""
    names = list(variants)
    found: dict[str, dict[str, list[float]]] = {name: {} for name in names}
    for number in range(passes):
        turn = number % len(names)
        order = names[turn:] + names[:turn]
        for place, name in enumerate(order if number % 2 == 0 else order[::-1]):
            for figure, value in variants[name]().items():
                found[name].setdefault(figure, []).append(value)
            if progress is not None:
                progress((number + (place + 1) / len(names)) / passes)
    return {name: {figure: np.array(values) for figure, values in figures.items()} for name, figures in found.items()}


def paired_ratio(values: Sequence[float] | np.ndarray[Any, Any], base: Sequence[float] | np.ndarray[Any, Any]) -> Ratio:
    """`values` over `base`, pass by pass (both (n,), n >= 1): median, and percentile bootstrap interval of it."""
    ratios = np.asarray(values, float) / np.asarray(base, float)
    generator = np.random.default_rng(1)
    drawn = ratios[generator.integers(0, ratios.size, (RESAMPLES, ratios.size))]
    low, high = np.quantile(np.median(drawn, axis=1), [0.5 - 0.5 * COVERAGE, 0.5 + 0.5 * COVERAGE])
    return Ratio(float(np.median(ratios)), float(low), float(high), ratios.size)


class Line(NamedTuple):
    """One line of the table of figures."""

    what: str
    figure: str
    target: str  # "" for a figure that is reported only
    met: bool | None  # None without a target


class Section(NamedTuple):
    """A part of a report that has a table of its own."""

    name: str
    figures: list[tuple[str, float, str, float | None]]  # what, value, unit, largest one allowed
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: list[str]


@dataclass
class Report:
    """What a benchmark found."""

    name: str
    purpose: str
    lines: list[Line] = field(default_factory=list)
    tables: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)  # for --json

    def ratio(self, what: str, ratio: Ratio, target: float | None = None) -> None:
        """A paired ratio, with the largest one allowed."""
        met = None if target is None else ratio.median <= target
        self.lines.append(Line(what, str(ratio), "" if target is None else f"<= {target:g}", met))
        self.facts[what] = ratio._asdict()

    def figure(self, what: str, value: float, unit: str, target: float | None = None, digits: int = 3) -> None:
        """A figure with a unit, with the largest one allowed."""
        met = None if target is None else value <= target
        limit = "" if target is None else f"<= {target:g} {unit}".rstrip()
        self.lines.append(Line(what, f"{value:.{digits}g} {unit}".rstrip(), limit, met))
        self.facts[what] = value

    def bounded(self, what: str, figure: str, met: bool | None = None, target: str = "") -> None:
        """A figure in words, with what it must reach in words too."""
        self.lines.append(Line(what, figure, target, met))

    def table(self, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table below the figures."""
        lines = [header, ["---"] * len(header), *rows]
        self.tables.append("\n".join(f"| {' | '.join(cells)} |" for cells in lines))

    def add(self, section: Section) -> None:
        """A section: its figures, its table, and what is to be said of it."""
        for what, value, unit, target in section.figures:
            self.figure(f"{section.name}: {what}", value, unit, target, digits=4)
        self.tables.append(f"## {section.name.capitalize()}")
        self.table(section.header, section.rows)
        self.tables.append("\n".join(f"- {note}" for note in section.notes))
        self.facts[section.name] = [dict(zip(section.header, row, strict=True)) for row in section.rows]

    @property
    def missed(self) -> list[str]:
        """Targets that were missed."""
        return [line.what for line in self.lines if line.met is False]

    def markdown(self) -> str:
        """The report as it is written to results/."""
        verdict = {True: "met", False: "**missed**", None: "reported"}
        figures = ["| figure | value | target | |", "| --- | --- | --- | --- |"]
        figures += [f"| {line.what} | {line.figure} | {line.target} | {verdict[line.met]} |" for line in self.lines]
        notes = "\n".join(f"- {note}" for note in self.notes)
        ratios = "Ratios: median of paired ratios over interleaved passes (95 % bootstrap interval)."
        parts = [
            f"# {self.name}",
            self.purpose,
            "\n".join(figures),
            *self.tables,
            notes,
            f"{ratios} {made_by(self.name)}",
        ]
        return "\n\n".join(part for part in parts if part) + "\n"


def made_by(name: str, commits: str | None = None) -> str:
    """The last line of a table: program, date, commits (None: the present one) and machine."""
    date = time.strftime("%Y-%m-%d")
    return f"Made by `tools/benchmarks/{name}` on {date}, commit {commits or commit()}, {machine()}."


def machine() -> str:
    """The kind of machine, without its name."""
    model = platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            model = line.partition(":")[2].strip()
            break
    virtual = ", virtual" if " hypervisor" in Path("/proc/cpuinfo").read_text() else ""
    load = os.getloadavg()[0]
    return f"{os.cpu_count()} cores ({model}{virtual}), Linux {platform.release()}, load {load:.1f} when it ended"


def commit() -> str:
    """Short hash of the tree, with a + for changes that are not committed (results themselves aside)."""
    changed = ["git", "-C", str(ROOT), "status", "--porcelain", "--", "fffo_drive", "tools/benchmarks/*.py"]
    try:
        name = commit_of(ROOT)
        dirty = subprocess.run(changed, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return name + ("+" if dirty else "")


def commit_of(checkout: Path) -> str:
    """Short hash of the commit that a checkout is at. Raises OSError, subprocess.CalledProcessError."""
    described = ["git", "-C", str(checkout), "rev-parse", "--short", "HEAD"]
    return subprocess.run(described, capture_output=True, text=True, check=True).stdout.strip()


def parser(name: str, purpose: str, passes: int, sample_passes: int) -> argparse.ArgumentParser:
    """Options that all benchmarks have."""
    made = argparse.ArgumentParser(prog=f"tools/benchmarks/{name}", description=purpose)
    made.add_argument(
        "--passes", type=int, help=f"interleaved passes (default {passes}; {sample_passes} with --sample)"
    )
    made.add_argument("--sample", action="store_true", help="a short run: logic and rough ratios, no result file")
    made.add_argument("--json", action="store_true", help="one JSON object on stdout in place of the table")
    made.add_argument("--out", type=Path, help=f"the Markdown file (default tools/benchmarks/results/{name}.md)")
    made.set_defaults(default_passes=(passes, sample_passes))
    return made


def passes_of(options: argparse.Namespace) -> int:
    """Passes to run."""
    return int(options.passes or options.default_passes[1 if options.sample else 0])


def shown(text: str) -> AbstractContextManager[Callable[[float], None] | None]:
    """A progress bar on stderr, where somebody sees it."""
    return progress_bar(text, quiet=not sys.stderr.isatty())


def finish(report: Report, options: argparse.Namespace) -> int:
    """Print and write the report. Returns the exit code: 1 when a full run missed a target."""
    if not options.sample or options.out is not None:
        path = options.out or RESULTS / f"{report.name}.md"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(report.markdown())
    if options.json:
        print(json.dumps(report.facts))
    else:
        print(report.markdown())
    return EXIT_MISSED if report.missed and not options.sample else 0


def main(run: Callable[[], int], *expected: type[Exception]) -> None:
    """Run a benchmark; a machine without a C compiler and `expected` errors get one clear message."""
    from in_c import NoCompilerError

    try:
        sys.exit(run())
    except NoCompilerError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(EXIT_UNAVAILABLE)
    except expected as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
