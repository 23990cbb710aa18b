"""Build the manual with Sphinx, and find pages that were built.

The sources in `pages/` are copied to a temporary directory, the reference and the figures are generated beside them,
and Sphinx writes static pages there that need neither a server nor a network.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import tempfile
from pathlib import Path

from .. import __version__
from ..directories import own_directory, shared_place
from ..extras import needs_extra

PACKAGE = Path(__file__).resolve().parent
SOURCES = PACKAGE / "pages"
BUILT = PACKAGE / "built"  # inside a wheel only: tools/manual_in_wheel.py puts it there
SOURCE_TREE = PACKAGE.parent.parent  # of a clone; in a wheel there is none
INDEX = "index.html"
TOOLS = ("sphinx", "myst_parser", "furo", "sphinx_copybutton")


class ManualError(ValueError):
    """The manual cannot be built or found. The text says what to do."""


def missing_tools() -> list[str]:
    """Names of the packages of the extra `manual` that are not installed."""
    return [name for name in TOOLS if importlib.util.find_spec(name) is None]


def find() -> Path | None:
    """The built page to open: in the wheel, else in the cache for exactly these sources, else None."""
    for directory in (BUILT, cache_directory()):
        if (directory / INDEX).is_file():
            return directory / INDEX
    return None


def cache_directory() -> Path:
    """Where a clone keeps its built pages: one directory for each state of the package's sources."""
    digest = hashlib.sha256(__version__.encode())
    package = PACKAGE.parent
    for path in sorted(package.rglob("*")):
        if path.suffix in (".py", ".md", ".css", ".yaml") and "__pycache__" not in path.parts:
            digest.update(str(path.relative_to(package)).encode())
            digest.update(path.read_bytes())
    return cache_root() / digest.hexdigest()[:16]


def cache_root() -> Path:
    """Directory of all cached manuals: $XDG_CACHE_HOME/fffo-drive/manual, else one of our own below /tmp."""
    cache = os.environ.get("XDG_CACHE_HOME")
    base = Path(cache) if cache else Path.home() / ".cache"
    if os.access(base if base.exists() else base.parent, os.W_OK):
        return base / "fffo-drive" / "manual"
    return own_directory(shared_place("fffo-drive-manual"))


def build(out: Path, strict: bool = True) -> Path:
    """Write the static pages to `out` and return the index page.

    `strict` makes each warning of Sphinx an error (sphinx-build -W). Raises ManualError, OSError.
    """
    if (BUILT / INDEX).is_file():  # of a wheel: the pages of this very version
        shutil.copytree(BUILT, out, dirs_exist_ok=True)
        return out / INDEX
    if not (SOURCE_TREE / "tools" / "tables").is_dir():
        raise ManualError(
            "this installation has no manual inside: its wheel was built without Sphinx. In a clone type "
            "`tools/environment test` and then `.venv/bin/fffo-drive manual`, or build the wheel again there"
        )
    missing = missing_tools()
    if missing:
        raise ManualError(f"not installed: {', '.join(missing)}: {needs_extra('building the manual', 'manual')}")
    from sphinx.cmd.build import main as sphinx_build

    from .generated import write_generated  # loads slowly

    with tempfile.TemporaryDirectory(prefix="fffo-drive-manual-") as name:
        work = Path(name)
        source = work / "source"
        shutil.copytree(SOURCES, source, ignore=shutil.ignore_patterns("__pycache__"))
        write_generated(source, SOURCE_TREE)
        words = ["-q", "-b", "html", "-d", str(work / "doctrees"), *(["-W", "--keep-going"] if strict else [])]
        code = sphinx_build([*words, str(source), str(work / "html")])
        if code != 0:
            raise ManualError(f"Sphinx ended with exit code {code}; its warnings stand above")
        _replace(work / "html", out)
    return out / INDEX


def _replace(built: Path, out: Path) -> None:
    """Move the pages to `out`, which may hold older pages of ours and nothing else."""
    if out.exists():
        if any(out.iterdir()) and not (out / "searchindex.js").is_file():
            raise ManualError(f"{out}: is not empty and holds no manual; name an empty or a new directory")
        shutil.rmtree(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    shutil.move(built, out)
