"""The chain of the benchmarks writes, byte for byte, what the commands write that a user types."""

from __future__ import annotations

import shutil
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import yaml

from fffo_drive import formats
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


@pytest.fixture
def chain(chain_files):
    import chain  # ty: ignore[unresolved-import]

    return chain


def outcome(chain, number, **changes):
    """A passive axis that is stable and quiet, with changes."""
    plain = chain.Outcome(
        number, "2SEP", (), "", True, "", (), "stable", 0.4, 1.0, "", 45.0, 0.5, 0.0, 0.0, 12.0, "0123abc"
    )
    return plain._replace(**changes)


def test_the_table_tells_what_shakes_without_a_word_from_what_was_warned_of_and_from_refusals(chain):
    nan = float("nan")
    found = [
        outcome(chain, 1),
        outcome(chain, 2, warned=("expect stick-slip",), verdict="limit cycle in motion"),
        outcome(chain, 3, elastic="0.35 behind 110 Hz, damping 0.030", verdict="at the current limit"),
        outcome(
            chain,
            4,
            elastic="0.20 behind 80 Hz, damping 0.030",
            refused="tune: 12.3 deg",
            verdict="",
            creep_counts=nan,
            swing_counts=nan,
        ),
        outcome(chain, 5, refused="tune: 7 deg", verdict="", creep_counts=nan, swing_counts=nan),
        outcome(chain, 6, ran="run: oscillation"),  # the envelope ends the tuned file's own run
        outcome(chain, 7, creep_counts=9.0),
        outcome(chain, 8, passive=False, verdict="hunting at standstill"),  # no controller can bring it to rest
    ]
    lines = "\n".join(chain.table(found))
    assert "| all: 7 | 2 | 1 | 1 | 0 | 1 | 2 | 0 | 1; **2** | 1 of 5 | 0.4, 7.3 |" in lines
    assert "| rigid: 5 | 2 | 1 | 0 | 0 | 1 | 1 | 0 | 1; **1** | 1 of 4 |" in lines
    assert "| elastic: 2 | 0 | 0 | 1 | 0 | 0 | 1 | 0 | 0; **1** | 0 of 1 |" in lines
    assert "| tune: # deg | 2: 4, 5 |" in lines
    assert "run: oscillation" in lines


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
    short = {name: profile | {"duration_s": 12} for name, profile in chain_files.PROFILES.items()}
    monkeypatch.setattr(chain_files, "PROFILES", short)
    (tmp_path / "made").mkdir()
    (tmp_path / "typed").mkdir()
    made, typed = chain_files.Chain(tmp_path / "made"), chain_files.Chain(tmp_path / "typed")
    made.type(plant, CONSTANT_NM_PER_A)
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
    # the commands as processes of their own, as the typed chain of the benchmark has them
    processes = chain_files.TypedChain(typed.place)
    processes.identify([typed.place / f"{name}.mcap" for name in chain_files.PROFILES])
    processes.tune()
    for name in ("axis.yaml", "axis.commissioning.yaml", "model/model.yaml", "tuned/axis.yaml"):
        assert (made.place / name).read_bytes() == (typed.place / name).read_bytes(), name
    told = len(made.warnings)
    made.tune()
    assert processes.warnings == made.warnings[told:]
    section = yaml.safe_load((typed.place / "tuned" / "controller.yaml").read_text())["controller"]
    whole = yaml.safe_load(made.tuned.read_text())["controller"]
    assert formats.over(whole, section) == whole
    with pytest.raises(ValueError, match=r"tune: fffo-drive tune: .*no_such\.yaml"):
        processes.tune(typed.place / "no_such.yaml")

    axis, model = read_axis(made.tuned), read_model(made.model())
    assert law_problems(axis, model, observer_on=True) == []
    assert law_costs(axis, model, make_plan(made.tuned).profile, observer_on=True) == []  # every part is on
