"""The whole assistant on a loopback bus: nodes of all kinds, and what is sent to them: never a word that enables."""

from __future__ import annotations

import dataclasses
import json
import struct
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from buses import BusLog, simulated_node
from paper_drive import u32
from scripted_node import RANGE, ScriptedNode, servo_dictionary

from fffo_drive.can.frame import pack_frame
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.cli import bring_up as command
from fffo_drive.cli import main
from fffo_drive.documents import DocumentError
from fffo_drive.drive.canopen import scan
from fffo_drive.drive.canopen.lss import LssLink, LssMaster
from fffo_drive.drive.port import BusOccupiedError, DriveRefusedError
from fffo_drive.drive.simulated.node.config import Identity, NodeConfig
from fffo_drive.workflows import bring_up as workflow
from fffo_drive.workflows import rate_trial
from fffo_drive.workflows.bring_up import Wishes, bring_up_axis
from fffo_drive.workflows.drive_facts import Answers
from fffo_drive.workflows.plan import make_plan

NODE = 5
LEVELS = ("failure", "warning")


@pytest.fixture(autouse=True)
def short_waits(monkeypatch):
    """A loopback bus carries everything at once; what is decided does not depend on these times."""
    monkeypatch.setattr(scan, "PACE_S", 0.0)
    monkeypatch.setattr(workflow, "LISTEN_S", 0.05)
    monkeypatch.setattr(rate_trial, "LISTEN_S", 0.02)
    monkeypatch.setattr(rate_trial, "SETTLE_S", 0.05)


@pytest.fixture
def bus(monkeypatch, tmp_path):
    """A bus of its own; files are written where the test is."""
    monkeypatch.chdir(tmp_path)
    return f"loopback:{free_loopback_port()}"


def drive_objects(node_id=NODE, changes=None, without=()):
    """A drive that tells its scales and can be enabled."""
    objects = servo_dictionary(node_id) | {
        (0x6041, 0): struct.pack("<H", 0x0250), (0x608F, 1): u32(4096), (0x608F, 2): u32(1),
        (0x60A9, 0): u32(0xFDB44700), (0x6079, 0): u32(48_000), (0x60FD, 0): u32(0), (0x1001, 0): b"\0",
    }  # fmt: skip
    return {where: data for where, data in (objects | (changes or {})).items() if where not in without}


class Drive(ScriptedNode):
    """A scripted node that answers SYNC once it was started, and denies some reads."""

    def __init__(self, bus, node_id=NODE, objects=None, *, answers_sync=True, denied=None, **more):
        super().__init__(bus, node_id, drive_objects(node_id) if objects is None else objects, **more)
        self.answers_sync, self.denied, self.running, self.syncs = answers_sync, denied or {}, False, 0

    def take(self, frame):
        if frame.can_id == 0x080 and self.running and self.answers_sync:
            self.syncs += 1
            self.send(0x180 + self.node_id, struct.pack("<ii", 0, 4096))
            if self.syncs % 10 == 0:
                self.send(0x280 + self.node_id, self.objects[0x6041, 0] + b"\0\0")
        elif frame.can_id == 0x000 and frame.data[1:] in (bytes([self.node_id]), b"\0"):
            self.running = frame.data[0] == 1

    def _sdo(self, request):
        where = int.from_bytes(request[1:3], "little"), request[3]
        if request[0] == 0x40 and where in self.denied:
            self._abort(request[1:4], self.denied[where])
        else:
            super()._sdo(request)

    @property
    def controlwords(self):
        """Of all commands that were heard, by RPDO and SDO."""
        words = [int.from_bytes(f.data[:2], "little") for f in self.heard if f.can_id == 0x200 + self.node_id]
        return set(words + [int.from_bytes(data, "little") for index, _, data in self.written if index == 0x6040])

    @property
    def torques(self):
        """Likewise."""
        values = [f.data[2:4] for f in self.heard if f.can_id == 0x200 + self.node_id and len(f.data) == 4]
        return set(values + [data for index, _, data in self.written if index == 0x6071])


class Person:
    """Reads what is printed and gives answers in their order; without answers nobody is there."""

    def __init__(self, *answers):
        self.answers, self.printed, self.questions = list(answers), [], []

    def tell(self, text):
        self.printed.append(text)

    def progress(self, share):
        assert 0.0 <= share <= 1.0

    def ask(self, question, proposal):
        self.questions.append(question)
        if not self.answers:
            return None
        return self.answers.pop(0) or proposal


