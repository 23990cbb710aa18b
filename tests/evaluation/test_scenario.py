"""Scenario files: what they change and nothing else, errors with line and key, and what the controllers must reach."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from trial_axes.passivity import comes_to_rest
from trial_axes.random_axis import random_axis, wide_axis
from trial_axes.robustness import HUNTING, STABLE, probe

from fffo_drive.cli import main
from fffo_drive.cli.evaluate import caution_about_envelope
from fffo_drive.config.axis import build_profile, read_axis
from fffo_drive.config.scenario import (
    FRICTION_KEYS,
    axis_of,
    candidates_of,
    case_of,
    cases_of,
    law_cautions,
    read_scenario,
    reference_of,
    select_controllers,
    wrong_model,
)
from fffo_drive.control.controller import AS_IN_MOTION
from fffo_drive.control.reference import MODE_VELOCITY, piecewise_linear
from fffo_drive.documents import DocumentError
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.evaluation.campaign import run_campaign, run_case, simulate
from fffo_drive.evaluation.summary import summarise

SCENARIOS = Path(__file__).resolve().parents[2] / "configs" / "scenarios"

SHORT = f"""\
format: fffo_drive/scenario/1
name: short
axis: {SCENARIOS.parent / "axis_simulated.yaml"}
seeds: 2
reference: {{kind: paper, duration_s: 4, slope: 0}}
plant:
  delay_s: 0.004
  resolver: {{noise_rev: 0}}
  effects:
    - {{name: cogging, parameters: {{amplitude_nm: 0.002}}}}
mismatch: {{friction_share: 0.1, factors: {{inertia_kg_m2: 1.2}}}}
controllers:
  pi: {{toggle: "off"}}
  pi+fffo+: {{toggle: ff, gain_nm_per_rev: 4, feedforward: {{inertia: true, preview: true, delay_aware: true}}}}
