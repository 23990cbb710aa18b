"""What the subcommands take from `config.plan`: an axis file into a drive, a session and the header of its runs."""

from __future__ import annotations

from ..config.plan import (
    YAML_TYPE,
    Plan,
    connect,
    effect_monitor,
    make_plan,
    open_drive,
    plan_session,
    run_header,
    toggle_name,
)

__all__ = [
    "YAML_TYPE",
    "Plan",
    "connect",
    "effect_monitor",
    "make_plan",
    "open_drive",
    "plan_session",
    "run_header",
    "toggle_name",
]
