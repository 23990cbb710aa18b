"""Layouts for the viewers: every topic, field and service that they name exists, live or in a recording."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fffo_drive.daemon.parameters import METHODS
from fffo_drive.live.messages import SCHEMAS
from fffo_drive.recording.schema import ROW_TOPIC
from fffo_drive.signals import SIGNALS

LAYOUTS = Path(__file__).resolve().parents[2] / "configs" / "layouts"
RECORDED = {signal.name for signal in SIGNALS}
LIVE_ONLY = re.compile(r"_(min|max)$")


def live_fields(topic: str) -> set[str]:
    """Of the message itself; nested types follow a line of `=`."""
    text = SCHEMAS[topic][1].partition("\n==")[0]
    return {line.split()[1] for line in text.splitlines() if line and not line.startswith("#")}


def require(topic: str, field: str) -> None:
    assert topic in SCHEMAS, topic
    assert not field or field in live_fields(topic), f"{topic}: {field}"
    if topic == ROW_TOPIC and not LIVE_ONLY.search(field):
        assert field in RECORDED, f"{field} is not in a recording"


def panels() -> dict[str, Any]:
    panels: dict[str, Any] = json.loads((LAYOUTS / "foxglove.json").read_text())["configById"]
    return panels


def paths() -> Iterator[str]:
    """Message paths of all panels."""
    for panel in panels().values():
        yield from (series["value"] for series in panel.get("paths", ()))
        yield from (panel[key] for key in ("path", "topicPath", "topicToRender") if panel.get(key))


def leaves(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    else:
        yield from leaves(node["first"])
        yield from leaves(node["second"])


@pytest.mark.parametrize("path", sorted(set(paths())))
def test_foxglove_finds_every_path(path):
    topic, _, field = path.partition(".")
    require(topic, field)


def test_foxglove_shows_every_panel_and_no_other():
    layout = json.loads((LAYOUTS / "foxglove.json").read_text())["layout"]
    assert sorted(leaves(layout)) == sorted(panels())


def test_foxglove_calls_services_that_there_are_and_has_a_place_for_the_key():
    calls = {name: panel for name, panel in panels().items() if "serviceName" in panel}
    for panel in calls.values():
        name = panel["serviceName"].removeprefix("/fffo_drive/")
        request = json.loads(panel["requestPayload"])
        assert request.pop("key") == ""
        METHODS[name].parameters.model_validate(request)
    assert json.loads(calls["CallService!stop"]["requestPayload"]) == {"key": "", "wait_s": 0}


def test_plotjuggler_finds_every_curve():
    curves = [curve.get("name", "") for curve in ElementTree.parse(LAYOUTS / "plotjuggler.xml").iter("curve")]
    assert len(curves) > 15
    for curve in curves:
        topic, _, field = curve.rpartition("/")
        require(topic, field)
        assert not LIVE_ONLY.search(field)  # it shows recordings as well