"""
CURRENT = "kind: sine, mode: current, duration_s: 4, amplitude: 1, frequency_hz: 1"


def written(path: Path, text: str = SHORT) -> Path:
    file = path / "scenario.yaml"
    file.write_text(text)
    return file


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda p: p.stem)
def test_the_shipped_scenarios_are_whole_and_proven(path):
    scenario = read_scenario(path)
    assert scenario.file.name == path.stem
    assert law_cautions(scenario) == []
    assert list(scenario.seeds) == list(range(1, 11))


def test_a_scenario_changes_what_it_names(tmp_path):
    scenario = read_scenario(written(tmp_path))
    case = case_of(scenario, 7)
    assert (case.plant.seed, case.plant.delay_s, case.plant.resolver.noise_rev) == (7, 0.004, 0.0)
    assert case.plant.resolver.bits == 15
    assert [effect.name for effect in case.plant.effects] == ["cogging"]
    pi, plus = case.candidates
    assert plus.controller.observer.gain_nm_per_rev == 4.0
    assert pi.controller.feedforward == (0.0, 0.0, 0.0)
    assert plus.controller.feedforward.inertia_nm_s2_per_rev == pytest.approx(1.2 * 9.387e-4, rel=1e-3)


def test_a_wrong_model_is_wrong_by_the_share_in_every_friction_parameter_and_by_seed(tmp_path):
    scenario = read_scenario(written(tmp_path))
    signs = set()
    for seed in range(1, 9):
        wrong = wrong_model(scenario.model, scenario.file.mismatch, seed)
        ratios = [
            getattr(wrong.friction, key).value / getattr(scenario.model.friction, key).value for key in FRICTION_KEYS
        ]
        np.testing.assert_allclose(np.abs(np.array(ratios) - 1.0), 0.1)
        signs.add(tuple(np.sign(np.array(ratios) - 1.0)))
    assert len(signs) > 4
    assert candidates_of(scenario, 3) == candidates_of(scenario, 3)


def test_seeds_vary_the_phases_of_the_reference(tmp_path):
    scenario = read_scenario(written(tmp_path))
    assert not np.array_equal(reference_of(scenario, 1).values, reference_of(scenario, 2).values)
    fixed = read_scenario(written(tmp_path, SHORT + "vary_phases: false\n"))
    assert np.array_equal(reference_of(fixed, 1).values, reference_of(fixed, 2).values)


def test_the_bench_runs_the_first_record_of_the_papers_scenario_with_its_laws():
    scenario = read_scenario(SCENARIOS / "paper.yaml")
    bench = read_axis(SCENARIOS.parent / "axis_bench.yaml")
    reference, profile = reference_of(scenario, 1), build_profile(bench.profile, bench.loop.period_s)
    assert np.array_equal(reference.values, profile.values)
    assert bench.controller == axis_of(scenario, "pi+fffo+").controller
    assert bench.controller.papers == axis_of(scenario, "pi+fffo").controller


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("delay_s: 0.004", "delay: 0.004", "scenario.yaml:7: plant.delay: unknown key; did you mean 'delay_s'?"),
        ("delay_s: 0.004", "delay_s: 0.4", "scenario.yaml:7: plant.delay_s"),
        ("{name: cogging,", "{name: coging,", "scenario.yaml:10: plant.effects[0].name"),
        ("inertia_kg_m2: 1.2", "inertia: 1.2", "unknown number 'inertia'"),
        ("toggle: ff,", "toggle: on,", "controllers.pi+fffo+.toggle"),
        ("slope: 0}", "slope: 0, high_rps: 900}", "scenario.yaml:5: reference: peak of"),
        (
            "controllers:",
            "percent_of: pi+ffo\ncontrollers:",
            "percent_of: no controller is called 'pi+ffo': did you mean 'pi+fffo+'?",
        ),
        ("kind: paper, duration_s: 4, slope: 0", CURRENT, "controllers are compared on a velocity"),
    ],
)
def test_errors_name_file_line_and_key(tmp_path, old, new, said):
    assert old in SHORT
    with pytest.raises(DocumentError) as error:
        read_scenario(written(tmp_path, SHORT.replace(old, new)))
    assert said in str(error.value)


def test_controllers_are_chosen_by_name(tmp_path):
    scenario = read_scenario(written(tmp_path))
    assert list(select_controllers(scenario, ["pi+fffo+"]).file.controllers) == ["pi+fffo+"]
    with pytest.raises(DocumentError, match=r"no 'fffo'; there are pi, pi\+fffo\+"):
        select_controllers(scenario, ["fffo"])


@pytest.mark.slow
def test_processes_give_what_one_process_gives(tmp_path):
    """The same numbers to the last bit, whoever computes them."""
    scenario = read_scenario(written(tmp_path))
    here = [run for case in cases_of(scenario) for run in run_case(case)]
    there = run_campaign(cases_of(scenario), workers=2)
    assert [(run.candidate, run.seed) for run in here] == [(run.candidate, run.seed) for run in there]
    for one, other in zip(here, there, strict=True):
        assert one.measures is not None
        assert other.measures is not None
        assert one.measures.true.error == other.measures.true.error
        assert one.measures.effort == other.measures.effort


@pytest.mark.slow
def test_the_command_writes_a_page_and_numbers(tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["evaluate", str(written(tmp_path)), "--out", str(out), "--workers", "1", "--json"]) == 0
    results = json.loads(capsys.readouterr().out)
    assert results["controllers"] == ["pi", "pi+fffo+"]
    true_mae = results["figures"]["true.mae"]
    assert true_mae["pi+fffo+"]["value"] < 0.3 * true_mae["pi"]["value"]
    assert (out / "report.html").stat().st_size > 50_000
    assert json.loads((out / "report.json").read_text())["results"] == results


def test_a_file_that_a_scenario_names_and_is_not_there_is_reported_at_its_key(tmp_path):
    file = written(tmp_path)
    text = file.read_text()
    line = next(k for k, one in enumerate(text.splitlines(), 1) if one.startswith("axis:"))
    file.write_text(re.sub(r"(?m)^axis: .*$", "axis: nosuch.yaml", text))
    with pytest.raises(DocumentError, match=rf"{file.name}:{line}: axis: .*nosuch.yaml: cannot be read: No such file"):
        read_scenario(file)


def test_ticks_in_which_the_envelope_changes_a_command_are_counted(tmp_path):
    """A slew rate of a hundredth: the start of the motion is cut; the usual limits cut nothing in it."""
    case = next(iter(cases_of(read_scenario(written(tmp_path)))))
    assert [run.envelope_ticks for run in run_case(case)] == [0, 0]
    slow = case.session.envelope._replace(slew_a_per_s=0.01 * case.session.envelope.slew_a_per_s)
    cut = run_case(case._replace(session=case.session._replace(envelope=slow)))
    assert all(run.envelope_ticks is not None and run.envelope_ticks > 0 for run in cut)
    said = caution_about_envelope([cut[0]._replace(candidate="pi", envelope_ticks=3)], 1000)
    assert "pi ran with the envelope" in said
    assert said.endswith("It changed the command of pi in 3 of 1000 ticks.")
    assert caution_about_envelope([cut[0]._replace(envelope_ticks=0)], 1000).endswith("It changed no command.")


@pytest.mark.slow
def test_recordings_are_evaluated_by_controller(tmp_path, capsys):
    axis = (SCENARIOS.parent / "axis_simulated.yaml").read_text()
    axis = axis.replace("duration_s: 60", "duration_s: 3, slope: 0")
    axis = axis.replace("file: simulated", f"file: {SCENARIOS.parent}/simulated")
    axis = axis.replace("model: models", f"model: {SCENARIOS.parent}/models")
    file = tmp_path / "axis.yaml"
    file.write_text(axis)
    runs = []
    for toggle in ("off", "ff"):
        runs.append(str(tmp_path / f"{toggle}.mcap"))
        assert main(["run", str(file), "--toggle", toggle, "--out", runs[-1], "--json"]) == 0
    capsys.readouterr()
    assert main(["evaluate", "--runs", *runs, "--out", str(tmp_path / "out"), "--json"]) == 0
    results = json.loads(capsys.readouterr().out)
    assert results["controllers"] == ["pi+", "pi+fffo+"]  # the file's law has the feed-forward parts
    mae = results["figures"]["measured.mae"]
    assert mae["pi+fffo+"]["value"] < mae["pi+"]["value"]


@pytest.mark.slow
def test_plus_reaches_its_targets_on_the_papers_scenario():
    """All ten seeds of the file: the same figures stand in tools/benchmarks/results/evaluation.md."""
    scenario = read_scenario(SCENARIOS / "paper_wrong_friction.yaml")
    scenario = select_controllers(scenario, ["pi+fffo", "pi+fffo+"])
    figures = summarise(run_campaign(cases_of(scenario), workers=1), "pi+fffo").figures
    for name, most in (("true.ise", 5.0), ("true.mae", 20.0), ("measured.ise", 20.0), ("measured.mae", 50.0)):
        assert figures[name].percent["pi+fffo+"].value < most, name
    assert figures["true.crossing.fast_lag_ms"].absolute["pi+fffo+"].high < 0.5  # the whole interval


@pytest.mark.slow
def test_random_axes_are_the_same_ones_every_time_and_all_effects_come_up():
    nominal = read_scenario(SCENARIOS / "paper.yaml").plant
    axes = [random_axis(nominal, number) for number in range(40)]
    assert [random_axis(nominal, number).plant for number in range(40)] == [axis.plant for axis in axes]
    from fffo_drive.drive.simulated.effects.registry import EFFECTS

    assert {name for axis in axes for name in axis.effects} == set(EFFECTS)
    assert all(0.001 <= axis.plant.delay_s <= 0.005 for axis in axes)


@pytest.mark.slow
def test_wide_axes_are_the_same_ones_every_time_on_resolvers_and_encoders():
    nominal = read_scenario(SCENARIOS / "paper.yaml").plant
    axes = [wide_axis(nominal, number) for number in range(20)]
    assert [wide_axis(nominal, number).plant for number in range(20)] == [axis.plant for axis in axes]
    assert {axis.plant.resolver.bits for axis in axes[::2]} == {nominal.resolver.bits}
    assert {axis.plant.resolver.tracking_hz for axis in axes[1::2]} == {2000.0}
    ratios = np.array([axis.plant.inertia_kg_m2 / nominal.inertia_kg_m2 for axis in axes])
    assert 0.5 <= ratios.min() < 0.75
    assert 1.25 < ratios.max() <= 1.5


@pytest.mark.slow
def test_every_third_wide_axis_has_one_elastic_load_within_its_bounds():
    nominal = read_scenario(SCENARIOS / "paper.yaml").plant
    axes = [wide_axis(nominal, number) for number in range(0, 60, 3)]
    loads = [[effect for effect in axis.plant.effects if effect.name == "elasticity"] for axis in axes]
    assert all(len(load) == 1 and "elasticity" in axis.effects for axis, load in zip(axes, loads, strict=True))
    for name, low, high in (("load_share", 0.05, 0.6), ("frequency_hz", 20.0, 400.0), ("damping", 0.01, 0.1)):
        values = np.array([load[0].parameters[name] for load in loads])
        assert low <= values.min() < low * (high / low) ** 0.4
        assert low * (high / low) ** 0.6 < values.max() <= high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "passive"), [(None, True), ("periodic_disturbance", True), ("odd_direction_angle", False)]
)
def test_an_axis_that_gives_energy_is_distinguished_from_one_that_is_disturbed(effect, passive):
    from dataclasses import replace

    nominal = read_scenario(SCENARIOS / "paper.yaml").plant
    effects = () if effect is None else (EffectConfig(effect),)
    assert comes_to_rest(replace(nominal, effects=effects)) == passive


@pytest.mark.slow
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_plus_does_not_creep_at_rest_and_starts_no_worse_than_the_observer_that_holds_its_estimate(direction):
    """One second of motion, ten of rest, a start the same way or the other; sums over three models, 10 % wrong."""
    scenario = read_scenario(SCENARIOS / "paper_wrong_friction.yaml")
    times_s = np.array([0.0, 0.2, 0.3, 1.5, 1.6, 11.6, 11.7, 12.5])
    levels = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.5 * direction, 0.5 * direction])
    creep_counts, start = Counter(), Counter()
    for seed in range(3):
        whole = case_of(scenario, seed)
        period_s = whole.session.loop.period_ns * 1e-9
        profile = piecewise_linear("stop and start", MODE_VELOCITY, period_s, times_s, levels)
        plus = next(c for c in whole.candidates if c.name == "pi+fffo+")
        observer = plus.controller.observer._replace(learns_in_integral=False)
        held = plus._replace(controller=plus.controller._replace(rest=AS_IN_MOTION, observer=observer))
        for name, candidate in (("released", plus), ("held", held)):
            rows, trip = simulate(whole._replace(profile=profile), candidate)
            assert trip == 0
            rows = rows[rows["profile_sample"] >= 0]
            velocity_rps = rows["true_velocity_rps"]
            at = [round(time_s / period_s) for time_s in (6.3, 11.3, 11.6, 11.9)]
            creep_counts[name] += abs(np.sum(velocity_rps[at[0] : at[1]])) * period_s * 2**15
            start[name] += np.sum((profile.values[at[2] : at[3]] - velocity_rps[at[2] : at[3]]) ** 2) * period_s
    assert creep_counts["released"] < 3 * 5.0
    assert creep_counts["held"] > 3 * 50.0
    assert start["released"] < start["held"]


@pytest.mark.slow
def test_the_probe_finds_a_loop_with_too_much_delay_and_passes_the_nominal_one():
    from dataclasses import replace

    case = case_of(read_scenario(SCENARIOS / "paper.yaml"), 1)
    plus = case.candidates[-1]
    nominal = probe(case, plus)
    assert nominal.verdict == STABLE
    assert nominal.overshoot < 0.1
    assert nominal.beyond_rest_rps < 0.02
    late = probe(case._replace(plant=replace(case.plant, extra_delay_s=0.012)), plus)
    assert late.verdict not in (STABLE, HUNTING)


@pytest.mark.slow
def test_a_run_ends_where_its_profile_does(tmp_path):
    case = case_of(read_scenario(written(tmp_path)), 1)
    rows, trip = simulate(case, case.candidates[0])
    assert trip == 0
    assert np.count_nonzero(rows["profile_sample"] == case.profile.values.size - 1) == 1
