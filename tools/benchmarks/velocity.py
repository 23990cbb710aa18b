"""The benefit of an estimated velocity: PI+FFFO+ on the drive's velocity and on the estimate, same gains or margins.

  .venv/bin/python tools/benchmarks/velocity.py [--seeds N] [--duration-s S]

The paper's scenario with friction 10 % wrong, with a flat reference and with f^-0.5, on two tracking loops of the drive
(the end-to-end delay is 3 ms with both). Writes results/velocity.md beside this file.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from common import RESULTS, ROOT, made_by, progress_bar

from fffo_drive.config.checks import law_margins, rest_margins
from fffo_drive.config.scenario import ControllerVariant, Scenario, axis_of, cases_of, read_scenario
from fffo_drive.config.sections import VelocitySection
from fffo_drive.control.envelope import TRIP_NONE, TRIP_TEXTS
from fffo_drive.control.stability import Margins
from fffo_drive.evaluation.campaign import Case, simulate, warm_up
from fffo_drive.evaluation.compare import MetricComparison, compare_metric
from fffo_drive.evaluation.measures import measure
from fffo_drive.evaluation.reversal import FAST_RPS2
from fffo_drive.evaluation.trace import trace_of
from fffo_drive.evaluation.workers import over_cores
from fffo_drive.runtime.tick import FLAG_ESTIMATED_VELOCITY

SCENARIO = ROOT / "configs" / "scenarios" / "paper_wrong_friction.yaml"
TRACKING_HZ = {"fast sensor": 400.0, "slow sensor": 179.0}  # the second one lags by 1.6 ms
SLOPES = {"flat": 0.0, "f^-0.5": -0.5}
BANDWIDTHS_HZ = (100.0, 200.0, 300.0, 390.0)
WRONG_INERTIA = (0.7, 1.4)  # of the model
BASE, PLUS = "PI+FFFO, drive", "PI+FFFO+, drive"
FILTER_S = 0.0002  # of the error, as in the scenarios
LARGEST_SCALE, SCALE_STEPS = 4.0, 40
SEEDS, DURATION_S = 6, 40.0


class Found(NamedTuple):
    """One run."""

    true_ise: float
    crossing_mrps: float  # mean magnitude of the true error at slow reversals
    step_rms_a: float  # of the command, from tick to tick
    estimated_share: float  # of the ticks in which the error took the estimate


def plus(bandwidth_hz: float | None = None, scale: float = 1.0, filter_s: float = FILTER_S) -> ControllerVariant:
    """PI+FFFO+ with all frequencies of the loop so many times as high: Kp by `scale`, Ki and L by its square."""
    section = read_scenario(SCENARIO).axis.controller
    velocity = VelocitySection() if bandwidth_hz is None else VelocitySection(
        source="estimated", bandwidth_hz=bandwidth_hz
    )  # fmt: skip
    return ControllerVariant(
        toggle="ff",
        proportional_a_per_rps=scale * section.proportional_a_per_rps,
        integral_a_per_rev=scale**2 * section.integral_a_per_rev,
        gain_nm_per_rev=scale**2 * section.observer.gain_nm_per_rev,
        error_filter_s=filter_s,
        velocity=velocity,
    )


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


def margins_of(scenario: Scenario, variant: ControllerVariant) -> tuple[Margins, Margins]:
    """In motion, and at rest on the contact's spring."""
    one = scenario._replace(file=scenario.file.model_copy(update={"controllers": {"one": variant}}))
    axis = axis_of(one, "one")
    return law_margins(axis, scenario.model, True), rest_margins(axis, scenario.model)


def retuned(scenario: Scenario, bandwidth_hz: float, filter_s: float) -> float:
    """The largest scale of the gains with no margin smaller than with the drive's velocity, in motion and at rest."""
    wanted = margins_of(scenario, plus())
    found = 0.0
    for scale in np.linspace(0.5, LARGEST_SCALE, round((LARGEST_SCALE - 0.5) * SCALE_STEPS) + 1):
        margins = margins_of(scenario, plus(bandwidth_hz, float(scale), filter_s))
        pairs = zip(margins, wanted, strict=True)
        if all(own.phase_deg >= base.phase_deg and own.gain >= base.gain for own, base in pairs):
            found = float(scale)
    return found


def variants(scenario: Scenario) -> dict[str, ControllerVariant]:
    """Everything that is compared on one sensor."""
    found = {BASE: ControllerVariant(law="paper", toggle="ff"), PLUS: plus()}
    for bandwidth_hz in BANDWIDTHS_HZ:
        found[f"estimated {bandwidth_hz:g} Hz, same gains"] = plus(bandwidth_hz)
    for filter_s in (FILTER_S, 0.0):
        for bandwidth_hz in BANDWIDTHS_HZ[1:]:
            scale = retuned(scenario, bandwidth_hz, filter_s)
            text = f"estimated {bandwidth_hz:g} Hz, same margins{'' if filter_s else ', no filter'} (x {scale:.2f})"
            found[text] = plus(bandwidth_hz, scale, filter_s)
    return found


