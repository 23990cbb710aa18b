"""Traces of a CAN bus as recordings: what the simulated node did, through five formats; and frames as literals."""

from __future__ import annotations

import struct
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from node.node_rig import Rig

from fffo_drive.can.frame import pack_frame, unpack_frame
from fffo_drive.cli import main
from fffo_drive.cli.exits import EXIT_BAD_INPUT
from fffo_drive.drive.canopen.object_map import MappedObject, PdoMap
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.eds import eds_text
from fffo_drive.identification.dataset import load_record
from fffo_drive.identification.facts import read_facts
from fffo_drive.importing.can_frames import Frames, read_frames, trace_kind
from fffo_drive.importing.can_objects import longest_stretch, numbers_of, pdos_of
from fffo_drive.importing.can_trace import NodeNeededError
from fffo_drive.importing.candidates import Hints
from fffo_drive.importing.read import read_source
from fffo_drive.importing.source import TraceDrive
from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.reader import read_run
from fffo_drive.workflows.import_logs import read_map, recognised_logs
from fffo_drive.workflows.trace_drive import trace_drive

SUFFIXES = ["log", "asc", "trc", "blf", "csv"]
BEGIN_S = 1793000000.0
PERIOD_MS = 2.0
CYCLES = 1500
EXAMPLES = Path(__file__).resolve().parents[2] / "configs"


class Sniffer(Rig):
    """A bus with the node on it, and what is on the wire; `truth`: position, velocity and current at each SYNC."""

    def __init__(self, config: NodeConfig | None = None) -> None:
        self.wire: list[can.Message] = []
        self.truth: list[tuple[float, float, float]] = []
        super().__init__(config)
        self._note(self.boot)

    def _note(self, frames: list[str]) -> None:
        for frame in frames:
            can_id, _, data = frame.partition("#")
            stamp = BEGIN_S + self.now_ns * 1e-9
            self.wire.append(
                can.Message(
                    timestamp=stamp, arbitration_id=int(can_id, 16), data=bytes.fromhex(data), is_extended_id=False
                )
            )

    def send(self, frame: str) -> list[str]:
        self._note([frame])
        answers = super().send(frame)
        self._note(answers)
        return answers

    def wait(self, milliseconds: float) -> list[str]:
        sent = super().wait(milliseconds)
        self._note(sent)
        return sent

    def _answer(self, request: bytes) -> tuple[bytes, int]:
        self._note([f"{0x600 + self.config.node_id:03X}#{request.hex()}"])
        data, abort = super()._answer(request)
        self._note([f"{0x580 + self.config.node_id:03X}#{data.hex()}"])
        return data, abort


def moved() -> Sniffer:
    """The node, mapped by SDO, enabled, and driven by a current of two sines."""
    rig = Sniffer()
    rig.map_cyclic()
    assert rig.read(0x6076) > 0  # as any master does: the scales are in the trace
    for place in ((0x608F, 1), (0x608F, 2)):
        rig.read(*place)
    rig.operational()
    rig.enable()
    for k in range(CYCLES):
        t = k * PERIOD_MS * 1e-3
        rig.cycle(0x0F, round(60.0 * np.sin(6.0 * t) + 30.0 * np.sin(31.0 * t)), PERIOD_MS)
        rig.truth.append((rig.plant.angle_rev, rig.plant.velocity_rps, rig.plant.current_a))
    return rig


@pytest.fixture(scope="module")
def rig() -> Sniffer:
    return moved()


@pytest.fixture
def eds(tmp_path):
    path = tmp_path / "node.eds"
    path.write_text(eds_text(NodeConfig()))
    return path


def written(path: Path, messages: list[can.Message]) -> Path:
    with can.Logger(str(path)) as logger:
        for message in messages:
            logger.on_message_received(message)
    return path


