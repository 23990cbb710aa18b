"""Longer work of the library: commissioning, importing logs, the whole circle, tables of recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..commissioning.procedure import MayMove
from ..commissioning.record import CommissioningRecord
from ..documents import DocumentError, did_you_mean
from ..importing.can_trace import NodeNeededError
from ..importing.candidates import ROLES, Hints
from ..importing.joints import JointNeededError
from ..importing.source import TraceDrive
from ..importing.times import RateNeededError
from ..recording.export import Exported
from ..recording.export import export as export_rows
from ..recording.reader import TimeWindow
from ..workflows import circle
from ..workflows import import_logs as importing
from ..workflows.circle import Closed
from ..workflows.circle_runs import CircleWish
from ..workflows.commission import accept_record, bounds_of, commission_axis, commissioning_plan, record_path
from ..workflows.import_logs import Imported
from .measured import Axis, MeasuredRun, as_written, recorded

SIGNALS = tuple(ROLES.values())


def commission(
    axis: Axis | str | Path,
    out: str | Path | None = None,
    *,
    bus: str | None = None,
    current_a: float | None = None,
    speed_rps: float | None = None,
    travel_rev: float | None = None,
    may_move: MayMove = lambda motion: True,
    accept: bool = False,
    reset_fault: bool = False,
) -> CommissioningRecord:
    """Check signs, scales, delay and limits of an axis with small pulses. **A drive on a bus moves.**

    `out`: the record (None: where the axis file says, else NAME.commissioning.yaml beside it). `bus` replaces the bus
    of the file. `current_a`, `speed_rps`, `travel_rev`: largest ones, inside the envelope (None: from it). `may_move`
    is asked before each motion. `accept`: name a record that has passed in the axis file. `reset_fault`: of a drive
    that is in fault. `.verdict`, `.passed` and `.checks` are the result. Raises DriveError, DocumentError, OSError, and
    NotAgreedError where `may_move` says no.
    """
    plan = commissioning_plan(as_written(axis).path)
    path = record_path(plan) if out is None else Path(out)
    bounds = bounds_of(plan, current_a, speed_rps, travel_rev)
    record = commission_axis(plan, bounds, path, bus, may_move=may_move, reset_fault=reset_fault)
    if accept and record.passed:
        accept_record(plan, path)
    return record


def import_log(
    logs: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    columns: Mapping[str, str | None] | None = None,
    units: Mapping[str, str] | None = None,
    rate_hz: float | None = None,
    counts_per_turn: float | None = None,
    linear: bool = False,
    joint: str | None = None,
    node: str | None = None,
    drop: bool = False,
    facts: Mapping[str, Any] | None = None,
    accept_assumptions: bool = False,
) -> Imported:
    """Convert logs of one axis to recordings in the directory `out`, with facts and a map of columns.

    `columns`: which column is a signal ({"position_rev": "theta", "current_a": None}; None: no column is). `units`: of
    columns ({"theta": "deg"}). `rate_hz`: where no column is the time. `counts_per_turn`: of a position in counts.
    `linear`: m and N instead of rev and Nm. `joint`: of a robot's log. `node`: of a trace of a CAN bus. `drop`: leave
    out more than 1 % of the rows. `facts`: of the axis ({"torque_constant_nm_per_a": 0.148}).

    What names, units and data leave open is an assumption, and an error that lists them, unless `accept_assumptions`.
    `.recordings` are the files. Raises RecordingError, DocumentError.
    """
    roles = {signal: column or "" for signal, column in (columns or {}).items()}
    unknown = next((signal for signal in roles if signal not in SIGNALS), None)
    if unknown is not None:
        raise DocumentError(f"columns: no signal {unknown!r}: {did_you_mean(unknown, SIGNALS)}")
    for name, value in (("rate_hz", rate_hz), ("counts_per_turn", counts_per_turn)):
        if value is not None and not 0.0 < value < math.inf:
            raise DocumentError(f"{name}: {value:g}: a positive number is needed")
    declared = dict(facts or {})
    hints = Hints(
        rate_hz,
        counts_per_turn,
        declared.get("pole_pairs"),
        drop,
        linear,
        roles,
        importing.known_units(dict(units or {})),
        TraceDrive(node=node) if node is not None else None,
        joint,
    )
    paths = [logs] if isinstance(logs, str | Path) else list(logs)
    try:
        found = importing.recognised_logs(paths, hints)
    except (RateNeededError, NodeNeededError, JointNeededError) as error:
        kinds = {RateNeededError: "rate_hz", NodeNeededError: "node", JointNeededError: "joint"}
        raise DocumentError(f"{kinds[type(error)]}: {error}") from None
    open_ones = importing.assumptions(found)
    if open_ones and not accept_assumptions:
        lines = "\n".join(f"  {g.signal} is {g.column!r} [{g.unit}]: {g.evidence}" for g in open_ones)
        raise DocumentError(f"assumptions: correct them with columns= and units=, or accept_assumptions=True\n{lines}")
    return importing.write_import(found, hints, declared, Path(out))


def close_the_loop(
    axis: Axis | str | Path,
    out: str | Path,
    *,
    facts: str | Path | None = None,
    sim: str | Path | None = None,
    bus: str | None = None,
    rate_hz: int | None = None,
    quick: bool = False,
    uncommissioned: bool = False,
) -> Closed:
    """Run, record, diagnose, adopt, and run again: the tracking error before and after. **A drive on a bus moves.**

    The axis file stays as it is; everything is written to the directory `out`, a new axis file among it. `facts`: what
    is declared about the drive (None: from the axis file). `sim`: the simulated drive of this file, in process or on
    the bus. `bus`, `rate_hz`: instead of the file's. `quick`: runs of 20 s without the recipe. `uncommissioned`: enable
    a drive without its commissioning record.

    `.source.tracking` has the errors, `.adopted` and `.gates` say what went into service, `.page` is the report. Raises
    DocumentError, DriveError, DriveFaultError.
    """
    wish = CircleWish(None if sim is None else Path(sim), bus, rate_hz, uncommissioned)
    declared = None if facts is None else Path(facts)
    return circle.close_the_loop(as_written(axis).path, Path(out), wish, facts=declared, quick=quick)


def export(
    runs: MeasuredRun | str | Path | Sequence[MeasuredRun | str | Path],
    out: str | Path,
    *,
    columns: Sequence[str] = (),
    from_s: float = 0.0,
    to_s: float = math.inf,
) -> Exported:
    """Write the rows of recordings as a table (.csv, .parquet) or a part of one as a recording (.mcap).

    `columns`: some of the signals (none: all). `from_s`, `to_s`: seconds since the first row. Raises RecordingError,
    OSError.
    """
    several = [runs] if isinstance(runs, MeasuredRun | str | Path) else list(runs)
    return export_rows(recorded(several), Path(out), columns, TimeWindow(from_s, to_s))
