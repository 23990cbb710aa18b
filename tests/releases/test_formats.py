"""What becomes of a file of another number: an older one is brought up to date, a newer one names who reads it."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Annotated

import pytest

from fffo_drive import __version__, formats
from fffo_drive.commissioning.record import CommissioningRecord
from fffo_drive.config.adoption import History
from fffo_drive.config.axis import AxisFile
from fffo_drive.config.scenario import ScenarioFile
from fffo_drive.config.simulated import SimulatedDriveRecord
from fffo_drive.documents import DocumentError, StrictRecord, load
from fffo_drive.formats import FORMATS, Document, Format
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.model.parameters import ModelFile
from fffo_drive.report.document import ReportFile

PACKAGE = Path(formats.__file__).parent
TABLE = PACKAGE.parent / "tools" / "tables" / "versions.md"
RECORDS = {
    formats.AXIS: AxisFile, formats.MODEL: ModelFile, formats.SIMULATED: SimulatedDriveRecord,
    formats.SCENARIO: ScenarioFile, formats.FACTS: DriveFacts, formats.COMMISSIONING: CommissioningRecord,
    formats.ADOPTIONS: History, formats.REPORT: ReportFile,
}  # fmt: skip


def hertz(data: Document) -> dict[str, object]:
    """1 -> 2: the speed was in rpm."""
    rest = {key: value for key, value in data.items() if key != "speed_rpm"}
    return {**rest, "speed_rps": data["speed_rpm"] / 60.0}


def sections(data: Document) -> dict[str, object]:
    """2 -> 3: what belongs to the motor has a section."""
    return {"format": data.get("format"), "motor": {"speed_rps": data["speed_rps"]}, "name": data["name"]}


GADGET = Format("gadget", "an invented file", formats.HAND, "these tests", (hertz, sections))


class Motor(StrictRecord):
    speed_rps: Annotated[float, formats.Field(gt=0, le=100)]


class Gadget(StrictRecord):
    format: Annotated[str, GADGET.key] = GADGET.word
    name: str
    motor: Motor


@pytest.fixture
def read(tmp_path, monkeypatch):
    monkeypatch.setitem(FORMATS, "gadget", GADGET)
    path = tmp_path / "gadget.yaml"

    def of(text: str) -> Gadget:
        path.write_text(text)
        return load(path, Gadget)

    return of


EVERY_AGE = [
    "name: a\nspeed_rpm: 600\n",
    "format: fffo_drive/gadget/1\nname: a\nspeed_rpm: 600\n",
    "format: fffo_drive/gadget/2\nname: a\nspeed_rps: 10\n",
    "format: fffo_drive/gadget/3\nname: a\nmotor: {speed_rps: 10}\n",
]


@pytest.mark.parametrize("text", EVERY_AGE)
def test_a_file_of_every_number_is_read_and_means_the_same(read, text):
    assert read(text) == Gadget(name="a", motor=Motor(speed_rps=10.0))


def test_a_migrated_file_is_checked_as_one_of_today(read):
    with pytest.raises(DocumentError, match=r"motor\.speed_rps: a number above 0 and up to 100 is needed \(got 200"):
        read("name: a\nspeed_rpm: 12000\n")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("speed_rpm: 600\n", "motor.name"),  # named below
        ("speed_rpm: fast\nname: a\n", "fffo_drive/gadget/1 cannot be brought to fffo_drive/gadget/3"),
        ("format: fffo_drive/gadget/2\nname: a\nspeed_rpm: 600\n", "fffo_drive/gadget/2 cannot be brought to"),
    ],
)
def test_an_older_file_that_lacks_something_is_one_sentence(read, text, said):
    with pytest.raises(DocumentError) as caught:
        read(text)
    assert "Traceback" not in str(caught.value)
    assert said in str(caught.value) or "cannot be brought" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


NEWER = "fffo_drive/gadget/4 is newer than what fffo-drive {version} reads (fffo_drive/gadget/3 and older); "


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("", "it does not say which version wrote it: read it with a later one"),
        ("tool: fffo_drive 0.9.1\n", "fffo-drive 0.9.1 wrote it: read it with that version, or a later one"),
        ("tool: fffo-drive/1.2.0rc1\n", "fffo-drive 1.2.0rc1 wrote it"),
        ("provenance: {tool: fffo-drive 2.0.0 diagnose}\n", "fffo-drive 2.0.0 wrote it"),
        ("provenance: [1]\ntool: something else\n", "it does not say which version wrote it"),
    ],
)
def test_a_newer_file_is_refused_and_names_who_reads_it(read, more, said):
    with pytest.raises(DocumentError) as caught:
        read(f"name: a\nformat: fffo_drive/gadget/4\n{more}surprise: 1\n")
    assert re.fullmatch(
        rf"\S+gadget\.yaml:2: format: {re.escape(NEWER.format(version=__version__) + said)}.*", str(caught.value)
    )


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("fffo_drive/axis/1", "fffo_drive/axis/1 where fffo_drive/gadget/3 is needed"),
        ("gadget", "'gadget' is no format of this program; write fffo_drive/gadget/3"),
        ("fffo_drive/gadget/0", "is no format of this program"),
        ("fffo_drive/gadget/03", "is no format of this program"),
        ("3", "3 is no format of this program"),
        ("[1]", "is no format of this program"),
    ],
)
def test_a_file_of_another_kind_is_recognised_by_its_format(read, said, message):
    with pytest.raises(DocumentError, match=r"gadget\.yaml:1: format: ") as caught:
        read(f"format: {said}\nname: a\n")
    assert message in str(caught.value)


def test_every_record_says_what_the_list_says():
    for one, record in RECORDS.items():
        field = record.model_fields["format"]
        assert FORMATS[one.kind] is one
        assert field.default == one.word
        assert record.model_json_schema()["properties"]["format"]["const"] == one.word


def test_the_page_is_current():
    page = runpy.run_path(str(TABLE.parents[1] / "versions_page.py"))["markdown"]()
    assert TABLE.read_text(encoding="utf-8") == page, "run tools/versions"


def test_the_list_is_complete():
    """No file has a format that is written down beside the list."""
    for path in PACKAGE.rglob("*.py"):
        if path.name != "formats.py":
            assert re.findall(r"fffo_drive/[a-z_]+/\d", path.read_text()) == [], path
    for kind, one in FORMATS.items():
        assert kind == one.kind
        assert re.fullmatch(r"[a-z_]+", kind)