def printed(path: Path, messages: list[can.Message], stamp: str = "({:.6f}) ") -> Path:
    """As `candump -ta` prints it."""
    path.write_text(
        "".join(
            f" {stamp.format(m.timestamp)} can0  {m.arbitration_id:03X}   [{len(m.data)}]  "
            + " ".join(f"{byte:02X}" for byte in m.data)
            + "\n"
            for m in messages
        )
    )
    return path


def check_motion(columns, rig: Sniffer) -> None:
    """Position, velocity and current are those of the plant at each SYNC."""
    truth = np.array(rig.truth)
    rows = columns["time_s"].size
    assert CYCLES - 4 <= rows <= CYCLES
    first = next(k for k in range(4) if abs(columns["position_rev"][0] - truth[k, 0]) < 2e-5)
    truth = truth[first : first + rows]
    ratings = rig.config.ratings
    np.testing.assert_allclose(columns["position_rev"], truth[:, 0], atol=1.01 / ratings.counts_per_rev)
    np.testing.assert_allclose(columns["velocity_rps"], truth[:, 1], atol=0.02 + 0.01 * np.abs(truth[:, 1]).max())
    np.testing.assert_allclose(np.diff(columns["time_s"]), PERIOD_MS * 1e-3, atol=3e-6)
    permille_a = 1e-3 * ratings.rated_torque_nm / ratings.torque_constant_nm_per_a
    np.testing.assert_allclose(columns["current_a"], truth[:, 2], atol=1.01 * permille_a)


# What the simulated node did


@pytest.mark.parametrize("suffix", [*SUFFIXES, "txt"])
def test_a_trace_tells_what_the_node_did(tmp_path, rig, eds, suffix):
    path = tmp_path / f"trace.{suffix}"
    (printed if suffix == "txt" else written)(path, rig.wire)
    constant = rig.config.ratings.torque_constant_nm_per_a
    drive = trace_drive([eds], torque_constant_nm_per_a=constant)
    (one,) = recognised_logs([path], Hints(drive=drive))
    check_motion(one.log.columns, rig)
    assert all(guess.sure for guess in one.found.guesses)  # every scale was read in the trace
    command = one.log.columns["current_command_a"]
    measured = one.log.columns["current_a"]
    # it acts from the next SYNC on, and what has flowed since is told at the one after that
    np.testing.assert_allclose(command[:-2], measured[2:], atol=0.02 * np.abs(measured).max())


def test_a_trace_that_begins_before_the_drive_is_set_up_needs_no_file(tmp_path, rig):
    (one,) = recognised_logs([written(tmp_path / "trace.blf", rig.wire)], Hints())
    assert one.found.of("velocity_rps").column == "velocity actual value 0x606C"
    assert any("mapped as the trace has it" in remark for remark in one.log.remarks)


def test_the_map_of_a_trace_keeps_the_drive_and_the_scales(tmp_path, rig, eds, monkeypatch):
    """Typed from another directory, with nothing but the map: the same columns."""
    path = written(tmp_path / "trace.log", cyclic(rig))
    drive = ["--eds", EXAMPLES / "axis_canopen.yaml", "--node", 1, "--rated-torque", 0.5]
    assert main([str(word) for word in ["import", path, *drive, "--out", tmp_path / "first"]]) == 0
    assert read_map(tmp_path / "first" / "map.yaml").scales == {"rated_torque_nm": 0.5}
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert main(["import", str(path), "--map", "../first/map.yaml", "--out", "again"]) == 0
    first, again = (read_run(place / "trace.mcap") for place in (tmp_path / "first", tmp_path / "elsewhere" / "again"))
    for name in ("position_rev", "velocity_rps", "current_a", "current_command_a"):
        np.testing.assert_array_equal(first.columns[name], again.columns[name])


def cyclic(rig: Sniffer) -> list[can.Message]:
    """Without the set-up: the trace of a drive that was on already."""
    return [m for m in rig.wire if m.arbitration_id in (0x80, 0x181, 0x201, 0x281)]


