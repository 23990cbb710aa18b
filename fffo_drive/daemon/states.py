"""The daemon's state machine as one table: the code interprets it, `tools/daemon_states` prints it, a test explores it.

A row says: in this state, on this event, go there and do that. What has no row is refused when somebody asks for it
and passed over when it is an observation. Torque is asked for by ENABLE alone, and every row that leads from a fault
needs a reset: there is no way from a fault to torque without a reset and another enable.

A request for torque or motion holds in the epoch in which it was asked, and in no other. Every stop, disable, quick
stop, fault and reset raises the epoch, and so does a change of who is in charge: what was asked before is refused,
however late it comes to be carried out.
"""

from __future__ import annotations

import threading
from enum import StrEnum
from typing import NamedTuple


class State(StrEnum):
    """Where the axis is, as the daemon has it."""

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
    State.OFFLINE: "no drive: the bus is away or nobody answers; tried again and again",
    State.CONNECTED: "the drive is brought up and the loop runs without torque; something forbids to enable it",
    State.READY: "may be enabled",
    State.ENABLED: "torque is asked for, the axis is held at standstill",
    State.PREPARING: "as enabled, and the profile of a start is being computed and checked",
    State.RUNNING: "a profile runs, or is braked to standstill",
    State.FOLLOWING: "live set points are followed (jog, velocity, step), or braked to standstill",
    State.STOPPING: "torque is on its way out",
    State.FAULT: "latched; no torque until somebody resets it",
}


class StateEvent(StrEnum):
    """What somebody asks for, and what is observed."""

    # asked for
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
    """What an event is: asked for (else refused) or observed (else passed over), in words."""

    asked: bool
    text: str
    raises: bool = False  # the epoch: what was asked for before is refused from here on
    bound: bool = False  # to the epoch in which it was asked


EVENTS = {
    StateEvent.ENABLE: Happening(True, "somebody asks for torque", bound=True),
    StateEvent.DISABLE: Happening(True, "somebody asks for no torque, in order", raises=True),
    StateEvent.START: Happening(True, "somebody starts a profile", bound=True),
    StateEvent.PREPARED: Happening(True, "the profile of that start is computed and within the limits", bound=True),
    StateEvent.NOT_PREPARED: Happening(True, "the profile of that start cannot be used", bound=True),
    StateEvent.SET_POINT: Happening(True, "somebody gives a live set point", bound=True),
    StateEvent.STOP: Happening(True, "somebody ends the motion, in order", raises=True),
    StateEvent.QUICK_STOP: Happening(True, "somebody wants the drive's quick stop", raises=True),
    StateEvent.RESET: Happening(True, "somebody resets a fault, the drive still answers", raises=True),
    StateEvent.RESET_AWAY: Happening(True, "somebody resets a fault, the drive or the loop is gone", raises=True),
    StateEvent.FOUND: Happening(False, "the drive is brought up, the loop runs"),
    StateEvent.PERMITTED: Happening(False, "feedback is fresh, no fault, commissioning record in order"),
    StateEvent.FORBIDDEN: Happening(False, "one of these no longer holds"),
    StateEvent.PROFILE_ENDED: Happening(False, "the profile, the motion by set points, or what brakes it, has ended"),
    StateEvent.TORQUE_OFF: Happening(False, "the drive says that its power stage is off"),
    StateEvent.ENABLE_TIMEOUT: Happening(False, "the drive does not reach Operation Enabled in time", raises=True),
    StateEvent.STOP_TIMEOUT: Happening(False, "the ordered stop takes too long", raises=True),
    StateEvent.STOP_FAILED: Happening(False, "the quick stop takes too long as well", raises=True),
    StateEvent.DRIVE_LOST: Happening(
        False,
        "bus off, interface gone, heartbeat or answers missing, drive rebooted or no longer operational, or another "
        "master's SYNC",
        raises=True,
    ),
    StateEvent.TRIPPED: Happening(
        False, "any other trip of the envelope, the drive's own faults among them", raises=True
    ),
    StateEvent.LOOP_ENDED: Happening(False, "the loop's thread is gone", raises=True),
}  # fmt: skip


class Action(StrEnum):
    """What the supervisor does on the way."""

    ENABLE = "ask for torque"
    DISABLE = "switch the power stage off"
    QUICK_STOP = "quick stop"
    START = "hand the profile to the loop"
    FOLLOW = "hand the set point to the loop"
    BRAKE = "brake the reference to standstill"
    FORGET = "ask for nothing, drop profile and set point"
    CLEAR = "clear the trip and the drive's fault"
    RELEASE = "end the loop, leave the drive, try again"


class StateTransition(NamedTuple):
    """Where to, and what to do on the way, in this order."""

    to: State
    actions: tuple[Action, ...] = ()


_S, _E, _A = State, StateEvent, Action

_FALLS: dict[StateEvent, StateTransition] = {
    event: StateTransition(_S.FAULT, (_A.FORGET,)) for event in (_E.DRIVE_LOST, _E.TRIPPED, _E.LOOP_ENDED)
}
_LOST_AT_REST = StateTransition(_S.OFFLINE, (_A.FORGET, _A.RELEASE))


