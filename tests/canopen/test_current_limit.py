"""The drive's own current limit: by its objects, at the bring-up, and what the law makes of it."""

from __future__ import annotations

import dataclasses
import math
import struct
from pathlib import Path

import numpy as np
import pytest
import yaml
from scripted_node import ScriptedNode, servo_dictionary

import fffo_drive as fd
from fffo_drive.can.link import free_loopback_port
from fffo_drive.cli import main
from fffo_drive.config.checks import drive_limit_words
from fffo_drive.control.controller import ControllerConfig, controller_at_rest, controller_step
from fffo_drive.control.envelope import LIMIT_CONTROLLER, LIMIT_DRIVE
from fffo_drive.control.feedforward import NO_FEEDFORWARD, steady_reference
from fffo_drive.control.friction_observer import TOGGLE_OFF, ObserverConfig
from fffo_drive.control.pi import PiConfig
from fffo_drive.drive.canopen.config import CanopenDriveConfig
from fffo_drive.drive.canopen.current_limit import least_limit
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.port import NO_LIMIT
from fffo_drive.model.friction import FrictionConfig
from fffo_drive.workflows.plan import make_plan

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
NODE = 5
KT, RATED_NM, RATED_A = 0.1, 1.0, 10.0  # one per mille of the rated torque is 0.01 A
MAX_TORQUE, MAX_CURRENT, POSITIVE, NEGATIVE = 0x6072, 0x6073, 0x60E0, 0x60E1


@pytest.mark.parametrize(
    ("values", "limit_a", "source"),
    [
        ({}, math.inf, ""),
        ({MAX_TORQUE: 600}, 6.0, "0x6072"),
        ({MAX_CURRENT: 450}, 4.5, "0x6073"),
        ({MAX_TORQUE: 600, MAX_CURRENT: 450, POSITIVE: 300, NEGATIVE: 900}, 3.0, "0x60E0"),
        ({NEGATIVE: 250, MAX_TORQUE: 1500}, 2.5, "0x60E1"),
        ({MAX_TORQUE: 0, MAX_CURRENT: 0}, math.inf, ""),  # not set up
        ({POSITIVE: 0xFFFF, NEGATIVE: 0x8000}, math.inf, ""),  # none, and a number with a sign
    ],
)
def test_the_least_of_the_objects_limits(values, limit_a, source):
    found = least_limit(values.get, KT, RATED_NM, RATED_A)
    assert found.current_a == pytest.approx(limit_a)
    assert found.source.startswith(source)
    assert (found == NO_LIMIT) == (limit_a == math.inf)


def test_a_limit_of_the_current_needs_the_rated_current():
    assert least_limit({MAX_CURRENT: 450}.get, KT, RATED_NM, None) == NO_LIMIT


@pytest.fixture
def config() -> CanopenDriveConfig:
    return CanopenDriveConfig(
        bus=f"loopback:{free_loopback_port()}",
        node_id=NODE,
        listen_s=0.02,
        period_ns=50_000_000,
        command_timeout_ms=100,
        counts_per_rev=32768,
        velocity_units_per_rps=1000.0,
        torque_constant_nm_per_a=KT,
        rated_torque_nm=RATED_NM,
        answer_timeout_s=2.0,
    )


def test_a_drive_tells_its_limit_when_it_is_connected(config):
    """0x6072 of the node is 1000: 10 A. 0x6073 counts the rated current, which is read where no key has it."""
    with ScriptedNode(config.bus, NODE), CanopenDrive(config) as drive:
        assert drive.current_limit.current_a == pytest.approx(10.0)
        assert drive.current_limit.source == "0x6072, max torque, is 1000"
    objects = servo_dictionary(NODE) | {(MAX_CURRENT, 0): struct.pack("<H", 700), (0x6075, 0): struct.pack("<I", 8000)}
    with ScriptedNode(config.bus, NODE, objects), CanopenDrive(config) as drive:
        assert drive.current_limit.current_a == pytest.approx(5.6)


def test_what_the_bring_up_writes_is_the_limit_and_a_key_has_the_last_word(config):
    written = dataclasses.replace(config, max_torque_permille=400)
    with ScriptedNode(config.bus, NODE), CanopenDrive(written) as drive:
        assert drive.current_limit.current_a == pytest.approx(4.0)
    named = dataclasses.replace(config, current_limit_a=7.5)
    with ScriptedNode(config.bus, NODE), CanopenDrive(named) as drive:
        assert drive.current_limit == (7.5, "drive.current_limit_a")


