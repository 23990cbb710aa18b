"""The recordings of a daemon's whole run, replayed: every command of it, whatever was set, changed and reset live."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from daemon.rig import Rig, edit
from daemon.test_supervisor import refused
from recording.samples import random_rows, write_run

from fffo_drive.control.reference import MODE_VELOCITY
from fffo_drive.drive.simulated.node.objects import OVERCURRENT
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.run_records import RecordKind
from fffo_drive.workflows.replay import replay_files, with_continuations

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]

KEY = "controller.proportional_a_per_rps"
WIDTH = "controller.notches.0.width"
SINE = {"kind": "sine", "duration_s": 20, "amplitude": 1, "frequency_hz": 0.5}
DELETED = "deleted to stay below recording.quota_bytes, 1 MB: "
SHORT = {"kind": "sine", "duration_s": 0.4, "amplitude": 1, "frequency_hz": 5}
COGGING = {"name": "cogging", "parameters": {"sin_nm": {"value": -0.001}, "order": {"value": 4.0}}}


def seen(rig, client):
    """Wait until the loop has seen what was asked for last."""
    session = rig.do(lambda: rig.supervisor.connection.session)
    begun = session.ring.words[0]
    rig.until_status(lambda status: session.ring.words[0] > begun + 30, client)


def model_with(rig, *effects, **changes):
    content = yaml.safe_load((rig.path.parent / "model.yaml").read_text())
    content.pop("content_hash", None)
    content["effects"] = list(effects)
    return yaml.safe_dump({**content, **changes})


def test_every_command_of_a_service_s_run_is_reproduced(tmp_path):
    with Rig(tmp_path) as rig:
        edit(rig.path, lambda axis: axis["recording"].update(rotate_s=1.0))
        edit(rig.path, lambda axis: axis["controller"].update(notches=[{"frequency_hz": 150.0, "width": 0.3}]))
        client = rig.client()
        rig.until("ready", client)
        client.call("reload")
        seen(rig, client)  # else the first record may hold what was in force before
        client.call("record", to="on")
        client.call("enable")
        client.act("start", profile=SINE)
        # off and on in a motion: the second recording begins in its midst
        client.call("record", to="off")
        seen(rig, client)
        client.call("record", to="on")
        for change in (
            lambda: client.call("set", key=KEY, value=0.9),
            lambda: client.call("toggle", to="fb"),
            lambda: client.call("set", key="controller.integral_a_per_rev", value=9.0),
            lambda: client.call("toggle", to="off"),
            lambda: client.call("set", key=WIDTH, value=0.4),
            lambda: client.call("toggle", to="ff"),
        ):
            seen(rig, client)
            change()
        edit(rig.path, lambda axis: axis["controller"].update(proportional_a_per_rps=0.95, notches=[]))
        client.call("reload")  # in motion
        seen(rig, client)
        client.call("stop")
        client.act("start", profile=SHORT, wait_s=20)
        client.call("disable")

        # another model with an effect, while recording goes off and on
        client.call("record", to="off")
        client.call("model", text=model_with(rig, COGGING, name="other"), name="other.yaml")
        client.call("record", to="on")
        client.call("enable")
        client.act("start", profile=SINE)
        seen(rig, client)
        rig.node.tell(lambda node: node.drive.injected.add(OVERCURRENT))
        rig.until("fault", client)
        rig.node.tell(lambda node: node.drive.injected.clear())
        seen(rig, client)
        client.call("reset_fault")
        refused(lambda: client.act("start", profile=SHORT), "ready")
        client.call("enable")
        client.act("start", profile=SHORT, wait_s=20)
        client.call("quick_stop")
        files = [Path(name) for name in client.call("record", to="off")["files"]]
    first = sorted((tmp_path / "axis" / "runs").glob("*.mcap"))
    assert set(files) <= set(first)
    starts = [file for file in first if "continues" not in read_run(file).metadata]
    given = with_continuations(starts)
    assert sorted(given) == first
    runs = [read_run(file) for file in given]
    rows = np.concatenate([run.rows for run in runs])
    report = replay_files(given)
    assert report.exact, report
    assert report.all_rows == rows.size
    assert report.rows == (rows["mode"] == 1).sum() > 200
    alone = [replay_files([file]) for file in given if read_run(file).rows.size]
    assert all(one.exact or not one.rows for one in alone)  # each by itself, too, from its first row on
    assert all(one.all_rows == read_run(file).rows.size for one, file in zip(alone, given, strict=True))
    assert sum(run.rows["mode"][0] == MODE_VELOCITY for run in runs) >= 2  # begun by hand, and by rotation
    assert len({used.parameters for used in report.blocks}) >= 4
    assert len({used.model for used in report.blocks}) == 2
    assert report.profiles.other == 0
    assert (rows["trip"] != 0).any()
    assert (rows["resetting"] != 0).any()
    assert len(runs) > 2

    records = {record.sequence: record for run in runs for record in run.records}
    asked = [record.data for _, record in sorted(records.items()) if record.kind == RecordKind.REQUEST]
    assert {"set", "toggle", "reload", "start", "stop", "reset_fault", "quick_stop"} <= {one["what"] for one in asked}
    assert {"key": KEY, "value": 0.9} in [one["values"] for one in asked]
    assert all(str(one["who"]).startswith("pid") or "uid" in str(one["who"]) for one in asked)
    # what somebody asked for stands in front of what came of it
    numbers = sorted(records)
    change = next(n for n in numbers if records[n].data.get("values") == {"key": KEY, "value": 0.9})
    after = next(n for n in numbers if n > change and records[n].kind == RecordKind.PARAMETERS)
    assert records[after].by_name["pi.proportional_a_per_rps"] == 0.9
    notched = [
        record.by_name["notches.used"] for _, record in sorted(records.items()) if record.kind == RecordKind.PARAMETERS
    ]
    assert notched[0] == 1.0
    assert notched[-1] == 0.0


def test_a_quota_deletes_the_service_s_own_oldest_files_tells_it_and_stops_nothing(tmp_path):
    with Rig(tmp_path, record_required=True) as rig:
        limits = {"rotate_s": 1.0, "rotate_bytes": None, "quota_bytes": 1_000_000, "compression": "none"}
        edit(rig.path, lambda axis: axis["recording"].update(limits))
        client = rig.client()
        rig.until("ready", client)
        client.call("reload")
        client.call("record", to="on")
        single = tmp_path / "axis" / "runs" / "a_single_run.mcap"
        write_run(single, random_rows(2000))
        client.call("enable")

        def deleted(status):
            assert status["state"] == "enabled"
            assert not status["recording"]["trouble"]
            told = [event["text"] for event in client.call("events")["events"]]
            return status["recording"]["disk_life"] and any(text.startswith(DELETED) for text in told)

        status = rig.until_status(deleted, client)
        assert "with the quota of 1 MB the last " in status["recording"]["disk_life"]["text"]
        assert 0 < status["recording"]["disk_life"]["bytes_per_s"] < 1e6
        client.call("disable")
        files = [Path(name) for name in client.call("record", to="off")["files"]]
    left = [file for file in files if file.exists()]
    assert left == files[len(files) - len(left) :]  # the youngest
    assert 2 <= len(left) < len(files)
    assert sum(file.stat().st_size for file in left) < 1_500_000
    assert read_run(single).rows.size == 2000
    assert all(replay_files([file]).all_rows == read_run(file).rows.size for file in left)
