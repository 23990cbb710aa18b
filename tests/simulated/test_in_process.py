"""The simulated drive behind the port: SYNC timing, quantisation, CiA 402 with torque only where it may be, reset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from interpreted import hex_results
from simulated.plant_rig import NO_FRICTION, copy_state, exchange, lively_current, quiet
from simulated.port_rig import FIELDS, PERIOD_NS, Master, short_runs

from fffo_drive.drive.port import Drive, port_receive, port_sleep_until, port_sync
from fffo_drive.drive.simulated import cia402_device as device
from fffo_drive.drive.simulated import state as at
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.drive.simulated.parameters import DeviceConfig, PlantConfig, PlantConfigError
from fffo_drive.drive.simulated.sync_cycle import APPLIED_A, SYNC_NS

COLUMN = {name: k for k, name in enumerate((*FIELDS, "sent_a"))}


def column(rows: np.ndarray, name: str) -> np.ndarray:
    return rows[:, COLUMN[name]]


def enabled(plant: PlantConfig | None = None, config: DeviceConfig | None = None) -> Master:
    master = Master(SimulatedDrive(plant or quiet(), config))
    master.enable()
    assert master.drive.device_state == device.OPERATION_ENABLED
    return master


def test_it_is_a_drive_that_says_what_it_is():
    drive: Drive = SimulatedDrive()
    identity = drive.connect()
    assert "simulated" in identity.device_name
    assert not drive.realtime
    assert drive.feedback is drive.port.feedback
    assert drive.feedback["boot_count"][0] == 1
    assert drive.device_state == device.SWITCH_ON_DISABLED
    drive.close()


def test_a_wrong_configuration_is_refused():
    with pytest.raises(PlantConfigError, match=r"plant\.dc_link_v"):
        SimulatedDrive(PlantConfig(dc_link_v=0.0))
    with pytest.raises(PlantConfigError, match=r"device\.status_period"):
        SimulatedDrive(device=DeviceConfig(status_period=0))


def test_enabling_walks_the_states_and_the_statusword_shows_it():
    master = Master(SimulatedDrive(quiet()))
    sent = (0x00, 0x06, 0x07, 0x0F, 0x0F, 0x07, 0x00, 0x00)
    words = [int(column(master.run(controlword, [0.0]), "statusword")[0]) & 0x6F for controlword in sent]
    # each answer shows what the command of the tick before has made
    assert words == [0x40, 0x40, 0x21, 0x23, 0x27, 0x27, 0x23, 0x40]


def test_a_command_acts_at_the_next_sync():
    """With everything else at its least, the current of sample k flows between SYNC k+1 and SYNC k+2."""
    plant = replace(quiet(friction=NO_FRICTION), delay_s=0.0, current_bandwidth_hz=5000.0)
    plant = replace(plant, resolver=replace(plant.resolver, tracking_hz=2000.0))
    master = enabled(plant)
    rows = master.run(0x0F, [0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    speeds = column(rows, "true_velocity_rps")
    assert speeds[1] == 0.0
    assert speeds[2] == 0.0
    assert speeds[3] > 0.05
    assert speeds[4] == pytest.approx(speeds[3], rel=0.2)


def test_it_is_the_same_plant_as_the_bare_one():
    plant = quiet(friction=PlantConfig().friction)
    commands = np.round(lively_current(0.3) / 0.0083) * 0.0083
    bare = exchange(plant, commands)
    # the bare plant has lived no ticks before; the port needs some to be enabled
    master = enabled(plant)
    rows = master.run(0x0F, commands)
    assert column(rows, "true_velocity_rps") == pytest.approx(bare[:, 3], abs=0.02)
    assert column(rows, "position_rev") == pytest.approx(bare[:, 1] / 2**24, abs=1e-3)


def test_the_command_is_quantised_to_a_thousandth_of_the_rated_torque_and_clamped():
    master = enabled()
    commands = np.array([0.0, 0.00414, 0.00416, -1.0, 1e9, -1e9, np.nan, 100.0])
    sent = column(master.run(0x0F, commands), "sent_a")
    permille = sent / 0.0083
    assert permille == pytest.approx(np.round(permille), abs=1e-9)
    assert permille[:4] == pytest.approx([0, 0, 1, -120], abs=1e-9)
    assert permille[4:7] == pytest.approx([32767, -32767, 0], abs=1e-9)
    assert sent[7] == pytest.approx(100.0, abs=0.0042)


def test_velocity_is_fresh_each_sync_and_the_status_every_so_many():
    master = enabled(config=DeviceConfig(status_period=10))
    first = master.tick
    rows = master.run(0x0F, np.zeros(100))
    ticks = first + np.arange(100)
    assert np.array_equal(column(rows, "velocity_tick"), ticks)
    ages = ticks - column(rows, "status_tick")
    assert ages.max() == 9
    assert np.unique(column(rows, "status_tick")).size == pytest.approx(10, abs=1)


def test_a_change_of_state_is_reported_at_once():
    master = enabled(config=DeviceConfig(status_period=1000))
    master.run(0x0F, np.zeros(5))
    rows = master.run(0x00, np.zeros(3))
    assert column(rows, "status_tick")[1] == column(rows, "velocity_tick")[1]
    assert int(column(rows, "statusword")[1]) & 0x4F == 0x40


def test_an_answer_after_the_cut_off_is_counted_late_and_not_used():
    drive = SimulatedDrive(quiet(), DeviceConfig(turnaround_s=0.0002))
    drive.connect()
    port_sleep_until(drive.port, PERIOD_NS)
    port_sync(drive.port, 0)
    assert port_receive(drive.port, 0, PERIOD_NS + 100_000) == 0
    assert drive.feedback["late_feedback"][0] == 1
    assert drive.feedback["velocity_tick"][0] == -1
    port_sync(drive.port, 1)
    assert port_receive(drive.port, 1, PERIOD_NS + 400_000) == 1
    assert drive.feedback["received_ns"][0] == drive.port.words[SYNC_NS] + 200_000


def test_the_target_is_zeroed_on_the_way_in_and_out():
    master = Master(SimulatedDrive(quiet(friction=NO_FRICTION)))
    for word in (0x06, 0x07, 0x0F, 0x0F):
        master.run(word, [5.0])  # a master that sends a target before it is enabled
    assert master.drive.device_state == device.OPERATION_ENABLED
    assert master.drive.plant_state.values[at.VELOCITY_RPS] == 0.0
    master.run(0x0F, np.full(100, 1.0))
    speed = master.drive.plant_state.values[at.VELOCITY_RPS]
    assert speed > 1.0
    master.run(0x07, np.full(100, 1.0))  # disabled with the target still sent: no more torque, it coasts
    coasting = column(master.run(0x07, np.full(100, 1.0)), "true_velocity_rps")
    assert np.ptp(coasting) < 1e-6
    assert coasting[0] > speed


@pytest.mark.parametrize(("option", "seconds"), [(1, 0.2), (2, 0.05), (3, 0.012)])
def test_a_quick_stop_brakes_and_then_switches_on_disabled(option, seconds):
    """10 rps on ramps of 50 and 200 rps2, and with the 16.6 A that the drive has (2607 rps2)."""
    master = enabled(quiet(friction=NO_FRICTION), DeviceConfig(quick_stop_option=option))
    master.run(0x0F, np.full(127, 1.0))
    start = master.drive.plant_state.values[at.VELOCITY_RPS]
    rows = master.run(0x0B, np.full(1200, 1.0))
    speeds = column(rows, "true_velocity_rps")
    assert master.drive.device_state == device.SWITCH_ON_DISABLED
    stopped_s = np.argmax(np.abs(speeds) < 0.3) * 0.0005
    assert stopped_s == pytest.approx(seconds * start / 10.0, abs=0.05)
    assert speeds.min() > -1.0
    words = column(rows, "statusword").astype(int)
    assert np.any(words & 0x6F == 0x07)


def test_quick_stop_option_zero_lets_the_shaft_coast():
    master = enabled(quiet(friction=NO_FRICTION), DeviceConfig(quick_stop_option=0))
    master.run(0x0F, np.full(100, 1.0))
    speeds = column(master.run(0x0B, np.zeros(200)), "true_velocity_rps")
    assert speeds[-1] == pytest.approx(speeds[20], abs=1e-6)
    assert master.drive.device_state == device.SWITCH_ON_DISABLED


def test_a_drive_that_stays_in_quick_stop_can_be_enabled_again():
    master = enabled(config=DeviceConfig(quick_stop_option=6))
    master.run(0x0F, np.full(300, 0.7))
    master.run(0x0B, np.zeros(1000))
    assert master.drive.device_state == device.QUICK_STOP_ACTIVE
    master.run(0x0F, np.zeros(3))
    assert master.drive.device_state == device.OPERATION_ENABLED


def test_a_fault_brakes_is_announced_and_is_left_by_an_edge_only():
    master = enabled(quiet(friction=NO_FRICTION))
    master.run(0x0F, np.full(200, 1.0))
    master.drive.raise_fault(0x2310)
    rows = master.run(0x0F, np.full(1000, 1.0))
    assert master.drive.device_state == device.FAULT
    assert abs(column(rows, "true_velocity_rps")[-1]) < 0.2
    assert master.drive.feedback["emergency_code"][0] == 0x2310
    assert master.drive.feedback["emergency_count"][0] == 1
    master.run(0x80, np.zeros(5))  # the cause is still there
    assert master.drive.device_state == device.FAULT
    master.drive.clear_fault()
    master.run(0x80, np.zeros(5))  # no edge
    assert master.drive.device_state == device.FAULT
    master.run(0x00, np.zeros(2))
    master.run(0x80, np.zeros(2))
    assert master.drive.device_state == device.SWITCH_ON_DISABLED


def test_a_fault_without_power_moves_nothing():
    master = Master(SimulatedDrive(quiet()))
    master.drive.plant_state.values[at.VELOCITY_RPS] = 5.0
    master.drive.raise_fault(0x7303)
    master.run(0x00, np.zeros(5))
    assert master.drive.device_state == device.FAULT
    assert np.abs(master.drive.plant_state.values[at.CURRENT_A]) < 1e-12


def test_the_limit_is_shown_and_following_is_not_claimed():
    master = enabled(config=DeviceConfig(status_period=1))
    follows = int(column(master.run(0x0F, np.full(20, 1.0)), "statusword")[-1])
    limited = int(column(master.run(0x0F, np.full(20, 30.0)), "statusword")[-1])
    assert follows & device.SW_FOLLOWS_COMMAND
    assert not follows & device.SW_INTERNAL_LIMIT
    assert limited & device.SW_INTERNAL_LIMIT
    assert not limited & device.SW_FOLLOWS_COMMAND


def test_reset_is_a_new_power_on_of_the_same_drive():
    commands = lively_current(0.2)

    def life(drive):
        master = Master(drive)
        master.enable()
        return master.run(0x0F, commands)

    drive = SimulatedDrive(PlantConfig(seed=4))
    port = drive.port
    first = life(drive)
    drive.reset()
    assert np.array_equal(life(drive), first, equal_nan=True)
    drive.reset(5)
    assert not np.array_equal(life(drive), first, equal_nan=True)
    assert drive.port is port
    drive.reset(5)
    assert np.array_equal(life(drive), life(SimulatedDrive(PlantConfig(seed=5))), equal_nan=True)


def test_closing_leaves_no_torque():
    master = enabled(quiet(friction=NO_FRICTION))
    master.run(0x0F, np.full(50, 2.0))
    master.drive.close()
    rows = master.run(0x00, np.zeros(50))
    assert column(rows, "true_velocity_rps")[-1] == pytest.approx(column(rows, "true_velocity_rps")[20], rel=1e-6)


@settings(max_examples=40)
@given(st.lists(st.tuples(st.integers(0, 0xFF), st.floats(-20, 20), st.booleans()), min_size=1, max_size=40))
def test_there_is_no_torque_outside_operation_enabled_but_to_brake(events):
    """Whatever is sent: current is applied in OPERATION ENABLED, and against the motion in the two that brake."""
    master = Master(SimulatedDrive(quiet(friction=NO_FRICTION)))
    for word, current_a, fault in events:
        if fault:
            master.drive.raise_fault(0x1000)
        else:
            master.drive.clear_fault()
        master.run(word, np.full(2, current_a))
        applied_a = master.drive.port.values[APPLIED_A]
        if master.drive.device_state not in (
            device.OPERATION_ENABLED,
            device.QUICK_STOP_ACTIVE,
            device.FAULT_REACTION_ACTIVE,
        ):
            assert applied_a == 0.0


@pytest.mark.slow
def test_compiled_and_interpreted_drives_agree_bit_for_bit():
    assert short_runs() == hex_results("simulated.port_rig", "short_runs")


def test_snapshots_of_the_plant_can_be_taken_from_outside():
    master = enabled()
    master.run(0x0F, np.full(100, 1.0))
    kept = copy_state(master.drive.plant_state)
    assert kept.values[at.VELOCITY_RPS] == master.drive.plant_state.values[at.VELOCITY_RPS]
    assert kept.values is not master.drive.plant_state.values
    assert master.drive.plant_parameters.numbers[at.DC_LINK_V] == 48.0
