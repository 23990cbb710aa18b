"""PyPI's `canopen` as master of the simulated drive: an implementation of CiA 301 and 402 that is not ours."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import canopen
import canopen.lss
import pytest
from buses import PATIENCE_S, python_can_arguments
from canopen import objectdictionary as od
from canopen.profiles.p402 import BaseNode402

pytestmark = pytest.mark.realtime

SUPPORTED_MODES = 1 << 3 | 1 << 9  # profile torque, cyclic synchronous torque
USER_TEXT = 0x2000
DEVICE_NAME = "fffo-drive simulated servo drive"  # more than four bytes: a segmented upload
STATES = ["SWITCH ON DISABLED", "READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"]


def wait_for(condition: Callable[[], bool], what: str) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, f"{what} did not come about"
        time.sleep(0.002)


@pytest.fixture
def network(drive_bus: str) -> Iterator[canopen.Network]:
    """The master's side of the bus."""
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05
    network.connect(**python_can_arguments(drive_bus))
    yield network
    network.disconnect()


@pytest.fixture
def node(network, eds_file) -> BaseNode402:
    """Node 1 after a reset, pre-operational."""
    node = BaseNode402(1, str(eds_file))
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
    for name in ("SWITCH_OP_MODE", "SWITCH_STATE_FINAL", "SWITCH_STATE_SINGLE", "CHECK_TPDO"):
        setattr(node, f"TIMEOUT_{name}", PATIENCE_S)
    with reboot_of(node):
        node.nmt.send_command(0x81)
    return node


@contextmanager
def reboot_of(node: BaseNode402) -> Iterator[None]:
    """Something in the block restarts the node; its boot-up message must come."""
    booted = threading.Event()
    node.network.subscribe(0x700 + node.id, seen := lambda cob, data, stamp: bytes(data) == b"\0" and booted.set())
    yield
    assert booted.wait(PATIENCE_S), "no boot-up message"
    node.network.unsubscribe(0x700 + node.id, seen)


def test_expedited_transfers(node):
    assert node.sdo[0x1000].raw == 0x00020192
    assert node.sdo[0x1018][2].raw == 0x50455332
    for value in (0, 1, 0x1234, 0xFFFF):
        node.sdo[0x1017].raw = value
        assert node.sdo[0x1017].raw == value
    node.sdo[0x6071].raw = -123
    assert node.sdo[0x6071].raw == -123


def test_segmented_transfers(node):
    assert node.sdo[0x1008].raw == DEVICE_NAME
    for length in (1, 4, 5, 7, 8, 14, 15, 64):
        text = "".join(chr(ord("a") + n % 26) for n in range(length))
        node.sdo[USER_TEXT].raw = text
        assert node.sdo[USER_TEXT].raw == text


@pytest.mark.parametrize(
    ("index", "sub", "data", "code"),
    [
        (0x5FFF, 0, None, 0x06020000),
        (0x1018, 9, None, 0x06090011),
        (0x1000, 0, bytes(4), 0x06010002),
        (0x2100, 6, None, 0x06010001),
        (0x1029, 1, b"\x07", 0x06090031),
        (0x1017, 0, bytes(4), 0x06070012),
    ],
)
def test_what_is_wrong_is_aborted_with_the_standard_code(node, index, sub, data, code):
    with pytest.raises(canopen.SdoAbortedError) as caught:
        _ = node.sdo.upload(index, sub) if data is None else node.sdo.download(index, sub, data)
    assert caught.value.code in (code, 0x06070010, 0x06090030) if data is not None else caught.value.code == code


def test_every_object_of_the_data_sheet_can_be_read(node):
    """What the EDS promises to be readable is, with the length that it says."""
    entries = [entry for entry in node.object_dictionary.values() if entry.index >= 0x1000]  # below: dummies
    for entry in entries:
        variables = [entry] if isinstance(entry, od.ODVariable) else list(entry.values())
        for variable in variables:
            if variable.access_type == "wo":
                continue
            if variable.index == 0x1003 and variable.subindex:
                continue  # an empty history has nothing to say
            raw = node.sdo.upload(variable.index, variable.subindex)
            if variable.data_type in od.datatypes.INTEGER_TYPES:
                assert len(raw) * 8 == len(variable), f"{variable.index:04X}:{variable.subindex:02X}"


def test_nmt_commands_and_the_heartbeat_that_shows_them(node):
    node.sdo[0x1017].raw = 20
    for command, state in (
        ("OPERATIONAL", "OPERATIONAL"),
        ("STOPPED", "STOPPED"),
        ("PRE-OPERATIONAL", "PRE-OPERATIONAL"),
        ("OPERATIONAL", "OPERATIONAL"),
    ):
        node.nmt.state = command
        wait_for(lambda state=state: node.nmt.wait_for_heartbeat(PATIENCE_S) == state, state)
    for command in (0x81, 0x82):
        node.sdo[0x1017].raw = 20
        with reboot_of(node):
            node.nmt.send_command(command)
        assert node.sdo[0x1017].raw == 0  # back to the default


def test_node_guarding_shows_the_state_too(node):
    node.nmt.start_node_guarding(0.02)
    try:
        for command in ("OPERATIONAL", "PRE-OPERATIONAL"):
            node.nmt.state = command
            wait_for(lambda state=command: node.nmt.wait_for_heartbeat(PATIENCE_S) == state, command)
    finally:
        node.nmt.stop_node_guarding()


