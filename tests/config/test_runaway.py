"""How far an axis can run away while nobody sees it: the figures, what is refused, and what the envelope lets by."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.cli import main
from fffo_drive.config.axis import AxisFile, blind_ticks, envelope_config, model_of, read_axis
from fffo_drive.config.runaway import OVERSPEED_SHARE, accepted_words, runaway_of, runaway_problems
from fffo_drive.control.envelope import (
    TRIP_FEEDBACK_MISSING,
    TRIP_NONE,
    EnvelopeInputs,
    envelope_at_rest,
    envelope_step,
)
from fffo_drive.workflows.commission import commissioning_plan
from fffo_drive.workflows.plan import make_plan

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SHIPPED = CONFIGS / "axis_canopen.yaml"
MODEL = model_of(SHIPPED, read_axis(SHIPPED))


def axis_with(rate_hz: int = 2000, **limits) -> AxisFile:
    """The shipped axis with other limits."""
    content = yaml.safe_load(SHIPPED.read_text())
    content["envelope"].update(limits)
    content["loop"] = {"rate_hz": rate_hz}
    return AxisFile.model_validate(content)


def written(tmp_path, **limits) -> Path:
    content = yaml.safe_load(SHIPPED.read_text())
    content["envelope"].update(limits)
    content["model"] = str(CONFIGS / "models" / "table1.yaml")
    path = tmp_path / "axis.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def gained_by_an_axis_in_free_flight(axis: AxisFile) -> tuple[float, int]:
    """Speed (rps) that an axis without friction gains from the last feedback until the torque is gone, and the ticks.

    The law asks for everything from the first tick without an answer on; a command acts from the next SYNC to the one
    after it.
    """
    config, state = envelope_config(axis), envelope_at_rest()
    believed = MODEL.axis_config()
    speed_rps, acting_a, trip, age = 0.0, 0.0, TRIP_NONE, 0
    while trip == TRIP_NONE or acting_a:
        age += 1
        wanted_a = 1e3 if trip == TRIP_NONE else 0.0
        seen = EnvelopeInputs(
            wanted_a,
            0.0,
            0.0,
            0.0,
            age,
            0,
            0x1637,
            0,
            0,
            False,
            False,
            0,
            -1,
            0,
            trip == TRIP_NONE,
            True,
            False,
            False,
            False,
            0,
            False,
        )
        command_a, _, found, state = envelope_step(config, state, seen)
        trip = trip or found
        speed_rps += acting_a * believed.torque_constant_nm_per_a / believed.inertia_nm_s2_per_rev * config.period_s
        acting_a = command_a
    assert trip == TRIP_FEEDBACK_MISSING
    return speed_rps, age


@given(
    ticks=st.integers(1, 400),
    current_a=st.floats(8.5, 200.0),
    rate_hz=st.sampled_from([100, 500, 1000, 2000]),
)
def test_an_axis_without_friction_gains_no_more_than_that(ticks, current_a, rate_hz):
    axis = axis_with(rate_hz, feedback_missing_ticks=ticks, current_limit_a=current_a, slew_a_per_s=1e7, i2t_time_s=600)
    found = runaway_of(axis, MODEL)
    gained_rps, _ = gained_by_an_axis_in_free_flight(axis)
    assert gained_rps <= found.gained_rps * (1 + 1e-12)
    assert gained_rps >= found.gained_rps * (ticks - 2) / ticks  # and not far less
    assert found.gained_rev == pytest.approx(0.5 * found.gained_rps * ticks / rate_hz)
    refused = bool(runaway_problems(axis, MODEL))
    assert refused == (found.gained_rps > OVERSPEED_SHARE * axis.envelope.speed_limit_rps)


@pytest.mark.parametrize("rate_hz", [500, 1000, 2000])
def test_the_default_lasts_as_long_at_every_rate_and_the_shipped_axis_is_safe(rate_hz):
    axis = axis_with(rate_hz)
    assert blind_ticks(axis) == 2 * rate_hz // 1000 or rate_hz == 500
    assert runaway_of(axis, MODEL).blind_s == pytest.approx(2e-3)
    assert runaway_problems(axis, MODEL) == []


def test_every_way_to_the_drive_refuses_and_says_what_to_set(tmp_path, capsys):
    path = written(tmp_path, feedback_missing_ticks=44)
    line = next(k for k, text in enumerate(path.read_text().splitlines(), 1) if "feedback_missing_ticks" in text)
    wanted = (
        f"{path}:{line}: envelope.feedback_missing_ticks: blind for at most 44 ticks = 22 ms: 48.6 rps and 0.53 rev"
    )
    for start in (make_plan, commissioning_plan):
        with pytest.raises(Exception, match=r"at most 4 ticks, or a lower current_limit_a, or accept it"):
            start(path)
    for words in (["config", "check"], ["run"], ["serve"], ["commission", "--yes"]):
        assert main([*words, str(path)]) == 78
        assert wanted in capsys.readouterr().err


def test_what_is_accepted_by_name_is_reported_each_time(tmp_path, capsys):
    path = written(tmp_path, feedback_missing_ticks=44, accept_runaway=True)
    axis = read_axis(path)
    (words,) = accepted_words(axis, MODEL)
    assert "48.6 rps" in words
    for _ in range(2):
        assert main(["config", "check", str(path)]) == 0
        assert f"  warning: {words}\n" in capsys.readouterr().out
    assert accepted_words(axis_with(accept_runaway=True), MODEL) == []  # it accepts nothing that is not there


def test_where_one_tick_is_too_long_no_number_of_ticks_is_proposed():
    (problem,) = runaway_problems(axis_with(feedback_missing_ticks=1, current_limit_a=90), MODEL)
    assert "a lower current_limit_a" in problem
    assert "at most 0" not in problem


def test_the_figures_are_printed_for_the_shipped_axis(capsys):
    assert main(["config", "check", str(SHIPPED)]) == 0
    said = capsys.readouterr().out
    assert "without feedback: blind for at most 4 ticks = 2 ms: 4.41 rps and 0.0044 rev at current_limit_a, 18%" in said
    assert "without this PC: the drive holds its last command for 20 ms" in said
    assert "with the quota of 20 GB the last " in said
