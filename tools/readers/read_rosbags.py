"""Reads a recording with rosbags, by the schema that it carries. Prints what `facts.py` describes, as JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from facts import facts_of
from rosbags.highlevel import AnyReader

ROW_TOPIC = "/fffo_drive/row"
RECORD_TOPIC = "/fffo_drive/records"

with AnyReader([Path(sys.argv[1])]) as reader:
    rows, stamps, events, records = [], [], [], []
    for connection, stamp, raw in reader.messages():
        message = reader.deserialize(raw, connection.msgtype)
        if connection.topic == ROW_TOPIC:
            rows.append(message)
            stamps.append(stamp)
        elif connection.topic == RECORD_TOPIC:
            m = message
            records.append([m.time_ns, m.sequence, m.number, m.kind, m.names, m.values, m.data])
        else:
            events.append([message.time_ns, message.level, message.source, message.text, message.data])
    names = [name for name in vars(rows[0]) if not name.startswith("_")]
    columns = {}
    for name in names:
        values = [getattr(row, name) for row in rows]
        kind = np.float64 if isinstance(values[0], float) else np.uint64 if max(values) > 2**63 - 1 else np.int64
        columns[name] = np.array(values, kind)
found = facts_of(columns, np.array(stamps, np.int64), events, records, {}, {})
del found["attachments"], found["metadata"]  # rosbags has neither
print(json.dumps(found))
