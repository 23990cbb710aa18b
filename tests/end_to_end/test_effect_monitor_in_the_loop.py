"""The monitor on rows of the loop: a wrong effect goes, a right one stays, however long; switching is no bump."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from fffo_drive.config.axis import AxisFile, build_profile
from fffo_drive.config.session import session_config
from fffo_drive.drive.cia402 import GOAL_ENABLED
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig
from fffo_drive.model.parameters import EffectModel, Quantity, read_model
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime.effect_monitor import EffectMonitor, Phase
from fffo_drive.runtime.runs import simulated_ring_rows
from fffo_drive.runtime.session import Session

pytestmark = pytest.mark.timeout(900)

AMPLITUDE_NM, ORDER = 0.0075, 6.0
WEAK_NM = 0.002  # 8 % of the Coulomb friction
BATCH = 100  # rows: 50 ms
STEADY = {"kind": "paper", "low_rps": 3.0, "high_rps": 3.0, "lowest_hz": 0.2, "highest_hz": 2.0, "slope": 0.0}


def plant(amplitude_nm):
    cogging = EffectConfig("cogging", {"amplitude_nm": amplitude_nm, "order": ORDER, "phase_rev": 0.0})
    return replace(PlantConfig(), effects=(cogging,))


def axis_file(duration_s):
    return AxisFile.model_validate({
        "name": "monitor", "drive": {"kind": "simulated", "file": "none"}, "model": "none",
        "controller": {
            "proportional_a_per_rps": 0.975, "integral_a_per_rev": 9.75, "current_limit_a": 12,
            "feedforward": {"inertia": True, "preview": True, "delay_aware": True},
        },
        "envelope": {
            "current_limit_a": 14, "continuous_current_a": 14, "speed_limit_rps": 25, "following_error_rps": 8,
        },
        "loop": {"longest_profile_s": 700}, "realtime": {"priority": 0, "lock_memory": False, "cpu": "any"},
        "profile": {**STEADY, "duration_s": duration_s},
    })  # fmt: skip


@pytest.fixture(scope="module")
def table_1(request):
    return read_model(request.config.rootpath / "configs" / "models" / "table1.yaml")


def with_cogging(model, sin_nm):
    values = {"sin_nm": sin_nm, "order": ORDER}
    cogging = EffectModel(name="cogging", parameters={key: Quantity(value=value) for key, value in values.items()})
    return model.model_copy(update={"effects": [cogging]})


def rows_of(amplitude_nm, model, effects, duration_s):
    """The loop on the plant, with these bits in service throughout."""
    axis = axis_file(duration_s)
    profile = build_profile(axis.profile, axis.loop.period_s)
    drive = SimulatedDrive(plant(amplitude_nm))
    drive.connect()
    ring_rows = simulated_ring_rows(profile, axis.loop.tail_s)
    with Session(drive, session_config(axis, model, profile.values.size, ring_rows)) as session:
        session.request(b.EFFECTS, effects)
        session.run_profile(profile, 1)
        assert session.status(b.TRIP) == 0
        rows = RingReader(session.ring).read().rows
    return rows[rows["profile_sample"] >= 0]


def watched(amplitude_nm, model, duration_s):
    """The monitor over the run with and the run without, at each time the one that it has asked for."""
    runs = {bits: rows_of(amplitude_nm, model, bits, duration_s) for bits in (0, 1)}
    monitor = EffectMonitor(0.0005, ["cogging"])
    verdicts = []
    for begin in range(0, min(run.size for run in runs.values()), BATCH):
        batch = runs[monitor.effects][begin : begin + BATCH]
        verdicts += [d.verdict for d in monitor.observe(batch) if d.verdict is not None]
    return monitor, verdicts


@pytest.mark.slow
def test_an_effect_with_its_sign_turned_is_taken_out(table_1):
    monitor, verdicts = watched(AMPLITUDE_NM, with_cogging(table_1, AMPLITUDE_NM), 60.0)
    assert monitor.state.phase is Phase.OUT
    assert [verdict.worse for verdict in verdicts] == [True]


@pytest.mark.slow
@pytest.mark.parametrize(("amplitude_nm", "duration_s"), [(AMPLITUDE_NM, 60.0), (WEAK_NM, 300.0)])
def test_a_right_effect_stays_in_service(table_1, amplitude_nm, duration_s):
    monitor, verdicts = watched(amplitude_nm, with_cogging(table_1, -amplitude_nm), duration_s)
    assert monitor.effects == 1
    assert not any(verdict.worse for verdict in verdicts)
    assert verdicts[0].change < 0.0  # it helps


@pytest.mark.slow
def test_switching_is_no_bump(table_1):
    """Into service and out of it some dozens of times while the axis moves, whenever this thread gets its turn."""
    axis = axis_file(60.0)
    profile = build_profile(axis.profile, axis.loop.period_s)
    model = with_cogging(table_1, -AMPLITUDE_NM)
    drive = SimulatedDrive(plant(AMPLITUDE_NM))
    drive.connect()
    ring_rows = simulated_ring_rows(profile, axis.loop.tail_s)
    with Session(drive, session_config(axis, model, profile.values.size, ring_rows)) as session:
        session.request(b.TOGGLE, 1)
        session.request(b.AUTOSTOP, 1)
        number = session.start_profile(profile)
        session.request(b.GOAL, GOAL_ENABLED)
        session.start()
        bits = 1
        while session.running and session.status(b.PROFILE_DONE) != number:
            bits = 1 - bits
            session.request(b.EFFECTS, bits)
            time.sleep(0.005)
        assert session.status(b.TRIP) == 0
        rows = RingReader(session.ring).read().rows
    rows = rows[(rows["profile_sample"] >= 0) & (rows["mode"] == 1)]
    assert np.count_nonzero(np.diff(rows["effects"].astype(int))) >= 4
    period_s = axis.loop.period_s
    fastest_rps = np.abs(rows["velocity_rps"]).max()
    # what the ramp and the angle may change in one tick, the sensor's noise with the latter
    step_nm = AMPLITUDE_NM * (period_s / 0.25 + 2.0 * np.pi * ORDER * (fastest_rps * period_s + 1e-3))
    assert np.abs(np.diff(rows["effects_nm"])).max() <= step_nm
    assert np.abs(rows["effects_nm"]).max() <= AMPLITUDE_NM * (1.0 + 1e-9)
    steps_a = np.abs(np.diff(rows["limited_a"]))
    assert steps_a.max() <= axis.envelope.slew_a_per_s * period_s * (1.0 + 1e-9)
    steady = rows_of(AMPLITUDE_NM, model, 0, 60.0)
    assert np.abs(rows["error_rps"]).max() <= 1.1 * np.abs(steady["error_rps"]).max()
