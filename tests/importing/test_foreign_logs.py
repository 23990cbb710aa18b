"""Logs of other programs that were read wrong in silence: counters, clocks, names, registers, contradictions, MCAP.

Each is a kind that users of other tools reported; the right value is that of the axis that the log is made of.
"""

from __future__ import annotations

import datetime
import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from importing.axis_log import PERIOD_S, truth

from fffo_drive.cli import main
from fffo_drive.cli.exits import EXIT_BAD_INPUT
from fffo_drive.identification.dataset import record_of_columns
from fffo_drive.identification.facts import facts_of
from fffo_drive.identification.torque_sensor import sensor_remarks
from fffo_drive.importing.candidates import Hints
from fffo_drive.importing.names import meaning_of
from fffo_drive.importing.read import read_source
from fffo_drive.importing.recognise import recognise
from fffo_drive.importing.source import source_of_arrays
from fffo_drive.importing.times import RateNeededError
from fffo_drive.importing.units import split_name
from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.reader import read_run
from fffo_drive.workflows.import_logs import assumptions, recognised, recognised_logs

LOG = truth()
ROWS = np.arange(LOG.time_s.size, dtype=float)
MOTION = {"Angle [deg]": 360.0 * LOG.position_rev, "Speed [rpm]": 60.0 * LOG.velocity_rps, "Current [A]": LOG.current_a}


def imported(columns, **hints):
    return recognised(source_of_arrays(Path("log.csv"), columns), Hints(**hints))


def written(path, columns, delimiter=";"):
    """The columns as text; those that are no numbers as they are."""
    rows = zip(*(c if isinstance(c, list) else [f"{x:.9g}" for x in c] for c in columns.values()), strict=True)
    path.write_text("\n".join(delimiter.join(row) for row in [tuple(columns), *rows]) + "\n")
    return path


# A count of rows is no time

COUNTERS = ["index", "Sample", "n", "#", "No.", "row", "k", "cycle", "tick", "counter", "time", "timestamp", "Zeit"]


@pytest.mark.parametrize("name", [*COUNTERS, "Unnamed: 0", "Sample number", "sample_index", "column 1"])
@pytest.mark.parametrize("first", [0.0, 1.0, 4711.0])
def test_the_rate_of_counted_rows_is_that_of_the_motion(name, first):
    one = imported({name: ROWS + first, **MOTION})
    np.testing.assert_allclose(one.log.columns["time_s"], LOG.time_s, atol=1e-9)
    np.testing.assert_allclose(one.log.columns["velocity_rps"], LOG.velocity_rps, atol=1e-9)
    assert "it counts rows; 500 Hz" in one.found.of("time_s").evidence


def test_counted_rows_without_a_speed_or_its_unit_need_a_rate(tmp_path, capsys, monkeypatch):
    columns = {"Sample": ROWS, "Angle [deg]": MOTION["Angle [deg]"], "Current [A]": LOG.current_a}
    with pytest.raises(RateNeededError, match=r"'Sample' counts rows and is no time.*--rate HZ"):
        imported(columns)
    path = written(tmp_path / "log.csv", columns)
    assert main(["import", str(path), "--out", str(tmp_path / "no"), "--yes"]) == EXIT_BAD_INPUT
    assert "give --rate HZ" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda text: "500")
    assert main(["import", str(path), "--out", str(tmp_path / "out")]) == 0
    np.testing.assert_allclose(read_run(tmp_path / "out" / "log.mcap").column("time_s"), LOG.time_s, atol=1e-9)


def test_counts_of_a_known_turn_tell_the_rate_as_well():
    counts = np.mod(np.floor(4096.0 * LOG.position_rev), 4096.0)
    columns = {"n": ROWS, "Encoder [counts]": counts, "w [rps]": LOG.velocity_rps, "i [A]": LOG.current_a}
    np.testing.assert_allclose(imported(columns, counts_per_turn=4096.0).log.columns["time_s"], LOG.time_s, atol=1e-9)


def test_rows_that_a_counter_misses_are_gaps():
    kept = np.delete(np.arange(ROWS.size), [300, 301, 302])
    one = imported({"Sample": ROWS[kept], **{name: v[kept] for name, v in MOTION.items()}})
    np.testing.assert_allclose(one.log.columns["time_s"], LOG.time_s[kept], atol=1e-9)


