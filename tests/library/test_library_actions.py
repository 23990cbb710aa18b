"""Commissioning, imports, circles and tables by the library, and errors that name the argument."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fffo_drive as fd
from fffo_drive.documents import DocumentError
from fffo_drive.model.parameters import effect_model

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
AXIS = CONFIGS / "axis_simulated.yaml"
SHORT = {"kind": "paper", "duration_s": 6, "seed": 3}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return fd.run(AXIS, tmp_path_factory.mktemp("run") / "short.mcap", profile=SHORT)


def test_the_effects_of_the_drive_are_those_that_are_given():
    """Cogging of the plant is a torque over the angle; that of the model alone changes nothing in the plant."""
    plain = fd.simulate(AXIS, profile=SHORT, seed=1, effects={})
    cogging = fd.simulate(AXIS, profile=SHORT, seed=1, effects={"cogging": {"amplitude_nm": 0.03}})
    assert cogging.metrics.shaft.ise > 2.0 * plain.metrics.shaft.ise
    assert np.array_equal(fd.simulate(AXIS, profile=SHORT, seed=1)["velocity_rps"], plain["velocity_rps"])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"effects": {"coging": {}}}, r"^effects: coging: no effect is called 'coging': did you mean 'cogging'"),
        ({"effects": {"cogging": {"size": 1.0}}}, r"^effects: cogging\.size: effect 'cogging' has no parameter 'size'"),
        ({"effects": {"cogging": {"amplitude_nm": 50.0}}}, r"^effects: cogging\.amplitude_nm: 50 is outside"),
        ({"profile": np.zeros((2, 2))}, "^profile: shape"),
        ({"toggle": "on"}, "^toggle: 'on' is none of"),
        ({"gains": {"kp": 1.0}}, "controller.kp"),
    ],
)
def test_a_wrong_argument_is_named(given, said):
    with pytest.raises(DocumentError, match=said):
        fd.simulate(AXIS, **given)


def test_a_profile_is_also_the_name_of_its_kind():
    named, section = (fd.simulate(AXIS, profile=given, seed=1) for given in ("recipe", {"kind": "recipe"}))
    assert np.array_equal(named["reference_rps"], section["reference_rps"])


def test_an_axis_in_memory_is_refused_by_key_and_one_of_a_file_by_its_line(tmp_path):
    axis = fd.read_axis(AXIS)
    with pytest.raises(DocumentError, match=r"^axis: profile: according to the model this current drives the axis"):
        fd.simulate(axis, profile="identify")
    with pytest.raises(DocumentError, match=r"^axis: controller"):
        fd.simulate(axis, gains={"proportional_a_per_rps": 30.0})
    text = AXIS.read_text().replace("proportional_a_per_rps:", "proportional_a_per_rps: 30.0  #")
    shutil.copytree(CONFIGS, tmp_path / "configs")
    path = tmp_path / "configs" / AXIS.name
    path.write_text(text)
    with pytest.raises(DocumentError, match=rf"^{path}:\d+: controller"):
        fd.simulate(path)


def test_an_axis_in_process_is_commissioned_and_its_record_accepted(tmp_path):
    shutil.copytree(CONFIGS, tmp_path / "configs")
    path = tmp_path / "configs" / AXIS.name
    asked = []
    record = fd.commission(path, may_move=lambda motion: not asked.append(motion), accept=True)
    assert record.passed
    assert asked
    named = fd.read_axis(path).file.commissioning
    assert named is not None
    assert (path.parent / named).exists()


def test_a_table_in_degrees_is_imported_once_its_unit_is_said(run, tmp_path):
    table = np.column_stack([run.time_s, 360.0 * run["position_rev"], run["current_command_a"]])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,theta,iq", comments="", fmt="%.9g")
    facts = {"torque_constant_nm_per_a": 0.148}
    given = {"units": {"theta": "deg", "iq": "A", "t": "s"}, "facts": facts, "accept_assumptions": True}
    done = fd.import_log(tmp_path / "log.csv", tmp_path / "out", columns={"position_rev": "theta"}, **given)
    again = fd.read_run(done.recordings[0])
    assert np.ptp(again["position_rev"]) == pytest.approx(np.ptp(run["position_rev"]), rel=1e-6)
    assert again.facts.torque_constant_nm_per_a == 0.148


def test_an_import_names_the_argument_that_answers_it(tmp_path):
    np.savetxt(tmp_path / "log.csv", np.ones((9, 2)), delimiter=",", header="a,b", comments="")
    with pytest.raises(DocumentError, match=r"^columns: no signal 'position': did you mean 'position_rev'"):
        fd.import_log(tmp_path / "log.csv", tmp_path / "out", columns={"position": "a"})
    with pytest.raises(DocumentError, match=r"^rate_hz: -1: a positive number"):
        fd.import_log(tmp_path / "log.csv", tmp_path / "out", rate_hz=-1.0)


def test_a_recording_becomes_a_table_of_some_of_its_signals(run, tmp_path):
    done = fd.export(run, tmp_path / "run.csv", columns=["velocity_rps", "reference_rps"], from_s=1.0, to_s=2.0)
    assert done.path.read_text().splitlines()[0].replace('"', "") == "time_s,velocity_rps,reference_rps"
    assert done.rows == 2000
    with pytest.raises(DocumentError, match="no recording: make it with run"):
        fd.export(fd.simulate(AXIS, profile=SHORT), tmp_path / "other.csv")


@pytest.mark.long
@pytest.mark.timeout(400)
def test_a_circle_gives_the_errors_before_and_after(tmp_path):
    closed = fd.close_the_loop(CONFIGS / "axis_undeclared.yaml", tmp_path / "circle", quick=True)
    assert closed.page.is_file()
    tracking = closed.source.tracking.metrics["measured"]
    if closed.adopted:
        assert tracking.after.ise < tracking.before.ise


def test_compensated_effects_are_evaluated_in_processes_as_in_this_one(tmp_path):
    """The table of effects holds addresses of kernels, which are others in another process."""
    axis = fd.read_axis(AXIS)
    cogging = effect_model("cogging", {"order": 12.0, "cosine_nm": 0.01, "sine_nm": 0.005}, {})
    fd.write_axis(replace(axis, model=axis.model.model_copy(update={"effects": [cogging]})), tmp_path / "axis.yaml")
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(
        "format: fffo_drive/scenario/1\nname: cogging\naxis: axis.yaml\nseeds: 2\n"
        "reference: {kind: paper, duration_s: 2}\ncontrollers: {pi+fffo: {toggle: ff}}\n"
    )
    there, here = (fd.evaluate(scenario, workers=workers) for workers in (2, 1))
    assert there.figure("true.ise", "pi+fffo") == here.figure("true.ise", "pi+fffo")
