"""What stands between a drive and Operation Enabled: each state, each input, in the words that are reported."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper_drive import Paper, plain_drive, u32

from fffo_drive.drive.canopen.sdo_objects import WANTED, SdoObjects
from fffo_drive.drive.canopen.service import Emergency
from fffo_drive.system.findings import Severity
from fffo_drive.workflows.readiness import stands_between, velocity_step


def word(value):
    return {(0x6041, 0): struct.pack("<H", value)}


def in_the_way(objects, emergencies=(), operational=False, written=()):
    found = stands_between(objects, emergencies, operational, written)
    return [f"{one.subject}: {one.text}" for one in found if one.level is Severity.FAILURE]


def warnings(objects, **more):
    found = stands_between(objects, more.pop("emergencies", ()), more.pop("operational", False), ())
    return [f"{one.subject}: {one.text}" for one in found if one.level is Severity.WARNING]


@pytest.mark.parametrize("ready", [0x0250, 0x0231, 0x0233])
def test_nothing_stands_in_the_way_of_a_drive_that_can_be_enabled(ready):
    assert in_the_way(plain_drive(word(ready))) == []
    assert warnings(plain_drive(word(ready))) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (word(0x0218), "fault: statusword 0x0218: fault"),
        (word(0x021F), "fault: statusword 0x021F: fault reaction active"),
        (word(0x0210), "state: statusword 0x0210: not ready to switch on"),
        (word(0x0237), "state: statusword 0x0237: operation enabled: another master has enabled it"),
        (word(0x0220), "state: statusword 0x0220: not ready to switch on"),
        ({(0x6079, 0): u32(0), **word(0x0240)}, "supply: DC link (0x6079): 0.0 V: the power stage is not supplied"),
        ({(0x6079, 0): u32(4200), **word(0x0240)}, "supply: DC link (0x6079): 4.2 V: the power stage is not supplied"),
        (
            {(0x60FD, 0): u32(8), **word(0x0240)},
            "STO: 0x60FD is 0x00000008: the interlock input (bit 3; STO in most drives) is active",
        ),
        ({(0x60FD, 0): u32(3)}, "limit switches: 0x60FD is 0x00000003: both limit switches are active"),
        ({(0x6076, 0): u32(0)}, "motor: 0x6076 (rated torque) is 0: the motor has not been configured in the drive"),
        ({(0x6075, 0): u32(0)}, "motor: 0x6075 (rated current) is 0: the motor has not been configured in the drive"),
        ({(0x6072, 0): b"\0\0"}, "torque limit: 0x6072 is 0: the drive makes no torque"),
    ],
)  # fmt: skip
def test_one_obstacle_is_one_sentence(changes, said):
    assert in_the_way(plain_drive(changes)) == [said]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (word(0x0050), "control: bit 9 of the statusword is 0: the drive ignores our controlword (local control)"),
        (word(0x0240), "supply: bit 4 of the statusword is 0 although the DC link has 48.0 V"),
        (word(0x02D0), "warning: the drive warns (bit 7 of the statusword)"),
        (word(0x0217), "state: statusword 0x0217: quick stop active"),
        ({(0x60FD, 0): u32(1)}, "limit switches: 0x60FD is 0x00000001: the negative limit switch is active"),
        ({(0x60FD, 0): u32(8)}, "STO: 0x60FD is 0x00000008: the interlock input"),
        ({(0x6072, 0): struct.pack("<H", 100)}, "torque limit: 0x6072 limits the torque to 10% of the rated torque"),
        ({(0x60FE, 1): u32(1)}, "brake: the brake is set (0x60FE:01, bit 0)"),
        ({(0x6079, 0): u32(0)}, "supply: DC link (0x6079): 0.0 V: the power stage is not supplied, although bit 4"),
        ({(0x60FD, 0): 0x08000020}, "not read: objects that could not be read: 0x60FD:00 (abort 0x08000020)"),
    ],
)  # fmt: skip
def test_what_may_be_in_the_way_is_a_warning(changes, said):
    objects = plain_drive(changes)
    objects.value(0x60FD)
    assert in_the_way(objects) == []
    found = warnings(objects)
    assert len(found) == 1
    assert found[0].startswith(said)


def test_a_fault_tells_the_drives_own_words():
    objects = plain_drive({
        **word(0x0218), (0x603F, 0): b"\x20\x32", (0x1001, 0): b"\x05", (0x1003, 0): b"\x01",
        (0x1003, 1): u32(0x12343220), (0x1003, 2): u32(0x8130),
    })  # fmt: skip
    said = in_the_way(objects, [Emergency(0, 0x8611, 0x21, b"\x01\x02\0\0\0"), Emergency(0, 0, 0, b"")])
    assert said == [
        "fault: statusword 0x0218: fault; 0x603F 0x3220 (DC link under-voltage); EMCY 0x8611 (following error), error "
        "register 0x21 (generic, device profile), "
        "vendor bytes 01 02 00 00 00; error register 0x1001 0x05 (generic, voltage); kept in 0x1003: "
        "0x3220 (DC link under-voltage) with 0x1234",
    ]


def test_local_control_stands_in_the_way_once_the_drive_is_operational():
    assert in_the_way(plain_drive(word(0x0050)), operational=True) == [
        "control: bit 9 of the statusword is 0: the drive ignores our controlword (local control)"
    ]


def test_a_rating_that_the_axis_file_writes_is_no_obstacle():
    assert in_the_way(plain_drive({(0x6076, 0): u32(0)}), written=("0x6076:00",)) == []


def test_a_drive_without_a_statusword():
    assert in_the_way(plain_drive(without=((0x6041, 0),)))[0] == "state: the drive reports no statusword (0x6041)"


def test_how_coarse_a_velocity_is():
    fine, coarse = velocity_step(32768.0, 0.1)[0], velocity_step(60.0, 0.1)[0]
    assert (fine.level, coarse.level) == (Severity.OK, Severity.WARNING)
    assert "one count of 0x606C is 0.0167 rps: coarse" in coarse.text


@given(st.dictionaries(st.sampled_from(WANTED), st.binary(min_size=1, max_size=4)), st.booleans())
def test_whatever_a_drive_tells_every_obstacle_has_a_remedy(objects, operational):
    found = stands_between(SdoObjects(Paper(objects).read), (), operational)
    assert [one.level for one in found] == sorted(
        (one.level for one in found), key=[Severity.FAILURE, Severity.WARNING, Severity.OK].index
    )
    assert all(one.remedy for one in found if one.level is not Severity.OK)
    if not found or all(one.level is not Severity.FAILURE for one in found):  # then the state is one to enable from
        state = int.from_bytes(objects[0x6041, 0], "little") & 0x6F
        assert state & 0x4F == 0x40 or state in (0x21, 0x23, 0x07)
