"""The facts file: an example of every key, and a schema with a meaning for each."""

from __future__ import annotations

import json
from pathlib import Path

from fffo_drive.cli import main
from fffo_drive.identification.facts import DriveFacts, read_facts

EXAMPLE = Path(__file__).resolve().parents[2] / "configs" / "facts.yaml"


def test_the_example_is_read_and_shows_every_key():
    facts = read_facts(EXAMPLE)
    text = EXAMPLE.read_text()
    for name in DriveFacts.model_fields:
        assert f"{name}:" in text, name
    assert facts.lsb_rev == 1.0 / 32768.0
    columns = {column.signal: column for column in facts.hints().columns}
    assert columns["velocity_rps"].unit == "rpm"
    assert columns["position_rev"].scale == 1.0 / 4096.0


def test_the_schema_says_what_each_key_means(capsys):
    assert main(["config", "schema", "facts"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert set(schema["properties"]) == set(DriveFacts.model_fields)
    without = [name for name, key in schema["properties"].items() if "description" not in key and name != "format"]
    assert without == []
