"""Wireshark's CANopen dissector on everything that was on the bus in a whole run: nothing is malformed, and no frame is
taken for something else than we meant."""

from __future__ import annotations

import subprocess
from collections import Counter
from pathlib import Path

import pytest
from buses import write_pcap
from uml.whole_run import NODE_ID, WholeRun

from fffo_drive.can.frame import Frame, unpack_frame

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.tshark]

FIELDS = (
    "_ws.col.Protocol", "can.id", "canopen.node_id", "canopen.nmt_ctrl.cd", "canopen.nmt_ctrl.node_id",
    "canopen.nmt_guard.state", "canopen.sdo.ccs", "canopen.sdo.scs", "canopen.sdo.main_idx", "canopen.sdo.sub_idx",
    "canopen.sdo.abort_code", "canopen.em.err_code", "canopen.pdo.data.bytes", "_ws.malformed", "_ws.expert.message",
    "_ws.col.Info",
)  # fmt: skip
NMT_TEXTS = {0x81: "Reset node", 0x82: "Reset communication", 0x01: "Start remote node", 0x80: "Enter pre-operational"}
BOOT_UP, OPERATIONAL, PRE_OPERATIONAL = 0x00, 0x05, 0x7F
STATE_TEXTS = {BOOT_UP: "Boot-up", OPERATIONAL: "Operational", PRE_OPERATIONAL: "Pre-operational"}
MASTER_ID = 127


def dissect(path: Path) -> list[dict[str, str]]:
    """The fields of each frame."""
    command = ["tshark", "-r", str(path), "-d", "can.subdissector,canopen", "-T", "fields", "-E", "separator=\t"]
    for field in FIELDS:
        command += ["-e", field]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [dict(zip(FIELDS, line.split("\t"), strict=True)) for line in output.splitlines()]


@pytest.fixture(scope="module")
def dissected(whole_run: WholeRun, tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Frame, dict[str, str]]]:
    """Each frame as we know it, and as Wireshark reads it."""
    path = tmp_path_factory.mktemp("pcap") / "run.pcap"
    write_pcap(path, whole_run.frames)
    rows = dissect(path)
    assert len(rows) == len(whole_run.frames)
    return [(unpack_frame(frame.raw), row) for frame, row in zip(whole_run.frames, rows, strict=True)]


def number(text: str) -> int:
    return int(text, 0)


def of_kind(dissected, base: int) -> list[tuple[Frame, dict[str, str]]]:
    return [(frame, row) for frame, row in dissected if frame.can_id & ~0x7F == base and frame.can_id & 0x7F]


def test_every_frame_is_canopen_and_none_is_malformed(dissected):
    for frame, row in dissected:
        assert row["_ws.col.Protocol"] == "CANopen", (frame, row)
        assert number(row["can.id"]) == frame.can_id
        assert row["_ws.malformed"] == "", row
        assert row["_ws.expert.message"] == "", row


def test_nmt_commands_are_the_ones_of_a_bring_up_and_an_end(dissected):
    commands = [row for frame, row in dissected if frame.can_id == 0]
    assert all(number(row["canopen.nmt_ctrl.node_id"]) == NODE_ID for row in commands)
    specifiers = [number(row["canopen.nmt_ctrl.cd"]) for row in commands]
    assert specifiers == [0x81, 0x82, 0x80, 0x01, 0x80]  # a node may start itself after its reset
    for row, specifier in zip(commands, specifiers, strict=True):
        assert f"nmt: {NMT_TEXTS[specifier]}".lower() in row["_ws.col.Info"].lower()


def test_the_drives_states_follow_the_commands(dissected):
    """Between two commands each heartbeat says what the last one asked for."""
    meant: set[int] = set()
    seen: list[int] = []
    for frame, row in dissected:
        if frame.can_id == 0:
            meant = {0x81: {0, 0x7F}, 0x82: {0, 0x7F}, 0x01: {0x7F, 0x05}, 0x80: {0x05, 0x7F, 0}}[frame.data[0]]
        elif frame.can_id == 0x700 + NODE_ID and meant:
            state = number(row["canopen.nmt_guard.state"])
            assert state in meant
            assert STATE_TEXTS[state].lower() in row["_ws.col.Info"].lower()
            if not seen or seen[-1] != state:
                seen.append(state)
    # it booted twice; a heartbeat may fall between boot-up and start, and comes 20 times a second afterwards
    assert [state for state in seen if state != PRE_OPERATIONAL] in (
        [BOOT_UP, OPERATIONAL],
        [BOOT_UP] * 2 + [OPERATIONAL],
    )


def test_our_heartbeat_says_operational(dissected):
    states = [row["canopen.nmt_guard.state"] for frame, row in dissected if frame.can_id == 0x700 + MASTER_ID]
    assert states
    assert {number(state) for state in states} == {0x05}


def test_every_sdo_request_has_its_response_for_the_same_object_and_none_is_refused(dissected):
    requests = of_kind(dissected, 0x600)
    responses = of_kind(dissected, 0x580)
    assert len(requests) == len(responses) > 60
    initiating = {1, 2}  # download and upload
    for (_, request), (_, response) in zip(requests, responses, strict=True):
        if request["canopen.sdo.ccs"] and number(request["canopen.sdo.ccs"]) in initiating:
            assert request["canopen.sdo.main_idx"] == response["canopen.sdo.main_idx"]
            assert request["canopen.sdo.sub_idx"] == response["canopen.sdo.sub_idx"]
    aborts = [row for _, row in responses if row["canopen.sdo.abort_code"]]
    # the first PDO that the drive does not have ends the search for those to be switched off
    assert [number(row["canopen.sdo.main_idx"]) for row in aborts] == [0x1404, 0x1804], aborts


def test_pdos_go_the_way_that_they_should(dissected):
    info = Counter(row["_ws.col.Info"].split("  ")[0] for _, row in dissected)
    assert info["PDO1 (rx)"] == sum(frame.can_id == 0x201 for frame, _ in dissected)
    assert info["PDO1 (tx)"] == sum(frame.can_id == 0x181 for frame, _ in dissected)
    assert info["SYNC"] == sum(frame.can_id == 0x080 for frame, _ in dissected)
    for frame, row in dissected:
        if frame.can_id in (0x181, 0x201):
            assert bytes.fromhex(row["canopen.pdo.data.bytes"].replace(":", "")) == frame.data


def test_there_is_no_emergency(dissected):
    assert not [row for _, row in dissected if row["canopen.em.err_code"]]
