"""A process that compiles for long says so, once."""

from __future__ import annotations

from fffo_drive.jit import LONG_S, compiling, say_when_compiling


def test_one_small_kernel_is_not_said_and_a_long_compilation_once():
    said = []
    say_when_compiling(lambda: said.append("compiling"))
    for now_s in (10.0, 10.0 + 0.9 * LONG_S):
        compiling(now_s)
    assert said == []
    for now_s in (10.0 + 1.1 * LONG_S, 60.0):
        compiling(now_s)
    assert said == ["compiling"]
