"""The figures of the manual, drawn from the code's own functions when the manual is built."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch

from .. import units
from ..config.checks import bus_sum
from ..control.stability import LinearAxis, condition_14_nm_per_rev, loop_margins
from ..model.friction import REST, FrictionConfig, friction_step, steady_friction_nm
from ..report.palette import FURNITURE, SERIES
from ..report.static import look
from ..workflows.plan import Plan, make_plan
from .table_two import details, obstacles, read_data

ORANGE, GREEN, BLUE = (SERIES[name].light for name in ("orange", "green", "blue"))
TEXT, QUIET, RAISED = (FURNITURE[name].light for name in ("text", "quiet", "raised"))
BAD = FURNITURE["bad"].light
STEP_S = 1e-4


def draw_all(directory: Path, configs: Path, results: Path) -> None:
    """Write each figure as NAME.svg. Some are drawn from the axes in `configs`, some from measured `results`."""
    bench = make_plan(str(configs / "axis_bench.yaml"))
    table_two = read_data(results / "table_two.json")
    drawn: dict[str, Callable[[], Figure]] = {
        "friction": lambda: friction(bench), "observer": observer, "condition_14": lambda: condition_14(bench),
        "preview": lambda: preview(bench), "tick": lambda: tick(bench), "diagnosis": diagnosis, "safety": safety,
        "table_two_details": lambda: details(table_two), "table_two_obstacles": lambda: obstacles(table_two),
    }  # fmt: skip
    directory.mkdir(parents=True, exist_ok=True)
    with look(), plt.rc_context({"font.size": 10, "legend.frameon": False, "lines.linewidth": 1.8}):
        for name, draw in drawn.items():
            figure = draw()
            figure.savefig(directory / f"{name}.svg", metadata={"Date": None}, bbox_inches="tight", pad_inches=0.08)
            plt.close(figure)


def _friction_of(plan: Plan) -> FrictionConfig:
    return plan.model.friction_config()


def friction(plan: Plan) -> Figure:
    """Steady friction over velocity, and the hysteresis of presliding."""
    config = _friction_of(plan)
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.2), constrained_layout=True)
    speed = np.linspace(0.0, 8.0, 400)
    steady = np.array([steady_friction_nm(config, v) for v in speed])
    left.plot(speed, steady, color=BLUE)
    left.plot(-speed, -steady, color=BLUE)
    left.axhline(0.0, color=QUIET, linewidth=0.8)
    left.annotate(
        "Fs: static",
        (0.05, config.static_nm),
        (1.6, config.static_nm - 0.001),
        arrowprops={"arrowstyle": "-", "color": QUIET},
    )
    left.annotate(
        "Fc: Coulomb",
        (2.6, steady_friction_nm(config, 2.6)),
        (2.2, 0.012),
        arrowprops={"arrowstyle": "-", "color": QUIET},
    )
    left.annotate(
        "σ: viscous slope",
        (6.0, steady_friction_nm(config, 6.0)),
        (4.4, 0.054),
        arrowprops={"arrowstyle": "-", "color": QUIET},
    )
    left.set(xlabel="velocity, rev/s", ylabel="steady friction, Nm", title="Sliding: the Stribeck curve")
    position, torque = _strokes(config)
    right.plot(position * 1000.0, torque, color=ORANGE)
    right.axhline(config.coulomb_nm, color=QUIET, linestyle=":", linewidth=1.0)
    right.axhline(-config.coulomb_nm, color=QUIET, linestyle=":", linewidth=1.0)
    right.text(-7.5, config.coulomb_nm + 0.001, "Fc", color=QUIET)
    right.set(xlabel="position, rev/1000", ylabel="friction, Nm", title="Presliding: strokes of shrinking length")
    return figure


def _strokes(config: FrictionConfig) -> tuple[Any, Any]:
    """Slow strokes of shrinking length: position in rev, friction in Nm."""
    state, position, positions, torques = REST, 0.0, [], []
    for target in (0.008, -0.007, 0.006, -0.004, 0.004, -0.002, 0.002, 0.0):
        velocity = 0.02 if target > position else -0.02
        while (target - position) * velocity > 0.0:
            state = friction_step(config, state, velocity, 0.0, STEP_S)
            position += velocity * STEP_S
            positions.append(position)
            torques.append(state.torque_nm)
    return np.array(positions), np.array(torques)


def _box(axes: Axes, place: tuple[float, float], size: tuple[float, float], text: str, colour: str = BLUE) -> None:
    x, y = place
    width, height = size
    patch = FancyBboxPatch(
        (x, y),
        width,
        height,
        boxstyle="round,pad=0.02,rounding_size=0.08",
        linewidth=1.4,
        edgecolor=colour,
        facecolor=RAISED,
    )
    axes.add_patch(patch)
    axes.text(x + width / 2.0, y + height / 2.0, text, ha="center", va="center", fontsize=9.5, linespacing=1.35)


def _arrow(
    axes: Axes,
    points: Sequence[tuple[float, float]],
    text: str = "",
    colour: str = TEXT,
    at: tuple[float, float] | None = None,
) -> None:
    for start, end in pairwise(points[:-1]):
        axes.plot((start[0], end[0]), (start[1], end[1]), color=colour, linewidth=1.3)
    axes.annotate(
        "",
        points[-1],
        points[-2],
        arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.3, "shrinkA": 0, "shrinkB": 0},
    )
    if text:
        x, y = at or ((points[0][0] + points[-1][0]) / 2.0, (points[0][1] + points[-1][1]) / 2.0 + 0.12)
        axes.text(x, y, text, ha="center", va="bottom", fontsize=9, color=colour)


def _canvas(width: float, height: float, scale: float = 0.78) -> tuple[Figure, Axes]:
    figure, axes = plt.subplots(figsize=(width * scale, height * scale))
    axes.set(xlim=(0.0, width), ylim=(0.0, height))
    axes.set_aspect("equal")
    axes.axis("off")
    return figure, axes


def observer() -> Figure:
    """The law: PI, friction observer, and where its velocity comes from."""
    figure, axes = _canvas(11.0, 4.6)
    _box(axes, (2.6, 0.5), (1.7, 0.9), "PI\nKp, Ki")
    _box(axes, (2.6, 2.6), (2.5, 1.2), "2SEP friction\n+ observation L e", ORANGE)
    _box(axes, (8.0, 0.5), (1.7, 0.9), "axis\nJ, friction, Td", QUIET)
    for x, y in ((1.5, 0.95), (6.5, 0.95)):
        axes.add_patch(Circle((x, y), 0.2, facecolor="white", edgecolor=TEXT, linewidth=1.3))
        axes.text(x, y, "+", ha="center", va="center")
    _arrow(axes, [(0.1, 0.95), (1.3, 0.95)], "reference", at=(0.62, 1.05))
    _arrow(axes, [(1.7, 0.95), (2.58, 0.95)], "e", at=(1.9, 1.0))
    _arrow(axes, [(4.32, 0.95), (6.3, 0.95)])
    _arrow(axes, [(6.7, 0.95), (7.98, 0.95)], "current", at=(7.35, 1.0))
    _arrow(axes, [(9.72, 0.95), (10.9, 0.95)], "velocity", at=(10.3, 1.02))
    _arrow(axes, [(0.5, 0.95), (0.5, 3.5), (2.58, 3.5)], "FF: reference velocity", BLUE, at=(1.3, 3.62))
    _arrow(axes, [(10.4, 0.95), (10.4, 4.3), (3.85, 4.3), (3.85, 3.82)], "FB: measured velocity", GREEN, at=(7.1, 4.02))
    _arrow(axes, [(2.15, 0.95), (2.15, 2.9), (2.58, 2.9)], "", ORANGE)
    axes.text(2.25, 1.9, "L e", color=ORANGE, fontsize=9)
    _arrow(axes, [(5.12, 3.2), (6.5, 3.2), (6.5, 1.17)], "friction / Kt", ORANGE, at=(7.15, 2.1))
    _arrow(axes, [(10.4, 0.95), (10.4, 0.1), (1.5, 0.1), (1.5, 0.73)])
    axes.text(1.68, 0.5, "−", fontsize=11)
    return figure


def _linear_axis(plan: Plan) -> LinearAxis:
    model = plan.model
    return LinearAxis(
        units.inertia_nm_s2_per_rev(model.inertia_kg_m2.value), model.friction.viscous_nm_per_rps.value,
        model.delay_s.value, model.torque_constant_nm_per_a,
    )  # fmt: skip


def condition_14(plan: Plan) -> Figure:
    """Phase margin over the observer gain, with the least gain that condition (14) allows."""
    controller, axis = plan.axis.controller, _linear_axis(plan)
    friction = _friction_of(plan)
    integral = controller.integral_a_per_rev
    least = -condition_14_nm_per_rev(integral, axis.torque_constant_nm_per_a, 0.0, friction.attraction_nm_per_rev)
    gains = np.linspace(0.0, 20.0, 160)
    phase = [loop_margins(axis, controller.proportional_a_per_rps, integral, float(gain)).phase_deg for gain in gains]
    figure, axes = plt.subplots(figsize=(7.2, 3.1), constrained_layout=True)
    axes.plot(gains, phase, color=BLUE)
    axes.axvspan(0.0, least, color=BAD, alpha=0.12, linewidth=0)
    axes.text(
        least / 2.0,
        min(phase) + 1.5,
        "(14) is violated:\nthe estimate may\noscillate",
        ha="center",
        color=BAD,
        fontsize=9,
    )
    chosen = controller.observer.gain_nm_per_rev
    at = loop_margins(axis, controller.proportional_a_per_rps, integral, chosen).phase_deg
    axes.plot([chosen], [at], "o", color=ORANGE)
    axes.annotate(
        f"configs/axis_bench.yaml\nL = {chosen:g} Nm/rev, {at:.0f}°",
        (chosen, at),
        (chosen + 1.6, at + 5.0),
        arrowprops={"arrowstyle": "-", "color": QUIET},
    )
    axes.set(xlabel="observer gain L, Nm/rev", ylabel="phase margin, degree", xlim=(0.0, 20.0))
    return figure


def preview(plan: Plan) -> Figure:
    """What an axis does with and without reading the reference ahead by its delay."""
    delay_s = plan.model.delay_s.value
    time_s = np.linspace(0.0, 0.05, 1000)

    def reference(t: Any) -> Any:
        return np.sin(2.0 * np.pi * 25.0 * t)

    figure, axes = plt.subplots(figsize=(7.2, 3.0), constrained_layout=True)
    axes.plot(time_s * 1e3, reference(time_s), color=TEXT, label="reference, and velocity with preview")
    axes.plot(
        time_s * 1e3,
        reference(time_s - delay_s),
        color=ORANGE,
        linestyle="--",
        label=f"velocity without preview: Td = {delay_s * 1e3:g} ms late",
    )
    axes.plot(
        time_s * 1e3,
        reference(time_s + delay_s),
        color=BLUE,
        linestyle=":",
        label="input of the feed-forward: Td ahead",
    )
    axes.set(xlabel="time, ms", ylabel="velocity, rev/s", ylim=(-1.15, 1.85))
    axes.legend(loc="upper center", fontsize=9, ncols=1)
    return figure


def tick(plan: Plan) -> Figure:
    """One period on the time axis, typical and worst, from the sums of `config check`."""
    _, chain = bus_sum(plan.axis, plan.model)
    names = [step.name for step in chain.steps]
    colours = [BLUE, QUIET, GREEN, GREEN, ORANGE, BLUE, BAD]
    figure, axes = plt.subplots(figsize=(8.0, 2.7), constrained_layout=True)
    for row, values in enumerate(([s.worst_s for s in chain.steps], [s.typical_s for s in chain.steps])):
        start = 0.0
        for index, value in enumerate(values):
            axes.barh(
                row,
                value * 1e6,
                left=start * 1e6,
                color=colours[index % len(colours)],
                height=0.5,
                edgecolor="white",
                label=names[index] if row == 0 else None,
            )
            start += value
    axes.axvline(chain.period_s * 1e6, color=TEXT, linestyle="--", linewidth=1.2)
    axes.text(chain.period_s * 1e6 - 4.0, 1.42, "next SYNC", ha="right", fontsize=9)
    axes.set(yticks=(0, 1), yticklabels=("worst", "typical"), xlabel="µs since SYNC", ylim=(-0.4, 1.7))
    axes.grid(axis="y", visible=False)
    axes.legend(ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.28), fontsize=9)
    return figure


def diagnosis() -> Figure:
    """The diagnosis on one page."""
    figure, axes = _canvas(11.0, 5.2)
    upper = (
        ("runs to fit", QUIET), ("1 runs agree?\nJ, Fc, σ of each", BLUE), ("2 ladder: constants,\nweight, friction", BLUE),  # noqa: E501
        ("2 waves, then laws,\ncurves, tables", BLUE),
    )  # fmt: skip
    for index, (text, colour) in enumerate(upper):
        _box(axes, (0.1 + 2.8 * index, 3.9), (2.3, 1.0), text, colour)
        if index:
            _arrow(axes, [(-0.4 + 2.8 * index, 4.4), (0.08 + 2.8 * index, 4.4)])
    lower = (
        ("3 gain on blocks\noutside the fit", BLUE), ("4 form? 5 plausible?\n6 in doubt?", BLUE), ("7 proof on\nheld-out runs", ORANGE),  # noqa: E501
        ("8 model, page,\nresidual", GREEN),
    )  # fmt: skip
    for index, (text, colour) in enumerate(lower):
        x = 8.5 - 2.8 * index
        _box(axes, (x, 1.3), (2.3, 1.0), text, colour)
        if index:
            _arrow(axes, [(x + 2.78, 1.8), (x + 2.34, 1.8)])
    _arrow(axes, [(9.2, 3.88), (9.2, 2.34)])
    _arrow(axes, [(10.2, 2.34), (10.2, 3.88)], "", QUIET)
    axes.text(9.1, 3.05, "candidate", ha="right", fontsize=9, color=TEXT)
    axes.text(10.1, 3.05, "next", ha="right", fontsize=9, color=QUIET)
    _box(axes, (2.9, 0.05), (2.3, 0.7), "held-out runs", QUIET)
    _arrow(axes, [(4.05, 0.77), (4.05, 1.28)])
    return figure


def safety() -> Figure:
    """Which layer stops the axis when the one before it has failed."""
    figure, axes = _canvas(11.0, 3.9)
    layers = (
        ("controller", "current limit,\nestimate clamp", BLUE), ("envelope", "clamps, or\nlatches a trip", BLUE),
        ("supervisor", "states, epochs,\norderly stops", BLUE), ("drive", "silence, limits,\nquick stop", ORANGE),
        ("machine", "e-stop, STO,\nbrake", BAD),
    )  # fmt: skip
    for index, (name, text, colour) in enumerate(layers):
        x = 0.1 + 2.2 * index
        _box(axes, (x, 1.2), (1.8, 1.6), f"{name}\n\n{text}", colour)
        if index:
            _arrow(axes, [(x - 0.38, 2.0), (x - 0.02, 2.0)])
    axes.plot((0.1, 6.3), (0.8, 0.8), color=BLUE, linewidth=1.4)
    axes.text(3.2, 0.3, "this program: not a safety function", ha="center", fontsize=9.5)
    axes.plot((6.7, 8.5), (0.8, 0.8), color=ORANGE, linewidth=1.4)
    axes.text(7.6, 0.3, "set up, read back", ha="center", fontsize=9.5)
    axes.plot((8.9, 10.7), (0.8, 0.8), color=BAD, linewidth=1.4)
    axes.text(9.8, 0.3, "your part", ha="center", fontsize=9.5)
    axes.text(
        0.1, 3.3, "each layer must stop the axis without help from the layers on its left", fontsize=9.5, color=QUIET
    )
    return figure