def wishes(bus, **changes):
    return Wishes(bus, Path("axis.yaml"), measure=False, seconds=0.2)._replace(**changes)


def said(report, *levels):
    return [f"{one.subject}: {one.text}" for one in report.findings if one.level in (levels or LEVELS)]


def check_page(report):
    """80 columns, the verdict first, JSON that programs read."""
    lines = list(command.report_lines(report))
    assert next(line for line in lines if line).startswith(report.verdict[:40])
    assert max(map(len, lines)) <= 80
    assert json.loads(json.dumps(report.as_json()))["verdict"] == report.verdict


def test_a_drive_is_found_read_and_written_down_without_a_single_write_to_it(bus, tmp_path):
    with Drive(bus) as node:
        report = bring_up_axis(wishes(bus), Person())
    assert report.ready
    assert report.verdict == "READY to be commissioned: node 5 (a drive with a long name); axis.yaml was written"
    assert (node.written, node.commands) == ([], [])
    assert [(one.node_id, one.device_name, one.vendor_id, one.serial_number) for one in report.nodes] == [
        (5, "a drive with a long name", 0x11, 0x44)
    ]
    assert report.objects["0x6041:00"] == 0x0250
    assert command.exit_code(report) == 0
    check_page(report)
    plan = make_plan(report.axis_file)
    assert (plan.axis.drive.bus, plan.axis.drive.node_id, plan.axis.drive.counts) == (bus, NODE, 4096)
    assert report.next_command == "fffo-drive commission axis.yaml"


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.realtime
def test_rates_are_measured_and_the_drive_is_never_enabled(bus, tmp_path):
    with Drive(bus) as node:
        report = bring_up_axis(wishes(bus, measure=True), Person())
    assert report.trials[0].rate_hz == 500
    assert all(trial.ticks > 0 for trial in report.trials)
    assert all(trial.turnaround_us.median > 0.0 for trial in report.trials if not trial.refused)
    assert report.adapter.answer_us.median >= report.adapter.adapter_us.median > 0.0
    assert node.controlwords == {0}
    assert node.torques == {b"\0\0"}
    assert node.commands[-1] == 0x80  # left pre-operational
    rate = make_plan(report.axis_file).axis.loop.rate_hz
    assert rate == (report.choice.rate_hz or 500)
    assert report.ready is (not report.trials[0].refused)  # a machine that answers no SYNC in time cannot be measured
    check_page(report)


class MillisecondDrive(Drive):
    """Its control period counts milliseconds: 0x60C2:02 takes -3 only."""

    def _check(self, index, sub, value):
        return RANGE if (index, sub) == (0x60C2, 2) and value != b"\xfd" else super()._check(index, sub, value)


def test_a_drive_that_takes_no_faster_sync_says_so(bus, monkeypatch):
    monkeypatch.setattr(workflow, "RATES_HZ", (2000,))
    with MillisecondDrive(bus) as node:
        report = bring_up_axis(wishes(bus, measure=True), Person())
    assert [trial.rate_hz for trial in report.trials] == [2000]
    refused = "node 5 refuses 0x60C2:02 = -4 (0xFC), needed for a control period of 500 us; a slower rate"
    assert report.trials[0].refused.startswith(refused)
    assert (report.choice.rate_hz, report.choice.reason[:22]) == (None, "2000 Hz does not fit: ")
    assert said(report, "failure") == [f"bring-up: {report.trials[0].refused}"]
    assert node.controlwords <= {0}


def test_a_drive_that_does_not_answer_sync_cannot_be_measured(bus, tmp_path):
    with Drive(bus, answers_sync=False) as node:
        report = bring_up_axis(wishes(bus, measure=True), Person())
    assert not report.ready
    assert said(report, "failure") == ["bring-up: no feedback after SYNC: see the PDO mapping and loop.cutoff_share"]
    assert node.controlwords == {0}
    assert command.exit_code(report) == 70


