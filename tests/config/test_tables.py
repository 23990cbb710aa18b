"""The tables of `config`: plain columns at a terminal, Markdown in the manual alone, and the same facts as JSON."""

from __future__ import annotations

import json

import pytest

from fffo_drive.cli import main
from fffo_drive.config.drive_profile import shipped_profiles
from fffo_drive.drive.simulated.effects.registry import EFFECTS
from fffo_drive.manual import reference
from fffo_drive.signals import SIGNALS

TABLES = pytest.mark.parametrize("table", ["signals", "effects", "drives"])


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> list[str]:
    assert main(["config", *words]) == 0
    return capsys.readouterr().out.splitlines()


@TABLES
def test_a_table_fits_the_terminal_and_is_no_markdown(
    table: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for columns in (80, 120):
        monkeypatch.setenv("COLUMNS", str(columns))
        lines = printed(capsys, table)
        assert max(map(len, lines)) <= columns
        assert not any("|" in line or "`" in line or line != line.rstrip() for line in lines)


def test_in_a_pipe_each_signal_and_parameter_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    lines = printed(capsys, "signals")
    assert len(lines) == 1 + len(SIGNALS)
    begin = lines[0].index("meaning")
    assert [line[begin:] for line in lines[1:]] == [signal.meaning for signal in SIGNALS]
    lines = printed(capsys, "effects")
    assert len(lines) == 2 + len(EFFECTS) + sum(len(effect.parameters) for effect in EFFECTS.values())
    begin = lines[1].index("meaning")
    assert all(line[begin - 1] == " " != line[begin] for line in lines[1:] if line.startswith("  "))


def test_the_same_facts_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    signals = json.loads("\n".join(printed(capsys, "signals", "--json")))
    assert {name: entry["unit"] for name, entry in signals.items()} == {s.name: s.unit for s in SIGNALS}
    cogging = json.loads("\n".join(printed(capsys, "effects", "--json")))["cogging"]
    assert cogging["acts_on"] == "shaft torque"
    assert cogging["parameters"][0] == EFFECTS["cogging"].parameters[0]._asdict()
    assert list(json.loads("\n".join(printed(capsys, "drives", "--json")))) == list(shipped_profiles())


def test_the_manual_has_a_row_for_each_parameter_of_an_effect() -> None:
    lines = reference.effects().partition("## Effects of the simulated drive")[2].strip().splitlines()
    assert len(lines) == 2 + sum(len(effect.parameters) for effect in EFFECTS.values())
    assert len({line.count("|") for line in lines}) == 1
    for name in EFFECTS:
        assert sum(line.startswith(f"| `{name}` |") for line in lines) == 1
