"""What `config check` says of a part that is off: by the model, against runs on an axis that is the model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fffo_drive.cli import main
from fffo_drive.config.axis import TOGGLES, AxisFile, controller_config
from fffo_drive.config.law_costs import PartCost, law_costs
from fffo_drive.config.scenario import Scenario, case_of, read_scenario, reference_of
from fffo_drive.control.friction_observer import TOGGLE_OFF
from fffo_drive.evaluation.campaign import Candidate, simulate
from fffo_drive.evaluation.metrics import profile_rows

SCENARIOS = Path(__file__).resolve().parents[2] / "configs" / "scenarios"
STARTED_S = 0.5  # the reference begins with a speed
PARTS = ("inertia", "preview", "delay_aware")
SMALL = 0.25  # of what is computed: friction before sliding, the sensor's noise and its counts


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """An axis that is Table I itself, and a model that is right, on a short flat reference."""
    found = read_scenario(SCENARIOS / "paper_single_surface.yaml")
    reference = found.file.reference.model_copy(update={"duration_s": 8.0, "high_rps": 8.0, "low_rps": 1.0})
    mismatch = found.file.mismatch.model_copy(update={"friction_share": 0.0})
    return found._replace(file=found.file.model_copy(update={"reference": reference, "mismatch": mismatch}))


def changed(scenario: Scenario, changes: dict) -> AxisFile:
    return scenario.axis.model_copy(update={"controller": scenario.axis.controller.changed(changes)})


def costs(scenario: Scenario, axis: AxisFile) -> list[PartCost]:
    toggle = TOGGLES[axis.controller.observer.toggle]
    return law_costs(axis, scenario.model, reference_of(scenario, 1), toggle != TOGGLE_OFF)


def run_error_rps(scenario: Scenario, axis: AxisFile) -> np.ndarray:
    """Of the shaft, along the reference."""
    case = case_of(scenario, 1)
    toggle = TOGGLES[axis.controller.observer.toggle]
    rows, _ = simulate(case, Candidate("one", toggle, controller_config(axis, scenario.model)))
    rows = profile_rows(rows, case.profile.values.size)
    error_rps = case.profile.values[: rows.size] - rows["true_velocity_rps"]
    return np.asarray(error_rps[round(STARTED_S / case.profile.period_s) :])


@pytest.mark.parametrize("part", PARTS)
def test_the_errors_that_are_expected_of_a_part_that_is_off_are_those_of_a_run(scenario, part):
    axis = changed(scenario, {"feedforward": {part: False}})
    (cost,) = costs(scenario, axis)
    assert cost.key == f"controller.feedforward.{part}"
    error_rps, best_rps = (run_error_rps(scenario, one) for one in (axis, scenario.axis))
    rms_rps, least_rps = (float(np.sqrt(np.mean(one * one))) for one in (error_rps, best_rps))
    assert cost.rms_rps == pytest.approx(rms_rps, rel=SMALL, abs=1.5 * least_rps)
    assert cost.largest_rps == pytest.approx(float(np.max(np.abs(error_rps))), rel=2.0 * SMALL, abs=0.02)
    assert rms_rps > 2.0 * least_rps  # the part is worth something there


def test_without_the_friction_observer_the_errors_are_within_those_that_are_expected(scenario):
    """The steady-state curve jumps at a reversal where a contact bends before it slides: the errors are rather less."""
    axis = changed(scenario, {"observer": {"toggle": "off"}})
    (cost,) = costs(scenario, axis)
    assert cost.key == "controller.observer.toggle"
    error_rps = run_error_rps(scenario, axis)
    assert 1.0 < cost.rms_rps / float(np.sqrt(np.mean(error_rps * error_rps))) < 2.0
    assert 1.0 < cost.largest_rps / float(np.max(np.abs(error_rps))) < 2.0


def test_the_law_of_an_old_file_lacks_every_part_and_the_best_none(scenario):
    assert costs(scenario, scenario.axis) == []
    papers = scenario.axis.model_copy(update={"controller": scenario.axis.controller.papers})
    keys = [cost.key.removeprefix("controller.") for cost in costs(scenario, papers)]
    assert keys == [
        *(f"feedforward.{part}" for part in PARTS),
        "observer.learns_in",
        "at_rest.release_friction",
        "at_rest.hold_a_per_rev_s",
    ]


def test_twice_the_acceleration_costs_twice_the_torque_and_the_error(scenario):
    """A live set point, where the profile is a current."""
    found = []
    for acceleration_rps2 in (25.0, 50.0):
        axis = changed(scenario, {"feedforward": {"inertia": False}})
        asked = axis.daemon.set_points.model_copy(update={"acceleration_rps2": acceleration_rps2, "largest_rps": 20.0})
        axis = axis.model_copy(update={"daemon": axis.daemon.model_copy(update={"set_points": asked})})
        current = reference_of(scenario, 1)._replace(mode=1 - reference_of(scenario, 1).mode)
        (cost,) = law_costs(axis, scenario.model, current, True)
        inertia = scenario.model.axis_config().inertia_nm_s2_per_rev
        assert cost.torque_nm == pytest.approx(inertia * acceleration_rps2, rel=1e-6)
        assert f"at {acceleration_rps2:g} rps2 the loop has to make" in str(cost)
        found.append(cost.largest_rps)
    assert found[1] == pytest.approx(2.0 * found[0], rel=0.05)


def test_config_check_says_what_an_old_file_leaves_to_the_loop(tmp_path, capsys):
    axis = (SCENARIOS.parent / "axis_simulated.yaml").read_text().replace("  at_rest:", "  # at_rest:")
    for name in ("models", "simulated_drive.yaml"):
        (tmp_path / name).symlink_to(SCENARIOS.parent / name)
    file = tmp_path / "axis.yaml"
    file.write_text(axis.replace("axis/2", "axis/1"))
    assert main(["config", "check", str(file)]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  law: ")]
    assert len(said) == 6
    assert "controller.feedforward.inertia is off: at 40.7 rps2 the loop has to make 0.038 Nm by itself" in said[0]
    assert "expect velocity errors of up to 0.18 rps" in said[0]
    assert all(" Nm" in line for line in said)
    file.write_text((SCENARIOS.parent / "axis_simulated.yaml").read_text())
    assert main(["config", "check", str(file)]) == 0
    assert "  law: " not in capsys.readouterr().out
