"""Configuration to byte layouts, and every way in which a configuration is refused."""

import dataclasses

import numpy as np
import pytest

from fffo_drive.drive.canopen.config import CanopenDriveConfig, chain_of, load_of, traffic
from fffo_drive.drive.canopen.object_map import (
    FIELD_POSITION,
    FIELD_STATUSWORD,
    FIELD_TORQUE,
    FIELD_VELOCITY,
    MappedObject,
    MappingError,
    PdoMap,
    PdoSlots,
    command_payload,
    feedback_pdos,
    field_table,
    interpolation_period,
)
from fffo_drive.drive.canopen.port_memory import ANSWERS_SYNC, OF_DRIVE, OF_LOOP, OF_SERVICE, known_identifiers

CONFIG = CanopenDriveConfig(
    bus="loopback:20000",
    node_id=5,
    period_ns=500_000,
    counts_per_rev=32768,
    velocity_units_per_rps=32768.0,
    torque_constant_nm_per_a=0.2,
    rated_torque_nm=4.0,
)


def changed(**facts):
    return dataclasses.replace(CONFIG, **facts)


def test_the_mapping_of_the_house():
    assert CONFIG.command == PdoMap(1, 0x205, 1, (MappedObject(0x6040, 0, 16), MappedObject(0x6071, 0, 16)))
    motion, status, event = CONFIG.answers
    assert [item.word for item in motion.objects] == [0x606C0020, 0x60640020]
    assert [item.word for item in status.objects] == [0x60410010, 0x60770010]
    assert [item.word for item in event.objects] == [0x60410010]
    assert [(p.cob_id, p.transmission) for p in CONFIG.answers] == [(0x185, 1), (0x285, 10), (0x385, 255)]
    assert event.inhibit_ns > 0
    assert feedback_pdos(5, 10, 254)[2].inhibit_ns == event.inhibit_ns  # an event as well, of the vendor's kind
    assert feedback_pdos(5, 10, 0)[2].inhibit_ns == 0  # with the next SYNC: nothing to hold back


def test_tables_for_the_loop():
    known = known_identifiers(CONFIG)
    assert known[:3].tolist() == [[0x185, 8, ANSWERS_SYNC], [0x285, 4, OF_DRIVE], [0x385, 2, OF_DRIVE]]
    ours = {0x080: OF_LOOP, 0x000: OF_SERVICE, 0x605: OF_SERVICE, 0x77F: OF_LOOP}
    ours |= dict.fromkeys((0x205, 0x305, 0x405, 0x505), OF_LOOP)
    assert {int(word): int(kind) for word, _, kind in known[3:]} == ours
    guarded = known_identifiers(changed(silence_detection="life_guarding"))
    assert guarded[-1].tolist() == [0x4000_0705, 0, OF_SERVICE]
    assert field_table(CONFIG.answers).tolist() == [
        [0, 0, 4, 1, FIELD_VELOCITY],
        [0, 4, 4, 1, FIELD_POSITION],
        [1, 0, 2, 0, FIELD_STATUSWORD],
        [1, 2, 2, 1, FIELD_TORQUE],
        [2, 0, 2, 0, FIELD_STATUSWORD],
    ]
    assert known.dtype == field_table(CONFIG.answers).dtype == np.int64
    assert command_payload(CONFIG.command) == bytes(4)


def test_scaling():
    scaling = CONFIG.scaling
    assert scaling.position_rev_per_count == 1 / 32768
    assert scaling.velocity_rps_per_unit == 1 / 32768
    assert scaling.target_units_per_a == pytest.approx(50.0)  # 0.2 Nm/A of 4 Nm
    assert changed(inverted=True).scaling == tuple(-factor for factor in scaling)


@pytest.mark.parametrize(
    ("period_ns", "written"),
    [
        (500_000, (5, -4)),
        (1_000_000, (1, -3)),
        (2_000_000, (2, -3)),
        (250_000, (25, -5)),
        (125_000, (125, -6)),
    ],
)
def test_interpolation_period(period_ns, written):
    value, exponent = interpolation_period(period_ns)
    assert (value, exponent) == written
    assert value * 10.0**exponent == pytest.approx(period_ns * 1e-9)


def test_a_period_that_cannot_be_written():
    with pytest.raises(MappingError, match="333333 ns does not fit 0x60C2"):
        changed(period_ns=333_333)


