"""Shared by all tests: helper modules beside the tests are importable, and compiled code has a cache of its own.

The index of a kernel's cache names every type that it was compiled for. Test doubles are such types: in the user's
cache they would make it unreadable for a process that has no tests on its path.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parent
if str(TESTS) not in sys.path:
    sys.path.insert(0, str(TESTS))

os.environ["NUMBA_CACHE_DIR"] = os.environ.get("FFFO_TEST_CACHE") or str(Path(sys.prefix) / "numba-tests")

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
