"""What every web server here answers by: the headers of an answer, whom it is for, and what a request asks for."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple
from urllib.parse import parse_qs, unquote, urlsplit

HTML, TEXT, JSON = "text/html; charset=utf-8", "text/plain; charset=utf-8", "application/json"
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")
_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)


class RequestTarget(NamedTuple):
    """What a request asks for."""

    path: str  # decoded; bytes that are no UTF-8 as in the names of files (surrogateescape)
    query: Mapping[str, list[str]]


def target_of(text: str) -> RequestTarget | None:
    """The target of a request; None for one that no browser sends: no URL, or characters that no name has."""
    try:
        parts = urlsplit(text)
        path, query = unquote(parts.path, errors="surrogateescape"), parse_qs(parts.query)
    except ValueError:
        return None
    return None if _CONTROL.search(path) else RequestTarget(path, query)


def is_one_of(given: Sequence[str] | None, names: Sequence[str], scheme: str = "") -> bool:
    """Whether a header (Host; Origin, with its scheme) is there once and says one of our names."""
    return given in [[f"{scheme}{name}"] for name in names]


def headers(kind: str, allowed: str = "", framed: bool = False) -> dict[str, str]:
    """Of every answer: nothing runs, loads or is sent but what `allowed` says, and nobody else may frame or keep it.

    `kind`: its media type. `framed`: pages of this server may show it in a frame.
    """
    frame = "'self'" if framed else "'none'"
    policy = ("default-src 'none'", "base-uri 'none'", "form-action 'none'", f"frame-ancestors {frame}", allowed)
    return {
        "Content-Type": kind,
        "Content-Security-Policy": "; ".join(filter(None, policy)),
        "Cross-Origin-Opener-Policy": "same-origin",
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "SAMEORIGIN" if framed else "DENY",
        "Cache-Control": "no-store",
    }


def own_page(style: str, script: str, *more: str) -> str:
    """What a page of ours may do: its one style sheet and script, and requests to this server."""
    return "; ".join(
        (f"script-src {_hash(script)}", f"style-src {_hash(style)}", "connect-src 'self'", "img-src data:", *more)
    )


def written_page(content: bytes) -> str:
    """What a page that was written to a file may do: its own scripts draw its figures and save their points.

    They are nobody here (sandbox): they cannot reach the page that shows them, nor ask this server for anything.
    """
    scripts = " ".join(map(_hash, _SCRIPT.findall(content.decode("utf-8", "replace")))) or "'none'"
    return (
        f"script-src {scripts}; style-src 'unsafe-inline'; img-src data: blob:; "
        "sandbox allow-scripts allow-downloads allow-modals"
    )


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