def test_without_a_description_the_trace_is_named_and_what_is_missing(tmp_path, rig, capsys):
    path = written(tmp_path / "trace.asc", cyclic(rig))
    with pytest.raises(RecordingError, match=r"a trace of a CAN bus \(Vector ASC\), node 1: .*--eds FILE"):
        read_source(path)
    assert main(["identify", str(path), "--out", str(tmp_path / "model")]) == EXIT_BAD_INPUT
    line = capsys.readouterr().err.rpartition("import it with: ")[2].strip()
    assert line == f"fffo-drive import {path} --out trace_imported --eds FILE"


def test_an_axis_file_maps_the_trace_of_its_drive(tmp_path, rig, capsys):
    path = written(tmp_path / "trace.log", cyclic(rig))
    words = ["import", str(path), "--eds", str(EXAMPLES / "axis_canopen.yaml"), "--out", str(tmp_path / "out")]
    assert main(words) == 0
    assert "next: fffo-drive identify" in capsys.readouterr().out
    facts = read_facts(tmp_path / "out" / "facts.yaml")
    record = load_record(tmp_path / "out" / "trace.mcap", facts)
    assert np.ptp(record.position_rev) == pytest.approx(np.ptp(np.array(rig.truth)[:, 0]), rel=1e-3)


def test_defaults_of_an_eds_are_assumptions(tmp_path, rig, eds):
    named = eds.read_text().replace("DefaultValue=0x60C20120", "")
    eds.write_text(named)
    wire = [m for m in rig.wire if m.arbitration_id != 0x581 or m.data[1:3] not in (b"\x76\x60", b"\x8f\x60")]
    path = written(tmp_path / "trace.csv", wire)
    (one,) = recognised_logs([path], Hints(drive=trace_drive([eds])))
    doubts = {guess.signal: guess.evidence for guess in one.found.guesses if not guess.sure}
    assert "--counts-per-turn" in doubts["position_rev"]
    assert "--rated-torque" in doubts["current_a"]
    scales = {"counts_per_rev": 32768, "rated_torque_nm": rig.config.ratings.rated_torque_nm}
    (one,) = recognised_logs([path], Hints(drive=trace_drive([eds], scales=scales)))
    assert all(guess.sure for guess in one.found.guesses if guess.signal in ("position_rev", "current_a"))


def test_a_mapping_that_the_frames_do_not_have_is_refused(tmp_path, rig, eds):
    shorter = [
        can.Message(timestamp=m.timestamp, arbitration_id=m.arbitration_id, data=m.data[:6], is_extended_id=False)
        if m.arbitration_id == 0x181
        else m
        for m in cyclic(rig)
    ]
    path = written(tmp_path / "trace.log", shorter)
    axis = trace_drive([EXAMPLES / "axis_canopen.yaml"])
    with pytest.raises(RecordingError, match=r"TPDO1 \(0x181\) would have 8 bytes .* its frames have 6"):
        read_source(path, axis)


def test_a_file_of_another_node_maps_this_one(tmp_path, rig, eds):
    """Vendors' files have identifiers of one node in place of $NODEID."""
    text = eds.read_text()
    at = text.index("[1800sub1]")
    eds.write_text(text[:at] + text[at:].replace("$NODEID+0x40000180", "0x400001A0", 1))
    eds.write_text(eds.read_text().replace("$NODEID+0x180", "0x1A0"))
    wire = [m for m in rig.wire if not (m.arbitration_id == 0x601 and m.data[1:4] == b"\x00\x18\x01")]
    source = read_source(written(tmp_path / "trace.log", wire), trace_drive([eds]))
    assert source.rows > CYCLES - 10


# Literal frames


def message(t: float, frame: str) -> can.Message:
    can_id, _, data = frame.partition("#")
    stamp = BEGIN_S + float(t)
    return can.Message(timestamp=stamp, arbitration_id=int(can_id, 16), data=bytes.fromhex(data), is_extended_id=False)