def _stays(state: State) -> dict[tuple[State, StateEvent], StateTransition]:
    """Where there is no motion to end, every stop succeeds and changes nothing."""
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
    (_S.ENABLED, _E.STOP): StateTransition(_S.ENABLED),
    (_S.ENABLED, _E.DISABLE): StateTransition(_S.STOPPING, (_A.DISABLE,)),
    (_S.ENABLED, _E.QUICK_STOP): StateTransition(_S.STOPPING, (_A.QUICK_STOP,)),
    (_S.ENABLED, _E.ENABLE_TIMEOUT): StateTransition(_S.STOPPING, (_A.DISABLE,)),
    **_falls(_S.ENABLED),
    #
    (_S.PREPARING, _E.ENABLE): StateTransition(_S.PREPARING),
    (_S.PREPARING, _E.PREPARED): StateTransition(_S.RUNNING, (_A.START,)),
    (_S.PREPARING, _E.NOT_PREPARED): StateTransition(_S.ENABLED),
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


class Change(StrEnum):
    """What may be changed, as far as the state lets it."""

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
    """What was asked for is not possible in this state."""

    def __init__(self, text: str, state: State, allowed: tuple[State, ...]) -> None:
        super().__init__(text)
        self.state = state
        self.allowed = allowed


def states_with(event: StateEvent) -> tuple[State, ...]:
    """States in which an event has a row."""
    return tuple(state for state in State if (state, event) in TABLE)


def step(state: State, event: StateEvent) -> StateTransition | None:
    """The row for this state and event; None for an observation that means nothing here.

    Raises RefusedError for something asked for that has no row.
    """
    row = TABLE.get((state, event))
    if row is None and EVENTS[event].asked:
        allowed = states_with(event)
        text = f"{event.value} is not possible in state {state.value}, only in {', '.join(allowed)}"
        raise RefusedError(text, state, allowed)
    return row


class Epoch:
    """A number that only grows, and whether a stop is on its way to its acknowledgement. For any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._value = 1
        self._stops = 0

    @property
    def value(self) -> int:
        """The present one."""
        return self._value

    @property
    def stopping(self) -> bool:
        """A stop has arrived and is not acknowledged yet."""
        return self._stops > 0

    def advance(self) -> int:
        """Begin a new one: what was asked for before is refused from here on. Returns it."""
        with self._lock:
            self._value += 1
            return self._value

    def stop_arrived(self) -> None:
        """From here to `stop_answered` nothing that is bound to an epoch is carried out."""
        with self._lock:
            self._stops += 1

    def stop_answered(self) -> None:
        """Once for each stop that arrived."""
        with self._lock:
            self._stops -= 1


class Machine:
    """The state and its epoch, moved by the table. Nothing else decides whether a request still holds."""

    def __init__(self) -> None:
        self.state = State.OFFLINE
        self.epoch = Epoch()

    def take(self, event: StateEvent, asked_in: int | None = None) -> StateTransition | None:
        """Go where the table says. Returns its row; None for an observation that means nothing here.

        `asked_in`: the epoch in which it was asked; None: in this one. Raises RefusedError.
        """
        happening = EVENTS[event]
        if happening.bound:
            self._require_epoch(event, asked_in)
        row = step(self.state, event)
        if row is None:
            return None
        if happening.raises:
            self.epoch.advance()
        self.state = row.to
        return row

    def _require_epoch(self, event: StateEvent, asked_in: int | None) -> None:
        what = event if event in (StateEvent.ENABLE, StateEvent.SET_POINT) else StateEvent.START
        if self.epoch.stopping:
            text = f"{what.value}: a stop is being carried out; ask again when it is acknowledged"
        elif asked_in is not None and asked_in != self.epoch.value:
            text = (
                f"{what.value} was asked for in epoch {asked_in}; epoch {self.epoch.value} has begun since by a stop, "
                "a fault, a reset or a change of who is in charge: look at the axis and ask again"
            )
        else:
            return
        raise RefusedError(text, self.state, states_with(what))


def require_change(state: State, change: Change) -> None:
    """Raise RefusedError where the state forbids a change."""
    if state not in CHANGES[change]:
        allowed = tuple(s for s in State if s in CHANGES[change])
        raise RefusedError(
            f"{change.value}: no change in state {state.value}, only in {', '.join(allowed)}", state, allowed
        )


def markdown() -> str:
    """The tables for people."""
    lines = [
        "# States of the daemon", "",
        "Made by `tools/daemon_states` from `fffo_drive/daemon/states.py`, which the daemon interprets. What is asked "
        "for without a row is refused with the state and the states that allow it.", "",
        "| state | meaning |", "| --- | --- |",
        *(f"| {state.value} | {MEANINGS[state]} |" for state in State), "",
        "The epoch is a number that only grows. What is bound to it is refused when it was asked for in an earlier "
        "one, at whatever moment it comes to be carried out. A change of who is in charge (enable with hold, and its "
        "end) raises it too, and so does the acknowledgement of a stop.", "",
        "| event | what it is | epoch |", "| --- | --- | --- |",
        *(
            f"| {event.value} | {happening.text} | {'raises it' if happening.raises else ''}"
            f"{'bound to it' if happening.bound else ''} |"
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
