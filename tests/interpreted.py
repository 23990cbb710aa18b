"""Run a function of a test module in a second interpreter without compilation, to compare bit for bit."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parent


def hex_results(module: str, function: str, timeout_s: float = 150.0) -> list[str]:
    """`function()` of tests module `module`, called in a process with NUMBA_DISABLE_JIT=1: its list of float.hex()."""
    code = f"import json; from {module} import {function}; print(json.dumps({function}()))"
    environment = dict(os.environ, NUMBA_DISABLE_JIT="1", PYTHONPATH=os.pathsep.join([str(TESTS), str(TESTS.parent)]))
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], env=environment, capture_output=True, text=True, timeout=timeout_s
    )
    assert done.returncode == 0, done.stderr
    result: list[str] = json.loads(done.stdout)
    return result
