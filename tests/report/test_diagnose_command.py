"""The command around a diagnosis: what it writes, takes away and refuses, its summary and its exit code."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from report.test_diagnose_report import REST, diagnosis, errors, finding

from fffo_drive.cli import main
from fffo_drive.cli.diagnose import searched_names
from fffo_drive.diagnosis import diagnose as engine
from fffo_drive.diagnosis.curves import axes_of
from fffo_drive.identification.runs import Remark, RunsLook
from fffo_drive.workflows.progress import LINE_MARK, LINES_ENVIRONMENT

FACTS = "torque_constant_nm_per_a: 0.148\nresolver_bits: 15\nsample_rate_hz: 1000\n"
SHARE = "62 % of the squared residual that the other effects leave, p 0.002"


@pytest.fixture
def command(tmp_path, monkeypatch):
    """Calls the command with an engine that was told what to find; the settings that the engine was given."""
    (tmp_path / "drive.yaml").write_text(FACTS)
    wave = np.sin(2.0 * np.pi * 1e-3 * np.arange(3000))  # a log that can be read is enough
    rows = "\n".join(f"{0.001 * k:.3f},{value:.4f},{-0.2 * value:.5f}" for k, value in enumerate(wave))
    for name in ("fit", "check"):
        (tmp_path / f"{name}.csv").write_text(f"time_s,current_command_a,position_rev\n{rows}\n")

    def call(found, *words):
        given = []

        def diagnose(fit, held_out, facts, model, settings, progress, prior):
            assert prior is None
            given.append(settings)
            if progress is not None:
                progress(0.3, "search")
            return found

        monkeypatch.setattr(engine, "diagnose", diagnose)
        code = main(["diagnose", "--drive", str(tmp_path / "drive.yaml"), "--fit", str(tmp_path / "fit.csv"),
                     "--held-out", str(tmp_path / "check.csv"), "--out", str(tmp_path / "out"), *words])  # fmt: skip
        return code, (given or [None])[0]

    return call


NOTHING = diagnosis(
    verdict="nothing_carries_over", headline="No finding carries over: the torque error is not smaller.",
    findings=(finding(accepted=False, reason="does not carry over"),), model_after=None,
)  # fmt: skip


def test_the_summary_gives_shares_of_what_all_others_leave_and_errors_of_what_the_axis_needs(command, tmp_path, capsys):
    remark = Remark("repeated_reference", (), ("fit",), "fit and check have the same reference")
    look = RunsLook((), (remark,), 0.001)
    code, _ = command(diagnosis(runs_look=look, unexplained_rest=REST))
    said = capsys.readouterr()
    assert code == 0
    assert SHARE in said.out
    assert "held-out runs: torque error 5.20 % before, 2.10 % after (95 % interval 1.89 to 2.31 %)" in said.out
    assert "runs: fit and check have the same reference" in said.out
    assert "caution: Not explained: 4 mNm rms" in said.err
    assert (tmp_path / "out" / "model.yaml").exists()


def test_what_the_data_can_show_comes_first_and_a_declared_weight_is_compared(command, tmp_path, capsys):
    (tmp_path / "drive.yaml").write_text(FACTS + "load_gravity_nm: 0.05\n")
    assert command(diagnosis())[0] == 0
    said = capsys.readouterr()
    assert said.out.startswith("what these data can show:\n")
    assert "reversals" in said.out.split("what they cannot")[0]
    assert "caution: load_gravity_nm declares 0.05 Nm, and the data show no weight" in said.err
    assert command(diagnosis(), "--json")[0] == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "effects_found"  # nothing else on stdout


def test_progress_names_the_step_of_the_search(command, monkeypatch, capsys):
    monkeypatch.setenv(LINES_ENVIRONMENT, "1")
    command(diagnosis())
    lines = [line[len(LINE_MARK) :] for line in capsys.readouterr().err.splitlines() if line.startswith(LINE_MARK)]
    assert {"share": 0.3, "text": "diagnose: search"} in [json.loads(line) for line in lines]


def test_where_nothing_carries_over_no_model_is_left_and_the_exit_code_says_so(command, tmp_path, capsys):
    out = tmp_path / "out"
    assert command(diagnosis())[0] == 0
    assert (out / "model.yaml").exists()
    assert command(NOTHING)[0] == 65
    said = capsys.readouterr()
    assert not (out / "model.yaml").exists()
    assert f"{out / 'model.yaml'}: from an earlier diagnosis, removed" in said.err
    assert "No finding carries over" in said.out
    assert json.loads((out / "report.json").read_text())["verdict"] == "nothing_carries_over"
    assert command(NOTHING)[0] == 65  # there is none to remove


def test_a_model_that_no_diagnosis_wrote_is_neither_overwritten_nor_removed(command, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "model.yaml").write_text("mine")
    assert command(NOTHING)[0] == 78
    assert "not from `diagnose`" in capsys.readouterr().err
    assert (out / "model.yaml").read_text() == "mine"
    (out / "report.json").write_text("{}")
    assert command(diagnosis(), "--model", str(out / "model.yaml"))[0] == 78
    assert "--model" in capsys.readouterr().err


def test_a_held_out_error_that_rose_is_a_caution(command, capsys):
    command(diagnosis(after=replace(errors(0.0021), velocity_rms_rps=errors(0.1).velocity_rms_rps)))
    assert "caution: The held-out error in velocity rose from 15.6 to 300 mrps." in capsys.readouterr().err


def test_the_settings_of_the_search_are_given_on(command):
    names = ("cogging", "friction(time)", "motor_angle x speed")
    _, settings = command(diagnosis(), "--alpha", "0.05", "--without", *names)
    assert settings.false_alarm_rate == 0.05
    assert settings.without == set(names)
    _, settings = command(diagnosis())
    assert settings == engine.DiagnosisSettings()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--without", "coging"), "did you mean 'cogging'?"),
        (("--without", "friction(tim)"), "did you mean 'friction(time)'?"),
        (("--without", "unknown:velocty"), "did you mean 'unknown:velocity'?"),
        (("--without", "motor_angle x sped"), "did you mean 'motor_angle x speed'?"),
        (("--alpha", "0"), "--alpha: 0 is not a probability"),
        (("--alpha", "nan"), "--alpha: nan is not a probability"),
    ],
)
def test_what_is_not_searched_or_no_probability_is_refused(command, capsys, words, said):
    code, settings = command(diagnosis(), *words)
    assert (code, settings) == (78, None)
    assert said in capsys.readouterr().err


def test_every_axis_of_the_search_can_be_left_out():
    names = searched_names()
    assert {f"unknown:{axis.word}" for axis in axes_of(100.0)} <= set(names)
    assert {"torque_offset", "wound(memory)", "motor_angle x velocity"} <= set(names)
    assert len(set(names)) == len(names)


def test_the_help_names_the_exit_codes(capsys):
    with pytest.raises(SystemExit):
        main(["diagnose", "--help"])
    assert "65 the held-out runs confirm none of the effects" in " ".join(capsys.readouterr().out.split())
