"""A recording with everything that readers trip over, and what is in it: `sample.py FILE` writes FILE and FILE.json.

Three chunks and more, every integer at the ends of its range, NaN, infinity, a subnormal, events with text beyond
ASCII, records with lists of any length, an empty attachment. The JSON is what our own reader finds; the other readers
are compared with it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from facts import facts_of

from fffo_drive.recording.events import Event, Level
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.run_records import RunRecord
from fffo_drive.recording.writer import RunWriter
from fffo_drive.signals import ROW

ROWS, BATCH = 12_000, 500
WALL_NS = 1_700_000_000_000_000_000
PERIOD_NS = 500_000
VALUES = (0.1, -0.0, 5e-324, float("inf"), 1.7976931348623157e308)


def rows() -> np.ndarray:
    """Random values in all fields; ticks and deadlines as the loop makes them, two ticks skipped."""
    chance = np.random.default_rng(1)
    made = np.zeros(ROWS, ROW)
    for name in ROW.names:
        kind = ROW[name]
        if kind.kind == "f":
            made[name] = chance.normal(size=ROWS)
            made[name][:6] = [0.0, -0.0, np.nan, np.inf, -np.inf, 5e-324]
        else:
            limits = np.iinfo(kind)
            made[name] = chance.integers(limits.min, limits.max, ROWS, dtype=kind, endpoint=True)
            made[name][:2] = [limits.min, limits.max]
    made["tick"] = np.arange(ROWS) + 2 * (np.arange(ROWS) > 7000)
    made["deadline_ns"] = 5_000_000_000 + made["tick"].astype(np.int64) * PERIOD_NS
    return made


def write(path: Path) -> None:
    """The recording."""
    attachments = [
        ("axis.yaml", "application/yaml", "name: Prüfstand\n".encode()),
        ("model.yaml", "application/yaml", bytes(range(256)) * 5),
        ("empty", "text/plain", b""),
    ]
    writer = RunWriter(path, {"axis": "bench", "note": 'µ, Ω and a "quote"'}, attachments, WALL_NS)
    made = rows()
    for begin in range(0, ROWS, BATCH):
        writer.write_rows(made[begin : begin + BATCH])
        stamp_ns = WALL_NS + int(made["deadline_ns"][begin])
        count = begin // BATCH
        names, values = tuple(f"größe_{k}" for k in range(count)), tuple(VALUES[k % len(VALUES)] for k in range(count))
        record = RunRecord(stamp_ns, count, count, "parameters", names, values, {"model": "µ", "begin": begin})
        writer.write_record(record, stamp_ns)
        writer.write_event(Event(stamp_ns, Level.INFO, "loop", f"Zustand № {begin}", {"begin": begin}))
    writer.close({"trip": "no fault"})


if __name__ == "__main__":
    file = Path(sys.argv[1])
    write(file)
    run = read_run(file)
    assert run.complete
    assert run.rows.tobytes() == rows().tobytes()
    columns = {name: run.rows[name] for name in ROW.names}
    events = [[e.time_ns, e.level, e.source, e.text, json.dumps(dict(e.data), sort_keys=True)] for e in run.events]
    records = [[*record[:6], json.dumps(dict(record.data))] for record in run.records]
    attached = {a.name: (a.media_type, a.data) for a in run.attachments.values()}
    metadata = {"fffo_drive": dict(run.metadata), "fffo_drive_summary": dict(run.summary)}
    found = facts_of(columns, run.log_time_ns, events, records, attached, metadata)
    Path(f"{file}.json").write_text(json.dumps(found, indent=1))
