"""Who may do what: the roles of the daemon's methods, of its pages and of the workbench, in one list."""

from __future__ import annotations

from typing import Literal

Role = Literal["look", "stop", "move", "tune"]
ROLES: tuple[Role, ...] = ("look", "stop", "move", "tune")  # each may do what those before it may


def may(role: Role, needed: Role) -> bool:
    """Whether who has `role` may do what needs another."""
    return ROLES.index(role) >= ROLES.index(needed)