@pytest.mark.parametrize(
    ("changes", "failures"),
    [
        (
            {(0x6041, 0): b"\x18\x02", (0x603F, 0): b"\x20\x32", (0x1001, 0): b"\x05"},
            [
                "fault: statusword 0x0218: fault; 0x603F 0x3220 (DC link under-voltage); error register 0x1001 0x05 "
                "(generic, voltage)",
            ],
        ),
        (
            {(0x6041, 0): b"\x40\x02", (0x60FD, 0): u32(8)},
            ["STO: 0x60FD is 0x00000008: the interlock input (bit 3; STO in most drives) is active"],
        ),
        (
            {(0x6041, 0): b"\x40\x02", (0x6079, 0): u32(0)},
            ["supply: DC link (0x6079): 0.0 V: the power stage is not supplied"],
        ),
    ],
)
def test_what_stands_in_the_way_is_reported_and_the_file_is_written_all_the_same(bus, tmp_path, changes, failures):
    with Drive(bus, objects=drive_objects(changes=changes)):
        report = bring_up_axis(wishes(bus), Person())
    assert said(report, "failure") == failures
    problems = "1 problem" if len(failures) == 1 else f"{len(failures)} problems"
    assert report.verdict.startswith(f"NOT READY: {problems} at node 5")
    assert command.exit_code(report) == 70
    assert make_plan(report.axis_file).axis.drive.node_id == NODE
    check_page(report)


def test_an_object_that_cannot_be_read_is_named(bus, tmp_path):
    with Drive(bus, denied={(0x6079, 0): 0x08000020}):
        report = bring_up_axis(wishes(bus), Person())
    assert report.ready
    assert report.unreadable == {"0x6079:00": "abort 0x08000020"}
    assert said(report) == ["not read: objects that could not be read: 0x6079:00 (abort 0x08000020)"]


def test_nobody_on_the_bus(bus, tmp_path):
    report = bring_up_axis(wishes(bus), Person())
    assert report.verdict.startswith(f"no node answers on {bus}: start a drive there")
    assert "termination (60 ohm" in workflow._where_to_look("socketcan:can0")
    assert command.exit_code(report) == 69
    assert list(tmp_path.iterdir()) == []
    check_page(report)


def test_of_two_drives_one_is_named_or_asked_for(bus, tmp_path):
    with Drive(bus, 5), Drive(bus, 9):
        alone = bring_up_axis(wishes(bus), Person())
        assert alone.verdict == "2 nodes answer (5, 9): choose one with --node"
        assert (command.exit_code(alone), alone.axis_file) == (78, None)
        person = Person("9")
        assert bring_up_axis(wishes(bus), person).node_id == 9
        assert person.questions[0] == "which node is the drive of the axis (5, 9)?"
        named = bring_up_axis(wishes(bus, node_id=5, force=True), Person())
        assert (named.node_id, len(named.nodes)) == (5, 2)
        other = bring_up_axis(wishes(bus, node_id=6, force=True), Person())
        assert other.verdict == f"node 6 does not answer on {bus}; node 5, node 9 does"


def test_the_drive_among_other_devices_is_taken(bus, tmp_path):
    digital = servo_dictionary(3) | {(0x1000, 0): u32(0x000F0191)}
    with Drive(bus), ScriptedNode(bus, 3, digital):
        report = bring_up_axis(wishes(bus), Person())
    assert report.node_id == NODE
    assert [one.is_drive for one in report.nodes] == [False, True]


def test_two_nodes_with_one_id_are_told_apart_from_one(bus, tmp_path):
    with Drive(bus), Drive(bus):
        report = bring_up_axis(wishes(bus), Person())
    assert "2 answers to one request: two nodes have this id" in report.verdict
    assert report.axis_file is None


def test_what_no_drive_tells_is_asked_or_named(bus, tmp_path):
    silent = ((0x608F, 1), (0x608F, 2), (0x60A9, 0), (0x6075, 0))
    with Drive(bus, objects=drive_objects(without=silent)):
        report = bring_up_axis(wishes(bus), Person())
        assert report.missing == ("--counts", "--velocity-units", "--torque-constant")
        assert (report.axis_file, command.exit_code(report)) == (None, 78)
        check_page(report)
        person = Person("2000", "60", "not a number", "0.1", "0.11", "", "")
        asked = bring_up_axis(wishes(bus), person)
        assert len(person.questions) == 3  # what cannot be understood stays open
        assert asked.missing == ("--torque-constant",)
        answered = bring_up_axis(wishes(bus), Person("2000", "60", "0.1", "8.5"))
        assert answered.ready
        assert answered.facts["torque_constant_nm_per_a"].value == 0.1
        assert answered.facts["rated_current_a"].value == 8.5  # put to the person, who knew better
        given = Answers(counts_per_rev=2000, velocity_units_per_rps=60.0, torque_constant_nm_per_a=0.1)
        again = bring_up_axis(wishes(bus, answers=given, force=True), Person())
        assert again.ready


