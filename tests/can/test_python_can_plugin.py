"""The loopback bus behind python-can's interface, and `canopen` on top of it."""

import can
import canopen
import pytest
from can import Message
from canopen.sdo import SdoClient

from fffo_drive.can.frame import pack_frame, unpack_frame
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.can.python_can import LoopbackBus, kernel_filters

WAIT_S = 1.0


@pytest.fixture
def port():
    return free_loopback_port()


def test_messages_go_both_ways(port):
    with LoopbackBus(port) as bus, open_link(f"loopback:{port}") as link:
        bus.send(Message(arbitration_id=0x601, data=b"12345678", is_extended_id=False))
        assert unpack_frame(link.receive(WAIT_S)) == (0x601, b"12345678", False, False, False)
        link.send(pack_frame(0x12345678, b"ab", extended=True))
        message = bus.recv(WAIT_S)
        assert message.arbitration_id == 0x12345678
        assert message.is_extended_id
        assert bytes(message.data) == b"ab"
        assert message.is_rx


def test_remote_and_error_frames_keep_their_kind(port):
    with LoopbackBus(port) as bus, LoopbackBus(port) as other:
        bus.send(Message(arbitration_id=0x705, is_remote_frame=True, dlc=1, is_extended_id=False))
        bus.send(Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
        remote, error = other.recv(WAIT_S), other.recv(WAIT_S)
        assert (remote.is_remote_frame, remote.dlc) == (True, 1)
        assert error.is_error_frame


def test_own_messages_only_when_asked_for(port):
    message = Message(arbitration_id=1, is_extended_id=False)
    with LoopbackBus(port) as deaf, LoopbackBus(port, receive_own_messages=True) as bus:
        bus.send(message)
        own = bus.recv(WAIT_S)
        assert own is not None
        assert not own.is_rx
        deaf.send(message)
        assert deaf.recv(WAIT_S) is not None  # the other's frame
        assert deaf.recv(0.0) is None


def test_timeouts(port):
    with LoopbackBus(port) as bus:
        assert bus.recv(0.0) is None
        assert bus.recv(0.001) is None


def test_filters_reach_the_kernel(port):
    wanted = [{"can_id": 0x580, "can_mask": 0x780, "extended": False}]
    with LoopbackBus(port, can_filters=wanted) as bus, open_link(f"loopback:{port}") as link:
        link.send(pack_frame(0x581, extended=True))
        link.send(pack_frame(0x80))
        link.send(pack_frame(0x585))
        assert bus.recv(WAIT_S).arbitration_id == 0x585
        bus.set_filters(None)
        link.send(pack_frame(0x80))
        assert bus.recv(WAIT_S).arbitration_id == 0x80


def test_filters_without_the_extended_key_match_both_kinds():
    assert kernel_filters([{"can_id": 0x185, "can_mask": 0x7FF}]) == [(0x185, 0x7FF, False)]


def test_descriptor_and_stamps(port):
    with LoopbackBus(port) as bus, LoopbackBus(port) as other:
        assert bus.fileno() >= 0
        for n in range(3):
            other.send(Message(arbitration_id=n, is_extended_id=False))
        stamps = [bus.recv(WAIT_S).timestamp for _ in range(3)]
        assert stamps == sorted(stamps)
        assert stamps[0] > 0.0


def test_a_bad_port_is_an_initialisation_error():
    with pytest.raises(can.CanInitializationError, match="from 1024 to 65535"):
        LoopbackBus(1)


def test_can_fd_is_refused(port):
    with LoopbackBus(port) as bus, pytest.raises(can.CanOperationError, match="no CAN FD"):
        bus.send(Message(arbitration_id=1, is_fd=True, data=bytes(12)))


def test_a_closed_bus_does_not_send(port):
    bus = LoopbackBus(port)
    bus.shutdown()
    with pytest.raises(can.CanOperationError):
        bus.send(Message(arbitration_id=1, is_extended_id=False))


def test_canopen_reads_and_writes_objects_over_it(port):
    """`canopen`'s client against `canopen`'s server, both on the loopback bus."""
    dictionary = canopen.ObjectDictionary()
    text = canopen.objectdictionary.ODVariable("name", 0x2000, 0)
    text.data_type = canopen.objectdictionary.VISIBLE_STRING
    number = canopen.objectdictionary.ODVariable("number", 0x2001, 0)
    number.data_type = canopen.objectdictionary.UNSIGNED32
    dictionary.add_object(text)
    dictionary.add_object(number)
    server, client = canopen.Network(), canopen.Network()
    server.NOTIFIER_CYCLE = client.NOTIFIER_CYCLE = 0.02
    with LoopbackBus(port) as server_bus, LoopbackBus(port) as client_bus:
        server.bus, client.bus = server_bus, client_bus
        with server.connect(), client.connect():
            node = canopen.LocalNode(5, dictionary)
            server.add_node(node)
            sdo = SdoClient(0x605, 0x585, canopen.ObjectDictionary())
            sdo.network = client
            client.subscribe(0x585, sdo.on_response)
            sdo.RESPONSE_TIMEOUT = WAIT_S
            sdo.download(0x2001, 0, bytes([1, 2, 3, 4]))
            assert sdo.upload(0x2001, 0) == bytes([1, 2, 3, 4])
            sdo.download(0x2000, 0, b"a text of more than four bytes")
            assert sdo.upload(0x2000, 0) == b"a text of more than four bytes"
            with pytest.raises(canopen.SdoAbortedError):
                sdo.upload(0x2002, 0)
