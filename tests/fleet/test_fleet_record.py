"""The record of a run: what it says of motion, residual, temperature and ticks, and how small it is."""

from __future__ import annotations

import operator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from fleet.fleet_rig import FACTS, KT, RATE_HZ, TRUTH, torque_nm, write_run

import fffo_drive as fd
from fffo_drive.fleet import pieces
from fffo_drive.fleet.measure import measured
from fffo_drive.fleet.place import digest_of
from fffo_drive.fleet.regress import PARAMETERS, Balance, balance_columns, balance_of, solve
from fffo_drive.fleet.schema import BAND_EDGES_HZ, RECORD_SCHEMA, file_bytes, table_of
from fffo_drive.identification.dataset import DataError, load_record
from fffo_drive.identification.kinematics import DEFAULT_CUTOFF_HZ
from fffo_drive.identification.rows import rows_at, stretches_of
from fffo_drive.recording.reader import RowBlocks, read_run
from fffo_drive.units import TWO_PI
from fffo_drive.workflows.recorded_facts import facts_in

AXIS = Path(__file__).resolve().parents[2] / "configs" / "axis_simulated.yaml"
LARGEST_BYTES = 4096


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Two recordings of the simulated axis, 12 s each."""
    directory = tmp_path_factory.mktemp("recorded")
    for seed in (3, 4):
        profile = directory / f"short{seed}.yaml"
        profile.write_text(f"profile: {{kind: paper, duration_s: 12, seed: {seed}}}\n")
        fd.run(AXIS, directory / f"short{seed}.mcap", toggle="ff", profile=profile)
    return [directory / "short3.mcap", directory / "short4.mcap"]


def record(path, facts=FACTS):
    return measured(path, digest_of(path), facts)


def test_records_of_recordings_add_up_to_the_fit_on_their_rows_joined(recordings):
    total, columns, target = Balance(np.zeros((8, 8)), np.zeros(8), 0.0, 0.0, 0.0), [], []
    for path in recordings:
        facts = facts_in(read_run(path))
        one = load_record(path, facts)
        cutoff_hz = min(DEFAULT_CUTOFF_HZ, 0.1 / one.period_s)
        stretches, _ = stretches_of([one], cutoff_hz)
        made = record(path, None)
        rows = rows_at(stretches, cutoff_hz, made["delay_s"])
        columns.append(balance_columns(rows, facts)[rows.sliding])
        target.append(rows.torque_nm[rows.sliding])
        assert made["rows"] == columns[-1].shape[0]
        total = Balance(*map(operator.add, total, balance_of(balance_columns(rows, facts), rows)))
        assert made["energy_nm2"] == pytest.approx(float(target[-1] @ target[-1]), rel=1e-12)
    wanted, *_ = np.linalg.lstsq(np.concatenate(columns), np.concatenate(target), rcond=None)
    assert solve(total).theta == pytest.approx(wanted, rel=1e-6, abs=1e-9)


def test_every_column_is_filled_and_ticks_are_those_of_the_recording(recordings):
    run = read_run(recordings[0])
    made = record(recordings[0], None)
    given = {"drive", "model", "path", "start"}
    without = {"temperature_degc", "temperature_low_degc", "temperature_high_degc"}
    assert set(made) == set(RECORD_SCHEMA.names) - given - without
    assert made["ticks"] == len(run.rows)
    assert made["late"] == int(run.rows["late"].sum())
    assert made["skipped"] == int(run.rows["tick"][-1] - run.rows["tick"][0]) + 1 - len(run.rows)
    assert made["trip"] == 0
    assert made["complete"]
    assert sum(made["speed_share"]) == pytest.approx(1.0)
    assert sum(made["angle_share"]) == pytest.approx(1.0)


def same(one, other, rel=1e-6, gap_rel=1e-3):
    """Numbers that agree but for rounding; of the gap, whose law begins anew in each piece, a little less."""
    assert one.keys() == other.keys()
    for name, value in one.items():
        if isinstance(value, float | np.ndarray):
            number = np.asarray(value, dtype=np.float64)
            scale = float(np.nanmax(np.abs(number), initial=0.0)) * (gap_rel if name.startswith("gap_") else rel)
            np.testing.assert_allclose(other[name], number, rtol=0.0, atol=scale, err_msg=name)
        elif name != "run":
            assert other[name] == value, name


def test_in_pieces_and_at_once_the_record_is_the_same(recordings, monkeypatch):
    """But for the bands: a piece of 4 s has a spectrum of its own, in which 0.25 Hz is one line."""
    at_once = record(recordings[0], None)
    monkeypatch.setattr(pieces, "PIECE_S", 4.0)
    in_pieces = record(recordings[0], None)
    bands, own = (np.asarray(one.pop("band_rms_nm"))[BAND_EDGES_HZ[:-1] > 4.0] for one in (at_once, in_pieces))
    np.testing.assert_allclose(own, bands, rtol=0.5)
    assert float(own @ own) == pytest.approx(float(bands @ bands), rel=0.1)
    same(at_once, in_pieces)


def test_of_an_axis_that_pauses_and_reverses_the_pieces_know_what_was_before(tmp_path, monkeypatch):
    """Between two pieces the axis stands for longer than their margin: the direction that it had goes with it."""
    time_s = np.arange(0.0, 30.0, 1.0 / RATE_HZ)
    velocity = np.where(np.mod(time_s, 15.0) < 4.0, np.sin(TWO_PI * 0.5 * time_s), 0.0)
    velocity += np.where((time_s > 12.0) & (time_s < 15.0), 0.5 - 0.5 * np.cos(TWO_PI * time_s / 1.5), 0.0)
    position = 0.013 + np.cumsum(velocity) / RATE_HZ  # no stop at the edge of a bin of the angle
    acceleration = np.gradient(velocity, 1.0 / RATE_HZ)
    current = torque_nm(position, velocity, acceleration, TRUTH) / KT
    table, path = np.stack([time_s, position, current], axis=1), tmp_path / "pauses.csv"
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header="time_s,position_rev,current_command_a", comments="")
    made = []
    for length_s in (60.0, 7.0, 9.5):
        monkeypatch.setattr(pieces, "PIECE_S", length_s)
        made.append(record(path))
        made[-1].pop("band_rms_nm")
        made[-1] = {name: value for name, value in made[-1].items() if not name.startswith("gap_")}
    same(made[0], made[1])
    same(made[0], made[2])


def test_losses_of_ticks_and_a_torn_end_make_the_same_record_in_pieces(recordings, tmp_path, monkeypatch):
    torn = tmp_path / "torn.mcap.part"
    torn.write_bytes(recordings[0].read_bytes()[:-200_000])
    at_once = record(torn, None)
    assert not at_once["complete"]
    monkeypatch.setattr(pieces, "PIECE_S", 3.0)
    in_pieces = record(torn, None)
    for one in (at_once, in_pieces):
        one.pop("band_rms_nm")
    same(at_once, in_pieces)


def test_what_a_record_takes_does_not_grow_with_the_recording(recordings, monkeypatch):
    """Rows that are held at a time, by the blocks of the recording and the pieces that are made of them."""
    monkeypatch.setattr(pieces, "PIECE_S", 1.0)
    monkeypatch.setattr(pieces, "MARGIN_S", 0.5)
    sizes = [piece.record.samples for piece in pieces.LogPieces(recordings[0], None, "")]
    assert len(sizes) >= 11
    assert max(sizes) <= 2 * 2000 + 2
    blocks = [block.rows.nbytes for block in RowBlocks(recordings[0])]
    assert max(blocks) < 300_000


def test_estimates_are_those_of_the_axis(tmp_path):
    made = record(write_run(tmp_path / "run.csv", 1, duration_s=40.0))
    for name in ("inertia_nm_s2_per_rev", "viscous_nm_per_rps", "coulomb_nm", "offset_nm"):
        assert abs(made[name] - TRUTH[name]) < 4.0 * made[f"{name}_sd"] + 0.05 * abs(TRUTH[name]), name


def test_a_wave_of_the_angle_stands_at_its_order_with_its_amplitude(tmp_path):
    made = record(write_run(tmp_path / "run.csv", 1, noise_nm=1e-3, duration_s=40.0, wave=(7.0, 0.008)))
    assert made["wave_order"] == 7
    assert made["wave_share"] > 0.6
    amplitude = np.asarray(made["order_amplitude_nm"])
    assert amplitude[6] == pytest.approx(0.008, rel=0.1)
    assert np.isnan(amplitude[99])  # too fast for the filter


def test_bands_hold_the_residual(tmp_path):
    made = record(write_run(tmp_path / "run.csv", 2, noise_nm=5e-3, duration_s=40.0))
    bands = np.asarray(made["band_rms_nm"])
    assert bands.size == BAND_EDGES_HZ.size - 1
    assert float(np.sqrt(np.sum(bands**2))) == pytest.approx(made["rms_nm"], rel=0.05)


def test_a_logged_temperature_is_in_the_record(tmp_path):
    warm = np.linspace(30.0, 40.0, 4000)
    made = record(write_run(tmp_path / "run.csv", 1, more={"temperature_degc": warm}))
    assert made["temperature_degc"] == pytest.approx(35.0, abs=0.01)
    assert (made["temperature_low_degc"], made["temperature_high_degc"]) == (30.0, 40.0)


def test_a_table_without_facts_and_a_run_that_hardly_moves_are_refused_with_a_word(tmp_path):
    path = write_run(tmp_path / "run.csv", 1)
    with pytest.raises(DataError, match=r"--drive FILE"):
        record(path, None)
    still = tmp_path / "still.csv"
    time_s = np.arange(0.0, 4.0, 2e-3)
    position = 1e-4 * time_s  # slower than the sensor's counts allow to tell its direction
    np.savetxt(
        still, np.stack([time_s, position, np.sin(9.0 * time_s)], axis=1), fmt="%.9g", delimiter=",",
        header="time_s,position_rev,current_command_a", comments="",
    )  # fmt: skip
    with pytest.raises(DataError, match="hardly anything moves"):
        record(still)


def test_a_record_takes_at_most_4_kb(recordings):
    """Merged, where what describes the columns weighs nothing; every number is of its own."""
    made = record(recordings[0], None) | {"drive": "d", "model": "m", "path": "/a/run.mcap", "start": 0}
    draw = np.random.default_rng(1)
    rows = [_shaken(made, draw, number) for number in range(300)]
    assert len(file_bytes(table_of(rows))) / len(rows) < LARGEST_BYTES
    assert pa.types.is_timestamp(RECORD_SCHEMA.field("start").type)
    assert set(PARAMETERS) < set(RECORD_SCHEMA.names)


def _shaken(row, draw, number):
    shaken = {
        name: np.asarray(value) * draw.uniform(0.9, 1.1, np.shape(value))
        if isinstance(value, float | np.ndarray)
        else value
        for name, value in row.items()
    }
    return shaken | {"run": f"{number:064x}"}