def sdo(node: int, index: int, sub: int, value: int, size: int) -> list[str]:
    """A download and its answer."""
    place = struct.pack("<HB", index, sub).hex()
    command = {1: 0x2F, 2: 0x2B, 4: 0x23}[size]
    data = (value & (1 << 8 * size) - 1).to_bytes(4, "little").hex()
    return [f"{0x600 + node:03X}#{command:02X}{place}{data}", f"{0x580 + node:03X}#60{place}00000000"]


def tpdo1(node: int, *objects: int, kind: int = 1) -> list[str]:
    steps = [(0x1800, 1, 0x80000180 + node, 4), (0x1800, 2, kind, 1), (0x1A00, 0, 0, 1)]
    steps += [(0x1A00, k, word, 4) for k, word in enumerate(objects, 1)]
    steps += [(0x1A00, 0, len(objects), 1), (0x1800, 1, 0x180 + node, 4)]
    return [line for step in steps for line in sdo(node, *step)]


MOTION = (0x60640020, 0x606C0020)
ROWS = np.arange(400)
COUNTS: np.ndarray = np.round(20_000.0 * np.sin(0.03 * ROWS) + 3000.0 * np.sin(0.11 * ROWS)).astype(int)
SPEEDS = np.round(100.0 * (600.0 * np.cos(0.03 * ROWS) + 330.0 * np.cos(0.11 * ROWS))).astype(int)


def pdo(node: int, k: int) -> str:
    return f"{0x180 + node:03X}#{struct.pack('<ii', COUNTS[k], SPEEDS[k]).hex()}"


def log(path: Path, lines: list[tuple[float, str]], channel: str = "can0") -> Path:
    path.write_text("".join(f"({BEGIN_S + t:.6f}) {channel} {frame.upper()}\n" for t, frame in lines))
    return path


def run(nodes: list[int], objects=MOTION) -> list[tuple[float, str]]:
    lines = [(0.0, line) for node in nodes for line in tpdo1(node, *objects)]
    for k in ROWS:
        lines.append((0.01 * k + 0.01, "080#"))
        lines += [(0.01 * k + 0.011 + 1e-4 * n, pdo(n, k)) for n in nodes]
    return lines


def test_frames_as_they_are_written(tmp_path):
    source = read_source(log(tmp_path / "a.log", run([1])))
    assert source.rows == ROWS.size
    np.testing.assert_array_equal(source.columns["position actual value 0x6064"], COUNTS)
    np.testing.assert_array_equal(source.columns["velocity actual value 0x606C"], SPEEDS)
    np.testing.assert_allclose(source.columns["time_s"], source.columns["time_s"][0] + 0.01 * ROWS, atol=1e-6)
    assert source.units["position actual value 0x6064"] == "counts"
    named = TraceDrive(keys={"counts_per_rev": 4096, "velocity_units_per_rps": 100.0})
    source = read_source(log(tmp_path / "a.log", run([1])), named)
    np.testing.assert_allclose(source.columns["position actual value 0x6064"], COUNTS / 4096.0)
    assert source.units["velocity actual value 0x606C"] == "rps"


def test_of_several_nodes_one_is_asked_for(tmp_path):
    path = log(tmp_path / "a.log", run([1, 5]))
    with pytest.raises(NodeNeededError, match="PDOs of 1, 5: say which with --node"):
        read_source(path)
    assert read_source(path, TraceDrive(node="5")).rows == ROWS.size
    for wrong in ("7", "0", "x", "can3:5"):
        with pytest.raises(RecordingError, match="PDOs of 1, 5"):
            read_source(path, TraceDrive(node=wrong))


