"""The library: its names, records and files alike, and the same numbers as the command line."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import fffo_drive as fd
from fffo_drive.cli import main
from fffo_drive.documents import DocumentError
from fffo_drive.evaluation.metrics import error_metrics
from fffo_drive.model.parameters import write_model

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
AXIS = CONFIGS / "axis_simulated.yaml"
NAMES = {
    "Axis", "MeasuredRun", "adopt", "diagnose", "evaluate", "identify", "read_axis", "read_facts", "read_model",
    "read_run", "replay", "run", "simulate", "tune",
}  # fmt: skip


@pytest.fixture(scope="module")
def short_profile(tmp_path_factory):
    path = tmp_path_factory.mktemp("profile") / "short.yaml"
    path.write_text("profile: {kind: paper, duration_s: 12, seed: 3}\n")
    return path


@pytest.fixture(scope="module")
def simulated(short_profile):
    return fd.simulate(AXIS, toggle="ff", profile=short_profile, seed=5)


@pytest.fixture(scope="module")
def recorded(short_profile, tmp_path_factory):
    return fd.run(AXIS, tmp_path_factory.mktemp("run") / "short.mcap", toggle="ff", profile=short_profile)


def test_the_names_are_these_and_each_is_documented_and_typed():
    assert set(fd.__all__) == NAMES
    assert set(dir(fd)) == NAMES | {"__version__"}
    for name in NAMES:
        member = getattr(fd, name)
        assert inspect.getdoc(member), name
        if inspect.isfunction(member):
            assert "return" in member.__annotations__, name
            assert set(inspect.signature(member).parameters) <= set(member.__annotations__), name


def test_importing_the_package_loads_nothing_heavy():
    said = "import sys, fffo_drive; print([m for m in ('numba', 'scipy', 'numpy', 'pydantic') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'idenfity'"):
        _ = fd.idenfity


def test_a_simulated_run_has_signals_with_units_and_the_metrics_of_its_error(simulated):
    error_rps = simulated["reference_rps"] - simulated["true_velocity_rps"]
    inside = simulated["profile_sample"] < simulated.profile_samples
    expected = error_metrics(error_rps[inside], 5e-4)
    assert simulated.metrics == pytest.approx(expected, rel=1e-12)
    assert simulated.duration_s == pytest.approx(12.25, abs=1e-3)  # and the standstill after it
    assert repr(simulated).startswith("MeasuredRun('simulated': 245")
    page = simulated._repr_html_()
    assert "<svg" in page
    assert "<td>velocity_rps</td><td>rps</td>" in page


def test_friction_forward_helps_and_a_seed_is_a_seed(simulated, short_profile):
    again = fd.simulate(fd.read_axis(AXIS), toggle="ff", profile=short_profile, seed=5)
    assert np.array_equal(again["current_command_a"], simulated["current_command_a"])
    assert fd.simulate(AXIS, toggle="off", profile=short_profile, seed=5).metrics.ise > simulated.metrics.ise


def test_a_recorded_run_is_replayed_bit_for_bit_and_another_model_asks_for_another_current(recorded, tmp_path):
    assert fd.replay(recorded).exact
    axis = fd.read_axis(AXIS)
    friction = axis.model.friction
    stiffer = friction.coulomb_nm.model_copy(update={"value": 1.5 * friction.coulomb_nm.value})
    other = axis.model.model_copy(update={"friction": friction.model_copy(update={"coulomb_nm": stiffer})})
    write_model(tmp_path / "other.yaml", other)
    changed = fd.replay(recorded, tmp_path / "other.yaml")
    expected_a = 0.5 * friction.coulomb_nm.value / axis.model.torque_constant_nm_per_a
    assert 0.9 * expected_a < changed.largest_difference_a  # all of it in sliding, less in presliding
    assert 0.5 * expected_a < changed.rms_difference_a < expected_a


def test_a_run_that_was_not_recorded_is_not_replayed(simulated):
    with pytest.raises(DocumentError, match="only a recorded run can be replayed"):
        fd.replay(simulated)


def test_arrays_and_the_file_give_the_same_model_and_it_is_the_true_one(recorded):
    names = ("time_s", "position_rev", "velocity_rps", "current_command_a", "reference_rps")
    active = recorded["profile_sample"] >= 0
    arrays = {name: recorded[name][active] for name in names}
    from_arrays = fd.identify(fd.read_run(arrays, facts=recorded.facts)).model
    from_file = fd.identify(recorded).model
    for model in (from_arrays, from_file):
        assert model.inertia_kg_m2.value == pytest.approx(1.494e-4, rel=0.1)
        assert model.friction.coulomb_nm.value == pytest.approx(0.025, rel=0.2)
    assert from_arrays.inertia_kg_m2.value == pytest.approx(from_file.inertia_kg_m2.value, rel=0.01)


def test_the_command_line_finds_the_same_numbers(recorded, tmp_path, capsys):
    assert main(["identify", str(recorded.path), "--out", str(tmp_path / "out"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    found = fd.identify(recorded).result
    assert said["parameters"] == json.loads(json.dumps(found["parameters"]))
    model = fd.read_model(tmp_path / "out" / "model.yaml")
    assert main(["tune", str(tmp_path / "out" / "model.yaml"), "--out", str(tmp_path / "tuned"), "--json"]) == 0
    gains = json.loads(capsys.readouterr().out)["gains"]
    assert gains == fd.tune(model).design.gains._asdict()


def test_a_mapping_without_time_and_a_log_without_facts_say_what_to_give():
    with pytest.raises(DocumentError, match="time_s"):
        fd.read_run({"velocity_rps": np.zeros(10)})
    with pytest.raises(DocumentError, match="torque_constant_nm_per_a"):
        fd.identify(fd.read_run({"time_s": np.arange(10.0), "current_command_a": np.zeros(10)}))
    with pytest.raises(DocumentError, match="'forward' is none of off, ff, fb"):
        fd.simulate(AXIS, toggle="forward")


def test_pandas_is_asked_for_by_name_and_gets_the_signals_by_theirs(simulated, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas"):
        simulated.to_pandas()

    class Frame(dict):
        def set_index(self, name):
            return name, self

    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(DataFrame=Frame))
    index, frame = simulated.to_pandas()
    assert index == "time_s"
    assert np.array_equal(frame["velocity_rps"], simulated["velocity_rps"])
