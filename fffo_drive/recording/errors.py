"""The only exception of this package: a file that cannot be used as requested. Its text names file and place."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class RecordingError(Exception):
    """A recording or table is invalid. A torn file is not an error: its complete part is read."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The tail of a message about an unknown name: the nearest known ones, else all of them."""
    names = sorted(set(known))
    lowered = {candidate.lower(): candidate for candidate in names}
    near = [lowered[match] for match in difflib.get_close_matches(name.lower(), lowered, n=3)]
    if near:
        return "did you mean " + " or ".join(repr(candidate) for candidate in near) + "?"
    return "there is " + (", ".join(names) if names else "nothing") + "."