def run_case(case: Case) -> dict[str, Found]:
    """All controllers on one seed. Raises RuntimeError for a run that tripped."""
    found = {}
    for candidate in case.candidates:
        rows, trip = simulate(case, candidate)
        if trip != TRIP_NONE:
            raise RuntimeError(f"{candidate.name}, seed {case.seed}: {TRIP_TEXTS[trip]}")
        trace = trace_of(rows, case.profile.period_s, case.profile.values.size)
        true = measure(trace, case.yardstick).true
        assert true is not None
        in_profile = rows[(rows["profile_sample"] >= 0) & (rows["profile_sample"] < case.profile.values.size)]
        found[candidate.name] = Found(
            true.error.ise,
            true.crossing.slow_error_mrps,
            float(np.sqrt(np.mean(np.diff(trace.command_a) ** 2))),
            float(np.mean(in_profile["flags"] & FLAG_ESTIMATED_VELOCITY != 0)),
        )
    return found


def evaluate(scenario: Scenario, controllers: dict[str, ControllerVariant], text: str) -> dict[str, list[Found]]:
    """All controllers on all seeds."""
    scenario = scenario._replace(file=scenario.file.model_copy(update={"controllers": controllers, "percent_of": None}))
    cases = list(cases_of(scenario))
    warm_up(cases[0])
    with progress_bar(text) as progress:
        done = None if progress is None else (lambda number: progress(number / len(cases)))
        found = over_cores(run_case, cases, progress=done)
    return {name: [one[name] for one in found] for name in controllers}


def percent(comparison: MetricComparison, name: str) -> str:
    """12.3 [11.0, 13.6]"""
    value = comparison.percent[name]
    return f"{value.value:.3g} [{value.low:.3g}, {value.high:.3g}]"


def table(sensor: str, duration_s: float, seeds: int) -> list[str]:
    """Markdown of one sensor."""
    scenarios = {text: with_sensor(TRACKING_HZ[sensor], slope, duration_s, seeds) for text, slope in SLOPES.items()}
    first = next(iter(scenarios.values()))
    controllers = variants(first)
    runs = {text: evaluate(one, controllers, f"{sensor}, {text}") for text, one in scenarios.items()}
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
    for name, variant in controllers.items():
        cells = []
        for text, found in runs.items():
            ran = Found(*np.mean(found[name], axis=0))
            percents = [percent(ises[text, base], name) for base in (BASE, PLUS)]
            cells += [*percents, f"{ran.crossing_mrps:.2f}", f"{1e3 * ran.step_rms_a:.1f}"]
        moving, resting = margins_of(first, variant)
        cells += [f"{one.phase_deg:.1f} deg, {one.gain:.2f}" for one in (moving, resting)]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    shares = [run.estimated_share for found in runs.values() for name in found for run in found[name] if "est" in name]
    return [*lines, "", f"The estimate was in use in at least {min(shares):.2%} of the ticks of a run.", ""]


def wrong_inertia(sensor: str, duration_s: float, seeds: int) -> list[str]:
    """Markdown of one sensor: a model with another inertia, which feed-forward and estimate believe alike."""
    right = with_sensor(TRACKING_HZ[sensor], SLOPES["flat"], duration_s, seeds)
    controllers = {name: one for name, one in variants(right).items() if name == PLUS or "no filter" in name}
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
        runs = evaluate(scenario, controllers, f"{sensor}, J x {factor:g}")
        found.append(
            compare_metric({name: np.array([run.true_ise for run in own]) for name, own in runs.items()}, PLUS)
        )
    lines += [f"| {name} | " + " | ".join(percent(one, name) for one in found) + " |" for name in controllers]
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
        "intervals over resampled seeds. Same margins: Kp times x, Ki and L times x^2, the largest x with no margin",
        "smaller than that of PI+FFFO+ on the drive's velocity, in motion and at rest; each margin is the smaller",
        "one of the two cuts (fffo_drive/control/stability.py). 200 Hz is the default. At the crossing: mean magnitude",
        f"of the true error at reversals slower than {FAST_RPS2:g} rps/s.",
        "",
    ]
    for sensor in TRACKING_HZ:
        lines += table(sensor, options.duration_s, options.seeds)
    for sensor in TRACKING_HZ:
        lines += wrong_inertia(sensor, options.duration_s, options.seeds)
    lines.append(made_by("velocity.py"))
    (RESULTS / "velocity.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