def test_milliseconds_that_are_called_so_are_no_count_of_rows():
    one = imported({"Time [ms]": ROWS, "Angle [deg]": MOTION["Angle [deg]"], "Current [A]": LOG.current_a})
    assert one.log.columns["time_s"][-1] == pytest.approx(1e-3 * ROWS[-1])


# Clocks

BEGIN = datetime.datetime(2026, 3, 1, 23, 59, 59, 100_000)
CLOCKS = {
    "German": lambda at, k: at.strftime("%d.%m.%Y %H:%M:%S.%f"),
    "US, half days": lambda at, k: at.strftime("%m/%d/%Y %I:%M:%S.%f %p"),
    "US": lambda at, k: at.strftime("%m/%d/%Y %H:%M:%S.%f"),
    "day first": lambda at, k: at.strftime("%d/%m/%Y %H:%M:%S.%f"),
    "MATLAB": lambda at, k: at.strftime("%d-%b-%Y %H:%M:%S.%f"),
    "pandas": lambda at, k: f"0 days 00:00:{PERIOD_S * k:09.6f}",
    "time of day": lambda at, k: at.strftime("%H:%M:%S.%f"),
    "comma": lambda at, k: at.strftime("%H:%M:%S,%f"),
    "ISO": lambda at, k: at.isoformat(),
    "ISO, UTC": lambda at, k: at.isoformat() + "+00:00",
    "two columns": lambda at, k: at.strftime("%Y-%m-%d;%H:%M:%S.%f"),
    "two columns, German": lambda at, k: at.strftime("%d.%m.%Y;%H:%M:%S.%f"),
    "seconds of the day": lambda at, k: f"{(86_399.1 + PERIOD_S * k) % 86_400.0:.4f}",
}


@pytest.mark.parametrize("kind", CLOCKS)
def test_a_clock_goes_on_over_midnight(tmp_path, kind):
    stamps = [CLOCKS[kind](BEGIN + datetime.timedelta(seconds=PERIOD_S * k), k) for k in range(ROWS.size)]
    heading = "Date;Time" if ";" in stamps[0] else "Time [s]" if kind.startswith("seconds") else "Time"
    (one,) = recognised_logs([written(tmp_path / "log.csv", {heading: stamps, **MOTION})], Hints())
    np.testing.assert_allclose(one.log.columns["time_s"], LOG.time_s, atol=1e-6)
    assert one.found.of("time_s").sure


def test_a_cell_that_is_not_understood_is_named(tmp_path):
    stamps = [f"w09 {k}h" for k in range(ROWS.size)]
    with pytest.raises(RecordingError, match="in line 2 'w09 0h' is neither a number nor a time"):
        read_source(written(tmp_path / "log.csv", {"Time": stamps, **MOTION}))


@pytest.mark.parametrize("again", [False, True], ids=["one heading", "repeated headings"])
def test_stamps_that_begin_anew_are_runs_of_their_own(tmp_path, again):
    texts = []
    for size in (1.0, 0.9, 0.8):
        columns = {"time": LOG.time_s} | {name: size * values for name, values in MOTION.items()}
        texts.append(written(tmp_path / "one.csv", columns).read_text())
    heading = texts[0].partition("\n")[0] + "\n"
    (tmp_path / "three.csv").write_text("".join(texts) if again else heading + "".join(texts).replace(heading, ""))
    out = tmp_path / "out"
    assert main(["import", str(tmp_path / "three.csv"), "--out", str(out), "--yes"]) == 0
    runs = sorted(out.glob("three_run*.mcap"))
    assert [run.name for run in runs] == ["three_run1.mcap", "three_run2.mcap", "three_run3.mcap"]
    for run in runs:
        assert "assumed" not in read_run(run).metadata["remarks"]
        np.testing.assert_allclose(read_run(run).column("time_s"), LOG.time_s, atol=1e-6)


def test_what_one_run_leaves_open_is_open_in_all(tmp_path):
    columns = {"time": LOG.time_s, "theta": LOG.position_rev, "Current [A]": LOG.current_a}
    twice = {
        name: np.concatenate([values, values if name == "time" else 0.9 * values]) for name, values in columns.items()
    }
    runs = recognised_logs([written(tmp_path / "log.csv", twice)], Hints())
    assert [one.found.of("position_rev").sure for one in runs] == [False, False]


