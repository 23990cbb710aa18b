"""A short sample of each benchmark: the same work in both languages, nothing lost, and ratios with a wide margin.

Each runs in a process of its own, as from a terminal. No figure of time is held against a clock.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "tools" / "benchmarks"
COMMANDS = ("loop_cycle", "lateness", "plant", "identification", "recorder", "node", "live", "small_commands")
NEED_C = ("loop_cycle", "lateness", "plant", "identification")
UNAVAILABLE = 69


def python(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    inherited = {name: value for name, value in os.environ.items() if name not in ("NUMBA_DISABLE_JIT", "CC")}
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True, text=True, timeout=560, cwd=BENCHMARKS, env={**inherited, **environment},
    )  # fmt: skip


def sample(name: str, *options: str) -> dict:
    """Facts of a sample run; where there is no C compiler, that it says so (and no facts)."""
    done = python(str(BENCHMARKS / f"{name}.py"), "--sample", "--json", *options)
    if name in NEED_C and shutil.which("gcc") is None:
        assert done.returncode == UNAVAILABLE
        assert "apt install gcc" in done.stderr
        return {}
    assert done.returncode == 0, done.stderr
    facts: dict = json.loads(done.stdout)
    return facts


@pytest.mark.parametrize("table", sorted((BENCHMARKS / "results").glob("*.md")), ids=lambda path: path.stem)
def test_every_table_says_by_what_code_it_was_made(table):
    said = r"Made by `tools/benchmarks/[\w.]+` on \d{4}-\d\d-\d\d, commits? [0-9a-f]{7,}"
    assert re.search(said, table.read_text()), f"{table.name}: no program, date and commit"


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_compiled_loop_does_what_the_loop_in_c_does_at_its_cost():
    facts = sample("loop_cycle")
    if facts:
        assert facts["socket pair: estimated ticks"] == 0
        assert facts["socket pair, estimated velocity: estimated ticks"] > 900  # of 1000
        assert facts["socket pair: ticks that learn"] == 0
        assert facts["socket pair, adaptation: ticks that learn"] > 500
        assert facts["socket pair: ticks that hold"] == 0
        assert facts["socket pair, hold: ticks that hold"] > 300
    for bus in ("socket pair", "loopback bus", "socket pair, estimated velocity", "socket pair, hold") if facts else ():
        assert facts[f"{bus}: differing fields"] == []
        assert facts[f"{bus}: largest command"] > 0.1  # it did control
    if facts:
        assert facts["socket pair: least cycle, numba over C"]["median"] < 1.5


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_plant_is_the_plant_in_c_bit_for_bit_at_its_cost():
    facts = sample("plant")
    if facts:
        assert facts["differing parts"] == []
        assert facts["sub-step, numba over C"]["median"] < 1.8


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_simulation_of_the_model_is_that_in_c():
    facts = sample("identification")
    if facts:
        assert facts["largest difference of the two"] < 1e-6
        assert facts["simulation over the same in C"]["median"] < 1.8


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_every_loop_of_the_lateness_benchmark_runs_its_ticks():
    facts = sample("lateness")
    if facts:
        assert facts["ticks"] == 300
        ratios = [value for value in facts.values() if isinstance(value, dict)]
        assert len(ratios) == 16
        assert all(0.0 < ratio["low"] <= ratio["median"] <= ratio["high"] for ratio in ratios)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_recorder_keeps_every_row_and_the_reader_every_column():
    facts = sample("recorder")
    assert facts["complete"]
    assert facts["rows"] == facts["ticks"] > 10_000
    assert facts["simulated time: rows lost in the ring"] == 0
    assert facts["simulated time: rows missing or out of order in the file"] == 0
    assert facts["simulated time: recorder's share of a core"] < 5.0  # CPU time of its own thread
    assert 30 < facts["simulated time: bytes a row in the MCAP file"] < 250
    assert facts["columns"] > 30


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_the_daemon_loses_no_row_beside_twenty_clients():
    facts = sample("daemon")
    assert facts["complete"]
    assert facts["rows lost in the ring or on the disk"] == 0
    assert facts["disordered"] == 0
    assert facts["ticks absent from the file"] <= facts["ticks skipped by the loop"]
    assert facts["recorded"] > 2000
    assert facts["requests a second"] > 0


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_the_stream_is_read_by_three_clients():
    facts = sample("live")
    assert facts["rows lost by the recorder"] == 0
    assert facts["frames a second"] > 0
    assert 0.0 < facts["CPU of the stream, 3 clients (median)"] < 100.0
    assert facts["CPU of the stream, no client (median)"] < facts["CPU of the stream, 3 clients (median)"]
    assert facts.get("pictures a second in the browser", 1.0) > 0.0


# each a test of its own, so that two workers share them


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_nothing_moves_after_a_stop_on_any_way():
    facts = sample("attacks", "--only", "motion_after_stop")
    assert facts["motion after a stop: motions after an acknowledged stop"] == 0, facts
    assert facts["motion after a stop: races"] > 20
    assert sum(int(row["requests refused"]) for row in facts["motion after a stop"]) > 100


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_frames_of_somebody_else_are_named():
    facts = sample("attacks", "--only", "foreign_frames")
    assert facts["frames of somebody else: not named within 2 ticks"] == 0, facts


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_hostile_clients_end_no_motion():
    facts = sample("stops")
    assert "abandoned" not in facts["faults"]
    facts = sample("hostile")
    assert facts["faults `abandoned`"] == 0
    assert facts["rows lost in the ring or on the disk"] == 0
    assert facts["earlier events that were displaced"] == 0
    assert facts["what the hostile clients did a second (median)"] > 100


@pytest.mark.parametrize("name", NEED_C)
def test_a_machine_without_a_c_compiler_gets_one_clear_message(name):
    done = python(str(BENCHMARKS / f"{name}.py"), "--sample", CC="no-such-compiler")
    assert done.returncode == UNAVAILABLE
    assert done.stderr.count("\n") == 1
    assert "'no-such-compiler'" in done.stderr
    assert "CC=" in done.stderr


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_node_holds_sync_and_its_cost_is_measured():
    facts = sample("node")
    assert facts["SYNCs sent"] > 4000
    assert 0.01 < facts["CPU time of the node, share of a core"] < 1.0
    assert "RPDO applied, 0 frames dropped, 0 send errors" in facts["node"]


@pytest.mark.parametrize("name", COMMANDS)
def test_each_is_one_command(name):
    command = BENCHMARKS / name
    assert os.access(command, os.X_OK)
    assert name in command.read_text()


STATISTICS = """
import json
import numpy as np
from common import interleaved, paired_ratio
generator = np.random.default_rng(3)
drift = np.exp(np.cumsum(generator.normal(0.0, 0.5, 60)))  # a machine that is fast and slow, for both alike
ratio = paired_ratio(1.2 * drift * generator.lognormal(0.0, 0.05, 60), drift)
order = []
variants = {name: (lambda name=name: (order.append(name), {"figure": len(order)})[1]) for name in "abc"}
found = interleaved(variants, 4)
print(json.dumps({"ratio": ratio, "order": "".join(order), "a": found["a"]["figure"].tolist()}))
"""


def test_paired_ratios_see_through_a_machine_that_changes():
    done = python("-c", STATISTICS)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    median, low, high, passes = facts["ratio"]
    assert low < median < high
    assert low <= 1.2 <= high
    assert high - low < 0.1
    assert passes == 60
    # every variant once a pass, in an order that turns
    turns = [facts["order"][begin : begin + 3] for begin in range(0, 12, 3)]
    assert all(sorted(turn) == ["a", "b", "c"] for turn in turns)
    assert len(set(turns)) > 2
    assert len(facts["a"]) == 4


def test_constants_of_two_values_are_refused():
    code = "from in_c import Declarations; d = Declarations(); d.numbers({'A': 1}); d.numbers({'A': 2})"
    done = python("-c", code)
    assert done.returncode == 1
    assert "A has two values" in done.stderr


LOADED = """
import json
from small_commands import EDS, HEAVY, loaded
found = dict(loaded())
print(json.dumps({"eds": f"drive-info {EDS}", "heavy": {command: names for command, names in found.items() if names}}))
"""


@pytest.mark.timeout(120)
def test_small_commands_load_no_compiler_and_nothing_else_that_is_slow():
    """Counted in modules, one command after the other; what they cost stands in results/small_commands.md."""
    done = python("-c", LOADED)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["heavy"] == {facts["eds"]: ["canopen"]}  # it reads the file with that library
