"""What a CAN link promises, tried on the loopback bus; and what it says when it cannot be opened."""

import errno
import os
import socket
import threading

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fffo_drive.can.bpf import program
from fffo_drive.can.frame import EXTENDED_FLAG, pack_frame, unpack_frame
from fffo_drive.can.link import BROADCAST, CanFilter, LinkError, free_loopback_port, open_link


@pytest.fixture
def spec():
    return f"loopback:{free_loopback_port()}"


def drain(link):
    """Everything in the queue; delivery on the loopback interface is done when send() returns."""
    frames = []
    while (raw := link.receive(0.05 if not frames else 0.0)) is not None:
        frames.append(unpack_frame(raw))
    return frames


def identifiers(link):
    return [frame.can_id for frame in drain(link)]


def test_every_link_but_the_sender_hears_a_frame(spec):
    with open_link(spec) as first, open_link(spec) as second, open_link(spec) as third:
        first.send(pack_frame(0x80))
        second.send(pack_frame(0x185, b"12345678"))
        assert identifiers(first) == [0x185]
        assert identifiers(second) == [0x80]
        assert identifiers(third) == [0x80, 0x185]


def test_frames_keep_their_bytes_and_order(spec):
    with open_link(spec) as sender, open_link(spec) as receiver:
        sent = [pack_frame(n, bytes([n]) * (n % 9)) for n in range(100)]
        for raw in sent:
            sender.send(raw)
        assert [receiver.receive(0.05) for _ in sent] == sent


def test_receive_own(spec):
    with open_link(spec, receive_own=True) as link:
        link.send(pack_frame(0x123))
        assert identifiers(link) == [0x123]


def test_two_buses_do_not_hear_each_other(spec):
    with open_link(spec) as one, open_link(f"loopback:{free_loopback_port()}") as other:
        one.send(pack_frame(1))
        assert other.receive(0.0) is None


@pytest.mark.parametrize(
    ("filters", "heard"),
    [
        ([CanFilter(0x185)], [0x185]),
        ([CanFilter(0x180, 0x780)], [0x185, 0x186]),
        ([CanFilter(0x185), CanFilter(0x705)], [0x185, 0x705]),
        ([CanFilter(0x185, exclude=True)], [0x80, 0x186, 0x705]),
        ([CanFilter(0x185, exclude=True), CanFilter(0x80, exclude=True)], [0x186, 0x705]),
        ([CanFilter(0x180, 0x780), CanFilter(0x186, exclude=True)], [0x185]),
    ],
)
def test_filters_work_in_the_kernel(spec, filters, heard):
    with open_link(spec) as sender, open_link(spec, filters=filters) as receiver:
        for can_id in (0x80, 0x185, 0x186, 0x705):
            sender.send(pack_frame(can_id))
        assert identifiers(receiver) == heard


@given(
    st.lists(st.builds(CanFilter, st.integers(0, 0x7FF), st.integers(0, 0x7FF), st.booleans()), max_size=6),
    st.lists(st.integers(0, 0x7FF), min_size=1, max_size=20),
)
@settings(max_examples=50)
def test_filters_against_their_definition(filters, sent):
    bus = f"loopback:{free_loopback_port()}"
    with open_link(bus) as sender, open_link(bus, filters=filters) as receiver:
        for can_id in sent:
            sender.send(pack_frame(can_id))
        sender.send(pack_frame(0x1, error=True))  # always passes: marks the end

        def matches(item, can_id):
            return can_id & item.mask == item.can_id & item.mask

        inclusive = [item for item in filters if not item.exclude]
        expected = [
            can_id
            for can_id in sent
            if not any(item.exclude and matches(item, can_id) for item in filters)
            and (not inclusive or any(matches(item, can_id) for item in inclusive))
        ]
        assert identifiers(receiver) == [*expected, 1]


def test_extended_frames_pass_a_filter_without_the_flag(spec):
    exact = [CanFilter(0x185, 0x7FF | EXTENDED_FLAG)]
    with (
        open_link(spec) as sender,
        open_link(spec, filters=[CanFilter(0x185)]) as loose,
        open_link(spec, filters=exact) as strict,
    ):
        sender.send(pack_frame(0x185, extended=True))
        sender.send(pack_frame(0x185, b"x"))
        assert [frame.extended for frame in drain(loose)] == [True, False]
        assert [frame.extended for frame in drain(strict)] == [False]


