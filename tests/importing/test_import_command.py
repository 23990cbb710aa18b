"""`fffo-drive import`: the published logs as they lie, foreign MCAP, questions, maps; and files that are no logs."""

from __future__ import annotations

import gzip
import io
import json
import shlex
import zipfile

import numpy as np
import pytest
import yaml
from importing.axis_log import Dialect, as_text, raw_columns, truth
from shared_data import shared_files

from fffo_drive.cli import main
from fffo_drive.cli.exits import EXIT_BAD_INPUT
from fffo_drive.identification.dataset import load_record
from fffo_drive.identification.facts import read_facts
from fffo_drive.importing.candidates import Hints
from fffo_drive.importing.convert import converted
from fffo_drive.importing.read import read_source
from fffo_drive.importing.recognise import recognise
from fffo_drive.report.columns import column_figures
from fffo_drive.workflows.import_logs import assumptions, recognised_logs, write_import

INPUTS = ("current_a", "current_command_a")


def run_import(*words):
    return main(["import", *map(str, words)])


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(as_text(truth(), Dialect()))
    return path


# What a user does


def test_a_log_becomes_a_recording_that_needs_no_facts(tmp_path, log, capsys):
    assert run_import(log, "--out", tmp_path / "out", "--torque-constant", "0.13") == 0
    said = capsys.readouterr().out
    assert "'Actual position' [rev]: unit rev" in said
    assert "next: fffo-drive identify" in said
    named = log.rename(tmp_path / "my log.csv")
    assert run_import(named, "--out", tmp_path / "my logs", "--torque-constant", "0.13") == 0
    words = shlex.split(capsys.readouterr().out.splitlines()[-1])
    assert words[-3:] == [str(tmp_path / "my logs" / "my log.mcap"), "--out", str(tmp_path / "my logs" / "model")]
    assert "assumed:" not in said  # the file gives every unit
    facts = read_facts(tmp_path / "out" / "facts.yaml")
    assert facts.torque_constant_nm_per_a == 0.13
    record = load_record(tmp_path / "out" / "log.mcap", facts)
    assert record.period_s == pytest.approx(2e-3)
    np.testing.assert_allclose(record.position_rev, truth().position_rev, atol=1e-6)


def test_importing_as_functions_prints_nothing_and_does_the_same(tmp_path, log, capsys):
    hints = Hints(units={"Actual position": "rev"})
    logs = recognised_logs([log], hints)
    assert not assumptions(logs)
    done = write_import(logs, hints, {"torque_constant_nm_per_a": 0.13}, tmp_path / "by_function")
    assert capsys.readouterr() == ("", "")
    assert done.recordings == [tmp_path / "by_function" / "log.mcap"]
    assert done.problems == []
    assert done.coverage is not None
    assert done.data_picture.stat().st_size > 10_000
    assert run_import(log, "--out", tmp_path / "out", "--unit", "Actual position=rev", "--torque-constant", "0.13") == 0
    for name in ("facts.yaml", "map.yaml"):
        assert (tmp_path / "out" / name).read_text() == (tmp_path / "by_function" / name).read_text()


def test_the_help_is_printed(capsys):
    with pytest.raises(SystemExit):
        run_import("--help")
    assert "permille" in capsys.readouterr().out


def test_an_assumption_is_not_taken_without_a_word(tmp_path, capsys):
    path = tmp_path / "log.csv"
    path.write_text(as_text(truth(), Dialect(units="none", position="rad", speed="rad/s")))
    assert run_import(path, "--out", tmp_path / "out") == EXIT_BAD_INPUT
    streams = capsys.readouterr()
    assert " ? position_rev" in streams.out
    assert "--yes" in streams.err
    assert not (tmp_path / "out").exists()
    assert run_import(path, "--out", tmp_path / "out", "--yes") == 0
    assert capsys.readouterr().out.splitlines()[-1] == (
        "assumed: position_rev is 'Actual position' in rad; velocity_rps is 'Actual velocity' in rad/s; "
        "current_a is 'Actual current' in A"
    )
    # what was recognised is a map for the next log
    said = yaml.safe_load((tmp_path / "out" / "map.yaml").read_text())
    said["units"]["Actual position"] = "deg"
    said["units"]["Actual velocity"] = "deg/s"
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(said))
    assert run_import(path, "--out", tmp_path / "again", "--map", tmp_path / "other.yaml") == 0
    record = load_record(tmp_path / "again" / "log.mcap", read_facts(tmp_path / "again" / "facts.yaml"))
    np.testing.assert_allclose(record.position_rev * 360.0, truth().position_rev * 2.0 * np.pi, atol=1e-5)


