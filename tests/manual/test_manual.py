"""The manual builds without a warning, leads nowhere outside, and its commands do what it says."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from manual.blocks import PAGES, agrees, blocks_of

from fffo_drive.cli import COMMANDS, parser_of
from fffo_drive.cli.config import SCHEMAS, schema_record
from fffo_drive.cli.exits import MEANINGS
from fffo_drive.daemon.parameters import METHODS
from fffo_drive.manual import building
from fffo_drive.manual.building import ManualError, build
from fffo_drive.manual.reference import commands, unit_of
from fffo_drive.model.effects.registry import LAWS
from fffo_drive.signals import SIGNALS

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(PAGES.rglob("*.md"))
LONG = ("diagnose", "identify_and_tune", "own_effect")  # chapters of ten seconds and more
RUN = [p for p in SOURCES if any("run" in b.marks and "long" not in b.marks for b in blocks_of(p))]
QUICK = [p for p in RUN if p.stem not in LONG]


class Links(HTMLParser):
    """Targets and anchors of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        if "id" in found:
            self.anchors.add(found["id"])
        if tag == "a" and found.get("href"):
            self.targets.append(found["href"])
        loaded = found.get("src") or (found.get("href") if tag == "link" else None)
        if loaded:
            self.loaded.append(loaded)


@pytest.fixture(scope="module")
def built(site):
    """The pages that the wheel brings."""
    return site / "fffo_drive" / "manual" / "built"


@pytest.fixture(scope="module")
def pages(built):
    assert (built / "index.html").is_file()
    return {path: Links(path.read_text(encoding="utf-8")) for path in sorted(built.rglob("*.html"))}


@pytest.mark.long
def test_every_link_inside_leads_somewhere(pages):
    broken = []
    for page, links in pages.items():
        for target in links.targets:
            if re.match(r"[a-z]+:", target):
                continue
            name, _, anchor = unquote(target).partition("#")
            goal = (page.parent / name).resolve() if name else page
            if not goal.is_file() or (anchor and goal.suffix == ".html" and anchor not in pages[goal].anchors):
                broken.append(f"{page.name}: {target}")
    assert broken == []


@pytest.mark.long
def test_pages_load_nothing_from_a_network(pages):
    for page, links in pages.items():
        assert [address for address in links.loaded if re.match(r"(https?:)?//", address)] == [], page.name


@pytest.mark.long
def test_the_reference_has_every_command_file_signal_law_and_method(built):
    def text(name):
        return (built / "reference" / f"{name}.html").read_text(encoding="utf-8")

    assert [name for name in COMMANDS if f"fffo-drive {name}" not in text("commands")] == []
    assert [signal.name for signal in SIGNALS if signal.name not in text("signals")] == []
    assert [name for name in LAWS if name != "lookup" and name not in text("effects")] == []
    assert [name for name in METHODS if name not in text("api")] == []
    for kind in SCHEMAS:
        assert [
            key for key in schema_record(kind).model_json_schema()["properties"] if key not in text(f"file_{kind}")
        ] == []


def test_the_unit_of_a_key_is_the_one_that_it_is_declared_with():
    """The reference takes it from the ending of the name; a simulated drive declares it, as [UNIT] in its meaning."""
    as_printed = {"kg m^2": "kg m²", "rps": "rev/s", "rps2": "rev/s²", "ohm": "Ω"}
    schema = schema_record("simulated").model_json_schema()
    keys = [item for section in schema["$defs"].values() for item in section.get("properties", {}).items()]
    declared = {key: re.search(r"\[(.+)\]$", entry["description"]) for key, entry in keys if "description" in entry}
    units = {key: found[1] for key, found in declared.items() if found}
    assert {key: unit_of(key) for key in units} == {key: as_printed.get(unit, unit) for key, unit in units.items()}


CODE = re.compile(r"(?<![\w.])(\d+)\s[a-z]")


def test_an_exit_code_of_a_command_or_of_the_manual_is_one_of_the_table():
    page = (ROOT / "fffo_drive" / "manual" / "pages" / "howto" / "troubleshooting.md").read_text(encoding="utf-8")
    assert [int(code) for code in re.findall(r"^\| (\d+) \|", page, re.MULTILINE)] == [c for c in MEANINGS if c]
    for command in COMMANDS:
        codes = re.search(r"exit codes: (.*?)(\n\n|$)", parser_of(command).description or "", re.DOTALL | re.IGNORECASE)
        if codes is not None:
            assert {int(code) for code in CODE.findall(codes[1])} <= set(MEANINGS), command
    rows = commands().partition("## Exit codes")[2].partition("##")[0]
    assert all(f"| {code} | {text} |" in rows for code, text in MEANINGS.items())


