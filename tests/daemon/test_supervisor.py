"""The daemon on a drive: states, motion, live changes, faults, recording, and who is in charge. In real time."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest
from daemon.rig import RATE_HZ, Rig, edit

from fffo_drive.daemon import supervisor as supervisors
from fffo_drive.daemon.client import CallError
from fffo_drive.daemon.connection import leave
from fffo_drive.daemon.rpc import BAD_DOCUMENT, NOT_REACHED, REFUSED
from fffo_drive.daemon.states import State
from fffo_drive.daemon.watch import STANDSTILL_RPS
from fffo_drive.drive.cia402 import GOAL_DISABLED, GOAL_ENABLED
from fffo_drive.drive.simulated.node.faults import Fault, FaultKind
from fffo_drive.drive.simulated.node.objects import OVERCURRENT
from fffo_drive.fleet.store import FleetStore
from fffo_drive.recording.reader import read_run
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime import session as sessions
from fffo_drive.runtime.session import LoopHungError

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]


def refused(call, *words, code=REFUSED):
    with pytest.raises(CallError) as error:
        call()
    assert error.value.code == code, error.value
    for word in words:
        assert word in str(error.value)
    return error.value


def reached(answer):
    """The state that an answer says was reached; the epoch beside it is no more than a number."""
    assert answer.keys() == {"state", "reached", "epoch"}
    assert answer["reached"] is True
    return answer["state"]


def stopped(answer):
    """The state that a stop says it ended in, with an axis that was seen at rest."""
    assert answer.keys() == {"state", "reached", "epoch", "velocity_rps", "at_rest"}
    assert answer["reached"] is answer["at_rest"] is True
    assert abs(answer["velocity_rps"]) < STANDSTILL_RPS
    return answer["state"]


def test_from_offline_to_a_profile_and_back(tmp_path):
    with Rig(tmp_path) as rig:
        client = rig.client()
        status = rig.until("ready", client)
        assert status["drive"]["state"] == "switch on disabled"
        assert client.call("info")["protocol"] == 1
        refused(lambda: client.act("start", profile="default"), "start", "ready", "enabled")
        assert reached(client.call("enable")) == "enabled"
        assert client.call("status")["drive"]["state"] == "operation enabled"
        assert client.call("record", to="on")["on"]
        client.act("start", profile="default")
        rig.until_status(lambda s: s["profile"] and s["profile"]["sample"] > RATE_SAMPLES, client)
        assert stopped(client.call("stop")) == "enabled"
        client.act("start", profile={"kind": "points", "points": [[0, 0], [0.2, 1], [0.4, 0]]}, wait_s=30)
        assert client.call("status")["state"] == "enabled"
        client.act("start", profile="default")
        rig.until_status(lambda s: s["profile"] and s["profile"]["sample"] > RATE_SAMPLES, client)
        assert stopped(client.call("disable")) == "ready"
        (file,) = client.call("record", to="off")["files"]
        assert rig.node is not None
        assert not any(rig.node.plant.torque_seen[-3:])
    run = read_run(file)
    assert run.complete
    kinds = [event.data["kind"] for event in run.events if event.source == "supervisor"]
    assert kinds.count("state") >= 5
    assert (run.rows["trip"] == 0).all()
    # an ordered stop has no step in the reference: 100 rps^2 at 500 Hz, and what lies between two turns
    moving = run.rows[run.rows["mode"] == 1]
    steps_rps = np.abs(np.diff(moving["reference_rps"])) / np.diff(moving["tick"].astype(np.int64))
    assert steps_rps.max() < 0.25


RATE_SAMPLES = 60


def test_an_axis_without_its_commissioning_record_is_connected_and_not_more(tmp_path):
    with Rig(tmp_path, uncommissioned=False) as rig:
        client = rig.client()
        status = rig.until_status(lambda s: s["state"] == "connected" and s["loop"] and s["loop"]["rows"] > 100, client)
        assert "commission" in status["obstacles"][0]
        refused(lambda: client.call("enable"), "commission")
        assert rig.node is not None
    assert rig.node.provocations() == []


def test_gains_and_toggle_change_while_a_profile_runs_and_the_model_does_not(tmp_path):
    with Rig(tmp_path) as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("enable")
        client.act("start", profile="default")
        key = "controller.proportional_a_per_rps"
        before = rig.do(lambda: rig.supervisor.connection.session.status(b.PARAMETERS_IN_USE))
        assert client.call("set", key=key, value=0.9) == {"key": key, "value": 0.9}
        assert client.call("info")["keys"][key] == 0.9
        for toggle in ("fb", "off", "ff"):
            assert client.call("toggle", to=toggle) == {"toggle": toggle}
        rig.until_status(lambda s: s["loop"]["tick"] > 0 and rig.do(in_use(rig)) > before, client)
        model = (rig.path.parent / "model.yaml").read_text()
        refused(lambda: client.call("model", text=model), "model", "running", "ready")
        refused(lambda: client.call("set", key="controller.feedforward.inertia", value=True), "feed-forward")
        # a law that is not stable is refused, and the old one stays
        refused(lambda: client.call("set", key=key, value=50), "phase margin", code=BAD_DOCUMENT)
        refused(lambda: client.call("set", key=key, value=-1), "a number above 0", code=BAD_DOCUMENT)
        wrong = "controller.observer.gain"
        refused(lambda: client.call("set", key=wrong, value=1), "gain_nm_per_rev", code=BAD_DOCUMENT)
        assert client.call("info")["keys"][key] == 0.9
        client.call("disable")
        changed = model.replace("name: table1", "name: other")
        assert client.call("model", text=changed, name="m.yaml")["name"] == "other"
        refused(lambda: client.call("model", text="rubbish: [", name="m.yaml"), "m.yaml", code=BAD_DOCUMENT)
        other_kt = changed.replace("torque_constant_nm_per_a: 0.148", "torque_constant_nm_per_a: 0.3")
        refused(lambda: client.call("model", text=other_kt), "torque_constant_nm_per_a", code=BAD_DOCUMENT)
        assert client.call("status")["model"]["name"] == "other"


def in_use(rig):
    return lambda: rig.supervisor.connection.session.status(b.PARAMETERS_IN_USE)


def test_a_fault_of_the_drive_latches_until_it_is_reset_and_enabled_again(tmp_path):
    with Rig(tmp_path) as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("enable")
        assert rig.node is not None
        rig.node.tell(lambda node: node.drive.injected.add(OVERCURRENT))
        status = rig.until("fault", client)
        assert status["fault"]["name"] in ("drive_fault", "emergency")
        refused(lambda: client.call("enable"), "fault")
        refused(lambda: client.act("start", profile="default"), "fault")
        refused(lambda: client.call("reset_fault", wait_s=5), "fault", code=NOT_REACHED)  # its cause is still there
        rig.node.tell(lambda node: node.drive.injected.clear())
        assert reached(client.call("reset_fault")) == "ready"
        refused(lambda: client.call("reset_fault"), "ready", "fault")
        assert not any(rig.node.plant.torque_seen[-3:])  # a reset is no enable
        client.call("enable")
        client.call("quick_stop")
        rig.until("ready", client)
        assert [event["data"]["name"] for event in rig.events("fault")].count(status["fault"]["name"]) >= 1


def test_a_drive_that_goes_away_at_rest_is_looked_for_again_and_under_torque_it_is_a_fault(tmp_path):
    with Rig(tmp_path) as rig:
        client = rig.client()
        rig.until("ready", client)
        assert rig.node is not None
        rig.node.tell(lambda node: node.faults.inject(Fault(FaultKind.REBOOT, duration_s=0.01)))
        rig.until_status(lambda s: s["loop"] is None or s["loop"]["connection"] > 1, client)
        rig.until("ready", client)
        client.call("enable")
        rig.node.tell(lambda node: node.faults.inject(Fault(FaultKind.REBOOT, duration_s=0.01)))
        status = rig.until("fault", client)
        assert status["fault"]["name"] == "reboot"
        assert reached(client.call("reset_fault", wait_s=60)) == "ready"  # brought up again
        assert client.call("status")["loop"]["connection"] >= 3


def test_a_drive_that_comes_later_is_found(tmp_path):
    with Rig(tmp_path, drive=False) as rig:
        client = rig.client()
        status = rig.until_status(lambda s: "does not answer" in str(s["obstacles"]), client)
        assert status["state"] == "offline"
        refused(lambda: client.call("enable"), "offline")
        assert len(rig.events("drive")) == 1  # reported once, not at each attempt
        rig.node = rig.new_node().__enter__()
        rig.until("ready", client)


@pytest.mark.parametrize(("loss", "state"), [("stop", "ready"), ("quick_stop", "ready"), ("go_on", "running")])
def test_who_holds_the_axis_and_goes_away_does_not_leave_it_moving_unless_told_so(tmp_path, loss, state):
    with Rig(tmp_path, client_loss=loss, in_charge="connection") as rig:
        watcher = rig.client()
        rig.until("ready", watcher)
        refused(lambda: watcher.call("enable"), "hold")
        holder = rig.client()
        holder.call("enable", hold=True)
        holder.act("start", profile="default")
        rig.until_status(lambda s: s["profile"] and s["profile"]["sample"] > RATE_SAMPLES, watcher)
        assert "pid" in watcher.call("status")["held_by"]
        holder.close()
        rig.until_status(lambda s: s["state"] == state and s["held_by"] is None, watcher)


def test_a_supervisor_that_is_silent_is_noticed_by_the_loop_which_stops_the_drive(tmp_path):
    with Rig(tmp_path, supervisor_timeout_s=0.5) as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("enable")
        connection = rig.do(lambda: rig.supervisor.connection)
        rig.do(lambda: connection.session._thread.join(60.0))  # the supervisor's thread is held up as long as it takes
        assert connection.session.status(b.ABANDONED) == 1
        status = rig.until("fault", client)
        assert status["fault"]["name"] == "abandoned"
        assert rig.node is not None
        assert not any(rig.node.plant.torque_seen[-3:])
        assert client.call("reset_fault", wait_s=60)["state"] == "ready"


def test_the_watchdog_is_fed_only_while_the_head_moves_and_all_fits_together(tmp_path):
    with Rig(tmp_path) as rig:
        assert rig.do(lambda: rig.supervisor.consistent)
        rig.until("ready")
        supervisor = rig.supervisor
        assert rig.do(lambda: supervisor.consistent)

        def with_torque_behind_its_back() -> bool:
            supervisor.motion.ask(GOAL_ENABLED)
            found = supervisor.consistent
            supervisor.motion.ask(GOAL_DISABLED)
            return found

        def with_a_loop_that_hangs() -> tuple[str, bool]:
            watcher, trouble = supervisor._watcher, None
            while trouble is None:  # again when the loop has moved between the two looks
                watcher._head, watcher._head_s = supervisor.connection.head, 0.0
                trouble = watcher.look(time.monotonic())
            return trouble.name, supervisor.consistent

        def in_a_state_that_does_not_fit() -> bool:
            before, supervisor.machine.state = supervisor.state, State.OFFLINE
            found = supervisor.consistent
            supervisor.machine.state = before
            return found

        assert not rig.do(with_torque_behind_its_back)
        assert not rig.do(in_a_state_that_does_not_fit)
        assert rig.do(with_a_loop_that_hangs) == ("loop_stalled", False)
        rig.until_status(lambda s: rig.do(lambda: supervisor.consistent))


def test_a_loop_that_cannot_be_ended_ends_the_daemon_which_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(sessions, "STOP_TIMEOUT_S", 0.2)
    for_ever = threading.Event()
    rig = Rig(tmp_path).__enter__()
    rig.until("ready")
    hung = threading.Thread(target=for_ever.wait, daemon=True)
    hung.start()
    session = rig.do(lambda: rig.supervisor.connection.session)
    session._thread = hung  # the true one ends when it is asked to
    with pytest.raises(LoopHungError, match="has to end"):
        rig.__exit__()
    for_ever.set()
    session.drive.close()
    assert rig.node is not None
    assert rig.node.provocations() == []


def test_a_reload_applies_what_it_can_and_names_what_needs_a_restart(tmp_path):
    with Rig(tmp_path) as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("enable")

        def change(axis):
            axis["controller"]["proportional_a_per_rps"] = 0.9
            axis["controller"]["observer"]["toggle"] = "off"
            axis["loop"]["rate_hz"] = 1000
            axis["envelope"]["speed_limit_rps"] = 20
            gentle = {"kind": "sine", "duration_s": 1, "amplitude": 0.5, "frequency_hz": 1}
            axis["daemon"]["profiles"] = {"gentle": gentle}

        edit(rig.path, change)
        done = client.call("reload")
        assert set(done["applied"]) == {"controller", "daemon"}
        assert set(done["restart"]) == {"loop", "envelope"}
        info = client.call("info")
        assert info["rate_hz"] == 500
        assert info["keys"]["controller.proportional_a_per_rps"] == 0.9
        assert client.call("status")["toggle"] == "off"
        client.act("start", profile="gentle", wait_s=60)
        rig.path.write_text("rubbish: [")
        refused(lambda: client.call("reload"), "axis.yaml", code=BAD_DOCUMENT)
        assert client.call("status")["state"] == "enabled"
        assert client.call("info")["keys"]["controller.proportional_a_per_rps"] == 0.9


def test_a_disk_that_hangs_does_not_hold_up_the_end_of_the_service(tmp_path, monkeypatch):
    monkeypatch.setattr(supervisors, "CLOSE_S", 0.5)
    hangs = threading.Event()
    with Rig(tmp_path) as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("record", to="on")
        stop = rig.supervisor.recorder._stop
        monkeypatch.setattr(rig.supervisor.recorder, "_stop", lambda recorder: (hangs.wait(60.0), stop(recorder))[1])
    journal = rig.journal.getvalue()
    hangs.set()
    assert "the disk does not answer" in journal
    assert rig.supervisor.state is State.OFFLINE
    assert rig.supervisor.connection is None  # torque, SYNC and the loop have ended all the same
    assert rig.node is not None
    assert not any(rig.node.plant.torque_seen[-3:])


def test_a_service_that_ends_while_it_brings_the_drive_up_leaves_the_drive_again(tmp_path, monkeypatch):
    begun, go_on = threading.Event(), threading.Event()
    real, left = supervisors.bring_up, []

    def slow(*arguments):
        begun.set()
        assert go_on.wait(60.0)
        return real(*arguments)

    monkeypatch.setattr(supervisors, "bring_up", slow)
    monkeypatch.setattr(supervisors, "leave", lambda connection: left.append(connection) or leave(connection))
    with Rig(tmp_path) as rig:
        assert begun.wait(60.0)
        rig.do(lambda: setattr(rig.supervisor, "_closing", True))
        go_on.set()
    assert len(left) == 1
    assert not left[0].running


@pytest.mark.long
def test_what_is_recorded_gets_a_record_in_the_fleets_store(tmp_path):
    store = tmp_path / "store"
    with Rig(tmp_path, fleet=str(store)) as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("record", to="on")
        client.call("enable")
        client.act("start", profile="default")
        rig.until_status(lambda s: s["profile"] and s["profile"]["sample"] > 4 * RATE_HZ, client)
        client.call("disable")
        (file,) = client.call("record", to="off")["files"]
        rig.until_status(lambda _: list(store.glob("records/new/*.parquet")) != [], client)
        assert not any("no record" in event["text"] for event in rig.events("recording"))
    made = FleetStore(str(store))
    assert (made.status().runs, made.status().recorded, made.status().failed) == (1, 1, 0)
    (entry,) = made.index().to_pylist()
    assert entry["path"] == str(Path(file).resolve())
    (row,) = made.records(["ticks", "trip"]).to_pylist()
    assert row["ticks"] == read_run(Path(file)).columns["tick"].size > RATE_HZ


def test_a_fleets_store_that_cannot_be_written_is_reported_and_stops_nothing(tmp_path):
    (tmp_path / "store").write_text("a file where a directory should be")
    with Rig(tmp_path, fleet=str(tmp_path / "store")) as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("record", to="on")
        client.call("record", to="off")

        def reported(status) -> bool:
            return any("no record for the fleet" in e["text"] for e in client.call("events", limit=100)["events"])

        rig.until_status(reported, client)
        assert client.call("status")["state"] == "ready"