@pytest.mark.parametrize(
    ("heading", "unknown", "known"),
    [
        ("Actual position [rev]", "foo", "there is %, A, N, Nm, V"),
        ("Actual current [A]", "mNmm", "did you mean 'mNm'"),
        ("Time [s]", "sss", "there is %"),
    ],
)
def test_a_unit_that_is_not_known_is_refused_and_can_be_said(tmp_path, capsys, heading, unknown, known):
    name, _, unit = heading.rstrip("]").partition(" [")
    path = tmp_path / "log.csv"
    path.write_text(as_text(truth(), Dialect()).replace(heading, f"{name} [{unknown}]"))
    assert run_import(path, "--out", tmp_path / "out", "--yes") == EXIT_BAD_INPUT
    said = capsys.readouterr().err
    assert f"column '{name} [{unknown}]': unknown unit '{unknown}'" in said
    assert known in said
    assert not (tmp_path / "out").exists()
    assert run_import(path, "--out", tmp_path / "out", "--unit", f"{name} [{unknown}]={unit}") == 0


@pytest.mark.parametrize("heading", ["Actual position[0]", "Actual position [-]", "Actual position (motor)"])
def test_an_index_or_a_remark_in_brackets_is_no_unit(tmp_path, heading):
    path = tmp_path / "log.csv"
    path.write_text(as_text(truth(), Dialect()).replace("Actual position [rev]", heading))
    assert run_import(path, "--out", tmp_path / "out", "--yes") == 0


@pytest.fixture
def answers(monkeypatch):
    """What is typed at the terminal, in turn."""

    def typed(*lines):
        left = list(lines)
        asked = []
        monkeypatch.setattr("sys.stdin.isatty", lambda: True)
        monkeypatch.setattr("builtins.input", lambda text: (asked.append(text), left.pop(0))[1])
        return asked, left

    return typed


def test_each_assumption_is_asked_and_can_be_put_right_taken_or_left_out(tmp_path, capsys, answers):
    path = tmp_path / "log.csv"
    path.write_text(as_text(truth(), Dialect(units="none", position="rev", speed="rps")))
    asked, left = answers("turnz", "rev", "", "")
    assert run_import(path, "--out", tmp_path / "out") == 0
    said = capsys.readouterr().out
    assert not left[1:]
    assert asked[0].startswith("position_rev is 'Actual position' [rad] (rad is assumed")
    assert "'turnz' is neither a unit nor a column" in said
    record = load_record(tmp_path / "out" / "log.mcap", read_facts(tmp_path / "out" / "facts.yaml"))
    np.testing.assert_allclose(record.position_rev, truth().position_rev, atol=1e-5)
    # what was answered is in the map: nothing is asked again
    answers()
    assert run_import(path, "--out", tmp_path / "again", "--map", tmp_path / "out" / "map.yaml") == 0
    same = load_record(tmp_path / "again" / "log.mcap", read_facts(tmp_path / "again" / "facts.yaml"))
    np.testing.assert_array_equal(same.position_rev, record.position_rev)
    answers("q")
    assert run_import(path, "--out", tmp_path / "none") == 0
    assert not (tmp_path / "none").exists()


def test_a_column_that_is_left_out_at_the_terminal_stays_out_by_the_map(tmp_path, capsys, answers):
    path = tmp_path / "log.csv"
    path.write_text(as_text(truth(), Dialect(units="none", position="rad", speed="rad/s")))
    answers("-", "", "", "")
    assert run_import(path, "--out", tmp_path / "out") == 0
    said = yaml.safe_load((tmp_path / "out" / "map.yaml").read_text())
    assert said["roles"]["position_rev"] == ""
    record = load_record(tmp_path / "out" / "log.mcap", read_facts(tmp_path / "out" / "facts.yaml"))
    assert any("no position" in warning for warning in record.warnings)
    answers()
    assert run_import(path, "--out", tmp_path / "again", "--map", tmp_path / "out" / "map.yaml") == 0


