"""Keys of the drive section on faults, warnings and the brake, and what one count on the wire is."""

from __future__ import annotations

import pytest
from config.test_files import BUS, errors_of, write

from fffo_drive.cli import main
from fffo_drive.config.axis import loop_config, model_of, read_axis
from fffo_drive.config.checks import bus_problems
from fffo_drive.config.drive_section import CanopenDriveSection
from fffo_drive.config.resolution import coarse_words, resolution_of
from fffo_drive.units import NS_PER_S

REMOTE, FOLLOWS = 1 << 9, 1 << 12


def axis_with(tmp_path, *keys):
    return read_axis(write(tmp_path, BUS.replace("node_id: 1", "\n  ".join(["node_id: 1", *keys]))))


@pytest.mark.parametrize(
    ("keys", "served", "delay_ticks"),
    [
        ((), REMOTE | FOLLOWS, 0),
        (("unserved_status_bits: [12]",), REMOTE, 0),
        (("unserved_status_bits: [9, 12]", "enable_delay_s: 0.35"), 0, 700),
        (("unserved_status_bits: [9, 9]",), FOLLOWS, 0),
    ],
)
def test_bits_and_delay_reach_the_loop(tmp_path, keys, served, delay_ticks):
    loop = loop_config(axis_with(tmp_path, *keys))
    assert (loop.served_status_bits, loop.enable_delay_ticks) == (served, delay_ticks)
    assert loop.enable_delay_s == pytest.approx(delay_ticks / 2000)


def test_codes_reach_the_drive(tmp_path):
    section = axis_with(tmp_path, "warning_codes: [0xFF00, 0x8611]", "unserved_status_bits: [9]").drive
    assert isinstance(section, CanopenDriveSection)
    config = section.drive_config(0.148, NS_PER_S // 2000)
    assert config.warning_codes == (0xFF00, 0x8611)
    assert config.unserved_status_bits == (9,)


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("warning_codes: [0]", "warning_codes"), ("warning_codes: [0x10000]", "warning_codes"),
        ("unserved_status_bits: [10]", "unserved_status_bits"), ("enable_delay_s: -0.1", "enable_delay_s"),
        ("enable_delay_s: 11", "enable_delay_s"),
        ("quick_stop_option: 65538", "drive.quick_stop_option: a number from -32768 to 32767 is needed (got 65538)"),
        ("fault_reaction_option: -32769", "drive.fault_reaction_option"),
    ],
)  # fmt: skip
def test_what_is_no_code_no_bit_and_no_delay_is_refused_with_its_key(tmp_path, key, said):
    assert said in errors_of(write(tmp_path, BUS.replace("node_id: 1", f"node_id: 1\n  {key}")))


def test_one_count_of_each_word(tmp_path):
    axis = axis_with(tmp_path)
    model = model_of(tmp_path / "axis.yaml", axis)
    one = resolution_of(axis, model)
    assert one.torque_nm == pytest.approx(1.2284e-3)
    assert one.current_a == pytest.approx(1.2284e-3 / model.torque_constant_nm_per_a)
    assert one.velocity_rps == one.position_rev == pytest.approx(2.0**-15)
    assert coarse_words(axis, model) == []


def test_rpm_are_coarse_against_the_observers_band(tmp_path, capsys):
    """EPOS4 and Nanotec count rpm by default (0x60A9): 1/60 rps is a sixth of the band of 0.1 rps."""
    axis = axis_with(tmp_path).model_copy()
    axis = axis.model_copy(update={"drive": axis.drive.model_copy(update={"velocity_units_per_rps": 60.0})})
    model = model_of(tmp_path / "axis.yaml", axis)
    (said,) = coarse_words(axis, model)
    assert said.startswith("drive.velocity_units_per_rps: one unit of 0x606C is 0.0167 rps, 17% of controller.observer")
    fine = axis.model_copy(update={"drive": axis.drive.model_copy(update={"velocity_units_per_rps": 600.0})})
    assert coarse_words(fine, model) == []


def test_a_rated_torque_far_above_the_friction_is_reported(tmp_path):
    axis = axis_with(tmp_path)
    model = model_of(tmp_path / "axis.yaml", axis)
    large = axis.model_copy(update={"drive": axis.drive.model_copy(update={"rated_torque_nm": 12.0})})
    (said,) = coarse_words(large, model)
    assert said.startswith("drive.rated_torque_nm: one per mille of 0x6071 is 0.012 Nm, 18% of the model's static")


def test_config_check_tells_the_counts(tmp_path, capsys):
    path = write(tmp_path, BUS)
    assert main(["config", "check", str(path)]) == 0
    said = capsys.readouterr().out
    assert "one per mille of 0x6071 is" in said
    assert "one unit of 0x606C is 3.05e-05 rps" in said


@pytest.mark.parametrize(
    ("keys", "envelope", "said"),
    [
        (("status_every: 100",), "", "envelope.status_missing_ticks: 100 SYNCs, but the statusword comes with every"),
        (("drive_heartbeat_ms: 500",), "", "envelope.heartbeat_timeout_s: 0.5 s, but the drive's heartbeat comes"),
        (("heartbeat_ms: 500", "heartbeat_timeout_ms: 1000", "silence_detection: life_guarding"), "",
         "the drive's heartbeat comes every 0.5 s (drive.heartbeat_ms)"),
        (("status_every: 99", "drive_heartbeat_ms: 499"), "", ""),
        (("drive_heartbeat_ms: 5000",), "heartbeat_timeout_s: 0", ""),
    ],
)  # fmt: skip
def test_a_limit_shorter_than_the_time_between_two_messages_is_refused(tmp_path, keys, envelope, said):
    text = BUS.replace("node_id: 1", "\n  ".join(["node_id: 1", *keys]))
    path = write(tmp_path, text.replace("envelope:", f"envelope:\n  {envelope}"))
    axis = read_axis(path)
    found = bus_problems(axis, model_of(path, axis))
    assert [said in text for text in found] == [True] * bool(said)


def test_a_command_timeout_shorter_than_two_periods_is_refused(tmp_path):
    at_50_hz = BUS + "loop: {rate_hz: 50}\n"
    path = write(tmp_path, at_50_hz)
    axis = read_axis(path)
    assert bus_problems(axis, model_of(path, axis)) == [
        "drive: command_timeout_ms 20: at least twice the period (40 ms), or one late command stops the drive; "
        "the period is 1 / loop.rate_hz"
    ]
    for timeout_ms in (0, 40):
        axis = read_axis(
            write(tmp_path, at_50_hz.replace("node_id: 1", f"node_id: 1\n  command_timeout_ms: {timeout_ms}"))
        )
        assert bus_problems(axis, model_of(path, axis)) == []
