"""What the drive says reaches the people: faults, warnings, why it is not enabled, a brake that opens late."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from daemon.rig import RATE_HZ, Rig, edit
from daemon.test_faults import goes_on, running

from fffo_drive.can.frame import pack_frame
from fffo_drive.canopen_node.nmt import NmtState
from fffo_drive.daemon.client import CallError
from fffo_drive.drive.simulated.node.faults import Fault, FaultKind
from fffo_drive.recording.reader import read_run

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]

REMOTE, FOLLOWS = 0x0200, 0x1000


def rig_with(directory, *, faults=(), daemon=None, **drive):
    """A rig whose axis file has these keys in its drive section."""
    rig = Rig(directory, faults=faults, **(daemon or {}))
    edit(rig.path, lambda axis: axis["drive"].update(drive))
    return rig


def without_bits(bits):
    """A drive whose statusword never has these bits."""

    def change(node):
        statusword = node.drive._statusword
        node.drive._statusword = lambda: statusword() & ~bits
        node.drive.update()

    return change


def test_a_fault_has_the_drives_words_in_status_log_and_recording(tmp_path):
    with Rig(tmp_path) as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("record", to="on")
        client.call("enable")
        client.act("start", profile="default")
        rig.node.tell(lambda node: node.faults.inject(Fault(FaultKind.OVERCURRENT)))
        status = rig.until_status(lambda s: s["fault"] and "0x6079" in s["fault"]["text"], client)
        text = status["fault"]["text"]
        assert status["fault"]["name"] in ("emergency", "drive_fault")
        assert "EMCY 0x2310 (continuous over-current at the output), error register 0x03 (generic, current)" in text
        assert text.count("0x2310") == 1  # not again from 0x603F and 0x1003
        assert "statusword 0x" in text
        assert " V (0x6079)" in text
        assert any("last statusword received 0x" in event["text"] for event in rig.events("fault"))
        assert any(event["text"].startswith("the drive says: EMCY 0x2310") for event in rig.events("drive"))
        (file,) = client.call("record", to="off")["files"]
    said = [event.text for event in read_run(file).events]
    assert any(text.startswith("the drive says: EMCY 0x2310") for text in said)


def test_a_drive_that_left_operational_is_asked_anew_and_its_heartbeat_corrects(tmp_path):
    """What was received last is not what it is now: the text says which is which."""
    with Rig(tmp_path) as rig:
        client = running(rig)
        rig.node.tell(lambda node: node.nmt.enter(NmtState.PRE_OPERATIONAL))
        rig.until_status(lambda s: s["fault"] and "last statusword" in s["fault"]["text"], client)
        asked = "NMT state pre-operational (its heartbeat)"
        status = rig.until_status(lambda s: s["fault"] and asked in s["fault"]["text"], client)
        text = status["fault"]["text"]
        assert "; statusword 0x02" in text
        assert "last statusword received 0x1237: operation enabled" in text
        assert "statusword 0x1237" not in text.replace("last statusword received 0x1237", "")
        rig.until_status(lambda s: "heartbeat says: pre-operational" in str(rig.events("drive")), client)


def test_an_emergency_that_only_warns_is_an_event_and_the_axis_goes_on(tmp_path):
    with rig_with(tmp_path, warning_codes=[0xFF00]) as rig:
        client = running(rig)
        rig.node.tell(lambda node: rig.node._send([pack_frame(0x081, struct.pack("<HB5s", 0xFF00, 0, b"\x07"))]))
        status = rig.until_status(lambda s: s["loop"]["exchange"]["warning_count"] == 1, client)
        assert status["loop"]["exchange"]["emergency_count"] == 0
        goes_on(rig, client)
        (event,) = [event for event in rig.events("drive") if "warns" in event["text"]]
        assert event["text"].startswith("the drive warns: EMCY 0xFF00 (the vendor's own), error register 0x00")
        assert event["text"].endswith("vendor bytes 07 00 00 00 00")
        assert event["level"] == "warning"


def test_the_warning_bit_is_an_event(tmp_path):
    with Rig(tmp_path) as rig:
        client = running(rig)

        def warn(node):
            statusword = node.drive._statusword
            node.drive._statusword = lambda: statusword() | 0x80
            node.drive.update()

        rig.node.tell(warn)
        rig.until_status(lambda s: s["drive"]["statusword"] & 0x80, client)
        goes_on(rig, client)
        (event,) = [event for event in rig.events("drive") if "warns" in event["text"]]
        assert event["text"] == "the drive warns: statusword bit 7"


def test_a_drive_that_is_not_enabled_says_what_holds_it(tmp_path):
    deaf = Fault(FaultKind.NO_RPDO)
    with rig_with(tmp_path, faults=(deaf,), daemon={"enable_timeout_s": 0.3}) as rig:
        client = rig.client()
        rig.until("ready", client)
        with pytest.raises(CallError) as refused:
            client.call("enable")
        text = str(refused.value)
        assert "the drive did not reach Operation Enabled in time (" in text
        assert "0x603F says no error" in text
        assert "statusword 0x0250: switch on disabled" in text
        assert " V (0x6079)" in text
        assert any("did not reach Operation Enabled" in event["text"] for event in rig.events("state"))
        assert client.call("status")["fault"] is None


def test_a_drive_in_local_control_is_not_enabled_and_says_why(tmp_path):
    with Rig(tmp_path) as rig:
        client = rig.client()
        rig.until("ready", client)
        rig.node.tell(without_bits(REMOTE))
        status = rig.until("connected", client)
        assert "statusword bit 9 is 0" in status["obstacles"][0]
        with pytest.raises(CallError, match=r"drive.unserved_status_bits: \[9\]"):
            client.call("enable")


def test_a_drive_that_does_not_follow_is_stopped_and_one_that_never_says_it_is_not(tmp_path):
    with Rig(tmp_path / "one") as rig:
        client = running(rig)
        rig.node.tell(without_bits(FOLLOWS))
        status = rig.until("fault", client)
        assert status["fault"]["name"] == "not_following"
        assert "drive.unserved_status_bits: [12]" in status["fault"]["text"]
        assert "bit 12 is 0: the drive ignores the target torque" in status["fault"]["text"]
    with rig_with(tmp_path / "other", unserved_status_bits=[12]) as rig:
        rig.node.tell(without_bits(FOLLOWS))
        client = running(rig)
        rig.until_status(lambda s: s["profile"] and s["profile"]["sample"] > RATE_HZ, client)
        goes_on(rig, client)


def test_the_profile_waits_until_the_brake_is_open(tmp_path):
    delay_s = 0.5
    with rig_with(tmp_path, enable_delay_s=delay_s) as rig:
        client = rig.client()
        rig.until("ready", client)
        client.call("record", to="on")
        client.call("enable")
        client.act("start", profile="default")
        rig.until_status(lambda s: s["profile"] and s["profile"]["sample"] > 50, client)
        client.call("disable")
        (file,) = client.call("record", to="off")["files"]
    rows = read_run(file).rows
    enabled = between_rows(rows, rows["statusword"] & 0x6F == 0x27)
    acting = between_rows(rows, rows["mode"] == 1)
    wait = round(delay_s * RATE_HZ)
    assert set(acting) & {tick + wait for tick in enabled}
    assert int(rows["tick"][rows["profile_sample"] >= 0][0]) >= acting[-1]


def between_rows(rows, where):
    """The ticks at which something may have begun that the first of these rows shows: skipped ticks have no row."""
    first = int(np.flatnonzero(where)[0])
    return range(int(rows["tick"][first - 1]) + 1, int(rows["tick"][first]) + 1)


def test_an_axis_is_disabled_at_once_while_its_brake_opens(tmp_path):
    with rig_with(tmp_path, enable_delay_s=10) as rig:
        client = rig.client()
        rig.until("ready", client)
        begin = client.call("status")["loop"]["tick"]
        client.call("enable")
        assert client.call("disable")["state"] == "ready"
        assert client.call("status")["loop"]["tick"] - begin < 10 * RATE_HZ  # it did not wait for the brake
        assert not [event for event in rig.events("state") if "too long" in event["text"]]
