"""Logs of robots: LeRobot datasets, vectors in Parquet and MCAP, joints by name or number; one recording a joint."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from importing.axis_log import truth

from fffo_drive.cli import main
from fffo_drive.cli.exits import EXIT_BAD_INPUT
from fffo_drive.identification.dataset import load_record
from fffo_drive.identification.facts import read_facts
from fffo_drive.importing.candidates import Hints
from fffo_drive.importing.joints import JointNeededError, chosen
from fffo_drive.importing.read import read_source
from fffo_drive.recording.errors import RecordingError
from fffo_drive.workflows.import_logs import recognised_logs

pyarrow = pytest.importorskip("pyarrow")

LOG = truth()
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow")
SIZES = np.array([1.0, -0.7, 0.4])  # of the motion of each joint
KEYS = ("observation.state", "observation.velocity", "observation.effort", "action")


def vectors(sizes=SIZES) -> dict[str, np.ndarray]:
    """A number a joint, in rad and Nm."""
    state = 2.0 * np.pi * np.outer(LOG.position_rev, sizes)
    return {
        "observation.state": state,
        "observation.velocity": 2.0 * np.pi * np.outer(LOG.velocity_rps, sizes),
        "observation.effort": np.outer(LOG.current_a, sizes),
        "action": np.vstack([state[5:], np.repeat(state[-1:], 5, axis=0)]),
    }


def table(columns: dict, episode: int = 0, fixed: bool = False):
    made = {}
    for name, values in columns.items():
        values = np.asarray(values)
        if values.ndim == 1:
            made[name] = pyarrow.array(values)
            continue
        kind = pyarrow.list_(pyarrow.float32(), values.shape[1] if fixed else -1)
        made[name] = pyarrow.array(values.tolist(), kind)
    rows = len(next(iter(made.values())))
    made["timestamp"] = pyarrow.array(LOG.time_s[:rows], pyarrow.float32())
    made["frame_index"] = pyarrow.array(np.arange(rows))
    made["episode_index"] = pyarrow.array(np.full(rows, episode))
    return pyarrow.table(made)


def write(path: Path, *tables) -> Path:
    from pyarrow import parquet

    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(pyarrow.concat_tables(tables), path)
    return path


def describe(root: Path, names) -> None:
    (root / "meta").mkdir(parents=True, exist_ok=True)
    features = {key: {"dtype": "float32", "shape": [len(JOINTS)], "names": names} for key in KEYS}
    (root / "meta" / "info.json").write_text(json.dumps({"codebase_version": "v2.1", "fps": 500, "features": features}))


def dataset(root: Path, episodes: int = 3, one_file: bool = False, names=None) -> Path:
    describe(root, {"motors": list(JOINTS)} if names is None else names)
    tables = [table(vectors((0.5 + 0.25 * k) * SIZES), k, one_file) for k in range(episodes)]
    if one_file:
        write(root / "data" / "chunk-000" / "file-000.parquet", *tables)
    else:
        for k, one in enumerate(tables):
            write(root / "data" / "chunk-000" / f"episode_{k:06d}.parquet", one)
    return root


def run_import(*words):
    return main(["import", *map(str, words)])


@pytest.mark.parametrize("one_file", [False, True], ids=["a file an episode", "one file"])
def test_a_dataset_is_a_recording_for_each_episode_of_the_joint(tmp_path, capsys, one_file):
    root = dataset(tmp_path / "set", one_file=one_file)
    assert run_import(root, "--joint", "shoulder_lift", "--out", tmp_path / "out", "--yes") == 0
    said = capsys.readouterr().out
    assert said.count(" rows, likewise") == 2
    found = sorted((tmp_path / "out").glob("*.mcap"))
    names = (
        [f"file-000_shoulder_lift_run{k}" for k in (1, 2, 3)]
        if one_file
        else [f"episode_{k:06d}_shoulder_lift" for k in range(3)]
    )
    assert [path.stem for path in found] == names
    facts = read_facts(tmp_path / "out" / "facts.yaml")
    for k, path in enumerate(found):
        record = load_record(path, facts)
        size = 0.7 * (0.5 + 0.25 * k)
        assert record.period_s == pytest.approx(2e-3, rel=1e-3)
        assert np.ptp(record.position_rev) == pytest.approx(size * np.ptp(LOG.position_rev), rel=1e-4)
        assert np.ptp(record.measured_current_a) == pytest.approx(size * np.ptp(LOG.current_a), rel=1e-4)
        assert record.reference_rps is not None  # by what was asked for


def test_without_a_joint_they_are_listed_with_the_line_to_type(tmp_path, capsys):
    root = dataset(tmp_path / "set", 1)
    assert run_import(root, "--out", tmp_path / "out", "--yes") == EXIT_BAD_INPUT
    said = capsys.readouterr().err
    assert "3 joints (0 shoulder_pan, 1 shoulder_lift, 2 elbow)" in said
    words = said.split("fffo-drive import ")[-1].split()
    assert run_import(*words, "--yes") == 0
    assert (tmp_path / "out" / "episode_000000_shoulder_pan.mcap").exists()


def test_all_joints_are_an_axis_each(tmp_path, capsys):
    root = dataset(tmp_path / "set", 2)
    assert run_import(root, "--joint", "all", "--out", tmp_path / "out", "--yes") == 0
    assert {path.parent.name for path in (tmp_path / "out").glob("*/facts.yaml")} == set(JOINTS)
    assert len(list((tmp_path / "out").glob("*/*.mcap"))) == 6
    assert capsys.readouterr().out.count("next: fffo-drive identify") == 3


def test_a_joint_is_typed_at_a_terminal(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    asked = []
    monkeypatch.setattr("builtins.input", lambda text: (asked.append(text), "2" if text == "joint: " else "")[1])
    assert run_import(dataset(tmp_path / "set", 1), "--out", tmp_path / "out") == 0
    assert asked[0] == "joint: "
    assert (tmp_path / "out" / "episode_000000_elbow.mcap").exists()


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (list(JOINTS), list(JOINTS)),
        ([list(JOINTS)], list(JOINTS)),
        ({"axes": list(JOINTS)}, list(JOINTS)),
        ([f"{joint}.pos" for joint in JOINTS], list(JOINTS)),
        (["too", "few"], ["0", "1", "2"]),
        ([], ["0", "1", "2"]),
    ],
)
def test_names_of_joints_as_datasets_have_them(tmp_path, names, told):
    root = dataset(tmp_path / "set", 1, names=names)
    source = read_source(root / "data" / "chunk-000" / "episode_000000.parquet")
    assert list(source.joints) == told
    (one,) = chosen([source], "1")[told[1]]
    state = next(values for name, values in one.columns.items() if name.startswith("observation.state"))
    np.testing.assert_allclose(state, vectors()["observation.state"][:, 1] * 0.5, rtol=1e-6)


def test_one_vector_with_all_that_a_joint_has(tmp_path):
    parts = vectors()
    names = [f"{joint}.{what}" for what in ("pos", "vel", "torque") for joint in JOINTS]
    whole = np.hstack([parts[key] for key in KEYS[:3]])
    root = tmp_path / "set"
    describe(root, names)
    path = write(root / "data" / "chunk-000" / "episode_000000.parquet", table({"observation.state": whole}))
    (one,) = recognised_logs([path], Hints(joint="elbow"))
    assert one.found.of("velocity_rps").column == "observation.state.vel"
    np.testing.assert_allclose(one.log.columns["current_a"], 0.4 * LOG.current_a, atol=1e-6)


def test_pictures_texts_and_lists_of_any_length_are_named_and_left_out(tmp_path):
    made = table(vectors())
    rows = made.num_rows
    odd = {
        "observation.image": pyarrow.array([{"bytes": b"x" * 10, "path": "a"}] * rows),
        "raw": pyarrow.array([b"x"] * rows),
        "ragged": pyarrow.array([[1.0] * (1 + k % 2) for k in range(rows)]),
        "words": pyarrow.array([["a"]] * rows),
    }
    for name, values in odd.items():
        made = made.append_column(name, values)
    source = read_source(write(tmp_path / "log.parquet", made))
    assert set(source.left) == set(odd)
    assert list(source.joints) == ["0", "1", "2"]


def test_rows_without_a_list_miss_a_number(tmp_path):
    made = table(vectors())
    state = made.column("observation.state").to_pylist()
    state[7] = None
    at = made.schema.get_field_index("observation.state")
    made = made.set_column(at, "observation.state", pyarrow.array(state, pyarrow.list_(pyarrow.float32())))
    numbers = pyarrow.array([None if k == 9 else 3 for k in range(made.num_rows)])
    at = made.schema.get_field_index("episode_index")
    made = made.set_column(at, "episode_index", numbers)
    (one,) = recognised_logs([write(tmp_path / "log.parquet", made)], Hints(joint="0"))
    assert one.log.left_out == 1


def test_vectors_without_a_dataset_are_joints_too(tmp_path):
    columns = {"q": vectors()["observation.state"], "qd": vectors()["observation.velocity"]}
    columns["tau"] = vectors()["observation.effort"]
    path = write(tmp_path / "log.parquet", table(columns))
    (one,) = recognised_logs([path], Hints(joint="2"))
    moved = one.log.columns["position_rev"] - one.log.columns["position_rev"][0]
    np.testing.assert_allclose(moved, 0.4 * (LOG.position_rev - LOG.position_rev[0]), atol=1e-6)


def test_a_vector_of_another_length_belongs_to_no_joint(tmp_path):
    columns = {**vectors(), "wrench": np.zeros((LOG.time_s.size, 6))}
    source = read_source(write(tmp_path / "log.parquet", table(columns)))
    (one,) = chosen([source], "0")["0"]
    assert {f"wrench[{k}]" for k in range(6)} < set(one.columns)


def test_the_only_joint_that_moves_needs_no_name(tmp_path):
    path = write(tmp_path / "log.parquet", table(vectors(np.array([0.001, 1.0, 0.0]))))
    (one,) = recognised_logs([path], Hints())
    assert one.source.joint == "1"


@pytest.mark.parametrize(
    ("wish", "said"),
    [("elbw", "did you mean 'elbow'"), ("7", "there is all, elbow, should"), ("-1", "there is all, elbow, should")],
)
def test_a_joint_that_is_not_there_is_refused(tmp_path, wish, said):
    with pytest.raises(RecordingError, match=said):
        recognised_logs([dataset(tmp_path / "set", 1)], Hints(joint=wish))


def test_a_joint_of_a_log_without_vectors_is_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time [s],pos [rev],current [A]\n" + "".join(f"{k * 0.01},{k},{k}\n" for k in range(100)))
    with pytest.raises(RecordingError, match="--joint 1: nothing in it"):
        recognised_logs([path], Hints(joint="1"))


def test_an_episode_in_which_the_joint_stands_costs_itself(tmp_path):
    root = dataset(tmp_path / "set", 3)
    still = table(vectors(np.array([1.0, 0.0, 0.4])), 1)
    write(root / "data" / "chunk-000" / "episode_000001.parquet", still)
    logs = recognised_logs([root], Hints(joint="shoulder_lift"))
    assert [one.source.path.stem for one in logs] == ["episode_000000", "episode_000002"]
    assert "1 of 3 episodes are left out" in logs[0].log.remarks[-1]


def test_a_directory_without_a_dataset_says_what_is_missing(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(RecordingError, match=r"no LeRobot dataset \(data"):
        recognised_logs([tmp_path], Hints())


@pytest.mark.parametrize("content", ["{", "[]", '{"features": 3}', '{"fps": "x"}'])
def test_metadata_that_are_none_are_refused_by_name(tmp_path, content):
    root = dataset(tmp_path / "set", 1)
    (root / "meta" / "info.json").write_text(content)
    with pytest.raises(RecordingError, match=r"info\.json: not readable"):
        recognised_logs([root], Hints(joint="0"))


def npz(path: Path, parts: dict) -> Path:
    np.savez(path, time_s=LOG.time_s, **parts)
    return path


def mat(path: Path, parts: dict) -> Path:
    from scipy.io import savemat

    savemat(path, {"time_s": LOG.time_s, **parts})
    return path


def hdf5(path: Path, parts: dict) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in {"time_s": LOG.time_s, **parts}.items():
            file[f"observations/{name}"] = values
    return path


def lists(path: Path, parts: dict) -> Path:
    path.write_text(json.dumps({"time_s": LOG.time_s.tolist()} | {name: v.tolist() for name, v in parts.items()}))
    return path


def records(path: Path, parts: dict) -> Path:
    rows = [{"time_s": t} | {name: v[k].tolist() for name, v in parts.items()} for k, t in enumerate(LOG.time_s)]
    path.write_text(json.dumps(rows))
    return path


@pytest.mark.parametrize(
    ("name", "make", "joint"),
    [("a.npz", npz, "2"), ("a.mat", mat, "2"), ("a.hdf5", hdf5, "2"), ("a.json", lists, "2"), ("b.json", records, "1")],
)
def test_matrices_have_a_column_a_joint(tmp_path, name, make, joint):
    parts = vectors()
    path = make(
        tmp_path / name,
        {
            "qpos": parts["observation.state"],
            "qvel": parts["observation.velocity"],
            "effort": parts["observation.effort"],
        },
    )
    with pytest.raises(JointNeededError, match="3 joints"):
        recognised_logs([path], Hints())
    (one,) = recognised_logs([path], Hints(joint=joint))
    np.testing.assert_allclose(one.log.columns["current_a"], -0.7 * LOG.current_a, atol=1e-9)
    np.testing.assert_allclose(np.ptp(one.log.columns["position_rev"]), 0.7 * np.ptp(LOG.position_rev), rtol=1e-9)


# MCAP


def joint_states(path: Path, names, sizes) -> Path:
    from mcap_ros2.writer import Writer

    schema_text = "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    parts = vectors(np.asarray(sizes))
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", schema_text)
        for k, t in enumerate(LOG.time_s):
            order = range(len(names)) if k % 2 else range(len(names))[::-1]  # drivers may reorder them
            message = {"name": [names[j] for j in order]} | {
                key: [float(parts[f"observation.{part}"][k, j]) for j in order]
                for key, part in (("position", "state"), ("velocity", "velocity"), ("effort", "effort"))
            }
            writer.write_message("/joint_states", schema, message, log_time=round(t * 1e9), publish_time=0)
        writer.finish()
    return path


def test_joint_states_by_the_name_of_the_joint(tmp_path):
    path = joint_states(tmp_path / "bag.mcap", ["a", "wrist"], [1.0, -0.3])
    with pytest.raises(JointNeededError, match=r"2 joints \(0 .*wrist"):
        recognised_logs([path], Hints())
    (one,) = recognised_logs([path], Hints(joint="wrist"))
    assert one.found.of("position_rev").column == "position"
    moved = one.log.columns["position_rev"] - one.log.columns["position_rev"][0]
    np.testing.assert_allclose(moved, -0.3 * (LOG.position_rev - LOG.position_rev[0]), atol=1e-6)
    np.testing.assert_allclose(one.log.columns["current_a"], -0.3 * LOG.current_a, atol=1e-6)


def test_arrays_of_a_message_by_their_number(tmp_path):
    from mcap.writer import Writer

    parts = vectors()
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        channel = writer.register_channel("/state", "json", schema)
        for k, t in enumerate(LOG.time_s):
            message = {
                "qpos": parts["observation.state"][k].tolist(),
                "qvel": parts["observation.velocity"][k].tolist(),
                "motors": [{"torque": value} for value in parts["observation.effort"][k].tolist()],
            }
            writer.add_message(channel, round(t * 1e9), json.dumps(message).encode(), 0)
        writer.finish()
    (one,) = recognised_logs([path], Hints(joint="1"))
    assert one.found.of("current_a").column == "motors.torque"
    np.testing.assert_allclose(one.log.columns["current_a"], -0.7 * LOG.current_a, atol=1e-9)