def test_a_log_that_was_written_twice_is_one_run(tmp_path):
    twice = {name: np.tile(v, 2) for name, v in {"time_s": LOG.time_s, **MOTION}.items()}
    (one,) = recognised_logs([written(tmp_path / "log.csv", twice)], Hints())
    np.testing.assert_allclose(one.log.columns["time_s"], LOG.time_s, atol=1e-9)
    assert "run 2 is the same and is left out" in one.log.remarks


@pytest.mark.parametrize("share", [0.005, 0.05])
def test_more_than_a_hundredth_of_the_rows_is_not_left_out_without_a_word(share):
    current = LOG.current_a.copy()
    current[10 : 10 + round(share * ROWS.size)] = np.nan
    columns = {"time_s": LOG.time_s, **MOTION, "Current [A]": current}
    if share > 0.01:
        with pytest.raises(RecordingError, match=r"5 % of its rows would be left out.*--drop"):
            imported(columns)
    assert imported(columns, drop=True).log.columns["time_s"].size == np.isfinite(current).sum()


def test_stamps_in_a_unit_that_cannot_be_are_asked_about():
    one = imported({"Time [ms]": LOG.time_s, **MOTION})
    guess = one.found.of("time_s")
    assert (guess.unit, guess.sure) == ("s", False)
    assert "in ms, as it is called, it would be 5e+05 Hz" in guess.evidence
    np.testing.assert_allclose(one.log.columns["time_s"], LOG.time_s)


# Names

CURRENTS = "q_axis_current;I_q;iq;i_q;Iq [A];current_q;q_current;Q-current;motor q axis current;Id/Iq: Iq;Iq_measured"
VELOCITIES = (
    "theta_dot;thetadot;d_theta;phi_p;angle rate;encoder velocity;position_velocity;velocity of encoder;erpm;rpm;"
    "current speed;Istdrehzahl;Vitesse [tr/min];dq;vel_estimate;qvel"
)
POSITIONS = "encoder_position;tachometer;q;current position;rotor position;Lageistwert;qpos;Present_Position;theta"
COMMANDS = "Torque req;TrqDem;Consigne [A];Vorgabe Strom;Torque, Request [Nm];Sollstrom;Iq_setpoint;commanded torque"


@pytest.mark.parametrize(
    ("headings", "quantity", "asked"),
    [
        (CURRENTS, ("current",), False),
        ("u_q;V_q;Uq;q_axis_voltage", ("voltage",), False),
        (VELOCITIES, ("velocity",), False),
        (POSITIONS, ("position",), False),
        (COMMANDS, ("current", "torque"), True),
        ("motor temp [C];temp;housing temp [C];temp_motor", ("temperature",), False),
    ],
)
def test_headings_say_what_a_column_is(headings, quantity, asked):
    for heading in headings.split(";"):
        found = meaning_of(*split_name(heading))
        assert found.quantity in quantity, heading
        assert (found.asked, found.aside) == (asked, False), heading


@pytest.mark.parametrize(
    "heading", ["d_axis_current", "i_d", "current_in", "input_voltage", "predicted torque", "current_limit"]
)
def test_what_does_not_drive_the_motor_is_aside(heading):
    assert meaning_of(*split_name(heading)).aside


def vesc(**changes):
    """As VESC Tool writes it, with the columns that matter."""
    turn, v, i = LOG.position_rev, LOG.velocity_rps, LOG.current_a
    return {
        "ms_today": 41_234_567.0 + 1e3 * LOG.time_s,
        "input_voltage": 48.0 + 0.1 * i,
        "current_motor": i,
        "current_in": 0.2 * i,
        "d_axis_current": 0.01 * np.sin(ROWS),
        "q_axis_current": i,
        "erpm": np.round(420.0 * v),
        "tachometer": np.floor(42.0 * turn),
        "encoder_position": 360.0 * np.mod(turn, 1.0),
        "temp_motor": 30.0 + 1e-3 * ROWS,
        **changes,
    }


