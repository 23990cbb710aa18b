"""Adoption: each gate by itself, the model line of an axis file, the history and the way back, and the command."""

from __future__ import annotations

import contextlib
import json
import math
import socket
import threading
from pathlib import Path

import pytest
import yaml

from fffo_drive.cli import main
from fffo_drive.cli.run import next_step
from fffo_drive.config.adoption import history_path, read_history
from fffo_drive.config.axis import AxisFile, build_profile, model_of, read_axis
from fffo_drive.config.axis_text import replace_file, with_line
from fffo_drive.config.effects import (
    angle_slope_nm_per_rev,
    compensated_terms,
    compensation_table,
    effect_problems,
    services,
)
from fffo_drive.control.compensation import COUNT
from fffo_drive.control.reference import MODE_CURRENT
from fffo_drive.daemon.places import WATCH
from fffo_drive.documents import DocumentError
from fffo_drive.model.effects.table import Term
from fffo_drive.model.parameters import EffectModel, Provenance, Quantity, read_model, write_model
from fffo_drive.workflows.adopt import put_in_service, roll_back
from fffo_drive.workflows.adoption_gates import compensation_gate, gates, held_out_gate, interval_gate, stability_gate
from fffo_drive.workflows.plan import make_plan

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
AXIS = read_axis(CONFIGS / "axis_simulated.yaml")
MODEL = model_of(CONFIGS / "axis_simulated.yaml", AXIS)


def effect(name="cogging", sd=2e-4, datum="absolute", **values):
    values = values or {"cos_nm": 0.004, "sin_nm": 0.003, "order": 6.0}
    held = ("order", "ratio")
    parameters = {
        key: Quantity(value=value, sd=None if key in held else sd, source="fitted") for key, value in values.items()
    }
    return EffectModel(name=name, parameters=parameters, datum=datum)


def with_effects(*effects):
    return MODEL.model_copy(update={"effects": list(effects)})


def report_of(before=0.010, after=0.006, reach=0.001):
    def figures(value):
        return {"held_out": {"torque_rms_nm": value, "interval_95": {"torque_rms_nm": [value - reach, value + reach]}}}

    return {"format": "fffo_drive/diagnosis/1", "verdict": "effects_found", "before": figures(before),
            "after": figures(after), "effects": [{"name": "cogging", "accepted": True}]}  # fmt: skip


def changed(axis, **effects_section):
    data = axis.model_dump()
    data["controller"]["effects"].update(effects_section)
    return AxisFile.model_validate(data)


def test_what_the_data_do_not_decide_is_not_put_in_service():
    sure, undecided = effect(), effect().model_copy(update={"alternatives": ["torque_ripple"]})
    assert [term.name for term in compensated_terms(AXIS, with_effects(sure))] == ["cogging"]
    assert compensated_terms(AXIS, with_effects(undecided)) == []
    (service,) = services(AXIS, with_effects(undecided))
    assert service.reason is not None
    assert "cogging or torque_ripple" in service.reason
    assert "--decide cogging" in service.reason


def test_the_held_out_error_has_to_fall_for_sure():
    assert held_out_gate(report_of()).passed
    assert not held_out_gate(report_of(after=0.0101)).passed
    assert not held_out_gate(report_of(after=0.0097, reach=0.001)).passed
    assert "diagnose" in held_out_gate(None).text
    assert "--held-out" in held_out_gate({"before": {}, "after": {}}).text


def test_a_diagnosis_that_does_not_carry_over_is_refused_with_its_own_reason():
    headline = "No finding carries over: on the held-out runs the torque error is not smaller."
    refused = held_out_gate(report_of() | {"verdict": "nothing_carries_over", "headline": headline})
    assert not refused.passed
    assert refused.text == headline


@pytest.mark.parametrize("broken", [{"before": None}, {"after": None}])
def test_a_held_out_error_that_is_no_number_is_refused(broken):
    report = report_of()
    for key in broken:
        report[key]["held_out"] = {"torque_rms_nm": None, "interval_95": {"torque_rms_nm": [None, None]}}
    gate = held_out_gate(report)
    assert not gate.passed
    assert "not finite" in gate.text


