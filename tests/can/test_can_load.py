"""The sum for the bus against figures worked out by hand (1 Mbit/s, 2 kHz)."""

import pytest

from fffo_drive.can.load import BLOCKING_BITS, Traffic, bus_load, period_chain

SYNC = Traffic("SYNC", 0x80, 0, 2000.0)
COMMAND = Traffic("RPDO1", 0x205, 4, 2000.0)
MOTION = Traffic("TPDO1", 0x185, 8, 2000.0)
STATUS = Traffic("TPDO2", 0x285, 4, 200.0)


def test_the_basic_set_takes_57_per_cent_at_worst():
    load = bus_load([SYNC, COMMAND, MOTION], 1_000_000)
    assert load.worst == pytest.approx(285 * 2000 / 1e6)
    assert 0.474 < load.typical < load.worst


def test_load_adds_up_and_scales_with_the_bit_rate():
    parts = [bus_load([item], 1_000_000).worst for item in (SYNC, COMMAND, MOTION, STATUS)]
    assert bus_load([SYNC, COMMAND, MOTION, STATUS], 1_000_000).worst == pytest.approx(sum(parts))
    assert bus_load([SYNC], 500_000).worst == pytest.approx(2 * parts[0])


def test_no_traffic_no_load():
    assert bus_load([], 1_000_000) == (0.0, 0.0)


def chain(period_s, host_s=60e-6):
    return period_chain([MOTION], SYNC, COMMAND, bitrate_hz=1e6, period_s=period_s, turnaround_s=50e-6, host_s=host_s)


def test_the_chain_of_a_period():
    steps = chain(500e-6).steps
    assert [step.name for step in steps] == [
        "SYNC", "drive turnaround", "TPDO1", "host", "RPDO1", "blocking frame"
    ]  # fmt: skip
    assert chain(500e-6).worst_s == pytest.approx((55 + 50 + 135 + 60 + 95 + BLOCKING_BITS) * 1e-6)
    assert chain(500e-6).typical_s < chain(500e-6).worst_s


def test_a_chain_fits_or_not():
    assert not chain(500e-6).fits
    assert chain(500e-6).slack_s == pytest.approx(-30e-6)
    assert chain(1e-3).fits
    assert chain(500e-6, host_s=20e-6).fits
