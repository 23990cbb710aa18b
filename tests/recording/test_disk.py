"""How long the disk lasts, in figures and in words."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.cli import main
from fffo_drive.recording.disk import DiskUse, bytes_text, disk_life, life_text, row_bytes, span_text
from fffo_drive.recording.reader import read_run
from fffo_drive.units import S_PER_DAY

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SHORT = CONFIGS / "profiles" / "short.yaml"

DAY = 24e9 / S_PER_DAY  # bytes/s


def test_with_a_quota_that_fits_the_disk_is_never_full():
    life = disk_life(DAY, DiskUse(72_000_000_000, 0), 20_000_000_000)
    assert not life.fills
    assert (
        life_text(life)
        == "24 GB a day: the disk lasts 3 days (72 GB free); with the quota of 20 GB the last 20 h are kept"
    )


def test_what_is_recorded_already_counts():
    full = DiskUse(1_000_000_000, 20_000_000_000)  # the quota is used up: no more is needed
    assert not disk_life(DAY, full, 20_000_000_000).fills
    assert disk_life(DAY, full._replace(own_bytes=18_000_000_000), 20_000_000_000).fills


def test_without_a_quota_or_with_one_that_does_not_fit_rows_will_be_lost():
    use = DiskUse(6_000_000_000, 0)
    assert life_text(disk_life(DAY, use, None)) == (
        "24 GB a day: the disk lasts 6 h (6 GB free), without a quota: then rows are lost"
    )
    assert life_text(disk_life(DAY, use, 20_000_000_000)) == (
        "24 GB a day: the disk lasts 6 h (6 GB free) and is full before the quota of 20 GB is reached: then rows are "
        "lost; lower recording.quota_bytes"
    )


@given(st.floats(1.0, 1e9), st.integers(0, 10**14), st.integers(0, 10**14), st.none() | st.integers(10**6, 10**14))
def test_a_disk_fills_only_where_the_recordings_outgrow_it(rate, free, own, quota):
    """Written on for ever, with everything beyond the quota deleted."""
    life = disk_life(rate, DiskUse(free, own), quota)
    most = float("inf") if quota is None else max(quota, own)
    assert life.fills == (most - own > free)
    assert life.full_in_s == pytest.approx(free / rate)


@pytest.mark.parametrize(
    ("time_s", "text"),
    [(20.0, "20 s"), (150.0, "2.5 min"), (75_600.0, "21 h"), (277_000.0, "3.2 days"), (4e7, "463 days")],
)
def test_times_are_said_in_the_unit_that_suits_them(time_s, text):
    assert span_text(time_s) == text


def test_sizes_are_said_as_disks_are_sold():
    assert [bytes_text(size) for size in (999, 1500, 2e7, 2e10, 1.5e12)] == [
        "999 bytes",
        "1.5 kB",
        "20 MB",
        "20 GB",
        "1.5 TB",
    ]


def test_the_estimate_is_what_a_run_takes(tmp_path, capsys):
    """In motion on the simulated drive; the rest of the file (model, axis file) is small beside a minute of rows."""
    out = tmp_path / "run.mcap"
    assert main(["run", str(CONFIGS / "axis_simulated.yaml"), "--profile", str(SHORT), "--out", str(out)]) == 0
    rows = read_run(out).rows.size
    assert out.stat().st_size / rows == pytest.approx(row_bytes("zstd"), rel=0.25)