def test_an_interval_without_an_end_shows_nothing_by_itself():
    report = report_of(after=0.0097)
    for key in ("before", "after"):
        report[key]["held_out"]["interval_95"]["torque_rms_nm"] = [None, None]
    assert not held_out_gate(report).passed
    regime = {"held_out_regime": {"torque_rms_nm": None}}
    report["effects"][0] |= {"before": regime, "after": {"held_out_regime": {"torque_rms_nm": 0.001}}}
    assert not held_out_gate(report).passed
    report["effects"][0]["before"] = {"held_out_regime": {"torque_rms_nm": 0.002}}
    assert held_out_gate(report).passed


def test_what_is_not_explained_is_shown_and_does_not_refuse():
    rest = {"rms_nm": 0.004, "floor_nm": 0.002, "sentence": "75 % of what is left could be explained"}
    report = report_of() | {"unexplained_rest": rest}
    found = {gate.name: gate for gate in gates(AXIS, MODEL, with_effects(effect()), report, False)}
    assert found["unexplained rest"].passed
    assert found["unexplained rest"].text == rest["sentence"]
    none = gates(AXIS, MODEL, with_effects(effect()), report | {"unexplained_rest": None}, False)
    assert "unexplained rest" not in {gate.name for gate in none}


def test_a_strength_has_to_differ_from_zero():
    assert interval_gate(effect()).passed
    assert interval_gate(effect()).text == (  # 0.004 and 0.003 over 2e-4
        "cos_nm = 0.004 +- 0.0002; all 2 strengths together: 25.0 standard deviations from zero, 2.8 needed"
    )
    assert interval_gate(effect(cos_nm=0.004, sin_nm=0.0)).text == (
        "cos_nm = 0.004 +- 0.0002; 20.0 standard deviations from zero, 2.0 needed"
    )
    assert not interval_gate(effect(sd=5e-3)).passed
    assert not interval_gate(effect(sd=None)).passed


def test_what_cannot_be_given_ahead_is_left_out_with_its_reason():
    model = with_effects(
        effect(),
        effect("elasticity", share=0.2, frequency_hz=40.0, damping=0.03),
        effect("unbalance", datum="run", sin_nm=0.01, ratio=160.0),
        effect("quadratic_drag", drag_nm_per_rps2=1e-4),
    )
    found = {s.effect.name: s.reason for s in services(AXIS, model)}
    assert found["cogging"] is None
    assert found["quadratic_drag"] is None
    assert "not known in advance" in found["elasticity"]
    assert "absolute_angle" in found["unbalance"]
    assert [term.name for term in compensated_terms(AXIS, model)] == ["cogging", "quadratic_drag"]
    assert compensation_table(AXIS, model)[COUNT] == 2.0
    only = changed(AXIS, out_of_service=["cogging"])
    assert [term.name for term in compensated_terms(only, model)] == ["quadratic_drag"]
    assert compensation_table(changed(AXIS, compensate=False), model)[COUNT] == 0.0
    assert compensation_gate(AXIS, model).passed
    assert not compensation_gate(AXIS, with_effects(effect("elasticity", share=0.2, frequency_hz=40.0))).passed


def test_forms_of_friction_that_the_data_do_not_separate_are_compensated_and_undecided_causes_are_not():
    def reason(name, *alternatives):
        model = with_effects(effect(name).model_copy(update={"alternatives": list(alternatives)}))
        return services(AXIS, model)[0].reason

    assert reason("presliding_shape", "stribeck_shape", "frictional_lag") is None
    assert "a law of another version" in reason("second_surface", "a law of another version")
    assert "second_surface or quadratic_drag" in reason("second_surface", "quadratic_drag")
    assert "quadratic_drag or stribeck_shape" in reason("quadratic_drag", "stribeck_shape")


def test_the_slope_over_the_angle_is_that_of_the_wave():
    config = MODEL.axis_config()
    cogging = Term("cogging", {"cos_nm": 0.004, "sin_nm": 0.003, "order": 6.0})
    assert angle_slope_nm_per_rev(cogging, config, 0.1) == pytest.approx(0.005 * 2.0 * math.pi * 6.0, rel=1e-3)
    unbalance = Term("unbalance", {"sin_nm": 0.01, "ratio": 160.0})
    assert angle_slope_nm_per_rev(unbalance, config, 0.1) == pytest.approx(0.01 * 2.0 * math.pi / 160.0, rel=1e-3)
    ripple = Term("friction_ripple", {"cos_share": 0.2, "order": 2.0})
    assert angle_slope_nm_per_rev(ripple, config, 0.1) == pytest.approx(0.067 * 0.2 * 4.0 * math.pi, rel=1e-3)
    assert angle_slope_nm_per_rev(Term("quadratic_drag", {"drag_nm_per_rps2": 1e-3}), config, 0.1) == 0.0


