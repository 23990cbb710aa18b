"""A whole run on a bus, drive and host as the product has them, time made of SYNCs.

The simulated drive advances by one period of 0.5 ms with each SYNC and not otherwise, and the loop ticks at whatever
rate the machine bears: law, model and plant see 2 kHz. Every limit on real time is far away.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from buses import PATIENCE_S, SOCKETCAN, BusLog, as_text

from fffo_drive.can.frame import NMT, SDO_REQUEST, SDO_RESPONSE, pack_frame, unpack_frame
from fffo_drive.can.link import StampedFrame, open_link
from fffo_drive.control.envelope import TRIP_NONE
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.port import DriveIdentity
from fffo_drive.recording.reader import Run, read_run
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime import runs
from fffo_drive.runtime.runs import RunOutcome, record_live
from fffo_drive.runtime.session import Session, SessionConfig
from fffo_drive.workflows.plan import Plan, make_plan, open_drive, plan_session, run_header
from fffo_drive.workflows.simulated_process import SimulatedProcess

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PERIOD_S = 0.0005
NODE_ID = 1
ASKED, MARGIN = 40, 3  # SDO answers, and periods of the loop in the longest of them
LONGEST_PERIOD_NS = 150_000_000
DRIVE = """\
format: fffo_drive/simulated/1
node_id: 1
step_by_sync: true
plant: {seed: 1}
"""
WIDE = {  # of configs/axis_bench.yaml: limits on real time, far away
    "feedback_missing_ticks: 200": "feedback_missing_ticks: 1000",
    "status_missing_ticks: 400": "status_missing_ticks: 2000",
    "heartbeat_timeout_s: 2": "heartbeat_timeout_s: 30",
    "heartbeat_timeout_ms: 1000": "heartbeat_timeout_ms: 30000",
    "command_timeout_ms: 200": "command_timeout_ms: 30000",
    "realtime: {priority: 60, required: false}": "realtime: {priority: 0, lock_memory: false, required: false}",
}


class Participants(NamedTuple):
    """A connected drive and a started loop."""

    plan: Plan
    drive: CanopenDrive
    session: Session
    identity: DriveIdentity
    log: BusLog


class WholeRun(NamedTuple):
    """What is left of a run."""

    run: Run  # the recording, read again
    outcome: RunOutcome
    frames: list[StampedFrame]  # everything that was on the bus, in its order
    identity: DriveIdentity

    def texts(self, since: int = 0) -> list[str]:
        """The frames as candump writes them, from number `since` on."""
        return [as_text(frame.raw) for frame in self.frames[since:]]


def axis_file(directory: Path, duration_s: float) -> Path:
    """The bench's axis with a short profile."""
    text = (CONFIGS / "axis_bench.yaml").read_text()
    profile = f"duration_s: {duration_s}, low_rps: 0.5, high_rps: 3, lowest_hz: 5, highest_hz: 20, lines: 5"
    for old, new in {
        **WIDE,
        "duration_s: 60": profile,
        "models/table1.yaml": str(CONFIGS / "models" / "table1.yaml"),
        "\nprofile:": "\nloop: {tail_s: 0.02}\nprofile:",
    }.items():
        assert old in text, old
        text = text.replace(old, new)
    path = directory / "axis.yaml"
    path.write_text(text)
    return path


@contextmanager
def drive_process(bus: str, directory: Path) -> Iterator[SimulatedProcess]:
    """`fffo-drive sim` on the bus."""
    file = directory / "drive.yaml"
    file.write_text(DRIVE)
    with SimulatedProcess(file, bus) as process:
        yield process


def reset_node(bus: str) -> None:
    """Power the drive off and on, as far as a frame can; returns when it has booted."""
    with open_link(bus) as link:
        link.send(pack_frame(NMT, bytes([0x81, NODE_ID])))
        while (raw := link.receive(PATIENCE_S)) is not None:
            if unpack_frame(raw)[:2] == (0x700 + NODE_ID, b"\0"):
                return
    raise AssertionError("no boot-up message after a reset")


def longest_answer_ns(bus: str) -> int:
    """Of some SDO answers, one after the other: how slow machine and bus are at present."""
    request = pack_frame(SDO_REQUEST + NODE_ID, bytes([0x40, 0x00, 0x10, 0, 0, 0, 0, 0]))
    longest_ns = 0
    with open_link(bus) as link:
        for _ in range(ASKED):
            asked_ns = time.monotonic_ns()
            link.send(request)
            while (raw := link.receive(PATIENCE_S)) is not None:
                if unpack_frame(raw).can_id == SDO_RESPONSE + NODE_ID:
                    break
            assert raw is not None, "no SDO answer"
            longest_ns = max(longest_ns, time.monotonic_ns() - asked_ns)
    return longest_ns


def slow(config: SessionConfig, bus: str, answer_ns: int) -> SessionConfig:
    """The same law at a rate that the machine bears: at most 100 Hz in a user-mode kernel, 400 Hz on the loopback bus.

    `answer_ns`: the longest that an answer took of late.
    """
    shortest_ns = 10_000_000 if bus == SOCKETCAN else 2_500_000
    period_ns = min(max(shortest_ns, MARGIN * answer_ns), LONGEST_PERIOD_NS)
    loop = config.loop._replace(
        period_ns=period_ns, cutoff_ns=period_ns * 9 // 10, late_ns=period_ns, minimum_gap_ns=period_ns // 2
    )
    return config._replace(loop=loop)


@contextmanager
def participants(bus: str, directory: Path, duration_s: float, log: BusLog) -> Iterator[Participants]:
    """Bring the drive up, and start the loop."""
    answer_ns = longest_answer_ns(bus)
    plan = make_plan(axis_file(directory, duration_s))
    asked_for = open_drive(plan, bus)
    assert isinstance(asked_for, CanopenDrive)
    drive = CanopenDrive(dataclasses.replace(asked_for.config, answer_timeout_s=10.0, start_timeout_s=PATIENCE_S))
    identity = drive.connect()
    with Session(drive, slow(plan_session(plan), bus, answer_ns)) as session:
        session.start()
        yield Participants(plan, drive, session, identity, log)


def wait_for_trip(session: Session) -> None:
    """Until the loop has found a reason to stop."""
    deadline_s = time.monotonic() + PATIENCE_S
    while session.status(b.TRIP) == TRIP_NONE:
        assert time.monotonic() < deadline_s, "the loop did not trip"
        time.sleep(0.005)


def record(
    bus: str, directory: Path, duration_s: float, at_half: Callable[[Participants], None] | None = None
) -> WholeRun:
    """From the reset of the node to the end; `at_half` is called once when the profile is half done."""
    directory.mkdir(parents=True, exist_ok=True)
    reset_node(bus)  # what another test has left it doing ends before the log begins
    with BusLog(bus) as log:
        reset_node(bus)
        with participants(bus, directory, duration_s, log) as host:
            pending = [at_half] if at_half is not None else []

            def progress(share: float) -> None:
                if share >= 0.5 and pending:
                    pending.pop()(host)  # type: ignore[misc]

            header = run_header(host.plan, host.identity, host.plan.toggle)
            outcome = record_live(
                host.session, host.plan.profile, host.plan.toggle, directory / "run.mcap", header, progress=progress
            )
            assert not pending, "the run ended before its half"
        time.sleep(0.2)  # the last frames reach the log
    assert log.lost == 0
    return WholeRun(read_run(outcome.files[0]), outcome, log.frames, host.identity)


runs.ENABLE_TIMEOUT_S = PATIENCE_S  # the rate of the loop is the machine's
assert runs.POLL_S <= 0.05  # `progress` comes often enough for at_half
