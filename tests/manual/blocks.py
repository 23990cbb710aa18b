"""The code blocks of the manual: the commands in them, and what they say is printed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

PAGES = Path(__file__).resolve().parents[2] / "fffo_drive" / "manual" / "pages"
FENCE = re.compile(r"^```(?:\{code-block\} )?(console|python)\n(?::class: ([^\n]*)\n)?\n?(.*?)^```$", re.M | re.S)
NUMBER = re.compile(r"[-+±]?\d[\d.]*(?:e[-+]?\d+)?")


class Block(NamedTuple):
    """One block: `marks` are `run`, `long` and, of a script, its file name."""

    language: str
    marks: tuple[str, ...]
    text: str

    @property
    def steps(self) -> list[tuple[str, str]]:
        """Each command with the output that the page quotes."""
        parts = re.split(r"^\$ ", self.text, flags=re.M)[1:]
        return [(part.partition("\n")[0], part.partition("\n")[2]) for part in parts]


def blocks_of(page: Path) -> list[Block]:
    """All console and Python blocks of a page, in order."""
    return [Block(f[1], tuple((f[2] or "").split()), f[3]) for f in FENCE.finditer(page.read_text(encoding="utf-8"))]


def words_of(text: str) -> str:
    """Output without numbers, which differ between processors, and without layout."""
    return " ".join(NUMBER.sub("#", text).split())


def agrees(quoted: str, printed: str) -> bool:
    """Whether the printed text is the quoted one, where `...` stands for anything. Nothing quoted: nothing is asked."""
    parts = [re.escape(words_of(part)) for part in quoted.split("...")]
    return not quoted.strip() or re.fullmatch(r"\s*.*".join(parts) + r"\s*", words_of(printed), re.S) is not None
