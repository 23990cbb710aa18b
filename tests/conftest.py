"""Shared by all tests: modules beside them and in tools are importable; all processes share one cache of kernels."""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parent
TOOLS = TESTS.parent / "tools"  # trial_axes, rigid_regression, headless
if str(TESTS) not in sys.path:
    sys.path.insert(0, str(TESTS))
    sys.path.append(str(TOOLS))

os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(sys.prefix) / "numba"))  # kept with the environment
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command has it: small matrices, and workers share the cores

from hypothesis import settings  # noqa: E402

# the first example compiles kernels, and machines are shared: no example has a deadline; seeds are fixed
settings.register_profile("fffo", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("fffo")

from browser import chromium  # noqa: E402, F401
from bus_fixtures import drive_bus, whole_run  # noqa: E402, F401
from needs import (  # noqa: E402, F401  # hooks of pytest: what cannot run on this machine is left out, with a word
    pytest_collection_modifyitems,
    pytest_configure,
    pytest_terminal_summary,
    pytest_testnodedown,
)
from wheel_fixtures import site, wheel  # noqa: E402, F401


def pytest_collection_finish() -> None:
    """The collected tests live to the end: scanning them for garbage again and again is a fortieth of the time."""
    gc.collect()
    gc.freeze()
