"""`fffo-drive init`: what it lays down is what the repository has, is right, and replaces nothing unasked."""

from __future__ import annotations

from pathlib import Path

import pytest

from fffo_drive.cli import main
from fffo_drive.config.axis import model_of, read_axis
from fffo_drive.config.scenario import read_scenario
from fffo_drive.system import service_files

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def files_below(directory):
    return {path.relative_to(directory): path.read_bytes() for path in directory.rglob("*") if path.is_file()}


def test_it_lays_down_all_files_and_says_what_to_type(tmp_path, capsys):
    assert main(["init", str(tmp_path / "bench")]) == 0
    assert files_below(tmp_path / "bench" / "configs") == files_below(CONFIGS)
    said = capsys.readouterr().out
    assert f"cd {tmp_path / 'bench'}" in said
    for line in said.splitlines():
        for word in line.split():
            if word.startswith("configs/"):
                assert (tmp_path / "bench" / word).is_file()


def test_every_axis_and_scenario_finds_what_it_names(tmp_path):
    assert main(["init", str(tmp_path)]) == 0
    axes = sorted((tmp_path / "configs").glob("axis_*.yaml"))
    assert len(axes) >= 4
    for path in axes:
        assert model_of(path, read_axis(path)).friction.coulomb_nm.value > 0.0
    for path in (tmp_path / "configs" / "scenarios").glob("*.yaml"):
        assert read_scenario(path).plant is not None


def test_files_that_were_changed_stay_unless_they_are_to_be_replaced(tmp_path, capsys):
    assert main(["init", str(tmp_path)]) == 0
    assert main(["init", str(tmp_path)]) == 0  # the same once more is no conflict
    mine = tmp_path / "configs" / "axis_simulated.yaml"
    mine.write_text("name: mine\n")
    (tmp_path / "configs" / "facts.yaml").unlink()
    capsys.readouterr()
    assert main(["init", str(tmp_path)]) == 78
    said = capsys.readouterr().err
    assert str(mine) in said
    assert "--missing writes only files that are not there" in said
    assert "--force" in said
    assert mine.read_text() == "name: mine\n"
    assert not (tmp_path / "configs" / "facts.yaml").exists()  # all or nothing
    assert main(["init", str(tmp_path), "--force"]) == 0
    assert files_below(tmp_path / "configs") == files_below(CONFIGS)


def test_missing_adds_what_is_not_there_and_names_what_it_leaves_alone(tmp_path, capsys):
    """As after an upgrade with a new example, and one that the user edited."""
    assert main(["init", str(tmp_path)]) == 0
    mine = tmp_path / "configs" / "axis_simulated.yaml"
    mine.write_text("name: mine\n")
    new = tmp_path / "configs" / "scenarios" / "paper.yaml"
    new.unlink()
    capsys.readouterr()
    assert main(["init", str(tmp_path), "--missing"]) == 0
    written, left = capsys.readouterr().out.split("left alone")
    assert f"  {new}\n" in written
    assert f"  {mine}\n" in left
    assert str(mine) not in written
    assert f"unchanged examples: {len(files_below(CONFIGS)) - 2}\n" in left
    assert mine.read_text() == "name: mine\n"
    assert files_below(tmp_path / "configs") == files_below(CONFIGS) | {Path("axis_simulated.yaml"): b"name: mine\n"}
    assert main(["init", str(tmp_path / "empty"), "--missing"]) == 0
    assert files_below(tmp_path / "empty" / "configs") == files_below(CONFIGS)
    assert "left alone" not in capsys.readouterr().out


def test_missing_and_force_are_not_both_meant(tmp_path):
    with pytest.raises(SystemExit):
        main(["init", str(tmp_path), "--missing", "--force"])
    assert list(tmp_path.iterdir()) == []


def test_the_list_has_a_line_for_each_file_and_writes_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "--list"]) == 0
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert names == sorted(f"configs/{path.relative_to(CONFIGS)}" for path in CONFIGS.rglob("*") if path.is_file())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["axis_simulated.yaml", "axis_undeclared.yaml", "axis_bench.yaml"])
def test_what_is_laid_down_passes_the_check(name, tmp_path, capsys):
    assert main(["init", str(tmp_path)]) == 0
    assert main(["config", "check", str(tmp_path / "configs" / name)]) == 0
    assert "ok" in capsys.readouterr().out


def test_a_package_without_its_examples_says_so(tmp_path, capsys, monkeypatch):
    package = tmp_path / "fffo_drive"
    unit = package / "files" / "systemd" / service_files.UNIT
    unit.parent.mkdir(parents=True)
    unit.touch()
    monkeypatch.setattr(service_files, "PACKAGE", package)
    assert main(["init", str(tmp_path / "bench")]) == 78
    assert "install it again" in capsys.readouterr().err
    assert not (tmp_path / "bench").exists()
