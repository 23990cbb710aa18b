"""An undeclared effect of the plant and its feed-forward in the loop: the error falls, every row replays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fffo_drive.config.axis import AxisFile, build_profile, controller_config, envelope_config
from fffo_drive.config.effects import compensation_table
from fffo_drive.config.session import session_config
from fffo_drive.control.controller import pack_controller
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig
from fffo_drive.evaluation.metrics import run_metrics
from fffo_drive.evaluation.replay_runs import ReplayedLaw, Replayer
from fffo_drive.model.parameters import EffectModel, Quantity, read_model
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime.runs import simulated_ring_rows
from fffo_drive.runtime.session import Session

PLANT = replace(
    PlantConfig(), effects=(EffectConfig("cogging", {"amplitude_nm": 0.0075, "order": 6.0, "phase_rev": 0.0}),)
)
AXIS = AxisFile.model_validate({
    "name": "end_to_end", "drive": {"kind": "simulated", "file": "none"}, "model": "none",
    "controller": {
        "proportional_a_per_rps": 0.975, "integral_a_per_rev": 9.75, "current_limit_a": 12,
        "feedforward": {"inertia": True, "preview": True, "delay_aware": True},
    },
    "envelope": {
        "current_limit_a": 14, "continuous_current_a": 14, "speed_limit_rps": 25, "following_error_rps": 8,
    },
    "profile": {"kind": "paper", "duration_s": 10},
})  # fmt: skip
PERIOD_S = AXIS.loop.period_s
PROFILE = build_profile(AXIS.profile, PERIOD_S)


@pytest.fixture(scope="module")
def models(request):
    """Without the effect, and with it."""
    model = read_model(request.config.rootpath / "configs" / "models" / "table1.yaml")
    values = {"cos_nm": 0.0, "sin_nm": -0.0075, "order": 6.0}
    cogging = EffectModel(name="cogging", parameters={key: Quantity(value=value) for key, value in values.items()})
    return model, model.model_copy(update={"effects": [cogging]})


def run(model, in_service=None):
    drive = SimulatedDrive(PLANT)
    drive.connect()
    rows = simulated_ring_rows(PROFILE, AXIS.loop.tail_s)
    with Session(drive, session_config(AXIS, model, PROFILE.values.size, rows)) as session:
        if in_service is not None:
            session.request(b.EFFECTS, in_service)
        records = session.records.listen(lambda record: None)
        session.run_profile(PROFILE, 1)
        assert session.status(b.TRIP) == 0
        return RingReader(session.ring).read().rows, records


def replayed(rows, records, instead=None):
    replayer = Replayer(instead)
    replayer.take(rows, records)
    return replayer.report


def law(model):
    return ReplayedLaw(
        pack_controller(controller_config(AXIS, model)), compensation_table(AXIS, model), envelope_config(AXIS)
    )


@pytest.mark.slow
def test_the_error_falls_and_every_row_replays(models):
    runs = [run(model) for model in models]
    without, with_effect = (rows for rows, _ in runs)
    ise = [run_metrics(rows, PERIOD_S, PROFILE.values.size, "true_velocity_rps").ise for rows in (without, with_effect)]
    assert ise[1] < 0.3 * ise[0]
    for one, model in zip(runs, models, strict=True):
        assert replayed(*one).exact
        assert replayed(*one, law(model)).exact
    assert not without["effects_nm"].any()
    assert not without["effects"].any()
    acting = with_effect["mode"] == 1
    assert (with_effect["effects"][acting] == 1).all()
    assert 0.0074 < np.abs(with_effect["effects_nm"]).max() <= 0.0075 * (1.0 + 1e-9)
    assert not replayed(*runs[1], law(models[0])).exact


@pytest.mark.slow
def test_an_effect_out_of_service_gives_nothing_and_replays(models):
    rows, records = run(models[1], in_service=0)
    assert not rows["effects_nm"].any()
    assert not rows["effects"].any()
    assert replayed(rows, records).exact
