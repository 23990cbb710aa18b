"""Backlash in a record: found along the measured motion, added up over runs, and not claimed where there is none."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

import fffo_drive as fd
from fffo_drive.fleet.backlash import GAP_REV, GAP_UPPER, GapSums, gap_of, gap_sums
from fffo_drive.fleet.measure import measured
from fffo_drive.fleet.pieces import whole
from fffo_drive.fleet.place import digest_of
from fffo_drive.fleet.regress import EVERY_COLUMN, Estimates, unpacked
from fffo_drive.identification.dataset import load_record

from .fleet_rig import FACTS, write_run

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
GAP = 0.02  # rev at the motor shaft
DURATION_S = 16.0


def recorded(folder: Path, gap_rev: float, seed: int) -> Path:
    """A recording of the simulated axis, whose plant has this gap: five surfaces, resolver, delay, all as they are."""
    axis = folder / f"gap_{gap_rev:g}"
    if not axis.exists():
        shutil.copytree(CONFIGS / "models", axis / "models")
        shutil.copy(CONFIGS / "axis_simulated.yaml", axis)
        effects = f"[{{name: backlash, parameters: {{gap_rev: {gap_rev:g}}}}}]" if gap_rev > 0.0 else "[]"
        text = (CONFIGS / "simulated_drive.yaml").read_text(encoding="utf-8").split("  effects:")[0]
        (axis / "simulated_drive.yaml").write_text(f"{text}  effects: {effects}\n", encoding="utf-8")
    profile = axis / f"profile{seed}.yaml"
    profile.write_text(f"profile: {{kind: paper, duration_s: {DURATION_S:g}, seed: {seed}}}\n")
    path = axis / f"run{seed}.mcap"
    fd.run(axis / "axis_simulated.yaml", path, profile=profile)
    return path


def sums_of(path: Path) -> GapSums:
    """The gap's sums as the record has them."""
    made = measured(path, digest_of(path), None)
    scalars = (made[f"gap_{name}"] for name in ("energy_nm2", "rows", "effective_rows"))
    return GapSums(unpacked(made["gap_normal"], GAP_REV.size), made["gap_moment"], *scalars)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("gaps")


def test_a_gap_is_measured_and_its_interval_shrinks_as_runs_are_added(folder: Path) -> None:
    runs = [sums_of(recorded(folder, GAP, seed)) for seed in (1, 2)]
    both = GapSums(*(first + second for first, second in zip(*runs, strict=True)))
    found = gap_of(both, "rotary")
    assert found.gap_rev == pytest.approx(GAP, rel=0.12)
    assert 0.15 <= found.share <= 0.35  # the plant has 0.3 of the inertia behind it
    assert found.log_sd < gap_of(runs[0], "rotary").log_sd


def test_no_gap_is_claimed_of_an_axis_without_one(folder: Path) -> None:
    path = recorded(folder, 0.0, 1)
    made = measured(path, digest_of(path), None)
    assert made["gap_rev"] is None
    assert made["gap_rows"] > 0.0  # it was looked for


def test_a_motion_without_inertia_and_friction_says_nothing_of_a_gap(tmp_path: Path) -> None:
    record = load_record(write_run(tmp_path / "run.csv", 1), FACTS)
    nothing = Estimates(np.zeros(8), np.zeros((8, 8)), np.full(8, np.nan), np.array(0.0))
    assert gap_sums(whole(record), FACTS, nothing, 0.0, EVERY_COLUMN, record.samples) is None


def made_of(gap_place: float, share: float, noise: float) -> GapSums:
    """Sums whose columns are bumps along the grid, so that the right gap lies at a place between two of them."""
    axis = np.linspace(-8.0, 20.0, 1500)
    columns = np.exp(-((axis[:, None] - np.arange(GAP_REV.size)) ** 2) / 8.0)
    target = share * np.exp(-((axis - gap_place) ** 2) / 8.0)
    target += noise * np.random.default_rng(3).standard_normal(axis.size)
    size = float(axis.size)
    return GapSums(columns.T @ columns, columns.T @ target, float(target @ target), size, size)


@pytest.mark.parametrize("place", [3.0, 5.5, 8.25])
@pytest.mark.parametrize("units", ["rotary", "linear"])
def test_a_gap_between_two_of_the_grid_is_found_and_a_linear_axis_has_it_in_metres(place: float, units: str) -> None:
    found = gap_of(made_of(place, 0.3, 0.01), units)
    ratio = GAP_REV[1] / GAP_REV[0]
    wanted = GAP_REV[0] * ratio**place * (0.02 if units == "linear" else 1.0)
    assert abs(math.log(found.gap_rev / wanted)) < max(4.0 * found.log_sd, 0.01)
    assert found.share == pytest.approx(0.3, rel=0.05)


def test_a_share_that_no_machine_has_is_no_gap() -> None:
    assert math.isnan(gap_of(made_of(5.0, 0.05, 0.001), "rotary").gap_rev)
    assert math.isnan(gap_of(made_of(5.0, 1.5, 0.001), "rotary").gap_rev)


def test_the_sums_come_back_from_their_triangle() -> None:
    sums = made_of(4.0, 0.3, 0.01)
    assert np.array_equal(unpacked(sums.normal[GAP_UPPER], GAP_REV.size), sums.normal)