def test_an_axis_file_or_a_dcf_names_its_node(tmp_path, eds):
    path = log(tmp_path / "a.log", run([1, 5]))
    eds.write_text(eds.read_text() + "\n[DeviceComissioning]\nNodeID=0x05\n")
    assert "node 5" in " ".join(read_source(path, trace_drive([eds])).remarks)
    assert "node 1" in " ".join(read_source(path, trace_drive([EXAMPLES / "axis_canopen.yaml"])).remarks)
    with pytest.raises(NodeNeededError):
        read_source(path, trace_drive(["maxon_epos4"], scales={"rated_torque_nm": 1.0}))


def commanded(values: dict[int, np.ndarray]) -> list[tuple[float, str]]:
    """Motion of node 1, and RPDO1 or TPDO2 with an object of 16 bits each, before the next SYNC."""
    lines = [(0.0, line) for line in tpdo1(1, *MOTION)]
    received = [index for index in values if index in (0x6071, 0x60B2)]
    sent = [index for index in values if index not in received]
    for parameters, cob_id, indices in ((0x1400, 0x201, received), (0x1801, 0x281, sent)):
        steps = [(parameters, 1, cob_id, 4), (parameters, 2, 1, 1), (parameters + 0x200, 0, len(indices), 1)]
        steps += [(parameters + 0x200, k, index << 16 | 16, 4) for k, index in enumerate(indices, 1)]
        lines += [(0.0, line) for step in steps if indices for line in sdo(1, *step)]
    for k in ROWS:
        lines += [(0.01 * k + 0.01, "080#"), (0.01 * k + 0.011, pdo(1, k))]
        for cob_id, indices in ((0x281, sent), (0x201, received)):
            if indices:
                data = struct.pack(f"<{len(indices)}h", *(int(values[index][k]) for index in indices))
                lines.append((0.01 * k + 0.012, f"{cob_id:03X}#{data.hex()}"))
    return lines


def test_a_torque_offset_is_added_to_the_target(tmp_path):
    wire = commanded({0x6071: 100 + ROWS, 0x60B2: 7 * (ROWS % 5)})
    source = read_source(log(tmp_path / "a.log", wire))
    np.testing.assert_array_equal(source.columns["target torque 0x6071"], 100 + ROWS + 7 * (ROWS % 5))
    assert any("0x60B2" in remark for remark in source.remarks)


def test_a_target_that_nobody_sets_is_no_command(tmp_path):
    """A drive in a mode of position: what its own loop asks for (0x6074) is the command."""
    wire = commanded({0x6071: 0 * ROWS, 0x6074: 50 + ROWS, 0x6077: 40 + ROWS})
    roles = read_source(log(tmp_path / "a.log", wire)).roles
    assert roles["current_command_a"] == "torque demand 0x6074"
    assert roles["current_a"] == "torque actual value 0x6077"


def test_objects_of_one_index_are_told_apart(tmp_path):
    lines = run([1], (0x21060108, 0x21060208, 0x60640020))
    lines = [(t, f if f[:4] != "181#" else f"181#0102{f[4:12]}") for t, f in lines]
    source = read_source(log(tmp_path / "a.log", lines))
    assert set(source.columns["object 0x2106:01"]) == {1.0}
    assert set(source.columns["object 0x2106:02"]) == {2.0}
    np.testing.assert_array_equal(source.columns["position actual value 0x6064"], COUNTS)


