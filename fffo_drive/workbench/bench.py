"""One workbench: what it shows, what it does when it is asked, and who asked."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..config.axis import model_of, read_axis
from ..config.commissioning import permission
from ..config.drive_section import CanopenDriveSection
from ..config.effects import services
from ..daemon.parameters import METHODS
from ..daemon.serving import serving
from ..directories import as_typed
from ..documents import DocumentError
from ..live.keys import Asker, Keys
from ..roles import Role, may
from . import shelf
from .actions import ACTIONS, Bench, known_axis
from .fleet_tab import fleet_state, store_of
from .jobs import Job, Jobs
from .served_axis import CALLS, ServedAxis, scope_address
from .simulated_axis import simulated_on

AUDIT_NAME = "workbench.log"
REFUSED = "your key does not allow it: {needed} is needed, this page has {role}"


class ForbiddenError(Exception):
    """The key of who asks does not allow it."""


class Workbench:
    """State and actions of one workbench; called from the server's threads."""

    def __init__(
        self, directory: Path, axis: Path | None, facts: Path | None, given: tuple[Path, ...],
        sockets: Path | None = None, fleet: str | None = None,
    ) -> None:  # fmt: skip
        """`sockets`: directory of the daemon's sockets; None: looked for by the name of the axis.

        `fleet`: store of records; None: the one of the axis' daemon, where its file names one.
        """
        self.directory, self._sockets, self._fleet = directory, sockets, fleet
        self.served = ServedAxis()
        # started here, beside the jobs; ended in this order: the daemon stops the axis first
        self.services = {name: Jobs() for name, action in ACTIONS.items() if action.beside}
        self._first = axis
        self._axis = axis
        self._facts, self._given = facts, given
        self.jobs = Jobs()
        self.keys = Keys()
        self._audit = threading.Lock()
        self._named: tuple[tuple[Path, int] | None, str] = (None, "")
        (directory / shelf.RUNS).mkdir(parents=True, exist_ok=True)

    def state(self, asker: Asker) -> dict[str, Any]:
        """Everything that a page shows."""
        role, daemon = asker.role, self.daemon()
        return {
            "role": role,
            "name": asker.name,
            "daemon": None
            if daemon is None
            else {
                "state": daemon[1],
                "sockets": as_typed(str(daemon[0])),
                "scope": scope_address(daemon[0], asker),
            },
            "services": {name: job.as_object() for name, jobs in self.services.items() for job in jobs.all()[:1]},
            "asks": self.served.methods_of(role),
            "may_try": may(role, "tune"),
            "may_serve": may(role, "move"),
            "trials": [trial.as_object(curves=False) for trial in self.served.trials],
            "may": [name for name, action in ACTIONS.items() if may(role, action.role)],
            "moves": [name for name, action in ACTIONS.items() if action.moves and not action.asks],
            "may_cancel": may(role, "stop"),
            "directory": as_typed(str(self.directory)),
            "axis": self._axis_facts(),
            "axis_files": [str(path) for path in shelf.axis_files(self.directory, self._first)],
            "facts": None if self._facts is None else str(self._facts),
            "runs": shelf.recordings(self.directory, self._given),
            "pages": shelf.pages(self.directory),
            "jobs": [job.as_object() for job in self.jobs.all()],
        }

    def fleet(self) -> dict[str, Any]:
        """What the Fleet tab shows: the store's address, and with `error` why it cannot be read."""
        store = store_of(self._axis, self._fleet)
        if store is None:
            return {"store": None}
        shown = {"store": as_typed(store)}
        try:
            return shown | fleet_state(store, self._axis)
        except (DocumentError, OSError) as error:
            return shown | {"error": str(error)}

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
                "simulated": simulated_on(axis) is not None,
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

    def daemon(self) -> tuple[Path, str] | None:
        """(directory of its sockets, state) of the daemon that has the axis; None where none answers."""
        name = self._axis_name()
        return None if name is None else serving(name, self._sockets)

    def _axis_name(self) -> str | None:
        """Of the axis file in use; read again when the file changes."""
        if self._axis is None:
            return None
        try:
            stamp = (self._axis, self._axis.stat().st_mtime_ns)
            if stamp != self._named[0]:
                self._named = (stamp, read_axis(self._axis).name)
        except (DocumentError, OSError):
            return None  # the page shows what is wrong with it
        return self._named[1]

    def sockets(self) -> Path:
        """Where the daemon of this axis listens. Raises DocumentError without one."""
        found = self.daemon()
        if found is None:
            raise DocumentError("no daemon has this axis: start one")
        return found[0]

    def ask(self, asker: Asker, method: str, wish: Mapping[str, Any]) -> Any:
        """A method of the daemon that has the axis. Raises ForbiddenError, DocumentError."""
        if method not in CALLS:
            raise DocumentError(f"no method of the axis is called {method!r}; known: {', '.join(CALLS)}")
        self._require(asker, METHODS[method].role)
        result = self.served.call(self.sockets(), asker, method, wish)
        if not (wish.get("renews") and wish.get("to_rps")):  # what renews a jog is no news, its end is
            wanted = {name: value for name, value in wish.items() if name not in ("page", "epoch")}
            self._log_action(asker, method, {"axis": wanted})
        return result

    def try_gain(self, asker: Asker, wish: Mapping[str, Any]) -> dict[str, Any]:
        """A step, a new gain, the same step. Raises ForbiddenError, DocumentError."""
        self._require(asker, "tune")
        trial = self.served.try_gain(self.sockets(), asker, wish)
        self._log_action(asker, "try_gain", {"key": trial["key"], "value": trial["value"], "by_rps": trial["by_rps"]})
        return trial

    def act(self, asker: Asker, name: str, wish: Mapping[str, Any]) -> dict[str, Any]:
        """Start one of ACTIONS. Raises ForbiddenError, DocumentError, jobs.BusyError."""
        action = ACTIONS[name]
        self._require(asker, action.role)
        daemon = self.daemon()
        if daemon is not None and action.moves and not action.by_daemon:
            raise DocumentError(f"{name} opens the bus itself, and the daemon has the drive: stop the daemon first")
        if daemon is not None and name == "serve":
            raise DocumentError(f"a daemon has this axis already ({daemon[0]})")
        served = None if daemon is None else daemon[0]
        fleet = store_of(self._axis, self._fleet)
        bench = Bench(self.directory, self._axis, self._facts, self._given, served, asker.text, fleet)
        order = action.make(bench, wish)
        jobs = self.services.get(name, self.jobs)
        job = jobs.start(name, order.title, order.words, order.out, self._ended, action.computes)
        self._log_action(asker, name, {"line": job.as_object()["line"]})
        return job.as_object()

    def answer(self, asker: Asker, wish: Mapping[str, Any]) -> None:
        """Answer what the job that runs has asked before a motion. Raises ForbiddenError, DocumentError."""
        job = self.jobs.running
        if job is None:
            raise DocumentError("this question is not open any more: nothing was answered")
        self._require(asker, ACTIONS[job.action].role)
        question = job.answer(wish.get("question"), wish.get("answer"))
        self._log_action(asker, "answer", {"job": job.title, "checks": question["checks"], "answer": wish["answer"]})

    def cancel(self, asker: Asker, service: Any = None) -> None:
        """Interrupt the job that runs, or a service of this name. Raises ForbiddenError."""
        self._require(asker, "stop")
        job = (self.services[service] if service in list(self.services) else self.jobs).running
        if job is not None:
            job.cancel()
            self._log_action(asker, "cancel", {"job": job.title})

    def close(self) -> None:
        """Cancel what runs, and wait for it."""
        self.jobs.close()
        for service in self.services.values():
            service.close()

    def use_axis(self, asker: Asker, path: Any) -> None:
        """Work on another axis file of this bench. Raises ForbiddenError, DocumentError."""
        self._require(asker, "tune")
        self._axis = known_axis(path, list(shelf.axis_files(self.directory, self._first)))
        self._log_action(asker, "use_axis", {"path": path})

    def take(self, asker: Asker, name: str, content: bytes) -> None:
        """A file that a page sends: a recording, or the facts of its drive. Raises ForbiddenError, DocumentError."""
        self._require(asker, "move")
        path = Path(name)
        if path.name != name or name.startswith(".") or "\0" in name:
            raise DocumentError(f"{name}: a plain file name is needed")
        if path.suffix in (".yaml", ".yml"):
            target = self.directory / name
        elif shelf.is_recording(path):
            target = self.directory / shelf.RUNS / name
        else:
            kinds = ", ".join(shelf.RECORDINGS)
            raise DocumentError(f"{name}: recordings ({kinds}) and the facts of their drive (.yaml) can be added")
        try:
            with target.open("xb") as file:
                file.write(content)
        except FileExistsError:
            raise DocumentError(f"{name}: already exists") from None
        except OSError:
            target.unlink(missing_ok=True)  # a part of it, on a full disk
            raise
        if path.suffix in (".yaml", ".yml"):
            self._facts = target
        self._log_action(asker, "take", {"file": name, "bytes": len(content)})

    def _require(self, asker: Asker, needed: Role) -> None:
        if not may(asker.role, needed):
            raise ForbiddenError(REFUSED.format(needed=needed, role=asker.role))

    def _ended(self, job: Job) -> None:
        self._log_action(None, "ended", {"job": job.title, "state": job.state, "exit_code": job.exit_code})

    def _log_action(self, asker: Asker | None, what: str, more: Mapping[str, Any]) -> None:
        """Who did what, and when: a line of DIR/workbench.log."""
        who = {} if asker is None else {"role": asker.role} | ({"name": asker.name} if asker.name else {})
        entry = {"time": time.strftime("%Y-%m-%dT%H:%M:%S%z"), **who, "action": what, **more}
        with self._audit, (self.directory / AUDIT_NAME).open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry, ensure_ascii=False) + "\n")
