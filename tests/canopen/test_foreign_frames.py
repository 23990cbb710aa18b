"""What somebody else sends in our name, or in the drive's, is noticed with the frame; what we send never is."""

import dataclasses
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_canopen_cyclic import NODE, Bench, bench  # noqa: F401  a fixture

from fffo_drive.can.bpf import CanFilter
from fffo_drive.can.frame import REMOTE_FLAG, STANDARD_MASK, pack_frame
from fffo_drive.can.link import open_link
from fffo_drive.drive.canopen.cyclic import BESIDE_RPDO, LOST_TICKS, SILENT_TICKS, WITHDRAWAL_EVERY
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.canopen.listening import foreign_text, masters_frames
from fffo_drive.drive.canopen.receiving import SECOND_BURST, SECOND_EVERY
from fffo_drive.drive.canopen.service import Service, service_filters
from fffo_drive.drive.port import port_command, port_housekeeping

OURS = [0x000, 0x080, 0x205, 0x305, 0x405, 0x505, 0x605, 0x77F]
SDO, PRE_OPERATIONAL = 0x600 + NODE, (0x000, bytes([0x80, NODE]))
ZERO_TARGET = (SDO, bytes.fromhex("2b71600000000000"))


def same_controlword(word):
    return SDO, struct.pack("<BHBHxx", 0x2B, 0x6040, 0, word)


def test_the_list_is_the_one_that_listening_uses(bench):  # noqa: F811
    assert sorted(masters_frames(bench.config)) == OURS


@pytest.mark.parametrize("can_id", OURS)
def test_each_frame_of_ours_from_somebody_else_is_counted_and_named_with_the_first(bench, can_id):  # noqa: F811
    bench.sync()
    assert (bench.count("foreign_frames"), bench.count("foreign_id")) == (0, -1)
    bench.say(can_id, bytes(1))
    bench.say(0x080)
    bench.sync()
    assert (bench.count("foreign_frames"), bench.count("foreign_id")) == (2, can_id)
    assert f"0x{can_id:03X}" in foreign_text(bench.config, can_id)
    for other in ({"extended": True}, {"remote": True}):  # other identifiers, or no command
        bench.say(can_id, bytes(1), **other)
    bench.sync()
    assert bench.count("foreign_frames") == 2


def test_a_guarding_request_is_ours_where_the_drive_is_guarded():
    bench = Bench(silence_detection="life_guarding")  # noqa: F811
    assert REMOTE_FLAG | 0x700 + NODE in masters_frames(bench.config)
    bench.say(0x700 + NODE, bytes(1), remote=True)
    bench.sync()
    assert (bench.count("foreign_frames"), bench.count("foreign_id")) == (1, 0x700 + NODE)
    assert bench.count("bad_frames") == 0
    bench.close()


def test_what_the_service_sends_beside_the_loop_is_ours_and_one_more_is_not(bench):  # noqa: F811
    """It has a link of its own, which the loop's hears."""
    link = open_link(bench.config.bus, filters=service_filters(NODE))
    service = Service(link, NODE, bench.queue, 0.1, 1)
    for _ in range(3):
        service.command_nmt(0x80)
        service.send_message(SDO, bytes([0x40, 0, 0x10, 0, 0, 0, 0, 0]))
    bench.sync()
    assert bench.count("foreign_frames") == 0
    service.command_nmt(0x80)
    bench.say(0x200 + NODE, bytes(4))  # never beside the loop
    bench.say(0x000, bytes([0x80, NODE]))
    bench.sync()
    assert (bench.count("foreign_frames"), bench.count("foreign_id")) == (2, 0x200 + NODE)
    service.close()


def test_what_was_sent_before_the_link_was_open_is_not_waited_for(bench):  # noqa: F811
    bench.queue.count_aside(1)
    made = Bench()
    made.say(0x000, bytes([0x80, NODE]))
    made.sync()
    assert made.count("foreign_frames") == 1
    made.close()


def test_the_kernel_lets_through_what_the_loop_watches(bench):  # noqa: F811
    """As `_cyclic_filters` of a drive on AF_CAN."""
    drive = CanopenDrive(dataclasses.replace(bench.config, bus="socketcan:can0"))
    passing = drive._cyclic_filters()
    for word in masters_frames(bench.config):
        assert CanFilter(word & STANDARD_MASK) in passing


def answered_twice(bench, ticks, when):  # noqa: F811
    """So many ticks, with a second answer in those that `when` names."""
    for tick in range(ticks):
        bench.sync()
        bench.motion(1000)
        if when(tick):
            bench.motion(0)
        bench.receive()


def test_a_second_answer_now_and_then_is_told_and_no_fault(bench):  # noqa: F811
    answered_twice(bench, 3 * SECOND_EVERY, lambda tick: tick % SECOND_EVERY == 0)
    assert (bench.count("duplicate_feedback"), bench.count("foreign_frames")) == (3, 0)
    assert bench.count("foreign_id") == 0x180 + NODE
    assert foreign_text(bench.config, 0x180 + NODE) == f"feedback of node {NODE} (TPDO 0x185)"


def test_somebody_who_sends_our_feedback_too_is_a_fault_with_the_eleventh(bench):  # noqa: F811
    answered_twice(bench, SECOND_BURST, lambda tick: True)
    assert bench.count("foreign_frames") == 0
    answered_twice(bench, 1, lambda tick: True)
    assert bench.count("foreign_frames") == 1


