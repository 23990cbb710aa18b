"""What readers printed against what ours found: `compare.py EXPECTED.json NAME=FOUND.json ...`; 1 on disagreement."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from facts import disagreements

expected = json.loads(Path(sys.argv[1]).read_text())
bad = False
for argument in sys.argv[2:]:
    name, _, file = argument.partition("=")
    found = json.loads(Path(file).read_text())
    problems = disagreements(expected, found)
    parts = [f"{found['rows']} rows", f"{found['events']} events", f"{found['records']} records"]
    parts += [f"{len(found['columns'])} columns to the last bit"] if "columns" in found else []
    parts += [f"{len(found[key])} {key}" for key in ("attachments", "metadata") if key in found]
    print(f"{name:<12} {'DISAGREES' if problems else 'agrees'}: {', '.join(parts)}")
    for problem in problems:
        print(f"    {problem}")
    bad = bad or bool(problems)
sys.exit(bad)
