"""A range of inertia: the gains that `tune` chooses for it, what refuses it, and axes at both of its ends."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

import fffo_drive as fd
from fffo_drive.cli import main
from fffo_drive.config.axis import loop_axis, read_axis
from fffo_drive.config.checks import law_problems
from fffo_drive.config.law_costs import law_costs
from fffo_drive.config.runaway import runaway_of
from fffo_drive.control.stability import loop_margins, over_loads
from fffo_drive.documents import DocumentError
from fffo_drive.identification.tuning import REST_MARGIN_DEG
from fffo_drive.workflows.load_range import ask_range
from fffo_drive.workflows.plan import make_plan

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
OWN = 1.494e-4  # of the model, kg m2
FOURTH, THREE = OWN / 4.0, 3.0 * OWN
MOTION = "profile:\n  kind: points\n  points: [[0, 0], [0.2, 6], [0.5, 6], [0.8, -4], [1.0, -4], [1.2, 0], [1.6, 0]]\n"


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """configs/, and beside it what `tune` writes for a load from a fourth to three times the model's inertia."""
    place = tmp_path_factory.mktemp("loads")
    shutil.copytree(CONFIGS, place / "configs")
    (place / "motion.yaml").write_text(MOTION)
    assert main(tune_words(place, "ranged", FOURTH, THREE)) == 0
    assert main(tune_words(place, "alone")) == 0
    return place


def tune_words(place: Path, name: str, *ends: float) -> list[str]:
    axis, model = place / "configs" / "axis_simulated.yaml", place / "configs" / "models" / "table1.yaml"
    ranged = ["--inertia-range", *(f"{end:.9g}" for end in ends)] if ends else []
    return ["tune", str(model), "--axis", str(axis), "--out", str(place / name), *ranged]


def with_plant(place: Path, name: str, inertia_kg_m2: float) -> Path:
    """The axis file that `tune` wrote, on a simulated drive with another inertia."""
    drive = yaml.safe_load((place / "configs" / "simulated_drive.yaml").read_text())
    drive["plant"]["inertia_kg_m2"] = inertia_kg_m2
    file = place / name / f"drive_{inertia_kg_m2:.3g}.yaml"
    file.write_text(yaml.safe_dump(drive))
    axis = yaml.safe_load((place / name / "axis_simulated.yaml").read_text())
    axis["drive"]["file"] = file.name
    target = place / name / f"axis_{inertia_kg_m2:.3g}.yaml"
    target.write_text(yaml.safe_dump(axis))
    return target


def test_tune_writes_the_range_and_gains_with_margins_over_it(made):
    axis = fd.read_axis(made / "ranged" / "axis_simulated.yaml")
    assert axis.file.controller.inertia_range_kg_m2 == pytest.approx((FOURTH, THREE), rel=1e-8)
    law = axis.file.controller
    gains = law.proportional_a_per_rps, law.integral_a_per_rev, law.observer.gain_nm_per_rev
    margins = [loop_margins(one, *gains) for one in over_loads(loop_axis(axis.file, axis.model))]
    assert len(margins) == 2
    assert min(one.phase_deg for one in margins) >= 45.0
    assert min(one.gain for one in margins) >= 2.5
    assert law_problems(axis.file, axis.model, observer_on=True) == []
    assert make_plan(axis.path).path == axis.path  # it runs


def test_the_library_and_a_file_with_a_range_give_the_same_gains(made):
    axis = fd.read_axis(made / "configs" / "axis_simulated.yaml")
    found = fd.tune(axis.model, axis=axis, inertia_range_kg_m2=(FOURTH, THREE))
    again = fd.tune(axis.model, axis=fd.read_axis(made / "ranged" / "axis_simulated.yaml"))
    assert again.design.gains.in_motion == pytest.approx(found.design.gains.in_motion, rel=1e-6)
    assert found.section(12.0)["inertia_range_kg_m2"] == pytest.approx([FOURTH, THREE], rel=1e-9)
    assert found.design.margins_rest.phase_deg >= REST_MARGIN_DEG
    alone = fd.tune(axis.model, axis=axis)
    assert "inertia_range_kg_m2" not in alone.section(12.0)
    assert found.design.gains.proportional_a_per_rps < 0.5 * alone.design.gains.proportional_a_per_rps


@pytest.mark.parametrize("inertia_kg_m2", [FOURTH, THREE])
def test_an_axis_at_either_end_of_its_range_runs_quietly(made, inertia_kg_m2):
    run = fd.simulate(with_plant(made, "ranged", inertia_kg_m2), profile=made / "motion.yaml")
    assert run.fault is None
    rest = run["current_command_a"][-200:]
    assert np.ptp(rest) < 0.5
    assert run.metrics.shaft.max < 3.0


def test_the_same_axis_without_a_range_trips_at_a_fourth_of_its_inertia(made):
    """Less than the gain margin allows."""
    run = fd.simulate(with_plant(made, "alone", FOURTH), profile=made / "motion.yaml")
    assert run.fault is not None


