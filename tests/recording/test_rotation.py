"""Quota: only this program's finished recordings are deleted, oldest first."""

from __future__ import annotations

import os

import pytest
from mcap.writer import Writer
from recording.samples import random_rows, write_run

from fffo_drive.recording.recover import recover
from fffo_drive.recording.rotation import enforce_quota, is_own, segment_path
from fffo_drive.recording.settings import RotationPolicy


def recording(directory, name: str, age_s: int):
    path = write_run(directory / name, random_rows(50))
    os.utime(path, (1_000_000 - age_s, 1_000_000 - age_s))
    return path


def test_oldest_first_and_no_more_than_needed(tmp_path):
    paths = [recording(tmp_path, f"{name}.mcap", age) for name, age in (("c", 40), ("a", 30), ("d", 20), ("b", 10))]
    size = paths[0].stat().st_size
    assert enforce_quota(tmp_path, 4 * size) == ((), 4 * size, True)
    assert enforce_quota(tmp_path, 3 * size - 1) == ((paths[0], paths[1]), 2 * size, True)
    assert enforce_quota(tmp_path, 1, keep=[paths[2]]) == ((paths[3],), size, False)
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
    report = enforce_quota(tmp_path, 1)
    assert report.deleted == (own,)
    assert not report.within
    assert report.total_bytes == part.stat().st_size
    assert foreign.exists()
    assert text.exists()
    assert directory.exists()


def test_recovered_files_are_own(tmp_path):
    path = recording(tmp_path, "a.mcap", 1)
    recover(path, tmp_path / "b.mcap")
    assert is_own(tmp_path / "b.mcap")


def test_names_sort_in_the_order_of_the_segments(tmp_path):
    names = [segment_path(tmp_path / "run.mcap", number).name for number in range(1, 120)]
    assert names[:2] == ["run.mcap", "run_002.mcap"]
    assert names == sorted(names)


@pytest.mark.parametrize("field", ["max_bytes", "max_duration_s", "quota_bytes"])
@pytest.mark.parametrize("value", [0, -1, float("nan")])
def test_limits_are_positive(field, value):
    with pytest.raises(ValueError, match=field):
        RotationPolicy(**{field: value})
