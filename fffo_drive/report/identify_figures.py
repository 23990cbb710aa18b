"""The figures of an identification: model against measurement (Fig. 3), residuals (Fig. 4) and the friction curve."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..identification.coordinates import PARAMETERS, axis_of, physical_slope, to_physical
from ..identification.fit import Fit
from ..identification.residuals import BLOCK_S, LONGEST_LAG, RunResidual, effective_samples, sampling_step
from ..model.friction import steady_friction_nm
from ..units import NORMAL_95, text_on
from .document import significant
from .figures import FREQUENCY, TIME, Figure, LevelLine, PlotAxis, Series, Uniform, histogram, normal_curve

COLOURS = ("blue", "orange", "green", "purple", "grey", "ink")
LONGEST = 12_000  # points of one record on the page
SCATTER = 2500  # points of a scatter
CUTOUT_S = 1.5
CURVE_POINTS = 121
CURVE_DRAWS = 400
FRICTION_BINS = 14
LEAST_IN_BIN = 40


class IdentifyWords(NamedTuple):
    """Names and units of the quantities on this kind of axis."""

    torque: str = "torque"
    torque_unit: str = "Nm"
    position_unit: str = "rev"
    velocity_unit: str = "rps"
    damping_unit: str = "Nm/rps"
    command: str = "current"
    command_unit: str = "A"
    linear: bool = False

    @property
    def inertia(self) -> str:
        """The letter of it: of a linear axis that of the mass."""
        return "M" if self.linear else "J"

    def text(self, rotary: str) -> str:
        """A sentence about a rotary axis in the words of this one."""
        return text_on(rotary, self.linear)

    def velocity(self, name: str = "velocity") -> PlotAxis:
        """An axis of velocities."""
        return PlotAxis(name, self.velocity_unit)

    def residual(self) -> PlotAxis:
        """An axis of residuals."""
        return PlotAxis(f"{self.torque} residual", self.torque_unit)


def figure_name(prefix: str, record: str) -> str:
    """An address in the page, made from a record's name."""
    return f"{prefix}-{re.sub(r'[^A-Za-z0-9]+', '-', record).strip('-') or 'run'}"


def free_velocities(run: RunResidual) -> tuple[Uniform, Floats, Floats]:
    """Measured and simulated velocity of the free windows on one grid: (n,) each, NaN between and where nothing moves.

    The measured one is the mean over a block, from the position; the simulation restarts with every window.
    """
    record = run.record
    block = max(1, round(BLOCK_S / record.period_s))
    blocks = record.samples // block
    measured, simulated = np.full(blocks, np.nan), np.full(blocks, np.nan)
    length = run.velocity_errors_rps.shape[1]
    for begin_s, errors in zip(run.begins_s, run.velocity_errors_rps, strict=True):
        first = round((begin_s - record.begin_s) / record.period_s)
        part = record.position_rev[first : first + (length + 1) * block].reshape(length + 1, block)
        place = first // block
        own = np.diff(part.mean(axis=1))[: blocks - place] / (block * record.period_s)
        measured[place : place + own.size] = own
        simulated[place : place + own.size] = own - errors[: own.size]
    return Uniform(record.begin_s, block * record.period_s), measured, simulated


def course_figures(run: RunResidual, words: IdentifyWords) -> list[Figure]:
    """One record: command, velocity measured and simulated, torque residual. They zoom together."""
    record, found = run.record, run.torque
    grid, measured, simulated = free_velocities(run)
    time = Uniform(record.begin_s, record.period_s)
    residual = np.full(record.samples, np.nan)
    places = np.rint((found.time_s - record.begin_s) / record.period_s).astype(np.int64)
    residual[places] = np.where(found.kept, found.residual_nm, np.nan)
    group = figure_name("time", record.name)
    parts: list[tuple[str, str, PlotAxis, tuple[Series, ...], int]] = [
        ("command", f"Command in {record.name}.", PlotAxis(words.command, words.command_unit),
         (Series("command", time, record.current_a, "ink", weight=1.0, finest=LONGEST),), 170),
        ("velocity", "Measured (derivative of the position over 5 ms) and simulated freely for 0.2 s at a time; "
         "windows at standstill are left out.", words.velocity(),
         (Series("measured", grid, measured, "orange", weight=2.4, finest=LONGEST),
          Series("simulated", grid, simulated, "blue", dash="dashed", weight=1.2, finest=LONGEST)), 240),
        ("residual", f"As in the paper's Fig. 4: Kt i(t − Td) − {words.inertia} a − F, all through the same 40 Hz "
         f"filter; standstill is left out. {record.name}.", words.residual(),
         (Series("residual", time, residual, "blue", weight=1.0, finest=LONGEST),), 200),
    ]  # fmt: skip
    return [
        Figure(
            name=figure_name(kind, record.name), kind="time", title=f"{record.name}: {kind}", caption=caption, x=TIME,
            y=axis, series=series, height_px=height, group=group,
        )
        for kind, caption, axis, series, height in parts
    ]  # fmt: skip


