"""Keys of the pages and services, one for each role; independent of the live server's own imports.

The key of the last role gives the keys of all others, never the reverse. A name may precede a key (`anna:KEY`): it
gives no rights, and appears in the log.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import re
import secrets
from typing import NamedTuple

from ..roles import ROLES, Role

LONGEST_NAME = 40
_NAME = re.compile(rf"[\w .-]{{1,{LONGEST_NAME}}}")


class Asker(NamedTuple):
    """The owner of a key: the role that the key gives, and the name before it."""

    role: Role
    name: str = ""

    @property
    def text(self) -> str:
        """For the log."""
        return f"{self.name} ({self.role})" if self.name else f"role {self.role}"


class Keys:
    """A key for each role, derived from the key of the last one."""

    def __init__(self, last: str | None = None) -> None:
        """`last`: the key of the last role; None makes a new one."""
        self.last = last or secrets.token_urlsafe(24)
        self._of: dict[Role, str] = {role: _made(self.last, role) for role in ROLES[:-1]} | {ROLES[-1]: self.last}

    def of(self, role: Role) -> str:
        """The key of a role."""
        return self._of[role]

    def asker(self, given: object) -> Asker | None:
        """The owner of this key; None where it is none. Takes equally long for every text of the same length."""
        name, colon, key = given.rpartition(":") if isinstance(given, str) else ("", "", "")
        if colon and not _NAME.fullmatch(name):
            return None
        found = [role for role, own in self._of.items() if hmac.compare_digest(_bytes(key), own.encode())]
        return Asker(found[0], name) if found else None


def _made(last: str, role: Role) -> str:
    digest = hmac.digest(last.encode(), role.encode(), hashlib.sha256)
    return base64.urlsafe_b64encode(digest[:24]).decode()


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "replace")
