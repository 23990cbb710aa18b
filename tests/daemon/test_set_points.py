"""Live set points through the daemon: gates, epochs, renewal, bounds of the reference, and the replay of all of it."""

from __future__ import annotations

import math
import os
import signal
import threading
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from daemon.rig import PATIENCE_S, RATE_HZ, Rig, edit
from daemon.test_supervisor import refused, stopped

from fffo_drive.cli import main
from fffo_drive.daemon.rpc import BAD_DOCUMENT, INVALID_PARAMS
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.run_records import RecordKind
from fffo_drive.workflows.replay import replay_files

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]

A, J, STOP = 20.0, 300.0, 40.0
TIMEOUT_S = 1.0
SET_POINTS = {"acceleration_rps2": A, "jerk_rps3": J, "jog_timeout_s": TIMEOUT_S, "largest_rps": 10}
SHORT = {"kind": "sine", "duration_s": 0.4, "amplitude": 1, "frequency_hz": 5}


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    made = Rig(tmp_path_factory.mktemp("d"), set_points=SET_POINTS, stop_rps2=STOP)
    edit(made.path, lambda axis: axis["controller"].update(feedforward={"preview": True, "inertia": True}))
    with made as found:
        found.until("ready")
        yield found


@pytest.fixture
def client(rig):
    found = rig.client()
    found.call("enable")
    yield found
    rig.client().call("disable")


def at_speed(rig, client, rps):
    return rig.until_status(lambda s: s["motion"]["reference_rps"] == rps, client)


def recorded(client):
    """Rows and records of what has been recorded."""
    (file,) = client.call("record", to="off")["files"]
    run = read_run(file)
    return Path(file), run.rows, run.records


def within_bounds(rows, acceleration=A):
    """Of references without a gap in time: acceleration and jerk of the reference stay inside theirs."""
    lives = rows[rows["set_point_sample"] >= 0]
    assert np.abs(lives["reference_rps2"]).max() <= acceleration * (1 + 1e-9)
    ticks = np.diff(lives["tick"].astype(np.int64))
    change = np.abs(np.diff(lives["reference_rps2"]))[np.diff(lives["set_point_sample"]) > 0]
    apart = ticks[np.diff(lives["set_point_sample"]) > 0]
    assert (change <= J / RATE_HZ * apart * (1 + 1e-4)).all()


def test_velocities_and_steps_that_nobody_knew_before(rig, client):
    client.call("disable", wait_s=30)
    client.call("record", to="on")
    client.call("enable")
    answer = client.act("velocity", to_rps=3, run_on=True)
    assert answer["state"] == "following"
    assert answer["renew_within_s"] is None
    # Td - Ts of the model and half a period's hold: reported, rounded up to periods
    status = at_speed(rig, client, 3.0)
    assert status["set_point"] == {
        "kind": "velocity", "number": answer["set_point"], "to_rps": 3.0, "hold_s": None, "run_on": True,
        "lapsed": False, "blocked": False, "latency_s": answer["latency_s"],
    }  # fmt: skip
    assert answer["latency_s"] > 0
    client.act("velocity", to_rps=-2, run_on=True)  # and in the middle of it
    client.act("velocity", to_rps=4, run_on=True, wait_s=30)
    assert client.act("step", by_rps=0.5, run_on=True, wait_s=30)["to_rps"] == 4.5
    assert client.call("status")["motion"]["reference_rps"] == 4.5
    number = client.act("step", by_rps=-1, for_s=0.4)["set_point"]
    rig.until_status(lambda s: s["set_point"]["lapsed"], client)
    assert at_speed(rig, client, 4.5)["set_point"]["to_rps"] == 4.5
    assert client.act("velocity", to_rps=0, run_on=True, wait_s=30)["state"] in ("following", "enabled")
    rig.until("enabled", client)
    assert client.call("status")["set_point"] is None
    last = client.act("velocity", to_rps=1, for_s=0.3)["set_point"]
    rig.until("enabled", client)
    client.act("start", profile=SHORT, wait_s=30)  # a profile as before
    client.call("disable")
    file, rows, records = recorded(client)
    within_bounds(rows)
    assert (rows["trip"] == 0).all()
    # the first sample that moves is as many periods on as was reported; a tick may be missing here
    first = int(np.flatnonzero(rows["reference_rps"])[0])
    before, begun = rows["set_point_sample"][first - 1 : first + 1]
    assert before < round(answer["latency_s"] * RATE_HZ) <= begun
    assert rows["reference_rps"][rows["set_point_number"] == number].min() == 3.5
    assert rows["reference_rps"][(rows["set_point_number"] == last) & (rows["set_point_sample"] >= 0)].max() == 1.0
    # the axis follows
    steady = rows[(rows["set_point_sample"] > 0) & (rows["reference_rps"] == 4.5)]
    assert np.abs(steady["velocity_rps"][-10:] - 4.5).max() < 1.0
    report = replay_files([file])
    assert report.live.as_asked == (rows["set_point_sample"] >= 0).sum() > 300
    assert report.exact, report
    asked = [r.by_name["target_rps"] for r in records if r.kind == RecordKind.SET_POINT]
    assert asked[:3] == [3.0, -2.0, 4.0]