@pytest.mark.parametrize("pairs", [7, None], ids=["given", "by the position"])
def test_the_csv_of_vesc_tool_is_read_by_its_electrical_speed(pairs):
    one = imported(vesc(), pole_pairs=pairs)
    found = {guess.signal: guess.column for guess in one.found.guesses}
    assert (found["position_rev"], found["velocity_rps"]) == ("encoder_position", "erpm")
    assert found["current_a"] == "current_motor"
    np.testing.assert_allclose(one.log.columns["velocity_rps"], LOG.velocity_rps, atol=2e-3)
    np.testing.assert_allclose(one.log.columns["temperature_degc"], 30.0 + 1e-3 * ROWS)


def test_an_electrical_speed_alone_needs_the_pole_pairs():
    columns = {"time_s": LOG.time_s, "erpm": 420.0 * LOG.velocity_rps, "current_a": LOG.current_a}
    with pytest.raises(RecordingError, match="'erpm' is in electrical turns a minute: give --pole-pairs N"):
        imported(columns)
    np.testing.assert_allclose(imported(columns, pole_pairs=7).log.columns["velocity_rps"], LOG.velocity_rps)


# Two columns that contradict each other, or are one

CONTRADICTING = {
    "180/pi": (2.0 * np.pi / 360.0, 1.0),
    "2 pi": (1.0, 2.0 * np.pi),
    "10: one of them is in tenths": (1.0, 10.0),
    "a gear of 50": (1.0 / 50.0, 1.0),
    "1000: a thousandth": (1.0, 1000.0),
    "60: one of them is per minute": (1.0, 1 / 60),
}


@pytest.mark.parametrize("meaning", CONTRADICTING)
def test_columns_that_contradict_each_other_are_asked_about(meaning):
    angle, speed = CONTRADICTING[meaning]
    columns = MOTION | {"Angle [deg]": angle * MOTION["Angle [deg]"], "Speed [rpm]": speed * MOTION["Speed [rpm]"]}
    guess = imported({"time_s": LOG.time_s, **columns}).found.of("position_rev")
    assert not guess.sure
    assert meaning in guess.evidence
    said = imported({"time_s": LOG.time_s, **columns}, units={"Angle [deg]": "deg"})
    assert said.found.of("position_rev").sure  # the user knows


def test_degrees_with_rpm_are_not_radians_with_turns():
    """Six and 2 pi: within one tolerance, the nearest is taken."""
    columns = {"time_s": LOG.time_s, "theta": 360.0 * LOG.position_rev, "omega": 60.0 * LOG.velocity_rps}
    one = imported({**columns, "Current [A]": LOG.current_a})
    np.testing.assert_allclose(one.log.columns["velocity_rps"], LOG.velocity_rps)


def test_a_torque_that_is_computed_is_asked_about():
    noise = 0.1 * np.random.default_rng(1).normal(size=ROWS.size)
    columns = {"time_s": LOG.time_s, "pos_rev": LOG.position_rev, "torque_est [Nm]": LOG.current_a}
    both = imported({**columns, "torque_sensor [Nm]": LOG.current_a + noise}).found.of("current_a")
    assert both.column == "torque_sensor [Nm]"
    assert not both.sure
    assert "not measured, computed" in both.evidence


def test_the_velocity_under_another_name_is_not_taken_for_a_torque():
    columns = {"time_s": LOG.time_s, "pos_rev": LOG.position_rev, "torque_1 [Nm]": 3.0 * LOG.velocity_rps}
    alone = imported(columns).found.of("current_a")
    assert "it is the velocity itself" in alone.evidence
    assert not alone.sure
    assert imported({**columns, "torque_2 [Nm]": LOG.current_a}).found.of("current_a").column == "torque_2 [Nm]"


def test_of_numbered_joints_the_one_that_moves_is_taken():
    still = 1e-5 * np.random.default_rng(2).normal(size=ROWS.size)
    one = imported(
        {"time_s": LOG.time_s, "q1_rad": still, "q2_rad": 2 * np.pi * LOG.position_rev, "i_a [A]": LOG.current_a}
    )
    assert one.found.of("position_rev").column == "q2_rad"


