"""Record one profile on a drive: in process as fast as possible, on a bus in real time."""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..config.axis import recorder_settings
from ..config.commissioning import Permission
from ..config.runaway import accepted_words
from ..drive.port import Drive
from ..evaluation.metrics import ErrorSums, TickSums, profile_rows
from ..runtime.fault_at_start import clear_fault
from ..runtime.runs import RunOutcome, record_live, record_simulated, simulated_ring_rows
from ..runtime.session import Session
from .plan import Plan, connect, effect_monitor, plan_session, run_header, toggle_name
from .progress import Bar, no_bar
from .recordings import recorded_blocks, recorder_hooks


def record_run(
    plan: Plan, drive: Drive, toggle: int, out: Path, given: Permission,
    bar: Bar = no_bar, ring_rows: int | None = None, reset_fault: bool = False,
) -> RunOutcome:  # fmt: skip
    """Connect, run the profile of the plan and record it. `ring_rows`: None for the default. Raises DriveError.

    `bar` appears when a run in real time begins. `reset_fault`: of a drive that is in fault, before anything moves.
    """
    for text in accepted_words(plan.axis, plan.model):
        print(f"warning: {text}", file=sys.stderr)
    identity = connect(drive, given)
    header = run_header(plan, identity, toggle, given)
    settings, hooks = recorder_settings(plan.axis), recorder_hooks()
    if not drive.realtime:
        rows = simulated_ring_rows(plan.profile, plan.axis.loop.tail_s)
        with Session(drive, plan_session(plan, rows)) as session:
            return record_simulated(session, plan.profile, toggle, out, header, settings, hooks)
    with Session(drive, plan_session(plan, ring_rows)) as session:
        report = session.start()
        for refusal in report.refusals:
            print(f"without real-time properties: {refusal}", file=sys.stderr)
        cleared = clear_fault(session, reset_fault, f"fffo-drive run {shlex.quote(str(plan.path))} --reset-fault")
        if cleared:
            print(cleared, file=sys.stderr)
            header = replace(header, metadata={**header.metadata, "at_start": cleared})
        monitor = effect_monitor(plan)
        with bar(f"{plan.axis.name} {toggle_name(toggle)}") as progress:
            return record_live(session, plan.profile, toggle, out, header, settings, hooks, progress, monitor)


def summarise(plan: Plan, outcome: RunOutcome, toggle: int) -> dict[str, Any]:
    """The result as one JSON object, from what was recorded."""
    recorder = outcome.recorder
    summary: dict[str, Any] = {
        "axis": plan.axis.name,
        "toggle": toggle_name(toggle),
        "fault": outcome.fault_text,
        "warnings": list(outcome.warnings),
        "files": [str(file) for file in outcome.files],
        "rows_written": recorder.rows_written,
        "rows_lost": recorder.rows_lost,
        "rows_dropped": recorder.rows_dropped,
        "write_errors": recorder.write_errors,
    }
    ticks, errors = TickSums(), ErrorSums()
    for rows in recorded_blocks(outcome.files):
        ticks.take(rows)
        inside = profile_rows(rows, plan.profile.values.size)
        errors.take(inside["reference_rps"] - inside["velocity_rps"])
    if ticks.rows:
        summary["ticks"] = ticks.statistics(outcome.exchange)._asdict()
    if errors.samples:
        summary["metrics"] = errors.metrics(plan.profile.period_s)._asdict()
    return summary