def test_a_jog_that_nobody_renews_ends_at_standstill_without_a_step(rig, client):
    client.call("record", to="on")
    answer = client.act("jog", to_rps=2)
    assert answer["renew_within_s"] == pytest.approx(TIMEOUT_S)
    number = answer["set_point"]
    client.close()  # whoever jogged is gone
    other = rig.client()
    rig.until("enabled", other)
    assert any("not renewed within 1 s" in event["text"] for event in rig.events("set_point"))
    # as good as a stop: whoever renews it too late hears what ended it, and does not move the axis
    stop = other.call("status")["last_stop"]
    assert stop["kind"] == "lapsed"
    assert stop["epoch"] > answer["epoch"]
    late = {"to_rps": 2, "renews": number}
    ended = "jog of pid", "that was not renewed within 1 s"
    refused(lambda: other.call("jog", **late, epoch=answer["epoch"]), *ended)
    error = refused(lambda: other.call("jog", **late), *ended)
    assert (error.data["epoch"], error.data["stop"]) == (stop["epoch"], stop)
    refused(lambda: other.act("jog", **late), f"set point {number} is over")
    assert other.call("status")["state"] == "enabled"
    other.call("disable")
    _, rows, _ = recorded(other)
    within_bounds(rows, STOP)
    lives = rows[rows["set_point_sample"] >= 0]
    held = lives["tick"][lives["set_point_rps"] == 2.0].astype(np.int64)
    lapsed = int(held[0] + TIMEOUT_S * RATE_HZ)  # in ticks of the loop, whatever the daemon does; some may be missing
    assert held[-1] < lapsed <= int(lives["tick"][held.size])
    # dv / A + A / J to standstill, with the deceleration of a stop, and the preview
    moved = int(np.flatnonzero(lives["reference_rps"])[-1])
    gap = int(lives["tick"][held.size]) - int(held[-1]) - 1  # where ticks are missing there, all of them decelerate
    moving, standing = (int(lives["tick"][moved + k]) - lapsed + k * gap for k in (0, 1))
    expected_s = 2 * math.sqrt(2.0 / J) if STOP**2 / J >= 2.0 else 2.0 / STOP + STOP / J
    assert moving - 1 <= (expected_s + answer["latency_s"]) * RATE_HZ <= standing + 1


@pytest.mark.parametrize(("method", "asked"), [("jog", "to_rps"), ("velocity", "to_rps"), ("step", "by_rps")])
def test_a_set_point_goes_on_as_long_as_it_is_renewed(rig, client, method, asked):
    answer = client.act(method, **{asked: 1})
    epoch = answer["epoch"]
    said = len(rig.events("command"))
    first = client.call("status")["loop"]["tick"]
    while client.call("status")["loop"]["tick"] < first + 1.6 * TIMEOUT_S * RATE_HZ:
        before = answer["set_point"]
        answer = client.call(method, **{asked: 1}, renews=before, epoch=epoch)
        assert answer["set_point"] == before + 1
        time.sleep(0.02)
    status = client.call("status")
    assert status["set_point"]["to_rps"] == 1.0
    assert status["motion"]["reference_rps"] == 1.0
    # renewals are no news for the journal
    assert len(rig.events("command")) == said
    # another set point ends it: its renewal is refused and does not bring it back
    client.act("velocity", to_rps=0.5, run_on=True)
    late = partial(client.call, method, **{asked: 1}, renews=answer["set_point"], epoch=epoch)
    refused(late, "is over: another one, by pid")
    assert client.act("jog", to_rps=0)["to_rps"] == 0.0
    rig.until("enabled", client)


