"""Optional libraries: what to type where the libraries of an extra are missing."""

from __future__ import annotations

import shlex
import sys
from importlib.metadata import PackageNotFoundError, requires

PACKAGE = "fffo-drive"


def needs_extra(what: str, extra: str) -> str:
    """`what` and how to install what it needs.

    The command names the libraries and this environment's Python. This package is on no index: `pip install` by its own
    name could fetch somebody else's.
    """
    command = shlex.join([sys.executable, "-m", "pip", "install", *libraries_of(extra)])
    return f"{what} needs the extra `{extra}`: {command}"


def libraries_of(extra: str) -> list[str]:
    """What the extra consists of, as pip takes it; the extra itself where this package is not installed."""
    try:
        declared = requires(PACKAGE) or []
    except PackageNotFoundError:
        declared = []
    wanted = [requirement for requirement, _, marker in (line.partition(";") for line in declared)
              if marker.replace('"', "'").strip() == f"extra == '{extra}'"]  # fmt: skip
    return [requirement.strip() for requirement in wanted] or [f"{PACKAGE}[{extra}]"]
