"""The state machine's table: what is written is what the code interprets, and no way leads around a reset."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from fffo_drive.daemon.states import (
    AT_REST,
    CHANGES,
    EVENTS,
    MEANINGS,
    TABLE,
    TORQUE_STATES,
    WANTING_TORQUE,
    Action,
    Change,
    Machine,
    RefusedError,
    State,
    StateEvent,
    markdown,
    require_change,
    states_with,
    step,
)

WRITTEN = Path(__file__).resolve().parents[2] / "tools" / "tables" / "daemon_states.md"
RESETS = (StateEvent.RESET, StateEvent.RESET_AWAY)
STOPS = (StateEvent.STOP, StateEvent.DISABLE, StateEvent.QUICK_STOP)
FALLS = (StateEvent.DRIVE_LOST, StateEvent.TRIPPED, StateEvent.LOOP_ENDED)
ASKED = [event for event, happening in EVENTS.items() if happening.asked]
OBSERVED = [event for event, happening in EVENTS.items() if not happening.asked]


def test_the_written_table_is_the_code():
    assert WRITTEN.read_text(encoding="utf-8") == markdown(), "write it again: tools/daemon_states"


def test_every_state_event_and_change_has_its_words():
    assert set(MEANINGS) == set(State)
    assert set(EVENTS) == set(StateEvent)
    assert set(CHANGES) == set(Change)
    assert {event for _, event in TABLE} == set(StateEvent)
    assert {action for row in TABLE.values() for action in row.actions} == set(Action)


def test_every_state_can_be_reached_and_left():
    reached = {State.OFFLINE}
    while (more := reached | {row.to for (state, _), row in TABLE.items() if state in reached}) != reached:
        reached = more
    assert reached == set(State)
    assert {state for (state, _), row in TABLE.items() if row.to is not state} == set(State)


def test_a_fault_is_left_by_a_reset_alone_and_not_into_torque():
    leaving = {(event, row.to) for (state, event), row in TABLE.items() if state is State.FAULT and row.to is not state}
    assert leaving == {(StateEvent.RESET, State.CONNECTED), (StateEvent.RESET_AWAY, State.OFFLINE)}


def test_torque_is_asked_for_by_enable_alone():
    entering = {(state, event) for (state, event), row in TABLE.items() if Action.ENABLE in row.actions}
    assert entering == {(State.READY, StateEvent.ENABLE)}
    for (state, event), row in TABLE.items():
        if state in AT_REST and row.to in TORQUE_STATES:
            assert event is StateEvent.ENABLE, (state, event)


@pytest.mark.parametrize("state", sorted(TORQUE_STATES, key=lambda state: state.value))
def test_an_axis_with_torque_can_always_be_stopped_and_always_falls_into_fault(state):
    for event in (StateEvent.DISABLE, StateEvent.STOP, StateEvent.QUICK_STOP):
        assert (state, event) in TABLE
    for event in (StateEvent.TRIPPED, StateEvent.DRIVE_LOST, StateEvent.LOOP_ENDED):
        assert TABLE[state, event].to is State.FAULT


@pytest.mark.parametrize("state", list(State))
def test_a_stop_is_refused_nowhere_and_raises_the_epoch(state):
    for event in STOPS:
        machine = Machine()
        machine.state = state
        before = machine.epoch.value
        assert machine.take(event) is not None
        assert machine.epoch.value > before


def test_what_raises_the_epoch_and_what_is_bound_to_it():
    raising = {event for event, happening in EVENTS.items() if happening.raises}
    assert raising == {
        *STOPS,
        *RESETS,
        *FALLS,
        StateEvent.LAPSED,
        StateEvent.CHARGE,
        StateEvent.ENABLE_TIMEOUT,
        StateEvent.STOP_TIMEOUT,
        StateEvent.STOP_FAILED,
    }
    assert {event for event, happening in EVENTS.items() if happening.bound} == {
        StateEvent.ENABLE, StateEvent.START, StateEvent.PREPARED, StateEvent.NOT_PREPARED, StateEvent.SET_POINT,
    }  # fmt: skip
    # what a client asks for to move the axis has to name its epoch
    assert {event for event, happening in EVENTS.items() if happening.named} == {StateEvent.START, StateEvent.SET_POINT}
    # motion begins nowhere else
    assert {event for (_, event), row in TABLE.items() if Action.START in row.actions} == {StateEvent.PREPARED}
    assert {event for (_, event), row in TABLE.items() if Action.FOLLOW in row.actions} == {StateEvent.SET_POINT}


@given(st.sampled_from(list(State)), st.sampled_from(ASKED))
def test_what_is_asked_for_without_a_row_is_refused_with_the_states_that_allow_it(state, event):
    if (state, event) in TABLE:
        assert step(state, event) == TABLE[state, event]
        return
    with pytest.raises(RefusedError) as refused:
        step(state, event)
    assert refused.value.state is state
    assert refused.value.allowed == states_with(event)
    assert state.value in str(refused.value)
    assert all(allowed.value in str(refused.value) for allowed in refused.value.allowed)


@given(st.sampled_from(list(State)), st.sampled_from(OBSERVED))
def test_an_observation_without_a_row_is_passed_over(state, event):
    assert step(state, event) == TABLE.get((state, event))


def test_the_model_changes_only_without_torque_and_gains_always():
    for state in State:
        for change in Change:
            if state in CHANGES[change]:
                require_change(state, change)
                continue
            with pytest.raises(RefusedError, match=change.value.split()[0]):
                require_change(state, change)
    assert CHANGES[Change.MODEL] == AT_REST
    assert CHANGES[Change.GAINS] == CHANGES[Change.TOGGLE] == CHANGES[Change.RECORD] == frozenset(State)


WORDS = {
    **dict.fromkeys((*STOPS, StateEvent.LAPSED, *FALLS), "stopped by pid 7"),
    **dict.fromkeys(RESETS, "fault reset by pid 7"),
    StateEvent.CHARGE: "taken over by pid 7",
    StateEvent.ENABLE_TIMEOUT: "not enabled in time",
    StateEvent.STOP_TIMEOUT: "stopped by a quick stop: the controlled one took too long",
    StateEvent.STOP_FAILED: "stopped by a fault: the quick stop took too long",
}


@pytest.mark.parametrize(("state", "event"), [row for row in TABLE if EVENTS[row[1]].raises])
def test_whatever_withdraws_motion_latches_and_says_who_and_when(state, event):
    machine = Machine(lambda: 43387.5)  # 12:03:07.5
    first = machine.epoch.value
    assert machine.last_stop is None
    machine.state = state
    machine.take(event, who="pid 7")
    assert machine.last_stop == (
        "pid 7",
        "1970-01-01T12:03:07.500+00:00",
        event.value,
        WORDS[event],
        machine.epoch.value,
    )
    machine.epoch.advance()  # acknowledged
    now = machine.epoch.value
    assert machine.last_stop.epoch == now
    machine.state = State.ENABLED
    for asked_in, named in ((None, ""), (first, f", not in {first}")):
        with pytest.raises(RefusedError) as refused:
            machine.take(StateEvent.SET_POINT, asked_in, what="velocity")
        assert str(refused.value) == (
            f"velocity: {WORDS[event]} at 12:03:07 UTC (epoch {now} has begun): look at the axis, then ask again with "
            f"epoch {now}{named}"
        )
        with pytest.raises(RefusedError, match="start: "):
            machine.take(StateEvent.START, asked_in)
    assert machine.state is State.ENABLED
    machine.take(StateEvent.SET_POINT, now)
    assert machine.state is State.FOLLOWING
    with pytest.raises(RefusedError, match=WORDS[event]):  # one request that names it does not revive those without
        machine.take(StateEvent.SET_POINT)


@given(st.floats(0, 2e9), st.integers(0, 1000), st.floats(1.0, 1e9))
def test_an_epoch_is_not_one_of_an_earlier_daemon(started_s, stops, later_s):
    earlier = Machine(lambda: started_s)
    earlier.state = State.ENABLED
    for _ in range(stops):
        earlier.take(StateEvent.STOP)
    later = Machine(lambda: started_s + later_s)
    later.state = State.ENABLED
    assert later.epoch.value < 2**53  # whole in JSON
    if earlier.epoch.value == later.epoch.value:
        assert stops >= 1000 * later_s - 1  # a thousand in each second of its life
        return
    with pytest.raises(RefusedError, match=f"epoch {later.epoch.value} is the first one of this daemon"):
        later.take(StateEvent.SET_POINT, earlier.epoch.value)


class Request:
    """A start, a set point or an enable on its way: asked for, taken, and for a start prepared.

    `epoch` is None for one that names none, which an enable never is: the server puts in the one of its arrival.
    """

    def __init__(self, event: StateEvent, epoch: int | None, outdated: bool) -> None:
        self.event, self.epoch, self.outdated = event, epoch, outdated

    def __repr__(self) -> str:
        return f"{self.event}@{self.epoch}"


class Axis(RuleBasedStateMachine):
    """Any events in any order, requests that take their time, and a small model of what the loop is asked for."""

    def __init__(self) -> None:
        super().__init__()
        self.machine = Machine(lambda: 1000.0)
        self.old_epochs: list[int] = [999_999]  # of a daemon before, and all that have ended
        self.wants_torque = False
        self.moves = False
        self.reset_since_fault = self.enabled_since_fault = True
        self.fault_seen = False
        self.arrived: list[Request] = []
        self.preparing: list[Request] = []
        self.stops: list[StateEvent] = []  # arrived, not yet taken
        self.unanswered: list[StateEvent] = []  # taken, not yet acknowledged

    @property
    def state(self) -> State:
        return self.machine.state

    def happen(self, event: StateEvent, asked_in: int | None = None) -> None:
        before = self.state
        row = self.machine.take(event, asked_in)
        if row is None:
            return
        if EVENTS[event].raises:
            self.outdate()
        if row.to is State.FAULT and before is not State.FAULT:
            self.fault_seen, self.enabled_since_fault, self.reset_since_fault = True, False, False
        if event in RESETS:
            self.reset_since_fault = True
        if event is StateEvent.ENABLE and before is State.READY:
            self.enabled_since_fault = True
            assert self.reset_since_fault
        for action in row.actions:
            if action is Action.ENABLE:
                self.wants_torque = True
            elif action in (Action.START, Action.FOLLOW):
                self.moves = True
            elif action in (Action.DISABLE, Action.QUICK_STOP, Action.FORGET, Action.RELEASE):
                self.wants_torque = self.moves = False
        if event is StateEvent.PROFILE_ENDED:
            self.moves = False

    def outdate(self) -> None:
        """Everything that was asked for before, and for good everything that names no epoch."""
        self.old_epochs.append(max(self.old_epochs) + 1)
        assert self.old_epochs[-1] < self.machine.epoch.value
        for request in (*self.arrived, *self.preparing):
            request.outdated = True

    @initialize(state=st.sampled_from([State.OFFLINE, State.READY, State.ENABLED]))
    def begin(self, state: State) -> None:
        self.machine.state = state
        self.wants_torque = state is State.ENABLED

    @rule(event=st.sampled_from(OBSERVED))
    def observe(self, event: StateEvent) -> None:
        self.happen(event)

    @rule(event=st.sampled_from([e for e in ASKED if not EVENTS[e].bound and e not in STOPS]))
    def ask(self, event: StateEvent) -> None:
        try:
            self.happen(event)
        except RefusedError:
            assert (self.state, event) not in TABLE

    @rule(event=st.sampled_from([StateEvent.ENABLE, StateEvent.START, StateEvent.SET_POINT]))
    def a_request_arrives(self, event: StateEvent) -> None:
        self.arrived.append(Request(event, self.machine.epoch.value, False))

    @rule(event=st.sampled_from([StateEvent.START, StateEvent.SET_POINT]))
    def a_request_without_epoch_arrives(self, event: StateEvent) -> None:
        self.arrived.append(Request(event, None, len(self.old_epochs) > 1))

    @rule(event=st.sampled_from([StateEvent.ENABLE, StateEvent.START, StateEvent.SET_POINT]), data=st.data())
    def a_request_of_an_earlier_epoch_arrives(self, event: StateEvent, data: st.DataObject) -> None:
        self.arrived.append(Request(event, data.draw(st.sampled_from(self.old_epochs)), True))

    @precondition(lambda self: self.arrived)
    @rule(data=st.data())
    def a_request_is_taken(self, data: st.DataObject) -> None:
        request = self.arrived.pop(data.draw(st.integers(0, len(self.arrived) - 1)))
        possible = (self.state, request.event) in TABLE and not request.outdated and not self.machine.epoch.stopping
        try:
            self.happen(request.event, request.epoch)
        except RefusedError:
            assert not possible
            return
        assert possible
        if request.event is StateEvent.START:
            request.epoch = self.machine.epoch.value
            self.preparing.append(request)

    @precondition(lambda self: self.preparing)
    @rule(data=st.data(), usable=st.booleans())
    def a_preparation_ends(self, data: st.DataObject, usable: bool) -> None:
        request = self.preparing.pop(data.draw(st.integers(0, len(self.preparing) - 1)))
        try:
            self.happen(StateEvent.PREPARED if usable else StateEvent.NOT_PREPARED, request.epoch)
        except RefusedError:
            assert request.outdated or self.machine.epoch.stopping
            return
        assert not request.outdated
        assert self.state is (State.RUNNING if usable else State.ENABLED)

    @rule(event=st.sampled_from(STOPS))
    def a_stop_arrives(self, event: StateEvent) -> None:
        self.machine.epoch.stop_arrived()
        self.stops.append(event)

    @precondition(lambda self: self.stops)
    @rule()
    def a_stop_is_taken(self) -> None:
        event = self.stops.pop(0)
        self.happen(event)
        self.unanswered.append(event)

    @precondition(lambda self: self.unanswered and self.state in AT_REST | {State.ENABLED})
    @rule()
    def a_stop_is_acknowledged(self) -> None:
        """Whatever was sent before is older than the acknowledgement from here on."""
        self.unanswered.pop(0)
        self.machine.epoch.advance()
        self.machine.epoch.stop_answered()
        self.outdate()
        assert not self.moves

    @precondition(lambda self: self.state is State.FAULT)
    @rule(event=st.sampled_from([e for e in StateEvent if e not in RESETS and not EVENTS[e].bound]))
    def a_fault_stays(self, event: StateEvent) -> None:
        self.ask(event) if EVENTS[event].asked else self.observe(event)
        assert self.state is State.FAULT

    @invariant()
    def torque_is_wanted_only_where_the_state_says_so(self) -> None:
        assert not self.wants_torque or self.state in TORQUE_STATES
        if self.state in WANTING_TORQUE:
            assert self.wants_torque
        assert not self.moves or self.state in (State.RUNNING, State.FOLLOWING, State.STOPPING)

    @invariant()
    def torque_after_a_fault_needs_a_reset_and_an_enable(self) -> None:
        if self.fault_seen and self.wants_torque:
            assert self.reset_since_fault
            assert self.enabled_since_fault


TestAxis = Axis.TestCase
TestAxis.settings = settings(max_examples=300, stateful_step_count=40)
