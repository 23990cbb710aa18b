"""drive.sdo: what a drive needs written, in its phase, read back, and never a command."""

import dataclasses
import struct

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pydantic import ValidationError
from scripted_node import RANGE, ScriptedNode, servo_dictionary
from test_bring_up import NODE, config, refusal  # noqa: F401  (a fixture)

from fffo_drive.config.drive_section import CanopenDriveSection, SdoWriteSection
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.canopen.sdo_writes import SdoWrite, reserved_reason

RPM = 0x00B44700
UNIT = SdoWrite(0x60A9, 0, RPM, 4, "before_mapping", True, (), "velocity in rpm")
LIMIT = SdoWrite(0x2010, 3, -5, 2, "before_enable", True, (), "a limit of the vendor")
BRAKE = SdoWrite(0x2020, 0, 1, 1, "after_disable", True, (), "the brake")


def dictionary(**more):
    own = {(0x60A9, 0): bytes(4), (0x2010, 3): bytes(2), (0x2020, 0): bytes(1)}
    return servo_dictionary(NODE) | own | {tuple(map(int, k.split("_")[1:])): v for k, v in more.items()}


def test_each_phase_has_its_place(config):  # noqa: F811
    config = dataclasses.replace(config, sdo=(BRAKE, LIMIT, UNIT))
    with ScriptedNode(config.bus, NODE, dictionary()) as node, CanopenDrive(config):
        assert node.number(0x60A9) == RPM
        assert node.objects[0x2010, 3] == struct.pack("<h", -5)
        assert node.number(0x2020) == 0
    order = [(index, sub) for index, sub, _ in node.written]
    assert order.index((0x60A9, 0)) < min(k for k, (index, _) in enumerate(order) if 0x1400 <= index < 0x1C00)
    assert order.index((0x2010, 3)) > order.index((0x6060, 0))
    assert order.index((0x2020, 0)) > order.index((0x6040, 0))  # the voltage is off by then
    assert node.number(0x2020) == 1


@pytest.mark.parametrize(
    ("index", "reason"),
    [(0x6040, "commands"), (0x6840, "commands"), (0x6871, "commands"), (0x70FF, "commands"), (0x9840, "commands"),
     (0x605A, "bring-up"), (0x685A, ""), (0x6877, ""), (0xA040, ""), (0x5840, "")],
)  # fmt: skip
def test_no_axis_of_a_node_is_commanded_and_the_others_may_be_configured(index, reason):
    """CiA 402: the objects of the second axis are those of the first + 0x800, and so on to eight axes."""
    assert (reason in reserved_reason(index)) if reason else reserved_reason(index) == ""


def test_a_rating_that_is_written_is_compared_afterwards(config):  # noqa: F811
    rating = SdoWrite(0x6076, 0, 1000, 4, "before_mapping", True, (), "the motor")
    config = dataclasses.replace(config, sdo=(rating,))
    with ScriptedNode(config.bus, NODE, dictionary() | {(0x6076, 0): bytes(4)}) as node, CanopenDrive(config):
        assert node.number(0x6076) == 1000


def test_what_is_refused_or_kept_otherwise_is_named_with_its_purpose(config):  # noqa: F811
    config = dataclasses.replace(config, sdo=(UNIT,))
    text = refusal(config, ScriptedNode(config.bus, NODE, dictionary(), refuse={(0x60A9, 0): RANGE}))
    assert "refuses 0x60A9:00" in text
    assert "velocity in rpm" in text
    text = refusal(config, ScriptedNode(config.bus, NODE, dictionary(), keep={(0x60A9, 0): bytes(4)}))
    assert "reads back 0" in text
    expected = dataclasses.replace(config, sdo=(UNIT._replace(aborts=(RANGE,)),))
    with ScriptedNode(config.bus, NODE, dictionary(), refuse={(0x60A9, 0): RANGE}), CanopenDrive(expected) as drive:
        assert drive.identity is not None
    blind = dataclasses.replace(config, sdo=(UNIT._replace(check=False),))
    with ScriptedNode(config.bus, NODE, dictionary(), keep={(0x60A9, 0): bytes(4)}), CanopenDrive(blind) as drive:
        assert drive.identity is not None


BASE = {"kind": "canopen", "bus": "loopback:29500", "node_id": 1, "rated_torque_nm": 1.0}


@pytest.mark.parametrize(
    "index", [0x6040, 0x6060, 0x6071, 0x607A, 0x60FF, 0x60B2, 0x1016, 0x1017, 0x1400, 0x1A01, 0x6007, 0x1F80]
)
def test_what_commands_a_drive_or_belongs_to_the_bring_up_is_no_part_of_a_list(index):
    with pytest.raises(ValidationError, match=f"0x{index:04X}"):
        SdoWriteSection(object=index, value=0, bytes=2, why="a bad idea")


@given(index=st.integers(0x1000, 0xFFFF), size=st.sampled_from([1, 2, 4, 8]), value=st.integers(-(1 << 63), 2**64 - 1))
def test_a_value_is_taken_exactly_where_it_fits(index, size, value):
    assume(not reserved_reason(index))
    given_ = {"object": index, "value": value, "bytes": size, "why": "anything"}
    if -(1 << 8 * size - 1) <= value < 1 << 8 * size:
        assert SdoWriteSection(**given_).write()[:4] == (index, 0, value, size)
    else:
        with pytest.raises(ValidationError, match="does not fit"):
            SdoWriteSection(**given_)


def test_any_number_of_counts_reaches_the_scale():
    for counts in (2, 500, 2000, 10_000, 3_600_000):
        section = CanopenDriveSection(**BASE, counts_per_rev=counts)
        made = section.drive_config(0.1, 500_000)
        assert made.scaling.position_rev_per_count * counts == pytest.approx(1.0)
    assert CanopenDriveSection(**BASE).counts == 32768
    assert CanopenDriveSection(**BASE, resolver_bits=17).counts == 131072
    with pytest.raises(ValidationError, match="give one of them"):
        CanopenDriveSection(**BASE, resolver_bits=17, counts_per_rev=2000)


def test_every_setting_of_the_backend_is_a_key_of_the_file():
    section = CanopenDriveSection(
        **BASE, quick_stop_option=None, fault_reaction_option=0, max_torque_permille=800, attempts=5, status_event=0,
        rated_torque_unit="uNm", sdo=[{"object": 0x60A9, "value": RPM, "bytes": 4, "why": "rpm"}],
    )  # fmt: skip
    made = section.drive_config(0.1, 500_000)
    assert (made.quick_stop_option, made.fault_reaction_option, made.max_torque_permille) == (None, 0, 800)
    assert (made.attempts, made.status_event, made.rated_torque_unit_nm) == (5, 0, 1e-6)
    assert made.sdo == (SdoWrite(0x60A9, 0, RPM, 4, "before_mapping", True, (), "rpm"),)