def pdo(number, cob_id, transmission, *objects):
    return PdoMap(number, cob_id, transmission, tuple(MappedObject(*item) for item in objects))


MOTION = pdo(1, 0x185, 1, (0x606C, 0, 32), (0x6064, 0, 32))
STATUS = pdo(2, 0x285, 1, (0x6041, 0, 16), (0x6077, 0, 16))


@pytest.mark.parametrize(
    ("facts", "text"),
    [
        ({"node_id": 0}, "node_id 0: node ids are 1 to 127"),
        ({"master_id": 128}, "master_id 128"),
        ({"node_id": 127}, "both 127"),
        ({"counts_per_rev": 0}, "counts_per_rev 0: must be above 0"),
        ({"rated_torque_nm": float("nan")}, "rated_torque_nm nan: must be above 0"),
        ({"heartbeat_timeout_ms": 60}, "at least twice heartbeat_ms"),
        ({"abort_connection_option": 0}, "abort_connection_option 0: 1 fault"),
        ({"status_every": 241}, "status_every 241: 1 to 240"),
        ({"tpdos": (MOTION,)}, "no TPDO maps 0x6041; no TPDO maps 0x6077"),
        ({"tpdos": (STATUS,)}, "no TPDO of transmission type 1 maps 0x606C"),
        ({"tpdos": (MOTION._replace(transmission=2), STATUS)}, "type 1 maps 0x606C"),
        ({"tpdos": (MOTION, STATUS._replace(cob_id=0x185))}, "TPDO1 COB-ID 0x185: 0x181 to 0x57F, each only once"),
        ({"tpdos": (MOTION, STATUS._replace(cob_id=0x605))}, "TPDO2 COB-ID 0x605"),
        ({"tpdos": (MOTION, STATUS._replace(transmission=241))}, "TPDO2 transmission type 241"),
        ({"tpdos": (pdo(1, 0x185, 1, (0x606C, 0, 16), (0x6064, 0, 32)), STATUS)}, "0x606C has 32 bits"),
        ({"tpdos": (MOTION, pdo(2, 0x285, 1, (0x6041, 0, 16), (0x6077, 0, 16), (0x2000, 1, 4)))}, "whole bytes"),
        ({"rpdo": pdo(1, 0x205, 1, (0x6040, 0, 16))}, "RPDO1 lacks 0x6071"),
        ({"rpdo": pdo(1, 0x205, 255, (0x6040, 0, 16), (0x6071, 0, 16))}, "a command acts|commands act at SYNC"),
        ({"rpdo": pdo(1, 0x205, 1, (0x6040, 0, 16), (0x6071, 0, 16), (0x60FF, 0, 32))}, "the loop can command"),
    ],
)  # fmt: skip
def test_refused_configurations(facts, text):
    with pytest.raises(MappingError, match=text):
        changed(**facts)


def test_all_problems_come_at_once():
    with pytest.raises(MappingError) as caught:
        changed(heartbeat_timeout_ms=1, abort_connection_option=9, rpdo=pdo(1, 0x205, 1, (0x6040, 0, 16)))
    assert str(caught.value).count(";") == 2


def test_the_sum_for_the_bus():
    names = [item.name for item in traffic(CONFIG)]
    assert names == ["SYNC", "RPDO1", "TPDO1", "TPDO2", "TPDO3", "heartbeat", "drive heartbeat"]
    expected = 2000 * (55 + 95 + 135) + 200 * 95 + (20 + 20) * 65 + 500 * 75  # TPDO3: its inhibit time is 2 ms
    assert load_of(CONFIG).worst == pytest.approx(expected / 1e6)
    quiet = load_of(changed(slots=PdoSlots(event=None)))
    assert quiet.typical == load_of(CONFIG).typical  # a change hardly ever comes
    chain = chain_of(CONFIG, turnaround_s=50e-6, host_s=60e-6)
    assert chain.worst_s == pytest.approx((55 + 50 + 135 + 95 + 60 + 95 + 135) * 1e-6)
    assert chain_of(changed(period_ns=1_000_000), 50e-6, 60e-6).fits
    with_sync = chain_of(changed(status_event=0), turnaround_s=50e-6, host_s=60e-6)
    assert with_sync.worst_s == pytest.approx(chain.worst_s + 75e-6)
    assert with_sync.typical_s == pytest.approx(chain.typical_s)