def test_a_slope_that_breaks_the_proof_is_refused():
    steep = with_effects(effect(cos_nm=0.02, order=40.0))
    profile = build_profile(AXIS.profile, AXIS.loop.period_s)
    papers = AXIS.model_copy(update={"controller": AXIS.controller.papers})
    assert effect_problems(AXIS, with_effects(effect()), profile, True) == []
    assert effect_problems(papers, with_effects(effect()), profile, True) == []
    assert "condition (14)" in effect_problems(papers, steep, profile, True)[0]
    assert stability_gate(AXIS, with_effects(effect())).passed
    assert not stability_gate(AXIS, steep).passed
    assert effect_problems(AXIS, MODEL, profile, True) == []


def test_no_model_is_exchanged_while_there_is_torque():
    found = {torque: gates(AXIS, MODEL, with_effects(effect()), report_of(), torque) for torque in (True, False, None)}
    assert [gate.name for gate in found[True] if not gate.passed] == ["drive disabled"]
    assert all(gate.passed for torque in (False, None) for gate in found[torque])


@pytest.fixture
def axis_path(tmp_path):
    text = (CONFIGS / "axis_simulated.yaml").read_text()
    text = text.replace("model: models/table1.yaml", "model: table1.yaml   # as printed")
    path = tmp_path / "axis.yaml"
    path.write_text(text.replace("simulated_drive.yaml", str(CONFIGS / "simulated_drive.yaml")))
    write_model(tmp_path / "table1.yaml", read_model(CONFIGS / "models" / "table1.yaml"))
    (tmp_path / "found").mkdir()
    write_model(tmp_path / "found" / "model.yaml", with_effects(effect()))
    (tmp_path / "found" / "report.json").write_text(json.dumps(report_of()))
    return path


def test_the_model_line_is_replaced_and_nothing_else(axis_path):
    before = axis_path.read_text()
    replace_file(axis_path, with_line(axis_path, "model", "found/model.yaml"))
    after = axis_path.read_text()
    assert "model: found/model.yaml   # as printed" in after
    assert after.replace("found/model.yaml", "table1.yaml") == before
    assert read_axis(axis_path).model == "found/model.yaml"


def test_into_service_and_back(axis_path):
    model_path = axis_path.parent / "found" / "model.yaml"
    put_in_service(axis_path, model_path, [])
    assert read_axis(axis_path).model == "found/model.yaml"
    assert read_history(axis_path).adoptions[-1].former == "table1.yaml"
    roll_back(axis_path)
    assert read_axis(axis_path).model == "table1.yaml"
    with pytest.raises(DocumentError, match="nothing was adopted"):
        roll_back(axis_path)
    put_in_service(axis_path, model_path, [])
    replace_file(axis_path, with_line(axis_path, "model", "other.yaml"))
    with pytest.raises(DocumentError, match="edited since"):
        roll_back(axis_path)


def test_the_command_shows_its_gates_and_refuses_or_adopts(axis_path, capsys):
    model_path = axis_path.parent / "found" / "model.yaml"
    words = ["adopt", str(model_path), "--axis", str(axis_path)]
    assert main([*words, "--dry-run"]) == 0
    assert "held-out error" in capsys.readouterr().out
    assert read_axis(axis_path).model == "table1.yaml"
    (model_path.parent / "report.json").write_text(json.dumps(report_of(after=0.012)))
    assert main([*words, "--json"]) == 65
    assert json.loads(capsys.readouterr().out)["adopted"] is False
    (model_path.parent / "report.json").write_text(json.dumps(report_of()))
    assert main(words) == 0
    assert read_axis(axis_path).model == "found/model.yaml"
    assert main(["adopt", "--rollback", "--axis", str(axis_path)]) == 0
    assert read_axis(axis_path).model == "table1.yaml"
    assert main(["adopt", "--axis", str(axis_path)]) == 78


