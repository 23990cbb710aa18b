"""Mistakes that people make, each with the command that meets it, its exit code and what the message must say.

A case edits the files beside this one in a directory of its own, puts nodes on a bus of its own, and runs the command
line in this process. `said` are parts that the message must have: place, what is allowed, what to do.
"""

from __future__ import annotations

import contextlib
import io
import re
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from bad_input.bus_node import BusNode

from fffo_drive.can.link import BROADCAST, free_loopback_port
from fffo_drive.canopen_node.abort import Abort, SdoAbortError
from fffo_drive.cli import main
from fffo_drive.drive.simulated.node.config import Identity, NodeConfig
from fffo_drive.drive.simulated.node.core import Node
from fffo_drive.drive.simulated.node.eds import eds_text
from fffo_drive.drive.simulated.node.objects import DEVICE_TYPE

FILES = Path(__file__).resolve().parent / "files"
AXIS, BUS_AXIS, DRIVE, MODEL = "axis.yaml", "bus.yaml", "drive.yaml", "model.yaml"
CHECK = ("config", "check")

Files = dict[str, str]
Preparation = Callable[[Node], None]
Visitor = Callable[[str], AbstractContextManager[object]]  # somebody on the bus


class Case(NamedTuple):
    """One mistake."""

    mistake: str
    words: tuple[str, ...]  # of the command; BUS and names of files are filled in
    code: int
    said: tuple[str, ...]
    edit: Callable[[Files], None] = lambda files: None
    visitors: tuple[Visitor, ...] = ()


class Result(NamedTuple):
    """What came of it, with paths and ports left out."""

    code: int
    message: str
    printed: str
    provocations: tuple[str, ...]
    left_behind: tuple[str, ...]  # recordings


def run_case(case: Case, directory: Path) -> Result:
    """Run the command of a case in `directory` (empty)."""
    bus = f"loopback:{free_loopback_port()}"
    files = {name: (FILES / name).read_text() for name in (AXIS, BUS_AXIS, DRIVE, MODEL)}
    case.edit(files)
    for name, text in files.items():
        (directory / name).write_text(text)
    words = [bus if word == "BUS" else word for word in case.words]
    stderr, stdout = io.StringIO(), io.StringIO()
    with ExitStack() as stack:
        visitors = [stack.enter_context(visitor(bus)) for visitor in case.visitors]
        stack.enter_context(contextlib.chdir(directory))
        stack.enter_context(_signals_kept())
        with contextlib.redirect_stderr(stderr), contextlib.redirect_stdout(stdout):
            code = _exit_code(words)
    nodes = [visitor for visitor in visitors if isinstance(visitor, BusNode)]
    provocations = tuple(text for node in nodes for text in node.provocations())
    recordings = tuple(sorted(path.name for path in directory.rglob("*.mcap*")))
    message = _plain(stderr.getvalue(), directory, bus)
    return Result(code, message, stdout.getvalue(), provocations, recordings)


def _exit_code(words: list[str]) -> int:
    try:
        return main(words)
    except SystemExit as usage:  # argparse
        return int(usage.code or 0)


@contextlib.contextmanager
def _signals_kept() -> Iterator[None]:
    """`sim` takes SIGTERM and SIGINT for itself."""
    kept = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


def _plain(text: str, directory: Path, bus: str) -> str:
    port = bus.partition(":")[2]
    text = text.replace(f"{directory}/", "").replace(bus, "loopback:PORT").replace(f"UDP port {port}", "UDP port PORT")
    return text.strip()


# --- edits


def changed(name: str, old: str, new: str) -> Callable[[Files], None]:
    """Replace a part of a file, which must be there."""

    def edit(files: Files) -> None:
        assert old in files[name], f"{name} does not hold {old!r} any more"
        files[name] = files[name].replace(old, new, 1)

    return edit


def added(name: str, text: str) -> Callable[[Files], None]:
    """Add a file, or to the end of one."""

    def edit(files: Files) -> None:
        files[name] = files.get(name, "") + text

    return edit