def test_of_two_joints_that_move_the_driven_one_is_taken_and_asked_about():
    other = 3.0 * np.sin(0.01 * ROWS)
    one = imported(
        {"time_s": LOG.time_s, "q1_rad": other, "q2_rad": 6.0 * LOG.position_rev, "current [A]": LOG.current_a}
    )
    guess = one.found.of("position_rev")
    assert guess.column == "q2_rad"  # inertia and friction explain its current
    assert not guess.sure
    assert "others may be it as well: 'q1_rad'" in guess.evidence


def test_what_was_assumed_is_in_the_recording_and_what_changes_the_inertia_is_for_the_user(tmp_path, capsys):
    columns = {"time_s": LOG.time_s, **MOTION, "Angle [deg]": MOTION["Angle [deg]"] / 50.0}
    path = written(tmp_path / "log.csv", columns)
    assert assumptions(recognised_logs([path], Hints()))
    words = ["import", str(path), "--out", str(tmp_path / "out"), "--yes"]
    assert main(words) == EXIT_BAD_INPUT  # a gear of 50: no inertia is known by that
    assert "a gear of 50" in (said := capsys.readouterr().err)
    assert "by more than a tenth, which --yes does not decide" in said
    assert not (tmp_path / "out").exists()
    written(path, {"time_s": LOG.time_s, "theta": 2.0 * np.pi * LOG.position_rev, "Current [A]": LOG.current_a})
    assert main(words) == 0
    assert "assumed: position_rev is 'theta' [rad]: rad" in read_run(tmp_path / "out" / "log.mcap").metadata["remarks"]


# Registers


def magnitude(values, bit):
    whole = np.round(values)
    return np.where(whole < 0.0, np.abs(whole) + (1 << bit), whole)


@pytest.mark.parametrize("past_zero", [False, True])
@pytest.mark.parametrize("bit", [10, 11])
def test_the_sign_in_a_bit_is_restored(past_zero, bit):
    counts = 4096.0 * (LOG.position_rev - 0.7)
    position = magnitude(counts, 15) if past_zero else np.mod(np.floor(counts), 4096.0)
    columns = {
        "timestamp": LOG.time_s,
        "Present_Position": position,
        "Present_Velocity": magnitude(4096.0 * LOG.velocity_rps, 15),
        "Present_Load": magnitude(1000.0 * LOG.current_a, bit),
    }
    one = imported(columns, counts_per_turn=4096.0)
    np.testing.assert_allclose(one.log.columns["velocity_rps"], LOG.velocity_rps, atol=0.05)
    np.testing.assert_allclose(one.log.columns["current_a"], 1000.0 * LOG.current_a, atol=0.51)
    moved = one.log.columns["position_rev"] - one.log.columns["position_rev"][0]
    np.testing.assert_allclose(moved, LOG.position_rev - LOG.position_rev[0], atol=1e-3)
    assert "sign restored" in one.found.of("velocity_rps").evidence


@pytest.mark.parametrize("roles", [{}, {"current_command_a": "x"}], ids=["by the motion", "as the user says"])
def test_a_current_without_a_name_gets_its_sign_back(roles):
    raw = np.mod(np.round(1000.0 * LOG.current_a), 65_536.0)
    one = imported({"time_s": LOG.time_s, "pos_rev": LOG.position_rev, "x": raw}, roles=roles)
    np.testing.assert_allclose(one.log.columns["current_command_a"], 1000.0 * LOG.current_a, atol=0.51)


def test_a_number_about_half_of_its_range_is_offset_and_asked_about():
    columns = {
        "time_s": LOG.time_s,
        "pos_rev": LOG.position_rev,
        "current [counts]": np.round(2048.0 + 1500.0 * LOG.current_a),
    }
    one = imported(columns)
    np.testing.assert_allclose(one.log.columns["current_a"], 1500.0 * LOG.current_a, atol=0.51)
    assert not one.found.of("current_a").sure


