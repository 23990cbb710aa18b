"""One workbench: what it shows, what it does when it is asked, and who asked."""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..config.axis import model_of, read_axis
from ..config.commissioning import permission
from ..config.drive_section import CanopenDriveSection
from ..config.effects import services
from ..directories import as_typed
from ..documents import DocumentError
from ..live.keys import is_key
from . import shelf
from .actions import ACTIONS, ROLES, Bench, Role, known_axis, may
from .jobs import Job, Jobs

AUDIT_NAME = "workbench.log"
REFUSED = "your key does not allow it: {needed} is needed, this page has {role}"


class ForbiddenError(Exception):
    """The key of who asks does not allow it."""


class Workbench:
    """State and actions of one workbench; called from the server's threads."""

    def __init__(self, directory: Path, axis: Path | None, facts: Path | None, given: tuple[Path, ...]) -> None:
        self.directory = directory
        self._first = axis
        self._axis = axis
        self._facts, self._given = facts, given
        self.jobs = Jobs()
        self.keys: dict[Role, str] = {role: secrets.token_urlsafe(18) for role in ROLES}
        self._audit = threading.Lock()
        (directory / shelf.RUNS).mkdir(parents=True, exist_ok=True)

    def role_of(self, key: str) -> Role | None:
        """The role that a key gives; None for a key that is none."""
        return next((role for role, own in self.keys.items() if is_key(key, own)), None)

    def state(self, role: Role) -> dict[str, Any]:
        """Everything that a page shows."""
        return {
            "role": role,
            "may": [name for name, action in ACTIONS.items() if may(role, action.role)],
            "moves": [name for name, action in ACTIONS.items() if action.moves],
            "may_cancel": may(role, "stop"),
            "directory": as_typed(str(self.directory)),
            "axis": self._axis_facts(),
            "axis_files": [str(path) for path in shelf.axis_files(self.directory, self._first)],
            "facts": None if self._facts is None else str(self._facts),
            "runs": shelf.recordings(self.directory, self._given),
            "pages": shelf.pages(self.directory),
            "jobs": [job.as_object() for job in self.jobs.all()],
        }

    def _axis_facts(self) -> dict[str, Any] | None:
        """The axis file in use, in words; with `error` where it cannot be read."""
        path = self._axis
        if path is None:
            return None
        try:
            axis = read_axis(path)
            model = model_of(path, axis)
            on_bus = isinstance(axis.drive, CanopenDriveSection)
            refused = ""
            if on_bus:
                try:
                    permission(path, axis, model)
                except DocumentError as error:
                    refused = str(error)
            controller = axis.controller
            return {
                "path": str(path), "shown": as_typed(str(path)), "name": axis.name, "on_bus": on_bus,
                "drive": f"CANopen, node {axis.drive.node_id}" if isinstance(axis.drive, CanopenDriveSection)
                         else "simulated, in process",
                "rate_hz": round(1.0 / axis.loop.period_s), "profile": axis.profile.kind,
                "model": f"{model.name}: {model.provenance.tool or 'by hand'}",
                "gains": f"Kp {controller.proportional_a_per_rps:g} A/rps, Ki {controller.integral_a_per_rev:g} A/rev, "
                         f"L {controller.observer.gain_nm_per_rev:g} Nm/rev, friction {controller.observer.toggle}",
                "effects": [{"name": s.effect.name, "reason": s.reason} for s in services(axis, model)],
                "commissioning": refused,
            }  # fmt: skip
        except (DocumentError, OSError) as error:
            return {"path": str(path), "shown": as_typed(str(path)), "name": path.name, "error": str(error)}

    def act(self, role: Role, name: str, wish: Mapping[str, Any]) -> dict[str, Any]:
        """Start one of ACTIONS. Raises ForbiddenError, DocumentError, jobs.BusyError."""
        action = ACTIONS[name]
        self._require(role, action.role)
        order = action.make(Bench(self.directory, self._axis, self._facts, self._given), wish)
        job = self.jobs.start(name, order.title, order.words, order.out, self._ended)
        self._told(role, name, {"line": job.as_object()["line"]})
        return job.as_object()

    def cancel(self, role: Role) -> None:
        """Interrupt what runs. Raises ForbiddenError."""
        self._require(role, "stop")
        job = self.jobs.running
        if job is not None:
            job.cancel()
            self._told(role, "cancel", {"job": job.title})

    def use_axis(self, role: Role, path: Any) -> None:
        """Work on another axis file of this bench. Raises ForbiddenError, DocumentError."""
        self._require(role, "tune")
        bench = Bench(self.directory, self._axis, self._facts, self._given)
        self._axis = known_axis(bench, path, list(shelf.axis_files(self.directory, self._first)))
        self._told(role, "use_axis", {"path": path})

    def take(self, role: Role, name: str, content: bytes) -> None:
        """A file that a page sends: a recording, or the facts of its drive. Raises ForbiddenError, DocumentError."""
        self._require(role, "move")
        path = Path(name)
        if path.name != name or name.startswith("."):
            raise DocumentError(f"{name}: a plain file name is needed")
        if path.suffix in (".yaml", ".yml"):
            target = self.directory / name
        elif shelf.is_recording(path):
            target = self.directory / shelf.RUNS / name
        else:
            kinds = ", ".join(shelf.RECORDINGS)
            raise DocumentError(f"{name}: recordings ({kinds}) and the facts of their drive (.yaml) can be added")
        if target.exists():
            raise DocumentError(f"{name}: already exists")
        target.write_bytes(content)
        if path.suffix in (".yaml", ".yml"):
            self._facts = target
        self._told(role, "take", {"file": name, "bytes": len(content)})

    def _require(self, role: Role, needed: Role) -> None:
        if not may(role, needed):
            raise ForbiddenError(REFUSED.format(needed=needed, role=role))

    def _ended(self, job: Job) -> None:
        self._told("look", "ended", {"job": job.title, "state": job.state, "exit_code": job.exit_code})

    def _told(self, role: str, what: str, more: Mapping[str, Any]) -> None:
        """Who did what, and when: a line of DIR/workbench.log."""
        entry = {"time": time.strftime("%Y-%m-%dT%H:%M:%S%z"), "role": role, "action": what, **more}
        with self._audit, (self.directory / AUDIT_NAME).open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry, ensure_ascii=False) + "\n")
