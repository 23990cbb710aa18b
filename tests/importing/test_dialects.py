"""A log that is written in any dialect comes back as the same numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from importing.axis_log import (
    CURRENT_UNITS,
    POSITION_UNITS,
    SPEED_UNITS,
    TIME_UNITS,
    Dialect,
    as_text,
    raw_columns,
    truth,
    units_of,
)

from fffo_drive.identification.facts import facts_of, facts_text
from fffo_drive.importing.candidates import Hints
from fffo_drive.importing.convert import converted, write_recording
from fffo_drive.importing.read import read_source
from fffo_drive.importing.recognise import recognise
from fffo_drive.importing.source import source_of_arrays
from fffo_drive.recording.reader import read_run

DELIMITERS = [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", "."), (" ", "."), (" ", ",")]

dialects = st.builds(
    lambda signs, **rest: Dialect(delimiter=signs[0], decimal=signs[1], **rest),
    st.sampled_from(DELIMITERS),
    names=st.booleans(),
    units=st.sampled_from(["brackets", "line", "none"]),
    metadata=st.integers(0, 5),
    time=st.sampled_from(list(TIME_UNITS)),
    position=st.sampled_from(list(POSITION_UNITS)),
    speed=st.sampled_from(list(SPEED_UNITS)),
    current=st.sampled_from(list(CURRENT_UNITS)),
    wrapped=st.booleans(),
    reversed_current=st.booleans(),
    ending=st.sampled_from(["\n", "\r\n"]),
)


def hints_of(dialect: Dialect, names: list[str]) -> Hints:
    """What a user has to say of a log that says nothing of its units."""
    if dialect.names and dialect.units != "none":
        return Hints(counts_per_turn=POSITION_UNITS["counts"] if dialect.position == "counts" else None)
    return Hints(
        counts_per_turn=POSITION_UNITS["counts"] if dialect.position == "counts" else None,
        units=dict(zip(names, units_of(dialect), strict=True)),
    )


def taken_in(path: Path, dialect: Dialect):
    source = read_source(path)
    return converted(source, recognise(source, hints_of(dialect, list(source.columns))))


def assert_same(log, expected, dialect):
    size = log.columns["time_s"].size
    assert size == expected["time_s"].size
    resolution = 1.01 / POSITION_UNITS["counts"] if dialect.position == "counts" else 1e-6
    # a wrapped angle has lost its turns, and counts begin at a whole one
    offset = np.round(log.columns["position_rev"][0] - expected["position_rev"][0])
    np.testing.assert_allclose(log.columns["time_s"], expected["time_s"] - expected["time_s"][0], atol=1e-8)
    np.testing.assert_allclose(log.columns["position_rev"] - offset, expected["position_rev"], atol=resolution)
    np.testing.assert_allclose(log.columns["velocity_rps"], expected["velocity_rps"], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(log.columns["current_a"], expected["current_a"], rtol=1e-6, atol=1e-6)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(dialect=dialects, jitter=st.sampled_from([0.0, 0.05, 0.2]), holes=st.booleans(), seed=st.integers(0, 99))
def test_a_log_in_any_dialect_gives_the_same_numbers(tmp_path_factory, dialect, jitter, holes, seed):
    log = truth(jitter, seed)
    rows = log.time_s.size
    missing = np.zeros((rows, 4), bool)
    if holes:
        missing[1:-1] = np.random.default_rng(seed).random((rows - 2, 4)) < 0.0025  # 1 % of the rows
    path = tmp_path_factory.mktemp("dialect") / "log.txt"
    path.write_text(as_text(log, dialect, missing), newline="")
    kept = ~missing.any(axis=1)
    assert_same(taken_in(path, dialect), {name: v[kept] for name, v in log.columns.items()}, dialect)


@pytest.mark.parametrize("kind", ["mat", "mat73", "npz", "parquet", "json", "records", "npy"])
def test_other_kinds_of_files_hold_the_same_log(tmp_path, kind):
    log, dialect = truth(), Dialect(units="line", position="rad", speed="rad/s")
    raw = raw_columns(log, dialect)
    names = [name.replace(" ", "_") for name in raw]
    columns = dict(zip(names, raw.values(), strict=True))
    path = tmp_path / {"records": "log.json", "mat73": "log.mat"}.get(kind, f"log.{kind}")
    written(kind, path, columns)
    source = read_source(path)
    assert source.rows == log.time_s.size
    units = dict(zip(source.columns, units_of(dialect), strict=True)) if kind == "npy" else {}
    found = recognise(source, Hints(units=units))
    assert_same(converted(source, found), log.columns, dialect)


def written(kind, path, columns):
    if kind == "mat":
        from scipy.io import savemat

        savemat(path, {"run": columns, "note": "text", "gain": 3.0})
    elif kind == "mat73":
        import h5py

        with h5py.File(path, "w", userblock_size=512) as file:
            for name, values in columns.items():
                file[f"run/{name}"] = values[None, :]
    elif kind == "npz":
        np.savez(path, **columns)
    elif kind == "npy":
        np.save(path, np.stack(list(columns.values()), axis=1))
    elif kind == "parquet":
        import pyarrow
        from pyarrow import parquet

        parquet.write_table(pyarrow.table(columns), path)
    elif kind == "json":
        import json

        path.write_text(json.dumps({"motor": "x", **{name: values.tolist() for name, values in columns.items()}}))
    else:
        import json

        rows = [
            dict(zip(columns, cells, strict=True))
            for cells in zip(*map(np.ndarray.tolist, columns.values()), strict=True)
        ]
        path.write_text(json.dumps({"kp": 100, "entries": rows}))


def test_what_is_written_is_read_back_with_its_facts(tmp_path):
    log = truth()
    source = source_of_arrays(tmp_path / "log", {n.removesuffix("_a"): v for n, v in log.columns.items()})
    (tmp_path / "log").write_bytes(b"as it was")
    found = recognise(source, Hints(units={"position_rev": "rev", "velocity_rps": "rps"}))
    facts = facts_of({"torque_constant_nm_per_a": 0.13, "pole_pairs": 4}, found.linear)
    write_recording(tmp_path / "log.mcap", tmp_path / "log", converted(source, found), facts_text(facts), found.linear)
    run = read_run(tmp_path / "log.mcap")
    assert run.complete
    np.testing.assert_allclose(run.column("time_s"), log.time_s, atol=1e-9)
    np.testing.assert_array_equal(run.column("position_rev"), log.position_rev)
    assert "pole_pairs: 4" in run.attachments["facts.yaml"].data.decode()
    assert run.metadata["imported_from"] == "log"


def test_a_counter_that_begins_anew_and_a_number_without_its_sign_are_put_right(tmp_path):
    log = truth()
    counts = np.floor(log.position_rev * 65536.0)
    raw = {
        "t": log.time_s, "position": np.mod(counts, 65536.0), "speed": np.round(log.velocity_rps * 100.0),
        "torque": np.mod(np.round(log.current_a * 1000.0), 65536.0),
    }  # fmt: skip
    source = source_of_arrays(tmp_path / "log", raw)
    found = recognise(source, Hints(counts_per_turn=65536.0))
    columns = converted(source, found).columns
    np.testing.assert_allclose(columns["position_rev"] * 65536.0, counts, atol=0.5)
    np.testing.assert_allclose(columns["current_a"], np.round(log.current_a * 1000.0), atol=0.5)
    # in a unit of its own: scaled by the derivative of the position
    np.testing.assert_allclose(columns["velocity_rps"], log.velocity_rps, rtol=0.01, atol=0.02)


def test_a_twincat_scope_export_is_read_with_its_own_time_for_each_channel(tmp_path):
    head = [
        "Name\tScope Project", "File\tC:\\scope.svdx", "StartTime\t133000000000000000", "",
        "Name\tActPos\tName\tActVelo\tName\tActTorque", "SymbolComment\t\tSymbolComment\t\tSymbolComment\t",
        "Data-Type\tREAL64\tData-Type\tREAL64\tData-Type\tINT16",
        "SampleTime[ms]\t2\tSampleTime[ms]\t2\tSampleTime[ms]\t4",
        "VariableSize\t8\tVariableSize\t8\tVariableSize\t2", "Unit\tdeg\tUnit\tdeg/s\tUnit\tmA", "",
    ]  # fmt: skip
    log = truth()
    lines = []
    for k, t in enumerate(log.time_s * 1e3):
        slow = f"{t:g}\t{1e3 * log.current_a[k]:.9g}" if k % 2 == 0 else "\t"
        row = f"{t:g}\t{360.0 * log.position_rev[k]:.9g}\t{t:g}\t{360.0 * log.velocity_rps[k]:.9g}\t{slow}"
        lines.append(row.replace(".", ","))
    (tmp_path / "scope.csv").write_text("\n".join([*head, *lines]) + "\n")
    source = read_source(tmp_path / "scope.csv")
    columns = converted(source, recognise(source)).columns
    np.testing.assert_allclose(columns["time_s"], log.time_s[:-1], atol=1e-9)  # the last torque is one sample earlier
    np.testing.assert_allclose(columns["velocity_rps"], log.velocity_rps[:-1], atol=1e-6)
    np.testing.assert_allclose(columns["current_a"][::2], log.current_a[::2], atol=1e-6)
    assert any("time of its own" in remark for remark in source.remarks)
