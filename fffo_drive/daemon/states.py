"""The daemon's state machine as one table: the code executes it, `tools/daemon_states` prints it, a test explores it.

Each row gives the next state and the actions for one event in one state. A request without a row is refused; an
observation without a row is ignored. Only ENABLE requests torque, and every row that leads out of a fault needs a
reset: there is no way from a fault to torque without a reset and another enable.

A request for torque or motion is valid only in the epoch in which it was made. Every stop, disable, quick stop, lapsed
lease, fault and reset begins a new epoch, and so does a change of the client in charge: earlier requests are refused,
however late they are processed.

A stop latches. A request for motion that names no epoch belongs to the first one of the daemon: from the first stop on,
motion needs a request that names the epoch which the last stop began. A stream of requests that was there before a stop
moves nothing after it, whatever else is asked for by whomever.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from enum import StrEnum
from typing import NamedTuple

EPOCHS_PER_S = 1000  # the first epoch of a daemon is its start, in these of the wall clock: none of an earlier daemon


class State(StrEnum):
    """State of the axis."""

    OFFLINE = "offline"
    CONNECTED = "connected"
    READY = "ready"
    ENABLED = "enabled"
    PREPARING = "preparing"
    RUNNING = "running"
    FOLLOWING = "following"
    STOPPING = "stopping"
    FAULT = "fault"


MEANINGS = {
    State.OFFLINE: "no drive: the bus is down or no node answers; the daemon keeps trying",
    State.CONNECTED: "the drive is brought up and the loop runs without torque; an obstacle prevents enabling",
    State.READY: "the drive can be enabled",
    State.ENABLED: "torque is requested, the axis is held at standstill",
    State.PREPARING: "as enabled, while the profile of a start is computed and checked",
    State.RUNNING: "a profile runs, or the axis is being braked to standstill",
    State.FOLLOWING: "live set points are followed (jog, velocity, step), or the axis is being braked to standstill",
    State.STOPPING: "torque is being removed",
    State.FAULT: "latched; no torque until a reset",
}


class StateEvent(StrEnum):
    """Requests by clients, and observations."""

    # requested
    ENABLE = "enable"
    DISABLE = "disable"
    START = "start"
    PREPARED = "prepared"
    NOT_PREPARED = "not_prepared"
    SET_POINT = "set_point"
    STOP = "stop"
    QUICK_STOP = "quick_stop"
    RESET = "reset"
    RESET_AWAY = "reset_away"
    # observed
    LAPSED = "lapsed"
    CHARGE = "charge"
    FOUND = "found"
    PERMITTED = "permitted"
    FORBIDDEN = "forbidden"
    PROFILE_ENDED = "profile_ended"
    TORQUE_OFF = "torque_off"
    ENABLE_TIMEOUT = "enable_timeout"
    STOP_TIMEOUT = "stop_timeout"
    STOP_FAILED = "stop_failed"
    DRIVE_LOST = "drive_lost"
    TRIPPED = "tripped"
    LOOP_ENDED = "loop_ended"


class Happening(NamedTuple):
    """An event in words. A request without a row is refused, an observation without a row is ignored."""

    asked: bool  # a request, as opposed to an observation
    text: str
    raises: str = ""  # begins a new epoch: in these words earlier requests are refused from here on
    bound: bool = False  # valid only in the epoch in which it was made
    named: bool = False  # ... which has to be named: without, it belongs to the first epoch of the daemon


EVENTS = {
    StateEvent.ENABLE: Happening(True, "request for torque", bound=True),
    StateEvent.DISABLE: Happening(True, "request to brake, then remove torque", raises="stopped by {who}"),
    StateEvent.START: Happening(True, "request to run a profile", bound=True, named=True),
    StateEvent.PREPARED: Happening(True, "the profile of that start is computed and within the limits", bound=True),
    StateEvent.NOT_PREPARED: Happening(True, "the profile of that start cannot be used", bound=True),
    StateEvent.SET_POINT: Happening(True, "request with a live set point", bound=True, named=True),
    StateEvent.STOP: Happening(True, "request to brake to standstill", raises="stopped by {who}"),
    StateEvent.QUICK_STOP: Happening(True, "request for the drive's quick stop", raises="stopped by {who}"),
    StateEvent.RESET: Happening(True, "request to reset a fault; the drive answers", raises="fault reset by {who}"),
    StateEvent.RESET_AWAY: Happening(
        True, "request to reset a fault; the drive or the loop is gone", raises="fault reset by {who}"
    ),
    StateEvent.LAPSED: Happening(
        False, "a set point was not renewed within its lease: the loop brakes", raises="stopped by {who}"
    ),
    StateEvent.CHARGE: Happening(False, "another connection comes to be in charge", raises="taken over by {who}"),
    StateEvent.FOUND: Happening(False, "the drive is brought up, the loop runs"),
    StateEvent.PERMITTED: Happening(False, "feedback is fresh, no fault, commissioning record valid"),
    StateEvent.FORBIDDEN: Happening(False, "one of these conditions no longer holds"),
    StateEvent.PROFILE_ENDED: Happening(False, "the profile, the motion by set points or the braking has ended"),
    StateEvent.TORQUE_OFF: Happening(False, "the drive reports that its power stage is off"),
    StateEvent.ENABLE_TIMEOUT: Happening(
        False, "the drive does not reach Operation Enabled in time", raises="not enabled in time"
    ),
    StateEvent.STOP_TIMEOUT: Happening(
        False, "the controlled stop takes too long", raises="stopped by a quick stop: the controlled one took too long"
    ),
    StateEvent.STOP_FAILED: Happening(
        False, "the quick stop takes too long as well", raises="stopped by a fault: the quick stop took too long"
    ),
    StateEvent.DRIVE_LOST: Happening(
        False,
        "bus off, interface gone, heartbeat or answers missing, drive rebooted or no longer operational, its settings "
        "changed, or a frame that only we may send from somebody else",
        raises="stopped by {who}",
    ),
    StateEvent.TRIPPED: Happening(
        False, "any other trip of the envelope, including faults of the drive", raises="stopped by {who}"
    ),
    StateEvent.LOOP_ENDED: Happening(False, "the loop's thread has ended", raises="stopped by {who}"),
}


class Action(StrEnum):
    """What the supervisor does in a transition."""

    ENABLE = "request torque"
    DISABLE = "switch the power stage off"
    QUICK_STOP = "quick stop"
    START = "hand the profile to the loop"
    FOLLOW = "hand the set point to the loop"
    BRAKE = "brake the reference to standstill"
    FORGET = "request no torque, drop profile and set point"
    CLEAR = "clear the trip and the drive's fault"
    RELEASE = "end the loop, leave the drive, try again"


class StateTransition(NamedTuple):
    """Next state, and the actions in this order."""

    to: State
    actions: tuple[Action, ...] = ()


_S, _E, _A = State, StateEvent, Action

_FALLS: dict[StateEvent, StateTransition] = {
    event: StateTransition(_S.FAULT, (_A.FORGET,)) for event in (_E.DRIVE_LOST, _E.TRIPPED, _E.LOOP_ENDED)
}
_LOST_AT_REST = StateTransition(_S.OFFLINE, (_A.FORGET, _A.RELEASE))


def _stays(state: State) -> dict[tuple[State, StateEvent], StateTransition]:
    """Without motion to end, every stop succeeds and changes nothing."""
    return {(state, event): StateTransition(state) for event in (_E.STOP, _E.DISABLE, _E.QUICK_STOP)}


def _falls(state: State) -> dict[tuple[State, StateEvent], StateTransition]:
    return {(state, event): row for event, row in _FALLS.items()}


TABLE: dict[tuple[State, StateEvent], StateTransition] = {
    (_S.OFFLINE, _E.FOUND): StateTransition(_S.CONNECTED),
    **_stays(_S.OFFLINE),
    #
    (_S.CONNECTED, _E.PERMITTED): StateTransition(_S.READY),
    **_stays(_S.CONNECTED),
    **_falls(_S.CONNECTED),
    (_S.CONNECTED, _E.DRIVE_LOST): _LOST_AT_REST,
    #
    (_S.READY, _E.FORBIDDEN): StateTransition(_S.CONNECTED),
    (_S.READY, _E.ENABLE): StateTransition(_S.ENABLED, (_A.ENABLE,)),
    **_stays(_S.READY),
    **_falls(_S.READY),
    (_S.READY, _E.DRIVE_LOST): _LOST_AT_REST,
    #
    (_S.ENABLED, _E.ENABLE): StateTransition(_S.ENABLED),
    (_S.ENABLED, _E.START): StateTransition(_S.PREPARING),
    (_S.ENABLED, _E.SET_POINT): StateTransition(_S.FOLLOWING, (_A.FOLLOW,)),
    (_S.ENABLED, _E.CHARGE): StateTransition(_S.ENABLED),
    (_S.ENABLED, _E.STOP): StateTransition(_S.ENABLED),
    (_S.ENABLED, _E.DISABLE): StateTransition(_S.STOPPING, (_A.DISABLE,)),
    (_S.ENABLED, _E.QUICK_STOP): StateTransition(_S.STOPPING, (_A.QUICK_STOP,)),
    (_S.ENABLED, _E.ENABLE_TIMEOUT): StateTransition(_S.STOPPING, (_A.DISABLE,)),
    **_falls(_S.ENABLED),
    #
    (_S.PREPARING, _E.ENABLE): StateTransition(_S.PREPARING),
    (_S.PREPARING, _E.PREPARED): StateTransition(_S.RUNNING, (_A.START,)),
    (_S.PREPARING, _E.NOT_PREPARED): StateTransition(_S.ENABLED),
    (_S.PREPARING, _E.CHARGE): StateTransition(_S.ENABLED),
    (_S.PREPARING, _E.STOP): StateTransition(_S.ENABLED),
    (_S.PREPARING, _E.DISABLE): StateTransition(_S.STOPPING, (_A.DISABLE,)),
    (_S.PREPARING, _E.QUICK_STOP): StateTransition(_S.STOPPING, (_A.QUICK_STOP,)),
    (_S.PREPARING, _E.ENABLE_TIMEOUT): StateTransition(_S.STOPPING, (_A.DISABLE,)),
    **_falls(_S.PREPARING),
    #
    (_S.RUNNING, _E.PROFILE_ENDED): StateTransition(_S.ENABLED),
    (_S.RUNNING, _E.STOP): StateTransition(_S.RUNNING, (_A.BRAKE,)),
    (_S.RUNNING, _E.DISABLE): StateTransition(_S.STOPPING, (_A.BRAKE,)),
    (_S.RUNNING, _E.QUICK_STOP): StateTransition(_S.STOPPING, (_A.QUICK_STOP,)),
    (_S.RUNNING, _E.ENABLE_TIMEOUT): StateTransition(_S.STOPPING, (_A.DISABLE,)),
    **_falls(_S.RUNNING),
    #
    (_S.FOLLOWING, _E.SET_POINT): StateTransition(_S.FOLLOWING, (_A.FOLLOW,)),
    (_S.FOLLOWING, _E.LAPSED): StateTransition(_S.FOLLOWING),
    (_S.FOLLOWING, _E.PROFILE_ENDED): StateTransition(_S.ENABLED),
    (_S.FOLLOWING, _E.STOP): StateTransition(_S.FOLLOWING, (_A.BRAKE,)),
    (_S.FOLLOWING, _E.DISABLE): StateTransition(_S.STOPPING, (_A.BRAKE,)),
    (_S.FOLLOWING, _E.QUICK_STOP): StateTransition(_S.STOPPING, (_A.QUICK_STOP,)),
    (_S.FOLLOWING, _E.ENABLE_TIMEOUT): StateTransition(_S.STOPPING, (_A.DISABLE,)),
    **_falls(_S.FOLLOWING),
    #
    (_S.STOPPING, _E.PROFILE_ENDED): StateTransition(_S.STOPPING, (_A.DISABLE,)),
    (_S.STOPPING, _E.TORQUE_OFF): StateTransition(_S.READY, (_A.FORGET,)),
    (_S.STOPPING, _E.DISABLE): StateTransition(_S.STOPPING),
    (_S.STOPPING, _E.STOP): StateTransition(_S.STOPPING),
    (_S.STOPPING, _E.QUICK_STOP): StateTransition(_S.STOPPING, (_A.QUICK_STOP,)),
    (_S.STOPPING, _E.STOP_TIMEOUT): StateTransition(_S.STOPPING, (_A.QUICK_STOP,)),
    (_S.STOPPING, _E.STOP_FAILED): StateTransition(_S.FAULT, (_A.FORGET,)),
    **_falls(_S.STOPPING),
    #
    **_stays(_S.FAULT),
    (_S.FAULT, _E.RESET): StateTransition(_S.CONNECTED, (_A.CLEAR,)),
    (_S.FAULT, _E.RESET_AWAY): StateTransition(_S.OFFLINE, (_A.RELEASE,)),
}

TORQUE_STATES = frozenset({State.ENABLED, State.PREPARING, State.RUNNING, State.FOLLOWING, State.STOPPING})
WANTING_TORQUE = TORQUE_STATES - {State.STOPPING}
AT_REST = frozenset(State) - TORQUE_STATES
UNMEASURED = frozenset({State.OFFLINE, State.FAULT})  # a drive or loop that goes in another state ends in one of these


class Change(StrEnum):
    """What can be changed live, if the state allows it."""

    MODEL = "model"
    LAW = "feed-forward switches"
    CONFIG = "configuration (reload)"
    GAINS = "gains"
    TOGGLE = "toggle"
    RECORD = "recording"


CHANGES: dict[Change, frozenset[State]] = {
    Change.MODEL: AT_REST,
    Change.LAW: AT_REST,
    Change.CONFIG: frozenset(State),  # each key by itself: a model in it waits for a state that allows it
    Change.GAINS: frozenset(State),
    Change.TOGGLE: frozenset(State),
    Change.RECORD: frozenset(State),
}


class RefusedError(Exception):
    """The request is not possible in this state."""

    def __init__(self, text: str, state: State, allowed: tuple[State, ...]) -> None:
        super().__init__(text)
        self.state = state
        self.allowed = allowed


def states_with(event: StateEvent) -> tuple[State, ...]:
    """States in which an event has a row."""
    return tuple(state for state in State if (state, event) in TABLE)


def step(state: State, event: StateEvent) -> StateTransition | None:
    """The row for this state and event; None for an observation that is ignored in this state.

    Raises RefusedError for a request without a row.
    """
    row = TABLE.get((state, event))
    if row is None and EVENTS[event].asked:
        allowed = states_with(event)
        text = f"{event.value} is not possible in state {state.value}, only in {', '.join(allowed)}"
        raise RefusedError(text, state, allowed)
    return row


class Epoch:
    """A number that only increases, and whether a stop awaits its acknowledgement. Thread-safe."""

    def __init__(self, first: int) -> None:
        self._lock = threading.Lock()
        self.first = self._value = first
        self._stops = 0

    @property
    def value(self) -> int:
        """The present epoch."""
        return self._value

    @property
    def stopping(self) -> bool:
        """Whether a stop has arrived and is not yet acknowledged."""
        return self._stops > 0

    def advance(self) -> int:
        """Begin a new epoch and return it: earlier requests are refused from here on."""
        with self._lock:
            self._value += 1
            return self._value

    def stop_arrived(self) -> None:
        """Until `stop_answered`, no request that is bound to an epoch is carried out."""
        with self._lock:
            self._stops += 1

    def stop_answered(self) -> None:
        """Call once for each stop that arrived."""
        with self._lock:
            self._stops -= 1


class LastStop(NamedTuple):
    """What began the present epoch: a stop, or another event of EVENTS that raises it."""

    who: str
    at: str  # wall clock, ISO 8601, UTC
    kind: str  # of StateEvent
    text: str  # as a refusal says it
    epoch: int  # that it began


class Machine:
    """The state and its epoch, changed by the table only. Nothing else decides whether a request is still valid."""

    def __init__(self, clock: Callable[[], float] = time.time) -> None:
        """`clock`: seconds since 1970."""
        self.state = State.OFFLINE
        self._clock = clock
        self.epoch = Epoch(max(1, int(clock() * EPOCHS_PER_S)))
        self._stop: LastStop | None = None

    @property
    def last_stop(self) -> LastStop | None:
        """What began the present epoch; None in the first one."""
        stop = self._stop  # its acknowledgement has raised the epoch once more
        return None if stop is None else stop._replace(epoch=self.epoch.value)

    def take(
        self, event: StateEvent, asked_in: int | None = None, who: str = "", what: str = ""
    ) -> StateTransition | None:
        """Move to the next state. Returns the row; None for an observation that is ignored in this state.

        `asked_in`: the epoch in which the request was made, see `require_epoch`; `who` ends an epoch, for those whose
        requests are refused then; `what`: the request in their words. Raises RefusedError.
        """
        happening = EVENTS[event]
        if happening.bound:
            self.require_epoch(event, asked_in, what)
        row = step(self.state, event)
        if row is None:
            return None
        if happening.raises:
            at = datetime.fromtimestamp(self._clock(), UTC).isoformat(timespec="milliseconds")
            self._stop = LastStop(who, at, event.value, happening.raises.format(who=who), self.epoch.advance())
        self.state = row.to
        return row

    def require_epoch(self, event: StateEvent, asked_in: int | None, what: str = "") -> None:
        """Raise RefusedError if a bound request was not made in the present epoch, or while a stop is carried out.

        Without `asked_in` a request for motion belongs to the first epoch, any other one to the present one.
        """
        asked_as = event if event in (StateEvent.ENABLE, StateEvent.SET_POINT) else StateEvent.START
        what, now = what or asked_as.value, self.epoch.value
        in_epoch = asked_in if asked_in is not None else self.epoch.first if EVENTS[event].named else now
        ended, stop = in_epoch != now, self.last_stop
        why = f"epoch {now} is the first one of this daemon"
        if stop is not None:
            why = f"{stop.text} at {stop.at[11:19]} UTC (epoch {now} has begun)"
        if self.epoch.stopping:
            what += f": {why}" if ended else ""
            text = f"{what}: a stop is being carried out; ask again when it is acknowledged"
        elif ended:
            named = "" if asked_in is None else f", not in {asked_in}"
            text = f"{what}: {why}: look at the axis, then ask again with epoch {now}{named}"
        else:
            return
        raise RefusedError(text, self.state, states_with(asked_as))


def require_change(state: State, change: Change) -> None:
    """Raise RefusedError where the state forbids a change."""
    if state not in CHANGES[change]:
        allowed = tuple(s for s in State if s in CHANGES[change])
        raise RefusedError(
            f"{change.value}: no change in state {state.value}, only in {', '.join(allowed)}", state, allowed
        )


def markdown() -> str:
    """The tables as Markdown."""
    lines = [
        "# States of the daemon", "",
        "Generated from `fffo_drive/daemon/states.py`, the table that the daemon executes. A "
        "request without a row in the present state is refused, and the answer names the states that allow it.", "",
        "| state | meaning |", "| --- | --- |",
        *(f"| {state.value} | {MEANINGS[state]} |" for state in State), "",
        "The epoch is a number that only increases, also from one start of the daemon to the next. A request bound to "
        "it is refused if it was made in an earlier epoch, whenever it is processed. A request for motion has to name "
        "the epoch; one that does not belongs to the first epoch of the daemon, and so is refused for good once "
        "anything has raised it. The acknowledgement of a stop raises it once more.", "",
        "| event | meaning | epoch |", "| --- | --- | --- |",
        *(
            f"| {event.value} | {happening.text} | {'raises it' if happening.raises else ''}"
            f"{'bound to it' if happening.bound else ''}{', which it has to name' if happening.named else ''} |"
            for event, happening in EVENTS.items()
        ), "",
        "| state | event | next state | actions |", "| --- | --- | --- | --- |",
        *(
            f"| {state.value} | {event.value} | {row.to.value} | {'; '.join(row.actions) or '-'} |"
            for (state, event), row in TABLE.items()
        ), "",
        f"| may change in | {' | '.join(state.value for state in State)} |",
        f"| --- |{' --- |' * len(State)}",
        *(
            f"| {change.value} | {' | '.join('yes' if state in allowed else '-' for state in State)} |"
            for change, allowed in CHANGES.items()
        ),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"
