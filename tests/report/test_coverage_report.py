"""Pictures of what logs can show, against motions that are known in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fffo_drive.identification.coverage import coverage_of, shown, to_record
from fffo_drive.identification.dataset import Record
from fffo_drive.report.coverage import MOST_RUNS, coverage_figures, coverage_section

PERIOD_S = 1e-3
TIME_S = np.arange(20_000) * PERIOD_S


def record_of(velocity_rps, command_a, name="log"):
    position = np.cumsum(velocity_rps) * PERIOD_S
    return Record(name, Path("log"), PERIOD_S, 0.1, command_a, position, None, None, 1e-6, (), "0")


def figures_of(records, linear=False):
    rows = coverage_figures(records, coverage_of(records), linear)
    return {figure.name: figure for row in rows for figure in row}


def constant(speed_rps=2.0, frequency_hz=12.0):
    """One speed with a little of a sine, and a sine as the command."""
    wave = np.sin(2.0 * np.pi * frequency_hz * TIME_S)
    return record_of(speed_rps + 1e-3 * wave, 0.5 * wave)


def test_at_one_speed_all_of_the_motion_shows_waves_up_to_the_cut_off_over_the_speed():
    records = [constant(2.0)]
    waves = figures_of(records)["data-waves"].series[0]
    assert waves.y == pytest.approx(np.full(waves.y.size, coverage_of(records).cutoff_hz / 2.0), rel=2e-3)
    turning = record_of(3.0 * np.sin(2.0 * np.pi * 0.2 * TIME_S), np.zeros(TIME_S.size))
    finer = figures_of([turning])["data-waves"].series[0]
    assert (np.diff(finer.y) <= 0.0).all()  # the slowest part shows the finest
    middle = finer.y[finer.abscissae.searchsorted(50.0)]  # half of a sine is below sin(pi/4) of its amplitude
    assert middle == pytest.approx(coverage_of([turning]).cutoff_hz / (3.0 * np.sin(np.pi / 4.0)), rel=0.02)


def test_the_spectrum_of_a_sine_stands_at_its_frequency():
    figure = figures_of([constant(frequency_hz=12.0)])["data-frequencies"]
    curve = figure.series[0]
    assert curve.abscissae[curve.y.argmax()] == pytest.approx(12.0, abs=0.26)  # a window of 4 s
    assert [level.upright for level in figure.levels] == [True]


def test_a_page_has_the_words_of_the_terminal_and_a_caption_below_each_picture():
    records = [constant()]
    coverage = coverage_of(records)
    section = coverage_section(records, coverage, linear=False)
    assert all(line in section.text for line in shown(coverage))
    wanted = to_record(coverage)
    assert wanted
    assert all(line[1:].replace("`", "") in section.text for line in wanted)
    assert all(figure.caption.strip() for figure in section.figures)
    assert [figure.width for figure in section.figures] == ["full", *["third"] * 3, *["half"] * 2]


def test_a_linear_axis_has_its_units_and_words():
    records = [constant()]
    figures = figures_of(records, linear=True)
    units = {figure.x.unit for figure in figures.values()} | {figure.y.unit for figure in figures.values()}
    assert {"m", "m/s", "m/s2", "1/m"} <= units
    assert not {"rev", "rps", "rps2", "1/rev"} & units
    said = " ".join(figure.caption for figure in figures.values())
    assert "Mass" in said
    assert "nertia" not in said + coverage_section(records, coverage_of(records), linear=True).text


def test_gaps_are_not_drawn_over_and_short_and_many_runs_are_pictures_too():
    gone = Record(**{**vars(constant()), "breaks": (8_000,)})
    velocity = figures_of([gone])["data-velocity"].series[0]
    assert velocity.y.size == gone.samples
    short = record_of(np.sin(2.0 * np.pi * 5.0 * TIME_S[:700]), np.ones(700))
    many = [Record(**{**vars(short), "name": f"log {k}"}) for k in range(MOST_RUNS + 2)]
    figures = figures_of(many)
    assert len(figures["data-velocity"].series) == MOST_RUNS
    assert f"of {MOST_RUNS + 2} runs" in figures["data-velocity"].caption