def test_the_law_takes_the_drives_limit_for_its_own_and_says_so(tmp_path):
    """The simulated drive with a power stage of 3 A, a law with 12 A: no row is limited by the drive."""
    drive = yaml.safe_load((CONFIGS / "simulated_drive.yaml").read_text())
    drive["plant"]["peak_current_a"] = 3.0
    (tmp_path / "drive.yaml").write_text(yaml.safe_dump(drive))
    axis = yaml.safe_load((CONFIGS / "axis_simulated.yaml").read_text())
    axis["drive"]["file"] = "drive.yaml"
    axis["model"] = str(CONFIGS / "models" / "table1.yaml")
    axis["envelope"]["following_error_rps"] = 30.0
    axis["profile"] = {"kind": "points", "points": [[0, 0], [0.1, 0], [0.11, 12], [0.6, 12]]}
    path = tmp_path / "axis.yaml"
    path.write_text(yaml.safe_dump(axis))
    run = fd.simulate(path)
    assert run.fault is None
    limits = run["limits"].astype(int)
    assert (limits & LIMIT_CONTROLLER).any()
    assert not (limits & LIMIT_DRIVE).any()
    assert run["requested_a"].max() > 3.0
    assert run["limited_a"].max() == pytest.approx(3.0)
    assert run["true_velocity_rps"].max() < 12.0 * 1.04


def overshoot(limit_a: float, told: bool = False) -> float:
    """Of a step of 12 rps, in per cent, with a drive that limits itself to 2 A; `told`: by bit 11."""
    inertia, delay, period_s, kt, drive_a = 9.4e-4, 5, 5e-4, 0.148, 2.0
    friction = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, 0)
    law = ControllerConfig(
        PiConfig(0.975, 9.75), ObserverConfig(friction, 5.0, 0.134, 0.1), NO_FEEDFORWARD, kt, limit_a, period_s
    )
    state, velocity, peak, sent = controller_at_rest(), 0.0, 0.0, [0.0] * delay
    for _ in range(3000):
        terms, state = controller_step(law, state, TOGGLE_OFF, steady_reference(12.0), velocity, 0.0, velocity, 0.0)
        given = float(np.clip(sent[-delay], -drive_a, drive_a))
        if told and given != sent[-delay]:
            state = state._replace(limited=True)  # as guard_step does with bit 11
        sent.append(terms.command_a)
        velocity += period_s / inertia * (kt * given - 0.003 * velocity)
        peak = max(peak, velocity)
    return 100.0 * (peak / 12.0 - 1.0)


def test_a_law_that_knows_the_drives_limit_does_not_wind_up():
    """The integral is held while the law's limit, or bit 11, says that there is no more torque; else it winds up."""
    unknown, known, told = overshoot(12.0), overshoot(2.0), overshoot(12.0, told=True)
    assert known < 1.0
    assert told < 2.0
    assert unknown > 10.0


def test_config_check_compares_the_limits_that_a_file_gives(tmp_path, capsys):
    axis = yaml.safe_load((CONFIGS / "axis_canopen.yaml").read_text())
    axis["model"] = str(CONFIGS / "models" / "table1.yaml")
    path = tmp_path / "axis.yaml"
    path.write_text(yaml.safe_dump(axis))
    plan = make_plan(path)
    asked_a = plan.axis.controller.current_limit_a
    assert drive_limit_words(plan.axis, plan.model) == []
    permille = round(500.0 * asked_a * plan.model.torque_constant_nm_per_a / axis["drive"]["rated_torque_nm"])
    for keys, half in (
        ({"max_torque_permille": permille}, "0x6072, max torque"),
        ({"current_limit_a": 0.5 * asked_a}, "drive.current_limit_a"),
        ({"sdo": [{"object": 0x60E0, "value": permille, "bytes": 2, "why": "a limit"}]}, "0x60E0"),
    ):
        path.write_text(yaml.safe_dump(axis | {"drive": axis["drive"] | keys}))
        plan = make_plan(path)
        (text,) = drive_limit_words(plan.axis, plan.model)
        assert f"controller.current_limit_a is {asked_a:g} A, but the drive limits itself to" in text
        assert half in text
    assert main(["config", "check", str(path)]) == 0
    assert "warning: controller.current_limit_a is" in capsys.readouterr().out