def test_a_node_is_typed_at_a_terminal(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    answers = ["5", "q"]
    monkeypatch.setattr("builtins.input", lambda text: answers.pop(0))
    path = log(tmp_path / "a.log", run([1, 5], (0x60640020, 0x60770010, 0x60410010)))
    main(["import", str(path), "--out", str(tmp_path / "out")])
    assert "PDOs of 1, 5" in capsys.readouterr().out
    assert answers != ["5", "q"]


def test_the_same_node_id_on_two_channels_is_two_nodes(tmp_path):
    text = log(tmp_path / "a.log", run([1])).read_text() + log(tmp_path / "b.log", run([1]), "can1").read_text()
    path = tmp_path / "both.log"
    path.write_text(text)
    with pytest.raises(NodeNeededError, match="can0:1, can1:1"):
        read_source(path)
    assert read_source(path, TraceDrive(node="can1:1")).rows == ROWS.size


def test_a_mapping_that_changes_is_read_where_most_frames_are(tmp_path):
    before = [(-1.0 + 0.01 * k, f"181#{k:04X}00000000") for k in range(50)]
    behind = [(10.0, line) for line in sdo(1, 0x1800, 1, 0x80000181, 4)]
    source = read_source(log(tmp_path / "a.log", before + run([1]) + behind))
    np.testing.assert_array_equal(source.columns["position actual value 0x6064"], COUNTS)


def test_what_is_read_again_later_changes_nothing(tmp_path):
    lines = run([1])
    at = len(lines) // 2
    read = [(lines[at][0], "601#4000180100000000"), (lines[at][0], "581#4300180181010000")]
    source = read_source(log(tmp_path / "a.log", lines[:at] + read + lines[at:]))
    assert source.rows == ROWS.size


def test_a_reset_takes_the_mapping_with_it(tmp_path):
    lines = [*run([1]), (5.0, "701#00"), *((t + 6.0, f) for t, f in run([1])[-99:])]
    source = read_source(log(tmp_path / "a.log", lines))
    assert source.rows == ROWS.size
    told = longest_stretch(read_frames(tmp_path / "a.log", "candump"), 1)
    assert pdos_of(told.value)[1][0].objects == (MappedObject(0x6064, 0, 32), MappedObject(0x606C, 0, 32))


def test_a_refused_write_sets_nothing(tmp_path):
    lines = run([1])
    refused = [(0.001, "601#23001A0108006160"), (0.002, "581#80001A0141000406")]
    at = next(k for k, (_, frame) in enumerate(lines) if frame == "080#")
    source = read_source(log(tmp_path / "a.log", lines[:at] + refused + lines[at:]))
    np.testing.assert_array_equal(source.columns["position actual value 0x6064"], COUNTS)


def test_a_counter_of_32_bits_goes_on_past_its_end(tmp_path, monkeypatch):
    high = (COUNTS + (1 << 31) + (1 << 31)) % (1 << 32) - (1 << 31)
    monkeypatch.setitem(globals(), "COUNTS", high)
    source = read_source(log(tmp_path / "a.log", run([1])))
    assert np.abs(np.diff(source.columns["position actual value 0x6064"])).max() < 2000


def test_values_that_come_by_themselves_keep_their_stamps(tmp_path):
    """Events, no SYNC: position and velocity each at its own time; the command is held."""
    lines = [(0.0, line) for line in tpdo1(1, 0x60640020, kind=255)]
    for step in [
        (0x1801, 1, 0x281, 4),
        (0x1A01, 0, 1, 1),
        (0x1A01, 1, 0x606C0020, 4),
        (0x1400, 1, 0x201, 4),
        (0x1600, 0, 1, 1),
        (0x1600, 1, 0x60710010, 4),
    ]:
        lines += [(0.0, line) for line in sdo(1, *step)]
    for k in range(200):
        t = 0.1 + 0.01 * k
        lines.append((t, f"181#{struct.pack('<i', 100 * k).hex()}"))
        lines.append((t + 0.005, f"281#{struct.pack('<i', 1000 * k).hex()}"))
        if k % 10 == 0:
            lines.append((t + 0.006, f"201#{struct.pack('<h', k + 1).hex()}"))
    source = read_source(log(tmp_path / "a.log", lines))
    position, speed, command = (
        source.columns[name]
        for name in ("position actual value 0x6064", "velocity actual value 0x606C", "target torque 0x6071")
    )
    np.testing.assert_allclose(
        speed, 10.0 * position - 500.0, atol=0.05
    )  # half a step later; stamps since 1970 have 0.24 us
    assert set(command) == {float(k + 1) for k in range(0, 200, 10)}
    assert command[10] == 11.0  # sent after the position of row 11, whose first row is left out


@pytest.mark.parametrize(
    ("stamp", "told"),
    [("({:.6f}) ", True), ("", False), ("date", True), ("delta", True)],
)
def test_stamps_of_candump(tmp_path, rig, stamp, told):
    wire = [message(t, f) for t, f in run([1])]
    path = tmp_path / "a.txt"
    if stamp == "date":
        printed(path, wire)
        text = path.read_text()
        import datetime as dt

        lines = [
            line.replace(
                line[line.index("(") : line.index(")") + 1],
                dt.datetime.fromtimestamp(m.timestamp, dt.UTC).strftime("(%Y-%m-%d %H:%M:%S.%f)"),
            )
            for line, m in zip(text.splitlines(), wire, strict=True)
        ]
        path.write_text("\n".join(lines) + "\n")
    elif stamp == "delta":
        last = wire[0].timestamp
        texts = []
        for m in wire:
            texts.append(
                printed(tmp_path / "line", [m]).read_text().replace(f"{m.timestamp:.6f}", f"{m.timestamp - last:.6f}")
            )
            last = m.timestamp
        path.write_text("".join(texts))
    else:
        printed(path, wire, stamp)
    source = read_source(path)
    np.testing.assert_array_equal(source.columns["position actual value 0x6064"], COUNTS)
    assert ("time_s" in source.columns) == told
    if told:
        np.testing.assert_allclose(np.diff(source.columns["time_s"]), 0.01, atol=5e-6)


def hexed(frame: str) -> tuple[str, int, str]:
    can_id, _, data = frame.partition("#")
    return can_id, len(data) // 2, " ".join(data[k : k + 2].upper() for k in range(0, len(data), 2))


def as_trc_10(lines):
    head = ";##########\n;   C:\\log.trc\n;\n;    CAN activities recorded by PCAN Explorer\n;\n"
    rows = (f"{k:>6}) {1e3 * t:13.1f}  {i:>8}  {n}  {d}" for k, (t, f) in enumerate(lines, 1) for i, n, d in [hexed(f)])
    return head + "\n".join(rows) + "\n"


def as_trc_11(lines):
    head = ";$FILEVERSION=1.1\n;$STARTTIME=43008.920986006946\n;\n;   Message Number\n"
    rows = (
        f"{k:>6}) {1e3 * t:13.1f}  Rx   {i:>8}  {n}  {d}" for k, (t, f) in enumerate(lines, 1) for i, n, d in [hexed(f)]
    )
    return head + "\n".join(rows) + "\n"


def as_trc_13(lines):
    head = ";$FILEVERSION=1.3\n;$STARTTIME=43008.920986006946\n;\n"
    rows = (
        f"{k:>6}) {1e3 * t:13.1f} 1  Rx {i:>8} -  {n}    {d}"
        for k, (t, f) in enumerate(lines, 1)
        for i, n, d in [hexed(f)]
    )
    return head + "\n".join(rows) + "\n"


def as_asc(lines, relative: bool, base: str = "hex"):
    head = f"date Mon Mar 2 10:00:00.000 am 2026\nbase {base}  timestamps {'relative' if relative else 'absolute'}\n"
    head += "internal events logged\n// version 9.0.0\nBegin Triggerblock Mon Mar 2 10:00:00.000 am 2026\n"
    head += "   0.000000 Start of measurement\n"
    rows, last = [], 0.0
    for t, frame in lines:
        can_id, size, data = hexed(frame)
        if base == "dec":
            can_id, data = str(int(can_id, 16)), " ".join(str(int(byte, 16)) for byte in data.split())
        rows.append(f"   {t - last if relative else t:.6f} 1  {can_id}             Rx   d {size} {data}")
        last = t
    return head + "\n".join([*rows, "End TriggerBlock"]) + "\n"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.trc", as_trc_10(run([1]))),
        ("a.trc", as_trc_11(run([1]))),
        ("a.trc", as_trc_13(run([1]))),
        ("a.asc", as_asc(run([1]), False)),
        ("a.asc", as_asc(run([1]), True)),
        ("a.asc", as_asc(run([1]), False, "dec")),
    ],
    ids=["TRC 1.0", "TRC 1.1", "TRC 1.3", "ASC", "ASC, differences", "ASC, decimal"],
)
def test_traces_as_the_vendors_programs_write_them(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    source = read_source(path)
    np.testing.assert_array_equal(source.columns["position actual value 0x6064"], COUNTS)
    np.testing.assert_allclose(np.diff(source.columns["time_s"]), 0.01, atol=2e-4)


def test_a_damaged_line_costs_itself(tmp_path):
    path = written(tmp_path / "trace.csv", [message(t, f) for t, f in run([1])])
    lines = path.read_text().splitlines()
    lines[300] = "1793,xx,0"
    path.write_text("\n".join(lines))
    source = read_source(path)
    assert ROWS.size - 2 <= source.rows < ROWS.size + 1
    assert "damaged" in source.remarks[0]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_trace_that_was_cut_is_read_as_far_as_it_goes(tmp_path, suffix):
    path = written(tmp_path / f"trace.{suffix}", [message(t, f) for t, f in run([1])])
    data = path.read_bytes()
    path.write_bytes(data[: int(0.8 * len(data))])
    assert 250 < read_source(path).rows < ROWS.size


def test_what_is_no_data_frame_is_left_out_and_counted(tmp_path):
    lines = run([1])
    odd = [(0.5, "18FF0181#0102"), (0.6, "20000088#0000000000000000"), (0.7, "181#R"), (0.8, "123##00102")]
    source = read_source(log(tmp_path / "a.log", lines + odd))
    assert source.rows == ROWS.size
    assert "left out: 4 lines or frames" in source.remarks[0]


def test_a_trace_compressed_is_one(tmp_path):
    import gzip

    path = log(tmp_path / "a.log", run([1]))
    packed = tmp_path / "a.log.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert read_source(packed).rows == ROWS.size


def test_options_of_a_trace_need_one(tmp_path, capsys):
    path = tmp_path / "log.csv"
    path.write_text("time [s],pos [rev]\n" + "".join(f"{k * 0.01},{k}\n" for k in range(100)))
    assert main(["import", str(path), "--node", "1", "--out", str(tmp_path / "out")]) == EXIT_BAD_INPUT
    assert "no trace of a CAN bus" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["time,position\n1,2\n", "a b [3] 4\n", "(1.0) x y\n"])
