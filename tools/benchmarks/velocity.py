"""The benefit of an estimated velocity: what `tune` writes for the drive's velocity and for the estimate, same margins.

  .venv/bin/python tools/benchmarks/velocity.py [--seeds N] [--duration-s S]

The paper's scenario with friction 10 % wrong, with a flat reference and with f^-0.5, on two tracking loops of the drive
(the end-to-end delay is 3 ms with both). Each law is an axis file that `tune` wrote for the example's axis file with
this `velocity:` section, run as it is. Then the drive's velocity and the estimate on sensors of three speeds, whose
position has white or coloured noise. Writes results/velocity.md beside this file.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, get_args

import numpy as np
import yaml
from chain_files import TUNED, in_this_process, tuned_file
from common import RESULTS, ROOT, made_by, progress_bar

from fffo_drive.config.axis import AxisFile, read_axis
from fffo_drive.config.checks import law_margins, rest_margins
from fffo_drive.config.scenario import ControllerVariant, Scenario, cases_of, read_scenario
from fffo_drive.config.sections import VelocitySection, VelocitySource
from fffo_drive.control.envelope import TRIP_NONE, TRIP_TEXTS
from fffo_drive.evaluation.campaign import Case, simulate, warm_up
from fffo_drive.evaluation.compare import MetricComparison, compare_metric
from fffo_drive.evaluation.measures import measure
from fffo_drive.evaluation.reversal import FAST_RPS2
from fffo_drive.evaluation.trace import trace_of
from fffo_drive.evaluation.workers import over_cores
from fffo_drive.identification.estimate_gain import WORTH_ERROR_RATIO, EstimateWorth
from fffo_drive.model.parameters import write_model
from fffo_drive.runtime.tick import FLAG_ESTIMATED_VELOCITY

SCENARIO = ROOT / "configs" / "scenarios" / "paper_wrong_friction.yaml"
TRACKING_HZ = {"fast sensor": 400.0, "slow sensor": 179.0}  # the second one lags by 1.6 ms
SPEEDS_HZ = (1000.0, 400.0, 200.0)  # of tracking loops, with each of these noises
NOISES: dict[str, dict[str, float]] = {
    "as it is": {},
    "coloured: converter's noise x 4, behind the tracking loop": {"noise_rev": 6e-5},
    "white: position of 13 bits": {"bits": 13},
}
SLOPES = {"flat": 0.0, "f^-0.5": -0.5}
BANDWIDTHS_HZ = (100.0, 200.0, 300.0, 390.0)
DEFAULT_HZ = VelocitySection().bandwidth_hz
WRONG_INERTIA = (0.7, 1.4)  # of the model
BASE, PLUS = "PI+FFFO, drive", "PI+FFFO+, drive"
ESTIMATED = "estimated"
SEEDS, DURATION_S = 6, 40.0


class Found(NamedTuple):
    """One run."""

    true_ise: float
    crossing_mrps: float  # mean magnitude of the true error at slow reversals
    step_rms_a: float  # of the command, from tick to tick
    estimated_share: float  # of the ticks in which the error took the estimate


def with_sensor(tracking_hz: float, slope: float, duration_s: float, seeds: int) -> Scenario:
    """The scenario on a drive whose tracking loop is so fast; the model knows its lag."""
    scenario = read_scenario(SCENARIO)
    lag_s = scenario.plant.resolver.tracking_damping / (math.pi * tracking_hz)  # type: ignore[union-attr]
    sensor = scenario.model.sensor_delay_s.model_copy(update={"value": lag_s})
    plant: Any = scenario.plant
    resolver = plant.resolver.__class__(**{**vars(plant.resolver), "tracking_hz": tracking_hz})
    reference = scenario.file.reference.model_copy(update={"slope": slope, "duration_s": duration_s})  # type: ignore[union-attr]
    return scenario._replace(
        model=scenario.model.model_copy(update={"sensor_delay_s": sensor, "content_hash": None}),
        plant=plant.__class__(**{**vars(plant), "resolver": resolver}),
        file=scenario.file.model_copy(update={"reference": reference, "seeds": seeds}),
    )


def tuned(scenario: Scenario, law: dict[str, Any]) -> AxisFile:
    """What `tune` writes for the example's axis file with these keys of its law, and the scenario's model."""
    with TemporaryDirectory(prefix="tuned_") as place:
        data = yaml.safe_load(scenario.axis_path.read_text(encoding="utf-8"))
        data["controller"] |= law
        data["drive"]["file"] = str(scenario.axis_path.parent / data["drive"]["file"])
        axis, model = Path(place) / "axis.yaml", Path(place) / "model.yaml"
        write_model(model, scenario.model)
        axis.write_text(yaml.safe_dump(data | {"model": model.name}), encoding="utf-8")
        return read_axis(tuned_file(axis, model))


def laws(scenario: Scenario) -> dict[str, AxisFile]:
    """Everything that is compared on one sensor."""
    found = {BASE: scenario.axis, PLUS: tuned(scenario, {})}
    for bandwidth_hz in BANDWIDTHS_HZ:
        velocity = {"source": "estimated", "bandwidth_hz": bandwidth_hz}
        found[f"{ESTIMATED} {bandwidth_hz:g} Hz"] = tuned(scenario, {"velocity": velocity})
        without = tuned(scenario, {"velocity": velocity, "error_filter_s": 0.0})
        found[f"{ESTIMATED} {bandwidth_hz:g} Hz, no filter"] = without
    return found


def run_case(case: Case) -> dict[str, Found]:
    """All controllers on one seed. Raises RuntimeError for a run that tripped."""
    found = {}
    for candidate in case.candidates:
        rows, trip = simulate(case, candidate)
        if trip != TRIP_NONE:
            raise RuntimeError(f"{candidate.name}, seed {case.seed}: {TRIP_TEXTS[trip]}")
        trace = trace_of(rows, case.profile.period_s, case.profile.values.size)
        true = measure([trace], case.yardstick).true
        assert true is not None
        in_profile = rows[(rows["profile_sample"] >= 0) & (rows["profile_sample"] < case.profile.values.size)]
        found[candidate.name] = Found(
            true.error.ise,
            true.crossing.slow_error_mrps,
            float(np.sqrt(np.mean(np.diff(trace.command_a) ** 2))),
            float(np.mean(in_profile["flags"] & FLAG_ESTIMATED_VELOCITY != 0)),
        )
    return found


def evaluate(scenario: Scenario, axes: dict[str, AxisFile], text: str) -> dict[str, list[Found]]:
    """All laws on all seeds."""
    jobs = []
    for name, axis in axes.items():
        variant = ControllerVariant(law="paper" if name == BASE else "axis", toggle="ff")
        file = scenario.file.model_copy(update={"controllers": {name: variant}, "percent_of": None})
        jobs += cases_of(scenario._replace(axis=axis, file=file))
    warm_up(jobs[0])
    with progress_bar(text) as progress:
        done = None if progress is None else (lambda number: progress(number / len(jobs)))
        found = over_cores(run_case, jobs, progress=done)
    return {name: [one[name] for one in found if name in one] for name in axes}


def percent(comparison: MetricComparison, name: str) -> str:
    """12.3 [11.0, 13.6]"""
    value = comparison.percent[name]
    return f"{value.value:.3g} [{value.low:.3g}, {value.high:.3g}]"


def table(sensor: str, duration_s: float, seeds: int) -> list[str]:
    """Markdown of one sensor."""
    scenarios = {text: with_sensor(TRACKING_HZ[sensor], slope, duration_s, seeds) for text, slope in SLOPES.items()}
    first = next(iter(scenarios.values()))
    axes = laws(first)
    runs = {text: evaluate(one, axes, f"{sensor}, {text}") for text, one in scenarios.items()}
    ises = {
        (text, base): compare_metric(
            {name: np.array([run.true_ise for run in own]) for name, own in found.items()}, base
        )
        for text, found in runs.items()
        for base in (BASE, PLUS)
    }
    heads = " | ".join(f"{text}: true ISE | of {PLUS} | at the crossing, mrps | rms of step, mA" for text in runs)
    lines = [
        f"## {sensor}: the drive's velocity lags by {1e3 * first.model.sensor_delay_s.value:.2f} ms",
        "",
        f"| controller | {heads} | phase, gain margin | at rest |",
        "|---|" + 4 * "---|" * len(runs) + "---|---|",
    ]
    for name, axis in axes.items():
        cells = []
        for text, found in runs.items():
            ran = Found(*np.mean(found[name], axis=0))
            percents = [percent(ises[text, base], name) for base in (BASE, PLUS)]
            cells += [*percents, f"{ran.crossing_mrps:.2f}", f"{1e3 * ran.step_rms_a:.1f}"]
        margins = law_margins(axis, first.model, True), rest_margins(axis, first.model)
        cells += [f"{one.phase_deg:.1f} deg, {one.gain:.2f}" for one in margins]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    shares = [
        run.estimated_share for found in runs.values() for name in found for run in found[name] if ESTIMATED in name
    ]
    return [*lines, "", f"The estimate was in use in at least {min(shares):.2%} of the ticks of a run.", ""]


def chosen(scenario: Scenario, resolver: dict[str, float]) -> tuple[dict[str, AxisFile], EstimateWorth]:
    """What `tune` writes with each velocity after `commission` on this resolver, and what it counts to choose."""
    with TemporaryDirectory(prefix="tuned_") as name:
        place = Path(name)
        data = yaml.safe_load(scenario.axis_path.read_text(encoding="utf-8"))
        drive = yaml.safe_load((scenario.axis_path.parent / data["drive"]["file"]).read_text(encoding="utf-8"))
        drive["plant"]["resolver"] = resolver
        (place / "drive.yaml").write_text(yaml.safe_dump(drive), encoding="utf-8")
        data |= {"model": "model.yaml", "drive": data["drive"] | {"file": "drive.yaml"}}
        axis, model = place / "axis.yaml", place / "model.yaml"
        axis.write_text(yaml.safe_dump(data), encoding="utf-8")
        write_model(model, scenario.model)
        in_this_process("commission", axis, "--yes")
        in_this_process("commission", axis, "--accept")
        out = place / TUNED
        said = in_this_process("tune", model, "--axis", axis, "--out", out, "--json")
        axes = {}
        for source in get_args(VelocitySource):
            in_this_process("tune", model, "--axis", axis, "--out", out, "--velocity", source)
            axes[source] = read_axis(out / axis.name)
        return axes, EstimateWorth(**said["on_the_estimate"])


def noise(duration_s: float, seeds: int) -> list[str]:
    """Markdown: what the estimate gains and what its command costs, by the speed of the sensor and its noise."""
    lines = [
        "## By sensor and noise",
        "",
        f"`tune` on the drive's velocity and on the estimate of {DEFAULT_HZ:g} Hz, after `commission` on this sensor;",
        "true ISE in per cent of that on the drive's. Predicted: the squared error by friction outside the model and",
        f"by the noise that `commission` measured; below {100.0 * WORTH_ERROR_RATIO:g} % `tune` takes the estimate.",
        "Steps of the command from tick to tick: rms over both references; predicted: by the measured noise alone.",
        "",
        "| tracking loop | noise of the position | predicted | taken | true ISE, flat | true ISE, f^-0.5 | "
        "step, mA: drive | estimated | ratio | predicted: drive | estimated |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    name = f"{ESTIMATED} {DEFAULT_HZ:g} Hz"
    for tracking_hz in SPEEDS_HZ:
        right = with_sensor(tracking_hz, 0.0, duration_s, seeds)
        for text, changes in NOISES.items():
            both, worth = chosen(right, {"tracking_hz": tracking_hz, **changes})
            axes = {PLUS: both["drive"], name: both["estimated"]}
            cells, steps_a = [], []
            for slope in SLOPES.values():
                scenario = with_sensor(tracking_hz, slope, duration_s, seeds)
                plant: Any = scenario.plant
                plant = replace(plant, resolver=replace(plant.resolver, **changes))
                runs = evaluate(scenario._replace(plant=plant), axes, f"{tracking_hz:g} Hz, {text}")
                ises = {key: np.array([run.true_ise for run in found]) for key, found in runs.items()}
                cells.append(percent(compare_metric(ises, PLUS), name))
                steps_a.append([float(np.mean([run.step_rms_a for run in found])) for found in runs.values()])
            drive_a, estimated_a = np.mean(steps_a, axis=0)
            assert worth.drive_step_a is not None
            lines.append(
                f"| {tracking_hz:g} Hz, {1e3 * right.model.sensor_delay_s.value:.2f} ms | {text} | "
                f"{100.0 * worth.error_ratio:.0f} | {'yes' if worth.gains else 'no'} | {cells[0]} | {cells[1]} | "
                f"{1e3 * drive_a:.1f} | {1e3 * estimated_a:.1f} | {estimated_a / drive_a:.2f} | "
                f"{1e3 * worth.drive_step_a:.1f} | {1e3 * worth.step_a:.1f} |"
            )
    return [*lines, ""]


def wrong_inertia(sensor: str, duration_s: float, seeds: int) -> list[str]:
    """Markdown of one sensor: a model with another inertia, which feed-forward and estimate believe alike."""
    right = with_sensor(TRACKING_HZ[sensor], SLOPES["flat"], duration_s, seeds)
    axes = {name: axis for name, axis in laws(right).items() if name != BASE}
    lines = [
        f"## {sensor}, flat: inertia of the model wrong",
        "",
        f"| controller | {' | '.join(f'x {factor:g}: true ISE of {PLUS}' for factor in WRONG_INERTIA)} |",
        "|---|" + "---|" * len(WRONG_INERTIA),
    ]
    found = []
    for factor in WRONG_INERTIA:
        mismatch = right.file.mismatch.model_copy(update={"factors": {"inertia_kg_m2": factor}})
        scenario = right._replace(file=right.file.model_copy(update={"mismatch": mismatch}))
        runs = evaluate(scenario, axes, f"{sensor}, J x {factor:g}")
        found.append(
            compare_metric({name: np.array([run.true_ise for run in own]) for name, own in runs.items()}, PLUS)
        )
    lines += [f"| {name} | " + " | ".join(percent(one, name) for one in found) + " |" for name in axes]
    return [*lines, ""]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="of each scenario (%(default)s)")
    parser.add_argument("--duration-s", type=float, default=DURATION_S, help="of each run (%(default)s)")
    options = parser.parse_args(arguments)
    lines = [
        "# Velocity from position and torque",
        "",
        f"{options.seeds} seeds of {options.duration_s:g} s each, friction 10 % wrong with random signs,",
        "five surfaces, 3 ms end to end. True ISE in per cent of PI+FFFO and of PI+FFFO+ on the drive's velocity, 95 %",
        "intervals over resampled seeds. PI+FFFO has the paper's gains; each other law is the axis file that `tune`",
        "wrote for the example's with this `velocity:` section; no filter: with `error_filter_s: 0` too. Each margin",
        "is the smaller one of the two cuts (fffo_drive/control/stability.py).",
        f"{DEFAULT_HZ:g} Hz is the default. At the crossing: mean magnitude of the true error at reversals slower than",
        f"{FAST_RPS2:g} rps/s.",
        "",
    ]
    for sensor in TRACKING_HZ:
        lines += table(sensor, options.duration_s, options.seeds)
    lines += noise(options.duration_s, options.seeds)
    for sensor in TRACKING_HZ:
        lines += wrong_inertia(sensor, options.duration_s, options.seeds)
    lines.append(made_by("velocity.py"))
    (RESULTS / "velocity.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
