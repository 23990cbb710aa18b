"""The methods of the API: one table that the server dispatches on, and from which schema and `ctl` are generated.

Newline-delimited JSON-RPC 2.0 on `control.sock` (0660, `daemon.control_group`) and, for the methods that only read, on
`watch.sock`. Parameters are objects with names (`parameters.py`). Answers of the methods:

info        protocol, version, axis, file, rate_hz, drive (identity), realtime, profiles, keys (of `set`), states
status      state, state_s, epoch, last_stop {who, at, kind, text, epoch}, held_by, obstacles, fault {name, text, tick},
            toggle, model {name, hash}, effects {monitor, list of {name, in_service, reason}}, profile {name, sample,
            samples, duration_s}, set_point {kind, number, to_rps, hold_s, run_on, lapsed, blocked, latency_s},
            recording {on, wanted, file, finished, rows_*, write_errors, trouble}, disk (which does not answer to
            what), last_event, loop {connection, running, tick, rows, late, skipped, missing_feedback, stale_blocks,
            trip, exchange}, drive {name, statusword, state, emergency_code, nmt_state}, motion {velocity_rps,
            position_rev, current_a, current_command_a, reference_rps, error_rps, friction_nm, mode, age}; null where
            there is none
enable, start, reset_fault
            {"state": ..., "reached": true, "epoch": ...}; error -32004 if the state is not reached within wait_s
stop, disable, quick_stop
            {"state": ..., "reached": ..., "epoch": ..., "velocity_rps": measured, "at_rest": ...}: what is seen when it
            is answered; both null while nothing is measured. Accepted in every state. With wait_s the answer comes once
            the axis is at rest by measurement (offline and in fault, where nothing may be measured, without it), or as
            error -32004. With wait_s 0 it comes at once, and `reached` is true only for an axis at rest. A stop
            latches, see below
jog, velocity, step
            {"state": ..., "set_point": number, "to_rps": ..., "latency_s": ..., "renew_within_s": ... or null,
            "epoch": ...}: the reference begins to change latency_s later (feed-forward's preview), within the bounds of
            daemon.set_points. A set point lives on a lease: it goes on if the request is repeated within renew_within_s
            in the same epoch with `renews`, its number. If not, the axis is braked to standstill, which counts as a
            stop by its client. With `for_s` it ends by itself, with `run_on` it needs no client. A motion that would
            leave envelope.position_window_rev ends at standstill
toggle, model, set, reload
            the values now in use
record      {"on": ..., "file": ..., "files": [...]}
events      {"events": [{number, time, kind, level, text, data}, ...], "last": number}
subscribe   {"status_hz": ..., "events": ...}; then notifications `status` (as above) and `event` on this connection
schema      JSON schemas of all parameters

A stop latches. Whatever ends or withdraws motion begins an epoch: stop, disable, quick_stop, a lapsed lease, a lost or
silent client in charge, a fault and its reset, and a change of the client in charge. From the first one on, start, jog,
velocity and step have to name the present epoch. Without it, or with an earlier one, they are refused with the reason:
error -32000, data.epoch and data.stop (last_stop of the status). So no stream of requests moves the axis after a stop,
on new connections neither. Read the epoch when a person acts, and keep to it: a client that reads it anew by itself
takes away what it is for. An enable without epoch is bound to the one in which it arrived. Once a stop is acknowledged,
what was sent before is refused. Epochs do not repeat when the daemon is started again.

The client in charge (enable with hold) has to be heard: one that sends nothing for daemon.client_silence_s is treated
as one that has closed its connection. An empty line is enough.

Error codes: -32000 not possible in this state (data: state, allowed, epoch, stop), -32001 this socket is read-only,
-32002 error of the drive, -32003 a profile, model, key or file that cannot be used, -32004 not reached in time, -32005
a limit.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from .. import __version__
from ..config.axis import TOGGLES
from ..config.commissioning import Permission
from ..model.parameters import model_of_text
from ..recording.events import Level
from ..workflows.plan import YAML_TYPE, Plan, toggle_name
from . import parameters as p
from . import set_points, settings
from .profiles import chosen_profile
from .record_keeper import Sources
from .rpc import BAD_DOCUMENT, NOT_REACHED, REFUSED, RpcError
from .states import AT_REST, UNMEASURED, WANTING_TORQUE, Change, RefusedError, State, StateEvent, require_change
from .status import info_of, status_of
from .supervisor import NEVER_S, Supervisor
from .worker import Worker


class Caller(Protocol):
    """The client that makes a request: one connection."""

    @property
    def name(self) -> str:
        """For the log: pid and user."""
        ...

    @property
    def credentials(self) -> dict[str, int]:
        """client_pid, client_uid, client_gid."""
        ...

    @property
    def heard_s(self) -> float:
        """When it sent anything last, monotonic."""
        ...

    def subscribe(self, status_hz: float, events: bool) -> None:
        """What to send to it from now on."""
        ...


class _ReadAgain(NamedTuple):
    """What a reload has read, and for which plan, toggle and state it is made."""

    plan: Plan
    toggle: int
    at_rest: bool
    fresh: settings.Reload
    sources: Sources
    given: Permission | str

    def stands(self, supervisor: Supervisor) -> bool:
        """Whether it may be taken: what it was made for has not changed."""
        same = self.plan is supervisor.plan and self.toggle == supervisor.toggle
        return same and not (self.at_rest and supervisor.state not in AT_REST)


class Api:
    """The methods of `parameters.METHODS`, each by its name, on one supervisor.

    `holder` is the connection in charge of the axis, if there is one.
    """

    def __init__(self, supervisor: Supervisor) -> None:
        self.supervisor = supervisor
        self.holder: Caller | None = None
        self._hold_answered_s = NEVER_S  # it has to be heard from then on
        self._looked_s = 0.0
        self._latest: dict[str, Any] = {}
        self.work = Worker("fffo-work")
        supervisor.changed = self.publish
        # plans are checked on another thread: one change at a time. Nobody waits for a disk with it
        self._changing = asyncio.Lock()

    # what only looks

    def info(self, wanted: p.Info, caller: Caller) -> Any:
        """Protocol version, axis, drive, profiles, keys, states."""
        return info_of(self.supervisor, __version__, wanted.protocol)

    def status(self, _: p.Nothing, caller: Caller) -> Any:
        """The present status, or that of the last cycle."""
        return self.latest

    @property
    def latest(self) -> dict[str, Any]:
        """The newest status, for any thread, with the present epoch."""
        machine = self.supervisor.machine
        stop = machine.last_stop
        return {**self._latest, "epoch": machine.epoch.value, "last_stop": None if stop is None else stop._asdict()}

    def publish(self) -> None:
        """Store the present status, with the client in charge."""
        holder = None if self.holder is None else self.holder.name
        self._latest = {**status_of(self.supervisor, time.monotonic()), "held_by": holder}

    def events(self, wanted: p.Events, caller: Caller) -> Any:
        """The last events."""
        log = self.supervisor.log
        return {"events": log.since(wanted.since, wanted.limit), "last": log.last_number}

    def subscribe(self, wanted: p.Subscribe, caller: Caller) -> Any:
        """Statuses at a rate, and events, on this connection."""
        caller.subscribe(wanted.status_hz, wanted.events)
        return wanted.model_dump()

    def schema(self, _: p.Nothing, caller: Caller) -> Any:
        """JSON schemas of all parameters."""
        return {
            name: {
                "summary": m.summary,
                "watching": m.watching,
                "role": m.role,
                "parameters": m.parameters.model_json_schema(),
            }
            for name, m in p.METHODS.items()
        }

    # motion

    async def enable(self, wanted: p.Enable, caller: Caller) -> Any:
        """Torque."""
        supervisor = self.supervisor
        if supervisor.plan.axis.daemon.in_charge == "connection" and not wanted.hold:
            text = "daemon.in_charge is connection: enable with hold, and stay connected (ctl enable --hold)"
            raise RpcError(REFUSED, text, {"state": supervisor.state.value, "allowed": []})
        if supervisor.state is State.CONNECTED and supervisor.obstacles:
            reasons = "; ".join(supervisor.obstacles)
            raise RefusedError(f"the axis may not be enabled: {reasons}", supervisor.state, (State.READY,))
        supervisor.apply(StateEvent.ENABLE, wanted.epoch)
        if wanted.hold and self.holder is not caller:
            self.holder, self._hold_answered_s = caller, NEVER_S
            supervisor.apply(StateEvent.CHARGE, who=asker(caller.name, wanted.who))
        self._command(caller, wanted, "enable")
        try:
            return await self._reached(
                lambda: supervisor.has_torque,
                wanted.wait_s,
                "Operation Enabled",
                lambda: supervisor.state not in WANTING_TORQUE,
            )
        finally:
            if self.holder is caller:
                self._hold_answered_s = time.monotonic()

    async def disable(self, wanted: p.Ending, caller: Caller) -> Any:
        """Brake to standstill if a profile runs, then no torque."""
        return await self._end(StateEvent.DISABLE, wanted, caller, AT_REST)

    async def stop(self, wanted: p.Ending, caller: Caller) -> Any:
        """Brake to standstill; the axis stays enabled."""
        return await self._end(StateEvent.STOP, wanted, caller, AT_REST | {State.ENABLED})

    async def quick_stop(self, wanted: p.Ending, caller: Caller) -> Any:
        """The drive's own quick stop, then no torque."""
        return await self._end(StateEvent.QUICK_STOP, wanted, caller, AT_REST)

    async def reset_fault(self, wanted: p.Ending, caller: Caller) -> Any:
        """Leave a fault; torque needs another enable."""
        supervisor = self.supervisor
        supervisor.reset_fault(asker(caller.name, wanted.who))
        self._command(caller, wanted, "reset_fault")
        return await self._reached(lambda: supervisor.state is State.READY, wanted.wait_s, State.READY.value)

    async def start(self, wanted: p.Start, caller: Caller) -> Any:
        """Run a profile."""
        supervisor = self.supervisor
        epoch = supervisor.begin_start(wanted.epoch)
        try:
            profile = await self.work.run(chosen_profile, supervisor.plan, wanted.profile)
            supervisor.start(profile, epoch)
        except BaseException:
            supervisor.start_failed(epoch)
            raise
        self._command(caller, wanted, f"start {profile.name}")
        if wanted.wait_s == 0:
            return self._now(True)
        return await self._reached(lambda: supervisor.state is not State.RUNNING, wanted.wait_s, "the profile's end")

    async def jog(self, wanted: p.Jog, caller: Caller) -> Any:
        """A velocity for as long as it is renewed."""
        self.supervisor.require_renewable(set_points.JOG, wanted.renews, wanted.epoch)
        return await self._follow(set_points.jog(self.supervisor.plan, wanted.to_rps), wanted, caller, 0.0)

    async def velocity(self, wanted: p.SetVelocity, caller: Caller) -> Any:
        """A velocity: on a lease, for a time, or until the next set point."""
        self.supervisor.require_renewable(set_points.VELOCITY, wanted.renews, wanted.epoch)
        asked = set_points.velocity(self.supervisor.plan, wanted.to_rps, wanted.for_s, wanted.run_on)
        return await self._follow(asked, wanted, caller, wanted.wait_s)

    async def step(self, wanted: p.Step, caller: Caller) -> Any:
        """A change of the present set point, on a lease, for a time, or until the next one."""
        self.supervisor.require_renewable(set_points.STEP, wanted.renews, wanted.epoch)
        motion = self.supervisor.motion
        before, from_rps = (None, 0.0) if motion is None else (motion.asked, motion.target_rps)
        by_rps = wanted.by_rps if wanted.renews is None else 0.0
        asked = set_points.step(self.supervisor.plan, before, from_rps, by_rps, wanted.for_s, wanted.run_on)
        return await self._follow(asked, wanted, caller, wanted.wait_s)

    async def _follow(
        self, asked: set_points.AskedSetPoint, wanted: p.Motion, caller: Caller, wait_s: float
    ) -> dict[str, Any]:
        supervisor = self.supervisor
        before = None if supervisor.motion is None else supervisor.motion.asked
        motion = supervisor.follow(asked, wanted.epoch, asker(caller.name, wanted.who))
        number = motion.set_point_number
        to_rps, hold_ticks = asked.set_point.target_rps, asked.set_point.hold_ticks
        if asked != before:  # renewals are not reported
            self._command(caller, wanted, f"{asked.kind} {to_rps:g} rps")
        if wait_s > 0:
            await self._reached(
                lambda: motion.there(number, to_rps), wait_s, f"{to_rps:g} rps",
                lambda: supervisor.motion is not motion or motion.set_point_number != number or motion.lapsed,
            )  # fmt: skip
        renew_s = hold_ticks * supervisor.plan.axis.loop.period_s if asked.leased else None
        return {
            "state": supervisor.state.value, "set_point": number, "to_rps": to_rps,
            "latency_s": set_points.latency_s(supervisor.plan), "renew_within_s": renew_s,
            "epoch": wanted.epoch or supervisor.machine.epoch.first,
        }  # fmt: skip

    # parameters

    async def toggle(self, wanted: p.Toggle, caller: Caller) -> Any:
        """Friction from reference, feedback, or not; bumpless, at a tick boundary."""
        supervisor = self.supervisor
        async with self._changing:
            toggle = TOGGLES[wanted.to]
            await self.work.run(settings.require_toggle, supervisor.plan, toggle)
            require_change(supervisor.state, Change.TOGGLE)
            supervisor.set_toggle(toggle)
        self._parameters(caller, wanted, f"friction {wanted.to}")
        return {"toggle": toggle_name(supervisor.toggle)}

    async def set(self, wanted: p.Set, caller: Caller) -> Any:
        """One gain or switch, until the next reload."""
        supervisor = self.supervisor
        async with self._changing:
            change = settings.change_of(supervisor.plan.axis, wanted.key)
            require_change(supervisor.state, change)
            args = (supervisor.plan, supervisor.toggle, wanted.key, wanted.value)
            plan = await self.work.run(settings.with_value, *args)
            require_change(supervisor.state, change)
            supervisor.set_plan(plan)
        self._parameters(caller, wanted, f"{wanted.key} = {wanted.value:g}")
        return {"key": wanted.key, "value": settings.value_of(plan.axis, wanted.key)}

    async def model(self, wanted: p.Model, caller: Caller) -> Any:
        """Another model, while the axis has no torque."""
        supervisor = self.supervisor
        async with self._changing:
            require_change(supervisor.state, Change.MODEL)
            plan = await self.work.run(self._with_model, wanted)
            require_change(supervisor.state, Change.MODEL)
            supervisor.set_plan(plan)
            supervisor.sources.model = (wanted.name, YAML_TYPE, wanted.text.encode())
        self._parameters(caller, wanted, f"model {plan.model.name}")
        return {"name": plan.model.name, "hash": supervisor.model_hash}

    def _with_model(self, wanted: p.Model) -> Plan:
        """What was commissioned stands for it too: of a model that is the torque constant alone."""
        plan, toggle = self.supervisor.plan, self.supervisor.toggle
        model = model_of_text(wanted.text, wanted.name)
        old = plan.model
        if model.torque_constant_nm_per_a != old.torque_constant_nm_per_a:
            text = (
                f"{wanted.name}: torque_constant_nm_per_a is {model.torque_constant_nm_per_a:g}, the drive is scaled "
                f"with {old.torque_constant_nm_per_a:g}: name this model in the axis file and restart the daemon"
            )
            raise RpcError(BAD_DOCUMENT, text)
        return settings.with_model(plan, toggle, model)

    async def reload(self, wanted: p.Commanded, caller: Caller) -> Any:
        """Read the axis file again; what needs a restart is named."""
        return await self.reload_file(asker(caller.name, wanted.who), caller.credentials)

    async def reload_file(self, who: str, credentials: dict[str, int]) -> dict[str, Any]:
        """As `reload`, also for SIGHUP."""
        supervisor = self.supervisor
        read = await self._read_again()
        async with self._changing:
            while not read.stands(supervisor):  # changed or enabled meanwhile, while the disk did answer
                read = await self._read_again()
            fresh, before = read.fresh, supervisor.plan
            supervisor.set_plan(fresh.plan)
            if before.toggle != fresh.plan.toggle:
                supervisor.set_toggle(fresh.plan.toggle)
            supervisor.sources = read.sources
            supervisor.permit(read.given)
        applied, restart = list(fresh.applied), list(fresh.restart)
        text = f"reloaded by {who}: {', '.join(applied) or 'nothing to apply'}"
        text += f"; needs a restart: {', '.join(restart)}" if restart else ""
        level = Level.WARNING if restart else Level.INFO
        supervisor.log.add("reload", text, level, {"applied": applied, "restart": restart, **credentials})
        return {"applied": applied, "restart": restart}

    async def _read_again(self) -> _ReadAgain:
        """Everything that a reload reads: the disk may be slow, and what cannot be read changes nothing."""
        supervisor = self.supervisor
        plan, toggle, at_rest = supervisor.plan, supervisor.toggle, supervisor.state in AT_REST

        def read() -> _ReadAgain:
            fresh = settings.reload(plan, toggle, at_rest)
            given = supervisor.read_permission(fresh.plan)
            return _ReadAgain(plan, toggle, at_rest, fresh, Sources(fresh.plan), given)

        return await supervisor.files.run(read, doing="reading", at=plan.path)

    async def record(self, wanted: p.RecordSwitch, caller: Caller) -> Any:
        """Begin or end a recording."""
        supervisor = self.supervisor
        self._command(caller, wanted, f"record {wanted.to}")
        if wanted.to == "off":
            supervisor.recorder.wanted = False
            return {"on": False, "file": None, "files": await supervisor.recorder.end()}
        path = await supervisor.start_recording()
        return {"on": True, "file": path or supervisor.recorder.status()["file"], "files": []}

    # what they share

    async def _end(self, event: StateEvent, wanted: p.Ending, caller: Caller, there: frozenset[State]) -> Any:
        """In every state: where nothing moves it succeeds and says what is. With waiting, the axis is at rest then."""
        supervisor = self.supervisor
        supervisor.apply(event, who=asker(caller.name, wanted.who))
        self._command(caller, wanted, event.value)
        if event is not StateEvent.STOP:
            self.holder = None

        def seen() -> dict[str, Any]:
            shaft = supervisor.shaft
            # connected, a drive that is silent for a moment is measured again or lost soon: nobody is told before that
            stands = supervisor.state in UNMEASURED if shaft is None else shaft.at_rest
            measured = {"velocity_rps": None, "at_rest": None} if shaft is None else shaft._asdict()
            return {**self._now(supervisor.state in there and stands), **measured}

        if wanted.wait_s == 0 or await supervisor.reached(lambda: seen()["reached"], wanted.wait_s):
            return seen()
        raise await self._not_reached("standstill")

    async def _reached(
        self, condition: Callable[[], bool], wait_s: float, what: str, hopeless: Callable[[], bool] | None = None
    ) -> dict[str, Any]:
        """Wait until it is so, or until a fault (or `hopeless`) ends the waiting."""
        supervisor = self.supervisor
        no_more = hopeless or (lambda: supervisor.state is State.FAULT)
        if wait_s == 0:
            return self._now(condition())
        came = await supervisor.reached(lambda: condition() or no_more(), wait_s)
        if came and condition():
            return self._now(True)
        raise await self._not_reached(what, hopeless is not None)

    async def _not_reached(self, what: str, enabling: bool = False) -> RpcError:
        supervisor = self.supervisor
        await supervisor.heard_out()
        said = supervisor.not_enabled if enabling else ""
        said = supervisor.fault.text if supervisor.fault is not None else said
        reason = f": {said}" if said else ""
        if not reason and supervisor.state in (State.OFFLINE, State.CONNECTED) and supervisor.obstacles:
            reason = f": {supervisor.obstacles[0]}"
        shaft = supervisor.shaft
        seen = "" if shaft is None else f" at {shaft.velocity_rps:.3g} rps (measured)"
        return RpcError(
            NOT_REACHED, f"{what} was not reached, the axis is in state {supervisor.state.value}{seen}{reason}",
            {"state": supervisor.state.value, "velocity_rps": None if shaft is None else shaft.velocity_rps},
        )  # fmt: skip

    def _now(self, reached: bool) -> dict[str, Any]:
        supervisor = self.supervisor
        return {"state": supervisor.state.value, "reached": reached, "epoch": supervisor.machine.epoch.value}

    def _command(self, caller: Caller, wanted: p.Commanded, text: str) -> None:
        self._log_request("command", caller, wanted, text)

    def _parameters(self, caller: Caller, wanted: p.Commanded, text: str) -> None:
        self._log_request("parameters", caller, wanted, text)

    def _log_request(self, kind: str, caller: Caller, wanted: p.Commanded, text: str) -> None:
        """Who did what, and on whose behalf."""
        data = {**caller.credentials, "who": wanted.who} if wanted.who else caller.credentials
        self.supervisor.log.add(kind, f"{text} by {asker(caller.name, wanted.who)}", data=data)

    def look_for_holder(self, now_s: float) -> None:
        """The client in charge has to be heard: one that is silent for too long is lost. Call periodically."""
        silence_s = self.supervisor.plan.axis.daemon.client_silence_s
        if now_s - self._looked_s > 0.5 * silence_s:  # we were silent ourselves: what it sent is still to be read
            self._hold_answered_s = max(self._hold_answered_s, now_s)
        self._looked_s = now_s
        if self.holder is not None and now_s - max(self.holder.heard_s, self._hold_answered_s) > silence_s:
            self._lose(self.holder, f"the axis is held by {self.holder.name}, which does not answer")

    def client_left(self, caller: Caller) -> None:
        """A connection closed. When the axis hung on it, do as daemon.client_loss says."""
        if caller is self.holder:
            self._lose(caller, f"{caller.name}, who held the axis, is gone")

    def _lose(self, caller: Caller, why: str) -> None:
        self.holder = None
        supervisor = self.supervisor
        reaction = supervisor.plan.axis.daemon.client_loss
        if supervisor.state in AT_REST or reaction == "go_on":
            return
        supervisor.log.add("client", f"{why}: {reaction.replace('_', ' ')}", Level.WARNING, caller.credentials)
        who = f"daemon.client_loss ({why})"
        supervisor.apply(StateEvent.QUICK_STOP if reaction == "quick_stop" else StateEvent.DISABLE, who=who)


def asker(caller: str, who: str | None) -> str:
    """The connection, and on whose behalf it asked."""
    return f"{who} through {caller}" if who else caller
