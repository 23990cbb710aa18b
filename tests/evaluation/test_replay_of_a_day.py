"""Whatever is asked of the loop, whenever: the recording names it, and its replay gives every command bit for bit."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from evaluation.asked import AXIS, FILES, MIDST, PROFILES, WHAT, begun_in_the_midst, models, replayed_files, tell
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from interpreted import hex_results

from fffo_drive.cli import main
from fffo_drive.config.axis import controller_config, envelope_config
from fffo_drive.config.effects import compensation_table
from fffo_drive.control.controller import pack_controller
from fffo_drive.control.reference import MODE_VELOCITY
from fffo_drive.drive.cia402 import GOAL_DISABLED
from fffo_drive.evaluation.replay_runs import ReplayedLaw, Replayer
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.run_records import RecordKind, decode_record, encode_record
from fffo_drive.runtime import records as made
from fffo_drive.runtime.tick import (
    FLAG_ADAPTS,
    FLAG_EMERGENCY,
    FLAG_ESTIMATED_VELOCITY,
    FLAG_LOOP_BEGAN,
    LoopConfig,
)
from fffo_drive.signals import ROW
from fffo_drive.workflows.replay import replay_files

SMALL_FILES = 20_000  # bytes: a file holds some hundred rows


@pytest.fixture(scope="module")
def story(tmp_path_factory):
    """One file of a run in which everything was asked for."""
    (file,) = tell(tmp_path_factory.mktemp("story"))
    return file


@pytest.fixture(scope="module")
def cut(tmp_path_factory):
    """The same in several files."""
    files = tell(tmp_path_factory.mktemp("cut"), rotate_bytes=SMALL_FILES, drain_each=True)
    assert len(files) > 3
    return files


def replayed(*parts):
    replayer = Replayer()
    for rows, records in parts:
        replayer.take(rows, records)
    return replayer.report


def test_a_run_with_everything_in_it_replays(story):
    report = replay_files([story])
    run = read_run(story)
    assert report.exact
    assert report.all_rows == run.rows.size
    assert report.rows == (run.rows["mode"] == 1).sum() > 900
    assert report.profiles.as_asked > 0
    assert report.profiles.other == 0
    assert report.live.as_asked == (run.rows["set_point_sample"] >= 0).sum() > 600
    assert report.live.other == report.live.not_followed == 0
    assert {record.kind for record in run.records} == set(RecordKind) - {RecordKind.MEMORY}  # it begins with the loop
    assert (run.rows["trip"] != 0).any()
    assert (run.rows["resetting"] != 0).any()
    assert (run.rows["effects_nm"] != 0).any()
    assert 500 < (run.rows["flags"] & FLAG_ESTIMATED_VELOCITY != 0).sum() < report.rows - 200
    assert len(np.unique(run.rows["limits"])) > 3
    used = {(block.parameters, block.effects) for block in report.blocks}
    assert len(used) >= 5
    assert len({block.model for block in report.blocks}) == 3
    assert sum(block.rows for block in report.blocks) == report.rows


@pytest.mark.parametrize("rows", [1, 37, 800])
def test_blocks_of_any_size_give_the_same_report(story, rows):
    run, whole = read_run(story), replay_files([story])
    report = replayed(*((run.rows[k : k + rows], run.records) for k in range(0, len(run.rows), rows)))
    assert report == whole


@settings(max_examples=12, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(st.tuples(st.sampled_from(WHAT), st.floats(0.0, 1.0), st.integers(1, 60)), min_size=8, max_size=25),
    st.sampled_from([None, SMALL_FILES]),
)
def test_whatever_is_asked_for_at_any_tick_replays(tmp_path_factory, asked, rotate_bytes):
    story = [("enable", 0.0, 40), ("start", 0.0, 30), *asked]
    files = tell(tmp_path_factory.mktemp("any"), story, rotate_bytes=rotate_bytes)
    report = replay_files(files)
    assert report.exact
    assert report.all_rows == sum(read_run(file).rows.size for file in files)


def test_files_of_a_rotated_run_are_one_run_and_each_stands_alone(story, cut):
    whole, parts = read_run(story), [read_run(file) for file in cut]
    assert np.concatenate([part.rows for part in parts]).tobytes() == whole.rows.tobytes()
    together = replay_files(cut)
    alone = [replay_files([file]) for file in cut]
    assert together.exact
    assert together.all_rows == whole.rows.size
    for part, report in zip(parts, alone, strict=True):
        assert report.all_identical == report.all_rows == part.rows.size
        assert report.rows == (part.rows["mode"] == 1).sum()
        assert report.live.as_asked == (part.rows["set_point_sample"] >= 0).sum()
        assert report.not_replayed == report.live.other == report.live.not_followed == 0
        named = {record.number for record in part.records if record.kind == RecordKind.PARAMETERS}
        assert set(part.rows["parameters_number"].tolist()) <= named
    assert sum(part.rows["mode"][0] == 1 for part in parts) >= 3  # those that begin in a motion
    assert sum(report.rows for report in alone) == together.rows


@pytest.mark.parametrize("story", MIDST)
def test_a_recording_that_begins_while_the_axis_is_enabled_replays_from_its_first_row(tmp_path, story):
    (file,) = tell(tmp_path, MIDST[story], recorded=False)
    run = read_run(file)
    report = replay_files([file])
    assert run.rows["mode"][0] == MODE_VELOCITY
    assert not run.rows["flags"][0] & FLAG_LOOP_BEGAN
    assert report.exact
    assert report.all_rows == run.rows.size
    assert report.rows == (run.rows["mode"] == 1).sum() > 100
    assert report.live.as_asked == (run.rows["set_point_sample"] >= 0).sum()
    if story == "moving":
        first = run.rows[0]
        assert abs(first["reference_rps"]) > 0.5
        assert first["flags"] & FLAG_ESTIMATED_VELOCITY
        assert first["flags"] & FLAG_ADAPTS
        assert first["adapted_coulomb_nm"] != 0.0
        assert first["effects_nm"] != 0.0
    if story == "live":
        assert run.rows["set_point_sample"][0] > 0


@pytest.mark.parametrize("story", MIDST)
def test_a_memory_that_is_not_what_the_loop_had_is_found(tmp_path, story):
    (file,) = tell(tmp_path, MIDST[story], recorded=False)
    run = read_run(file)
    (memory,) = (record for record in run.records if record.kind == RecordKind.MEMORY)
    place = memory.names.index("law.controller.integral_a")
    values = list(memory.values)
    values[place] += 1e-9
    other = [record._replace(values=tuple(values)) if record is memory else record for record in run.records]
    assert not replayed((run.rows, other)).exact
    without = replayed((run.rows, [record for record in run.records if record is not memory]))
    assert without.not_replayed > 100


@pytest.mark.slow
def test_loop_and_replay_from_the_midst_give_the_same_bits_without_compilation():
    there = hex_results("evaluation.asked", "begun_in_the_midst")
    assert there.count("True") == len(MIDST)
    assert there == begun_in_the_midst()


def test_a_file_that_was_cut_off_is_replayed_as_far_as_it_reaches_and_says_so(story, tmp_path, capsys):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(story.read_bytes()[: story.stat().st_size * 3 // 4])
    run = read_run(torn)
    assert not run.complete
    assert main(["replay", str(torn), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["torn"] == [run.reason]
    assert main(["replay", str(torn)]) == 0
    said = capsys.readouterr().out
    assert f"ends at byte {torn.stat().st_size}" in said
    assert f"; {run.rows.size} rows" in said
    assert "log recover" in said
    assert replay_files([story]).torn == ()


def test_a_missing_file_costs_its_own_rows_alone(cut):
    left = [cut[0], *cut[2:]]
    report = replay_files(left)
    assert report.exact
    assert report.all_rows == sum(read_run(file).rows.size for file in left)


def test_a_file_that_was_continued_brings_the_others_along(cut, capsys):
    assert main(["replay", str(cut[0])]) == 0
    said = capsys.readouterr().out
    assert f"and {len(cut) - 1} more" in said
    assert "reproduced bit for bit" in said
    assert "rows with live set points: " in said
    assert main(["replay", *map(str, cut)]) == 0
    assert capsys.readouterr().out == said


@pytest.mark.parametrize("kind", [RecordKind.PARAMETERS, RecordKind.EFFECTS, RecordKind.SESSION, RecordKind.SET_POINT])
def test_a_record_that_is_not_what_was_in_use_is_found(story, kind):
    run = read_run(story)
    changed = 0

    def other(record):
        nonlocal changed
        if record.kind != kind:
            return record
        values = list(record.values)
        name = {
            RecordKind.PARAMETERS: "pi.integral_a_per_rev", RecordKind.EFFECTS: "total_limit_nm",
            RecordKind.SESSION: "envelope.slew_a_per_s", RecordKind.SET_POINT: "jerk_rps3",
        }[kind]  # fmt: skip
        values[record.names.index(name)] *= 1e-3 if kind is RecordKind.EFFECTS else 1.0 + 1e-12
        changed += 1
        return record._replace(values=tuple(values))

    report = replayed((run.rows, tuple(map(other, run.records))))
    assert changed
    assert not report.exact
    if kind is RecordKind.SET_POINT:  # law and command go by the row's reference, which is no longer the set point's
        assert report.live.other > 100
    else:
        assert report.all_identical < report.all_rows


@pytest.mark.parametrize("name", ["parameters_number", "effects_number", "toggle", "position_rev", "goal", "flags"])
def test_a_row_that_says_something_else_is_found(story, name):
    run = read_run(story)
    rows = run.rows.copy()
    where = np.flatnonzero((rows["mode"] == 1) & (rows["effects_nm"] != 0) & (np.abs(rows["reference_rps"]) > 0.5))[20]
    before = rows[where].copy()
    other = {
        "position_rev": before["position_rev"] + 0.1,
        "flags": FLAG_EMERGENCY,
        "goal": GOAL_DISABLED,
        "toggle": (before["toggle"] + 1) % 3,
    }
    rows[name][where] = other.get(name, rows[name].max() + rows[name].min() - before[name])
    assert rows[where] != before
    assert not replayed((rows, run.records)).exact


def test_samples_other_than_those_asked_for_are_found(story):
    run = read_run(story)
    records = [
        record._replace(data={**record.data, "values_sha256": "0" * 64})
        if record.kind == RecordKind.PROFILE
        else record
        for record in run.records
    ]
    assert replayed((run.rows, records)).profiles.other == replay_files([story]).profiles.as_asked > 0


def test_lost_rows_cost_the_rows_until_the_law_rests_and_no_more(story):
    run = read_run(story)
    acts = np.flatnonzero(run.rows["mode"] == 1)
    rows = np.delete(run.rows, slice(acts[50], acts[60]))
    report = replayed((rows, run.records))
    assert report.all_identical == report.all_rows
    assert 0 < report.not_replayed < acts.size - 60
    assert report.rows > 100


def test_a_changed_law_is_scored_beside_the_recorded_one(story):
    run = read_run(story)
    limits = AXIS.envelope.model_copy(update={"speed_limit_rps": 0.5, "slew_a_per_s": 100.0})
    axis = AXIS.model_copy(update={"envelope": limits})
    law = ReplayedLaw(
        pack_controller(controller_config(axis, models()[0])), compensation_table(axis, models()[0]),
        envelope_config(axis),
    )  # fmt: skip
    replayer = Replayer(law)
    replayer.take(run.rows, run.records)
    report = replayer.report
    assert report.rows == (run.rows["mode"] == 1).sum()
    assert 1e-4 < report.rms_difference_a < 5.0
    assert report.rms_command_difference_a > 0.0
    assert report.trips_elsewhere > 0
    assert "speed_limit_rps" in report.first_trip


@pytest.mark.slow
def test_a_replay_without_compilation_gives_the_same_bits(cut, monkeypatch):
    monkeypatch.setenv(FILES, os.pathsep.join(map(str, cut)))
    there = hex_results("evaluation.asked", "replayed_files")
    assert there[0] == "True"
    assert there == replayed_files()


def test_every_kind_of_record_comes_back_from_its_bytes_and_as_what_it_was(story):
    run = read_run(story)
    for record in run.records:
        assert decode_record(encode_record(record)) == record
    (session,) = (record for record in run.records if record.kind == RecordKind.SESSION)
    again = made.of_session("x", made_loop(session), made.envelope_of(session))
    assert again.values == session.values
    for record in run.records:
        if record.kind == RecordKind.PARAMETERS:
            assert made.of_parameters(record.number, made.block_of(record), None).values == record.values
        elif record.kind == RecordKind.EFFECTS:
            back = made.of_effects(record.number, made.effects_of(record))
            assert (back.names, back.values, back.data) == (record.names, record.values, record.data)
        elif record.kind == RecordKind.MODEL:
            assert record.data["content_hash"] in record.data["text"]
    asked = [record.data for record in run.records if record.kind == RecordKind.REQUEST]
    assert {"who": "pid 1", "what": "start", "values": {"value": 0.0}, "epoch": 0} in asked
    names = {record.data["name"] for record in run.records if record.kind == RecordKind.PROFILE}
    assert names <= {profile.name for profile in PROFILES}


def made_loop(session):
    """The times of the loop in a record."""
    values = session.by_name
    return LoopConfig(**{name: int(values[f"loop.{name}"]) for name in LoopConfig._fields})


SINCE_RECORDS = {  # fields that rows have since blocks are recorded
    "heartbeat_age_ns", "i2t_a2s", "row_number", "request_number", "parameters_number", "effects_number",
    "profile_number", "flags", "goal", "resetting",
}  # fmt: skip


def test_rows_of_an_older_version_replay_with_the_law_that_is_given_for_them(tmp_path):
    """Toggles and effects in service stood in its rows; what was set live did not, and shows as a difference."""
    calm = [("toggle", 0.5, 3), ("enable", 0.0, 40), ("start", 0.0, 200), ("in_service", 0.0, 90), ("toggle", 1.0, 90)]
    law = ReplayedLaw(
        pack_controller(controller_config(AXIS, models()[1])), compensation_table(AXIS, models()[1]),
        envelope_config(AXIS),
    )  # fmt: skip
    reports = []
    for name, story in (("calm", calm), ("set", [*calm, ("gains", 0.9, 50)])):
        (tmp_path / name).mkdir()
        (file,) = tell(tmp_path / name, [*story, ("disable", 1.0, 80), ("enable", 0.0, 60), ("fault", 0.0, 40)])
        rows = read_run(file).rows
        old = np.zeros(rows.size, [(name, rows.dtype[name]) for name in ROW.names if name not in SINCE_RECORDS])
        for field in old.dtype.names:
            old[field] = rows[field]
        replayer = Replayer()
        with pytest.raises(ValueError, match="does not name its blocks"):
            replayer.take(old, ())
        replayer.take(old, (), law)
        reports.append(replayer.report)
        assert reports[-1].rows == (rows["mode"] == 1).sum() > 300
        assert not reports[-1].names_blocks
    assert reports[0].exact
    assert not reports[1].exact
    assert reports[1].identical > 300