@pytest.mark.parametrize("levels", [(0.0, 1500.0), (0.0, 1100.0)])
def test_a_current_that_steps_has_no_sign_bit(levels):
    steps = np.round(np.repeat(np.tile(levels, 20), ROWS.size // 40) + 3.0 * (ROWS % 3))
    columns = {"time_s": LOG.time_s, "pos_rev": LOG.position_rev, "demand current [A]": steps}
    assert recognise(source_of_arrays(Path("log"), columns)).of("current_command_a").register is None


# MCAP of others

FLAT = b"float64 position\nfloat64 velocity\nfloat64 effort\n"


def message(k):
    parts = (2.0 * np.pi * LOG.position_rev[k], 2.0 * np.pi * LOG.velocity_rps[k], LOG.current_a[k])
    return b"\0\1\0\0" + struct.pack("<ddd", *parts)


def bag(path, make, schema=FLAT, encoding="ros2msg", kind="cdr", others=()):
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file, chunk_size=16_384)
        writer.start()
        channel = writer.register_channel("/axis", kind, writer.register_schema("m/msg/A", encoding, schema))
        for topic, content in others:
            extra = writer.register_channel(topic, "cdr", writer.register_schema("m/msg/W", "ros2msg", content))
            writer.add_message(extra, 0, message(0), 0)
        for k in range(ROWS.size):
            writer.add_message(channel, round(1e9 * LOG.time_s[k]), make(k), 0)
        writer.finish()
    return path


@pytest.mark.parametrize("bad", [message(0)[:12], b"", b"\0\1\0\0"])
def test_one_message_that_does_not_fit_costs_itself(tmp_path, bad):
    source = read_source(bag(tmp_path / "log.mcap", lambda k: bad if k == 600 else message(k)))
    assert source.rows == ROWS.size - 1
    assert source.remarks[0].startswith("left out: messages of topic /axis: 1 of 1200 do not fit the schema")


def test_one_text_that_is_no_json_costs_itself(tmp_path):
    def text(k):
        return (
            b"{bad" if k == 600 else json.dumps({"position": LOG.position_rev[k], "torque": LOG.current_a[k]}).encode()
        )

    source = read_source(bag(tmp_path / "log.mcap", text, b"{}", "jsonschema", "json"))
    assert source.rows == ROWS.size - 1


@pytest.mark.parametrize(
    "schema",
    [
        b"float64 position\nfloat64 effort\n",
        FLAT + b"float64 temperature\n",
        FLAT.replace(b"64", b"32"),
        b"float64 position\nother_msgs/Thing thing\n",
        b"float64 position\nwstring text\n",
    ],
    ids=["a field less", "a field more", "of half the size", "of a type that is absent", "of a type that is not read"],
)
def test_a_schema_that_is_not_that_of_the_messages_is_refused(tmp_path, schema):
    with pytest.raises(RecordingError, match="topic /axis"):
        read_source(bag(tmp_path / "log.mcap", message, schema))


def test_a_schema_in_idl_is_refused_by_its_name(tmp_path):
    with pytest.raises(RecordingError, match="topic /axis has the encoding 'cdr' with a schema in 'ros2idl'"):
        read_source(bag(tmp_path / "log.mcap", message, b"module m {};", "ros2idl"))


def test_a_topic_that_cannot_be_read_costs_itself(tmp_path):
    path = bag(tmp_path / "log.mcap", message, others=[("/words", b"wstring text\n"), ("/odd", b"no schema at all\n")])
    source = read_source(path)
    assert set(source.columns) == {"time_s", "position", "velocity", "effort"}
    assert sum("/words" in remark or "/odd" in remark for remark in source.remarks) == 2


def test_a_file_that_was_cut_is_read_as_far_as_it_goes(tmp_path):
    path = bag(tmp_path / "log.mcap", message)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    source = read_source(path)
    assert 100 < source.rows < ROWS.size
    assert "fffo-drive log recover" in source.remarks[-1]
    path.write_bytes(data[:300])
    with pytest.raises(RecordingError, match="fffo-drive log recover"):
        read_source(path)


# Traces of a CAN bus


@pytest.mark.parametrize("suffix", ["log", "asc", "trc", "blf", "csv"])
def test_a_trace_of_a_bus_is_called_one(tmp_path, suffix):
    can = pytest.importorskip("can")
    path = tmp_path / f"trace.{suffix}"
    with can.Logger(str(path)) as logger:
        for k in range(200):
            data = struct.pack("<Hi", 0x1637, k)
            logger.on_message_received(
                can.Message(timestamp=1.7e9 + 1e-3 * k, arbitration_id=0x181, data=data, is_extended_id=False)
            )
    with pytest.raises(RecordingError, match="a trace of a CAN bus"):
        read_source(path)


def test_what_candump_prints_is_called_a_trace(tmp_path):
    path = tmp_path / "candump.txt"
    path.write_text("".join(f" (1793000000.{k:06d})  can0  181   [3]  01 02 {k % 100:02d}\n" for k in range(100)))
    with pytest.raises(RecordingError, match=r"a trace of a CAN bus .candump"):
        read_source(path)


# A torque sensor beside the current

SENSED = {"time_s": LOG.time_s, **MOTION}


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["as the current", "reversed"])
def test_a_torque_beside_the_current_is_that_of_a_sensor(sign):
    """0.06 Nm/A, less what the rotor takes."""
    acceleration = np.gradient(LOG.velocity_rps, LOG.time_s)
    torque_nm = 0.06 * LOG.current_a - 5e-5 * acceleration
    one = imported({**SENSED, "Shaft torque [mNm]": sign * 1e3 * torque_nm})
    assert one.found.of("current_a").column == "Current [A]"
    np.testing.assert_allclose(one.log.columns["measured_torque_nm"], torque_nm, atol=1e-12)
    record = record_of_columns("log", one.log.columns, facts_of({"torque_constant_nm_per_a": 0.05}, False))
    (said,) = sensor_remarks([record])
    assert float(said.partition("a torque constant of ")[2].split()[0]) == pytest.approx(0.06, rel=1e-3)
    assert "0.05 is declared" in said
    assert "0.833 times the true ones" in said
    assert not sensor_remarks([replace(record, measured_torque_nm=None)])


