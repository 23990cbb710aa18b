"""What logs can show, as pictures: velocity over time, input against acceleration, speeds, places, waves, frequencies.

`import` draws them on one sheet; the pages of `identify` and `diagnose` have them as a section, with the same words.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats
from ..documents import sentence
from ..identification.coverage import Coverage, shown, to_record
from ..identification.dataset import Record
from ..identification.kinematics import motion_of
from ..units import unit_on
from .document import Section
from .figures import FREQUENCY, TIME, Figure, LevelLine, PlotAxis, Series, Uniform, Width

MOST_RUNS = 4  # that are drawn over time
COLOURS = ("blue", "orange", "green", "purple")
WIDTHS: dict[int, Width] = {1: "full", 2: "half", 3: "third"}  # of figures that share a row
CLASSES = 60
POINTS = 1500  # of all runs
SHARES = 99  # quantiles of the motion at which the highest order is drawn
WINDOW_S = 4.0  # of the spectrum
LEAST_WINDOW_S = 0.5
FREQUENCIES = 400


def coverage_section(records: Sequence[Record], coverage: Coverage, linear: bool) -> Section:
    """The section of a page: what the data can and cannot show, in words and figures."""
    text = f"They hold {'; '.join(shown(coverage, linear))}."
    wanted = to_record(coverage, linear)
    if wanted:
        sentences = (f" {sentence(line)}" for line in wanted)
        text += " Not determined by these data, and what to record for it:" + "".join(sentences).replace("`", "")
    rows = coverage_figures(records, coverage, linear)
    figures = tuple(replace(one, width=WIDTHS[len(row)]) for row in rows for one in row)
    return Section("What these data can show", text, figures)


def coverage_figures(records: Sequence[Record], coverage: Coverage, linear: bool) -> list[list[Figure]]:
    """Rows of figures for one sheet."""
    turn, speed, acceleration = (unit_on(unit, linear) for unit in ("rev", "rps", "rps2"))
    motions = [[motion_of(r, part, coverage.cutoff_hz) for part in r.segments()] for r in records]
    over_time, against = [], []
    drawn = min(len(records), MOST_RUNS)
    for record, parts, colour in zip(records[:MOST_RUNS], motions, COLOURS, strict=False):
        velocity = np.full(record.samples, np.nan)
        own: list[Floats] = []
        for part, motion in zip(record.segments(), parts, strict=True):
            velocity[part] = motion.velocity_rps
            own.append(np.stack([motion.acceleration_rps2, record.current_a[part]], axis=1))
        over_time.append(Series(record.name, Uniform(0.0, record.period_s), velocity, colour, weight=1.2))
        points = np.concatenate(own)
        points = points[:: max(1, drawn * points.shape[0] // POINTS)]
        points = points[np.argsort(points[:, 0])]
        against.append(Series(record.name, points[:, 0], points[:, 1], colour, draw="points"))
    velocity = np.concatenate([m.velocity_rps for parts in motions for m in parts])
    position = np.concatenate([m.position_rev for parts in motions for m in parts])
    more = "" if len(records) <= MOST_RUNS else f" The first {MOST_RUNS} of {len(records)} runs."
    return [
        [
            Figure(
                "data-velocity", "time", "Velocity",
                f"The derivative of the position, below {coverage.cutoff_hz:.3g} Hz. Presliding shows at changes of "
                f"sign, break-away after standstill.{more}",
                TIME, PlotAxis("velocity", speed), tuple(over_time),
            ),
        ],
        [
            Figure(
                "data-input", "xy", "Input against acceleration",
                f"{'Mass' if linear else 'Inertia'} is the slope; a fit needs points on both sides. The spread above "
                f"and below is friction and everything else.{more}",
                PlotAxis("acceleration", acceleration), PlotAxis("input", "-"), tuple(against),
            ),
            _shares(
                "data-speeds", "Speeds", "Share of time at each speed. Viscous friction needs several peaks, the "
                "Stribeck curve some of them near zero.", PlotAxis("velocity", speed), velocity,
            ),
            _shares(
                "data-places", "Places", "Share of time at each position. Effects of position show only where the "
                "axis has been.", PlotAxis("position", turn), position,
            ),
        ],
        [_waves(velocity, coverage, linear), _frequencies(records, coverage)],
    ]  # fmt: skip


def _shares(name: str, title: str, caption: str, axis: PlotAxis, values: Floats) -> Figure:
    counts, edges = np.histogram(values, bins=CLASSES)
    share = 100.0 * counts / max(1, values.size)
    return Figure(
        name, "histogram", title, caption, axis, PlotAxis("share of the time", "%"),
        (Series(title, edges, share, "blue", draw="filled"),),
    )  # fmt: skip


def _waves(velocity_rps: Floats, coverage: Coverage, linear: bool) -> Figure:
    """The highest order of ripple that each part of the motion shows: the filter's cut-off over the speed."""
    share = np.linspace(0.0, 100.0, SHARES + 2)[1:-1]
    lowest_rps = max(1e-3 * coverage.highest_rps, 1e-12)
    speed_rps = np.maximum(np.percentile(np.abs(velocity_rps), share), lowest_rps)
    unit = unit_on("1/rev", linear)
    return Figure(
        "data-waves", "xy", "Ripple over the position",
        f"Highest order of ripple over the position that the data show: {coverage.cutoff_hz:.3g} Hz over the "
        "speed. Slow motion shows higher orders.",
        PlotAxis("share of the motion that is slower", "%"), PlotAxis("highest order", unit, log=True),
        (Series("highest order", share, coverage.cutoff_hz / speed_rps, "blue"),),
    )  # fmt: skip


def _frequencies(records: Sequence[Record], coverage: Coverage) -> Figure:
    """Power spectral density of the input by Welch's method, each run by its longest stretch without a gap."""
    series: list[Series] = []
    for record, colour in zip(records[:MOST_RUNS], COLOURS, strict=False):
        longest = max(record.segments(), key=lambda part: part.stop - part.start)
        values = record.current_a[longest]
        window = min(values.size, round(WINDOW_S / record.period_s))
        if window * record.period_s < LEAST_WINDOW_S and series:
            continue
        hz, density = scipy.signal.welch(values, 1.0 / record.period_s, nperseg=window)
        hz, density = hz[1:], np.sqrt(density[1:])
        floor = max(1e-6 * float(density.max(initial=0.0)), 1e-12)
        edges = np.geomspace(hz[0], hz[-1], min(FREQUENCIES, hz.size) + 1)
        places = np.unique(np.clip(np.searchsorted(hz, edges), 0, hz.size - 1))
        series.append(Series(record.name, hz[places], np.maximum(density[places], floor), colour, weight=1.2))
    return Figure(
        "data-frequencies", "xy", "Frequencies of the input",
        "Frequencies that the input excites; delay, resonances and lags show there. A fit uses nothing beyond the "
        "line.",
        FREQUENCY, PlotAxis("amplitude density", "1/√Hz", log=True), tuple(series),
        levels=(LevelLine(coverage.cutoff_hz, "fit", upright=True),),
    )  # fmt: skip
