"""The library: its names, records and files alike, and the same numbers as the command line."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fffo_drive as fd
from fffo_drive import library
from fffo_drive.cli import main
from fffo_drive.documents import DocumentError
from fffo_drive.evaluation.metrics import error_metrics
from fffo_drive.workflows.errors import RecordingGapError

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
AXIS = CONFIGS / "axis_simulated.yaml"
NAMES = {
    "Axis", "ControlLaw", "LawInput", "MeasuredRun", "RunMetrics", "adopt", "close_the_loop", "commission",
    "diagnose", "evaluate", "export", "identify", "import_log", "margins", "read_axis", "read_facts", "read_model",
    "read_run", "register_law", "replay", "run", "simulate", "tune", "write_axis", "write_model",
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
    inside = simulated["profile_sample"] < simulated.profile_samples
    for own, column in zip(simulated.metrics, ("velocity_rps", "true_velocity_rps"), strict=True):
        error_rps = simulated["reference_rps"] - simulated[column]
        assert own == pytest.approx(error_metrics(error_rps[inside], 5e-4), rel=1e-12)
    assert simulated.time_s[0] == 0.0
    assert simulated.duration_s == pytest.approx(12.25, abs=1e-3)  # and the standstill after it
    assert repr(simulated).startswith("MeasuredRun('simulated': 245")
    page = simulated._repr_html_()
    assert "<svg" in page
    assert "<td>velocity_rps</td><td>rps</td>" in page
    with pytest.raises(KeyError, match="no signal 'velocty_rps': did you mean 'velocity_rps'"):
        simulated["velocty_rps"]


def test_friction_forward_helps_and_a_seed_is_a_seed(simulated, short_profile):
    again = fd.simulate(fd.read_axis(AXIS), toggle="ff", profile=short_profile, seed=5)
    assert np.array_equal(again["current_command_a"], simulated["current_command_a"])
    without = fd.simulate(AXIS, toggle="off", profile=short_profile, seed=5)
    assert all(worse.ise > own.ise for worse, own in zip(without.metrics, simulated.metrics, strict=True))


def same(one, other):
    return np.array_equal(one["current_command_a"], other["current_command_a"])


def test_a_simulation_uses_the_axis_gains_and_model_that_it_is_given(simulated, short_profile):
    """Each way to say the same law gives the same currents, and another law gives others."""
    axis, key = fd.read_axis(AXIS), "controller.proportional_a_per_rps"
    own = axis.file.controller.proportional_a_per_rps
    settings = {"toggle": "ff", "profile": short_profile, "seed": 5}
    softer = fd.simulate(axis.change({key: 0.8 * own}), **settings)
    assert not same(softer, simulated)
    assert same(fd.simulate(axis, gains={"proportional_a_per_rps": 0.8 * own}, **settings), softer)
    assert same(fd.simulate(axis.change({key: 0.8 * own}).change({key: own}), **settings), simulated)
    friction = axis.model.friction
    higher = friction.coulomb_nm.model_copy(update={"value": 1.2 * friction.coulomb_nm.value})
    other = axis.model.model_copy(update={"friction": friction.model_copy(update={"coulomb_nm": higher})})
    by_model = fd.simulate(axis, model=other, **settings)
    assert not same(by_model, simulated)
    assert same(fd.simulate(replace(axis, model=other), **settings), by_model)
    tuned = fd.tune(axis.model, axis=axis)
    by_tune = fd.simulate(axis, gains=tuned, **settings)
    assert same(fd.simulate(axis.change({"controller": tuned.section(5.0)}), **settings), by_tune)


def test_a_profile_is_an_array_a_section_or_a_file(short_profile):
    axis = fd.read_axis(AXIS)
    ramp_rps = np.minimum(np.arange(4001) * 5e-4, 1.0)
    ramp_rps = np.concatenate([ramp_rps, ramp_rps[::-1]])
    run = fd.simulate(axis, profile=ramp_rps, seed=1)
    asked = run["reference_rps"][run["profile_sample"] < run.profile_samples]
    assert asked == pytest.approx(ramp_rps, abs=1e-9)
    section = {"kind": "points", "points": [(0.0, 0.0), (1.0, 1.0), (2.0, 1.0)]}
    assert fd.simulate(axis, profile=section, seed=1)["reference_rps"].max() == pytest.approx(1.0)
    with pytest.raises(DocumentError, match=r"profile: shape \(2, 2\): finite velocities in rps"):
        fd.simulate(axis, profile=np.zeros((2, 2)))
    with pytest.raises(DocumentError, match="axis: profile"):
        fd.simulate(axis, profile={"kind": "circle"})


def test_a_key_that_is_none_is_named_with_the_nearest():
    axis = fd.read_axis(AXIS)
    for keys, said in (
        ({"controller.proportional": 1.0}, "axis: controller.proportional.*proportional_a_per_rps"),
        (
            {"controler.observer.toggle": "ff"},
            "axis: controler.observer.toggle: no section 'controler': .*'controller'",
        ),
        ({"controller.observer.toggle": "fast"}, "axis: controller.observer.toggle"),
        ({"loop.rate_hz": "2 kHz"}, "axis: loop.rate_hz"),
    ):
        with pytest.raises(DocumentError, match=said):
            axis.change(keys)
    with pytest.raises(DocumentError, match="phase margin"):
        fd.simulate(axis, gains={"proportional_a_per_rps": 0.2})


def test_what_was_changed_is_run_once_it_is_written(short_profile, tmp_path):
    axis = fd.read_axis(AXIS)
    friction = axis.model.friction
    higher = friction.coulomb_nm.model_copy(update={"value": 1.2 * friction.coulomb_nm.value})
    model = axis.model.model_copy(update={"friction": friction.model_copy(update={"coulomb_nm": higher})})
    changed = replace(axis.change({"controller.integral_a_per_rev": 5.0}), model=model)
    with pytest.raises(DocumentError, match=r"it has been changed since .*axis_simulated.yaml was read.*fd.write_axis"):
        fd.run(changed, tmp_path / "no.mcap")
    with pytest.raises(DocumentError, match="it has been changed since"):
        fd.adopt(tmp_path / "model.yaml", changed)
    (tmp_path / "place").mkdir()
    written = fd.write_axis(changed, tmp_path / "place" / "mine.yaml")
    assert written.model.friction == model.friction
    assert written.file.controller == changed.file.controller
    settings = {"profile": short_profile, "seed": 5}
    assert same(fd.simulate(written, **settings), fd.simulate(changed, **settings))
    made = fd.run(written, tmp_path / "run.mcap", profile=short_profile)
    assert fd.replay(made).exact
    again = fd.write_axis(fd.read_axis(AXIS), tmp_path / "same.yaml")
    assert again.model == axis.model
    assert not (tmp_path / "same_model.yaml").exists()  # the model is that of the file which it names


def test_a_recorded_run_is_replayed_bit_for_bit_and_another_model_asks_for_another_current(recorded, tmp_path):
    assert fd.replay(recorded).exact
    axis = fd.read_axis(AXIS)
    friction = axis.model.friction
    stiffer = friction.coulomb_nm.model_copy(update={"value": 1.5 * friction.coulomb_nm.value})
    other = axis.model.model_copy(update={"friction": friction.model_copy(update={"coulomb_nm": stiffer})})
    fd.write_model(other, tmp_path / "other.yaml")
    changed = fd.replay(recorded, tmp_path / "other.yaml")
    expected_a = 0.5 * friction.coulomb_nm.value / axis.model.torque_constant_nm_per_a
    assert 0.9 * expected_a < changed.largest_difference_a  # all of it in sliding, less in presliding
    assert 0.5 * expected_a < changed.rms_difference_a < expected_a


@pytest.mark.parametrize(("axis_name", "said"), [("table1.yaml", True), ("axis.yaml", False)])
def test_a_recording_has_its_axis_and_model_though_they_share_a_name_or_do_not_say_what_they_are(
    axis_name, said, short_profile, tmp_path
):
    text = AXIS.read_text().replace("file: sim", f"file: {CONFIGS}/sim").replace("model: m", f"model: {CONFIGS}/m")
    axis = tmp_path / axis_name  # its model is models/table1.yaml
    axis.write_text(text if said else text.replace("format: fffo_drive/axis/2\n", ""))
    made = fd.run(axis, tmp_path / "run.mcap", profile=short_profile)
    assert made.facts == fd.simulate(axis, profile=short_profile).facts
    assert fd.replay(made, CONFIGS / "models" / "table1.yaml").largest_difference_a == 0.0
    assert fd.evaluate(runs=[made]).controllers == ("pi+fffo+" if said else "pi+fffo",)  # it is of axis/1 then


def test_a_run_that_was_not_recorded_is_not_replayed(simulated):
    with pytest.raises(DocumentError, match="no recording: make it with run"):
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


ARRAYS = ("time_s", "position_rev", "velocity_rps", "current_command_a")


def arrays_of(run, name, torque_constant_nm_per_a=0.148):
    return fd.read_run(
        {key: run[key] for key in ARRAYS}, torque_constant_nm_per_a=torque_constant_nm_per_a, name=name
    )  # fmt: skip


def test_a_torque_constant_replaces_that_of_a_recording_and_keeps_its_other_facts(recorded):
    found = fd.read_run(recorded.path, torque_constant_nm_per_a=0.2).facts
    assert found == recorded.facts.model_copy(update={"torque_constant_nm_per_a": 0.2})
    assert (found.resolver_bits, found.absolute_angle) == (15, True)
    for wrong in (-1.0, 0.0, float("nan")):
        for given in (None, recorded.facts):
            with pytest.raises(DocumentError, match="torque_constant_nm_per_a"):
                fd.read_run(recorded.path, facts=given, torque_constant_nm_per_a=wrong)


@pytest.mark.parametrize("position", [np.zeros(9), np.zeros((10, 1)), np.zeros(0)])
def test_arrays_of_other_lengths_are_named(position):
    with pytest.raises(DocumentError, match=r"axis: position_rev: shape \("):
        fd.read_run({"time_s": np.arange(10.0), "position_rev": position}, name="axis")
    with pytest.raises(DocumentError, match="at least 2 samples"):
        fd.read_run({"time_s": np.zeros(1), "position_rev": np.zeros(1)})


def test_a_recording_cut_off_before_its_rows_is_shown_as_empty(recorded, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recorded.path.read_bytes()[:9000])
    with pytest.warns(UserWarning, match="0 rows, up to the last whole chunk, were read$"):
        run = fd.read_run(cut)
    start = f"MeasuredRun('cut.mcap': 0 samples, 0 s, {len(run.columns)} signals"
    assert repr(run) == f"{start}, cut: its recording is incomplete)"
    assert "0 samples" in run._repr_html_()


def test_a_recording_cut_in_its_rows_warns_how_much_was_read_and_how_to_recover_it(recorded, tmp_path):
    whole = recorded.path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 6 // 10])
    with pytest.warns(UserWarning, match="log recover") as caught:
        run = fd.read_run(cut)
    assert 0 < run.time_s.size < recorded.time_s.size
    (said,) = {str(warning.message) for warning in caught}
    assert said == run.cut
    assert said.startswith(f"{cut} ends at byte {len(whole) * 6 // 10}")
    assert f"; {run.time_s.size} rows, " in said
    assert f"`fffo-drive log recover {cut} NEW.mcap`" in said
    for shown in (repr(run), run._repr_html_()):
        assert ", cut: its recording is incomplete)" in shown
    assert recorded.cut is None
    assert "cut" not in repr(recorded)


def test_a_table_whose_last_line_is_cut_warns(recorded, tmp_path):
    table = tmp_path / "log.csv"
    np.savetxt(
        table, np.column_stack([recorded[name][:100] for name in ARRAYS]), delimiter=",", header=",".join(ARRAYS)
    )
    table.write_text(table.read_text()[:-60])
    with pytest.warns(UserWarning, match="log.csv: the last line ends in the middle"):
        assert fd.read_run(table, torque_constant_nm_per_a=0.148).time_s.size == 99


def test_runs_of_one_name_are_two_runs(simulated):
    found = fd.identify([arrays_of(simulated, "run"), arrays_of(simulated, "run")])
    assert len(found.result["residuals"]) == 2


def test_runs_of_two_torque_constants_are_not_one_axis_unless_the_facts_say_so(simulated):
    runs = [arrays_of(simulated, "a"), arrays_of(simulated, "b", 0.3)]
    for both in (fd.identify, fd.diagnose):
        with pytest.raises(DocumentError, match="b: its facts are not those of a"):
            both(runs)
    assert fd.identify(runs, facts=runs[1].facts).model.torque_constant_nm_per_a == 0.3


def test_a_run_is_no_proof_of_what_was_chosen_on_it(simulated):
    with pytest.raises(DocumentError, match="b: a run cannot be fitted and held out"):
        fd.diagnose(arrays_of(simulated, "a"), arrays_of(simulated, "b"))


def test_a_simulated_current_is_an_open_loop_as_in_its_recording(tmp_path):
    profile = tmp_path / "current.yaml"
    profile.write_text("profile: {kind: identify, lowest_hz: 0.5, duration_s: 4, high_a: 0.6, low_a: 0.18}\n")
    records = [
        fd.simulate(AXIS, profile=profile).record(),
        fd.run(AXIS, tmp_path / "current.mcap", profile=profile).record(),
    ]
    for name in ("current_a", "position_rev", "velocity_rps"):
        assert np.array_equal(*(getattr(record, name) for record in records)), name
    assert [record.reference_rps for record in records] == [None, None]


def test_a_recording_that_is_not_whole_is_an_error(short_profile, tmp_path, monkeypatch):
    made = library.record_run

    def with_rows_lost(*given):
        outcome = made(*given)
        return outcome._replace(recorder=outcome.recorder._replace(rows_lost=7))

    monkeypatch.setattr(library, "record_run", with_rows_lost)
    with pytest.raises(RecordingGapError, match=r"gap\.mcap: .*7"):
        fd.run(AXIS, tmp_path / "gap.mcap", profile=short_profile)


def test_a_divided_recording_names_its_files(short_profile, tmp_path, monkeypatch):
    made = library.record_run
    monkeypatch.setattr(
        library, "record_run", lambda *given: (lambda done: done._replace(files=done.files * 2))(made(*given))
    )
    with pytest.raises(DocumentError, match="read each with read_run"):
        fd.run(AXIS, tmp_path / "two.mcap", profile=short_profile)


def test_the_package_tells_a_type_checker_that_it_has_types():
    assert (Path(fd.__file__).parent / "py.typed").exists()


def test_the_command_line_finds_the_same_numbers(recorded, tmp_path, capsys):
    assert main(["identify", str(recorded.path), "--out", str(tmp_path / "out"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    found = fd.identify(recorded).result
    assert said["parameters"] == json.loads(json.dumps(found["parameters"]))
    model = fd.read_model(tmp_path / "out" / "model.yaml")
    assert main(["tune", str(tmp_path / "out" / "model.yaml"), "--out", str(tmp_path / "tuned"), "--json"]) == 0
    gains = json.loads(capsys.readouterr().out)["gains"]
    tuned = fd.tune(model)
    assert gains == tuned.design.gains._asdict()
    assert f"Kp {gains['proportional_a_per_rps']:.4g} A/rps" in repr(tuned)
    assert len(repr(tuned)) < 150


COGGING_NM = 0.0075  # configs/simulated_undeclared.yaml, order 6


@pytest.mark.long
@pytest.mark.timeout(300)
def test_arrays_are_diagnosed_and_what_is_found_is_adopted_as_on_the_command_line(tmp_path, capsys):
    axis_text = (CONFIGS / "axis_undeclared.yaml").read_text()
    axis = tmp_path / "axis.yaml"
    axis.write_text(axis_text.replace("file: sim", f"file: {CONFIGS}/sim").replace("model: m", f"model: {CONFIGS}/m"))
    runs = []
    for seed in (1, 2, 3):
        profile = tmp_path / f"{seed}.yaml"
        profile.write_text(f"profile: {{kind: paper, duration_s: 12, seed: {seed}}}\n")
        runs.append(arrays_of(fd.simulate(axis, profile=profile, seed=seed), f"run {seed}"))
    found = fd.diagnose(runs[:2], runs[2], out=tmp_path / "found")
    cogging = next(finding for finding in found.findings if finding.name == "cogging")
    numbers = {number.name: number.value for number in cogging.parameters}
    assert cogging.accepted
    assert numbers["order"] == pytest.approx(6.0, rel=1e-3)  # fitted: the arrays declare no resolver
    assert np.hypot(numbers["cos_nm"], numbers["sin_nm"]) == pytest.approx(COGGING_NM, rel=0.1)

    model = tmp_path / "found" / "model.yaml"
    looked = fd.adopt(model, axis, dry_run=True)
    assert main(["adopt", str(model), "--axis", str(axis), "--dry-run", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [gate._asdict() for gate in looked.gates] == said["gates"]
    assert looked.passed
    assert repr(looked) == f"Adopted(not yet in service; {len(looked.gates)} gates)"
    before = axis.read_text()
    assert fd.adopt(model, axis).entry is not None
    assert before != axis.read_text()
    assert fd.read_axis(axis).model.effects[0].name == "cogging"


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "short.yaml"
    path.write_text(f"""\
