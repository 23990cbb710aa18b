"""Quota: only the finished recordings of one writer are deleted, oldest first."""

from __future__ import annotations

import os

import pytest
from mcap.writer import Writer
from recording.samples import random_rows, write_run

from fffo_drive.recording.recover import recover
from fffo_drive.recording.rotation import (
    SERVICE,
    OfOneWriter,
    enforce_quota,
    is_own,
    later_segments,
    segment_order,
    segment_path,
)
from fffo_drive.recording.settings import RotationPolicy
from fffo_drive.recording.writer import RunWriter

BENCH = OfOneWriter({"axis": "bench"})  # as `write_run` writes them


def recording(directory, name: str, age_s: int):
    path = write_run(directory / name, random_rows(50))
    os.utime(path, (1_000_000 - age_s, 1_000_000 - age_s))
    return path


def test_oldest_first_and_no_more_than_needed(tmp_path):
    paths = [recording(tmp_path, f"{name}.mcap", age) for name, age in (("c", 40), ("a", 30), ("d", 20), ("b", 10))]
    size = paths[0].stat().st_size
    assert enforce_quota(tmp_path, 4 * size, BENCH) == ((), 4 * size, True)
    assert enforce_quota(tmp_path, 3 * size - 1, BENCH) == ((paths[0], paths[1]), 2 * size, True)
    assert enforce_quota(tmp_path, 1, BENCH, keep=[paths[2]]) == ((paths[3],), size, False)
    assert paths[2].exists()


def test_files_of_others_and_unfinished_ones_stay(tmp_path):
    own = recording(tmp_path, "own.mcap", 10)
    part = recording(tmp_path, "x.mcap", 99).rename(tmp_path / "x.mcap.part")
    foreign = tmp_path / "bag.mcap"
    with foreign.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "libmcap 1.4")
        writer.finish()
    text = tmp_path / "notes.mcap"
    text.write_text("fffo-drive/ in a text")
    directory = tmp_path / "folder.mcap"
    directory.mkdir()
    report = enforce_quota(tmp_path, 1, BENCH)
    assert report.deleted == (own,)
    assert not report.within
    assert report.total_bytes == part.stat().st_size
    assert foreign.exists()
    assert text.exists()
    assert directory.exists()


def of(directory, name: str, **metadata: str):
    """A finished recording with this metadata."""
    writer = RunWriter(directory / name, metadata)
    writer.write_rows(random_rows(50))
    return writer.close()


def test_a_service_deletes_its_own_recordings_alone(tmp_path):
    own = [of(tmp_path, f"own_{number}.mcap", axis="x", source=SERVICE) for number in range(3)]
    others = [
        of(tmp_path, "single_run.mcap", axis="x"),  # of `fffo-drive run`
        of(tmp_path, "other_axis.mcap", axis="y", source=SERVICE),
    ]
    os.link(own[1], tmp_path / "kept.mcap")  # somebody gave it a name of his own, as `run --served` does
    size = own[0].stat().st_size
    service = OfOneWriter({"axis": "x", "source": SERVICE, "connection": "7"})
    assert enforce_quota(tmp_path, 2 * size, service) == ((), 2 * size, True)
    report = enforce_quota(tmp_path, size, service)
    assert report.deleted == (own[0],)
    assert enforce_quota(tmp_path, 1, service).deleted == (own[2],)
    assert all(path.exists() for path in (*others, own[1], tmp_path / "kept.mcap"))


def test_recovered_files_are_own(tmp_path):
    path = recording(tmp_path, "a.mcap", 1)
    recover(path, tmp_path / "b.mcap")
    assert is_own(tmp_path / "b.mcap")


def test_names_sort_in_the_order_of_the_segments(tmp_path):
    files = [segment_path(tmp_path / "run.mcap", number) for number in range(1, 1120)]
    assert [file.name for file in files[:2]] == ["run.mcap", "run_002.mcap"]
    assert sorted(reversed(files), key=segment_order) == files
    assert [file.name for file in sorted(files)] != [file.name for file in files]  # a thousand has a digit more


def test_the_continuations_of_a_run_come_by_their_number(tmp_path):
    first = tmp_path / "run[1].mcap"
    wanted = [segment_path(first, number) for number in (2, 999, 1000)]
    wanted.append(tmp_path / "run[1]_1001.mcap.part")
    others = [tmp_path / name for name in ("run[1]_2nd.mcap", "run1_002.mcap", "run[1]_3.mcap.x")]
    for file in (first, *wanted, *others):
        file.touch()
    (tmp_path / "run[1]_004.mcap").mkdir()
    assert later_segments(first) == wanted


def test_of_files_of_one_moment_the_first_of_a_run_goes_first(tmp_path):
    names = [f"run_{number}.mcap" for number in (1000, 999)]
    late, early = [recording(tmp_path, name, 10) for name in names]
    assert enforce_quota(tmp_path, late.stat().st_size, BENCH).deleted == (early,)


@pytest.mark.parametrize("field", ["max_bytes", "max_duration_s", "quota_bytes"])
@pytest.mark.parametrize("value", [0, -1, float("nan")])
def test_limits_are_positive(field, value):
    with pytest.raises(ValueError, match=field):
        RotationPolicy(**{field: value})
