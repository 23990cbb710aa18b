"""Who is on a bus: by literal frames, with a clock of its own."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.can.frame import Frame, pack_frame, unpack_frame
from fffo_drive.can.link import LinkError
from fffo_drive.drive.canopen import scan
from fffo_drive.drive.canopen.listening import Heard
from fffo_drive.drive.canopen.scan import NodeName, Roll, Sign, ask_every_node
from fffo_drive.drive.port import BusUnavailableError


def frame_of(text):
    """`705#7F`, as candump writes it."""
    can_id, _, data = text.partition("#")
    return Frame(int(can_id, 16), bytes.fromhex(data), len(can_id) == 8)


def signs(script):
    roll = Roll()
    for text in script.split():
        roll.take(frame_of(text))
    return {sign.node_id: sign for sign in roll.signs}


@pytest.mark.parametrize(
    ("script", "device_type", "drive"),
    [
        ("585#4300100092010200", 0x00020192, True),
        ("585#4300100092010000", 0x00000192, True),  # the type word is the vendor's
        ("585#4300100091010F00", 0x000F0191, False),  # an I/O device
        ("585#4F00100092000000", 0x92, False),  # in one byte
        ("585#4200100092010200", 0x00020192, True),  # no size indicated
        ("585#8000100000000206", None, False),  # it answers with an abort
        ("585#4100100004000000", None, False),  # in segments
    ],
)
def test_an_answer_tells_the_device_type(script, device_type, drive):
    found = signs(script)
    assert list(found) == [5]
    assert (found[5].answers, found[5].device_type, found[5].is_drive) == (1, device_type, drive)


def test_two_answers_to_one_request_are_counted_and_a_stray_one_is_not():
    assert signs("585#4300100092010200 585#4300100092010200")[5].answers == 2
    assert signs("585#4B41600050020000") == {}  # of another object, to somebody else


def test_heartbeats_boot_ups_and_emergencies_tell_of_nodes_that_say_nothing_else():
    found = signs("705#04 703#00 703#7F 086#3081010000000000 701#05")
    assert [(node, sign.state_name) for node, sign in found.items()] == [
        (1, "operational"), (3, "pre-operational"), (5, "stopped"), (6, ""),
    ]  # fmt: skip
    assert found[6].emergencies[0].code == 0x8130
    assert all(sign.answers == 0 for sign in found.values())


@given(st.lists(st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans())))
def test_no_traffic_makes_a_node_that_did_not_send(frames):
    roll = Roll()
    for frame in frames:
        roll.take(frame)
    senders = {frame.can_id & 0x7F for frame in frames if not frame.extended}
    assert {sign.node_id for sign in roll.signs} <= senders - {0}


class ScriptedLink:
    """Answers of nodes, each a while after it was asked; time passes in `receive` alone."""

    def __init__(self, answers, delay_s):
        self.answers, self.delay_s = answers, delay_s
        self.now_s = 0.0
        self.sent = []
        self._coming = []

    def send(self, raw):
        frame = unpack_frame(raw)
        self.sent.append((self.now_s, frame.can_id, frame.data))
        self._coming += [(self.now_s + self.delay_s, text) for text in self.answers.get(frame.can_id - 0x600, [])]

    def receive(self, timeout_s):
        if self._coming and self._coming[0][0] <= self.now_s + timeout_s:
            self.now_s, text = max(self.now_s, self._coming[0][0]), self._coming.pop(0)[1]
            frame = frame_of(text)
            return pack_frame(frame.can_id, frame.data)
        self.now_s += timeout_s
        return None


def test_every_id_is_asked_once_with_time_between_and_the_slowest_node_is_waited_for():
    link = ScriptedLink({1: ["581#4300100092010200"], 127: ["5FF#4300100091010F00"]}, delay_s=0.25)
    roll, asked = Roll(), []
    ask_every_node(link, roll, progress=asked.append, clock=lambda: link.now_s)
    assert asked == list(range(1, 128))
    assert [can_id for _, can_id, _ in link.sent] == list(range(0x601, 0x680))
    assert {data for _, _, data in link.sent} == {bytes.fromhex("4000100000000000")}
    times = [time_s for time_s, _, _ in link.sent]
    assert min(b - a for a, b in itertools.pairwise(times)) == pytest.approx(scan.PACE_S)
    assert [(sign.node_id, sign.is_drive) for sign in roll.signs] == [(1, True), (127, False)]


def test_an_interface_that_goes_away_is_a_bus_that_is_not_there():
    class Gone(ScriptedLink):
        def send(self, raw):
            raise LinkError("socketcan:can0: cannot send: it is down")

    with pytest.raises(BusUnavailableError, match="it is down"):
        ask_every_node(Gone({}, 0.0), Roll())


def test_a_node_is_named_in_one_line():
    node = NodeName(3, 0x00020192, "operational", "EPOS4", "0x6551", "0x0170", 0xFB, 1, 2, 12345)
    assert node.text == (
        "node 3: EPOS4, CiA 402 drive, maxon, serial 12345, hardware 0x6551, software 0x0170, operational"
    )
    assert "vendor 0x0000ABCD" in NodeName(3, 0x191, "", vendor_id=0xABCD).text
    assert "device profile 401" in NodeName(3, 0x191, "").text


def test_who_answers_twice_or_not_at_all_is_not_asked_for_names():
    def no_link(node_id):
        raise AssertionError("nobody is asked")

    assert "two nodes have this id" in scan.name_node(Sign(5, answers=2), no_link).remark
    assert "it is stopped" in scan.name_node(Sign(5, nmt_state=4), no_link).remark


# -- listening before any node is chosen


def obstacles(script):
    heard = Heard()
    for text in script.split():
        heard.take(frame_of(text))
    return [obstacle.text for obstacle in heard.obstacles()]


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("080#", "somebody else commands here: SYNC (0x080)"),
        ("000#0105", "somebody else commands here: NMT commands (0x000)"),
        ("607#4000100000000000", "somebody else commands here: SDO requests to node 7 (0x607)"),
        ("203#0F00", "somebody else commands here: commands to node 3 (RPDO 0x203)"),
        ("57F#0F00", "somebody else commands here: commands to node 127 (RPDO 0x57F)"),
        ("709#05 709#7F 709#05", "node 9 says pre-operational and operational in turn"),
        ("709#00 709#00", "node 9 says 2 boot-up messages"),
    ],
)
def test_whoever_commands_any_node_is_named(script, said):
    assert obstacles(script) == [said]


def test_what_nodes_send_by_themselves_is_no_master():
    assert obstacles("705#7F 701#05 77F#05 181#00 2FF#00 381#00 4FF#00 585#43001000 081#00 100#00 7E4#00 701#05") == []
