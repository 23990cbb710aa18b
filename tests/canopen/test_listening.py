"""Who else is on the bus: what is named, what is not taken for a master, and that nothing is sent before."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import threading

import pytest
from buses import PATIENCE_S, BusLog, one_bus
from hypothesis import given
from hypothesis import strategies as st
from scripted_node import ScriptedNode

from fffo_drive.can.frame import Frame, pack_frame, unpack_frame
from fffo_drive.can.lease import LONGEST_COMMAND, BusHeldError, BusLease, bus_holder
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.drive.canopen.config import CanopenDriveConfig
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.canopen.listening import Heard, Listening, masters_frames
from fffo_drive.drive.canopen.object_map import command_pdo
from fffo_drive.drive.port import BusOccupiedError, port_command, port_sync

NODE, MASTER = 5, 127
CONFIG = CanopenDriveConfig(
    bus="loopback:20000", node_id=NODE, period_ns=500_000, counts_per_rev=32768, velocity_units_per_rps=1000.0,
    torque_constant_nm_per_a=0.1, rated_torque_nm=1.0, listen_s=0.02, answer_timeout_s=1.0, start_timeout_s=1.0,
)  # fmt: skip


@pytest.fixture(params=["loopback", pytest.param("vcan", marks=pytest.mark.vcan)])
def config(request):
    return dataclasses.replace(CONFIG, bus=one_bus(request.param))


def frame_of(text):
    """`705#7F`, as candump writes it; `185#R` is a remote frame, eight digits are an identifier of 29 bits."""
    can_id, _, data = text.partition("#")
    remote = data.startswith("R")
    return Frame(int(can_id, 16), b"" if remote else bytes.fromhex(data), len(can_id) == 8, remote)


def obstacles(script, config=CONFIG):
    heard = Heard(config)
    for text in script.split():
        heard.take(frame_of(text))
    return [obstacle.text for obstacle in heard.obstacles()]


@pytest.mark.parametrize(
    ("script", "sign"),
    [
        ("080#", "SYNC (0x080)"),
        ("080#01", "SYNC (0x080)"),  # with a counter
        ("000#0101", "NMT commands (0x000)"),
        ("000#8200", "NMT commands (0x000)"),
        ("605#4000100000000000", "SDO requests to node 5 (0x605)"),
        ("205#0F000000", "commands to node 5 (RPDO 0x205)"),
        ("505#00", "commands to node 5 (RPDO 0x505)"),
        ("77F#05", "the heartbeat of node 127 (0x77F), which is ours (drive.master_id)"),
        ("77F#00", "the heartbeat of node 127 (0x77F), which is ours (drive.master_id)"),
    ],
)
def test_each_sign_of_another_master_is_named(script, sign):
    for around in ("{}", "705#7F {} 185#0000000000000000 705#7F", "{0} {0} {0}"):
        assert obstacles(around.format(script)) == [f"somebody else commands here: {sign}"]


def test_all_signs_are_named_at_once_and_in_one_order():
    said = "somebody else commands here: SYNC (0x080), NMT commands (0x000), commands to node 5 (RPDO 0x205)"
    assert obstacles("080# 000#0100 205#0600") == obstacles("205#0600 080# 000#0100 080#") == [said]


@pytest.mark.parametrize(
    "script",
    [
        "",
        "705#7F 705#7F 085#3081110000000000 185#0000000000000000 385#4002",  # our drive, as an earlier run left it
        "705#00 705#7F 705#05",  # it starts by itself
        "705#05 705#00 705#7F 705#05",  # it restarts
        "705#05 705#85 705#05",  # with the toggle bit of node guarding
        "585#4B41600000000000 585#4B41600000000000",  # answers that come too late for a former connection
        "701#05 77E#7F 601#4000100000000000 201#0F00 081#0000000000000000",  # others, and who reads or drives them
        "100#000000000000 7E4#00",  # TIME, LSS
        "00000080# 80000605#00 080#R 705#R 605#R 000#R",  # 29 bits, remote
    ],
)
def test_what_is_no_master_is_no_obstacle(script):
    assert obstacles(script) == []


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("705#05 705#7F 705#05", "pre-operational and operational in turn"),
        ("705#7F 705#05 705#05 705#7F 705#05", "pre-operational and operational in turn"),
        ("705#00 705#7F 705#04 705#7F", "stopped and pre-operational in turn"),
        ("705#05 705#33 705#05", "state 0x33 and operational in turn"),
        ("705#00 705#00", "2 boot-up messages"),
    ],
)
def test_two_nodes_with_the_drives_id_that_disagree_are_named(script, said):
    assert obstacles(script) == [f"node 5 says {said}"]
    assert obstacles(script.replace("705", "706")) == []  # other nodes are not our matter


def test_commands_are_those_of_the_mapping_and_answers_are_no_commands():
    answers = (*CONFIG.answers[:2], CONFIG.answers[2]._replace(cob_id=0x405))
    mapped = dataclasses.replace(CONFIG, rpdo=command_pdo(NODE)._replace(cob_id=0x321), tpdos=answers)
    assert obstacles("321#0600", mapped) == ["somebody else commands here: commands to node 5 (RPDO 0x321)"]
    assert obstacles("205#0600", mapped) == ["somebody else commands here: commands to node 5 (RPDO 0x205)"]
    assert obstacles("405#0600", mapped) == []
    assert obstacles("321#0600") == []


OURS = st.one_of(
    st.sampled_from(
        [0x085, 0x185, 0x285, 0x385, 0x485, 0x585, 0x100, 0x701, 0x77E, 0x086, 0x205 + 1, 0x605 + 1, 0x7E4]
    ),
    st.integers(0x700, 0x7FF).filter(lambda can_id: can_id not in (0x700 + NODE, 0x700 + MASTER)),
)
QUIET_FRAMES = st.one_of(
    st.builds(Frame, OURS, st.binary(max_size=8)),
    st.builds(Frame, st.integers(0, 0x1FFF_FFFF), st.binary(max_size=8), st.just(True)),
    st.builds(Frame, st.integers(0, 0x7FF), st.just(b""), st.just(False), st.just(True)),
    st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8), st.just(False), st.just(False), st.just(True)),
    st.just(Frame(0x700 + NODE, b"\x7f")),
)


@given(st.lists(QUIET_FRAMES), st.integers(0, 40), st.binary(max_size=1))
def test_no_traffic_of_drives_is_an_alarm_and_every_foreign_sync_is_named(frames, place, counter):
    def said(heard_frames):
        heard = Heard(CONFIG)
        for frame in heard_frames:
            heard.take(frame)
        return [obstacle.text for obstacle in heard.obstacles()]

    assert said(frames) == []
    with_sync = [*frames[:place], Frame(0x080, counter), *frames[place:]]
    assert said(with_sync) == ["somebody else commands here: SYNC (0x080)"]


def test_nothing_is_sent_where_somebody_else_commands_and_it_connects_once_that_one_is_gone(config):
    stop = threading.Event()

    def master():
        with open_link(config.bus) as link:
            while not stop.wait(0.002):
                link.send(pack_frame(0x080))

    thread = threading.Thread(target=master)
    with ScriptedNode(config.bus, NODE):
        thread.start()
        try:
            drive = CanopenDrive(config)
            with BusLog(config.bus) as log, pytest.raises(BusOccupiedError) as refused:
                drive.connect()
        finally:
            stop.set()
            thread.join()
        assert str(refused.value).startswith(
            f"{config.bus}: somebody else commands here: SYNC (0x080): one bus has one"
        )
        assert "several axes on one bus under one SYNC are not built yet" in str(refused.value)
        assert {unpack_frame(frame.raw).can_id for frame in log.frames} == {0x080}
        drive.connect()
        drive.close()


def test_what_was_heard_while_other_work_was_done_counts(config):
    """The kernel keeps the frames from `listen` on."""
    with open_link(config.bus) as other:
        drive = CanopenDrive(config)
        drive.listen()
        other.send(pack_frame(0x000, b"\x01\x00"))
        with pytest.raises(BusOccupiedError, match="NMT commands"):
            drive.connect()
        assert bus_holder(config.bus) is None


def test_a_bus_is_heard_until_its_time_is_over(config):
    listening = Listening(config, 0.2)
    with open_link(config.bus) as other:
        thread = threading.Timer(0.05, lambda: other.send(pack_frame(0x080)))
        thread.start()
        assert len(listening.heard().obstacles()) == 1
        thread.join()
    listening.close()


def test_one_master_a_bus_on_this_machine(config):
    with ScriptedNode(config.bus, NODE) as node:
        first, second = CanopenDrive(config), CanopenDrive(dataclasses.replace(config, node_id=NODE + 1))
        first.listen()
        heard = len(node.heard)
        with pytest.raises(BusOccupiedError, match=r"process \d+ .* on this machine commands there: one bus has one"):
            second.connect()
        assert len(node.heard) == heard
        first.connect()
        with pytest.raises(BusOccupiedError):
            second.listen()
        first.close()
        second.listen()
        second.close()


def test_the_lease_is_of_one_bus_and_ends_with_its_process():
    bus = f"loopback:{free_loopback_port()}"
    program = f"import time; from fffo_drive.can.lease import BusLease; l = BusLease({bus!r}); print(); time.sleep(600)"
    holder = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    assert holder.stdout is not None
    try:
        holder.stdout.readline()
        assert bus_holder(bus) == f"process {holder.pid} ({f'-c {program}'[:LONGEST_COMMAND]}...)"
        with pytest.raises(BusHeldError, match=rf"process {holder.pid} \(-c import time; .*\) on this machine"):
            BusLease(bus)
        BusLease(f"{bus}0").close()
    finally:
        holder.kill()
        holder.wait(PATIENCE_S)
        holder.stdout.close()
    lease = BusLease(bus)
    lease.close()
    lease.close()
    assert bus_holder(bus) is None


def test_a_running_port_counts_what_others_send_in_our_name_and_never_our_own(config):
    """Neither its own frames, nor what the service has sent on its link since the port's was opened."""
    with ScriptedNode(config.bus, NODE), CanopenDrive(config) as drive, open_link(config.bus) as other:
        for tick in range(5):
            port_sync(drive.port, tick)
            port_command(drive.port, tick, 0, 0.0)
            drive.read_object(0x1000, 0)
        port_sync(drive.port, 5)
        assert drive.feedback["foreign_frames"][0] == 0
        for raw in (pack_frame(0x080), pack_frame(0x080, b"\x01"), pack_frame(0x080, remote=True), pack_frame(0x08F)):
            other.send(raw)
        other.send(pack_frame(0x080, extended=True))
        port_sync(drive.port, 6)
        port_sync(drive.port, 7)
        assert drive.feedback["foreign_frames"][0] == 2
        for can_id in masters_frames(config):
            other.send(pack_frame(can_id, bytes(8)))
        port_sync(drive.port, 8)
        assert drive.feedback["foreign_frames"][0] == 2 + len(masters_frames(config))
        assert "SYNC (0x080) from somebody else" in drive.fault_words(ask=False)
