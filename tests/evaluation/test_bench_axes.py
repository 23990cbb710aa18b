"""The axes of `tools/bench`: which laws run on them, and what the one that is nearest to Table II changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fffo_drive.cli.bench import nearest_label
from fffo_drive.config.checks import law_margins
from fffo_drive.config.scenario import axis_of, on_axis, read_scenario, reference_of
from fffo_drive.config.sections import FeedforwardSection
from fffo_drive.config.simulated import read_simulated

SCENARIOS = Path(__file__).resolve().parents[2] / "configs" / "scenarios"


@pytest.mark.parametrize("name", ["axis_bench.yaml", "axis_nearest.yaml"])
def test_an_axis_of_the_bench_has_the_papers_three_laws_as_they_are_and_ours_whole(name):
    scenario = on_axis(read_scenario(SCENARIOS / "paper.yaml"), SCENARIOS.parent / name)
    assert list(scenario.file.controllers) == ["pi", "pi+fbfo", "pi+fffo", "pi+fffo+"]
    for law in scenario.file.controllers:
        section = axis_of(scenario, law).controller
        ours = law == "pi+fffo+"
        assert section.feedforward == FeedforwardSection(inertia=ours, preview=ours, delay_aware=ours), law
        assert section.observer.learns_in == ("integral" if ours else "friction")
        assert (section.at_rest.gain_share < 1.0, section.at_rest.release_friction) == (ours, ours)
    (seed,) = scenario.seeds
    assert reference_of(scenario, seed).values == pytest.approx(
        reference_of(read_scenario(SCENARIOS / "paper.yaml"), 1).values
    )


def test_the_nearest_axis_is_the_papers_but_for_two_numbers_and_says_what_they_contradict():
    """Gh <= Kt / sigma and, with J = Th Kt / Gh, Th <= J / sigma; both fail there, and the margin is 25 degrees."""
    paper = on_axis(read_scenario(SCENARIOS / "paper.yaml"), SCENARIOS.parent / "axis_bench.yaml")
    nearest = on_axis(read_scenario(SCENARIOS / "paper.yaml"), SCENARIOS.parent / "axis_nearest.yaml")
    kt = nearest.model.torque_constant_nm_per_a
    share = kt / paper.model.torque_constant_nm_per_a
    assert nearest.model.friction == paper.model.friction
    assert nearest.model.delay_s == paper.model.delay_s
    assert nearest.model.inertia_kg_m2.value == pytest.approx(share * paper.model.inertia_kg_m2.value, rel=1e-3)
    drives = [read_simulated(SCENARIOS.parent / f"simulated_{name}.yaml") for name in ("drive", "nearest")]
    by_the_same = replace(drives[0].plant, torque_constant_nm_per_a=kt, inertia_kg_m2=drives[1].plant.inertia_kg_m2)
    assert drives[1].plant == by_the_same
    assert drives[1].plant.inertia_kg_m2 == pytest.approx(share * drives[0].plant.inertia_kg_m2, rel=1e-3)
    gains, printed = nearest.axis.controller, paper.axis.controller
    same = printed.observer.model_copy(update={"gain_nm_per_rev": 5.9})
    at_rest = printed.at_rest.model_copy(update={"hold_a_per_rev_s": 0.0})  # tuned for the gains of the other
    assert gains == printed.model_copy(update={"observer": same, "at_rest": at_rest, "accept_unproven": True})
    papers = axis_of(nearest, "pi+fffo")
    assert law_margins(papers, nearest.model, observer_on=True).phase_deg == pytest.approx(25.0, abs=0.5)
    label = nearest_label(nearest)
    for text in (
        "Kt 0.0485 Nm/A and L 5.9 Nm/rev are inferred",
        "16.2 rps/A (printed 26.17)",
        "0.103 s (printed 0.166)",
        "25 deg",
    ):
        assert text in label