def test_a_drive_that_answers_many_syncs_late_and_at_once_owes_them(bench):  # noqa: F811
    """A simulated drive on a loaded machine: it sleeps, then answers all that it has heard, over two ticks."""
    for _ in range(3):
        answered_twice(bench, SECOND_BURST, lambda tick: False)
        for _ in range(3 * SECOND_BURST):
            bench.sync()
            assert bench.receive() == 0
        for late in (SECOND_BURST, 2 * SECOND_BURST + 1):
            bench.sync()
            for _ in range(late):
                bench.motion()
            assert bench.receive() == 1
        bench.sync()
        bench.motion()
        bench.receive()
    assert (bench.count("duplicate_feedback"), bench.count("foreign_frames")) == (0, 0)


def test_a_drive_that_catches_up_for_longer_than_a_loss_is_remembered_is_nobody_else(bench):  # noqa: F811
    """It slept for 200 ms, and makes up for them with two answers a tick."""
    for _ in range(8 * LOST_TICKS):
        bench.sync()
        bench.receive()
    for late in [2] * 8 * LOST_TICKS + [1] * LOST_TICKS:
        bench.sync()
        for _ in range(late):
            bench.motion()
        bench.receive()
    assert (bench.count("duplicate_feedback"), bench.count("foreign_frames")) == (0, 0)


def test_an_answer_that_was_lost_is_owed_no_longer_once_the_drive_answers_again(bench):  # noqa: F811
    for _ in range(SECOND_BURST):
        bench.sync()
        bench.receive()
    answered_twice(bench, LOST_TICKS + 2, lambda tick: False)
    answered_twice(bench, 1, lambda tick: True)
    assert bench.count("duplicate_feedback") == 1


@settings(max_examples=25, deadline=None)
@given(st.sets(st.integers(0, 199), max_size=SECOND_BURST))
def test_no_burst_that_is_allowed_is_a_fault(ticks):
    made = Bench()
    answered_twice(made, 200, ticks.__contains__)
    assert (made.count("duplicate_feedback"), made.count("foreign_frames")) == (len(ticks), 0)
    made.close()


def tripped(bench, ticks, answers=True, statusword=0x0217):  # noqa: F811
    """The slots after the command of so many ticks of a latched fault: what goes out, beside our heartbeat."""
    found = []
    for _ in range(ticks):
        bench.sync()
        if answers:
            bench.motion()
            bench.status(statusword)
        bench.receive()
        port_command(bench.port, bench.tick, 0x0002, 0.0)
        bench.heard()
        port_housekeeping(bench.port, bench.tick, True)
        found += [[(frame.can_id, frame.data) for frame in bench.heard() if frame.can_id != 0x77F]]
    return found


def test_after_a_fault_a_drive_that_answers_hears_the_stop_by_sdo_too_and_once(bench):  # noqa: F811
    said = tripped(bench, 3 * WITHDRAWAL_EVERY)
    assert said[:BESIDE_RPDO] == [[ZERO_TARGET], [same_controlword(0x0002)]]
    assert not any(said[BESIDE_RPDO:])
    bench.sync()
    port_housekeeping(bench.port, bench.tick, False)
    bench.heard()
    assert tripped(bench, 1) == [[ZERO_TARGET]]  # the next fault


def test_a_drive_that_does_not_answer_is_told_by_nmt_as_well_and_again(bench):  # noqa: F811
    for _ in range(SILENT_TICKS):
        bench.sync()
    said = tripped(bench, 2 * WITHDRAWAL_EVERY, answers=False)
    once = [[ZERO_TARGET], [same_controlword(2)], [PRE_OPERATIONAL], [ZERO_TARGET], [same_controlword(2)]]
    once += [[]] * (WITHDRAWAL_EVERY - len(once))
    assert said == [*once, *once]


def test_a_drive_that_misses_a_tick_is_not_silent(bench):  # noqa: F811
    tripped(bench, 1)
    assert [PRE_OPERATIONAL] not in tripped(bench, SILENT_TICKS, answers=False)


def test_a_drive_in_fault_that_answers_late_can_still_hear_a_reset(bench):  # noqa: F811
    tripped(bench, 1, statusword=0x0218)
    assert [PRE_OPERATIONAL] not in tripped(bench, 2 * WITHDRAWAL_EVERY, answers=False)


def test_a_drive_that_says_that_it_is_not_operational_is_told_like_one_that_is_silent(bench):  # noqa: F811
    bench.say(0x700 + NODE, b"\x7f")
    assert [PRE_OPERATIONAL] in tripped(bench, 5)


def test_a_drive_that_is_enabled_in_spite_of_it_is_made_deaf_to_commands(bench):  # noqa: F811
    said = tripped(bench, 2 * WITHDRAWAL_EVERY, statusword=0x1237)
    assert [PRE_OPERATIONAL] not in said[:WITHDRAWAL_EVERY]
    assert [PRE_OPERATIONAL] in said[WITHDRAWAL_EVERY:]


def test_a_service_frame_waits_for_the_withdrawal(bench):  # noqa: F811
    bench.queue.put(pack_frame(SDO, bytes(8)))
    said = tripped(bench, BESIDE_RPDO + 2)
    assert said[:BESIDE_RPDO] == [[ZERO_TARGET], [same_controlword(0x0002)]]
    assert [(SDO, bytes(8))] in said[BESIDE_RPDO:]


def test_an_answer_to_the_loops_own_request_is_no_second_node(bench):  # noqa: F811
    link = open_link(bench.config.bus, filters=service_filters(NODE))
    service = Service(link, NODE, bench.queue, 0.1, 1, loop_writes=frozenset({(0x6040, 0), (0x6071, 0)}))
    tripped(bench, BESIDE_RPDO)
    for frame in ("6071600000000000", "6040600000000000"):
        bench.say(0x580 + NODE, bytes.fromhex(frame))
    assert service.wait_until(lambda: service._responses == BESIDE_RPDO, 2.0)
    service.check_one_node()
    assert service._client.responses.empty()  # nobody waits for them
    service.close()