def test_lss_gives_the_drive_another_node_id(node, network, eds_file):
    lss = network.lss
    lss.RESPONSE_TIMEOUT = PATIENCE_S
    identity = [node.sdo[0x1018][sub].raw for sub in range(1, 5)]
    other = canopen.RemoteNode(42, str(eds_file))
    network.add_node(other)
    other.sdo.RESPONSE_TIMEOUT = PATIENCE_S
    try:
        lss.send_switch_state_global(lss.CONFIGURATION_STATE)
        assert lss.inquire_node_id() == 1
        assert [lss.inquire_lss_address(0x5A + part) for part in range(4)] == identity
        with pytest.raises(canopen.lss.LssError):
            lss.configure_node_id(128)
        lss.configure_node_id(42)
        lss.send_switch_state_global(lss.WAITING_STATE)
        with reboot_of(other):
            node.nmt.send_command(0x82)
        assert other.sdo[0x1008].raw == DEVICE_NAME
        assert other.sdo[0x1014].raw == 0x80 + 42
    finally:
        with reboot_of(node):  # not stored: a reset of the node forgets it
            network.nmt.send_command(0x81)


def test_the_drive_gives_the_sync(node):
    seen = threading.Event()
    node.network.subscribe(0x80, on_sync := lambda cob, data, stamp: seen.set())
    node.sdo[0x1006].raw = 20_000
    node.sdo[0x1005].raw = 1 << 30 | 0x80
    assert seen.wait(PATIENCE_S)
    node.network.unsubscribe(0x80, on_sync)
    node.sdo[0x1005].raw = 0x80
    assert node.sdo[0x2020][1].raw > 0


def test_pdo_parameters_are_read_saved_and_found_again(node):
    node.rpdo.read()
    node.tpdo.read()
    assert [variable.index for variable in node.tpdo[1].map] == [0x6041]
    tpdo = node.tpdo[1]
    tpdo.clear()
    for index in (0x606C, 0x6064):
        tpdo.add_variable(index)
    tpdo.trans_type = 1
    tpdo.enabled = True
    rpdo = node.rpdo[1]
    rpdo.clear()
    for index in (0x6040, 0x6071):
        rpdo.add_variable(index)
    rpdo.trans_type = 1
    rpdo.enabled = True
    tpdo.save()
    rpdo.save()
    for pdo in (tpdo, rpdo):
        pdo.clear()
        pdo.read()
    assert [variable.index for variable in tpdo.map] == [0x606C, 0x6064]
    assert [variable.index for variable in rpdo.map] == [0x6040, 0x6071]
    assert (tpdo.trans_type, rpdo.trans_type) == (1, 1)

    node.nmt.state = "OPERATIONAL"
    received = threading.Event()
    tpdo.add_callback(lambda pdo: received.set())
    rpdo[0x6040].raw = 0x06  # shutdown
    rpdo.transmit()
    assert node.sdo[0x6041].raw & 0x6F == 0x40  # it acts with SYNC
    node.network.sync.transmit()
    assert received.wait(PATIENCE_S)
    wait_for(lambda: node.sdo[0x6041].raw & 0x6F == 0x21, "ready to switch on")
    assert len(tpdo.data) == 8


def states_402(node: BaseNode402) -> BaseNode402:
    """Its state machine on the default mapping: controlword on events, statusword also every 20 ms.

    It waits for a statusword that comes after it began to wait: without the timer one that came sooner was the last.
    """
    node.sdo[0x1800][5].raw = 20
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    wait_for(lambda: node.statusword != 0, "the first statusword")
    return node


def test_base_node_402_walks_the_state_machine_up_and_down(node):
    states_402(node)
    assert node.state == STATES[0]
    node.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    assert node.op_mode == "CYCLIC SYNCHRONOUS TORQUE"
    assert node.sdo[0x6502].raw == SUPPORTED_MODES
    assert not node.is_op_mode_supported("CYCLIC SYNCHRONOUS POSITION")
    for state in STATES[1:]:
        node.state = state
        assert node.state == state
        assert node.sdo[0x6041].raw & 0x6F == {1: 0x21, 2: 0x23, 3: 0x27}[STATES.index(state)]
    for state in ("SWITCHED ON", "READY TO SWITCH ON", "SWITCH ON DISABLED"):
        node.state = state
        assert node.state == state
    node.state = "OPERATION ENABLED"  # three steps at once
    assert node.state == "OPERATION ENABLED"
    node.state = "SWITCH ON DISABLED"


def test_base_node_402_sees_a_fault_and_resets_it(node):
    emergencies = []
    states_402(node)
    node.emcy.add_callback(emergencies.append)
    node.state = "OPERATION ENABLED"
    node.sdo[0x2100][1].raw = 22  # overcurrent
    node.sdo[0x2100][6].raw = 1
    wait_for(lambda: node.state == "FAULT", "the fault")
    wait_for(lambda: bool(emergencies), "the EMCY message")
    assert emergencies[0].code == 0x2310 == node.sdo[0x603F].raw
    assert node.sdo[0x1003][1].raw & 0xFFFF == 0x2310
    node.sdo[0x2100][6].raw = 2  # the cause is gone; the fault stays
    assert node.state == "FAULT"
    node.TIMEOUT_RESET_FAULT = 0.0
    node.reset_from_fault()
    assert node.state == "OPERATION ENABLED"
    wait_for(lambda: emergencies[-1].code == 0, "the EMCY message that there is no error")
    node.state = "SWITCH ON DISABLED"