def test_after_an_adoption_a_run_names_the_comparison_and_not_the_diagnosis_again(axis_path):
    files = [Path("after.mcap")]
    assert next_step(make_plan(axis_path), files).startswith("fffo-drive identify after.mcap --out DIR, or ")
    assert "--fit 'my run.mcap' --held-out" in next_step(make_plan(axis_path), [Path("my run.mcap")])
    put_in_service(axis_path, axis_path.parent / "found" / "model.yaml", [])
    plan = make_plan(axis_path)
    assert next_step(plan, files).startswith("fffo-drive evaluate --runs RUN_BEFORE_ADOPTION after.mcap ")
    open_loop = plan._replace(profile=plan.profile._replace(mode=MODE_CURRENT))
    assert "fffo-drive diagnose --fit after.mcap" in next_step(open_loop, files)
    history_path(axis_path).write_text("{")  # damaged
    assert "fffo-drive diagnose --fit after.mcap" in next_step(plan, files)
    fitted = plan.model.model_copy(update={"provenance": Provenance(runs=["5c1f"])})
    assert next_step(plan._replace(model=fitted), files).startswith("fffo-drive diagnose --fit after.mcap")


def test_what_is_wrong_with_a_report_is_said(axis_path, capsys):
    model_path = axis_path.parent / "found" / "model.yaml"
    report = model_path.parent / "report.json"
    report.write_text("{")
    assert main(["adopt", str(model_path), "--axis", str(axis_path)]) == 78
    assert f"{report}:1: not JSON" in capsys.readouterr().err
    other = yaml.safe_dump({"format": "other"})
    report.write_text(json.dumps(yaml.safe_load(other)))
    assert main(["adopt", str(model_path), "--axis", str(axis_path), "--report", str(report)]) == 78
    assert main(["adopt", str(model_path), "--axis", str(axis_path)]) == 65  # somebody else's: as if there were none


def model_in(path, model):
    write_model(path, model)
    return path


