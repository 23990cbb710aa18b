"""`fffo-drive identify` and `fffo-drive tune`, from files to files."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from commissioning.test_command import IDENTITY
from commissioning.test_record import NAME, axis_file, record_for
from identification.rig import TABLE_1
from identification.synthetic import PERIOD_S, TRUTH, chirp_record
from identification.test_dataset import write_csv

from fffo_drive.cli import identify as cli_identify
from fffo_drive.cli import main
from fffo_drive.commissioning.judge import CHECKS, judged
from fffo_drive.commissioning.record import UNEXPLAINED_SHARE, read_record, write_record
from fffo_drive.config.axis import read_axis
from fffo_drive.config.checks import law_margins, law_problems
from fffo_drive.config.drive_profile import profile_path, shipped_profiles
from fffo_drive.model.parameters import read_model


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "drive.yaml"
    path.write_text("torque_constant_nm_per_a: 0.148\nrated_current_a: 8.3\nresolver_bits: 15\nsample_rate_hz: 2000\n")
    return path


@pytest.mark.slow
def test_identify_writes_a_model_and_a_report(tmp_path, drive, capsys):
    record = chirp_record(30.0, lsb_rev=2.0**-15, noise_rev=1e-5)
    time = np.arange(record.samples) * PERIOD_S
    columns = {"time_s": time, "current_command_a": record.current_a, "position_rev": record.position_rev}
    log = write_csv(tmp_path / "run.csv.gz", columns)
    assert main(["identify", str(log), "--drive", str(drive), "--out", str(tmp_path / "out"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["doubts"] == []
    model = read_model(tmp_path / "out" / "model.yaml")
    assert model.friction.coulomb_nm.value == pytest.approx(TRUTH[3], rel=0.03)
    assert model.sensor_delay_s.value == 0.0
    assert len(model.provenance.runs[0]) == 64
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"model.yaml", "report.html", "report.json"}
    content = json.loads((tmp_path / "out" / "report.json").read_text())
    assert content["kind"] == "identify"
    assert content["results"]["residuals"]["run"]["torque_relative_percent"] < 2.0
    assert content["results"]["parameters"] == printed["parameters"]
    cli_identify._print(content["results"])
    j, *_ = capsys.readouterr().out.splitlines()
    assert j.split()[0] == "J"
    assert float(j.split()[1]) == pytest.approx(model.inertia_kg_m2.value, rel=1e-3)
    assert j.endswith("kg m2")


def test_identify_refuses_what_cannot_be_fitted(tmp_path, drive, capsys):
    time = np.arange(8000) * PERIOD_S
    columns = {"time_s": time, "current_command_a": 0.0 * time, "position_rev": np.sin(time)}
    log = write_csv(tmp_path / "run.csv.gz", columns)
    assert main(["identify", str(log), "--drive", str(drive), "--out", str(tmp_path / "out")]) == 78
    assert "nothing is excited" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_column_of_the_facts_that_a_log_lacks_is_named_with_its_place(tmp_path, capsys):
    log = write_csv(tmp_path / "run.csv", {"t": np.arange(4), "Torque_demand": np.arange(4), "Angle": np.arange(4)})
    facts = tmp_path / "facts.yaml"
    facts.write_text(
        "torque_constant_nm_per_a: 0.1\ncolumns:\n  time_s: t\n  position_rev: {column: Angel}\n"
        "  current_command_a: Torque demand\n"
    )
    assert main(["identify", str(log), "--drive", str(facts), "--out", str(tmp_path / "out")]) == 78
    said = capsys.readouterr().err
    assert f"{facts}:4: columns.position_rev: {log} has no column 'Angel': did you mean 'Angle'?" in said
    assert f"{facts}:5: columns.current_command_a: {log} has no column 'Torque demand': did you mean" in said


def test_tune_writes_gains_that_the_axis_file_accepts(tmp_path, capsys):
    axis = TABLE_1.parents[1] / "axis_simulated.yaml"
    assert main(["tune", str(TABLE_1), "--out", str(tmp_path), "--axis", str(axis), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    section = yaml.safe_load((tmp_path / "controller.yaml").read_text())["controller"]
    assert section["proportional_a_per_rps"] == pytest.approx(printed["gains"]["proportional_a_per_rps"], rel=1e-3)
    written = read_axis(tmp_path / axis.name)
    assert written.controller.observer.clamp_ratio == read_axis(axis).controller.observer.clamp_ratio
    model = read_model(tmp_path / written.model)
    assert law_problems(written, model, True) == law_problems(written, model, False) == []
    result = json.loads((tmp_path / "report.json").read_text())["results"]
    assert main(["tune", str(TABLE_1), "--out", str(tmp_path), "--axis", str(axis)]) == 0
    page, printed = (tmp_path / "report.html").read_text(), capsys.readouterr().out.splitlines()
    (said,) = (line for line in printed if line.startswith("friction damping"))
    assert f"The {said}." in page
    assert re.search(r"step: overshoot [\d.]+ %, at worst [\d.]+ % with the observer, settled in", "\n".join(printed))
    assert len(result["root_locus"]) > 50
    assert result["condition_14_nm_per_rev"] >= 0.0


def test_tune_writes_the_whole_law_also_for_an_old_file_and_keeps_what_it_does_not_choose(tmp_path, capsys):
    text = (TABLE_1.parents[1] / "axis_simulated.yaml").read_text()
    old = re.sub(r"  at_rest: .*\n", "  at_rest: {time_s: 0.05}\n", text.replace("axis/2", "axis/1"))
    axis = tmp_path / "axis.yaml"
    axis.write_text(old)
    assert not read_axis(axis).controller.feedforward.inertia
    assert main(["tune", str(TABLE_1), "--out", str(tmp_path / "out"), "--axis", str(axis)]) == 0
    capsys.readouterr()
    written = tmp_path / "out" / axis.name
    assert written.read_text().startswith("format: fffo_drive/axis/2\n")
    law = read_axis(written).controller
    said = yaml.safe_load((tmp_path / "out" / "controller.yaml").read_text())["controller"]
    assert law.feedforward.model_dump() == said["feedforward"] == dict.fromkeys(said["feedforward"], True)
    assert (law.observer.learns_in, law.at_rest.release_friction, law.at_rest.time_s) == ("integral", True, 0.05)
    assert law.at_rest.hold_a_per_rev_s > 0.0
    assert law.error_filter_s == 0.0  # as the file has it: the gains are for it
    margins = law_margins(read_axis(written), read_model(TABLE_1), observer_on=True)
    assert margins.phase_deg == pytest.approx(45.0, abs=0.2) or margins.gain == pytest.approx(2.5, abs=0.02)


def test_the_gains_of_tune_count_the_filter_of_the_error(tmp_path, capsys):
    """As in the axis file; without one as a file has it that says nothing."""
    found = {}
    for name, words in {"file": ["--axis", str(TABLE_1.parents[1] / "axis_simulated.yaml")], "none": []}.items():
        assert main(["tune", str(TABLE_1), "--out", str(tmp_path / name), *words]) == 0
        found[name] = yaml.safe_load((tmp_path / name / "controller.yaml").read_text())["controller"]
    capsys.readouterr()
    assert found["none"]["error_filter_s"] == found["file"]["error_filter_s"] == 0.0002
    gains = ("proportional_a_per_rps", "integral_a_per_rev")
    assert [found["none"][key] for key in gains] == [found["file"][key] for key in gains]
    margins = law_margins(read_axis(tmp_path / "file" / "axis_simulated.yaml"), read_model(TABLE_1), observer_on=True)
    assert min(margins.phase_deg - 45.0, 20.0 * (margins.gain - 2.5)) == pytest.approx(0.0, abs=0.3)


def test_tune_says_what_the_estimated_velocity_would_allow_and_a_tuning_on_it_has_exactly_that(tmp_path, capsys):
    def tuned(name: str) -> dict:
        options = ["tune", str(TABLE_1), "--out", str(tmp_path / name), "--axis", str(axis)]
        assert main(options) == 0
        printed.append(capsys.readouterr().out)
        return json.loads((tmp_path / name / "report.json").read_text())["results"]

    def integral_action(result: dict) -> float:
        gains = result["gains"]
        return gains["integral_a_per_rev"] * read_model(TABLE_1).torque_constant_nm_per_a + gains["observer_nm_per_rev"]

    axis, printed = axis_file(tmp_path), []
    before = tuned("drive")
    axis.write_text(axis.read_text().replace("controller:\n", "controller:\n  velocity: {source: estimated}\n"))
    after = tuned("estimated")
    ratio = before["on_the_estimate"]["integral_ratio"]
    assert ratio == pytest.approx(integral_action(after) / integral_action(before), rel=1e-9)
    assert ratio > 1.2
    assert after["on_the_estimate"] is None
    assert f"the same margins allow {ratio:.1f} times the integral action" in printed[0]
    assert "integral action" not in printed[1]
    assert f"the same margins allow {ratio:.1f} times" in (tmp_path / "drive" / "report.html").read_text()


def test_tune_designs_for_the_longer_delay_of_model_and_commissioning_and_keeps_the_record(tmp_path, capsys):
    axis = axis_file(tmp_path)
    assert main(["tune", str(TABLE_1), "--out", str(tmp_path / "first"), "--axis", str(axis)]) == 0  # no record yet
    capsys.readouterr()
    gains = {}
    for measured_s in (0.0020, 0.0040):  # the model's is 2.75 ms
        checks = [judged(name, "ok", "fine") for name in CHECKS if name != "delay"]
        delay = judged("delay", "ok", "").model_copy(update={"measured": measured_s})
        write_record(tmp_path / NAME, record_for(axis, IDENTITY, [*checks, delay]))
        out = tmp_path / f"{measured_s:g}"
        assert main(["tune", str(TABLE_1), "--out", str(out), "--axis", str(axis), "--json"]) == 0
        result = json.loads(capsys.readouterr().out)
        gains[measured_s] = result["gains"]["proportional_a_per_rps"]
        assert result["axis"]["delay_s"] == pytest.approx(max(measured_s, 0.00275) + 0.00025)
        assert any("commissioning" in text for text in result["warnings"]) == (measured_s > 0.00275)
        written = out / str(read_axis(out / axis.name).commissioning)
        assert read_record(written) == read_record(tmp_path / NAME)
    assert gains[0.0040] < 0.8 * gains[0.0020]


def test_tune_advises_a_diagnosis_where_commissioning_found_no_single_rigid_inertia(tmp_path, capsys):
    axis = axis_file(tmp_path)
    rigid = [judged(name, "ok", "fine") for name in CHECKS]
    swings = judged("motion", "warning", "it slides", "diagnose", {UNEXPLAINED_SHARE: 0.47})
    elastic = tmp_path / "elastic.yaml"
    found = {"share": 0.3, "frequency_hz": 30.0, "damping": 0.05}
    effect = {"name": "elasticity", "parameters": {name: {"value": value} for name, value in found.items()}}
    elastic.write_text(yaml.safe_dump(yaml.safe_load(TABLE_1.read_text()) | {"effects": [effect]}))

    def tuned_with(checks: list, model: Path) -> tuple[str, float]:
        write_record(tmp_path / NAME, record_for(axis, IDENTITY, checks))
        assert main(["tune", str(model), "--out", str(tmp_path / "out"), "--axis", str(axis), "--json"]) == 0
        result = json.loads(capsys.readouterr().out)
        return " ".join(result["warnings"]), result["axis"]["delay_s"]

    assert "rigid inertia" not in tuned_with(rigid, TABLE_1)[0]
    late = judged("delay", "ok", "").model_copy(update={"measured": 0.019})  # elastic, taken for rigid
    moved = [swings, late, *(check for check in rigid if check.name not in ("motion", "delay"))]
    said, delay_s = tuned_with(moved, TABLE_1)
    assert "leaves 47 % of the velocity variance unexplained" in said
    assert delay_s == pytest.approx(0.01925)
    said, delay_s = tuned_with(moved, elastic)  # it has been diagnosed, and has the delay that goes with the elasticity
    assert "rigid inertia" not in said
    assert "commissioning" not in said
    assert delay_s == pytest.approx(0.003)


def test_the_axis_file_that_tune_writes_finds_eds_and_profile_of_its_own(tmp_path, capsys):
    (tmp_path / "mine.yaml").write_bytes(shipped_profiles()["maxon_epos4"].read_bytes())
    axis = axis_file(tmp_path, "  node_id: 1\n", "  node_id: 1\n  profile: mine\n  eds: drive.eds\n")
    assert main(["tune", str(TABLE_1), "--out", str(tmp_path / "tuned"), "--axis", str(axis)]) == 0
    written = tmp_path / "tuned" / axis.name
    drive = read_axis(written).drive
    assert (written.parent / drive.eds).resolve() == tmp_path / "drive.eds"
    assert profile_path(written, drive.profile).resolve() == tmp_path / "mine.yaml"


def test_files_that_were_not_written_here_are_not_overwritten(tmp_path, drive, capsys):
    axis = axis_file(tmp_path)
    before = axis.read_bytes()
    words = ["tune", str(TABLE_1), "--axis", str(axis), "--out", str(tmp_path)]
    assert main(words) == 78
    assert f"{axis}: not from `tune`" in capsys.readouterr().err
    (tmp_path / "report.json").write_text('{"kind": "tune"}')  # of gains without an axis file
    assert main(words) == 78
    assert f"{axis} is the axis file to copy" in capsys.readouterr().err
    assert axis.read_bytes() == before
    model = tmp_path / "fit" / "model.yaml"
    model.parent.mkdir()
    model.write_text("mine")
    assert main(["identify", "log.csv", "--drive", str(drive), "--out", str(model.parent)]) == 78
    assert f"{model}: not from `identify`" in capsys.readouterr().err
    assert model.read_text() == "mine"
