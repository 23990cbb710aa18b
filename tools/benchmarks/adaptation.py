"""Adaptation over a warm-up: the example axis with the initial model, with `controller.adaptation: {enabled: true}`,
and with a model fitted to each minute.

  .venv/bin/python tools/benchmarks/adaptation.py [--minutes N] [--seeds N]

A day of warm-up in half an hour: the drive's thermal time constant is ten minutes instead of hours, so that friction
changes faster than on a machine. After a third of the time the load falls, after two thirds it returns. The error of a
minute is compared with that of the same minute under a model whose level and viscous friction were fitted by least
squares to the rows of that minute. Writes results/adaptation.md beside this file.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from common import RESULTS, ROOT, made_by, progress_bar

from fffo_drive.config.axis import AxisFile, beside, build_profile, model_of, read_axis
from fffo_drive.config.profile_sections import PaperProfile
from fffo_drive.config.sections import AdaptationSection
from fffo_drive.config.session import session_config
from fffo_drive.config.simulated import read_simulated
from fffo_drive.control.adaptation import EXCITED_SHARE, adaptation_at_start, adapted_torque
from fffo_drive.control.envelope import TRIP_NONE, TRIP_TEXTS
from fffo_drive.control.friction_observer import TOGGLE_FEEDFORWARD
from fffo_drive.control.reference import MODE_VELOCITY, Profile
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.drive.simulated.parameters import PlantConfig, ThermalConfig
from fffo_drive.evaluation.workers import over_cores
from fffo_drive.model.parameters import ModelFile
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime.runs import simulated_ring_rows
from fffo_drive.runtime.session import Session

AXIS = ROOT / "configs" / "axis_simulated.yaml"
KINDS = {"five surfaces": "five_surfaces", "single surface": "single_2sep"}
DEFAULT_S = AdaptationSection().time_s
TIMES_S = (10.0, DEFAULT_S, 100.0)
THERMAL = ThermalConfig(
    k_per_w=16.0, time_constant_s=600.0, viscous_per_k=-0.03, coulomb_per_k=-0.02, offset_nm_per_k=0.0001
)
MINUTE_S = 60.0
FAST_RPS, SLOW_RPS = 15.0, 6.0
SKIPPED_S = 3.0  # of a minute: it begins with a jump of the reference in one loop, and from rest in the other
BEGUN = 3  # minutes that are left out: nothing can have been learned yet
ASKED = 1.2


class WarmUp(NamedTuple):
    """One axis and seed."""

    kind: str
    seed: int
    minutes: int


class Found(NamedTuple):
    """Mean squared true error of each minute, (minutes,), rps^2."""

    fitted: np.ndarray[Any, Any]
    initial: np.ndarray[Any, Any]
    adapted: dict[float, np.ndarray[Any, Any]]  # by T
    change: tuple[float, float]  # fitted at the end over the model: level, viscous


def axis_with(adaptation: AdaptationSection) -> AxisFile:
    """The example's axis file with this section, whose other keys are their defaults."""
    axis = read_axis(AXIS)
    return axis.model_copy(update={"controller": axis.controller.model_copy(update={"adaptation": adaptation})})