def test_filters_can_be_changed_while_open(spec):
    with open_link(spec) as sender, open_link(spec) as receiver:
        receiver.set_filters([CanFilter(1)])
        sender.send(pack_frame(2))
        receiver.set_filters(None)
        sender.send(pack_frame(3))
        assert identifiers(receiver) == [3]


def test_a_datagram_that_is_no_frame_never_arrives(spec):
    port = int(spec.partition(":")[2])
    with open_link(spec) as link, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        for size in (0, 1, 15, 17, 1000):
            stranger.sendto(bytes(size), (BROADCAST, port))
        stranger.sendto(pack_frame(0x42), (BROADCAST, port))
        assert identifiers(link) == [0x42]


def test_lost_frames_are_counted_and_ours_are_not(spec):
    with open_link(spec) as sender, open_link(spec) as receiver:
        assert receiver.dropped_frames() == 0
        with socket.socket(fileno=os.dup(receiver.rx_fd)) as handle:
            handle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sent = 200
        for _ in range(sent):
            sender.send(pack_frame(0x80))
            receiver.send(pack_frame(0x185))  # its own: kept away by the filter, and not lost
        heard = len(drain(receiver))
        assert 0 < heard < sent
        assert receiver.dropped_frames() == sent - heard
        assert receiver.dropped_frames() == sent - heard
        assert sender.dropped_frames() == 0


def test_frames_sent_on_the_descriptor_are_named_by_the_caller(spec):
    with open_link(spec) as link, socket.socket(fileno=os.dup(link.tx_fd)) as handle:
        handle.send(pack_frame(0x80))
        assert link.dropped_frames(lambda: 1) == 0


def test_drops_are_unknown_behind_identifier_filters(spec):
    with open_link(spec, filters=[CanFilter(1)]) as link:
        assert link.dropped_frames() == -1


def test_stamps_grow_and_tell_own_frames(spec):
    with open_link(spec, receive_own=True) as link, open_link(spec) as other:
        assert link.receive_stamped(0.0) is None
        link.send(pack_frame(1))
        other.send(pack_frame(2))
        first, second = link.receive_stamped(0.05), link.receive_stamped(0.05)
        assert first is not None
        assert second is not None
        assert (first.own, second.own) == (True, False)
        assert 0.0 < first.time_s <= second.time_s


def test_a_port_in_use_by_something_else(spec):
    port = int(spec.partition(":")[2])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as squatter:
        squatter.bind(("", port))
        with pytest.raises(LinkError, match=rf"{port} is in use by a program that is no loopback bus"):
            open_link(spec)


@pytest.mark.parametrize("text", ["can0", "loopback", "loopback:", "usb:1", "", "socketcan:"])
def test_unknown_kinds_of_bus(text):
    with pytest.raises(LinkError, match="socketcan:INTERFACE"):
        open_link(text)


@pytest.mark.parametrize("port", ["x", "0", "80", "65536", "-1", "1e4"])
def test_ports_out_of_range(port):
    with pytest.raises(LinkError, match="from 1024 to 65535"):
        open_link(f"loopback:{port}")


def test_a_missing_interface_is_named_with_what_to_do():
    with pytest.raises(LinkError, match="socketcan:nosuchcan0") as caught:
        open_link("socketcan:nosuchcan0")
    assert "loopback:20000" in str(caught.value) or "ip link" in str(caught.value)


def test_interface_names_are_short():
    with pytest.raises(LinkError, match="at most 15"):
        open_link("socketcan:averyveryverylongname")


def test_too_many_filters():
    with pytest.raises(ValueError, match="at most 500"):
        program([CanFilter(1)] * 501)


def test_a_closed_link_is_closed(spec):
    link = open_link(spec)
    link.close()
    link.close()
    with pytest.raises(LinkError) as caught:
        link.send(pack_frame(1))
    assert isinstance(caught.value.__cause__, OSError)
    assert caught.value.__cause__.errno == errno.EBADF


def test_threads_that_send_do_not_spoil_the_count(spec):
    with open_link(spec) as link:

        def send():
            for _ in range(2000):
                link.send(pack_frame(0x80))

        threads = [threading.Thread(target=send) for _ in range(3)]
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads):
            assert link.dropped_frames() == 0
        assert link.dropped_frames() == 0