@pytest.mark.parametrize("page", SOURCES, ids=lambda p: p.stem)
def test_every_command_of_a_page_is_one_that_the_program_takes(page):
    for block in blocks_of(page):
        for command, _ in block.steps:
            words = shlex.split(command.partition(" > ")[0].removesuffix("&"))
            if words and words[0] == "fffo-drive":
                parser_of(words[1]).parse_args(words[2:])


def run_page(page: Path, directory: Path, with_long: bool) -> list[str]:
    """Run the marked blocks of a page in order; what differs from the page."""
    shutil.copytree(ROOT / "configs", directory / "configs")
    program = directory / "bin" / "fffo-drive"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m fffo_drive "$@"\n')
    program.chmod(0o755)
    python = program.with_name("python")  # no link: that would leave the environment behind
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    environment = dict(os.environ, PATH=f"{program.parent}:{os.environ['PATH']}", COLUMNS="80")
    # what a page installs goes to a place of its own, without the network
    site = directory / "site"
    environment["PYTHONPATH"] = os.pathsep.join([str(site), str(ROOT)])
    pip = {"TARGET": str(site), "NO_BUILD_ISOLATION": "0", "NO_DEPS": "1", "NO_INDEX": "1"}  # 0: no isolation
    environment |= {f"PIP_{name}": value for name, value in pip.items()}
    wrong = []
    for block in blocks_of(page):
        if "run" not in block.marks or ("long" in block.marks and not with_long):
            continue
        if block.language != "console":
            file = directory / block.marks[1]
            file.parent.mkdir(exist_ok=True)
            file.write_text(block.text)
            continue
        for command, quoted in block.steps:
            done = subprocess.run(
                command, shell=True, cwd=directory, env=environment, capture_output=True, text=True, timeout=170
            )
            # a terminal shows both; what is said on the way comes before the result
            numbers = "varying" not in block.marks
            said = any(agrees(quoted, printed, numbers) for printed in (done.stdout, done.stderr + done.stdout))
            if done.returncode != 0 or not said:
                wrong.append(f"$ {command} -> {done.returncode}\n{done.stdout}{done.stderr}")
    return wrong


@pytest.mark.slow
@pytest.mark.parametrize("page", QUICK, ids=lambda p: p.stem)
def test_the_quick_blocks_of_a_page_print_what_it_says(page, tmp_path):
    assert run_page(page, tmp_path, with_long=False) == []


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("chapter", LONG)
def test_a_long_chapter_prints_what_it_says(chapter, tmp_path):
    assert run_page(PAGES / "tutorial" / f"{chapter}.md", tmp_path, with_long=True) == []


def test_the_comparison_of_output_notices_another_word_and_another_number():
    assert agrees("a 1.5 b\n...\nend", "a 1.6 b\nmore\nend\n")
    assert not agrees("a 1.5 b\n...\nend", "a 1.7 b\nmore\nend\n")
    assert agrees("a 1.5 b\n...\nend", "a 1.7 b\nmore\nend\n", numbers=False)
    assert agrees("p 9.2e-10; 3 of -4", "p 9.3e-10; 3 of -4")
    assert not agrees("p 9.2e-10", "p 9.2e-9")
    assert not agrees("... 5", "3 7")
    assert not agrees("-2 to 3", "2 to 3")
    assert not agrees("a 1.5 b\n...\nend", "a 1.6 c\nmore\nend\n")
    assert not agrees("a 1.5 b", "a 1.5 b\nmore\n")


def test_an_installation_without_pages_and_sources_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr(building, "SOURCE_TREE", tmp_path)
    with pytest.raises(ManualError, match="tools/environment test"):
        build(tmp_path / "out")


def test_a_directory_with_other_files_is_not_overwritten(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ManualError, match="holds no manual"):
        building._replace(tmp_path, tmp_path)


def test_the_readme_is_short_and_its_links_lead_somewhere():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.encode()) <= 5000
    assert [t for t in re.findall(r"\]\(([^)#]+)\)", text.replace("\n   ", " ")) if not (ROOT / t).is_file()] == []
