"""The figures of the page on Table II, drawn from what tools/benchmarks/table_two measured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

from ..report.palette import FURNITURE, SERIES

QUIET, RAISED = FURNITURE["quiet"].light, FURNITURE["grid"].light
COLOURS = {"PI": SERIES["blue"].light, "PI+FBFO": SERIES["orange"].light}
DASHES = {"ISE": "-", "MAE": "--", "MAX": ":", "STD": "-."}
NEAR = 1.2  # the grey band: within a fifth of the paper
FACTOR_TICKS = (0.25, 0.5, 1.0, 2.0)
COLUMNS = 4
LONGEST = 5  # characters of a value below its tick
# field of the benchmark's point: title, factor to the unit shown
TITLES = {
    "torque_constant_nm_per_a": ("torque constant, Nm/A", 1.0),
    "inertia_share": ("inertia / (Th Kt / Gh)", 1.0),
    "slope": ("slope of the spectrum", 1.0),
    "length_s": ("length of the run, s", 1.0),
    "observer_nm_per_rev": ("L, Nm/rev", 1.0),
    "proportional_a_per_rps": ("Kp, A/rps", 1.0),
    "integral_time_s": ("Ti, s", 1.0),
    "delay_s": ("delay, ms", 1e3),
    "noise_share": ("noise / the drive's", 1.0),
    "roughness_share": ("roughness / the drive's", 1.0),
    "mismatch_share": ("wrong friction, %", 100.0),
    "mismatch_signs": ("wrong friction, signs", 1.0),
    "friction": ("friction of the plant", 1.0),
    "preview": ("reference read ahead", 1.0),
    "feedback_band_rps": ("dead band of the FBFO, rps", 1.0),
}
WORDS = {"five_surfaces": "five surfaces", "single_2sep": "one surface", True: "yes", False: "no"}


def read_data(path: Path) -> dict[str, Any]:
    """What the benchmark wrote. Raises OSError, ValueError."""
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def details(data: dict[str, Any]) -> Figure:
    """Each ratio over the paper's for each detail that is varied alone; one panel a detail."""
    rows = -(-(len(data["details"]) + 1) // COLUMNS)
    figure, panels = plt.subplots(rows, COLUMNS, figsize=(10.4, 2.15 * rows), sharey=True, constrained_layout=True)
    best = data["best"]["point"]
    for axes, (name, title) in zip(panels.flat, TITLES.items(), strict=False):
        _detail(axes, name, title, data, best[name])
    legend = panels.flat[len(TITLES)]
    handles, labels = panels.flat[0].get_legend_handles_labels()
    legend.legend(handles, labels, loc="center", fontsize=8.5)
    for axes in panels.flat[len(TITLES) :]:
        axes.axis("off")
    for axes in panels[:, 0]:
        axes.set_ylabel("ours / paper", fontsize=9)
    return figure


def _detail(axes: Axes, name: str, title: tuple[str, float], data: dict[str, Any], best: Any) -> None:
    """One panel: values evenly spaced, since some are words."""
    series = data["details"][name]
    places = np.arange(len(series))
    factors = np.array([one["ratios"] for one in series]) / np.array(data["paper"])
    axes.axhspan(1.0 / NEAR, NEAR, color=RAISED, linewidth=0)
    chosen = [one["value"] for one in series].index(best)
    axes.axvline(chosen, color=QUIET, linewidth=0.8, label="nearest point")
    for column, label in enumerate(data["ratios"]):
        law, metric = label.split(" ")
        axes.plot(
            places, factors[:, column], DASHES[metric], color=COLOURS[law], linewidth=1.5, marker=".", markersize=4,
            label=label,
        )  # fmt: skip
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(FixedLocator(list(FACTOR_TICKS)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xticks(places, [_said(one["value"], title[1]) for one in series], fontsize=8)
    axes.tick_params(axis="y", labelsize=8)
    axes.set_xlim(-0.4, len(series) - 0.6)
    axes.set_title(title[0], fontsize=9.5)


def _said(value: Any, scale: float) -> str:
    if isinstance(value, bool | str):
        return WORDS.get(value, str(value))
    text = f"{scale * value:.3g}"
    return text if len(text) <= LONGEST else f"{scale * value:.2g}"


def obstacles(data: dict[str, Any]) -> Figure:
    """All points of the free searches: PI's largest error, and PI+FBFO's squared error, over PI's squared error."""
    ratios = np.array([one["ratios"] for one in data["tried"]])
    column = {label: place for place, label in enumerate(data["ratios"])}
    figure, panels = plt.subplots(1, 2, figsize=(8.6, 3.2), constrained_layout=True)
    for axes, label in zip(panels, ("PI MAX", "PI+FBFO ISE"), strict=True):
        x, y = column["PI ISE"], column[label]
        axes.plot(ratios[:, x], ratios[:, y], ".", color=QUIET, markersize=4, alpha=0.6, label="points searched")
        others, best, paper = np.array([one["ratios"] for one in data["others"]]), data["best"]["ratios"], data["paper"]
        axes.plot(others[:, x], others[:, y], "o", mfc="none", color=COLOURS["PI"], label="nearest, other draws")
        axes.plot(best[x], best[y], "o", color=COLOURS["PI"], label="nearest point")
        axes.plot(paper[x], paper[y], "*", color=COLOURS["PI+FBFO"], markersize=12, label="paper")
        axes.set(xlabel="PI ISE, % of PI+FFFO", ylabel=f"{label}, % of PI+FFFO")
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(FixedLocator([100, 200, 400, 800]))
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.xaxis.set_minor_locator(NullLocator())
    panels[0].legend(fontsize=9)
    return figure