def test_a_stop_ends_the_motion_and_what_was_asked_before_it(rig, client):
    begun = client.act("velocity", to_rps=3, run_on=True)["epoch"]
    assert stopped(rig.client().call("stop", who="anna (stop)")) == "enabled"
    assert client.call("status")["motion"]["reference_rps"] == 0.0
    for method, asked in (("velocity", "to_rps"), ("jog", "to_rps"), ("step", "by_rps")):
        late = partial(client.call, method, epoch=begun, **{asked: 3})
        refused(late, f"{method}: stopped by anna (stop) through pid", f"not in {begun}")
        refused(partial(client.call, method, **{asked: 3}), f"{method}: stopped by anna (stop) through pid")
    assert client.call("status")["state"] == "enabled"
    jogging = client.act("jog", to_rps=3)
    answer = rig.client().call("stop")
    renewal = {"renews": jogging["set_point"], "epoch": jogging["epoch"]}
    refused(lambda: client.call("jog", to_rps=3, **renewal), "jog: stopped by pid", f"epoch {answer['epoch']}")
    assert client.call("status")["state"] == "enabled"
    client.call("velocity", to_rps=1, epoch=answer["epoch"], run_on=True)  # of the present epoch
    assert stopped(client.call("disable")) == "ready"
    client.call("enable")
    client.act("velocity", to_rps=3, run_on=True)
    assert stopped(client.call("quick_stop")) == "ready"
    refused(lambda: client.act("velocity", to_rps=3), "ready", "enabled, following")


def test_what_is_not_possible_is_refused_with_what_is(rig, client):
    refused(lambda: client.act("velocity", to_rps=12), "12 rps", "largest_rps 10", code=BAD_DOCUMENT)
    client.act("velocity", to_rps=9.5, run_on=True)
    refused(lambda: client.act("step", by_rps=1), "10.5 rps", code=BAD_DOCUMENT)
    refused(lambda: client.act("start", profile="default"), "following")
    refused(lambda: client.act("jog", to_rps=1e9), "to_rps", code=INVALID_PARAMS)
    client.call("stop")
    client.act("start", profile="default")
    refused(lambda: client.act("jog", to_rps=1), "running", "enabled, following")
    client.call("disable")
    refused(lambda: client.act("jog", to_rps=1), "ready")
    client.call("enable", wait_s=0)


@contextmanager
def meanwhile(what):
    """On another thread, which has ended behind the block."""
    thread = threading.Thread(target=what)
    thread.start()
    yield
    thread.join(PATIENCE_S)
    assert not thread.is_alive()


def test_ctl_jogs_until_it_is_interrupted(rig, client, capsys):
    sockets = ("--sockets", str(rig.sockets))

    def interrupt():
        rig.until_status(lambda status: status["motion"]["reference_rps"] == 1.5)
        os.kill(os.getpid(), signal.SIGINT)

    def stop():
        rig.until("following")
        rig.client().call("stop")

    with meanwhile(interrupt):
        assert main(["ctl", *sockets, "jog", "1.5"]) == 0
    printed = capsys.readouterr()
    assert "state: following" in printed.out
    assert "latency_s: 0.0" in printed.out
    assert "Ctrl-C ends" in printed.err
    rig.until("enabled", client)
    with meanwhile(stop):
        assert main(["ctl", *sockets, "jog", "-1.5"]) == 70
    assert "ctl: jog: stopped by pid" in capsys.readouterr().err
    rig.until("enabled", client)
    with meanwhile(interrupt):
        assert main(["ctl", *sockets, "velocity", "1.5"]) == 0
    rig.until("enabled", client)
    assert main(["ctl", *sockets, "velocity", "-1", "--run-on", "--wait-s", "30"]) == 0
    assert main(["ctl", *sockets, "status"]) == 0
    out = capsys.readouterr().out
    assert "velocity: to -1 rps (set point" in out
    assert "later than it is given (preview)" in out
    assert main(["ctl", *sockets, "jog", "0"]) == 0
    rig.until("enabled", client)


def test_a_set_point_does_not_leave_the_position_window(tmp_path):
    made = Rig(tmp_path, set_points={**SET_POINTS, "window_margin_rev": 0.5})
    edit(made.path, lambda axis: axis["envelope"].update(position_window_rev=[-3.0, 3.0]))
    with made as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("enable")
        client.act("velocity", to_rps=5, run_on=True)
        rig.until("enabled", client)
        (event,) = rig.events("set_point")
        assert "position_window_rev" in event["text"]
        there_rev = client.call("status")["motion"]["position_rev"]
        assert 1.5 < there_rev < 3.0  # about 2.4; the margin is for the ticks that a shared machine skips
        again = client.act("velocity", to_rps=5, for_s=1)  # taken, and not followed
        assert again["state"] == "following"
        rig.until("enabled", client)
        client.act("velocity", to_rps=-1, for_s=0.5)
        rig.until("enabled", client)
        status = client.call("status")
        assert status["motion"]["position_rev"] < there_rev - 0.2
        assert status["fault"] is None
