"""The half of `jit` that needs numba, and loads it: dispatchers, their cache, the choice of a kernel by type.

numba would import scipy.linalg (0.2 s) with the first kernel, to learn whether it could compile a matrix product. No
kernel here may hold one, since it would allocate: numba is told that there is no BLAS.
"""

from __future__ import annotations

import functools
import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import overload
from numba.np import linalg

from . import PACKAGE_DIRECTORY, Kernel, cache_directory, compiling, declarations, digest_of

# without numba's runtime there is nothing to allocate with, and no reference count of an array is touched: their atomic
# increments were two fifths of the loop's cycle
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}


def _leave_out_linear_algebra() -> None:
    def no_blas() -> None:
        raise ImportError("no kernel holds a matrix product")

    ensure_blas, linalg.ensure_blas = linalg.ensure_blas, no_blas
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        linalg.ensure_blas = ensure_blas


numba.config.DISABLE_JIT = 0  # `jit` has decided; numba would also read a file in the working directory
numba.config.CACHE_DIR = str(cache_directory())
_leave_out_linear_algebra()


def dispatcher_of(kernel: Kernel) -> Any:
    """The dispatcher of a kernel; makes it, after all that has been declared so far."""
    with global_compiler_lock:  # reentrant: a caller that is being compiled asks for its callees
        while declarations:
            declarations.pop(0)()
        made = kernel.__dict__.get("dispatcher")
        if made is None:
            made = numba.njit(kernel.py_func, fastmath=False, forceinline=kernel.inline, **_OPTIONS)
            if Path(kernel.py_func.__code__.co_filename).is_file():  # one that was typed at a prompt is not kept
                made._cache = _KernelCache(kernel.py_func)
            kernel.__dict__["dispatcher"] = made
    return made


def declare_choice(call: Callable[..., Any], registry: dict[type, Callable[..., Any]]) -> None:
    """Inside kernels, `call` is the kernel that the registry has for the type of its first argument."""

    def choose(first: Any, *rest: Any) -> Any:
        if not isinstance(first, types.BaseNamedTuple):
            return None
        kernel = registry.get(first.instance_class)
        if kernel is None:
            return None

        # a call, not the kernel's own Python function: that would be compiled twice under one symbol and crash
        def implementation(first: Any, *rest: Any) -> Any:
            return kernel(first, *rest)

        return implementation

    overload(call, strict=False, jit_options=_OPTIONS | {"forceinline": True})(choose)  # its callers are cached whole


def _named_tuples(kind: Any) -> Iterator[type]:
    """Classes of the named tuples in a numba type, or in a tuple of types."""
    if isinstance(kind, types.BaseNamedTuple):
        yield kind.instance_class
    if isinstance(kind, tuple | types.BaseTuple):
        for part in kind:
            yield from _named_tuples(part)


def _origin(named_tuple: type) -> str:
    """Where a class is from; one from outside this package also by the content of its file, which holds its kernels."""
    name = f"{named_tuple.__module__}.{named_tuple.__qualname__}"
    if named_tuple.__module__.startswith(f"{PACKAGE_DIRECTORY.name}."):
        return name
    path = getattr(sys.modules.get(named_tuple.__module__), "__file__", None)
    return f"{name} {hashlib.sha256(Path(path).read_bytes()).hexdigest() if path else os.getpid()}"


@functools.cache
def _digest_beside(path: Path) -> str:
    """Hash over the kernels in the folder of one from outside this package, which may call them; "" for one inside."""
    return "" if PACKAGE_DIRECTORY in path.parents else digest_of(path.parent, path.parent.glob("*.py"))


class _KernelCache(FunctionCache):  # type: ignore[misc]
    """numba's cache with text for a signature, since a pickled class can be read only where it can be imported.

    Without it, one script with a port of its own made every other program fail at the loop's cache.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What is on disk for a signature; None where it has to be compiled, which takes time: that is said."""
        found = super().load_overload(sig, target_context)
        if found is None:
            compiling()
        return found

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        arguments = tuple(sig) if isinstance(sig, tuple) else sig.args
        origins = sorted({_origin(named_tuple) for named_tuple in _named_tuples(arguments)})
        beside = _digest_beside(Path(self._py_func.__code__.co_filename).resolve())
        return (repr((arguments, origins, beside)), *super()._index_key(sig, codegen)[1:])