def both(*edits: Callable[[Files], None]) -> Callable[[Files], None]:
    """One edit after the other."""

    def edit(files: Files) -> None:
        for each in edits:
            each(files)

    return edit


def drive_key(text: str) -> Callable[[Files], None]:
    """One more key of the drive section of the file for a bus."""
    return changed(BUS_AXIS, "  node_id: 1\n", f"  node_id: 1\n  {text}\n")


def without(*names: str) -> Callable[[Files], None]:
    """Leave files out."""

    def edit(files: Files) -> None:
        for name in names:
            del files[name]

    return edit


OTHER_DRIVE = replace(NodeConfig(), identity=replace(Identity(), product_code=0x1234))
FEW_OBJECTS = eds_text(NodeConfig()).replace("[606C]", "[2F6C]").replace("=0x606C", "=0x2F6C")
LONG = "p" * 300
QUICK = drive_key("start_timeout_s: 0.1")


# --- visitors


def node(
    config: NodeConfig | None = None, prepare: Preparation | None = None, after_boot: Preparation | None = None
) -> Visitor:
    """A simulated drive."""
    return lambda bus: BusNode(bus, config, prepare, after_boot)


def put(index: int, sub: int, value: int) -> Preparation:
    """A drive in which an object says something else."""
    return lambda node: node.od.put(index, sub, value)


def put_on_bus(index: int, sub: int, data: bytes) -> Preparation:
    """A drive to which somebody wrote an object."""
    return lambda node: node.od.download(index, sub, data)


def refuse(index: int, code: Abort) -> Preparation:
    """A drive that takes no write to an object."""

    def guard(sub: int, value: int) -> None:
        raise SdoAbortError(code)

    return lambda node: node.od.guard(index, guard)