def test_nothing_is_sent_where_somebody_else_commands(bus, tmp_path):
    stop = threading.Event()

    def other_master():
        with open_link(bus) as link:
            while not stop.wait(0.002):
                link.send(pack_frame(0x080))

    thread = threading.Thread(target=other_master)
    with Drive(bus) as node:
        thread.start()
        try:
            with pytest.raises(BusOccupiedError, match="SYNC \\(0x080\\)"):
                bring_up_axis(wishes(bus), Person())
        finally:
            stop.set()
            thread.join()
    assert {frame.can_id for frame in node.heard} == {0x080}


def test_a_drive_that_lacks_what_we_need_is_not_measured_and_says_what(bus):
    with Drive(bus, objects=drive_objects(without=((0x606C, 0),))) as node:
        report = bring_up_axis(wishes(bus, measure=True), Person())
    assert said(report, "failure") == ["lacks: object 0x606C:00 is missing (the velocity that is controlled)"]
    assert report.verdict.startswith("CANNOT BE USED: node 5 (a drive with a long name) lacks what this program needs")
    assert report.axis_file is None
    check_page(report)
    assert (report.trials, node.written, node.commands) == ((), [], [])
    assert command.exit_code(report) == 70


def test_what_a_key_of_the_axis_file_can_help_is_written_down(bus):
    deaf = drive_objects(without=((0x1016, 0), (0x1016, 1), *(((0x1400 + n, 5)) for n in range(4))))
    with Drive(bus, objects=deaf):
        report = bring_up_axis(wishes(bus, measure=True), Person())
    failures = said(report, "failure")
    assert len(failures) == 1
    assert "drive.silence_detection" in failures[0]
    assert (report.trials, report.axis_file) == ((), Path("axis.yaml"))


def test_the_family_can_be_named_where_the_drive_does_not_tell_it(bus):
    epos = drive_objects(changes={(0x6076, 0): u32(1_000_000)})
    with Drive(bus, objects=epos), BusLog(bus) as log:
        with pytest.raises(DocumentError, match=r"'epos99' is neither a file .* nor a profile"):
            bring_up_axis(wishes(bus, profile="epos99"), Person())
        assert log.frames == []
        report = bring_up_axis(wishes(bus, profile="maxon_epos4"), Person())
    assert report.profile == "maxon_epos4"
    assert report.facts["rated_torque_nm"].value == pytest.approx(1.0)  # it counts uNm
    assert make_plan(report.axis_file).axis.drive.profile == "maxon_epos4"


def test_what_a_drive_tells_and_no_axis_file_can_hold_is_named(bus):
    with Drive(bus, objects=drive_objects(changes={(0x6076, 0): u32(4_000_000_000)})):
        report = bring_up_axis(wishes(bus), Person())
    assert not report.ready
    assert "rated_torque_nm" in said(report, "failure")[0]
    assert list(Path.cwd().iterdir()) == []


def test_a_node_that_only_beats_is_reported(bus):
    beat = threading.Event()

    def stopped_node():
        with open_link(bus) as link:
            while not beat.wait(0.01):
                link.send(pack_frame(0x709, b"\x04"))

    thread = threading.Thread(target=stopped_node)
    thread.start()
    try:
        report = bring_up_axis(wishes(bus), Person())
    finally:
        beat.set()
        thread.join()
    assert report.verdict.endswith("stopped: heard, but answers no SDO request; it is stopped")


def test_a_directory_that_is_not_there_is_named_before_the_bus_is_used(bus):
    with BusLog(bus) as log, pytest.raises(DocumentError, match="no such directory: nowhere"):
        bring_up_axis(wishes(bus, out=Path("nowhere/axis.yaml")), Person())
    assert log.frames == []