format: fffo_drive/scenario/1
name: short
axis: {AXIS}
seeds: 2
reference: {{kind: paper, duration_s: 2, slope: 0}}
controllers:
  pi: {{toggle: "off"}}
  pi+fffo: {{toggle: ff}}
""")
    return path


def test_a_scenario_has_the_figures_of_the_command_line(scenario, tmp_path, capsys):
    words = ["evaluate", str(scenario), "--workers", "1", "--out", str(tmp_path / "out"), "--json"]
    assert main(words) == 0
    said = json.loads(capsys.readouterr().out)
    found = fd.evaluate(scenario, workers=1)
    assert list(found.controllers) == said["controllers"] == ["pi", "pi+fffo"]
    assert found.seeds == (1, 2)
    for name in ("true.ise", "measured.mae"):
        for controller in found.controllers:
            assert found.figure(name, controller) == said["figures"][name][controller]["value"]
    assert found.figure("true.ise", "pi+fffo") < found.figure("true.ise", "pi")


def test_where_no_seed_runs_to_its_end_the_faults_are_the_answer(scenario, tmp_path, capsys):
    text = AXIS.read_text().replace("following_error_rps: 8", "following_error_rps: 0.05")
    text = text.replace("following_error_s: 0.2", "following_error_s: 0.001")
    text = text.replace("file: sim", f"file: {CONFIGS}/sim").replace("model: m", f"model: {CONFIGS}/m")
    (tmp_path / "axis.yaml").write_text(text)
    (tmp_path / "trips.yaml").write_text(scenario.read_text().replace(str(AXIS), "axis.yaml"))
    words = ["evaluate", str(tmp_path / "trips.yaml"), "--workers", "1", "--out", str(tmp_path / "out")]
    assert main(words) == 70
    said = capsys.readouterr().err
    assert "fffo-drive evaluate: no seed on which every controller ran to its end" in said
    assert "pi, seed 2: velocity error beyond envelope.following_error_rps" in said


def test_recordings_have_the_figures_of_the_command_line_and_one_that_broke_off_is_a_warning(
    recorded, short_profile, tmp_path, capsys
):
    other = fd.run(AXIS, tmp_path / "off.mcap", toggle="off", profile=short_profile)
    files = [str(other.path), str(recorded.path)]
    assert main(["evaluate", "--runs", *files, "--out", str(tmp_path / "out"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    found = fd.evaluate(runs=[other, recorded])
    assert list(found.controllers) == said["controllers"] == ["pi+", "pi+fffo+"]
    for controller, run in (("pi+", other), ("pi+fffo+", recorded)):
        assert found.figure("true.ise", controller) == said["figures"]["true.ise"][controller]["value"]
        assert found.figure("true.ise", controller) == pytest.approx(run.metrics.shaft.ise, rel=1e-9)
    shorter = tmp_path / "shorter.yaml"
    shorter.write_text("profile: {kind: paper, duration_s: 3, seed: 3}\n")
    third = fd.run(AXIS, tmp_path / "third.mcap", toggle="off", profile=shorter)
    with pytest.warns(UserWarning, match="have different profiles"):
        fd.evaluate(runs=[third, recorded])
    with pytest.raises(DocumentError, match="a scenario file or runs"):
        fd.evaluate()


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
