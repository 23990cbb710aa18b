"""SYNC supervision and the emergency object."""

from __future__ import annotations

import pytest
from node.node_rig import Rig

INVALID_VALUE, DEVICE_STATE, UNSUPPORTED = 0x06090030, 0x08000022, 0x06010000


@pytest.mark.conformance(
    "CiA 301", "wrong length: EMCY 0x8240, not followed", "once an error, and once its end (0x0000)"
)
def test_a_sync_of_wrong_length_is_an_error_once_and_is_not_followed() -> None:
    rig = Rig()
    rig.operational()
    assert rig.send("080#01") == ["081#4082110100000000"]
    assert rig.send("080#01") == []
    assert rig.send("080#") == ["081#0000000000000000", "281#0000000000000000"]


@pytest.mark.conformance("CiA 301", "counter 0x1019")
def test_a_counter_is_expected_where_0x1019_says_so() -> None:
    rig = Rig()
    assert rig.write(0x1019, 0, 4, 1) == 0
    rig.operational()
    assert rig.send("080#01") == ["281#0000000000000000"]
    assert rig.send("080#") == ["081#4082110000000000"]


@pytest.mark.conformance("CiA 301", "0x1019 is settled before 0x1006 (08000022)", "device state (08000022)")
def test_counter_overflow_is_settled_before_the_cycle_period() -> None:
    rig = Rig()
    assert rig.write(0x1019, 0, 1, 1) == INVALID_VALUE
    assert rig.write(0x1006, 0, 500, 4) == 0
    assert rig.write(0x1019, 0, 4, 1) == DEVICE_STATE
    assert rig.write(0x1006, 0, 0, 4) == 0
    assert rig.write(0x1019, 0, 4, 1) == 0


@pytest.mark.conformance("CiA 301", "another COB-ID 0x1005")
def test_sync_identifier_can_be_another_but_not_a_restricted_one() -> None:
    rig = Rig()
    for refused in (0x20000080, 0x60000080, 0x40000601, 0x601, 0x701, 0x000, 0x581):
        assert rig.write(0x1005, 0, refused, 4) == INVALID_VALUE
    assert rig.write(0x1005, 0, 0x90, 4) == 0
    rig.operational()
    assert rig.send("080#") == []
    assert rig.send("090#") == ["281#0000000000000000"]


@pytest.mark.conformance("CiA 301", "loss after 1.5 x 0x1006 at least: EMCY 0x8700")
def test_loss_of_sync_is_reported_after_the_tolerance_and_ends_with_the_next() -> None:
    rig = Rig()
    rig.write(0x1006, 0, 1000, 4)
    rig.write(0x2010, 0, 20, 2)
    rig.operational()
    assert rig.wait(1000) == []  # not before the first
    rig.send("080#")
    assert rig.wait(20.9) == []
    assert rig.wait(0.2) == ["081#0087210000000000", "181#D002"]  # and the warning bit of the statusword
    assert rig.send("080#") == ["081#0000000000000000", "281#0000000000000000", "181#5002"]
    assert rig.read(0x2020, 2) == 20  # SYNCs that did not come


def test_every_missing_sync_is_counted() -> None:
    rig = Rig()
    rig.write(0x1006, 0, 500, 4)
    rig.operational()
    for gap_ms in (0.5, 0.5, 0.6, 1.0, 0.5, 2.0):
        rig.send("080#")
        rig.wait(gap_ms)
    rig.send("080#")
    assert rig.read(0x2020, 1) == 7
    assert rig.read(0x2020, 2) == 1 + 3


@pytest.mark.conformance("CiA 301", "history 0x1003")
def test_history_is_newest_first_bounded_and_cleared_by_zero() -> None:
    rig = Rig()
    for detail in range(10):
        rig.node.emergency.raise_error(0xFF01, detail)
    assert rig.read(0x1003, 0) == 8
    assert rig.read(0x1003, 1) == 0x0009FF01
    assert rig.read(0x1003, 8) == 0x0002FF01
    assert rig.write(0x1003, 0, 1, 1) == INVALID_VALUE
    assert rig.write(0x1003, 0, 0, 1) == 0
    assert rig.read(0x1003, 0) == 0
    assert rig.read_abort(0x1003, 1) == 0x08000024


@pytest.mark.parametrize(
    ("code", "register"),
    [(0x2310, 0x03), (0x3220, 0x05), (0x4310, 0x09), (0x7303, 0x21), (0x8130, 0x11), (0x8210, 0x11),
     (0x8700, 0x21), (0xFF00, 0x81), (0x6100, 0x01)],
)  # fmt: skip
@pytest.mark.conformance("CiA 301", "error register 0x1001")
def test_error_register_bits(code: int, register: int) -> None:
    rig = Rig()
    rig.node.emergency.raise_error(code)
    assert rig.read(0x1001) == register
    rig.node.emergency.clear(code)
    assert rig.read(0x1001) == 0


@pytest.mark.conformance("CiA 301", "inhibit time 0x1015")
def test_inhibit_time_spaces_emergencies() -> None:
    rig = Rig()
    rig.write(0x1015, 0, 100, 2)  # 10 ms
    emergency = rig.node.emergency
    emergency.bus.now_ns = rig.now_ns
    for detail in (1, 2, 3):
        emergency.raise_error(0xFF01, detail)
    assert rig.wait(0) == ["081#01FF810100000000"]
    assert rig.wait(9.9) == []
    assert rig.wait(0.2) == ["081#01FF810200000000"]
    assert rig.wait(10) == ["081#01FF810300000000"]


@pytest.mark.conformance("CiA 301", "COB-ID 0x1014")
def test_emcy_identifier_changes_only_while_it_is_invalid() -> None:
    rig = Rig()
    assert rig.read(0x1014) == 0x81
    assert rig.write(0x1014, 0, 0x82, 4) == INVALID_VALUE
    assert rig.write(0x1014, 0, 0x80000081, 4) == 0
    rig.node.emergency.raise_error(0xFF01)
    assert rig.wait(10) == []
    assert rig.write(0x1014, 0, 0x85, 4) == 0
    rig.node.emergency.clear(0xFF01)
    assert rig.wait(0) == ["085#0000000000000000"]


@pytest.mark.conformance("CiA 301", "loss after 1.5 x 0x1006 at least: EMCY 0x8700")
def test_without_a_tolerance_one_and_a_half_periods_are_a_loss() -> None:
    rig = Rig()
    rig.write(0x1006, 0, 1000, 4)
    rig.write(0x2010, 0, 0, 2)
    rig.operational()
    rig.send("080#")
    assert rig.wait(1.499) == []
    assert rig.wait(0.002)[0] == "081#0087210000000000"


@pytest.mark.conformance("CiA 301", "once an error, and once its end (0x0000)")
def test_an_error_that_is_raised_again_is_reported_once() -> None:
    rig = Rig()
    emergency = rig.node.emergency
    emergency.bus.now_ns = rig.now_ns
    for _ in range(5):
        emergency.raise_error(0xFF01, 3)
    assert rig.wait(0) == ["081#01FF810300000000"]
    emergency.clear(0xFF01)
    emergency.clear(0xFF01)
    assert rig.wait(0) == ["081#0000000000000000"]
