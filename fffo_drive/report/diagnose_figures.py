"""Figures of a diagnosis: each effect over the quantity it depends on, the residual of each run, and its dependence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..diagnosis.results import Diagnosis, Finding, FoundCurve, Picture, ResidualChannel, RunFigure
from ..units import axis_word_on, name_on, text_on, unit_on
from .figures import TIME, Dash, Figure, Group, LevelLine, PlotAxis, Series, Uniform, grouped_bars

SHOWN_CHANNELS = 12
PAIR = " x "  # in the name of a channel over two axes
SHORT = {"travel_since_reversal": "travel", "motor_angle": "motor", "output_angle": "output", "acceleration": "accel."}
BEFORE, AFTER, LAW = "grey", "blue", "orange"
POINTS = (BEFORE, AFTER, "green", "purple")
LINES = (LAW, "ink", "purple", "green")
DASHES: tuple[Dash, ...] = ("solid", "dashed", "dotted", "dashdot")  # lines differ without their colours too


class DiagnosisWords(NamedTuple):
    """Names and units of quantities on this kind of axis."""

    torque: str = "torque"
    torque_unit: str = "Nm"
    small_torque: str = "mNm"  # of errors
    torque_scale: float = 1e3
    small_speed: str = "mrps"
    speed_scale: float = 1e3
    linear: bool = False

    def unit(self, rotary: str) -> str:
        """The unit here for that of a rotary axis."""
        return unit_on(rotary, self.linear)

    def name(self, parameter: str, rotary: str) -> str:
        """The name here of a parameter with this unit on a rotary axis."""
        return name_on(parameter, rotary, self.linear)

    def text(self, rotary: str) -> str:
        """A sentence about a rotary axis in the words of this one."""
        return text_on(rotary, self.linear)

    def axis(self, word: str) -> str:
        """An axis of a finding, or both of a table, as people read it."""
        return PAIR.join(axis_word_on(one, self.linear) for one in word.split(PAIR))

    def unit_of(self, quantity: str) -> str:
        """Unit of an error in this quantity."""
        return self.small_speed if quantity == "velocity" else self.small_torque


ROTARY = DiagnosisWords()
STRONG = ROTARY._replace(small_torque="Nm", torque_scale=1.0)  # where errors are above 1 Nm
LINEAR = DiagnosisWords("force", "N", "N", 1.0, "mm/s", linear=True)


def words_of(diagnosis: Diagnosis) -> DiagnosisWords:
    """The words of the axis that was diagnosed."""
    if diagnosis.units == "linear":
        return LINEAR
    return STRONG if diagnosis.fit_before.torque_rms_nm.value >= 1.0 else ROTARY


def effect_figures(findings: Sequence[Finding], words: DiagnosisWords) -> tuple[Figure, ...]:
    """The figures of each finding: the one that its law declares, and the residual over its axis."""
    found = []
    for number, finding in enumerate((f for f in findings if f.picture is not None or f.law_picture is not None), 1):
        both = {f"effect-{number}-own": finding.law_picture, f"effect-{number}": finding.picture}
        found += [(name, picture) for name, picture in both.items() if picture is not None and picture.curves]
    width = "full" if len(found) == 1 else "half"
    return tuple(_effect(name, picture, width, words) for name, picture in found)


def _effect(name: str, picture: Picture, width: str, words: DiagnosisWords) -> Figure:
    clouds = [curve for curve in picture.curves if curve.kind == "points"]
    lines = [curve for curve in picture.curves if curve.kind == "line"]
    series = [_series(curve, POINTS[k % len(POINTS)], words) for k, curve in enumerate(clouds)]
    series += [_series(curve, LINES[k % len(LINES)], words, DASHES[k % len(DASHES)]) for k, curve in enumerate(lines)]
    note = f" {picture.note}" if picture.note else ""
    return Figure(
        name=name,
        kind="xy",
        title=words.text(picture.title),
        caption=words.text(picture.says) + note,
        x=PlotAxis(words.text(picture.x_label), words.unit(picture.x_unit) or "-"),
        y=PlotAxis(words.text(picture.y_label), words.unit(picture.y_unit) or "-"),
        series=tuple(_distinct(series)),
        levels=tuple(LevelLine(mark.x, mark.label, upright=True) for mark in picture.marks),
        width="full" if width == "full" else "half",
    )


def _series(curve: FoundCurve, colour: str, words: DiagnosisWords, dash: Dash = "solid") -> Series:
    order = np.argsort(curve.x, kind="stable")
    low, high = (None if end is None else np.asarray(end)[order] for end in (curve.low, curve.high))
    x, y = np.asarray(curve.x)[order], np.asarray(curve.y)[order]
    return Series(words.text(curve.label), x, y, colour, curve.kind, dash, weight=2.2, low=low, high=high)


def _distinct(series: Sequence[Series]) -> list[Series]:
    """Series with unique names: a number is added to a name that occurs again."""
    seen: dict[str, int] = {}
    found = []
    for one in series:
        seen[one.name] = seen.get(one.name, 0) + 1
        if seen[one.name] > 1:
            one = Series(f"{one.name} ({seen[one.name]})", one.x, one.y, one.colour, one.draw, one.dash, one.weight,
                         one.low, one.high)  # fmt: skip
        found.append(one)
    return found


def run_figures(runs: Sequence[RunFigure], words: DiagnosisWords) -> tuple[Figure, ...]:
    """The residual of each run over time: its envelope before and after."""
    roles = {"fit": "used to choose and fit", "held_out": "held out: not used for the fit"}
    ordered = sorted(runs, key=lambda run: run.role != "held_out")
    return tuple(
        Figure(
            name=f"run-{number}",
            kind="time",
            title=f"{run.name} ({roles[run.role]})",
            caption="Smallest and largest residual in each interval.",
            x=TIME,
            y=PlotAxis(f"residual {words.torque}", words.torque_unit),
            series=(
                _envelope("before", run.time_s, run.before_low_nm, run.before_high_nm, BEFORE),
                _envelope("after", run.time_s, run.after_low_nm, run.after_high_nm, AFTER),
            ),
            width="full" if len(runs) == 1 else "half",
            group="runs",
            share_y=True,
        )
        for number, run in enumerate(ordered, 1)
        if run.time_s.size > 1
    )


def _envelope(name: str, time_s: Floats, low: Floats, high: Floats, colour: str) -> Series:
    step = float(time_s[1] - time_s[0])
    both = np.stack([low, high], axis=1).reshape(-1)
    return Series(name, Uniform(float(time_s[0]), 0.5 * step), np.asarray(both, dtype=np.float64), colour, weight=1.0)


def channel_figure(channels: Sequence[ResidualChannel], words: DiagnosisWords) -> Figure | None:
    """Share of the residual that a free curve over each axis explains, before and after; pairs are in the table."""
    single = [channel for channel in channels if PAIR not in channel.name]
    shown = sorted(single, key=lambda c: -c.explained_before)[:SHOWN_CHANNELS]
    if not shown:
        return None
    groups = {
        "before": Group([100.0 * c.explained_before for c in shown], BEFORE),
        "after": Group([100.0 * c.explained_after for c in shown], AFTER),
    }
    return Figure(
        name="channels",
        kind="bars",
        title="What the residual depends on",
        caption="Share of the squared residual that a free curve over this quantity alone explains.",
        x=PlotAxis(
            "axis",
            "-",
            categories=tuple(
                words.axis(c.name) if words.linear else SHORT.get(c.name, words.axis(c.name)) for c in shown
            ),
        ),
        y=PlotAxis("explained", "%"),
        series=tuple(grouped_bars(groups, {}, "")),
    )
