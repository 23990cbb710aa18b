"""The chain of the benchmarks writes, byte for byte, what the commands write that a user types."""

from __future__ import annotations

import shutil
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import yaml

from fffo_drive.cli import main
from fffo_drive.config.axis import read_axis
from fffo_drive.config.checks import law_problems
from fffo_drive.config.law_costs import law_costs
from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.config.simulated import read_simulated
from fffo_drive.model.parameters import read_model
from fffo_drive.recording.reader import read_run
from fffo_drive.workflows import commission
from fffo_drive.workflows.plan import make_plan

ROOT = Path(__file__).resolve().parents[2]
CONSTANT_NM_PER_A = 0.141  # of the data sheet: 5 % below the plant's


class OneMoment(datetime):
    """The date of a record."""

    @classmethod
    def now(cls, tz=None):
        return datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


@pytest.fixture
def chain_files(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT / "tools" / "benchmarks"), *sys.path])
    import chain_files  # ty: ignore[unresolved-import]

    return chain_files


@pytest.fixture(scope="module")
def plant():
    return case_of(read_scenario(ROOT / "configs" / "scenarios" / "paper.yaml"), 1).plant


def test_a_new_axis_is_the_plant_with_a_first_law_that_passes_every_check(chain_files, plant, tmp_path, capsys):
    chain = chain_files.Chain(tmp_path)
    chain.new_axis(plant, CONSTANT_NM_PER_A)
    assert read_simulated(tmp_path / "simulated_drive.yaml").plant == plant
    assert main(["config", "check", str(chain.axis)]) == 0
    said = capsys.readouterr().out
    assert "controller.observer.toggle is off: the loop has to make up to" in said
    assert "controller.feedforward.inertia is off: at" in said
    assert read_axis(chain.axis).format == "fffo_drive/axis/2"


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_chain_in_one_process_writes_what_the_typed_commands_write(
    chain_files, plant, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(commission, "datetime", OneMoment)
    (tmp_path / "made").mkdir()
    (tmp_path / "typed").mkdir()
    made, typed = chain_files.Chain(tmp_path / "made"), chain_files.Chain(tmp_path / "typed")
    tuned = made.type(plant, CONSTANT_NM_PER_A)
    typed.new_axis(plant, CONSTANT_NM_PER_A)

    def types(*words: str) -> None:
        assert main([word.replace("~", str(typed.place)) for word in words]) == 0
        capsys.readouterr()

    types("commission", "~/axis.yaml", "--yes")
    for name in chain_files.PROFILES:
        shutil.copy(made.place / f"{name}.yaml", typed.place)  # the amplitudes that the user found
        types("run", "~/axis.yaml", "--profile", f"~/{name}.yaml", "--out", f"~/{name}.mcap")
        runs = [read_run(chain.place / f"{name}.mcap").rows for chain in (made, typed)]
        assert all(np.array_equal(runs[0][column], runs[1][column], equal_nan=True) for column in runs[0].dtype.names)
        shutil.copy(made.place / f"{name}.mcap", typed.place)  # a recording has its date, a model the hash of the file
    types("identify", "~/chirp.mcap", "~/sweep.mcap", "--out", "~/model")
    types("tune", "~/model/model.yaml", "--axis", "~/axis.yaml", "--out", "~/tuned")
    for name in ("axis.yaml", "axis.commissioning.yaml", "model/model.yaml", "tuned/axis.yaml"):
        assert (made.place / name).read_bytes() == (typed.place / name).read_bytes(), name
    section = yaml.safe_load((typed.place / "tuned" / "controller.yaml").read_text())["controller"]
    assert section == tuned.section(read_axis(made.axis).controller.current_limit_a)

    axis, model = read_axis(made.tuned), read_model(made.model())
    assert law_problems(axis, model, observer_on=True) == []
    assert law_costs(axis, model, make_plan(made.tuned).profile, observer_on=True) == []  # every part is on