def test_a_torque_that_the_drive_computes_is_no_sensor():
    one = imported({**SENSED, "Torque [Nm]": 0.06 * LOG.current_a})
    assert "measured_torque_nm" not in one.log.columns
    assert any("0.06 Nm/A times 'Current [A]': the drive computed it" in remark for remark in one.log.remarks)
    said = imported({**SENSED, "Torque [Nm]": 0.06 * LOG.current_a}, roles={"measured_torque_nm": "Torque [Nm]"})
    np.testing.assert_allclose(said.log.columns["measured_torque_nm"], 0.06 * LOG.current_a)


# Conventions of programs, and what the data say where no unit is written

TURNS = {"rev": 1.0, "rad": 2.0 * np.pi, "deg": 360.0}
RATES = {"rps": 1.0, "rad/s": 2.0 * np.pi, "rpm": 60.0, "deg/s": 360.0}
PROGRAMS = {
    "ODrive": ("axis0.encoder.pos_estimate", "rev", "axis0.encoder.vel_estimate", "rps", "axis0.motor.Iq_measured"),
    "moteus": ("servo_stats.position", "rev", "servo_stats.velocity", "rps", "servo_stats.torque_Nm"),
    "MuJoCo": ("qpos[0]", "rad", "qvel[0]", "rad/s", "qfrc_actuator[0]"),
    "ROS": (
        "/joint_states/elbow/position",
        "rad",
        "/joint_states/elbow/velocity",
        "rad/s",
        "/joint_states/elbow/effort",
    ),
}


@pytest.mark.parametrize("program", PROGRAMS)
def test_units_that_a_program_means_are_told_and_known(program):
    place, turn, speed, rate, driven = PROGRAMS[program]
    columns = {"time": LOG.time_s, place: TURNS[turn] * LOG.position_rev, speed: RATES[rate] * LOG.velocity_rps}
    one = imported({**columns, driven: 3.0 * LOG.current_a})
    np.testing.assert_allclose(one.log.columns["position_rev"], LOG.position_rev, atol=1e-9)
    np.testing.assert_allclose(one.log.columns["velocity_rps"], LOG.velocity_rps, atol=1e-9)
    assert not [guess for guess in one.found.guesses if not guess.sure]
    assert any(remark.startswith(f"units as {program} means them") for remark in one.found.remarks)


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("rate", RATES)
def test_of_all_pairs_of_units_the_one_that_fits_is_taken_and_equal_ones_are_asked_about(turn, rate):
    """Time, position and velocity without units: milliseconds are a plausible rate, the pair follows from its ratio."""
    columns = {"t": 1e3 * LOG.time_s, "theta": TURNS[turn] * LOG.position_rev, "omega": RATES[rate] * LOG.velocity_rps}
    one = imported({**columns, "Current [A]": LOG.current_a})
    alike = (turn, rate) in {("rad", "rad/s"), ("rev", "rps"), ("deg", "deg/s")}
    guess = one.found.of("position_rev")
    assert guess.sure != alike
    if not alike:
        np.testing.assert_allclose(one.log.columns["position_rev"], LOG.position_rev, atol=1e-9)
        np.testing.assert_allclose(one.log.columns["velocity_rps"], LOG.velocity_rps, atol=1e-9)


