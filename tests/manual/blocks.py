"""The code blocks of the manual: the commands in them, and what they say is printed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

PAGES = Path(__file__).resolve().parents[2] / "fffo_drive" / "manual" / "pages"
FENCE = re.compile(
    r"^```(?:\{code-block\} )?(console|python|yaml|toml)\n(?::class: ([^\n]*)\n)?\n?(.*?)^```$", re.M | re.S
)
NUMBER = re.compile(r"[-+±]?\d[\d.]*(?:e[-+]?\d+)?")


class Block(NamedTuple):
    """One block: `marks` are `run`, `long`, `varying` (its numbers are not compared), or `run` and a file's name."""

    language: str
    marks: tuple[str, ...]
    text: str

    @property
    def steps(self) -> list[tuple[str, str]]:
        """Each command with the output that the page quotes."""
        parts = re.split(r"^\$ ", self.text, flags=re.M)[1:]
        return [(part.partition("\n")[0], part.partition("\n")[2]) for part in parts]


def blocks_of(page: Path) -> list[Block]:
    """All blocks of a page with commands or a file, in order."""
    return [Block(f[1], tuple((f[2] or "").split()), f[3]) for f in FENCE.finditer(page.read_text(encoding="utf-8"))]


def words_of(text: str) -> str:
    """Output without numbers and without layout."""
    return " ".join(NUMBER.sub("#", text).split())


def agrees(quoted: str, printed: str, numbers: bool = True) -> bool:
    """Whether the printed text is the quoted one, where `...` stands for anything; true where nothing is quoted.

    With `numbers` each number may differ by one unit of the last digit that the page quotes: processors round
    differently.
    """
    if not quoted.strip():
        return True
    pattern = r"\s*.*?".join(_pattern(part) for part in quoted.split("...")) + r"\s*"
    found = re.fullmatch(pattern, " ".join(printed.split()), re.S)
    if found is None or not numbers:
        return found is not None
    return all(_close(*pair) for pair in zip(NUMBER.findall(quoted), found.groups(), strict=True))


def _pattern(part: str) -> str:
    return f"({NUMBER.pattern})".join(re.escape(words) for words in NUMBER.split(" ".join(part.split())))


def _close(quoted: str, printed: str) -> bool:
    digits, _, exponent = quoted.lstrip("±").rstrip(".").partition("e")
    last = 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))
    values = [float(one.lstrip("±").rstrip(".")) for one in (quoted, printed)]
    return abs(values[0] - values[1]) <= 1.01 * last
