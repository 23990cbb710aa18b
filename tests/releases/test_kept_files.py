"""The files of each release, made by its own program: today's reads every one, and each means what it meant."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from fffo_drive import formats
from fffo_drive.cli import main
from fffo_drive.commissioning.record import read_record
from fffo_drive.config.adoption import read_history
from fffo_drive.config.axis import build_profile, read_axis
from fffo_drive.config.drive_profile import read_profile
from fffo_drive.config.scenario import read_scenario
from fffo_drive.config.simulated import read_simulated
from fffo_drive.documents import DocumentError, parse, read_text
from fffo_drive.fleet.prior import population_from_plain
from fffo_drive.fleet.store import FleetStore
from fffo_drive.formats import FORMATS, kind_of
from fffo_drive.identification.facts import ColumnFact, read_facts
from fffo_drive.model.effects.laws.lookup import CurveModel
from fffo_drive.model.parameters import content_hash, effect_model, read_model
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.recover import recover
from fffo_drive.workflows.adopt import read_report
from fffo_drive.workflows.plan import make_plan

RELEASES = Path(__file__).resolve().parent
FIRST = RELEASES / "0.1.0"
LARGEST_BYTES = 100_000


def test_there_is_a_file_of_every_format_that_is_read():
    for release in (path for path in RELEASES.iterdir() if path.is_dir() and path.name[0].isdigit()):
        kinds = {"facts"} if (release / "facts.yaml").exists() else set()  # of 0.1.0: it does not say so
        for path in release.glob("*.yaml"):
            kinds.add(kind_of(parse(read_text(path), str(path))[0]))
        kinds |= {kind_of(json.loads(path.read_text())) for path in release.glob("*.json")}
        assert {kind for kind, one in FORMATS.items() if one.read_by != formats.NOBODY} <= kinds
        assert all(path.stat().st_size < LARGEST_BYTES for path in release.iterdir())


def test_a_fleets_store_and_population(tmp_path):
    shutil.copy(FIRST / "store.json", tmp_path)
    assert FleetStore(str(tmp_path)).status().runs == 0
    kept = population_from_plain(parse(read_text(FIRST / "population.yaml"), "population.yaml")[0])
    assert (kept.names, kept.mean.tolist(), kept.drives) == (("coulomb_nm",), [0.025], 12)


def test_the_profile_of_a_family():
    profile = read_profile(FIRST / "drive_profile.yaml")
    assert (profile.vendor_id, profile.product_codes, profile.keys["mode"]) == (0x1A3, [0x42], -5)
    assert profile.keys["target"] == {"object": 0x201C, "bits": 32}
    assert profile.keys["sdo"][0]["when"] == "before_enable"


def test_the_axis_in_process():
    axis = read_axis(FIRST / "axis_simulated.yaml")
    assert (axis.name, axis.drive.kind, axis.drive.file) == ("kept", "simulated", "simulated.yaml")
    law = axis.controller
    assert (law.proportional_a_per_rps, law.integral_a_per_rev, law.error_filter_s) == (0.975, 9.75, 2e-4)
    assert (law.observer.toggle, law.observer.gain_nm_per_rev, law.observer.clamp_ratio) == ("ff", 5.0, 2.0)
    assert law.feedforward.model_dump() == {"inertia": True, "preview": True, "delay_aware": True}
    assert (law.effects.compensate, law.effects.monitor) == (True, False)
    assert axis.envelope.position_window_rev == (-100.0, 100.0)
    assert axis.envelope.reactions == {"overspeed": "coast"}
    assert (axis.loop.rate_hz, axis.loop.tail_s, axis.loop.longest_profile_s) == (1000, 0.05, 600.0)
    assert axis.profile.model_dump() == {
        "kind": "sine", "mode": "velocity", "duration_s": 0.3, "amplitude": 2.0, "frequency_hz": 5.0,
    }  # fmt: skip
    assert build_profile(axis.profile, axis.loop.period_s).values.size == 300
    with pytest.raises(DocumentError, match=r"axis_simulated\.yaml:32: .*envelope\.accept_runaway: true"):
        make_plan(FIRST / "axis_simulated.yaml")  # 0.1.0 let an axis be blind for as long as anybody liked


def test_the_axis_on_a_bus():
    axis = read_axis(FIRST / "axis_canopen.yaml")
    drive = axis.drive
    assert (drive.bus, drive.node_id, drive.master_id, drive.bitrate_hz) == ("loopback:29500", 1, 127, 1_000_000)
    assert (drive.resolver_bits, drive.rated_torque_nm, drive.rated_current_a) == (15, 1.2284, 8.3)
    assert (drive.heartbeat_timeout_ms, drive.command_timeout_ms, drive.status_every) == (1000, 200, 10)
    assert (axis.realtime.priority, axis.realtime.cpu, axis.realtime.lock_memory) == (0, "any", False)
    assert (axis.recording.flush_interval_s, axis.recording.rotate_bytes) == (0.1, 10**9)
    daemon = axis.daemon
    assert (daemon.scope, daemon.foxglove, daemon.supervisor_timeout_s) == ("8700", "127.0.0.1:8765", 5.0)
    assert daemon.profiles["steps"].points == [(0.0, 0.0), (0.1, 0.2), (0.2, 0.0)]
    assert (daemon.profiles["all"].kind, daemon.profiles["gentle"].duration_s) == ("identify", 0.4)
    assert axis.commissioning == "commissioning.yaml"


def test_the_models():
    plain, full = read_model(FIRST / "model.yaml"), read_model(FIRST / "model_with_effects.yaml")
    assert (plain.torque_constant_nm_per_a, plain.inertia_kg_m2.value, plain.delay_s.value) == (
        0.148, 1.494e-4, 0.00275,
    )  # fmt: skip
    f = plain.friction
    assert (f.coulomb_nm.value, f.static_nm.value, f.stribeck_exponent.value) == (0.025, 0.067, -1.07)
    assert plain.effects == []
    assert full.content_hash == "651149979eef9a025c64636340d84d9e07d1509112a53efc92ee33af511cefdb"
    assert [effect.name for effect in full.effects] == ["cogging", "stribeck_shape", "frictional_lag"]
    cogging = full.effects[0].parameters
    assert (cogging["order"].value, cogging["cos_nm"].sd) == (6.0000278172956465, 3.7994485268842094e-05)
    assert full.effects[2].alternatives == ["coulomb_drift"]
    assert (full.friction.stiffness_per_rev.value, full.sensor_delay_s.source) == (
        835.135505772269, "lag of the drive's velocity",
    )  # fmt: skip


def test_curves_with_one_key_a_number_and_a_window_without_the_shapes_that_are_off():
    """As 0.1.0 wrote what is in no list; the window it then refused to read itself. They keep their hash."""
    model = read_model(FIRST / "model_with_curves.yaml")
    assert model.content_hash == content_hash(model)
    places_rev, speeds_rps = np.array([0.0, 0.3, 0.6, 1.0]), np.array([0.1, 4.0])
    friction, table, window = (effect.term() for effect in model.effects)
    again = [effect_model(term.name, term.values, {}) for term in (friction, table)]
    assert again[0].curve == CurveModel(
        kind="friction", unit="Nm", scale=1.0, knots=places_rev.tolist(), values=[0.001, -0.0025, 0.004, 0.001]
    )
    assert again[1].curve == CurveModel(
        kind="torque", unit="Nm", knots=[-2.0, 0.5, 3.0], across="speed", levels=speeds_rps.tolist(),
        values=[[0.001, 0.002, 0.003], [-0.001, -0.002, -0.003]],
    )  # fmt: skip
    assert window.values == {"window_share": 0.12, "centre_rev": 3.5, "width_rev": 1.25}


def test_the_simulated_drive_and_the_facts():
    drive = read_simulated(FIRST / "simulated.yaml")
    assert (drive.node_id, drive.sync_loss_tolerance_ms, drive.realtime_priority) == (1, 500, 0)
    assert drive.plant.seed == 7
    assert [(e.name, dict(e.parameters)["amplitude_nm"]) for e in drive.plant.effects] == [("cogging", 0.01)]
    facts = read_facts(FIRST / "facts.yaml")
    assert (facts.torque_constant_nm_per_a, facts.pole_pairs, facts.slots) == (0.148, 4, 12)
    assert facts.lsb_rev == 1.0 / 32768
    assert facts.columns == {"time_s": "t", "velocity_rps": ColumnFact(column="speed", unit="rpm")}


def test_the_scenario():
    scenario = read_scenario(FIRST / "scenario.yaml")
    assert list(scenario.seeds) == [5, 6, 7]
    assert scenario.file.mismatch.factors == {"coulomb_nm": 1.2}
    assert scenario.file.controllers["pi+fffo"].error_filter_s == 0.0002
    assert scenario.plant.friction.kind == "single_2sep"


def test_the_commissioning_record_still_counts():
    record = read_record(FIRST / "commissioning.yaml")
    assert (record.verdict, record.passed, len(record.checks)) == ("warning", True, 17)
    assert record.facts.digest == "a5801758a9487839cddfae8063d933ae8ed5cddb42d14ed90ceced1cde3d504e"
    assert record.drive.product_code == 1346720562
    checks = {check.name: check for check in record.checks}
    assert checks["torque_per_inertia"].verdict == "warning"
    assert checks["velocity_scale"].lowest == 0.99


def test_what_was_adopted_and_why():
    history = read_history(FIRST / "axis_simulated.yaml")
    assert [(entry.model, entry.former) for entry in history.adoptions] == [("model_with_effects.yaml", "model.yaml")]
    assert len(history.adoptions[0].gates) == 11
    report = read_report(FIRST / "model_with_effects.yaml", FIRST / "diagnosis.json")
    assert report["verdict"] == "effects_found"
    assert report["after"]["held_out"]["torque_rms_nm"] == pytest.approx(0.00276, abs=5e-6)


def test_a_run_in_process():
    run = read_run(FIRST / "run.mcap")
    assert (run.complete, len(run.rows), run.metadata["tool"]) == (True, 355, "fffo-drive/0.1.0")
    assert (run.units["velocity_rps"], run.units["deadline_ns"]) == ("rps", "ns")
    moving = run.rows["mode"] == 1
    reference = 2.0 * np.sin(2.0 * np.pi * 5.0 * np.arange(300) * 0.001)
    begin = 3  # ticks: the law compares with a reference as old as the feedback is
    np.testing.assert_allclose(run.rows["reference_rps"][begin:300], reference[: 300 - begin], atol=1e-12)
    error = run.rows["error_rps"][moving]
    assert float(np.abs(run.rows["velocity_rps"]).max()) == pytest.approx(2.0, abs=0.2)
    assert 0.0 < float(np.abs(error).max()) < 0.5
    assert set(run.attachments) == {"axis_simulated.yaml", "model_with_effects.yaml"}
    assert run.attachments["axis_simulated.yaml"].data == (FIRST / "axis_simulated.yaml").read_bytes()
    assert run.summary["trip"] == "no fault"


def test_a_recording_of_the_daemon_with_a_live_set():
    run = read_run(FIRST / "daemon.mcap")
    assert (run.complete, len(run.rows), run.rows["tick"][0], run.rows["tick"][-1]) == (True, 576, 91, 666)
    texts = [event.text for event in run.events]
    assert texts[4].startswith("controller.proportional_a_per_rps = 0.9 by pid")
    assert sum(text.startswith("start gentle") for text in texts) == 2
    assert run.metadata["source"] == "daemon"


def test_a_torn_file_is_read_and_recovered(tmp_path):
    run = read_run(FIRST / "torn.mcap.part")
    assert (run.complete, len(run.rows), len(run.events)) == (False, 253, 3)
    report = recover(FIRST / "torn.mcap.part", tmp_path / "whole.mcap")
    assert (report.rows, report.bytes_discarded) == (253, 715)
    assert read_run(tmp_path / "whole.mcap").rows.tobytes() == run.rows.tobytes()


@pytest.mark.parametrize("name", ["run.mcap", "daemon.mcap", "torn.mcap.part"])
def test_the_commands_read_them(name, capsys):
    assert main(["log", "info", str(FIRST / name), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["metadata"]["fffo_drive"] == "0.1.0"


def test_the_checks_pass_but_for_the_tolerance_that_0_1_0_did_not_check(tmp_path, capsys):
    """The file may be blind for 200 ticks; what is added is what the message says."""
    shutil.copytree(FIRST, tmp_path, dirs_exist_ok=True)
    for name in ("axis_simulated.yaml", "axis_canopen.yaml"):
        path = tmp_path / name
        assert main(["config", "check", str(path)]) == 78
        (said,) = capsys.readouterr().err.splitlines()
        assert "envelope.feedback_missing_ticks: blind for at most 200 ticks" in said
        assert "accept it by envelope.accept_runaway: true" in said
        path.write_text(path.read_text().replace("envelope:\n", "envelope:\n  accept_runaway: true\n"))
        assert main(["config", "check", str(path)]) == 0
        out = capsys.readouterr().out
        assert out.startswith(f"{path}: ok")
        assert "warning: accepted by envelope.accept_runaway: blind for at most 200 ticks" in out