def test_the_picture_of_the_columns_shows_every_guess_beside_what_it_should_be_like(tmp_path, log):
    assert run_import(log, "--out", tmp_path / "out") == 0
    assert (tmp_path / "out" / "columns.png").read_bytes().startswith(b"\x89PNG")
    one = read_source(log)
    found = recognise(one)
    rows = column_figures(found.guesses, converted(one, found).columns, "A", linear=False)
    shown = {row[0].name: row[0] for row in rows}
    assert set(shown) == {"position_rev", "velocity_rps", "current_a"}
    measured, derived = shown["velocity_rps"].series
    assert np.max(np.abs(measured.y - derived.y)) < 0.05 * np.max(np.abs(measured.y))
    assert "Actual velocity" in shown["velocity_rps"].title


def test_what_the_user_says_stands_before_every_guess(tmp_path, log, capsys):
    assert run_import(log, "--out", tmp_path / "out", "--current", "", "--command", "Actual current", "--json") == 0
    found = json.loads(capsys.readouterr().out)["logs"][0]["signals"]
    assert found["current_command_a"]["column"] == "Actual current"
    assert "current_a" not in found
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("linear: false\nroles:\n  time_s: Time\n  position_rev: Actual positon\n")
    for words, text in (
        (["--position", "Actual positon"], "no column 'Actual positon': did you mean 'Actual position'"),
        (["--unit", "Actual position=turnz"], "unit 'turnz'"),
        (["--unit", "Actual position"], "COLUMN=UNIT"),
        (["--rate", "-1"], "--rate -1"),
        (["--rate", "nan"], "--rate nan"),
        (["--counts-per-turn", "-4096"], "--counts-per-turn -4096: give a positive number"),
        (["--gear-ratio", "-3"], "gear_ratio"),
        (["--map", str(log)], "not a map of columns"),
        (["--map", wrong], f"wrong.yaml:4: roles.position_rev: {log} has no column 'Actual positon': did you mean"),
        (["--map", wrong, "--position", "Actual"], f"{log}: no column 'Actual'"),
    ):
        assert run_import(log, "--out", tmp_path / "other", *words) == EXIT_BAD_INPUT
        assert text in capsys.readouterr().err
    assert run_import(log, "--out", tmp_path / "out") == EXIT_BAD_INPUT
    assert "exists already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("linear: false\nrate_hz: 0\n", "map.yaml:2: rate_hz: a number above 0 is needed (got 0)"),
        ("counts_per_turn: -4096\n", "map.yaml:1: counts_per_turn: a number above 0 is needed (got -4096)"),
        ("roles: [a, b]\n", "map.yaml:1: roles: a mapping of keys to values is needed"),
        ("units:\n  Time: 3\n", "map.yaml:2: units.Time: text is needed"),
        ("units:\n  Time: sss\n", "map.yaml:2: units.Time: unknown unit 'sss'"),
        ("roles:\n  positon_rev: x\n", "map.yaml:2: roles.positon_rev: no signal 'positon_rev': did you mean"),
        ("role: {}\n", "map.yaml:1: role: unknown key; did you mean 'roles'?"),
        ("roles: {time_s: [\n", "map.yaml:2: not valid YAML"),
    ],
)
def test_a_map_that_cannot_be_used_is_refused_by_its_file_and_key(tmp_path, log, capsys, content, said):
    (tmp_path / "map.yaml").write_text(content)
    assert run_import(log, "--out", tmp_path / "out", "--map", tmp_path / "map.yaml") == EXIT_BAD_INPUT
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("unit", ["permille", "%", "Nm"])
def test_the_map_that_an_import_writes_is_one_that_it_reads(tmp_path, unit):
    path = tmp_path / "log.csv"
    path.write_text(as_text(truth(), Dialect()).replace("Actual current [A]", f"Target torque [{unit}]"))
    assert run_import(path, "--out", tmp_path / "out") == 0
    assert yaml.safe_load((tmp_path / "out" / "map.yaml").read_text())["units"]["Target torque"] == unit
    assert run_import(path, "--map", tmp_path / "out" / "map.yaml", "--out", tmp_path / "again") == 0
    for name in ("map.yaml", "facts.yaml"):
        assert (tmp_path / "again" / name).read_text() == (tmp_path / "out" / name).read_text()