def cutout_figures(run: RunResidual, words: IdentifyWords) -> list[Figure]:
    """Fig. 3: two stretches of a record, one with slow reversals and one with the fastest motion."""
    grid, measured, simulated = free_velocities(run)
    length = min(measured.size, round(CUTOUT_S / grid.step))
    begins = np.arange(0, measured.size - length + 1, max(1, length // 4))
    windows = [measured[b : b + length] for b in begins]
    full = np.array([np.isfinite(w).mean() > 0.8 for w in windows])
    if not full.any():
        return []
    peak = np.array([np.nanmax(np.abs(w)) if ok else np.nan for w, ok in zip(windows, full, strict=True)])
    swing = np.array([min(np.nanmax(w), -np.nanmin(w)) if ok else -1.0 for w, ok in zip(windows, full, strict=True)])
    fast = int(np.nanargmax(peak))
    share = 0.05 * peak[fast]
    gentle = np.where((swing > 0.2 * peak) & (swing > 0.0), np.abs(np.log(peak / share)), np.inf)
    chosen = [("slow reversals", int(np.argmin(gentle)))] if np.isfinite(gentle).any() else []
    chosen.append(("fastest motion", fast))
    figures = []
    for number, (kind, place) in enumerate(chosen):
        begin = int(begins[place])
        part = slice(begin, begin + length)
        shown = Uniform(grid.start + begin * grid.step, grid.step)
        figures.append(
            Figure(
                name=figure_name(f"cutout-{number + 1}", run.record.name), kind="time",
                title=f"{run.record.name}: {kind}",
                caption=f"{CUTOUT_S:g} s from {shown.start:.4g} s; the simulation restarts every 0.2 s.",
                x=TIME, y=words.velocity(), width="half", height_px=220,
                series=(
                    Series("measured", shown, measured[part], "orange", weight=2.4),
                    Series("simulated", shown, simulated[part], "blue", dash="dashed", weight=1.3),
                ),
            )
        )  # fmt: skip
    return figures


def histogram_figure(run: RunResidual, words: IdentifyWords) -> Figure:
    """Fig. 4: distribution of the torque residual against a normal one of the same mean and deviation."""
    values = run.torque.residual_nm[run.torque.kept]
    limit = float(np.quantile(np.abs(values), 0.998)) if values.size else 1.0
    edges = np.linspace(-max(limit, 1e-12), max(limit, 1e-12), 62)
    return Figure(
        name=figure_name("histogram", run.record.name), kind="histogram", title=f"{run.record.name}: distribution",
        caption="Share of all moving samples in each bin, and a normal distribution of the same mean and deviation.",
        x=words.residual(), y=PlotAxis("share of samples", "%"), width="half", height_px=220,
        series=(histogram("residual", values, edges, "blue"), normal_curve("normal", values, edges)),
    )  # fmt: skip


def autocorrelation_figure(runs: Sequence[RunResidual], words: IdentifyWords) -> Figure:
    """Autocorrelation of the residual, with the band of white noise."""
    series, smallest = [], np.inf
    step_s = 0.0
    for number, run in enumerate(runs):
        values = run.torque.residual_nm[run.torque.kept][:: sampling_step(run.record.period_s)]
        step_s = sampling_step(run.record.period_s) * run.record.period_s
        if values.size < 50:
            continue
        correlation = effective_samples(values, LONGEST_LAG // 4)[1]
        smallest = min(smallest, float(values.size))
        colour = COLOURS[number % len(COLOURS)]
        series.append(Series(run.record.name, Uniform(0.0, step_s), correlation, colour, dash=_dash(number)))
    bound = NORMAL_95 / np.sqrt(smallest)
    return Figure(
        name="autocorrelation", kind="time", title=f"Autocorrelation of the {words.torque} residual",
        caption="The 40 Hz filter alone correlates neighbours within 0.01 s. Longer correlation comes from a rough "
                "surface, or from an effect that the model lacks. Dashed: 95 % of white noise.",
        x=PlotAxis("lag", "s"), y=PlotAxis("correlation", "-"), series=tuple(series), height_px=220,
        levels=(LevelLine(bound, "white"), LevelLine(-bound, "")),
    )  # fmt: skip


def over_speed_figure(run: RunResidual, words: IdentifyWords) -> Figure:
    """Torque residual over velocity, sliding and presliding apart."""
    series = []
    for name, mask, colour in (("sliding", run.sliding, "blue"), ("presliding", run.presliding, "orange")):
        places = np.flatnonzero(mask)
        places = places[:: max(1, -(-places.size // SCATTER))]
        if places.size:
            v, r = run.torque.velocity_rps[places], run.torque.residual_nm[places]
            series.append(Series(name, v, r, colour, "points", finest=SCATTER))
    means = _binned(run.torque.velocity_rps[run.sliding], run.torque.residual_nm[run.sliding])
    if means is not None:
        series.append(Series("mean, sliding", means[0], means[1], "ink", weight=1.8))
    return Figure(
        name=figure_name("speed", run.record.name), kind="xy",
        title=f"{run.record.name}: residual over velocity",
        caption="A mean different from zero is friction that the model lacks; presliding: the first "
                f"{significant(run.presliding_rev)} {words.position_unit} after a reversal.",
        x=words.velocity(), y=words.residual(), series=tuple(series), width="half", height_px=240,
    )  # fmt: skip


def _binned(x: Floats, y: Floats, bins: int = 40) -> tuple[Floats, Floats] | None:
    """Means of y in bins of x with as many samples each; None with too few samples."""
    if x.size < bins * LEAST_IN_BIN:
        return None
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, bins)
    return np.array([x[p].mean() for p in parts]), np.array([y[p].mean() for p in parts])


def by_frequency_figure(summaries: dict[str, dict[str, Any]], words: IdentifyWords) -> Figure:
    """Residual by octaves of frequency, beside the torque itself."""
    series = []
    for number, (name, run) in enumerate(summaries.items()):
        rows = run["by_frequency"]
        at = np.array([np.sqrt(row["low_hz"] * row["high_hz"]) for row in rows])
        colour = COLOURS[number % len(COLOURS)]
        series.append(Series(f"residual, {name}", at, np.array([row["rms_nm"] for row in rows]), colour))
        torque = np.array([row["torque_rms_nm"] for row in rows])
        series.append(Series(f"{words.torque}, {name}", at, torque, colour, dash="dotted"))
    return Figure(
        name="by-frequency", kind="xy", title="Error by frequency",
        caption=f"Rms of residual and {words.torque} in octaves.", x=FREQUENCY,
        y=PlotAxis(f"{words.torque}, rms", words.torque_unit, log=True), series=tuple(series), height_px=220,
    )  # fmt: skip


def by_speed_figure(summaries: dict[str, dict[str, Any]], words: IdentifyWords) -> Figure:
    """Residual by speed, sliding and presliding apart."""
    series = []
    for number, (name, run) in enumerate(summaries.items()):
        colour = COLOURS[number % len(COLOURS)]
        for regime, dash in (("sliding", "solid"), ("presliding", "dashed")):
            rows = [row for row in run["by_speed"] if row[f"{regime}_rms_nm"] > 0.0]
            if rows:
                at = np.array([np.sqrt(row["low_rps"] * row["high_rps"]) for row in rows])
                values = np.array([row[f"{regime}_rms_nm"] for row in rows])
                series.append(
                    Series(f"{regime}, {name}", at, values, colour, dash="solid" if dash == "solid" else "dashed")
                )
    return Figure(
        name="by-speed", kind="xy", title="Error by amplitude and regime",
        caption="Rms of the residual in bins of speed.",
        x=PlotAxis("speed", words.velocity_unit, log=True), y=PlotAxis("residual, rms", words.torque_unit, log=True),
        series=tuple(series), height_px=220,
    )  # fmt: skip


def friction_band(fit: Fit, speeds: Floats) -> tuple[Floats, Floats, Floats]:
    """Steady friction over speed, and the ends of its 95 % band: draws of the parameters with their correlation."""
    u, space = fit.uncertainty, fit.space
    slope = physical_slope(fit.solution.values, space.scale)
    sd = np.minimum(u.sd / slope, 2.0)
    curvature, directions = np.linalg.eigh(u.correlation * np.outer(sd, sd))
    root = directions * np.sqrt(np.maximum(curvature, 0.0))
    normal = np.random.default_rng(1).standard_normal((CURVE_DRAWS, sd.size))
    drawn = np.clip(fit.solution.values + normal @ root.T, space.low, space.high)
    curves = np.array([_steady(to_physical(values, space.scale), speeds) for values in drawn])
    low, high = np.percentile(curves, [2.5, 97.5], axis=0)
    return _steady(fit.physical, speeds), low, high


def _steady(physical: Floats, speeds: Floats) -> Floats:
    friction = axis_of(physical, 1.0)[0].friction
    return np.array([steady_friction_nm(friction, float(speed)) for speed in speeds])


def friction_figure(fit: Fit, runs: Sequence[RunResidual], words: IdentifyWords) -> Figure:
    """Stribeck curve with its band, and the friction in the records at each speed, both ways."""
    speed = np.concatenate([np.abs(run.torque.velocity_rps[run.sliding]) for run in runs])
    highest = float(speed.max()) if speed.size else 1.0
    vs = float(fit.physical[PARAMETERS.index("stribeck_velocity_rps")])
    speeds = np.geomspace(min(0.02 * vs, 0.01 * highest), highest, CURVE_POINTS)
    curve, low, high = friction_band(fit, speeds)
    outline = np.concatenate([speeds, speeds[::-1]])
    series = [
        Series("95 % band", outline, np.concatenate([low, high[::-1]]), "grey", dash="dashed", weight=1.0),
        Series("model, steady", speeds, curve, "blue", weight=2.0),
    ]
    for name, sign, colour in (("forward", 1.0, "green"), ("backward", -1.0, "orange")):
        points = _measured_friction(runs, sign, speeds[0], highest)
        if points is not None:
            series.append(Series(name, points[0], points[1], colour, "points", low=points[2], high=points[3]))
    return Figure(
        name="friction", kind="xy", title="Friction over speed",
        caption=f"Steady curve of the model with the 95 % band of its parameters; points: {words.torque} minus "
                f"{words.inertia} a in the logs while sliding, mean of each bin; whiskers: its middle 90 %. The "
                "points contain frictional lag, the curve does not.",
        x=PlotAxis("speed", words.velocity_unit, log=True), y=PlotAxis(f"friction {words.torque}", words.torque_unit),
        series=tuple(series), height_px=300,
    )  # fmt: skip


def _measured_friction(
    runs: Sequence[RunResidual], sign: float, low: float, high: float
) -> tuple[Floats, Floats, Floats, Floats] | None:
    v = np.concatenate([run.torque.velocity_rps[run.sliding] for run in runs]) * sign
    f = np.concatenate([(run.torque.residual_nm + run.torque.friction_nm)[run.sliding] for run in runs]) * sign
    number = np.digitize(v, np.geomspace(low, high * 1.0001, FRICTION_BINS + 1))
    rows = []
    for k in range(1, FRICTION_BINS + 1):
        inside = number == k
        if inside.sum() >= LEAST_IN_BIN:
            rows.append([v[inside].mean(), f[inside].mean(), *np.percentile(f[inside], [5.0, 95.0])])
    if not rows:
        return None
    columns = np.array(rows).T
    return columns[0], columns[1], columns[2], columns[3]


def _dash(number: int) -> Any:
    return ("solid", "dashed", "dashdot", "dotted")[number % 4]
