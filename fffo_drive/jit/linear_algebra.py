"""numba imports scipy.linalg (0.2 s) with the first kernel, to learn whether it could compile a matrix product.

No kernel here may hold one: it would allocate. numba is told that there is no BLAS; SciPy itself stays as it is.
"""

from __future__ import annotations

import sys
from typing import Any

ASKED_FOR = "scipy.linalg"


def leave_out() -> None:
    """To be called before the first kernel is compiled or taken from the cache; later it changes nothing."""
    modules: dict[str, Any] = sys.modules
    if ASKED_FOR in modules:
        return
    modules[ASKED_FOR] = None  # who imports it is told that it is not there
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        del modules[ASKED_FOR]