@pytest.mark.parametrize(("size", "unit", "sure"), [(1.0, "A", False), (4.0, "A", True), (2e3, "mA", True)])
def test_a_current_without_a_unit_is_known_by_its_peaks_where_they_are_those_of_a_drive(size, unit, sure):
    guess = imported({"time_s": LOG.time_s, **MOTION, "Iq": size * LOG.current_a, "Current [A]": LOG.current_a * 0.0})
    assert (guess.found.of("current_a").unit, guess.found.of("current_a").sure) == (unit, sure)
    whole = imported({"time_s": LOG.time_s, **MOTION, "Iq": np.round(1e3 * LOG.current_a), "Current [A]": 0.0 * ROWS})
    assert not whole.found.of("current_a").sure  # permille, counts


def test_a_position_in_counts_that_nobody_names_is_refused_under_yes(tmp_path, capsys):
    columns = {"Time [s]": LOG.time_s, "Position": np.round(65536.0 * LOG.position_rev), "IQ": 4.0 * LOG.current_a}
    path = written(tmp_path / "log.csv", columns)
    assert main(["import", str(path), "--out", str(tmp_path / "out"), "--yes"]) == EXIT_BAD_INPUT
    assert "in counts, --counts-per-turn N" in capsys.readouterr().err
    words = ["import", str(path), "--out", str(tmp_path / "out"), "--counts-per-turn", "65536"]
    assert main(words) == 0
    np.testing.assert_allclose(
        read_run(tmp_path / "out" / "log.mcap").columns["position_rev"], LOG.position_rev, atol=1e-5
    )


def test_seconds_and_nanoseconds_beside_them_are_one_clock(tmp_path):
    stamps_ns = 1_700_000_000_000_000_000 + np.round(1e9 * LOG.time_s).astype(np.int64)
    columns = {"header.stamp.sec": stamps_ns // 10**9, "header.stamp.nanosec": stamps_ns % 10**9, **MOTION}
    (one,) = recognised_logs(
        [written(tmp_path / "log.csv", {k: [str(x) for x in v] for k, v in columns.items()})], Hints()
    )
    np.testing.assert_allclose(one.log.columns["time_s"], LOG.time_s, atol=1e-9)


def test_a_date_beside_words_is_one_cell(tmp_path):
    begin = datetime.datetime(2026, 3, 1, 23, 59, 59, tzinfo=datetime.UTC)
    stamps = [f"{begin + datetime.timedelta(seconds=float(t)):%Y-%m-%d %H:%M:%S.%f}" for t in LOG.time_s]
    path = written(tmp_path / "log.csv", {"when": stamps, "state": ["RUN"] * ROWS.size, **MOTION}, "\t")
    (one,) = recognised_logs([path], Hints())
    np.testing.assert_allclose(one.log.columns["time_s"], LOG.time_s, atol=1e-6)
    np.testing.assert_allclose(one.log.columns["position_rev"], LOG.position_rev, atol=1e-8)


@pytest.mark.parametrize("stored", ["two's complement", "sign and magnitude", "offset binary"])
def test_sixteen_bits_without_a_sign_are_seen_in_a_current_that_jumps(stored):
    whole = np.round(2e3 * LOG.current_a)
    registers = {
        "two's complement": np.where(whole < 0.0, whole + 65536.0, whole),
        "sign and magnitude": magnitude(whole, 15),
        "offset binary": whole + 32768.0,
    }
    motion = {name: MOTION[name] for name in ("Angle [deg]", "Speed [rpm]")}
    one = imported({"time_s": LOG.time_s, **motion, "I [mA]": registers[stored]})
    np.testing.assert_allclose(one.log.columns["current_a"], 1e-3 * whole, atol=1e-9)
    assert stored in one.found.of("current_a").evidence