def stderr_of(capsys, words, code):
    """The command ends with this code and one message, which is given back."""
    assert main(words) == code
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_every_way_in_which_an_adoption_fails_has_its_message_and_code(axis_path, capsys):
    """Missing, damaged, of another axis, already in service, not to be compensated; nothing is changed by any of it."""
    before = axis_path.read_text()
    found = axis_path.parent / "found"
    model_path, axis = found / "model.yaml", ["--axis", str(axis_path)]

    def fails(model, code, *said, axis=axis):
        message = stderr_of(capsys, ["adopt", str(model), *axis], code)
        for part in said:
            assert part in message
        assert axis_path.read_text() == before
        assert not history_path(axis_path).exists()

    fails(found / "nowhere.yaml", 78, "nowhere.yaml: cannot be read")
    fails(model_path, 78, "nowhere.yaml: cannot be read", axis=["--axis", "nowhere.yaml"])
    fails(axis_path.parent / "table1.yaml", 78, "is already in service")

    other = MODEL.model_copy(update={"torque_constant_nm_per_a": 0.3, "effects": [effect()]})
    fails(model_in(found / "kt.yaml", other), 78, "not adopted: same axis", "0.3 Nm/A, in service 0.148")
    heavy = MODEL.inertia_kg_m2.model_copy(update={"value": 5.0 * MODEL.inertia_kg_m2.value})
    other = MODEL.model_copy(update={"inertia_kg_m2": heavy, "effects": [effect()]})
    fails(model_in(found / "heavy.yaml", other), 78, "not adopted: same axis", "factor 2 allowed")

    elastic = effect("elasticity", share=0.2, frequency_hz=40.0, damping=0.03)
    text = "not adopted: compensation: elasticity: its torque is not known in advance"
    fails(model_in(found / "elastic.yaml", with_effects(elastic)), 1, text)
    steep = effect(cos_nm=0.02, order=40.0)
    fails(model_in(found / "steep.yaml", with_effects(steep)), 1, "not adopted: stability", "below phase_margin_deg 35")

    whole = model_path.read_text()
    for damaged, said in (
        (whole[: len(whole) // 2], "content_hash"),
        (whole.replace("value: 0.067", "value: 0.068"), "content_hash: does not match the content"),
        (whole.replace("name: cogging", "name: coging"), "did you mean 'cogging'?"),
        ("name: [", "not valid YAML"),
        ("", "missing"),
    ):
        model_path.write_text(damaged)
        if said == "content_hash":  # cut in two, what is left may still be a model: then its effects are gone
            assert main(["adopt", str(model_path), *axis]) != 0
            capsys.readouterr()
        else:
            assert main(["adopt", str(model_path), *axis]) == 78
            assert said in capsys.readouterr().err
        assert axis_path.read_text() == before
    model_path.write_bytes(b"\xff\xfe\x00")
    fails(model_path, 78, "not UTF-8 text")


def test_where_a_diagnosis_wrote_no_model_adopt_says_why(axis_path, capsys):
    model_path = axis_path.parent / "found" / "model.yaml"
    model_path.unlink()
    report = report_of() | {"verdict": "nothing_carries_over", "headline": "No finding carries over."}
    (model_path.parent / "report.json").write_text(json.dumps(report | {"kind": "diagnose"}))
    said = stderr_of(capsys, ["adopt", str(model_path), "--axis", str(axis_path)], 78)
    assert "the diagnosis wrote no model: No finding carries over." in said


def test_a_history_that_is_damaged_is_said_before_anything_changes(axis_path, capsys):
    before = axis_path.read_text()
    history_path(axis_path).write_text("adoptions: {")
    words = ["adopt", str(axis_path.parent / "found" / "model.yaml"), "--axis", str(axis_path)]
    assert main(words) == 78
    assert f"{history_path(axis_path)}:1: not valid YAML" in capsys.readouterr().err
    assert main(["adopt", "--rollback", "--axis", str(axis_path)]) == 78
    assert axis_path.read_text() == before


def test_an_axis_with_torque_on_is_left_alone(axis_path, tmp_path, capsys):
    """A daemon's socket that answers with a state; the real one is asked in tests/daemon."""
    words = ["adopt", str(axis_path.parent / "found" / "model.yaml"), "--axis", str(axis_path)]
    before = axis_path.read_text()
    for state, code in (("running", 70), ("following", 70), ("ready", 0)):
        with answering(tmp_path / state, state) as sockets:
            assert main([*words, "--sockets", str(sockets)]) == code
        captured = capsys.readouterr()
        if code:
            assert captured.err.startswith("fffo-drive adopt: not adopted: drive disabled: the daemon has torque on")
            assert "`fffo-drive ctl disable` first" in captured.err
            assert axis_path.read_text() == before
    assert "ctl reload" in captured.out


@contextlib.contextmanager
def answering(directory, state):
    """One answer to `status` on a watch socket."""
    directory.mkdir()
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(directory / WATCH))
    listener.listen(1)

    def answer():
        connection, _ = listener.accept()
        with connection, connection.makefile("rw") as file:
            request = json.loads(file.readline())
            file.write(json.dumps({"jsonrpc": "2.0", "id": request["id"], "result": {"state": state}}) + "\n")
            file.flush()

    thread = threading.Thread(target=answer, daemon=True)
    thread.start()
    yield directory
    thread.join(10.0)
    listener.close()


def test_the_help_says_what_comes_of_it(capsys):
    for command in ("adopt", "close-the-loop"):
        with pytest.raises(SystemExit) as ended:
            main([command, "--help"])
        assert ended.value.code == 0
        text = " ".join(capsys.readouterr().out.split())
        assert "Exit codes: 0 adopted" in text
    assert "1 not adopted: a gate refuses the finding, or no effect in it can be compensated; 65" in text
    assert "77 real-time rights refused" in text


def test_the_gates_of_a_linear_axis_speak_of_forces_and_a_mass():
    """Keys of the axis file that a gate names stay."""
    own = MODEL.model_copy(update={"units": "linear"})
    model = own.model_copy(update={"effects": [effect("asymmetric_viscous", sd=1e-5, excess_nm_per_rps=1e-3)]})
    found = {gate.name: gate.text for gate in gates(AXIS, own, model, report_of(), False)}
    assert " N rms" in found["held-out error"]
    assert "mass_kg" in found["same axis"]
    assert "force constant" in found["same axis"]
    assert found["asymmetric_viscous: interval"].startswith("excess_n_s_per_m = 0.001")
    assert " N/m" in found["stability"]
    assert not [text for text in found.values() if " Nm" in text]
    assert "torque" in found["drive disabled"]
    rotary = {gate.name: gate.text for gate in gates(AXIS, MODEL, with_effects(*model.effects), report_of(), False)}
    assert rotary["asymmetric_viscous: interval"].startswith("excess_nm_per_rps = 0.001")
    assert "inertia_kg_m2" in rotary["same axis"]