@pytest.mark.parametrize(
    ("unit", "constant", "warned"), [("Nm", "0.025", True), ("Nm", "1", False), ("A", "0.025", False)]
)
def test_a_torque_constant_beside_a_torque_is_warned_of(tmp_path, capsys, unit, constant, warned):
    path = tmp_path / "log.csv"
    path.write_text(as_text(truth(), Dialect()).replace("Actual current [A]", f"Actual torque [{unit}]"))
    assert run_import(path, "--out", tmp_path / "out", "--torque-constant", constant) == 0
    said = "warning: the input is in Nm already and is multiplied by the torque constant of 0.025 as well"
    assert (said in capsys.readouterr().err) == warned


@pytest.mark.parametrize(
    ("spoiled", "said"),
    [
        ([20], "note: 1 cell is not a number and counts as missing, the first is 'x' in line 21"),
        ([20, 30], "note: 2 cells are not numbers and count as missing, the first is 'x' in line 21"),
    ],
)
def test_cells_that_are_not_numbers_are_counted(tmp_path, capsys, spoiled, said):
    lines = as_text(truth(), Dialect()).splitlines()
    for line in spoiled:
        lines[line] = lines[line].rpartition(",")[0] + ",x"
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    assert run_import(tmp_path / "log.csv", "--out", tmp_path / "out") == 0
    assert said in capsys.readouterr().out


def test_a_sign_that_is_turned_is_reported(tmp_path, capsys):
    (tmp_path / "log.csv").write_text(as_text(truth(), Dialect(reversed_current=True)))
    assert run_import(tmp_path / "log.csv", "--out", tmp_path / "out") == 0
    assert "its sign is reversed" in capsys.readouterr().out


def test_a_velocity_that_is_too_small_does_not_cost_the_log(tmp_path, capsys):
    given = raw_columns(truth(), Dialect()) | {"Actual velocity": 0.93 * truth().velocity_rps}
    lines = [",".join(f"{cell:.9g}" for cell in row) for row in np.stack(list(given.values()), axis=1)]
    names = "Time [s],Actual position [rev],Actual velocity [rps],Actual current [A]"
    (tmp_path / "log.csv").write_text("\n".join([names, *lines]) + "\n")
    assert run_import(tmp_path / "log.csv", "--out", tmp_path / "out") == 0
    assert "the velocity is left out" in capsys.readouterr().out
    record = load_record(tmp_path / "out" / "log.mcap", read_facts(tmp_path / "out" / "facts.yaml"))
    assert record.velocity_rps is None
    np.testing.assert_allclose(record.position_rev, truth().position_rev, atol=1e-6)


# MCAP of others


