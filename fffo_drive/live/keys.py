"""Keys of the pages and services; without what the live server itself needs."""

from __future__ import annotations

import hmac


def is_key(given: object, key: str) -> bool:
    """What was given is the key; takes as long for every other text of its length."""
    text = given if isinstance(given, str) else ""
    return hmac.compare_digest(text.encode("utf-8", "replace"), key.encode())