def test_files_are_never_overwritten_unasked_and_then_the_bus_is_left_alone(bus, tmp_path):
    (tmp_path / "axis.model.yaml").write_text("mine")
    with BusLog(bus) as log, pytest.raises(DocumentError, match=r"axis\.model\.yaml: exists already"):
        bring_up_axis(wishes(bus), Person())
    assert log.frames == []
    with Drive(bus):
        assert bring_up_axis(wishes(bus, force=True), Person()).ready
    assert (tmp_path / "axis.model.yaml").read_text() != "mine"


@pytest.mark.long
@pytest.mark.slow
def test_a_drive_without_an_id_is_found_and_given_one_only_when_asked(bus, tmp_path):
    identity = dataclasses.replace(Identity(), vendor_id=0x11, serial_number=0xCAFE)
    with simulated_node(bus, NodeConfig(identity=identity)):
        link = LssLink(bus)
        for request in ("0401", "11FF", "17", "0400"):
            link.ask(bytes.fromhex(request.ljust(16, "0")), 0.5)
        with open_link(bus) as plain:
            plain.send(pack_frame(0, bytes([0x81, 1])))
        found = bring_up_axis(wishes(bus), Person())
        assert [address.serial_number for address in found.without_id] == [0xCAFE]
        assert (found.nodes, found.axis_file) == ((), None)
        assert found.verdict.startswith("1 without a node id: give one with --assign ID; no node answers")
        assert bring_up_axis(wishes(bus), Person("no")).nodes == ()
        taken = bring_up_axis(wishes(bus, assign_id=42), Person())
        assert (taken.node_id, taken.ready, taken.without_id) == (42, True, ())
        assert make_plan(taken.axis_file).axis.drive.node_id == 42
        assert LssMaster(link.ask).nodes_without_id() == []
        link.close()


def test_an_id_is_not_given_twice(bus, tmp_path, monkeypatch):
    address = workflow.LssAddress(1, 2, 3, 4)
    monkeypatch.setattr(workflow, "_search_without_id", lambda bus, talk: (address,))
    with Drive(bus), pytest.raises(DriveRefusedError, match="node id 5 is taken"):
        bring_up_axis(wishes(bus, assign_id=NODE), Person())
    monkeypatch.setattr(workflow, "_search_without_id", lambda bus, talk: (address, address))
    with pytest.raises(DriveRefusedError, match="2 nodes have no id; connect one at a time"):
        bring_up_axis(wishes(bus, assign_id=NODE), Person())


# -- the command


def test_the_command_prints_json_for_programs(bus, tmp_path, capsys):
    with Drive(bus):
        code = main(["bring-up", bus, "--out", str(tmp_path / "a.yaml"), "--no-measure", "--json"])
    out, err = capsys.readouterr()
    report = json.loads(out)
    assert (code, err) == (0, "")
    assert report["ready"] is True
    assert report["axis_file"] == str(tmp_path / "a.yaml")
    assert report["facts"]["counts_per_rev"] == {"value": 4096, "source": "read: 0x608F"}
    assert report["nodes"][0]["drive"] is True


def test_the_command_says_the_verdict_and_checks_its_own_file(bus, tmp_path, capsys):
    out = tmp_path / "a.yaml"
    with Drive(bus):
        assert main(["bring-up", bus, "--out", str(out), "--no-measure", "--yes"]) == 0
    printed = capsys.readouterr().out
    assert printed.lstrip().startswith("READY to be commissioned")
    assert main(["config", "check", str(out)]) == 0
    assert main(["bring-up", bus, "--out", str(out), "--no-measure"]) == 78
    assert "exists already" in capsys.readouterr().err


@pytest.mark.parametrize(("typed", "started"), [("", False), ("n", False), ("yes please", False), ("y", True)])
def test_the_next_step_moves_the_axis_and_is_started_by_a_yes_alone(typed, started, monkeypatch, tmp_path):
    calls = []
    monkeypatch.setattr("builtins.input", lambda question: typed)
    monkeypatch.setattr("fffo_drive.cli.main", lambda arguments: calls.append(arguments) or 0)
    assert command._lead_on(tmp_path / "a.yaml") == 0
    assert calls == ([["commission", str(tmp_path / "a.yaml")]] if started else [])


def test_nobody_is_asked_who_said_yes_to_everything(monkeypatch, tmp_path, bus):
    monkeypatch.setattr("builtins.input", lambda question: pytest.fail("asked"))
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    with Drive(bus):
        assert main(["bring-up", bus, "--out", str(tmp_path / "a.yaml"), "--no-measure", "--yes"]) == 0