@contextlib.contextmanager
def somebody_else(bus: str) -> Iterator[None]:
    """A program that is no loopback bus holds the port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind((BROADCAST, int(bus.partition(":")[2])))
        yield


FACTS = added("facts.yaml", "torque_constant_nm_per_a: 0.148\n")
RUN, RUN_ON_BUS = ("run", AXIS), ("run", BUS_AXIS, "--bus", "BUS", "--uncommissioned")

CASES = (
    # the file
    Case(
        "unknown key", (*CHECK, AXIS), 78,
        (rf"{AXIS}:\d+: controller\.integral_a_per_rv: unknown key; did you mean 'integral_a_per_rev'\?",
         "controller.integral_a_per_rev: missing"),
        changed(AXIS, "integral_a_per_rev:", "integral_a_per_rv:"),
    ),
    Case(
        "unknown key without a near one", RUN, 78, (rf"{AXIS}:\d+: colour: unknown key; known here: .*profile",),
        added(AXIS, "colour: blue\n"),
    ),
    Case(
        "wrong unit: rpm in place of rev/s", RUN, 78,
        (rf"{AXIS}:\d+: envelope\.speed_limit_rpm: unknown key; did you mean 'speed_limit_rps'\?",),
        changed(AXIS, "speed_limit_rps: 25", "speed_limit_rpm: 1500"),
    ),
    Case(
        "wrong unit: a unit behind the number", RUN, 78,
        (rf"{AXIS}:\d+: controller\.current_limit_a: .*number.*'12 A'",),
        changed(AXIS, "current_limit_a: 12", "current_limit_a: 12 A"),
    ),
    Case(
        "wrong unit: milliseconds in place of seconds", RUN, 78,
        (rf"{MODEL}:\d+: delay_s\.value: 2.75 is outside 0 .. 0.1",),
        changed(MODEL, "delay_s: {value: 0.00275", "delay_s: {value: 2.75"),
    ),
    Case(
        "out of range", RUN, 78,
        (rf"{AXIS}:\d+: controller\.proportional_a_per_rps: a number above 0 and up to 10000 is needed \(got -1\)",),
        changed(AXIS, "proportional_a_per_rps: 0.975", "proportional_a_per_rps: -1"),
    ),
    Case(
        "node id out of range", RUN_ON_BUS, 78,
        (rf"{BUS_AXIS}:\d+: drive\.node_id: a number from 1 to 127 is needed \(got 200\)",),
        changed(BUS_AXIS, "node_id: 1\n", "node_id: 200\n"),
    ),
    Case(
        "key given twice", RUN, 78, (rf"{AXIS}:\d+: name: given twice, first in line \d+",),
        added(AXIS, "name: again\n"),
    ),
    Case(
        "limits that contradict each other", RUN, 78,
        (rf"{AXIS}:\d+: envelope: continuous_current_a must not exceed current_limit_a",),
        changed(AXIS, "continuous_current_a: 8.3", "continuous_current_a: 20"),
    ),
    Case(
        "model edited by hand", RUN, 78,
        (rf"{MODEL}:\d+: content_hash: does not match .*edited by hand.*Remove the line to accept",),
        added(MODEL, "content_hash: 0123456789abcdef\n"),
    ),
    Case(
        "a number in quotes", RUN, 78,
        (rf"{AXIS}:\d+: controller\.current_limit_a: a number above 0 and up to 1000 is needed \(got '12'\)",),
        changed(AXIS, "current_limit_a: 12", "current_limit_a: '12'"),
    ),
    Case(
        "true in place of a number", (*CHECK, AXIS), 78,
        (rf"{AXIS}:\d+: controller\.current_limit_a: a number above 0 and up to 1000 is needed \(got true\)",),
        changed(AXIS, "current_limit_a: 12", "current_limit_a: true"),
    ),
    Case(
        "a decimal comma", (*CHECK, AXIS), 78,
        (rf"{AXIS}:\d+: controller\.current_limit_a: .* write 12\.5, with a decimal point",),
        changed(AXIS, "current_limit_a: 12", "current_limit_a: 12,5"),
    ),
    Case(
        "a decimal comma inside braces", RUN, 78,
        (rf"{MODEL}:\d+: delay_s\.value: write 0\.00275, with a decimal point \(got 0,00275\)",),
        changed(MODEL, "delay_s: {value: 0.00275", "delay_s: {value: 0,00275"),
    ),
    Case(
        "a mistake in the file of the simulated drive, when the axis is checked", (*CHECK, AXIS), 78,
        (f"{DRIVE}: cannot be read: No such file",),
        without(DRIVE),
    ),
    Case(
        "a fraction or an exponent in place of a whole number", (*CHECK, BUS_AXIS), 78,
        (rf"{BUS_AXIS}:\d+: drive\.bitrate_hz: a whole number from 10000 to 1000000 is needed: write 500000",),
        drive_key("bitrate_hz: 5e5"),
    ),
    Case(
        "an alias", (*CHECK, AXIS), 78, (rf"{AXIS}:\d+: the anchor &limit is not allowed",),
        both(changed(AXIS, "current_limit_a: 12", "current_limit_a: &limit 12"),
             changed(AXIS, "current_limit_a: 14", "current_limit_a: *limit")),
    ),
    Case("a list in itself", (*CHECK, AXIS), 78, (rf"{AXIS}:\d+: the anchor &a is not allowed",),
         added(AXIS, "more: &a [*a]\n")),
    Case(
        "a file of a later version", RUN, 78,
        (rf"{MODEL}:\d+: format: fffo_drive/model/7 is newer than what fffo-drive \S+ reads .*with a later one",),
        changed(MODEL, "fffo_drive/model/1", "fffo_drive/model/7"),
    ),
    Case(
        "a file of another kind", (*CHECK, MODEL), 78,
        (rf"{MODEL}:\d+: format: fffo_drive/model/1 where fffo_drive/axis/2 is needed",),
    ),
    Case("text that is no YAML", RUN, 78, (rf"{AXIS}:\d+: not valid YAML",), added(AXIS, "recording: [\n")),
    Case(
        "a name too long for its recordings", RUN, 78, (rf"{AXIS}:\d+: name: at most 64 characters are allowed",),
        changed(AXIS, "name: bench", f"name: {LONG}"),
    ),
    Case(
        "a model whose name no file may have", RUN, 78, (rf"{AXIS}:\d+: model: no file may have this name: at most",),
        changed(AXIS, f"model: {MODEL}", f"model: {LONG}"),
    ),
    Case(
        "a drive profile whose name no file may have", RUN_ON_BUS, 78,
        (rf"{BUS_AXIS}:\d+: drive\.profile: no file may have this name",), drive_key(f"profile: {LONG}"),
    ),
    Case("missing axis file", RUN, 78, (f"{AXIS}: cannot be read: No such file",), without(AXIS)),
    Case(
        "missing model file", RUN, 78,
        (rf"{AXIS}:\d+: model: {MODEL}: cannot be read: No such file or directory$",),
        without(MODEL),
    ),
    Case(
        "mistyped model file", RUN, 78,
        (rf"{AXIS}:\d+: model: modle\.yaml: cannot be read: .*: did you mean '{MODEL}'",),
        changed(AXIS, "model: model.yaml", "model: modle.yaml"),
    ),
    Case(
        "a model with an effect of a package that is not installed", RUN, 78,
        (rf"{MODEL}:\d+: effects\[0\]\.name: the effect 'my_drag' is not known here, .* package my-drag 1\.0: ",),
        added(MODEL, "effects: [{name: my_drag, brought_by: package my-drag 1.0}]\n"),
    ),
    Case("missing file of the simulated drive", RUN, 78, (f"{DRIVE}: cannot be read: No such file",), without(DRIVE)),
    Case(
        "unknown effect of the simulated drive", RUN, 78,
        (rf"{DRIVE}:\d+: plant\.effects\[0\]\.name: no effect is called 'coging': did you mean 'cogging'",),
        changed(DRIVE, "  effects: []", "  effects: [{name: coging}]"),
    ),
    Case(
        "observer gain too small for condition (14)", RUN, 78,
        (rf"{AXIS}:\d+: controller\.observer\.gain_nm_per_rev: 3 breaks condition \(14\).*at least 3\.2",),
        changed(AXIS, "gain_nm_per_rev: 5", "learns_in: friction\n    gain_nm_per_rev: 3"),
    ),
    Case(
        "quota smaller than two files", RUN, 78, (rf"{AXIS}:\d+: recording: quota_bytes must hold two files",),
        added(AXIS, "recording: {rotate_bytes: 1000000, quota_bytes: 1500000}\n"),
    ),
    Case(
        "quota of a file that is never finished", RUN, 78,
        (rf"{AXIS}:\d+: recording: quota_bytes deletes finished files only.*quota_bytes: null",),
        added(AXIS, "recording: {rotate_bytes: null, rotate_s: null}\n"),
    ),
    Case(
        "blind for so long that it can run away", RUN, 78,
        (
            rf"{AXIS}:\d+: envelope\.feedback_missing_ticks: blind for at most 10 ticks = 5 ms: 11 rps and 0\.028 rev "
            r"at current_limit_a, more than 20% of speed_limit_rps 25: at most 4 ticks, or .*\.accept_runaway: true",
        ),
        changed(AXIS, "  following_error_s: 0.2\n", "  following_error_s: 0.2\n  feedback_missing_ticks: 10\n"),
    ),
    # what the file asks for
    Case(
        "velocity reference beyond the limit", RUN, 78,
        (rf"{AXIS}:\d+: profile: peak of 14\.\d+ rps is beyond envelope\.speed_limit_rps 10",),
        changed(AXIS, "speed_limit_rps: 25", "speed_limit_rps: 10"),
    ),
    Case(
        "a reference of a day", (*CHECK, AXIS), 78,
        (rf"{AXIS}:\d+: profile: lasts 86400 s, loop\.longest_profile_s is 600",),
        changed(AXIS, "duration_s: 60", "duration_s: 86400"),
    ),
    Case(
        "a reference of no duration", (*CHECK, AXIS), 78,
        (rf"{AXIS}:\d+: profile: lasts 1e-06 s; at least 2 periods of the loop, 0\.001 s, are needed",),
        changed(AXIS, "{kind: paper, duration_s: 60}", "{kind: points, points: [[0, 0], [1.0e-6, 0]]}"),
    ),
    Case(
        "a chirp that goes nowhere", (*CHECK, AXIS), 78,
        (rf"{AXIS}:\d+: profile: lowest_hz 10 must be below highest_hz 10",),
        changed(AXIS, "{kind: paper, duration_s: 60}", "{kind: identify, lowest_hz: 10, highest_hz: 10}"),
    ),
    Case(
        "current reference beyond the limit", RUN, 78,
        (rf"{AXIS}:\d+: profile: peak of 20 A is beyond envelope\.current_limit_a 14",),
        changed(AXIS, "{kind: paper, duration_s: 60}",
                "{kind: sine, mode: current, duration_s: 5, amplitude: 20, frequency_hz: 1}"),
    ),
    Case(
        "reference that leaves the position window", RUN, 78,
        (rf"{AXIS}:\d+: profile: travels .* rev from its start, envelope\.position_window_rev is \(-1\.0, 1\.0\)",),
        changed(AXIS, "envelope:\n", "envelope:\n  position_window_rev: [-1, 1]\n"),
    ),
    Case(
        "rate that the bus cannot carry", RUN_ON_BUS, 78,
        (rf"{BUS_AXIS}:\d+: loop\.rate_hz: 4000 Hz loads the bus to \d+% .*lower the rate or raise the bit rate",),
        added(BUS_AXIS, "loop: {rate_hz: 4000}\n"),
    ),
    Case(
        "bit rate too low for the rate", RUN_ON_BUS, 78,
        (rf"{BUS_AXIS}:\d+: loop\.rate_hz: .*drive\.bitrate_hz 500000",),
        drive_key("bitrate_hz: 500000"),
    ),
    Case(
        "period that no drive can be told", RUN_ON_BUS, 78,
        (rf"{BUS_AXIS}:\d+: drive: .*period of 3003003 ns does not fit 0x60C2: choose",),
        added(BUS_AXIS, "loop: {rate_hz: 333}\n"),
    ),
    Case(
        "heartbeat timeout too short", RUN_ON_BUS, 78,
        (rf"{BUS_AXIS}:\d+: drive: heartbeat_timeout_ms 60: at least twice heartbeat_ms \(100\)",),
        drive_key("heartbeat_timeout_ms: 60"),
    ),
    Case(
        "our own node id is the drive's", RUN_ON_BUS, 78,
        (rf"{BUS_AXIS}:\d+: drive: node_id and master_id are both 1",),
        drive_key("master_id: 1"),
    ),
    Case(
        "a bus for a drive in process", (*RUN, "--bus", "BUS"), 78,
        (rf"{AXIS}:\d+: drive\.kind: simulated runs in process and has no bus: leave --bus",),
    ),
    Case(
        "a torque object of a node's second axis", RUN_ON_BUS, 78,
        (rf"{BUS_AXIS}:\d+: drive\.torque_feedback\.object: 0x6877 is 0x6077 of axis 2 of a node\. .*first axis",),
        drive_key("torque_feedback: {object: 0x6877}"),
    ),
    # the EDS
    Case(
        "missing EDS", RUN_ON_BUS, 78, (rf"{BUS_AXIS}:\d+: drive\.eds: none.eds: cannot be read: No such file",),
        drive_key("eds: none.eds"), (node(),),
    ),
    Case(
        "a file that is no EDS", RUN_ON_BUS, 78, (f"EDS file {DRIVE}: has no section .*is it an EDS",),
        drive_key(f"eds: {DRIVE}"), (node(),),
    ),
    Case(
        "EDS of a drive without a velocity", RUN_ON_BUS, 78,
        ("EDS file few.eds: .*: object 0x606C:00 is missing .the velocity that is controlled",),
        both(drive_key("eds: few.eds"), added("few.eds", FEW_OBJECTS)), (node(),),
    ),
    Case(
        "EDS of another drive", RUN_ON_BUS, 70,
        ("EDS file other.eds is for product 0x00001234, the drive says .*use the EDS of this drive, or none",),
        both(drive_key("eds: other.eds"), added("other.eds", eds_text(OTHER_DRIVE))), (node(),),
    ),
    # the axis
    Case(
        "an axis that was never commissioned", ("run", BUS_AXIS, "--bus", "BUS"), 78,
        (rf"{BUS_AXIS}:\d+: commissioning: .*never checked: run fffo-drive commission .*or give --uncommissioned",),
        visitors=(node(),),
    ),
    Case(
        "a commissioning record that is not there", ("run", BUS_AXIS, "--bus", "BUS"), 78,
        (rf"{BUS_AXIS}:\d+: commissioning: none.yaml is not there: run fffo-drive commission {BUS_AXIS}, which",),
        added(BUS_AXIS, "commissioning: none.yaml\n"), (node(),),
    ),
    # the bus
    Case(
        "no answer on the bus", RUN_ON_BUS, 69,
        ("loopback:PORT: node 1 does not answer .*powered, wired and terminated.*no other node",), QUICK,
    ),
    Case(
        "node id of nobody", RUN_ON_BUS, 69, ("node 1 does not answer .*node id right.*Heard of: node 2",), QUICK,
        (node(replace(NodeConfig(), node_id=2), after_boot=put_on_bus(0x1017, 0, bytes([10, 0]))),),
    ),
    Case(
        "two nodes of one id", RUN_ON_BUS, 70, ("two nodes have (the|this) id",),
        visitors=(node(), node()),
    ),
    Case(
        "port in use by something else", RUN_ON_BUS, 69,
        ("UDP port PORT is in use by a program that is no loopback bus; choose another port",),
        visitors=(somebody_else,),
    ),
    Case(
        "port in use by something else, simulated drive", ("sim", DRIVE, "--bus", "BUS"), 69,
        ("UDP port PORT is in use by a program that is no loopback bus; choose another port",),
        visitors=(somebody_else,),
    ),
    Case("port that is none", ("sim", DRIVE, "--bus", "loopback:80"), 69, ("a number from 1024 to 65535",)),
    Case(
        "bus without its kind", ("run", BUS_AXIS, "--bus", "can0", "--uncommissioned"), 69,
        ("'can0': write socketcan:INTERFACE",),
    ),
    Case("node id of the simulated drive", ("sim", DRIVE, "--node", "200"), 78, ("node_id: 200 is outside 1 to 127",)),
    # the drive
    Case(
        "no servo drive", RUN_ON_BUS, 70,
        ("node 1: 0x1000:00 says 0x00020191, which is no CiA 402 drive .*set drive.device_profile: null",),
        visitors=(node(prepare=put(0x1000, 0, DEVICE_TYPE & ~0xFFFF | 0x0191)),),
    ),
    Case(
        "a drive without cyclic synchronous torque", RUN_ON_BUS, 70,
        ("node 1: there is no mode 10 .cyclic synchronous torque.: 0x6502:00 says 0x00000008, bit 9 is needed",),
        visitors=(node(prepare=put(0x6502, 0, 1 << 3)),),
    ),
    Case(
        "a drive that refuses the command mapping", RUN_ON_BUS, 70,
        (r"refuses 0x1600:01 = .*needed for 0x6040:00/16 in RPDO1: .*0x06040041|refuses 0x1600:00 .*0x06040041",),
        visitors=(node(prepare=refuse(0x1600, Abort.NOT_MAPPABLE)),),
    ),
    Case(
        "a drive that refuses the feedback mapping", RUN_ON_BUS, 70,
        ("refuses 0x1A00:0. .*TPDO1.*0x06040041",),
        visitors=(node(prepare=refuse(0x1A00, Abort.NOT_MAPPABLE)),),
    ),
    Case(
        "a drive that takes no SYNC so fast", RUN_ON_BUS, 70,
        ("refuses 0x1006:00 = 500 .*needed for a SYNC period of 500 us",),
        visitors=(node(prepare=refuse(0x1006, Abort.INVALID_VALUE)),),
    ),
    Case(
        "a drive that will not stop when the PC is silent", RUN_ON_BUS, 70,
        ("refuses 0x6007:00 = 3 .*needed for the drive to stop when the PC is silent",),
        visitors=(node(prepare=refuse(0x6007, Abort.INVALID_VALUE)),),
    ),
    Case(
        "rated torque of another drive", RUN_ON_BUS, 70,
        ("0x6076:00 says 1.228 Nm, the configuration rated_torque_nm: 2.5; make them agree",),
        changed(BUS_AXIS, "rated_torque_nm: 1.2284", "rated_torque_nm: 2.5"), (node(),),
    ),
    # files of recordings
    Case("a recording that is none", ("log", "info", AXIS), 78, (f"{AXIS}.*not an MCAP file",)),
    Case("a directory in place of a recording", ("log", "info", "."), 78, (r"\.: is a directory, and one file",)),
    Case("a directory in place of a recording to replay", ("replay", "."), 78, (r"\.: is a directory, and one file",)),
    Case("a directory in place of a log to import", ("import", ".", "--out", "new"), 78, (r"\.: is a directory",)),
    Case("a recording that is not there", ("log", "info", "none.mcap"), 78, ("none.mcap: No such file",)),
    Case(
        "an output that is there already", ("log", "recover", AXIS, MODEL), 74,
        (f"{MODEL}: a file of this name exists and is not overwritten",),
    ),
    Case(
        "an output that is there already, of a run", (*RUN, "--out", DRIVE), 74,
        (f"{DRIVE}: a recording of this name exists and is not overwritten",),
    ),
    Case(
        "an output where none can be", (*RUN, "--out", f"{MODEL}/run.mcap"), 74,
        (f"{MODEL}: no directory for recordings: (Not a directory|File exists)",),
    ),
    Case(
        "recording.directory where none can be", RUN, 74, (f"{MODEL}: no directory for recordings",),
        added(AXIS, f"recording: {{directory: {MODEL}}}\n"),
    ),
    # the machine
    Case(
        "real-time properties that the system refuses", RUN_ON_BUS, 77, (r"CPU 4095 for the loop: .*allowed here: \[",),
        added(BUS_AXIS, "realtime: {cpu: 4095, priority: 0, lock_memory: false}\n"), (node(),),
    ),
    # a log of somebody else
    Case(
        "a log of 200,000 columns", ("import", "log.csv", "--yes", "--out", "out"), 78,
        (r"log\.csv, line 2: 200000 columns; at most 4096 can be read: is it a log",),
        added("log.csv", "# turned by 90 degrees\n" + "1.5," * 199_999 + "1.5\n"),
    ),
    Case(
        "a log with a line of 300 kB", ("identify", "log.csv", "--drive", "facts.yaml", "--out", "out"), 78,
        (r"log\.csv, line 3: a line of 300000 bytes; a table has at most 262144 in one",),
        both(added("log.csv", "time_s,velocity_rps\n0,1\n" + "1" * 300_000 + "\n"), FACTS),
    ),
    Case(
        "a log of brackets", ("import", "log.json", "--yes", "--out", "out"), 78,
        (r"log\.json: not readable as JSON: nested too deeply",),
        added("log.json", "[" * 60_000),
    ),
    # usage
    Case("unknown option", (*RUN, "--bass", "BUS"), 2, ("unrecognized arguments: --bass",)),
    Case("unknown toggle", (*RUN, "--toggle", "on"), 2, ("argument --toggle: invalid choice: 'on'",)),
    Case("unknown command", ("start",), 2, ("invalid choice: 'start'",)),
    Case("a letter of a command out of place", ("indentify",), 2, ("'indentify'; did you mean 'identify'\\?",)),
)  # fmt: skip


def shown(message: str) -> str:
    """A message in one cell of a Markdown table; of argparse's usage text only the error."""
    lines = message.splitlines()
    if lines and lines[0].startswith("usage:"):
        lines = lines[-1:]
    lines = [re.sub(r" \(choose from .*\)", "", line) for line in lines]  # grows with the commands
    lines = [re.sub(r"\d+ SDO answers", "N SDO answers", line) for line in lines]
    lines = [re.sub(r"allowed here: .*", "allowed here: ...", line) for line in lines]
    return "<br>".join(re.sub(r"\s+", " ", line).replace("|", r"\|") for line in lines)