def minutes_of(warm_up: WarmUp, period_s: float) -> list[Profile]:
    """A profile for each minute."""
    made: dict[float, Profile] = {}
    for high_rps in (FAST_RPS, SLOW_RPS):
        section = PaperProfile(kind="paper", duration_s=MINUTE_S, high_rps=high_rps, slope=0.0, seed=warm_up.seed)
        made[high_rps] = build_profile(section, period_s)
    slow = range(warm_up.minutes // 3, 2 * warm_up.minutes // 3)
    return [made[SLOW_RPS if k in slow else FAST_RPS] for k in range(warm_up.minutes)]


def plant_of(axis: AxisFile, warm_up: WarmUp) -> PlantConfig:
    """The axis' plant, which warms up."""
    plant = read_simulated(beside(AXIS, axis.drive.file)).plant  # type: ignore[union-attr]
    friction = replace(plant.friction, kind=KINDS[warm_up.kind])
    return replace(plant, friction=friction, thermal=THERMAL, seed=warm_up.seed)


def squared_error(rows: Any, rate_hz: int) -> float:
    """Mean squared true error of a minute without its beginning."""
    acting = rows[(rows["mode"] == MODE_VELOCITY) & (rows["profile_sample"] >= 0)]
    acting = acting[round(SKIPPED_S * rate_hz) : round(MINUTE_S * rate_hz)]  # without braking at its end
    return float(np.mean((acting["reference_rps"] - acting["true_velocity_rps"]) ** 2))


def in_one_loop(warm_up: WarmUp, adaptation: AdaptationSection, model: ModelFile) -> list[Any]:
    """Rows of each minute of one uninterrupted loop. Raises RuntimeError for a trip."""
    axis = axis_with(adaptation)
    minutes = minutes_of(warm_up, axis.loop.period_s)
    whole = minutes[0]._replace(
        values=np.concatenate([one.values for one in minutes]),
        derivatives=np.concatenate([one.derivatives for one in minutes]),
    )
    drive = SimulatedDrive(plant_of(axis, warm_up))
    drive.connect()
    rows = simulated_ring_rows(whole, axis.loop.tail_s)
    with Session(drive, session_config(axis, model, whole.values.size, rows)) as session:
        session.run_profile(whole, TOGGLE_FEEDFORWARD)
        if session.status(b.TRIP) != TRIP_NONE:
            raise RuntimeError(f"{warm_up}: {TRIP_TEXTS[session.status(b.TRIP)]}")
        rows = RingReader(session.ring).read().rows
    running = rows[rows["profile_sample"] >= 0]
    edges = np.cumsum([one.values.size for one in minutes])
    return [running[end - one.values.size : end] for end, one in zip(edges, minutes, strict=True)]


def fitted_model(model: ModelFile, rows: Any) -> ModelFile:
    """Level and viscous friction by least squares on what P and I gave in these rows."""
    acting = rows[rows["mode"] == MODE_VELOCITY]
    friction, start = model.friction_config(), adaptation_at_start()
    shape = [
        adapted_torque(friction, start, float(row["friction_nm"]), float(row["reference_ahead_rps"])).contact
        for row in acting[::10]
    ]
    part = acting[::10]
    design = np.column_stack((np.ones(part.size), shape, part["reference_ahead_rps"]))
    lacking_nm = model.torque_constant_nm_per_a * (part["proportional_a"] + part["integral_a"])
    _, coulomb_nm, viscous = np.linalg.lstsq(design, lacking_nm, rcond=None)[0]
    level = 1.0 + coulomb_nm / model.friction.coulomb_nm.value
    factors = {"coulomb_nm": level, "static_nm": level}
    factors["viscous_nm_per_rps"] = 1.0 + viscous / model.friction.viscous_nm_per_rps.value
    changed = {
        name: getattr(model.friction, name).model_copy(update={"value": factor * getattr(model.friction, name).value})
        for name, factor in factors.items()
    }
    return model.model_copy(update={"friction": model.friction.model_copy(update=changed), "content_hash": None})


def under_fitted(warm_up: WarmUp, models: list[ModelFile]) -> np.ndarray[Any, Any]:
    """The same warm-up, each minute under its own model: the plant continues, the law restarts."""
    axis = axis_with(AdaptationSection())
    minutes = minutes_of(warm_up, axis.loop.period_s)
    drive = SimulatedDrive(plant_of(axis, warm_up))
    drive.connect()
    found = []
    ring = simulated_ring_rows(minutes[0], axis.loop.tail_s)
    first = session_config(axis, models[0], minutes[0].values.size, ring)
    with Session(drive, first) as session:
        reader = RingReader(session.ring)
        for model, minute in zip(models, minutes, strict=True):
            session.set_controller(session_config(axis, model, minute.values.size, ring).controller)
            session.run_profile(minute, TOGGLE_FEEDFORWARD)
            if session.status(b.TRIP) != TRIP_NONE:
                raise RuntimeError(f"{warm_up}: {TRIP_TEXTS[session.status(b.TRIP)]}")
            found.append(squared_error(reader.read().rows, axis.loop.rate_hz))
    return np.array(found)


def measured(warm_up: WarmUp) -> Found:
    """All variants of one warm-up."""
    axis = read_axis(AXIS)
    model, rate_hz = model_of(AXIS, axis), axis.loop.rate_hz
    minutes = in_one_loop(warm_up, AdaptationSection(), model)
    models = [fitted_model(model, rows) for rows in minutes]
    last = models[-1].friction
    change = (
        last.coulomb_nm.value / model.friction.coulomb_nm.value,
        last.viscous_nm_per_rps.value / model.friction.viscous_nm_per_rps.value,
    )
    initial = np.array([squared_error(rows, rate_hz) for rows in minutes])
    del minutes
    fitted = under_fitted(warm_up, models)
    adapted = {}
    for time_s in TIMES_S:
        minutes = in_one_loop(warm_up, AdaptationSection(enabled=True, time_s=time_s), model)
        adapted[time_s] = np.array([squared_error(rows, rate_hz) for rows in minutes])
    return Found(fitted, initial, adapted, change)


def excited_shares() -> list[tuple[str, float, float]]:
    """(motion, share of c that an offset leaves, share of w_r that offset and c leave), steady friction, c = sgn w."""
    phase = np.linspace(0.0, 1.0, 20_001)[1:]
    trapezoid = np.clip(4.0 * np.abs((phase % 1.0) - 0.5) - 1.0, -0.8, 0.8)
    motions = {
        "sine about zero": np.sin(2.0 * np.pi * phase),
        "multi-sine": np.random.default_rng(1).normal(size=20_000),
        "to and fro, 90 % of the time at one speed": np.clip(10.0 * (4.0 * np.abs(phase - 0.5) - 1.0), -1.0, 1.0),
        "to and fro, 20 % of the time at one speed, else ramps": trapezoid,
        "one way, 1 % of the time back": np.where(phase < 0.99, 1.0, -1.0) * (1.0 + 0.3 * np.sin(20.0 * phase)),
    }
    found = []
    for name, w in motions.items():
        c = np.sign(w)
        design = np.column_stack((np.ones_like(c), c))
        rest = w - design @ np.linalg.lstsq(design, w, rcond=None)[0]
        found.append((name, float(np.var(c) / np.mean(c**2)), float(np.mean(rest**2) / np.mean(w**2))))
    return found


def table(warm_ups: list[WarmUp], found: list[Found]) -> list[str]:
    """Lines of the result."""
    lines = [
        "| axis, seed | friction level, viscous friction at the end, relative to the model | initial model | "
        + " | ".join(f"T = {time_s:g} s" for time_s in TIMES_S)
        + " |",
        "| --- | --- | --- |" + " --- |" * len(TIMES_S),
    ]
    for warm_up, one in zip(warm_ups, found, strict=True):
        cells = []
        for squared in (one.initial, *one.adapted.values()):
            ratio = np.sqrt(squared / one.fitted)[BEGUN:]
            cells.append(f"{np.median(ratio):.2f}, {ratio.max():.2f}")
        lines.append(
            f"| {warm_up.kind}, {warm_up.seed} | {one.change[0]:.2f}, {one.change[1]:.2f} | " + " | ".join(cells) + " |"
        )
    return lines


def run() -> int:
    """The command."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--minutes", type=int, default=30)
    options.add_argument("--seeds", type=int, default=2)
    options.add_argument("--workers", type=int, default=None, help="processes (default: one a core)")
    chosen = options.parse_args()
    warm_ups = [WarmUp(kind, seed, chosen.minutes) for kind in KINDS for seed in range(1, chosen.seeds + 1)]
    with progress_bar("adaptation") as progress:
        done = None if progress is None else (lambda number: progress(number / len(warm_ups)))
        found = over_cores(measured, warm_ups, progress=done, workers=chosen.workers)
    worst = max(float(np.sqrt(one.adapted[DEFAULT_S] / one.fitted)[BEGUN:].max()) for one in found)
    lines = [
        "# adaptation",
        "",
        f"RMS of the true error in each minute, relative to that with a model fitted to the minute: median and largest "
        f"of minutes {BEGUN + 1} to {chosen.minutes}. Target: at most {ASKED:g}. Measured with `enabled: true` alone "
        f"(T = {DEFAULT_S:g} s): {worst:.2f}.",
        "",
        *table(warm_ups, found),
        "",
        f"Excitation of typical motions. If a constant leaves more than EXCITED_SHARE = {EXCITED_SHARE:g} of c, offset "
        "and Coulomb friction are adapted; if a constant and c leave more than that of w_r, viscous friction too. "
        "Shares of power.",
        "",
        "| motion | c left | w_r left |",
        "| --- | --- | --- |",
        *(f"| {name} | {c:.3f} | {w:.3f} |" for name, c, w in excited_shares()),
        "",
        f"{THERMAL}. The first {BEGUN} minutes are left out, and the first {SKIPPED_S:g} s of each. "
        + made_by("adaptation.py"),
    ]
    text = "\n".join(lines) + "\n"
    (RESULTS / "adaptation.md").write_text(text, encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    raise SystemExit(run())
