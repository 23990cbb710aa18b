"""The house: who may import whom, how long a file may be, and that names carry their units."""

from __future__ import annotations

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "fffo_drive"
HOUSE_PAGE = PACKAGE / "manual" / "pages" / "explanation" / "house.md"
FLOORS = {
    "arrays": 0, "units": 0, "signals": 0, "symbols": 0, "formats": 0, "directories": 0, "extras": 0, "roles": 0,
    "jit": 0.25, "documents": 0.25, "packing": 0.25, "least_squares": 0.25,
    "model": 0.5,
    "control": 1, "can": 1, "recording": 1,
    "canopen_node": 1.5,
    "drive": 2,
    "importing": 2.5,
    "runtime": 3, "identification": 3,
    "evaluation": 4, "diagnosis": 4, "commissioning": 4, "system": 4,
    "config": 5, "report": 5,
    "workflows": 5.5,
    "daemon": 5.75, "live": 5.75,
    "fleet": 5.75,
    "workbench": 5.9,
    "cli": 6, "library": 6,
    "manual": 7,
}  # fmt: skip
LONGEST_FILE = 600  # a file holds one concept and is as long as that takes; beyond this it holds two
SOURCES = sorted(PACKAGE.rglob("*.py"))


def part_of(path: Path) -> str:
    relative = path.relative_to(PACKAGE)
    return relative.parts[0].removesuffix(".py")


def _checked_only(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def imported_modules(path: Path, of_types: bool = True) -> set[str]:
    """Absolute names of the modules of this package that a file imports, relative imports resolved.

    `of_types`: with those that only a type checker imports.
    """
    package = ["fffo_drive", *path.relative_to(PACKAGE).parent.parts]
    names: set[str] = set()
    tree = ast.parse(path.read_text())
    left_out = set() if of_types else {id(n) for one in ast.walk(tree) if _checked_only(one) for n in ast.walk(one)}
    for node in ast.walk(tree):
        if id(node) in left_out:
            continue
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            names.add(module)
            names.update(f"{module}.{alias.name}" for alias in node.names)
    return {name for name in names if name.startswith("fffo_drive.")}


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_module_imports_from_floors_below_and_its_own_package_only(path):
    own = part_of(path)
    if own in ("__init__", "__main__"):
        return
    for name in imported_modules(path):
        other = name.split(".")[1]
        if other in FLOORS and other != own:
            assert FLOORS[other] < FLOORS[own], f"{path.relative_to(PACKAGE)} imports {name}"


def test_the_page_of_the_manual_has_every_part_in_the_layer_that_is_held_here():
    layer, found = -1, {}
    for line in HOUSE_PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) < 5 or not cells[2].startswith("`"):
            continue
        layer = int(cells[1]) if cells[1].isdigit() else layer
        found |= {name.rstrip("/"): layer for name in re.findall(r"`([a-z_]+/?)`", cells[2])}
    assert found == {name: int(floor) for name, floor in FLOORS.items()}


def test_no_module_imports_itself_by_way_of_others():
    """Neither when it is loaded nor later, inside a function; what only a type checker imports may go round."""
    files = {".".join(["fffo_drive", *path.relative_to(PACKAGE).with_suffix("").parts]): path for path in SOURCES}
    graph = {name: imported_modules(path, of_types=False) & set(files) for name, path in files.items()}
    TopologicalSorter(graph).prepare()  # raises CycleError with the circle


def test_every_part_of_the_package_has_a_floor():
    assert {part_of(path) for path in SOURCES} - {"__init__", "__main__"} <= set(FLOORS)


def test_the_simulated_drive_shares_nothing_with_the_model():
    for path in (PACKAGE / "drive" / "simulated").rglob("*.py"):
        for name in imported_modules(path):
            assert not name.startswith(("fffo_drive.model", "fffo_drive.control")), f"{path} imports {name}"


def test_the_canopen_node_serves_any_device():
    for path in (PACKAGE / "canopen_node").rglob("*.py"):
        assert {name.split(".")[1] for name in imported_modules(path)} <= {"canopen_node", "can", "jit"}, path


def test_the_envelope_knows_none_of_the_controllers():
    own = {name for name in imported_modules(PACKAGE / "control" / "envelope.py") if ".control" in name}
    assert own == set()


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_no_file_is_longer_than_one_concept(path):
    assert len(path.read_text().splitlines()) <= LONGEST_FILE


def test_a_class_has_a_name_of_its_own():
    places: dict[str, list[str]] = {}
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    assert {name: files for name, files in places.items() if len(files) > 1 and not name.startswith("_")} == {}


def test_numba_is_configured_in_one_place():
    for path in SOURCES:
        text = path.read_text()
        if path.parent.name != "jit":
            assert "numba.njit" not in text
            assert "from numba import njit" not in text