def test_joint_states_of_ros_2_are_read_by_the_names_of_their_joints(tmp_path):
    from mcap_ros2.writer import Writer

    log = truth()
    schema_text = (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
        "================\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        "================\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", schema_text)
        for k, t in enumerate(log.time_s):
            stamp = {"sec": 10 + int(t), "nanosec": round((t - int(t)) * 1e9)}
            message = {
                "header": {"stamp": stamp, "frame_id": ""}, "name": ["elbow"],
                "position": [2.0 * np.pi * log.position_rev[k]], "velocity": [2.0 * np.pi * log.velocity_rps[k]],
                "effort": [log.current_a[k]],
            }  # fmt: skip
            writer.write_message("/joint_states", schema, message, log_time=round(t * 1e9), publish_time=0)
        writer.finish()
    source = read_source(path)
    assert set(source.columns) == {"time_s", "elbow.position", "elbow.velocity", "elbow.effort"}
    np.testing.assert_allclose(source.columns["time_s"], log.time_s, atol=2e-6)
    found = recognise(source)
    assert found.of("current_a").column == "elbow.effort"
    assert not found.of("position_rev").sure


def test_protobuf_messages_are_read_by_their_own_schema(tmp_path):
    """The schema is made here and lies in the file alone: any message will do."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from mcap_protobuf.writer import Writer

    double = descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE
    proto = descriptor_pb2.FileDescriptorProto(name="bench/axis.proto", package="bench", syntax="proto3")
    state = proto.message_type.add(name="State")
    for number, name in enumerate(("position_rad", "current_a"), 1):
        state.field.add(name=name, number=number, type=double, label=1)
    outer = proto.message_type.add(name="Axis")
    outer.field.add(name="motor", number=1, type=11, type_name=".bench.State", label=1)
    outer.field.add(name="comment", number=2, type=9, label=1)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(proto)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("bench.Axis"))
    log = truth()
    path = tmp_path / "log.mcap"
    with path.open("wb") as file, Writer(file) as writer:
        for time_s, position, current in zip(log.time_s, log.position_rev, log.current_a, strict=True):
            message = kind(comment="no number")
            message.motor.position_rad, message.motor.current_a = 2.0 * np.pi * position, current
            stamp = round(1e9 * time_s) + 10**18
            writer.write_message("axis", message, log_time=stamp, publish_time=stamp)
    assert run_import(path, "--out", tmp_path / "out", "--yes") == 0
    record = load_record(tmp_path / "out" / "log.mcap", read_facts(tmp_path / "out" / "facts.yaml"))
    assert record.period_s == pytest.approx(2e-3)
    np.testing.assert_allclose(record.position_rev, log.position_rev, atol=1e-9)
    np.testing.assert_allclose(record.measured_current_a, log.current_a, atol=1e-9)


def test_json_messages_of_two_topics_come_on_one_time(tmp_path):
    from mcap.writer import Writer

    log = truth()
    path = tmp_path / "two.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        channels = [writer.register_channel(topic, "json", schema) for topic in ("/motion", "/drive")]
        for k, t in enumerate(log.time_s):
            stamp = round(t * 1e9)
            motion = {"position_rev": log.position_rev[k], "velocity_rps": log.velocity_rps[k]}
            writer.add_message(channels[0], stamp, json.dumps(motion).encode(), stamp)
            if k % 2 == 0:
                writer.add_message(channels[1], stamp, json.dumps({"current_a": log.current_a[k]}).encode(), stamp)
        writer.finish()
    source = read_source(path)
    np.testing.assert_allclose(source.columns["drive.current_a"][::2], log.current_a[::2])
    assert any("interpolated" in remark for remark in source.remarks)


def test_topics_are_not_continued_and_angles_go_through_their_wraps(tmp_path):
    """A slow topic that begins late and ends early, once with the current, once with a wrapped angle."""
    from mcap.writer import Writer

    log = truth()
    angle = np.mod(3.0 * 360.0 * log.position_rev, 360.0)
    early, late = 200, 1000
    for slow in ("current_cmd_a", "angle_deg"):
        path = tmp_path / f"{slow}.mcap"
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            schema = writer.register_schema("x", "jsonschema", b"{}")
            channels = {
                name: writer.register_channel(f"/{name}", "json", schema) for name in ("angle_deg", "current_cmd_a")
            }
            for k, t in enumerate(log.time_s):
                stamp = round(t * 1e9)
                for name, value in (("angle_deg", angle[k]), ("current_cmd_a", log.current_a[k])):
                    if name != slow or (k % 5 == 0 and early <= k <= late):
                        writer.add_message(channels[name], stamp, json.dumps({name: value}).encode(), stamp)
            writer.finish()
        source = read_source(path)
        columns = converted(source, recognise(source)).columns
        part = slice(early, late + 1)
        np.testing.assert_allclose(columns["time_s"], log.time_s[part] - log.time_s[early], atol=1e-9)
        np.testing.assert_allclose(columns["current_command_a"][::5], log.current_a[part][::5], atol=1e-9)
        moved = 3.0 * (log.position_rev[part] - log.position_rev[early])
        # between samples 10 ms apart a straight line is off by less than a T^2 / 8 = 3e-3 rev
        np.testing.assert_allclose(columns["position_rev"] - columns["position_rev"][0], moved, atol=3e-3)


# The published logs as they lie


@pytest.mark.parametrize(
    ("files", "words", "column"),
    [
        ("measured/laas/speed_test*.txt", ["--torque-constant", "0.025"], "Iq"),
        ("measured/bam/*28m*.json", [], "load"),
        ("measured/tro2021/*.csv", [], "Torque actual value averaged"),
        ("emps/DATA_EMPS*.mat", ["--linear", "--torque-constant", "35.15065"], "vir"),
    ],
)
def test_published_logs_are_taken_in_as_they_lie(tmp_path, capsys, files, words, column):
    paths = shared_files(files)
    assert run_import(*paths, "--out", tmp_path / "out", "--json", "--yes", *words) == 0
    said = json.loads(capsys.readouterr().out)
    for one in said["logs"]:
        inputs = [
            guess["column"] for name, guess in one["signals"].items() if name in ("current_a", "current_command_a")
        ]
        assert inputs == [column]
    assert len(said["logs"]) == len(paths)


def test_the_published_log_of_an_outrunner_keeps_its_turn(tmp_path):
    """Positions in rad: recognised by a reference that stands at 2 pi, not by a unit."""
    source = read_source(shared_files("measured/laas/speed_test1.txt")[0])
    found = recognise(source)
    position = found.of("position_rev")
    assert position.sure
    assert position.factor == pytest.approx(1.0 / (2.0 * np.pi))
    assert found.of("current_a").factor == 1.0


def test_a_published_log_below_20_hz_is_refused_by_its_rate_and_one_at_25_hz_says_what_it_hides(tmp_path, capsys):
    paths = shared_files("measured/tro2021/*.csv")
    assert run_import(*paths, "--out", tmp_path / "out", "--yes") == 0
    said = capsys.readouterr().err
    assert "sampled at 15.62 Hz; at least 20 Hz" in said
    assert "sampled at 25 Hz: motion faster than 2.5 Hz" in said
    recordings = sorted(map(str, (tmp_path / "out").glob("*.mcap")))
    assert len(recordings) == len(paths)
    assert main(["identify", *recordings, "--out", str(tmp_path / "model")]) == EXIT_BAD_INPUT
    assert "record it faster" in capsys.readouterr().err


# Files that are no logs


def _mat(columns):
    from scipy.io import savemat

    out = io.BytesIO()
    savemat(out, columns)
    return out.getvalue()


def _npz(columns):
    out = io.BytesIO()
    np.savez(out, **columns)
    return out.getvalue()


def _parquet(columns):
    import pyarrow
    from pyarrow import parquet

    out = io.BytesIO()
    parquet.write_table(pyarrow.table(columns), out)
    return out.getvalue()


def _zip():
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("xl/workbook.xml", "<x/>")
    return out.getvalue()


def malformed():
    """(name, bytes): files of every kind, cut off, damaged, or with nothing in them that is a log."""
    text = as_text(truth(), Dialect()).encode()
    raw = {name.replace(" ", "_"): v for name, v in raw_columns(truth(), Dialect()).items()}
    whole = {
        "log.mat": _mat(raw), "log.npz": _npz(raw), "log.parquet": _parquet(raw),
        "log.json": json.dumps({name: v.tolist() for name, v in raw.items()}).encode(),
        "log.csv.gz": gzip.compress(text),
    }  # fmt: skip
    for name, data in whole.items():
        for share in (0.1, 0.3, 0.5, 0.7, 0.9, 0.99):
            yield name, data[: int(share * len(data))]
        yield name, b""
        yield name, bytes(reversed(data))
        yield name, np.random.default_rng(3).bytes(2000)
    header, *rows = text.decode().splitlines()
    tables = {
        "names alone": header,
        "one row": f"{header}\n{rows[0]}",
        "blank": "\n\n\n",
        "words": "\n".join(["the quick brown fox"] * 50),
        "a page": "<html><body><p>404</p></body></html>",
        "no input": "\n".join(",".join(row.split(",")[:3]) for row in [header, *rows]),
        "no motion": "\n".join(",".join(row.split(",")[::3]) for row in [header, *rows]),
        "time alone": "\n".join(row.split(",")[0] for row in [header, *rows]),
        "no time": "\n".join(",".join(row.split(",")[1:]) for row in [header, *rows]),
        "time stands": "\n".join([header, *("0," + row.split(",", 1)[1] for row in rows)]),
        "time runs back": "\n".join([header, *reversed(rows)]),
        "nothing moves": "\n".join([header, *(f"{k},0,0,0" for k in range(500))]),
        "all missing": "\n".join([header, *("nan,nan,nan,nan" for _ in rows)]),
        "text among": "\n".join([header, *(row.replace(",", ",x", 1) if k % 3 else row for k, row in enumerate(rows))]),
        "lengths": "\n".join([header, *(row if k % 3 else row + ",1,2,3" for k, row in enumerate(rows))]),
        "position of words": "\n".join([header, *(",".join([r.split(",")[0], "a", "b", "c"]) for r in rows)]),
        "infinite": "\n".join([header, *(f"{k},inf,inf,inf" for k in range(500))]),
        "counts": "\n".join(
            ["Time [s],Position [counts],Current [A]", *(f"{k / 500},{k % 7},{k % 3}" for k in range(500))]
        ),
    }  # fmt: skip
    for name, table in tables.items():
        yield f"{name}.csv", table.encode()
        yield f"{name}.txt", table.replace(",", "\t").encode("utf-16")
    objects = [
        "3", "null", "[]", "{}", "[1,2,3]", '"x"', "[[1,2],[3,4]]", '{"a": 1}', '{"entries": []}',
        '{"entries": [{"a": "x"}, {"a": "y"}]}',
        '{"a": [1,2', '[{"t": 0}, 5]', '{"a": {"b": {"c": "d"}}}', "[" * 100_000, "\ufeff{", "{'a': 1}",
    ]  # fmt: skip
    for k, content in enumerate(objects):
        yield f"{k}.json", content.encode()
    yield from (
        ("a.pdf", b"%PDF-1.7\n"), ("a.png", b"\x89PNG\r\n\x1a\n"), ("a.xlsx", _zip()),
        ("a.xls", b"\xd0\xcf\x11\xe0" + bytes(500)),
        ("a.mcap", b"\x89MCAP0\r\n"), ("b.mcap", b"\x89MCAP0\r\n" + bytes(500)),
        ("a.mat", b"MATLAB 7.3 MAT-file" + bytes(600)),
        ("b.mat", bytes(509)), ("a.npy", b"\x93NUMPY\x01\x00"),
        ("a.feather", b"ARROW1\0\0"), ("a.parquet", b"PAR1PAR1"),
    )  # fmt: skip


CASES = list(malformed())


def test_there_are_a_hundred_malformed_files():
    assert len(CASES) >= 100


@pytest.mark.parametrize("case", range(len(CASES)), ids=lambda k: f"{k}-{CASES[k][0]}")
def test_a_malformed_file_has_one_message_and_one_exit_code(tmp_path, capsys, case):
    name, data = CASES[case]
    path = tmp_path / name
    path.write_bytes(data)
    assert run_import(path, "--out", tmp_path / "out", "--yes", "--json") == EXIT_BAD_INPUT
    streams = capsys.readouterr()
    assert streams.out == ""
    assert streams.err.startswith("fffo-drive import: ")
    assert str(path) in streams.err
    assert len(streams.err) < 2000
    assert not (tmp_path / "out").exists()


def test_a_file_that_is_not_there_is_named(tmp_path, capsys):
    assert run_import(tmp_path / "none.csv", "--out", tmp_path / "out") == EXIT_BAD_INPUT
    assert "none.csv" in capsys.readouterr().err


def test_a_reference_encoder_tells_the_cyclic_error_of_the_sensor(tmp_path, capsys):
    """In degrees, reversed, with a zero of its own; no torque is used."""
    log = truth()
    error = 2e-4 * np.cos(2.0 * np.pi * (2.0 * log.position_rev - 0.1))
    error += 2e-6 * np.random.default_rng(4).normal(size=error.size)
    columns = {
        "time_s": log.time_s, "position_rev": log.position_rev + error, "current_a": log.current_a,
        "scale [deg]": 77.0 - 360.0 * log.position_rev,
    }  # fmt: skip
    rows = "\n".join(",".join(f"{v:.9g}" for v in row) for row in np.stack(list(columns.values()), axis=1))
    path = tmp_path / "log.csv"
    path.write_text(",".join(columns) + "\n" + rows + "\n")
    status = run_import(path, "--reference-encoder", "scale", "--yes", "--out", tmp_path / "out", "--json")
    streams = capsys.readouterr()
    assert status == 0, streams.err
    said = json.loads(streams.out)
    assert said["logs"][0]["signals"]["reference_position_rev"]["evidence"].endswith("sign reversed")
    (sure,) = [one for one in said["cyclic_error"]["orders"] if one["sure"]]
    assert sure["order"] == 2
    assert sure["amplitude_rev"] == pytest.approx(2e-4, rel=0.02)
    record = load_record(tmp_path / "out" / "log.mcap", read_facts(tmp_path / "out" / "facts.yaml"))
    np.testing.assert_allclose(np.diff(record.reference_position_rev), np.diff(log.position_rev), atol=1e-8)
    map_file = tmp_path / "out" / "map.yaml"
    assert run_import(path, "--map", map_file, "--out", tmp_path / "again") == 0  # the map says it too
    assert "2 a turn: 4.3" in capsys.readouterr().out
