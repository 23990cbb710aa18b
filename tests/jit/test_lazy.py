"""numba is loaded with the first kernel that is called, and then kernels are what they were."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading

import pytest

from fffo_drive import jit
from fffo_drive.drive.cia402 import state_of

OPERATION_ENABLED = 0x237  # a statusword (CiA 402)
ALL_KERNELS = "import sys, fffo_drive.library, fffo_drive.drive.cia402 as c;"


def printed(code: str, **environment: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return done.stdout.split()


def test_to_import_every_kernel_loads_no_numba_and_to_call_one_does():
    code = f"{ALL_KERNELS} print('numba' in sys.modules); c.state_of(0x237); print('numba' in sys.modules)"
    assert printed(code, NUMBA_DISABLE_JIT="0") == ["False", "True"]


def test_interpreted_kernels_are_plain_functions_and_never_load_it():
    code = f"{ALL_KERNELS} print(c.state_of(0x237), type(c.state_of).__name__, 'numba' in sys.modules)"
    assert printed(code, NUMBA_DISABLE_JIT="1") == [str(int(state_of(OPERATION_ENABLED))), "function", "False"]


@pytest.mark.skipif(jit.INTERPRETED, reason="nothing is compiled")
def test_a_kernel_has_one_dispatcher_whoever_calls_it_first():
    @jit.njit
    def twice(value: float) -> float:
        return 2.0 * value

    met = threading.Barrier(8)
    made = []

    def ask() -> None:
        met.wait()
        made.append(twice.dispatcher)

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 8
    assert len({id(one) for one in made}) == 1
    assert twice(3.0) == 6.0


def test_a_kernel_is_its_function_for_whoever_looks_at_it_and_goes_to_other_processes_by_name():
    assert (state_of.__name__, state_of.__module__) == ("state_of", "fffo_drive.drive.cia402")
    assert state_of.__doc__
    assert pickle.loads(pickle.dumps(state_of)) is state_of
    assert not hasattr(state_of, "__len__")
