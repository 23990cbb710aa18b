"""The cache of compiled kernels, shared by programs that have ports of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
from typing import NamedTuple
from fffo_drive.drive.port import port_now_ns
from fffo_drive.jit import njit
class Own(NamedTuple):
    start_ns: int
LATER_NS = {later_ns}
@port_now_ns.register(Own)
@njit
def own_now(port):
    return port.start_ns + LATER_NS
@njit
def now_of(port):
    return port_now_ns(port)
print(now_of(Own(2)), sum(now_of.stats.cache_hits.values()))
"""


def _run(program: Path, cache: Path) -> list[int]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(
        # imported: a class of a main program would be pickled whole, and read anywhere
        [sys.executable, "-c", f"import {program.stem}"],
        cwd=program.parent, env=environment, capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    return [int(word) for word in done.stdout.split()]


def test_programs_with_ports_of_one_name_share_the_cache(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    one, two, cache = tmp_path / "one" / "own.py", tmp_path / "two" / "own.py", tmp_path / "cache"
    one.write_text(PROGRAM.format(later_ns=3))
    two.write_text(PROGRAM.format(later_ns=4))
    assert _run(one, cache) == [5, 0]
    assert _run(one, cache) == [5, 1]  # from the cache
    assert _run(two, cache) == [6, 0]
    one.write_text(PROGRAM.format(later_ns=5))
    assert _run(one, cache) == [7, 0]  # the edited port is compiled again


CALLER = """
from callee import twice
from fffo_drive.jit import njit
@njit
def four_times(value):
    return twice(twice(value))
print(four_times(1), sum(four_times.stats.cache_hits.values()))
"""
CALLEE = """
from fffo_drive.jit import njit
@njit
def twice(value):
    return {factor} * value
"""


def test_a_kernel_of_ones_own_notices_an_edited_callee_in_the_file_beside_it(tmp_path: Path) -> None:
    caller, callee, cache = tmp_path / "caller.py", tmp_path / "callee.py", tmp_path / "cache"
    caller.write_text(CALLER)
    callee.write_text(CALLEE.format(factor=2))
    assert _run(caller, cache) == [4, 0]
    assert _run(caller, cache) == [4, 1]
    callee.write_text(CALLEE.format(factor=3))
    assert _run(caller, cache) == [9, 0]


INDEX_READER = """
import sys
from pathlib import Path
import pickle
import fffo_drive.jit
for path in Path(sys.argv[1]).rglob("*.nbi"):
    with path.open("rb") as file:
        pickle.load(file)
        pickle.loads(file.read())
print(sum(1 for _ in Path(sys.argv[1]).rglob("*.nbi")))
"""


def test_an_index_is_read_where_the_port_is_not_known(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    program, reader = tmp_path / "one" / "own.py", tmp_path / "reader.py"
    program.write_text(PROGRAM.format(later_ns=3))
    reader.write_text(INDEX_READER)
    _run(program, tmp_path / "cache")
    done = subprocess.run(
        [sys.executable, str(reader), str(tmp_path / "cache")], capture_output=True, text=True, timeout=120, check=True
    )
    assert int(done.stdout) > 0
