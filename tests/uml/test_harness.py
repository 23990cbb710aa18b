"""tools/uml/run: what goes in and comes out, what stays as it was, and how it ends."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
from needs import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.uml, pytest.mark.timeout(400)]

RUN = ROOT / "tools" / "uml" / "run"
TIMED_OUT, NO_RESULT = 124, 125


def run(*words: str | Path, limit_s: float = 120.0) -> subprocess.CompletedProcess[str]:
    command = [RUN, "--timeout", str(limit_s), *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=limit_s + 60.0)


def kernels_of(exchange: Path) -> list[str]:
    """Processes of the kernel that was given this exchange directory."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = entry.read_bytes().replace(b"\0", b" ").decode()
        except OSError:  # it has ended
            continue
        if "linux.uml" in line and str(exchange) in line:
            found.append(line)
    return found


def test_output_exit_code_and_exchange_come_back_and_nothing_else_is_written(tmp_path):
    stray = ROOT / "tests" / "uml" / f"stray_{os.getpid()}"
    log = tmp_path / "kernel.log"
    script = f'id -u; pwd; echo "$GREETING"; echo kept >"$UML_EXCHANGE/file"; echo lost >{stray}; cat {stray}; exit 3'
    done = run("--exchange", tmp_path, "--log", log, "--env", "GREETING=it's here", "sh", "-c", script)
    assert done.returncode == 3, done.stderr
    lines = done.stdout.splitlines()
    at = lines.index("0")
    assert lines[at : at + 4] == ["0", str(ROOT), "it's here", "lost"]
    assert (tmp_path / "file").read_text() == "kept\n"
    assert not stray.exists()
    assert "it's here" in log.read_text()


def test_there_is_af_can_and_no_network_beyond_it():
    script = "ip link add vcan0 type vcan && ip -o link | cut -d: -f2 | tr -d ' ' | sort | tr '\\n' ' '"
    done = run("sh", "-c", script)
    assert done.returncode == 0
    assert {"lo", "vcan0"} <= set(done.stdout.split())
    assert not [name for name in done.stdout.split() if name.startswith(("eth", "en", "vec"))]


def test_a_command_that_does_not_end_is_ended_with_its_kernel(tmp_path):
    done = run("--exchange", tmp_path, "sleep", "1000", limit_s=8.0)
    assert done.returncode == TIMED_OUT
    assert "sleep 1000 did not end within 8 s" in done.stderr
    assert not kernels_of(tmp_path)


def test_a_kernel_that_ends_without_a_result_is_no_success():
    done = run("sh", "-c", "echo o >/proc/sysrq-trigger; sleep 100")
    assert done.returncode == NO_RESULT
    assert "without a result" in done.stderr
