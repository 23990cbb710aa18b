"""Asks rerun's Rust reader: `read_rerun.py RERUN FILE`. `mcap check` must find nothing; `mcap info` counts messages."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile

rerun, file = sys.argv[1:3]
with tempfile.TemporaryDirectory() as home:  # it keeps settings of its own, and would ask about statistics of use
    environment = dict(os.environ, HOME=home, XDG_CONFIG_HOME=home)
    check, info = (
        subprocess.run([rerun, "mcap", action, file], capture_output=True, text=True, env=environment)
        for action in ("check", "info")
    )
if check.returncode or info.returncode:
    print(check.stdout + check.stderr + info.stdout + info.stderr, file=sys.stderr)
    sys.exit(f"rerun mcap check: exit code {check.returncode}, info: {info.returncode}")
channels = dict(re.findall(r"^ *\d+ +(/\S+) +(\d+) +\S+.* Hz", info.stdout, re.MULTILINE))
topics = {"rows": "row", "events": "events", "records": "records"}
print(json.dumps({name: int(channels[f"/fffo_drive/{topic}"]) for name, topic in topics.items()}))