def test_a_table_is_no_trace(text):
    assert trace_kind(text.encode()) is None


@given(st.lists(st.sampled_from([8, 16, 24, 32, 1, 4, 64]), min_size=1, max_size=6), st.data())
def test_any_mapping_gives_back_what_was_packed(sizes, data):
    sizes = [s for k, s in enumerate(sizes) if sum(sizes[: k + 1]) <= 64]
    if not sizes:
        return
    values = [data.draw(st.integers(-(1 << s - 1), (1 << s - 1) - 1)) for s in sizes]
    word = 0
    offset = 0
    for size, value in zip(sizes, values, strict=True):
        word |= (value & (1 << size) - 1) << offset
        offset += size
    raw = pack_frame(0x181, word.to_bytes(8, "little"))
    padded = np.frombuffer(unpack_frame(raw).data, np.uint8).reshape(1, 8)
    one = np.zeros(1, np.int64)
    frames = Frames(None, one, one, padded, one, ("",), ())
    pdo = PdoMap(1, 0x181, 1, tuple(MappedObject(0x2000 + k, 0, s) for k, s in enumerate(sizes)))
    for k, (size, value) in enumerate(zip(sizes, values, strict=True)):
        assert numbers_of(frames, one, pdo, k, True)[0] == value
        assert size == 64 or numbers_of(frames, one, pdo, k, False)[0] == value & (1 << size) - 1
