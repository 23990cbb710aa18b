"""Bring-up and a closed loop on a real bus, stepped by SYNC: the recording against the wire, and against physics."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from uml.whole_run import PERIOD_S, WholeRun

from fffo_drive.can.frame import unpack_frame
from fffo_drive.drive.cia402 import is_operation_enabled
from fffo_drive.units import permille_per_a

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

SYNC, RPDO1, TPDO1 = 0x080, 0x201, 0x181
KT_NM_PER_A, RATED_TORQUE_NM = 0.148, 1.2284  # configs/models/table1.yaml, configs/axis_bench.yaml


def data_of(whole_run: WholeRun, can_id: int) -> list[bytes]:
    frames = (unpack_frame(frame.raw) for frame in whole_run.frames)
    return [frame.data for frame in frames if frame.can_id == can_id and not frame.error]


def test_the_run_is_whole(whole_run):
    assert whole_run.run.complete
    assert whole_run.outcome.fault_text is None
    assert whole_run.outcome.gap_text is None
    assert whole_run.identity.product_code == 0x50455332
    rows = whole_run.run.rows
    assert rows["profile_sample"].max() >= int(whole_run.run.metadata["profile_samples"]) - 1
    assert (rows["trip"] == 0).all()


def test_no_current_is_commanded_outside_operation_enabled(whole_run):
    rows = whole_run.run.rows
    enabled = np.array([is_operation_enabled(int(word)) for word in rows["statusword"]])
    assert enabled.any()
    assert (rows["current_command_a"][~enabled] == 0).all()


def test_every_command_of_the_record_went_over_the_wire_in_its_order(whole_run):
    rows = whole_run.run.rows
    torques = np.round(rows["current_command_a"] * permille_per_a(KT_NM_PER_A, RATED_TORQUE_NM)).astype("<i2")
    recorded = b"".join(
        struct.pack("<Hh", int(word), int(torque)) for word, torque in zip(rows["controlword"], torques, strict=True)
    )
    assert np.abs(torques).max() > 50
    on_the_wire = b"".join(data_of(whole_run, RPDO1))
    at = on_the_wire.find(recorded)
    assert at >= 0
    assert at % 4 == 0


def test_every_sync_is_answered_with_what_the_record_says(whole_run):
    """Velocity and position of a row are those of the TPDO that followed its SYNC."""
    rows = whole_run.run.rows
    answered = rows[rows["velocity_age"] == 0]
    assert answered.size > 0.9 * rows.size
    recorded = np.round(answered["velocity_rps"] * 32768).astype(np.int64)
    wire = np.array([struct.unpack_from("<i", data)[0] for data in data_of(whole_run, TPDO1)])
    # a subsequence: late answers and those before and after the recording are left out
    position = 0
    for value in recorded:
        found = np.flatnonzero(wire[position:] == value)
        assert found.size
        position += int(found[0]) + 1


def test_the_plant_made_one_period_with_each_sync(whole_run):
    """The turned angle is the sum of velocities times 0.5 ms, whatever time the machine took."""
    pairs = [struct.unpack("<ii", data) for data in data_of(whole_run, TPDO1)]
    velocity_rps = np.array([pair[0] for pair in pairs]) / 32768
    position_rev = np.array([pair[1] for pair in pairs]) / 32768
    syncs = len(data_of(whole_run, SYNC))
    assert abs(syncs - len(pairs)) <= 2  # nothing was lost on the way
    travelled = np.cumsum(velocity_rps) * PERIOD_S
    moved = position_rev - position_rev[0]
    assert np.abs(moved).max() > 0.005
    assert np.abs(moved - travelled).max() < 0.004  # delays of the resolver's filter at 3 rps


def test_the_axis_followed(whole_run):
    rows = whole_run.run.rows
    inside = rows[rows["profile_sample"] >= 0]
    moving = np.abs(inside["reference_rps"]) > 0.3
    assert np.corrcoef(inside["reference_rps"][moving], inside["velocity_rps"][moving])[0, 1] > 0.8


def test_the_bus_carries_what_it_must_in_the_right_order(whole_run):
    texts = whole_run.texts()
    reset, boot_up = texts.index("000#8201"), texts.index("701#00", texts.index("000#8201"))
    start = texts.index("000#0101")
    first_sync = texts.index("080#")
    assert reset < boot_up < start < first_sync
    pre_operational = len(texts) - 1 - texts[::-1].index("000#8001")
    last_sync = len(texts) - 1 - texts[::-1].index("080#")
    assert last_sync < pre_operational
    assert not any(text.startswith("081#") for text in texts)  # no EMCY
    # the last command: no torque, no voltage
    assert [text for text in texts if text.startswith("201#")][-1] == "201#00000000"
