"""The whole circle as one command: in process, and in real time on a loopback bus; and what is wrong with a request."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from report.test_diagnose_command import NOTHING

from fffo_drive.can.link import free_loopback_port
from fffo_drive.cli import main
from fffo_drive.config.axis import read_axis
from fffo_drive.diagnosis import diagnose as engine
from fffo_drive.documents import DocumentError
from fffo_drive.recording.reader import read_run
from fffo_drive.signals import ROW
from fffo_drive.workflows.adoption_gates import Gate
from fffo_drive.workflows.circle import close_the_loop
from fffo_drive.workflows.circle_runs import MOST_LOST, Circle, CircleWish, SpoiledRunError, health_of, write_axis

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
# phase margin 55 degrees at 3.2 ms of delay, 35 at 6.4 ms: a shared machine may answer late and the margins still hold
SLOWER_GAINS = {"proportional_a_per_rps": 0.7, "integral_a_per_rev": 7}
SLOWER_OBSERVER = {"gain_nm_per_rev": 2, "learns_in": "integral"}
SHORT = {"kind": "paper", "duration_s": 10}
KEEPS_NO_RATE = 70
CURRENT = {"kind": "sine", "mode": "current", "duration_s": 5, "amplitude": 0.2, "frequency_hz": 1}
AXIS, SIM = str(CONFIGS / "axis_undeclared.yaml"), str(CONFIGS / "simulated_undeclared.yaml")


def circle(capsys, *words):
    code = main(["close-the-loop", *words, "--quick", "--json"])
    captured = capsys.readouterr()
    assert code == 0, captured.err
    return json.loads(captured.out)


def the_loop_is_closed(result, out):
    """The effect that nobody declared was found, adopted, and tracking is better with it; everything says so alike."""
    assert result["verdict"] == "effects_found"
    assert result["effects"][0] == "cogging"
    assert result["adopted"], [gate["text"] for gate in result["gates"] if not gate["passed"]]
    errors = result["tracking"]
    ratio = errors["after"]["measured"]["ise"] / errors["before"]["measured"]["ise"]
    assert errors["ratio"]["measured"]["ise"]["value"] == pytest.approx(ratio)
    assert read_axis(out / "axis.yaml").model == "diagnosis/model.yaml"
    report = json.loads((out / "report.json").read_text())
    assert report["kind"] == "close-the-loop"
    assert report["results"] == result
    assert "Found and adopted: cogging" in report["verdict"]["headline"]
    page = (out / "report.html").read_text()
    assert "Tracking error" in page
    assert report["verdict"]["headline"].split(":")[0] in page
    assert (out / "diagnosis" / "report.html").exists()
    rows = read_run(out / "after.mcap").rows
    assert (rows["effects"][rows["mode"] == 1] & 1 == 1).all()
    assert not read_run(out / "before.mcap").rows["effects_nm"].any()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_in_process(tmp_path, capsys):
    axis = changed(tmp_path, "axis_undeclared.yaml", lambda axis: axis.update(profile=SHORT))
    tmp_path = tmp_path / "out"
    result = circle(capsys, axis, "--sim", SIM, "--out", str(tmp_path))
    the_loop_is_closed(result, tmp_path)
    assert result["tracking"]["ratio"]["measured"]["ise"]["value"] < 0.9
    assert result["tracking"]["ratio"]["true"]["ise"]["value"] < 0.4
    # the same directory is not written over
    assert main(["close-the-loop", axis, "--out", str(tmp_path)]) == 78
    assert "another --out" in capsys.readouterr().err


@pytest.mark.slow
def test_what_does_not_carry_over_to_the_run_that_was_held_out_is_not_adopted(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(engine, "diagnose", lambda *given: NOTHING)
    axis = changed(tmp_path, "axis_undeclared.yaml", lambda axis: axis.update(profile=SHORT))
    out = tmp_path / "out"
    assert main(["close-the-loop", axis, "--sim", SIM, "--out", str(out), "--quick", "--json"]) == 65
    said = capsys.readouterr()
    result = json.loads(said.out)
    assert (result["verdict"], result["effects"], result["adopted"]) == ("nothing_carries_over", [], False)
    assert f"not adopted: held-out error: {NOTHING.headline}" in said.err
    assert not (out / "diagnosis" / "model.yaml").exists()
    assert "diagnosis" not in read_axis(out / "axis.yaml").model
    assert (
        "lowers the error of the held-out run" in json.loads((out / "report.json").read_text())["verdict"]["headline"]
    )


@pytest.mark.slow
def test_the_circle_as_a_function_says_nothing_unless_it_is_listened_to(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(engine, "diagnose", lambda *given: NOTHING)
    axis = Path(changed(tmp_path, "axis_undeclared.yaml", lambda axis: axis.update(profile=SHORT)))
    said: list[str] = []
    wish = CircleWish(sim=Path(SIM))
    shown: list[Gate] = []
    closed = close_the_loop(axis, tmp_path / "out", wish, quick=True, say=said.append, show_gates=shown.extend)
    assert (closed.adopted, closed.trouble, len(closed.gates)) == (False, "", 1)
    assert shown == list(closed.gates)
    assert closed.source.verdict == "nothing_carries_over"
    assert [text.split(" ")[0] for text in said] == ["run", "diagnose"]
    assert capsys.readouterr() == ("", "")
    with pytest.raises(DocumentError, match="another --out"):
        close_the_loop(axis, tmp_path / "out", wish, quick=True)


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.timeout(900)
def test_in_real_time_on_a_bus(tmp_path, capsys):
    """At 2 kHz; on a machine that is too busy for it at a lower rate, at which so little data may tell nothing.

    On one that keeps no rate at all the command says so, and adopts nothing; on one that keeps none any more after the
    adoption it says that the error with the model is not known. How much better tracking is depends on the
    machine as well: that is asserted in process.
    """
    bus = f"loopback:{free_loopback_port()}"
    axis = changed(tmp_path, "axis_bench.yaml", with_room_for_delay)
    out = tmp_path / "out"
    code = main(["close-the-loop", axis, "--sim", SIM, "--bus", bus, "--out", str(out), "--quick", "--json"])
    captured = capsys.readouterr()
    if code == KEEPS_NO_RATE and "does not keep the loop's rate" in captured.err:
        in_service = "diagnosis/model.yaml" in (out / "axis.yaml").read_text()
        assert in_service == ("the model is in service" in captured.err)
        assert in_service == (captured.out != "") == (out / "report.json").exists()
        if in_service:
            result = json.loads(captured.out)
            assert result["adopted"]
            assert "after" not in result["tracking"]
        pytest.skip(captured.err.splitlines()[-1])
    assert code in (0, 1), captured.err
    result = json.loads(captured.out)
    rates = {run["rate_hz"] for run in result["runs"]}
    assert len(rates) == 1
    assert all(run["lost_share"] <= MOST_LOST for run in result["runs"])
    assert "true" not in result["tracking"]["before"]
    assert json.loads((out / "report.json").read_text())["results"] == result
    if rates == {2000} and max(run["lost_share"] for run in result["runs"]) < 0.5 * MOST_LOST:
        the_loop_is_closed(result, out)
    else:
        assert result["adopted"] == all(gate["passed"] for gate in result["gates"] or [{"passed": False}])


def test_the_health_of_a_run():
    rows = np.zeros(20_000, ROW)
    rows["tick"], rows["mode"] = np.arange(rows.size), 1
    assert health_of(rows, 0.0005)[1:] == (0, 0, 0.0005, 1.0)
    stalls = np.ones(rows.size, bool)
    for begin in range(1000, 20_000, 5000):
        stalls[begin : begin + 100] = False  # 50 ms each
    found = health_of(rows[stalls], 0.0005)
    assert found.skipped == 400
    assert found.longest_s == pytest.approx(0.0505)
    assert found.sound
    rows["velocity_age"][::10] = 1
    found = health_of(rows, 0.0005)
    assert found.lost_share == pytest.approx(0.1)
    assert not found.sound
    assert found.lost_share > MOST_LOST
    assert not health_of(rows[:0], 0.0005).sound


def with_room_for_delay(axis):
    axis["profile"] = SHORT
    axis["controller"] |= SLOWER_GAINS
    axis["controller"]["observer"] |= SLOWER_OBSERVER


def changed(tmp_path, name, change):
    content = yaml.safe_load((CONFIGS / name).read_text())
    content["model"] = str(CONFIGS / "models" / "table1.yaml")
    if "file" in content["drive"]:
        content["drive"]["file"] = SIM
    change(content)
    path = tmp_path / "given.yaml"
    path.write_text(yaml.safe_dump(content))
    return str(path)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["nowhere.yaml"], 78, "nowhere.yaml: cannot be read"),
        ([AXIS, "--sim", "nowhere.yaml"], 78, "nowhere.yaml: cannot be read"),
        ([AXIS, "--drive", "nowhere.yaml"], 78, "nowhere.yaml: cannot be read"),
        ([AXIS, "--bus", "loopback:29999"], 78, "has no bus: leave --bus out"),
        ([str(CONFIGS / "axis_canopen.yaml")], 78, "were never checked"),
        ([AXIS, "--rate", "100000"], 78, "loop.rate_hz"),
    ],
)
def test_what_is_wrong_with_a_request_is_said_and_nothing_runs(tmp_path, capsys, words, code, said):
    out = tmp_path / "out"
    assert main(["close-the-loop", *words, "--out", str(out)]) == code
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.out == ""
    assert not list(out.glob("*.mcap*"))


def test_files_that_the_axis_names_are_looked_at_before_anything_runs(tmp_path, capsys):
    out = str(tmp_path / "out")
    for change, said in (
        (lambda axis: axis.update(model="nowhere.yaml"), "cannot be read"),
        (lambda axis: axis.update(profile=CURRENT), "sine has no tracking error: a velocity profile is needed"),
        (lambda axis: axis["envelope"].update(speed_limit_rps=1.0), "speed_limit_rps"),
    ):
        axis = changed(tmp_path, "axis_undeclared.yaml", change)
        assert main(["close-the-loop", axis, "--out", out]) == 78
        assert said in capsys.readouterr().err
    damaged = tmp_path / "damaged.yaml"
    damaged.write_text("name: [")
    assert main(["close-the-loop", str(damaged), "--out", out]) == 78
    assert f"{damaged}:1: not valid YAML" in capsys.readouterr().err


def test_a_bus_without_a_drive_is_unavailable(tmp_path, capsys):
    bus = f"loopback:{free_loopback_port()}"
    words = [str(CONFIGS / "axis_bench.yaml"), "--bus", bus, "--uncommissioned", "--out", str(tmp_path)]
    assert main(["close-the-loop", *words]) == 69
    assert "does not answer" in capsys.readouterr().err


def test_all_runs_are_made_again_at_a_lower_rate_on_the_simulated_drive_alone(tmp_path):
    said: list[str] = []
    tried: list[int] = []

    def spoiled_above(rate_hz):
        def runs():
            tried.append(circle.axis.loop.rate_hz)
            if tried[-1] > rate_hz:
                raise SpoiledRunError("before: 40.0 % of the ticks skipped")
            return ()

        return runs

    own = write_axis(CONFIGS / "axis_bench.yaml", tmp_path, Path(SIM), None)
    circle = Circle(CircleWish(sim=Path(SIM)), own, said.append)
    assert circle.at_a_rate_it_keeps(spoiled_above(500)) == ()
    assert tried == [2000, 1000, 500]
    assert said == [f"before: 40.0 % of the ticks skipped: all runs again at {rate} Hz" for rate in (1000, 500)]
    axis = circle.axis
    assert axis.envelope.feedback_missing_ticks == 4000  # two seconds at the file's rate
    assert axis.drive.command_timeout_ms == 5000
    with pytest.raises(SpoiledRunError):
        circle.at_a_rate_it_keeps(spoiled_above(100))

    hardware = tmp_path / "hardware"
    hardware.mkdir()
    own = write_axis(CONFIGS / "axis_bench.yaml", hardware, None, None)
    assert Circle(CircleWish(), own, said.append).rates() == [2000]
    assert read_axis(own).envelope == read_axis(CONFIGS / "axis_bench.yaml").envelope