def test_config_check_says_what_another_load_costs_as_a_run_has_it(made, capsys):
    axis = read_axis(made / "ranged" / "axis_simulated.yaml")
    path = with_plant(made, "ranged", THREE)
    plan = make_plan(path, profile_file=made / "motion.yaml")
    (cost,) = law_costs(axis, plan.model, plan.profile, observer_on=True)
    assert cost.key == "controller.inertia_range_kg_m2"
    inertia = 2.0 * np.pi * OWN
    assert cost.torque_nm == pytest.approx(2.0 * inertia * np.abs(plan.profile.derivatives).max(), rel=1e-3)
    run = fd.simulate(path, profile=made / "motion.yaml")
    assert cost.largest_rps == pytest.approx(run.metrics.shaft.max, rel=0.3)
    assert main(["config", "check", str(made / "ranged" / "axis_simulated.yaml")]) == 0
    said = capsys.readouterr().out
    assert "at the worst inertia from 3.735e-05 to 0.0004482 kg m2" in said
    assert "with 3 times the model's inertia the loop has to make up to" in said


def test_without_feedback_the_axis_with_the_least_load_runs_away_fastest(made, capsys):
    axis = fd.read_axis(made / "configs" / "axis_simulated.yaml")
    controller = axis.file.controller.model_copy(update={"inertia_range_kg_m2": (FOURTH, THREE)})
    ranged = axis.file.model_copy(update={"controller": controller})
    gained_rps = runaway_of(axis.file, axis.model).gained_rps
    assert runaway_of(ranged, axis.model).gained_rps == pytest.approx(4.0 * gained_rps)
    # `tune` writes as many ticks as are safe then
    written = read_axis(made / "ranged" / "axis_simulated.yaml")
    assert (written.envelope.feedback_missing_ticks, axis.file.envelope.feedback_missing_ticks) == (1, None)
    assert read_axis(made / "alone" / "axis_simulated.yaml").envelope.feedback_missing_ticks is None


def test_a_range_that_is_none_is_refused_with_its_key(made, capsys):
    assert main(tune_words(made, "out", THREE, FOURTH)) == 78
    assert "the least inertia, above 0, and then the largest" in capsys.readouterr().err
    path = made / "ranged" / "wrong.yaml"
    path.write_text((made / "ranged" / "axis_simulated.yaml").read_text().replace("- 3.735e-05", "- 0"))
    assert main(["config", "check", str(path)]) == 78
    assert "controller.inertia_range_kg_m2: 0 to 0.0004482: the least inertia" in capsys.readouterr().err


def test_a_range_too_wide_is_refused_with_one_that_would_do(made, capsys):
    assert main(tune_words(made, "out", 1e-6, 0.1)) == 78
    said = capsys.readouterr().err
    assert "1e-06 to 0.1 kg m2" in said
    assert "would stick and slip" in said
    narrower = said.partition(" From ")[2].split()
    ends = float(narrower[0]), float(narrower[2])
    assert 1e-6 < ends[0] < OWN < ends[1] < 0.1
    assert main(tune_words(made, "out", *ends)) == 0


def test_a_model_outside_its_range_is_a_warning(made, capsys):
    assert main(tune_words(made, "out", 3e-4, 4e-4)) == 0
    said = capsys.readouterr()
    assert "the model's inertia, 0.0001494 kg m2, is outside the range 0.0003 to 0.0004 kg m2" in said.err
    assert "all margins hold with an inertia of 0.0003 to 0.0004 kg m2" in said.out


def test_without_a_range_tune_says_what_it_assumed(made, capsys):
    assert main(tune_words(made, "alone")) == 0
    said = capsys.readouterr().out
    assert "assumed: the load never changes, the inertia is always the model's 0.0001494 kg m2" in said
    page = (made / "alone" / "report.html").read_text()
    assert "the load never changes" in page
    assert main(tune_words(made, "ranged", FOURTH, THREE)) == 0
    page = (made / "ranged" / "report.html").read_text()
    assert "all margins hold with an inertia of 3.735e-05 to 0.0004482 kg m2" in page
    assert "at the largest inertia, 0.0004482 kg m2" in page


def test_the_range_of_a_linear_axis_is_a_mass(made, tmp_path, capsys):
    model = yaml.safe_load((made / "configs" / "models" / "table1.yaml").read_text())
    model["units"] = "linear"
    mass = model.pop("inertia_kg_m2")["value"] * 2.0 * np.pi
    model["mass_kg"] = {"value": mass}
    file = tmp_path / "linear.yaml"
    file.write_text(yaml.safe_dump(model))
    ends = [f"{0.5 * mass:.8g}", f"{2.0 * mass:.8g}"]
    assert main(["tune", str(file), "--out", str(tmp_path / "out"), "--mass-range", *ends]) == 0
    assert f"all margins hold with a mass of {0.5 * mass:.4g} to {2.0 * mass:.4g} kg" in capsys.readouterr().out
    section = yaml.safe_load((tmp_path / "out" / "controller.yaml").read_text())["controller"]
    assert section["inertia_range_kg_m2"] == pytest.approx([0.5 * OWN, 2.0 * OWN], rel=1e-6)


def test_the_range_is_asked_for():
    assert ask_range("1 kg m2", lambda question, proposal: "0.5, 2") == (0.5, 2.0)
    assert ask_range("1 kg m2", lambda question, proposal: proposal) is None
    assert ask_range("1 kg m2", lambda question, proposal: None) is None
    for answer in ("2", "a b", "2 1", "0 1"):
        with pytest.raises(DocumentError, match="inertia range"):
            ask_range("1 kg m2", lambda question, proposal, answer=answer: answer)
